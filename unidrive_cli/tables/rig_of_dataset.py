"""The rig of a dataset: its calibrated cameras."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path

from unidrive_cli.errors import DatasetError, GeometryError, PictureError, RigError, UnidriveError, UsageError
from unidrive_cli.rig.fleet import Fleet, is_fleet_file, load_fleet
from unidrive_cli.rig.gallery import gallery_names, load_gallery_rig
from unidrive_cli.rig.model import Camera, Rig
from unidrive_cli.rig.yaml_file import load_rig
from unidrive_cli.tables.dataset import Dataset, is_version_folder, open_dataset
from unidrive_cli.tables.layouts.known import layout_named
from unidrive_cli.tables.lenses import GivenLens
from unidrive_cli.tables.moments import cameras_of, lens_and_pose, reference_of
from unidrive_cli.tables.schema import CalibratedSensor, SampleData


def camera_of(dataset: Dataset, row: SampleData, size_px: tuple[int, int]) -> Camera:
    """The camera that took a picture: its channel, lens and pose on the vehicle.

    Raises:
        DatasetError: dangling tokens, numbers that are no camera, or a channel that cannot be a folder.
    """
    sensor = dataset.sensor_of(row)
    lens, ego_from_cam = lens_and_pose(dataset, row, size_px)
    try:
        return Camera(sensor.channel, lens, ego_from_cam)
    except GeometryError as error:
        raise DatasetError(error.what, where=dataset.sensor.place(sensor, "channel")) from error


SizeOfFile = Callable[[Path], tuple[int, int]]
"""Gives (width, height) in pixels of a picture file; pictures are not opened in this room."""


def picture_size_of(dataset: Dataset, row: SampleData, size_of_file: SizeOfFile | None = None) -> tuple[int, int]:
    """(width, height) in pixels of a camera row: the table's, or the file's where the table has none.

    Raises:
        DatasetError: neither says it.
    """
    if row.width and row.height:
        return row.width, row.height
    if size_of_file is None:
        raise DatasetError("the picture has no size.", where=dataset.sample_data.place(row, "width"))
    return size_of_file(dataset.path_of(row))


def rig_of_dataset(
    dataset: Dataset, scenes: tuple[str, ...] = (), size_of_file: SizeOfFile | None = None
) -> tuple[Rig, list[str]]:
    """The rig that a dataset's pictures were taken with: the most frequent one where there are several.

    Args:
        scenes: names of the scenes to look at; all where empty.
        size_of_file: says the size of pictures that have none in their table.

    Returns:
        The rig, and notes that say what was chosen.

    Raises:
        DatasetError: no camera pictures, a picture without a size, or broken calibrations.
        PictureError: no sample whose pictures all say their size.
        UsageError: an unknown scene.
    """
    calibrations = dataset.calibrated_sensor.by_token
    contents: dict[str, str] = {}
    rigs: Counter[tuple[tuple[str, str, int, int], ...]] = Counter()
    example: dict[tuple[tuple[str, str, int, int], ...], list[SampleData]] = {}
    without_size: list[PictureError] = []
    for scene in dataset.scenes_named(scenes):
        for sample in dataset.samples_of_scene[scene.token]:
            if sample.token not in dataset.keyframes:
                continue
            rows = cameras_of(dataset, sample, reference_of(dataset, sample))
            entries = []
            try:
                for channel, row in rows.items():
                    size = picture_size_of(dataset, row, size_of_file)
                    if row.calibrated_sensor_token not in contents:
                        contents[row.calibrated_sensor_token] = _content(calibrations[row.calibrated_sensor_token])
                    entries.append((channel, contents[row.calibrated_sensor_token], *size))
            except PictureError as error:
                without_size.append(error)
                continue
            if entries:
                rigs[tuple(entries)] += 1
                example.setdefault(tuple(entries), list(rows.values()))
    if not rigs:
        if without_size:
            raise without_size[0]
        raise DatasetError("holds no camera key frames, so it has no rig.", where=str(dataset.folder))
    (key, count), *others = rigs.most_common()
    order = {channel: index for index, channel in enumerate(dataset.camera_channels())}
    taken = sorted(example[key], key=lambda row: order[dataset.sensor_of(row).channel])
    cameras = tuple(camera_of(dataset, row, picture_size_of(dataset, row, size_of_file)) for row in taken)
    notes = []
    if others:
        total = sum(rigs.values())
        notes.append(
            f"{dataset.folder} holds {len(rigs)} different calibrations; the most frequent one is taken "
            f"({count} of {total} samples)."
        )
    if without_size:
        notes.append(
            f"{len(without_size)} samples of {dataset.folder} are not counted: a picture has no size in the table "
            "and cannot be read."
        )
    name = dataset.root.resolve().name.encode(errors="replace").decode()
    return Rig(name, f"the calibrated cameras of {dataset.version}", cameras), notes


def _content(row: CalibratedSensor) -> str:
    distortion = [row.camera_distortion or [], str(row.camera_model)]
    return json.dumps([row.translation, row.rotation, row.camera_intrinsic, *distortion])


def open_named(
    folder: Path,
    version: str | None = None,
    *,
    layout: str | None = None,
    lenses: Mapping[str, GivenLens] | None = None,
) -> Dataset:
    """Opens the dataset that an argument without a `--version` of its own means: a folder, or its version folder.

    Args:
        lenses: as `open_dataset`.

    Raises:
        DatasetError: it cannot be read.
        UsageError: several version folders; the hint says how to name one.
    """
    if layout is not None:
        layout_named(layout)  # an unknown one is no matter of version folders
    try:
        if version is None and folder.is_dir() and is_version_folder(folder):
            folder = folder.resolve()
            folder, version = folder.parent, folder.name
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror}.", where=str(folder)) from error
    try:
        return open_dataset(folder, version, layout=layout, lenses=lenses)
    except UsageError as error:
        if version is not None or "--version" not in error.hint:
            raise
        hint = f"Name one of them: {folder}/<version folder>."
        raise UsageError(error.what, where=error.where, hint=hint) from error


def resolve_fleet(
    text: str, size_of_file: SizeOfFile | None = None, lenses: Mapping[str, GivenLens] | None = None
) -> tuple[Fleet, list[str]]:
    """The fleet that a RIG argument means: a fleet file's, or a virtual rig with no cars named.

    Args:
        text: a fleet file, or what `resolve_rig` takes.
        size_of_file: says the size of a dataset's pictures that have none in their table.
        lenses: of a dataset folder.

    Returns:
        The fleet, and notes that say what was assumed.

    Raises:
        RigError, DatasetError, UsageError: as `resolve_rig`, for the rigs of a fleet file too.
    """
    path, notes = Path(text), list[str]()
    try:
        is_fleet = path.suffix in (".yaml", ".yml") and path.is_file() and is_fleet_file(path)
    except OSError as error:
        raise RigError(f"cannot be read: {error}.", where=text[:200]) from error
    if not is_fleet:
        rig, notes = resolve_rig(text, size_of_file=size_of_file, lenses=lenses)
        return Fleet(rig.name, rig, (), common=False), notes

    def rig_named(name: str) -> Rig:
        rig, more = resolve_rig(name, size_of_file=size_of_file)
        notes.extend(more)
        return rig

    return load_fleet(path, rig_named), notes


def resolve_rig(
    text: str,
    version: str | None = None,
    scenes: tuple[str, ...] = (),
    size_of_file: SizeOfFile | None = None,
    lenses: Mapping[str, GivenLens] | None = None,
) -> tuple[Rig, list[str]]:
    """The rig that a RIG argument means: a rig file, a shipped rig's name, or a dataset folder.

    A dataset with several version folders is named with the version folder itself.

    Args:
        text: the argument.
        version, scenes, lenses: of a dataset folder.
        size_of_file: says the size of a dataset's pictures that have none in their table.

    Returns:
        The rig, and notes that say what was assumed.

    Raises:
        RigError: neither of the three, or a rig file with a mistake.
        DatasetError, UsageError: a dataset folder that cannot be read.
    """
    try:
        if dataset := dataset_meant(text, version, lenses=lenses):
            rig, notes = rig_of_dataset(dataset, scenes, size_of_file)
            if dataset.layout.name != "nuscenes":
                notes.insert(0, f"{dataset.folder} is in the layout of {dataset.layout.title}.")
            return rig, notes
        path = Path(text)
        if _looks_like_path(text) or (text not in gallery_names() and path.is_file()):
            return load_rig(path), []
    except (OSError, ValueError) as error:
        if isinstance(error, UnidriveError):
            raise
        raise RigError(f"cannot be read: {error}.", where=text[:200]) from error
    return load_gallery_rig(text), []


def dataset_meant(
    text: str,
    version: str | None = None,
    layout: str | None = None,
    lenses: Mapping[str, GivenLens] | None = None,
) -> Dataset | None:
    """The dataset that a RIG argument means, opened; None where it means a rig file or a shipped rig.

    Args:
        text: the argument.
        version, layout, lenses: of the dataset; the layout is found out where None.

    Raises:
        DatasetError, UsageError: it cannot be read.
    """
    if not _looks_like_path(text) and text in gallery_names():
        return None
    try:
        is_folder = Path(text).is_dir()
    except OSError:  # no path can be called that
        return None
    return open_named(Path(text), version, layout=layout, lenses=lenses) if is_folder else None


def _looks_like_path(text: str) -> bool:
    return "/" in text or Path(text).suffix in (".yaml", ".yml")
