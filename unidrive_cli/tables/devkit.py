"""nuscenes-devkit as a second opinion on a dataset."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

from unidrive_cli.errors import CheckError


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
