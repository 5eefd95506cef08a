"""Some scenes of a dataset as a dataset: whole, and nothing of the others."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.datasets import VERSION, Bench, assert_consistent, paint, rows, unidrive
from unidrive_cli.check.references import check_references
from unidrive_cli.tables import thinned as thinned_module
from unidrive_cli.tables.dataset import open_dataset
from unidrive_cli.tables.devkit import check_devkit
from unidrive_cli.tables.thinned import thinned


@pytest.fixture(scope="module")
def painted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return paint(tmp_path_factory.mktemp("painted"), scenes=3)


def test_two_scenes_of_three(painted: Path) -> None:
    dataset = open_dataset(painted)
    chosen = [dataset.scene.rows[0], dataset.scene.rows[2]]
    samples = {sample.token for scene in chosen for sample in dataset.samples_of_scene[scene.token]}
    with thinned(dataset, chosen) as (root, annotations):
        part = open_dataset(root)
        assert list(check_references(part)) == []
        assert part.scene.rows == chosen
        assert {row.token for row in part.sample.rows} == samples
        assert {row.sample_token for row in part.sample_data.rows} == samples
        assert {row.sample_token for row in part.sample_annotation.rows} == samples
        assert annotations == len(part.sample_annotation.rows) == sum(len(dataset.annotations(s)) for s in samples)
        assert {row.token for row in part.ego_pose.rows} == {row.ego_pose_token for row in part.sample_data.rows}
        assert check_devkit(root, VERSION, annotations) > 0
        assert_consistent(root)
    assert not root.exists()


def test_large_outputs_are_opened_in_part(painted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The devkit is shown two scenes of three, with `--verify full` all."""
    opened: list[int] = []

    def spy(root: Path, version: str, annotations: int) -> int:
        opened.append(len(rows(root, "scene")))
        return check_devkit(root, version, annotations)

    monkeypatch.setattr(thinned_module, "check_devkit", spy)
    monkeypatch.setattr(thinned_module, "DEVKIT_SCENES", 2)
    bench = Bench(tmp_path, painted)
    assert bench.convert().code == 0
    assert unidrive("convert", bench.src, bench.dst, "--rig", bench.rig, "--jobs", 0, "--verify", "full").code == 0
    assert opened == [2, 3]
