"""`unidrive measure`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from unidrive_cli.cli.progress import Progress
from unidrive_cli.cli.shared import (
    CONFIG,
    DEBUG,
    JOBS,
    JSON,
    RIG_HELP,
    SourceOptions,
    WarpOptions,
    grouped,
    guarded,
    jobs_of,
    option,
    plural,
    say_layout,
    say_table,
)
from unidrive_cli.errors import OutputError, UnidriveError, UsageError

if TYPE_CHECKING:
    from unidrive_cli.measure.fidelity import Tally
    from unidrive_cli.measure.projection import Errors, ProjectionReport, Spread
    from unidrive_cli.measure.truth import Fidelity, TruthReport

_ONLY_WITH_RIG = ("depth_limit", "ground_height", "blend", "ego_motion", "anti_alias", "exposure", "camera", "png")
_NAME_WIDTH = 34


@guarded
@grouped
def measure_command(
    context: typer.Context,
    datasets: list[Path] = typer.Argument(
        ...,
        metavar="SRC...",
        readable=False,
        help="With --rig the datasets to measure; else one that convert has written.",
    ),
    *,
    rig: str | None = option(None, "--rig", help=RIG_HELP, show_default=False),
    truth: Path | None = option(
        None,
        "--truth",
        help="Compare pictures too: the same drive rendered directly through the virtual rig, all cameras at once.",
        show_default=False,
    ),
    source: Path | None = option(
        None, "--source", help="The dataset that CONVERTED was made from; seams need it.", show_default=False
    ),
    selection: SourceOptions,
    warp: WarpOptions,
    png: Path | None = option(
        None, "--png", help="Draw the projection error there: from above, and by distance.", show_default=False
    ),
    jobs: int | None = JOBS,
    as_json: bool = JSON,
    config: Path | None = CONFIG,
    debug: bool = DEBUG,
) -> None:
    """Measure how far the corners of SRC's 3D boxes lie from where the virtual pictures of RIG show them.

    With --truth pictures are compared too: those of a converted dataset, or, with --rig, those that SRC gives
    through RIG, with the same drive rendered directly through it.
    """
    from unidrive_cli.measure.projection import measure_projection
    from unidrive_cli.measure.truth import measure_converted, measure_rendered
    from unidrive_cli.tables.dataset import open_dataset
    from unidrive_cli.tables.lenses import read_lenses
    from unidrive_cli.tables.rig_of_dataset import open_named, resolve_fleet
    from unidrive_cli.warp.pictures import size_of_file

    if truth is not None and len(datasets) > 1:
        raise UsageError(f"--truth compares the pictures of one dataset; {len(datasets)} are given.")
    if rig is None:
        if truth is None:
            raise UsageError(
                "--rig or --truth is needed.",
                hint="Give --rig RIG for the projection error of SRC, or --truth TRUTH for a converted dataset.",
            )
        _refuse_choices(context)
        if selection.lenses is not None and source is None:
            raise UsageError("--lenses are SRC's: without --rig they go with --source.")
    elif source is not None:
        raise UsageError("--source belongs to a converted dataset; with --rig the source is SRC itself.")
    elif truth is None and (given := _on_the_command_line(context) & {"blend", "anti_alias", "exposure"}):
        name = min(given).replace("_", "-")
        raise UsageError(f"--{name} goes with --truth; the projection error is that of the angular blend.")
    if selection.lenses is not None and len(datasets) > 1:
        raise UsageError(f"--lenses are those of one dataset; {len(datasets)} are given.")
    of_source = None if selection.lenses is None else read_lenses(selection.lenses)
    compared: TruthReport | None = None
    projected: ProjectionReport | None = None
    notes: list[str] = []
    workers = jobs_of(jobs)
    if rig is None and truth is not None:
        with Progress("samples", sys.stderr) as progress:
            compared = measure_converted(
                open_dataset(datasets[0], selection.version),
                open_named(truth),
                source=None if source is None else open_named(source, lenses=of_source),
                scenes=tuple(selection.scene),
                jobs=workers,
                progress=progress,
            )
    if rig is not None:
        fleet, notes = resolve_fleet(rig, size_of_file)
        virtual_rig = fleet.virtual
        choices = warp.choices(virtual_rig)
        alone = len(datasets) == 1
        open_one = open_dataset if alone else open_named
        opened = [open_one(one, selection.version, layout=selection.layout, lenses=of_source) for one in datasets]
        for dataset in opened:
            say_layout(dataset.layout, dataset.folder, selection.layout)
        if truth is not None:
            with Progress("samples", sys.stderr) as progress:
                compared = measure_rendered(
                    opened[0],
                    virtual_rig,
                    choices,
                    open_named(truth),
                    scenes=tuple(selection.scene),
                    cameras=tuple(selection.camera),
                    jobs=workers,
                    progress=progress,
                )
        try:
            with Progress("samples", sys.stderr) as progress:
                projected = measure_projection(
                    opened,
                    virtual_rig,
                    choices,
                    scenes=selection.scene,
                    cameras=selection.camera,
                    jobs=workers,
                    progress=progress,
                )
        except UnidriveError as error:
            if compared is None or png is not None:
                raise
            notes.append(f"The projection error is not measured: {error.sentence}")
    if projected is not None and png is not None:
        _draw(projected, png)
    _tell(projected, compared, as_json=as_json, notes=notes)


def _draw(report: ProjectionReport, png: Path) -> None:
    from unidrive_cli.report.projection_picture import draw_projection

    try:
        draw_projection(report, png)
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}.", where=str(png)) from error


def _on_the_command_line(context: typer.Context) -> set[str]:
    sources = {name: context.get_parameter_source(name) for name in context.params}
    return {name for name, where in sources.items() if where is not None and where.name == "COMMANDLINE"}


def _refuse_choices(context: typer.Context) -> None:
    """Options that are given with a converted dataset, whose pictures are what they are."""
    given = _on_the_command_line(context)
    for name in _ONLY_WITH_RIG:
        if name in given:
            raise UsageError(
                f"--{name.replace('_', '-')} goes with --rig; a converted dataset has its pictures already.",
                hint="Give --rig RIG to measure SRC here and now.",
            )


def _tell(
    projected: ProjectionReport | None, compared: TruthReport | None, *, as_json: bool, notes: Sequence[str] = ()
) -> None:
    reports = [report for report in (compared, projected) if report is not None]
    all_notes = list(dict.fromkeys([*(note for report in reports for note in report.notes), *notes]))
    if as_json:
        both = {key: value for report in reports for key, value in report.document().items()}
        typer.echo(json.dumps({**both, "notes": all_notes}))
        return
    if projected is not None:
        _say_projection(projected)
    if projected is not None and compared is not None:
        typer.echo("")
    if compared is not None:
        _say_truth(compared)
    for note in all_notes:
        typer.echo(f"note: {note}")


def _say_projection(report: ProjectionReport) -> None:
    found, share = report.overall, report.overall.uncovered
    typer.echo(
        f"{plural(report.samples, 'sample')}, {plural(report.boxes, 'annotation')}; {report.rig.name}, depth limit "
        f"{report.choices.depth_limit_m:g} m; errors in metre-radians, {found.pairs.sum:,.1f} in all"
    )
    if share is not None:
        typer.echo(
            f"{plural(share.of, 'corner')} seen by a source, {share.count:,} of those "
            f"({share.count / share.of:.1%}) by no virtual camera; {plural(found.behind or 0, 'pair')} behind it"
        )
    header = ("", "pairs", "mean", "median", "p90", "blended", "mean", "median", "p90")
    say_table(header, list(_projection_rows(report)), left=1)


def _projection_rows(report: ProjectionReport) -> Iterator[tuple[str, ...]]:
    from unidrive_cli.measure.projection import distance_bands

    bands = {
        f"{low} to {high} m" if high else f"{low} m and beyond": errors
        for (low, high), errors in zip(distance_bands(), report.by_distance, strict=True)
    }
    groups = (
        ("virtual camera", report.by_camera),
        ("source", report.by_source),
        ("class", report.by_class),
        ("distance", bands),
        ("dataset", report.by_dataset if len(report.by_dataset) > 1 else {}),
    )
    yield _errors_row("all", report.overall)
    for title, group in groups:
        if group:
            yield (title, *[""] * 8)
        yield from (_errors_row(f"  {name}", errors) for name, errors in group.items())


def _errors_row(name: str, errors: Errors) -> tuple[str, ...]:
    if len(name) > _NAME_WIDTH:
        name = "  ..." + name[5 - _NAME_WIDTH :]
    pairs = errors.pairs
    return name, f"{pairs.count:,}", *_spread(pairs), *_blended(errors.blended)


def _blended(spread: Spread | None) -> tuple[str, ...]:
    return ("", "", "", "") if spread is None else (f"{spread.count:,}", *_spread(spread))


def _spread(spread: Spread) -> tuple[str, ...]:
    return tuple("-" if number is None else f"{number:.4f}" for number in (spread.mean, spread.median, spread.p90))


def _say_truth(report: TruthReport) -> None:
    typer.echo(
        f"{plural(report.samples, 'sample')} compared with the truth; "
        f"{report.overall.covered:.1%} of the pixels are covered"
    )
    columns = ("overall", "ground", "objects", "seams")
    header = ("camera", *(cell for name in columns for cell in (f"{name} dB", "SSIM")))
    lines = {**report.by_camera, "all": report.overall}
    say_table(header, [_row(name, fidelity, columns) for name, fidelity in lines.items()], left=1)


def _row(name: str, fidelity: Fidelity, columns: tuple[str, ...]) -> tuple[str, ...]:
    cells = (cell for column in columns for cell in _cells(fidelity.tallies.get(column)))
    return (name, *cells)


def _cells(tally: Tally | None) -> tuple[str, str]:
    if tally is None or tally.psnr_db is None or tally.ssim is None:
        return "-", "-"
    return f"{tally.psnr_db:.2f}", f"{tally.ssim:.4f}"
