"""Strict entry of numbers into the geometry."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from unidrive_cli.errors import GeometryError

Float = npt.NDArray[np.float64]
Bool = npt.NDArray[np.bool_]


def finite_array(value: Any, shape: tuple[int | None, ...], name: str) -> Float:
    """`value` as a float64 array of `shape` (None: any length), all finite.

    Raises:
        GeometryError: another shape, not numbers, NaN or infinity.
    """
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise GeometryError(f"{name} must be an array of numbers, got {value!r:.80}.") from error
    fits = array.ndim == len(shape) and all(
        want is None or have == want for have, want in zip(array.shape, shape, strict=True)
    )
    if not fits:
        wanted = "x".join("n" if want is None else str(want) for want in shape)
        raise GeometryError(
            f"{name} must have shape {wanted}, got {'x'.join(map(str, array.shape)) or 'one number'}."
        )
    if not np.isfinite(array).all():
        raise GeometryError(f"{name} must be finite numbers, got {array.tolist()!r:.120}.")
    return array


def lengths(vectors: Float) -> Float:
    """Euclidean lengths (...) of vectors (..., n); much faster than `np.linalg.norm` where n is small."""
    result: Float = np.sqrt(np.einsum("...k,...k->...", vectors, vectors))
    return result


def read_only(array: Float) -> Float:
    """A copy of `array` that nobody can change: what frozen dataclasses keep."""
    kept = np.array(array, dtype=np.float64)
    kept.flags.writeable = False
    return kept
