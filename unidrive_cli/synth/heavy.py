"""Buses and trucks. Built standing on z = 0, the middle of their length at x = 0."""

from __future__ import annotations

from typing import Any

import numpy as np

from unidrive_cli.geometry.arrays import Float
from unidrive_cli.synth.mesh import Mesh, merged
from unidrive_cli.synth.shapes import (
    BLACK,
    DARK_PLASTIC,
    GLASS,
    GLASS_GLOSS,
    LAMP_AMBER,
    LAMP_RED,
    LAMP_WHITE,
    PAINT_GLOSS,
    PLATE,
    STEEL,
    Side,
    block,
    loft,
    mirrored,
    number_plate,
    painted,
    patch,
    rectangle,
    road_wheel,
    rod,
    rounded_rectangle,
    shaded,
    tube,
)
from unidrive_cli.synth.vehicles import Size, between, choose, paint

LIVERIES: tuple[tuple[float, tuple[tuple[float, float, float], tuple[float, float, float]]], ...] = (
    (0.2, ((0.70, 0.71, 0.70), (0.38, 0.02, 0.02))),
    (0.2, ((0.42, 0.02, 0.02), (0.70, 0.70, 0.68))),
    (0.15, ((0.62, 0.42, 0.03), (0.62, 0.42, 0.03))),
    (0.15, ((0.70, 0.71, 0.70), (0.02, 0.07, 0.28))),
    (0.15, ((0.03, 0.22, 0.12), (0.60, 0.62, 0.58))),
    (0.15, ((0.30, 0.33, 0.36), (0.02, 0.20, 0.34))),
)
LETTERS = ((-0.84, -0.62), (-0.40, -0.26), (-0.22, -0.06), (0.0, 0.14), (0.2, 0.42), (0.48, 0.84))


def hull(
    start_m: float,
    end_m: float,
    half_m: float,
    low_m: float,
    high_m: float,
    colour: Any,
    *,
    rake_m: float = 0.0,
    edge_m: float = 0.14,
    nose_m: float = 0.16,
    gloss: float = PAINT_GLOSS,
) -> Mesh:
    """A long body with round edges; its front leans back towards the roof by the rake."""
    tail = min(0.06, nose_m)
    stations = [(start_m, tail), (start_m + 0.35 * tail, 0.3 * tail), (start_m + 1.2 * tail, 0.0)]
    stations += [(end_m - 1.2 * nose_m, 0.0), (end_m - 0.35 * nose_m, 0.3 * nose_m), (end_m, nose_m)]
    middle_z, half_z = (low_m + high_m) / 2, (high_m - low_m) / 2
    sections = []
    for x, inset in stations:
        ring = rounded_rectangle(half_m - inset, half_z - 0.6 * inset, edge_m, 2)
        lean = (
            rake_m * np.clip((ring[:, 1] + half_z) / (2 * half_z), 0, 1) ** 2 if x > (start_m + end_m) / 2 else 0.0
        )
        sections.append(np.column_stack([x - lean + 0 * ring[:, 0], ring[:, 0], ring[:, 1] + middle_z]))
    return painted(loft(sections), colour, gloss=gloss, crease_deg=45)


def arch_and_wheels(
    body: Mesh, x: float, half_m: float, radius_m: float, low_m: float, rim: Any, *, width_m: float = 0.28
) -> list[Mesh]:
    """Two wheels of one axle, in dark wheel arches on both sides of a body."""
    turn = np.linspace(np.pi, 0, 9)
    arch = radius_m * 1.16
    high = np.column_stack([x + arch * np.cos(turn), np.maximum(radius_m + arch * np.sin(turn), low_m + 0.02)])
    low = np.column_stack([high[:, 0], np.full(9, low_m + 0.012)])
    parts = [patch(body, side, low, high, BLACK, rows=4, gloss=0.0, lift_m=0.01) for side in ("left", "right")]
    left = road_wheel(
        (x, half_m + 0.045 - width_m / 2, radius_m),
        radius_m,
        width_m,
        rim,
        outward=1,
        spokes=0,
        segments=16,
        dish=1.05,
    )
    return [*parts, left, mirrored(left)]


