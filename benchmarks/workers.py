"""How a conversion grows with worker processes, and what memory each takes.

    python benchmarks/workers.py [--data FOLDER] [--rig RIG] [--samples 20 60] [--jobs 1 2]

Runs `convert`'s own units on copies of the genuine nuScenes keyframe, each at its own moment, in worker
processes, start of the processes and loading of the kernel included. Prints one JSON object: seconds by number
of samples and of workers, the speed-up, and the largest resident memory of a worker. `codec` is what the machine's
cores give processes that only decode and encode the same pictures with OpenCV, in the same run: cores that share
memory, power or a host are not as fast together as each alone.
"""

from __future__ import annotations

import argparse
import functools
import json
import os
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import cv2

from unidrive_cli.convert.options import Options
from unidrive_cli.convert.plan import make_plan
from unidrive_cli.convert.units import Frame, Job, run_unit
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.tables.destination import Destination
from unidrive_cli.tables.rig_of_dataset import resolve_rig
from unidrive_cli.warp.render import prepare
from unidrive_cli.workers import in_workers, start_server

SHARED = os.environ.get("UNIDRIVE_TEST_DATA") or Path(__file__).parents[1] / ".." / "shared" / "data"


def unit_and_memory(job: Job, frame: Frame) -> float:
    """Does a unit; returns the largest resident memory of this process so far, in MB."""
    run_unit(job, frame)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def decode_and_encode(paths: tuple[str, ...], number: int) -> int:
    """What the codec alone does for a sample."""
    cv2.setNumThreads(1)
    for path in paths:
        cv2.imencode(".jpg", cv2.imread(path), [cv2.IMWRITE_JPEG_QUALITY, 95])
    return number


def at_another_moment(frame: Frame, number: int) -> Frame:
    sources = []
    for source in frame.sources:
        cam_from_ego = source.cam_from_ego.copy()
        cam_from_ego[0, 3] += 1e-4 * number
        sources.append(replace(source, cam_from_ego=cam_from_ego))
    pictures = tuple(name.replace(".jpg", f"-{number}.jpg") for name in frame.pictures)
    return replace(frame, token=str(number), pictures=pictures, sources=tuple(sources))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(SHARED) / "nuscenes-onekeyframe")
    parser.add_argument("--rig", default="roof-6x70")
    parser.add_argument("--samples", type=int, nargs="+", default=[20, 60])
    parser.add_argument("--jobs", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--rounds", type=int, default=3)
    chosen = parser.parse_args()
    if not chosen.data.is_dir():
        parser.error(f"{chosen.data} is not there: name a dataset with --data, or set UNIDRIVE_TEST_DATA")
    rig, _ = resolve_rig(chosen.rig)
    plan = make_plan(open_dataset(chosen.data), rig, Options())
    frame = plan.frame(plan.units[0])
    prepare(plan.toolchain)
    start_server(["unidrive_cli.warp.prepared"])
    results = []
    for samples in chosen.samples:
        frames = [at_another_moment(frame, number) for number in range(samples)]
        best: dict[int, float] = {}
        codec: dict[int, float] = {}
        memory = 0.0
        for _ in range(chosen.rounds):
            for jobs in chosen.jobs:
                with tempfile.TemporaryDirectory() as folder:
                    job = Job(Destination(Path(folder)), rig, plan.options, plan.toolchain, f"{folder}")
                    job.destination.work.mkdir()
                    started = time.monotonic()
                    peaks = list(in_workers(functools.partial(unit_and_memory, job), frames, jobs))
                    seconds = time.monotonic() - started
                best[jobs] = min(seconds, best.get(jobs, seconds))
                started = time.monotonic()
                list(in_workers(functools.partial(decode_and_encode, frame.paths), range(samples), jobs))
                seconds = time.monotonic() - started
                codec[jobs] = min(seconds, codec.get(jobs, seconds))
                memory = max(memory, *peaks)
        first, first_codec = best[chosen.jobs[0]], codec[chosen.jobs[0]]
        results.append(
            {
                "samples": samples,
                "seconds": {jobs: round(seconds, 2) for jobs, seconds in best.items()},
                "speed_up": {jobs: round(first / seconds, 2) for jobs, seconds in best.items()},
                "codec_speed_up": {jobs: round(first_codec / seconds, 2) for jobs, seconds in codec.items()},
                "worker_mb": round(memory),
            }
        )
    print(json.dumps({"toolchain": plan.toolchain.identity, "runs": results}, indent=1))


if __name__ == "__main__":
    main()
