"""`unidrive inspect-rig`."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from unidrive_cli.cli.shared import (
    COMMON_SWEEP,
    CONFIG,
    DEBUG,
    DEPTH_LIMIT,
    GROUND_HEIGHT,
    JSON,
    LAYOUT,
    LENSES,
    SCENES,
    VERSION,
    guarded,
    option,
    say_layout,
    say_table,
    warp_choices,
)
from unidrive_cli.errors import UsageError

if TYPE_CHECKING:
    from unidrive_cli.rig.inspection import RigFacts
    from unidrive_cli.rig.model import Rig
    from unidrive_cli.warp.common import Fill


@guarded
def inspect_rig_command(
    rig: str = typer.Argument(
        ..., metavar="RIG_OR_DATASET", help="A rig file, a shipped rig's name, a dataset folder, or a fleet file."
    ),
    against: list[str] = option(
        [],
        "--against",
        help="A real rig or dataset: how much of each camera it fills (repeatable).",
        show_default=False,
    ),
    depth_limit: float | None = DEPTH_LIMIT,
    ground_height: float | None = GROUND_HEIGHT,
    common_sweep: float | None = COMMON_SWEEP,
    version: str | None = VERSION,
    layout: str | None = LAYOUT,
    scene: list[str] = SCENES,
    lenses: Path | None = LENSES,
    as_json: bool = JSON,
    config: Path | None = CONFIG,
    debug: bool = DEBUG,
) -> None:
    """Show a rig's cameras, and what they see of the circle round the car.

    Of a fleet: the virtual rig, how much of each virtual camera each car fills, and what they have in common.
    """
    from unidrive_cli.rig.inspection import inspect_rig
    from unidrive_cli.tables.lenses import read_lenses
    from unidrive_cli.tables.rig_of_dataset import dataset_meant, resolve_fleet, resolve_rig, rig_of_dataset
    from unidrive_cli.warp.common import DEFAULT_SWEEP_M, fill
    from unidrive_cli.warp.pictures import size_of_file
    from unidrive_cli.warp.remap import virtual_views

    given = None if lenses is None else read_lenses(lenses)
    datasets = sum(os.path.isdir(name) for name in (rig, *against))  # noqa: PTH112 (a name may be too long for Path)
    if given and datasets != 1:
        raise UsageError(f"--lenses are those of one dataset; {datasets} are named.")
    rigs: list[Rig] = []
    if dataset := dataset_meant(rig, version, layout, given):
        say_layout(dataset.layout, dataset.folder, layout)
        found, notes = rig_of_dataset(dataset, tuple(scene), size_of_file)
    else:
        fleet, notes = resolve_fleet(rig, size_of_file)
        found, rigs = fleet.virtual, list(fleet.sources)
    for name in against:
        real, more = resolve_rig(name, size_of_file=size_of_file, lenses=given)
        rigs.append(real)
        notes.extend(more)
    facts = inspect_rig(found)
    shares: Fill | None = None
    if rigs:
        choices = warp_choices(found, depth_limit, ground_height)
        views = virtual_views(found, choices.depth_limit_m, choices.ground_height_m)
        shares = fill(views, rigs, DEFAULT_SWEEP_M if common_sweep is None else common_sweep)
    if as_json:
        filled = {} if shares is None else {"filled": _fill_document(found, rigs, shares)}
        typer.echo(json.dumps({**asdict(facts), **filled, "notes": notes}))
        return
    _say(facts)
    if shares:
        _say_fill(found, rigs, shares)
    for note in notes:
        typer.echo(f"note: {note}")


def _fill_document(virtual: Rig, rigs: Sequence[Rig], shares: Fill) -> dict[str, Any]:
    by_camera = {
        channel: {"by_rig": list(row), "common": common}
        for channel, row, common in zip(virtual.channels, shares.by_rig, shares.common, strict=True)
    }
    return {"rigs": [rig.name for rig in rigs], "common_sweep_m": shares.sweep_m, "by_camera": by_camera}


def _say_fill(virtual: Rig, rigs: Sequence[Rig], shares: Fill) -> None:
    typer.echo("\nhow much of each virtual picture is filled, by the cameras at their places")
    header = ("channel", *(rig.name for rig in rigs), "common")
    rows = [
        (channel, *(f"{share:.1%}" for share in row), f"{common:.1%}")
        for channel, row, common in zip(virtual.channels, shares.by_rig, shares.common, strict=True)
    ]
    say_table(header, rows, left=1)
    typer.echo(
        f"common: by all of them, wherever a camera stood within the last {shares.sweep_m:g} m before the moment"
    )


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
