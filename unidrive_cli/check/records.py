"""REC, KEY: what a row says of others must be so."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np

from unidrive_cli.check.finding import Broken
from unidrive_cli.check.subject import Lists, Subject, at
from unidrive_cli.tables.table import EMPTY, Indices, ListedTable

MODALITIES = ("camera", "lidar", "radar")
SPLITS = "splits"


def wrong_sample_counts(subject: Subject) -> Iterator[Broken]:
    """A scene has as many samples as its nbr_samples says.

    Readers that count by it lose samples, or wait for more.
    """
    table, of_scene = subject.dataset.scene, subject.scene_of_sample
    counts = np.bincount(of_scene[of_scene >= 0], minlength=len(table.rows))
    for row, count in zip(table.rows, counts.tolist(), strict=True):
        if row.nbr_samples != count:
            yield table.place(row, "nbr_samples"), f"is {row.nbr_samples}, but the number of its samples is {count}."


def wrong_annotation_counts(subject: Subject) -> Iterator[Broken]:
    """An instance has as many annotations as its nbr_annotations says.

    nuscenes-devkit and trackers believe it.
    """
    if "instance" in subject.missing:
        return
    table, owners = subject.dataset.instance, subject.lists["sample_annotation"].groups
    counts = np.bincount(owners[owners >= 0], minlength=len(table.rows))
    for row, count in zip(table.rows, counts.tolist(), strict=True):
        if row.nbr_annotations != count:
            what = f"is {row.nbr_annotations}, but the number of its annotations is {count}."
            yield table.place(row, "nbr_annotations"), what


def wrong_scene_ends(subject: Subject) -> Iterator[Broken]:
    """A scene's first and last sample are the ends of its list.

    Readers walk from the first sample; those before it are lost.
    """
    yield from _wrong_ends(subject.dataset.scene, "sample", subject.lists["sample"])


def wrong_instance_ends(subject: Subject) -> Iterator[Broken]:
    """An instance's first and last annotation are the ends of its list.

    Readers walk from the first annotation; those before it are lost.
    """
    if "instance" not in subject.missing:
        yield from _wrong_ends(subject.dataset.instance, "annotation", subject.lists["sample_annotation"])


def repeated_scene_names(subject: Subject) -> Iterator[Broken]:
    """Scene names are unique.

    Splits name scenes; both would be meant.
    """
    table = subject.dataset.scene
    counts = Counter(row.name for row in table.rows)
    for row in table.rows:
        if counts[row.name] > 1:
            yield table.place(row, "name"), f"{row.name!r} is the name of {counts[row.name]} scenes."


def repeated_channels(subject: Subject) -> Iterator[Broken]:
    """No two sensors have one channel.

    Readers keep one picture per channel of a sample, and lose the other.
    """
    table = subject.dataset.sensor
    counts = Counter(row.channel for row in table.rows)
    for row in table.rows:
        if counts[row.channel] > 1:
            yield table.place(row, "channel"), f"{row.channel!r} is the channel of {counts[row.channel]} sensors."


def unknown_modalities(subject: Subject) -> Iterator[Broken]:
    """The modality of a sensor is camera, lidar or radar.

    Readers leave such a sensor out, or stop.
    """
    table = subject.dataset.sensor
    for row in table.rows:
        if row.modality not in MODALITIES:
            what = f"is {row.modality!r}; one of {', '.join(MODALITIES)} was expected."
            yield table.place(row, "modality"), what


def scenes_in_no_split(subject: Subject) -> Iterator[Broken]:
    """Every scene is in a split: one of nuscenes-devkit's, or of splits.json in the version folder.

    Evaluation and most trainers leave out, or refuse, a scene that no split names.
    """
    from nuscenes.utils.splits import create_splits_scenes

    known = {name for names in create_splits_scenes().values() for name in names}
    path = subject.folder / f"{SPLITS}.json"
    if path.exists():
        splits = json.loads(path.read_bytes())
        if not isinstance(splits, dict) or not all(isinstance(names, list) for names in splits.values()):
            yield str(path), "must hold a list of scene names for every split."
            return
        known |= {name for names in splits.values() for name in names if isinstance(name, str)}
    table = subject.dataset.scene
    for row in table.rows:
        if row.name not in known:
            what = f"{row.name!r} is in no split of nuscenes-devkit, and {SPLITS}.json does not name it."
            yield table.place(row, "name"), what


def repeated_key_frames(subject: Subject) -> Iterator[Broken]:
    """A sample has one key frame per sensor.

    Readers keep one of several.
    """
    table = subject.dataset.sample_data
    rows = _key_frames(subject)
    _, first = np.unique(_moments(subject, rows), return_index=True)
    for row in table.rows_at(np.delete(rows, first)):
        what = f"sample {row.sample_token} has another key frame of this sensor; one was expected."
        yield table.place(row, "is_key_frame"), what


def missing_key_frames(subject: Subject) -> Iterator[Broken]:
    """A sample has a key frame of every sensor that its scene has.

    BEVDet, PETR, BEVFormer and mmdetection3d stop with a KeyError.
    """
    data, sensors = subject.dataset, len(subject.dataset.sensor.rows)
    rows = _key_frames(subject)
    moments = np.unique(_moments(subject, rows))
    samples, of_moment = np.divmod(moments, max(sensors, 1))
    scenes = at(subject.scene_of_sample, samples)
    used = np.unique(scenes[scenes >= 0] * sensors + of_moment[scenes >= 0])
    by_scene: dict[int, list[int]] = {}
    for number in used.tolist():
        by_scene.setdefault(number // sensors, []).append(number % sensors)
    present = set(moments.tolist())
    for index, scene in enumerate(subject.scene_of_sample.tolist()):
        lacking = [sensor for sensor in by_scene.get(scene, []) if index * sensors + sensor not in present]
        if lacking:
            channels = ", ".join(data.sensor.rows[sensor].channel for sensor in lacking)
            yield data.sample.place(data.sample.rows[index], "token"), f"has no key frame of {channels}."


def _wrong_ends(table: ListedTable[Any], what: str, lists: Lists) -> Iterator[Broken]:
    """Rows that own a list, and whose `first_<what>_token` or `last_<what>_token` is not its end."""
    counts = np.bincount(lists.groups[lists.groups >= 0], minlength=len(table.rows)).tolist()
    for which, links in (("first", lists.prev), ("last", lists.next)):
        field = f"{which}_{what}_token"
        ends = table.links(field, lists.table).tolist()
        for index, (row, end, count) in enumerate(zip(table.rows, ends, counts, strict=True)):
            if end >= 0 and 0 <= lists.groups[end] != index:
                yield table.place(row, field), f"{getattr(row, field)!r} is of another {lists.of}."
            elif end >= 0 and links[end] >= 0:
                yield table.place(row, field), f"{getattr(row, field)!r} is not the {which} of its list."
            elif end == EMPTY and count:
                yield table.place(row, field), f"is empty, but there are {count} rows of this {lists.of}."


def _key_frames(subject: Subject) -> Indices:
    """The sample_data rows that are key frames of a sample and a sensor."""
    are_key_frames = subject.dataset.sample_data.flags("is_key_frame")
    return np.flatnonzero(are_key_frames & (subject.sample_of_row >= 0) & (subject.sensor_of_row >= 0))


def _moments(subject: Subject, rows: Indices) -> Indices:
    """Sample and sensor of some sample_data rows as one number."""
    return subject.sample_of_row[rows] * len(subject.dataset.sensor.rows) + subject.sensor_of_row[rows]
