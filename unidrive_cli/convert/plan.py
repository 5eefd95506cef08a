"""The plan: what would be written, from which pictures; everything that can be refused is refused here."""

from __future__ import annotations

import itertools
import re
import stat
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from unidrive_cli import __version__
from unidrive_cli.check.files import named_files
from unidrive_cli.check.poses import Rotations, check_poses
from unidrive_cli.check.references import check_references
from unidrive_cli.convert.common import Common, with_own_rig
from unidrive_cli.convert.coverage import covered_rig
from unidrive_cli.convert.links import check_carried_folders
from unidrive_cli.convert.options import Options
from unidrive_cli.convert.output_names import OutputNames
from unidrive_cli.convert.own_cars import own_car_of, own_cars_identity, read_own_cars
from unidrive_cli.convert.sweeps import CHANNEL, SWEEP, KeyFrames, Sweep, group_sweeps
from unidrive_cli.convert.units import SKIP_HINT, Frame
from unidrive_cli.errors import DatasetError, PictureError, RigError, UsageError
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.geometry.poses import relative
from unidrive_cli.geometry.scene import HalfBall
from unidrive_cli.rig.model import Rig
from unidrive_cli.tables.converted import is_converted
from unidrive_cli.tables.dataset import LIDAR_REFERENCE, Dataset
from unidrive_cli.tables.destination import RESERVED, digest_of
from unidrive_cli.tables.layouts.known import LAYOUTS
from unidrive_cli.tables.moments import cameras_of, lens_and_cam_from_ego, lens_and_pose, reference_of
from unidrive_cli.tables.rig_of_dataset import picture_size_of, rig_of_dataset
from unidrive_cli.tables.schema import Sample, SampleData, Scene, Timestamp
from unidrive_cli.tables.splits import scenes_of
from unidrive_cli.tables.table import Indices
from unidrive_cli.warp.common import CommonMasks, common_masks
from unidrive_cli.warp.own_car import OwnCar
from unidrive_cli.warp.pictures import check_size, jpeg_bytes, read_head, size_of_file
from unidrive_cli.warp.remap import Source, virtual_views
from unidrive_cli.warp.render import Toolchain, choose_toolchain

METHOD = 5
"""Version of what the pictures and tables depend on; a change of results raises it."""

STANDARD_CHANNELS = (
    "CAM_FRONT",
    "CAM_FRONT_LEFT",
    "CAM_FRONT_RIGHT",
    "CAM_BACK",
    "CAM_BACK_LEFT",
    "CAM_BACK_RIGHT",
)
STANDARD_SIZE_PX = (1600, 900)
MAX_TIMESTAMP = 2**63
_MASK_BYTES = 4_000
_ROW_BYTES = 700


@dataclass(frozen=True, eq=False)
class Unit:
    """One unit of work: a sample with the rows it is rendered from.

    Attributes:
        scene, sample: its rows.
        reference: the row whose time and ego pose the virtual pictures take.
        cameras: the camera key frames, at most one per channel.
        sources: those that are rendered from (`--camera`).
        pictures: file name of each virtual picture, in the rig's order.
    """

    scene: Scene
    sample: Sample
    reference: SampleData
    cameras: tuple[SampleData, ...]
    sources: tuple[SampleData, ...]
    pictures: tuple[str, ...]

    @property
    def token(self) -> str:
        """What receipts and failures are known by: the sample's."""
        return self.sample.token

    @property
    def timestamp(self) -> Timestamp:
        """Of the virtual pictures."""
        return self.reference.timestamp