def make_bus(rng: np.random.Generator) -> tuple[str, Size, Mesh]:
    """Look, size and mesh of a bus."""
    coach = rng.random() < 0.4
    look = "coach" if coach else "city_bus"
    size = between(rng, (2.72, 2.9)), between(rng, (10.2, 12.5)), between(rng, (3.2, 3.5) if coach else (2.9, 3.25))
    main, second = (np.array(colour) * rng.uniform(0.85, 1.1) for colour in choose(rng, LIVERIES))
    return (
        look,
        size,
        shaded(_bus(size, coach, np.clip(main, 0, 0.8), np.clip(second, 0, 0.8)), fade_m=1.2, darkest=0.55),
    )


def _bus(size: Size, coach: bool, main: Float, second: Float) -> Mesh:
    width, length, height = size
    half, front, rear = width / 2 - 0.16, length / 2 - 0.12, -length / 2
    low = 0.30
    body = hull(rear, front, half, low, height - (0.0 if coach else 0.16), main, rake_m=0.45 if coach else 0.12)
    parts = [body]
    if not coach:
        pack = block(
            (-0.1 * length, -0.72 * half, height - 0.24), (0.28 * length, 0.72 * half, height), bevel_m=0.06
        )
        parts.append(painted(pack, 0.9 * main, gloss=0.05))
    parts.append(painted(block((rear + 0.3, -half + 0.35, 0.22), (front - 0.5, half - 0.35, 0.5)), BLACK, gloss=0))
    sill, top = (1.35, height - 0.42) if coach else (1.02, height - 0.55)
    nose = front - (0.75 if coach else 0.30)
    axles = (front - 2.65, rear + 3.1)
    both: tuple[Side, Side] = ("left", "right")
    for side in both:
        band = np.linspace(rear + 0.45, nose, 9)
        lower, upper = np.column_stack([band, 0 * band + sill]), np.column_stack([band, 0 * band + top])
        parts.append(patch(body, side, lower, upper, GLASS, rows=2, gloss=GLASS_GLOSS, lift_m=0.008))
        for x in np.arange(rear + 1.85, nose - 0.5, 1.45):
            post = (x - 0.03, sill), (x + 0.03, top)
            parts.append(rectangle(body, side, *post, BLACK, columns=1, gloss=0.05, lift_m=0.014))
        stripe = (rear + 0.2, 0.46), (front - 0.35, 0.72 if coach else 0.76)
        parts.append(rectangle(body, side, *stripe, second, columns=2, gloss=PAINT_GLOSS, lift_m=0.004))
    if coach:
        sweep = np.linspace(rear + 0.3, -0.1 * length, 6)
        rise = (sweep - sweep[0]) / (sweep[-1] - sweep[0])
        for side in both:
            lower = np.column_stack([sweep, 0.72 + 0.0 * sweep])
            upper = np.column_stack([sweep, 0.72 + (sill - 0.80) * (1 - rise) ** 1.5])
            parts.append(patch(body, side, lower, upper, second, rows=1, lift_m=0.005))
    doors = (front - 2.0,) if coach else (front - 1.65, -0.35, rear + 1.2)
    for at in doors:
        frame = (at, 0.46), (at + 1.15, top)
        parts.append(rectangle(body, "right", *frame, DARK_PLASTIC, columns=2, rows=2, gloss=0.08, lift_m=0.016))
        for leaf in (at + 0.05, at + 0.61):
            pane = (leaf, 0.53), (leaf + 0.49, top - 0.06)
            parts.append(rectangle(body, "right", *pane, GLASS, columns=1, rows=2, gloss=GLASS_GLOSS, lift_m=0.022))
    for x in axles:
        parts += arch_and_wheels(body, x, half, 0.48, low, (0.20, 0.20, 0.21))
    wide = 0.855 * half
    across = np.linspace(-1, 1, 7)
    crown = height - (0.34 if coach else 0.50)
    glass_low = np.column_stack([across * wide, (1.12 if coach else 0.95) + 0.04 * across**2])
    glass_high = np.column_stack([across * wide * 0.98, crown - 0.03 * across**2])
    parts.append(patch(body, "front", glass_low, glass_high, GLASS, rows=3, gloss=GLASS_GLOSS, lift_m=0.008))
    sign_low, sign_high = (-0.62 * half, crown - 0.30), (0.62 * half, crown - 0.06)
    parts.append(rectangle(body, "front", sign_low, sign_high, BLACK, columns=4, gloss=0.05, lift_m=0.016))
    for start, end in LETTERS:
        letter = (start * 0.6 * half, crown - 0.25), (end * 0.6 * half, crown - 0.11)
        parts.append(rectangle(body, "front", *letter, (0.85, 0.48, 0.06), columns=1, gloss=0, lift_m=0.024))
    parts.append(
        rectangle(body, "front", (-wide, 0.45), (wide, 0.57), DARK_PLASTIC, columns=4, gloss=0.03, lift_m=0.008)
    )
    rear_low, rear_high = (-0.78 * half, sill + 0.25), (0.78 * half, top)
    parts.append(
        rectangle(body, "rear", rear_low, rear_high, GLASS, columns=4, rows=2, gloss=GLASS_GLOSS, lift_m=0.008)
    )
    grille = (-0.6 * half, 0.55), (0.6 * half, 0.95)
    parts.append(rectangle(body, "rear", *grille, DARK_PLASTIC, columns=2, gloss=0.03, lift_m=0.008))
    for sign in (1, -1):
        lamp = sorted((sign * 0.55 * half, sign * 0.855 * half))
        parts.append(rectangle(body, "front", (lamp[0], 0.60), (lamp[1], 0.80), BLACK, gloss=0.1, lift_m=0.008))
        lamp = sorted((sign * 0.59 * half, sign * 0.83 * half))
        parts.append(
            rectangle(body, "front", (lamp[0], 0.63), (lamp[1], 0.77), LAMP_WHITE, gloss=0.25, lift_m=0.014)
        )
        edge = sorted((sign * 0.80 * half, sign * 0.92 * half))
        for z, tone in ((0.62, LAMP_RED), (0.86, LAMP_AMBER), (1.02, LAMP_RED)):
            parts.append(
                rectangle(body, "rear", (edge[0], z), (edge[1], z + 0.13), tone, columns=1, gloss=0.2, lift_m=0.014)
            )
    parts.append(number_plate(body, "front", (0, 0.66), PLATE))
    parts.append(number_plate(body, "rear", (0, 0.45), PLATE))
    arm = front - (0.42 if coach else 0.1)
    head = height - (0.5 if coach else 0.62)
    glass = block(
        (length / 2 - 0.16, width / 2 - 0.22, head - 0.55), (length / 2, width / 2, head - 0.12), bevel_m=0.04
    )
    reach = painted(rod((arm, half - 0.12, head), (length / 2 - 0.08, width / 2 - 0.1, head - 0.12), 0.03), BLACK)
    for piece in (painted(glass, BLACK, gloss=0.08), reach):
        parts += [piece, mirrored(piece)]
    return merged(parts)


