"""The paper's own figures: mAP in percent of BEVFusion-C, raw (its table 1) and through UniDrive (its table 2)."""

from __future__ import annotations

from benchmarks.cross_rig.retention import Matrix


def _row(figures: str) -> dict[str, float]:
    rigs = ("4x95", "5x75", "6x80a", "6x80b", "6x70", "6x60", "8x50", "5x70+110")
    return dict(zip(rigs, map(float, figures.split()), strict=True))


RAW: Matrix = {
    "6x60": _row("3.8 3.4 0.6 0.4 8.1 69.3 17.3 4.6"),
    "6x80a": _row("3.8 30.4 66.7 63.3 16.4 1.8 0.4 9.2"),
    "6x80b": _row("3.5 29.6 63.2 69.1 16.1 1.7 0.2 8.9"),
    "5x70+110": _row("4.9 7.2 8.5 6.9 67.5 9.2 0.5 63.9"),
}
UNIFIED: Matrix = {
    "6x60": _row("58.9 62.2 64.4 65.7 65.0 64.6 63.8 63.6"),
    "6x80a": _row("55.9 65.2 69.4 66.2 68.9 59.6 61.2 63.7"),
    "6x80b": _row("53.6 62.7 64.5 63.1 62.5 62.6 58.4 57.9"),
    "5x70+110": _row("60.1 66.7 69.4 65.8 68.4 63.1 58.9 68.8"),
}
