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
        ({"dst": "out"}, "The same command continues where this one stopped."),
        ({"src": "in"}, "Nothing was written."),
    ],
)
def test_only_commands_with_a_destination_promise_to_continue(
    arguments: dict[str, object], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(typer.Exit) as stopped:
        interrupted(**arguments)
    assert stopped.value.exit_code == 130
    assert capsys.readouterr().err == f"unidrive: interrupted. {words}\n"
