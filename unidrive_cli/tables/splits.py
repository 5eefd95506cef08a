"""Splits: nuscenes-devkit's own, by scene name, and those of a version folder's `splits.json`."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import msgspec

from unidrive_cli.errors import DatasetError, UsageError, did_you_mean
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.schema import Scene

SPLITS = "splits"
ALL = "all"
"""The split of every scene, written where the devkit's splits do not find them all."""
CUSTOM = "custom_"
"""Before the name of a split that the devkit looks up in its own list, and that holds other scenes here."""

Splits = Mapping[str, Sequence[str]]
"""Scene names by the name of their split."""


def devkit_splits() -> dict[str, list[str]]:
    """nuScenes' own splits, which nuscenes-devkit knows without a file."""
    from nuscenes.utils.splits import create_splits_scenes

    found: dict[str, list[str]] = create_splits_scenes()
    return found


def own_splits(dataset: Dataset) -> dict[str, list[str]]:
    """The splits of a dataset's `splits.json`; none where it has no such file.

    Raises:
        DatasetError: the file holds something else than lists of scene names.
    """
    table = dataset.extra_tables.get(SPLITS)
    if table is None:
        return {}
    try:
        return msgspec.json.decode(table.path.read_bytes(), type=dict[str, list[str]])
    except msgspec.DecodeError as error:
        raise DatasetError(
            f"is no list of scene names by split: {error}.",
            where=str(table.path),
            hint='A file like {"train": ["scene-0001"], "val": ["scene-0002"]} was expected.',
        ) from error


def scenes_of(dataset: Dataset, names: Collection[str], splits: Collection[str]) -> list[Scene]:
    """The scenes that have one of the names and are in one of the splits, in table order; all where none is given.

    What `splits.json` says of a split goes before what the devkit says of it.

    Raises:
        UsageError: an unknown name, a split that has no scene here, or no scene that is of both.
        DatasetError: `splits.json` is no such file.
    """
    named = dataset.scenes_named(names)
    if not splits:
        return named
    known: dict[str, Sequence[str]] = {**devkit_splits(), **own_splits(dataset)}
    here = {scene.name for scene in dataset.scene.rows}
    inhabited = [split for split, members in known.items() if not here.isdisjoint(members)]
    there_are = f"Its scenes are in: {', '.join(inhabited) or 'no split at all'}."
    for split in sorted(set(splits) - set(inhabited)):
        if split in known:
            raise UsageError(f"--split {split}: no scene of {dataset.folder} is in it.", hint=there_are)
        hint = did_you_mean(split, known) or there_are
        raise UsageError(
            f"--split {split}: there is no such split, neither nuScenes' own nor in {SPLITS}.json.", hint=hint
        )
    chosen = {scene for split in splits for scene in known[split]}
    found = [scene for scene in named if scene.name in chosen]
    if not found:
        raise UsageError(
            f"--scene and --split leave nothing: of {', '.join(sorted(names))} none is in {', '.join(splits)}."
        )
    return found


def trimmed(splits: Splits, scenes: Collection[str]) -> dict[str, list[str]]:
    """The splits without the scenes that are not there; without those that have no scene then."""
    kept = {split: [name for name in members if name in scenes] for split, members in splits.items()}
    return {split: members for split, members in kept.items() if members}


def findable(splits: Splits, scenes: Sequence[str]) -> dict[str, list[str]]:
    """What must be in `splits.json` so that nuscenes-devkit finds the scenes and splits of a dataset.

    The devkit looks into the file only for splits of other names than its own: one of its names that holds other
    scenes here is in the file a second time, with CUSTOM before its name. Where scenes are in no split that it
    finds, ALL holds every scene.

    Args:
        splits: those that the dataset has, trimmed.
        scenes: names of all its scenes.

    Returns:
        Empty where the devkit needs no file.
    """
    predefined = devkit_splits()
    written = {split: list(members) for split, members in splits.items()}
    for split, members in splits.items():
        if split in predefined and set(members) != set(scenes).intersection(predefined[split]):
            written.setdefault(CUSTOM + split, list(members))
    found = set[str]().union(*predefined.values())
    found.update(*(members for split, members in written.items() if split not in predefined))
    if not found.issuperset(scenes):
        written.setdefault(ALL, list(scenes))
    return written
