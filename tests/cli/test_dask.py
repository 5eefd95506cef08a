"""`convert --backend dask` on a real cluster of this machine."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.datasets import SCRIPT, SMALL_RIG, Bench, assert_consistent, paint, tree

SAMPLES = 12
RIG = SMALL_RIG.replace("width: 64, height: 36", "width: 640, height: 360")
"""Takes long enough for a worker to be killed in the middle."""


@pytest.fixture(scope="module")
def painted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return paint(tmp_path_factory.mktemp("painted") / "drive", scenes=2, samples=SAMPLES // 2)


@pytest.fixture
def bench(painted: Path, tmp_path: Path) -> Bench:
    made = Bench(tmp_path / "bench", painted)
    made.rig.write_text(RIG)
    return made


def receipts(dst: Path) -> int:
    return len(list((dst / ".unidrive" / "receipts").glob("*.json")))


def test_the_bytes_are_those_of_any_number_of_jobs_though_a_worker_was_killed(bench: Bench, tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the extra `dask` is not installed")
    from tests.clusters import cluster, wait_until

    with cluster(tmp_path, workers=2) as machines:
        arguments = ["src", "dst", "--rig", bench.rig, "--backend", "dask", "--scheduler", machines.address]
        process = subprocess.Popen(
            [SCRIPT, "convert", *map(str, arguments)], cwd=bench.folder, stderr=subprocess.PIPE, text=True
        )
        wait_until(lambda: receipts(bench.dst) >= 2)
        os.killpg(machines.workers[0].pid, signal.SIGKILL)
        assert receipts(bench.dst) < SAMPLES
        _, stderr = process.communicate(timeout=120)
        assert (process.returncode, stderr) == (0, "")
        assert machines.workers[1].poll() is None
    assert_consistent(bench.dst)
    for jobs in (0, 1, 2):
        other = bench.folder / f"jobs-{jobs}"
        assert bench.convert("--jobs", jobs, dst=other).code == 0
        assert tree(other, apart=("run.json",)) == tree(bench.dst, apart=("run.json",))


def test_what_a_lost_cluster_has_done_is_kept(bench: Bench, tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the extra `dask` is not installed")
    from tests.clusters import cluster, wait_until

    with cluster(tmp_path, workers=1) as machines:
        arguments = [bench.src, bench.dst, "--rig", bench.rig, "--backend", "dask", "--scheduler", machines.address]
        process = subprocess.Popen([SCRIPT, "convert", *map(str, arguments)], stderr=subprocess.PIPE, text=True)
        wait_until(lambda: receipts(bench.dst) >= 2)
        os.killpg(machines.scheduler.pid, signal.SIGKILL)
        _, stderr = process.communicate(timeout=120)
    lost = f"unidrive: the connection to the scheduler {machines.address} was lost. The same command continues"
    assert stderr.startswith(lost)
    assert stderr.count("\n") == process.returncode == 1
    done = {path: path.stat().st_mtime_ns for path in (bench.dst / "samples").rglob("*.jpg")}
    assert done
    bench.converted()
    assert done.items() <= {path: path.stat().st_mtime_ns for path in (bench.dst / "samples").rglob("*.jpg")}.items()


def test_interrupted_it_says_one_sentence(bench: Bench, tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the extra `dask` is not installed")
    from tests.clusters import cluster, wait_until

    with cluster(tmp_path, workers=1) as machines:
        arguments = [
            bench.src,
            bench.dst,
            "--rig",
            bench.rig,
            "--kernel",
            "opencv",
            "--backend",
            "dask",
            "--scheduler",
            machines.address,
        ]
        process = subprocess.Popen([SCRIPT, "convert", *map(str, arguments)], stderr=subprocess.PIPE, text=True)
        wait_until(lambda: receipts(bench.dst) >= 2)
        process.send_signal(signal.SIGINT)
        _, stderr = process.communicate(timeout=120)
        again = shlex.join(["unidrive", "convert", *map(str, arguments)])
        assert stderr == f"unidrive: interrupted. To continue:\n{again}\n"
        assert process.returncode == 130
        assert bench.convert(*map(str, arguments[4:])).code == 0


@pytest.mark.parametrize("code", [1, 3])
def test_a_broken_picture_is_said_as_without_a_cluster(bench: Bench, tmp_path: Path, code: int) -> None:
    """Its end is cut off, which only the worker finds out."""
    pytest.importorskip("distributed", reason="the extra `dask` is not installed")
    from tests.clusters import cluster

    picture = bench.picture(0)
    picture.write_bytes(picture.read_bytes()[:-200])
    options = ("--on-error", "stop" if code == 3 else "skip")
    with cluster(tmp_path, workers=1) as machines:
        run = bench.convert("--backend", "dask", "--scheduler", machines.address, *options)
    here = bench.convert(*options, dst=bench.folder / "here")
    assert (run.code, run.stderr) == (here.code, here.stderr)
    assert run.code == code
    assert picture.name in run.said
    if code == 1:
        assert tree(bench.dst, apart=("run.json",)) == tree(bench.folder / "here", apart=("run.json",))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--backend", "dask"), ("--backend dask needs the address of a scheduler", "--scheduler")),
        (("--scheduler", "tcp://a:1"), ("--scheduler tcp://a:1 needs --backend dask",)),
        (("--backend", "processes", "--scheduler", "tcp://a:1"), ("--scheduler tcp://a:1 needs --backend dask",)),
        (("--backend", "spark"), ("--backend", "processes", "dask")),
    ],
)
def test_options_that_do_not_fit_together(bench: Bench, options: tuple[str, ...], words: tuple[str, ...]) -> None:
    bench.refused(2, *words, options=options)


def test_the_extra_is_not_installed(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)  # what Python itself takes for "cannot be imported"
    monkeypatch.delitem(sys.modules, "unidrive_cli.cluster", raising=False)
    options = ("--backend", "dask", "--scheduler", "tcp://127.0.0.1:1")
    bench.refused(2, "needs a package that is not installed", "pip install 'unidrive[dask]'", options=options)


def test_no_scheduler_answers(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="the extra `dask` is not installed")
    from unidrive_cli import cluster as room

    monkeypatch.setattr(room, "CONNECT_WITHIN_S", 1)
    options = ("--backend", "dask", "--scheduler", "tcp://127.0.0.1:1")
    run = bench.refused(2, "--scheduler tcp://127.0.0.1:1: no Dask scheduler answered there", options=options)
    assert re.search(r"within 1 seconds\. `dask scheduler` starts one", run.said)