Moment = Unit | Sweep
"""A unit of work: a sample, or pictures that were taken together between two."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Everything that a conversion will do.

    Attributes:
        dataset, rig, options: what it was made from.
        toolchain: kernel and codec.
        units: one per sample, by scene and time.
        names: what files that go along are called in the output.
        common: the rigs that must fill what is shown; None where none are named.
        notes: what a user should know, one sentence each.
        sweeps: by scene and time; empty without the option.
        own_cars: where the source cameras show the own car, by channel.
        rotations: unit quaternions of rows whose own are none.
    """

    dataset: Dataset
    rig: Rig
    options: Options
    toolchain: Toolchain
    units: list[Unit]
    notes: list[str]
    names: OutputNames
    common: Common | None = None
    sweeps: Sequence[Sweep] = ()
    own_cars: Mapping[str, OwnCar] = field(default_factory=dict)
    rotations: Rotations = field(default_factory=dict)

    @cached_property
    def source_rig(self) -> Rig:
        """The cameras that took most samples, for what depends on no sample.

        Raises:
            DatasetError, PictureError, RigError: they are no rig.
        """
        return rig_of_dataset(self.dataset, scene_names(self.units), size_of_file)[0]

    @cached_property
    def moments(self) -> list[Moment]:
        """All units of work, by scene and time."""
        return [moment for scene in moments_by_scene(self.units, self.sweeps) for moment in scene]

    @cached_property
    def common_masks(self) -> CommonMasks | None:
        """What the rigs of `common` fill; None where none are named.

        Raises:
            UsageError: nothing is common.
        """
        if self.common is None:
            return None
        views = virtual_views(self.rig, self.options.depth_limit_m, self.options.ground_height_m)
        return common_masks(views, self.common.rigs, self.common.sweep_m)

    @cached_property
    def identity(self) -> dict[str, Any]:
        """What the output depends on; the plan's digest names it."""
        lenses = {channel: lens.identity for channel, lens in self.dataset.lenses.items()}
        return {
            "method": METHOD,
            "version": __version__,
            "source": {
                "version": self.dataset.version,
                "digest": self.dataset.digest,
                "layout": self.dataset.layout.name,
                **({"lenses": lenses} if lenses else {}),
            },
            "rig": {"name": self.rig.name, "digest": self.rig.digest},
            "options": self.options.identity()
            | (self.common.identity() if self.common else {})
            | own_cars_identity(self.own_cars),
            **self.toolchain.identity,
        }

    @property
    def version(self) -> str:
        """The version folder of the output."""
        return output_version(self.dataset, self.options)

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of `identity`."""
        return digest_of(self.identity)

    def frame(self, unit: Moment) -> Frame:
        """The unit as its worker needs it: files, cameras and boxes, no tables.

        Raises:
            DatasetError: numbers that are no camera or no pose.
        """
        if isinstance(unit, Sweep):
            return self._sweep_frame(unit)
        global_from_ego = self.dataset.global_from_ego(unit.reference)
        witnesses = {row.token: self._source(row, global_from_ego) for row in unit.cameras}
        return Frame(
            unit.sample.token,
            unit.pictures,
            tuple(str(self.dataset.path_of(row)) for row in unit.sources),
            tuple(witnesses[row.token] for row in unit.sources),
            tuple(witnesses.values()),
            *self._boxes(unit, global_from_ego),
        )

    def _sweep_frame(self, sweep: Sweep) -> Frame:
        rows = np.array([sweep.reference, *sweep.rows])
        global_from_ego, *own_poses = self.dataset.global_from_ego_at(rows)
        pictures = list(self.dataset.sample_data.rows_at(rows[1:]))
        return Frame(
            sweep.token,
            sweep.pictures,
            tuple(str(self.dataset.path_of(row)) for row in pictures),
            tuple(self._source(row, global_from_ego, own) for row, own in zip(pictures, own_poses, strict=True)),
            (),
            np.zeros((0, 4, 4)),
            np.zeros((0, 3)),
        )

    def _source(self, row: SampleData, global_from_ego: Float, global_from_own_ego: Float | None = None) -> Source:
        """A source picture's camera.

        Args:
            global_from_ego: (4, 4) pose of the car at the moment of the virtual pictures.
            global_from_own_ego: at the picture's own moment, where it is known already.
        """
        size = picture_size_of(self.dataset, row, size_of_file)
        motion = self.options.ego_motion
        camera = lens_and_cam_from_ego(
            self.dataset, row, size, global_from_ego, global_from_own_ego, ego_motion=motion
        )
        return Source(*camera, own_car_of(self.own_cars, self.dataset.sensor_of(row).channel, size))

    def _boxes(self, unit: Unit, global_from_ego: Float) -> tuple[Float, Float]:
        rows = self.dataset.annotations(unit.sample.token)
        poses = [relative(global_from_ego, self.dataset.global_from_box(row)) for row in rows]
        sizes = np.array([row.size for row in rows], dtype=np.float64).reshape(-1, 3)
        return np.array(poses, dtype=np.float64).reshape(-1, 4, 4), sizes

    @property
    def picture_count(self) -> int:
        """Virtual pictures that will be written."""
        return (len(self.units) + len(self.sweeps)) * len(self.rig.cameras)

    def estimated_bytes(self, moments: int | None = None) -> int:
        """Disk that pictures, masks and tables will take, roughly; files that go along not counted.

        Args:
            moments: how many of them are still to be converted; all where None.
        """
        moments = len(self.units) + len(self.sweeps) if moments is None else moments
        pictures = moments * len(self.rig.cameras)
        pixels = sum(camera.lens.width_px * camera.lens.height_px for camera in self.rig.cameras)
        masks = _MASK_BYTES * pictures if self.options.masks == "frame" else 0
        tables = self.dataset.sample_annotation.size_bytes + _ROW_BYTES * self.picture_count
        return jpeg_bytes(pixels, self.options.quality) * moments + masks + tables


def make_plan(dataset: Dataset, rig: Rig, options: Options, common: Common | None = None) -> Plan:
    """Plans a conversion, and refuses what cannot be converted before anything is written.

    Args:
        common: a fleet whose common coverage is to be shown; the dataset's own rig joins it, unless it is there.

    Raises:
        DatasetError: dangling tokens, broken poses or calibrations, missing pictures, no samples.
        RigError, UsageError: a rig or an option that does not fit the dataset.
    """
    _check_layout(dataset, options)
    _check_channels(dataset, rig)
    toolchain = choose_toolchain(options.kernel, options.codec)
    surfaces = [view.half_ball for view in virtual_views(rig, options.depth_limit_m, options.ground_height_m)]
    notes = list(dataset.notes)
    if is_converted(dataset.root):
        notes.append(
            "The source was itself written by unidrive convert, and what is black there counts as seen: convert the "
            "dataset that it was made from instead."
        )
    with ThreadPoolExecutor(1) as threads:
        decoding = threads.submit(lambda: dataset.keyframes)
        notes.extend(_mended_links(dataset))
        rotations = check_poses(dataset)
        notes.extend(_scaled(dataset, rotations))
        _check_filenames(dataset, output_version(dataset, options))
        decoding.result()
    channels = set(dataset.camera_channels(options.cameras))
    taken: Counter[str] = Counter()
    units = list(itertools.islice(_units(dataset, rig, options, channels, taken), options.max_samples))
    if not units:
        raise DatasetError("holds no samples to convert.", where=str(dataset.folder))
    if not any(unit.sources for unit in units):
        raise DatasetError("holds no camera key frames to render from.", where=str(dataset.folder))
    own_cars = read_own_cars(Path(options.source_mask), dataset) if options.source_mask else {}
    own_rig_notes: list[str] = []
    if common:
        common, own_rig_notes = with_own_rig(common, dataset, options, scene_names(units))
    if options.min_coverage and options.low_coverage == "drop-camera":
        whole = rig
        rig, more = covered_rig(dataset, whole, [unit.sources for unit in units], options, common, own_cars)
        notes.extend(more)
        units = [_through(unit, whole, rig) for unit in units]
    notes.extend(_source_notes(dataset, units, channels, surfaces))
    notes.extend(consumer_notes(rig, dataset))
    notes.extend(own_rig_notes)
    sweeps: list[Sweep] = []
    if options.sweeps:
        sweeps, more = _sweeps(dataset, rig, options, units, sorted(channels), taken)
        notes.extend(more)
    names = OutputNames(dataset, output_version(dataset, options), keep_layout=options.keep_layout)
    plan = Plan(dataset, rig, options, toolchain, units, notes, names, common, sweeps, own_cars, rotations)
    _check_cameras(plan)
    if options.masks == "camera":
        plan.source_rig  # noqa: B018 - refused before anything is written
    if plan.common_masks:
        shares = zip(rig.channels, plan.common_masks.shares, strict=True)
        notes.extend(
            f"Nothing of {channel} is common: its pictures are black." for channel, share in shares if not share
        )
    return plan


def output_version(dataset: Dataset, options: Options) -> str:
    """The version folder of the output: the one that was asked for, or what the source's layout makes of its own."""
    if options.keep_layout:
        return dataset.version
    return options.output_version or dataset.layout.output_version(dataset.version)


