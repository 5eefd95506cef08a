"""Motorcycles and bicycles, ridden or parked. Built standing on z = 0, the middle between the wheels at x = 0."""

from __future__ import annotations

from typing import Any

import numpy as np

from unidrive_cli.geometry.arrays import Float
from unidrive_cli.synth.mesh import Mesh, merged
from unidrive_cli.synth.people import Outfit, Pose, draw_outfit, person
from unidrive_cli.synth.shapes import (
    BLACK,
    DARK_PLASTIC,
    GLASS,
    LAMP_AMBER,
    LAMP_RED,
    LAMP_WHITE,
    PAINT_GLOSS,
    PLATE,
    RUBBER,
    STEEL,
    ball,
    block,
    loft,
    mirrored,
    painted,
    revolved,
    rod,
    shaded,
    tube,
)
from unidrive_cli.synth.vehicles import Size, between, choose, paint


def hoop(
    x: float, radius_m: float, thick_m: float, colour: Any, segments: int, sides: int = 5, wide: float = 1.0
) -> Mesh:
    """A ring in the plane y = 0, standing on the ground: a tyre, or a rim inside one."""
    turn = 2 * np.pi * np.arange(segments) / segments
    around = 2 * np.pi * np.arange(sides) / sides
    far = (radius_m - thick_m) + thick_m * np.cos(around)
    points = np.stack(
        [
            np.cos(turn)[:, None] * far,
            np.repeat(wide * thick_m * np.sin(around)[None], segments, axis=0),
            np.sin(turn)[:, None] * far,
        ],
        axis=-1,
    )
    closed = np.concatenate([points, points[:1]])
    return painted(_open_tube(closed), colour, gloss=0.02, crease_deg=80)


def _open_tube(rings: Float) -> Any:
    """A loft without its two fans: the first and last ring are the same."""
    shape = loft(rings)
    count = 2 * (rings.shape[0] - 1) * rings.shape[1]
    return type(shape)(shape.positions_m, shape.triangles[:count])


def _standing(mesh: Mesh, x: float, z: float) -> Mesh:
    pose = np.eye(4)
    pose[:3, 3] = x, 0, z
    return mesh.placed(pose)


def make_bicycle(rng: np.random.Generator, *, rider: bool) -> tuple[str, Size, Mesh]:
    """Look, size and mesh of a bicycle."""
    look = str(choose(rng, [(0.5, "city_bicycle"), (0.3, "racing_bicycle"), (0.2, "mountain_bicycle")]))
    colour = paint(rng)
    outfit = draw_outfit(rng, riding=True, helmet="helmet" if rng.random() < 0.55 else "")
    size = between(rng, (0.55, 0.65)), between(rng, (1.66, 1.84)), 0.0
    turn = float(rng.uniform(0.2, 1.4))
    mesh, top = _bicycle(look, size, colour, outfit, rider, turn)
    return look, (size[0], size[1], top), shaded(mesh, fade_m=0.5, darkest=0.8)


