"""Two small camera detectors: pictures of any rig to a bird's-eye grid, and a head on it.

`LiftSplat` (after Philion & Fidler, 2020) learns how far away each pixel is and puts its feature there. `Bilinear`
(after Simple-BEV, 2023) learns no depth: each place of the grid takes the mean of what the cameras show there.
They share all the rest.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from benchmarks.cross_rig.config import CLASSES, SEEN, STRIDE
from benchmarks.cross_rig.frames import DEPTHS_M, Rig
from benchmarks.cross_rig.targets import CELL_M, CELLS, HALF_M, NUMBERS

WIDTH = 16
LEVELS_M = np.array([0.0, 0.7, 1.4, 2.5], dtype=np.float32)
"""Heights at which the bilinear lift looks."""
_LOW_M, _HIGH_M = -1.0, 4.0


def _layer(channels_in: int, channels_out: int, side: int = 3, stride: int = 1, reach: int = 1) -> nn.Sequential:
    """A convolution of a kernel of so many cells a side, with `reach` cells from one to the next."""
    pad = (side - 1) * reach // 2
    convolution = nn.Conv2d(channels_in, channels_out, side, stride, pad, dilation=reach, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(channels_out), nn.ReLU(True))


def _halved(channels_in: int, channels_out: int, side: int) -> nn.Sequential:
    """Half the resolution. Kernels of even sides keep the picture's middle in the middle, flipped or not."""
    return _layer(channels_in, channels_out, side, 2)


class _Residual(nn.Module):
    def __init__(self, channels: int, reach: int = 1) -> None:
        super().__init__()
        self.layers = nn.Sequential(_layer(channels, channels), _layer(channels, channels, reach=reach))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x + self.layers(x)


class _Grid(nn.Module):
    """The bird's-eye half: grid features to heat (K) and numbers."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.fine = _layer(channels, 24)
        self.coarse = nn.Sequential(_halved(24, 48, 4), _Residual(48), _halved(48, 64, 2), _Residual(64))
        self.narrow = nn.Conv2d(64, 32, 1)
        self.joined = _layer(24 + 32, 32)
        self.heat = nn.Conv2d(32, len(CLASSES), 1)
        self.numbers = nn.Conv2d(32, NUMBERS, 1)
        nn.init.constant_(self.heat.bias, -4.0)

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        fine = self.fine(x)
        coarse = functional.interpolate(
            self.narrow(self.coarse(fine)), scale_factor=4, mode="bilinear", align_corners=False
        )
        joined = self.joined(torch.cat([fine, coarse], 1))
        return self.heat(joined), self.numbers(joined)


class Detector(nn.Module):
    """Pictures to heat maps."""

    learns_depth = False

    def __init__(self, picture_channels: int, grid_channels: int) -> None:
        super().__init__()
        self.picture = nn.Sequential(
            _halved(3, WIDTH, 4),
            _halved(WIDTH, 2 * WIDTH, 4),
            _halved(2 * WIDTH, 3 * WIDTH, 2),
            _Residual(3 * WIDTH, reach=3),
            nn.Conv2d(3 * WIDTH, picture_channels, 1),
        )
        self.grid = _Grid(grid_channels)

    def lift(self, features: torch.Tensor, rig: Rig, turns: torch.Tensor) -> torch.Tensor:
        raise NotImplementedError

    def forward(
        self, pictures: torch.Tensor, rig: Rig, mirrored: torch.Tensor, turns: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Heat (B, K, CELLS, CELLS; before the sigmoid), numbers (B, NUMBERS, CELLS, CELLS), and the pictures'
        features (B, C, F, h, w), the first of which are depth (before the softmax) where depth is learned.

        Args:
            pictures: (B, C, 3, H, W) uint8.
            mirrored: (B,) bool, whose pictures are flipped left to right on the way in. Calibration stays right.
            turns: (B, 2, 2), how the grid lies to the ego frame: grid = turn @ ego.
        """
        batch, cameras = pictures.shape[:2]
        seen = pictures.flatten(0, 1).float() / 64.0 - 2.0
        flips = mirrored.repeat_interleave(cameras)
        seen = torch.where(flips[:, None, None, None], seen.flip(-1), seen)
        features = self.picture(seen)
        features = torch.where(flips[:, None, None, None], features.flip(-1), features)
        features = features.unflatten(0, (batch, cameras))
        return *self.grid(self.lift(features, rig, turns)), features


