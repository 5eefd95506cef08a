"""What resuming costs: temporary names, renames, receipts and the wait for the disk, against bare writes.

    python benchmarks/safety.py [--data FOLDER] [--rig RIG] [--samples 20] [--rounds 7]

Converts copies of the genuine nuScenes keyframe in one process, in turn: as `convert` does (every file under a
temporary name and renamed, a receipt for each sample, looked for before and checked as a continued run checks it,
`syncfs` at the end), and with the same units writing their files straight to their place. Medians over the rounds
of CPU and wall time, and their ratios. Prints one JSON object.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from unidrive_cli.convert.options import Options
from unidrive_cli.convert.plan import Plan, make_plan
from unidrive_cli.convert.units import Frame, Job, read_receipt, run_unit
from unidrive_cli.tables.converted import WORK
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.tables.destination import Destination, to_disk
from unidrive_cli.tables.rig_of_dataset import resolve_rig

SHARED = os.environ.get("UNIDRIVE_TEST_DATA") or Path(__file__).parents[1] / ".." / "shared" / "data"


class Bare(Destination):
    """Writes pictures and masks straight to their place, and no receipts."""

    def write(self, name: str, data: bytes) -> None:
        if not name.startswith(WORK):
            path = self.root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)


def series(plan: Plan, frames: list[Frame], *, safe: bool) -> tuple[float, float]:
    """CPU and wall seconds of all frames into an empty folder."""
    with tempfile.TemporaryDirectory(dir=".") as folder:
        destination = (Destination if safe else Bare)(Path(folder))
        job = Job(destination, plan.rig, plan.options, plan.toolchain, plan.digest)
        destination.work.mkdir()
        os.sync()
        wall, cpu = time.perf_counter(), time.process_time()
        for frame in frames:
            if safe:
                read_receipt(destination, frame.token, frame.pictures, plan.options.masks)
            run_unit(job, frame)
        if safe:
            for frame in frames:
                assert read_receipt(destination, frame.token, frame.pictures, plan.options.masks)
            to_disk(destination.root)
        return time.process_time() - cpu, time.perf_counter() - wall


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(SHARED) / "nuscenes-onekeyframe")
    parser.add_argument("--rig", default="roof-6x70")
    parser.add_argument("--samples", type=int, default=20)
    parser.add_argument("--rounds", type=int, default=7)
    chosen = parser.parse_args()
    if not chosen.data.is_dir():
        parser.error(f"{chosen.data} is not there: name a dataset with --data, or set UNIDRIVE_TEST_DATA")
    rig, _ = resolve_rig(chosen.rig)
    plan = make_plan(open_dataset(chosen.data), rig, Options())
    frame = plan.frame(plan.units[0])
    frames = [
        replace(
            frame,
            token=str(number),
            pictures=tuple(name.replace(".jpg", f"-{number}.jpg") for name in frame.pictures),
        )
        for number in range(chosen.samples)
    ]
    series(plan, frames[:1], safe=True)
    rounds = [(series(plan, frames, safe=True), series(plan, frames, safe=False)) for _ in range(chosen.rounds)]
    result: dict[str, dict[str, float]] = {}
    for place, name in enumerate(("cpu", "wall")):
        safe, bare = (statistics.median(both[which][place] for both in rounds) for which in (0, 1))
        ratios = [both[0][place] / both[1][place] for both in rounds]
        result[name] = {
            "safe_ms_per_sample": round(1e3 * safe / chosen.samples, 1),
            "bare_ms_per_sample": round(1e3 * bare / chosen.samples, 1),
            "ratio": round(statistics.median(ratios), 3),
        }
    print(json.dumps({"samples": chosen.samples, "rounds": chosen.rounds, **result}, indent=1))


if __name__ == "__main__":
    main()
