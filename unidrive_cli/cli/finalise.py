"""`unidrive finalise`."""

from __future__ import annotations

from pathlib import Path

import typer

from unidrive_cli.cli.convert import (
    CODEC,
    KEEP_LAYOUT,
    KERNEL,
    LINK,
    LOW_COVERAGE,
    MASKS,
    MIN_COVERAGE,
    ON_ERROR,
    OUTPUT_VERSION,
    QUALITY,
    SWEEPS,
    UNSEEN_BOXES,
    VERIFY,
    VISIBILITY,
    planned,
    say_summary,
)
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
    option,
)
from unidrive_cli.convert.options import Link, LowCoverage, Masks, OnError, UnseenBoxes, VerifyLevel, VisibilityRule
from unidrive_cli.warp.choices import Blend, Codec, ExposureChoice, Kernel


@guarded
def finalise_command(
    src: Path = typer.Argument(..., metavar="SRC", help="Dataset: the folder that holds v1.0-*."),
    dst: Path = typer.Argument(..., metavar="DST", help="Where the parts put the converted samples."),
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
    on_error: OnError = ON_ERROR,
    verify: VerifyLevel = VERIFY,
    kernel: Kernel = KERNEL,
    codec: Codec = CODEC,
    jobs: int | None = option(None, "--jobs", hidden=True, help="No effect: --config may be that of `convert`."),
    backend: str = option("", "--backend", hidden=True, help="No effect, as --jobs."),
    scheduler: str = option("", "--scheduler", hidden=True, help="No effect, as --jobs."),
    space_check: bool = option(True, "--space-check/--no-space-check", hidden=True, help="No effect, as --jobs."),
    as_json: bool = JSON,
    config: Path | None = CONFIG,
    debug: bool = DEBUG,
) -> None:
    """Complete a conversion whose parts (`convert --part`) are all done, with the same options."""
    from unidrive_cli.convert.run import finalise_parts

    plan = planned(
        src,
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
    )
    say_summary(finalise_parts(plan, dst), plan, dst, as_json)
