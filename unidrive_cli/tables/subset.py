"""Consistent parts of a dataset: which rows change when samples or cameras leave."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import Any, Protocol

from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.schema import SampleAnnotation


class Linked(Protocol):
    """A row of a linked list."""

    @property
    def token(self) -> str: ...
    @property
    def prev(self) -> str: ...
    @property
    def next(self) -> str: ...


def mended_links(rows: Sequence[Linked], kept: Collection[str]) -> dict[str, dict[str, str]]:
    """Changes of `prev` and `next` that close the lists over the kept rows.

    A link to a row that leaves is followed until a row that stays; a link that points nowhere ends
    the list.

    Args:
        rows: all rows of one table.
        kept: tokens of the rows that stay.

    Returns:
        Changed fields by token, for the rows that need any.
    """
    by_token = {row.token: row for row in rows}

    def follow(token: str, direction: str) -> str:
        steps = 0
        while token and token not in kept:
            row = by_token.get(token)
            steps += 1
            token = getattr(row, direction) if row is not None and steps <= len(by_token) else ""
        return token

    changes: dict[str, dict[str, str]] = {}
    for row in rows:
        if row.token not in kept:
            continue
        for direction in ("prev", "next"):
            old = getattr(row, direction)
            if old and old not in kept:
                changes.setdefault(row.token, {})[direction] = follow(old, direction)
    return changes


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


def mended_instances(dataset: Dataset, kept_annotations: Collection[str]) -> Iterator[tuple[int, dict[str, Any]]]:
    """(row index, changed fields) of each instance that stays.

    An instance whose annotations all leave goes with them; one that never had any stays.
    """
    samples = dataset.sample.by_token
    first: dict[str, SampleAnnotation] = {}
    last: dict[str, SampleAnnotation] = {}
    count: dict[str, int] = {}
    annotated = set()

    def time(row: SampleAnnotation) -> float:
        return samples[row.sample_token].timestamp

    for row in dataset.sample_annotation.rows:
        token = row.instance_token
        annotated.add(token)
        if row.token not in kept_annotations:
            continue
        count[token] = count.get(token, 0) + 1
        if token not in first or time(row) < time(first[token]):
            first[token] = row
        if token not in last or time(row) >= time(last[token]):
            last[token] = row
    for index, instance in enumerate(dataset.instance.rows):
        token = instance.token
        if token in annotated and token not in first:
            continue
        yield (
            index,
            _differences(
                {
                    "nbr_annotations": (instance.nbr_annotations, count.get(token, 0)),
                    "first_annotation_token": (
                        instance.first_annotation_token,
                        first[token].token if token in first else "",
                    ),
                    "last_annotation_token": (
                        instance.last_annotation_token,
                        last[token].token if token in last else "",
                    ),
                }
            ),
        )


def _differences(fields: dict[str, tuple[Any, Any]]) -> dict[str, Any]:
    return {name: new for name, (old, new) in fields.items() if old != new}
