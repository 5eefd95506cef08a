"""CAM: intrinsics and distortion must be those of a camera, and only cameras have any."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from unidrive_cli.check.finding import Broken
from unidrive_cli.check.subject import Subject, at
from unidrive_cli.errors import DatasetError, GeometryError
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.tables.table import Indices

MIN_FIELD_DEG, MAX_FIELD_DEG = 1.0, 175.0


def wrong_intrinsics(subject: Subject) -> Iterator[Broken]:
    """A camera's intrinsics are [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], its field of view is 1 to 175 degrees, and
    its principal point is in the picture.

    Boxes are projected to the wrong place.
    """
    table = subject.dataset.calibrated_sensor
    widths, heights = _sizes(subject)
    for row, modality, width, height in zip(table.rows, _modalities(subject), widths, heights, strict=True):
        if modality == "camera" and (what := _fault(row.camera_intrinsic, int(width), int(height))):
            yield table.place(row, "camera_intrinsic"), what


def intrinsics_of_others(subject: Subject) -> Iterator[Broken]:
    """A lidar or radar has no intrinsics.

    Readers that ask by the matrix take it for a camera.
    """
    table = subject.dataset.calibrated_sensor
    for row, modality in zip(table.rows, _modalities(subject), strict=True):
        if modality in ("lidar", "radar") and row.camera_intrinsic:
            yield table.place(row, "camera_intrinsic"), f"is of a {modality}, which has none: [] was expected."


def wrong_distortion(subject: Subject) -> Iterator[Broken]:
    """A camera's camera_distortion, where it has one, is that of a lens: 4, 5, 8, 12 or 14 numbers in OpenCV's order
    (4 of a fisheye, by camera_model) that do not fold back near the principal point.

    Pictures are taken for rectified, or for what they are not.
    """
    table = subject.dataset.calibrated_sensor
    widths, heights = _sizes(subject)
    for row, modality, width, height in zip(table.rows, _modalities(subject), widths, heights, strict=True):
        size = int(width), int(height)
        if modality != "camera" or min(size) <= 0 or _fault(row.camera_intrinsic, *size):
            continue
        try:
            subject.dataset.lens(row, *size)
        except DatasetError as error:
            yield error.where, error.what


def _fault(intrinsic: object, width_px: int, height_px: int) -> str:
    known = width_px > 0 and height_px > 0
    try:
        lens = Pinhole.from_matrix(intrinsic, *((width_px, height_px) if known else (1, 1)))
    except GeometryError as error:
        return error.what
    if not known:
        return ""
    if not (0 <= lens.cx_px <= width_px and 0 <= lens.cy_px <= height_px):
        centre = f"({lens.cx_px:g}, {lens.cy_px:g})"
        return f"the principal point {centre} is outside of the picture of {width_px}x{height_px} pixels."
    for name, field in (("horizontal", lens.hfov_deg), ("vertical", lens.vfov_deg)):
        if not MIN_FIELD_DEG <= field <= MAX_FIELD_DEG:
            limits = f"{MIN_FIELD_DEG:g} to {MAX_FIELD_DEG:g}"
            return f"the {name} field of view is {field:.3g} degrees; {limits} were expected of a rectified picture."
    return ""


def _modalities(subject: Subject) -> list[str]:
    """Of each calibration's sensor; empty where it has none."""
    data = subject.dataset
    sensors = data.calibrated_sensor.links("sensor_token", data.sensor).tolist()
    return [data.sensor.rows[index].modality if index >= 0 else "" for index in sensors]


def _sizes(subject: Subject) -> tuple[Indices, Indices]:
    """Width and height of the first picture of each calibration, 0 where there is none."""
    data = subject.dataset
    of_row = data.sample_data.links("calibrated_sensor_token", data.calibrated_sensor)
    present, first = np.unique(of_row, return_index=True)
    rows = np.full(len(data.calibrated_sensor.rows), -1)
    rows[present[present >= 0]] = first[present >= 0]
    return np.maximum(at(subject.shots.widths, rows), 0), np.maximum(at(subject.shots.heights, rows), 0)
