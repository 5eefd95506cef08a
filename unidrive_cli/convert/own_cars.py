"""`--source-mask`: a folder with a PNG per source camera that says where its pictures show the own car."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from unidrive_cli.errors import PictureError, UsageError, did_you_mean
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.warp.own_car import OwnCar
from unidrive_cli.warp.pictures import read_mask, size_of_file

MOST_OF_PICTURE = 0.75
"""A mask that holds more is taken for one of the other kind, which shows what may be used."""


def read_own_cars(folder: Path, dataset: Dataset) -> dict[str, OwnCar]:
    """The masks `<CHANNEL>.png` of a folder, by channel: a pixel that is not 0 shows the own car.

    Raises:
        UsageError: no folder, no masks, a name that is no camera's, or a file that is no mask.
    """
    channels = dataset.camera_channels()
    if not folder.is_dir():
        raise UsageError("--source-mask must be a folder with a <CHANNEL>.png for each camera.", where=str(folder))
    found = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or (path.suffix.lower() != ".png" and path.stem not in channels):
            continue
        if path.suffix != ".png":
            raise UsageError(f"a mask must be a PNG file, {path.stem}.png.", where=str(path))
        if path.stem not in channels:
            raise UsageError(
                f"{path.stem} is no camera of {dataset.folder} (it has {', '.join(channels)}).",
                where=str(path),
                hint=did_you_mean(path.stem, channels),
            )
        found[path.stem] = _read(path)
    if not found:
        raise UsageError(f"holds no masks: {channels[0]}.png or the like was expected.", where=str(folder))
    return found


def own_car_of(own_cars: Mapping[str, OwnCar], channel: str, size_px: tuple[int, int]) -> OwnCar | None:
    """The mask of a camera whose pictures have (width, height) pixels; None where it has none.

    Raises:
        UsageError: a mask of another size.
    """
    car = own_cars.get(channel)
    if car is None or (car.width_px, car.height_px) == size_px:
        return car
    raise UsageError(
        f"the mask {channel}.png has {car.width_px}x{car.height_px} pixels, but pictures of {channel} have "
        f"{size_px[0]}x{size_px[1]}.",
        where="--source-mask",
    )


def own_cars_identity(own_cars: Mapping[str, OwnCar]) -> dict[str, Any]:
    """For the plan's digest and the provenance file: what the masks hold, whatever they are called."""
    if not own_cars:
        return {}
    digests = {
        channel: hashlib.sha256(f"{car.width_px}x{car.height_px} ".encode() + car.mask.tobytes()).hexdigest()
        for channel, car in sorted(own_cars.items())
    }
    return {"source_masks": digests}


def _read(path: Path) -> OwnCar:
    try:
        mask = read_mask(path, size_of_file(path))
    except PictureError as error:
        raise UsageError(error.what, where=error.where, hint="A mask is a PNG file with one channel.") from error
    if mask.mean() > MOST_OF_PICTURE:
        raise UsageError(
            f"takes {mask.mean():.0%} of the picture for the own car.",
            where=str(path),
            hint="Pixels that are not 0 show the own car, 0 is what may be used; the mask seems to be inverted.",
        )
    return OwnCar.of(mask)
