"""`unidrive convert`."""

from __future__ import annotations

import json
import os
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from unidrive_cli.cli.progress import Progress
from unidrive_cli.cli.shared import CONFIG, DEBUG, JSON, SCENES, guarded, human_bytes, plural
from unidrive_cli.convert.options import (
    DEFAULT_DEPTH_LIMIT_M,
    DEFAULT_GROUND_HEIGHT_M,
    Link,
    Masks,
    OnError,
    Options,
    UnseenBoxes,
    VerifyLevel,
    VisibilityRule,
)
from unidrive_cli.warp.choices import Blend

if TYPE_CHECKING:
    from unidrive_cli.convert.finalise import Summary
    from unidrive_cli.convert.plan import Plan


def _option(default: Any, *names: str, help: str, **more: Any) -> Any:
    variable = "UNIDRIVE_" + names[0].split("/")[0].lstrip("-").upper().replace("-", "_")
    return typer.Option(default, *names, help=help, envvar=variable, show_envvar=False, **more)


@guarded
def convert_command(
    src: Path = typer.Argument(..., metavar="SRC", help="Dataset: the folder that holds v1.0-*."),
    dst: Path = typer.Argument(..., metavar="DST", help="Where the converted dataset goes."),
    rig: str = _option(..., "--rig", help="Virtual rig: a rig file, a shipped rig's name, or a dataset folder."),
    version: str | None = _option(
        None, "--version", help="Version folder, where SRC has several.", show_default=False
    ),
    scene: list[str] = SCENES,
    camera: list[str] = _option(
        [], "--camera", help="Use only this source camera (repeatable).", show_default=False
    ),
    depth_limit: float | None = _option(
        None,
        "--depth-limit",
        help="D0: distance in metres of what is not ground (default: the rig's, or 50).",
    ),
    ground_height: float | None = _option(
        None,
        "--ground-height",
        help="Height in metres of the ground in the ego frame (default: the rig's, or 0).",
    ),
    blend: Blend = _option("angular", "--blend", help="How overlapping source pictures are joined."),
    ego_motion: bool = _option(
        True, "--ego-motion/--no-ego-motion", help="Compensate the car's motion between the cameras' moments."
    ),
    quality: int = _option(95, "--quality", help="JPEG quality, 1 to 100."),
    masks: Masks = _option("frame", "--masks", help="Coverage masks: one per picture, one per camera, or none."),
    visibility: VisibilityRule = _option(
        "lower",
        "--visibility",
        help="Lower a box's visibility where the virtual rig shows less of it.",
    ),
    unseen_boxes: UnseenBoxes = _option("keep", "--unseen-boxes", help="Boxes that no virtual pixel shows."),
    link: Link = _option(
        "hardlink",
        "--link",
        help="How unchanged files come into DST; links share SRC's data: treat as read-only.",
    ),
    jobs: int | None = _option(
        None, "--jobs", "-j", help="Worker processes; 0 works in this process (default: one per core)."
    ),
    on_error: OnError = _option("stop", "--on-error", help="At a broken picture: stop, or leave its sample out."),
    verify: VerifyLevel = _option("sample", "--verify", help="Decode a sample of the pictures at the end, or all."),
    dry_run: bool = _option(False, "--dry-run", help="Say what would be done; write nothing."),
    force: bool = _option(False, "--force", help="Replace a DST that holds another conversion of ours."),
    as_json: bool = JSON,
    config: Path | None = CONFIG,
    debug: bool = DEBUG,
) -> None:
    """Render a nuScenes-format dataset through a virtual rig, annotations included.

    Every option can also be given as UNIDRIVE_<OPTION> in the environment, or in the --config file.
    """
    from unidrive_cli.convert.destination import (
        check_apart,
        check_destination,
        free_bytes,
        resolved_destination,
        same_device,
    )
    from unidrive_cli.convert.plan import make_plan, picture_size_of
    from unidrive_cli.convert.run import convert
    from unidrive_cli.tables.dataset import open_dataset
    from unidrive_cli.tables.rig_of_dataset import resolve_rig

    virtual_rig, rig_notes = resolve_rig(rig, size_of=picture_size_of)
    options = Options(
        depth_limit_m=_first(depth_limit, virtual_rig.depth_limit_m, DEFAULT_DEPTH_LIMIT_M),
        ground_height_m=_first(ground_height, virtual_rig.ground_height_m, DEFAULT_GROUND_HEIGHT_M),
        blend=blend,
        ego_motion=ego_motion,
        quality=quality,
        scenes=tuple(sorted(set(scene))),
        cameras=tuple(sorted(set(camera))),
        masks=masks,
        visibility=visibility,
        unseen_boxes=unseen_boxes,
        link=link,
        on_error=on_error,
        verify=verify,
        jobs=(os.cpu_count() or 1) if jobs is None else jobs,
    )
    check_apart(src, dst)
    plan = make_plan(open_dataset(src, version), virtual_rig, options)
    for note in rig_notes:
        typer.echo(f"note: {note}", err=True)
    if dry_run:
        check_destination(resolved_destination(dst), plan.identity, force=force)
        _say_plan(plan, dst, as_json, free=free_bytes(dst), links=same_device(src, dst))
        return
    if options.link == "hardlink" and not same_device(src, dst):
        typer.echo("note: DST is on another file system: files that do not change are copied, not linked", err=True)
    with Progress("samples", sys.stderr) as progress:
        summary = convert(plan, dst, force=force, progress=progress)
    if as_json:
        typer.echo(json.dumps(asdict(summary)))
    else:
        _say_summary(summary, plan, dst)
    if summary.failures:
        for failure in summary.failures:
            typer.echo(f"left out: sample {failure.sample_token}: {failure.sentence}", err=True)
        raise typer.Exit(1)


