"""Kills conversions (kill -9 of the whole process group) at seeded moments, resumes each, and compares the bytes.

`make chaos` does it fifty times; the tests five times. A moment is a number of receipts, or the begin of finalise,
and a pause after it, so that the kills fall on warping, writing and finalising alike.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from tests.datasets import SCRIPT, VERSION, paint, tree

RIG = """\
name: chaos
cameras:
  CAM_FRONT: {width: 640, height: 360, hfov: 80, position: [1.5, 0.0, 1.6], yaw: 0}
  CAM_BACK: {width: 640, height: 360, hfov: 80, position: [0.0, 0.0, 1.6], yaw: 180}
"""
SAMPLES = 8
PATIENCE_S = 120.0


@dataclass(frozen=True)
class Moment:
    """When to kill.

    Attributes:
        receipts: after so many samples are done; None once finalise has begun.
        pause_s: so long after that.
        jobs: of the run that is killed and of the one that resumes it.
    """

    receipts: int | None
    pause_s: float
    jobs: int


def moments(count: int, seed: int) -> list[Moment]:
    """Every third in finalise, the others after 0 to SAMPLES - 1 samples."""
    chance = random.Random(seed)
    return [
        Moment(
            None if number % 3 == 2 else chance.randrange(SAMPLES),
            chance.uniform(0, 1.0 if number % 3 == 2 else 0.15),
            chance.choice((0, 2)),
        )
        for number in range(count)
    ]


class Chaos:
    """A folder with a painted drive, a rig, and the undisturbed conversion that all others must equal."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.src = paint(folder / "src", scenes=2, samples=SAMPLES // 2)
        (folder / "rig.yaml").write_text(RIG)
        self.whole = self._completed(folder / "whole", jobs=0)

    def kill_and_resume(self, moment: Moment) -> str:
        """Kills one run and completes it; says where the kill found it.

        Raises:
            AssertionError: something looks complete and is not, the resume failed, or the bytes are others.
        """
        dst = self.folder / "dst"
        shutil.rmtree(dst, ignore_errors=True)
        running = subprocess.Popen(
            self._command(dst, moment.jobs),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        end = time.monotonic() + PATIENCE_S
        while running.poll() is None and not _reached(dst, moment):
            assert time.monotonic() < end, f"{moment} was never reached"
            time.sleep(0.001)
        time.sleep(moment.pause_s)
        os.killpg(running.pid, signal.SIGKILL) if running.poll() is None else None
        running.wait()
        state = _state(dst)
        if state == "finished":
            assert tree(dst, apart=("run.json",)) == self.whole, f"{moment}: looks complete, and is not"
        assert self._completed(dst, moment.jobs) == self.whole, f"{moment}: other bytes after a resume ({state})"
        return state

    def _completed(self, dst: Path, jobs: int) -> dict[str, str]:
        done = subprocess.run(
            self._command(dst, jobs), capture_output=True, text=True, check=False, timeout=PATIENCE_S
        )
        assert done.returncode == 0, done.stderr
        return tree(dst, apart=("run.json",))

    def _command(self, dst: Path, jobs: int) -> list[str]:
        return [
            SCRIPT,
            "convert",
            str(self.src),
            str(dst),
            "--rig",
            str(self.folder / "rig.yaml"),
            "--jobs",
            str(jobs),
        ]


def _reached(dst: Path, moment: Moment) -> bool:
    if moment.receipts is None:
        return (dst / ".unidrive" / "tables").exists() or (dst / VERSION).exists()
    if not (dst / ".unidrive").exists():
        return False
    return len(list((dst / ".unidrive" / "receipts").glob("*.json"))) >= moment.receipts


def _state(dst: Path) -> str:
    """What a reader would make of DST."""
    if not (dst / "UNFINISHED.txt").exists() and not (dst / ".unidrive").exists():
        return "finished" if (dst / "unidrive.json").exists() else "not begun"
    if not (dst / ".unidrive").exists():
        return "finished"  # the marker is swept away after the rename that counts
    if (dst / VERSION).exists() or (dst / ".unidrive" / "tables").exists():
        return "finalise"
    done = len(list((dst / ".unidrive" / "receipts").glob("*.json")))
    return "units" if done < SAMPLES else "between units and finalise"


def main() -> None:
    """Runs as many kills as are asked for and says where they fell."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        chaos = Chaos(Path(folder))
        for number, moment in enumerate(moments(arguments.kills, arguments.seed), 1):
            state = chaos.kill_and_resume(moment)
            found[state] += 1
            sys.stderr.write(f"{number}: {moment}: {state}, resumed, same bytes\n")
    killed = ", ".join(f"{count} in {state}" for state, count in sorted(found.items()))
    sys.stdout.write(f"{arguments.kills} kills (seed {arguments.seed}): {killed}; all resumed to the same bytes\n")


if __name__ == "__main__":
    main()
