"""Shares of a conversion: every unit in one of them, whole scenes where that is possible."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from unidrive_cli.convert.parts import Part, part_of
from unidrive_cli.errors import UsageError


def units_of(*sizes: int) -> list[Any]:
    """Stand-ins of which only the scene counts: (scene, sample) pairs."""
    return [
        SimpleNamespace(scene=SimpleNamespace(token=f"scene-{scene}"), sample=(scene, index))
        for scene, size in enumerate(sizes)
        for index in range(size)
    ]


def shares(sizes: tuple[int, ...], count: int) -> list[list[tuple[int, int]]]:
    units = units_of(*sizes)
    return [[unit.sample for unit in Part(number, count).of(units)] for number in range(1, count + 1)]


@pytest.mark.parametrize(
    ("sizes", "count", "expected"),
    [
        ((40, 40, 40, 40), 2, [80, 80]),
        ((40, 40, 40), 2, [40, 80]),
        ((10, 10, 10, 30), 2, [30, 30]),
        ((1, 1, 100), 3, [1, 1, 100]),
        ((100, 1, 1), 3, [100, 1, 1]),
        ((5, 5), 2, [5, 5]),
        ((4, 4), 4, [2, 2, 2, 2]),
        ((3,), 2, [1, 2]),
        ((2,), 4, [0, 1, 0, 1]),
        ((7,), 1, [7]),
    ],
)
def test_how_many_samples_a_share_has(sizes: tuple[int, ...], count: int, expected: list[int]) -> None:
    assert [len(share) for share in shares(sizes, count)] == expected


@given(st.lists(st.integers(1, 50), min_size=1, max_size=12), st.integers(1, 20))
def test_shares_are_all_units_each_once_in_order(sizes: list[int], count: int) -> None:
    found = shares(tuple(sizes), count)
    assert [unit for share in found for unit in share] == [unit.sample for unit in units_of(*sizes)]
    if count <= len(sizes):
        assert all(found)
        scenes = [{scene for scene, _ in share} for share in found]
        assert sum(map(len, scenes)) == len(set().union(*scenes)), "a scene was divided"
    elif count <= sum(sizes):
        lengths = [len(share) for share in found]
        assert max(lengths) - min(lengths) <= 1


def test_a_part_is_read_from_the_command_line() -> None:
    assert part_of("2/12") == Part(2, 12)
    assert str(Part(2, 12)) == "2/12"


@pytest.mark.parametrize(
    "text", ["", "1", "0/4", "5/4", "1/0", "-1/4", "1/4/2", " 1/4", "a/b", "1.0/2", "1/99999999999"]
)
def test_what_is_no_part(text: str) -> None:
    with pytest.raises(UsageError, match=r"--part must be i/n"):
        part_of(text)
