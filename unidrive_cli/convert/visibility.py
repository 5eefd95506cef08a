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

    A level of nuScenes' own that the table lacks is offered too, under nuScenes' token, and `added` if used.
    """

    def __init__(self, rows: Sequence[Visibility]) -> None:
        self._upper = {row.token: upper for row in rows if (upper := _upper_bound(row.level)) is not None}
        tokens, levels = {row.token for row in rows}, set(self._upper.values())
        self._offered = {
            record["token"]: record
            for record in NUSCENES_VISIBILITY
            if _upper_bound(record["level"]) not in levels and record["token"] not in tokens
        }
        self._upper.update({token: _upper_bound(row["level"]) or 0.0 for token, row in self._offered.items()})
        self._used: set[str] = set()

    @property
    def added(self) -> list[dict[str, Any]]:
        """Full rows of the levels that were used and that the table does not have."""
        return [record for token, record in self._offered.items() if token in self._used]

    def lowered(self, token: str | None, shown: float) -> str | None:
        """The token for a box of which the virtual rig shows the share `shown` of what the sources saw.

        The source's level stands for its upper bound, so `upper * shown` bounds what can be visible
        now. Never raised; unknown levels stay, unless nothing is shown.
        """
        upper = self._upper.get(token or "")
        if shown > 0 and (upper is None or shown >= 1.0):
            return token
        bound = (upper or 0.0) * shown - _TOLERANCE
        fitting = [(level, name) for name, level in self._upper.items() if level >= bound]
        level, lower = min(fitting, default=(1.0, token))
        if lower is None or lower == token:
            return token
        if upper is not None and level >= upper:
            return token
        self._used.add(lower)
        return lower


def _upper_bound(level: str | int) -> float | None:
    text = str(level)
    match = re.fullmatch(r"v\d+-(\d+)", text)
    if match:
        return int(match.group(1)) / 100
    return _NAMED_UPPER.get(text)
