"""Light and surfaces: the formulas that both renderers share, in numpy.

`shaders/light.glsl` says the same in GLSL, with the constants of this module; a change here is a change there.
Colours are linear RGB radiances (3, n), directions are unit vectors (3, n) of the global frame (z up), float32.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from unidrive_cli.errors import GeometryError
from unidrive_cli.synth.stage import Day, Picture
from unidrive_cli.synth.textures import LAYERS, layer

Array = npt.NDArray[np.float32]
"""float32 of any shape."""

NEAR_M, FAR_M = 0.05, 4000.0
"""Nearer and farther than this along the optical axis, GL draws nothing."""

GRIDS = {1: 1, 4: 2, 16: 4}
"""Samples per pixel, and the side of their square grid inside it."""

EXPOSURE = 1.0
SHOULDER = 0.75
"""Exposed values above this bend smoothly towards 1."""

GROUND_ALBEDO = 0.16
"""What the ground is taken for where it lights, or is mirrored by, other things."""
SKY_SHARE = 0.55
"""Zenith's share in the mean of the sky that lights the shade; the rest is the horizon's."""
LEAF_TRANSMISSION = 0.45
"""Sunlight that comes through a leaf, as a share of what it sends back."""
LEAF_LAYER = layer("leaves")
CLOUD_LAYER = layer("clouds")
VARIED_LAYERS = tuple(layer(name) for name in ("asphalt", "paving", "grass", "concrete"))
"""Layers that are seen over wide areas: a second, slow look at the texture hides that it repeats."""
VARIED_SCALE = 1 / 7.3
VARIED_DEPTH = 0.55

GLOSS_EDGE = 16.0
"""Gloss times this, at most 1, is how far a surface turns into a mirror at grazing angles."""
MIRROR_LOW, MIRROR_HIGH = -0.04, 0.30
"""Heights (sines) of mirrored directions between which the dark ground turns into the sky."""
GLINT, GLINT_POWER = 14.0, 700.0
GLOW_WIDE, GLOW_WIDE_POWER = 0.10, 6.0
GLOW_NEAR, GLOW_NEAR_POWER = 0.30, 90.0
DISC, DISC_OUTER, DISC_INNER = 40.0, 0.99993, 0.99997
CLOUD_SCALE = 0.09
"""Repeats of the cloud texture per height of the clouds."""
CLOUD_LOW, CLOUD_HIGH = 0.02, 0.20
"""Heights (sines) between which clouds appear out of the haze."""
CLOUD_SOFT = 0.16

GRAZING = 1.3
"""Blur where a surface is seen at an angle: 1 is the geometric mean of the footprint's axes, 2 the longer one."""
LOD_BIAS = -0.25


def constants() -> dict[str, float]:
    """The numbers that the shaders share, by name."""
    numbers = {name: value for name, value in globals().items() if isinstance(value, int | float)}
    return {name: float(value) for name, value in numbers.items() if name.isupper()}


@dataclass(frozen=True, eq=False)
class Light:
    """What the formulas need to know of a day; colours are (3, 1)."""

    to_sun: Array
    sun: Array
    zenith: Array
    horizon: Array
    sky_mean: Array
    bounce: Array
    cloud_bright: Array
    cloud_dark: Array
    cloud: float
    haze_m: float

    @classmethod
    def of(cls, day: Day) -> Light:
        """The light of a day. A sun below the horizon lights nothing."""
        to_sun = np.asarray(day.to_sun, dtype=np.float64)
        to_sun = to_sun / np.linalg.norm(to_sun)
        height = float(to_sun[2])
        sun, zenith, horizon = (
            np.asarray(colour, dtype=np.float64) for colour in (day.sun, day.zenith, day.horizon)
        )
        if height <= 0:
            sun = sun * 0
        mean = SKY_SHARE * zenith + (1 - SKY_SHARE) * horizon
        bounce = GROUND_ALBEDO * (sun * max(height, 0.0) * 0.7 + mean)
        columns = (to_sun, sun, zenith, horizon, mean, bounce, 0.62 * sun + 0.45 * mean, 0.16 * sun + 0.50 * mean)
        names = ("to_sun", "sun", "zenith", "horizon", "sky_mean", "bounce", "cloud_bright", "cloud_dark")
        colours = dict(zip(names, map(_column, columns), strict=True))
        return cls(**colours, cloud=float(day.cloud), haze_m=float(day.haze_m))


