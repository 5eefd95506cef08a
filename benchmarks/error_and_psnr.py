"""Does a lower projection error mean a better picture? The table of docs/measure.md.

    python benchmarks/error_and_psnr.py [--rigs N] [--scenes N] [--keyframes N] [--seed N] [--jobs N] [--work FOLDER]
                                        [--out FILE]

Draws random virtual rigs of six cameras (places, yaws, field of view, depth limit), renders one synthetic drive
through one source rig (cameras firing as nuScenes' do) and directly through each of them (all at the sample's
time), and compares each rig's projection error on the drive's boxes with the PSNR of what the source's pictures
give through it. Prints Spearman's rank correlations, with intervals of 95 % from resampled rigs: as they are, and
with the ranks of depth limit and field of view held fixed (partial correlations). --out writes all figures as JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import rankdata

from unidrive_cli.measure.projection import measure_projection
from unidrive_cli.measure.truth import measure_rendered
from unidrive_cli.rig.model import Rig
from unidrive_cli.rig.yaml_file import parse_rig
from unidrive_cli.synth.options import SynthOptions
from unidrive_cli.synth.run import make_synth_plan, synthesise
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.warp.choices import WarpChoices

CHANNELS = {
    "CAM_FRONT": 0,
    "CAM_FRONT_LEFT": 60,
    "CAM_FRONT_RIGHT": -60,
    "CAM_BACK": 180,
    "CAM_BACK_LEFT": 120,
    "CAM_BACK_RIGHT": -120,
}
SIZE_PX = (400, 225)
HELD: tuple[tuple[str, ...], ...] = ((), ("depth_limit_m",), ("depth_limit_m", "hfov_deg"))
ERRORS = ("blended", "pairs")
REGIONS = ("overall", "objects")
RESAMPLED = 5000
SOURCE = """
name: source
cameras:
  CAM_FRONT: {width: 400, height: 225, hfov: 64.6, position: [1.70, 0.02, 1.51], yaw: 0}
  CAM_FRONT_LEFT: {width: 400, height: 225, hfov: 64.4, position: [1.52, 0.49, 1.51], yaw: 55}
  CAM_FRONT_RIGHT: {width: 400, height: 225, hfov: 64.8, position: [1.55, -0.49, 1.50], yaw: -56}
  CAM_BACK_LEFT: {width: 400, height: 225, hfov: 64.9, position: [1.04, 0.48, 1.59], yaw: 109}
  CAM_BACK_RIGHT: {width: 400, height: 225, hfov: 64.8, position: [1.01, -0.48, 1.56], yaw: -111}
  CAM_BACK: {width: 400, height: 225, hfov: 89.4, position: [0.03, 0, 1.58], yaw: 180}
