"""File names of tables must stay inside the dataset, through links too."""

from __future__ import annotations

from pathlib import Path

import pytest

from unidrive_cli.errors import DatasetError
from unidrive_cli.tables.paths import MAX_FILENAME_CHARACTERS, Inside, check_filename

PLACE = "sample_data.json, token a, field filename"


@pytest.mark.parametrize(
    "name", ["a.jpg", "samples/CAM_FRONT/a b.jpg", "samples/..a/é.jpg", "samples/./a.jpg", "~/a", "samples/..."]
)
def test_ordinary_names(name: str, tmp_path: Path) -> None:
    check_filename(name, PLACE)
    assert Inside(tmp_path).resolve(name, PLACE) == tmp_path / name


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("", "names no file"),
        (".", "names no file"),
        ("./", "names no file"),
        ("..", "leaves the dataset"),
        ("../other/a.jpg", "leaves the dataset"),
        ("samples/../../a.jpg", "leaves the dataset"),
        ("samples/..", "leaves the dataset"),
        ("/etc/passwd", "leaves the dataset ('/etc/passwd')"),
        ("//server/a.jpg", "leaves the dataset"),
        ("samples/a\0.jpg", "NUL or a backslash"),
        ("samples\\..\\a.jpg", "NUL or a backslash"),
        ("C:\\a.jpg", "NUL or a backslash"),
        ("a" * (MAX_FILENAME_CHARACTERS + 1), "more than 255 bytes"),
    ],
)
def test_names_that_are_refused(name: str, problem: str, tmp_path: Path) -> None:
    for check in (check_filename, Inside(tmp_path).resolve):
        with pytest.raises(DatasetError) as caught:
            check(name, PLACE)
        sentence = str(caught.value)
        assert sentence.startswith(f"{PLACE}: ")
        assert problem in sentence
        assert len(sentence) < 300


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """data/samples/CAM/a.jpg inside; other/CAM/b.jpg on what stands for another disk."""
    for file in ("data/samples/CAM/a.jpg", "other/CAM/b.jpg", "data-2/c.jpg"):
        (tmp_path / file).parent.mkdir(parents=True)
        (tmp_path / file).write_text(file)
    return tmp_path / "data"


def refused(root: Path, name: str) -> bool:
    try:
        Inside(root).resolve(name, PLACE)
    except DatasetError as error:
        return str(error) == f"{PLACE}: {name!r} is a link that leads out of the dataset."
    return False


def test_a_file_inside(root: Path) -> None:
    files = Inside(root)
    for _ in range(2):
        assert files.resolve("samples/CAM/a.jpg", PLACE).read_text() == "data/samples/CAM/a.jpg"
    assert files.resolve("samples/CAM/not-there.jpg", PLACE) == root / "samples" / "CAM" / "not-there.jpg"


def test_a_top_level_folder_may_be_a_link_to_another_disk(root: Path) -> None:
    (root / "sweeps").symlink_to(root.parent / "other")
    assert Inside(root).resolve("sweeps/CAM/b.jpg", PLACE).read_text() == "other/CAM/b.jpg"


def test_the_root_itself_may_be_a_link(root: Path) -> None:
    (root.parent / "link").symlink_to(root)
    assert Inside(root.parent / "link").resolve("samples/CAM/a.jpg", PLACE).read_text() == "data/samples/CAM/a.jpg"


def test_links_that_stay_inside(root: Path) -> None:
    (root / "samples" / "CAM" / "again.jpg").symlink_to("a.jpg")
    (root / "samples" / "CAM_2").symlink_to(root / "samples" / "CAM")
    (root / "maps").mkdir()
    (root / "maps" / "picture.jpg").symlink_to("../samples/CAM/a.jpg")
    for name in ("samples/CAM/again.jpg", "samples/CAM_2/a.jpg", "maps/picture.jpg"):
        assert Inside(root).resolve(name, PLACE).read_text() == "data/samples/CAM/a.jpg"


def test_links_that_lead_out(root: Path) -> None:
    other = root.parent / "other"
    (root / "samples" / "CAM" / "out.jpg").symlink_to(other / "CAM" / "b.jpg")
    (root / "samples" / "CAM" / "broken.jpg").symlink_to(root.parent / "none.jpg")
    (root / "samples" / "OUT").symlink_to(other / "CAM")
    (root / "samples" / "NEXT").symlink_to(root.parent / "data-2")  # a name that only starts like the root's
    (root / "top.jpg").symlink_to(other / "CAM" / "b.jpg")
    (root / "sweeps").symlink_to(other)
    (other / "CAM" / "on.jpg").symlink_to(root.parent / "data-2" / "c.jpg")  # out of the other disk again
    for name in (
        "samples/CAM/out.jpg", "samples/CAM/broken.jpg", "samples/OUT/b.jpg", "samples/NEXT/c.jpg", "top.jpg",
        "sweeps/CAM/on.jpg",
    ):  # fmt: skip
        assert refused(root, name), name


def test_a_safe_folder_does_not_make_its_links_safe(root: Path) -> None:
    """The folder is looked at once, each link in it every time."""
    (root / "samples" / "CAM" / "out.jpg").symlink_to(root.parent / "other" / "CAM" / "b.jpg")
    files = Inside(root)
    files.resolve("samples/CAM/a.jpg", PLACE)
    with pytest.raises(DatasetError, match="leads out"):
        files.resolve("samples/CAM/out.jpg", PLACE)


def test_a_link_in_a_circle_does_not_hang(root: Path) -> None:
    (root / "samples" / "loop").symlink_to("loop")
    Inside(root).resolve("samples/loop", PLACE)
