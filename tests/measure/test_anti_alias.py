"""Anti-aliasing against the synthetic truth: a virtual camera that only turns, so that nothing but sampling errs."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path
from typing import Any

from unidrive_cli.measure.truth import measure_rendered
from unidrive_cli.rig.model import Rig
from unidrive_cli.rig.yaml_file import parse_rig
from unidrive_cli.synth.options import SynthOptions
from unidrive_cli.synth.run import make_synth_plan, synthesise
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.warp.choices import WarpChoices


def rig(name: str, times: int, hfov_deg: float, yaw_deg: float) -> Rig:
    """One camera at the same place; of `times` as many pixels along each side."""
    camera = (
        f"{{width: {times * 192}, height: {times * 108}, hfov: {hfov_deg}, position: [1.5, 0, 1.6], yaw: {yaw_deg}}}"
    )
    return parse_rig(f"name: {name}\ncameras:\n  CAM_FRONT: {camera}\n", f"{name}.yaml")


VIRTUAL = rig("virtual", 1, 60, 4)


@functools.cache
def drive() -> Path:
    """A moment through a camera of the virtual one's pixels, one of pixels a third as large, and the virtual one."""
    root = Path(tempfile.mkdtemp())
    options = SynthOptions(scenes=1, keyframes=1, firing="together", samples_per_pixel=4)
    synthesise(make_synth_plan(options, [rig("alike", 1, 60, 0), rig("finer", 3, 60, 0), VIRTUAL], "auto"), root)
    return root


def figures(source: str, *, anti_alias: bool) -> dict[str, Any]:
    root = drive()
    choices = WarpChoices(anti_alias=anti_alias)
    report = measure_rendered(open_dataset(root / source), VIRTUAL, choices, open_dataset(root / "virtual"))
    found: dict[str, Any] = report.document()["truth"]
    return found


def test_a_source_three_times_as_fine_is_nearer_to_the_truth() -> None:
    before, after = (figures("finer", anti_alias=chosen) for chosen in (False, True))
    assert after["psnr"] >= before["psnr"] + 2.5
    assert after["ssim"] >= before["ssim"] + 0.012


def test_where_nothing_is_shrunk_nothing_changes() -> None:
    assert figures("alike", anti_alias=True) == figures("alike", anti_alias=False)
