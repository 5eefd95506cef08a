"""DST: held by one process, emptied safely, and left as it was by a start that failed."""

from __future__ import annotations

import multiprocessing
from pathlib import Path

import pytest

from unidrive_cli.errors import OutputError
from unidrive_cli.tables.converted import PROVENANCE
from unidrive_cli.tables.destination import Destination, abandon, begin, check_destination, held

PLAN = {"options": {"quality": 95}, "rig": {"name": "a"}, "source": {"digest": "b"}}


def _is_refused(root: Path) -> bool:
    try:
        with held(root):
            return False
    except OutputError as error:
        return "another unidrive is writing here" in str(error)


def test_a_second_process_is_refused_until_the_first_has_ended(tmp_path: Path) -> None:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        with held(tmp_path):
            assert pool.apply(_is_refused, (tmp_path,))
        assert not pool.apply(_is_refused, (tmp_path,))


def test_folders_that_were_made_and_stay_empty_go_again(tmp_path: Path) -> None:
    with held(tmp_path / "a" / "b"):
        assert (tmp_path / "a" / "b").is_dir()
    assert not (tmp_path / "a").exists()
    with held(tmp_path / "c"):
        (tmp_path / "c" / "kept").touch()
    assert (tmp_path / "c" / "kept").exists()


def test_emptying_that_was_interrupted_leaves_nothing_that_looks_whole(tmp_path: Path) -> None:
    """Killed after the provenance file was moved aside: the rest is continued as an empty start."""
    (tmp_path / ".unidrive-old").mkdir()
    (tmp_path / ".unidrive-old" / PROVENANCE).write_text("{}")
    assert not check_destination(tmp_path, PLAN, force=False)
    destination = begin(tmp_path, PLAN, same=False, force=False)
    assert sorted(path.name for path in tmp_path.iterdir()) == [".unidrive", "UNFINISHED.txt"]
    abandon(destination)
    assert not any(tmp_path.iterdir())


def test_what_an_earlier_run_has_done_is_never_abandoned(tmp_path: Path) -> None:
    begin(tmp_path, PLAN, same=False, force=False)
    abandon(begin(tmp_path, PLAN, same=True, force=False))
    assert (tmp_path / ".unidrive" / "plan.json").exists()
    (tmp_path / PROVENANCE).write_text("{}")
    abandon(Destination(tmp_path, started=True))
    assert (tmp_path / PROVENANCE).exists()


def test_a_name_that_cannot_be_written_is_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot be written"), held(tmp_path / "file" / "dst"):
        pass
