"""`unidrive measure --truth` on a painted drive: converted, rendered, and painted directly through the rig."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.datasets import VERSION, Row, Run, paint, rows, tree, unidrive
from tests.measure.drives import CHANNELS, RIG, SAMPLES, SIZE, paint_source, paint_truth, rig
from unidrive_cli.measure.truth import TruthReport, measure_converted, measure_rendered
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.warp.choices import WarpChoices

REGIONS = ("ground", "objects", "structures", "sky", "seams")
PIXELS = SIZE[0] * SIZE[1] * len(CHANNELS) * SAMPLES


@pytest.fixture(scope="session")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `src`, `truth`, the rig file, and `out`: src converted."""
    root = tmp_path_factory.mktemp("measured")
    paint_source(root / "src")
    paint_truth(root / "truth")
    (root / "rig.yaml").write_text(RIG)
    convert(root, "out")
    return root


def convert(root: Path, name: str, *options: object) -> Path:
    run = unidrive("convert", root / "src", root / name, "--rig", root / "rig.yaml", "--jobs", 0, *options)
    assert run.code == 0, run.stderr
    return root / name


def measured(*arguments: object) -> dict[str, Any]:
    """The JSON of a run that must succeed and write nothing but that."""
    run = unidrive("measure", *arguments, "--json")
    assert run.code == 0, run.stderr
    assert run.stdout.count("\n") == 1
    document: dict[str, Any] = json.loads(run.stdout, parse_constant=lambda text: pytest.fail(f"{text} is not JSON"))
    return document


def form_a(drive: Path, *options: object) -> dict[str, Any]:
    return measured(drive / "out", "--truth", drive / "truth", *options)


def form_b(drive: Path, *options: object) -> dict[str, Any]:
    return measured(drive / "src", "--rig", drive / "rig.yaml", "--truth", drive / "truth", *options)


# --- figures ----------------------------------------------------------------------------------------------------


def test_the_keys_are_those_of_the_interface(drive: Path) -> None:
    found = form_a(drive, "--source", drive / "src")
    assert list(found) == ["schema_version", "truth", "samples", "covered", "notes"]
    assert (found["schema_version"], found["samples"], found["notes"]) == (1, SAMPLES, [])
    keys = ["psnr", "ssim", "pixels", *REGIONS]
    assert list(found["truth"]) == [*keys, "by_camera"]
    assert list(found["truth"]["by_camera"]) == list(CHANNELS)
    for figures in (found["truth"], *found["truth"]["by_camera"].values()):
        assert all(list(figures[name]) == ["psnr", "ssim", "pixels"] for name in REGIONS)
    assert all(list(figures) == keys for figures in found["truth"]["by_camera"].values())


def test_with_a_rig_the_projection_error_is_there_too(drive: Path, tmp_path: Path) -> None:
    """As without a truth; where it cannot be measured, a note says so and the pictures are compared all the same."""
    found = form_b(drive)
    alone = measured(drive / "src", "--rig", drive / "rig.yaml")
    assert found["pairs"]["count"] > 100
    assert {key: found[key] for key in alone if key != "notes"} == {k: v for k, v in alone.items() if k != "notes"}
    without_boxes = Path(shutil.copytree(drive / "src", tmp_path / "src"))
    for table in ("sample_annotation", "instance"):
        (without_boxes / VERSION / f"{table}.json").write_text("[]")
    bare = measured(without_boxes, "--rig", drive / "rig.yaml", "--truth", drive / "truth")
    assert bare["truth"] == found["truth"]
    assert "pairs" not in bare
    (note,) = (note for note in bare["notes"] if note.startswith("The projection error is not measured: "))
    assert "have no annotated boxes" in note


def test_the_figures_are_sensible(drive: Path) -> None:
    """Ground within D0 and the sky are shown where they are; cars, whose depth is not known, are not."""
    truth = form_b(drive)["truth"]
    for figures in (truth, *truth["by_camera"].values()):
        assert 20 < figures["objects"]["psnr"] < figures["psnr"] < figures["ground"]["psnr"] + 3
        assert figures["ground"]["psnr"] > 25
        assert figures["sky"]["psnr"] > 30
        assert 0.6 < figures["objects"]["ssim"] < figures["ssim"] < figures["ground"]["ssim"] < 1
        assert 24 < figures["seams"]["psnr"] < 35


