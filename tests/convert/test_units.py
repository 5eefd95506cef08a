"""Units of work: what a worker keeps, and what it gets."""

from __future__ import annotations

import pickle
import re
from dataclasses import replace
from pathlib import Path

import pytest

from unidrive_cli.convert.options import Options
from unidrive_cli.convert.units import Job, receipt_name, renderer_of
from unidrive_cli.errors import OutputError
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.tables.destination import Destination


@pytest.fixture
def job(tmp_path: Path) -> Job:
    return Job(Destination(tmp_path), load_gallery_rig("4x95"), Options(), "digest")


def test_a_worker_keeps_its_renderer_from_unit_to_unit(job: Job) -> None:
    """Every task brings its own unpickled copy of the job."""
    first = renderer_of(job)
    assert renderer_of(pickle.loads(pickle.dumps(job))) is first
    assert renderer_of(replace(job, key="another plan")) is not first


def test_a_token_cannot_name_a_file_elsewhere() -> None:
    assert re.fullmatch(r"\.unidrive/receipts/[0-9a-f]{32}\.json", receipt_name("../../../etc/passwd"))


def test_a_file_is_whole_or_not_there(tmp_path: Path) -> None:
    destination = Destination(tmp_path)
    destination.work.mkdir()
    destination.write("a/b.bin", b"1234")
    assert (tmp_path / "a" / "b.bin").read_bytes() == b"1234"
    with pytest.raises(OutputError, match=r"a/b\.bin/c: cannot be written"):
        destination.write("a/b.bin/c", b"")
    assert not any(destination.work.iterdir())
