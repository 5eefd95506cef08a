"""The inverse of a function that increases from 0 up to where it folds back."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from unidrive_cli.geometry.arrays import Float

_MOST_STEPS = 80
_ROUNDING = 4e-16


def first_positive_root(coefficients: Sequence[float] | Float) -> float:
    """The smallest positive real root of a polynomial 1 + a s + b s^2 + ... (ascending powers), or infinity."""
    reciprocals = np.roots(
        coefficients
    )  # as a polynomial of 1/s its leading coefficient is 1, however small the others
    real = reciprocals.real[np.abs(reciprocals.imag) <= 1e-7 * np.abs(reciprocals)]
    largest = float(real.max(initial=0.0))
    return 1 / largest if largest > 1e-300 else math.inf


def inverse_of_increasing(
    value_and_slope: Callable[[Float], tuple[Float, Float]], nodes: Float, targets: Float
) -> Float:
    """Where (n,) an increasing function takes the values `targets` (n,); clipped to the ends of `nodes`.

    Newton's method between the two nodes round each target; where a step would leave them, bisection.

    Args:
        value_and_slope: gives values (n,) and derivatives (n,) at places (n,).
        nodes: (m,) places, ascending; the function increases from the first to the last.
    """
    values = np.maximum.accumulate(value_and_slope(nodes)[0])
    result = np.where(targets < values[-1], nodes[0], nodes[-1])
    at = np.flatnonzero((targets > values[0]) & (targets < values[-1]))
    targets = targets[at]
    after = np.searchsorted(values, targets, side="right")
    low, high = nodes[after - 1], nodes[after]
    places = low + (high - low) * (targets - values[after - 1]) / (values[after] - values[after - 1])
    for _ in range(_MOST_STEPS):
        value, slope = value_and_slope(places)
        excess = value - targets
        low, high = np.where(excess <= 0, places, low), np.where(excess >= 0, places, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            better = places - excess / slope
        better = np.where((better >= low) & (better <= high), better, (low + high) / 2)
        result[at] = better
        going = (np.abs(better - places) > _ROUNDING * places) & (np.abs(excess) > _ROUNDING * targets)
        if not going.any():
            break
        at, places, targets, low, high = at[going], better[going], targets[going], low[going], high[going]
    return result
