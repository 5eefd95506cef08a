"""The corners of a dataset's annotated boxes, in the car's frame of each sample, and the cameras that see them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
import numpy.typing as npt

from unidrive_cli.check.poses import check_poses
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.geometry.boxes import corners
from unidrive_cli.geometry.lenses import Lens
from unidrive_cli.geometry.poses import inverse, rotations_from_quaternions
from unidrive_cli.geometry.projection_error import Indices, Sighting, sight
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.moments import cameras_of, lens_and_pose, reference_of, seen_from
from unidrive_cli.tables.rig_of_dataset import SizeOfFile, picture_size_of
from unidrive_cli.tables.schema import Sample, SampleData

CORNERS = 8
MOST_SAMPLES = 64
MOST_BOXES = 2048


@dataclass(frozen=True, eq=False)
class SourceCamera:
    """One channel of consecutive samples that were taken through the same lens.

    Attributes:
        cam_from_ego: (s, 4, 4) for each sample from the car's frame at its reference into the camera, the motion
            between the two moments included.
    """

    channel: str
    lens: Lens
    cam_from_ego: Float


@dataclass(frozen=True, eq=False)
class Corners:
    """Box corners of consecutive samples that have the same channels and lenses.

    Attributes:
        samples: (s,) tokens.
        cameras: of those samples.
        points_ego: (n, 3) corners, eight in turn of each box, in the car's frame at their sample's reference.
        sample: (n,) index of each corner's sample.
        category: (n,) row of each corner's category in the dataset's table; -1 where it has none.
    """

    samples: tuple[str, ...]
    cameras: tuple[SourceCamera, ...]
    points_ego: Float
    sample: Indices
    category: Indices

    def sightings(self) -> list[Sighting]:
        """What each camera sees of the corners."""
        return [sight(self.points_ego, camera.lens, camera.cam_from_ego[self.sample]) for camera in self.cameras]


class BoxCorners:
    """Reads the corners of a dataset's boxes, some samples at a time."""

    def __init__(
        self,
        dataset: Dataset,
        cameras: Sequence[str] = (),
        *,
        ego_motion: bool = True,
        size_of_file: SizeOfFile | None = None,
    ) -> None:
        """
        Args:
            cameras: channels to look through; all where empty.
            ego_motion: whether each camera stands where the car was when it fired, or at the sample's reference.
            size_of_file: says the size of pictures that have none in their table.

        Raises:
            UsageError: an unknown camera.
            DatasetError: numbers that are no pose or no box, annotations whose instance is not there.
        """
        check_poses(dataset)
        self._dataset = dataset
        self._channels = set(dataset.camera_channels(cameras))
        self._ego_motion = ego_motion
        self._size_of_file = size_of_file
        self._calibrated: dict[tuple[str, tuple[int, int]], tuple[Lens, Float]] = {}
        boxes = dataset.sample_annotation
        self._translations, self._rotations, self._sizes = (
            boxes.numbers(field) for field in ("translation", "rotation", "size")
        )
        instances = boxes.links("instance_token", dataset.instance)
        for row in boxes.rows_at(np.flatnonzero(instances < 0)[:1]):
            dataset.instance.get(row.instance_token, boxes.place(row, "instance_token"))
        categories = np.append(dataset.instance.links("category_token", dataset.category), -1)
        self._categories = np.maximum(categories[instances], -1).astype(np.intp)

    def of(self, samples: Sequence[Sample]) -> Iterator[Corners]:
        """The corners of samples, in their order; samples without boxes or cameras are left out.

        Raises:
            DatasetError: dangling tokens, or numbers that are no camera.
        """
        described = (self._described(sample) for sample in samples)
        wanted = (one for one in described if len(one.boxes) and one.cameras)
        for _, alike in groupby(wanted, key=lambda one: [camera[:2] for camera in one.cameras]):
            run: list[_Described] = []
            for one in alike:
                boxes = sum(len(other.boxes) for other in run)
                if run and (len(run) == MOST_SAMPLES or boxes + len(one.boxes) > MOST_BOXES):
                    yield self._corners(run)
                    run = []
                run.append(one)
            yield self._corners(run)

    def _described(self, sample: Sample) -> _Described:
        dataset = self._dataset
        reference = reference_of(dataset, sample)
        global_from_ego = dataset.global_from_ego(reference)
        cameras = []
        for channel, row in cameras_of(dataset, sample, reference).items():
            if channel in self._channels:
                size = picture_size_of(dataset, row, self._size_of_file)
                lens, cam_from_ego = self._camera(row, size)
                if self._ego_motion:
                    cam_from_ego = seen_from(dataset, row, cam_from_ego, global_from_ego)
                cameras.append((channel, lens, cam_from_ego))
        return _Described(sample.token, global_from_ego, dataset.annotation_indices(sample.token), cameras)

    def _camera(self, row: SampleData, size_px: tuple[int, int]) -> tuple[Lens, Float]:
        """Lens, and `cam_from_ego` (4, 4) at the picture's own moment: the same for many pictures."""
        key = row.calibrated_sensor_token, size_px
        if key not in self._calibrated:
            lens, ego_from_cam = lens_and_pose(self._dataset, row, size_px)
            self._calibrated[key] = lens, inverse(ego_from_cam)
        return self._calibrated[key]

    def _corners(self, run: Sequence[_Described]) -> Corners:
        boxes = np.concatenate([one.boxes for one in run])
        sample = np.repeat(np.arange(len(run)), [len(one.boxes) for one in run])
        global_from_ego = np.array([one.global_from_ego for one in run])[sample]
        to_ego = np.swapaxes(global_from_ego[:, :3, :3], -1, -2)
        ego_from_box = np.zeros((len(boxes), 4, 4))
        ego_from_box[:, :3, :3] = to_ego @ rotations_from_quaternions(self._rotations[boxes])
        offsets = self._translations[boxes] - global_from_ego[:, :3, 3]
        ego_from_box[:, :3, 3] = (to_ego @ offsets[..., None])[..., 0]
        cameras = tuple(
            SourceCamera(channel, lens, np.array([one.cameras[place][2] for one in run]))
            for place, (channel, lens, _) in enumerate(run[0].cameras)
        )
        return Corners(
            tuple(one.token for one in run),
            cameras,
            corners(ego_from_box, self._sizes[boxes]).reshape(-1, 3),
            np.repeat(sample, CORNERS),
            np.repeat(self._categories[boxes], CORNERS),
        )


@dataclass(frozen=True, eq=False)
class _Described:
    """A sample before its corners are computed: `boxes` are rows of sample_annotation, `cameras` channel, lens and
    `cam_from_ego` (4, 4)."""

    token: str
    global_from_ego: Float
    boxes: npt.NDArray[np.int64]
    cameras: list[tuple[str, Lens, Float]]
