"""The road users of the synthetic drive: one model at random of each of six classes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unidrive_cli.errors import UsageError, did_you_mean
from unidrive_cli.synth.heavy import make_bus, make_truck
from unidrive_cli.synth.mesh import Mesh
from unidrive_cli.synth.people import make_pedestrian
from unidrive_cli.synth.shapes import boxed
from unidrive_cli.synth.two_wheelers import make_bicycle, make_motorcycle
from unidrive_cli.synth.vehicles import make_car

KINDS = ("car", "bus", "truck", "motorcycle", "bicycle", "pedestrian")


@dataclass(frozen=True, eq=False)
class ActorModel:
    """A road user and its box.

    Attributes:
        kind: one of KINDS.
        look: kind of car, bus, ... for people.
        size_wlh_m: width, length and height of the box.
        mesh: in the frame of the box: x forward, y left, z up, origin at the box's centre; it touches all six sides.
    """

    kind: str
    look: str
    size_wlh_m: tuple[float, float, float]
    mesh: Mesh


def make_actor(kind: str, rng: np.random.Generator, *, rider: bool = True, walking: bool = True) -> ActorModel:
    """A road user at random; the same state of the generator gives the same bytes.

    Args:
        kind: one of KINDS.
        rng: the source of looks, sizes and colours.
        rider: two-wheelers only: somebody rides it; else it is parked.
        walking: pedestrians only: in mid-stride; else standing.
    """
    if kind == "car":
        look, size, mesh = make_car(rng)
    elif kind == "bus":
        look, size, mesh = make_bus(rng)
    elif kind == "truck":
        look, size, mesh = make_truck(rng)
    elif kind == "motorcycle":
        look, size, mesh = make_motorcycle(rng, rider=rider)
    elif kind == "bicycle":
        look, size, mesh = make_bicycle(rng, rider=rider)
    elif kind == "pedestrian":
        look, size, mesh = make_pedestrian(rng, walking=walking)
    else:
        raise UsageError(
            f"There is no class of actors '{kind}'.",
            hint=did_you_mean(kind, KINDS) or f"Use one of {', '.join(KINDS)}.",
        )
    width, length, height = (round(side, 3) for side in size)
    return ActorModel(kind, look, (width, length, height), boxed(mesh, (width, length, height)))
