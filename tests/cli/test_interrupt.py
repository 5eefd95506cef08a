"""Ctrl-C in a command: what it says depends on whether the command has a destination."""

from __future__ import annotations

import pytest
import typer

from unidrive_cli.cli.shared import guarded


@guarded
def interrupted(**arguments: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"dst": "out"}, "To continue:\nunidrive convert 'my drives/a' out --rig 6x60"),
        ({"src": "in"}, "Nothing was written."),
    ],
)
def test_only_commands_with_a_destination_promise_to_continue(
    arguments: dict[str, object], words: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The line is the one to give again; --force would start over, so it is not in it."""
    line = ["/usr/bin/unidrive", "convert", "--force", "my drives/a", "out", "--rig", "6x60"]
    monkeypatch.setattr("sys.argv", line)
    with pytest.raises(typer.Exit) as stopped:
        interrupted(**arguments)
    assert stopped.value.exit_code == 130
    assert capsys.readouterr().err == f"unidrive: interrupted. {words}\n"
