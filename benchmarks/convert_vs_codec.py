"""CPU time of a whole sample against decoding and encoding the same number of pictures with OpenCV.

    python benchmarks/convert_vs_codec.py [--data FOLDER] [--rig RIG] [--rounds N] [--out FILE]

Runs `convert`'s own unit of work (files read, decoded, warped, encoded, masks, boxes, receipt, all written)
on the genuine nuScenes keyframe, in one process and one thread, interleaved with the floor: six decodes and
six encodes by OpenCV at the same JPEG quality and 4:2:0. With ego motion the sources move a hair from round
to round, as every new sample moves them. `straightforward` is what most people write: remaps of all pairs
with float maps, made beforehand, and a float blend. Medians of CPU time; only ratios mean something. Prints
one JSON object.

The C library keeps freed memory in all cases: otherwise OpenCV's decoder takes new pages for every picture,
which makes the floor up to 1.6 times slower in some processes and not in others.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import ctypes
import json
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from unidrive_cli.convert.boxes import seen_boxes
from unidrive_cli.convert.options import Options
from unidrive_cli.convert.plan import Plan, make_plan
from unidrive_cli.convert.units import Frame, Job, run_unit
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.tables.destination import Destination
from unidrive_cli.tables.rig_of_dataset import resolve_rig
from unidrive_cli.warp import turbojpeg
from unidrive_cli.warp.pictures import encode_mask
from unidrive_cli.warp.remap import Source, VirtualView, virtual_views
from unidrive_cli.warp.render import choose_toolchain

SHARED = os.environ.get("UNIDRIVE_TEST_DATA") or Path(__file__).parents[1] / ".." / "shared" / "data"
DATA = Path(SHARED) / "nuscenes-onekeyframe"
QUALITY = 95
JPEG = [cv2.IMWRITE_JPEG_QUALITY, QUALITY]

Action = Callable[[], object]


def codec_floor(frame: Frame) -> Action:
    """Decodes every source picture and encodes as many of the same size, with OpenCV."""
    files = [np.fromfile(path, np.uint8) for path in frame.paths]

    def run() -> None:
        for data in files:
            cv2.imencode(".jpg", cv2.imdecode(data, cv2.IMREAD_COLOR), JPEG)

    return run


def unit_of_work(plan: Plan, folder: Path, *, moving: bool) -> Action:
    """`convert`'s unit on the first sample."""
    job = Job(Destination(folder), plan.rig, plan.options, plan.toolchain, plan.digest)
    job.destination.work.mkdir(parents=True)
    frame = plan.frame(plan.units[0])
    round_number = 0

    def run() -> None:
        nonlocal round_number
        round_number += 1
        run_unit(job, moved(frame, 1e-6 * round_number) if moving else frame)

    return run


def moved(frame: Frame, metres: float) -> Frame:
    """The frame with its sources moved a hair."""
    sources = []
    for source in frame.sources:
        cam_from_ego = source.cam_from_ego.copy()
        cam_from_ego[0, 3] += metres
        sources.append(replace(source, cam_from_ego=cam_from_ego))
    return replace(frame, sources=tuple(sources))


def straightforward(plan: Plan) -> Action:
    """Decode, remap every pair with float maps, blend in float32, encode."""
    frame = plan.frame(plan.units[0])
    tables = []
    for view in virtual_views(plan.rig, plan.options.depth_limit_m, plan.options.ground_height_m):
        pairs = [float_maps(view, source) for source in frame.sources]
        total = np.maximum(sum(weight for _, _, weight in pairs), 1e-9)
        tables.append([(x, y, (weight / total)[..., None]) for x, y, weight in pairs])

    def run() -> None:
        pictures = [cv2.imread(path, cv2.IMREAD_COLOR) for path in frame.paths]
        for pairs in tables:
            blended = np.zeros((*pairs[0][0].shape, 3), np.float32)
            for picture, (x, y, weight) in zip(pictures, pairs, strict=True):
                blended += cv2.remap(picture, x, y, cv2.INTER_LINEAR) * weight
            cv2.imencode(".jpg", np.rint(blended).astype(np.uint8), JPEG)

    return run


def float_maps(view: VirtualView, source: Source) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Source coordinates (H, W) float32, and a weight that falls to the picture's border."""
    points = view.points(source.cam_from_ego, slice(None), slice(None))
    pixels, valid = source.lens.project(points)
    x, y = np.where(valid, np.moveaxis(pixels, -1, 0), -1.0).astype(np.float32)
    return x, y, (np.maximum(source.lens.border_sine(points), 1e-4) * valid).astype(np.float32)


