"""Camera pictures between the key frames: which of them were taken together, and when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from unidrive_cli.geometry.arrays import Float
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.schema import Row, Sample, Scene, Timestamp
from unidrive_cli.tables.table import EMPTY, Indices

SWEEP = "sweep "
"""How the tokens of sweeps begin."""
CHANNEL = "{}"
"""Stands for the channel in the name of a sweep's pictures; file names are not made with braces otherwise."""


@dataclass(frozen=True, eq=False, slots=True)
class Sweep:
    """One unit of work: pictures that were taken together between two key frames.

    Attributes:
        token: `SWEEP` and the token of its leading picture.
        scene, sample: the scene, and the sample that follows.
        timestamp: of the row whose time and ego pose the virtual pictures take.
        reference: where in sample_data this row stands.
        rows: where in sample_data the source pictures stand, by channel.
        name: of the pictures, with `CHANNEL` in the place of the virtual cameras' names.
        channels: the virtual cameras.
    """

    token: str
    scene: Scene
    sample: Sample
    timestamp: Timestamp
    reference: int
    rows: tuple[int, ...]
    name: str
    channels: tuple[str, ...]

    @property
    def pictures(self) -> tuple[str, ...]:
        """File name of each virtual picture, in the rig's order."""
        return tuple(self.name.replace(CHANNEL, channel) for channel in self.channels)


class KeyFrames(NamedTuple):
    """The key frames of one scene.

    Attributes:
        samples: in the order of time.
        times: (n,) when their virtual pictures are.
        lidar: the channel whose times and poses they take; empty where it is a camera's.
        lags: how much later than that each camera fires, by channel.
    """

    samples: Sequence[Sample]
    times: Float
    lidar: str
    lags: Mapping[str, float]


class Groups(NamedTuple):
    """Pictures that were taken together, by scene and time; (g,) each, indices of rows.

    Attributes:
        samples: place of the sample that follows, among all that were given.
        leads: the leading picture.
        references: the row whose time and ego pose counts.
        cameras: (g, c) the picture of each channel, or EMPTY.
    """

    samples: Indices
    leads: Indices
    references: Indices
    cameras: Indices


class _Moment(Row, frozen=True, gc=False):
    timestamp: Timestamp


def group_sweeps(dataset: Dataset, channels: Sequence[str], scenes: Sequence[KeyFrames]) -> tuple[Groups, int]:
    """Groups the camera sweeps of some scenes.

    Before each sample the channel with most sweeps leads: each of its pictures makes a group (of two that are
    nearer than a quarter of a period, the first), in which every other channel has the picture that fits best,
    if it does within half a period; each picture is in one group at most. Pictures fit that were taken as far
    from each other in time as they are in the key frames. The row that counts is the lidar sweep that fits
    within half a period too, or the leading picture; a group whose time is a key frame's or another group's is
    none.

    Args:
        channels: of the cameras.

    Returns:
        The groups, and the number of pictures that are in none.

    Raises:
        DatasetError: tokens that lead nowhere, or two rows with one token.
    """
    lidars = sorted({scene.lidar for scene in scenes} - {""})
    places = {channel: place for place, channel in enumerate((*channels, *lidars))}
    rows, sensors = _sweeps_of(dataset, places)
    parts = dataset.sample_data.parts_at(rows, _Moment)
    times = np.fromiter((part.timestamp for part in parts), dtype=np.float64, count=len(rows))
    following = _following(dataset, rows, times, [row.token for scene in scenes for row in scene.samples])
    firsts = np.cumsum([0, *(len(scene.samples) for scene in scenes)])
    order = np.argsort(following, kind="stable")
    order = order[np.searchsorted(following[order], 0) :]
    begins = np.searchsorted(following[order], firsts)
    found = []
    for scene, first, *ends in zip(scenes, firsts.tolist(), begins.tolist(), begins[1:].tolist(), strict=False):
        own = order[slice(*ends)]
        own = own[np.argsort(times[own], kind="stable")]
        groups = _grouped(sensors[own], times[own], following[own] - first, scene, channels, places)
        if groups is not None:
            here = [np.where(part < 0, EMPTY, rows[own][part]) for part in groups[1:]]
            found.append(Groups(groups.samples + first, *here))
    empty, no_cameras = np.zeros(0, dtype=np.int64), np.zeros((0, len(channels)), dtype=np.int64)
    none = Groups(empty, empty, empty, no_cameras)
    joined = Groups(*(np.concatenate(parts) for parts in zip(none, *found, strict=True)))
    cameras = np.count_nonzero((sensors < len(channels)) & (following >= 0))
    return joined, int(cameras - np.count_nonzero(joined.cameras >= 0))