def _bicycle(look: str, size: Size, colour: Float, outfit: Outfit, rider: bool, turn: float) -> tuple[Mesh, float]:
    width, length, _ = size
    r = 0.34
    rear, front = -length / 2 + r, length / 2 - r
    thick = {"city_bicycle": 0.021, "racing_bicycle": 0.015, "mountain_bicycle": 0.028}[look]
    parts = []
    for x in (rear, front):
        parts.append(_standing(hoop(x, r, thick, RUBBER, 22, 4), x, r))
        parts.append(_standing(hoop(x, r - 1.7 * thick, 0.012, STEEL, 18, 3), x, r))
        parts.append(painted(rod((x, -0.05, r), (x, 0.05, r), 0.022, 6), STEEL, gloss=0.2))
        for spoke in range(8):
            angle = np.pi * spoke / 4 + 0.2
            tip = np.array([np.cos(angle), 0, np.sin(angle)]) * (r - 2 * thick)
            side = 0.025 * (-1) ** spoke
            parts.append(
                painted(rod((x, side, r), tip + np.array((x, 0, r)), 0.0035, 3), STEEL, gloss=0.2, crease_deg=180)
            )
    sport = look != "city_bicycle"
    bottom = np.array([rear + 0.47, 0, 0.29])
    seat_top = np.array([rear + 0.29, 0, 0.82 if sport else 0.78])
    saddle = np.array([rear + 0.245, 0, 0.98 if sport else 0.95])
    head_low, head_top = np.array([front - 0.155, 0, 0.66]), np.array([front - 0.205, 0, 0.84])
    pipes = [
        (bottom, seat_top, 0.018),
        (seat_top, saddle, 0.013),
        (bottom, head_low, 0.021),
        (seat_top - (0, 0, 0.03) if sport else bottom + np.array((0, 0, 0.12)), head_top - (0, 0, 0.03), 0.018),
        (head_low - (-0.01, 0, 0.04), head_top, 0.021),
    ]
    for start, end, thick_m in pipes:
        parts.append(painted(rod(start, end, thick_m, 6), colour, gloss=PAINT_GLOSS, crease_deg=70))
    for sign in (1, -1):
        y = 0.045 * sign
        for start, end, thick_m in (
            (bottom + np.array((0, 0.3 * y, 0)), np.array((rear, y, r)), 0.010),
            (seat_top + np.array((0, 0.3 * y, -0.03)), np.array((rear, y, r)), 0.009),
            (head_low + np.array((0, 0.8 * y, -0.02)), np.array((front, y, r)), 0.012),
        ):
            parts.append(painted(rod(start, end, thick_m, 5), colour, gloss=PAINT_GLOSS, crease_deg=80))
    sections = [
        (saddle + np.array((at, 0, 0.015)), (wide, 0.022))
        for at, wide in ((-0.13, 0.06), (-0.09, 0.08), (0.0, 0.045), (0.13, 0.016))
    ]
    parts.append(
        painted(tube([s[0] for s in sections], np.array([s[1] for s in sections]), 8, tip=0.4), BLACK, gloss=0.04)
    )
    stem = head_top + np.array([0.02 if sport else -0.03, 0, 0.11 if sport else 0.19])
    parts.append(painted(rod(head_top, stem, 0.014, 6), STEEL, gloss=0.2))
    half = width / 2
    if look == "city_bicycle":
        bar = [
            stem,
            stem + np.array((0.04, 0.5 * half, 0.02)),
            stem + np.array((-0.02, half - 0.01, 0.0)),
            stem + np.array((-0.15, half - 0.01, -0.02)),
        ]
    elif look == "racing_bicycle":
        bar = [
            stem,
            stem + np.array((0.03, 0.6 * half, 0)),
            stem + np.array((0.10, half - 0.01, -0.01)),
            stem + np.array((0.09, half - 0.01, -0.12)),
        ]
    else:
        bar = [stem, stem + np.array((0.05, 0.4 * half, 0.03)), stem + np.array((0.02, half, 0.03))]
    hand = 0.5 * (np.asarray(bar[-1]) + np.asarray(bar[-2])) if len(bar) == 4 else np.asarray(bar[-1]) - (0, 0.06, 0)
    if look == "racing_bicycle":
        hand = np.asarray(bar[2]) + np.array((0.0, 0, 0.015))
    handle = painted(tube(bar, 0.013, 5, side=(0, 0, 1)), DARK_PLASTIC, gloss=0.05, crease_deg=80)
    parts += [handle, mirrored(handle)]
    # drive
    disc, _, _ = revolved([(0, -0.004), (0.095, -0.004), (0.095, 0.004), (0, 0.004)], 14, bottom - (0, 0.05, 0))
    parts.append(painted(disc, STEEL, gloss=0.15))
    crank = 0.17 * np.array([np.cos(turn), 0, -np.sin(turn)])
    pedals = np.stack([bottom + crank + (0, 0.115, 0), bottom - crank - (0, 0.115, 0)])
    for pedal, sign in zip(pedals, (1, -1), strict=True):
        parts.append(
            painted(
                rod(bottom + np.array((0, 0.06 * sign, 0)), pedal - (0, 0.05 * sign, 0), 0.011, 4), STEEL, gloss=0.2
            )
        )
        parts.append(painted(block(pedal - (0.05, 0.045, 0.01), pedal + np.array((0.05, 0.045, 0.01))), BLACK))
    for level in (0.048, -0.048):
        chain = block((rear, -0.054, r + level - 0.003), (bottom[0], -0.046, r + level + 0.003))
        parts.append(painted(chain, DARK_PLASTIC))
    if look == "city_bicycle":
        for x, first, last in ((rear, 0.25, 3.3), (front, 0.7, 3.0)):
            angles = np.linspace(first, last, 7)
            path = np.stack([x + (r + 0.025) * np.cos(angles), 0 * angles, r + (r + 0.025) * np.sin(angles)], axis=1)
            parts.append(painted(tube(path, np.array([(0.028, 0.005)] * 7), 4), BLACK, gloss=0.06, crease_deg=50))
        parts.append(painted(block((rear - 0.18, -0.065, 0.765), (rear + 0.24, 0.065, 0.785)), DARK_PLASTIC))
        basket = block((front - 0.02, -0.15, 0.80), (front + 0.22, 0.15, 0.99))
        if turn > 0.9:
            parts.append(painted(basket, (0.10, 0.065, 0.03)))
        for x in (rear - 0.14,):
            for sign in (1, -1):
                parts.append(painted(rod((x, 0.05 * sign, 0.77), (rear, 0.05 * sign, r), 0.006, 4), DARK_PLASTIC))
    lamp = ball(head_top + np.array((0.06, 0, 0.03)), (0.025, 0.03, 0.03), 4, 6)
    parts.append(painted(lamp, LAMP_WHITE, gloss=0.3))
    parts.append(
        painted(
            block(seat_top + np.array((-0.05, -0.02, 0.04)), seat_top + np.array((-0.02, 0.02, 0.08))),
            LAMP_RED,
            gloss=0.2,
        )
    )
    if not rider:
        mesh = merged(parts)
        return mesh, float(mesh.positions_m[:, 2].max())
    lean = {"city_bicycle": 0.20, "racing_bicycle": 0.62, "mountain_bicycle": 0.42}[look]
    h = outfit.height_m
    pelvis = saddle + np.array((0.02, 0, 0.085))
    neck = pelvis + 0.312 * h * np.array([np.sin(lean), 0, np.cos(lean)])
    sides = np.array([1.0, -1.0])
    hands = np.stack([hand, hand * (1, -1, 1)])
    ankles = pedals + np.column_stack([np.full(2, -0.06), -0.02 * sides, np.full(2, 0.10)])
    pose = _seated(outfit, pelvis, neck, hands, ankles, np.array([(1, 0, -0.12)] * 2))
    parts.append(person(outfit, pose, sides=8))
    mesh = merged(parts)
    return mesh, float(mesh.positions_m[:, 2].max())


