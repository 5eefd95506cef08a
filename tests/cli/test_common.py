"""`convert --common-with` and fleet files: what is blackened, the same for every car, whatever the kernel."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.datasets import SMALL_RIG, Bench, rows, spawn, tree, unidrive
from unidrive_cli.rig.yaml_file import parse_rig
from unidrive_cli.rig.yaml_writing import dump_rig
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.tables.rig_of_dataset import rig_of_dataset
from unidrive_cli.warp.common import common_masks
from unidrive_cli.warp.remap import virtual_views

FRONT = """\
name: front
cameras:
  CAM_FRONT: {width: 320, height: 180, hfov: 50, position: [1.5, 0, 1.6], yaw: 0}
  CAM_BACK: {width: 320, height: 180, hfov: 100, position: [0, 0, 1.6], yaw: 180}
"""


LARGER = SMALL_RIG.replace("width: 64, height: 36", "width: 320, height: 180")


@pytest.fixture
def front(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rigs") / "front.yaml"
    path.write_text(FRONT)
    return path


def expected_masks(bench: Bench, *others: Path, virtual: str = SMALL_RIG) -> dict[str, np.ndarray]:
    rigs = [rig_of_dataset(open_dataset(bench.src))[0], *(parse_rig(path.read_text(), "") for path in others)]
    rig = parse_rig(virtual, "")
    masks = common_masks(virtual_views(rig, 50.0, 0.0), rigs, 1.0).masks()
    return dict(zip(rig.channels, masks, strict=True))


@pytest.mark.parametrize("kernel", ["numba", "opencv"])
def test_pictures_masks_and_boxes_hold_only_what_is_common(kernel: str, bench: Bench, front: Path) -> None:
    if kernel == "numba":
        pytest.importorskip("numba", reason="the extra `fast` is not installed")
    bench.rig.write_text(LARGER)
    bench.converted("--common-with", front, "--kernel", kernel)
    alone = bench.folder / "alone"
    bench.converted("--kernel", kernel, dst=alone)
    common = expected_masks(bench, front, virtual=LARGER)
    blackened = blackened_blocks = 0
    for path in sorted((bench.dst / "masks").rglob("*.png")):
        mask, whole = (cv2.imread(str(root / path.relative_to(bench.dst)), 0) for root in (bench.dst, alone))
        expected = np.where(common[path.parent.name] > 0, whole, 0)
        np.testing.assert_array_equal(mask > 0, expected > 0)
        blackened += np.count_nonzero((whole > 0) & (mask == 0))
        name = f"samples/{path.parent.name}/{path.stem}.jpg"
        picture, before = (cv2.imread(str(root / name)).astype(int) for root in (bench.dst, alone))
        inside, outside = (cv2.erode(part.astype(np.uint8), np.ones((33, 33))) > 0 for part in (mask > 0, mask == 0))
        # a JPEG block, or two for the colours, away from the border all is as it was, or black
        assert picture[outside].max(initial=0) <= 4
        assert np.abs(picture - before)[inside].max() <= 4
        blackened_blocks += np.count_nonzero(outside & (whole > 0))
    assert blackened > blackened_blocks > 1000
    boxes, before_boxes = (rows(root, "image_annotations") for root in (bench.dst, alone))
    assert 0 < len(boxes) < len(before_boxes)
    document = json.loads((bench.dst / "unidrive.json").read_text())
    assert [rig.split()[0] for rig in document["plan"]["options"]["common_with"]] == ["front", "src"]
    training = (bench.dst / "TRAINING.md").read_text()
    assert "Pictures show only what all of front, src can fill: CAM_FRONT " in training


def test_jobs_change_nothing_and_parts_come_to_the_same(bench: Bench, front: Path) -> None:
    bench.converted("--common-with", front)
    for jobs in (1, 2):
        other = bench.folder / str(jobs)
        run = spawn("convert", bench.src, other, "--rig", bench.rig, "--common-with", front, "--jobs", jobs)
        assert run.code == 0, run.stderr
        assert tree(other, apart=("run.json",)) == tree(bench.dst, apart=("run.json",))
    parts = bench.folder / "parts"
    for part in ("1/2", "2/2"):
        assert bench.convert("--common-with", front, "--part", part, dst=parts).code == 0
    finished = unidrive("finalise", bench.src, parts, "--rig", bench.rig, "--common-with", front)
    assert finished.code == 0, finished.stderr
    assert tree(parts, apart=("run.json",)) == tree(bench.dst, apart=("run.json",))


def test_other_rigs_on_the_same_dst_are_other_options(bench: Bench, front: Path) -> None:
    bench.converted("--common-with", front)
    bench.refused(2, "other options (common_with ['front ", "], now None; common_sweep_m 1.0, now None)")
    bench.refused(
        2, "other options (common_sweep_m 1.0, now 0.5)", options=("--common-with", front, "--common-sweep", 0.5)
    )
    again = bench.convert("--common-with", front)
    assert "already holds this conversion" in again.stdout


def test_a_fleet_gives_every_car_the_same_masks(bench: Bench, front: Path, tmp_path: Path) -> None:
    """The dataset's own rig is in the fleet, under other channel names, so it blackens nothing more."""
    own, _ = rig_of_dataset(open_dataset(bench.src))
    (front.parent / "own.yaml").write_text(dump_rig(own).replace("CAM_", "CAMERA_"))
    (front.parent / "virtual.yaml").write_text(SMALL_RIG)
    fleet = front.parent / "fleet.yaml"
    fleet.write_text("name: two\nvirtual: virtual.yaml\nsources: [front.yaml, own.yaml]\n")
    run = bench.converted("--masks", "camera", rig=fleet)
    assert "blackened too" not in run.stdout
    for channel, mask in expected_masks(bench, front).items():
        found = cv2.imread(str(bench.dst / "masks" / f"{channel}.png"), 0)
        assert not ((found > 0) & (mask == 0)).any()
    fleet.write_text("name: two\nvirtual: virtual.yaml\nsources: [front.yaml]\n")
    lonely = bench.convert("--dry-run", rig=fleet, dst=bench.folder / "other")
    assert "The cameras of src count as well: what they cannot fill is black too." in lonely.stdout
    fleet.write_text("name: two\nvirtual: virtual.yaml\nsources: [front.yaml]\ncommon: false\n")
    plain = bench.folder / "plain"
    bench.converted(rig=fleet, dst=plain)
    assert "common_with" not in json.loads((plain / "unidrive.json").read_text())["plan"]["options"]


