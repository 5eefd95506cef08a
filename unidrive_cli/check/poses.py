"""POSE: quaternions and translations of the needed tables must be poses."""

from __future__ import annotations

import numpy as np

from unidrive_cli.errors import DatasetError
from unidrive_cli.tables.dataset import Dataset

MAX_COORDINATE_M = 1e9
MAX_SIZE_M = 1e4


def check_poses(dataset: Dataset) -> None:
    """POSE-1: every rotation has a norm, no translation is absurd; boxes have sizes.

    Raises:
        DatasetError: naming the first row that breaks it.
    """
    for table in (dataset.calibrated_sensor, dataset.ego_pose, dataset.sample_annotation):
        rows, rotations, translations = table.rows, table.numbers("rotation"), table.numbers("translation")
        with np.errstate(over="ignore", invalid="ignore"):
            norms = np.linalg.norm(rotations, axis=1)
        bad = np.flatnonzero(~(np.isfinite(norms) & (norms > 1e-6)))
        if len(bad):
            row = rows[int(bad[0])]
            raise DatasetError(
                f"{list(row.rotation)} has norm {norms[bad[0]]:g}; a unit quaternion w, x, y, z was expected.",
                where=table.place(row, "rotation"),
            )
        bad = np.flatnonzero(~(np.abs(translations) <= MAX_COORDINATE_M).all(axis=1))
        if len(bad):
            raise DatasetError(
                f"must be three numbers of at most {MAX_COORDINATE_M:g} metres.",
                where=table.place(rows[int(bad[0])], "translation"),
            )
    sizes = dataset.sample_annotation.numbers("size")
    sane = ((sizes >= 0) & (sizes <= MAX_SIZE_M)).all(axis=1)
    for box in dataset.sample_annotation.rows_at(np.flatnonzero(~sane)[:1]):
        raise DatasetError(
            f"{list(box.size)}: width, length and height must be from 0 to {MAX_SIZE_M:g} metres.",
            where=dataset.sample_annotation.place(box, "size"),
        )
