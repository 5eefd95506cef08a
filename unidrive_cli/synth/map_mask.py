"""The map picture of a town: where vehicles may drive, as nuscenes-devkit reads it."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
import shapely

from unidrive_cli.synth.town import Town

METRES_PER_PX = 0.1
"""nuscenes-devkit's MapMask takes this for granted."""


def drivable_mask(town: Town) -> npt.NDArray[np.uint8]:
    """(n, n) uint8: 255 where vehicles may drive; bottom left is the global frame's origin, north is up."""
    side_px = int(np.ceil(town.plan.side_m / METRES_PER_PX))
    mask = np.zeros((side_px, side_px), dtype=np.uint8)
    rings = []
    for polygon in shapely.get_parts(town.road):
        for ring in (polygon.exterior, *polygon.interiors):
            x, y = np.asarray(ring.coords).T / METRES_PER_PX
            rings.append(np.rint(np.stack([x, side_px - y], axis=-1)).astype(np.int32))
    cv2.fillPoly(mask, rings, (255,))  # by the even-odd rule: holes stay black
    return mask
