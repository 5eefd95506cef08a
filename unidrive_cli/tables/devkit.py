"""nuscenes-devkit as a second opinion on a dataset."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import msgspec

from unidrive_cli.errors import CheckError
from unidrive_cli.tables.schema import Category
from unidrive_cli.tables.table import ListedTable

LABELS = ("lidarseg", "panoptic")
"""Tables of point labels, which the devkit opens only where it knows the categories; their files are in a folder of
that name, in one of the version's name."""


def labels_refused(categories: ListedTable[Category]) -> str:
    """Why nuscenes-devkit stops where a dataset with these categories has one of LABELS; empty where it does not."""
    from nuscenes.utils.color_map import get_colormap

    colours = get_colormap()
    for row, raw in zip(categories.rows, categories.raw, strict=True):
        if not isinstance(msgspec.json.decode(raw).get("index"), int):
            return f"the category {row.name} has no index"
        if row.name not in colours:
            return f"it has no colour for the category {row.name}"
    return ""


def check_devkit(root: Path, version: str, annotations: int) -> int:
    """Opens a dataset with nuscenes-devkit and lets it project the boxes of a few samples.

    Args:
        annotations: how many it must find.

    Returns:
        How many boxes it projected into pictures.

    Raises:
        CheckError: it refuses, or reads something else.
    """
    from nuscenes.nuscenes import NuScenes

    try:
        with contextlib.redirect_stdout(io.StringIO()):
            nusc = NuScenes(version=version, dataroot=str(root), verbose=False)
            if len(nusc.sample_annotation) != annotations:
                raise CheckError(
                    f"nuscenes-devkit reads {len(nusc.sample_annotation)} annotations, not {annotations}."
                )
            boxes = 0
            for sample in nusc.sample[:: max(len(nusc.sample) // 5, 1)]:
                for channel, token in sample["data"].items():
                    if nusc.get("sample_data", token)["sensor_modality"] == "camera":
                        path, seen, _ = nusc.get_sample_data(token)
                        boxes += len(seen)
                        if not Path(path).is_file():
                            raise CheckError(f"nuscenes-devkit looks for {path}, which is not there ({channel}).")
    except CheckError:
        raise
    except Exception as error:  # the devkit raises bare ones
        raise CheckError(f"nuscenes-devkit does not open the dataset: {type(error).__name__}: {error}.") from error
    return boxes
