"""The rig file: what it means, and one sentence with file, line, camera and key for each mistake."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.rig.hand_made import TEXT, with_changes
from unidrive_cli.errors import RigError
from unidrive_cli.geometry.lenses import FisheyeLens, OpenCVLens, Pinhole
from unidrive_cli.rig.model import Rig
from unidrive_cli.rig.yaml_file import load_rig, parse_rig
from unidrive_cli.rig.yaml_reading import MAX_FILE_BYTES


def refusal(text: str) -> str:
    """The sentence that a text is refused with."""
    with pytest.raises(RigError) as caught:
        parse_rig(text, "car.yaml")
    sentence = str(caught.value)
    assert caught.value.exit_code == 2
    assert sentence.startswith("car.yaml")
    assert sentence.endswith((".", "?"))
    assert "\n" not in sentence
    return sentence


# --- what it means -----------------------------------------------------------------------------------


def test_every_key_means_what_the_page_says() -> None:
    rig = parse_rig(TEXT, "car.yaml")
    assert (rig.name, rig.description, rig.channels) == ("hand-made", "two cameras", ("CAM_FRONT", "CAM_BACK"))
    assert (rig.depth_limit_m, rig.ground_height_m) == (40.0, 0.1)
    front, back = rig.cameras
    assert front.lens.fx_px == pytest.approx(800.0)
    assert (front.lens.cx_px, front.lens.cy_px) == (799.5, 449.5)
    assert back.lens == Pinhole(400.0, 410.0, 399.5, 199.5, 800, 400)
    # 1.3 m forward of where the file says, because its origin is the vehicle's centre
    np.testing.assert_allclose(front.ego_from_cam, [[0, 0, 1, 2.8], [-1, 0, 0, 0.25], [0, -1, 0, 1.6], [0, 0, 0, 1]])
    np.testing.assert_allclose(back.ego_from_cam, [[0, 0, -1, 0.8], [1, 0, 0, 0], [0, -1, 0, 1.2], [0, 0, 0, 1]])


def test_defaults() -> None:
    """Level, no roll, rear axle, no description, no options."""
    rig = parse_rig(
        "{name: 6, cameras: {C: {width: 4, height: 2, hfov: 90, position: [1, 2, 3], yaw: 180}}}", "car.yaml"
    )
    assert (rig.name, rig.description, rig.depth_limit_m, rig.ground_height_m) == ("6", "", None, None)
    (camera,) = rig.cameras
    np.testing.assert_allclose(
        camera.ego_from_cam, [[0, 0, -1, 1], [1, 0, 0, 2], [0, -1, 0, 3], [0, 0, 0, 1]], atol=1e-15
    )


def test_pitch_and_roll() -> None:
    """Looks 30 degrees up; its right side is a quarter turn down."""
    rig = parse_rig(with_changes(("    yaw: 0\n", "    yaw: 0\n    pitch: 30\n    roll: 90\n")), "car.yaml")
    right, _, ahead = rig.cameras[0].ego_from_cam[:3, :3].T
    np.testing.assert_allclose(ahead, [np.sqrt(0.75), 0, 0.5], atol=1e-15)
    np.testing.assert_allclose(right, [0.5, 0, -np.sqrt(0.75)], atol=1e-15)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("width: 1600", "width: 1600.0"),
        ("    yaw: 0\n", "    <<: {yaw: 0}\n"),  # a merge key is an ordinary way to share values
        ("name: hand-made", "# a comment\nname: hand-made"),
        ("name: hand-made", "\ufeffname: hand-made"),
        ("ground_height: 0.1", "ground_height: 0.1\r"),
    ],
)
def test_other_ways_to_write_the_same(old: str, new: str, tmp_path: Path) -> None:
    path = tmp_path / "car.yaml"
    path.write_bytes(with_changes((old, new)).encode())
    assert load_rig(path).digest == parse_rig(TEXT, "car.yaml").digest


def test_distortion_comes_on_top_of_the_camera_matrix() -> None:
    numbers = [-0.3, 0.1, 1e-3, -2e-3]
    with_lens = parse_rig(with_changes(distortion(f"{{model: opencv, coefficients: {numbers}}}")), "car.yaml")
    pinhole = parse_rig(TEXT, "car.yaml").cameras[0].lens
    np.testing.assert_array_equal(with_lens.cameras[0].lens.matrix, pinhole.matrix)
    assert with_lens.cameras[0].lens == OpenCVLens(*dataclasses.astuple(pinhole), tuple(numbers))
    fisheye = parse_rig(with_changes(distortion("{model: fisheye, coefficients: [0, 0, 0, 0]}")), "car.yaml")
    assert fisheye.cameras[0].lens == FisheyeLens(*dataclasses.astuple(pinhole), (0.0,) * 4)
    assert fisheye.cameras[1].lens == Pinhole(400.0, 410.0, 399.5, 199.5, 800, 400)
    none = parse_rig(with_changes(distortion("{model: opencv, coefficients: [0, 0, 0, 0, 0]}")), "car.yaml")
    assert none.digest == parse_rig(TEXT, "car.yaml").digest
    assert len({rig.digest for rig in (with_lens, fisheye, none)}) == 3


# --- mistakes ----------------------------------------------------------------------------------------

FRONT, BACK, TOP = "camera CAM_FRONT", "camera CAM_BACK", ""
FRONT_YAW, BACK_ROTATION, HFOV = "    yaw: 0\n", "[0.5, -0.5, -0.5, 0.5]", "    hfov: 90\n"
SIZE = "width: 1600\n    height: 900"


def distortion(text: str) -> tuple[str, str]:
    """The change that gives the camera ahead a distortion, on line 10."""
    return FRONT_YAW, f"{FRONT_YAW}    distortion: {text}\n"


@pytest.mark.parametrize(
    ("old", "new", "line", "camera", "words"),
    [
        # unknown keys
        ("    yaw: 0", "    yaww: 0", 9, FRONT, ["yaww is not a known key", "Did you mean yaw?"]),
        ("hfov: 90", "Hfov: 90", 7, FRONT, ["Hfov", "Did you mean hfov?"]),
        ("origin:", "orgin:", 16, TOP, ["orgin", "Did you mean origin?"]),
        ("name: hand-made", "name: a\n3: b", 2, TOP, ["3 is not a known key", "Known keys are name, "]),
        ("name: hand-made", "name: a\n? [x, y]\n: b", 2, TOP, ["is not a known key"]),
        # missing keys
        ("name: hand-made\n", "", None, TOP, ["key name is missing"]),
        ("    width: 1600\n", "", None, FRONT, ["key width is missing"]),
        ("    height: 400\n", "", None, BACK, ["key height is missing"]),
        ("    position: [1.5, 0.25, 1.6]\n", "", None, FRONT, ["key position is missing"]),
        (HFOV, "", None, FRONT, ["hfov", "intrinsics", "missing"]),
        (FRONT_YAW, "", None, FRONT, ["yaw", "rotation", "missing"]),
        ("rear_axle_to_centre: 1.3\n", "", None, TOP, ["rear_axle_to_centre", "metres"]),
        # one too many
        (HFOV, HFOV + "    intrinsics: [1, 1, 1, 1]\n", None, FRONT, ["hfov", "intrinsics", "both"]),
        (FRONT_YAW, "    yaw: 0\n    rotation: [1, 0, 0, 0]\n", None, FRONT, ["yaw", "rotation", "both"]),
        (BACK_ROTATION, BACK_ROTATION + "\n    pitch: 1", 16, BACK, ["pitch", "rotation"]),
        ("origin: vehicle_centre", "origin: rear_axle", 17, TOP, ["rear_axle_to_centre", "vehicle_centre"]),
        # duplicates
        ("  CAM_BACK:", "  CAM_FRONT:", 10, TOP, ["CAM_FRONT is given twice"]),
        (FRONT_YAW, "    yaw: 0\n    yaw: 0\n", 10, TOP, ["yaw is given twice"]),
        ("origin:", "name: b\norigin:", 16, TOP, ["name is given twice"]),
        # fields of view and intrinsics
        ("hfov: 90", "hfov: 0", 7, FRONT, ["hfov", "(0, 180)", "got 0"]),
        ("hfov: 90", "hfov: 180", 7, FRONT, ["hfov", "(0, 180)", "got 180"]),
        ("hfov: 90", "hfov: -70", 7, FRONT, ["hfov", "(0, 180)", "got -70"]),
        ("hfov: 90", "hfov: .nan", 7, FRONT, ["hfov", "finite number", "nan"]),
        ("hfov: 90", "hfov: .inf", 7, FRONT, ["hfov", "finite number", "inf"]),
        ("hfov: 90", "hfov: " + 400 * "9", 7, FRONT, ["hfov", "finite number"]),
        ("hfov: 90", "hfov: '90'", 7, FRONT, ["hfov", "number", "'90'"]),
        ("hfov: 90", "hfov:", 7, FRONT, ["hfov", "number", "None"]),
        ("[400, 410,", "[-400, 410,", 13, BACK, ["intrinsics", "positive", "-400"]),
        ("[400, 410,", "[0, 410,", 13, BACK, ["intrinsics", "positive"]),
        ("[400, 410, 399.5, 199.5]", "[400, 410, 399.5]", 13, BACK, ["intrinsics", "4 numbers"]),
        ("[400, 410, 399.5, 199.5]", "400", 13, BACK, ["intrinsics", "4 numbers"]),
        ("199.5", "true", 13, BACK, ["intrinsics", "finite number", "True"]),
        # sizes
        ("width: 1600", "width: true", 5, FRONT, ["width", "number", "True"]),
        ("width: 1600", "width: 1600.5", 5, FRONT, ["width", "whole number", "1600.5"]),
        ("width: 1600", "width: 0", 5, FRONT, ["width", "got 0"]),
        ("width: 800", "width: -800", 11, BACK, ["width", "-800"]),
        ("height: 400", "height: 40000", 12, BACK, ["height", "32766", "40000"]),
        (SIZE, "width: 30000\n    height: 30000", 5, FRONT, ["width", "900,000,000 pixels"]),
        # positions and rotations
        ("[1.5, 0.25, 1.6]", "[1.5, 0.25, -1.5]", 8, FRONT, ["position", "the ground", "1.6 m"]),
        ("ground_height: 0.1", "ground_height: 1.4", 14, BACK, ["position", "the ground", "0.2 m"]),
        ("[1.5, 0.25, 1.6]", "[1.5, 0.25]", 8, FRONT, ["position", "3 numbers"]),
        ("[1.5, 0.25, 1.6]", "[1.5, .nan, 1.6]", 8, FRONT, ["position", "finite number", "nan"]),
        ("[1.5, 0.25, 1.6]", "[1.5, off, 1.6]", 8, FRONT, ["position", "number", "off"]),
        (BACK_ROTATION, "[1, 1, 0, 0]", 15, BACK, ["rotation", "norm 1", "1.41421"]),
        (BACK_ROTATION, "[0, 0, 0, 0]", 15, BACK, ["rotation", "norm"]),
        (BACK_ROTATION, "[[1, 0, 0], [0, 1, 0], [0, 0, 1]]", 15, BACK, ["rotation", "4 numbers"]),
        ("    yaw: 0", "    yaw: left", 9, FRONT, ["yaw", "number", "left"]),
        ("    yaw: 0", "    yaw: 0\n    roll: -.inf", 10, FRONT, ["roll", "finite number"]),
        # the rest
        ("origin: vehicle_centre", "origin: centre", 16, TOP, ["origin", "rear_axle or vehicle_centre", "'centre'"]),
        ("origin: vehicle_centre", "origin: [rear_axle]", 16, TOP, ["origin", "rear_axle or vehicle_centre"]),
        ("rear_axle_to_centre: 1.3", "rear_axle_to_centre: yes", 17, TOP, ["rear_axle_to_centre", "number"]),
        ("rear_axle_to_centre: 1.3", "rear_axle_to_centre: true", 17, TOP, ["rear_axle_to_centre", "True"]),
        ("depth_limit: 40", "depth_limit: 0", 18, TOP, ["depth_limit", "positive", "got 0"]),
        ("depth_limit: 40", "depth_limit: 1.0e+12", 18, TOP, ["depth_limit", "1000000000000"]),
        ("depth_limit: 40", "depth_limit: .inf", 18, TOP, ["depth_limit", "finite number"]),
        ("ground_height: 0.1", "ground_height: low", 19, TOP, ["ground_height", "number", "low"]),
        ("name: hand-made", "name: true", 1, TOP, ["name", "text", "True"]),
        ("name: hand-made", "name:", 1, TOP, ["name", "text", "None"]),
        ("description: two cameras", "description: [two]", 2, TOP, ["description", "text"]),
        ("  CAM_BACK:", "  ../CAM:", 10, TOP, ["../CAM is not a channel name", "letters, digits"]),
        ("  CAM_BACK:", "  7:", 10, TOP, ["7 is not a channel name"]),
        # distortion
        (*distortion(""), 10, FRONT, ["distortion", "{model: opencv or fisheye, coefficients: [...]}", "None"]),
        (*distortion("[0.1, 0, 0, 0]"), 10, FRONT, ["distortion must be a mapping", "[0.1"]),
        (*distortion("{model: fisheye}"), 10, FRONT, ["distortion lacks the key coefficients", "{model: "]),
        (*distortion("{coefficients: [0, 0, 0, 0]}"), 10, FRONT, ["distortion lacks the key model"]),
        (*distortion("{modle: fisheye}"), 10, FRONT, ["distortion", "modle is not", "Did you mean model?"]),
        (*distortion("\n      model: fish\n      coefficients: []"), 11, FRONT,
            ["model must be opencv or fisheye, got 'fish'", "Did you mean fisheye?"]),
        (*distortion("{model: 4, coefficients: []}"), 10, FRONT, ["model must be opencv or fisheye, got 4"]),
        (*distortion("\n      model: fisheye\n      coefficients: [0, 0, 0, 0, 0]"), 12, FRONT,
            ["coefficients do not fit", "4 coefficients (k1 k2 k3 k4), got 5"]),
        (*distortion("{model: opencv, coefficients: [1, 2, 3]}"), 10, FRONT, ["4, 5, 8, 12, 14 coeff", "got 3"]),
        (*distortion("{model: opencv, coefficients: 0.1}"), 10, FRONT, ["coefficients must be a list of numbers"]),
        (*distortion("{model: opencv, coefficients: [.nan, 0, 0, 0]}"), 10, FRONT, ["coefficients", "finite"]),
        (*distortion("{model: opencv, coefficients: [a, 0, 0, 0]}"), 10, FRONT, ["coefficients", "number", "'a'"]),
        (*distortion("{model: opencv, coefficients: [0,0,0,0,0,0,0,0,0,0,0,0,2,0]}"), 10, FRONT, ["is tilted by"]),
        (*distortion("{model: opencv, coefficients: [-90, 0, 0, 0]}"), 10, FRONT, ["folds back", "pixels"]),
        # not YAML
        ("    width: 1600", "\twidth: 1600", 5, TOP, ["not valid YAML"]),
        ("name: hand-made", "name: a: b", 1, TOP, ["not valid YAML"]),
        ("name: hand-made", "name: *nobody", 1, TOP, ["not valid YAML", "nobody"]),
        ("origin:", "---\norigin:", 16, TOP, ["not valid YAML", "document"]),
    ],
)  # fmt: skip
def test_a_mistake_is_named_by_file_line_camera_and_key(
    old: str, new: str, line: int | None, camera: str, words: list[str]
) -> None:
    sentence = refusal(with_changes((old, new)))
    for word in [*words, camera, f"line {line}:" if line else ""]:
        assert word in sentence


def test_a_camera_on_the_ground_is_not_minus_zero_metres_below_it() -> None:
    sentence = refusal(with_changes(("[1.5, 0.25, 1.6]", "[1.5, 0.25, 0.1]")))
    assert "position" in sentence
    assert "-0 m" not in sentence


@pytest.mark.parametrize("text", ["", "# only a comment\n", "---\n", "null", "- a\n- b\n", "car", "6", "[]", "{}"])
def test_what_is_no_mapping_is_refused(text: str) -> None:
    sentence = refusal(text)
    assert "mapping" in sentence or "missing" in sentence


@pytest.mark.parametrize("cameras", ["", " []", " {}", " 4", " [CAM_FRONT]", "\n- CAM_FRONT"])
def test_what_are_no_cameras_is_refused(cameras: str) -> None:
    assert "line 2: cameras must map channel names" in refusal(f"name: a\ncameras:{cameras}\n")


@pytest.mark.parametrize("camera", ["", " 4", " [1]", " text"])
def test_what_is_no_camera_is_refused(camera: str) -> None:
    assert "camera CAM_FRONT: must be a mapping" in refusal(f"name: a\ncameras:\n  CAM_FRONT:{camera}\n")


def test_too_many_cameras() -> None:
    cameras = "".join(f"  C{index}: {{}}\n" for index in range(65))
    assert "65 cameras; at most 64" in refusal(f"name: a\ncameras:\n{cameras}")


# --- hostile files -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "change",
    [
        ("name: hand-made", "name: !!python/object/apply:os.mkdir [{folder}]"),
        ("hfov: 90", "hfov: !!python/object/apply:os.mkdir [{folder}]"),
        ("origin: vehicle_centre", "origin: !!python/object/new:os.mkdir [{folder}]"),
        ("  CAM_FRONT:\n", "  CAM_FRONT: !!python/object:os.mkdir\n"),
        ("width: 1600", "width: !!python/name:os.mkdir 1600"),
    ],
)
def test_a_python_tag_is_refused_and_nothing_of_it_runs(change: tuple[str, str], tmp_path: Path) -> None:
    folder = tmp_path / "made-by-yaml"
    old, new = change
    with pytest.raises(RigError):
        parse_rig(with_changes((old, new.format(folder=folder))), "car.yaml")
    assert not folder.exists()


@pytest.mark.parametrize("value", ["!!int", "!!float", "!!int abc", "!!float abc", "!!bool abc", "!!timestamp abc"])
def test_a_tag_without_its_value_is_a_sentence_too(value: str) -> None:
    refusal(with_changes(("hfov: 90", f"hfov: {value}")))


@pytest.mark.parametrize("place", ["name: {bomb}\ncameras: {{}}\n", "name: a\ndescription: {bomb}\ncameras: {{}}\n"])
def test_an_anchor_bomb_is_refused_before_it_goes_off(place: str) -> None:
    """Nine levels of nine: 9^9 items if anything walked or printed them all."""
    layers = [
        f"&{name} [{', '.join(['*' + before] * 9)}]" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
    ]
    bomb = f"[&a [{', '.join('x' * 9)}], {', '.join(layers)}]"
    start = time.perf_counter()
    sentence = refusal(place.format(bomb=bomb))
    assert time.perf_counter() - start < 5
    assert len(sentence) < 400


def test_an_anchor_that_holds_itself() -> None:
    assert "CAM_FRONT" in refusal("name: a\ncameras: &c\n  CAM_FRONT: *c\n")


def test_an_anchor_given_twice_adds_no_warning_to_the_sentence(recwarn: pytest.WarningsRecorder) -> None:
    assert "CAM_FRONT" in refusal("name: &a x\ncameras: &a\n  CAM_FRONT: *a\n")
    assert not recwarn.list


@pytest.mark.parametrize("opening", ["[", "{a: "])
def test_a_pit_of_brackets_is_refused(opening: str) -> None:
    assert "not valid YAML" in refusal("name: " + opening * 500)


def test_a_name_that_no_file_could_hold_is_refused() -> None:
    """Half of a surrogate pair: valid YAML, but neither printable nor writable as UTF-8."""
    try:
        rig = parse_rig(with_changes(("name: hand-made", 'name: "\\ud800"')), "car.yaml")
    except RigError:
        return
    rig.name.encode()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\x89PNG\r\n\x1a\n\x00\x00", "not UTF-8 text (byte 0)"),
        (b"name: a\xff", "not UTF-8 text (byte 7)"),
        (b"name: a\x00b", "not valid YAML"),
        (b"name: a\n" + b"#" * MAX_FILE_BYTES, "larger than 1000000 bytes"),
    ],
)
def test_files_that_are_no_text(data: bytes, words: str, tmp_path: Path) -> None:
    path = tmp_path / "car.yaml"
    path.write_bytes(data)
    with pytest.raises(RigError) as caught:
        load_rig(path)
    assert str(path) in str(caught.value)
    assert words in str(caught.value)


@pytest.mark.parametrize(("name", "words"), [("none.yaml", "No such file"), (".", "directory")])
def test_files_that_cannot_be_read(name: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(RigError, match=words) as caught:
        load_rig(tmp_path / name)
    assert str(tmp_path) in str(caught.value)


BITS = [
    "&a ",
    "*a",
    "!!int ",
    "!x ",
    "<<: ",
    "? ",
    ": ",
    "- ",
    "[",
    "}",
    "|",
    '"',
    "#",
    "%",
    ".nan",
    "1e999",
    "\t",
    "\n",
]


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(0, len(TEXT)), st.sampled_from(BITS)), min_size=1, max_size=3))
def test_a_damaged_file_is_a_rig_or_a_sentence(damage: list[tuple[int, str]]) -> None:
    text = TEXT
    for place, bit in damage:
        text = text[:place] + bit + text[place:]
    with contextlib.suppress(RigError):
        assert isinstance(parse_rig(text, "car.yaml"), Rig)
