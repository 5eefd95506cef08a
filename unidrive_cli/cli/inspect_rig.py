"""`unidrive inspect-rig`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from unidrive_cli.cli.shared import CONFIG, DEBUG, JSON, SCENES, VERSION, guarded, say_table

if TYPE_CHECKING:
    from unidrive_cli.rig.inspection import RigFacts


@guarded
def inspect_rig_command(
    rig: str = typer.Argument(
        ..., metavar="RIG_OR_DATASET", help="A rig file, a shipped rig's name, or a dataset folder."
    ),
    version: str | None = VERSION,
    scene: list[str] = SCENES,
    as_json: bool = JSON,
    config: Path | None = CONFIG,
    debug: bool = DEBUG,
) -> None:
    """Show a rig's cameras, and what they see of the circle round the car."""
    from unidrive_cli.rig.inspection import inspect_rig
    from unidrive_cli.tables.rig_of_dataset import resolve_rig
    from unidrive_cli.warp.pictures import size_of_file

    found, notes = resolve_rig(rig, version, tuple(scene), size_of_file)
    facts = inspect_rig(found)
    if as_json:
        typer.echo(json.dumps({**asdict(facts), "notes": notes}))
        return
    _say(facts)
    for note in notes:
        typer.echo(f"note: {note}")


def _say(facts: RigFacts) -> None:
    typer.echo(f"{facts.name}: {facts.description}" if facts.description else facts.name)
    distorted = any(camera.lens != "pinhole" for camera in facts.cameras)
    header = ["channel", "size px", "HFOV", "VFOV", "yaw", "pitch", "roll", "x m", "y m", "z m"]
    header += ["lens"] if distorted else []
    rows = [
        (
            camera.channel,
            f"{camera.width_px}x{camera.height_px}",
            *(
                f"{round(angle, 1) + 0.0:.1f}"
                for angle in (
                    camera.hfov_deg,
                    camera.vfov_deg,
                    camera.yaw_deg,
                    camera.pitch_deg,
                    camera.roll_deg,
                )
            ),
            *(f"{round(metres, 2) + 0.0:.2f}" for metres in camera.position_m),
            *([camera.lens] if distorted else []),
        )
        for camera in facts.cameras
    ]
    say_table(header, rows, left=2)
    for camera in facts.cameras:
        if camera.blank_share:
            share = f"{100 * camera.blank_share:.1f} %"
            typer.echo(f"{camera.channel}: {share} of the picture lies beyond the field of its lens model")
    typer.echo(f"\nsees {facts.covered_deg:g} of 360 degrees of the horizon (0 is ahead, 90 is left)")
    for first, second, degrees in facts.overlaps_deg:
        typer.echo(f"overlap  {first} and {second}: {degrees:g} degrees")
    for start, end in facts.blind_arcs_deg:
        typer.echo(f"blind    from {start:g} to {end:g} degrees")
    if facts.depth_limit_m is not None:
        typer.echo(f"depth limit {facts.depth_limit_m:g} m")
    if facts.ground_height_m is not None:
        typer.echo(f"ground height {facts.ground_height_m:g} m")
