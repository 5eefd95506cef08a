"""`unidrive finalise`."""

from __future__ import annotations

from pathlib import Path

import typer

from unidrive_cli.cli.conversion import OutputOptions, SelectionOptions, planned, say_summary
from unidrive_cli.cli.shared import CONFIG, DEBUG, JSON, RIG_HELP, SOURCE, WarpOptions, grouped, guarded, option


@guarded
@grouped
def finalise_command(
    src: Path = SOURCE,
    dst: Path = typer.Argument(..., metavar="DST", help="Where the parts put the converted samples."),
    rig: str = option(..., "--rig", help=RIG_HELP),
    *,
    selection: SelectionOptions,
    warp: WarpOptions,
    chosen: OutputOptions,
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

    plan = planned(src, dst, rig, selection, warp, chosen)
    say_summary(finalise_parts(plan, dst), plan, dst, as_json)
