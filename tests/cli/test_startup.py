"""What a command imports before it does anything: help comes at once (times: benchmarks/startup.py)."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.datasets import spawn

HEAVY = (
    "numpy",
    "cv2",
    "joblib",
    "scipy",
    "numba",
    "simplejpeg",
    "msgspec",
    "nuscenes",
    "distributed",
    "rich",
    "tqdm",
)
PROGRAM = """
import sys
from unidrive_cli.cli.main import app
sys.argv = ["unidrive", *sys.argv[1:]]
try:
    app()
except SystemExit as end:
    assert end.code == 0, end.code
print(*sorted({name.partition(".")[0] for name in sys.modules}), file=sys.stderr)
"""


@pytest.mark.parametrize(
    "arguments", [("--help",), ("--version",), ("convert", "--help"), ("finalise", "--help"), ("doctor", "--help")]
)
def test_help_imports_nothing_heavy(arguments: tuple[str, ...]) -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM, *arguments], capture_output=True, text=True, check=True)
    assert done.stdout
    imported = done.stderr.split()
    assert "unidrive_cli" in imported
    assert [name for name in HEAVY if name in imported] == []


def test_help_lists_every_command() -> None:
    said = spawn("--help").stdout
    for command in ("convert", "finalise", "inspect-rig", "measure", "synth", "doctor"):
        assert f"\n  {command} " in said
