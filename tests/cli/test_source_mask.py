"""`--source-mask`: what the own car covers in source pictures is left out, and a sentence for every mistake."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.datasets import Bench, tree

WIDTH, HEIGHT = 80, 45


def folder_of(root: Path, name: str = "masks", **masks: np.ndarray) -> Path:
    folder = root / name
    folder.mkdir()
    for channel, mask in masks.items():
        assert cv2.imwrite(str(folder / f"{channel}.png"), mask)
    return folder


def lower(rows: int, value: int = 255) -> np.ndarray:
    """A mask of the lowest rows."""
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[HEIGHT - rows :] = value
    return mask


@pytest.fixture
def outside(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("outside")


def coverage(root: Path, channel: str) -> list[np.ndarray]:
    found = [
        cv2.imread(str(path), cv2.IMREAD_UNCHANGED) > 0 for path in sorted((root / "masks" / channel).iterdir())
    ]
    assert found
    return found


def test_what_only_a_hidden_part_sees_is_black_and_masked(bench: Bench, default: Path, outside: Path) -> None:
    bench.converted("--source-mask", folder_of(outside, CAM_BACK=lower(12)))
    fewer = 0
    for before, after in zip(coverage(default, "CAM_BACK"), coverage(bench.dst, "CAM_BACK"), strict=True):
        assert not (after & ~before).any()
        fewer += np.count_nonzero(before & ~after)
        assert not after[-1, 20:-20].any()
        assert (after[:20] == before[:20]).all()
    assert fewer > 100
    front = [path.read_bytes() for path in sorted((default / "samples" / "CAM_FRONT").iterdir())]
    assert front == [path.read_bytes() for path in sorted((bench.dst / "samples" / "CAM_FRONT").iterdir())]


def test_static_coverage_leaves_it_out_too(bench: Bench, outside: Path) -> None:
    masks = folder_of(outside, CAM_BACK=lower(12))
    bench.converted("--source-mask", masks, "--masks", "camera")
    static = cv2.imread(str(bench.dst / "masks" / "CAM_BACK.png"), cv2.IMREAD_UNCHANGED)
    assert static[:20].any()
    assert not static[-1, 20:-20].any()


def test_what_it_hides_does_not_count_as_covered(bench: Bench, outside: Path) -> None:
    options = ("--min-coverage", 0.6)
    bench.converted(*options)
    masks = folder_of(outside, CAM_BACK=lower(32))
    run = bench.converted(*options, "--source-mask", masks, dst=bench.folder / "other")
    assert "Left out, being covered less than 60% in the mean of all samples: CAM_BACK (" in run.stdout


def test_the_plan_is_that_of_what_the_masks_hold(bench: Bench, outside: Path) -> None:
    bench.converted("--source-mask", folder_of(outside, CAM_BACK=lower(12)))
    digests = json.loads((bench.dst / "unidrive.json").read_text())["plan"]["options"]["source_masks"]
    assert list(digests) == ["CAM_BACK"]
    before = tree(bench.dst)
    same = folder_of(outside, "elsewhere", CAM_BACK=lower(12, value=1))
    assert bench.convert("--source-mask", same, "--json").json()["already_complete"] is True
    assert tree(bench.dst) == before
    bench.refused(2, "--force", options=("--source-mask", folder_of(outside, "other", CAM_BACK=lower(13))))
    bench.refused(2, "--force")


def test_it_comes_from_the_environment_and_workers_know_it(bench: Bench, outside: Path) -> None:
    masks = folder_of(outside, CAM_BACK=lower(12), CAM_FRONT_LEFT=lower(5))
    bench.converted("--source-mask", masks, dst=bench.folder / "dst-1")
    bench.converted("--jobs", 2, env={"UNIDRIVE_SOURCE_MASK": str(masks)}, dst=bench.folder / "dst-2")
    first, second = (tree(bench.folder / name, apart=("run.json",)) for name in ("dst-1", "dst-2"))
    assert first == second


def _other_size(folder: Path) -> None:
    cv2.imwrite(str(folder / "CAM_BACK.png"), np.zeros((HEIGHT, WIDTH + 1), np.uint8))


def _unknown(folder: Path) -> None:
    cv2.imwrite(str(folder / "CAM_BAK.png"), lower(3))


def _jpeg(folder: Path) -> None:
    cv2.imwrite(str(folder / "CAM_BACK.jpg"), lower(3))


def _inverted(folder: Path) -> None:
    cv2.imwrite(str(folder / "CAM_BACK.png"), 255 - lower(6))


def _coloured(folder: Path) -> None:
    cv2.imwrite(str(folder / "CAM_BACK.png"), np.zeros((HEIGHT, WIDTH, 3), np.uint8))


def _truncated(folder: Path) -> None:
    data = cv2.imencode(".png", lower(6))[1].tobytes()
    (folder / "CAM_BACK.png").write_bytes(data[: len(data) // 2])


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_other_size, ("CAM_BACK.png", "81x45", "80x45")),
        (_unknown, ("CAM_BAK is no camera of", "Did you mean CAM_BACK?")),
        (_jpeg, ("CAM_BACK.jpg", "must be a PNG file, CAM_BACK.png")),
        (_inverted, ("CAM_BACK.png", "takes 87% of the picture", "inverted")),
        (_coloured, ("CAM_BACK.png", "has 3 channels; one was expected")),
        (_truncated, ("CAM_BACK.png", "broken PNG")),
        (lambda folder: None, ("holds no masks",)),
        (lambda folder: folder.rmdir(), ("must be a folder",)),
    ],
)
def test_a_mistake_is_a_sentence(
    bench: Bench, outside: Path, spoil: Callable[[Path], None], words: tuple[str, ...]
) -> None:
    folder = folder_of(outside)
    spoil(folder)
    bench.refused(
        2, str(folder) if spoil is not _other_size else "--source-mask", *words, options=("--source-mask", folder)
    )


def test_other_files_in_the_folder_do_not_matter(bench: Bench, outside: Path) -> None:
    folder = folder_of(outside, CAM_BACK=lower(12))
    (folder / "README.txt").write_text("white is the car")
    (folder / ".hidden.png").write_bytes(b"")
    assert bench.convert("--dry-run", "--source-mask", folder).code == 0
