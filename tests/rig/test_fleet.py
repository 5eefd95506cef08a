"""The fleet file: what it means, and one sentence for each mistake."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from unidrive_cli.errors import UnidriveError
from unidrive_cli.rig.fleet import Fleet, is_fleet_file, load_fleet
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.rig.model import Rig
from unidrive_cli.tables.rig_of_dataset import resolve_fleet

FLEET = "name: two cars\nvirtual: roof-6x70\nsources: [5x70+110, 4x95]\ndepth_limit: 35\nground_height: -0.1\n"
OWN = "name: own\ncameras:\n  CAM_FRONT: {width: 64, height: 36, hfov: 60, position: [1, 0, 1.5], yaw: 0}\n"


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "fleet.yaml"
    path.write_text(text)
    return path


def test_a_whole_file(tmp_path: Path) -> None:
    fleet, notes = resolve_fleet(str(written(tmp_path, FLEET)))
    assert (fleet.name, fleet.common, notes) == ("two cars", True, [])
    assert [rig.name for rig in fleet.sources] == ["5x70+110", "4x95"]
    assert fleet.virtual.digest == load_gallery_rig("roof-6x70").digest
    assert (fleet.virtual.depth_limit_m, fleet.virtual.ground_height_m) == (35, -0.1)


def test_the_virtual_rig_s_own_numbers_stay_where_the_fleet_has_none(tmp_path: Path) -> None:
    (tmp_path / "virtual.yaml").write_text(OWN + "depth_limit: 20\nground_height: 0.2\n")
    fleet, _ = resolve_fleet(
        str(written(tmp_path, "name: a\nvirtual: virtual.yaml\nsources: [4x95]\ncommon: false\n"))
    )
    assert (fleet.virtual.depth_limit_m, fleet.virtual.ground_height_m, fleet.common) == (20, 0.2, False)


def test_paths_are_seen_from_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "cars").mkdir()
    (tmp_path / "cars" / "own.yaml").write_text(OWN)
    (tmp_path / "beside.yaml").write_text(OWN.replace("own", "beside"))
    path = written(
        tmp_path, f"name: a\nvirtual: beside.yaml\nsources: [cars/own.yaml, {tmp_path}/beside.yaml, 4x95]\n"
    )
    monkeypatch.chdir("/")
    fleet, _ = resolve_fleet(str(path))
    assert (fleet.virtual.name, *(rig.name for rig in fleet.sources)) == ("beside", "own", "beside", "4x95")


def test_a_rig_is_a_fleet_of_no_cars(tmp_path: Path) -> None:
    fleet, _ = resolve_fleet("6x60")
    assert (fleet.virtual.name, fleet.sources, fleet.common) == ("6x60", (), False)
    (tmp_path / "own.yaml").write_text(OWN)
    assert not is_fleet_file(tmp_path / "own.yaml")
    assert resolve_fleet(str(tmp_path / "own.yaml"))[0].virtual.name == "own"


MISTAKES = {
    "unknown key": (FLEET + "commn: true\n", "commn is not a known key. Did you mean common?"),
    "no name": (FLEET.replace("name: two cars\n", ""), "the key name is missing"),
    "no virtual": (FLEET.replace("virtual: roof-6x70\n", ""), "the key virtual is missing"),
    "no sources": (FLEET.replace("sources: [5x70+110, 4x95]\n", ""), "the key sources is missing"),
    "empty sources": (FLEET.replace("[5x70+110, 4x95]", "[]"), "sources must be a list of rigs"),
    "one source": (FLEET.replace("[5x70+110, 4x95]", "4x95"), "sources must be a list of rigs"),
    "a source that is a list": (FLEET.replace("[5x70+110, 4x95]", "[[4x95]]"), "sources must be a list of rigs"),
    "too many": (FLEET.replace("[5x70+110, 4x95]", str(["4x95"] * 65)), "sources holds 65 rigs; at most 64"),
    "unknown rig": (FLEET.replace("4x95", "4x96"), "Did you mean 4x95?"),
    "unknown file": (FLEET.replace("roof-6x70", "no/where.yaml"), "no/where.yaml: cannot be read"),
    "common": (FLEET + "common: maybe\n", "common must be true or false, got 'maybe'"),
    "depth limit": (FLEET.replace("35", "0"), "depth_limit must be a positive number of metres, got 0"),
    "ground height": (FLEET.replace("-0.1", "low"), "ground_height must be a finite number"),
    "a fleet in a fleet": (FLEET.replace("roof-6x70", "fleet.yaml"), "virtual is not a known key"),
}


@pytest.mark.parametrize(("text", "words"), MISTAKES.values(), ids=MISTAKES)
def test_mistakes(text: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(UnidriveError, match=re.escape(words)) as caught:
        resolve_fleet(str(written(tmp_path, text)))
    assert caught.value.exit_code == 2


def test_a_virtual_rig_with_distortion(tmp_path: Path) -> None:
    bent = OWN.replace("yaw: 0", "yaw: 0, distortion: {model: fisheye, coefficients: [0.01, 0, 0, 0]}")
    (tmp_path / "bent.yaml").write_text(bent)
    with pytest.raises(UnidriveError, match="virtual must be a rig of pinholes; CAM_FRONT of own has lens"):
        resolve_fleet(str(written(tmp_path, "name: a\nvirtual: bent.yaml\nsources: [4x95]\n")))
    fleet, _ = resolve_fleet(str(written(tmp_path, "name: a\nvirtual: 6x60\nsources: [bent.yaml]\n")))
    assert fleet.sources[0].cameras[0].lens.model == "fisheye"


def test_rigs_come_from_whoever_knows_them(tmp_path: Path) -> None:
    asked = []

    def rig_named(name: str) -> Rig:
        asked.append(name)
        return load_gallery_rig("6x60")

    fleet = load_fleet(written(tmp_path, "name: a\nvirtual: x\nsources: [y, z/w]\n"), rig_named)
    assert isinstance(fleet, Fleet)
    assert asked == ["x", "y", f"{tmp_path}/z/w"]
