"""Whether kernels can be compiled here (numba), and whether what was compiled can be kept."""

from __future__ import annotations

import functools
from importlib import metadata


@functools.cache
def has_numba() -> bool:
    """Whether numba is installed."""
    try:
        metadata.version("numba")
    except metadata.PackageNotFoundError:
        return False
    return True


def can_cache() -> bool:
    """Whether compiled code can be kept: beside the package, in the user's cache folder or in NUMBA_CACHE_DIR."""
    from numba import njit

    try:
        njit(cache=True)(can_cache)
    except RuntimeError:
        return False
    return True