def test_the_regions_are_all_of_what_is_covered(drive: Path) -> None:
    found = form_b(drive)
    truth = found["truth"]
    parts = [truth[name]["pixels"] for name in ("ground", "objects", "structures", "sky")]
    assert sum(parts) == truth["pixels"]
    assert truth["structures"] == {"psnr": None, "ssim": None, "pixels": 0}
    assert found["covered"] == pytest.approx(truth["pixels"] / PIXELS, abs=1e-6)
    assert 0.7 < found["covered"] < 0.95
    cameras = truth["by_camera"].values()
    for name in REGIONS:
        assert truth[name]["pixels"] == sum(camera[name]["pixels"] for camera in cameras)
    mse = sum(camera["pixels"] * 10 ** (-camera["psnr"] / 10) for camera in cameras) / truth["pixels"]
    assert truth["psnr"] == pytest.approx(-10 * math.log10(mse), abs=1e-3)


def test_ego_motion_on_beats_off(drive: Path) -> None:
    """At 9 m/s the real cameras fire up to 0.4 m apart."""
    on, off = form_b(drive)["truth"], form_b(drive, "--no-ego-motion")["truth"]
    assert on["psnr"] > off["psnr"] + 1
    assert on["ground"]["psnr"] > off["ground"]["psnr"] + 2
    assert on["ground"]["ssim"] > off["ground"]["ssim"] + 0.03
    assert on["seams"]["psnr"] > off["seams"]["psnr"] + 1


def test_both_forms_agree_but_for_the_jpeg(drive: Path) -> None:
    files, memory = form_a(drive, "--source", drive / "src"), form_b(drive)
    assert files["covered"] == memory["covered"]
    for name in (None, *REGIONS):
        one, other = ((d["truth"] if name is None else d["truth"][name]) for d in (files, memory))
        assert one["pixels"] == other["pixels"]
        if one["pixels"]:
            assert one["psnr"] == pytest.approx(other["psnr"], abs=0.7)
            assert one["ssim"] == pytest.approx(other["ssim"], abs=0.01)


def test_the_options_are_those_of_the_conversion(drive: Path, tmp_path: Path) -> None:
    """Seams of a converted dataset, too, are where its own options put them."""
    out = convert(drive, "other", "--no-ego-motion", "--depth-limit", 20, "--blend", "nearest")
    files = measured(out, "--truth", drive / "truth", "--source", drive / "src")
    memory = form_b(drive, "--no-ego-motion", "--depth-limit", 20, "--blend", "nearest")
    assert files["truth"]["psnr"] == pytest.approx(memory["truth"]["psnr"], abs=0.7)
    assert files["truth"]["seams"]["pixels"] == memory["truth"]["seams"]["pixels"]
    assert memory["truth"]["seams"]["pixels"] != form_b(drive)["truth"]["seams"]["pixels"]


