"""What tables of trainval's size cost: planning a key frame conversion, writing and checking its tables, the devkit.

    python benchmarks/make_trainval_tables.py FOLDER
    python benchmarks/tables.py FOLDER [--stages plan write check devkit]

Each stage runs in a process of its own; its peak memory is that process's, worker threads included. `write` makes
receipts up (every third box is lowered, one 2D box for every annotation) and writes all tables of the output to a
temporary folder beside FOLDER; `check` opens what it wrote and runs the rules of the final verification on it;
`devkit` is nuscenes-devkit's own load of the source's tables. Prints JSON.
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

STAGES = ("plan", "write", "check", "devkit")


def planned(folder: Path) -> Any:
    from unidrive_cli.convert.options import Options
    from unidrive_cli.convert.plan import make_plan
    from unidrive_cli.rig.gallery import load_gallery_rig
    from unidrive_cli.tables.dataset import open_dataset

    return make_plan(open_dataset(folder), load_gallery_rig("roof-6x70"), Options(masks="none"))


def receipts_of(plan: Any) -> dict[str, Any]:
    from unidrive_cli.convert.boxes import Box2d
    from unidrive_cli.convert.units import Receipt

    receipts = {}
    cameras = len(plan.rig.cameras)
    for unit in plan.units:
        count = len(plan.dataset.annotation_indices(unit.sample.token))
        shown = [0.5 if index % 3 == 0 else 1.0 for index in range(count)]
        boxes = [Box2d(index % cameras, index, 100.0, 200.125, 300.5, 400.75) for index in range(count)]
        token = unit.token
        receipts[token] = Receipt(token, [1.0] * cameras, [200_000] * cameras, shown, 0, boxes)
    return receipts


def stage(name: str, folder: Path, written: Path) -> dict[str, Any]:
    started, began = time.perf_counter(), time.process_time()
    if name == "plan":
        planned(folder).digest  # noqa: B018 - the tables are hashed beside all else; wait for it
    elif name == "write":
        from unidrive_cli.convert.output_tables import OutputTables
        from unidrive_cli.tables.table import write_rows

        plan = planned(folder)
        plan.digest  # noqa: B018 - a conversion has waited for it before it converts
        receipts = receipts_of(plan)
        started, began = time.perf_counter(), time.process_time()
        written.mkdir(parents=True)
        tables = OutputTables(plan, receipts)
        tables.write(lambda table, rows: write_rows(written / f"{table}.json", rows))
    elif name == "check":
        from unidrive_cli.check.references import check_references
        from unidrive_cli.tables.dataset import open_dataset

        findings = list(check_references(open_dataset(written.parent)))
        assert not findings, findings[0]
    else:
        from nuscenes.nuscenes import NuScenes

        NuScenes(version="v1.0-trainval", dataroot=str(folder), verbose=False)
    return {
        "seconds": round(time.perf_counter() - started, 2),
        "cpu_seconds": round(time.process_time() - began, 2),
        "peak_gb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20, 2),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--stages", nargs="+", choices=STAGES, default=STAGES)
    parser.add_argument("--here", choices=STAGES, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    beside = arguments.folder.resolve().with_name(arguments.folder.name + "-written")
    written = beside / "v1.0-trainval"
    if arguments.here:
        print(json.dumps(stage(arguments.here, arguments.folder, written)))
        return
    shutil.rmtree(beside, ignore_errors=True)
    results = {}
    for name in arguments.stages:
        command = [sys.executable, __file__, str(arguments.folder), "--here", name]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
        results[name] = json.loads(done.stdout.splitlines()[-1])
    shutil.rmtree(beside, ignore_errors=True)
    print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
