"""A few scenes of a large dataset, in tables of their own: what a reader that wants all in memory can open."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from unidrive_cli.errors import OutputError
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.devkit import check_devkit
from unidrive_cli.tables.schema import Scene
from unidrive_cli.tables.subset import mended_instances, mended_links
from unidrive_cli.tables.table import RawRows, are_kept, write_rows

WHOLE = ("sensor", "calibrated_sensor", "category", "attribute", "visibility", "log", "map")
"""Tables that stay as they are; they do not grow with the recordings, or only little."""
DEVKIT_SCENES = 20
"""So many scenes of a larger dataset are opened with nuscenes-devkit, which keeps every row in memory."""


def open_with_devkit(dataset: Dataset, *, whole: bool = False) -> int:
    """Opens a dataset with nuscenes-devkit: `check_devkit` on it, or on some scenes of a large one.

    Args:
        whole: all scenes, however many.

    Returns:
        How many boxes it projected into pictures.

    Raises:
        CheckError: it refuses, or reads something else.
    """
    scenes = dataset.scene.rows
    if whole or len(scenes) <= DEVKIT_SCENES:
        return check_devkit(dataset.root, dataset.version, len(dataset.sample_annotation.rows))
    chosen = [scenes[place] for place in np.linspace(0, len(scenes) - 1, DEVKIT_SCENES).astype(int)]
    with thinned(dataset, chosen) as (root, annotations):
        return check_devkit(root, dataset.version, annotations)


@contextlib.contextmanager
def thinned(dataset: Dataset, scenes: Sequence[Scene]) -> Iterator[tuple[Path, int]]:
    """The scenes as a dataset in a temporary folder, its files links; and the number of its annotations.

    The extra tables are left out.

    Raises:
        OutputError: the temporary folder cannot be written.
    """
    tokens = {scene.token for scene in scenes}
    samples = np.array([row.scene_token in tokens for row in dataset.sample.rows], dtype=bool)
    rows = are_kept(samples, dataset.sample_data.links("sample_token", dataset.sample))
    annotations = are_kept(samples, dataset.sample_annotation.links("sample_token", dataset.sample))
    poses = np.zeros(len(dataset.ego_pose.rows), dtype=bool)
    poses[dataset.sample_data.links("ego_pose_token", dataset.ego_pose)[rows]] = True
    instances = dict(mended_instances(dataset, annotations))
    linked = {"sample": samples, "sample_data": rows, "sample_annotation": annotations}
    with contextlib.ExitStack() as stack:
        try:
            root = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="unidrive-")))
            for entry in dataset.root.resolve().iterdir():
                if entry.name != dataset.version:
                    (root / entry.name).symlink_to(entry)
            folder = root / dataset.version
            folder.mkdir()
            tables: dict[str, RawRows] = {
                "scene": (
                    raw
                    for row, raw in zip(dataset.scene.rows, dataset.scene.raw, strict=True)
                    if row.token in tokens
                ),
                "ego_pose": dataset.ego_pose.runs(np.flatnonzero(poses), {}),
                "instance": dataset.instance.runs(np.array(list(instances), dtype=np.int64), instances),
                **{name: getattr(dataset, name).raw for name in WHOLE},
            }
            for name, kept in linked.items():
                table = getattr(dataset, name)
                tables[name] = table.runs(np.flatnonzero(kept), mended_links(table, kept))
            for name, texts in tables.items():
                write_rows(folder / f"{name}.json", texts)
        except OSError as error:
            raise OutputError(
                f"the tables of {len(scenes)} scenes, which nuscenes-devkit is to open, cannot be written: "
                f"{error.strerror}.",
                where=tempfile.tempdir or "the folder for temporary files",
                hint="Set TMPDIR to a folder with more room.",
            ) from error
        yield root, int(np.count_nonzero(annotations))
