"""The tables of the output: what stays, what is mended, what the virtual cameras add."""

from __future__ import annotations

import contextlib
import gc
import itertools
import operator
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from unidrive_cli.convert.plan import Moment, Plan, Unit, moments_by_scene
from unidrive_cli.convert.units import Receipt
from unidrive_cli.convert.visibility import VisibilityLevels
from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.geometry.poses import quaternion_from_rotation
from unidrive_cli.tables.extra import IMAGE_ANNOTATIONS
from unidrive_cli.tables.schema import EgoPose, Quaternion, Timestamp, Vector3
from unidrive_cli.tables.subset import mended_instances, mended_links, mended_scenes
from unidrive_cli.tables.table import (
    EMPTY,
    Indices,
    ListedTable,
    RawRow,
    RawRows,
    Run,
    Table,
    are_kept,
    changed,
    run_of,
)
from unidrive_cli.tables.tokens import derived_token

_NUMBERS = operator.attrgetter("camera", "annotation", "left", "top", "right", "bottom")
_TAKEN_OVER = frozenset(("prev", "next", "visibility_token"))
"""Fields of an annotation that may change and that its 2D boxes have too."""
_LARGEST = (IMAGE_ANNOTATIONS, "sample_data", "sample_annotation", "ego_pose")
"""The tables that take longest, in this order."""
_UNITS_A_RUN = 256


class _Annotation(msgspec.Struct, gc=False):
    """What a 2D box takes over of a sample_annotation row."""

    token: str
    instance_token: str
    prev: str = ""
    next: str = ""
    visibility_token: str | None = ""
    attribute_tokens: list[str] = msgspec.field(default_factory=list)
    num_lidar_pts: int = 0
    num_radar_pts: int = 0


class _BoxRow(msgspec.Struct, gc=False):
    """A row of image_annotations."""

    attribute_tokens: list[str]
    bbox_corners: tuple[float, float, float, float]
    category_name: str
    filename: str
    instance_token: str
    next: str
    num_lidar_pts: int
    num_radar_pts: int
    prev: str
    sample_annotation_token: str
    sample_data_token: str
    visibility_token: str | None


class _PictureRow(msgspec.Struct, gc=False):
    """A sample_data row of a virtual picture."""

    token: str
    sample_token: str
    ego_pose_token: str
    calibrated_sensor_token: str
    timestamp: Timestamp
    fileformat: str
    is_key_frame: bool
    height: int
    width: int
    filename: str
    prev: str
    next: str


class _PoseRow(msgspec.Struct, gc=False):
    """An ego_pose row of a virtual picture."""

    token: str
    timestamp: Timestamp
    rotation: Quaternion | list[float]
    translation: Vector3


@dataclass
class Counts:
    """How many rows and boxes the output has, and what happened to them.

    Attributes:
        boxes_unseen: boxes that no covered virtual pixel shows.
        boxes_unwitnessed: boxes that no real camera of their sample saw either.
    """

    samples: int = 0
    sweeps: int = 0
    pictures: int = 0
    annotations: int = 0
    visibility_lowered: int = 0
    boxes_unseen: int = 0
    boxes_unwitnessed: int = 0
    boxes_dropped: int = 0
    boxes_2d: int = 0
    tables: dict[str, int] = field(default_factory=dict)


