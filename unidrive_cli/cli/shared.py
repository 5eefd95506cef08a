"""What the commands share: options, the config file, errors and exit codes."""

from __future__ import annotations

import functools
import os
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import typer

from unidrive_cli.errors import UnidriveError, UsageError, did_you_mean

INTERRUPTED = 130

Command = TypeVar("Command", bound=Callable[..., None])


def guarded(command: Command) -> Command:
    """Turns errors into one sentence on stderr and their exit code; tracebacks only with `--debug`."""

    @functools.wraps(command)
    def run(*args: Any, **kwargs: Any) -> None:
        signal.signal(signal.SIGTERM, _interrupt)
        try:
            command(*args, **kwargs)
            sys.stdout.flush()
        except UnidriveError as error:
            _fail(str(error), error.exit_code, debug=kwargs.get("debug", False))
        except BrokenPipeError:
            sys.stdout = open(os.devnull, "w")  # noqa: PTH123, SIM115 (nobody reads on: not an error)
            raise typer.Exit(0) from None
        except KeyboardInterrupt:
            _fail("interrupted. The same command continues where this one stopped.", INTERRUPTED, debug=False)
        except Exception as error:
            if isinstance(error, typer.Exit) or type(error).__module__.startswith(("click", "typer")):
                raise
            sentence = f"unexpected {type(error).__name__}: {error}. This is a bug; --debug shows where it happened."
            _fail(sentence, 1, debug=kwargs.get("debug", False))

    return run  # type: ignore[return-value]


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

    try:
        try:
            values = YAML(typ="safe").load(path.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, YAMLError, ValueError, RecursionError) as error:
            raise UsageError(f"--config cannot be read: {str(error).splitlines()[0]}.", where=str(path)) from error
        known = {
            name.lstrip("-"): parameter
            for parameter in context.command.params
            for name in parameter.opts
            if name.startswith("--") and name not in ("--config", "--help")
        }
        if not isinstance(values, dict):
            raise UsageError("--config must be a mapping of option names to values.", where=str(path))
        defaults = {}
        for key, value in values.items():
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


CONFIG = typer.Option(
    None,
    "--config",
    callback=read_config,
    is_eager=True,
    help="YAML file with defaults for these options.",
    show_default=False,
    envvar="UNIDRIVE_CONFIG",
    show_envvar=False,
)
DEBUG = typer.Option(
    False, "--debug", help="Show a traceback with an error.", envvar="UNIDRIVE_DEBUG", show_envvar=False
)
JSON = typer.Option(
    False, "--json", help="Print one JSON object instead of text.", envvar="UNIDRIVE_JSON", show_envvar=False
)
SCENES = typer.Option(
    [],
    "--scene",
    help="Only this scene (repeatable).",
    show_default=False,
    envvar="UNIDRIVE_SCENE",
    show_envvar=False,
)


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
