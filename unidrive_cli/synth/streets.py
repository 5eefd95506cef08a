"""A seeded street plan: a bent grid of streets, their lanes, and ways along them. Plane geometry, metres."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from unidrive_cli.geometry.arrays import Float, lengths

LANE_M = 3.5
PARKING_M = 2.3
HALF_ROAD_M = LANE_M + PARKING_M
PAVEMENT_M = 3.4
JUNCTION_M = 14.0
"""From a junction's middle to where lanes, markings and parking end."""
TURN_SAFETY_MPS2 = 1.8
"""Sideways acceleration that drivers accept in bends."""
_SPACING_M = 92.0
_MARGIN_M = 46.0
_STEP_M = 1.0


class Line:
    """A curve in the plane, sampled densely, with its length as parameter.

    Attributes:
        points: (n, 2) metres.
        along_m: (n,) length up to each point.
    """

    def __init__(self, points: Float) -> None:
        steps = lengths(np.diff(points, axis=0))
        keep = np.append(True, steps > 1e-6)
        self.points = points[keep]
        self.along_m = np.append(0.0, np.cumsum(steps[steps > 1e-6]))

    @property
    def length_m(self) -> float:
        """Length of the whole curve."""
        return float(self.along_m[-1])

    def at(self, along_m: Float) -> Float:
        """Points (..., 2) at some lengths (...); beyond the ends the end points."""
        return np.stack([np.interp(along_m, self.along_m, self.points[:, axis]) for axis in (0, 1)], axis=-1)

    @cached_property
    def headings_rad(self) -> Float:
        """(n,) direction of travel at each point, unwrapped."""
        steps = np.gradient(self.points, axis=0)
        return np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))

    def heading_at(self, along_m: Float) -> Float:
        """Direction of travel (...) in radians at some lengths (...)."""
        heading: Float = np.interp(along_m, self.along_m, self.headings_rad)
        return heading

    @cached_property
    def curvature_per_m(self) -> Float:
        """(n,) curvature at each point, smoothed over a few metres."""
        if len(self.points) < 8:
            return np.zeros(len(self.points))
        bent = np.gradient(self.headings_rad, self.along_m)
        kernel = np.ones(5) / 5
        smooth: Float = np.convolve(np.pad(bent, 2, mode="edge"), kernel, mode="valid")
        return smooth

    def beside(self, left_m: float) -> Line:
        """The parallel curve so many metres to the left (negative: to the right)."""
        normal = np.stack([-np.sin(self.headings_rad), np.cos(self.headings_rad)], axis=-1)
        return Line(self.points + left_m * normal)

    def part(self, start_m: float, end_m: float) -> Line:
        """The curve between two lengths."""
        inner = self.along_m[(self.along_m > start_m) & (self.along_m < end_m)]
        return Line(self.at(np.concatenate([[start_m], inner, [end_m]])))

    def reversed(self) -> Line:
        """The same curve, the other way."""
        return Line(self.points[::-1].copy())


@dataclass(frozen=True, eq=False)
class Street:
    """One street between two junctions.

    Attributes:
        start, end: indices of its junctions.
        middle: its middle line, from junction to junction.
    """

    start: int
    end: int
    middle: Line

    @property
    def open_m(self) -> tuple[float, float]:
        """The part of the middle line that is no junction."""
        return JUNCTION_M, self.middle.length_m - JUNCTION_M

    def from_junction(self, junction: int) -> Line:
        """The middle line, beginning at one of its two junctions."""
        return self.middle if junction == self.start else self.middle.reversed()


@dataclass(frozen=True, eq=False)
class StreetPlan:
    """Junctions and streets; the plan lies in [0, side] x [0, side].

    Attributes:
        junctions: (n, 2) metres.
        streets: each joins two junctions.
        side_m: length of the square's side.
    """

    junctions: Float
    streets: tuple[Street, ...]
    side_m: float

    def streets_at(self, junction: int) -> list[Street]:
        """The streets that meet at a junction."""
        return [street for street in self.streets if junction in (street.start, street.end)]

    def lane(self, street: Street, start: int, right_m: float = LANE_M / 2) -> Line:
        """A lane's middle line, driven from junction `start`, between the two junctions' areas."""
        line = street.from_junction(start)
        return line.part(JUNCTION_M, line.length_m - JUNCTION_M).beside(-right_m)

    def way(self, junctions: Sequence[int], right_m: float = LANE_M / 2) -> Line:
        """The way of a vehicle along a sequence of junctions, turns included.

        Args:
            junctions: at least two; neighbours are joined by streets.
            right_m: distance to the right of the street's middle.
        """
        pieces: list[Float] = []
        for start, end in itertools.pairwise(junctions):
            street = next(street for street in self.streets_at(start) if end in (street.start, street.end))
            lane = self.lane(street, start, right_m)
            if pieces:
                pieces.append(_turn(pieces[-1], lane.points))
            pieces.append(lane.points)
        line = Line(np.concatenate(pieces))
        return Line(line.at(np.arange(0.0, line.length_m, _STEP_M / 2)))

    def wander(self, rng: np.random.Generator, start: int, second: int, length_m: float) -> list[int]:
        """Junctions of a random drive of at least some length that never turns round."""
        route = [start, second]
        left_m = length_m
        while left_m > 0:
            here, before = route[-1], route[-2]
            ahead = [
                street.end if street.start == here else street.start
                for street in self.streets_at(here)
                if before not in (street.start, street.end)
            ]
            if not ahead:
                break
            inward = [j for j in ahead if len(self.streets_at(j)) > 1]
            following = int(rng.choice(inward or ahead))
            left_m -= float(np.linalg.norm(self.junctions[following] - self.junctions[here]))
            route.append(following)
        return route


