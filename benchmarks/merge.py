"""What merging costs where tables are large, against finishing one conversion of the same size.

    python benchmarks/make_trainval_tables.py SRC1 --scale 0.06 --files all
    python benchmarks/make_trainval_tables.py SRC2 --scale 0.06 --files all --seed 2
    python benchmarks/make_trainval_tables.py SRC --scale 0.12 --files all
    python benchmarks/merge.py WORK SRC --merge SRC1 SRC2

`finalise` plans a conversion of a source, with receipts made up as benchmarks/tables.py does and black pictures, and
finishes it: tables written, files linked, all verified. `merge` merges two datasets that were made so, one after the
other: of two sources, and (`clash`) of one source and a copy of it with other poses and calibrations, whose tokens,
names and files are all taken. Each in a process of its own; peak memory is that process's. Prints JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from tables import planned, receipts_of


def finalise(source: Path, folder: Path) -> None:
    from unidrive_cli.convert.finalise import finalise, write_run
    from unidrive_cli.tables.destination import begin, finish

    plan = planned(source)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    destination = begin(folder.resolve(), plan.identity, same=False, force=False)
    for camera in plan.rig.cameras:
        black = np.zeros((camera.lens.height_px, camera.lens.width_px, 3), dtype=np.uint8)
        (folder / "black.jpg").write_bytes(cv2.imencode(".jpg", black)[1].tobytes())
        for unit in plan.units:
            target = folder / next(name for name in unit.pictures if f"/{camera.channel}/" in name)
            target.parent.mkdir(parents=True, exist_ok=True)
            os.link(folder / "black.jpg", target)
        (folder / "black.jpg").unlink()
    summary = finalise(plan, destination, receipts_of(plan), [])
    write_run(destination, summary)
    finish(destination, keep_work=False)


def merge(sources: list[Path], folder: Path) -> None:
    from unidrive_cli.merge.plan import make_merge_plan
    from unidrive_cli.merge.run import merge

    shutil.rmtree(folder, ignore_errors=True)
    merge(make_merge_plan(sources), folder)


def other_drive(source: Path, folder: Path) -> None:
    """A copy of a source's tables, beside links to its files, in which every pose is a kilometre to the east."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for entry in source.resolve().iterdir():
        (folder / entry.name).symlink_to(entry)
    tables = folder / "v1.0-trainval"
    tables.unlink()
    shutil.copytree(source / tables.name, tables)
    poses = json.loads((tables / "ego_pose.json").read_bytes())
    for pose in poses:
        pose["translation"][0] += 1000.0
    (tables / "ego_pose.json").write_text(json.dumps(poses, indent=0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("work", type=Path)
    parser.add_argument("source", type=Path)
    parser.add_argument("--merge", type=Path, nargs=2, required=True)
    parser.add_argument("--stages", nargs="+", help="only these (default: all)")
    parser.add_argument("--stage", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    work, pair = arguments.work, arguments.merge
    halves = [work / "half-1", work / "half-2"]
    stages: dict[str, Any] = {
        "other-drive": lambda: other_drive(pair[0], work / "other-drive"),
        "finalise": lambda: finalise(arguments.source, work / "whole"),
        "finalise-1": lambda: finalise(pair[0], halves[0]),
        "finalise-2": lambda: finalise(pair[1], halves[1]),
        "finalise-other": lambda: finalise(work / "other-drive", work / "half-other"),
        "merge": lambda: merge(halves, work / "merged"),
        "clash": lambda: merge([halves[0], work / "half-other"], work / "clashed"),
    }
    if arguments.stage:
        started, began = time.perf_counter(), time.process_time()
        stages[arguments.stage]()
        found = {
            "seconds": round(time.perf_counter() - started, 2),
            "cpu_seconds": round(time.process_time() - began, 2),
            "peak_gb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 2),
        }
        print(json.dumps(found))
        return
    for stage in arguments.stages or stages:
        command = [sys.executable, __file__, *sys.argv[1:], "--stage", stage]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        print(json.dumps({"stage": stage, **json.loads(done.stdout.splitlines()[-1])}), flush=True)


if __name__ == "__main__":
    main()
