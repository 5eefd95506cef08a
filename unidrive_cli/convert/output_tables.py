"""The tables of the output: what stays, what is mended, what the virtual cameras add."""

from __future__ import annotations

from collections.abc import Callable, Collection, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import msgspec

from unidrive_cli.convert.plan import Plan, Unit
from unidrive_cli.convert.units import Receipt
from unidrive_cli.convert.visibility import VisibilityLevels
from unidrive_cli.geometry.poses import quaternion_from_rotation
from unidrive_cli.tables.schema import SampleAnnotation, SampleData
from unidrive_cli.tables.subset import mended_instances, mended_links, mended_scenes
from unidrive_cli.tables.table import Table, changed
from unidrive_cli.tables.tokens import derived_token

RawRow = bytes | msgspec.Raw
IMAGE_ANNOTATIONS = "image_annotations"


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
    def kept_samples(self) -> set[str]:
        """Tokens of the samples that stay."""
        return {unit.sample.token for unit in self._units}

    @cached_property
    def kept_sample_data(self) -> dict[str, SampleData]:
        """The rows of sensors other than cameras that stay, by token; sweeps without a sample stay too."""
        dataset, samples = self._dataset, {*self.kept_samples, ""}
        return {
            row.token: row
            for row in dataset.sample_data.rows
            if dataset.sensor_of(row).modality != "camera" and row.sample_token in samples
        }

    @cached_property
    def annotation_fates(self) -> dict[str, str | None]:
        """Visibility token of every annotation that stays, by token."""
        drop = self._plan.options.unseen_boxes == "drop"
        return {
            row.token: self._visibility(row, shown)
            for row, shown in self._annotations_shown()
            if shown > 0 or not drop
        }

    def _annotations_shown(self) -> Iterator[tuple[SampleAnnotation, float]]:
        """Every annotation of the samples that stay, with the share of it that is shown."""
        for unit in self._units:
            rows = self._dataset.annotations.get(unit.sample.token, [])
            yield from zip(rows, self._receipts[unit.sample.token].shown, strict=True)

    def _visibility(self, row: SampleAnnotation, shown: float) -> str | None:
        if self._plan.options.visibility == "keep":
            return row.visibility_token
        return self._levels.lowered(row.visibility_token, shown)

    def write(self, write_table: Callable[[str, Iterable[RawRow]], int]) -> None:
        """Calls `write_table(name, rows)` for every table of the output, and counts."""
        fates, changes = self.annotation_fates, self._changed_annotations
        rows: dict[str, Iterable[RawRow]] = {
            "sensor": self._sensors(),
            "calibrated_sensor": self._calibrated_sensors(),
            "ego_pose": self._ego_poses(),
            "sample": self._linked_rows(self._dataset.sample, self.kept_samples),
            "sample_data": self._sample_data(),
            "scene": self._indexed(self._dataset.scene, mended_scenes(self._dataset, self.kept_samples)),
            "sample_annotation": self._kept_rows(self._dataset.sample_annotation, fates, changes),
            "instance": self._indexed(self._dataset.instance, mended_instances(self._dataset, fates)),
            "visibility": [*self._dataset.visibility.raw, *map(msgspec.json.encode, self._levels.added)],
            IMAGE_ANNOTATIONS: self._boxes_2d(),
        }
        for name in ("category", "attribute", "log", "map"):
            rows[name] = getattr(self._dataset, name).raw
        for name in sorted(rows):
            self.counts.tables[name] = write_table(name, rows[name])
        receipts = [self._receipts[unit.sample.token] for unit in self._units]
        self.counts.annotations = len(fates)
        self.counts.visibility_lowered = sum("visibility_token" in fields for fields in changes.values())
        self.counts.boxes_unseen = sum(receipt.shown.count(0.0) for receipt in receipts)
        self.counts.boxes_unwitnessed = sum(receipt.unwitnessed for receipt in receipts)
        self.counts.boxes_dropped = sum(len(receipt.shown) for receipt in receipts) - len(fates)
        self.counts.boxes_2d = self.counts.tables[IMAGE_ANNOTATIONS]

    def extra_tables(self) -> Iterator[tuple[str, list[dict[str, Any]]]]:
        """(name, rows that stay) of the source's extra tables.

        Rows that point to a sample_data or sample row which is gone go with it. A file that is no table
        has no rows.
        """
        stay = {"sample_data_token": self.kept_sample_data, "sample_token": self.kept_samples}
        for name, table in self._dataset.extra_tables.items():
            if name != IMAGE_ANNOTATIONS:
                yield name, [row for row in table.rows or [] if all(_points_into(row, *key) for key in stay.items())]

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
        dataset = self._dataset
        used = {row.ego_pose_token for row in self.kept_sample_data.values()}
        left = {row.ego_pose_token for row in dataset.sample_data.rows} - used
        table = dataset.ego_pose
        for row, raw in zip(table.rows, table.raw, strict=True):
            if row.token not in left:
                yield raw
        for unit in self._units:
            pose = dataset.ego_pose.by_token[unit.reference.ego_pose_token]
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
        dataset, fates, changes = self._dataset, self.annotation_fates, self._changed_annotations
        categories = {row.token: row.name for row in dataset.category.rows}
        instances = {row.token: categories.get(row.category_token, "") for row in dataset.instance.rows}
        for unit in self._units:
            annotations = dataset.annotations.get(unit.sample.token, [])
            for box in self._receipts[unit.sample.token].boxes:
                row = annotations[box.annotation]
                if row.token not in fates:
                    continue
                mended = changes.get(row.token, {})
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
                    sample_data_token=self._token(
                        "sample_data", unit.sample.token, self._plan.rig.channels[box.camera]
                    ),
                    visibility_token=fates[row.token],
                )

    @cached_property
    def _changed_annotations(self) -> dict[str, dict[str, Any]]:
        """Mended links, new visibility; and centres in whole numbers as floats, which nuscenes-devkit needs."""
        fates = self.annotation_fates
        changes: dict[str, dict[str, Any]] = {}
        changes.update(mended_links(self._dataset.sample_annotation.rows, fates))
        for row in self._dataset.sample_annotation.rows:
            if row.token not in fates:
                continue
            if fates[row.token] != row.visibility_token:
                changes.setdefault(row.token, {})["visibility_token"] = fates[row.token]
            if all(number == int(number) for number in row.translation):
                changes.setdefault(row.token, {})["translation"] = list(row.translation)
        return changes

    def _linked_rows(self, table: Table[Any], kept: Collection[str]) -> Iterator[RawRow]:
        return self._kept_rows(table, kept, mended_links(table.rows, kept))

    def _kept_rows(
        self, table: Table[Any], kept: Collection[str], changes: Mapping[str, Mapping[str, Any]]
    ) -> Iterator[RawRow]:
        for row, raw in zip(table.rows, table.raw, strict=True):
            if row.token in kept:
                fields = changes.get(row.token)
                yield changed(raw, fields) if fields else raw

    def _indexed(self, table: Table[Any], changes: Iterator[tuple[int, dict[str, Any]]]) -> Iterator[RawRow]:
        for index, fields in changes:
            yield changed(table.raw[index], fields) if fields else table.raw[index]

    def _token(self, table: str, source_token: str, channel: str) -> str:
        return derived_token(table, source_token, self._plan.rig.digest, channel)


def _points_into(row: dict[str, Any], field: str, known: Container[str]) -> bool:
    token = row.get(field)
    return not isinstance(token, str) or not token or token in known


def _row(**fields: Any) -> bytes:
    return msgspec.json.encode(fields)
