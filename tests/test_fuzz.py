"""Two hundred broken datasets, rigs and pictures: no traceback, no hang, nothing written outside DST."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.fuzzing import fuzz, to_break

CASES, GROUP = 200, 5


@pytest.fixture(scope="module")
def painted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return to_break(tmp_path_factory.mktemp("painted") / "drive")


@pytest.mark.parametrize("first", range(0, CASES, GROUP))
def test_whatever_is_broken_a_sentence_is_said(first: int, painted: Path, tmp_path: Path) -> None:
    for seed in range(first, first + GROUP):
        (tmp_path / str(seed)).mkdir()
        fuzz(painted, tmp_path / str(seed), seed)