def make_truck(rng: np.random.Generator) -> tuple[str, Size, Mesh]:
    """Look, size and mesh of a truck."""
    look = str(
        choose(
            rng, [(0.38, "box_truck"), (0.2, "curtain_truck"), (0.16, "tipper"), (0.12, "tanker"), (0.14, "flatbed")]
        )
    )
    tall = {"box_truck": (3.1, 3.6), "curtain_truck": (3.2, 3.6), "tipper": (2.75, 3.1), "tanker": (2.8, 3.2)}
    size = between(rng, (2.35, 2.6)), between(rng, (6.4, 10.0)), between(rng, tall.get(look, (2.65, 2.95)))
    cab = np.clip(paint(rng), 0.03, 0.75)
    load = np.array(
        choose(rng, [(0.4, (0.70, 0.71, 0.70)), (0.15, (0.03, 0.10, 0.34)), (0.15, (0.42, 0.06, 0.02))])
        if rng.random() < 0.7
        else choose(rng, [(1, (0.05, 0.24, 0.12)), (1, (0.62, 0.40, 0.04)), (1, (0.33, 0.34, 0.36))])
    ) * rng.uniform(0.9, 1.1)
    badge = paint(rng)
    return look, size, shaded(_truck(look, size, cab, np.clip(load, 0, 0.8), badge), fade_m=1.2, darkest=0.5)


