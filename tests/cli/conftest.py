"""A painted drive of two scenes with two samples each, which several modules convert; others paint their own."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.datasets import Bench, paint


@pytest.fixture(scope="session")
def painted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return paint(tmp_path_factory.mktemp("painted") / "drive", scenes=2, samples=2)


@pytest.fixture
def bench(painted: Path, tmp_path: Path) -> Bench:
    return Bench(tmp_path, painted)


@pytest.fixture(scope="session")
def default(painted: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The painted drive, converted with no options at all."""
    bench = Bench(tmp_path_factory.mktemp("default"), painted)
    bench.converted()
    return bench.dst
