"""File names inside a dataset: POSIX, relative, and never outside of it."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from unidrive_cli.errors import DatasetError

MAX_FILENAME_CHARACTERS = 1024
MAX_NAME_BYTES = 255


def check_filename(filename: str, where: str) -> None:
    """Refuses the `filename` of a table row that is not a safe relative path.

    Raises:
        DatasetError: empty, absolute, with `..`, NUL or a backslash, or absurdly long.
    """
    problem = None
    if (
        len(filename) > MAX_NAME_BYTES
        and max(len(part.encode(errors="replace")) for part in filename.split("/")) > MAX_NAME_BYTES
    ):
        problem = f"has a name of more than {MAX_NAME_BYTES} bytes"
    elif len(filename) > MAX_FILENAME_CHARACTERS:
        problem = f"has {len(filename)} characters"
    elif "\0" in filename or "\\" in filename:
        problem = "holds a NUL or a backslash"
    elif filename[:1] == "/" or (".." in filename and ".." in filename.split("/")):
        problem = f"leaves the dataset ({filename[:80]!r})"
    elif not filename.strip("/."):
        problem = f"names no file ({filename[:80]!r})"
    if problem:
        raise DatasetError(f"{problem}; a relative POSIX path inside the dataset is expected.", where=where)


class Inside:
    """Resolves checked file names below a dataset's root without following links that lead elsewhere.

    The top-level folders may themselves be links to another disk (people do that); below them a
    link that leads out of its top-level folder is refused.
    """

    def __init__(self, root: Path) -> None:
        self._root = str(root)
        self._real_root = os.path.realpath(root)
        self._top_folders: dict[str, str] = {}
        self._safe_folders: set[str] = set()

    def has_links(self, folder: str) -> bool:
        """Whether anything in a folder (checked by name, relative to the root) is a link; False where it is missing.

        Raises:
            DatasetError: the folder cannot be read.
        """
        try:
            with os.scandir(f"{self._root}/{folder}") as entries:
                return any(entry.is_symlink() for entry in entries)
        except (FileNotFoundError, NotADirectoryError):
            return False
        except OSError as error:
            raise DatasetError(f"cannot be read: {error.strerror}.", where=str(error.filename)) from error

    def resolve(self, filename: str, where: str) -> Path:
        """The file's path below the root.

        Raises:
            DatasetError: the name is not safe, or a link leads out of the dataset.
        """
        return Path(self.locate(filename, where))

    def locate(self, filename: str, where: str) -> str:
        """As `resolve`, for very many files."""
        full = self._in_safe_folder(filename, where)
        if os.path.islink(full):
            self._refuse_outside(full, filename, where)
        return full

    def look_at(self, filename: str, where: str) -> os.stat_result:
        """The status of the file, as of one that `locate` finds; a file that is no link is asked for once.

        Raises:
            DatasetError: the name is not safe, or a link leads out of the dataset.
            OSError: there is no such file, or it cannot be looked at.
        """
        full = self._in_safe_folder(filename, where)
        status = os.lstat(full)
        if stat.S_ISLNK(status.st_mode):
            self._refuse_outside(full, filename, where)
            status = os.stat(full)
        return status

    def _in_safe_folder(self, filename: str, where: str) -> str:
        check_filename(filename, where)
        full = f"{self._root}/{filename}"
        folder = filename.rpartition("/")[0]
        if folder not in self._safe_folders:
            real = os.path.dirname(full)
            self._refuse_outside(real, filename, where)
            if os.path.isdir(real) and not os.access(real, os.X_OK):
                raise DatasetError(f"the folder {real} cannot be read: permission denied.", where=where)
            self._safe_folders.add(folder)
        return full

    def _refuse_outside(self, path: str, filename: str, where: str) -> None:
        real = os.path.realpath(path)
        top, _, below = filename.strip("/").partition("/")
        homes = {self._real_root}
        if below:
            homes.add(self._top_folders.setdefault(top, os.path.realpath(f"{self._root}/{top}")))
        if not any(real == home or real.startswith(home + os.sep) for home in homes):
            raise DatasetError(f"{filename[:80]!r} is a link that leads out of the dataset.", where=where)
