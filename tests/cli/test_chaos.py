"""Five of the kills of `make chaos`."""

from __future__ import annotations

from pathlib import Path

from tests.chaos import Chaos, moments


def test_two_killed_runs_end_with_the_same_bytes(tmp_path: Path) -> None:
    chaos = Chaos(tmp_path)
    states = [chaos.kill_and_resume(moment) for moment in moments(2, seed=1)]
    assert {"finalise", "units"} & set(states), "no kill found a run at work"