def _truck(look: str, size: Size, colour: Float, load: Float, badge: Float) -> Mesh:
    width, length, height = size
    front, rear, half = length / 2, -length / 2, width / 2 - 0.14
    wheel = 0.48
    cab_rear = front - 1.95
    cab_top = min(height - (0.0 if look in ("tipper", "tanker", "flatbed") else 0.35), 2.95)
    cab = hull(cab_rear, front - 0.02, half - 0.02, 0.62, cab_top, colour, rake_m=0.22, edge_m=0.12, nose_m=0.12)
    parts = [cab]
    parts.append(painted(block((front - 1.9, -half + 0.2, 0.34), (front - 0.06, half - 0.2, 0.7)), BLACK, gloss=0))
    bumper = painted(block((front - 0.35, -half, 0.34), (front, half, 0.68), bevel_m=0.06), DARK_PLASTIC, gloss=0.05)
    parts.append(bumper)
    for side in (1, -1):
        parts.append(
            painted(
                block((rear + 0.05, side * 0.45 - 0.06, 0.66), (front - 0.5, side * 0.45 + 0.06, 0.92)), DARK_PLASTIC
            )
        )
    axles = [rear + 1.35] if length < 8.2 else [rear + 1.2, rear + 2.3]
    parts += arch_and_wheels(cab, front - 1.15, half - 0.02, wheel, 0.62, (0.35, 0.35, 0.36))
    for x in axles:
        left = road_wheel(
            (x, half - 0.24, wheel), wheel, 0.48, (0.25, 0.25, 0.26), outward=1, spokes=0, segments=16, dish=0.2
        )
        parts += [left, mirrored(left), painted(rod((x, -half + 0.3, wheel), (x, half - 0.3, wheel), 0.09), BLACK)]
    fender = painted(block((axles[-1] + 0.62, half - 0.34, 0.52), (axles[-1] + 0.66, half - 0.02, 1.0)), BLACK)
    parts += [fender, mirrored(fender)]
    under = axles[-1] + 0.75, cab_rear - 0.15
    if under[1] - under[0] > 0.7:
        guard = painted(block((under[0], half - 0.10, 0.50), (under[1], half - 0.04, 0.80)), STEEL, gloss=0.1)
        fuel = painted(
            tube([(under[1] - 0.75, half - 0.42, 0.68), (under[1] - 0.05, half - 0.42, 0.68)], 0.26, 10, tip=0.1),
            STEEL,
            gloss=0.12,
        )
        parts += [guard, mirrored(guard), fuel]
        battery = block((under[1] - 0.6, -half + 0.12, 0.5), (under[1] - 0.05, -half + 0.5, 0.95))
        parts.append(painted(battery, DARK_PLASTIC))
    parts += _cab_details(cab, bumper, front, half, width, cab_top, cab_rear)
    parts += _load(look, size, cab_rear - 0.12, half, load, badge, cab_top)
    frame = painted(block((rear + 0.02, -half + 0.12, 0.52), (rear + 0.10, half - 0.12, 0.66)), DARK_PLASTIC)
    parts.append(frame)
    board = painted(block((rear + 0.03, -half + 0.06, 0.70), (rear + 0.12, half - 0.06, 0.90)), BLACK)
    parts.append(board)
    parts.append(number_plate(board, "rear", (0, 0.80), PLATE))
    for sign in (1, -1):
        for start, tone in ((0.55, (0.5, 0.45, 0.4)), (0.68, LAMP_AMBER), (0.80, LAMP_RED)):
            lamp = sorted((sign * start * half, sign * (start + 0.11) * half))
            spot = (lamp[0], 0.73), (lamp[1], 0.87)
            parts.append(rectangle(board, "rear", *spot, tone, columns=1, gloss=0.2, lift_m=0.012))
    return merged(parts)


