"""The cross-rig benchmark's arithmetic and geometry; what it measures is measured by `make cross-rig`."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from benchmarks.cross_rig import paper, scoring
from benchmarks.cross_rig.config import CLASSES, PAPER_RIGS, PICTURE, SEEN, STRIDE, VEILED, Config, full, quick
from benchmarks.cross_rig.drives import coverage, small_rig
from benchmarks.cross_rig.frames import DEPTHS_M, NO_DEPTH, Rig, read_frames, veil
from benchmarks.cross_rig.report import sections
from benchmarks.cross_rig.retention import Key, packed, read_results, retention, spread
from benchmarks.cross_rig.run import unpack
from benchmarks.cross_rig.targets import CELL_M, HALF_M, decode, encode, turned
from tests.datasets import unidrive
from tests.painted import nuscenes_like_cameras, write_painted
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.rig.yaml_writing import dump_rig
from unidrive_cli.synth.options import SynthOptions
from unidrive_cli.synth.run import make_synth_plan

BOXES = np.array(
    [
        [10.3, -4.9, 0.8, 1.9, 4.5, 1.6, 0.3],
        [-20.1, 17.2, 1.1, 0.6, 0.7, 1.8, -2.9],
        [0.0, 0.0, 2.0, 2.9, 11.0, 3.4, np.pi / 2],
    ],
    np.float32,
)
KINDS = np.array([0, 3, 2])


def test_a_figure_of_the_paper_is_what_its_text_says() -> None:
    raw, unified = retention(paper.RAW), retention(paper.UNIFIED)
    assert round(raw.kept, 2) == 0.21
    assert round(unified.kept, 2) == 0.94
    assert (raw.worst, raw.worst_pair) == (0.2, ("6x80b", "8x50"))
    assert (unified.worst, unified.worst_pair) == (53.6, ("6x80b", "4x95"))


def test_retention_counts_each_training_rig_alike() -> None:
    kept = retention({"a": {"a": 0.8, "b": 0.4}, "c": {"c": 0.4, "a": 0.3, "b": 0.1}})
    assert (kept.own, kept.others, kept.kept) == pytest.approx((0.6, 0.3, 0.5))
    assert (kept.worst, kept.worst_pair) == (0.1, ("c", "b"))
    assert retention({"a": {"a": 0.0, "b": 0.0}}).kept == 0


def test_the_spread_is_the_standard_deviation_of_a_sample() -> None:
    assert spread([0.5]) == "50.0"
    assert spread([0.4, 0.5, 0.6]) == "50.0 ± 10.0"


@pytest.mark.parametrize("config", [quick(), full(), full(all_eight=True)])
def test_every_rig_of_a_run_can_be_rendered(config: Config) -> None:
    rigs = [small_rig(name) for name in dict.fromkeys((*config.train_rigs, *config.test_rigs))]
    make_synth_plan(SynthOptions(), rigs, "rays")


def test_boxes_survive_the_grid() -> None:
    targets = encode(KINDS, BOXES, len(CLASSES))
    numbers = np.zeros((targets.numbers.shape[1], *targets.heat.shape[1:]), np.float32)
    numbers.reshape(len(numbers), -1)[:, targets.cells] = targets.numbers.T
    kinds, scores, boxes = decode(targets.heat, numbers)
    order = np.lexsort([boxes[:, 0]])
    wanted = np.lexsort([BOXES[:, 0]])
    assert kinds[order].tolist() == KINDS[wanted].tolist()
    assert scores.tolist() == [1.0, 1.0, 1.0]
    np.testing.assert_allclose(boxes[order], BOXES[wanted], atol=1e-4)


def test_boxes_outside_the_grid_teach_nothing() -> None:
    outside = BOXES[:1].copy()
    outside[0, 0] = HALF_M + 0.01
    targets = encode(KINDS[:1], outside, len(CLASSES))
    assert targets.heat.max() == 0
    assert len(targets.cells) == 0


def test_turned_boxes_keep_their_heading_relative_to_their_place() -> None:
    quarter = np.array([[0, -1], [1, 0]], np.float32)
    mirror = np.diag([1, -1]).astype(np.float32)
    assert turned(BOXES[:1], quarter)[0] == pytest.approx([4.9, 10.3, 0.8, 1.9, 4.5, 1.6, 0.3 + np.pi / 2])
    assert turned(BOXES[:1], mirror)[0] == pytest.approx([10.3, 4.9, 0.8, 1.9, 4.5, 1.6, -0.3])


def test_small_rigs_see_what_the_large_ones_see() -> None:
    for name in PAPER_RIGS:
        for small, large in zip(small_rig(name).cameras, load_gallery_rig(name).cameras, strict=True):
            assert (small.lens.width_px, small.lens.height_px) == PICTURE
            assert small.lens.hfov_deg == pytest.approx(large.lens.hfov_deg)
            np.testing.assert_array_equal(small.ego_from_cam, large.ego_from_cam)


def test_veils_hide_what_a_rig_does_not_fill() -> None:
    filled = coverage(VEILED)
    shares = dict(zip(PAPER_RIGS, (one.mean() for one in filled), strict=True))
    assert shares["6x60"] < 0.85 < shares["6x80a"]
    assert min(shares.values()) > np.logical_and.reduce(filled).mean() > 0.6
    veils = veil(filled[PAPER_RIGS.index("6x60")])
    assert veils.shape == (6, 1, SEEN[1], SEEN[0])
    assert veils.mean() == pytest.approx(shares["6x60"], abs=1e-4)
    assert 0 == veils.min() < veils.max() == 1


def test_rigs_of_the_ablations_differ_in_one_thing() -> None:
    base, lens, height = (small_rig(name).cameras for name in ("6x60", "6x60-at-80", "6x60-at-2.5m"))
    for before, wide, high in zip(base, lens, height, strict=True):
        assert wide.lens.hfov_deg == pytest.approx(80)
        np.testing.assert_array_equal(wide.ego_from_cam, before.ego_from_cam)
        assert high.lens.hfov_deg == pytest.approx(60)
        assert (high.ego_from_cam - before.ego_from_cam)[:3, 3] == pytest.approx([0, 0, 0.9])


def test_the_runs_hold_what_the_results_need() -> None:
    config = full()
    names = [training.name for training in config.trainings]
    assert len(set(names)) == len(names)
    main = [t for t in config.trainings if t.detector == "lift-splat" and len(t.rigs) == 1]
    for setting in ("raw", "intuitive", "fleet", "fleet-common"):
        assert len([t for t in main if t.setting.name == setting]) == 4 * 3  # training rigs, seeds
    assert len(full(all_eight=True).trainings) == len(names) + 4 * 4
    for each in (config, quick()):
        assert each.test.seed not in {drive.seed for drive in each.train}


def test_tables_are_made_of_what_is_there(tmp_path: Path) -> None:
    for rig, figure in zip(PAPER_RIGS, (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8), strict=True):
        path = tmp_path / "results" / "raw" / "lift-splat" / "6x60" / "seed1" / f"{rig}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({"mAP": figure, "NDS": 0.5, "AP": {"car": figure}}))
    results = read_results(tmp_path)
    assert list(results) == [Key("raw", "lift-splat", 1)]
    unpack(tmp_path / "again", packed(tmp_path))
    assert read_results(tmp_path / "again") == results
    text = "\n".join(sections(results))
    assert "| raw | lift-splat | 1 (1) | 60.0 | 42.9 | 71 % | 10.0 (6x60 on 4x95) | 50.0 | 100 % |" in text
    assert "| 6x60 | 10.0 | 20.0 | 30.0 | 40.0 | 50.0 | **60.0** | 70.0 | 80.0 |" in text


def test_a_run_on_some_of_the_rigs_has_its_own_tables(tmp_path: Path) -> None:
    for trained, figures in {"6x80a": (0.4, 0.2, 0.1), "6x60": (0.1, 0.3, 0.6)}.items():
        for rig, figure in zip(("6x80a", "6x70", "6x60"), figures, strict=True):
            path = tmp_path / "results" / "fleet" / "lift-splat" / trained / "seed0" / f"{rig}.json"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps({"mAP": figure, "NDS": 0.5, "AP": {"car": figure}}))
    alone = tmp_path / "results" / "fleet" / "lift-splat" / "6x60" / "seed1"
    shutil.copytree(alone.with_name("seed0"), alone)  # a seed that is not through counts for its cells only
    text = "\n".join(sections(read_results(tmp_path)))
    assert "| fleet | lift-splat | 1 (2) | 50.0 | 17.5 | 35 % | 10.0 (6x60 on 6x80a) | 50.0 | 100 % |" in text
    lines = ("| trained on | 6x80a | 6x70 | 6x60 |", "| --- | --- | --- | --- |")
    assert "\n".join((*lines, "| 6x60 | 10.0 ± 0.0 | 30.0 ± 0.0 | **60.0 ± 0.0** |")) in text
    assert "| car | 53.3 | 18.3 | 34% |" in text
    assert "## Heights" not in text


def test_the_truth_found_in_a_converted_dataset_scores_everything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, rig, virtual = tmp_path / "source", tmp_path / "rig.yaml", tmp_path / "virtual"
    cameras = nuscenes_like_cameras(0.05)
    write_painted(
        source,
        version="v1.0-trainval",
        scenes=2,
        samples_per_scene=3,
        cameras=cameras,
        supersample=1,
        lidar_sweeps=0,
    )
    rig.write_text(dump_rig(small_rig("intuitive-6")))
    with pytest.raises(ValueError, match="do not fire together"):
        read_frames(source)
    assert unidrive("convert", source, virtual, "--rig", rig, "--scene", "scene-0103", "--jobs", 0).code == 0
    calibration, frames = read_frames(virtual)
    np.testing.assert_allclose(calibration.intrinsics, _calibration("intuitive-6").intrinsics[_BY_NAME], atol=1e-4)
    assert frames[0].pictures.shape == (6, 3, SEEN[1], SEEN[0])
    assert _share_on_the_ground(calibration, frames[0].depth) > 0.6
    monkeypatch.setattr(scoring, "LEAST_BOXES", 3)
    truth = [(frame.classes, np.ones(len(frame.classes), np.float32), frame.boxes) for frame in frames]
    score = scoring.score(virtual, frames, truth)
    assert score["mAP"] == pytest.approx(1)
    assert {"car", "pedestrian"} <= set(score["AP"])
    assert max(score["errors"][name] for name in ("trans_err", "scale_err", "orient_err")) < 1e-3
    moved = [(kinds, scores, boxes + np.array([5, 0, 0, 0, 0, 0, 0], np.float32)) for kinds, scores, boxes in truth]
    assert scoring.score(virtual, frames, moved)["mAP"] < 0.2


def _calibration(name: str) -> Rig:
    rig = small_rig(name)
    scale = np.diag([SEEN[0] / PICTURE[0], SEEN[1] / PICTURE[1], 1.0])
    to_edge = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    intrinsics = [np.linalg.inv(to_edge) @ scale @ to_edge @ camera.lens.matrix for camera in rig.cameras]
    return Rig(
        np.array(intrinsics, np.float32), np.array([camera.ego_from_cam for camera in rig.cameras], np.float32)
    )


def _share_on_the_ground(rig: Rig, depth: npt.NDArray[np.uint8]) -> float:
    """Of features below the horizon: how many say the ground's depth. None is deeper than the ground."""
    row = 8
    edges_px = np.array([row * STRIDE - 0.5, (row + 1) * STRIDE - 0.5])
    farthest_m, nearest_m = (
        rig.ego_from_cam[0, 2, 3] * rig.intrinsics[0, 1, 1] / (edges_px - rig.intrinsics[0, 1, 2])
    )
    known = DEPTHS_M[depth[:, row][depth[:, row] != NO_DEPTH]]
    assert len(known) > 50
    assert known.max() < farthest_m + 1
    return float((known > nearest_m - 1).mean())