"""


def random_rig(number: int, rng: np.random.Generator) -> Rig:
    """Six cameras that look outward from a ring, each a little off; with a depth limit."""
    width, height = SIZE_PX
    middle, radius = np.array([rng.uniform(0, 2), rng.uniform(-0.2, 0.2), rng.uniform(1.65, 2.1)]), rng.uniform(0, 1)
    hfov, lines = rng.uniform(62, 85), [f"name: random-{number:02d}", "cameras:"]
    for channel, yaw in CHANNELS.items():
        turned = yaw + rng.uniform(-8, 8)
        outward = np.array([np.cos(np.radians(yaw)), np.sin(np.radians(yaw)), 0.0])
        place = [
            round(value, 3) for value in (middle + radius * outward + rng.normal(0, [0.08, 0.08, 0.03])).tolist()
        ]
        size = f"width: {width}, height: {height}, hfov: {hfov:.2f}"
        lines.append(f"  {channel}: {{{size}, position: {place}, yaw: {turned:.2f}}}")
    lines.append(f"depth_limit: {np.exp(rng.uniform(np.log(12), np.log(100))):.1f}")
    return parse_rig("\n".join(lines) + "\n", f"random-{number:02d}")


def figures(source: Path, rig: Rig, truth: Path, depth_m: float, jobs: int) -> dict[str, Any]:
    choices, dataset = WarpChoices(depth_limit_m=depth_m), open_dataset(source)
    error = measure_projection([dataset], rig, choices).document()
    fidelity = measure_rendered(dataset, rig, choices, open_dataset(truth), jobs=jobs).document()
    return {
        "depth_limit_m": depth_m,
        "error": {name: error[name]["mean"] for name in ERRORS},
        "uncovered": error["uncovered"]["count"] / error["uncovered"]["of"],
        "psnr": {"overall": fidelity["truth"]["psnr"], "objects": fidelity["truth"]["objects"]["psnr"]},
        "covered": fidelity["covered"],
    }


def correlation(
    rigs: list[dict[str, Any]], error: str, region: str, held: tuple[str, ...], seed: int
) -> dict[str, float]:
    """Spearman's rho of the rigs' errors and PSNR, the ranks of what is held taken out of both; and its interval."""
    columns = [[one["error"][error], one["psnr"][region], *(one[name] for name in held)] for one in rigs]
    rows, rng = np.array(columns, dtype=np.float64), np.random.default_rng(seed)

    def rho(some: np.ndarray) -> float:
        ranks = rankdata(some, axis=0)
        known = np.column_stack([np.ones(len(ranks)), ranks[:, 2:]])
        left = ranks[:, :2] - known @ np.linalg.lstsq(known, ranks[:, :2], rcond=None)[0]
        return float(np.corrcoef(left.T)[0, 1])

    draws = [rho(rows[rng.integers(0, len(rows), len(rows))]) for _ in range(RESAMPLED)]
    low, high = np.nanquantile(draws, [0.025, 0.975])
    return {"rho": round(rho(rows), 3), "low": round(float(low), 3), "high": round(float(high), 3)}


def measured(chosen: argparse.Namespace, work: Path) -> dict[str, Any]:
    rng = np.random.default_rng(chosen.seed)
    rigs = [random_rig(number, rng) for number in range(chosen.rigs)]
    drive = {"seed": chosen.seed, "scenes": chosen.scenes, "keyframes": chosen.keyframes}
    source = parse_rig(SOURCE, "source")
    synthesise(make_synth_plan(SynthOptions(**drive), [source], "auto"), work / "source", jobs=chosen.jobs)
    together = SynthOptions(**drive, firing="together", instances=True)
    synthesise(make_synth_plan(together, rigs, "auto"), work / "truth", jobs=chosen.jobs)
    found: list[dict[str, Any]] = []
    for rig in rigs:
        truth = work / "truth" / (rig.name if len(rigs) > 1 else "")
        own = figures(work / "source", rig, truth, rig.depth_limit_m or 50.0, chosen.jobs)
        found.append({"rig": rig.name, "hfov_deg": rig.cameras[0].pinhole.hfov_deg, **own})
    correlations = {
        " and ".join(held) or "nothing": {
            error: {region: correlation(found, error, region, held, chosen.seed) for region in REGIONS}
            for error in ERRORS
        }
        for held in HELD
    }
    return {"drive": drive, "rigs": found, "correlations": correlations}


def table(results: dict[str, Any]) -> str:
    lines = ["| held fixed | error (mean) | PSNR overall | PSNR of objects |", "| --- | --- | --- | --- |"]
    for name, by_error in results["correlations"].items():
        for error, by_region in by_error.items():
            cells = (f"{one['rho']:+.2f} ({one['low']:+.2f} to {one['high']:+.2f})" for one in by_region.values())
            lines.append(f"| {name} | {error} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rigs", type=int, default=24)
    parser.add_argument("--scenes", type=int, default=2)
    parser.add_argument("--keyframes", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--work", type=Path, help="keep the rendered drives there; a rerun continues")
    parser.add_argument("--out", type=Path, help="write the figures there as JSON")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        results = measured(chosen, chosen.work or Path(scratch))
    if chosen.out:
        chosen.out.write_text(json.dumps(results, indent=1) + "\n")
    print(table(results))


if __name__ == "__main__":
    main()
