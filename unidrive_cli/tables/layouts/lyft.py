"""Lyft Level 5."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from unidrive_cli.tables.layouts.base import Layout, glimpse

_FLAT_FILE = re.compile(rb'"filename"\s*:\s*"(images|lidar)/[^/"]*"')


class LyftLayout(Layout):
    """`v1.01-train/` with tables in a folder of the same name, flat `images/` and `lidar/`; times are floats."""

    name = "lyft"
    title = "Lyft Level 5"
    sorts_files = True

    def is_at(self, folder: Path) -> bool:
        return _FLAT_FILE.search(glimpse(folder / "sample_data.json")) is not None

    def mend(self, tables: dict[str, Any]) -> Iterator[str]:
        annotations = tables.get("sample_annotation")
        if annotations and any(row.num_lidar_pts < 0 for row in annotations.rows):
            yield (
                "num_lidar_pts is -1 where it was not counted, and stays so: mmdetection3d takes such boxes for "
                "invalid, nuscenes-devkit's evaluation keeps them."
            )
        if any(isinstance(row.timestamp, float) for row in tables["sample"].rows):
            yield "Timestamps are fractions of microseconds and stay so; file names have them rounded."
