"""Textures made from noise and simple shapes: square tiles that repeat."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from unidrive_cli.geometry.arrays import Float

SIDE_PX = 512
LAYERS = (
    "plain",
    "asphalt",
    "paving",
    "grass",
    "marking",
    "concrete",
    "brick",
    "plaster",
    "facade_flats",
    "facade_old",
    "facade_office",
    "facade_glass",
    "shops",
    "roof",
    "bark",
    "leaves",
    "clouds",
)
"""Names of the texture layers, in order."""


def layer(name: str) -> int:
    """Index of a texture layer."""
    return LAYERS.index(name)


def make_textures(seed: int) -> npt.NDArray[np.uint8]:
    """(len(LAYERS), SIDE_PX, SIDE_PX, 3) uint8: square roots of linear RGB, times 255. Row 0 is v = 0.

    `plain` is white. `clouds` is a grey density: 0 is clear sky.
    """
    rng = np.random.default_rng(seed)
    makers: dict[str, Callable[[np.random.Generator], Any]] = {
        "plain": lambda rng: np.ones((SIDE_PX, SIDE_PX, 3)),
        "asphalt": _asphalt,
        "paving": _paving,
        "grass": _grass,
        "marking": _marking,
        "concrete": _concrete,
        "brick": _brick,
        "plaster": lambda rng: _tinted(0.62 + 0.12 * noise(rng, (4, 16, 64, 256), 0.7), (1, 0.98, 0.95)),
        "facade_flats": lambda rng: _facade(rng, window=(1.5, 1.5), bay_m=3.2, sill=True, balconies=True),
        "facade_old": lambda rng: _facade(rng, window=(1.1, 1.8), bay_m=2.56, sill=True, frame=True),
        "facade_office": lambda rng: _facade(rng, window=(2.7, 1.7), bay_m=3.2, mullions=2),
        "facade_glass": lambda rng: _facade(rng, window=(3.05, 2.6), bay_m=3.2, mullions=1),
        "shops": _shops,
        "roof": _roof,
        "bark": lambda rng: _tinted(0.3 + 0.4 * noise(rng, (32, 64, 128), 0.8), (1, 0.95, 0.9)),
        "leaves": _leaves,
        "clouds": lambda rng: _tinted(
            np.clip(noise(rng, (3, 6, 12, 24, 48, 96), 0.58) * 2.2 - 0.85, 0, 1), (1, 1, 1)
        ),
    }
    tiles = np.stack([makers[name](rng) for name in LAYERS])
    textures: npt.NDArray[np.uint8] = np.rint(255 * np.sqrt(np.clip(tiles, 0, 1))).astype(np.uint8)
    return textures


def noise(rng: np.random.Generator, cells: Sequence[int], falloff: float) -> Float:
    """(SIDE_PX, SIDE_PX) smooth noise in 0 to 1 that repeats: octaves with so many cells a side."""
    total = np.zeros((SIDE_PX, SIDE_PX))
    weight = 1.0
    for count in cells:
        grid = rng.random((count, count))
        at = np.arange(SIDE_PX) * count / SIDE_PX
        low = at.astype(int)
        share = at - low
        share = share * share * (3 - 2 * share)
        high = (low + 1) % count
        rows = grid[low] * (1 - share)[:, None] + grid[high] * share[:, None]
        total += weight * (rows[:, low] * (1 - share) + rows[:, high] * share)
        weight *= falloff
    low_value, high_value = total.min(), total.max()
    scaled: Float = (total - low_value) / (high_value - low_value)
    return scaled


def _tinted(grey: Float, tint: Any) -> Float:
    """(SIDE_PX, SIDE_PX, 3) of a grey picture and a colour."""
    coloured: Float = grey[..., None] * np.asarray(tint, dtype=np.float64)
    return coloured


def _asphalt(rng: np.random.Generator) -> Float:
    grain = noise(rng, (64, 128, 256), 0.9)
    stains = noise(rng, (3, 6, 12), 0.6)
    grey = 0.075 + 0.05 * grain + 0.035 * stains
    stones = rng.random((SIDE_PX, SIDE_PX)) > 0.985
    grey = np.where(stones, grey + 0.07, grey)
    return _tinted(grey, (1.0, 0.98, 0.96))


def _paving(rng: np.random.Generator) -> Float:
    """Slabs of half a metre on a tile of three metres."""
    slabs = 6
    at = np.arange(SIDE_PX) * slabs / SIDE_PX
    row, column = at.astype(int)[:, None], ((at[None, :] + 0.5 * (at.astype(int)[:, None] % 2)) % slabs).astype(int)
    shade = rng.uniform(0.85, 1.1, (slabs, slabs))[np.broadcast_to(row, (SIDE_PX, SIDE_PX)), column]
    edge_y = np.minimum(at % 1, 1 - at % 1)[:, None]
    across = (at[None, :] + 0.5 * (at.astype(int)[:, None] % 2)) % 1
    joint = np.minimum(edge_y, np.minimum(across, 1 - across)) < 0.025
    grey = (0.27 + 0.08 * noise(rng, (32, 64, 128, 256), 0.8)) * shade
    return _tinted(np.where(joint, 0.14, grey), (1.0, 0.97, 0.92))


def _grass(rng: np.random.Generator) -> Float:
    blades, patches = noise(rng, (64, 128, 256), 1.0), noise(rng, (4, 8, 16), 0.6)
    green = np.array([0.10, 0.17, 0.035]) * (0.5 + blades)[..., None]
    dry = np.array([0.22, 0.19, 0.08]) * (0.5 + blades)[..., None]
    share = np.clip(patches * 1.6 - 0.6, 0, 1)[..., None]
    mixed: Float = green * (1 - 0.6 * share) + dry * 0.6 * share
    return mixed


def _marking(rng: np.random.Generator) -> Float:
    worn = noise(rng, (16, 64, 128, 256), 0.8)
    return _tinted(np.where(worn < 0.25, 0.35, 0.62 + 0.15 * worn), (1.0, 0.99, 0.95))


def _concrete(rng: np.random.Generator) -> Float:
    grey = 0.34 + 0.1 * noise(rng, (4, 8, 32, 128, 256), 0.75)
    joint = np.arange(SIDE_PX) % (SIDE_PX // 4) < 3
    grey[:, joint] *= 0.6
    return _tinted(grey, (1.0, 0.985, 0.95))


def _brick(rng: np.random.Generator) -> Float:
    """Courses of 8 cm on a tile of 3.2 m, with one window."""
    rows, columns = 40, 14
    v, u = np.arange(SIDE_PX) * rows / SIDE_PX, np.arange(SIDE_PX) * columns / SIDE_PX
    course = v.astype(int)[:, None]
    shifted = u[None, :] + 0.5 * (course % 2)
    shade = rng.uniform(0.7, 1.2, (rows, columns))[
        np.broadcast_to(course, (SIDE_PX, SIDE_PX)), (shifted % columns).astype(int)
    ]
    joint = (v % 1 < 0.14)[:, None] | (shifted % 1 < 0.06)
    wall = np.where(joint, 0.75, (0.72 + 0.2 * noise(rng, (64, 128), 0.8)) * shade)
    picture = _tinted(wall, (1.0, 1.0, 1.0))
    _window(rng, picture, (1.05, 0.95), (1.1, 1.4), 3.2, frame=True, sill=True, mullions=1)
    return picture


def _facade(
    rng: np.random.Generator,
    *,
    window: tuple[float, float],
    bay_m: float,
    sill: bool = False,
    frame: bool = False,
    balconies: bool = False,
    mullions: int = 1,
) -> Float:
    """Four storeys of windows on a tile of 12.8 m; the wall is nearly white, buildings tint it."""
    picture = _tinted(0.78 + 0.14 * noise(rng, (2, 4, 16, 64, 256), 0.8), (1.0, 1.0, 1.0))
    side_m, storey_m = 12.8, 3.2
    for floor in range(4):
        picture[_px(floor * storey_m, side_m) : _px(floor * storey_m + 0.12, side_m)] *= 0.8
        for bay in range(round(side_m / bay_m)):
            left, low = bay * bay_m + (bay_m - window[0]) / 2, floor * storey_m + (storey_m - window[1]) * 0.55
            _window(rng, picture, (left, low), window, side_m, frame=frame, sill=sill, mullions=mullions)
            if balconies and bay % 2 == 1:
                low_px, high_px = _px(floor * storey_m + 0.1, side_m), _px(floor * storey_m + 1.05, side_m)
                columns = slice(_px(left - 0.5, side_m), _px(left + window[0] + 0.5, side_m))
                picture[low_px:high_px, columns] = 0.35
                picture[low_px:high_px, columns][:, ::3] = 0.15
                picture[high_px - 2 : high_px, columns] = 0.2
    return picture


def _px(metres: float, side_m: float) -> int:
    return round(metres * SIDE_PX / side_m)


def _window(
    rng: np.random.Generator,
    picture: Float,
    corner_m: tuple[float, float],
    size_m: tuple[float, float],
    side_m: float,
    *,
    frame: bool = False,
    sill: bool = False,
    mullions: int = 1,
) -> None:
    """Draws a window into a facade; some have curtains or light behind them."""
    left, low = (_px(value, side_m) for value in corner_m)
    right, high = (_px(corner + size, side_m) for corner, size in zip(corner_m, size_m, strict=True))
    border = max(1, _px(0.09, side_m))
    if frame:
        picture[low - border : high + 2 * border, left - border : right + border] = 0.85
    if sill:
        picture[low - 2 * border : low, left - border : right + border] = 0.55
    height = np.linspace(0, 1, high - low)[:, None, None]
    pane = np.array([0.035, 0.045, 0.055]) + height * np.array([0.06, 0.085, 0.11])
    kind = rng.random()
    if kind < 0.25:
        pane = pane + rng.uniform(0.1, 0.4) * np.array([1.0, 0.95, 0.85]) * (height > rng.uniform(0.0, 0.8))
    elif kind < 0.32:
        pane = pane + np.array([0.45, 0.33, 0.16])
    picture[low:high, left:right] = pane
    bar = max(1, border // 2 + 1)
    for step in range(1, mullions + 1):
        at = left + round((right - left) * step / (mullions + 1))
        picture[low:high, at - bar // 2 : at - bar // 2 + bar] = 0.5
    picture[low:high, [*range(left, left + bar), *range(right - bar, right)]] = 0.5
    picture[[*range(low, low + bar), *range(high - bar, high)], left:right] = 0.5


def _shops(rng: np.random.Generator) -> Float:
    """A ground floor of three shop fronts on a tile 12.8 m wide and a storey high."""
    picture = _tinted(0.36 + 0.1 * noise(rng, (4, 32, 128), 0.8), (1.0, 0.97, 0.93))
    for shop in range(3):
        left, right = (round(SIDE_PX * (shop + share) / 3) for share in (0.05, 0.95))
        colour = rng.uniform(0.03, 0.5, 3)
        picture[round(0.78 * SIDE_PX) : round(0.95 * SIDE_PX), left:right] = colour
        letters = rng.random((1, (right - left) // 6)) > 0.45
        band = np.repeat(letters, 6, axis=1)[0]
        rows = slice(round(0.83 * SIDE_PX), round(0.90 * SIDE_PX))
        start = left + (right - left) // 6
        stop = start + 2 * (right - left) // 3
        picture[rows, start:stop][:, band[: stop - start]] = 0.75
        inside = 0.05 + 0.2 * noise(rng, (8, 24), 0.7)[round(0.18 * SIDE_PX) : round(0.74 * SIDE_PX), left:right]
        goods = _tinted(inside, rng.uniform(0.5, 1.2, 3))
        picture[round(0.18 * SIDE_PX) : round(0.74 * SIDE_PX), left:right] = goods
        door = left + round((right - left) * rng.uniform(0.1, 0.7))
        picture[round(0.05 * SIDE_PX) : round(0.74 * SIDE_PX), door : door + 36] = 0.06
        for bar in (left, right - 4, door - 4, door + 36):
            picture[round(0.05 * SIDE_PX) : round(0.74 * SIDE_PX), bar : bar + 4] = 0.3
    return picture


def _roof(rng: np.random.Generator) -> Float:
    rows = (np.arange(SIDE_PX) % 22)[:, None] / 22
    return _tinted((0.55 + 0.4 * rows) * (0.75 + 0.35 * noise(rng, (8, 64, 128), 0.8)), (1.0, 1.0, 1.0))


def _leaves(rng: np.random.Generator) -> Float:
    clumps, blades = noise(rng, (12, 24, 48), 0.8), noise(rng, (64, 128), 0.9)
    shade = np.clip(1.9 * clumps - 0.35, 0.1, 1) * (0.45 + 0.75 * blades)
    picture = _tinted(shade, (1.0, 1.0, 1.0))
    gaps = (noise(rng, (20, 40, 80), 0.9) < 0.32)[..., None]
    darkened: Float = np.where(gaps, 0.18 * picture, picture)
    return darkened
