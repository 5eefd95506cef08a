"""Visibility levels of a dataset, and which one a box falls to when less of it is shown."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from unidrive_cli.tables.schema import NUSCENES_VISIBILITY, Visibility

_NAMED_UPPER = {"none": 0.4, "partial": 0.6, "most": 0.8, "full": 1.0}
"""T4's names for nuScenes' four bands."""
_TOLERANCE = 1e-9


class VisibilityLevels:
    """The levels of a visibility table, each known by its upper bound.

    A level that is needed and missing is added with nuScenes' own token (`added`).
    """

    def __init__(self, rows: Sequence[Visibility]) -> None:
        self._upper = {row.token: upper for row in rows if (upper := _upper_bound(row.level)) is not None}
        self._tokens = {row.token for row in rows}
        self.added: list[dict[str, Any]] = []
        self._complete()

    def _complete(self) -> None:
        for record in NUSCENES_VISIBILITY:
            upper = _upper_bound(record["level"])
            token = record["token"]
            if upper not in self._upper.values() and token not in self._tokens and upper is not None:
                self._upper[token] = upper
                self.added.append(dict(record))

    def lowered(self, token: str | None, shown: float) -> str | None:
        """The token for a box of which the virtual rig shows the share `shown` of what the sources saw.

        The source's level stands for its upper bound, so `upper * shown` bounds what can be visible
        now. Never raised; unknown levels stay, unless nothing is shown.
        """
        upper = self._upper.get(token or "")
        if shown == 0.0:
            return self._lowest(token)
        if upper is None or shown >= 1.0:
            return token
        bound = upper * shown
        fitting = [(level, name) for name, level in self._upper.items() if level >= bound - _TOLERANCE]
        level, name = min(fitting)
        return name if level < upper else token

    def _lowest(self, token: str | None) -> str | None:
        if not self._upper:
            return token
        level, name = min((level, name) for name, level in self._upper.items())
        return name if level < self._upper.get(token or "", 2.0) else token


def _upper_bound(level: str | int) -> float | None:
    text = str(level)
    match = re.fullmatch(r"v\d+-(\d+)", text)
    if match:
        return int(match.group(1)) / 100
    return _NAMED_UPPER.get(text)
