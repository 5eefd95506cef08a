"""The layouts that are known: one line each, in the order in which a dataset is compared with them."""

from __future__ import annotations

from pathlib import Path

from unidrive_cli.errors import UsageError, did_you_mean
from unidrive_cli.tables.layouts.base import Layout
from unidrive_cli.tables.layouts.carla import CarlaLayout
from unidrive_cli.tables.layouts.lyft import LyftLayout
from unidrive_cli.tables.layouts.nuscenes import NuScenesLayout
from unidrive_cli.tables.layouts.t4 import T4Layout
from unidrive_cli.tables.layouts.truckscenes import TruckScenesLayout
from unidrive_cli.tables.layouts.unidrive import UniDriveLayout

LAYOUTS: tuple[Layout, ...] = (
    T4Layout(),
    TruckScenesLayout(),
    CarlaLayout(),
    LyftLayout(),
    UniDriveLayout(),
    NuScenesLayout(),  # the last: it takes all
)


def layout_of(folder: Path) -> Layout:
    """The layout of a version folder.

    Raises:
        OSError: it cannot be read.
    """
    return next(layout for layout in LAYOUTS if layout.is_at(folder))


def layout_named(name: str) -> Layout:
    """The layout that `--layout` names.

    Raises:
        UsageError: there is none of that name.
    """
    names = [layout.name for layout in LAYOUTS]
    if name not in names:
        hint = did_you_mean(name, names) or f"There are: {', '.join(names)}."
        raise UsageError(f"--layout {name}: there is no such layout.", hint=hint)
    return LAYOUTS[names.index(name)]
