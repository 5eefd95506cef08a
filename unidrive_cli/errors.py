"""The one error hierarchy of unidrive: every kind carries what, where, hint and its exit code."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class UnidriveError(Exception):
    """Root of all errors that a user can act on.

    Args:
        what: one sentence: what is wrong and what was expected.
        where: file, table, token or field it was found in; may be empty.
        hint: what to do about it; may be empty.
    """

    exit_code = 1

    def __init__(self, what: str, *, where: str = "", hint: str = "") -> None:
        super().__init__(what, where, hint)
        self.what = what
        self.where = where
        self.hint = hint

    @property
    def sentence(self) -> str:
        """Where and what, without the hint."""
        return f"{self.where}: {self.what}" if self.where else self.what

    def __str__(self) -> str:
        return f"{self.sentence} {self.hint}" if self.hint else self.sentence

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild, (type(self), self.what, self.where, self.hint)


def _rebuild(kind: type[UnidriveError], what: str, where: str, hint: str) -> UnidriveError:
    return kind(what, where=where, hint=hint)


class CheckError(UnidriveError):
    """A check on the finished output found something wrong."""

    exit_code = 1


class UsageError(UnidriveError):
    """An option, or a combination of options, that cannot be carried out."""

    exit_code = 2


class RigError(UnidriveError):
    """A rig file, or a virtual rig, that is not valid."""

    exit_code = 2


class GeometryError(UnidriveError, ValueError):
    """A number that is not a pose, a lens, a plane or a point array."""

    exit_code = 2


class DatasetError(UnidriveError):
    """The input dataset is missing, unreadable or invalid."""

    exit_code = 3


class PictureError(DatasetError):
    """One picture of the input is missing, broken or of another size than its tables say."""


class OutputError(UnidriveError):
    """The destination cannot be written, or belongs to somebody else."""

    exit_code = 4


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """`Did you mean X?` for the nearest known name, or an empty text where none is near."""
    close = difflib.get_close_matches(name, list(known), n=1)
    return f"Did you mean {close[0]}?" if close else ""
