"""A dataset under examination: its tables, and the columns that several rules look at."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from unidrive_cli.check.finding import Broken
from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.tables.dataset import Dataset, open_dataset
from unidrive_cli.tables.layouts.base import Layout
from unidrive_cli.tables.schema import TABLES, Row, Timestamp, Whole
from unidrive_cli.tables.table import NOWHERE, Indices, Table

Item = TypeVar("Item")
PictureSize = Callable[[bytes, str], tuple[int, int]]
"""Gives (width, height) in pixels of a picture from its first bytes, and what errors call it."""
_BATCH = 512


class _Shot(Row, frozen=True, gc=False):
    timestamp: Timestamp
    width: Whole | None = None
    height: Whole | None = None


class Shots(NamedTuple):
    """Of all sample_data rows: (n,) times in the dataset's own unit, widths and heights in pixels, 0 for none."""

    times: Float
    widths: Indices
    heights: Indices


class Lists(NamedTuple):
    """The linked lists of a table.

    Attributes:
        table: whose rows are linked.
        of: what all rows of a list have in common.
        groups: (n,) the number of what each row's list is of; negative where that is not known.
        times: (n,) when each row is; nan where that is not known.
        prev, next: (n,) indices, EMPTY or NOWHERE.
    """

    table: Table[Any]
    of: str
    groups: Indices
    times: Float
    prev: Indices
    next: Indices

    @property
    def joined(self) -> Indices:
        """The rows whose next row leads back to them."""
        rows = np.flatnonzero(self.next >= 0)
        joined: Indices = rows[self.prev[self.next[rows]] == rows]
        return joined


@dataclass(frozen=True, eq=False)
class Subject:
    """A dataset under examination.

    Attributes:
        folder: its version folder.
        layout: which family of datasets it is of.
        picture_size: reads a picture's header.
        jobs: files looked at together.
    """

    folder: Path
    layout: Layout
    picture_size: PictureSize
    jobs: int = 1

    @cached_property
    def missing(self) -> frozenset[str]:
        """Tables that are not there; of some of them the dataset has assumed rows."""
        return frozenset(name for name in TABLES if not (self.folder / f"{name}.json").exists())

    @cached_property
    def dataset(self) -> Dataset:
        """The tables, read.

        Raises:
            DatasetError: one of them cannot be used.
        """
        return open_dataset(self.folder.parent, self.folder.name, layout=self.layout.name, as_found=True)

    @cached_property
    def shots(self) -> Shots:
        """When the sample_data rows were recorded, and how large they are."""
        table = self.dataset.sample_data
        count = len(table.rows)
        shots = Shots(np.empty(count), np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64))
        for index, row in enumerate(table.parts_at(np.arange(count), _Shot)):
            shots.times[index] = row.timestamp
            shots.widths[index], shots.heights[index] = row.width or 0, row.height or 0
        return shots

    @cached_property
    def scene_of_sample(self) -> Indices:
        """(n,) which scene each sample is of, or negative."""
        return self.dataset.sample.links("scene_token", self.dataset.scene)

    @cached_property
    def sample_of_row(self) -> Indices:
        """(n,) which sample each sample_data row is of, or negative."""
        return self.dataset.sample_data.links("sample_token", self.dataset.sample)

    @cached_property
    def sample_of_annotation(self) -> Indices:
        """(n,) which sample each annotation is of, or negative."""
        return self.dataset.sample_annotation.links("sample_token", self.dataset.sample)

    @cached_property
    def sensor_of_row(self) -> Indices:
        """(n,) which sensor has recorded each sample_data row, or negative."""
        data = self.dataset
        sensors = data.calibrated_sensor.links("sensor_token", data.sensor)
        return at(sensors, data.sample_data.links("calibrated_sensor_token", data.calibrated_sensor))

    @cached_property
    def of_cameras(self) -> Bool:
        """(n,) the sample_data rows that cameras have recorded."""
        cameras = np.array([row.modality == "camera" for row in self.dataset.sensor.rows], dtype=np.int64)
        of_cameras: Bool = at(cameras, self.sensor_of_row) > 0
        return of_cameras

    @cached_property
    def lists(self) -> dict[str, Lists]:
        """The linked lists, by the table's name."""
        data = self.dataset
        times = np.array([row.timestamp for row in data.sample.rows], dtype=np.float64)
        annotated = np.full(len(self.sample_of_annotation), np.nan)
        there = self.sample_of_annotation >= 0
        annotated[there] = times[self.sample_of_annotation[there]]
        owners = data.sample_annotation.links("instance_token", data.instance)
        return {
            "sample": _lists(data.sample, "scene", self.scene_of_sample, times),
            "sample_data": _lists(data.sample_data, "scene and channel", self._tracks(), self.shots.times),
            "sample_annotation": _lists(data.sample_annotation, "instance", owners, annotated),
        }

    def _tracks(self) -> Indices:
        """(n,) scene and sensor of each sample_data row as one number; negative for sensors with stray rows."""
        scenes, sensors = at(self.scene_of_sample, self.sample_of_row), self.sensor_of_row
        stray = np.unique(sensors[scenes < 0])
        known = (scenes >= 0) & (sensors >= 0) & ~np.isin(sensors, stray)
        return np.where(known, scenes * max(len(self.dataset.sensor.rows), 1) + sensors, NOWHERE)

    def look_at(self, items: Iterator[Item], look: Callable[[list[Item]], list[Broken]]) -> Iterator[Broken]:
        """What `look` finds in batches of items, `jobs` batches at once, in the order of the items."""
        batches = iter(lambda: list(islice(items, _BATCH)), [])
        if self.jobs < 2:
            for batch in batches:
                yield from look(batch)
            return
        waiting: deque[Future[list[Broken]]] = deque()
        with ThreadPoolExecutor(self.jobs) as threads:
            for batch in batches:
                waiting.append(threads.submit(look, batch))
                if len(waiting) > 2 * self.jobs:
                    yield from waiting.popleft().result()
            for future in waiting:
                yield from future.result()


def at(values: Indices, links: Indices) -> Indices:
    """(n,) the values to which links lead; where they lead nowhere, the links themselves."""
    found = links.copy()
    there = links >= 0
    found[there] = values[links[there]]
    return found


def _lists(table: Table[Any], of: str, groups: Indices, times: Float) -> Lists:
    return Lists(table, of, groups, times, table.links("prev", table), table.links("next", table))
