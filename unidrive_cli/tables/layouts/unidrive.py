"""What UniDrive's own generator writes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from unidrive_cli.tables.layouts.base import Layout, glimpse

_TOKEN = re.compile(rb'"token"\s*:\s*"([^"]*)"')


class UniDriveLayout(Layout):
    """nuScenes' folders; tokens are numbers, and all sensors of a frame have one ego pose."""

    name = "unidrive"
    title = "UniDrive"

    def is_at(self, folder: Path) -> bool:
        tokens = _TOKEN.findall(glimpse(folder / "sample.json"))
        return bool(tokens) and all(token.isdigit() for token in tokens)

    def mend(self, tables: dict[str, Any]) -> Iterator[str]:
        yield "All sensors of a frame have one ego pose, so its pictures are taken to be of one moment."
