"""`unidrive doctor`."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from unidrive_cli.cli.shared import DEBUG, JSON, guarded, human_bytes

if TYPE_CHECKING:
    from unidrive_cli.machine import Machine


@guarded
def doctor_command(
    path: Path = typer.Argument(Path(), metavar="[PATH]", help="Where free disk is looked at.", show_default="here"),
    as_json: bool = JSON,
    debug: bool = DEBUG,
) -> None:
    """Show what this machine has: versions, codecs, cores, memory, free disk, GL."""
    from unidrive_cli.machine import look_at_machine

    machine = look_at_machine(path)
    if as_json:
        typer.echo(json.dumps({"schema_version": 1, **asdict(machine)}))
    else:
        _say(machine)
    if machine.toolchain_error:
        raise typer.Exit(1)


def _say(machine: Machine) -> None:
    rows = [("unidrive", machine.unidrive), ("Python", f"{machine.python}, {machine.platform}")]
    rows += [(name, version or "not installed") for name, version in machine.packages.items()]
    rows += [(name, _words(value)) for name, value in machine.toolchain.items()]
    if machine.toolchain_error:
        rows.append(("codec", f"cannot be used: {machine.toolchain_error}"))
    available = human_bytes(machine.available_bytes)
    rows += [
        ("libturbojpeg", "found" if machine.libturbojpeg else "not found"),
        ("cores", f"{machine.usable_cores} usable of {machine.cores}"),
        ("memory", f"{available} free of {human_bytes(machine.memory_bytes)}"),
        ("disk", f"{human_bytes(machine.free_bytes)} free at {machine.folder}"),
        ("GL", machine.gl or f"none, synth casts rays ({machine.gl_error})"),
    ]
    width = max(len(name) for name, _ in rows)
    for name, text in rows:
        typer.echo(f"{name:{width}}  {text}")


def _words(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {what}" for name, what in value.items())
    return str(value)
