"""The virtual projection error over datasets (UniDrive section 3.3): where the warp puts box corners, and where they
are. docs/measure.md says what is counted."""

from __future__ import annotations

import functools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
import numpy.typing as npt

from unidrive_cli.errors import DatasetError, UsageError
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.geometry.poses import inverse
from unidrive_cli.geometry.projection_error import Indices, point_errors
from unidrive_cli.geometry.scene import HalfBall
from unidrive_cli.measure.corners import CORNERS, BoxCorners, Corners
from unidrive_cli.rig.model import Rig
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.schema import Sample
from unidrive_cli.warp.choices import WarpChoices
from unidrive_cli.warp.pictures import size_of_file
from unidrive_cli.warp.remap import virtual_views
from unidrive_cli.workers import in_workers

SCHEMA_VERSION = 1
BAND_M = 10
BANDS = 7
"""Distance bands of `BAND_M` metres from the virtual camera; the last has no end."""
CELL_M = 2.0
CELLS = 60
"""The top view: `CELLS` by `CELLS` squares of `CELL_M`, the car's origin in their middle."""
UNKNOWN_CLASS = "unknown"

_BATCHES_AT_ONCE = 32
_BATCHES_FOR_WORKERS = 4
_DIGITS = 9

Numbers = npt.NDArray[np.int16]
Progress = Callable[[int, int], None]
"""Called with (finished samples, all samples)."""


@dataclass(frozen=True)
class Spread:
    """What errors, in metre-radians, come to; the last three are None where there are none."""

    count: int
    sum: float
    mean: float | None
    median: float | None
    p90: float | None

    @classmethod
    def of(cls, errors: Float) -> Spread:
        """Of errors (n,)."""
        if not len(errors):
            return cls(0, 0.0, None, None, None)
        total = float(errors.sum())
        median, p90 = np.quantile(errors, [0.5, 0.9]).tolist()
        return cls(len(errors), total, total / len(errors), median, p90)

    def document(self, *, with_sum: bool = True) -> dict[str, Any]:
        """The object of `measure --json`."""
        numbers = {"mean": self.mean, "median": self.median, "p90": self.p90}
        if with_sum:
            numbers = {"sum": self.sum, **numbers}
        rounded = {name: None if number is None else round(number, _DIGITS) for name, number in numbers.items()}
        return {"count": self.count, **rounded}


@dataclass(frozen=True)
class Uncovered:
    """Of the `of` corners that a source sees, the `count` that no virtual camera sees."""

    count: int
    of: int

    def document(self) -> dict[str, int]:
        """The object of `measure --json`."""
        return {"count": self.count, "of": self.of}


@dataclass(frozen=True)
class Errors:
    """The errors of some corners, cameras or distances.

    Attributes:
        pairs: one error for every (corner, source, virtual camera) that sees the corner.
        blended: one for every (corner, virtual camera): the pairs' mean by the sources' shares of the blend. None
            where it cannot be told apart (by source).
        uncovered: None where it cannot be told apart (by camera, source or distance).
        behind: pairs that are left out, because the warp puts their corner behind the virtual camera. None where
            it cannot be told apart (by source, class or distance).
    """

    pairs: Spread
    blended: Spread | None = None
    uncovered: Uncovered | None = None
    behind: int | None = None

    def document(self) -> dict[str, Any]:
        """The object of `measure --json`."""
        found: dict[str, Any] = {"pairs": self.pairs.document()}
        if self.blended is not None:
            found["blended"] = self.blended.document(with_sum=False)
        if self.uncovered is not None:
            found["uncovered"] = self.uncovered.document()
        if self.behind is not None:
            found["behind"] = self.behind
        return found


@dataclass(frozen=True, eq=False)
class TopView:
    """Blended errors by where the corners are, seen from above.

    Attributes:
        count, sum: (CELLS, CELLS) of the blended errors, by x (forward) and y (left) in the car's frame at the
            sample's reference; the first square begins at -CELLS * CELL_M / 2.
        beyond: blended errors of corners that lie outside.
    """

    count: npt.NDArray[np.int64]
    sum: Float
    beyond: int


