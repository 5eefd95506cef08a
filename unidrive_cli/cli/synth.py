"""`unidrive synth`."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, replace
from pathlib import Path

import typer

from unidrive_cli.cli.progress import Progress
from unidrive_cli.cli.shared import CONFIG, DEBUG, JOBS, JSON, guarded, jobs_of, option, plural
from unidrive_cli.synth.options import Firing, RendererChoice, SynthOptions, Version


@guarded
def synth_command(
    dst: Path = typer.Argument(..., metavar="DST", help="Where the drive goes."),
    rig: list[str] = option(
        ..., "--rig", help="A rig file, a shipped rig's name, or a dataset folder. Several: DST/<name> each."
    ),
    seed: int = option(0, "--seed", help="Another seed, another drive."),
    scenes: int = option(1, "--scenes", help="How many scenes."),
    keyframes: int = option(40, "--keyframes", help="Key frames per scene, at 2 Hz."),
    version: Version = option("v1.0-trainval", "--version", help="Name of the version folder."),
    val_share: float = option(0.2, "--val-share", help="Share of the scenes named as nuScenes' validation scenes."),
    firing: Firing = option(
        "nuscenes", "--firing", help="When cameras fire: as the turning lidar passes them, or all at its time."
    ),
    sweeps: bool = option(False, "--sweeps/--no-sweeps", help="Pictures at 12 Hz and clouds at 20 Hz as well."),
    slope: float = option(0.0, "--slope", help="Steepest rise of the streets, in percent; 0 is flat."),
    ego_tilt: float = option(0.0, "--ego-tilt", help="Degrees by which the car's body pitches and rolls."),
    instances: bool = option(False, "--instances/--no-instances", help="Write instance pictures."),
    depth: bool = option(False, "--depth/--no-depth", help="Write depth pictures (metres times 256)."),
    quality: int = option(95, "--quality", help="JPEG quality, 1 to 100."),
    samples_per_pixel: int | None = option(
        None, "--samples-per-pixel", help="1, 4 or 16; 4 with GL and 1 with rays where not given."
    ),
    renderer: RendererChoice = option(
        "auto", "--renderer", help="GL, rays on the CPU, or GL where it can be had (auto)."
    ),
    jobs: int | None = JOBS,
    space_check: bool = option(
        True, "--space-check/--no-space-check", help="Refuse to start where the estimate exceeds the free space."
    ),
    force: bool = option(False, "--force", help="Replace a DST that holds another synthetic drive."),
    as_json: bool = JSON,
    config: Path | None = CONFIG,
    debug: bool = DEBUG,
) -> None:
    """Render a synthetic drive through one rig or several, as nuScenes-format datasets with exact 3D boxes."""
    from unidrive_cli.synth.run import make_synth_plan, synthesise
    from unidrive_cli.tables.rig_of_dataset import resolve_rig
    from unidrive_cli.warp.pictures import size_of_file

    options = SynthOptions(
        seed=seed,
        scenes=scenes,
        keyframes=keyframes,
        slope_percent=slope,
        ego_tilt_deg=ego_tilt,
        firing=firing,
        sweeps=sweeps,
        quality=quality,
        samples_per_pixel=4 if samples_per_pixel is None else samples_per_pixel,
        instances=instances,
        depth=depth,
        version=version,
        val_share=val_share,
    )
    resolved = [resolve_rig(name, size_of_file=size_of_file) for name in rig]
    for _, notes in resolved:
        for note in notes:
            typer.echo(f"note: {note}", err=True)
    plan = make_synth_plan(options, [found for found, _ in resolved], renderer)
    if samples_per_pixel is None and plan.renderer == "rays":
        plan = replace(plan, options=replace(options, samples_per_pixel=1))
    samples = plural(plan.options.samples_per_pixel, "sample")
    typer.echo(f"renderer: {plan.renderer_name}, {samples} per pixel", err=True)
    with Progress("samples", sys.stderr) as progress:
        summaries = synthesise(
            plan, dst, jobs=jobs_of(jobs), force=force, space_check=space_check, progress=progress
        )
    if as_json:
        typer.echo(json.dumps({"schema_version": 1, "datasets": [asdict(summary) for summary in summaries]}))
        return
    for summary in summaries:
        if summary.already_complete:
            typer.echo(f"{summary.folder} already holds this drive, complete; nothing was changed.")
            continue
        typer.echo(
            f"{summary.folder}: {plural(summary.scenes, 'scene')}, {plural(summary.samples, 'sample')}, "
            f"{plural(summary.pictures, 'picture')}, {plural(summary.annotations, 'annotation')}, "
            f"through {summary.rig}"
        )
        typer.echo(f"verified: nuscenes-devkit opens it and projected boxes into {summary.rig}'s pictures")
