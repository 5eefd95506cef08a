"""What the commands share: options, the config file, errors and exit codes."""

from __future__ import annotations

import functools
import inspect
import os
import shlex
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_type_hints

import typer

from unidrive_cli.errors import OutputError, UnidriveError, UsageError, did_you_mean
from unidrive_cli.warp.choices import (
    DEFAULT_DEPTH_LIMIT_M,
    DEFAULT_GROUND_HEIGHT_M,
    Blend,
    ExposureChoice,
    WarpChoices,
)

if TYPE_CHECKING:
    from unidrive_cli.rig.model import Rig
    from unidrive_cli.tables.layouts.base import Layout

INTERRUPTED = 130

Command = TypeVar("Command", bound=Callable[..., None])


def guarded(command: Command) -> Command:
    """Turns errors into one sentence on stderr and their exit code; tracebacks only with `--debug`."""

    @functools.wraps(command)
    def run(*args: Any, **kwargs: Any) -> None:
        signal.signal(signal.SIGTERM, _interrupt)
        try:
            command(*args, **kwargs)
            if sys.stdout:
                sys.stdout.flush()
        except UnidriveError as error:
            _fail(str(error), error.exit_code, debug=kwargs.get("debug", False))
        except BrokenPipeError:
            sys.stdout = open(os.devnull, "w")  # noqa: PTH123, SIM115 (nobody reads on: not an error)
            raise typer.Exit(0) from None
        except KeyboardInterrupt:
            what_now = f"To continue:\n{command_line()}" if "dst" in kwargs else "Nothing was written."
            if kwargs.get("fix"):
                what_now = "Tables that were mended by then have what they were beside them (.bak)."
            _fail(f"interrupted. {what_now}", INTERRUPTED, debug=False)
        except Exception as error:
            if isinstance(error, OSError) and _came_of_saying(error):
                sys.stdout = open(os.devnull, "w")  # noqa: PTH123, SIM115 (what is left is flushed at the end)
                sentence = f"standard output: cannot be written: {error.strerror}."
                _fail(sentence, OutputError.exit_code, debug=kwargs.get("debug", False))
            if isinstance(error, typer.Exit) or type(error).__module__.startswith(("click", "typer")):
                raise
            sentence = f"unexpected {type(error).__name__}: {error}. This is a bug; --debug shows where it happened."
            _fail(sentence, 1, debug=kwargs.get("debug", False))

    return run  # type: ignore[return-value]


def _came_of_saying(error: OSError) -> bool:
    """Whether an error was raised by `typer.echo`, or by the flush at the end of a command."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return last.name == "echo" or last.filename == __file__


def grouped(command: Command) -> Command:
    """Lets a command take groups of options: of a parameter whose type is a dataclass each field is an option."""
    parameters: list[inspect.Parameter] = []
    groups: dict[str, type] = {}
    hints = get_type_hints(command)
    for name, parameter in inspect.signature(command).parameters.items():
        if not is_dataclass(hints[name]):
            parameters.append(parameter.replace(annotation=hints[name]))
            continue
        groups[name], of_fields = hints[name], get_type_hints(hints[name])
        parameters += [
            parameter.replace(name=field.name, default=field.default, annotation=of_fields[field.name])
            for field in fields(hints[name])
        ]

    @functools.wraps(command)
    def run(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
        command(**given)

    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]  # which inspect looks for
    return run  # type: ignore[return-value]


def command_line() -> str:
    """The command line to give again to continue this one: without --force, which would start over."""
    return shlex.join(["unidrive", *(word for word in sys.argv[1:] if word != "--force")])


def _interrupt(signal_number: int, frame: object) -> None:
    """SIGTERM (batch systems, containers) ends a run as Ctrl-C does: workers stopped, resumable."""
    raise KeyboardInterrupt


def _fail(sentence: str, exit_code: int, *, debug: bool) -> None:
    if debug:
        traceback.print_exc(file=sys.stderr)
    typer.echo(f"unidrive: {sentence}".encode(errors="backslashreplace").decode(), err=True)
    raise typer.Exit(exit_code)


def read_config(context: typer.Context, path: Path | None) -> Path | None:
    """Callback of `--config`: the file's values become defaults, below flags and UNIDRIVE_* variables."""
    if path is None:
        return None
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    from unidrive_cli.rig.yaml_reading import problem_and_place

    try:
        try:
            values = YAML(typ="safe").load(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, YAMLError, ValueError, RecursionError) as error:
            problem, place = problem_and_place(error, str(path))
            what = getattr(error, "strerror", None) or problem
            raise UsageError(f"--config cannot be read: {what}.", where=place) from error
        known = {
            name.lstrip("-"): parameter
            for parameter in context.command.params
            for name in parameter.opts
            if name.startswith("--") and name not in ("--config", "--help")
        }
        if not isinstance(values, dict | None):
            raise UsageError("--config must be a mapping of option names to values.", where=str(path))
        defaults = {}
        for key, value in (values or {}).items():
            name = str(key).replace("_", "-")
            if name not in known:
                sentence = f"{key} is not an option of {context.command.name}."
                raise UsageError(sentence, where=str(path), hint=did_you_mean(str(key), known))
            parameter = known[name]
            several = getattr(parameter, "multiple", False) and not isinstance(value, list)
            defaults[str(parameter.name)] = [value] if several else value
    except UsageError as error:
        _fail(str(error), error.exit_code, debug=False)
    context.default_map = {**(context.default_map or {}), **defaults}
    return path