def test_the_rigs_own_depth_limit_counts_unless_one_is_given(drive: Path, tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(RIG + "depth_limit: 20\n")
    by_rig = measured(drive / "src", "--rig", own, "--truth", drive / "truth")
    assert by_rig["truth"] == form_b(drive, "--depth-limit", 20)["truth"]
    assert by_rig["truth"] != form_b(drive)["truth"]
    by_flag = measured(drive / "src", "--rig", own, "--truth", drive / "truth", "--depth-limit", 50)
    assert by_flag["truth"] == form_b(drive)["truth"]


def test_the_truth_itself_through_its_own_rig_is_perfect(drive: Path) -> None:
    """Infinite PSNR is null, with pixels to tell it from no pixels; as text it is `inf`."""
    run = measured(drive / "truth", "--rig", drive / "rig.yaml", "--truth", drive / "truth")
    back = run["truth"]["by_camera"]["CAM_BACK"]  # overlaps with no other camera
    assert (back["psnr"], back["pixels"]) == (None, SIZE[0] * SIZE[1] * SAMPLES)
    assert back["ssim"] == pytest.approx(1, abs=1e-6)
    assert back["seams"] == {"psnr": None, "ssim": None, "pixels": 0}
    assert run["covered"] == 1
    text = unidrive("measure", drive / "truth", "--rig", drive / "rig.yaml", "--truth", drive / "truth").stdout
    line = next(line for line in text.splitlines() if line.startswith("CAM_BACK"))
    assert line.split() == ["CAM_BACK", "inf", "1.0000", "inf", "1.0000", "inf", "1.0000", "-", "-"]


@pytest.mark.parametrize("jobs", [1, 2, 5])
def test_jobs_change_no_figure(drive: Path, jobs: int) -> None:
    assert form_b(drive, "--jobs", jobs) == form_b(drive, "--jobs", 0)


def test_nothing_is_written(drive: Path) -> None:
    before = tree(drive)
    form_a(drive, "--source", drive / "src")
    form_b(drive)
    assert tree(drive) == before


def test_a_scene_can_be_chosen(drive: Path) -> None:
    assert form_b(drive, "--scene", "scene-0061") == form_b(drive)


def test_one_mask_per_camera(drive: Path) -> None:
    out = convert(drive, "static", "--masks", "camera")
    found = measured(out, "--truth", drive / "truth")
    assert found["covered"] == pytest.approx(form_a(drive)["covered"], abs=0.05)
    assert found["truth"]["psnr"] > 15


def test_the_table(drive: Path) -> None:
    run = unidrive("measure", drive / "out", "--truth", drive / "truth")
    assert (run.code, run.stderr) == (0, "")
    first, header, *lines, note = run.stdout.splitlines()
    found = form_a(drive)
    assert first == f"2 samples compared with the truth; {found['covered']:.1%} of the pixels are covered"
    assert " ".join(header.split()) == "camera overall dB SSIM ground dB SSIM objects dB SSIM seams dB SSIM"
    assert [line.split()[0] for line in lines] == [*CHANNELS, "all"]
    assert len({len(line) for line in (header, *lines)}) == 1
    truth = found["truth"]
    expected = [f"{truth['psnr']:.2f}", f"{truth['ssim']:.4f}", f"{truth['ground']['psnr']:.2f}"]
    assert lines[-1].split()[1:4] == expected
    assert lines[-1].split()[-2:] == ["-", "-"]
    assert note == "note: Seams are not measured: they need the dataset that was converted (--source SRC)."
    assert found["truth"]["seams"] is None


def test_the_same_from_python(drive: Path) -> None:
    source, truth = open_dataset(drive / "src"), open_dataset(drive / "truth")
    told: list[tuple[int, int]] = []
    report = measure_rendered(
        source, rig(), WarpChoices(), truth, progress=lambda done, total: told.append((done, total))
    )
    assert isinstance(report, TruthReport)
    document = report.document()
    assert document == {key: value for key, value in form_b(drive).items() if key in document}
    assert told == [(1, 2), (2, 2)]
    assert measure_converted(open_dataset(drive / "out"), truth, source=source).document() == form_a(
        drive, "--source", drive / "src"
    )


def test_options_come_from_the_config_file_too(drive: Path, tmp_path: Path) -> None:
    config = tmp_path / "config.yaml"
    config.write_text(f"truth: {drive / 'truth'}\nrig: {drive / 'rig.yaml'}\nego-motion: false\njson: true\n")
    run = unidrive("measure", drive / "src", "--config", config)
    assert run.code == 0, run.stderr
    assert run.json() == form_b(drive, "--no-ego-motion")


# --- what is missing but no error -------------------------------------------------------------------------------


@pytest.fixture
def copy(drive: Path, tmp_path: Path) -> Path:
    """The drive, to break."""
    return Path(shutil.copytree(drive, tmp_path / "copy"))


def edit(root: Path, table: str, change: Callable[[list[Row]], object]) -> None:
    found = rows(root, table)
    change(found)
    (root / VERSION / f"{table}.json").write_text(json.dumps(found))


def test_without_instance_pictures(copy: Path) -> None:
    shutil.rmtree(copy / "truth" / "instances")
    found, whole = form_b(copy), form_b(copy.parent / "copy")
    assert (found["truth"]["psnr"], found["truth"]["seams"]) == (whole["truth"]["psnr"], whole["truth"]["seams"])
    assert [found["truth"][name] for name in ("ground", "objects", "structures", "sky")] == [None] * 4
    assert "instance pictures" in found["notes"][0]


def test_samples_without_a_truth_are_said(copy: Path) -> None:
    (first, _) = rows(copy / "truth", "sample")
    fields = {"sample": "token", "sample_data": "sample_token", "sample_annotation": "sample_token"}
    for table, field in fields.items():

        def keep(found: list[Row], field: str = field) -> None:
            found[:] = [row for row in found if row[field] == first["token"]]

        edit(copy / "truth", table, keep)
    found = form_b(copy)
    assert found["samples"] == 1
    assert found["notes"] == ["1 of 2 samples have no truth and are left out."]


# --- errors -----------------------------------------------------------------------------------------------------


def refused(run: Run, code: int, *words: str) -> None:
    assert run.code == code, run.stdout + run.stderr
    assert run.stdout == ""
    assert run.stderr.startswith("unidrive: ")
    assert run.stderr.count("\n") == 1
    for word in words:
        assert word in run.said, f"{word!r} is not in {run.said!r}"


def refused_a(drive: Path, code: int, *words: str, options: tuple[object, ...] = ()) -> None:
    refused(unidrive("measure", drive / "out", "--truth", drive / "truth", *options), code, *words)


def refused_b(drive: Path, code: int, *words: str, options: tuple[object, ...] = ()) -> None:
    arguments = ("measure", drive / "src", "--rig", drive / "rig.yaml", "--truth", drive / "truth", *options)
    refused(unidrive(*arguments), code, *words)


def test_without_a_truth(drive: Path) -> None:
    refused(unidrive("measure", drive / "out"), 2, "--rig or --truth is needed", "--truth TRUTH")


def test_neither_a_rig_nor_a_converted_dataset(drive: Path) -> None:
    run = unidrive("measure", drive / "src", "--truth", drive / "truth")
    refused(run, 2, str(drive / "src"), "is no converted dataset", "--rig")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--depth-limit", 40), ("--depth-limit goes with --rig",)),
        (("--ground-height", 0), ("--ground-height goes with --rig",)),
        (("--blend", "angular"), ("--blend goes with --rig",)),
        (("--no-ego-motion",), ("--ego-motion goes with --rig",)),
        (("--jobs", -1), ("--jobs must be 0 or more",)),
        (("--scene", "scene-0016"), ("scene-0016", "Did you mean scene-0061?")),
        (("--version", "v2"), ("--version v2",)),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else None,
)
def test_options_that_cannot_be(drive: Path, options: tuple[object, ...], words: tuple[str, ...]) -> None:
    refused_a(drive, 2, *words, options=options)


