"""YAML files of ours, read with one clear sentence per mistake."""

from __future__ import annotations

import contextlib
import math
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap
from ruamel.yaml.error import YAMLError, YAMLWarning

from unidrive_cli.errors import GeometryError, RigError, did_you_mean
from unidrive_cli.geometry.lenses import MAX_SIDE_PX

MAX_FILE_BYTES = 1_000_000
MAX_NUMBER = 1e9


def read_text(path: Path) -> str:
    """The UTF-8 text of a small file.

    Raises:
        RigError: missing, unreadable, too large, or not UTF-8.
    """
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise RigError(f"cannot be read: {error.strerror}.", where=str(path)) from error
    if len(data) > MAX_FILE_BYTES:
        raise RigError(f"is larger than {MAX_FILE_BYTES} bytes, which no file of this kind is.", where=str(path))
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RigError(
            f"is not UTF-8 text (byte {error.start}); a YAML file was expected.", where=str(path)
        ) from error


def parse_yaml(text: str, source: str) -> Any:
    """The document of a YAML text, with the places of its keys; `source` is what error sentences call it.

    Raises:
        RigError: not YAML, or a key given twice.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", YAMLWarning)
            return YAML(typ="rt").load(text)
    except YAMLError as error:
        problem, place = problem_and_place(error, source)
        if type(error).__name__ == "DuplicateKeyError":
            key = re.search(r'key "(.*?)"', str(problem))
            what = f"{key.group(1) if key else 'a key'} is given twice; channels and keys must be unique."
            raise RigError(what, where=place) from error
        raise RigError(f"is not valid YAML: {problem}.", where=place) from error
    except (ValueError, RecursionError, AttributeError, TypeError, LookupError) as error:
        raise RigError("is not valid YAML.", where=source) from error


def problem_and_place(error: Exception, source: str) -> tuple[str, str]:
    """What a YAML parser complains of, and the line of `source` where it does."""
    mark = getattr(error, "problem_mark", None)
    place = f"{source}, line {mark.line + 1}" if mark is not None else source
    return getattr(error, "problem", None) or str(error).splitlines()[0], place


def check_keys(mapping: CommentedMap, known: Iterable[str], needed: Iterable[str], where: str) -> None:
    """Refuses unknown and missing keys, and YAML tags."""
    known = tuple(known)
    if mapping.tag.value not in (None, "tag:yaml.org,2002:map"):
        raise RigError(f"holds the tag {mapping.tag.value}; none is expected.", where=where)
    for key in mapping:
        if key not in known:
            guess = did_you_mean(str(key), known) or f"Known keys are {', '.join(known)}."
            raise error_at(mapping, key, where, f"is not a known key. {guess}")
    for key in needed:
        if key not in mapping:
            raise RigError(f"the key {key} is missing.", where=where)


def exactly_one(entry: CommentedMap, key: str, others: tuple[str, ...], where: str) -> None:
    """Refuses none, and more than one, of some keys."""
    given = [name for name in (key, *others) if name in entry]
    if len(given) != 1:
        names = " or ".join((key, *others))
        what = "one is missing" if not given else "both are given"
        line = f", line {entry.lc.line}"
        raise RigError(f"exactly one of {names} must be given; {what}.", where=f"{where}{line}")


@contextlib.contextmanager
def named(mapping: CommentedMap, key: str, where: str, verb: str = "does not fit") -> Iterator[None]:
    """Gives an error of the geometry the key, file and line that its numbers came from."""
    try:
        yield
    except GeometryError as error:
        raise error_at(mapping, key, where, f"{verb}: {error.what}") from error


def error_at(mapping: Mapping[Any, Any], key: object, where: str, what: str) -> RigError:
    """An error about a key, with its line."""
    line = ""
    with contextlib.suppress(AttributeError, KeyError, TypeError):
        line = f", line {mapping.lc.key(key)[0] + 1}"  # type: ignore[attr-defined]
    return RigError(f"{key} {what}", where=f"{where}{line}")


def text_of(mapping: CommentedMap, key: str, where: str) -> str:
    """A printable, non-empty text."""
    value = mapping[key]
    if not isinstance(value, str | int | float) or isinstance(value, bool) or not str(value).strip():
        raise error_at(mapping, key, where, f"must be a text, got {value!r:.60}.")
    text = str(value)
    if not text.isprintable():
        raise error_at(mapping, key, where, f"must be a text of printable characters, got {text!r:.60}.")
    return text


def number_of(mapping: CommentedMap, key: str, where: str) -> float:
    """A finite number."""
    return as_number(mapping[key], mapping, key, where)


def as_number(value: object, mapping: CommentedMap, key: str, where: str) -> float:
    """A value that belongs to a key, as a finite number."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    try:
        number = float(value) if is_number else math.nan  # type: ignore[arg-type]
    except OverflowError:
        number = math.nan
    if not abs(number) <= MAX_NUMBER:
        raise error_at(mapping, key, where, f"must be a finite number of at most {MAX_NUMBER:g}, got {value!r:.60}.")
    return number


def optional_number(mapping: CommentedMap, key: str, where: str) -> float | None:
    """A finite number, or None where the key is missing."""
    return number_of(mapping, key, where) if key in mapping else None


def whole_number(mapping: CommentedMap, key: str, where: str) -> int:
    """A whole number of pixels."""
    number = number_of(mapping, key, where)
    if number != int(number) or not 1 <= number <= MAX_SIDE_PX:
        raise error_at(
            mapping, key, where, f"must be a whole number of pixels from 1 to {MAX_SIDE_PX}, got {number:g}."
        )
    return int(number)


def numbers_of(mapping: CommentedMap, key: str, count: int, where: str) -> list[float]:
    """A list of so many finite numbers."""
    values = mapping[key]
    if not isinstance(values, list) or len(values) != count:
        raise error_at(mapping, key, where, f"must be a list of {count} numbers, got {values!r:.60}.")
    return [as_number(value, mapping, key, where) for value in values]
