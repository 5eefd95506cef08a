"""`unidrive convert`."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from unidrive_cli.cli.progress import Progress
from unidrive_cli.cli.shared import (
    ANTI_ALIAS,
    BLEND,
    CAMERAS,
    COMMON_SWEEP,
    COMMON_WITH,
    CONFIG,
    DEBUG,
    DEPTH_LIMIT,
    EGO_MOTION,
    EXPOSURE,
    GROUND_HEIGHT,
    JOBS,
    JSON,
    LAYOUT,
    LENSES,
    MAX_SAMPLES,
    RIG_HELP,
    SCENES,
    SOURCE_MASK,
    SPLITS,
    VERSION,
    guarded,
    human_bytes,
    jobs_of,
    option,
    plural,
    say_layout,
    warp_choices,
)
from unidrive_cli.convert.options import (
    Backend,
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
from unidrive_cli.warp.choices import Blend, Codec, ExposureChoice, Kernel

if TYPE_CHECKING:
    from unidrive_cli.convert.finalise import Failure, Summary
    from unidrive_cli.convert.parts import Part
    from unidrive_cli.convert.plan import Plan
    from unidrive_cli.convert.run import PartSummary


QUALITY = option(95, "--quality", help="JPEG quality, 1 to 100.")
SWEEPS = option(
    False,
    "--sweeps/--no-sweeps",
    help="Render the pictures between the key frames too, those taken together as one.",
)
MASKS = option("frame", "--masks", help="Coverage masks: one per picture, one per camera, or none.")
VISIBILITY = option("lower", "--visibility", help="Lower a box's visibility where the virtual rig shows less of it.")
UNSEEN_BOXES = option("keep", "--unseen-boxes", help="Boxes that no virtual pixel shows.")
KEEP_LAYOUT = option(
    False, "--keep-layout", help="Write the source's own layout instead of nuScenes', where that is possible (T4)."
)
OUTPUT_VERSION = option(
    "",
    "--output-version",
    help="Version folder of the output (default: the source's; of other layouts than nuScenes' v1.0-trainval, "
    "v1.0-mini or v1.0-test).",
    show_default=False,
)
MIN_COVERAGE = option(
    0.0, "--min-coverage", help="Least share (0 to 1) of a virtual picture that the source's cameras see."
)
LOW_COVERAGE = option(
    "drop-camera",
    "--low-coverage",
    help="Below that: drop virtual cameras (by their mean over all samples) or single pictures, or keep and report.",
)
LINK = option(
    "hardlink", "--link", help="How unchanged files come into DST; links share SRC's data: treat as read-only."
)
ON_ERROR = option("stop", "--on-error", help="At a broken picture: stop, or leave its sample out.")
KERNEL = option("auto", "--kernel", help="What warps: the fused kernel (numba), or OpenCV.")
CODEC = option("auto", "--codec", help="What decodes and encodes for the kernel numba.")
VERIFY = option(
    "sample",
    "--verify",
    help="Decode a sample of the pictures at the end (and open 20 scenes with the devkit), or all.",
)


@guarded
def convert_command(
    src: Path = typer.Argument(..., metavar="SRC", help="Dataset: the folder that holds v1.0-*."),
    dst: Path = typer.Argument(..., metavar="DST", help="Where the converted dataset goes."),
    rig: str = option(..., "--rig", help=RIG_HELP),
    version: str | None = VERSION,
    layout: str | None = LAYOUT,
    scene: list[str] = SCENES,
    split: list[str] = SPLITS,
    max_samples: int | None = MAX_SAMPLES,
    camera: list[str] = CAMERAS,
    lenses: Path | None = LENSES,
    depth_limit: float | None = DEPTH_LIMIT,
    ground_height: float | None = GROUND_HEIGHT,
    blend: Blend = BLEND,
    ego_motion: bool = EGO_MOTION,
    anti_alias: bool = ANTI_ALIAS,
    exposure: ExposureChoice = EXPOSURE,
    source_mask: Path | None = SOURCE_MASK,
    common_with: list[str] = COMMON_WITH,
    common_sweep: float | None = COMMON_SWEEP,
    quality: int = QUALITY,
    sweeps: bool = SWEEPS,
    masks: Masks = MASKS,
    visibility: VisibilityRule = VISIBILITY,
    unseen_boxes: UnseenBoxes = UNSEEN_BOXES,
    min_coverage: float = MIN_COVERAGE,
    low_coverage: LowCoverage = LOW_COVERAGE,
    link: Link = LINK,
    keep_layout: bool = KEEP_LAYOUT,
    output_version: str = OUTPUT_VERSION,
    jobs: int | None = JOBS,
    backend: Backend = option(
        "processes", "--backend", help="Processes on this machine, or a Dask cluster's workers."
    ),
    scheduler: str = option("", "--scheduler", help="Address of the Dask scheduler, with --backend dask."),
    part: str | None = option(
        None, "--part", help="Only the i-th of n shares, as i/n; `finalise` follows when all are done."
    ),
    on_error: OnError = ON_ERROR,
    verify: VerifyLevel = VERIFY,
    kernel: Kernel = KERNEL,
    codec: Codec = CODEC,
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
        (version, layout, lenses),
        (depth_limit, ground_height, blend, ego_motion, anti_alias, exposure),
        (common_with, common_sweep),
        quality=quality,
        scenes=tuple(sorted(set(scene))),
        splits=tuple(sorted(set(split))),
        max_samples=max_samples,
        cameras=tuple(sorted(set(camera))),
        sweeps=sweeps,
        source_mask="" if source_mask is None else str(source_mask),
        masks=masks,
        visibility=visibility,
        unseen_boxes=unseen_boxes,
        min_coverage=min_coverage,
        low_coverage=low_coverage,
        link=link,
        keep_layout=keep_layout,
        output_version=output_version,
        on_error=on_error,
        verify=verify,
        kernel=kernel,
        codec=codec,
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


def planned(
    src: Path,
    dst: Path,
    rig: str,
    source: tuple[str | None, str | None, Path | None],
    warp: tuple[float | None, float | None, Blend, bool, bool, ExposureChoice],
    common_with: tuple[list[str], float | None],
    **chosen: Any,
) -> Plan:
    """The plan of a conversion, from a command's options; what was found out about the rig goes to stderr.

    Args:
        source: version, layout and file of lenses of SRC, as given.
        warp: depth limit, ground height, blend, ego motion, anti-aliasing, exposure, as given.
        common_with: rigs that must fill what is shown, and the sweep, as given.
        chosen: the other `Options`.
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
    options = Options(**asdict(warp_choices(fleet.virtual, *warp)), **chosen)
    check_apart(src, dst)
    rigs = list(fleet.sources) if fleet.common else []
    for name in common_with[0]:
        found, more = resolve_rig(name, size_of_file=size_of_file)
        rigs.append(found)
        rig_notes.extend(more)
    sweep_m = common_with[1]
    if sweep_m is not None and not rigs:
        raise UsageError("--common-sweep goes with --common-with, or with a fleet file that names `common`.")
    common = Common(tuple(rigs), DEFAULT_SWEEP_M if sweep_m is None else sweep_m) if rigs else None
    version, layout, lenses = source
    dataset = open_dataset(src, version, layout=layout, lenses=read_lenses(lenses) if lenses else None)
    say_layout(dataset.layout, dataset.folder, layout)
    prepare_workers(options)
    plan = make_plan(dataset, fleet.virtual, options, common)
    for note in rig_notes:
        typer.echo(f"note: {note}", err=True)
    return plan