def test_variables_for_other_commands_do_not_disturb(drive: Path) -> None:
    run = unidrive("measure", drive / "out", "--truth", drive / "truth", env={"UNIDRIVE_DEPTH_LIMIT": "40"})
    assert run.code == 0, run.stderr


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--source", "here"), ("--source belongs to a converted dataset",)),
        (("--depth-limit", 1), ("CAM_FRONT_LEFT", "depth limit")),
        (("--ground-height", 3), ("CAM_FRONT_LEFT", "below the ground")),
        (("--depth-limit", -1), ("--depth-limit must be a positive number",)),
        (("--rig", "6x61"), ("Did you mean 6x60?",)),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else None,
)
def test_options_that_cannot_be_with_a_rig(drive: Path, options: tuple[object, ...], words: tuple[str, ...]) -> None:
    if options[0] == "--source":
        options = ("--source", drive / "src")
    refused_b(drive, 2, *words, options=options)


def test_pictures_that_are_too_small_for_ssim(drive: Path, tmp_path: Path) -> None:
    small = tmp_path / "small.yaml"
    small.write_text(RIG.replace("width: 192, height: 108", "width: 16, height: 9"))
    run = unidrive("measure", drive / "src", "--rig", small, "--truth", drive / "truth")
    refused(run, 2, "CAM_FRONT_LEFT", "16x9", "SSIM needs 11")


