"""People: on foot, and as riders. Built standing on z = 0."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from unidrive_cli.geometry.arrays import Float
from unidrive_cli.synth.mesh import Mesh, merged
from unidrive_cli.synth.shapes import ball, block, loft, painted, rod, shaded, tube, unit
from unidrive_cli.synth.vehicles import Size, choose

SKINS = ((0.50, 0.33, 0.24), (0.44, 0.27, 0.19), (0.36, 0.21, 0.14), (0.25, 0.14, 0.09), (0.15, 0.08, 0.05))
HAIRS = ((0.012, 0.010, 0.009), (0.03, 0.018, 0.011), (0.09, 0.05, 0.025), (0.30, 0.20, 0.09), (0.32, 0.31, 0.30))
TOPS = (
    (0.02, 0.02, 0.025),
    (0.10, 0.10, 0.11),
    (0.62, 0.62, 0.60),
    (0.03, 0.06, 0.16),
    (0.34, 0.02, 0.03),
    (0.05, 0.16, 0.08),
    (0.45, 0.30, 0.05),
    (0.16, 0.28, 0.45),
    (0.30, 0.22, 0.14),
    (0.30, 0.06, 0.16),
)
BOTTOMS = ((0.02, 0.022, 0.03), (0.03, 0.05, 0.11), (0.06, 0.09, 0.16), (0.09, 0.09, 0.09), (0.28, 0.22, 0.14))
SHOES = ((0.015, 0.015, 0.015), (0.10, 0.06, 0.035), (0.55, 0.55, 0.54), (0.06, 0.06, 0.07))


@dataclass(frozen=True, eq=False)
class Outfit:
    """What a person looks like.

    Attributes:
        height_m: standing.
        build: girth; 1 is usual.
        woman: narrower shoulders, wider hips.
        skin, hair, top, bottom, shoes: linear RGB.
        sleeves: `long` or `short`.
        legs: `trousers`, `shorts`, `skirt`, or `coat` (a top that reaches to the knees).
        head: `short`, `long`, `bald`, `cap`, `hood`, `helmet`, `full_helmet`.
        headgear: linear RGB of cap, hood or helmet.
    """

    height_m: float
    build: float
    woman: bool
    skin: Float
    hair: Float
    top: Float
    bottom: Float
    shoes: Float
    sleeves: str
    legs: str
    head: str
    headgear: Float


@dataclass(frozen=True, eq=False)
class Pose:
    """Where the joints are, (3,) each, or (2, 3): left, right. Knees and elbows follow from the rest.

    Attributes:
        pelvis, neck: ends of the spine.
        hips, shoulders, hands, ankles: joints.
        toes: directions in which the feet point.
        face: direction in which the head looks.
    """

    pelvis: Float
    neck: Float
    hips: Float
    shoulders: Float
    hands: Float
    ankles: Float
    toes: Float
    face: Float


def draw_outfit(rng: np.random.Generator, *, riding: bool = False, helmet: str = "") -> Outfit:
    """Somebody at random; riders wear no skirts and coats."""
    woman = bool(rng.random() < 0.5)
    height = float(np.clip(rng.normal(1.665 if woman else 1.775, 0.065), 1.56, 1.90))
    hair_style = choose(
        rng,
        [(0.5, "long"), (0.3, "short"), (0.2, "hood")] if woman else [(0.65, "short"), (0.15, "bald"), (0.2, "cap")],
    )
    legs = choose(
        rng,
        [(0.6, "trousers"), (0.22, "skirt"), (0.18, "coat")]
        if woman
        else [(0.72, "trousers"), (0.16, "shorts"), (0.12, "coat")],
    )

    def pick(colours: Any, spread: float) -> Float:
        tone = np.array(colours[int(rng.integers(len(colours)))]) * rng.uniform(1 - spread, 1 + spread, 3)
        result: Float = np.clip(tone, 0.005, 0.8)
        return result

    return Outfit(
        height_m=height,
        build=float(np.clip(rng.normal(1.0, 0.09), 0.85, 1.25)),
        woman=woman,
        skin=pick(SKINS, 0.06),
        hair=pick(HAIRS, 0.1),
        top=pick(TOPS, 0.25),
        bottom=pick(TOPS, 0.2) if legs == "skirt" and not riding else pick(BOTTOMS, 0.2),
        shoes=pick(SHOES, 0.1),
        sleeves="long" if helmet or legs == "coat" or rng.random() < 0.6 else "short",
        legs="trousers" if riding and legs in ("skirt", "coat") else legs,
        head=helmet or hair_style,
        headgear=pick(TOPS, 0.2),
    )


def person(outfit: Outfit, pose: Pose, *, sides: int = 12) -> Mesh:
    """The mesh of a person in a pose; hangs in the air where the pose does."""
    h, b = outfit.height_m, outfit.build
    thigh, shank = 0.245 * h, 0.246 * h
    forward = unit(np.cross(pose.shoulders[0] - pose.shoulders[1], pose.neck - pose.pelvis))
    outward = np.array([(0, 0.15, 0.3), (0, -0.15, 0.3)])
    knees = np.stack([bend(pose.hips[n], pose.ankles[n], thigh, shank, forward + outward[n]) for n in range(2)])
    parts = [_torso(outfit, pose, knees, sides), _head(outfit, pose)]
    bare = outfit.legs in ("shorts", "skirt")
    for number in range(2):
        hip, knee, ankle = pose.hips[number], knees[number], pose.ankles[number]
        path = np.stack([hip, 0.5 * (hip + knee), knee, 0.62 * knee + 0.38 * ankle, ankle])
        loose = 1.0 if bare else 1.12
        radii = (
            np.array([0.050, 0.043, 0.033, 0.032 if bare else 0.030, 0.021 if bare else 0.027]) * h * b**0.7 * loose
        )
        radii[0] *= 1.06 if outfit.woman else 1.0
        leg = tube(path, radii, 8, tip=0.4)
        colours = np.tile(outfit.bottom, (len(leg.triangles), 1))
        if bare:
            middle = leg.positions_m[leg.triangles].mean(axis=1)
            shin = np.linalg.norm(middle - ankle, axis=1) < (1.05 if outfit.legs == "shorts" else 2.2) * shank
            colours[shin] = outfit.skin
        parts.append(painted(leg, colours, crease_deg=70, gloss=0.01))
        parts.append(_shoe(ankle, pose.toes[number], h, outfit.shoes))
        parts += _arm(outfit, pose.shoulders[number], pose.hands[number], -forward, 1 - 2 * number)
    return merged(parts)


def bend(start: Float, end: Float, first_m: float, second_m: float, towards: Any) -> Float:
    """The joint between two bones of given lengths; where they are too short to meet, on the straight line."""
    reach = end - start
    distance = float(np.linalg.norm(reach))
    along = unit(reach)
    out = np.asarray(towards, dtype=np.float64)
    out = unit(out - (out @ along) * along)
    near = float(
        np.clip((first_m**2 - second_m**2 + distance**2) / (2 * max(distance, 1e-6)), 0.2 * distance, 0.8 * distance)
    )
    off = np.sqrt(max(first_m**2 - near**2, 0.0))
    joint: Float = start + near * along + off * out
    return joint


def _torso(outfit: Outfit, pose: Pose, knees: Float, sides: int) -> Mesh:
    h, b = outfit.height_m, outfit.build
    spine = pose.neck - pose.pelvis
    up = unit(spine)
    across = unit(pose.shoulders[0] - pose.shoulders[1])
    ahead = np.cross(across, up)
    w = outfit.woman
    # share of the spine, half width, half depth, forward
    rows = [
        (-0.13, 0.055, 0.048, 0.0),
        (-0.06, 0.094 if w else 0.090, 0.068, -0.004),
        (0.10, 0.101 if w else 0.093, 0.070, -0.004),
        (0.34, 0.080 if w else 0.088, 0.058, 0.004),
        (0.62, 0.092 if w else 0.104, 0.068, 0.004),
        (0.81, 0.100 if w else 0.113, 0.062, 0.0),
        (0.90, 0.086 if w else 0.098, 0.050, -0.006),
        (0.96, 0.054 if w else 0.060, 0.040, -0.006),
        (1.0, 0.036, 0.036, -0.004),
        (1.12, 0.031, 0.032, 0.004),
    ]
    if outfit.legs in ("coat", "skirt"):
        ahead_of = (knees - pose.pelvis) @ ahead / h
        middle, swing = float(ahead_of.mean()), float(np.ptp(ahead_of)) / 2 + 0.052
        hem, flare = (-0.74, 0.108) if outfit.legs == "coat" else (-0.70, 0.118)
        rows[:2] = [
            (hem, flare - 0.02, swing - 0.01, middle),
            (hem + 0.05, flare, swing + 0.008, middle),
            (-0.28, 0.110, max(0.078, 0.5 * swing + 0.045), 0.5 * middle),
        ]
    angles = 2 * np.pi * np.arange(sides) / sides
    square = (
        np.sign(np.cos(angles)) * np.abs(np.cos(angles)) ** 0.8,
        np.sign(np.sin(angles)) * np.abs(np.sin(angles)) ** 0.8,
    )
    sections = []
    for share, wide, deep, shift in rows:
        girth = h * (b if share < 0.9 else 1.0)
        middle = pose.pelvis + share * spine + shift * h * ahead
        if share < -0.15 and abs(up[2]) < 0.9:
            continue
        sections.append(middle + girth * (wide * square[0][:, None] * across + deep * square[1][:, None] * ahead))
    shape = loft(sections)
    level = (shape.positions_m[shape.triangles].mean(axis=1) - pose.pelvis) @ up / np.linalg.norm(spine)
    colours = np.tile(outfit.top, (len(level), 1))
    if outfit.legs != "coat":
        colours[level < 0.06] = outfit.bottom
    colours[level > 1.01] = outfit.skin
    return painted(shape, colours, crease_deg=70, gloss=0.01)


def _arm(outfit: Outfit, shoulder: Float, hand: Float, back: Float, sign: int) -> list[Mesh]:
    h, b = outfit.height_m, outfit.build
    elbow = bend(shoulder, hand, 0.172 * h, 0.150 * h, back + np.array([0, 0.5 * sign, -0.5]))
    wrist = elbow + 0.95 * (hand - elbow)
    path = np.stack([shoulder + np.array((0, 0, 0.004 * h)), 0.5 * (shoulder + elbow), elbow, wrist])
    short = outfit.sleeves == "short"
    radii = np.array([0.032, 0.029, 0.024, 0.016 if short else 0.021]) * h * b**0.8
    arm = tube(path, radii, 7, side=(1, 0.2, 0.1) if abs((hand - shoulder)[0]) < 0.2 * h else (0, 1, 0), tip=0.5)
    colours = np.tile(outfit.top, (len(arm.triangles), 1))
    if short:
        middle = arm.positions_m[arm.triangles].mean(axis=1)
        colours[np.linalg.norm(middle - wrist, axis=1) < 0.20 * h] = outfit.skin
    palm = unit(hand - elbow) * 0.035 * h
    fist = tube(
        np.stack([wrist, hand + 0.4 * palm, hand + palm]),
        np.array([0.014, 0.022, 0.013]) * h,
        6,
        side=(1, 0.3, 0.2),
        tip=0.5,
    )
    return [
        painted(arm, colours, crease_deg=70, gloss=0.01),
        painted(fist, outfit.skin, crease_deg=70, gloss=0.02),
    ]


def _shoe(ankle: Float, toe: Float, h: float, colour: Float) -> Mesh:
    ahead = unit(toe)
    across = unit(np.cross((0, 0, 1), ahead))
    up = np.cross(ahead, across)
    sections = []
    for along, wide, top in (
        (-0.036, 0.016, 0.030),
        (-0.026, 0.021, 0.046),
        (0.022, 0.022, 0.044),
        (0.070, 0.027, 0.024),
        (0.105, 0.018, 0.014),
    ):
        base = ankle + along * h * ahead - 0.040 * h * up
        ring = [
            base + (y * h) * across + (z * h) * up
            for y, z in (
                (-wide, 0),
                (wide, 0),
                (wide, 0.55 * top),
                (0.55 * wide, top),
                (-0.55 * wide, top),
                (-wide, 0.55 * top),
            )
        ]
        sections.append(ring)
    return painted(loft(sections), colour, crease_deg=60, gloss=0.03)


def _head(outfit: Outfit, pose: Pose) -> Mesh:
    h = outfit.height_m
    face = unit(pose.face)
    across = unit(np.cross((0, 0, 1), face))
    up = np.cross(face, across)
    frame = np.stack([face, across, up], axis=1)
    centre = pose.neck + h * (0.016 * face + 0.083 * up)

    def at(shape: Any, colour: Any, gloss: float = 0.02) -> Mesh:
        placed = type(shape)(shape.positions_m @ frame.T + centre, shape.triangles)
        return painted(placed, colour, crease_deg=70, gloss=gloss)

    skull = ball((0, 0, 0), (0.054 * h, 0.043 * h, 0.066 * h), 7, 10)
    skull.positions_m[:, 1] *= 1 - 1.8 * np.clip(-skull.positions_m[:, 2] / h - 0.01, 0, 0.05) * 6
    nose = ball((0.052 * h, 0, -0.010 * h), (0.010 * h, 0.007 * h, 0.013 * h), 3, 4)
    parts = [] if outfit.head == "full_helmet" else [at(skull, outfit.skin), at(nose, outfit.skin)]
    if outfit.head in ("short", "long", "cap", "hood"):
        hair = ball((0, 0, 0), 1.0, 7, 10)
        points = hair.positions_m.copy()
        low = points[:, 2] < -0.1
        points[low & (points[:, 0] > -0.2), :] *= 0.75
        scale = np.array([0.056, 0.047, 0.064]) * h
        shift = np.array([-0.009, 0, 0.011]) * h
        long = outfit.head in ("long", "hood")
        stretch = np.where((points[:, 2] < 0) & (points[:, 0] < 0.3), 1.9 if long else 1.0, 1.0)
        points[:, 2] *= stretch
        tone = outfit.headgear if outfit.head in ("cap", "hood") else outfit.hair
        parts.append(
            at(
                type(hair)(points * scale * (1.06 if outfit.head == "hood" else 1.0) + shift, hair.triangles),
                tone,
                0.04,
            )
        )
        if outfit.head == "cap":
            brim = block((0.03 * h, -0.034 * h, 0.024 * h), (0.086 * h, 0.034 * h, 0.030 * h))
            parts.append(at(brim, outfit.headgear))
    if outfit.head == "helmet":
        parts.append(
            at(ball((-0.004 * h, 0, 0.026 * h), (0.072 * h, 0.056 * h, 0.052 * h), 6, 10), outfit.headgear, 0.1)
        )
    if outfit.head == "full_helmet":
        parts.append(at(ball((0.0, 0, 0.004 * h), (0.076 * h, 0.064 * h, 0.080 * h), 7, 10), outfit.headgear, 0.12))
        parts.append(
            at(ball((0.020 * h, 0, 0.012 * h), (0.062 * h, 0.056 * h, 0.028 * h), 5, 10), (0.01, 0.01, 0.012), 0.45)
        )
    return merged(parts)


def make_pedestrian(rng: np.random.Generator, *, walking: bool) -> tuple[str, Size, Mesh]:
    """Look, size and mesh of somebody on foot."""
    outfit = draw_outfit(rng)
    pose = _walk(outfit, float(rng.uniform(0.75, 1.0)), int(rng.choice([-1, 1]))) if walking else _stand(outfit, rng)
    parts = [person(outfit, pose)]
    bag = str(choose(rng, [(0.55, ""), (0.27, "backpack"), (0.18, "bag")]))
    tone = np.array(TOPS[int(rng.integers(len(TOPS)))]) * rng.uniform(0.6, 1.0)
    h = outfit.height_m
    if bag == "backpack":
        spine = pose.neck - pose.pelvis
        middle = pose.pelvis + 0.62 * spine + (-0.105 * h * outfit.build, 0, 0)
        pack = block(
            middle - (0.05 * h, 0.085 * h, 0.125 * h),
            middle + np.array((0.045 * h, 0.085 * h, 0.115 * h)),
            bevel_m=0.03 * h,
        )
        parts.append(painted(pack, tone, crease_deg=60))
        for sign in (1, -1):
            start = pose.neck + np.array((-0.05 * h, sign * 0.07 * h, -0.03 * h))
            path = [
                start,
                pose.neck + np.array((0.035 * h, sign * 0.072 * h, -0.045 * h)),
                pose.neck + np.array((0.072 * h * outfit.build, sign * 0.078 * h, -0.14 * h)),
            ]
            parts.append(painted(tube(path, 0.011 * h, 4), 0.7 * tone))
    if bag == "bag":
        side = int(rng.integers(2))
        hand = pose.hands[side]
        low = hand + np.array((-0.10 * h, -0.025 * h, -0.22 * h))
        parts.append(painted(block(low, low + np.array([0.20, 0.05, 0.15]) * h, bevel_m=0.012 * h), tone))
        for dx in (-0.05, 0.05):
            parts.append(
                painted(
                    rod(hand + np.array((0, 0, -0.02 * h)), hand + np.array((dx * h, 0, -0.075 * h)), 0.006 * h, 4),
                    0.7 * tone,
                )
            )
    mesh = merged(parts)
    low, high = mesh.positions_m.min(axis=0).astype(float), mesh.positions_m.max(axis=0).astype(float)
    size = (
        float(np.clip(high[1] - low[1], 0.5, 0.75)),
        float(np.clip(high[0] - low[0], 0.5, 0.9)),
        float(np.clip(high[2] - low[2], 1.55, 1.95)),
    )
    look = f"{'woman' if outfit.woman else 'man'}_{outfit.legs}" + (f"_{bag}" if bag else "")
    return look, size, shaded(mesh, fade_m=0.6, darkest=0.75)


def _joints(outfit: Outfit, pelvis: Float, neck: Float, twist: float) -> tuple[Float, Float]:
    """Hips and shoulders; the twist turns the shoulders one way and the hips half as much the other."""
    h = outfit.height_m
    hip, shoulder = (0.052, 0.102) if outfit.woman else (0.050, 0.116)
    shoulder *= 0.5 + 0.5 * outfit.build
    sides = np.array([1.0, -1.0])[:, None]
    hips = pelvis + sides * hip * h * np.array([np.sin(0.5 * twist), np.cos(0.5 * twist), 0])
    shoulders = neck - (0, 0, 0.042 * h) + sides * shoulder * h * np.array([-np.sin(twist), np.cos(twist), 0])
    return hips, shoulders


def _walk(outfit: Outfit, stride: float, lead: int) -> Pose:
    """Mid-stride; lead 1: the left foot is ahead."""
    h = outfit.height_m
    if outfit.legs in ("skirt", "coat"):
        stride *= 0.8
    pelvis, neck = np.array([0.0, 0, 0.505 * h]), np.array([0.022 * h, 0, 0.818 * h])
    hips, shoulders = _joints(outfit, pelvis, neck, -0.16 * lead * stride)
    ahead, behind = (0, 1) if lead > 0 else (1, 0)
    ankles, hands, toes = np.zeros((2, 3)), np.zeros((2, 3)), np.zeros((2, 3))
    ankles[ahead] = (0.155 * h * stride, 0.9 * hips[ahead][1], 0.0452 * h)
    ankles[behind] = (-0.170 * h * stride, 0.9 * hips[behind][1], 0.0776 * h)
    toes[ahead], toes[behind] = (1, 0, 0.16), (1, 0, -0.42)
    hands[behind] = shoulders[behind] + np.array([0.135 * stride, 0.015 * (1 - 2 * behind), -0.272]) * h
    hands[ahead] = shoulders[ahead] + np.array([-0.120 * stride, 0.030 * (1 - 2 * ahead), -0.283]) * h
    return Pose(pelvis, neck, hips, shoulders, hands, ankles, toes, np.array([1.0, 0, -0.05]))


def _stand(outfit: Outfit, rng: np.random.Generator) -> Pose:
    h = outfit.height_m
    pelvis, neck = np.array([0.0, 0, 0.520 * h]), np.array([0.004 * h, 0, 0.832 * h])
    hips, shoulders = _joints(outfit, pelvis, neck, float(rng.uniform(-0.1, 0.1)))
    spread = rng.uniform(0.8, 1.5)
    sides = np.array([1.0, -1.0])
    ahead = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.075))
    ankles = np.column_stack([np.array([ahead, -ahead]) * h, sides * 0.052 * spread * h, np.full(2, 0.040 * h)])
    toes = np.column_stack([np.ones(2), 0.2 * sides, np.zeros(2)])
    hands = shoulders + np.column_stack([np.full(2, 0.03), 0.03 * sides, np.full(2, -0.305)]) * h
    if rng.random() < 0.35:  # looks at a telephone
        one = int(rng.integers(2))
        hands[one] = shoulders[one] + np.array([0.17, -0.07 * sides[one], -0.09]) * h
    return Pose(pelvis, neck, hips, shoulders, hands, ankles, toes, np.array([1.0, rng.uniform(-0.4, 0.4), -0.1]))
