"""MAN TruckScenes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from unidrive_cli.tables.layouts.base import Layout

NO_LOG = "unidrive-no-log"


class TruckScenesLayout(Layout):
    """nuScenes' folders without logs and maps; motion of cabin and chassis; UTM coordinates."""

    name = "truckscenes"
    title = "MAN TruckScenes"

    def is_at(self, folder: Path) -> bool:
        return any((folder / f"ego_motion_{part}.json").exists() for part in ("cabin", "chassis"))

    def mend(self, tables: dict[str, Any]) -> Iterator[str]:
        scenes = tables["scene"]
        without = [index for index, row in enumerate(scenes.rows) if not row.log_token]
        if without:
            tables["scene"] = scenes.mended({index: {"log_token": NO_LOG} for index in without})
            yield f"log_token is empty in {len(without)} scenes, because there are no logs; {NO_LOG} is put in."
            if "log" in tables:
                record = {"token": NO_LOG, "logfile": "", "vehicle": "", "date_captured": "", "location": ""}
                tables["log"] = tables["log"].extended([record])
