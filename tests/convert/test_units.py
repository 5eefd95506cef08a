"""Units of work: what a worker keeps, and what it gets."""

from __future__ import annotations

import pickle
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from unidrive_cli.convert.options import Options
from unidrive_cli.convert.units import Job, check_machine, receipt_name, renderer_of
from unidrive_cli.errors import OutputError, UnidriveError
from unidrive_cli.rig.gallery import load_gallery_rig
from unidrive_cli.tables.destination import Destination, begin, digest_of
from unidrive_cli.warp.render import choose_toolchain


@pytest.fixture
def job(tmp_path: Path) -> Job:
    return Job(Destination(tmp_path), load_gallery_rig("4x95"), Options(), choose_toolchain(), "digest")


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


# --- what a machine must have -------------------------------------------------------------------------------------


@pytest.fixture
def begun(job: Job, tmp_path: Path) -> tuple[Job, dict[str, Any]]:
    """A job whose plan lies in DST, as every worker finds it."""
    identity = {"options": {"quality": 95}, **choose_toolchain().identity}
    begin(tmp_path, identity, same=False, force=False)
    return replace(job, key=digest_of(identity)), identity


def test_a_machine_that_has_all_is_taken(begun: tuple[Job, dict[str, Any]], tmp_path: Path) -> None:
    check_machine(begun[0], tmp_path)


def test_a_machine_that_does_not_see_dst_is_refused(begun: tuple[Job, dict[str, Any]], tmp_path: Path) -> None:
    elsewhere = replace(begun[0], destination=Destination(tmp_path / "not-mounted"))
    with pytest.raises(OutputError, match=r"not-mounted: \S+ does not see this conversion in this folder"):
        check_machine(elsewhere, tmp_path)


def test_a_machine_that_sees_another_conversion_in_dst_is_refused(
    begun: tuple[Job, dict[str, Any]], tmp_path: Path
) -> None:
    with pytest.raises(OutputError, match="does not see this conversion"):
        check_machine(replace(begun[0], key="another plan"), tmp_path)


def test_a_machine_that_does_not_see_src_is_refused(begun: tuple[Job, dict[str, Any]], tmp_path: Path) -> None:
    with pytest.raises(UnidriveError, match=r"v1\.0-mini: .* does not see this folder"):
        check_machine(begun[0], tmp_path / "v1.0-mini")


@pytest.mark.parametrize("name", ["kernel", "codec"])
def test_a_machine_with_another_codec_or_kernel_is_refused(job: Job, tmp_path: Path, name: str) -> None:
    identity = {**choose_toolchain().identity, name: "another"}
    begin(tmp_path, identity, same=False, force=False)
    with pytest.raises(UnidriveError, match=f"would work with the {name} .*, the plan with 'another'"):
        check_machine(replace(job, key=digest_of(identity)), tmp_path)
