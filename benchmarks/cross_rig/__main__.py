"""Runs the benchmark, piece by piece; the same command continues.

    python -m benchmarks.cross_rig quick|full [--work FOLDER] [--workers N] [--all-eight] [--known FILE.json]

FOLDER gets `data/` (rendered and converted drives), `weights/` and `results/`: one JSON file for each detector on
each rig. `python -m benchmarks.cross_rig.report FOLDER` makes tables and figures of what is there. FILE has results
that need not be measured again, as the report's `--json` writes them.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from benchmarks.cross_rig.config import full, quick
from benchmarks.cross_rig.run import run, unpack


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("size", choices=("quick", "full"))
    parser.add_argument("--work", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--all-eight", action="store_true", help="train on all eight rigs, not on the paper's four")
    parser.add_argument("--known", type=Path, metavar="FILE.json", help="results that are there already")
    chosen = parser.parse_args()
    config = quick() if chosen.size == "quick" else full(chosen.all_eight)
    work = chosen.work or Path(f"cross-rig-{config.name}")
    if chosen.known:
        unpack(work, json.loads(chosen.known.read_text()))
    run(work, config, chosen.workers)


if __name__ == "__main__":
    main()
