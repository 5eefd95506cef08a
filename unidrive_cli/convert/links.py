"""Files that do not change: linked or copied from the source."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from unidrive_cli.convert.options import Link
from unidrive_cli.errors import DatasetError, OutputError
from unidrive_cli.geometry.arrays import Bool
from unidrive_cli.tables.dataset import Dataset
from unidrive_cli.tables.destination import Destination

CARRIED_FOLDERS = ("can_bus", "map", "maps")
"""Top-level folders that go along whole; other files go along where a table names them."""


def check_carried_folders(dataset: Dataset) -> None:
    """Refuses a link in the carried folders that leads elsewhere.

    Raises:
        DatasetError: there is one, or a folder cannot be read.
    """
    for folder in CARRIED_FOLDERS:
        for path, folders, files in os.walk(dataset.root / folder, onerror=_raise):
            for name in (*folders, *files):
                entry = Path(path) / name
                if entry.is_symlink():
                    if entry.is_dir():
                        raise DatasetError(
                            "is a link to a folder; below the top-level folders links are not followed.",
                            where=str(entry),
                            hint="Put the folder itself in its place.",
                        )
                    relative = entry.relative_to(dataset.root).as_posix()
                    dataset.files.resolve(relative, str(entry))


def carried_files(dataset: Dataset, kept: Bool, extra_files: Iterable[str]) -> Iterator[str]:
    """File names, relative to the dataset, of everything that goes along unchanged.

    Args:
        kept: (n,) the sample_data rows (no cameras) that stay.
        extra_files: files that rows of extra tables name.
    """
    for row in dataset.sample_data.rows_at(np.flatnonzero(kept)):
        yield row.filename
    for _, filename in dataset.layout.further_files(dataset.sample_data, np.flatnonzero(kept)):
        yield filename
    yield from extra_files
    yield from (name for name in dataset.layout.top_files if (dataset.root / name).is_file())
    named = {row.filename for row in dataset.map.rows if row.filename}
    for folder in CARRIED_FOLDERS:
        for path, _, files in os.walk(dataset.root / folder, onerror=_raise):
            for name in files:
                named.add((Path(path) / name).relative_to(dataset.root).as_posix())
    yield from sorted(named)


def check_names_apart(dataset: Dataset, destination: Destination) -> None:
    """Refuses files that would be one on DST's disk, where that takes no notice of case.

    Raises:
        OutputError: two names of carried files differ only by case.
    """
    if not destination.folds_case:
        return
    seen: dict[str, str] = {}
    for name in carried_files(dataset, ~dataset.of_cameras, ()):
        other = seen.setdefault(name.lower(), name)
        if other != name:
            raise OutputError(
                f"takes no notice of case, and the source has {other} and {name}, which would be one file.",
                where=str(destination.root),
                hint="Choose a DST on a disk that tells them apart.",
            )


def carry(source: Path, name: str, destination: Destination, how: Link) -> bool:
    """Brings one file of a source into the destination; False where the source does not have it.

    Args:
        source: the file.
        name: what it is called there, a POSIX path relative to DST that has been checked.

    Raises:
        DatasetError: the file cannot be read.
        OutputError: it cannot be written.
    """
    target = destination.root / name
    try:
        if not source.is_file():
            return False
        real = source.resolve()
        if how != "symlink" and not os.access(real, os.R_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror}.", where=str(source)) from error
    try:
        if os.path.lexists(target):
            if target.exists() and target.stat().st_size == real.stat().st_size:
                return True
            target.unlink()  # lost with the power
        target.parent.mkdir(parents=True, exist_ok=True)
        if how == "symlink":
            target.symlink_to(real)
        elif how == "copy" or not _hard_link(real, target):
            temporary = destination.work / "carried.part"
            shutil.copyfile(real, temporary)
            temporary.replace(target)
    except OSError as error:
        raise OutputError(
            f"cannot be written: {error.strerror}.",
            where=str(target),
            hint="When that is mended, the same command continues.",
        ) from error
    return True


def _hard_link(source: Path, target: Path) -> bool:
    try:
        os.link(source, target)
    except OSError:
        return False
    return True


def _raise(error: OSError) -> None:
    if not isinstance(error, FileNotFoundError):
        raise DatasetError(f"cannot be read: {error.strerror}.", where=str(error.filename)) from error
