"""`unidrive measure`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from unidrive_cli.cli.progress import Progress
from unidrive_cli.cli.shared import (
    BLEND,
    CONFIG,
    DEBUG,
    DEPTH_LIMIT,
    EGO_MOTION,
    GROUND_HEIGHT,
    JOBS,
    JSON,
    RIG_HELP,
    SCENES,
    VERSION,
    guarded,
    jobs_of,
    option,
    plural,
    say_table,
    warp_choices,
)
from unidrive_cli.errors import UsageError
from unidrive_cli.warp.choices import Blend

if TYPE_CHECKING:
    from unidrive_cli.measure.fidelity import Tally
    from unidrive_cli.measure.truth import Fidelity, TruthReport

_ONLY_WITH_RIG = ("depth_limit", "ground_height", "blend", "ego_motion")


@guarded
def measure_command(
    context: typer.Context,
    dataset: Path = typer.Argument(
        ..., metavar="CONVERTED_OR_SRC", help="A dataset that convert has written; with --rig, one to render."
    ),
    truth: Path | None = option(
        None,
        "--truth",
        help="The same drive rendered directly through the virtual rig, all cameras at once.",
        show_default=False,
    ),
    rig: str | None = option(None, "--rig", help=f"{RIG_HELP} SRC is rendered through it.", show_default=False),
    source: Path | None = option(
        None, "--source", help="The dataset that CONVERTED was made from; seams need it.", show_default=False
    ),
    version: str | None = VERSION,
    scene: list[str] = SCENES,
    depth_limit: float | None = DEPTH_LIMIT,
    ground_height: float | None = GROUND_HEIGHT,
    blend: Blend = BLEND,
    ego_motion: bool = EGO_MOTION,
    jobs: int | None = JOBS,
    as_json: bool = JSON,
    config: Path | None = CONFIG,
    debug: bool = DEBUG,
) -> None:
    """Compare virtual pictures with the truth: the same drive rendered directly through the virtual rig.

    Measures the pictures of a converted dataset, or, with --rig, those that SRC gives through that rig.
    """
    from unidrive_cli.measure.truth import measure_converted, measure_rendered
    from unidrive_cli.tables.dataset import open_dataset
    from unidrive_cli.tables.rig_of_dataset import open_named, resolve_rig
    from unidrive_cli.warp.pictures import size_of_file

    if truth is None:
        raise UsageError(
            "this version of measure compares with a truth.",
            hint="Give --truth TRUTH: the same drive rendered directly through the virtual rig.",
        )
    with Progress("samples", sys.stderr) as progress:
        if rig is None:
            _refuse_choices(context)
            report = measure_converted(
                open_dataset(dataset, version),
                open_named(truth),
                source=None if source is None else open_named(source),
                scenes=tuple(scene),
                jobs=jobs_of(jobs),
                progress=progress,
            )
        else:
            if source is not None:
                raise UsageError("--source belongs to a converted dataset; with --rig the source is SRC itself.")
            virtual_rig, notes = resolve_rig(rig, size_of_file=size_of_file)
            report = measure_rendered(
                open_dataset(dataset, version),
                virtual_rig,
                warp_choices(virtual_rig, depth_limit, ground_height, blend, ego_motion),
                open_named(truth),
                scenes=tuple(scene),
                jobs=jobs_of(jobs),
                progress=progress,
            )
            report.notes.extend(notes)
    if as_json:
        typer.echo(json.dumps(report.document()))
    else:
        _say(report)


def _refuse_choices(context: typer.Context) -> None:
    """Options of the warp that are given with a converted dataset, whose pictures are what they are."""
    for name in _ONLY_WITH_RIG:
        given = context.get_parameter_source(name)
        if given is not None and given.name == "COMMANDLINE":
            raise UsageError(
                f"--{name.replace('_', '-')} goes with --rig; a converted dataset has its pictures already.",
                hint="Give --rig RIG to render SRC here and now.",
            )


def _say(report: TruthReport) -> None:
    typer.echo(
        f"{plural(report.samples, 'sample')} compared with the truth; "
        f"{report.overall.covered:.1%} of the pixels are covered"
    )
    columns = ("overall", "ground", "objects", "seams")
    header = ("camera", *(cell for name in columns for cell in (f"{name} dB", "SSIM")))
    lines = {**report.by_camera, "all": report.overall}
    say_table(header, [_row(name, fidelity, columns) for name, fidelity in lines.items()], left=1)
    for note in report.notes:
        typer.echo(f"note: {note}")


def _row(name: str, fidelity: Fidelity, columns: tuple[str, ...]) -> tuple[str, ...]:
    cells = (cell for column in columns for cell in _cells(fidelity.tallies.get(column)))
    return (name, *cells)


def _cells(tally: Tally | None) -> tuple[str, str]:
    if tally is None or tally.psnr_db is None or tally.ssim is None:
        return "-", "-"
    return f"{tally.psnr_db:.2f}", f"{tally.ssim:.4f}"
