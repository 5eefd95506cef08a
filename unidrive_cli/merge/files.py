"""Under which names the files of several datasets lie side by side."""

from __future__ import annotations

import filecmp
import itertools
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from unidrive_cli.convert.links import CARRIED_FOLDERS
from unidrive_cli.errors import DatasetError
from unidrive_cli.merge.drives import Drive, parts_of
from unidrive_cli.merge.renaming import Renaming, suffixed
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.extra import IMAGE_ANNOTATIONS
from unidrive_cli.tables.paths import check_filename
from unidrive_cli.tables.tokens import Hashes, short_hashes

CAN_BUS = "can_bus"


@dataclass
class FileNames:
    """The names that are taken; those that differ only by case count as the same.

    Attributes:
        version: of the output: label files lie in a folder of that name.
    """

    version: str
    _data: list[Hashes] = field(default_factory=list)
    _others: dict[str, Path] = field(default_factory=dict)

    def add(self, drive: Drive, dataset: Dataset, renaming: Renaming) -> tuple[list[tuple[str, str]], list[str]]:
        """Finds names for the files of a dataset, and notes those that change in its renaming.

        Returns:
            (old, new) names of the files that sample_data does not name; and notes.

        Raises:
            DatasetError: a name that leaves the dataset, or a folder that cannot be read.
        """
        renaming.suffix, hashes = self._suffix(drive, dataset)
        named = self._named(dataset)
        are_data = np.isin(short_hashes(map(str.lower, named)), drive.files)
        renaming.data_files = frozenset(
            name for name, is_data in zip(named, are_data.tolist(), strict=True) if is_data
        )
        wanted = {name: self._wanted(name, dataset.version) for name in named if name not in renaming.data_files}
        are_taken = np.isin(short_hashes(map(str.lower, wanted.values())), np.concatenate([*self._data, hashes]))
        self._data.append(hashes)
        carried = {
            name: self._free(dataset.root / name, new, is_taken=is_taken)
            for (name, new), is_taken in zip(wanted.items(), are_taken.tolist(), strict=True)
        }
        left: list[str] = []
        for name in _unnamed(dataset):
            if name not in carried:
                new = _of_scene(name, renaming.scenes)
                if _same(self._others.setdefault(new.lower(), dataset.root / name), dataset.root / name):
                    carried[name] = new
                else:
                    left.append(name)
        renaming.files = {old: new for old, new in carried.items() if old != new}
        return list(carried.items()), _left_out(left)

    def _suffix(self, drive: Drive, dataset: Dataset) -> tuple[str, Hashes]:
        """What makes the names of a dataset's sample_data files new, and their hashes then."""
        taken = np.concatenate([*self._data, short_hashes(self._others)])
        if not np.isin(drive.files, taken).any():
            return "", drive.files
        for number in itertools.count(len(self._data) + 1):
            suffix = f"-{number}"
            rows = parts_of(dataset.sample_data)
            hashes = short_hashes(suffixed(name, suffix).lower() for row in rows for name in row.files)
            if not np.isin(hashes, taken).any():
                return suffix, hashes
        raise AssertionError("unreachable: numbers do not end")

    def _named(self, dataset: Dataset) -> list[str]:
        """The files that maps and extra tables name."""
        names = {row.filename: dataset.map.place(row, "filename") for row in dataset.map.rows if row.filename}
        for table_name, table in dataset.extra_tables.items():
            for row in (table.rows or []) if table_name != IMAGE_ANNOTATIONS else ():
                if filename := table.filename(row):
                    names.setdefault(filename, f"{table.path}, token {row.get('token')}, field filename")
        for name, where in names.items():
            check_filename(name, where)
        return sorted(names)

    def _wanted(self, name: str, version: str) -> str:
        """The name, in the output's version folder where it is in the dataset's (lidarseg, panoptic)."""
        parts = name.split("/")
        if len(parts) > 2 and parts[1] == version:
            parts[1] = self.version
        return "/".join(parts)

    def _free(self, source: Path, wanted: str, *, is_taken: bool) -> str:
        """A name under which no other file lies than this one."""
        names = (suffixed(wanted, f"-{number}") for number in itertools.count(2))
        for name in names if is_taken else itertools.chain([wanted], names):
            if _same(self._others.setdefault(name.lower(), source), source):
                return name
        raise AssertionError("unreachable: numbers do not end")


def _unnamed(dataset: Dataset) -> Iterator[str]:
    """Files that go along though no table names them."""
    yield from (name for name in dataset.layout.top_files if (dataset.root / name).is_file())
    for folder in CARRIED_FOLDERS:
        for path, folders, files in os.walk(dataset.root / folder, onerror=_refuse):
            folders.sort()
            yield from ((Path(path) / name).relative_to(dataset.root).as_posix() for name in sorted(files))


def _refuse(error: OSError) -> None:
    if not isinstance(error, FileNotFoundError):
        raise DatasetError(f"cannot be read: {error.strerror}.", where=str(error.filename)) from error


def _of_scene(name: str, scenes: dict[str, str]) -> str:
    """The name of a scene's CAN bus file, can_bus/<scene>_<message>.json, after the scene's new name."""
    folder, _, file = name.partition("/")
    scene, separator, message = file.partition("_")
    return f"{folder}/{scenes.get(scene, scene)}{separator}{message}" if folder == CAN_BUS else name


def _same(one: Path, other: Path) -> bool:
    """Whether two names lead to the same bytes, or one of them nowhere."""
    try:
        if one == other or not one.exists() or not other.exists():
            return True
        return one.samefile(other) or filecmp.cmp(one, other, shallow=False)
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror}.", where=str(error.filename)) from error


def _left_out(names: list[str]) -> list[str]:
    if not names:
        return []
    files = "1 file is" if len(names) == 1 else f"{len(names)} files are"
    return [f"{files} others than those of this name before, and left out ({', '.join(names[:3])})."]