def _seated(outfit: Outfit, pelvis: Float, neck: Float, hands: Float, ankles: Float, toes: Float) -> Pose:
    h = outfit.height_m
    sides = np.array([1.0, -1.0])[:, None]
    up = (neck - pelvis) / np.linalg.norm(neck - pelvis)
    hips = pelvis + sides * 0.05 * h * np.array([0, 1, 0])
    shoulders = neck - 0.042 * h * up + sides * (0.102 if outfit.woman else 0.114) * h * np.array([0, 1, 0])
    return Pose(pelvis, neck, hips, shoulders, hands, ankles, toes, np.array([1.0, 0, -0.08]))


def make_motorcycle(rng: np.random.Generator, *, rider: bool) -> tuple[str, Size, Mesh]:
    """Look, size and mesh of a motorcycle or a scooter."""
    look = str(choose(rng, [(0.4, "roadster"), (0.25, "sports"), (0.35, "scooter")]))
    colour = paint(rng)
    outfit = draw_outfit(rng, riding=True, helmet="full_helmet")
    size = between(rng, (0.70, 0.85)), between(rng, (1.9, 2.0) if look == "scooter" else (2.04, 2.2)), 0.0
    size = size[0], max(size[1], 2.0), 0.0
    mesh = _motorcycle(look, size, colour, outfit, rider)
    return look, (size[0], size[1], float(mesh.positions_m[:, 2].max())), shaded(mesh, fade_m=0.6, darkest=0.7)


