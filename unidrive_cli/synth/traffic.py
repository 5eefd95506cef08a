"""Who moves and stands in a town: the ego car first, then whoever fits in without touching anybody."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from unidrive_cli.geometry.arrays import Bool, Float, lengths
from unidrive_cli.synth.actors import ActorModel, make_actor
from unidrive_cli.synth.streets import (
    HALF_ROAD_M,
    JUNCTION_M,
    LANE_M,
    PARKING_M,
    PAVEMENT_M,
    TURN_SAFETY_MPS2,
    Line,
    Street,
    StreetPlan,
)
from unidrive_cli.synth.terrain import Terrain
from unidrive_cli.synth.town import CROSSING_M, KERB_M, Town

EGO_LENGTH_M, EGO_WIDTH_M, EGO_HEIGHT_M = 4.084, 1.730, 1.562
EGO_CENTRE_M = 1.3
"""From the ego origin (rear axle) to the middle of the car."""
NEIGHBOURHOOD_M = 95.0
"""Distance from the ego car's way within which traffic is put."""
_STEP_S = 0.1
_BEFORE_S, _AFTER_S = 1.0, 1.0
_GAP_ACROSS_M, _GAP_ALONG_M = 0.25, 0.7
_MODELS = {"car": 16, "bus": 3, "truck": 5, "motorcycle": 3, "bicycle": 4, "pedestrian": 14}
_MOVES_MPS = 0.2


@dataclass(frozen=True, eq=False)
class Track:
    """Where somebody is over time: along a line, at a known place at each time.

    Attributes:
        line: the way.
        times_s: (n,) seconds since the scene's first key frame.
        along_m: (n,) how far along the line at those times.
        floor_m: height of what it stands on over the road.
    """

    line: Line
    times_s: Float
    along_m: Float
    floor_m: float

    def xy_heading(self, seconds: Float) -> tuple[Float, Float]:
        """Places (..., 2) and headings (...) in radians at some times (...)."""
        along = np.interp(seconds, self.times_s, self.along_m)
        return self.line.at(along), self.line.heading_at(along)

    def speed_mps(self, seconds: float) -> float:
        """Speed at a time."""
        before, after = np.interp([seconds - 0.1, seconds + 0.1], self.times_s, self.along_m)
        return float(after - before) / 0.2


@dataclass(frozen=True, eq=False)
class Actor:
    """Somebody with a body and a track.

    Attributes:
        parked: it stands for good, at the kerb or on the pavement.
        rider: a two-wheeler with somebody on it.
    """

    model: ActorModel
    track: Track
    parked: bool = False
    rider: bool = True

    def attribute(self, seconds: float) -> str:
        """nuScenes' attribute at a time."""
        moves = self.track.speed_mps(seconds) > _MOVES_MPS
        if self.model.kind == "pedestrian":
            return "pedestrian.moving" if moves else "pedestrian.standing"
        if self.model.kind in ("bicycle", "motorcycle"):
            return "cycle.with_rider" if self.rider else "cycle.without_rider"
        return "vehicle.moving" if moves else "vehicle.parked" if self.parked else "vehicle.stopped"


@dataclass(frozen=True, eq=False)
class Traffic:
    """The ego car's track (its rear axle) and everybody else."""

    ego: Track
    actors: tuple[Actor, ...]


def make_traffic(rng: np.random.Generator, town: Town, ego: Track) -> Traffic:
    """Fills the neighbourhood of the ego car's way; nobody ever touches anybody, nor a post or a trunk."""
    crowd = _Crowd(rng, town, ego)
    for candidates in (
        _leaders,
        _drivers,
        _parked,
        _waiting,
        _cyclists,
        _walkers,
        _crossers,
        _standers,
        _parked_cycles,
    ):
        for actor in candidates(crowd):
            crowd.admit(actor)
    return Traffic(ego, tuple(crowd.actors))


