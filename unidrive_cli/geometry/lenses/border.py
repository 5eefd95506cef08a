"""The border of a picture's field as curves of unit rays, and how far other rays are from it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from unidrive_cli.geometry.arrays import Bool, Float, lengths

_ARCS = 64
_DENSE = 1024
_CHUNK = 4096
_SINGLE_PRECISION = 2e-3

Index = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class BorderCurve:
    """A smooth piece of a field's border, in arcs of about equal length.

    Attributes:
        nodes: (n + 1, 3) unit rays, the ends included.
        bulges: (n, 3) what leads from the middle of an arc's chord to the arc.
    """

    nodes: Float
    bulges: Float

    @cached_property
    def longest_chord(self) -> float:
        return float(lengths(np.diff(self.nodes, axis=0)).max())

    @cached_property
    def _arcs(self) -> Float:
        """(n, 12) of each arc: its start, its chord, the chord over its length squared, and the bulge."""
        chords = np.diff(self.nodes, axis=0)
        squares = np.maximum(np.einsum("ij,ij->i", chords, chords), np.finfo(np.float64).tiny)
        return np.concatenate([self.nodes[:-1], chords, chords / squares[:, None], self.bulges], axis=1)

    def distances(self, rays: Float, nearest: Index) -> Float:
        """Chords (n,) from unit rays (n, 3) to the curve, given the index (n,) of each ray's nearest node.

        An arc is taken for a parabola over its chord: right to the third order of its length.
        """
        last = len(self._arcs) - 1
        return np.minimum(
            self._to_arc(rays, np.maximum(nearest - 1, 0)), self._to_arc(rays, np.minimum(nearest, last))
        )

    def _to_arc(self, rays: Float, arc: Index) -> Float:
        start, chord, inverse, bulge = self._arcs[arc].reshape(-1, 4, 3).transpose(1, 0, 2)
        offset = rays - start
        along = np.clip(np.einsum("ij,ij->i", offset, inverse), 0, 1)
        offset -= along[:, None] * chord
        offset -= (4 * along * (1 - along))[:, None] * bulge
        return lengths(offset)


def border_curves(curve: Callable[[Float], Float], inside: Callable[[Float], Bool]) -> Iterator[BorderCurve]:
    """The pieces of a curve of unit rays that are border.

    Args:
        curve: unit rays (n, 3) at places (n,) of [0, 1].
        inside: (n,) where the curve is border.
    """
    places = np.linspace(0, 1, _DENSE + 1)
    border = np.concatenate([[False], inside(places), [False]])
    for start, end in zip(
        np.flatnonzero(border[1:] & ~border[:-1]), np.flatnonzero(border[:-1] & ~border[1:]) - 1, strict=True
    ):
        low = _edge(inside, places[start], places[start - 1]) if start > 0 else 0.0
        high = _edge(inside, places[end], places[end + 1]) if end < _DENSE else 1.0
        # crowded at the ends: where a side meets the rim of a model's field, rays run away like a square root
        dense = curve(low + (high - low) * (1 - np.cos(np.linspace(0, np.pi, _DENSE + 1))) / 2)
        dense = dense[np.isfinite(dense[:, 0])]  # the very ends may be beyond by rounding
        if len(dense) < 2:
            continue
        travelled = np.append(0, np.cumsum(lengths(np.diff(dense, axis=0))))
        even = np.linspace(0, travelled[-1], 2 * _ARCS + 1)
        rays = np.stack([np.interp(even, travelled, axis) for axis in dense.T], axis=-1)
        nodes = rays[::2]
        yield BorderCurve(nodes, rays[1::2] - (nodes[1:] + nodes[:-1]) / 2)


def _edge(inside: Callable[[Float], Bool], within: float, beyond: float) -> float:
    """The last place on the way from one to the other that is inside, to 64^-9 of the way."""
    for _ in range(9):
        places = np.linspace(within, beyond, 65)
        last = int(np.argmin(inside(places[1:])))
        within, beyond = float(places[last]), float(places[last + 1])
    return within


def chords_to_border(curves: Sequence[BorderCurve], rays: Float) -> Float:
    """Chord lengths (n,) from unit rays (n, 3) to the nearest of some curves.

    Nearest nodes are found in single precision; only curves that may be the nearest are looked at closely.
    """
    nodes = np.concatenate([curve.nodes for curve in curves]).astype(np.float32).T
    ends = np.cumsum([len(curve.nodes) for curve in curves])
    slack = np.array([curve.longest_chord / 2 + _SINGLE_PRECISION for curve in curves])
    result = np.full(len(rays), np.inf)
    for start in range(0, len(rays), _CHUNK):
        part, best = rays[start : start + _CHUNK], result[start : start + _CHUNK]
        cosines = np.split(part.astype(np.float32) @ nodes, ends[:-1], axis=1)
        to_node = np.sqrt([np.maximum(2 - 2 * of_curve.max(axis=1), 0) for of_curve in cosines])
        candidates = to_node - slack[:, None] <= to_node.min(axis=0)
        for curve, of_curve, candidate in zip(curves, cosines, candidates, strict=True):
            which = np.flatnonzero(candidate)
            distance = curve.distances(part[which], of_curve[which].argmax(axis=1))
            best[which] = np.minimum(best[which], distance)
    return result
