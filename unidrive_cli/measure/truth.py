"""Virtual pictures against the truth: the same drive rendered directly through the virtual rig."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from unidrive_cli.check.poses import check_poses
from unidrive_cli.errors import DatasetError, UsageError
from unidrive_cli.geometry.arrays import Bool
from unidrive_cli.geometry.poses import relative, turn_rad
from unidrive_cli.measure.fidelity import SSIM_WINDOW_PX, Tally, compare
from unidrive_cli.measure.subjects import ConvertedPictures, RenderedPictures, Shown, Subject
from unidrive_cli.rig.model import Camera, Rig
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.instances import FIRST_OBJECT, GROUND, INSTANCES, SKY, STRUCTURES, instance_name
from unidrive_cli.tables.moments import cameras_of, reference_of
from unidrive_cli.tables.rig_of_dataset import camera_of, picture_size_of
from unidrive_cli.tables.schema import Sample, SampleData
from unidrive_cli.warp.choices import WarpChoices
from unidrive_cli.warp.pictures import read_instances, read_picture, size_of_file

SCHEMA_VERSION = 1
OVERALL = "overall"
REGIONS = ("ground", "objects", "structures", "sky", "seams")
"""Parts of a picture that are measured besides the whole, where it is known which pixels they are."""
SAME_CAMERA = 1e-6
"""How far numbers of a truth camera (metres, pixels) may be from those of the virtual one."""
SAME_PLACE_M = 1e-3
SAME_HEADING_RAD = 1e-5
SAME_TIME_US = 1000

Progress = Callable[[int, int], None]
"""Called with (finished samples, all samples)."""


@dataclass(frozen=True)
class Fidelity:
    """What pictures of one camera, or of all, add up to.

    Attributes:
        seen: pixels of the pictures, covered or not.
        tallies: by region; `overall` is all that is covered. Regions that are not known are missing.
    """

    seen: int
    tallies: dict[str, Tally]

    def __add__(self, other: Fidelity) -> Fidelity:
        """The pictures of both, in the regions that are known of both."""
        tallies = {
            name: tally + other.tallies[name] for name, tally in self.tallies.items() if name in other.tallies
        }
        return Fidelity(self.seen + other.seen, tallies)

    @property
    def covered(self) -> float:
        """Share of the pixels that are covered."""
        return self.tallies[OVERALL].pixels / self.seen

    def document(self) -> dict[str, Any]:
        """The keys of `measure --json`."""
        regions = {name: self.tallies.get(name) for name in REGIONS}
        return {
            **_figures(self.tallies[OVERALL]),
            **{name: None if tally is None else _figures(tally) for name, tally in regions.items()},
        }


@dataclass(frozen=True)
class TruthReport:
    """How near virtual pictures come to the truth.

    Attributes:
        overall: all pictures.
        by_camera: by virtual channel, in the rig's order.
        samples: how many were compared.
        notes: what a user should know, one sentence each.
    """

    overall: Fidelity
    by_camera: dict[str, Fidelity]
    samples: int
    notes: list[str]

    def document(self) -> dict[str, Any]:
        """The object that `measure --json` prints."""
        cameras = {channel: fidelity.document() for channel, fidelity in self.by_camera.items()}
        return {
            "schema_version": SCHEMA_VERSION,
            "truth": {**self.overall.document(), "by_camera": cameras},
            "samples": self.samples,
            "covered": round(self.overall.covered, 6),
            "notes": self.notes,
        }


def measure_converted(
    converted: Dataset,
    truth: Dataset,
    *,
    source: Dataset | None = None,
    scenes: tuple[str, ...] = (),
    jobs: int = 0,
    progress: Progress | None = None,
) -> TruthReport:
    """Compares the picture files of a converted dataset with the truth.

    Args:
        truth: the same drive through the virtual rig, all cameras at the samples' reference moments.
        source: the dataset that was converted; seams are known with it only.
        scenes: names; all where empty.
        jobs: samples worked on at once; 0 works in the calling thread alone. The result does not depend on it.
        progress: told after every sample.

    Raises:
        UsageError: not a converted dataset, or an option that cannot be.
        DatasetError: a dataset that is not what it must be, or lacks pictures.
    """
    return _measure(ConvertedPictures(converted, source), truth, scenes, jobs, progress)


def measure_rendered(
    source: Dataset,
    rig: Rig,
    choices: WarpChoices,
    truth: Dataset,
    *,
    scenes: tuple[str, ...] = (),
    cameras: tuple[str, ...] = (),
    jobs: int = 0,
    progress: Progress | None = None,
) -> TruthReport:
    """Renders a dataset through a rig in memory, and compares with the truth.

    Args, and further errors: those of `measure_converted`, and `cameras`: channels to render from; all where empty.

    Raises:
        RigError: a rig that does not fit the choices.
    """
    return _measure(RenderedPictures(source, rig, choices, cameras), truth, scenes, jobs, progress)


def _measure(
    subject: Subject, truth: Dataset, scenes: tuple[str, ...], jobs: int, progress: Progress | None
) -> TruthReport:
    if jobs < 0:
        raise UsageError(f"--jobs must be 0 or more, got {jobs}.")
    for camera in subject.rig.cameras:
        if min(camera.lens.width_px, camera.lens.height_px) < SSIM_WINDOW_PX:
            raise UsageError(
                f"{camera.channel} of {subject.rig.name} is {camera.lens.width_px}x{camera.lens.height_px} pixels; "
                f"SSIM needs {SSIM_WINDOW_PX} on either side."
            )
    for dataset in (subject.dataset, truth):
        check_poses(dataset)
    named = subject.dataset.scenes_named(scenes)
    samples = [sample for scene in named for sample in subject.dataset.samples_of_scene[scene.token]]
    common = [sample for sample in samples if sample.token in truth.sample.by_token]
    if not common:
        raise DatasetError(
            f"has none of the {len(samples)} samples of {subject.dataset.folder}: not one token is the same.",
            where=str(truth.folder),
            hint="The truth must be the same drive (unidrive synth writes one dataset per --rig).",
        )
    notes = list(subject.notes)
    if len(common) < len(samples):
        notes.append(f"{len(samples) - len(common)} of {len(samples)} samples have no truth and are left out.")
    pictures = _TruthPictures(truth, subject.rig)
    if not pictures.has_instances:
        notes.append(
            "The truth has no instance pictures (folder instances), so ground, objects, structures and sky "
            "are not told apart."
        )
    sums: dict[str, Fidelity] = {}
    for done, fidelities in enumerate(_in_order(lambda sample: pictures.compare(subject, sample), common, jobs), 1):
        for channel, fidelity in fidelities.items():
            sums[channel] = sums[channel] + fidelity if channel in sums else fidelity
        if progress:
            progress(done, len(common))
    return TruthReport(reduce(Fidelity.__add__, sums.values()), sums, len(common), notes)


def _in_order(
    work: Callable[[Sample], dict[str, Fidelity]], samples: Sequence[Sample], jobs: int
) -> Iterator[dict[str, Fidelity]]:
    """The samples' results in their order, so that sums do not depend on the number of jobs.

    Threads are enough: OpenCV, SciPy and simplejpeg release the interpreter. A few samples are in work at once.
    """
    if jobs == 0 or len(samples) == 1:
        yield from map(work, samples)
        return
    waiting: deque[Future[dict[str, Fidelity]]] = deque()
    with ThreadPoolExecutor(jobs) as pool:
        try:
            for sample in samples:
                waiting.append(pool.submit(work, sample))
                if len(waiting) > jobs:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


class _TruthPictures:
    """The truth's pictures, each checked to be of the virtual camera and of the sample's moment."""

    def __init__(self, dataset: Dataset, rig: Rig) -> None:
        """
        Raises:
            DatasetError: a camera of the rig is missing.
        """
        self._dataset = dataset
        self._rig = rig
        known = dataset.camera_channels()
        missing = [channel for channel in rig.channels if channel not in known]
        if missing:
            raise DatasetError(
                f"lacks cameras of the virtual rig {rig.name}: {', '.join(missing)}; it has "
                f"{', '.join(known) or 'none'}.",
                where=str(dataset.folder),
                hint="The truth must be rendered through the virtual rig.",
            )
        self.has_instances = (dataset.root / INSTANCES).is_dir()

    def compare(self, subject: Subject, sample: Sample) -> dict[str, Fidelity]:
        """Compares the virtual pictures of a sample, by channel.

        Raises:
            DatasetError: the truth has no such picture, or one of another camera, moment or size.
        """
        dataset = self._dataset
        own = dataset.sample.by_token[sample.token]
        rows = cameras_of(dataset, own, reference_of(dataset, own))
        found = {}
        for shown in subject.shown(sample):
            row = rows.get(shown.camera.channel)
            if row is None:
                raise DatasetError(
                    f"the sample has no picture of {shown.camera.channel}.",
                    where=dataset.sample.place(own, "token"),
                )
            self._check_camera(row, shown.camera)
            self._check_moment(row, subject.dataset, shown.moment)
            found[shown.camera.channel] = self._compare(row, shown)
        return found

    def _compare(self, row: SampleData, shown: Shown) -> Fidelity:
        size = shown.camera.lens.width_px, shown.camera.lens.height_px
        truth = read_picture(self._dataset.path_of(row), size)
        regions: dict[str, Bool] = {OVERALL: shown.covered}
        if self.has_instances:
            instances = read_instances(self._dataset.root / instance_name(row.filename), size)
            regions |= {
                "ground": instances == GROUND,
                "objects": instances >= FIRST_OBJECT,
                "structures": instances == STRUCTURES,
                "sky": instances == SKY,
            }
        if shown.seams is not None:
            regions["seams"] = shown.seams
        return Fidelity(shown.covered.size, compare(shown.picture, truth, shown.covered, regions))

    def _check_camera(self, row: SampleData, camera: Camera) -> None:
        """Refuses a truth picture of another lens or pose than the virtual camera's."""
        own = camera_of(self._dataset, row, picture_size_of(self._dataset, row, size_of_file))
        size, own_size = ((lens.width_px, lens.height_px) for lens in (camera.lens, own.lens))
        difference = ""
        if own_size != size:
            difference = f"its pictures are {own_size[0]}x{own_size[1]} pixels, not {size[0]}x{size[1]}"
        elif own.lens.model != camera.lens.model:
            difference = f"its lens is of the model {own.lens.model}"
        elif not np.allclose(own.lens.matrix, camera.lens.matrix, rtol=0, atol=SAME_CAMERA):
            off_px = np.abs(own.lens.matrix - camera.lens.matrix).max()
            difference = f"its focal lengths or its centre differ by up to {off_px:.3g} px"
        elif not np.allclose(own.ego_from_cam, camera.ego_from_cam, rtol=0, atol=SAME_CAMERA):
            off = relative(camera.ego_from_cam, own.ego_from_cam)
            difference = (
                f"it stands {_short(np.linalg.norm(off[:3, 3]))} m away and looks "
                f"{_short(math.degrees(turn_rad(off[:3, :3])))} degrees elsewhere"
            )
        if difference:
            raise DatasetError(
                f"{camera.channel} is not the virtual camera of {self._rig.name}: {difference}.",
                where=self._dataset.calibrated_sensor.place(
                    self._dataset.calibrated_sensor.by_token[row.calibrated_sensor_token], "sensor_token"
                ),
                hint="The truth must be rendered through the virtual rig.",
            )

    def _check_moment(self, row: SampleData, other: Dataset, moment: SampleData) -> None:
        """Refuses a truth picture of another time or ego pose than the virtual picture's."""
        off = relative(other.global_from_ego(moment), self._dataset.global_from_ego(row))
        apart_m, turned_rad = float(np.linalg.norm(off[:3, 3])), turn_rad(off[:3, :3])
        apart_us = abs(row.timestamp - moment.timestamp)
        if apart_m > SAME_PLACE_M or turned_rad > SAME_HEADING_RAD or apart_us > SAME_TIME_US:
            raise DatasetError(
                f"the truth was taken at another moment than the virtual picture: {_short(apart_m)} m, "
                f"{_short(math.degrees(turned_rad))} degrees and {_short(apart_us / 1000)} ms away from the "
                "sample's reference.",
                where=self._dataset.sample_data.place(row, "ego_pose_token"),
                hint="Its cameras must fire together, at the reference's moment (unidrive synth --firing together).",
            )


def _short(number: Any) -> str:
    """A distance, an angle or a time for an error sentence, without the dust of rounding."""
    return f"{round(float(number), 6):.4g}"


def _figures(tally: Tally) -> dict[str, Any]:
    psnr, ssim = tally.psnr_db, tally.ssim
    return {
        "psnr": None if psnr is None or math.isinf(psnr) else round(psnr, 4),
        "ssim": None if ssim is None else round(ssim, 6),
        "pixels": tally.pixels,
    }