def _motorcycle(look: str, size: Size, colour: Float, outfit: Outfit, rider: bool) -> Mesh:
    width, length, _ = size
    scooter = look == "scooter"
    r, thick = (0.26, 0.055) if scooter else (0.315, 0.065)
    rear, front = -length / 2 + r + (0.12 if scooter else 0.08), length / 2 - r
    parts = []
    for x in (rear, front):
        parts.append(_standing(hoop(x, r, thick, RUBBER, 18, 5, wide=1.15 if x == rear else 0.9), x, r))
        disc, row, segment = revolved(
            [
                (0, -0.05),
                (0.07, -0.04),
                (r - 1.7 * thick, -0.035),
                (r - 1.7 * thick, 0.035),
                (0.07, 0.04),
                (0, 0.05),
            ],
            12,
            (x, 0, r),
        )
        tones = np.tile(np.array((0.10, 0.10, 0.105)), (len(row), 1))
        tones[((row == 1) | (row == 3)) & (segment % 3 == 2)] = BLACK
        parts.append(painted(disc, tones, gloss=0.12))
    half = width / 2
    crown = np.array([front - 0.26, 0, 0.86])
    stem = crown + np.array((-0.06, 0, 0.12))
    for sign in (1, -1):
        y = 0.10 * sign
        parts.append(
            painted(rod((front, y, r), crown + np.array((0, y, 0)), 0.026, 6), STEEL, gloss=0.3, crease_deg=70)
        )
    if scooter:
        bar = [stem, stem + np.array((0.0, 0.5 * half, 0.05)), stem + np.array((-0.07, half, 0.04))]
    elif look == "sports":
        bar = [
            stem - (0, 0, 0.06),
            stem + np.array((0.02, 0.45 * half, -0.07)),
            stem + np.array((-0.12, half, -0.10)),
        ]
    else:
        bar = [stem, stem + np.array((0.02, 0.45 * half, 0.07)), stem + np.array((-0.10, half, 0.05))]
    handle = painted(tube(bar, [0.016, 0.016, 0.021], 6, side=(0, 0, 1)), BLACK, gloss=0.05, crease_deg=80)
    parts += [handle, mirrored(handle)]
    stalk = bar[1] + np.array([0.0, 0.04, 0])
    glass = stalk + np.array([0.02, 0.06, 0.17])
    parts_mirror = [
        painted(rod(stalk, glass, 0.008, 4), BLACK),
        painted(ball(glass, (0.022, 0.065, 0.042), 3, 8), BLACK, gloss=0.15, crease_deg=70),
    ]
    for piece in parts_mirror:
        parts += [piece, mirrored(piece)]
    if scooter:
        parts += _scooter_body(rear, front, colour, r)
        seat_x, seat_z, lean, foot = rear + 0.42, 0.80, 0.08, np.array([rear + 0.82, 0.13, 0.42])
    else:
        parts += _motorcycle_body(look, rear, front, colour, r, crown)
        seat_x, seat_z = rear + 0.43, 0.80
        lean = 0.62 if look == "sports" else 0.24
        foot = np.array([rear + (0.36 if look == "sports" else 0.56), 0.19, 0.42 if look == "sports" else 0.40])
        peg = painted(
            rod((foot[0] + 0.02, 0.08, foot[2] - 0.09), (foot[0] + 0.02, 0.24, foot[2] - 0.09), 0.016, 5), STEEL
        )
        parts += [peg, mirrored(peg)]
    tail_x = rear - 0.22
    parts.append(
        painted(block((tail_x, -0.07, 0.66), (tail_x + 0.05, 0.07, 0.73), bevel_m=0.012), LAMP_RED, gloss=0.25)
    )
    parts.append(painted(block((tail_x - 0.01, -0.09, 0.45), (tail_x + 0.0, 0.09, 0.60)), PLATE, gloss=0.05))
    parts.append(painted(rod((tail_x + 0.005, 0, 0.50), (rear + 0.05, 0, 0.68), 0.018, 5), BLACK))
    for sign in (1, -1):
        parts.append(
            painted(ball((tail_x + 0.04, 0.13 * sign, 0.68), (0.03, 0.03, 0.02), 3, 5), LAMP_AMBER, gloss=0.2)
        )
        parts.append(
            painted(
                ball(crown + np.array((0.06, 0.17 * sign, -0.03)), (0.03, 0.03, 0.02), 3, 5), LAMP_AMBER, gloss=0.2
            )
        )
    if rider:
        h = outfit.height_m
        pelvis = np.array([seat_x, 0, seat_z + 0.085])
        neck = pelvis + 0.312 * h * np.array([np.sin(lean), 0, np.cos(lean)])
        grip = np.asarray(bar[2]) - (0, 0.065, 0)
        sides = np.array([1.0, -1.0])[:, None]
        hands = np.stack([grip, grip * (1, -1, 1)]) + np.array((0, 0, 0.01))
        ankles = np.stack([foot, foot * (1, -1, 1)])
        parts.append(
            person(
                outfit,
                _seated(
                    outfit, pelvis, neck, hands, ankles + 0 * sides, np.array([(1, 0.1, -0.15), (1, -0.1, -0.15)])
                ),
                sides=8,
            )
        )
    return merged(parts)


