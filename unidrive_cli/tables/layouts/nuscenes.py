"""nuScenes' own layout, and whatever is like it."""

from __future__ import annotations

from pathlib import Path

from unidrive_cli.tables.layouts.base import Layout


class NuScenesLayout(Layout):
    """`v1.0-*/`, `samples/CH/`, `sweeps/CH/`, `maps/`: mini, trainval, and test, which has no annotations."""

    name = "nuscenes"
    title = "nuScenes"

    def is_at(self, folder: Path) -> bool:
        return True

    def output_version(self, version: str) -> str:
        return version
