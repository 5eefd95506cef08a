"""What a renderer is given, and what it gives back: the seam between the world and its pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from unidrive_cli.geometry.arrays import Float
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.synth.mesh import Mesh
from unidrive_cli.tables.instances import FIRST_OBJECT, GROUND, SKY, STRUCTURES

SKY_ID, GROUND_ID, STRUCTURE_ID, FIRST_ACTOR_ID = SKY, GROUND, STRUCTURES, FIRST_OBJECT
"""Values of instance pictures; actor i has FIRST_ACTOR_ID + i."""

Instances = npt.NDArray[np.uint16]
Picture = npt.NDArray[np.uint8]
Depth = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Day:
    """Sun and sky; colours are linear RGB radiances on a scale where a sunlit white wall is about 1.

    Attributes:
        to_sun: unit vector towards the sun, global frame (z up).
        sun: radiance that a white surface facing the sun returns.
        zenith, horizon: the sky straight up and at the horizon; they also light what the sun does not.
        cloud: 0 (clear) to 1 (closed): share of the sky that the cloud texture covers.
        haze_m: distance at which 1 - 1/e of what is seen is the horizon's colour.
    """

    to_sun: tuple[float, float, float]
    sun: tuple[float, float, float]
    zenith: tuple[float, float, float]
    horizon: tuple[float, float, float]
    cloud: float
    haze_m: float


@dataclass(frozen=True, eq=False)
class Stage:
    """All that can be seen in one scene; one frame of metres, z up, within a kilometre of its origin.

    Attributes:
        ground: roads, markings, pavements, verges.
        structures: buildings, trees, poles.
        actors: each actor's mesh in the frame of its box (x forward, y left, z up, origin at the centre).
        textures: (l, side, side, 3) uint8: square roots of linear RGB, times 255; repeats in both directions.
        day: the light.
    """

    ground: Mesh
    structures: Mesh
    actors: tuple[Mesh, ...]
    textures: npt.NDArray[np.uint8]
    day: Day


@dataclass(frozen=True, eq=False)
class View:
    """A pinhole camera at one moment.

    Attributes:
        lens: intrinsics and size.
        global_from_cam: (4, 4).
        global_from_actor: (n, 4, 4) where each actor of the stage is at that moment.
        shown: (n,) bool: actors that are there at all; None: all.
    """

    lens: Pinhole
    global_from_cam: Float
    global_from_actor: Float
    shown: npt.NDArray[np.bool_] | None = None


class Renderer(Protocol):
    """Draws views of one stage. Two implementations, GL and rays; the same arguments give the same bytes."""

    @property
    def name(self) -> str:
        """What draws, for people: `GL (llvmpipe ...)` or `embree (rays on the CPU)`."""

    def picture(self, view: View, samples: int) -> Picture:
        """(H, W, 3) uint8 BGR, sRGB-encoded.

        Args:
            samples: per pixel: 1, 4 or 16.
        """

    def instances(self, view: View) -> tuple[Instances, Depth]:
        """What the ray through each pixel's centre meets first.

        Returns:
            (H, W) uint16 ids, and (H, W) float32 depths along the optical axis in metres, infinite in the sky.
        """

    def close(self) -> None:
        """Gives back what the renderer holds outside of Python (a GL context)."""
