"""`unidrive merge`."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from unidrive_cli.cli.progress import Progress
from unidrive_cli.cli.shared import CONFIG, DEBUG, JSON, guarded, option, plural
from unidrive_cli.convert.options import Link, VerifyLevel

if TYPE_CHECKING:
    from unidrive_cli.merge.plan import MergePlan
    from unidrive_cli.merge.run import MergeSummary


@guarded
def merge_command(
    datasets: list[Path] = typer.Argument(
        ..., metavar="DST...", readable=False, help="Converted datasets, of one virtual rig."
    ),
    dst: Path = option(..., "--out", help="Where the merged dataset goes."),
    version: str | None = option(
        None, "--version", help="Name of its version folder, where theirs have several.", show_default=False
    ),
    link: Link = option(
        "hardlink", "--link", help="How pictures and other files come into it; links share the datasets' data."
    ),
    verify: VerifyLevel = option("sample", "--verify", help="Decode a sample of the pictures at the end, or all."),
    space_check: bool = option(
        True, "--space-check/--no-space-check", help="Refuse to start where what is copied exceeds the free space."
    ),
    dry_run: bool = option(False, "--dry-run", help="Say what would be done; write nothing."),
    force: bool = option(False, "--force", help="Replace an --out that holds another dataset of ours."),
    as_json: bool = JSON,
    config: Path | None = CONFIG,
    debug: bool = DEBUG,
) -> None:
    """Make one dataset of several that `convert` has written through one virtual rig."""
    from unidrive_cli.merge.plan import make_merge_plan
    from unidrive_cli.merge.run import NAMES, merge
    from unidrive_cli.tables.destination import check_apart, check_destination, resolved_destination

    for dataset in datasets:
        check_apart(dataset, dst, NAMES)
    plan = make_merge_plan(datasets, version, link, verify)
    if dry_run:
        check_destination(resolved_destination(dst), plan.identity, force=force)
        _say_plan(plan, dst, as_json)
        return
    with Progress("files", sys.stderr) as progress:
        summary = merge(plan, dst, force=force, space_check=space_check, progress=progress)
    if as_json:
        typer.echo(json.dumps(asdict(summary)))
    else:
        _say_summary(summary, plan, dst)


def _say_plan(plan: MergePlan, dst: Path, as_json: bool) -> None:
    document = {
        "scenes": sum(part.scenes for part in plan.parts),
        "samples": sum(part.samples for part in plan.parts),
        "pictures": sum(part.pictures for part in plan.parts),
        "version": plan.version,
        "masks": plan.masks,
        "notes": plan.notes,
    }
    if as_json:
        typer.echo(json.dumps(document))
        return
    _say_parts(plan)
    scenes, samples = (
        sum(numbers) for numbers in zip(*((part.scenes, part.samples) for part in plan.parts), strict=True)
    )
    typer.echo(f"-> {dst / plan.version}: {plural(scenes, 'scene')}, {plural(samples, 'sample')}")
    for note in plan.notes:
        typer.echo(f"note: {note}")
    typer.echo("nothing was written (--dry-run)")


def _say_parts(plan: MergePlan) -> None:
    for position, part in enumerate(plan.parts, 1):
        counts = f"{plural(part.scenes, 'scene')}, {plural(part.samples, 'sample')}"
        typer.echo(f"dataset {position}: {part.source.root / part.version}: {counts}")


def _say_summary(summary: MergeSummary, plan: MergePlan, dst: Path) -> None:
    if summary.already_complete:
        typer.echo(f"{dst} already holds this dataset, complete; it was verified again, and nothing was changed.")
        return
    _say_parts(plan)
    typer.echo(
        f"{dst}: {plural(summary.scenes, 'scene')}, {plural(summary.samples, 'sample')}, "
        f"{plural(summary.pictures, 'picture')}, {plural(summary.annotations, 'annotation')}, "
        f"{summary.boxes_2d:,} 2D {'box' if summary.boxes_2d == 1 else 'boxes'}"
    )
    for note in summary.notes:
        typer.echo(f"note: {note}")
    if summary.verified:
        typer.echo(
            f"verified: nuscenes-devkit opens it; {summary.verified.pictures_decoded:,} of "
            f"{plural(summary.verified.pictures_present, 'picture')} decoded"
        )