def test_precedence_of_the_depth_limit(bench: Bench, front: Path) -> None:
    fleet = front.parent / "fleet.yaml"
    (front.parent / "virtual.yaml").write_text(SMALL_RIG + "depth_limit: 20\nground_height: 0.1\n")
    fleet.write_text("name: a\nvirtual: virtual.yaml\nsources: [front.yaml]\ncommon: false\ndepth_limit: 30\n")
    for options, expected in (((), 30), (("--depth-limit", 40), 40)):
        dst = bench.folder / str(expected)
        bench.converted(*options, rig=fleet, dst=dst)
        chosen = json.loads((dst / "unidrive.json").read_text())["plan"]["options"]
        assert (chosen["depth_limit_m"], chosen["ground_height_m"]) == (expected, 0.1)


def test_refusals(bench: Bench, front: Path) -> None:
    nothing = front.parent / "nothing.yaml"
    nothing.write_text(FRONT.replace("yaw: 0}", "yaw: 0, pitch: 85}").replace("yaw: 180}", "yaw: 180, pitch: 85}"))
    bench.refused(2, "no virtual pixel can be filled by all of", options=("--common-with", nothing))
    bench.refused(2, "--common-sweep goes with --common-with", options=("--common-sweep", 2))
    bench.refused(2, "--common-sweep must be from 0 to 100", options=("--common-with", front, "--common-sweep", -1))
    bench.refused(2, "Did you mean 4x95?", options=("--common-with", "4x96"))


def test_inspect_rig_shows_what_a_fleet_fills(bench: Bench, front: Path) -> None:
    fleet = front.parent / "fleet.yaml"
    (front.parent / "virtual.yaml").write_text(SMALL_RIG)
    fleet.write_text(f"name: two\nvirtual: virtual.yaml\nsources: [front.yaml, {bench.src}]\n")
    run = unidrive("inspect-rig", fleet, "--json")
    assert run.code == 0, run.stderr
    filled = run.json()["filled"]
    assert filled["rigs"] == ["front", "src"]
    for channel, mask in expected_masks(bench, front).items():
        found = filled["by_camera"][channel]
        assert found["common"] == pytest.approx((mask > 0).mean(), abs=1e-6)
        assert found["common"] <= min(found["by_rig"])
    table = unidrive("inspect-rig", front.parent / "virtual.yaml", "--against", bench.src, "--against", front).stdout
    assert ["channel", "src", "front", "common"] in [line.split() for line in table.splitlines()]
    assert "filled" not in unidrive("inspect-rig", front, "--json").json()


def test_measure_takes_a_fleet_in_the_rig_s_place(bench: Bench, front: Path) -> None:
    fleet = front.parent / "fleet.yaml"
    (front.parent / "virtual.yaml").write_text(SMALL_RIG)
    fleet.write_text("name: two\nvirtual: virtual.yaml\nsources: [front.yaml]\ndepth_limit: 30\n")
    by_fleet = unidrive("measure", bench.src, "--rig", fleet, "--json")
    by_rig = unidrive("measure", bench.src, "--rig", bench.rig, "--depth-limit", 30, "--json")
    assert by_fleet.code == 0, by_fleet.stderr
    assert by_fleet.json()["pairs"] == by_rig.json()["pairs"]
