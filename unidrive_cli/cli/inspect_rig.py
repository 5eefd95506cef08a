"""`unidrive inspect-rig`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from unidrive_cli.cli.shared import CONFIG, DEBUG, JSON, SCENES, guarded

if TYPE_CHECKING:
    from unidrive_cli.rig.inspection import RigFacts


@guarded
def inspect_rig_command(
    rig: str = typer.Argument(
        ..., metavar="RIG_OR_DATASET", help="A rig file, a shipped rig's name, or a dataset folder."
    ),
    version: str | None = typer.Option(
        None, "--version", help="Version folder, where the dataset has several.", show_default=False
    ),
    scene: list[str] = SCENES,
    as_json: bool = JSON,
    config: Path | None = CONFIG,
    debug: bool = DEBUG,
) -> None:
    """Show a rig's cameras, and what they see of the circle round the car."""
    from unidrive_cli.convert.plan import picture_size_of
    from unidrive_cli.rig.inspection import inspect_rig
    from unidrive_cli.tables.rig_of_dataset import resolve_rig

    found, notes = resolve_rig(rig, version, tuple(scene), picture_size_of)
    facts = inspect_rig(found)
    if as_json:
        typer.echo(json.dumps({**asdict(facts), "notes": notes}))
        return
    _say(facts)
    for note in notes:
        typer.echo(f"note: {note}")


def _say(facts: RigFacts) -> None:
    typer.echo(f"{facts.name}: {facts.description}" if facts.description else facts.name)
    header = ("channel", "size px", "HFOV", "VFOV", "yaw", "pitch", "roll", "x m", "y m", "z m")
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
        )
        for camera in facts.cameras
    ]
    widths = [max(len(row[column]) for row in (header, *rows)) for column in range(len(header))]
    for row in (header, *rows):
        first, *rest = (
            cell.ljust(width) if place < 2 else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        typer.echo("  ".join((first, *rest)))
    typer.echo(f"\nsees {facts.covered_deg:g} of 360 degrees of the horizon (0 is ahead, 90 is left)")
    for first, second, degrees in facts.overlaps_deg:
        typer.echo(f"overlap  {first} and {second}: {degrees:g} degrees")
    for start, end in facts.blind_arcs_deg:
        typer.echo(f"blind    from {start:g} to {end:g} degrees")
    if facts.depth_limit_m is not None:
        typer.echo(f"depth limit {facts.depth_limit_m:g} m")
    if facts.ground_height_m is not None:
        typer.echo(f"ground height {facts.ground_height_m:g} m")
