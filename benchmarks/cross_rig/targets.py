"""Boxes as maps of the bird's-eye grid, and back: what the detector's head learns (as CenterPoint's)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Float32 = npt.NDArray[np.float32]
Found = tuple[npt.NDArray[np.int64], Float32, Float32]
"""Classes (n,), scores (n,), and boxes (n, 7: x, y, z, width, length, height, yaw) in the ego frame."""
CELLS = 64
CELL_M = 0.8
HALF_M = CELLS * CELL_M / 2
NUMBERS = 8
"""Per cell: two offsets in cells, height of the centre in metres, three log sizes, sine and cosine of the yaw."""
_SIGMA_CELLS = 1.0
_TOP = 80


@dataclass(frozen=True, eq=False)
class Targets:
    """What the head should say about one frame.

    Attributes:
        heat: (K, CELLS, CELLS) 1 in the cell of a centre, falling off around; first axis of the grid x, then y.
        cells: (n,) flat index of each centre's cell.
        numbers: (n, NUMBERS).
    """

    heat: Float32
    cells: npt.NDArray[np.int64]
    numbers: Float32


def encode(classes: npt.NDArray[np.int64], boxes: Float32, class_count: int) -> Targets:
    """Targets of the boxes (n, 7: x, y, z, width, length, height, yaw) whose centres lie in the grid."""
    place = (boxes[:, :2] + HALF_M) / CELL_M
    inside = ((place >= 0) & (place < CELLS)).all(axis=1)
    classes, boxes, place = classes[inside], boxes[inside], place[inside]
    cell = np.floor(place).astype(np.int64)
    heat = np.zeros((class_count, CELLS, CELLS), np.float32)
    axis = np.arange(CELLS)
    for kind, (row, column) in zip(classes, cell, strict=True):
        bump_x = np.exp(-((axis - row) ** 2) / (2 * _SIGMA_CELLS**2))
        bump_y = np.exp(-((axis - column) ** 2) / (2 * _SIGMA_CELLS**2))
        heat[kind] = np.maximum(heat[kind], np.outer(bump_x, bump_y).astype(np.float32))
    yaw = boxes[:, 6:]
    numbers = np.concatenate(
        [place - cell - 0.5, boxes[:, 2:3], np.log(boxes[:, 3:6]), np.sin(yaw), np.cos(yaw)], axis=1
    )
    return Targets(heat, cell[:, 0] * CELLS + cell[:, 1], numbers.astype(np.float32))


def decode(heat: Float32, numbers: Float32) -> Found:
    """Boxes at the peaks of a heat map.

    Args:
        heat: (K, CELLS, CELLS) scores from 0 to 1.
        numbers: (NUMBERS, CELLS, CELLS).

    Returns:
        The best first, 80 at most. None is too bad, because nuScenes' evaluation refuses a run without findings.
    """
    padded = np.pad(heat, ((0, 0), (1, 1), (1, 1)))
    around = [padded[:, i : i + CELLS, j : j + CELLS] for i in range(3) for j in range(3)]
    peak = (heat >= np.max(around, axis=0)) & (heat > 0)
    kind, row, column = np.nonzero(peak)
    scores = heat[kind, row, column]
    best = np.argsort(-scores, kind="stable")[:_TOP]
    kind, row, column, scores = kind[best], row[best], column[best], scores[best]
    here = numbers[:, row, column].T
    centre = (np.stack([row, column], axis=1) + 0.5 + here[:, :2]) * CELL_M - HALF_M
    yaw = np.arctan2(here[:, 6:7], here[:, 7:8])
    boxes = np.concatenate([centre, here[:, 2:3], np.exp(here[:, 3:6]), yaw], axis=1)
    return kind.astype(np.int64), scores.astype(np.float32), boxes.astype(np.float32)


def turned(boxes: Float32, by: Float32) -> Float32:
    """Boxes after a turn or a mirroring (2, 2) of the ground plane about the ego origin."""
    moved = boxes.copy()
    moved[:, :2] = boxes[:, :2] @ by.T
    ahead = np.stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6])], axis=1) @ by.T
    moved[:, 6] = np.arctan2(ahead[:, 1], ahead[:, 0])
    return moved
