"""Virtual cameras of which the source's cameras fill too little."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from unidrive_cli.convert.common import Common
from unidrive_cli.convert.options import Options
from unidrive_cli.convert.own_cars import own_car_of
from unidrive_cli.errors import PictureError, UsageError
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.geometry.lenses import Lens
from unidrive_cli.geometry.poses import inverse
from unidrive_cli.rig.model import Rig
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.moments import lens_and_pose
from unidrive_cli.tables.rig_of_dataset import picture_size_of
from unidrive_cli.tables.schema import SampleData
from unidrive_cli.warp.common import common_masks, covered_share
from unidrive_cli.warp.own_car import OwnCar
from unidrive_cli.warp.pictures import size_of_file
from unidrive_cli.warp.remap import Source, VirtualView, virtual_views

_Camera = tuple[Lens, bytes, OwnCar | None]


def covered_rig(
    dataset: Dataset,
    rig: Rig,
    samples: Sequence[Sequence[SampleData]],
    options: Options,
    common: Common | None,
    own_cars: Mapping[str, OwnCar],
) -> tuple[Rig, list[str]]:
    """The virtual rig without the cameras that stay below `min_coverage` in the mean of all samples.

    Known from the calibrations alone, so that every part of a conversion comes to the same rig: the cameras are
    taken to have fired together.

    Args:
        samples: the source pictures of each.
        common: the rigs that must fill what is shown.
        own_cars: where the source cameras show the own car, by channel.

    Returns:
        The rig, and a note where cameras are gone.

    Raises:
        UsageError: no camera would be left.
        DatasetError: dangling tokens, or numbers that are no camera.
    """
    views = virtual_views(rig, options.depth_limit_m, options.ground_height_m)
    shares = _mean_shares(dataset, samples, views, common, own_cars)
    stays = shares >= options.min_coverage
    if not stays.any():
        best = int(shares.argmax())
        raise UsageError(
            f"no virtual camera reaches --min-coverage {options.min_coverage:g}; {rig.channels[best]} comes "
            f"nearest: {shares[best]:.1%} are covered."
        )
    if stays.all():
        return rig, []
    left_out = ", ".join(
        f"{channel} ({share:.1%})"
        for channel, share, stay in zip(rig.channels, shares, stays, strict=True)
        if not stay
    )
    cameras = tuple(camera for camera, stay in zip(rig.cameras, stays, strict=True) if stay)
    note = (
        f"Left out, being covered less than {100 * options.min_coverage:g}% in the mean of all samples: {left_out}."
    )
    return replace(rig, cameras=cameras), [note]


def _mean_shares(
    dataset: Dataset,
    samples: Sequence[Sequence[SampleData]],
    views: Sequence[VirtualView],
    common: Common | None,
    own_cars: Mapping[str, OwnCar],
) -> Float:
    """(views,) covered share of each virtual camera in the mean of some samples."""
    sources: dict[_Camera, Source] = {}
    of_picture: dict[tuple[str, int | None, int | None], _Camera] = {}
    arrangements: Counter[frozenset[_Camera]] = Counter()
    for rows in samples:
        together = set()
        for row in rows:
            picture = row.calibrated_sensor_token, row.width, row.height
            if picture not in of_picture:
                with contextlib.suppress(PictureError):  # a missing file whose size no table says
                    size = picture_size_of(dataset, row, size_of_file)
                    lens, ego_from_cam = lens_and_pose(dataset, row, size)
                    own_car = own_car_of(own_cars, dataset.sensor_of(row).channel, size)
                    of_picture[picture] = lens, ego_from_cam.tobytes(), own_car
                    sources[of_picture[picture]] = Source(lens, inverse(ego_from_cam), own_car=own_car)
            if picture in of_picture:
                together.add(of_picture[picture])
        arrangements[frozenset(together)] += 1
    common_pixels = common_masks(views, common.rigs, common.sweep_m).masks() if common else [None] * len(views)
    shares = np.array(
        [
            [
                covered_share(view, [sources[key] for key in together], mask)
                for view, mask in zip(views, common_pixels, strict=True)
            ]
            for together in arrangements
        ]
    )
    means: Float = np.average(shares, axis=0, weights=list(arrangements.values()))
    return means
