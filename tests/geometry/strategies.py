"""Random geometry of plausible size. Rotations come from pyquaternion, not from the package."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from pyquaternion import Quaternion

from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.geometry.scene import GroundPlane, HalfBall


def reals(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


def vectors(size: int, bound: float) -> st.SearchStrategy[np.ndarray]:
    return st.lists(reals(-bound, bound), min_size=size, max_size=size).map(np.array)


def units(size: int) -> st.SearchStrategy[np.ndarray]:
    return vectors(size, 1.0).filter(lambda v: np.linalg.norm(v) > 0.1).map(lambda v: v / np.linalg.norm(v))


rotations = units(4).map(lambda q: Quaternion(q).rotation_matrix)


@st.composite
def poses(draw: st.DrawFn, bound_m: float = 100.0) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = draw(rotations)
    matrix[:3, 3] = draw(vectors(3, bound_m))
    return matrix


@st.composite
def lenses(draw: st.DrawFn) -> Pinhole:
    """Any pinhole of 20 to 170 degrees or so, with its principal point anywhere in the picture."""
    width, height = draw(st.integers(2, 4000)), draw(st.integers(2, 4000))
    fx, fy = draw(reals(0.2, 3.0)) * width, draw(reals(0.2, 3.0)) * height
    return Pinhole(fx, fy, draw(reals(0.1, 0.9)) * width, draw(reals(0.1, 0.9)) * height, width, height)


@st.composite
def half_balls(draw: st.DrawFn) -> HalfBall:
    """A virtual camera 0.2 to 5 m above a ground that leans by up to some 60 degrees."""
    normal = draw(units(3).filter(lambda n: abs(n[2]) > 0.5))
    ground = GroundPlane(draw(reals(-1.0, 1.0)), normal * np.sign(normal[2]))
    along = draw(vectors(3, 20.0))
    foot = along - (along @ ground.normal - ground.offset_m) * ground.normal
    height = draw(reals(0.2, 5.0))
    return HalfBall(foot + height * ground.normal, height + draw(reals(0.1, 100.0)), ground)


@st.composite
def balls_with_inner_points(draw: st.DrawFn) -> tuple[HalfBall, np.ndarray]:
    ball = draw(half_balls())
    away, height = draw(units(3)), float(ball.centre_ego @ ball.ground.normal - ball.ground.offset_m)
    descent = -float(away @ ball.ground.normal)
    reach = min(ball.radius_m, height / descent) if descent > 0 else ball.radius_m
    return ball, ball.centre_ego + draw(reals(0.0, 0.99)) * reach * away