def _column(values: Any) -> Array:
    column: Array = np.asarray(values, dtype=np.float32).reshape(3, 1)
    return column


def dot(a: Array, b: Array) -> Array:
    """Scalar products (n,) of vectors (3, n) or (3, 1)."""
    product: Array = a[0] * b[0]
    product = product + a[1] * b[1]
    product += a[2] * b[2]
    return product


def smoothstep(low: float, high: float, value: Array) -> Array:
    """0 below `low`, 1 above `high`, smooth between; as GLSL's."""
    share: Array = np.clip((value - np.float32(low)) / np.float32(high - low), 0, 1)
    share *= share * (np.float32(3) - np.float32(2) * share)
    return share


def sky_gradient(light: Light, towards: Array) -> Array:
    """(3, n) clear sky without the sun; below the horizon it is the horizon's colour."""
    below: Array = np.float32(1) - np.maximum(towards[2], 0)
    below *= below
    below *= below
    colour: Array = light.zenith + (light.horizon - light.zenith) * below
    return colour


def sky(light: Light, towards: Array, density: Array) -> Array:
    """(3, n) what is seen in the sky; `density` (n,) is the squared cloud texture at `cloud_place`."""
    colour = sky_gradient(light, towards)
    along = np.maximum(dot(towards, light.to_sun), 0)
    glow = GLOW_WIDE * np.power(along, np.float32(GLOW_WIDE_POWER))
    glow += GLOW_NEAR * np.power(along, np.float32(GLOW_NEAR_POWER))
    glow += DISC * smoothstep(DISC_OUTER, DISC_INNER, along)
    colour += light.sun * glow
    threshold = 1 - light.cloud
    cover = smoothstep(threshold - CLOUD_SOFT, threshold + CLOUD_SOFT, density) * min(light.cloud * 8, 1)
    cover *= smoothstep(CLOUD_LOW, CLOUD_HIGH, towards[2])
    thick = smoothstep(threshold, threshold + 0.6, density)
    cloud = light.cloud_bright + (light.cloud_dark - light.cloud_bright) * thick
    cloud += light.sun * (np.float32(0.25) * np.power(along, np.float32(GLOW_WIDE_POWER)))
    colour += (cloud - colour) * cover
    return colour


def cloud_place(towards: Array) -> Array:
    """(2, n) texture coordinates of the clouds."""
    height = np.maximum(towards[2], CLOUD_LOW) / np.float32(CLOUD_SCALE)
    place: Array = towards[:2] / height
    return place


def mirrored(light: Light, towards: Array, lit: Array) -> Array:
    """(3, n) what a mirror shows in a direction: sky, the sun's glint where `lit` (n,), ground below."""
    colour = sky_gradient(light, towards)
    along = np.maximum(dot(towards, light.to_sun), 0)
    colour += light.sun * (GLOW_WIDE * np.power(along, np.float32(GLOW_WIDE_POWER)))
    share = smoothstep(MIRROR_LOW, MIRROR_HIGH, towards[2])
    colour = light.bounce + (colour - light.bounce) * share
    colour += light.sun * (lit * np.float32(GLINT) * np.power(along, np.float32(GLINT_POWER)))
    return colour


def sunlight(light: Light, normals: Array, leaves: npt.NDArray[np.bool_]) -> Array:
    """(n,) share of the sun's light that arrives unless something is in the way; leaves let some through."""
    facing = dot(normals, light.to_sun)
    through = np.where(leaves, np.float32(-LEAF_TRANSMISSION), np.float32(0))
    arriving: Array = np.maximum(facing, through * facing)
    return arriving


def shade(
    light: Light, albedo: Array, normals: Array, towards: Array, gloss: Array, direct: Array, lit: Array
) -> Array:
    """(3, n) light that a surface sends to the eye.

    Args:
        albedo: (3, n), texture included.
        normals: (3, n), on the side that is seen.
        towards: (3, n) from the eye to the surface.
        gloss: (n,).
        direct: (n,) `sunlight`.
        lit: (n,) 1 in the sun, 0 in the shadow.
    """
    up = np.float32(0.5) + np.float32(0.5) * normals[2]
    colour: Array = light.bounce + (light.sky_mean - light.bounce) * up
    colour += light.sun * (direct * lit)
    colour *= albedo
    shiny = np.flatnonzero(gloss > 0)
    if shiny.size:
        normals, towards, gloss = normals[:, shiny], towards[:, shiny], gloss[shiny]
        facing = dot(normals, towards)
        edge = np.float32(1) - np.clip(-facing, 0, 1)
        square = edge * edge
        share = gloss + (np.float32(1) - gloss) * np.minimum(gloss * GLOSS_EDGE, 1) * square * square * edge
        bounced = towards - np.float32(2) * facing * normals
        mirror = mirrored(light, bounced, lit[shiny])
        matt = colour[:, shiny]
        colour[:, shiny] = matt + (mirror - matt) * share
    return colour


