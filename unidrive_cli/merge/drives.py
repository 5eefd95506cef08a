"""What is kept of a dataset while others are looked at: the moments it recorded, hashes of its tokens and files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from unidrive_cli.errors import DatasetError
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.merge.inputs import Input
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.paths import check_filename
from unidrive_cli.tables.schema import Row, SampleData, Whole
from unidrive_cli.tables.table import Table
from unidrive_cli.tables.tokens import Hashes, short_hashes

DRIVEN = ("scene", "sample", "sample_data", "ego_pose", "sample_annotation", "instance")
"""Tables whose rows belong to one recording and are never those of another."""


class DataPart(Row, frozen=True, gc=False):
    """What merging looks at of a sample_data row."""

    ego_pose_token: str
    calibrated_sensor_token: str
    is_key_frame: bool
    filename: str
    width: Whole | None = None
    height: Whole | None = None
    info_filename: str | None = None

    @property
    def files(self) -> tuple[str, ...]:
        """The files that it names; T4's rows may name two."""
        return (self.filename, self.info_filename) if self.info_filename else (self.filename,)


class _Token(Row, frozen=True, gc=False):
    """A row of which only the token matters."""


@dataclass(frozen=True, eq=False)
class Drive:
    """The recordings of a dataset.

    Attributes:
        source: the dataset.
        tokens: hashes of all tokens, by table.
        files: hashes of the file names in sample_data, in lower case: on some disks others are the same.
        timestamps: (n,) of the samples.
        centres: (n, 3) where the car was, metres, in the global frame; NaN where a sample has no picture.
        pictures: the names of every sample's pictures.
    """

    source: Input
    tokens: dict[str, Hashes]
    files: Hashes
    timestamps: Float
    centres: Float
    pictures: list[list[str]]


def parts_of(table: Table[SampleData]) -> Iterator[DataPart]:
    """The rows of sample_data, of which only what merging looks at is read."""
    return table.parts_at(np.arange(len(table.rows)), DataPart)


def drive_of(source: Input, dataset: Dataset) -> Drive:
    """Reads what must be known of a dataset.

    Raises:
        DatasetError: a file name that leaves the dataset, or a picture that is none of the virtual rig.
    """
    samples = dataset.sample.rows
    pictures: list[list[str]] = [[] for _ in samples]
    poses = np.full(len(samples), -1)
    files = short_hashes(_names(source, dataset, pictures, poses))
    centres = np.full((len(samples), 3), np.nan)
    seen = np.flatnonzero(poses >= 0)
    centres[seen] = [row.translation for row in dataset.ego_pose.rows_at(poses[seen])] if len(seen) else 0.0
    times = np.array([row.timestamp for row in samples], dtype=np.float64)
    return Drive(source, {name: _tokens(getattr(dataset, name)) for name in DRIVEN}, files, times, centres, pictures)


def _tokens(table: Table[Any]) -> Hashes:
    return short_hashes(row.token for row in table.parts_at(np.arange(len(table.rows)), _Token))


def _names(source: Input, dataset: Dataset, pictures: list[list[str]], poses: Any) -> Iterator[str]:
    """The file names of sample_data in lower case; fills in every sample's pictures, and its first one's pose."""
    table, cameras = dataset.sample_data, source.made.rig["cameras"]
    of_sample, of_pose = table.links("sample_token", dataset.sample), table.links("ego_pose_token", dataset.ego_pose)
    for row, sample, pose, is_picture in zip(
        parts_of(table), of_sample.tolist(), of_pose.tolist(), dataset.of_cameras.tolist(), strict=True
    ):
        where = f"{table.file}, token {row.token}"
        for name in row.files:
            check_filename(name, f"{where}, field filename")
        if is_picture:
            channel = dataset.sensor_of_calibration[row.calibrated_sensor_token].channel
            camera = cameras.get(channel)
            if camera is None:
                raise DatasetError(f"is a picture of {channel}, which the virtual rig does not have.", where=where)
            if (row.width, row.height) != (camera["width"], camera["height"]):
                raise DatasetError(
                    f"the picture has {row.width}x{row.height} pixels; {camera['width']}x{camera['height']} was "
                    f"expected, as the virtual rig's {channel} has.",
                    where=where,
                )
            if row.is_key_frame and sample >= 0:
                pictures[sample].append(row.filename)
                if poses[sample] < 0:
                    poses[sample] = pose
        yield from map(str.lower, row.files)