def _check_layout(dataset: Dataset, options: Options) -> None:
    if options.keep_layout and not dataset.layout.can_be_kept:
        able = ", ".join(layout.title for layout in LAYOUTS if layout.can_be_kept)
        raise UsageError(
            f"--keep-layout: {dataset.folder} is in the layout of {dataset.layout.title}; {able} alone can be kept.",
            hint="--output-version chooses the version folder of the output.",
        )


def _through(unit: Unit, whole: Rig, rig: Rig) -> Unit:
    """A unit of a rig for what remains of it."""
    pictures = dict(zip(whole.channels, unit.pictures, strict=True))
    return replace(unit, pictures=tuple(pictures[channel] for channel in rig.channels))


def scene_names(units: Iterable[Unit]) -> tuple[str, ...]:
    """The scenes that samples are of, in their order."""
    return tuple(dict.fromkeys(unit.scene.name for unit in units))


def _scaled(dataset: Dataset, rotations: Rotations) -> list[str]:
    """A sentence for each table with rotations that are no unit quaternions."""
    sentences = []
    for name, of_rows in rotations.items():
        (first,) = getattr(dataset, name).rows_at(np.array([min(of_rows)]))
        sentences.append(
            f"Rotations of {name}.json that are not of unit length: {len(of_rows):,}, the first of token "
            f"{first.token}. Each is taken, and written, as the unit quaternion of its direction."
        )
    return sentences