def ego_track(rng: np.random.Generator, plan: StreetPlan, seconds: float) -> Track:
    """A drive of some seconds through the middle of the town, in its lane."""
    cruise = float(rng.uniform(5.5, 11.0))
    inner = [n for n in range(len(plan.junctions)) if len(plan.streets_at(n)) >= 3]
    distance = lengths(plan.junctions - plan.side_m / 2)
    nearest = sorted(inner, key=lambda n: float(distance[n]))[:9]
    start = int(rng.choice(nearest))
    street = plan.streets_at(start)[int(rng.integers(len(plan.streets_at(start))))]
    second = street.end if street.start == start else street.start
    if len(plan.streets_at(second)) < 2:
        start, second = second, start
    needed = cruise * (seconds + _BEFORE_S + _AFTER_S) + 30
    line = plan.way(plan.wander(rng, start, second, needed + 40))
    return _driven(line, float(rng.uniform(2, 20)), cruise, times_of(seconds))


def times_of(seconds: float) -> Float:
    """The times at which tracks are known, a little before and after a scene of some seconds."""
    times: Float = np.arange(-_BEFORE_S, seconds + _AFTER_S + _STEP_S, _STEP_S)
    return times


def _driven(line: Line, start_m: float, cruise_mps: float, times_s: Float, floor_m: float = 0.0) -> Track:
    """A drive along a line at cruising speed, slower in bends, with gentle braking before them."""
    bends = np.maximum(np.abs(line.curvature_per_m), 1e-6)
    limit = np.minimum(cruise_mps, np.sqrt(TURN_SAFETY_MPS2 / bends))
    steps = np.diff(line.along_m)
    squared = np.square(limit)
    for index in range(len(steps) - 1, -1, -1):
        squared[index] = min(squared[index], squared[index + 1] + 2 * 1.8 * steps[index])
    for index in range(len(steps)):
        squared[index + 1] = min(squared[index + 1], squared[index] + 2 * 1.5 * steps[index])
    speed = np.sqrt(squared)
    clock = np.append(0.0, np.cumsum(steps / np.maximum((speed[:-1] + speed[1:]) / 2, 0.1)))
    begin = np.interp(start_m, line.along_m, clock)
    along = np.interp(begin + times_s - times_s[0], clock, line.along_m)
    return Track(line, times_s, along, floor_m)


def _standing(place: Float, heading_rad: float, times_s: Float, floor_m: float) -> Track:
    ahead = np.array([np.cos(heading_rad), np.sin(heading_rad)])
    line = Line(np.array([place - ahead, place, place + ahead]))
    return Track(line, times_s, np.full(len(times_s), 1.0), floor_m)