def leave_out(failures: Sequence[Failure]) -> None:
    """Says which samples were left out; that is exit code 1."""
    for failure in failures:
        typer.echo(f"left out: {failure.unit}: {failure.sentence}", err=True)
    if failures:
        raise typer.Exit(1)


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
        f"{plural(scenes, 'scene')}{_and_sweeps(len(plan.sweeps))}"
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
        typer.echo("that is more than is free: the conversion will refuse to start (--no-space-check)")
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


def _and_sweeps(count: int) -> str:
    return f" and {plural(count, 'sweep')}" if count else ""


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
        f"{dst}: {plural(counts.samples, 'sample')}{_and_sweeps(counts.sweeps)}, "
        f"{plural(counts.pictures, 'picture')} ({human_bytes(summary.picture_bytes)}), "
        f"{plural(counts.annotations, 'annotation')}, "
        f"{counts.boxes_2d:,} 2D {'box' if counts.boxes_2d == 1 else 'boxes'}"
    )
    covered = ", ".join(f"{channel} {share:.0%}" for channel, share in summary.covered.items())
    typer.echo(f"covered: {covered}")
    if counts.visibility_lowered:
        typer.echo(f"visibility lowered for {counts.visibility_lowered:,} of {counts.annotations:,} annotations")
    if counts.boxes_unseen:
        fate = "kept" if not counts.boxes_dropped else "left out"
        unwitnessed = f"no source camera saw {counts.boxes_unwitnessed:,} of all"
        typer.echo(f"{plural(counts.boxes_unseen, 'annotation')} shown by no virtual pixel, {fate}; {unwitnessed}")
    for note in summary.notes:
        typer.echo(f"note: {note}")
    if summary.verified:
        verified = summary.verified
        typer.echo(
            f"verified: nuscenes-devkit opens it; {verified.pictures_decoded:,} of "
            f"{plural(verified.pictures_present, 'picture')} decoded"
        )
