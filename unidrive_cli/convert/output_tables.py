"""The tables of the output: what stays, what is mended, what the virtual cameras add."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import msgspec
import numpy as np

from unidrive_cli.convert.plan import Plan, Unit
from unidrive_cli.convert.units import Receipt
from unidrive_cli.convert.visibility import VisibilityLevels
from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.geometry.poses import quaternion_from_rotation
from unidrive_cli.tables.extra import IMAGE_ANNOTATIONS
from unidrive_cli.tables.subset import are_kept, mended_instances, mended_links, mended_rows, mended_scenes
from unidrive_cli.tables.table import EMPTY, Indices, ListedTable, RawRow, Table
from unidrive_cli.tables.tokens import derived_token


@dataclass
class Counts:
    """How many rows and boxes the output has, and what happened to them.

    Attributes:
        boxes_unseen: boxes that no covered virtual pixel shows.
        boxes_unwitnessed: boxes that no real camera of their sample saw either.
    """

    samples: int = 0
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
            receipts: by sample token; samples without one leave the dataset.
        """
        self._plan = plan
        self._dataset = plan.dataset
        self._receipts = receipts
        self._units = [unit for unit in plan.units if unit.sample.token in receipts]
        self._levels = VisibilityLevels(plan.dataset.visibility.rows)
        self.counts = Counts(samples=len(self._units))

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
        for unit in self._units:
            shown[self._dataset.annotation_indices(unit.sample.token)] = self._receipts[unit.sample.token].shown
        return shown

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
        shares = self._shown[candidates].tolist()
        for index, code, shown in zip(candidates.tolist(), old[candidates].tolist(), shares, strict=True):
            token = tokens[code] if code >= 0 else ""
            if (new := self._levels.lowered(token, shown)) != token:
                lowered[index] = new
        return lowered

    def write(self, write_table: Callable[[str, Iterable[RawRow]], int]) -> None:
        """Calls `write_table(name, rows)` for every table of the output, and counts."""
        kept, changes = self.kept_annotations, self._changed_annotations
        scenes = dict(mended_scenes(self._dataset, {unit.sample.token for unit in self._units}))
        instances = dict(mended_instances(self._dataset, kept))
        rows: dict[str, Iterable[RawRow]] = {
            "sensor": self._sensors(),
            "calibrated_sensor": self._calibrated_sensors(),
            "ego_pose": self._ego_poses(),
            "sample": self._linked_rows(self._dataset.sample, self.kept_samples),
            "sample_data": self._sample_data(),
            "scene": mended_rows(self._dataset.scene, _indices(scenes), scenes),
            "sample_annotation": mended_rows(self._dataset.sample_annotation, np.flatnonzero(kept), changes),
            "instance": mended_rows(self._dataset.instance, _indices(instances), instances),
            "visibility": [*self._dataset.visibility.raw, *map(msgspec.json.encode, self._levels.added)],
            IMAGE_ANNOTATIONS: self._boxes_2d(),
        }
        for name in ("category", "attribute", "log", "map"):
            rows[name] = getattr(self._dataset, name).raw
        for name in sorted(rows):
            self.counts.tables[name] = write_table(name, rows[name])
        receipts = [self._receipts[unit.sample.token] for unit in self._units]
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

    def _sensors(self) -> Iterator[RawRow]:
        table = self._dataset.sensor
        yield from (raw for row, raw in zip(table.rows, table.raw, strict=True) if row.modality != "camera")
        for channel in self._plan.rig.channels:
            yield _row(token=self._token("sensor", "", channel), channel=channel, modality="camera")

    def _calibrated_sensors(self) -> Iterator[RawRow]:
        table, sensors = self._dataset.calibrated_sensor, self._dataset.sensor_of_calibration
        for row, raw in zip(table.rows, table.raw, strict=True):
            if sensors[row.token].modality != "camera":
                yield raw
        for camera in self._plan.rig.cameras:
            yield _row(
                token=self._token("calibrated_sensor", "", camera.channel),
                sensor_token=self._token("sensor", "", camera.channel),
                translation=camera.centre_ego.tolist(),
                rotation=quaternion_from_rotation(camera.ego_from_cam[:3, :3]).tolist(),
                camera_intrinsic=camera.lens.matrix.tolist(),
            )

    def _ego_poses(self) -> Iterator[RawRow]:
        """Poses that a row which stays uses, or that none ever used; then one per virtual picture."""
        dataset, table = self._dataset, self._dataset.ego_pose
        poses = dataset.sample_data.links("ego_pose_token", table)
        stays = np.ones(len(table.rows), dtype=bool)
        stays[poses] = False
        stays[poses[self.kept_sample_data]] = True
        yield from table.raw_at(np.flatnonzero(stays))
        for unit in self._units:
            place = dataset.sample_data.place(unit.reference, "ego_pose_token")
            pose = table.get(unit.reference.ego_pose_token, place)
            for channel in self._plan.rig.channels:
                yield _row(
                    token=self._token("sample_data", unit.sample.token, channel),
                    timestamp=unit.reference.timestamp,
                    rotation=list(pose.rotation),
                    translation=list(pose.translation),
                )

    def _sample_data(self) -> Iterator[RawRow]:
        yield from self._linked_rows(self._dataset.sample_data, self.kept_sample_data)
        by_scene: dict[str, list[Unit]] = {}
        for unit in self._units:
            by_scene.setdefault(unit.scene.token, []).append(unit)
        for index, camera in enumerate(self._plan.rig.cameras):
            for units in by_scene.values():
                tokens = [self._token("sample_data", unit.sample.token, camera.channel) for unit in units]
                for place, unit in enumerate(units):
                    yield _row(
                        token=tokens[place],
                        sample_token=unit.sample.token,
                        ego_pose_token=tokens[place],
                        calibrated_sensor_token=self._token("calibrated_sensor", "", camera.channel),
                        timestamp=unit.reference.timestamp,
                        fileformat="jpg",
                        is_key_frame=True,
                        height=camera.lens.height_px,
                        width=camera.lens.width_px,
                        filename=unit.pictures[index],
                        prev=tokens[place - 1] if place else "",
                        next=tokens[place + 1] if place + 1 < len(tokens) else "",
                    )

    def _boxes_2d(self) -> Iterator[RawRow]:
        """2D boxes in the form of the devkit's export_2d_annotations_as_json."""
        dataset, kept, changes = self._dataset, self.kept_annotations, self._changed_annotations
        categories = {row.token: row.name for row in dataset.category.rows}
        instances = {row.token: categories.get(row.category_token, "") for row in dataset.instance.rows}
        for unit in self._units:
            indices = dataset.annotation_indices(unit.sample.token)
            annotations = list(dataset.sample_annotation.rows_at(indices))
            pictures = [
                self._token("sample_data", unit.sample.token, channel) for channel in self._plan.rig.channels
            ]
            for box in self._receipts[unit.sample.token].boxes:
                row, index = annotations[box.annotation], int(indices[box.annotation])
                if not kept[index]:
                    continue
                mended = changes.get(index, {})
                yield _row(
                    attribute_tokens=row.attribute_tokens,
                    bbox_corners=[box.left, box.top, box.right, box.bottom],
                    category_name=instances[row.instance_token],
                    filename=unit.pictures[box.camera],
                    instance_token=row.instance_token,
                    next=mended.get("next", row.next),
                    num_lidar_pts=row.num_lidar_pts,
                    num_radar_pts=row.num_radar_pts,
                    prev=mended.get("prev", row.prev),
                    sample_annotation_token=row.token,
                    sample_data_token=pictures[box.camera],
                    visibility_token=mended.get("visibility_token", row.visibility_token),
                )

    @cached_property
    def _changed_annotations(self) -> dict[int, dict[str, Any]]:
        """Mended links, new visibility; and centres in whole numbers as floats, which nuscenes-devkit needs."""
        table, kept = self._dataset.sample_annotation, self.kept_annotations
        changes = mended_links(table, kept)
        for index, token in self._lowered.items():
            changes.setdefault(index, {})["visibility_token"] = token
        centres = table.numbers("translation")
        for index in np.flatnonzero(kept & (centres == np.floor(centres)).all(axis=1)).tolist():
            changes.setdefault(index, {})["translation"] = centres[index].tolist()
        return changes

    def _linked_rows(self, table: Table[Any], kept: Bool) -> Iterator[RawRow]:
        return mended_rows(table, np.flatnonzero(kept), mended_links(table, kept))

    @staticmethod
    def _mask(table: ListedTable[Any], tokens: list[str]) -> Bool:
        mask = np.zeros(len(table.rows), dtype=bool)
        mask[table.find(tokens)] = True
        return mask

    def _token(self, table: str, source_token: str, channel: str) -> str:
        return derived_token(table, source_token, self._plan.rig.digest, channel)


def _indices(changes: Mapping[int, Any]) -> Indices:
    return np.array(list(changes), dtype=np.int64)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else ""


def _row(**fields: Any) -> bytes:
    return msgspec.json.encode(fields)
