"""Lenses: from camera-frame points to pixels and back. One protocol, one module per lens."""

from __future__ import annotations

from collections.abc import Sequence

from unidrive_cli.errors import GeometryError, did_you_mean
from unidrive_cli.geometry.lenses.base import MAX_SIDE_PX, PIXEL_TOLERANCE, Lens
from unidrive_cli.geometry.lenses.distorted import DistortedLens, known_lens
from unidrive_cli.geometry.lenses.fisheye import FisheyeLens
from unidrive_cli.geometry.lenses.opencv import OpenCVLens
from unidrive_cli.geometry.lenses.pinhole import Pinhole

__all__ = [
    "DISTORTED_LENSES",
    "MAX_SIDE_PX",
    "PIXEL_TOLERANCE",
    "DistortedLens",
    "FisheyeLens",
    "Lens",
    "OpenCVLens",
    "Pinhole",
    "lens_of",
]

DISTORTED_LENSES: dict[str, type[DistortedLens]] = {lens.model: lens for lens in (OpenCVLens, FisheyeLens)}
"""Lenses with distortion by the name that rig files give them: a new one is registered here."""


def lens_of(pinhole: Pinhole, model: str, coefficients: Sequence[float]) -> Lens:
    """The lens with a pinhole's intrinsics and picture size, and the distortion of a model.

    Args:
        pinhole: fx, fy, cx, cy and the picture size.
        model: `opencv` or `fisheye`.
        coefficients: of the model, in OpenCV's order; `opencv` with nothing but zeros is the pinhole itself.

    Raises:
        GeometryError: an unknown model, or coefficients that do not fit it.
    """
    if model not in DISTORTED_LENSES:
        guess = did_you_mean(model, DISTORTED_LENSES)
        known = " or ".join(DISTORTED_LENSES)
        raise GeometryError(f"the lens model must be {known}, got {model!r:.60}. {guess}".rstrip())
    k = pinhole
    intrinsics = k.fx_px, k.fy_px, k.cx_px, k.cy_px, k.width_px, k.height_px
    lens = known_lens(DISTORTED_LENSES[model], *intrinsics, tuple(coefficients))
    return pinhole if model == OpenCVLens.model and not any(lens.coefficients) else lens
