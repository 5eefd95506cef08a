"""The search file: what it means, and one sentence for each mistake."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from unidrive_cli.errors import UnidriveError
from unidrive_cli.optimize.objective import Penalties
from unidrive_cli.optimize.search_file import SearchFile, load_search
from unidrive_cli.optimize.space import Parameter
from unidrive_cli.rig.gallery import gallery_folder, load_gallery_rig

WHOLE = """\
name: found
description: a trial
start: roof-6x70
mirror: {CAM_FRONT_RIGHT: CAM_FRONT_LEFT, CAM_BACK_RIGHT: CAM_BACK_LEFT}
free:
  - {of: x, cameras: all, min: -1, max: 3, step: 0.05}
  - {of: z, cameras: all, share: true, min: 1.2, max: 2, step: 0.01}
  - {of: yaw, cameras: [CAM_FRONT_LEFT], within: 20, step: 0.5}
  - {of: depth_limit, min: 15, max: 120}
penalties: {uncovered: 3, worst: 0.5}
evaluations: 500
population: 20
"""
LEADERS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK", "CAM_BACK_LEFT")


def load(tmp_path: Path, text: str) -> SearchFile:
    path = tmp_path / "search.yaml"
    path.write_text(text)
    return load_search(path, load_gallery_rig)


def test_a_whole_file(tmp_path: Path) -> None:
    found = load(tmp_path, WHOLE)
    assert (found.name, found.description, found.ground_height_m) == ("found", "a trial", 0.0)
    assert found.space.parameters == (
        *(Parameter("x", (channel,), -1, 3, 0.05) for channel in LEADERS),
        Parameter("z", LEADERS, 1.2, 2, 0.01),
        Parameter("yaw", ("CAM_FRONT_LEFT",), -20, 20, 0.5, relative=True),
        Parameter("depth_limit", (), 15, 120, 0),
    )
    assert found.space.mirror == {"CAM_FRONT_RIGHT": "CAM_FRONT_LEFT", "CAM_BACK_RIGHT": "CAM_BACK_LEFT"}
    assert found.penalties == Penalties(uncovered=3, unfilled=Penalties().unfilled, worst=0.5)
    assert (found.effort.evaluations, found.effort.population) == (500, 20)
    assert not found.common
    assert load(tmp_path, WHOLE + "corners: common\n").common


def test_the_start_s_own_depth_limit_and_ground_count(tmp_path: Path) -> None:
    from dataclasses import replace

    path = tmp_path / "search.yaml"
    path.write_text("name: a\nstart: b\nfree: [{of: x, cameras: all, min: -1, max: 3}]\n")
    found = load_search(
        path, lambda name: replace(load_gallery_rig("roof-6x70"), depth_limit_m=33.0, ground_height_m=-0.1)
    )
    assert (found.space.start_depth_limit_m, found.ground_height_m) == (33.0, -0.1)


def test_the_shipped_search_files_are_in_order() -> None:
    shipped = sorted((gallery_folder() / "searches").glob("*.yaml"))
    assert shipped
    for path in shipped:
        assert load_search(path, load_gallery_rig).name == path.stem


MISTAKES = {
    "a list": ("- a\n", "a search file must be a mapping with the keys name, start and free"),
    "not yaml": ("name: [\n", "is not valid YAML"),
    "unknown key": (WHOLE + "evaluation: 3\n", "evaluation is not a known key. Did you mean evaluations?"),
    "no start": (WHOLE.replace("start: roof-6x70\n", ""), "the key start is missing"),
    "unknown start": (WHOLE.replace("roof-6x70", "roof-6x07"), "Did you mean roof-6x70?"),
    "nothing free": (WHOLE[: WHOLE.index("  - {of: x")] + "  []\n", "free must be a list of free numbers"),
    "a free text": (
        WHOLE.replace("  - {of: depth_limit, min: 15, max: 120}", "  - depth"),
        "free number 4: must be",
    ),
    "unknown quantity": (WHOLE.replace("of: yaw", "of: jaw"), "names no quantity: 'jaw'. Did you mean yaw?"),
    "unknown quantity, nothing near": (WHOLE.replace("of: yaw", "of: colour"), "Known are x, y, z"),
    "no bounds": (WHOLE.replace("within: 20, ", ""), "either min and max, or within, must be given"),
    "both bounds": (WHOLE.replace("within: 20", "within: 20, min: 3"), "either min and max, or within"),
    "one bound": (WHOLE.replace("min: 15, ", ""), "free number 4: either min and max"),
    "within nothing": (WHOLE.replace("within: 20", "within: 0"), "within must be a positive number, got 0"),
    "a text as bound": (WHOLE.replace("min: 15", "min: low"), "min must be a finite number"),
    "corners of another kind": (WHOLE + "corners: shared\n", "corners must be own or common, got 'shared'"),
    "no cameras": (WHOLE.replace("cameras: [CAM_FRONT_LEFT], ", ""), "the key cameras is missing"),
    "a camera that is not there": (
        WHOLE.replace("[CAM_FRONT_LEFT]", "[CAM_TOP]"),
        "roof-6x70 has no camera CAM_TOP",
    ),
    "cameras as a text": (
        WHOLE.replace("[CAM_FRONT_LEFT]", "most"),
        "must be a list of channels, or all, got 'most'",
    ),
    "share": (WHOLE.replace("share: true", "share: maybe"), "share must be true or false"),
    "depth limit with cameras": (
        WHOLE.replace("{of: depth_limit,", "{of: depth_limit, cameras: all,"),
        "does not go with depth_limit",
    ),
    "mirror": (WHOLE[: WHOLE.index("mirror")] + "mirror: [a]\n" + WHOLE[WHOLE.index("free") :], "mirror must map"),
    "mirror of nobody": (WHOLE.replace("{CAM_FRONT_RIGHT:", "{CAM_TOP:"), "mirror: roof-6x70 has no camera CAM_TOP"),
    "unknown penalty": (WHOLE.replace("worst:", "worse:"), "worse is not a known key. Did you mean worst?"),
    "negative penalty": (WHOLE.replace("uncovered: 3", "uncovered: -3"), "uncovered must not be negative, got -3"),
    "penalties": (WHOLE.replace("{uncovered: 3, worst: 0.5}", "3"), "penalties must map"),
    "half an evaluation": (WHOLE.replace("500", "500.5"), "evaluations must be a whole number, got 500.5"),
    "no evaluations": (WHOLE.replace("500", "0"), "evaluations must be at least 1, got 0"),
    "bounds without the start": (WHOLE.replace("min: -1", "min: 2"), "outside of the bounds 2 to 3"),
}


@pytest.mark.parametrize(("text", "words"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes(text: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(UnidriveError, match=re.escape(words)) as caught:
        load(tmp_path, text)
    assert caught.value.exit_code == 2
    if "start" not in words and "roof-6x70?" not in words:
        assert str(tmp_path / "search.yaml") in str(caught.value)


def test_a_start_with_distortion(tmp_path: Path) -> None:
    from unidrive_cli.rig.yaml_file import parse_rig

    bent = parse_rig(
        "name: bent\ncameras:\n  CAM_FRONT: {width: 320, height: 180, hfov: 90, position: [1, 0, 1.5], yaw: 0,\n"
        "    distortion: {model: fisheye, coefficients: [0.01, 0, 0, 0]}}\n",
        "bent.yaml",
    )
    path = tmp_path / "search.yaml"
    path.write_text("name: a\nstart: bent\nfree: [{of: x, cameras: all, min: -1, max: 3}]\n")
    with pytest.raises(UnidriveError, match="start must be a virtual rig; CAM_FRONT has lens distortion"):
        load_search(path, lambda name: bent)