def _turn(arriving: Float, leaving: Float) -> Float:
    """A smooth curve from the end of one lane to the start of the next: a cubic Bezier along both."""
    start, end = arriving[-1], leaving[0]
    into = arriving[-1] - arriving[-2]
    out = leaving[1] - leaving[0]
    into, out = into / np.linalg.norm(into), out / np.linalg.norm(out)
    reach = 0.45 * float(np.linalg.norm(end - start))
    return _bezier(start, start + reach * into, end - reach * out, end, 24)[1:-1]


def _bezier(a: Float, b: Float, c: Float, d: Float, count: int) -> Float:
    t = np.linspace(0, 1, count)[:, None]
    curve: Float = (1 - t) ** 3 * a + 3 * (1 - t) ** 2 * t * b + 3 * (1 - t) * t**2 * c + t**3 * d
    return curve


def make_street_plan(rng: np.random.Generator, blocks: int) -> StreetPlan:
    """A square of `blocks` x `blocks` city blocks between bent streets; some streets are left out.

    Streets lead on beyond the outermost junctions and end at the square's border.
    """
    count = blocks + 1
    side_m = 2 * _MARGIN_M + blocks * _SPACING_M
    grid = np.stack(np.meshgrid(np.arange(count), np.arange(count), indexing="ij"), axis=-1).reshape(-1, 2)
    junctions = _MARGIN_M + _SPACING_M * grid + rng.uniform(-9, 9, (count * count, 2))
    number = {(int(i), int(j)): n for n, (i, j) in enumerate(grid)}
    pairs = [
        (number[cell], number[neighbour])
        for cell in number
        for neighbour in ((cell[0] + 1, cell[1]), (cell[0], cell[1] + 1))
        if neighbour in number
    ]
    pairs = _thinned(rng, pairs, len(junctions))
    places = list(junctions)
    for index, (i, j) in enumerate(grid):  # streets that leave the square
        outward = np.array([(i == count - 1) * 1.0 - (i == 0), (j == count - 1) * 1.0 - (j == 0)])
        for direction in (outward * [1, 0], outward * [0, 1]):
            if direction.any() and rng.random() < 0.6:
                places.append(junctions[index] + direction * (_MARGIN_M - 2 + rng.uniform(0, 2)))
                pairs.append((index, len(places) - 1))
    points = np.array(places)
    arms: dict[int, list[int]] = {n: [] for n in range(len(points))}
    for a, b in pairs:
        arms[a].append(b)
        arms[b].append(a)
    streets = tuple(Street(a, b, _street_line(rng, points, a, b)) for a, b in pairs)
    return StreetPlan(points, streets, side_m)


def _thinned(rng: np.random.Generator, pairs: list[tuple[int, int]], count: int) -> list[tuple[int, int]]:
    """Leaves out about one street in eight, where both junctions keep three others."""
    degree = np.bincount(np.array(pairs).ravel(), minlength=count)
    kept = []
    for a, b in pairs:
        if rng.random() < 0.18 and degree[a] > 3 and degree[b] > 3:
            degree[[a, b]] -= 1
        else:
            kept.append((a, b))
    return kept


def _street_line(rng: np.random.Generator, points: Float, a: int, b: int) -> Line:
    """A bent street: straight for a while at both junctions, with a bow or an S between."""
    start, end = points[a], points[b]
    chord = end - start
    across = np.array([-chord[1], chord[0]]) / np.linalg.norm(chord)
    bends = rng.normal(0, 0.13, 2) * np.linalg.norm(chord)
    curve = _bezier(start, start + 0.4 * chord + bends[0] * across, end - 0.4 * chord + bends[1] * across, end, 240)
    line = Line(curve)
    return Line(line.at(np.append(np.arange(0.0, line.length_m, _STEP_M), line.length_m)))