@dataclass(frozen=True, eq=False)
class ProjectionReport:
    """The virtual projection error of a rig on annotated datasets, metre-radians.

    Attributes:
        rig, choices: of the virtual cameras; of the choices, `blend` does not count.
        overall: all corners of all datasets.
        by_camera: by virtual channel, in the rig's order.
        by_source: by the sources' channels, in alphabetical order.
        by_class: by category name, in alphabetical order, of the corners that a source sees.
        by_distance: by distance from the virtual camera: BANDS bands of BAND_M metres, the last without end.
        by_dataset: by version folder, in the order given.
        top_view: where the errors are.
        samples, boxes: that have been measured.
        notes: what a user should know, one sentence each.
    """

    rig: Rig
    choices: WarpChoices
    overall: Errors
    by_camera: dict[str, Errors]
    by_source: dict[str, Errors]
    by_class: dict[str, Errors]
    by_distance: list[Errors]
    by_dataset: dict[str, Errors]
    top_view: TopView
    samples: int
    boxes: int
    notes: list[str]

    def document(self) -> dict[str, Any]:
        """The object that `measure --json` prints."""
        groups = {
            name: {key: errors.document() for key, errors in group.items()}
            for name, group in (
                ("by_camera", self.by_camera),
                ("by_source", self.by_source),
                ("by_class", self.by_class),
                ("by_dataset", self.by_dataset),
            )
        }
        bands = [
            {"from_m": low, "to_m": high, **errors.document()}
            for (low, high), errors in zip(distance_bands(), self.by_distance, strict=True)
        ]
        return {
            "schema_version": SCHEMA_VERSION,
            **self.overall.document(),
            **groups,
            "by_distance": bands,
            "measured": {"samples": self.samples, "boxes": self.boxes},
            "rig": {"name": self.rig.name, "digest": self.rig.digest},
            "depth_limit_m": self.choices.depth_limit_m,
            "ground_height_m": self.choices.ground_height_m,
            "ego_motion": self.choices.ego_motion,
            "notes": self.notes,
        }


def distance_bands() -> list[tuple[int, int | None]]:
    """Where each band of `by_distance` begins and ends, metres; the last has no end."""
    return [(band * BAND_M, (band + 1) * BAND_M if band < BANDS - 1 else None) for band in range(BANDS)]


def measure_projection(
    datasets: Sequence[Dataset],
    rig: Rig,
    choices: WarpChoices,
    *,
    scenes: Sequence[str] = (),
    cameras: Sequence[str] = (),
    jobs: int = 0,
    progress: Progress | None = None,
) -> ProjectionReport:
    """Measures where the warp into a virtual rig puts the corners of annotated boxes, against where they are.

    Args:
        datasets: their errors are pooled, and told apart.
        choices: depth limit, ground height and ego motion; `blend` does not count, shares are those of `angular`.
        scenes, cameras: names of scenes, and channels of the sources; all where empty. Each must be in one of the
            datasets.
        jobs: processes; 0 and small datasets are worked on in this one. The result does not depend on it.
        progress: told after every few samples.

    Raises:
        UsageError: an unknown scene or camera, a dataset that is given twice, a negative `jobs`, or a source
            outside of a virtual camera's half-ball.
        RigError: a virtual camera with lens distortion or below the ground, or a depth limit below its height.
        DatasetError: no boxes, boxes that no camera sees, or tables that cannot be used.
    """
    if jobs < 0:
        raise UsageError(f"--jobs must be 0 or more, got {jobs}.")
    for folder, times in Counter(str(dataset.folder) for dataset in datasets).items():
        if times > 1:
            raise UsageError(f"{folder} is given {times} times; its boxes would count as often.")
    views = [
        _View(view.camera.pinhole, view.camera.ego_from_cam, view.half_ball)
        for view in virtual_views(rig, choices.depth_limit_m, choices.ground_height_m)
    ]
    notes: list[str] = []
    chosen = [
        _chosen(dataset, scenes_here, cameras_here, notes)
        for dataset, scenes_here, cameras_here in _asked(datasets, scenes, cameras)
    ]
    total = sum(len(samples) for _, samples, _ in chosen)
    names = _Names(
        rig.channels,
        sorted({channel for _, _, channels in chosen for channel in channels}),
        sorted({row.name for dataset in datasets for row in dataset.category.rows} | {UNKNOWN_CLASS}),
    )
    sums = _Sums(names, [str(dataset.folder) for dataset in datasets])
    done = 0
    for place, (dataset, samples, channels) in enumerate(chosen):
        batches = _batches(dataset, samples, channels, choices, views, names)
        measured = 0
        for found in _measured(views, batches, jobs):
            sums.add(place, found)
            measured += found.samples
            if progress:
                progress(done + measured, total)
        if measured < len(samples):
            notes.append(
                f"{len(samples) - measured} of {len(samples)} samples of {dataset.folder} have no boxes or no "
                "pictures of the chosen cameras, and are left out."
            )
        done += len(samples)
        if progress:
            progress(done, total)
    where = ", ".join(str(dataset.folder) for dataset in datasets)
    if not sums.boxes:
        raise DatasetError(
            f"the {total} chosen samples have no annotated boxes with pictures.",
            where=where,
            hint="The projection error is measured on the corners of 3D boxes.",
        )
    if not sums.seen.sum():
        raise DatasetError(
            f"no camera sees any of the {CORNERS * sums.boxes:,} corners of the {sums.boxes:,} boxes.",
            where=where,
            hint="Check the poses of cameras and boxes, or choose other cameras.",
        )
    return sums.report(rig, choices, notes)