def _cab_details(
    cab: Mesh, bumper: Mesh, front: float, half: float, width: float, top: float, rear: float
) -> list[Mesh]:
    parts = []
    across = np.linspace(-1, 1, 7)
    sill = 1.42
    low = np.column_stack([across * 0.88 * half, sill + 0.03 * across**2])
    high = np.column_stack([across * 0.85 * half, min(top - 0.28, 2.45) - 0.02 * across**2])
    parts.append(patch(cab, "front", low, high, GLASS, rows=3, gloss=GLASS_GLOSS, lift_m=0.008))
    grille = (-0.62 * half, 0.80), (0.62 * half, 1.22)
    parts.append(rectangle(cab, "front", *grille, BLACK, columns=4, rows=1, gloss=0.06))
    for z in (0.90, 1.02, 1.14):
        bar = (-0.58 * half, z - 0.012), (0.58 * half, z + 0.012)
        parts.append(rectangle(cab, "front", *bar, STEEL, columns=2, gloss=0.2, lift_m=0.012))
    for sign in (1, -1):
        lamp = sorted((sign * 0.58 * half, sign * 0.90 * half))
        parts.append(
            rectangle(bumper, "front", (lamp[0], 0.45), (lamp[1], 0.60), LAMP_WHITE, gloss=0.35, lift_m=0.01)
        )
    parts.append(number_plate(bumper, "front", (0, 0.52), PLATE))
    both: tuple[Side, Side] = ("left", "right")
    for side in both:
        x = np.array([rear + 0.55, rear + 0.9, front - 0.42])
        window_low = np.column_stack([x, [sill + 0.02, sill, sill - 0.10]])
        window_high = np.column_stack([x - (0, 0, 0.16), np.full(3, min(top - 0.30, 2.42))])
        parts.append(patch(cab, side, window_low, window_high, GLASS, rows=2, gloss=GLASS_GLOSS, lift_m=0.008))
        for at in (rear + 0.47, front - 0.34):
            seam = (at - 0.008, 0.75), (at + 0.008, 1.40)
            parts.append(rectangle(cab, side, *seam, BLACK, columns=1, rows=1, gloss=0.02))
    glass = block((front - 0.36, width / 2 - 0.18, 1.55), (front - 0.20, width / 2, 2.15), bevel_m=0.035)
    arm = painted(rod((front - 0.4, half - 0.08, 2.2), (front - 0.28, width / 2 - 0.09, 2.13), 0.025), BLACK)
    for piece in (painted(glass, BLACK, gloss=0.08), arm):
        parts += [piece, mirrored(piece)]
    return parts


