"""The `unidrive` program."""

from __future__ import annotations

import typer

from unidrive_cli import __version__
from unidrive_cli.cli.convert import convert_command
from unidrive_cli.cli.doctor import doctor_command
from unidrive_cli.cli.finalise import finalise_command
from unidrive_cli.cli.inspect_rig import inspect_rig_command
from unidrive_cli.cli.measure import measure_command
from unidrive_cli.cli.merge import merge_command
from unidrive_cli.cli.optimize_rig import optimize_rig_command
from unidrive_cli.cli.synth import synth_command
from unidrive_cli.cli.validate import validate_command

app = typer.Typer(
    name="unidrive",
    help="Convert nuScenes-format datasets to one shared virtual camera rig.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"unidrive {__version__}")
        raise typer.Exit


@app.callback()
def _program(
    version: bool = typer.Option(False, "--version", callback=_version, is_eager=True, help="Print the version."),
) -> None:
    """Convert nuScenes-format datasets to one shared virtual camera rig."""


app.command("convert")(convert_command)
app.command("finalise")(finalise_command)
app.command("inspect-rig")(inspect_rig_command)
app.command("measure")(measure_command)
app.command("merge")(merge_command)
app.command("optimize-rig")(optimize_rig_command)
app.command("synth")(synth_command)
app.command("validate")(validate_command)
app.command("doctor")(doctor_command)