def _mended_links(dataset: Dataset) -> list[str]:
    """A sentence where links point outside of the dataset and need not."""
    mended = []
    for finding in check_references(dataset):
        if finding.error:
            raise DatasetError(finding.what, where=finding.where, hint="The dataset is incomplete or broken.")
        mended.append(finding)
    if not mended:
        return []
    return [
        f"{len(mended)} list links point outside of the dataset and are closed in the output "
        f"(the first: {mended[0].where} {mended[0].what[:-1]})."
    ]


def consumer_notes(rig: Rig, dataset: Dataset) -> list[str]:
    """What off-the-shelf trainers will stumble over with this rig, one sentence each (docs/output.md)."""
    notes = []
    if not has_standard_channels(rig):
        notes.append(
            f"The rig has {len(rig.cameras)} cameras ({', '.join(rig.channels)}): BEVDet, PETR, BEVFormer and "
            "mmdetection3d expect the six nuScenes channels and must be told (TRAINING.md)."
        )
    sizes = {(camera.lens.width_px, camera.lens.height_px) for camera in rig.cameras}
    if len(sizes) > 1:
        notes.append("The virtual cameras have several picture sizes: trainers that stack pictures need one.")
    elif sizes != {STANDARD_SIZE_PX}:
        width, height = sizes.pop()
        notes.append(f"Pictures are {width}x{height}: trainers that assume 1600x900 must be told (TRAINING.md).")
    return [*notes, *lidar_notes(dataset)]


def has_standard_channels(rig: Rig) -> bool:
    """Whether the cameras carry nuScenes' six names, which trainers expect."""
    return sorted(rig.channels) == sorted(STANDARD_CHANNELS)


def lidar_notes(dataset: Dataset) -> list[str]:
    """A sentence where the dataset has no LIDAR_TOP."""
    if LIDAR_REFERENCE in {row.channel for row in dataset.sensor.rows}:
        return []
    return [f"The source has no {LIDAR_REFERENCE}: most trainers and the devkit's evaluation need one."]


def _check_channels(dataset: Dataset, rig: Rig) -> None:
    others = {row.channel for row in dataset.sensor.rows if row.modality != "camera"}
    for channel in rig.channels:
        if channel in others:
            raise RigError(f"{channel} is a channel of another sensor in {dataset.folder}.", where=rig.name)
    rig.check_folders(others)


def _check_filenames(dataset: Dataset, version: str) -> None:
    """Every file that goes along: inside the dataset, and under no name that the output needs for itself.

    The pictures that are rendered are checked with their units.
    """
    reserved = {*RESERVED, version}

    def check(filename: str, where: Callable[[], str]) -> None:
        try:
            dataset.files.resolve(filename, "")
        except DatasetError as error:
            raise DatasetError(error.what, where=where()) from error
        if filename.partition("/")[0] in reserved:
            raise DatasetError(f"{filename[:80]!r} is a name that the output needs for itself.", where=where())

    rows = dataset.sample_data.names_to_check(np.flatnonzero(~dataset.of_cameras), dataset.files.has_links)
    for filename, where in named_files(dataset, rows):
        check(filename, where)
    for place, filename in dataset.layout.further_files(dataset.sample_data, np.flatnonzero(~dataset.of_cameras)):
        check(filename, place.strip)
    for name in dataset.layout.top_files:
        check(name, str(dataset.root / name).strip)
    check_carried_folders(dataset)


