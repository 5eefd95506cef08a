"""Five of the kills of `make chaos`."""

from __future__ import annotations

import pytest

from tests.chaos import Chaos, Moment, moments


@pytest.fixture(scope="module")
def chaos(tmp_path_factory: pytest.TempPathFactory) -> Chaos:
    return Chaos(tmp_path_factory.mktemp("chaos"))


@pytest.mark.parametrize("moment", moments(5, seed=1), ids=str)
def test_a_killed_run_ends_with_the_same_bytes(chaos: Chaos, moment: Moment) -> None:
    assert chaos.kill_and_resume(moment) != "not begun"