@dataclass(frozen=True)
class _View:
    """A virtual camera."""

    lens: Pinhole
    ego_from_cam: Float
    half_ball: HalfBall


@dataclass(frozen=True)
class _Names:
    """What the numbers of groups stand for."""

    cameras: Sequence[str]
    sources: Sequence[str]
    classes: Sequence[str]


@dataclass(frozen=True, eq=False)
class _Batch:
    """Corners, with the numbers of their classes (n,) and of their cameras."""

    corners: Corners
    classes: Indices
    sources: Indices


@dataclass(frozen=True, eq=False)
class _Columns:
    """Errors (m,) and the group (m,) of each, by the name of the grouping."""

    errors: Float
    groups: dict[str, Numbers]


@dataclass(frozen=True, eq=False)
class _Found:
    """What one batch comes to: `seen` and `uncovered` corners by class, `behind` by virtual camera."""

    pairs: _Columns
    blended: _Columns
    seen: Indices
    uncovered: Indices
    behind: Indices
    top_view: TopView
    samples: int
    boxes: int


def _asked(
    datasets: Sequence[Dataset], scenes: Sequence[str], cameras: Sequence[str]
) -> Iterator[tuple[Dataset, list[str], list[str]]]:
    """Each dataset with those of the names that it has; a name that none has is refused."""
    has_scenes = [{row.name for row in dataset.scene.rows} for dataset in datasets]
    has_cameras = [set(dataset.camera_channels()) for dataset in datasets]
    for dataset in datasets[:1]:
        dataset.scenes_named([name for name in scenes if not any(name in known for known in has_scenes)])
        dataset.camera_channels([name for name in cameras if not any(name in known for known in has_cameras)])
    for dataset, known_scenes, known_cameras in zip(datasets, has_scenes, has_cameras, strict=True):
        yield (
            dataset,
            [name for name in scenes if name in known_scenes],
            [name for name in cameras if name in known_cameras],
        )


def _chosen(
    dataset: Dataset, scenes: Sequence[str], cameras: Sequence[str], notes: list[str]
) -> tuple[Dataset, list[Sample], list[str]]:
    notes.extend(f"{dataset.folder}: {note}" for note in dataset.notes)
    named = dataset.scenes_named(scenes)
    samples = [sample for scene in named for sample in dataset.samples_of_scene[scene.token]]
    return dataset, samples, dataset.camera_channels(cameras)


def _batches(
    dataset: Dataset,
    samples: Sequence[Sample],
    channels: Sequence[str],
    choices: WarpChoices,
    views: Sequence[_View],
    names: _Names,
) -> Iterator[_Batch]:
    rows = [row.name for row in dataset.category.rows]
    class_of_row = np.array([names.classes.index(name) for name in [*rows, UNKNOWN_CLASS]])
    reader = BoxCorners(dataset, channels, ego_motion=choices.ego_motion, size_of_file=size_of_file)
    for corners in reader.of(samples):
        _refuse_outside(dataset, corners, names.cameras, views)
        sources = np.array([names.sources.index(camera.channel) for camera in corners.cameras])
        yield _Batch(corners, class_of_row[corners.category], sources)


