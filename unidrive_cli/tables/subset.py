"""Consistent parts of a dataset: which rows change when samples or cameras leave."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from unidrive_cli.geometry.arrays import Bool
from unidrive_cli.tables.table import EMPTY, Indices, Table

if TYPE_CHECKING:
    from unidrive_cli.tables.dataset import Dataset  # which imports the layouts, and these use what is here


def mended_links(table: Table[Any], kept: Bool) -> dict[int, dict[str, Any]]:
    """Changes of `prev` and `next` that close the lists over the rows that stay.

    A link to a row that leaves is followed until a row that stays; a link that points nowhere ends
    the list.

    Args:
        kept: (n,) whether a row stays.

    Returns:
        Changed fields by row index, for the rows that need any.
    """
    changes: dict[int, dict[str, Any]] = {}
    for direction in ("prev", "next"):
        open_ends = table.leading_out(direction, kept)
        if not len(open_ends):
            continue
        links = table.links(direction, table)
        ends = _followed(links, kept)[links[open_ends]]
        there = ends >= 0
        tokens = iter([row.token for row in table.rows_at(ends[there])])
        for row, is_there in zip(open_ends.tolist(), there.tolist(), strict=True):
            changes.setdefault(row, {})[direction] = next(tokens) if is_there else ""
    return changes


def _followed(links: Indices, kept: Bool) -> Indices:
    """For every row, and nowhere (the last two): the row that stays at which its list arrives, or EMPTY.

    Every round doubles the steps, so that all arrive that ever do; circles of rows that leave do not.
    """
    count = len(links)
    follow = np.append(np.where(kept, np.arange(count), np.maximum(links, EMPTY)), [EMPTY, EMPTY])
    for _ in range(count.bit_length()):
        further = follow[follow]
        if np.array_equal(further, follow):
            break
        follow = further
    arrived: Indices = np.where(np.append(kept, [False, False])[follow], follow, EMPTY)
    return arrived


def mended_scenes(dataset: Dataset, kept_samples: Collection[str]) -> Iterator[tuple[int, dict[str, Any]]]:
    """(row index, changed fields) of each scene that keeps a sample."""
    for index, scene in enumerate(dataset.scene.rows):
        samples = [row for row in dataset.samples_of_scene[scene.token] if row.token in kept_samples]
        if not samples:
            continue
        yield (
            index,
            _differences(
                {
                    "nbr_samples": (scene.nbr_samples, len(samples)),
                    "first_sample_token": (scene.first_sample_token, samples[0].token),
                    "last_sample_token": (scene.last_sample_token, samples[-1].token),
                }
            ),
        )


def mended_instances(dataset: Dataset, kept_annotations: Bool) -> Iterator[tuple[int, dict[str, Any]]]:
    """(row index, changed fields) of each instance that stays.

    An instance whose annotations all leave goes with them; one that never had any stays.

    Args:
        kept_annotations: (n,) whether an annotation stays.
    """
    table, instances = dataset.sample_annotation, dataset.instance.rows
    owners = table.links("instance_token", dataset.instance)
    annotated = np.bincount(owners, minlength=len(instances)) > 0
    times = np.array([row.timestamp for row in dataset.sample.rows])[table.links("sample_token", dataset.sample)]
    staying = np.flatnonzero(kept_annotations)
    staying = staying[np.lexsort((staying, times[staying], owners[staying]))]
    begins = np.searchsorted(owners[staying], np.arange(len(instances) + 1))
    counts = np.diff(begins)
    ends = {"first_annotation_token": begins[:-1], "last_annotation_token": begins[1:] - 1}
    tokens: dict[str, dict[int, str]] = {}
    for field, places in ends.items():
        rows = np.full(len(instances), EMPTY)
        rows[counts > 0] = staying[places[counts > 0]]
        moved = np.flatnonzero((rows != dataset.instance.links(field, table)) & (counts > 0))
        named = [row.token for row in table.rows_at(rows[moved])]
        tokens[field] = dict(zip(moved.tolist(), named, strict=True))
    for index, instance in enumerate(instances):
        if annotated[index] and not counts[index]:
            continue
        fields: dict[str, tuple[Any, Any]] = {"nbr_annotations": (instance.nbr_annotations, int(counts[index]))}
        for field in ends:
            old = getattr(instance, field)
            fields[field] = (old, tokens[field].get(index, old) if counts[index] else "")
        yield index, _differences(fields)


def _differences(fields: dict[str, tuple[Any, Any]]) -> dict[str, Any]:
    return {name: new for name, (old, new) in fields.items() if old != new}