def haze(light: Light, colour: Array, distance_m: Array) -> Array:
    """(3, n) a colour seen through the air."""
    clear = np.exp(distance_m * np.float32(-1 / light.haze_m))
    seen: Array = light.horizon + (colour - light.horizon) * clear
    return seen


def exposed(colour: Array) -> Array:
    """Linear values 0 to 1 of radiances: what is averaged over the samples of a pixel."""
    value = colour * np.float32(EXPOSURE)
    above = np.maximum(value - np.float32(SHOULDER), 0)
    room = 1 - SHOULDER
    bent = np.float32(room) * (np.float32(1) - np.exp(above * np.float32(-1 / room)))
    tone: Array = np.minimum(value, np.float32(SHOULDER)) + bent
    return tone


def encoded(linear: Array) -> Picture:
    """sRGB bytes of linear values 0 to 1, the same shape."""
    steps = np.arange(65536) / 65535
    curve = np.where(steps <= 0.0031308, 12.92 * steps, 1.055 * np.power(steps, 1 / 2.4) - 0.055)
    table = np.rint(255 * curve).astype(np.uint8)
    picture: Picture = table[(np.clip(linear, 0, 1) * np.float32(65535) + np.float32(0.5)).astype(np.uint16)]
    return picture


def level_of_detail(area_texels: Array, facing: Array) -> Array:
    """(n,) mip level of a texture.

    Args:
        area_texels: (n,) texels of the finest level inside a pixel's footprint.
        facing: (n,) cosine between the surface's own normal and the viewing ray, positive.
    """
    level: Array = np.float32(0.5) * np.log2(np.maximum(area_texels, np.float32(1e-12)))
    level -= np.float32((GRAZING - 1) / 2) * np.log2(np.maximum(facing, np.float32(0.01)))
    level += np.float32(LOD_BIAS)
    return level


def varied(look: Array, mean: Array) -> Array:
    """(n,) slow brightness of wide areas from a second look at the squared texture and the layer's mean."""
    share: Array = np.float32(1 - VARIED_DEPTH) + np.float32(VARIED_DEPTH) * look / mean
    return share


def varied_place(uv: Array) -> Array:
    """(2, n) where the second look goes, turned so that the grids do not meet."""
    u, v = uv
    cosine, sine = np.float32(0.8 * VARIED_SCALE), np.float32(0.6 * VARIED_SCALE)
    place: Array = np.stack([cosine * u - sine * v, sine * u + cosine * v])
    return place


def mip_chain(textures: npt.NDArray[np.uint8]) -> list[npt.NDArray[np.uint8]]:
    """The textures (l, side, side, 3) at full, half, quarter ... size down to one texel.

    Raises:
        GeometryError: tiles that are not square, or whose side is not a power of two.
    """
    side = textures.shape[1]
    if textures.ndim != 4 or textures.shape != (len(LAYERS), side, side, 3) or side & (side - 1):
        raise GeometryError(
            f"textures must be {len(LAYERS)} square RGB tiles with a power of two a side, got {textures.shape}."
        )
    chain = [np.ascontiguousarray(textures)]
    while (side := side // 2) >= 1:
        blocks = chain[-1].reshape(len(textures), side, 2, side, 2, 3).astype(np.uint16)
        chain.append(((blocks.sum(axis=(2, 4), dtype=np.uint16) + 2) // 4).astype(np.uint8))
    return chain


def layer_means(chain: list[npt.NDArray[np.uint8]]) -> Array:
    """(l,) mean brightness of each layer, squared as the shading does; at least 0.01."""
    green = chain[-1][:, 0, 0, 1].astype(np.float32) / np.float32(255)
    means: Array = np.maximum(green * green, np.float32(0.01))
    return means