def _motorcycle_body(look: str, rear: float, front: float, colour: Float, r: float, crown: Float) -> list[Mesh]:
    parts = []
    sports = look == "sports"
    tank = [
        (rear + 0.60, 0.76, 0.09, 0.05),
        (rear + 0.70, 0.82, 0.14, 0.11),
        (rear + 0.90, 0.86, 0.155, 0.13),
        (front - 0.36, 0.84, 0.10, 0.10),
    ]
    parts.append(
        painted(
            tube([(x, 0, z) for x, z, _, _ in tank], [(w, d) for _, _, w, d in tank], 10, tip=0.35),
            colour,
            gloss=0.15,
            crease_deg=70,
        )
    )
    up = 0.10 if sports else 0.0
    seat = [
        (rear - 0.20, 0.80 + up, 0.06, 0.03),
        (rear - 0.05, 0.80 + up, 0.11, 0.05),
        (rear + 0.20, 0.78 + 0.6 * up, 0.13, 0.05),
    ]
    seat += [(rear + 0.45, 0.75, 0.13, 0.05), (rear + 0.64, 0.77, 0.08, 0.05)]
    parts.append(
        painted(
            tube([(x, 0, z) for x, z, _, _ in seat], [(w, d) for _, _, w, d in seat], 8, tip=0.3),
            BLACK,
            gloss=0.04,
            crease_deg=70,
        )
    )
    cowl = [
        (rear - 0.22, 0.72 + up, 0.05, 0.03),
        (rear, 0.70 + up, 0.10, 0.06),
        (rear + 0.40, 0.68, 0.11, 0.07),
        (rear + 0.62, 0.68, 0.09, 0.07),
    ]
    parts.append(
        painted(
            tube([(x, 0, z) for x, z, _, _ in cowl], [(w, d) for _, _, w, d in cowl], 8, tip=0.3),
            colour,
            gloss=0.12,
            crease_deg=60,
        )
    )
    parts.append(
        painted(
            block((rear + 0.52, -0.17, 0.24), (front - 0.48, 0.17, 0.62), bevel_m=0.06),
            (0.06, 0.06, 0.062),
            gloss=0.12,
        )
    )
    parts.append(painted(rod((rear, 0.09, r), (rear + 0.6, 0.12, 0.42), 0.03, 6), STEEL, gloss=0.2))
    parts.append(painted(rod((rear, -0.09, r), (rear + 0.6, -0.12, 0.42), 0.03, 6), STEEL, gloss=0.2))
    pipe = [
        (front - 0.42, -0.06, 0.50),
        (front - 0.40, -0.12, 0.26),
        (rear + 0.55, -0.19, 0.24),
        (rear + 0.40, -0.20, 0.27),
        (rear - 0.10, -0.21, 0.40),
    ]
    parts.append(
        painted(
            tube(pipe, [0.025, 0.025, 0.028, 0.055, 0.055], 8, tip=0.1),
            (0.35, 0.35, 0.36),
            gloss=0.35,
            crease_deg=60,
        )
    )
    mud = np.linspace(0.5, 2.4, 6)
    path = np.stack([front + (r + 0.02) * np.cos(mud), 0 * mud, r + (r + 0.02) * np.sin(mud)], axis=1)
    parts.append(painted(tube(path, [(0.075, 0.014)] * 6, 6), colour, gloss=0.12, crease_deg=60))
    if sports:
        shell = [
            (front - 0.02, 0.72, 0.05, 0.05),
            (front - 0.10, 0.76, 0.13, 0.13),
            (front - 0.26, 0.76, 0.19, 0.20),
            (front - 0.45, 0.66, 0.20, 0.24),
        ]
        shell += [(rear + 0.75, 0.50, 0.20, 0.22), (rear + 0.55, 0.40, 0.15, 0.12)]
        parts.append(
            painted(
                tube([(x, 0, z) for x, z, _, _ in shell], [(w, d) for _, _, w, d in shell], 9, tip=0.2),
                colour,
                gloss=0.14,
                crease_deg=60,
            )
        )
        screen = [
            (front - 0.12, 0.86, 0.10, 0.04),
            (front - 0.25, 0.98, 0.12, 0.05),
            (front - 0.33, 1.06, 0.08, 0.02),
        ]
        parts.append(
            painted(
                tube([(x, 0, z) for x, z, _, _ in screen], [(w, d) for _, _, w, d in screen], 6, tip=0.2),
                GLASS,
                gloss=0.4,
                crease_deg=60,
            )
        )
        for sign in (1, -1):
            parts.append(
                painted(
                    ball((front - 0.075, 0.07 * sign, 0.76), (0.04, 0.045, 0.03), 3, 6),
                    LAMP_WHITE,
                    gloss=0.35,
                    crease_deg=70,
                )
            )
    else:
        lamp = [crown + np.array((at, 0, 0.02)) for at in (0.02, 0.10, 0.13)]
        parts.append(painted(tube(lamp, [0.05, 0.095, 0.095], 10), BLACK, gloss=0.15))
        parts.append(
            painted(
                tube([crown + np.array((0.132, 0, 0.02)), crown + np.array((0.145, 0, 0.02))], [0.085, 0.07], 10),
                LAMP_WHITE,
                gloss=0.35,
            )
        )
        parts.append(painted(ball(crown + np.array((0.0, 0, 0.16)), (0.04, 0.07, 0.05), 4, 8), BLACK, gloss=0.15))
    return parts


