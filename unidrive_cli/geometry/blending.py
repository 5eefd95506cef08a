"""Angular blending weights (UniDrive eq. 3, whose weights the paper leaves open)."""

from __future__ import annotations

import numpy as np

from unidrive_cli.geometry.arrays import Float, lengths

BORDER_FLOOR = 1e-4
"""Sine below which a ray counts as on the picture's border: keeps 0/0 away where two borders meet."""
PARALLAX_FLOOR = 2e-3
"""Parallax in radians that still counts as none."""


def angular_weights(border_sine: Float, parallax_chord: Float) -> Float:
    """Unnormalised weight of a source at a scene point: max(border, eps)^4 / (parallax + eps)^2.

    It falls continuously to (almost) nothing at the source's picture border, and a source at the
    virtual camera's own place all but wins. The powers are steep, so that wide overlaps are decided
    and only narrow bands are mixed: averaging sources that disagree makes ghosts.

    Args:
        border_sine: (...) sine of the angle from the viewing ray to the source's picture border.
        parallax_chord: (...) chord of the angle at the scene point between the directions to the
            virtual and to the source centre; equals the angle in radians where it is small.

    Returns:
        (...) positive weights; what is covered is decided by the lens's validity, never by these.
    """
    border = np.maximum(border_sine, BORDER_FLOOR)
    weights: Float = np.square(np.square(border)) / np.square(parallax_chord + PARALLAX_FLOOR)
    return weights


def parallax_chord(points: Float, centre_a: Float, centre_b: Float) -> Float:
    """Chord 2 sin(angle / 2) of the angle at points (..., 3) between the directions to two centres (3,)."""
    to_a, to_b = points - centre_a, points - centre_b
    cosine = np.einsum("...k,...k->...", to_a, to_b) / (lengths(to_a) * lengths(to_b))
    chord: Float = np.sqrt(np.maximum(2 - 2 * cosine, 0.0))
    return chord
