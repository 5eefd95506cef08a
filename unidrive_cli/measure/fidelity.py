"""Fidelity of one picture to another: PSNR and SSIM over regions, as sums that add up over many pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from skimage.metrics import structural_similarity

from unidrive_cli.geometry.arrays import Bool
from unidrive_cli.warp.pictures import Picture

SEAM_PX = 8
"""How far on either side of a change of the dominant source the seam region reaches."""
SSIM_WINDOW_PX = 11
"""Side of the window in which SSIM compares: pictures must not be smaller."""
_PEAK = 255.0
_CHANNELS = 3


@dataclass(frozen=True)
class Tally:
    """What the pixels of a region add up to; tallies of several pictures may be added.

    Attributes:
        pixels: their number.
        squared_error: sum of the squared differences of all three channels, in levels of 8 bits.
        similarity: sum of the pixels' SSIM.
    """

    pixels: int = 0
    squared_error: int = 0
    similarity: float = 0.0

    def __add__(self, other: Tally) -> Tally:
        return Tally(
            self.pixels + other.pixels,
            self.squared_error + other.squared_error,
            self.similarity + other.similarity,
        )

    @property
    def psnr_db(self) -> float | None:
        """PSNR from the mean squared error of all pixels; infinite where all are equal, None without pixels."""
        if not self.pixels:
            return None
        if not self.squared_error:
            return math.inf
        return 10 * math.log10(_PEAK**2 * _CHANNELS * self.pixels / self.squared_error)

    @property
    def ssim(self) -> float | None:
        """Mean SSIM of the pixels; None without pixels."""
        return self.similarity / self.pixels if self.pixels else None


def compare(picture: Picture, truth: Picture, covered: Bool, regions: Mapping[str, Bool]) -> dict[str, Tally]:
    """Compares a picture with the truth over regions.

    What is not covered is made black in both pictures first: an SSIM window that reaches beyond the
    coverage finds the two equal there.

    Args:
        picture, truth: (H, W, 3) uint8.
        covered: (H, W) where the picture shows anything.
        regions: (H, W) each; only their covered pixels count.

    Returns:
        One tally per region.
    """
    picture, truth = picture * covered[..., None], truth * covered[..., None]
    difference = picture.astype(np.int32) - truth
    squared_error = np.einsum("hwc,hwc->hw", difference, difference)
    similarity = ssim_map(picture, truth)
    tallies = {}
    for name, region in regions.items():
        inside = region & covered
        tallies[name] = Tally(
            int(np.count_nonzero(inside)),
            int(squared_error[inside].sum(dtype=np.int64)),
            float(similarity[inside].sum()),
        )
    return tallies


def ssim_map(picture: Picture, truth: Picture) -> npt.NDArray[np.float64]:
    """SSIM (H, W) of the luma of two BGR pictures: Wang et al. 2004, Gaussian windows with a sigma of 1.5."""
    _, similarity = structural_similarity(  # type: ignore[no-untyped-call]
        cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY),
        cv2.cvtColor(truth, cv2.COLOR_BGR2GRAY),
        full=True,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        data_range=_PEAK,
    )
    return np.asarray(similarity, dtype=np.float64)


def near_seams(dominant: npt.NDArray[np.int32]) -> Bool:
    """Where (H, W) another source becomes the dominant one: the `SEAM_PX` pixels on either side of the change.

    Args:
        dominant: (H, W) index of the source with the largest share of each pixel; negative where there is none.
    """
    border = np.zeros(dominant.shape, dtype=bool)
    for one, other in (
        ((slice(None), slice(1, None)), (slice(None), slice(None, -1))),
        ((slice(1, None), slice(None)), (slice(None, -1), slice(None))),
    ):
        change = (dominant[one] != dominant[other]) & (dominant[one] >= 0) & (dominant[other] >= 0)
        border[one] |= change
        border[other] |= change
    if not border.any():
        return border
    distance_px = cv2.distanceTransform((~border).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    near: Bool = distance_px < SEAM_PX
    return near
