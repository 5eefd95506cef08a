"""The search: known optima, the same course whatever the jobs, and continued from its log."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from tests.optimize.fleet import boxes_around, gallery_cars, pair, place_space
from unidrive_cli.errors import OutputError, UsageError
from unidrive_cli.optimize.objective import Car, Objective, Penalties
from unidrive_cli.optimize.search import Best, Effort, Search
from unidrive_cli.optimize.space import Parameter, SearchSpace
from unidrive_cli.rig.model import Rig


def objective(count: int = 60) -> Objective:
    """A fleet of one car, whose cameras stand at x 1.3 and z 1.6."""
    return Objective([Car(pair(x=1.3, z=1.6), boxes_around(count))], Penalties(), 0.0)


def searched(tmp_path: Path, effort: Effort, *, jobs: int = 0, name: str = "log", resume: bool = False) -> Best:
    *_, last = Search(place_space(pair()), objective(), effort, jobs).run(
        tmp_path / name, resume=resume, identity="it"
    )
    return last


def test_the_only_car_s_own_rig_is_found(tmp_path: Path) -> None:
    best = searched(tmp_path, Effort(evaluations=400))
    assert best.values.tolist() == pytest.approx([1.3, 1.6])
    assert best.total == pytest.approx(0, abs=1e-9)


def test_without_a_grid_it_is_found_too(tmp_path: Path) -> None:
    *_, best = Search(place_space(pair(), step=0.0), objective(), Effort(evaluations=600)).run(
        tmp_path / "log", resume=False, identity="it"
    )
    assert best.values.tolist() == pytest.approx([1.3, 1.6], abs=1e-3)


def test_candidates_lie_on_the_grid_and_the_best_never_gets_worse(tmp_path: Path) -> None:
    totals = []
    for best in Search(place_space(pair()), objective(), Effort(evaluations=200)).run(
        tmp_path / "log", resume=False, identity="it"
    ):
        totals.append(best.total)
        for value in best.values.tolist():
            assert round(value * 10) / 10 == value
    assert totals == sorted(totals, reverse=True)


def test_jobs_change_nothing(tmp_path: Path) -> None:
    effort = Effort(seed=3, evaluations=120)
    alone = searched(tmp_path, effort, jobs=0, name="alone")
    together = searched(tmp_path, effort, jobs=3, name="together")
    assert alone.values.tolist() == together.values.tolist()
    assert (tmp_path / "alone").read_bytes() == (tmp_path / "together").read_bytes()


def test_another_seed_takes_another_course(tmp_path: Path) -> None:
    searched(tmp_path, Effort(seed=0, evaluations=20), name="one")
    searched(tmp_path, Effort(seed=1, evaluations=20), name="other")
    assert (tmp_path / "one").read_bytes() != (tmp_path / "other").read_bytes()


@pytest.mark.parametrize("crash", [False, True], ids=["between generations", "in the middle of a line"])
def test_a_resumed_search_ends_like_an_undisturbed_one(tmp_path: Path, crash: bool) -> None:
    whole = searched(tmp_path, Effort(evaluations=150), name="whole")
    course = Search(place_space(pair()), objective(), Effort(evaluations=150)).run(
        tmp_path / "part", resume=False, identity="it"
    )
    for _ in range(5):
        next(course)
    course.close()
    if crash:
        with (tmp_path / "part").open("a") as log:
            log.write("[0.1234, 0.")
    resumed = searched(tmp_path, Effort(evaluations=150), name="part", resume=True)
    assert resumed.values.tolist() == whole.values.tolist()
    assert (resumed.evaluations, resumed.restarts) == (whole.evaluations, whole.restarts)
    assert (tmp_path / "part").read_bytes() == (tmp_path / "whole").read_bytes()


def test_what_the_log_knows_is_not_evaluated_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    searched(tmp_path, Effort(evaluations=60))
    asked = []
    evaluate = Objective.__call__
    monkeypatch.setattr(Objective, "__call__", lambda self, *of: (asked.append(of), evaluate(self, *of))[1])
    searched(tmp_path, Effort(evaluations=60), resume=True)
    assert len(asked) == 1  # the start


def test_a_longer_search_continues_a_shorter_one(tmp_path: Path) -> None:
    longer = searched(tmp_path, Effort(evaluations=90), name="longer")
    searched(tmp_path, Effort(evaluations=30), name="log")
    assert searched(tmp_path, Effort(evaluations=90), name="log", resume=True).total == longer.total


def test_a_finished_start_is_followed_by_another_with_twice_the_candidates(tmp_path: Path) -> None:
    best = searched(tmp_path, Effort(evaluations=1500, population=4))
    assert best.restarts >= 1
    sizes = [len(json.loads(line)) for line in (tmp_path / "log").read_text().splitlines()[1:]]
    assert set(sizes) - {4 * 2**best.restarts} == {4 * 2**restart for restart in range(best.restarts)}
    assert sizes == sorted(sizes)


@pytest.mark.parametrize(
    "text",
    ['{"search": "another"}\n', "", "nonsense", '{"search": "it"}\n["a"]\n', '{"search": "it"}\n[0.5]\n', "[]\n"],
)
def test_the_log_of_another_search(text: str, tmp_path: Path) -> None:
    (tmp_path / "log").write_text(text)
    with pytest.raises(UsageError, match=r"is of another search.*Leave out --resume"):
        searched(tmp_path, Effort(evaluations=20), resume=True)
    assert (tmp_path / "log").read_text().startswith(text[:1])


def test_a_log_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot be written"):
        searched(tmp_path, Effort(evaluations=20), name="nowhere/log")


@pytest.mark.parametrize(
    ("effort", "words"),
    [
        ({"seed": -1}, "--seed must be from 0"),
        ({"evaluations": 0}, "evaluations must be at least 1"),
        ({"population": 2}, "population must be at least 4"),
    ],
)
def test_efforts_that_cannot_be(effort: dict[str, int], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        Effort(**effort)


def test_one_camera_for_one_camera(tmp_path: Path) -> None:
    def alone(x: float) -> Rig:
        whole = pair(x=x, z=1.6)
        return replace(whole, cameras=whole.cameras[:1])

    space = SearchSpace(alone(1.0), 50.0, (Parameter("x", ("CAM_FRONT",), 0.0, 2.0, 0.1),), {})
    single = Objective([Car(alone(1.3), boxes_around(60))], Penalties(), 0.0)
    *_, best = Search(space, single, Effort(evaluations=60)).run(tmp_path / "log", resume=False, identity="it")
    assert best.values.tolist() == [1.3]
    assert best.total == pytest.approx(0, abs=1e-9)


def test_several_cars_are_served_better_than_by_the_start(tmp_path: Path) -> None:
    fleet = Objective(gallery_cars("4x95", "5x70+110", count=60), Penalties(), 0.0)
    first, *_, last = Search(place_space(pair()), fleet, Effort(evaluations=60)).run(
        tmp_path / "log", resume=False, identity="it"
    )
    assert last.total < first.total