class OutputTables:
    """Makes the rows of every output table from a plan and the receipts of its finished units.

    Rows that stay are written with the source's own JSON text.
    """

    def __init__(self, plan: Plan, receipts: dict[str, Receipt]) -> None:
        """
        Args:
            receipts: by token of their units; units without one leave the dataset.
        """
        self._plan = plan
        self._dataset = plan.dataset
        self._receipts = receipts
        self._units = [unit for unit in plan.units if unit.sample.token in receipts]
        self._sweeps = [sweep for sweep in plan.sweeps if sweep.token in receipts]
        self._picture_tokens_of: dict[str, list[str]] = {}
        self._levels = VisibilityLevels(plan.dataset.visibility.rows)
        self.counts = Counts(samples=len(self._units), sweeps=len(self._sweeps))

    @cached_property
    def kept_samples(self) -> Bool:
        """(n,) the samples that stay."""
        return self._mask(self._dataset.sample, [unit.sample.token for unit in self._units])

    @cached_property
    def kept_sample_data(self) -> Bool:
        """(n,) the rows of sensors other than cameras that stay; sweeps without a sample stay too."""
        samples = self._dataset.sample_data.links("sample_token", self._dataset.sample)
        stays: Bool = ~self._dataset.of_cameras & ((samples == EMPTY) | are_kept(self.kept_samples, samples))
        return stays

    @cached_property
    def kept_annotations(self) -> Bool:
        """(n,) the annotations that stay."""
        drop = self._plan.options.unseen_boxes == "drop"
        stays: Bool = ~np.isnan(self._shown) & ((self._shown > 0) | (not drop))
        return stays

    @cached_property
    def _shown(self) -> Float:
        """(n,) the share of every annotation that is shown; NaN where its sample leaves."""
        shown = np.full(len(self._dataset.sample_annotation.rows), np.nan)
        for unit, indices in zip(self._units, self._annotations_of_units, strict=True):
            shown[indices] = self._receipts[unit.token].shown
        return shown

    @cached_property
    def _annotations_of_units(self) -> list[Indices]:
        """Where the annotations of each unit stand."""
        return [self._dataset.annotation_indices(unit.sample.token) for unit in self._units]

    @cached_property
    def _lowered(self) -> dict[int, str | None]:
        """New visibility tokens, by the index of the annotation, where they change."""
        if self._plan.options.visibility == "keep":
            return {}
        dataset = self._dataset
        tokens = [row.token for row in dataset.visibility.rows]
        old = dataset.sample_annotation.links("visibility_token", dataset.visibility)
        lowered: dict[int, str | None] = {}
        candidates = np.flatnonzero(self.kept_annotations & (self._shown < 1.0))
        shares, share_of = np.unique(self._shown[candidates], return_inverse=True)
        cases, case_of = np.unique(np.maximum(old[candidates], EMPTY) * len(shares) + share_of, return_inverse=True)
        for case, (code, share) in enumerate(zip(*np.divmod(cases, len(shares)), strict=True)):
            token = tokens[code] if code >= 0 else ""
            if (new := self._levels.lowered(token, float(shares[share]))) != token:
                lowered.update(dict.fromkeys(candidates[case_of == case].tolist(), new))
        return lowered

    def write(self, write_table: Callable[[str, RawRows], int]) -> None:
        """Calls `write_table(name, rows)` for every table of the output, for two at a time, and counts."""
        rows: dict[str, RawRows] = {
            "sensor": self._sensors(),
            "calibrated_sensor": self._calibrated_sensors(),
            "ego_pose": self._ego_poses(),
            "sample": self._linked_rows(self._dataset.sample, self.kept_samples),
            "sample_data": self._sample_data(),
            "scene": self._scenes(),
            "sample_annotation": self._annotations(),
            "instance": self._instances(),
            "visibility": self._visibilities(),
            IMAGE_ANNOTATIONS: self._boxes_2d(),
        }
        for name in ("category", "attribute", "map"):
            rows[name] = getattr(self._dataset, name).raw
        rows["log"] = self._logs()
        names = [*_LARGEST, *sorted(rows.keys() - set(_LARGEST))]
        with _no_garbage_collection(), ThreadPoolExecutor(2) as threads:
            counts = threads.map(write_table, names, [rows[name] for name in names])
            self.counts.tables.update(sorted(zip(names, counts, strict=True)))
        receipts = [self._receipts[unit.sample.token] for unit in self._units]
        moments: Iterator[Moment] = itertools.chain(self._units, self._sweeps)
        self.counts.pictures = sum(sum(self._has_picture(moment)) for moment in moments)
        self.counts.annotations = int(np.count_nonzero(self.kept_annotations))
        self.counts.visibility_lowered = len(self._lowered)
        self.counts.boxes_unseen = sum(receipt.shown.count(0.0) for receipt in receipts)
        self.counts.boxes_unwitnessed = sum(receipt.unwitnessed for receipt in receipts)
        self.counts.boxes_dropped = sum(len(receipt.shown) for receipt in receipts) - self.counts.annotations
        self.counts.boxes_2d = self.counts.tables[IMAGE_ANNOTATIONS]

    def extra_tables(self) -> Iterator[tuple[str, list[dict[str, Any]]]]:
        """(name, rows that stay) of the source's extra tables.

        Rows that point to a sample_data or sample row which is gone go with it. A file that is no table
        has no rows.
        """
        targets: dict[str, tuple[Table[Any], Bool]] = {
            "sample_data_token": (self._dataset.sample_data, self.kept_sample_data),
            "sample_token": (self._dataset.sample, self.kept_samples),
        }
        for name, table in self._dataset.extra_tables.items():
            if name != IMAGE_ANNOTATIONS:
                rows = table.rows or []
                stays = np.ones(len(rows), dtype=bool)
                for field, (target, kept) in targets.items():
                    tokens = [_text(row.get(field)) for row in rows]
                    places = target.find(tokens)
                    stays &= (places == EMPTY) | are_kept(kept, places)
                yield name, [row for row, stay in zip(rows, stays.tolist(), strict=True) if stay]

    def _scenes(self) -> RawRows:
        changes = dict(mended_scenes(self._dataset, {unit.sample.token for unit in self._units}))
        yield from self._dataset.scene.runs(_indices(changes), changes)

    def _annotations(self) -> RawRows:
        table, kept = self._dataset.sample_annotation, self.kept_annotations
        yield from table.runs(np.flatnonzero(kept), self._changed_annotations)

    def _instances(self) -> RawRows:
        changes = dict(mended_instances(self._dataset, self.kept_annotations))
        yield from self._dataset.instance.runs(_indices(changes), changes)

    def _visibilities(self) -> RawRows:
        """The levels of the source, and those that lowered annotations needed."""
        yield from self._dataset.visibility.raw
        if self._lowered:
            yield from map(msgspec.json.encode, self._levels.added)

    def _sensors(self) -> Iterator[RawRow]:
        table = self._dataset.sensor
        yield from (raw for row, raw in zip(table.rows, table.raw, strict=True) if row.modality != "camera")
        for channel in self._plan.rig.channels:
            yield _row(token=self._token("sensor", "", channel), channel=channel, modality="camera")

    def _calibrated_sensors(self) -> Iterator[RawRow]:
        table, sensors = self._dataset.calibrated_sensor, self._dataset.sensor_of_calibration
        rotations = self._plan.rotations.get("calibrated_sensor", {})
        for index, (row, raw) in enumerate(zip(table.rows, table.raw, strict=True)):
            if sensors[row.token].modality != "camera":
                yield changed(raw, {"rotation": rotations[index]}) if index in rotations else raw
        for camera in self._plan.rig.cameras:
            yield _row(
                token=self._token("calibrated_sensor", "", camera.channel),
                sensor_token=self._token("sensor", "", camera.channel),
                translation=camera.centre_ego.tolist(),
                rotation=quaternion_from_rotation(camera.ego_from_cam[:3, :3]).tolist(),
                camera_intrinsic=camera.lens.matrix.tolist(),
                **(self._dataset.layout.calibration_fields() if self._plan.options.keep_layout else {}),
            )

    def _logs(self) -> Iterator[RawRow]:
        for raw in self._dataset.log.raw:
            fields = (
                {} if self._plan.options.keep_layout else self._dataset.layout.log_fields(msgspec.json.decode(raw))
            )
            yield changed(raw, fields) if fields else raw

    def _ego_poses(self) -> RawRows:
        """Poses that a row which stays uses, or that none ever used; then one per virtual picture."""
        dataset, table = self._dataset, self._dataset.ego_pose
        poses = dataset.sample_data.links("ego_pose_token", table)
        stays = np.ones(len(table.rows), dtype=bool)
        stays[poses] = False
        stays[poses[self.kept_sample_data]] = True
        scaled = self._plan.rotations.get(table.name, {})
        yield from table.runs(np.flatnonzero(stays), {index: {"rotation": unit} for index, unit in scaled.items()})
        rows = table.rows_at(np.array(list(scaled), dtype=np.int64))
        rotations = {row.token: unit for row, unit in zip(rows, scaled.values(), strict=True)}
        places = table.find([unit.reference.ego_pose_token for unit in self._units])
        references = np.array([sweep.reference for sweep in self._sweeps], dtype=np.int64)
        moments: Iterator[tuple[Moment, EgoPose]] = itertools.chain(
            zip(self._units, table.rows_at(places), strict=True),
            zip(self._sweeps, dataset.ego_poses_at(references), strict=True),
        )
        while several := list(itertools.islice(moments, _UNITS_A_RUN)):
            yield run_of(
                [
                    _PoseRow(token, moment.timestamp, rotations.get(pose.token, pose.rotation), pose.translation)
                    for moment, pose in several
                    for token in itertools.compress(self._picture_tokens(moment), self._has_picture(moment))
                ]
            )

    def _sample_data(self) -> RawRows:
        table, changes = self._dataset.sample_data, mended_links(self._dataset.sample_data, self.kept_sample_data)
        for index, name in self._plan.names.moved(self.kept_sample_data).items():
            changes.setdefault(index, {})["filename"] = name
        yield from table.runs(np.flatnonzero(self.kept_sample_data), changes)
        by_scene = moments_by_scene(self._units, self._sweeps)
        for index, camera in enumerate(self._plan.rig.cameras):
            calibration, lens = self._token("calibrated_sensor", "", camera.channel), camera.lens
            for scene in by_scene:
                moments = [moment for moment in scene if self._receipts[moment.token].picture_bytes[index]]
                tokens = ["", *(self._picture_tokens(moment)[index] for moment in moments), ""]
                yield run_of(
                    [
                        _PictureRow(
                            token,
                            moment.sample.token,
                            token,
                            calibration,
                            moment.timestamp,
                            "jpg",
                            isinstance(moment, Unit),
                            lens.height_px,
                            lens.width_px,
                            moment.pictures[index],
                            before,
                            after,
                        )
                        for moment, before, token, after in zip(
                            moments, tokens, tokens[1:], tokens[2:], strict=False
                        )
                    ]
                )

    def _boxes_2d(self) -> Iterator[Run]:
        """2D boxes in the form of the devkit's export_2d_annotations_as_json."""
        table, changes = self._dataset.sample_annotation, self._changed_annotations
        are_changed = np.zeros(len(table.rows), dtype=bool)
        are_changed[list(changes)] = True
        for start in range(0, len(self._units), _UNITS_A_RUN):
            units = self._units[start : start + _UNITS_A_RUN]
            of_units = self._annotations_of_units[start : start + _UNITS_A_RUN]
            first = itertools.accumulate(map(len, of_units), initial=0)
            indices = np.concatenate(of_units)
            rows = list(table.parts_at(indices, _Annotation))
            places = np.flatnonzero(are_changed[indices])
            for place, index in zip(places.tolist(), indices[places].tolist(), strict=True):
                for name in _TAKEN_OVER & changes[index].keys():
                    setattr(rows[place], name, changes[index][name])
            stays = self.kept_annotations[indices].tolist()
            described = list(zip(rows, self._category_names[indices].tolist(), stays, strict=True))
            yield run_of(
                [
                    _BoxRow(
                        row.attribute_tokens,
                        (left, top, right, bottom),
                        category,
                        pictures[camera],
                        row.instance_token,
                        row.next,
                        row.num_lidar_pts,
                        row.num_radar_pts,
                        row.prev,
                        row.token,
                        tokens[camera],
                        row.visibility_token,
                    )
                    for unit, offset in zip(units, first, strict=False)
                    for pictures, tokens in [(unit.pictures, self._picture_tokens(unit))]
                    for camera, place, left, top, right, bottom in map(_NUMBERS, self._receipts[unit.token].boxes)
                    for row, category, is_kept in [described[offset + place]]
                    if is_kept
                ]
            )

    @cached_property
    def _category_names(self) -> npt.NDArray[np.object_]:
        """(n,) the category of every annotation."""
        dataset = self._dataset
        names = {row.token: row.name for row in dataset.category.rows}
        of_instances = [names.get(row.category_token, "") for row in dataset.instance.rows]
        owners = dataset.sample_annotation.links("instance_token", dataset.instance)
        return np.array(of_instances, dtype=object)[owners]

    @cached_property
    def _changed_annotations(self) -> dict[int, dict[str, Any]]:
        """Mended links, new visibility, unit rotations; and whole centres as floats, which nuscenes-devkit needs."""
        table, kept = self._dataset.sample_annotation, self.kept_annotations
        changes = mended_links(table, kept)
        for index, token in self._lowered.items():
            changes.setdefault(index, {})["visibility_token"] = token
        centres = table.numbers("translation")
        for index in np.flatnonzero(kept & (centres == np.floor(centres)).all(axis=1)).tolist():
            changes.setdefault(index, {})["translation"] = centres[index].tolist()
        for index, unit in self._plan.rotations.get(table.name, {}).items():
            changes.setdefault(index, {})["rotation"] = unit
        return changes

    def _linked_rows(self, table: Table[Any], kept: Bool) -> RawRows:
        return table.runs(np.flatnonzero(kept), mended_links(table, kept))

    @staticmethod
    def _mask(table: ListedTable[Any], tokens: list[str]) -> Bool:
        mask = np.zeros(len(table.rows), dtype=bool)
        mask[table.find(tokens)] = True
        return mask

    def _picture_tokens(self, moment: Moment) -> list[str]:
        """sample_data tokens of a unit's virtual pictures, in the rig's order; their poses have the same."""
        if moment.token not in self._picture_tokens_of:
            channels = self._plan.rig.channels
            self._picture_tokens_of[moment.token] = [
                self._token("sample_data", moment.token, channel) for channel in channels
            ]
        return self._picture_tokens_of[moment.token]

    def _has_picture(self, moment: Moment) -> list[bool]:
        """Whether each of them was written."""
        return [size > 0 for size in self._receipts[moment.token].picture_bytes]

    def _token(self, table: str, source_token: str, channel: str) -> str:
        return derived_token(table, source_token, self._plan.rig.digest, channel)


@contextlib.contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Rows hold no circles, but a collection while they are made looks at everything that a plan holds."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _indices(changes: Mapping[int, Any]) -> Indices:
    return np.array(list(changes), dtype=np.int64)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""


def _row(**fields: Any) -> bytes:
    return msgspec.json.encode(fields)
