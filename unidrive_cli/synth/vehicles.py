"""Cars, buses and trucks. Built standing on z = 0, the middle of their length at x = 0."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from unidrive_cli.geometry.arrays import Float
from unidrive_cli.synth.mesh import Mesh, merged
from unidrive_cli.synth.shapes import (
    BLACK,
    CHROME,
    DARK_PLASTIC,
    GLASS,
    GLASS_GLOSS,
    LAMP_RED,
    LAMP_WHITE,
    PAINT_GLOSS,
    PLATE,
    Side,
    Solid,
    block,
    curve,
    loft,
    mirrored,
    number_plate,
    painted,
    patch,
    rectangle,
    road_wheel,
    shaded,
    tube,
)

Size = tuple[float, float, float]
Knots = tuple[tuple[float, float], ...]

PAINTS: tuple[tuple[float, tuple[float, float, float]], ...] = (  # share on the road, linear RGB
    (0.22, (0.72, 0.73, 0.72)),
    (0.18, (0.014, 0.015, 0.017)),
    (0.17, (0.11, 0.115, 0.12)),
    (0.13, (0.40, 0.41, 0.42)),
    (0.06, (0.02, 0.06, 0.22)),
    (0.05, (0.012, 0.022, 0.06)),
    (0.08, (0.38, 0.014, 0.016)),
    (0.03, (0.02, 0.09, 0.05)),
    (0.03, (0.16, 0.10, 0.06)),
    (0.02, (0.62, 0.24, 0.02)),
    (0.03, (0.16, 0.34, 0.48)),
)


@dataclass(frozen=True)
class CarLines:
    """One look of a car. Lengths along the car are shares of its length from the front; heights shares of its own.

    Attributes:
        weight: share of cars with this look.
        width_m, length_m, height_m: ranges.
        deck: top of the lower body, along the car.
        belt: lower edge of the windows, along the car.
        cabin: silhouette of the cabin, along the car.
        pillars: where posts divide the side windows.
        axles: where the wheels are.
        wheel_m: radius of a wheel.
        sill_m: height of the lower edge of the body.
        roof: half the roof's width as a share of the body's.
        glazed_to: how far back the side windows go.
        cladding: dark plastic around the lower edge.
    """

    weight: float
    width_m: tuple[float, float]
    length_m: tuple[float, float]
    height_m: tuple[float, float]
    deck: Knots
    belt: Knots
    cabin: Knots
    pillars: tuple[float, ...]
    axles: tuple[float, float]
    wheel_m: float
    sill_m: float
    roof: float
    glazed_to: float
    cladding: bool = False


CARS: dict[str, CarLines] = {
    "hatchback": CarLines(
        weight=0.30,
        width_m=(1.74, 1.98),
        length_m=(3.9, 4.4),
        height_m=(1.44, 1.56),
        deck=(
            (0, 0.43),
            (0.02, 0.49),
            (0.07, 0.535),
            (0.15, 0.58),
            (0.25, 0.635),
            (0.5, 0.62),
            (0.94, 0.66),
            (1, 0.62),
        ),
        belt=((0, 0.39), (0.03, 0.44), (0.1, 0.49), (0.25, 0.585), (0.6, 0.60), (0.97, 0.63), (1, 0.58)),
        cabin=(
            (0.235, 0.60),
            (0.30, 0.77),
            (0.40, 0.945),
            (0.52, 1.0),
            (0.70, 0.985),
            (0.88, 0.93),
            (0.945, 0.75),
            (0.975, 0.60),
        ),
        pillars=(0.535, 0.755),
        axles=(0.195, 0.815),
        wheel_m=0.31,
        sill_m=0.19,
        roof=0.71,
        glazed_to=0.875,
    ),
    "saloon": CarLines(
        weight=0.24,
        width_m=(1.85, 2.06),
        length_m=(4.5, 5.0),
        height_m=(1.42, 1.50),
        deck=(
            (0, 0.42),
            (0.02, 0.48),
            (0.06, 0.53),
            (0.15, 0.585),
            (0.27, 0.645),
            (0.5, 0.62),
            (0.84, 0.70),
            (0.97, 0.69),
            (1, 0.64),
        ),
        belt=(
            (0, 0.38),
            (0.03, 0.44),
            (0.1, 0.50),
            (0.27, 0.60),
            (0.6, 0.61),
            (0.85, 0.645),
            (0.97, 0.63),
            (1, 0.58),
        ),
        cabin=(
            (0.25, 0.62),
            (0.32, 0.78),
            (0.42, 0.94),
            (0.54, 1.0),
            (0.66, 0.975),
            (0.74, 0.90),
            (0.82, 0.76),
            (0.87, 0.66),
        ),
        pillars=(0.53, 0.705),
        axles=(0.19, 0.79),
        wheel_m=0.325,
        sill_m=0.18,
        roof=0.69,
        glazed_to=0.80,
    ),
    "estate": CarLines(
        weight=0.16,
        width_m=(1.84, 2.06),
        length_m=(4.5, 4.95),
        height_m=(1.46, 1.54),
        deck=(
            (0, 0.42),
            (0.02, 0.48),
            (0.06, 0.53),
            (0.15, 0.575),
            (0.27, 0.635),
            (0.5, 0.61),
            (0.95, 0.64),
            (1, 0.60),
        ),
        belt=((0, 0.38), (0.03, 0.44), (0.1, 0.49), (0.27, 0.585), (0.6, 0.595), (0.97, 0.615), (1, 0.57)),
        cabin=(
            (0.25, 0.60),
            (0.32, 0.77),
            (0.42, 0.94),
            (0.53, 0.995),
            (0.72, 1.0),
            (0.90, 0.95),
            (0.955, 0.78),
            (0.985, 0.60),
        ),
        pillars=(0.53, 0.72),
        axles=(0.19, 0.785),
        wheel_m=0.325,
        sill_m=0.18,
        roof=0.70,
        glazed_to=0.925,
    ),
    "suv": CarLines(
        weight=0.22,
        width_m=(1.92, 2.10),
        length_m=(4.3, 4.9),
        height_m=(1.62, 1.80),
        deck=(
            (0, 0.45),
            (0.015, 0.53),
            (0.05, 0.575),
            (0.15, 0.61),
            (0.25, 0.645),
            (0.5, 0.62),
            (0.95, 0.65),
            (1, 0.60),
        ),
        belt=((0, 0.42), (0.03, 0.50), (0.1, 0.545), (0.25, 0.60), (0.6, 0.605), (0.97, 0.63), (1, 0.58)),
        cabin=(
            (0.235, 0.61),
            (0.29, 0.77),
            (0.375, 0.94),
            (0.50, 0.995),
            (0.72, 1.0),
            (0.91, 0.955),
            (0.955, 0.78),
            (0.985, 0.61),
        ),
        pillars=(0.52, 0.735),
        axles=(0.195, 0.80),
        wheel_m=0.365,
        sill_m=0.25,
        roof=0.735,
        glazed_to=0.915,
        cladding=True,
    ),
    "van": CarLines(
        weight=0.08,
        width_m=(1.98, 2.10),
        length_m=(4.6, 5.0),
        height_m=(1.82, 1.90),
        deck=(
            (0, 0.40),
            (0.015, 0.46),
            (0.05, 0.50),
            (0.12, 0.545),
            (0.18, 0.575),
            (0.5, 0.55),
            (0.97, 0.56),
            (1, 0.53),
        ),
        belt=((0, 0.36), (0.03, 0.43), (0.1, 0.48), (0.18, 0.525), (0.6, 0.525), (0.985, 0.53), (1, 0.51)),
        cabin=(
            (0.135, 0.53),
            (0.19, 0.70),
            (0.275, 0.92),
            (0.38, 0.985),
            (0.70, 1.0),
            (0.955, 0.97),
            (0.98, 0.80),
            (0.993, 0.53),
        ),
        pillars=(0.43, 0.68),
        axles=(0.175, 0.80),
        wheel_m=0.335,
        sill_m=0.21,
        roof=0.80,
        glazed_to=0.955,
    ),
}


@dataclass(frozen=True, eq=False)
class Trim:
    """What two cars of one look may differ in; colours are linear RGB."""

    paint: Float
    rim: Float
    spokes: int
    panelled: bool
    glass_roof: bool
    rails: bool


def between(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    """A number from a range."""
    return float(rng.uniform(*limits))


def choose(rng: np.random.Generator, weighted: Sequence[tuple[float, Any]]) -> Any:
    """One of some things, each with its weight."""
    weights = np.array([weight for weight, _ in weighted])
    return weighted[int(rng.choice(len(weighted), p=weights / weights.sum()))][1]


def paint(rng: np.random.Generator) -> Float:
    """A paint as seen on the road, linear RGB."""
    colour = np.array(choose(rng, PAINTS)) * rng.uniform(0.85, 1.15) * rng.uniform(0.96, 1.04, 3)
    result: Float = np.clip(colour, 0, 0.8)
    return result


def make_car(rng: np.random.Generator) -> tuple[str, Size, Mesh]:
    """Look, size and mesh of a car."""
    look = str(choose(rng, [(lines.weight, name) for name, lines in CARS.items()]))
    lines = CARS[look]
    size = between(rng, lines.width_m), between(rng, lines.length_m), between(rng, lines.height_m)
    colour = paint(rng)
    rims = [(0.6, (0.35, 0.35, 0.36)), (0.25, (0.12, 0.12, 0.13)), (0.15, (0.03, 0.03, 0.03))]
    trim = Trim(
        paint=colour,
        rim=np.array(choose(rng, rims)),
        spokes=int(rng.choice([5, 5, 3])),
        panelled=look == "van" and bool(rng.random() < 0.6),
        glass_roof=look != "van" and bool(rng.random() < 0.15),
        rails=look in ("estate", "suv") and bool(rng.random() < 0.6),
    )
    return look, size, shaded(_car(lines, size, trim), fade_m=0.7, darkest=0.55)


def _car(lines: CarLines, size: Size, trim: Trim) -> Mesh:
    width, length, height = size
    colour, panelled = trim.paint, trim.panelled
    half = width / 2 - 0.085  # the mirrors take the rest

    def share(x: Any) -> Float:
        result: Float = 0.5 - np.asarray(x, dtype=np.float64) / length
        return result

    def ahead(at: Any) -> Any:
        return (0.5 - np.asarray(at, dtype=np.float64)) * length

    def half_width(x: Any) -> Float:
        front, rear = (np.clip(1 - end / 0.95, 0, 1) for end in (length / 2 - x, length / 2 + x))
        result: Float = half * (1 - 0.17 * front**2.6 - 0.13 * rear**2.8)
        return result

    body = _lower_body(lines, size, colour, half_width, share, ahead)
    cabin = _cabin(lines, size, trim, half_width, ahead)
    tall, sill = height, lines.sill_m
    parts = [body, cabin]
    inner = half - 0.26
    belly = block((-length * 0.42, -inner, sill - 0.02), (length * 0.42, inner, 2.15 * lines.wheel_m))
    parts.append(painted(belly, BLACK, gloss=0))
    radius, tyre = lines.wheel_m, 0.215
    for axle in lines.axles:
        x = float(ahead(axle))
        left = road_wheel(
            (x, float(half_width(np.array(x))) - 0.035 - tyre / 2, radius),
            radius,
            tyre,
            trim.rim,
            outward=1,
            spokes=trim.spokes,
        )
        parts += [left, mirrored(left)]

    def beltline(x: Any) -> Float:
        return curve(share(x), lines.belt) * tall

    # doors, handles, mirrors
    seams = [lines.cabin[0][0] + 0.075, *(lines.pillars[:1] if panelled else lines.pillars)]
    for at in seams:
        x = float(ahead(at))
        low, high = np.array([(x - 0.005, sill + 0.09), (x + 0.005, sill + 0.09)]), np.zeros((2, 2))
        high[:] = [(x - 0.005, float(beltline(x)) - 0.02), (x + 0.005, float(beltline(x)) - 0.02)]
        parts += [patch(body, side, low, high, 0.18 * colour, rows=4, gloss=0.02) for side in ("left", "right")]
    for at in lines.pillars[: 1 if panelled else 2]:
        x = float(ahead(at)) + 0.10
        z = float(beltline(x)) - 0.10
        for side in ("left", "right"):
            parts.append(rectangle(body, side, (x, z - 0.014), (x + 0.17, z + 0.014), 0.45 * colour, lift_m=0.018))
    at_mirror = float(ahead(lines.cabin[0][0] + 0.085))
    z = float(beltline(at_mirror)) + 0.085
    housing = block(
        (at_mirror - 0.06, half - 0.08, z - 0.065), (at_mirror + 0.07, width / 2, z + 0.075), bevel_m=0.035
    )
    mirror = painted(housing, colour, gloss=PAINT_GLOSS, crease_deg=60)
    parts += [mirror, mirrored(mirror)]
    if trim.rails:
        rail_y, rail = 0.9 * lines.roof * half, [lines.cabin[2][0] + 0.06, lines.cabin[-3][0] - 0.02]
        ends_x = ahead(np.array(rail))
        height_z = curve(np.array(rail), lines.cabin) * tall - 0.01
        bar = [(ends_x[0], rail_y, height_z[0] - 0.03), (ends_x[0] - 0.12, rail_y, tall + 0.015)]
        bar += [(ends_x[1] + 0.12, rail_y, tall + 0.012), (ends_x[1], rail_y, height_z[1] - 0.03)]
        roof_rail = painted(tube(bar, 0.017, 5), (0.08, 0.08, 0.085), gloss=0.15, crease_deg=80)
        parts += [roof_rail, mirrored(roof_rail)]
    parts += _car_ends(body, lines, tall, half, colour)
    return merged(parts)


def _lower_body(lines: CarLines, size: Size, colour: Float, half_width: Any, share: Any, ahead: Any) -> Mesh:
    """The body up to its belt, with wheel arches cut into its lower edge."""
    _, length, height = size
    arch = lines.wheel_m * 1.13
    steps = np.cos(np.linspace(0, np.pi, 8)) * arch
    ends = np.array([0.0, 0.025, 0.09, 0.22])
    stations = [length / 2 - ends, -length / 2 + ends, ahead(np.array([0.44, 0.57, 0.68]))]
    for axle in lines.axles:
        stations += [ahead(axle) + steps, ahead(axle) + np.array([arch + 0.006, -arch - 0.006])]
    x = np.sort(np.concatenate(stations))
    from_end = length / 2 - np.abs(x)
    lower = lines.sill_m + 0.07 * np.clip(1 - from_end / 0.45, 0, 1) ** 2
    opening = np.zeros_like(x)
    for axle in lines.axles:
        off = np.abs(x - ahead(axle))
        opening = np.where(off <= arch + 1e-6, lines.wheel_m + np.sqrt(np.clip(arch**2 - off**2, 0, None)), opening)
    lower = np.maximum(lower, opening)
    deck, belt = curve(share(x), lines.deck) * height, curve(share(x), lines.belt) * height
    deck = np.maximum(deck, belt + 0.02)
    wide = half_width(x)
    # half outline from the middle of the floor, up the side, to the middle of the deck
    trim = lower + 0.055
    rising = np.array([0.0, 0.34, 0.66, 0.88, 1.0])
    heights = np.column_stack([lower, trim[:, None] + (belt - trim)[:, None] * rising])
    relative = np.clip((heights - lines.sill_m) / (belt - lines.sill_m)[:, None], 0, 1)
    bulge = curve(relative, ((0.0, 0.955), (0.12, 0.982), (0.35, 0.988), (0.68, 1.0), (0.9, 0.985), (1.0, 0.955)))
    bulge[:, 0] -= 0.012
    sides = wide[:, None] * bulge
    over = np.array([0.965, 0.86, 0.5, 0.0])
    top_y = sides[:, -1:] * over
    rise = np.array([0.55, 0.82, 0.97, 1.0])
    top_z = belt[:, None] + (deck - belt)[:, None] * rise
    floor_y = np.column_stack([np.zeros_like(x), 0.80 * wide])
    y = np.column_stack([floor_y, sides, top_y])
    z = np.column_stack([lower, lower, heights, top_z])
    right = np.column_stack([np.arange(y.shape[1] - 2, 0, -1)]).ravel()
    ring_y, ring_z = np.column_stack([y, -y[:, right]]), np.column_stack([z, z[:, right]])
    sections = np.stack([np.repeat(x[:, None], ring_y.shape[1], axis=1), ring_y, ring_z], axis=-1)
    shape = loft(sections)
    points = ring_y.shape[1]
    column = np.tile(np.arange(points), 2 * (len(x) - 1))
    strip = np.minimum(column, points - 1 - column)  # 0 floor, 1 floor's edge, 2 the trim, 3 ... the sides
    colours = np.tile(colour, (len(shape.triangles), 1))
    colours[: len(strip)][strip <= 1] = BLACK
    if lines.cladding:
        colours[: len(strip)][strip == 2] = DARK_PLASTIC
    gloss = np.full(len(colours), PAINT_GLOSS)
    gloss[: len(strip)][strip <= 1] = 0
    start, end = ahead(lines.cabin[0][0]) - 0.30, ahead(lines.cabin[-1][0]) + 0.12
    hidden = np.zeros(len(colours), dtype=bool)  # under the cabin
    rows = np.tile(np.repeat((x[:-1] > end) & (x[1:] < start), points), 2)
    hidden[: len(strip)] = (strip >= 7) & rows
    shape = Solid(shape.positions_m, shape.triangles[~hidden])
    return painted(shape, colours[~hidden], gloss=gloss[~hidden], crease_deg=42)


def _cabin(lines: CarLines, size: Size, trim: Trim, half_width: Any, ahead: Any) -> Mesh:
    """All above the belt: pillars and roof in paint, windows between them in glass."""
    _, length, height = size
    start, end = lines.cabin[0][0], lines.cabin[-1][0]
    header, rear = lines.cabin[2][0], lines.cabin[-3][0]
    fine = np.linspace(rear, end, 60)
    shelf = np.maximum(curve(fine, lines.deck), curve(fine, lines.belt)) * height + 0.05
    rear_end = float(fine[np.argmax(curve(fine, lines.cabin) * height < shelf)])
    first, post = start + 0.02, 0.009
    knots = np.array([at for at, _ in lines.cabin])
    cuts = [at + side * post for at in lines.pillars for side in (-1, 1)]
    middles = [0.5 * (knots[0] + knots[1]), 0.5 * (knots[1] + knots[2]), 0.5 * (knots[-2] + knots[-3])]
    at = np.unique(np.round(np.concatenate([knots, middles, cuts, [first, lines.glazed_to, rear_end]]), 5))
    at = at[np.concatenate([[True], np.diff(at) > 0.003])]
    x = ahead(at)
    centre = curve(at, lines.cabin) * height
    foot = curve(at, lines.belt) * height - 0.03
    roof_half, base_half = lines.roof * float(half_width(np.zeros(1))[0]), half_width(x) * 0.945

    def side_y(z: Any) -> Any:
        up = np.clip((z - foot) / (height * 0.96 - foot), 0, 1.2)
        return base_half + (np.minimum(roof_half, base_half) - base_half) * up**1.25

    # sideways the glass sweeps back: the silhouette is met earlier at the front, later at the rear
    forward = np.clip((0.5 * (start + end) - at) / (0.5 * (end - start)), -1, 1)
    bow = np.where(forward > 0, 0.15, 0.05) * forward / length

    def top_z(across: float) -> Any:
        return curve(np.clip(at - bow * across**2, 0, 1), lines.cabin) * height - 0.025 * across**2

    edge = np.maximum(top_z(0.95), foot + 0.01)
    rail = np.minimum(0.085, 0.5 * (edge - foot))
    glass_foot = np.minimum(foot + 0.05, edge - rail)
    z_side = [foot, glass_foot, 0.5 * (glass_foot + edge - rail), edge - rail]
    y_side = [side_y(z) for z in z_side]
    y_edge = side_y(edge)
    y_top = [y_edge - 0.14 * rail, y_edge - 0.7 * rail, 0.55 * y_edge, 0 * y_edge]
    z_top = [
        edge - 0.38 * rail,
        np.maximum(top_z(0.88), edge),
        np.maximum(top_z(0.55), edge),
        np.maximum(centre, edge),
    ]
    y = np.column_stack([0 * x, *y_side, *y_top])
    z = np.column_stack([foot - 0.02, *z_side, *z_top])
    right = np.arange(y.shape[1] - 2, 0, -1)
    ring_y, ring_z = np.column_stack([y, -y[:, right]]), np.column_stack([z, z[:, right]])
    sections = np.stack([np.repeat(x[:, None], ring_y.shape[1], axis=1), ring_y, ring_z], axis=-1)
    shape = loft(sections)
    points = ring_y.shape[1]
    column = np.arange(points)[None, :]
    strip = np.minimum(
        column, points - 1 - column
    )  # 1 the seal, 2 and 3 side windows, 4 and 5 pillars, 6 and 7 the top
    where = (0.5 * (at[1:] + at[:-1]))[:, None]
    inside = (where > first) & (where < lines.glazed_to)
    posts = np.any([np.abs(where - pillar) < post for pillar in lines.pillars], axis=0)
    sides = ((strip == 2) | (strip == 3)) & inside
    if trim.panelled:
        sides &= where < lines.pillars[0]
    black = (sides & posts) | ((strip == 1) & inside & ((where < lines.pillars[0]) | (not trim.panelled)))
    top = strip >= 6
    glass = (
        (sides & ~posts)
        | (top & (where < header))
        | (top & (where > rear) & (where < rear_end) & (not trim.panelled))
    )
    if trim.glass_roof:
        glass |= top & (where > header + 0.03) & (where < rear - 0.02)
    colours = np.tile(trim.paint, (len(shape.triangles), 1))
    gloss = np.full(len(colours), PAINT_GLOSS)
    for mask, tone, shine in ((black, BLACK, 0.06), (glass, GLASS, GLASS_GLOSS)):
        both = np.flatnonzero(np.tile(np.broadcast_to(mask, (len(at) - 1, points)).ravel(), 2))
        colours[both], gloss[both] = tone, shine
    return painted(shape, colours, gloss=gloss, crease_deg=48)


def _car_ends(body: Mesh, lines: CarLines, tall: float, half: float, colour: Float) -> list[Mesh]:
    """Lamps, grille, plates and bumpers' openings."""
    nose, tail, floor = lines.deck[1][1] * tall, lines.belt[-1][1] * tall, lines.sill_m + 0.07
    length = 2 * float(body.positions_m[:, 0].max())
    parts = []
    for sign in (1, -1):
        y = np.array([0.47, 0.68, 0.875]) * half * sign
        low = np.column_stack([y, nose - np.array([0.075, 0.085, 0.07])])
        high = np.column_stack([y, nose + np.array([-0.02, 0.012, 0.02])])
        parts.append(patch(body, "front", low, high, (0.05, 0.055, 0.06), rows=2, gloss=0.3))
        y = np.array([0.50, 0.68, 0.85]) * half * sign
        low, high = np.column_stack([y, low[:, 1] + 0.018]), np.column_stack([y, high[:, 1] - 0.014])
        parts.append(patch(body, "front", low, high, LAMP_WHITE, rows=1, gloss=0.25, lift_m=0.011))
        y = np.array([0.52, 0.70, 0.89]) * half * sign
        low = np.column_stack([y, tail - np.array([0.10, 0.13, 0.145])])
        high = np.column_stack([y, tail + np.array([-0.015, 0.0, 0.005])])
        parts.append(patch(body, "rear", low, high, LAMP_RED, rows=2, gloss=0.2, lift_m=0.008))
        clear = np.column_stack([y[:2] * (1.1, 1.06), tail - np.array([0.085, 0.10])])
        parts.append(
            patch(
                body, "rear", clear, clear + np.array((0, 0.03)), (0.7, 0.6, 0.55), rows=1, gloss=0.2, lift_m=0.014
            )
        )
        inner, outer = sorted((0.60 * half * sign, 0.72 * half * sign))
        parts.append(
            rectangle(
                body,
                "front",
                (inner, floor + 0.06),
                (outer, floor + 0.12),
                LAMP_WHITE,
                columns=1,
                gloss=0.2,
                lift_m=0.014,
            )
        )
        parts.append(
            rectangle(body, "rear", (inner, floor + 0.12), (outer, floor + 0.16), LAMP_RED, columns=1, lift_m=0.010)
        )
    for side in ("left", "right"):
        x = -length / 2 + np.array([0.05, 0.13, 0.27])
        low = np.column_stack([x, tail - np.array([0.14, 0.12, 0.055])])
        high = np.column_stack([x, tail + np.array([0.0, -0.005, -0.02])])
        parts.append(patch(body, side, low, high, LAMP_RED, rows=1, gloss=0.2, lift_m=0.008))
        x = length / 2 - np.array([0.36, 0.2, 0.1])
        low = np.column_stack([x, nose + np.array([0.0, -0.05, -0.065])])
        high = np.column_stack([x, nose + np.array([0.022, 0.012, -0.005])])
        parts.append(patch(body, side, low, high, (0.45, 0.46, 0.48), rows=1, gloss=0.3, lift_m=0.008))
    wide = 0.42 * half

    def strip(side: Side, reach: float, low: float, high: float, tone: Any, gloss: float, lift: float) -> None:
        at = (-reach, low), (reach, high)
        parts.append(rectangle(body, side, *at, tone, columns=4, gloss=gloss, lift_m=lift))

    strip("front", wide, nose - 0.115, nose - 0.02, BLACK, 0.06, 0.006)
    strip("front", wide, nose - 0.062, nose - 0.05, CHROME, 0.3, 0.012)
    strip("front", 0.74 * half, floor + 0.03, floor + 0.15, BLACK, 0.02, 0.006)
    strip("rear", 0.78 * half, floor + 0.0, floor + 0.085, DARK_PLASTIC, 0.02, 0.006)
    strip("rear", 0.80 * half, tail - 0.285, tail - 0.277, 0.2 * colour, 0.02, 0.006)
    strip("rear", 0.30 * half, tail - 0.095, tail - 0.083, CHROME, 0.3, 0.010)
    parts.append(number_plate(body, "front", (0, floor + 0.125), PLATE))
    parts.append(number_plate(body, "rear", (0, tail - 0.18), PLATE))
    return parts
