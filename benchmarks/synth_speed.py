"""Pictures a second of `unidrive synth`: 1600x900, 4 samples a pixel, everything included (boxes, lidar, files).

    python benchmarks/synth_speed.py [--renderer auto|gl|rays] [--keyframes N] [--jobs N]

Two scenes through 6x60, so that two workers have one each. Prints one JSON object: pictures a second of the whole
run, and of the pictures alone, one process after its scene was made.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.synth.options import SynthOptions
from unidrive_cli.synth.renderers import open_renderer
from unidrive_cli.synth.run import make_synth_plan, synthesise
from unidrive_cli.synth.scene import SHOWN_WITHIN_M, make_scene
from unidrive_cli.synth.stage import View


def pictures_alone(renderer: str, moments: int) -> dict[str, float]:
    """One process; each picture with its instance picture, the cameras at different times."""
    scene = make_scene(SynthOptions(keyframes=20), 0)
    drawing = open_renderer(scene.stage, renderer)  # type: ignore[arg-type]
    cameras = load_gallery_rig("6x60").cameras
    clocks = []
    for step in range(moments * len(cameras)):
        camera = cameras[step % len(cameras)]
        time_us = scene.start_us + 500_000 * (step // len(cameras)) + 8_000 * (step % len(cameras))
        ego, actors = scene.global_from_ego(time_us), scene.global_from_actors(time_us)
        shown = np.linalg.norm(actors[:, :2, 3] - ego[:2, 3], axis=1) < SHOWN_WITHIN_M
        view = View(camera.lens, ego @ camera.ego_from_cam, actors, shown)
        started = time.perf_counter(), time.process_time()
        drawing.picture(view, 4)
        drawing.instances(view)
        clocks.append((time.perf_counter() - started[0], time.process_time() - started[1]))
    drawing.close()
    wall, cpu = np.mean(clocks[1:], axis=0)
    return {"wall_s": round(float(wall), 3), "cpu_s": round(float(cpu), 3), "per_second": round(float(1 / wall), 2)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--renderer", default="auto", choices=("auto", "gl", "rays"))
    parser.add_argument("--keyframes", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    chosen = parser.parse_args()
    options = SynthOptions(scenes=2, keyframes=chosen.keyframes)
    plan = make_synth_plan(options, [load_gallery_rig("6x60")], chosen.renderer)
    alone = pictures_alone(chosen.renderer, 3)
    with tempfile.TemporaryDirectory() as scratch:
        started = time.monotonic()
        (summary,) = synthesise(plan, Path(scratch) / "out", jobs=chosen.jobs)
        seconds = time.monotonic() - started
    result = {
        "renderer": plan.renderer_name,
        "cores": os.cpu_count(),
        "picture and instances": alone,
        "whole run": {
            "pictures": summary.pictures,
            "seconds": round(seconds, 1),
            "per_second": round(summary.pictures / seconds, 2),
        },
    }
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
