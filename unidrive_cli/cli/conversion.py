"""What `convert` and `finalise` share: the options of a conversion, its plan, and what is said at its end."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from unidrive_cli.cli.shared import COMMON_SWEEP, SourceOptions, WarpOptions, human_bytes, option, plural, say_layout
from unidrive_cli.convert.options import (
    Link,
    LowCoverage,
    Masks,
    OnError,
    Options,
    UnseenBoxes,
    VerifyLevel,
    VisibilityRule,
)
from unidrive_cli.errors import UsageError
from unidrive_cli.warp.choices import Codec, Kernel, WarpChoices

if TYPE_CHECKING:
    from unidrive_cli.convert.finalise import Failure, Summary
    from unidrive_cli.convert.plan import Plan


@dataclass(frozen=True)
class SelectionOptions(SourceOptions):
    """Which dataset, and what of it is converted."""

    split: list[str] = option(
        [],
        "--split",
        help="Only scenes of this split: nuScenes' own, or in splits.json (repeatable).",
        show_default=False,
    )
    max_samples: int | None = option(None, "--max-samples", help="Only the first N samples, by scene and time.")


@dataclass(frozen=True)
class OutputOptions:
    """What becomes of a dataset; the names are those of `convert.options.Options` where it has them."""

    source_mask: Path | None = option(
        None,
        "--source-mask",
        help="Folder with a <CHANNEL>.png per source camera: pixels that are not 0 show the own car and are not "
        "used.",
        show_default=False,
    )
    common_with: list[str] = option(
        [], "--common-with", help="Blacken what this rig or dataset cannot fill (repeatable).", show_default=False
    )
    common_sweep: float | None = COMMON_SWEEP
    quality: int = option(95, "--quality", help="JPEG quality, 1 to 100.")
    sweeps: bool = option(
        False,
        "--sweeps/--no-sweeps",
        help="Render the pictures between the key frames too, those taken together as one.",
    )
    masks: Masks = option("frame", "--masks", help="Coverage masks: one per picture, one per camera, or none.")
    visibility: VisibilityRule = option(
        "lower", "--visibility", help="Lower a box's visibility where the virtual rig shows less of it."
    )
    unseen_boxes: UnseenBoxes = option("keep", "--unseen-boxes", help="Boxes that no virtual pixel shows.")
    min_coverage: float = option(
        0.0, "--min-coverage", help="Least share (0 to 1) of a virtual picture that the source's cameras see."
    )
    low_coverage: LowCoverage = option(
        "drop-camera",
        "--low-coverage",
        help="Below that: drop virtual cameras (by their mean over all samples) or single pictures, or keep and "
        "report.",
    )
    link: Link = option(
        "hardlink", "--link", help="How unchanged files come into DST; links share SRC's data: treat as read-only."
    )
    keep_layout: bool = option(
        False,
        "--keep-layout",
        help="Write the source's own layout instead of nuScenes', where that is possible (T4).",
    )
    output_version: str = option(
        "",
        "--output-version",
        help="Version folder of the output (default: the source's; of other layouts than nuScenes' v1.0-trainval, "
        "v1.0-mini or v1.0-test).",
        show_default=False,
    )
    on_error: OnError = option("stop", "--on-error", help="At a broken picture: stop, or leave its sample out.")
    verify: VerifyLevel = option(
        "sample",
        "--verify",
        help="Decode a sample of the pictures at the end (and open 20 scenes with the devkit), or all.",
    )
    kernel: Kernel = option("auto", "--kernel", help="What warps: the fused kernel (numba), or OpenCV.")
    codec: Codec = option("auto", "--codec", help="What decodes and encodes for the kernel numba.")


def planned(
    src: Path,
    dst: Path,
    rig: str,
    selection: SelectionOptions,
    warp: WarpOptions,
    chosen: OutputOptions,
    **how: Any,
) -> Plan:
    """The plan of a conversion, from a command's options; what was found out about the rig goes to stderr.

    Args:
        how: the other `Options`: how the work is done.
    """
    from unidrive_cli.convert.common import Common
    from unidrive_cli.convert.plan import make_plan
    from unidrive_cli.convert.run import prepare_workers
    from unidrive_cli.tables.dataset import open_dataset
    from unidrive_cli.tables.destination import check_apart
    from unidrive_cli.tables.lenses import read_lenses
    from unidrive_cli.tables.rig_of_dataset import resolve_fleet, resolve_rig
    from unidrive_cli.warp.common import DEFAULT_SWEEP_M
    from unidrive_cli.warp.pictures import size_of_file

    fleet, rig_notes = resolve_fleet(rig, size_of_file)
    options = _options(selection, warp.choices(fleet.virtual), chosen, how)
    check_apart(src, dst)
    rigs = list(fleet.sources) if fleet.common else []
    for name in chosen.common_with:
        found, more = resolve_rig(name, size_of_file=size_of_file)
        rigs.append(found)
        rig_notes.extend(more)
    sweep_m = chosen.common_sweep
    if sweep_m is not None and not rigs:
        raise UsageError("--common-sweep goes with --common-with, or with a fleet file that names `common`.")
    common = Common(tuple(rigs), DEFAULT_SWEEP_M if sweep_m is None else sweep_m) if rigs else None
    lenses = read_lenses(selection.lenses) if selection.lenses else None
    dataset = open_dataset(src, selection.version, layout=selection.layout, lenses=lenses)
    say_layout(dataset.layout, dataset.folder, selection.layout)
    prepare_workers(options)
    plan = make_plan(dataset, fleet.virtual, options, common)
    for note in rig_notes:
        typer.echo(f"note: {note}", err=True)
    return plan


def _options(selection: SelectionOptions, warp: WarpChoices, chosen: OutputOptions, how: dict[str, Any]) -> Options:
    shared = {field.name for field in fields(chosen)} & {field.name for field in fields(Options)}
    given = {name: getattr(chosen, name) for name in shared}
    given["source_mask"] = "" if chosen.source_mask is None else str(chosen.source_mask)
    return Options(
        **asdict(warp),
        scenes=tuple(sorted(set(selection.scene))),
        splits=tuple(sorted(set(selection.split))),
        cameras=tuple(sorted(set(selection.camera))),
        max_samples=selection.max_samples,
        **given,
        **how,
    )


def leave_out(failures: Sequence[Failure]) -> None:
    """Says which samples were left out; that is exit code 1."""
    for failure in failures:
        typer.echo(f"left out: {failure.unit}: {failure.sentence}", err=True)
    if failures:
        raise typer.Exit(1)


def say_summary(summary: Summary, plan: Plan, dst: Path, as_json: bool) -> None:
    """Says what a conversion did; samples that were left out are exit code 1."""
    if as_json:
        typer.echo(json.dumps(asdict(summary)))
    else:
        _say_summary(summary, plan, dst)
    leave_out(summary.failures)


def _say_summary(summary: Summary, plan: Plan, dst: Path) -> None:
    counts = summary.counts
    if summary.already_complete:
        typer.echo(f"{dst} already holds this conversion, complete; it was verified again, and nothing was changed.")
        return
    typer.echo(
        f"{dst}: {plural(counts.samples, 'sample')}{and_sweeps(counts.sweeps)}, "
        f"{plural(counts.pictures, 'picture')} ({human_bytes(summary.picture_bytes)}), "
        f"{plural(counts.annotations, 'annotation')}, "
        f"{counts.boxes_2d:,} 2D {'box' if counts.boxes_2d == 1 else 'boxes'}"
    )
    covered = ", ".join(f"{channel} {_percent(share)}" for channel, share in summary.covered.items())
    typer.echo(f"covered: {covered}")
    if counts.visibility_lowered:
        typer.echo(f"visibility lowered for {counts.visibility_lowered:,} of {counts.annotations:,} annotations")
    if counts.boxes_unseen:
        fate = "kept" if not counts.boxes_dropped else "left out"
        unwitnessed = ""
        if counts.boxes_unwitnessed:
            unwitnessed = f"; {counts.boxes_unwitnessed:,} of all were seen by no source camera"
        typer.echo(f"{plural(counts.boxes_unseen, 'annotation')} shown by no virtual pixel, {fate}{unwitnessed}")
    for note in summary.notes:
        typer.echo(f"note: {note}")
    if summary.verified:
        verified = summary.verified
        typer.echo(
            f"verified: nuscenes-devkit opens it; {verified.pictures_decoded:,} of "
            f"{plural(verified.pictures_present, 'picture')} decoded"
        )


def _percent(share: float) -> str:
    """In whole percent, rounded down: what is not whole is not called so."""
    return f"{math.floor(100 * share + 1e-6)}%"


def and_sweeps(count: int) -> str:
    return f" and {plural(count, 'sweep')}" if count else ""