def option(default: Any, *names: str, help: str, **more: Any) -> Any:
    """An option that may also come from its UNIDRIVE_* variable."""
    variable = "UNIDRIVE_" + names[0].split("/")[0].lstrip("-").upper().replace("-", "_")
    return typer.Option(default, *names, help=help, envvar=variable, show_envvar=False, **more)


CONFIG = option(
    None,
    "--config",
    callback=read_config,
    is_eager=True,
    help="YAML file with defaults for these options.",
    show_default=False,
)
DEBUG = option(False, "--debug", help="Show a traceback with an error.")
JSON = option(False, "--json", help="Print one JSON object instead of text.")
VERSION = option(None, "--version", help="Version folder, where the dataset has several.", show_default=False)
LAYOUT = option(
    None,
    "--layout",
    help="Read the dataset as one of this layout, instead of the one found out (docs/layouts.md).",
    show_default=False,
)
SCENES = option([], "--scene", help="Only this scene (repeatable).", show_default=False)
LENSES = option(
    None,
    "--lenses",
    help="YAML file of SRC's lenses by channel, where its tables do not say them (docs/lenses.md).",
    show_default=False,
)
SOURCE = typer.Argument(
    ..., metavar="SRC", readable=False, help="Dataset: the folder that holds v1.0-*."
)  # whether it can be read is found out with a better sentence
RIG_HELP = "Virtual rig: a rig file, a shipped rig's name, a dataset folder, or a fleet file."
COMMON_SWEEP = option(
    None,
    "--common-sweep",
    help="How far a car drives, at most, between a camera's moment and the sample's, in metres (default: 1).",
)
DEPTH_LIMIT = option(
    None, "--depth-limit", help="D0: distance in metres of what is not ground (default: the rig's, or 50)."
)
GROUND_HEIGHT = option(
    None, "--ground-height", help="Height in metres of the ground in the ego frame (default: the rig's, or 0)."
)
JOBS = option(
    None, "--jobs", "-j", help="Samples worked on at once; 0 works in this process alone (default: one per core)."
)


@dataclass(frozen=True)
class SourceOptions:
    """Which dataset, and what of it."""

    version: str | None = VERSION
    layout: str | None = LAYOUT
    scene: list[str] = SCENES
    camera: list[str] = option([], "--camera", help="Use only this source camera (repeatable).", show_default=False)
    lenses: Path | None = LENSES


@dataclass(frozen=True)
class WarpOptions:
    """How pictures are warped."""

    depth_limit: float | None = DEPTH_LIMIT
    ground_height: float | None = GROUND_HEIGHT
    blend: Blend = option("angular", "--blend", help="How overlapping source pictures are joined.")
    ego_motion: bool = option(
        True, "--ego-motion/--no-ego-motion", help="Compensate the car's motion between the cameras' moments."
    )
    anti_alias: bool = option(
        True,
        "--anti-alias/--no-anti-alias",
        help="Sample sources that are shrunk by more than 1.95 from reduced copies.",
    )
    exposure: ExposureChoice = option(
        "none", "--exposure", help="Even out the brightness of neighbouring source pictures by gains."
    )

    def choices(self, rig: Rig) -> WarpChoices:
        """What was chosen, as `warp_choices` has it."""
        others = (self.blend, self.ego_motion, self.anti_alias, self.exposure)
        return warp_choices(rig, self.depth_limit, self.ground_height, *others)


def warp_choices(rig: Rig, depth_limit_m: float | None, ground_height_m: float | None, *others: Any) -> WarpChoices:
    """The options of the warp; where one of the two is not given the rig's own value counts, then the default."""

    def first(*values: float | None) -> float:
        return next(value for value in values if value is not None)

    return WarpChoices(
        first(depth_limit_m, rig.depth_limit_m, DEFAULT_DEPTH_LIMIT_M),
        first(ground_height_m, rig.ground_height_m, DEFAULT_GROUND_HEIGHT_M),
        *others,
    )


def say_layout(layout: Layout, folder: Path, forced: str | None) -> None:
    """Says on stderr in which layout a version folder is read, where that is not simply nuScenes'."""
    if forced or layout.name != "nuscenes":
        how = "as told" if forced else "found out; --layout names another"
        typer.echo(f"layout: {layout.title} ({folder}), {how}", err=True)


def jobs_of(jobs: int | None) -> int:
    """The number of jobs: where none is given, one per core that this process may use."""
    return len(os.sched_getaffinity(0)) if jobs is None else jobs


def say_table(header: Sequence[str], rows: Sequence[Sequence[str]], left: int) -> None:
    """Prints rows of text in aligned columns: the first `left` columns to the left, the others to the right."""
    widths = [max(len(row[column]) for row in (header, *rows)) for column in range(len(header))]
    for row in (header, *rows):
        cells = (
            cell.ljust(width) if place < left else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        typer.echo("  ".join(cells).rstrip())


def human_bytes(count: float) -> str:
    """A size for people, in powers of 1000."""
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000
    return f"{count:.1f} TB"


def plural(count: int, noun: str) -> str:
    """`1 sample`, `2 samples`."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"
