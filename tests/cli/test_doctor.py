"""`unidrive doctor`: what it says is what the machine has."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from tests.datasets import unidrive
from unidrive_cli import __version__
from unidrive_cli.warp.render import choose_toolchain


def test_the_machine_as_an_object(tmp_path: Path) -> None:
    run = unidrive("doctor", tmp_path, "--json")
    assert run.code == 0, run.stderr
    machine = run.json()
    assert (machine["unidrive"], machine["python"]) == (__version__, platform.python_version())
    assert machine["packages"]["numpy"] == version("numpy")
    assert machine["packages"]["nuscenes-devkit"] == version("nuscenes-devkit")
    assert machine["toolchain"] == choose_toolchain().identity
    assert machine["usable_cores"] == len(os.sched_getaffinity(0)) <= machine["cores"]
    assert 0 < machine["available_bytes"] < machine["memory_bytes"]
    assert machine["folder"] == str(tmp_path)
    assert machine["free_bytes"] == pytest.approx(shutil.disk_usage(tmp_path).free, rel=0.2)
    assert bool(machine["gl"]) != bool(machine["gl_error"])


def test_the_machine_in_lines(tmp_path: Path) -> None:
    run = unidrive("doctor", tmp_path / "not" / "there")
    assert run.code == 0, run.stderr
    lines = dict(line.split(maxsplit=1) for line in run.stdout.splitlines())
    assert lines["unidrive"] == __version__
    assert lines["simplejpeg"] == version("simplejpeg")
    assert lines["disk"].endswith(f"free at {tmp_path}/not/there")
    assert {"Python", "kernel", "codec", "libturbojpeg", "cores", "memory", "GL", "distributed"} <= lines.keys()


def test_cores_are_those_that_the_process_may_use() -> None:
    """As a batch system allots them; they are the default of `--jobs` too."""
    program = """
import os
os.sched_setaffinity(0, [min(os.sched_getaffinity(0))])
from pathlib import Path
from unidrive_cli.cli.shared import jobs_of
from unidrive_cli.machine import look_at_machine
print(jobs_of(None), look_at_machine(Path()).usable_cores)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["1", "1"]


def test_a_codec_that_cannot_be_imported_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "simplejpeg", None)  # what Python itself takes for "cannot be imported"
    for module in ("render", "pictures"):
        monkeypatch.delitem(sys.modules, f"unidrive_cli.warp.{module}", raising=False)
    run = unidrive("doctor")
    assert run.code == 1
    assert "cannot be used: import of simplejpeg halted" in run.stdout
