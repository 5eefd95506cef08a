"""Linked lists stay lists whatever leaves; scenes and instances say what is left of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.tables.small import tables, write
from unidrive_cli.tables.dataset import Dataset, open_dataset
from unidrive_cli.tables.subset import mended_instances, mended_links, mended_scenes
from unidrive_cli.tables.table import table_of

Node = tuple[str, str, str]
"""token, prev, next"""


def chain(tokens: list[str]) -> list[Node]:
    return list(zip(tokens, ["", *tokens], [*tokens[1:], ""], strict=False))


def changes_of(rows: list[Node], kept: set[str]) -> dict[str, dict[str, str]]:
    """What `mended_links` changes in a table of these rows, by token."""
    records = [
        {"token": token, "prev": before, "next": after, "timestamp": 0, "scene_token": ""}
        for token, before, after in rows
    ]
    stays = np.array([token in kept for token, _, _ in rows], dtype=bool)
    return {rows[index][0]: fields for index, fields in mended_links(table_of("sample", records), stays).items()}


def links_after(rows: list[Node], kept: set[str]) -> dict[str, dict[str, str]]:
    """prev and next of the rows that stay, with the changes put in."""
    changes = changes_of(rows, kept)
    assert set(changes) <= kept
    return {
        token: {"prev": before, "next": after} | changes.get(token, {})
        for token, before, after in rows
        if token in kept
    }


@given(st.lists(st.lists(st.booleans(), max_size=12), max_size=4), st.randoms())
def test_what_is_left_of_each_list_is_a_closed_list_in_the_old_order(chains: list[list[bool]], random) -> None:
    """Several lists in one table, its rows in any order, any subset removed."""
    rows, expected = [], {}
    for number, stays in enumerate(chains):
        tokens = [f"{number}-{place}" for place in range(len(stays))]
        rows += chain(tokens)
        left = [token for token, stay in zip(tokens, stays, strict=True) if stay]
        expected |= {token: {"prev": before, "next": after} for token, before, after in chain(left)}
    random.shuffle(rows)
    assert links_after(rows, set(expected)) == expected


def test_nothing_leaves_nothing_changes() -> None:
    rows = chain(["a", "b", "c"])
    assert changes_of(rows, {"a", "b", "c"}) == {}
    assert changes_of(rows, set()) == {}
    assert changes_of([], set()) == {}


def test_by_hand() -> None:
    assert changes_of(chain(["a", "b", "c", "d"]), {"a", "d"}) == {"a": {"next": "d"}, "d": {"prev": "a"}}
    assert changes_of(chain(["a", "b", "c", "d"]), {"b", "c"}) == {"b": {"prev": ""}, "c": {"next": ""}}


def test_links_to_rows_that_were_never_there_end_the_list() -> None:
    """Lyft's extract points outside of itself at both ends."""
    rows = [("a", "gone", "b"), ("b", "a", "c"), ("c", "b", "gone too")]
    assert changes_of(rows, {"a", "b", "c"}) == {"a": {"prev": ""}, "c": {"next": ""}}
    assert changes_of(rows, {"b"}) == {"b": {"prev": "", "next": ""}}


NAMES = ["a", "b", "c", "d", "e"]


@given(
    st.lists(st.tuples(*[st.sampled_from(["", "gone", *NAMES])] * 2), min_size=5, max_size=5),
    st.sets(st.sampled_from(NAMES)),
)
def test_broken_lists_end_and_never_point_at_what_left(links: list[tuple[str, str]], kept: set[str]) -> None:
    """Circles, forks, rows that are their own neighbour."""
    rows = [(token, before, after) for token, (before, after) in zip(NAMES, links, strict=True)]
    for fields in links_after(rows, kept).values():
        assert {*fields.values()} <= {"", *kept}


def test_a_circle_of_rows_that_all_leave() -> None:
    circle = [("b", "c", "c"), ("c", "b", "b")]
    assert changes_of([("a", "", "b"), *circle], {"a"}) == {"a": {"next": ""}}


def test_a_long_list_with_long_gaps_is_no_effort() -> None:
    """100,000 rows, every 1,000th stays: as fast as it is long."""
    tokens = [str(index) for index in range(100_000)]
    kept = tokens[::1000]
    expected = {token: {"prev": before, "next": after} for token, before, after in chain(kept)}
    assert links_after(chain(tokens), set(kept)) == expected


# --- scenes and instances ----------------------------------------------------------------------------


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    """The small dataset with its samples and annotations out of order, a second scene and three more instances."""
    made = tables()
    made["scene"].append(made["scene"][0] | {"token": "other", "name": "scene-0002", "nbr_samples": 1,
                                             "first_sample_token": "t0", "last_sample_token": "t0"})  # fmt: skip
    made["sample"].append({"token": "t0", "timestamp": 9_000_000, "scene_token": "other", "prev": "", "next": ""})
    made["sample"].reverse()
    annotation = made["sample_annotation"][0]
    made["sample_annotation"].append(annotation | {"token": "van-t0", "sample_token": "t0", "instance_token": "van"})
    made["sample_annotation"].reverse()
    blank = {"category_token": "vehicle.car", "first_annotation_token": "", "last_annotation_token": ""}
    made["instance"] += [
        {
            "token": "van",
            "nbr_annotations": 1,
            **blank,
            "first_annotation_token": "van-t0",
            "last_annotation_token": "van-t0",
        },
        {"token": "never-seen", "nbr_annotations": 0, **blank},
        {"token": "lies", "nbr_annotations": 7, **blank, "first_annotation_token": "gone"},
    ]
    return open_dataset(write(tmp_path, made))


@pytest.mark.parametrize(
    ("kept", "expected"),
    [
        ({"s0", "s1", "s2", "t0"}, {0: {}, 1: {}}),
        ({"s1", "s2"}, {0: {"nbr_samples": 2, "first_sample_token": "s1"}}),
        ({"s1"}, {0: {"nbr_samples": 1, "first_sample_token": "s1", "last_sample_token": "s1"}}),
        ({"s0", "s2"}, {0: {"nbr_samples": 2}}),
        ({"t0"}, {1: {}}),
        (set(), {}),
    ],
)
def test_scenes_count_and_name_the_samples_that_stay(dataset: Dataset, kept: set[str], expected: dict) -> None:
    assert dict(mended_scenes(dataset, kept)) == expected


ALWAYS = {2: {}, 3: {"nbr_annotations": 0, "first_annotation_token": ""}}  # never annotated: stay, put right


@pytest.mark.parametrize(
    ("kept", "expected"),
    [
        ({"car-s0", "car-s1", "car-s2", "van-t0"}, {0: {}, 1: {}}),
        ({"car-s1", "car-s2"}, {0: {"nbr_annotations": 2, "first_annotation_token": "car-s1"}}),
        ({"car-s0", "car-s2"}, {0: {"nbr_annotations": 2}}),
        ({"car-s0", "van-t0"}, {0: {"nbr_annotations": 1, "last_annotation_token": "car-s0"}, 1: {}}),
        ({"van-t0"}, {1: {}}),
        (set(), {}),
    ],
)
def test_instances_count_and_name_the_boxes_that_stay(dataset: Dataset, kept: set[str], expected: dict) -> None:
    stays = np.array([row.token in kept for row in dataset.sample_annotation.rows])
    assert dict(mended_instances(dataset, stays)) == expected | ALWAYS
