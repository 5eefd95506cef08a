"""TIER IV's T4 format."""

from __future__ import annotations

import bisect
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from unidrive_cli.tables.layouts.base import Layout
from unidrive_cli.tables.schema import Row, SampleData
from unidrive_cli.tables.subset import mended_links
from unidrive_cli.tables.table import Indices, ListedTable, Table


class _T4Data(Row, frozen=True, gc=False):
    """What T4's rows of sample_data have beyond nuScenes'."""

    is_valid: Any = True
    info_filename: Any = None


class T4Layout(Layout):
    """`annotation/`, `data/CH/`, `map/*.osm`, `status.json`; one scene per dataset, pictures not rectified."""

    name = "t4"
    title = "T4"
    sorts_files = True
    mends_rows = True
    top_files = ("status.json",)
    can_be_kept = True

    def is_at(self, folder: Path) -> bool:
        return folder.name == "annotation"

    def mend(self, tables: dict[str, Any]) -> Iterator[str]:
        table: ListedTable[SampleData] = tables["sample_data"]
        valid = np.array([msgspec.json.decode(raw, type=_T4Data).is_valid is not False for raw in table.raw])
        cameras = _of_cameras(tables)
        dropped = [
            not ok and row.calibrated_sensor_token in cameras for ok, row in zip(valid, table.rows, strict=True)
        ]
        if any(dropped):
            kept = ~np.array(dropped)
            table = table.mended(mended_links(table, kept)).only(kept)
            yield f"{sum(dropped)} pictures are marked is_valid: false and are not read."
        following = _following_key_frames(table)
        if following:
            table = table.mended({index: {"sample_token": token} for index, token in following.items()})
            yield (
                f"sample_token is empty in {len(following)} rows between key frames; each is given to the sample of "
                "its sensor's next key frame, as in nuScenes."
            )
        tables["sample_data"] = table

    def log_fields(self, record: dict[str, Any]) -> dict[str, Any]:
        return {} if "date_captured" in record else {"date_captured": record.get("data_captured", "")}

    def calibration_fields(self) -> dict[str, Any]:
        return {"camera_distortion": []}

    def picture_name(self, channel: str, number: int) -> str:
        return f"data/{channel}/{number:05d}.jpg"

    def further_files(self, sample_data: Table[Any], rows: Indices) -> Iterator[tuple[str, str]]:
        for raw in sample_data.raw_at(rows):
            row = msgspec.json.decode(raw, type=_T4Data)
            if isinstance(row.info_filename, str) and row.info_filename:
                yield sample_data.place(row, "info_filename"), row.info_filename


def _of_cameras(tables: dict[str, Any]) -> set[str]:
    """Tokens of the cameras' calibrations."""
    cameras = {row.token for row in tables["sensor"].rows if row.modality == "camera"}
    return {row.token for row in tables["calibrated_sensor"].rows if row.sensor_token in cameras}


def _following_key_frames(table: ListedTable[SampleData]) -> dict[int, str]:
    """The sample of the sensor's next key frame (of its last after that), for rows that name none, by index."""
    key_frames: dict[str, list[tuple[int | float, str]]] = defaultdict(list)
    for row in table.rows:
        if row.is_key_frame:
            key_frames[row.calibrated_sensor_token].append((row.timestamp, row.sample_token))
    for of_sensor in key_frames.values():
        of_sensor.sort()
    found = {}
    for index, row in enumerate(table.rows):
        of_sensor = key_frames.get(row.calibrated_sensor_token, [])
        if not row.is_key_frame and not row.sample_token and of_sensor:
            place = bisect.bisect_left(of_sensor, (row.timestamp, ""))
            found[index] = of_sensor[min(place, len(of_sensor) - 1)][1]
    return found
