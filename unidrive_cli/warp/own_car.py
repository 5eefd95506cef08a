"""The own car in source pictures: pixels of bonnets and mirrors, which no virtual picture is to show."""

from __future__ import annotations

import functools
import math
import zlib
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.geometry.lenses import PIXEL_TOLERANCE

HALF_PX = 0.5 + PIXEL_TOLERANCE
"""What is exactly between two pixels belongs to the second, whatever it is rounded to."""


@dataclass(frozen=True)
class OwnCar:
    """Where a camera's pictures show the own car, packed for the way to the workers.

    Attributes:
        width_px, height_px: of the pictures.
        packed: the mask, one bit a pixel, compressed.
    """

    width_px: int
    height_px: int
    packed: bytes

    @classmethod
    def of(cls, mask: Bool) -> OwnCar:
        """Packs a mask (H, W) bool, true on the own car."""
        height, width = mask.shape
        return cls(width, height, zlib.compress(np.packbits(mask).tobytes()))

    @property
    def mask(self) -> Bool:
        """(H, W) bool, true on the own car."""
        bits = np.frombuffer(zlib.decompress(self.packed), dtype=np.uint8)
        pixels = np.unpackbits(bits, count=self.width_px * self.height_px)
        return pixels.reshape(self.height_px, self.width_px).astype(bool)


@dataclass(frozen=True, eq=False)
class Hidden:
    """What must not be sampled of a picture: the own car, and what is so near that a sample would touch it.

    Attributes:
        left, top: its first column and row in the picture.
        pixels: (h, w) uint8, 1 where nothing may be sampled; the rest of the picture is free.
    """

    left: int
    top: int
    pixels: npt.NDArray[np.uint8]

    def holds(self, pixels: Float | npt.NDArray[np.float32]) -> Bool:
        """(...,) whether pixels (..., 2) of the picture are hidden."""
        height, width = self.pixels.shape
        if not self.pixels.size:
            return np.zeros(pixels.shape[:-1], dtype=bool)
        column = np.floor(pixels[..., 0] + HALF_PX).astype(np.intp) - self.left
        row = np.floor(pixels[..., 1] + HALF_PX).astype(np.intp) - self.top
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        held: Bool = inside & (self.pixels[row.clip(0, height - 1), column.clip(0, width - 1)] > 0)
        return held


@functools.lru_cache(maxsize=256)
def hidden_of(car: OwnCar, n: float) -> Hidden:
    """What must not be sampled of a copy that is n times smaller; of the picture itself where n is 1.

    A bilinear sample of 4:2:0 chroma reaches over 3 n pixels each way.
    """
    reach = math.ceil(3 * n)
    grown = np.pad(car.mask.astype(np.uint8), reach)
    grown = np.asarray(cv2.dilate(grown, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)), dtype=np.uint8)
    grown = grown[reach:-reach, reach:-reach]
    rows, columns = np.flatnonzero(grown.any(axis=1)), np.flatnonzero(grown.any(axis=0))
    if not len(rows):
        return Hidden(0, 0, grown[:0, :0])
    top, left = int(rows[0]), int(columns[0])
    return Hidden(left, top, np.ascontiguousarray(grown[top : int(rows[-1]) + 1, left : int(columns[-1]) + 1]))
