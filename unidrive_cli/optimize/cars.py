"""The cars of a search: rigs, and boxes where their cameras find them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from unidrive_cli.check.poses import check_poses
from unidrive_cli.errors import DatasetError, UsageError
from unidrive_cli.geometry import boxes
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.geometry.poses import relative
from unidrive_cli.optimize.objective import Car
from unidrive_cli.rig.model import Rig
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.moments import reference_of
from unidrive_cli.tables.rig_of_dataset import SizeOfFile, open_named, resolve_rig, rig_of_dataset

_SEED = 0


def cars_of(
    sources: Sequence[str],
    boxes_of: str | None,
    most_boxes: int,
    size_of_file: SizeOfFile | None = None,
    *,
    common: bool = False,
) -> tuple[list[Car], list[str]]:
    """The cars that SRC arguments mean: datasets with boxes, or rigs that borrow those of `boxes_of`.

    Args:
        sources: datasets, rig files, or names of shipped rigs.
        boxes_of: a dataset whose boxes stand in for those that a source lacks.
        most_boxes: where a dataset has more, so many of them, drawn at random, always the same ones.
        size_of_file: says the size of a dataset's pictures that have none in their table.
        common: of all boxes, only corners that the cameras of every car see count.

    Returns:
        The cars, and notes.

    Raises:
        UsageError: a source without boxes, and no `boxes_of`; boxes that no camera sees; a source given twice.
        RigError, DatasetError: a source that cannot be read.
    """
    if most_boxes < 1:
        raise UsageError(f"--max-boxes must be at least 1, got {most_boxes}.")
    borrowed = None if boxes_of is None else corners_of(open_named(Path(boxes_of)), most_boxes)
    if borrowed is not None and not len(borrowed):
        raise DatasetError("has no annotations, so there are no boxes to borrow.", where=str(boxes_of))
    seen: list[tuple[Rig, Float]] = []
    notes: list[str] = []
    for source in sources:
        own = None
        if Path(source).is_dir():
            dataset = open_named(Path(source))
            rig, more = rig_of_dataset(dataset, size_of_file=size_of_file)
            own = corners_of(dataset, most_boxes)
        else:
            rig, more = resolve_rig(source)
        notes.extend(more)
        if own is None or not len(own):
            if borrowed is None:
                raise UsageError(f"{source} has no boxes.", hint="Give a dataset that has some with --boxes.")
            own = borrowed
        if any(rig.digest == other.digest for other, _ in seen):
            notes.append(f"{source} has the cameras of a source before it; it counts once more.")
        seen.append((rig, own))
    fleet = [rig for rig, _ in seen] if common else []
    return [Car(rig, own, fleet) for rig, own in seen], notes


def corners_of(dataset: Dataset, most_boxes: int) -> Float:
    """Corners (b, 8, 3) of a dataset's boxes in the ego frame at their samples' reference moments, metres.

    Raises:
        DatasetError: dangling tokens, or numbers that are no pose or no box.
    """
    check_poses(dataset)
    samples = dataset.sample_annotation.links("sample_token", dataset.sample)
    indices = np.flatnonzero(samples >= 0)
    if len(indices) > most_boxes:
        indices = np.sort(np.random.default_rng(_SEED).choice(indices, most_boxes, replace=False))
    order = indices[np.argsort(samples[indices], kind="stable")]
    poses, sizes, current, global_from_ego = [], [], -1, np.eye(4)
    for row, sample in zip(dataset.sample_annotation.rows_at(order), samples[order].tolist(), strict=True):
        if sample != current:
            current = sample
            global_from_ego = dataset.global_from_ego(reference_of(dataset, dataset.sample.rows[sample]))
        poses.append(relative(global_from_ego, dataset.global_from_box(row)))
        sizes.append(row.size)
    if not poses:
        return np.empty((0, 8, 3))
    return boxes.corners(np.array(poses), np.array(sizes, dtype=np.float64))