@dataclass(eq=False)
class _Crowd:
    """Everybody admitted so far, as rectangles over time."""

    rng: np.random.Generator
    town: Town
    ego: Track
    actors: list[Actor] = field(default_factory=list)
    _middles: list[Float] = field(default_factory=list)
    _headings: list[Float] = field(default_factory=list)
    _halves: list[Float] = field(default_factory=list)
    _models: dict[tuple[str, bool, bool], list[ActorModel]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        place, heading = self.ego.xy_heading(self.times_s)
        middle = place + EGO_CENTRE_M * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        self._add(middle, heading, np.array([EGO_LENGTH_M / 2 + 1.0, EGO_WIDTH_M / 2 + 0.35]))

    @property
    def times_s(self) -> Float:
        return self.ego.times_s

    @cached_property
    def ego_way(self) -> Float:
        """(n, 2) places along the ego car's way."""
        return self.ego.line.at(np.arange(self.ego.along_m[0] - 20, self.ego.along_m[-1] + 60, 5.0))

    def near(self, place: Float) -> bool:
        """Whether a place is in the neighbourhood of the ego car's way."""
        return float(lengths(self.ego_way - place).min()) < NEIGHBOURHOOD_M

    @cached_property
    def streets(self) -> list[Street]:
        """The streets of the neighbourhood that are long enough for lanes."""
        return [
            street
            for street in self.town.plan.streets
            if street.middle.length_m > 2 * JUNCTION_M + 12
            and self.near(street.middle.at(np.array(street.middle.length_m / 2)))
        ]

    def model(self, kind: str, *, rider: bool = True, walking: bool = True) -> ActorModel:
        """One of a few models of a kind, made when first wanted."""
        known = self._models.setdefault((kind, rider, walking), [])
        if len(known) < _MODELS[kind]:
            known.append(make_actor(kind, self.rng, rider=rider, walking=walking))
            return known[-1]
        return known[int(self.rng.integers(len(known)))]

    def admit(self, actor: Actor) -> None:
        """Takes somebody in, if there is room for them at all times."""
        middle, heading = actor.track.xy_heading(self.times_s)
        width, length, _ = actor.model.size_wlh_m
        parked = actor.parked or float(np.ptp(actor.track.along_m)) == 0.0
        gap = 0.1 if parked else _GAP_ALONG_M
        half = np.array([length / 2 + gap, width / 2 + (0.05 if parked else _GAP_ACROSS_M)])
        if self._collides(middle, heading, half) or self._hits_post(middle, heading, half):
            return
        self._add(middle, heading, half)
        self.actors.append(actor)

    def _add(self, middle: Float, heading: Float, half: Float) -> None:
        self._middles.append(middle)
        self._headings.append(heading)
        self._halves.append(half)

    def _collides(self, middle: Float, heading: Float, half: Float) -> bool:
        reach = np.array([float(lengths(other)) for other in self._halves]) + float(lengths(half))
        apart = np.stack(self._middles) - middle
        close = (apart**2).sum(axis=-1) < (reach**2)[:, None]
        for other in np.flatnonzero(close.any(axis=1)):
            at = close[other]
            boxes = (
                (middle[at], heading[at], half),
                (self._middles[other][at], self._headings[other][at], self._halves[other]),
            )
            if overlap(*boxes).any():
                return True
        return False

    def _hits_post(self, middle: Float, heading: Float, half: Float) -> bool:
        posts = self.town.obstacles
        if not len(posts):
            return False
        near = posts[lengths(posts[:, :2] - middle.mean(axis=0)) < np.ptp(middle, axis=0).max() + lengths(half) + 2]
        offset = near[:, None, :2] - middle
        ahead, left = (np.stack(pair, axis=-1) for pair in _axes(heading))
        outside = np.stack([np.abs((offset * ahead).sum(-1)), np.abs((offset * left).sum(-1))], axis=-1) - half
        apart = lengths(np.maximum(outside, 0.0))
        return bool((apart < near[:, 2:]).any())


def _axes(heading_rad: Float) -> tuple[tuple[Float, Float], tuple[Float, Float]]:
    cos, sin = np.cos(heading_rad), np.sin(heading_rad)
    return (cos, sin), (-sin, cos)


def overlap(a: tuple[Float, Float, Float], b: tuple[Float, Float, Float]) -> Bool:
    """Where two moving rectangles overlap, by their separating axes.

    Args:
        a, b: centres (n, 2), headings (n,), and half length and half width (2,).

    Returns:
        (n,).
    """
    apart = b[0] - a[0]
    separated = np.zeros(len(apart), dtype=bool)
    axes_a, axes_b = ([np.stack(axis, axis=-1) for axis in _axes(heading)] for heading in (a[1], b[1]))
    for axis in (*axes_a, *axes_b):
        reach = sum(
            (
                half[side] * np.abs((own[side] * axis).sum(-1))
                for half, own in ((a[2], axes_a), (b[2], axes_b))
                for side in (0, 1)
            ),
            np.zeros(len(apart)),
        )
        separated |= np.abs((apart * axis).sum(-1)) >= reach
    return ~separated


def _leaders(crowd: _Crowd) -> Iterator[Actor]:
    """Who drives ahead of and behind the ego car, on its way: the same drive, earlier and later."""
    rng, ego = crowd.rng, crowd.ego
    for gap_s in (rng.uniform(1.6, 3.0), rng.uniform(4.0, 6.5), -rng.uniform(1.6, 3.5), -rng.uniform(4.5, 7.0)):
        if rng.random() < 0.25:
            continue
        kind = str(rng.choice(["car", "car", "car", "car", "truck", "bus", "motorcycle"]))
        along = np.interp(ego.times_s + gap_s, ego.times_s, ego.along_m)
        mean_mps = float(np.ptp(ego.along_m) / np.ptp(ego.times_s))
        beyond = ego.times_s + gap_s
        along = along + mean_mps * (np.maximum(beyond - ego.times_s[-1], 0) + np.minimum(beyond - ego.times_s[0], 0))
        if along.min() > 0 and along.max() < ego.line.length_m:
            yield Actor(crowd.model(kind), Track(ego.line, ego.times_s, along, 0.0))


def _drivers(crowd: _Crowd) -> Iterator[Actor]:
    """Vehicles that drive about."""
    rng, plan = crowd.rng, crowd.town.plan
    kinds = ["car"] * 11 + ["truck"] * 3 + ["bus"] * 3 + ["motorcycle"] * 3
    for _ in range(46):
        street = crowd.streets[int(rng.integers(len(crowd.streets)))]
        start, second = (street.start, street.end) if rng.random() < 0.5 else (street.end, street.start)
        kind = str(rng.choice(kinds))
        cruise = float(rng.uniform(5.0, 11.5)) * (0.85 if kind in ("truck", "bus") else 1.0)
        needed = cruise * float(np.ptp(crowd.times_s)) + 20
        if len(plan.streets_at(second)) < 2:
            continue
        line = plan.way(plan.wander(rng, start, second, needed + 110))
        track = _driven(line, float(rng.uniform(0, max(1.0, line.length_m - needed))), cruise, crowd.times_s)
        if track.along_m[-1] < line.length_m - 1:
            yield Actor(crowd.model(kind), track)


def _parked(crowd: _Crowd) -> Iterator[Actor]:
    """Vehicles at both kerbs."""
    rng = crowd.rng
    for street in crowd.streets:
        start, end = street.open_m
        fullness = rng.uniform(0.35, 0.8)
        for side in (1, -1):
            edge = street.middle.beside(side * (LANE_M + PARKING_M / 2))
            along = start + 3.0
            while along < end - 4:
                kind = str(rng.choice(["car"] * 14 + ["truck"]))
                free = rng.random() > fullness or not crowd.near(edge.at(np.array(along)))
                model = None if free else crowd.model(kind)
                length = 5.5 if model is None else model.size_wlh_m[1]
                place = edge.at(np.array(along + length / 2)) + rng.normal(0, 0.06, 2)
                heading = float(edge.heading_at(np.array(along + length / 2))) + float(rng.normal(0, 0.015))
                if model is not None and along + length < end:
                    heading += np.pi * (side > 0)
                    yield Actor(model, _standing(place, heading, crowd.times_s, 0.0), parked=True)
                along += length + rng.uniform(0.8, 2.2)


def _waiting(crowd: _Crowd) -> Iterator[Actor]:
    """Vehicles that wait at a stop line, one behind the other."""
    rng = crowd.rng
    for street in crowd.streets:
        for junction in (street.start, street.end):
            if rng.random() > 0.3:
                continue
            lane = crowd.town.plan.lane(street, street.end if junction == street.start else street.start)
            along = lane.length_m - 0.8
            for _ in range(int(rng.integers(1, 4))):
                model = crowd.model(str(rng.choice(["car"] * 8 + ["truck", "bus", "motorcycle"])))
                middle = along - model.size_wlh_m[1] / 2
                if middle < 4:
                    break
                place, heading = lane.at(np.array(middle)), float(lane.heading_at(np.array(middle)))
                yield Actor(model, _standing(place, heading, crowd.times_s, 0.0))
                along -= model.size_wlh_m[1] + rng.uniform(1.5, 3)


def _cyclists(crowd: _Crowd) -> Iterator[Actor]:
    """Bicycles at the right of the lanes, and on the ego car's own streets more often."""
    rng, plan = crowd.rng, crowd.town.plan
    for _ in range(26):
        street = crowd.streets[int(rng.integers(len(crowd.streets)))]
        start, second = (street.start, street.end) if rng.random() < 0.5 else (street.end, street.start)
        if len(plan.streets_at(second)) < 2:
            continue
        cruise = float(rng.uniform(3.2, 5.8))
        needed = cruise * float(np.ptp(crowd.times_s)) + 10
        line = plan.way(plan.wander(rng, start, second, needed + 60), LANE_M - 0.55)
        track = _driven(line, float(rng.uniform(0, max(1.0, line.length_m - needed))), cruise, crowd.times_s)
        if track.along_m[-1] < line.length_m - 1:
            yield Actor(crowd.model("bicycle"), track)


def _pavement(street: Street, side: int, across_m: float) -> Line:
    start, end = street.open_m
    return street.middle.part(start - 1, end + 1).beside(side * (HALF_ROAD_M + across_m))


def _walkers(crowd: _Crowd) -> Iterator[Actor]:
    """People who walk along the pavements, some in pairs."""
    rng = crowd.rng
    for _ in range(80):
        street = crowd.streets[int(rng.integers(len(crowd.streets)))]
        line = _pavement(street, int(rng.choice([1, -1])), float(rng.uniform(1.5, PAVEMENT_M - 0.45)))
        line = line if rng.random() < 0.5 else line.reversed()
        speed = float(rng.uniform(0.7, 1.7))
        seconds = float(np.ptp(crowd.times_s))
        along = rng.uniform(0, max(0.5, line.length_m - speed * seconds)) + speed * (
            crowd.times_s - crowd.times_s[0]
        )
        if along[-1] < line.length_m:
            yield Actor(crowd.model("pedestrian"), Track(line, crowd.times_s, along, KERB_M))
            if rng.random() < 0.3:
                beside = line.beside(0.75)
                shifted = along * beside.length_m / line.length_m
                yield Actor(crowd.model("pedestrian"), Track(beside, crowd.times_s, shifted, KERB_M))


def _crossers(crowd: _Crowd) -> Iterator[Actor]:
    """People on zebra crossings; they are on the road's level all the way from kerb to kerb."""
    rng = crowd.rng
    for _ in range(40):
        street = crowd.streets[int(rng.integers(len(crowd.streets)))]
        junction = street.start if rng.random() < 0.5 else street.end
        if len(crowd.town.plan.streets_at(junction)) < 2:
            continue
        line = street.from_junction(junction)
        at = float(rng.uniform(CROSSING_M[0] + 0.5, CROSSING_M[1] - 0.5))
        ends = np.array([line.beside(side * (HALF_ROAD_M - 0.4)).at(np.array(at)) for side in (1, -1)])
        way = Line(ends if rng.random() < 0.5 else ends[::-1])
        speed = float(rng.uniform(0.9, 1.6))
        walk = speed * (crowd.times_s - rng.uniform(-8, max(1.0, crowd.times_s[-1])))
        if walk.max() <= way.length_m + speed * 3:
            yield Actor(crowd.model("pedestrian"), Track(way, crowd.times_s, np.clip(walk, 0, way.length_m), 0.0))


def _standers(crowd: _Crowd) -> Iterator[Actor]:
    """People who stand about, alone and in groups that face each other."""
    rng = crowd.rng
    for _ in range(22):
        street = crowd.streets[int(rng.integers(len(crowd.streets)))]
        line = _pavement(street, int(rng.choice([1, -1])), float(rng.uniform(1.4, PAVEMENT_M - 0.6)))
        place = line.at(np.array(rng.uniform(1, line.length_m - 1)))
        for turn in np.arange(int(rng.choice([1, 1, 2, 3]))) * 2.1 + rng.uniform(0, 6):
            at = place + 0.6 * np.array([np.cos(turn), np.sin(turn)])
            model = crowd.model("pedestrian", walking=False)
            yield Actor(model, _standing(at, turn + np.pi, crowd.times_s, KERB_M))


def _parked_cycles(crowd: _Crowd) -> Iterator[Actor]:
    """Bicycles and motorcycles without riders: on the pavement, and at the kerb."""
    rng = crowd.rng
    for _ in range(26):
        kind = str(rng.choice(["bicycle", "motorcycle"]))
        street = crowd.streets[int(rng.integers(len(crowd.streets)))]
        side = int(rng.choice([1, -1]))
        bicycle = kind == "bicycle"
        line = _pavement(street, side, 0.9 if bicycle else -1.0)
        along = np.array(rng.uniform(3, line.length_m - 3))
        heading = float(line.heading_at(along)) + (0.0 if bicycle else side * np.pi / 2) + float(rng.normal(0, 0.1))
        track = _standing(line.at(along), heading, crowd.times_s, KERB_M if bicycle else 0.0)
        yield Actor(crowd.model(kind, rider=False), track, parked=True, rider=False)


def pose_over_ground(track: Track, terrain: Terrain, seconds: float, above_m: float) -> Float:
    """`global_from_body` (4, 4) of a body whose origin is `above_m` over what it stands on."""
    place, heading = track.xy_heading(np.array(seconds))
    pose: Float = terrain.pose_on(place, float(heading), track.floor_m + above_m)
    return pose