_BY_NAME = np.argsort(small_rig("intuitive-6").channels)


def test_both_lifts_put_what_a_camera_sees_where_it_stands() -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed: pip install 'unidrive[proof]'")
    from benchmarks.cross_rig.detector import WIDTH, Bilinear, LiftSplat

    rig = _calibration("6x70")
    place = np.array([12.0, 3.5, 0.7, 1.0])  # metres in the ego frame, ahead and a little to the left
    cam = np.linalg.inv(rig.ego_from_cam[0]) @ place
    pixel = (rig.intrinsics[0] @ cam[:3])[:2] / cam[2]
    u, v = np.rint((pixel - (STRIDE - 1) / 2) / STRIDE).astype(int)
    cell = tuple(np.floor((place[:2] + HALF_M) / CELL_M).astype(int))
    features = torch.zeros(1, 6, len(DEPTHS_M) + WIDTH, SEEN[1] // STRIDE, SEEN[0] // STRIDE)
    features[0, 0, len(DEPTHS_M), v, u] = 1.0
    features[0, 0, np.abs(DEPTHS_M - cam[2]).argmin(), v, u] = 50.0
    still = torch.eye(2)[None]
    splat = LiftSplat().lift(features, rig, still)[0, 0].numpy()
    assert np.abs(np.array(np.unravel_index(splat.argmax(), splat.shape)) - cell).max() <= 1
    content = torch.zeros(1, 6, WIDTH, *features.shape[3:])
    content[0, 0, 0, v, u] = 1.0
    mirror = torch.diag(torch.tensor([1.0, -1.0]))[None]
    for turn, side in ((still, 1), (mirror, -1)):
        lifted = Bilinear().lift(content, rig, turn)[0].unflatten(0, (WIDTH, 4))[0, 1].numpy()
        where = np.argwhere(lifted > 0.5 * lifted.max()) * CELL_M - HALF_M + CELL_M / 2
        ahead = np.array([12.0, side * 3.5]) - [1.8, 0]
        bearings = np.arctan2(where[:, 1], where[:, 0] - 1.8)
        assert np.abs(bearings - np.arctan2(ahead[1], ahead[0])).max() < np.deg2rad(5)


def test_flipped_pictures_give_the_same_grid_but_for_what_is_learned() -> None:
    """With weights that are symmetric, flipping the pictures on the way in changes nothing."""
    torch = pytest.importorskip("torch", reason="torch is not installed: pip install 'unidrive[proof]'")
    from benchmarks.cross_rig.detector import LiftSplat

    torch.manual_seed(0)
    detector = LiftSplat().eval()
    for weights in detector.picture.parameters():
        if weights.dim() == 4:
            weights.data = (weights + weights.flip(-1)) / 2
    pictures = torch.randint(0, 255, (1, 6, 3, SEEN[1], SEEN[0]), dtype=torch.uint8)
    with torch.inference_mode():
        heat, flipped = (
            detector(pictures, _calibration("6x70"), torch.tensor([flip]), torch.eye(2)[None])[0]
            for flip in (False, True)
        )
    torch.testing.assert_close(heat, flipped, atol=1e-4, rtol=1e-4)
    assert heat.std() > 1e-4
