"""`unidrive convert`."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from unidrive_cli.cli.conversion import (
    OutputOptions,
    SelectionOptions,
    and_sweeps,
    leave_out,
    planned,
    say_summary,
)
from unidrive_cli.cli.progress import Progress
from unidrive_cli.cli.shared import (
    CONFIG,
    DEBUG,
    JOBS,
    JSON,
    RIG_HELP,
    SOURCE,
    WarpOptions,
    grouped,
    guarded,
    human_bytes,
    jobs_of,
    option,
    plural,
)
from unidrive_cli.convert.options import Backend
from unidrive_cli.errors import UsageError

if TYPE_CHECKING:
    from unidrive_cli.convert.parts import Part
    from unidrive_cli.convert.plan import Plan
    from unidrive_cli.convert.run import PartSummary


@guarded
@grouped
def convert_command(
    src: Path = SOURCE,
    dst: Path = typer.Argument(..., metavar="DST", help="Where the converted dataset goes."),
    rig: str = option(..., "--rig", help=RIG_HELP),
    *,
    selection: SelectionOptions,
    warp: WarpOptions,
    chosen: OutputOptions,
    jobs: int | None = JOBS,
    backend: Backend = option(
        "processes", "--backend", help="Processes on this machine, or a Dask cluster's workers."
    ),
    scheduler: str = option("", "--scheduler", help="Address of the Dask scheduler, with --backend dask."),
    part: str | None = option(
        None, "--part", help="Only the i-th of n shares, as i/n; `finalise` follows when all are done."
    ),
    dry_run: bool = option(False, "--dry-run", help="Say what would be done; write nothing."),
    force: bool = option(False, "--force", help="Replace a DST that holds another conversion of ours."),
    only_failed: bool = option(
        False, "--only-failed", help="Try only the samples again that failed (failures.txt)."
    ),
    space_check: bool = option(
        True, "--space-check/--no-space-check", help="Refuse to start where the estimate exceeds the free space."
    ),
    as_json: bool = JSON,
    config: Path | None = CONFIG,
    debug: bool = DEBUG,
) -> None:
    """Render a nuScenes-format dataset through a virtual rig, annotations included.

    Every option can also be given as UNIDRIVE_<OPTION> in the environment, or in the --config file.
    """
    from unidrive_cli.convert.parts import part_of
    from unidrive_cli.convert.run import convert, convert_part
    from unidrive_cli.tables.destination import check_destination, free_bytes, resolved_destination, same_device

    share = None if part is None else part_of(part)
    if share and force:
        raise UsageError("--part and --force exclude each other: other parts may be at work in DST.")
    if only_failed and (share or force):
        raise UsageError(f"--only-failed and --{'part' if share else 'force'} exclude each other.")
    plan = planned(
        src.absolute() if backend == "dask" else src,
        dst,
        rig,
        selection,
        warp,
        chosen,
        jobs=0 if dry_run else jobs_of(jobs),
        backend=backend,
        scheduler=scheduler,
        space_check=space_check,
    )
    if dry_run:
        check_destination(resolved_destination(dst), plan.identity, force=force)
        _say_plan(plan, dst, as_json, share, free=free_bytes(dst), links=same_device(src, dst))
        return
    if plan.options.link == "hardlink" and not same_device(src, dst):
        typer.echo("note: DST is on another file system: files that do not change are copied, not linked", err=True)
    if share:
        with Progress(f"{_unit_noun(plan)}s", sys.stderr) as progress:
            done = convert_part(plan, dst, share, progress=progress)
        if as_json:
            typer.echo(json.dumps(asdict(done)))
        else:
            _say_part(done, dst, _unit_noun(plan))
        leave_out(done.failures)
        return
    with Progress(f"{_unit_noun(plan)}s", sys.stderr) as progress:
        summary = convert(plan, dst, force=force, only_failed=only_failed, progress=progress)
    say_summary(summary, plan, dst, as_json)


def _unit_noun(plan: Plan) -> str:
    """What the units of work are called."""
    return "moment" if plan.sweeps else "sample"


def _say_plan(plan: Plan, dst: Path, as_json: bool, share: Part | None, *, free: int, links: bool) -> None:
    estimate = plan.estimated_bytes()
    scenes = len({unit.scene.token for unit in plan.units})
    sources = sum(len(unit.sources) for unit in plan.units) + sum(len(sweep.rows) for sweep in plan.sweeps)
    annotations = sum(len(plan.dataset.annotation_indices(unit.sample.token)) for unit in plan.units)
    sizes = sorted({f"{camera.lens.width_px}x{camera.lens.height_px}" for camera in plan.rig.cameras})
    copies = plan.options.link == "copy" or (plan.options.link == "hardlink" and not links)
    document: dict[str, Any] = {
        "samples": len(plan.units),
        "scenes": scenes,
        "sweeps": len(plan.sweeps),
        "pictures": plan.picture_count,
        "source_pictures": sources,
        "annotations": annotations,
        "estimated_bytes": estimate,
        "free_bytes": free,
        "rig": plan.rig.name,
        "picture_sizes": sizes,
        "copies": copies,
        "notes": plan.notes,
    }
    if share:
        units = share.of(plan.moments)
        document["part"] = {
            "part": str(share),
            "samples": len(units),
            "scenes": list(dict.fromkeys(unit.scene.name for unit in units)),
        }
    if as_json:
        typer.echo(json.dumps(document))
        return
    typer.echo(
        f"{plan.dataset.folder} -> {dst} through {plan.rig.name}: {plural(len(plan.units), 'sample')} in "
        f"{plural(scenes, 'scene')}{and_sweeps(len(plan.sweeps))}"
    )
    typer.echo(f"reads  {plural(sources, 'source picture')}")
    typer.echo(
        f"writes {plural(plan.picture_count, 'picture')} of {', '.join(sizes)} pixels, "
        f"about {human_bytes(estimate)} ({human_bytes(free)} free); {plural(annotations, 'annotation')}"
    )
    if copies:
        why = "" if links else ": DST is on another file system, where links cannot lead"
        typer.echo(f"files that do not change (lidar, radar, maps) are copied{why}; their size is not counted above")
    if estimate > free:
        refuses = plan.options.space_check
        what = "refuse to start (--no-space-check)" if refuses else "start all the same, and may stop in the middle"
        typer.echo(f"that is more than is free: the conversion will {what}")
    if share:
        units = share.of(plan.moments)
        scenes = len({unit.scene.token for unit in units})
        typer.echo(f"part {share}: {plural(len(units), _unit_noun(plan))} of {plural(scenes, 'scene')}")
    for note in plan.notes:
        typer.echo(f"note: {note}")
    typer.echo("nothing was written (--dry-run)")


def _say_part(done: PartSummary, dst: Path, noun: str) -> None:
    if done.already_complete:
        typer.echo(f"{dst} already holds this conversion, complete; nothing was changed.")
        return
    converted = done.samples - len(done.failures)
    typer.echo(f"{dst}: part {done.part}: {converted:,} of {plural(done.samples, noun)} converted")
    if done.left:
        typer.echo(f"{plural(done.left, noun)} of the whole not converted yet; when all are, finish with")
    else:
        typer.echo(f"all {noun}s of the whole are converted; finish with")
    typer.echo("unidrive finalise SRC DST and the same options")
