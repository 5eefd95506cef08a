"""Visibility levels: lowered to the band that fits, never raised, none invented."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from unidrive_cli.convert.visibility import VisibilityLevels
from unidrive_cli.tables.schema import NUSCENES_VISIBILITY, Visibility

NUSCENES = [Visibility(row["token"], row["level"]) for row in NUSCENES_VISIBILITY]
T4 = [Visibility("f1", "full"), Visibility("m2", "most"), Visibility("p3", "partial"), Visibility("n4", "none")]
UPPER = {"1": 0.4, "2": 0.6, "3": 0.8, "4": 1.0}


@pytest.mark.parametrize(
    ("token", "shown", "expected"),
    [
        ("4", 1.0, "4"),
        ("4", 0.81, "4"),  # up to 81 % can be visible still: the band 80-100
        ("4", 0.8, "3"),
        ("4", 0.61, "3"),
        ("4", 0.6, "2"),
        ("4", 0.41, "2"),
        ("4", 0.4, "1"),
        ("4", 0.01, "1"),
        ("4", 0.0, "1"),
        ("3", 0.9, "3"),  # at most 72 %: still 60-80
        ("3", 0.75, "2"),  # at most 60 %
        ("3", 0.5, "1"),
        ("2", 0.7, "2"),
        ("2", 0.6, "1"),
        ("1", 0.5, "1"),
        ("1", 0.0, "1"),
        ("", 0.5, ""),  # Lyft: no level known, so none is invented,
        (None, 0.5, None),
        ("other", 0.5, "other"),
        ("", 0.0, "1"),  # unless nothing is shown
        (None, 0.0, "1"),
        ("other", 0.0, "1"),
        ("", 1.0, ""),
    ],
)
def test_nuscenes_levels(token: str | None, shown: float, expected: str | None) -> None:
    levels = VisibilityLevels(NUSCENES)
    assert levels.lowered(token, shown) == expected
    assert levels.added == []


@given(st.sampled_from("1234"), st.floats(0, 1), st.floats(0, 1))
def test_never_raised_and_monotone(token: str, shown: float, other: float) -> None:
    levels = VisibilityLevels(NUSCENES)
    less, more = sorted((shown, other))
    low, high = UPPER[levels.lowered(token, less)], UPPER[levels.lowered(token, more)]
    assert low <= high <= UPPER[token]
    assert high >= UPPER[token] * more - 1e-9  # the band still holds all that may be visible,
    if high > 0.4:
        assert high - 0.2 < UPPER[token] * more + 1e-9  # and no lower band would


def test_t4_names_its_levels() -> None:
    levels = VisibilityLevels(T4)
    assert [levels.lowered("f1", shown) for shown in (1.0, 0.8, 0.6, 0.4, 0.0)] == ["f1", "m2", "p3", "n4", "n4"]
    assert levels.lowered("p3", 0.9) == "p3"
    assert levels.added == []


def test_of_two_tokens_for_one_level_a_box_keeps_its_own() -> None:
    levels = VisibilityLevels([Visibility("a", "v80-100"), Visibility("b", "full"), *NUSCENES[:3]])
    assert [levels.lowered(token, 0.9) for token in ("a", "b")] == ["a", "b"]


def test_a_level_that_is_missing_is_added_as_nuscenes_has_it() -> None:
    levels = VisibilityLevels([Visibility("a", "v80-100"), Visibility("b", "v40-60")])
    assert levels.lowered("a", 0.7) == "3"
    assert levels.lowered("b", 0.1) == "1"
    assert levels.added == [NUSCENES_VISIBILITY[0], NUSCENES_VISIBILITY[2]]


def test_a_token_that_is_taken_is_not_given_again() -> None:
    """Here "1" means full: the lowest band cannot be called "1", so the next one has to do."""
    levels = VisibilityLevels([Visibility("1", "full")])
    assert levels.lowered("1", 0.1) == "2"
    assert [row["token"] for row in levels.added] == ["2"]


def test_levels_that_are_only_numbers_stay() -> None:
    """MAN TruckScenes: level is an int, whose meaning is not known here."""
    levels = VisibilityLevels([Visibility(str(level), level) for level in (1, 2, 3, 4)])
    assert levels.added == []
    for shown in (0.0, 0.5, 1.0):
        assert levels.lowered("3", shown) == "3"


def test_an_empty_table_is_filled() -> None:
    levels = VisibilityLevels([])
    assert levels.added == []
    assert levels.lowered("", 0.0) == "1"
    assert levels.added == [NUSCENES_VISIBILITY[0]]