def _refuse_outside(dataset: Dataset, corners: Corners, channels: Sequence[str], views: Sequence[_View]) -> None:
    """Refuses sources that stand where the rays have no single scene point."""
    for source in corners.cameras:
        centres = np.array([inverse(cam_from_ego)[:3, 3] for cam_from_ego in source.cam_from_ego])
        for channel, view in zip(channels, views, strict=True):
            outside = np.flatnonzero(~view.half_ball.contains(centres))
            if not len(outside):
                continue
            centre = centres[outside[0]]
            height_m = float(view.half_ball.ground.height_m(centre))
            apart_m = float(np.linalg.norm(centre - view.half_ball.centre_ego))
            place = f"{-height_m:.2f} m below the ground" if height_m < 0 else f"{apart_m:.2f} m away"
            raise UsageError(
                f"the camera {source.channel} stands outside of the scene that the virtual camera {channel} assumes "
                f"(above the ground, within {view.half_ball.radius_m:g} m): {place}.",
                where=f"{dataset.folder}, sample {corners.samples[outside[0]]}",
                hint="Check --ground-height and --depth-limit, or choose other cameras with --camera.",
            )


def _measured(views: Sequence[_View], batches: Iterable[_Batch], jobs: int) -> Iterator[_Found]:
    """What the batches come to, in their order. Tables are read in this process, some batches ahead."""
    waiting = iter(batches)
    while some := list(islice(waiting, _BATCHES_AT_ONCE)):
        if jobs < 2 or len(some) < _BATCHES_FOR_WORKERS:
            yield from (_measure(views, batch) for batch in some)
        else:
            done = in_workers(functools.partial(_numbered, views), enumerate(some), min(jobs, len(some)))
            yield from (found for _, found in sorted(done, key=lambda outcome: outcome[0]))


def _numbered(views: Sequence[_View], item: tuple[int, _Batch]) -> tuple[int, _Found]:
    number, batch = item
    return number, _measure(views, batch)


def _measure(views: Sequence[_View], batch: _Batch) -> _Found:
    corners, classes = batch.corners, batch.classes
    sightings = corners.sightings()
    seen, shown = np.zeros(len(classes), dtype=bool), np.zeros(len(classes), dtype=bool)
    for sighting in sightings:
        seen[sighting.points] = True
    pairs, blended, behind = [], [], []
    points = []
    for number, view in enumerate(views):
        found = point_errors(corners.points_ego, sightings, view.lens, view.ego_from_cam, view.half_ball)
        shown[found.seen] = True
        behind.append(found.behind)
        distance_m = np.empty(len(classes))
        distance_m[found.point] = found.distance_m
        columns = {"camera": number, "class": classes[found.point], "distance": _band(found.distance_m)}
        pairs.append(_columns(found.error_m_rad, {**columns, "source": batch.sources[found.source]}))
        point, errors = found.blended()
        points.append(point)
        columns = {"camera": number, "class": classes[point], "distance": _band(distance_m[point])}
        blended.append(_columns(errors, columns))
    all_blended = _joined(blended)
    count = int(classes.max()) + 1
    return _Found(
        _joined(pairs),
        all_blended,
        np.bincount(classes[seen], minlength=count),
        np.bincount(classes[seen & ~shown], minlength=count),
        np.array(behind),
        _top_view(corners.points_ego[np.concatenate(points)], all_blended.errors),
        len(corners.samples),
        len(classes) // CORNERS,
    )