def moments_by_scene(units: Sequence[Unit], sweeps: Sequence[Sweep]) -> list[list[Moment]]:
    """Units of work of each scene, in the order of time."""
    by_scene: dict[str, list[Moment]] = {}
    for unit in units:
        by_scene.setdefault(unit.scene.token, []).append(unit)
    for scene, own in itertools.groupby(sweeps, key=lambda sweep: sweep.scene.token):
        by_scene[scene] = sorted([*by_scene.get(scene, []), *own], key=lambda moment: moment.timestamp)
    return list(by_scene.values())


def _units(dataset: Dataset, rig: Rig, options: Options, channels: set[str], taken: Counter[str]) -> Iterator[Unit]:
    stems = _stems(dataset)
    number = 0
    for scene in scenes_of(dataset, options.scenes, options.splits):
        stem = stems[scene.token]
        for sample in dataset.samples_of_scene[scene.token]:
            reference = reference_of(dataset, sample)
            if not abs(reference.timestamp) < MAX_TIMESTAMP:
                place = dataset.sample_data.place(reference, "timestamp")
                raise DatasetError(f"{reference.timestamp:g} is no time in microseconds.", where=place)
            timestamp = _moment_name(taken, stem, reference.timestamp)
            cameras = cameras_of(dataset, sample, reference)
            yield Unit(
                scene,
                sample,
                reference,
                tuple(cameras.values()),
                tuple(row for channel, row in cameras.items() if channel in channels),
                tuple(
                    dataset.layout.picture_name(channel, number)
                    if options.keep_layout
                    else f"samples/{channel}/{stem}__{channel}__{timestamp}.jpg"
                    for channel in rig.channels
                ),
            )
            number += 1


def _stems(dataset: Dataset) -> dict[str, str]:
    """How the names of a scene's pictures begin, by the scene's token."""
    logfiles = {row.token: row.logfile for row in dataset.log.rows}
    return {row.token: _file_stem(logfiles.get(row.log_token, "") or row.name) for row in dataset.scene.rows}


def _moment_name(taken: Counter[str], stem: str, timestamp: Timestamp) -> str:
    """A timestamp as part of file names, made unique among those that begin with the stem."""
    name = str(round(timestamp))
    key = (stem + name).lower()  # on some disks names that differ by case are one
    taken[key] += 1
    return name if taken[key] == 1 else f"{name}-{taken[key]}"


def _sweeps(
    dataset: Dataset,
    rig: Rig,
    options: Options,
    units: Sequence[Unit],
    channels: Sequence[str],
    taken: Counter[str],
) -> tuple[list[Sweep], list[str]]:
    """The sweeps of the units' scenes, and notes."""
    scenes = [list(own) for _, own in itertools.groupby(units, key=lambda unit: unit.scene.token)]
    groups, left = group_sweeps(dataset, channels, [_key_frames(dataset, own) for own in scenes])
    notes = [f"Camera sweeps that do not fit in with others in time, and are left out: {left:,}."] if left else []
    incomplete = np.count_nonzero((groups.cameras < 0).any(axis=1))
    if incomplete:
        notes.append(
            f"{incomplete:,} of {len(groups.leads):,} sweeps lack some of the cameras {', '.join(channels)}; what "
            "nothing else shows stays black."
        )
    if not len(groups.leads):
        notes.append("The source has no camera sweeps: there is nothing to render between its key frames.")
    tokens = dict(_decoded(dataset, groups.leads, "token"))
    times = dict(_decoded(dataset, groups.references, "timestamp"))
    stems = _stems(dataset)
    sweeps = []
    for number, (place, lead, reference, rows) in enumerate(
        zip(*(part.tolist() for part in groups), strict=True), start=len(units)
    ):
        unit, timestamp = units[place], times[reference]
        stem = stems[unit.scene.token]
        name = f"{CHANNEL}__{_moment_name(taken, stem, timestamp)}.jpg"
        sources = tuple(row for row in rows if row >= 0)
        sweeps.append(
            Sweep(
                SWEEP + tokens[lead],
                unit.scene,
                unit.sample,
                timestamp,
                reference,
                sources,
                dataset.layout.picture_name(CHANNEL, number)
                if options.keep_layout
                else f"sweeps/{CHANNEL}/{stem}__{name}",
                rig.channels,
            )
        )
    return sweeps, notes