def stages(plan: Plan) -> dict[str, Action]:
    """The parts of a unit with the fused kernel, each alone."""
    from unidrive_cli.warp.planar import Atlas, Canvas
    from unidrive_cli.warp.turbojpeg import TurboJpeg

    frame = plan.frame(plan.units[0])
    turbo = TurboJpeg() if turbojpeg.found() else None
    atlas = Atlas(tuple((source.lens.width_px, source.lens.height_px) for source in frame.sources))
    canvases = [Canvas(view) for view in virtual_views(plan.rig, 50.0, 0.0)]

    def load() -> None:
        for index, path in enumerate(frame.paths):
            atlas.load(index, Path(path), turbo)

    def draw() -> None:
        for canvas in canvases:
            canvas.draw(atlas, frame.sources, nearest=False)

    def encode() -> None:
        for canvas in canvases:
            if turbo:
                turbo.encode(canvas.planes, QUALITY)

    views = [(canvas.view.camera, canvas.mask) for canvas in canvases]
    return {
        "read and decode": load,
        "warp and blend": draw,
        "encode": encode,
        "boxes": lambda: seen_boxes(frame.ego_from_box, frame.box_sizes_m, frame.witnesses, views),
        "masks as PNG": lambda: [encode_mask(canvas.mask) for canvas in canvases],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--rig", default="roof-6x70")
    parser.add_argument("--rounds", type=int, default=21)
    parser.add_argument("--out", type=Path, help="also write the JSON there")
    chosen = parser.parse_args()
    if not chosen.data.is_dir():
        parser.error(
            f"{chosen.data} is not there: name a nuScenes-format dataset with --data, or set UNIDRIVE_TEST_DATA"
        )
    cv2.setNumThreads(1)
    _keep_freed_memory()
    with tempfile.TemporaryDirectory() as scratch:
        result = _measure(chosen, Path(scratch))
    text = json.dumps(result, indent=1)
    print(text)
    if chosen.out:
        chosen.out.write_text(text + "\n")


def _measure(chosen: argparse.Namespace, scratch: Path) -> dict[str, object]:
    rig, _ = resolve_rig(chosen.rig)
    dataset = open_dataset(chosen.data)

    def plan(**options: object) -> Plan:
        return make_plan(dataset, rig, Options(quality=QUALITY, **options))

    floor = codec_floor(plan().frame(plan().units[0]))
    cases: dict[str, Action] = {}
    kernels: list[dict[str, str]] = [{"kernel": "opencv"}]
    if choose_toolchain().kernel == "numba":
        codecs = ["libturbojpeg", "simplejpeg"] if turbojpeg.found() else ["simplejpeg"]
        kernels = [*({"kernel": "numba", "codec": codec} for codec in codecs), *kernels]
    for tools in kernels:
        name = " + ".join(tools.values())
        cases[f"{name}, static, no masks"] = unit_of_work(
            plan(masks="none", ego_motion=False, **tools), scratch / f"{name} s", moving=False
        )
        if tools["kernel"] == "numba":
            for masks in ("none", "frame"):
                cases[f"{name}, ego motion, masks {masks}"] = unit_of_work(
                    plan(masks=masks, **tools), scratch / f"{name} {masks}", moving=True
                )
    cases["straightforward OpenCV, static, no masks"] = straightforward(plan(kernel="opencv"))
    if choose_toolchain().kernel == "numba":
        cases |= {f"stage: {name}": action for name, action in stages(plan()).items()}
    milliseconds = {name: _against(floor, run, chosen.rounds, scratch) for name, run in cases.items()}
    return {"opencv": cv2.__version__, "rounds": chosen.rounds, "cases": milliseconds}


def _against(floor: Action, run: Action, rounds: int, scratch: Path) -> dict[str, float]:
    seconds: tuple[list[float], list[float]] = ([], [])
    for warm_up in (run, run, floor):  # the worker keeps one plan's renderer, so each case has its own turn
        warm_up()
    for _ in range(rounds):
        for path in scratch.rglob("*.*g"):  # a conversion does not overwrite pictures either
            path.unlink()
        for action, times in zip((floor, run), seconds, strict=True):
            start = time.process_time()
            action()
            times.append(time.process_time() - start)
    codec, unit = (1e3 * statistics.median(times) for times in seconds)
    ratios = [after / before for before, after in zip(*seconds, strict=True)]
    return {"floor_ms": round(codec, 1), "ms": round(unit, 1), "ratio": round(statistics.median(ratios), 2)}


def _keep_freed_memory() -> None:
    trim_threshold, mmap_threshold = -1, -3
    libc = ctypes.CDLL(None)
    libc.mallopt(trim_threshold, 2**31 - 1)
    libc.mallopt(mmap_threshold, 2**30)


if __name__ == "__main__":
    main()
