"""Boxes before several pinhole cameras at once: which may show in which picture, and where."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from unidrive_cli.geometry import boxes
from unidrive_cli.geometry.arrays import Bool, Float
from unidrive_cli.geometry.lenses import PIXEL_TOLERANCE, Pinhole


class Sights:
    """Pairs of a camera and a box that may show in its picture, sorted by camera.

    Left out are boxes that do not reach `near_m` in front of the camera, or lie beyond one of the four planes
    through its picture's borders.

    Attributes:
        camera, box: (p,) indices.
        whole: (p,) whether the box lies wholly within the four planes.
        corners: (p, 8, 3) homogeneous pixels u z, v z, z of the corners, z in metres.
    """

    def __init__(
        self,
        cameras: Sequence[tuple[Pinhole, Float]],
        ego_from_box: Float,
        sizes_wlh_m: Float,
        near_m: float,
    ) -> None:
        """
        Args:
            cameras: lens and `cam_from_ego` (4, 4) of each.
            ego_from_box: (n, 4, 4).
            sizes_wlh_m: (n, 3).
        """
        forms = np.empty((len(cameras), 7, 4))
        for form, (lens, cam_from_ego) in zip(forms, cameras, strict=True):
            form[:4], form[4:] = lens.border_normals() @ cam_from_ego[:3], lens.matrix @ cam_from_ego[:3]
        corners = np.ones((8, 4, len(sizes_wlh_m)))
        corners[:, :3] = boxes.corners(ego_from_box, sizes_wlh_m).transpose(1, 2, 0)
        values = (forms.reshape(-1, 4) @ corners).reshape(8, len(cameras), 7, len(sizes_wlh_m))
        borders = values[:, :, :4]
        may_show = (borders.max(axis=0) > 0).all(axis=1) & (values[:, :, 6].max(axis=0) >= near_m)
        self.camera, self.box = np.nonzero(may_show)
        self.whole: Bool = (borders.min(axis=0) > 0).all(axis=1)[may_show]
        self.corners: Float = values[:, self.camera, 4:, self.box]
        self._pixels_from_box = forms[:, 4:]
        self._ego_from_box, self._sizes_wlh_m = ego_from_box, sizes_wlh_m
        self._borders_px = np.array([[lens.width_px, lens.height_px] for lens, _ in cameras]) - 0.5 + PIXEL_TOLERANCE

    def of_camera(self, camera: int) -> slice:
        """The pairs of a camera."""
        start, end = np.searchsorted(self.camera, [camera, camera + 1])
        return slice(int(start), int(end))

    def project(self, pairs: npt.NDArray[np.intp], unit_points: Float) -> tuple[Float, Bool]:
        """Where points (k, 3) of [-1, 1]^3, placed in the boxes of some pairs (q,), are in the pictures.

        Returns:
            Pixels (2, q, k), and where (q, k) they are inside the picture, to PIXEL_TOLERANCE.
        """
        camera, box = self.camera[pairs], self.box[pairs]
        pixels_from_box = self._pixels_from_box[camera] @ self._ego_from_box[box]
        pixels_from_box[:, :, :3] *= self._sizes_wlh_m[box][:, None, [1, 0, 2]] / 2
        u, v, z = np.moveaxis(pixels_from_box[:, :, :3] @ unit_points.T + pixels_from_box[:, :, 3:], 1, 0)
        ahead = z > 0
        depth = np.where(ahead, z, 1.0)
        pixels = np.array([u / depth, v / depth])
        high = self._borders_px[camera].T[:, :, None]
        inside: Bool = ahead & ((pixels >= -0.5 - PIXEL_TOLERANCE) & (pixels <= high)).all(axis=0)
        return pixels, inside
