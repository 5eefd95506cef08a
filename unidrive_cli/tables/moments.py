"""The moment of a sample: whose time and pose the virtual pictures take, and where its cameras stood then."""

from __future__ import annotations

from unidrive_cli.errors import DatasetError
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.geometry.lenses import Lens
from unidrive_cli.geometry.poses import inverse, relative
from unidrive_cli.tables.dataset import LIDAR_REFERENCE, Dataset
from unidrive_cli.tables.schema import Sample, SampleData


def reference_of(dataset: Dataset, sample: Sample) -> SampleData:
    """The row whose time and pose the virtual pictures take: LIDAR_TOP, another lidar, or the nearest camera.

    Raises:
        DatasetError: the sample has neither.
    """
    rows = dataset.keyframes.get(sample.token)
    if not rows:
        raise DatasetError(
            "the sample has no key frame of a lidar or a camera, so it has no pose.",
            where=dataset.sample.place(sample, "token"),
        )

    def rank(row: SampleData) -> tuple[int, float, str]:
        sensor = dataset.sensor_of(row)
        kind = 0 if sensor.channel == LIDAR_REFERENCE else 1 if sensor.modality == "lidar" else 2
        return kind, abs(row.timestamp - sample.timestamp), sensor.channel

    return min(rows, key=rank)


def cameras_of(dataset: Dataset, sample: Sample, reference: SampleData) -> dict[str, SampleData]:
    """The camera rows of a sample by channel; of several of one channel the one nearest in time to the reference."""
    chosen: dict[str, SampleData] = {}
    for row in dataset.keyframes.get(sample.token, []):
        sensor = dataset.sensor_of(row)
        if sensor.modality != "camera":
            continue
        other = chosen.get(sensor.channel)
        if other is None or abs(row.timestamp - reference.timestamp) < abs(other.timestamp - reference.timestamp):
            chosen[sensor.channel] = row
    return {channel: chosen[channel] for channel in sorted(chosen)}


def lens_and_pose(dataset: Dataset, row: SampleData, size_px: tuple[int, int]) -> tuple[Lens, Float]:
    """Lens, and `ego_from_cam` (4, 4), of the camera that took a picture of (width, height) pixels.

    Raises:
        DatasetError: dangling tokens, or numbers that are no camera.
    """
    calibration = dataset.calibrated_sensor.get(
        row.calibrated_sensor_token, dataset.sample_data.place(row, "calibrated_sensor_token")
    )
    return dataset.lens(calibration, *size_px), dataset.ego_from_sensor(calibration)


def lens_and_cam_from_ego(
    dataset: Dataset,
    row: SampleData,
    size_px: tuple[int, int],
    global_from_ego: Float,
    global_from_own_ego: Float | None = None,
    *,
    ego_motion: bool,
) -> tuple[Lens, Float, Float]:
    """Lens of the camera that took a picture, and where it stood, seen from the car at another moment.

    Args:
        size_px: (width, height) of the picture.
        global_from_ego: (4, 4) pose of the car at the moment of the virtual pictures.
        global_from_own_ego: (4, 4) at the picture's own moment; looked up where it is not given.
        ego_motion: whether the car's motion between the two moments counts.

    Returns:
        The lens, `cam_from_ego` (4, 4) from the ego frame of that moment into the camera, and `cam_from_own_ego`
        (4, 4) from that of the picture's own, the calibration.

    Raises:
        DatasetError: dangling tokens, or numbers that are no camera or no pose.
    """
    lens, ego_from_cam = lens_and_pose(dataset, row, size_px)
    cam_from_own_ego = inverse(ego_from_cam)
    if not ego_motion:
        return lens, cam_from_own_ego, cam_from_own_ego
    if global_from_own_ego is None:
        return lens, seen_from(dataset, row, cam_from_own_ego, global_from_ego), cam_from_own_ego
    return lens, cam_from_own_ego @ relative(global_from_own_ego, global_from_ego), cam_from_own_ego


def seen_from(dataset: Dataset, row: SampleData, cam_from_own_ego: Float, global_from_ego: Float) -> Float:
    """`cam_from_ego` (4, 4) from the ego frame of another moment into the camera, of that at the picture's own.

    Raises:
        DatasetError: the picture's ego pose is none.
    """
    moved: Float = cam_from_own_ego @ relative(dataset.global_from_ego(row), global_from_ego)
    return moved
