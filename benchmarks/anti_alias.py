"""What anti-aliasing gains and costs: the tables of docs/fidelity.md and docs/performance.md.

    python benchmarks/anti_alias.py gain [--work FOLDER]
    python benchmarks/anti_alias.py cost [--data FOLDER] [--rounds N]

`gain` renders one synthetic moment through cameras whose pixels are up to four times as fine as those of a virtual
camera that stands where they stand and only turns, and compares with the truth, 16 samples a pixel: without copies,
with the copy that is chosen, and with one that is as small as the source is shrunk.
`cost` runs `convert`'s unit of work on a dataset with a telephoto camera into two rigs, with and without, in turn,
in one process; medians of CPU time.
"""

from __future__ import annotations

import argparse
import math
import os
import statistics
import tempfile
import time
from pathlib import Path

import cv2

from unidrive_cli.convert.options import Options
from unidrive_cli.convert.plan import make_plan
from unidrive_cli.convert.units import Job, run_unit
from unidrive_cli.measure.truth import measure_rendered
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.rig.model import Rig
from unidrive_cli.rig.yaml_file import parse_rig
from unidrive_cli.synth.options import SynthOptions
from unidrive_cli.synth.run import make_synth_plan, synthesise
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.tables.destination import Destination
from unidrive_cli.warp import reduction
from unidrive_cli.warp.choices import WarpChoices

SHARED = os.environ.get("UNIDRIVE_TEST_DATA") or Path(__file__).parents[1] / ".." / "shared" / "data"
FACTORS = (1.0, 1.6, 2.0, 2.4, 3.0, 4.0)
WIDTH, HEIGHT, HFOV_DEG, SOURCE_HFOV_DEG = 480, 270, 70, 84
RIGS = ("6x80a", "4x95")


def rig(name: str, width: int, height: int, hfov_deg: float, yaw_deg: float, pitch_deg: float) -> Rig:
    camera = f"{{width: {width}, height: {height}, hfov: {hfov_deg}, position: [1.5, 0, 1.6]"
    return parse_rig(f"name: {name}\ncameras:\n  CAM_FRONT: {camera}, yaw: {yaw_deg}, pitch: {pitch_deg}}}\n", name)


def gain(work: Path) -> None:
    truth = rig("truth", WIDTH, HEIGHT, HFOV_DEG, 4, -1)
    focal_px = WIDTH / 2 / math.tan(math.radians(HFOV_DEG / 2))
    sources = []
    for factor in FACTORS:
        width = round(2 * focal_px * factor * math.tan(math.radians(SOURCE_HFOV_DEG / 2)))
        sources.append(rig(f"finer-{factor:g}", width, round(width * 9 / 16), SOURCE_HFOV_DEG, 0, 0))
    options = SynthOptions(scenes=1, keyframes=1, firing="together", samples_per_pixel=16, quality=100)
    synthesise(make_synth_plan(options, [*sources, truth], "auto"), work)
    chosen = reduction.reduction_of
    print("| shrunk | no copy | the copy that is chosen | a copy as small |\n| --- | --- | --- | --- |")
    for source, factor in zip(sources, FACTORS, strict=True):
        cells = []
        for n in (1.0, chosen(factor), float(round(factor))):
            reduction.reduction_of = lambda _, n=n: n
            report = measure_rendered(
                open_dataset(work / source.name), truth, WarpChoices(), open_dataset(work / "truth")
            )
            found = report.document()["truth"]
            cells.append(f"{found['psnr']:.1f} / {found['ssim']:.4f} (n = {n:g})")
        print(f"| {factor:g} | {' | '.join(cells)} |", flush=True)


def cost(data: Path, rounds: int) -> None:
    cv2.setNumThreads(1)
    dataset = open_dataset(data)
    for name in RIGS:
        seconds: tuple[list[float], list[float]] = ([], [])
        with tempfile.TemporaryDirectory() as scratch:
            units = []
            for chosen in (False, True):
                plan = make_plan(dataset, load_gallery_rig(name), Options(anti_alias=chosen))
                job = Job(
                    Destination(Path(scratch) / str(chosen)), plan.rig, plan.options, plan.toolchain, plan.digest
                )
                job.destination.work.mkdir(parents=True)
                units.append((job, plan.frame(plan.units[0])))
            for _ in range(rounds):
                for (job, frame), times in zip(units, seconds, strict=True):
                    run_unit(job, frame)  # another plan's turn: its renderer is opened
                    start = time.process_time()
                    run_unit(job, frame)
                    times.append(time.process_time() - start)
        plain, smooth = (statistics.median(times) for times in seconds)
        least = [min(times) for times in seconds]
        print(
            f"{name}: {smooth / plain:.3f} times the CPU time (of the least: {least[1] / least[0]:.3f})", flush=True
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("gain", "cost"))
    parser.add_argument("--work", type=Path, help="keep the rendered moment there")
    parser.add_argument("--data", type=Path, default=Path(SHARED) / "dgp-tri-2scenes")
    parser.add_argument("--rounds", type=int, default=15)
    chosen = parser.parse_args()
    if chosen.what == "cost":
        cost(chosen.data, chosen.rounds)
        return
    with tempfile.TemporaryDirectory() as scratch:
        gain(chosen.work or Path(scratch))


if __name__ == "__main__":
    main()