def nearest_pairs(times: Float, others: Float, within: float) -> Indices:
    """(n,) the place in `others` of what is nearest to each time and has it for its own nearest; EMPTY for none.

    Args:
        times, others: ascending.
        within: how far they may be apart.
    """
    if not len(times) or not len(others):
        return np.full(len(times), EMPTY)
    there, back = _nearest(times, others), _nearest(others, times)
    mutual = (back[there] == np.arange(len(times))) & (np.abs(others[there] - times) <= within)
    return np.where(mutual, there, EMPTY)


def _nearest(times: Float, others: Float) -> Indices:
    after = np.searchsorted(others, times)
    before, after = np.maximum(after - 1, 0), np.minimum(after, len(others) - 1)
    return np.where(np.abs(others[after] - times) < np.abs(others[before] - times), after, before)


def _sweeps_of(dataset: Dataset, places: Mapping[str, int]) -> tuple[Indices, Indices]:
    """The rows of some sensors that are no key frames, and the place of each one's channel."""
    sensors = dataset.sensor_of_calibration
    of_calibration = np.array(
        [places.get(sensors[row.token].channel, EMPTY) for row in dataset.calibrated_sensor.rows], dtype=np.int64
    )
    of_row = of_calibration[dataset.sample_data.links("calibrated_sensor_token", dataset.calibrated_sensor)]
    rows = np.flatnonzero((of_row >= 0) & ~dataset.sample_data.flags("is_key_frame"))
    return rows, of_row[rows]


def _following(dataset: Dataset, rows: Indices, times: Float, tokens: Sequence[str]) -> Indices:
    """Where among some samples the one stands that each row belongs to; negative where it is another.

    A row that names no sample belongs to the next one of the scene that was being recorded, or to its last.
    """
    samples = dataset.sample_data.links("sample_token", dataset.sample)[rows]
    nameless = np.flatnonzero(samples == EMPTY)
    if len(nameless) and len(dataset.sample.rows):
        scenes = dataset.sample.links("scene_token", dataset.scene)
        moments = np.array([row.timestamp for row in dataset.sample.rows], dtype=np.float64)
        order = np.argsort(moments, kind="stable")
        after = order[np.minimum(np.searchsorted(moments[order], times[nameless]), len(order) - 1)]
        nearest = order[_nearest(times[nameless], moments[order])]
        samples[nameless] = np.where(scenes[after] == scenes[nearest], after, nearest)
    place = np.full(len(dataset.sample.rows), EMPTY)
    place[dataset.sample.find(tokens)] = np.arange(len(tokens))
    return np.where(samples >= 0, place[np.maximum(samples, 0)], EMPTY)


def _grouped(
    sensors: Indices,
    times: Float,
    samples: Indices,
    scene: KeyFrames,
    channels: Sequence[str],
    places: Mapping[str, int],
) -> Groups | None:
    """The groups of one scene, in indices of its sweeps and samples.

    Args:
        sensors: (n,) place of each sweep's channel.
        times: (n,) ascending.
        samples: (n,) place in the scene of the sample that each belongs to.
    """
    fits = times - np.array([scene.lags.get(channel, 0.0) for channel in places])[sensors]
    cameras = np.flatnonzero(sensors < len(channels))
    counts = np.bincount(
        samples[cameras] * len(channels) + sensors[cameras], minlength=len(scene.samples) * len(channels)
    )
    leading = counts.reshape(-1, len(channels)).argmax(axis=1)
    leads = cameras[sensors[cameras] == leading[samples[cameras]]]
    leads = leads[np.argsort(fits[leads], kind="stable")]
    if not len(leads):
        return None
    half_period = np.median(np.diff(np.sort(np.append(scene.times, fits[leads])))) / 2
    leads = leads[np.diff(fits[leads], prepend=-np.inf) > half_period / 2]

    def fitting(place: int) -> Indices:
        own = np.flatnonzero(sensors == place)
        pairs = nearest_pairs(fits[leads], fits[own], half_period)
        return np.where(pairs < 0, EMPTY, own[pairs]) if len(own) else pairs

    found = np.stack([fitting(place) for place in range(len(channels))], axis=1)
    found[samples[found] != samples[leads, None]] = EMPTY
    lidar = fitting(places[scene.lidar]) if scene.lidar else np.full(len(leads), EMPTY)
    references = np.where(lidar < 0, leads, lidar)
    moments, first = np.unique(times[references], return_index=True)
    stays = first[~np.isin(moments, scene.times)]
    stays = stays[found[stays, sensors[leads[stays]]] == leads[stays]]
    return Groups(samples[leads[stays]], leads[stays], references[stays], found[stays])