def test_a_truth_that_is_no_dataset(drive: Path, tmp_path: Path) -> None:
    run = unidrive("measure", drive / "out", "--truth", tmp_path / "nowhere")
    refused(run, 3, "nowhere", "there is no such folder")
    run = unidrive("measure", drive / "out", "--truth", tmp_path)
    refused(run, 3, str(tmp_path), "holds no version folder")


def test_a_subject_that_is_no_dataset(drive: Path, tmp_path: Path) -> None:
    refused(unidrive("measure", tmp_path / "nowhere", "--truth", drive / "truth"), 3, "there is no such folder")


def test_the_truth_may_be_named_by_its_version_folder(drive: Path) -> None:
    found = measured(drive / "out", "--truth", drive / "truth" / VERSION, "--source", drive / "src" / VERSION)
    assert found == form_a(drive, "--source", drive / "src")


def test_another_drive(drive: Path, tmp_path: Path) -> None:
    other = paint_truth(tmp_path / "other")

    def rename(found: list[Row]) -> None:
        for row in found:
            for field in ("token", "sample_token", "prev", "next"):
                if row.get(field):
                    row[field] = "f" + row[field][1:] if row[field][0] != "f" else "0" + row[field][1:]

    edit(other, "sample", rename)
    run = unidrive("measure", drive / "out", "--truth", other)
    refused(run, 3, str(other / VERSION), "has none of the 2 samples", "same drive")


def test_a_camera_that_the_truth_lacks(copy: Path) -> None:
    def rename(found: list[Row]) -> None:
        next(row for row in found if row["channel"] == "CAM_BACK")["channel"] = "CAM_REAR"

    edit(copy / "truth", "sensor", rename)
    for refuse in (refused_a, refused_b):
        refuse(copy, 3, str(copy / "truth"), "lacks cameras of the virtual rig", "CAM_BACK", "CAM_REAR")


def calibration(root: Path, channel: str) -> tuple[str, Callable[[Callable[[Row], object]], None]]:
    (sensor,) = [row["token"] for row in rows(root, "sensor") if row["channel"] == channel]
    (token,) = [row["token"] for row in rows(root, "calibrated_sensor") if row["sensor_token"] == sensor]

    def change(how: Callable[[Row], object]) -> None:
        edit(root, "calibrated_sensor", lambda found: [how(row) for row in found if row["token"] == token])

    return token, change


def test_another_pose(copy: Path) -> None:
    token, change = calibration(copy / "truth", "CAM_BACK")
    change(lambda row: row["translation"].__setitem__(0, row["translation"][0] + 0.25))
    for refuse in (refused_a, refused_b):
        refuse(copy, 3, "CAM_BACK is not the virtual camera of", token, "stands 0.25 m away and looks 0 degrees")


def test_a_pose_that_differs_by_rounding_is_the_same(copy: Path) -> None:
    _, change = calibration(copy / "truth", "CAM_BACK")
    change(lambda row: row["translation"].__setitem__(0, row["translation"][0] + 5e-7))
    assert form_b(copy)["samples"] == SAMPLES


@pytest.mark.parametrize("dataset", ["truth", "out", "src"])
def test_a_pose_that_is_nowhere(copy: Path, dataset: str) -> None:
    edit(copy / dataset, "ego_pose", lambda found: found[0].update(translation=[1e308, 0, 0]))
    (refused_b if dataset == "src" else refused_a)(copy, 3, "ego_pose.json", "metres")


def test_another_lens(copy: Path) -> None:
    token, change = calibration(copy / "truth", "CAM_FRONT_LEFT")
    change(lambda row: row["camera_intrinsic"][0].__setitem__(0, row["camera_intrinsic"][0][0] + 2))
    refused_b(copy, 3, "CAM_FRONT_LEFT is not the virtual camera", token, "differ by up to 2 px")


def test_another_picture_size(copy: Path) -> None:
    def widen(found: list[Row]) -> None:
        for row in found:
            if "/CAM_BACK/" in row["filename"]:
                row["width"] *= 2

    edit(copy / "truth", "sample_data", widen)
    refused_a(copy, 3, "CAM_BACK is not the virtual camera", "384x108 pixels, not 192x108")


def picture(root: Path, folder: str = "samples") -> Path:
    return min((root / folder / "CAM_BACK").iterdir())


