"""A nuScenes-format dataset opened for reading: version folder, tables, indexes, poses."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from unidrive_cli.errors import DatasetError, GeometryError, UsageError, did_you_mean
from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.geometry.lenses import DISTORTED_LENSES, FisheyeLens, Lens, OpenCVLens, Pinhole, lens_of
from unidrive_cli.geometry.poses import pose, rotation_from_quaternion
from unidrive_cli.tables.converted import refuse_unfinished
from unidrive_cli.tables.extra import ExtraTable, extra_table_paths, read_extra_table
from unidrive_cli.tables.lacking import completed
from unidrive_cli.tables.layouts.base import Layout
from unidrive_cli.tables.layouts.known import layout_named, layout_of
from unidrive_cli.tables.lenses import GivenLens, check_channels
from unidrive_cli.tables.paths import Inside
from unidrive_cli.tables.scanned import SCANNED, scan_tables
from unidrive_cli.tables.schema import (
    NEEDED,
    NUSCENES_VISIBILITY,
    TABLES,
    Attribute,
    CalibratedSensor,
    Category,
    EgoPose,
    Instance,
    Log,
    Map,
    Sample,
    SampleAnnotation,
    SampleData,
    Scene,
    Sensor,
    Visibility,
)
from unidrive_cli.tables.table import Indices, ListedTable, Table, read_table, table_of

LIDAR_REFERENCE = "LIDAR_TOP"
OPTIONAL = ("sample_annotation", "instance", "category", "attribute", "visibility", "log", "map")
"""Tables that may be missing, in an order in which their minimal rows can be made."""
NO_CATEGORY = "unidrive-unknown-category"
LARGE_BYTES = 200 << 20
"""Tables that can grow are scanned where they are larger than this together."""


@dataclass(frozen=True, eq=False)
class Dataset:
    """All tables of one version folder, with the links between them as dictionaries.

    Attributes:
        root: the folder that holds the version folder, `samples` and `sweeps`.
        version: name of the version folder.
        layout: which family of datasets it is of.
        extra_tables: further `*.json` files of the version folder, by name without suffix.
        notes: what was assumed or repaired, one sentence each.
        lenses: by channel, where a side file gives them.
    """

    root: Path
    version: str
    sensor: ListedTable[Sensor]
    calibrated_sensor: ListedTable[CalibratedSensor]
    ego_pose: Table[EgoPose]
    sample: ListedTable[Sample]
    sample_data: Table[SampleData]
    scene: ListedTable[Scene]
    sample_annotation: Table[SampleAnnotation]
    instance: ListedTable[Instance]
    category: ListedTable[Category]
    attribute: ListedTable[Attribute]
    visibility: ListedTable[Visibility]
    log: ListedTable[Log]
    map: ListedTable[Map]
    extra_tables: dict[str, ExtraTable]
    layout: Layout
    notes: list[str] = field(default_factory=list)
    lenses: Mapping[str, GivenLens] = field(default_factory=dict)

    @property
    def folder(self) -> Path:
        """The version folder."""
        return self.root / self.version

    @cached_property
    def digest(self) -> str:
        """SHA-256 (hex) of all tables, the extra ones included."""
        digests = {name: getattr(self, name).digest for name in TABLES}
        digests.update({name: table.digest for name, table in self.extra_tables.items()})
        return hashlib.sha256(json.dumps(digests, sort_keys=True).encode()).hexdigest()

    @cached_property
    def files(self) -> Inside:
        """Resolves `filename` fields below the root."""
        return Inside(self.root)

    def path_of(self, row: SampleData) -> Path:
        """The file of a sample_data row.

        Raises:
            DatasetError: its name leaves the dataset.
        """
        return self.files.resolve(row.filename, self.sample_data.place(row, "filename"))

    @cached_property
    def sensor_of_calibration(self) -> dict[str, Sensor]:
        """The sensor of each calibrated_sensor token."""
        return {
            row.token: self.sensor.get(row.sensor_token, self.calibrated_sensor.place(row, "sensor_token"))
            for row in self.calibrated_sensor.rows
        }

    def sensor_of(self, row: SampleData) -> Sensor:
        """The sensor that recorded a sample_data row.

        Raises:
            DatasetError: its calibrated_sensor_token points nowhere.
        """
        sensor = self.sensor_of_calibration.get(row.calibrated_sensor_token)
        if sensor is None:
            self.calibrated_sensor.get(
                row.calibrated_sensor_token, self.sample_data.place(row, "calibrated_sensor_token")
            )
            raise AssertionError("unreachable: the token was just not found")
        return sensor

    @cached_property
    def keyframes(self) -> dict[str, list[SampleData]]:
        """Key frame rows of lidars and cameras by sample token, in table order."""
        by_sample: dict[str, list[SampleData]] = defaultdict(list)
        are_key_frames = self.sample_data.flags("is_key_frame")
        for row in self.sample_data.rows_at(np.flatnonzero(are_key_frames & self._are_of("lidar", "camera"))):
            by_sample[row.sample_token].append(row)
        self.ego_pose.expect([row.ego_pose_token for rows in by_sample.values() for row in rows])
        return by_sample

    @cached_property
    def of_cameras(self) -> Bool:
        """(n,) bool: the sample_data rows that cameras have recorded.

        Raises:
            DatasetError: a calibrated_sensor_token points nowhere.
        """
        return self._are_of("camera")

    def _are_of(self, *modalities: str) -> Bool:
        """(n,) bool: the sample_data rows that sensors of some modalities have recorded."""
        calibrations = self.calibrated_sensor.rows
        are_of = [self.sensor_of_calibration[row.token].modality in modalities for row in calibrations]
        of_row = self.sample_data.links("calibrated_sensor_token", self.calibrated_sensor)
        for row in self.sample_data.rows_at(np.flatnonzero(of_row < 0)[:1]):
            self.sensor_of(row)
        return np.array(are_of, dtype=bool)[of_row]

    @cached_property
    def _annotations_by_sample(self) -> tuple[Indices, Indices]:
        """Annotation indices in the order of their samples, and where those of each sample begin."""
        samples = self.sample_annotation.links("sample_token", self.sample)
        order = np.argsort(samples, kind="stable")
        return order, np.searchsorted(samples[order], np.arange(len(self.sample.rows) + 1))

    def annotation_indices(self, sample_token: str) -> Indices:
        """Where the annotations of a sample stand, in table order."""
        order, begins = self._annotations_by_sample
        (sample,) = self.sample.find([sample_token])
        return order[begins[sample] : begins[sample + 1]]

    def annotations(self, sample_token: str) -> list[SampleAnnotation]:
        """Annotation rows of a sample, in table order."""
        return list(self.sample_annotation.rows_at(self.annotation_indices(sample_token)))

    @cached_property
    def samples_of_scene(self) -> dict[str, list[Sample]]:
        """Samples by scene token, in the order of time."""
        by_scene: dict[str, list[Sample]] = {row.token: [] for row in self.scene.rows}
        for row in self.sample.rows:
            self.scene.get(row.scene_token, self.sample.place(row, "scene_token"))
            by_scene[row.scene_token].append(row)
        for samples in by_scene.values():
            samples.sort(key=lambda row: row.timestamp)
        return by_scene

    def global_from_ego(self, row: SampleData) -> Float:
        """(4, 4) pose of the ego vehicle when a sample_data row was recorded, metres.

        Raises:
            DatasetError: dangling token, or numbers that are no pose.
        """
        ego = self.ego_pose.get(row.ego_pose_token, self.sample_data.place(row, "ego_pose_token"))
        return _pose(self.ego_pose, ego)

    @cached_property
    def _pose_of_row(self) -> Indices:
        """(n,) where the ego pose of each sample_data row stands, or negative."""
        return self.sample_data.links("ego_pose_token", self.ego_pose)

    def ego_poses_at(self, rows: Indices) -> Iterator[EgoPose]:
        """The ego poses of the sample_data rows at these indices; for very many, of which few are asked for at once.

        Raises:
            DatasetError: dangling token.
        """
        places = self._pose_of_row[rows]
        for row in self.sample_data.rows_at(rows[places < 0][:1]):
            raise self.ego_pose.nowhere(row.ego_pose_token, self.sample_data.place(row, "ego_pose_token"))
        return self.ego_pose.rows_at(places)

    def global_from_ego_at(self, rows: Indices) -> list[Float]:
        """`global_from_ego` of the sample_data rows at these indices.

        Raises:
            DatasetError: as `global_from_ego`.
        """
        return [_pose(self.ego_pose, ego) for ego in self.ego_poses_at(rows)]

    def ego_from_sensor(self, row: CalibratedSensor) -> Float:
        """(4, 4) pose of a sensor on the vehicle, metres.

        Raises:
            DatasetError: numbers that are no pose.
        """
        return _pose(self.calibrated_sensor, row)

    def global_from_box(self, row: SampleAnnotation) -> Float:
        """(4, 4) pose of an annotated box, metres.

        Raises:
            DatasetError: numbers that are no pose.
        """
        return _pose(self.sample_annotation, row)

    def lens(self, row: CalibratedSensor, width_px: int, height_px: int) -> Lens:
        """The lens of a camera calibration: the table's, or the side file's.

        Raises:
            DatasetError: intrinsics that are no camera matrix, or distortion that is none.
            UsageError: a lens of the side file that is none, or another one than the table's.
        """
        given = self.lenses.get(self.sensor_of_calibration[row.token].channel)
        if given is None:
            return self._lens_of_table(row, width_px, height_px)
        try:
            if given.intrinsics is None:
                pinhole = self._pinhole(row, width_px, height_px)
            else:
                pinhole = Pinhole(*given.intrinsics, width_px, height_px)
            lens = lens_of(pinhole, given.model, given.coefficients)
        except GeometryError as error:
            raise UsageError(error.what, where=given.where) from error
        if self._is_distorted(row) and (own := self._lens_of_table(row, width_px, height_px)) != lens:
            place = self.calibrated_sensor.place(row, "camera_distortion")
            raise UsageError(
                f"is not the lens that the dataset gives: {own.model} {list(own.coefficients)} ({place}).",
                where=given.where,
                hint="Take it out of the file, or out of the table.",
            )
        return lens

    def _lens_of_table(self, row: CalibratedSensor, width_px: int, height_px: int) -> Lens:
        pinhole = self._pinhole(row, width_px, height_px)
        if not self._is_distorted(row):
            return pinhole
        model = OpenCVLens.model if row.camera_model is None else row.camera_model
        try:
            return lens_of(pinhole, str(model), row.camera_distortion or ())
        except GeometryError as error:
            field = "camera_distortion" if model in DISTORTED_LENSES else "camera_model"
            raise DatasetError(error.what, where=self.calibrated_sensor.place(row, field)) from error

    def _pinhole(self, row: CalibratedSensor, width_px: int, height_px: int) -> Pinhole:
        try:
            return Pinhole.from_matrix(row.camera_intrinsic, width_px, height_px)
        except GeometryError as error:
            raise DatasetError(error.what, where=self.calibrated_sensor.place(row, "camera_intrinsic")) from error

    @staticmethod
    def _is_distorted(row: CalibratedSensor) -> bool:
        """A fisheye is one even if all its coefficients are zero; other models are then the pinhole."""
        return any(row.camera_distortion or ()) or row.camera_model == FisheyeLens.model

    def scenes_named(self, names: Iterable[str]) -> list[Scene]:
        """The scenes of those names, in table order; all of them where no name is given.

        Raises:
            UsageError: a name that no scene has.
        """
        wanted = set(names)
        known = [row.name for row in self.scene.rows]
        _refuse_unknown(wanted, known, "--scene", f"scene of {self.folder}")
        return [row for row in self.scene.rows if not wanted or row.name in wanted]

    def camera_channels(self, names: Iterable[str] = ()) -> list[str]:
        """Channels of modality camera that the dataset uses, in table order; or those of the given names.

        Raises:
            UsageError: a name that no camera has.
        """
        used = {row.sensor_token for row in self.calibrated_sensor.rows}
        known = [row.channel for row in self.sensor.rows if row.modality == "camera" and row.token in used]
        wanted = set(names)
        _refuse_unknown(wanted, known, "--camera", f"camera of {self.folder}")
        return [channel for channel in known if not wanted or channel in wanted]


def open_dataset(
    root: Path,
    version: str | None = None,
    *,
    layout: str | None = None,
    as_found: bool = False,
    lenses: Mapping[str, GivenLens] | None = None,
) -> Dataset:
    """Opens the dataset in a folder.

    Args:
        root: folder that holds the version folder, or a folder that alone holds such a one.
        version: its name; needed where there are several.
        layout: name of its layout; found out where None.
        as_found: as it lies there: a layout's tables are not brought to nuScenes' meaning, fields that rows lack
            are not put in, and one that a command of ours has not finished is opened too.
        lenses: by channel, for cameras whose tables do not say them.

    Raises:
        DatasetError: no such folder, no version folder, or a table that cannot be used.
        UsageError: several version folders and no `version`, a `version` that is not there, an unknown layout, or
            the lens of a camera that the dataset does not have.
    """
    known = layout_named(layout) if layout else None
    try:
        if not as_found:
            refuse_unfinished(root)
        folder = version_folder(root, version, known)
        if not as_found:
            refuse_unfinished(folder.parent)
        dataset = _open(folder, known or layout_of(folder), as_found=as_found)
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror}.", where=str(error.filename or root)) from error
    if not lenses:
        return dataset
    check_channels(lenses, dataset.camera_channels(), dataset.folder)
    return replace(dataset, lenses=lenses)


def _open(folder: Path, layout: Layout, *, as_found: bool) -> Dataset:
    paths = {name: folder / f"{name}.json" for name in TABLES}
    growing = [name for name in SCANNED if paths[name].is_file()]
    tables: dict[str, Any] = {}
    mends_rows = layout.mends_rows and not as_found
    if not mends_rows and sum(paths[name].stat().st_size for name in growing) > LARGE_BYTES:
        tables.update(scan_tables(folder, growing))
    for name in (*NEEDED, *OPTIONAL):
        if name in NEEDED and not paths[name].exists():
            raise _incomplete(folder, name)
        if paths[name].exists():
            tables[name] = tables.get(name) or read_table(paths[name], name)
    notes = [] if as_found else [*layout.mend(tables), *completed(tables)]
    for name in OPTIONAL:
        if name not in tables:
            records = _minimal_records(name, tables)
            tables[name] = table_of(name, records)
            notes.append(f"{name}.json is missing; {len(records)} rows are assumed.")
    categories = {row.token for row in tables["category"].rows}
    if any(row.category_token == NO_CATEGORY for row in tables["instance"].rows) and NO_CATEGORY not in categories:
        unknown = {"token": NO_CATEGORY, "name": "unknown", "description": ""}
        tables["category"] = tables["category"].extended([unknown])
    unmapped = {row.token for row in tables["log"].rows}.difference(*(row.log_tokens for row in tables["map"].rows))
    if unmapped:
        tables["map"] = tables["map"].extended([_no_map(sorted(unmapped))])
        notes.append(f"{len(unmapped)} logs have no map; an empty one is assumed, as nuscenes-devkit wants one.")
    extra_paths = extra_table_paths(folder, frozenset(TABLES))
    return Dataset(
        folder.parent,
        folder.name,
        **tables,
        extra_tables={path.stem: read_extra_table(path) for path in extra_paths},
        layout=layout,
        notes=notes,
    )


def is_version_folder(folder: Path) -> bool:
    """Whether a folder holds the tables itself."""
    return (folder / "sensor.json").exists() and (folder / "sample_data.json").exists()


def version_folder(root: Path, version: str | None, layout: Layout | None = None) -> Path:
    """The version folder that `open_dataset` reads.

    Args:
        layout: of several version folders those of this layout count, where there are any.

    Raises:
        DatasetError, UsageError: as `open_dataset`.
        OSError: the folder cannot be read.
    """
    if not root.exists():
        raise DatasetError("there is no such folder.", where=str(root))
    if not root.is_dir():
        raise DatasetError("is a file; the folder that holds v1.0-* was expected.", where=str(root))
    folders = _folders(root)
    found = [folder for folder in folders if (folder / "sensor.json").exists()]
    found = [folder for folder in found if (folder / "sample_data.json").exists()] or found
    if not found and not (root / "sensor.json").exists():
        found = [below for folder in folders for below in _folders(folder) if is_version_folder(below)]
    if layout and len(found) > 1:
        found = [folder for folder in found if layout.is_at(folder)] or found
    parents = {folder.parent for folder in found}
    if len(parents) > 1:
        names = ", ".join(sorted(folder.relative_to(root).as_posix() for folder in parents))
        one = min(parents)
        raise UsageError(f"{root} holds {len(parents)} datasets: {names}.", hint=f"Give the folder of one: {one}.")
    if version is not None:
        match = next((folder for folder in found if folder.name == version), None)
        if match is None:
            names = ", ".join(folder.name for folder in found) or "none"
            raise UsageError(f"--version {version}: {root} has no such version folder.", hint=f"It holds: {names}.")
        return match
    if len(found) > 1:
        names = ", ".join(folder.relative_to(root).as_posix() for folder in found)
        raise UsageError(f"{root} holds {len(found)} version folders: {names}.", hint="Choose one with --version.")
    if found:
        return found[0]
    if (root / "sensor.json").exists():
        if not (root / "sample_data.json").exists():
            raise _incomplete(root, "sample_data")
        raise DatasetError(
            "is a version folder itself.",
            where=str(root),
            hint=f"Give the folder above it: {root.resolve().parent}.",
        )
    refuse_unfinished(root)
    raise DatasetError(
        "holds no version folder: no folder with sensor.json and sample_data.json in it.",
        where=str(root),
        hint="Give the folder that holds v1.0-trainval, v1.0-mini or the like.",
    )


def _incomplete(folder: Path, name: str) -> DatasetError:
    """The error for a needed table that is missing; where the calibrations dangle too, it says so."""
    more = ""
    with contextlib.suppress(DatasetError):
        sensors, calibrations = (read_table(folder / f"{one}.json", one) for one in ("sensor", "calibrated_sensor"))
        for row in calibrations.rows_at(calibrations.unlinked("sensor_token", sensors, empty=True)[:1]):
            place = calibrations.place(row, "sensor_token")
            more = f" Besides, {place} points to {row.sensor_token!r}, which is not in sensor.json."
    return DatasetError(
        f"this table is needed and missing.{more}",
        where=str(folder / f"{name}.json"),
        hint="Unpack the dataset's metadata archive completely.",
    )


def _folders(place: Path) -> list[Path]:
    """The folders in one, except hidden ones."""
    with os.scandir(place) as entries:
        return sorted(Path(entry.path) for entry in entries if entry.is_dir() and not entry.name.startswith("."))


def _minimal_records(name: str, tables: dict[str, Any]) -> list[dict[str, Any]]:
    """Rows of a missing table: one for every token that other tables point to."""

    def wanted(table: str, field: str) -> list[str]:
        return sorted({getattr(row, field) or "" for row in tables[table].rows})

    if name == "visibility":
        known = {record["token"] for record in NUSCENES_VISIBILITY}
        others = set(wanted("sample_annotation", "visibility_token")) - known - {""}
        return [
            *NUSCENES_VISIBILITY,
            *({"description": "", "token": token, "level": ""} for token in sorted(others)),
        ]
    if name == "instance":
        tokens = wanted("sample_annotation", "instance_token")
        return [
            {
                "token": token,
                "category_token": NO_CATEGORY,
                "nbr_annotations": 0,
                "first_annotation_token": "",
                "last_annotation_token": "",
            }
            for token in tokens
        ]
    if name == "category":
        tokens = wanted("instance", "category_token")
        return [{"token": token, "name": "unknown", "description": ""} for token in tokens]
    if name == "attribute":
        tokens = sorted({token for row in tables["sample_annotation"].rows for token in row.attribute_tokens})
        return [{"token": token, "name": "unknown", "description": ""} for token in tokens]
    if name == "log":
        empty = {"logfile": "", "vehicle": "", "date_captured": "", "location": ""}
        return [{"token": token, **empty} for token in wanted("scene", "log_token")]
    if name == "map":
        return [_no_map([row.token for row in tables["log"].rows])]
    return []


def _no_map(log_tokens: list[str]) -> dict[str, Any]:
    return {"category": "semantic_prior", "token": "unidrive-no-map", "filename": "", "log_tokens": log_tokens}


def _pose(table: Table[Any], row: CalibratedSensor | EgoPose | SampleAnnotation) -> Float:
    try:
        return pose(rotation_from_quaternion(row.rotation), row.translation)
    except GeometryError as error:
        raise DatasetError(error.what, where=table.place(row, "rotation")) from error


def _refuse_unknown(wanted: set[str], known: list[str], option: str, kind: str) -> None:
    for name in sorted(wanted - set(known)):
        hint = did_you_mean(name, known) or f"There are: {', '.join(known[:12])}."
        raise UsageError(f"{option} {name}: there is no such {kind}.", hint=hint)
