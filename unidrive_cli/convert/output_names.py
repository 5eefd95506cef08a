"""What files that go along unchanged are called in the output."""

from __future__ import annotations

from functools import cached_property
from pathlib import PurePosixPath

import numpy as np

from unidrive_cli.errors import DatasetError
from unidrive_cli.geometry.arrays import Bool
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.devkit import LABELS


class OutputNames:
    """Names in the output, by names in the source; most stay.

    Files of other sensors are given nuScenes' places where the source's layout has others and is not kept.
    """

    def __init__(self, dataset: Dataset, version: str, *, keep_layout: bool) -> None:
        """
        Args:
            version: the output's version folder.

        Raises:
            DatasetError: two files would have one name.
        """
        self._dataset = dataset
        self._version = version
        self._sorts = dataset.layout.sorts_files and not keep_layout
        taken: dict[str, str] = {}
        for source, target in self._sorted.items():
            other = taken.setdefault(target, source)
            if other != source:
                raise DatasetError(
                    f"the files {other} and {source} would both become {target}.",
                    where=dataset.sample_data.file,
                    hint="Give one of them another name, in the table too.",
                )

    def __getitem__(self, filename: str) -> str:
        """The name in the output of a file of the source."""
        top, _, below = filename.partition("/")
        if top in LABELS and below.startswith(f"{self._dataset.version}/"):
            return f"{top}/{self._version}{below[len(self._dataset.version) :]}"
        return self._sorted.get(filename, filename)

    def moved(self, rows: Bool) -> dict[int, str]:
        """New names of the files of sample_data rows, by the row's index, where they change.

        Args:
            rows: (n,) the rows to look at.
        """
        if not self._sorts:
            return {}
        indices = np.flatnonzero(rows)
        found = zip(indices.tolist(), self._dataset.sample_data.rows_at(indices), strict=True)
        return {index: name for index, row in found if (name := self[row.filename]) != row.filename}

    @cached_property
    def _sorted(self) -> dict[str, str]:
        names: dict[str, str] = {}
        if self._sorts:
            for row in self._dataset.sample_data.rows_at(np.flatnonzero(~self._dataset.of_cameras)):
                folder = "samples" if row.is_key_frame else "sweeps"
                name = PurePosixPath(row.filename).name
                names.setdefault(row.filename, f"{folder}/{self._dataset.sensor_of(row).channel}/{name}")
        return names
