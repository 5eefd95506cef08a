"""POSE, BOX: poses must be poses, boxes must have sizes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from unidrive_cli.check.finding import Broken
from unidrive_cli.check.subject import Subject
from unidrive_cli.errors import DatasetError
from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.table import Indices, Table

MAX_COORDINATE_M = 1e9
MAX_SIZE_M = 1e4
MIN_NORM = 1e-6
UNIT_TOLERANCE = 1e-3
Rotations = dict[str, dict[int, list[float]]]
"""Quaternions w, x, y, z by table and index of the row."""


def check_poses(dataset: Dataset) -> Rotations:
    """What arithmetic with poses and boxes needs of POSE-1, POSE-2 and BOX-1; boxes may be flat.

    Returns:
        Of rotations that are no unit quaternions (POSE-3): these scaled to unit length.

    Raises:
        DatasetError: naming the first row that breaks it.
    """
    scaled: Rotations = {}
    for table in _tables(dataset):
        norms = _norms(table)
        for where, what in (*_no_rotations(table, norms), *_far_off(table)):
            raise DatasetError(what, where=where)
        if len(bad := _not_unit(norms)):
            units = table.numbers("rotation")[bad] / norms[bad, None]
            scaled[table.name] = dict(zip(bad.tolist(), units.tolist(), strict=True))
    sizes = dataset.sample_annotation.numbers("size")
    for where, what in _sizeless(dataset, ((sizes >= 0) & (sizes <= MAX_SIZE_M)).all(axis=1), "from 0 to"):
        raise DatasetError(what, where=where)
    return scaled


def no_rotations(subject: Subject) -> Iterator[Broken]:
    """A rotation is a quaternion that has a norm.

    It is no rotation.
    """
    for table in _tables(subject.dataset):
        yield from _no_rotations(table, _norms(table))


def far_translations(subject: Subject) -> Iterator[Broken]:
    """A translation is at most 1e9 metres.

    It is no place on earth.
    """
    for table in _tables(subject.dataset):
        yield from _far_off(table)


def rotations_not_unit(subject: Subject) -> Iterator[Broken]:
    """A rotation is a unit quaternion, within 0.001.

    Some readers scale it, others get a matrix that also stretches.
    """
    for table in _tables(subject.dataset):
        norms = _norms(table)
        bad = _not_unit(norms)
        for row, norm in zip(table.rows_at(bad), norms[bad], strict=True):
            what = f"{list(row.rotation)} has norm {norm:g}; a unit quaternion w, x, y, z was expected."
            yield table.place(row, "rotation"), what


def sizeless_boxes(subject: Subject) -> Iterator[Broken]:
    """Width, length and height of a box are above 0, up to 10000 metres.

    IoU and size losses divide by them.
    """
    sizes = subject.dataset.sample_annotation.numbers("size")
    yield from _sizeless(subject.dataset, ((sizes > 0) & (sizes <= MAX_SIZE_M)).all(axis=1), "above 0, up to")


def _tables(dataset: Dataset) -> tuple[Table[Any], ...]:
    return dataset.calibrated_sensor, dataset.ego_pose, dataset.sample_annotation


def _norms(table: Table[Any]) -> Float:
    with np.errstate(over="ignore", invalid="ignore"):
        norms: Float = np.linalg.norm(table.numbers("rotation"), axis=1)
    return norms


def _not_unit(norms: Float) -> Indices:
    return np.flatnonzero((norms > MIN_NORM) & ~(np.abs(norms - 1) <= UNIT_TOLERANCE) & np.isfinite(norms))


def _no_rotations(table: Table[Any], norms: Float) -> Iterator[Broken]:
    bad = np.flatnonzero(~(np.isfinite(norms) & (norms > MIN_NORM)))
    for row, norm in zip(table.rows_at(bad), norms[bad], strict=True):
        what = f"{list(row.rotation)} has norm {norm:g}; a unit quaternion w, x, y, z was expected."
        yield table.place(row, "rotation"), what


def _far_off(table: Table[Any]) -> Iterator[Broken]:
    bad = np.flatnonzero(~(np.abs(table.numbers("translation")) <= MAX_COORDINATE_M).all(axis=1))
    for row in table.rows_at(bad):
        yield table.place(row, "translation"), f"must be three numbers of at most {MAX_COORDINATE_M:g} metres."


def _sizeless(dataset: Dataset, sane: Bool, limits: str) -> Iterator[Broken]:
    for box in dataset.sample_annotation.rows_at(np.flatnonzero(~sane)):
        what = f"{list(box.size)}: width, length and height must be {limits} {MAX_SIZE_M:g} metres."
        yield dataset.sample_annotation.place(box, "size"), what