def _band(distance_m: Float) -> Indices:
    return np.minimum(distance_m // BAND_M, BANDS - 1).astype(np.intp)


def _columns(errors: Float, groups: dict[str, Any]) -> _Columns:
    shape = errors.shape
    return _Columns(errors, {name: np.broadcast_to(group, shape).astype(np.int16) for name, group in groups.items()})


def _joined(parts: Sequence[_Columns]) -> _Columns:
    names = parts[0].groups
    return _Columns(
        np.concatenate([part.errors for part in parts]),
        {name: np.concatenate([part.groups[name] for part in parts]) for name in names},
    )


def _top_view(points_ego: Float, errors: Float) -> TopView:
    cell = np.floor(points_ego[:, :2] / CELL_M).astype(np.int64) + CELLS // 2
    inside = ((cell >= 0) & (cell < CELLS)).all(axis=1)
    place = cell[inside, 0] * CELLS + cell[inside, 1]
    total = np.asarray(np.bincount(place, errors[inside], CELLS * CELLS), dtype=np.float64)
    return TopView(
        np.bincount(place, minlength=CELLS * CELLS).reshape(CELLS, CELLS),
        total.reshape(CELLS, CELLS),
        int(np.count_nonzero(~inside)),
    )


class _Sums:
    """Gathers what the batches come to."""

    def __init__(self, names: _Names, datasets: Sequence[str]) -> None:
        self._names = names
        self._datasets = datasets
        self._pairs: list[_Columns] = []
        self._blended: list[_Columns] = []
        shape = len(datasets), len(names.classes)
        self.seen = np.zeros(shape, dtype=np.int64)
        self._uncovered = np.zeros(shape, dtype=np.int64)
        self._behind = np.zeros((len(datasets), len(names.cameras)), dtype=np.int64)
        self._top_view = TopView(np.zeros((CELLS, CELLS), dtype=np.int64), np.zeros((CELLS, CELLS)), 0)
        self._samples = 0
        self.boxes = 0

    def add(self, dataset: int, found: _Found) -> None:
        for columns, kept in ((found.pairs, self._pairs), (found.blended, self._blended)):
            kept.append(_columns(columns.errors, {**columns.groups, "dataset": dataset}))
        self.seen[dataset, : len(found.seen)] += found.seen
        self._uncovered[dataset, : len(found.uncovered)] += found.uncovered
        self._behind[dataset] += found.behind
        self._top_view = TopView(
            self._top_view.count + found.top_view.count,
            self._top_view.sum + found.top_view.sum,
            self._top_view.beyond + found.top_view.beyond,
        )
        self._samples += found.samples
        self.boxes += found.boxes

    def report(self, rig: Rig, choices: WarpChoices, notes: list[str]) -> ProjectionReport:
        names, pairs, blended = self._names, _joined(self._pairs), _joined(self._blended)
        self._pairs, self._blended = [], []

        def by(group: str, count: int) -> Iterator[tuple[Spread, Spread]]:
            return zip(_spreads(pairs, group, count), _spreads(blended, group, count), strict=True)

        def uncovered(at: Any) -> Uncovered:
            return Uncovered(int(self._uncovered[at].sum()), int(self.seen[at].sum()))

        cameras, classes, datasets = (
            list(by(group, len(these)))
            for group, these in (("camera", names.cameras), ("class", names.classes), ("dataset", self._datasets))
        )
        sources = _spreads(pairs, "source", len(names.sources))
        return ProjectionReport(
            rig,
            choices,
            Errors(
                Spread.of(pairs.errors), Spread.of(blended.errors), uncovered(...), behind=int(self._behind.sum())
            ),
            {
                name: Errors(*cameras[place], behind=int(self._behind[:, place].sum()))
                for place, name in enumerate(names.cameras)
            },
            {name: Errors(spread) for name, spread in zip(names.sources, sources, strict=True)},
            {
                name: Errors(*classes[place], uncovered=uncovered((slice(None), place)))
                for place, name in enumerate(names.classes)
                if self.seen[:, place].any()
            },
            [Errors(*spreads) for spreads in by("distance", BANDS)],
            {
                name: Errors(*datasets[place], uncovered(place), int(self._behind[place].sum()))
                for place, name in enumerate(self._datasets)
            },
            self._top_view,
            self._samples,
            self.boxes,
            notes,
        )


def _spreads(columns: _Columns, group: str, count: int) -> list[Spread]:
    """The spread of each of `count` groups."""
    numbers = columns.groups[group]
    order = np.argsort(numbers, kind="stable")
    errors = columns.errors[order]
    ends = np.searchsorted(numbers[order], np.arange(count + 1))
    return [Spread.of(errors[ends[place] : ends[place + 1]]) for place in range(count)]
