"""How near the warp comes to pictures rendered directly through the virtual rig: the table of docs/fidelity.md.

    python benchmarks/fidelity.py [--scenes N] [--keyframes N] [--seed N] [--jobs N] [--work FOLDER] [--out FILE]

Renders one synthetic drive through the paper's eight rigs (cameras firing as nuScenes' do) and directly
through roof-6x70 (all cameras at the sample's time), then measures what each rig's pictures give through
roof-6x70, for several depth limits, both blends, with and without ego motion. The floor of resampling is a
camera that only turns: the virtual camera stands where the source stands, at 16 samples a pixel.
Prints Markdown tables; --out writes all figures as JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from pathlib import Path
from typing import Any

from unidrive_cli.measure.truth import measure_rendered
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.rig.model import Rig
from unidrive_cli.rig.yaml_file import parse_rig
from unidrive_cli.synth.options import SynthOptions
from unidrive_cli.synth.run import make_synth_plan, synthesise
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.warp.choices import WarpChoices

PAPER = ("4x95", "5x75", "6x80a", "6x80b", "6x70", "6x60", "8x50", "5x70+110")
VIRTUAL = "roof-6x70"
DEPTHS_M = (20.0, 35.0, 50.0, 80.0, 120.0)
REGIONS = ("overall", "ground", "objects", "seams")
TURNED = """
name: {name}
cameras:
  CAM_FRONT: {{width: 1600, height: 900, hfov: {hfov}, position: [1.5, 0, 1.6], yaw: {yaw}, pitch: {pitch}}}
"""


def render(options: SynthOptions, rigs: list[Rig], folder: Path, jobs: int) -> None:
    synthesise(make_synth_plan(options, rigs, "auto"), folder, jobs=jobs)


def figures(source: Path, rig: Rig, truth: Path, choices: WarpChoices, jobs: int) -> dict[str, Any]:
    document = measure_rendered(open_dataset(source), rig, choices, open_dataset(truth), jobs=jobs).document()
    whole = {**document["truth"], "covered": document["covered"]}
    whole.pop("by_camera")
    return whole


def settings() -> dict[str, WarpChoices]:
    named = {f"D0 = {depth:g} m": WarpChoices(depth_limit_m=depth) for depth in DEPTHS_M}
    return {**named, "nearest": WarpChoices(blend="nearest"), "no ego motion": WarpChoices(ego_motion=False)}


def measured(options: SynthOptions, work: Path, jobs: int) -> dict[str, Any]:
    virtual = load_gallery_rig(VIRTUAL)
    together = {"seed": options.seed, "scenes": options.scenes, "keyframes": options.keyframes, "firing": "together"}
    render(SynthOptions(**together, instances=True), [virtual], work / "truth", jobs)
    render(options, [load_gallery_rig(name) for name in PAPER], work / "rigs", jobs)
    source, turned = (
        parse_rig(TURNED.format(name=name, hfov=hfov, yaw=yaw, pitch=pitch), name)
        for name, hfov, yaw, pitch in (("floor-source", 100, 0, 0), ("floor-truth", 70, 8, -2))
    )
    exact = SynthOptions(**together, instances=True, samples_per_pixel=16)
    render(exact, [source, turned], work / "floor", jobs)
    floor = figures(work / "floor" / source.name, turned, work / "floor" / turned.name, WarpChoices(), jobs)
    rigs = {
        name: {
            setting: figures(work / "rigs" / name, virtual, work / "truth", choices, jobs)
            for setting, choices in settings().items()
        }
        for name in PAPER
    }
    return {"virtual": VIRTUAL, "options": options.identity(), "floor": floor, "rigs": rigs}


def cell(region: dict[str, Any] | None) -> str:
    return "-" if region is None or region["psnr"] is None else f"{region['psnr']:.1f} / {region['ssim']:.3f}"


def overall_of(found: dict[str, Any]) -> dict[str, Any]:
    return {"overall": {"psnr": found["psnr"], "ssim": found["ssim"]}, **{r: found.get(r) for r in REGIONS[1:]}}


def tables(results: dict[str, Any]) -> str:
    lines = ["| source rig | covered | " + " | ".join(REGIONS) + " |", "| --- | --- | " + "--- | " * len(REGIONS)]
    floor = overall_of(results["floor"])
    lines.append("| *floor: only turned* | | " + " | ".join(cell(floor[region]) for region in REGIONS) + " |")
    for name, found in results["rigs"].items():
        default = found["D0 = 50 m"]
        cells = " | ".join(cell(overall_of(default)[region]) for region in REGIONS)
        lines.append(f"| {name} | {default['covered']:.1%} | {cells} |")
    lines += ["", "| mean of the eight rigs | " + " | ".join(REGIONS) + " |", "| --- | " + "--- | " * len(REGIONS)]
    for setting in settings():
        cells = []
        for region in REGIONS:
            values = [overall_of(found[setting])[region] for found in results["rigs"].values()]
            values = [value for value in values if value and value["psnr"] is not None]
            psnr, ssim = (sum(value[key] for value in values) / len(values) for key in ("psnr", "ssim"))
            cells.append(f"{psnr:.2f} / {ssim:.4f}")
        lines.append(f"| {setting} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=3)
    parser.add_argument("--keyframes", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--work", type=Path, help="keep the rendered drives there; a rerun continues")
    parser.add_argument("--out", type=Path, help="write the figures there as JSON")
    chosen = parser.parse_args()
    options = SynthOptions(seed=chosen.seed, scenes=chosen.scenes, keyframes=chosen.keyframes)
    with tempfile.TemporaryDirectory() as scratch:
        results = measured(options, chosen.work or Path(scratch), chosen.jobs)
    if chosen.out:
        chosen.out.write_text(json.dumps(results, indent=1) + "\n")
    print(tables(results))


if __name__ == "__main__":
    main()