def _scooter_body(rear: float, front: float, colour: Float, r: float) -> list[Mesh]:
    def skin(rows: Any, tone: Any, gloss: float = PAINT_GLOSS, sides: int = 10) -> Mesh:
        path, radii = [(x, 0, z) for x, z, _, _ in rows], [(w, d) for _, _, w, d in rows]
        return painted(tube(path, radii, sides, tip=0.3), tone, gloss=gloss, crease_deg=65)

    tail = [
        (rear - 0.22, 0.66, 0.07, 0.06),
        (rear - 0.08, 0.62, 0.15, 0.13),
        (rear + 0.20, 0.58, 0.19, 0.19),
        (rear + 0.50, 0.54, 0.17, 0.22),
    ]
    tail += [(rear + 0.62, 0.52, 0.12, 0.2)]
    seat = [
        (rear - 0.16, 0.78, 0.08, 0.03),
        (rear, 0.79, 0.13, 0.05),
        (rear + 0.35, 0.77, 0.14, 0.05),
        (rear + 0.64, 0.75, 0.09, 0.05),
    ]
    shield = [
        (front - 0.10, 0.42, 0.13, 0.06),
        (front - 0.16, 0.56, 0.20, 0.075),
        (front - 0.22, 0.74, 0.19, 0.07),
        (front - 0.30, 0.93, 0.10, 0.05),
    ]
    parts = [skin(tail, colour), skin(seat, BLACK, 0.04, 8), skin(shield, colour)]
    parts.append(painted(block((rear + 0.50, -0.17, 0.27), (front - 0.16, 0.17, 0.34), bevel_m=0.02), DARK_PLASTIC))
    parts.append(
        painted(
            block((rear - 0.05, -0.13, 0.2), (rear + 0.5, -0.06, 0.40), bevel_m=0.03), (0.06, 0.06, 0.06), gloss=0.1
        )
    )
    mud = np.linspace(0.3, 2.6, 6)
    path = np.stack([front + (r + 0.025) * np.cos(mud), 0 * mud, r + (r + 0.025) * np.sin(mud)], axis=1)
    parts.append(painted(tube(path, [(0.09, 0.02)] * 6, 6), colour, gloss=0.12, crease_deg=60))
    parts.append(
        painted(ball((front - 0.225, 0, 0.94), (0.06, 0.13, 0.075), 5, 10), colour, gloss=0.12, crease_deg=70)
    )
    parts.append(
        painted(ball((front - 0.185, 0, 0.93), (0.035, 0.075, 0.05), 4, 8), LAMP_WHITE, gloss=0.35, crease_deg=70)
    )
    parts.append(
        painted(tube([(rear + 0.1, -0.17, 0.26), (rear - 0.22, -0.18, 0.33)], 0.05, 8, tip=0.1), STEEL, gloss=0.25)
    )
    return parts