def test_a_picture_of_another_size_than_its_table_says(copy: Path) -> None:
    path = picture(copy / "truth")
    cv2.imwrite(str(path), cv2.imread(str(path))[::2])
    refused_a(copy, 3, str(path), "is 192x54 pixels, but its tables say 192x108")


@pytest.mark.parametrize(
    ("place", "words"),
    [("truth/samples", "is missing"), ("truth/instances", "is missing"), ("out/masks", "is missing")],
)
def test_a_missing_picture(copy: Path, place: str, words: str) -> None:
    root, folder = place.split("/")
    path = picture(copy / root, folder)
    path.unlink()
    refused_a(copy, 3, str(path), words)


@pytest.mark.parametrize("place", ["truth/samples", "truth/instances", "out/samples", "out/masks"])
def test_a_broken_picture(copy: Path, place: str) -> None:
    path = picture(copy / place.split("/")[0], place.split("/")[1])
    data = path.read_bytes()
    path.unlink()  # it may be linked
    path.write_bytes(data[: len(data) // 2])
    refused_a(copy, 3, str(path), "broken")


def test_a_broken_source_picture(copy: Path) -> None:
    path = min((copy / "src" / "samples" / "CAM_BACK").iterdir())
    path.write_bytes(b"")
    refused_b(copy, 3, str(path), "is empty")


def test_instance_pictures_of_another_form(copy: Path) -> None:
    path = picture(copy / "truth", "instances")
    cv2.imwrite(str(path), np.zeros(SIZE[::-1], np.uint8))
    refused_a(copy, 3, str(path), "uint8", "16-bit PNG")
    cv2.imwrite(str(path), np.zeros((*SIZE[::-1], 3), np.uint16))
    refused_a(copy, 3, str(path), "has 3 channels")


def test_a_truth_taken_at_another_moment(drive: Path, tmp_path: Path) -> None:
    """20 ms at 9 m/s."""
    late = paint_truth(tmp_path / "late", fires_us=20_000)
    run = unidrive("measure", drive / "out", "--truth", late)
    refused(run, 3, str(late), "0.18 m", "20 ms away from the sample's reference", "--firing together")
    run = unidrive("measure", drive / "src", "--rig", drive / "rig.yaml", "--truth", late)
    refused(run, 3, str(late), "0.18 m", "20 ms away from the sample's reference", "--firing together")


def test_a_truth_of_the_same_place_at_another_time(copy: Path) -> None:
    def later(found: list[Row]) -> None:
        for row in found:
            if row["fileformat"] == "jpg":
                row["timestamp"] += 5000

    edit(copy / "truth", "sample_data", later)
    refused_a(copy, 3, "0 m, 0 degrees and 5 ms away")


def test_a_sample_of_the_truth_without_a_picture(copy: Path) -> None:
    def drop(found: list[Row]) -> None:
        found.remove(next(row for row in found if "/CAM_BACK/" in row["filename"]))

    edit(copy / "truth", "sample_data", drop)
    refused_a(copy, 3, str(copy / "truth"), "the sample has no picture of CAM_BACK")


def test_an_unfinished_conversion(copy: Path) -> None:
    out = copy / "out"
    (out / "UNFINISHED.txt").write_text("not yet")
    refused_a(copy, 3, str(out), "has not been finished", "same unidrive command")
    shutil.rmtree(out / VERSION)
    (out / "unidrive.json").unlink()
    refused_a(copy, 3, str(out), "has not been finished", "same unidrive command")


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"plan": {"options": {"masks": "some"}}}'])
def test_a_broken_provenance_file(copy: Path, text: str) -> None:
    (copy / "out" / "unidrive.json").write_text(text)
    refused_a(copy, 3, "unidrive.json", "is not a provenance file")


def test_converted_without_masks(drive: Path) -> None:
    out = convert(drive, "bare", "--masks", "none")
    refused(unidrive("measure", out, "--truth", drive / "truth"), 3, str(out), "--masks none", "--rig")


def test_another_source(drive: Path, tmp_path: Path) -> None:
    other = paint(tmp_path / "other", samples=1)
    refused_a(drive, 3, str(other), "is not what", "was converted from", options=("--source", other))
