"""The splits of several datasets as those of one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from unidrive_cli.tables.splits import ALL, CUSTOM, Splits, devkit_splits, findable


@dataclass(frozen=True)
class Membership:
    """What one dataset says of its scenes.

    Attributes:
        scenes: their names there.
        own: of its `splits.json`.
        names: their new names, of those that have one.
    """

    scenes: Sequence[str]
    own: Splits
    names: Mapping[str, str]

    def members(self, split: str, predefined: Splits) -> list[str]:
        """The scenes of a split under their new names; where the file does not have it, what the devkit says."""
        if split in self.own:
            found: Sequence[str] = self.own[split]
        elif split == ALL:
            found = self.scenes
        elif split.startswith(CUSTOM) and split.removeprefix(CUSTOM) in predefined:
            return self.members(split.removeprefix(CUSTOM), predefined)
        else:
            found = [name for name in self.scenes if name in set(predefined.get(split, ()))]
        return [self.names.get(name, name) for name in found]


def joined_splits(datasets: Sequence[Membership]) -> dict[str, list[str]]:
    """What `splits.json` of the merged dataset must hold; empty where nuscenes-devkit needs no such file."""
    predefined = devkit_splits()
    scenes = [dataset.names.get(name, name) for dataset in datasets for name in dataset.scenes]
    joined: dict[str, list[str]] = {}
    for split in dict.fromkeys([*(name for dataset in datasets for name in dataset.own), *predefined]):
        members = [name for dataset in datasets for name in dataset.members(split, predefined)]
        in_a_file = any(split in dataset.own for dataset in datasets)
        if in_a_file or set(members) != set(scenes).intersection(predefined[split]):
            joined[split] = list(dict.fromkeys(members))
    return findable(joined, scenes)