def _decoded(dataset: Dataset, rows: Indices, field: str) -> Iterator[tuple[int, Any]]:
    """A field of some sample_data rows, by the row's index."""
    rows = np.sort(rows)
    for index, row in zip(rows.tolist(), dataset.sample_data.rows_at(rows), strict=True):
        yield index, getattr(row, field)


def _key_frames(dataset: Dataset, units: Sequence[Unit]) -> KeyFrames:
    """The key frames of a scene; a camera's lag is the median of those that it has."""
    lags: dict[str, list[float]] = {}
    for unit in units:
        for row in unit.sources:
            lags.setdefault(dataset.sensor_of(row).channel, []).append(row.timestamp - unit.timestamp)
    sensor = dataset.sensor_of(units[0].reference)
    return KeyFrames(
        [unit.sample for unit in units],
        np.array([unit.timestamp for unit in units], dtype=np.float64),
        sensor.channel if sensor.modality == "lidar" else "",
        {channel: float(np.median(own)) for channel, own in lags.items()},
    )


def _check_cameras(plan: Plan) -> None:
    """Every calibration, every picture's presence, and one picture's size per calibration."""
    dataset, seen = plan.dataset, set()
    stop = plan.options.on_error == "stop"
    swept = np.sort(np.fromiter((row for sweep in plan.sweeps for row in sweep.rows), dtype=np.int64))
    key_frames = (row for unit in plan.units for row in unit.sources)
    for row in itertools.chain(key_frames, dataset.sample_data.rows_at(swept)):
        place = dataset.sample_data.place(row, "filename")
        if stop:
            _refuse_missing(dataset, row, place)
        else:
            dataset.files.locate(row.filename, place)
        calibration = (row.calibrated_sensor_token, row.width, row.height)
        if calibration in seen:
            continue
        seen.add(calibration)
        if stop or (row.width and row.height):
            size = picture_size_of(dataset, row, size_of_file)
            lens_and_pose(dataset, row, size)
            own_car_of(plan.own_cars, dataset.sensor_of(row).channel, size)
            if stop:
                path = dataset.path_of(row)
                check_size(read_head(path, SKIP_HINT), size, str(path))


def _refuse_missing(dataset: Dataset, row: SampleData, place: str) -> None:
    try:
        status = dataset.files.look_at(row.filename, place)
        if stat.S_ISREG(status.st_mode) and status.st_size > 0:
            return
        what = "is empty" if stat.S_ISREG(status.st_mode) else "is no file"
    except FileNotFoundError:
        what = "is missing"
    except OSError as error:
        what = f"cannot be read: {error.strerror}"
    raise PictureError(f"the picture {dataset.path_of(row)} {what}.", where=place, hint=SKIP_HINT)


def _source_notes(dataset: Dataset, units: list[Unit], channels: set[str], surfaces: list[HalfBall]) -> list[str]:
    notes = []
    incomplete = sum(len(unit.sources) < len(channels) for unit in units)
    if incomplete:
        notes.append(
            f"{incomplete} of {len(units)} samples lack some of the cameras {', '.join(sorted(channels))}; "
            "what nothing else shows stays black."
        )
    used = {row.calibrated_sensor_token for unit in units for row in unit.sources}
    outside = {
        dataset.sensor_of_calibration[row.token].channel
        for row in dataset.calibrated_sensor.rows
        if row.token in used and not all(surface.contains(np.array(row.translation)) for surface in surfaces)
    }
    if outside:
        notes.append(
            f"The source's {', '.join(sorted(outside))} stand outside of the assumed scene (below the ground, or "
            "farther than the depth limit from a virtual camera); check --ground-height and --depth-limit."
        )
    return notes


def _file_stem(name: str) -> str:
    """A log or scene name as part of a file name."""
    stem = re.sub(r"[^A-Za-z0-9._+\-]", "-", name)[:120].lstrip(".-")
    return stem or "scene"