def _first(*values: float | None) -> float:
    return next(value for value in values if value is not None)


def _say_plan(plan: Plan, dst: Path, as_json: bool, *, free: int, links: bool) -> None:
    estimate = plan.estimated_bytes()
    scenes = len({unit.scene.token for unit in plan.units})
    sources = sum(len(unit.sources) for unit in plan.units)
    annotations = sum(len(plan.dataset.annotations.get(unit.sample.token, [])) for unit in plan.units)
    sizes = sorted({f"{camera.lens.width_px}x{camera.lens.height_px}" for camera in plan.rig.cameras})
    copies = plan.options.link == "copy" or (plan.options.link == "hardlink" and not links)
    document = {
        "samples": len(plan.units),
        "scenes": scenes,
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
    if as_json:
        typer.echo(json.dumps(document))
        return
    typer.echo(
        f"{plan.dataset.folder} -> {dst} through {plan.rig.name}: {plural(len(plan.units), 'sample')} in "
        f"{plural(scenes, 'scene')}"
    )
    typer.echo(f"reads  {plural(sources, 'source picture')}")
    typer.echo(
        f"writes {plural(plan.picture_count, 'picture')} of {', '.join(sizes)} pixels, "
        f"about {human_bytes(estimate)} ({human_bytes(free)} free); {plural(annotations, 'annotation')}"
    )
    if copies:
        why = "" if links else ": DST is on another file system, where links cannot lead"
        typer.echo(f"files that do not change (lidar, radar, maps) are copied{why}; their size is not counted above")
    for note in plan.notes:
        typer.echo(f"note: {note}")
    typer.echo("nothing was written (--dry-run)")


def _say_summary(summary: Summary, plan: Plan, dst: Path) -> None:
    counts = summary.counts
    if summary.already_complete:
        typer.echo(f"{dst} already holds this conversion, complete; it was verified again, and nothing was changed.")
        return
    pictures = counts.samples * len(plan.rig.cameras)
    typer.echo(
        f"{dst}: {plural(counts.samples, 'sample')}, {plural(pictures, 'picture')} "
        f"({human_bytes(summary.picture_bytes)}), {plural(counts.annotations, 'annotation')}, "
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