class LiftSplat(Detector):
    """Learned depth, one of DEPTHS_M for each feature."""

    learns_depth = True

    def __init__(self) -> None:
        super().__init__(len(DEPTHS_M) + WIDTH, WIDTH)

    def lift(self, features: torch.Tensor, rig: Rig, turns: torch.Tensor) -> torch.Tensor:
        batch = len(features)
        depth, content = features.split([len(DEPTHS_M), WIDTH], dim=2)
        spread = depth.softmax(2)[:, :, None] * content[:, :, :, None]  # (B, C, WIDTH, D, h, w)
        rows = spread.permute(0, 1, 3, 4, 5, 2).reshape(batch, -1, WIDTH)
        places, kept = _frustum(rig)
        grid = features.new_zeros(batch * CELLS * CELLS, WIDTH)
        cells, inside = _cells(places @ turns.transpose(1, 2))  # (B, P)
        inside &= kept
        offset = torch.arange(batch)[:, None] * CELLS * CELLS
        grid = grid.index_add(0, (cells + offset)[inside], rows[inside])
        return grid.view(batch, CELLS, CELLS, WIDTH).permute(0, 3, 1, 2)


class Bilinear(Detector):
    """No depth: the mean of what the cameras show at each place, at four heights."""

    def __init__(self) -> None:
        super().__init__(WIDTH, WIDTH * len(LEVELS_M))

    def lift(self, features: torch.Tensor, rig: Rig, turns: torch.Tensor) -> torch.Tensor:
        batch, cameras = features.shape[:2]
        axis = (torch.arange(CELLS) + 0.5) * CELL_M - HALF_M
        level = torch.from_numpy(LEVELS_M)
        place = torch.stack(torch.meshgrid(level, axis, axis, indexing="ij"), -1).flatten(0, 2)[:, [1, 2, 0]]
        ego = place[None].repeat(batch, 1, 1)
        ego[..., :2] = place[:, :2] @ turns  # the inverse of an orthogonal turn, from the right
        where, seen = _pixels(ego, rig)  # (B, C, P, 2) and (B, C, P)
        found = functional.grid_sample(
            features.flatten(0, 1), where.flatten(0, 1)[:, None], align_corners=False, padding_mode="border"
        )
        found = found[:, :, 0].unflatten(0, (batch, cameras)) * seen[:, :, None]  # (B, C, WIDTH, P)
        mean = found.sum(1) / seen.sum(1).clamp(min=1)[:, None]
        return mean.unflatten(2, (len(LEVELS_M), CELLS, CELLS)).flatten(1, 2)


DETECTORS = {"lift-splat": LiftSplat, "bilinear": Bilinear}


def _frustum(rig: Rig) -> tuple[torch.Tensor, torch.Tensor]:
    """Ego x and y (P, 2) of all features at all depths, and which of them (P,) are at heights that count."""
    width, height = SEEN[0] // STRIDE, SEEN[1] // STRIDE
    u = np.arange(width, dtype=np.float32) * STRIDE + (STRIDE - 1) / 2
    v = np.arange(height, dtype=np.float32) * STRIDE + (STRIDE - 1) / 2
    pixels = np.stack([*np.meshgrid(u, v), np.ones((height, width), np.float32)], -1)
    rays = np.einsum("cij,hwj->chwi", np.linalg.inv(rig.intrinsics), pixels)
    points = rays[:, None] * DEPTHS_M[None, :, None, None, None]  # (C, D, h, w, 3)
    rotation, centre = rig.ego_from_cam[:, :3, :3], rig.ego_from_cam[:, :3, 3]
    ego = np.einsum("cij,cdhwj->cdhwi", rotation, points) + centre[:, None, None, None]
    flat = torch.from_numpy(ego.reshape(-1, 3).astype(np.float32))
    return flat[:, :2], (flat[:, 2] > _LOW_M) & (flat[:, 2] < _HIGH_M)


def _cells(places: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Flat cells (B, P) of places (B, P, 2), and which lie in the grid."""
    cell = torch.floor((places + HALF_M) / CELL_M).long()
    inside = ((cell >= 0) & (cell < CELLS)).all(-1)
    return cell[..., 0] * CELLS + cell[..., 1], inside


def _pixels(ego: torch.Tensor, rig: Rig) -> tuple[torch.Tensor, torch.Tensor]:
    """Places (B, P, 3) in each camera: (B, C, P, 2) from -1 to 1 over the picture, and which are in it."""
    cam_from_ego = torch.from_numpy(np.linalg.inv(rig.ego_from_cam))
    intrinsics = torch.from_numpy(rig.intrinsics)
    cam = torch.einsum("cij,bpj->bcpi", cam_from_ego[:, :3, :3], ego) + cam_from_ego[None, :, None, :3, 3]
    ahead = cam[..., 2].clamp(min=0.1)
    pixel = torch.einsum("cij,bcpj->bcpi", intrinsics, cam)[..., :2] / ahead[..., None]
    where = (pixel + 0.5) / torch.tensor(SEEN) * 2 - 1
    return where, (cam[..., 2] > 0.5) & (where.abs() <= 1).all(-1)
