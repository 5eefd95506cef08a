"""Which rigs must fill what a conversion shows: a fleet, and the converted dataset's own car."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from unidrive_cli.convert.options import Options
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.rig.model import Camera, Rig
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.rig_of_dataset import rig_of_dataset
from unidrive_cli.warp.common import DEFAULT_SWEEP_M
from unidrive_cli.warp.pictures import size_of_file

_SAME_CAMERA = 1e-3


@dataclass(frozen=True, eq=False)
class Common:
    """The rigs of a fleet whose common coverage the pictures show.

    Attributes:
        rigs: the converted dataset's own among them.
        sweep_m: how far a car drives, at most, between a camera's moment and the reference.
    """

    rigs: tuple[Rig, ...]
    sweep_m: float = DEFAULT_SWEEP_M

    def identity(self) -> dict[str, Any]:
        """For the plan's digest and the provenance file; the order of the rigs does not matter."""
        rigs = sorted(f"{rig.name} {rig.digest[:16]}" for rig in self.rigs)
        return {"common_with": rigs, "common_sweep_m": self.sweep_m}


def with_own_rig(
    common: Common, dataset: Dataset, options: Options, scenes: tuple[str, ...]
) -> tuple[Common, list[str]]:
    """The fleet and the dataset's most frequent rig in some scenes, as far as its cameras are used; and notes."""
    own, notes = rig_of_dataset(dataset, scenes, size_of_file)
    used = tuple(camera for camera in own.cameras if not options.cameras or camera.channel in options.cameras)
    if any(_same_cameras(used, rig.cameras) for rig in common.rigs):
        return common, notes
    notes.append(f"The cameras of {own.name} count as well: what they cannot fill is black too.")
    return replace(common, rigs=(*common.rigs, replace(own, cameras=used))), notes


def _same_cameras(cameras: Sequence[Camera], others: Sequence[Camera]) -> bool:
    """Whether two rigs take the same pictures, whatever their channels are called: to 1e-3 pixels and metres."""

    def numbers(camera: Camera) -> Float:
        lens = camera.lens
        sizes = [lens.width_px, lens.height_px, *lens.coefficients]
        return np.concatenate([camera.ego_from_cam.ravel(), lens.matrix.ravel(), sizes])

    def same(camera: Camera, other: Camera) -> bool:
        one, another = numbers(camera), numbers(other)
        return one.shape == another.shape and bool(np.allclose(one, another, rtol=0, atol=_SAME_CAMERA))

    return len(cameras) == len(others) and all(any(same(camera, other) for other in others) for camera in cameras)
