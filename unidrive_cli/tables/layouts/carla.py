"""Generators that record CARLA, such as carla_nuscenes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from unidrive_cli.tables.layouts.base import Layout, glimpse


class CarlaLayout(Layout):
    """nuScenes' folders, `progress.json` (a mapping) among the tables, times from zero in tenths of microseconds."""

    name = "carla"
    title = "CARLA generator"

    def is_at(self, folder: Path) -> bool:
        return glimpse(folder / "progress.json").lstrip().startswith(b"{")

    def mend(self, tables: dict[str, Any]) -> Iterator[str]:
        times = [row.timestamp for row in tables["sample"].rows]
        if times and max(times) < _YEAR_2000_US:
            yield (
                "Timestamps do not count from 1970, and carla_nuscenes writes tenths of microseconds: they stay as "
                "they are; velocities that a reader derives from them may be ten times too small."
            )


_YEAR_2000_US = 946_684_800_000_000