def _load(look: str, size: Size, end: float, half: float, load: Float, badge: Float, cab_top: float) -> list[Mesh]:
    width, length, height = size
    rear = -length / 2
    outer = min(half + 0.06, width / 2 - 0.02)
    both: tuple[Side, Side] = ("left", "right")
    parts = []
    if look in ("box_truck", "curtain_truck"):
        box = painted(block((rear, -outer, 0.95), (end, outer, height), bevel_m=0.03), load, gloss=0.06)
        parts.append(box)
        for side in both:
            if look == "box_truck":
                panel = (rear + 0.18 * length, 0.40 * height + 0.2), (rear + 0.52 * length, 0.40 * height + 0.85)
                parts.append(rectangle(box, side, *panel, badge, columns=1, gloss=0.06))
                inset = (rear + 0.2 * length, 0.40 * height + 0.4), (rear + 0.42 * length, 0.40 * height + 0.62)
                parts.append(
                    rectangle(
                        box, side, *inset, np.clip(1.0 - badge, 0.1, 0.75), columns=1, gloss=0.06, lift_m=0.012
                    )
                )
            else:
                for x in np.arange(rear + 0.5, end - 0.3, 0.62):
                    strap = (x, 1.0), (x + 0.05, 1.22)
                    parts.append(rectangle(box, side, *strap, BLACK, columns=1, gloss=0.02))
                    fold = (x, 1.22), (x + 0.03, height - 0.12)
                    parts.append(rectangle(box, side, *fold, 0.62 * load, columns=1, gloss=0.02))
            rail = (rear + 0.05, 0.97), (end - 0.05, 1.05)
            parts.append(rectangle(box, side, *rail, STEEL, columns=1, gloss=0.15, lift_m=0.008))
        parts.append(
            rectangle(box, "rear", (-0.012, 1.0), (0.012, height - 0.06), 0.25 * load, columns=1, gloss=0.02)
        )
        for y in (-0.55, -0.25, 0.25, 0.55):
            bolt = (y * outer - 0.015, 1.02), (y * outer + 0.015, height - 0.1)
            parts.append(rectangle(box, "rear", *bolt, STEEL, columns=1, gloss=0.25, lift_m=0.014))
        for sign in (1, -1):
            edge = sorted((sign * (outer - 0.08), sign * (outer - 0.03)))
            mark = (edge[0], 1.0), (edge[1], height - 0.08)
            parts.append(rectangle(box, "rear", *mark, (0.5, 0.03, 0.02), columns=1, gloss=0.1, lift_m=0.01))
        return parts
    deck = painted(block((rear, -outer, 0.93), (end, outer, 1.08)), DARK_PLASTIC)
    if look == "tanker":
        radius = min(outer - 0.03, (height - 0.16 - 1.0) / 2)
        middle = 1.0 + radius
        path = [(rear + at, 0, middle) for at in (0.08, 0.14, 0.35)] + [
            (end - at, 0, middle) for at in (0.35, 0.14, 0.08)
        ]
        radii = np.array([0.72, 0.9, 1.0, 1.0, 0.9, 0.72])[:, None] * np.array([outer - 0.03, radius])
        tank = painted(tube(path, radii, 20, tip=0.03), load, gloss=0.22)
        parts += [deck, tank]
        for x in np.linspace(rear + 0.9, end - 0.9, 3):
            hoop = painted(
                tube([(x - 0.03, 0, middle), (x + 0.03, 0, middle)], np.tile(radii[2] + 0.012, (2, 1)), 20),
                STEEL,
                gloss=0.2,
            )
            lid = painted(
                tube([(x, 0.0, height - 0.3), (x, 0.0, height)], 0.24, 10, side=(0, 1, 0)), STEEL, gloss=0.2
            )
            parts += [hoop, lid]
        for side in both:
            band = (rear + 0.6, middle - 0.12), (end - 0.6, middle + 0.12)
            parts.append(rectangle(tank, side, *band, badge, columns=3, gloss=0.15, lift_m=0.02))
        return parts
    if look == "tipper":
        wall = 0.07
        floor, rim = 1.05, height - 0.12
        parts.append(deck)
        parts.append(painted(block((rear, -outer, floor), (end, outer, floor + 0.1)), load, gloss=0.06))
        for y0, y1 in ((-outer, -outer + wall), (outer - wall, outer)):
            parts.append(painted(block((rear, y0, floor), (end, y1, rim)), load, gloss=0.06))
        parts.append(painted(block((rear, -outer, floor), (rear + wall, outer, rim - 0.1)), 0.9 * load, gloss=0.06))
        parts.append(painted(block((end - wall, -outer, floor), (end, outer, height)), load, gloss=0.06))
        for x in np.arange(rear + 0.1, end - 0.1, 0.75):
            rib = painted(block((x, outer - 0.02, floor), (x + 0.09, outer + 0.05, rim)), 0.85 * load, gloss=0.06)
            parts += [rib, mirrored(rib)]
        heap_x = np.linspace(rear + wall, end - wall, 6)
        top = rim - 0.25 + 0.22 * np.sin(np.linspace(0.3, np.pi - 0.3, 6)) * np.array([1, 0.8, 1.1, 0.9, 1.1, 1])
        sections = [
            [
                (x, -outer + wall, floor),
                (x, -outer + wall, rim - 0.3),
                (x, -0.3, z),
                (x, 0.35, z - 0.03),
                (x, outer - wall, rim - 0.3),
                (x, outer - wall, floor),
            ]
            for x, z in zip(heap_x, top, strict=True)
        ]
        parts.append(painted(loft(sections), (0.16, 0.12, 0.08), gloss=0.0, crease_deg=60))
        return parts
    parts.append(deck)
    for y0, y1 in ((-outer, -outer + 0.05), (outer - 0.05, outer)):
        parts.append(painted(block((rear, y0, 1.05), (end, y1, 1.48)), load, gloss=0.06))
    parts.append(painted(block((rear, -outer, 1.05), (rear + 0.05, outer, 1.48)), load, gloss=0.06))
    parts.append(painted(block((end - 0.06, -outer, 1.05), (end, outer, height - 0.35)), STEEL, gloss=0.1))
    for number, x in enumerate(np.arange(rear + 0.35, end - 1.25, 1.3)):
        tall = 1.08 + (0.9, 0.62, 1.05)[number % 3]
        tone = ((0.30, 0.20, 0.11), (0.20, 0.20, 0.21), (0.36, 0.25, 0.14))[number % 3]
        for y0, y1 in ((-outer + 0.12, -0.04), (0.04, outer - 0.12)):
            parts.append(painted(block((x, y0, 1.08), (x + 1.1, y1, tall), bevel_m=0.02), tone, gloss=0.0))
    return parts
