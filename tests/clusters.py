"""A real Dask cluster for tests: scheduler and workers as processes of their own on this machine."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

WITHIN_S = 60.0


def wait_until(true: Callable[[], bool]) -> None:
    """Returns as soon as it is; fails after a minute."""
    end = time.monotonic() + WITHIN_S
    while not true():
        assert time.monotonic() < end, "waited a minute for nothing"
        time.sleep(0.02)


@dataclass
class Cluster:
    """A scheduler and its workers; workers of one thread, without a nanny that would start them anew."""

    folder: Path
    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def start_worker(self, *options: str, first_in_path: Path | None = None) -> subprocess.Popen[bytes]:
        """Starts a worker; where it imports from can be changed."""
        options = options or ("--nthreads", "1", "--no-nanny")
        worker = _start("dask_worker", self.address, *options, folder=self.folder, first_in_path=first_in_path)
        self.workers.append(worker)
        return worker

    def close(self) -> None:
        """Kills all of it."""
        for process in (*self.workers, self.scheduler):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@contextlib.contextmanager
def cluster(folder: Path, workers: int = 0) -> Iterator[Cluster]:
    """A cluster that lives as long as the block.

    Args:
        folder: where its processes work.
        workers: how many are started at once; `in_cluster` waits for the first.
    """
    address_file = folder / "scheduler.json"
    scheduler = _start(
        "dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(address_file), folder=folder
    )
    made = Cluster(folder, "", scheduler)
    try:
        wait_until(lambda: address_file.is_file() and address_file.read_text().rstrip().endswith("}"))
        made.address = json.loads(address_file.read_text())["address"]
        for _ in range(workers):
            made.start_worker()
        yield made
    finally:
        made.close()


def _start(program: str, *options: str, folder: Path, first_in_path: Path | None = None) -> subprocess.Popen[bytes]:
    path = [str(first_in_path)] if first_in_path else []
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([*path, os.environ.get("PYTHONPATH", "")])}
    with (folder / "log.txt").open("ab") as log:
        return subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.{program}", *options, "--no-dashboard"],
            cwd=folder,
            env=env,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
