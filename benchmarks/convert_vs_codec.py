"""CPU time of a whole sample against decoding and encoding the same number of pictures with OpenCV.

    python benchmarks/convert_vs_codec.py [--data FOLDER] [--rig RIG] [--rounds N] [--out FILE]

Runs `convert`'s own unit of work (files read, decoded, warped, encoded, masks, boxes, receipt, all
written) on the genuine nuScenes keyframe, in one process and one thread, interleaved with the floor:
six decodes and six encodes by OpenCV at the same JPEG quality and 4:2:0. Medians of CPU time; only the
ratios mean something. Prints one JSON object.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from unidrive_cli.convert.options import Options
from unidrive_cli.convert.plan import make_plan
from unidrive_cli.convert.units import Frame, Job, run_unit
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.tables.destination import Destination
from unidrive_cli.tables.rig_of_dataset import resolve_rig
from unidrive_cli.warp.remap import Source

SHARED = os.environ.get("UNIDRIVE_TEST_DATA") or Path(__file__).parents[1] / ".." / "shared" / "data"
DATA = Path(SHARED) / "nuscenes-onekeyframe"
QUALITY = 95


def codec_floor(frame: Frame) -> Callable[[], None]:
    """Decodes every source picture and encodes as many of the same size, with OpenCV."""
    files = [np.fromfile(path, np.uint8) for path in frame.paths]
    parameters = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]

    def run() -> None:
        for data in files:
            cv2.imencode(".jpg", cv2.imdecode(data, cv2.IMREAD_COLOR), parameters)

    return run


def unit_of_work(data: Path, rig: str, folder: Path, *, ego_motion: bool, masks: str) -> Callable[[], None]:
    """`convert`'s unit on the first sample; with ego motion the tables are built anew each time."""
    virtual_rig, _ = resolve_rig(rig)
    plan = make_plan(open_dataset(data), virtual_rig, Options(ego_motion=ego_motion, quality=QUALITY, masks=masks))
    job = Job(Destination(folder), virtual_rig, plan.options, plan.toolchain, plan.digest)
    job.destination.work.mkdir(parents=True)
    frame = plan.frame(plan.units[0])
    round_number = 0

    def run() -> None:
        nonlocal round_number
        round_number += 1
        run_unit(job, _moved(frame, 1e-6 * round_number) if ego_motion else frame)

    return run


def _moved(frame: Frame, metres: float) -> Frame:
    """The frame with its sources moved a hair, as every new sample moves them."""
    sources = []
    for source in frame.sources:
        cam_from_ego = source.cam_from_ego.copy()
        cam_from_ego[0, 3] += metres
        sources.append(Source(source.lens, cam_from_ego))
    return replace(frame, sources=tuple(sources))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--rig", default="roof-6x70")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--out", type=Path, help="also write the JSON there")
    chosen = parser.parse_args()
    if not chosen.data.is_dir():
        parser.error(
            f"{chosen.data} is not there: name a nuScenes-format dataset with --data, or set UNIDRIVE_TEST_DATA"
        )
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        cases = {
            "static, masks per picture": unit_of_work(
                chosen.data, chosen.rig, folder / "a", ego_motion=False, masks="frame"
            ),
            "static, no masks": unit_of_work(chosen.data, chosen.rig, folder / "b", ego_motion=False, masks="none"),
            "ego motion, masks per picture": unit_of_work(
                chosen.data, chosen.rig, folder / "c", ego_motion=True, masks="frame"
            ),
        }
        print(json.dumps(_measure(cases, chosen, folder), indent=1))


def _measure(cases: dict[str, Callable[[], None]], chosen: argparse.Namespace, scratch: Path) -> dict[str, object]:
    plan = make_plan(open_dataset(chosen.data), resolve_rig(chosen.rig)[0], Options())
    floor = codec_floor(plan.frame(plan.units[0]))
    milliseconds: dict[str, dict[str, float]] = {}
    for name, run in cases.items():
        seconds: tuple[list[float], list[float]] = ([], [])
        for warm_up in (run, run, floor):  # the worker keeps one plan's tables, so each case has its own turn
            warm_up()
        for _ in range(chosen.rounds):
            for path in scratch.rglob("*.*g"):  # a conversion does not overwrite pictures either
                path.unlink()
            for action, times in zip((floor, run), seconds, strict=True):
                start = time.process_time()
                action()
                times.append(time.process_time() - start)
        codec, unit = (1e3 * statistics.median(times) for times in seconds)
        milliseconds[name] = {
            "codec_ms": round(codec, 1),
            "unit_ms": round(unit, 1),
            "ratio": round(unit / codec, 2),
        }
    result: dict[str, object] = {"opencv": cv2.__version__, "rounds": chosen.rounds, "cases": milliseconds}
    if chosen.out:
        chosen.out.write_text(json.dumps(result, indent=1) + "\n")
    return result


if __name__ == "__main__":
    main()
