"""LINK, TIME: prev and next must make one list of each scene, channel and instance, in the order of time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from unidrive_cli.check.finding import Broken
from unidrive_cli.check.subject import Lists, Subject
from unidrive_cli.tables.table import EMPTY, NOWHERE, Indices


def one_way_links(subject: Subject) -> Iterator[Broken]:
    """The row that next leads to leads back with prev, and the other way round.

    Walks there and back differ.
    """
    for lists in subject.lists.values():
        table = lists.table
        for field, links, other, back in (
            ("next", lists.next, "prev", lists.prev),
            ("prev", lists.prev, "next", lists.next),
        ):
            rows = np.flatnonzero(links >= 0)
            returned = back[links[rows]]
            bad = rows[(returned != rows) & (returned != NOWHERE)]
            for row in table.rows_at(bad):
                what = f"leads to {getattr(row, field)!r}, whose {other} does not lead back."
                yield table.place(row, field), what


def links_elsewhere(subject: Subject) -> Iterator[Broken]:
    """A list stays within its scene (samples), scene and channel (sample_data) or instance (annotations).

    Velocities and sweeps are taken from something else.
    """
    for lists in subject.lists.values():
        rows, groups = lists.joined, lists.groups
        after = groups[lists.next[rows]]
        for row in lists.table.rows_at(rows[(groups[rows] >= 0) & (after >= 0) & (groups[rows] != after)]):
            yield lists.table.place(row, "next"), f"leads to {row.next!r}, which is of another {lists.of}."


def lists_in_pieces(subject: Subject) -> Iterator[Broken]:
    """The samples of a scene, its sample_data of a channel, and the annotations of an instance are one list.

    Walks end early.
    """
    for lists in subject.lists.values():
        begins = _beginnings(lists)
        begins = begins[np.lexsort((lists.times[begins], lists.groups[begins]))]
        again = np.flatnonzero(np.diff(lists.groups[begins], prepend=NOWHERE) == 0)
        for row in lists.table.rows_at(begins[again]):
            what = f"is empty, but there are earlier rows of the same {lists.of}: its list is in pieces."
            yield lists.table.place(row, "prev"), what


def times_not_rising(subject: Subject) -> Iterator[Broken]:
    """The next row of a list is later.

    Velocities have the wrong sign or divide by nothing; a list that closes on itself never ends.
    """
    for name, lists in subject.lists.items():
        rows = lists.joined
        bad = rows[lists.times[lists.next[rows]] <= lists.times[rows]]
        field = "next" if name == "sample_annotation" else "timestamp"
        for row in lists.table.rows_at(bad):
            yield lists.table.place(row, field), f"the next row, {row.next!r}, is not later than this one."


def _beginnings(lists: Lists) -> Indices:
    is_led_to = np.zeros(len(lists.next), dtype=bool)
    is_led_to[lists.next[lists.next >= 0]] = True
    return np.flatnonzero((lists.prev == EMPTY) & ~is_led_to & (lists.groups >= 0))
