"""Lenses from a side file, for datasets whose tables have no place for them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ruamel.yaml.comments import CommentedMap

from unidrive_cli.errors import RigError, UsageError, did_you_mean
from unidrive_cli.rig.yaml_file import DISTORTION_KEYS, distortion_of
from unidrive_cli.rig.yaml_reading import check_keys, error_at, numbers_of, parse_yaml, read_text

LENS_FORM = "{model: opencv or fisheye, coefficients: [...]}, and intrinsics: [fx, fy, cx, cy] where those differ"


@dataclass(frozen=True)
class GivenLens:
    """What a side file says of a channel's lens.

    Attributes:
        model, coefficients: as rig files have them.
        intrinsics: fx, fy, cx, cy in pixels, instead of the table's; None takes those.
        where: file, channel and line, for error sentences.
    """

    model: str
    coefficients: tuple[float, ...]
    intrinsics: tuple[float, float, float, float] | None
    where: str

    @property
    def identity(self) -> list[Any]:
        """All that pictures depend on."""
        return [self.model, list(self.coefficients), self.intrinsics and list(self.intrinsics)]


def read_lenses(path: Path) -> dict[str, GivenLens]:
    """The lenses of a YAML file that maps channels to them (docs/lenses.md).

    Raises:
        RigError: the file is missing, not YAML, or something in it is no lens; the sentence names the line.
    """
    where = str(path)
    document = parse_yaml(read_text(path), where)
    if not isinstance(document, CommentedMap) or not document:
        raise RigError(f"must map channels to lenses: CAM_FRONT: {LENS_FORM}.", where=where)
    return {str(channel): _given(document, channel, where) for channel in document}


def _given(document: CommentedMap, channel: object, source: str) -> GivenLens:
    entry = document[channel]
    if not isinstance(entry, CommentedMap):
        raise error_at(document, channel, source, f"must be a mapping {LENS_FORM}; got {entry!r:.60}.")
    where = f"{source}, {channel}"
    check_keys(entry, (*DISTORTION_KEYS, "intrinsics"), DISTORTION_KEYS, where)
    model, coefficients = distortion_of(entry, where)
    fx, fy, cx, cy = numbers_of(entry, "intrinsics", 4, where) if "intrinsics" in entry else [None] * 4
    intrinsics = None if fx is None or fy is None or cx is None or cy is None else (fx, fy, cx, cy)
    line = document.lc.key(channel)[0] + 1
    return GivenLens(model, tuple(coefficients), intrinsics, f"{where}, line {line}")


def check_channels(lenses: Mapping[str, GivenLens], channels: Iterable[str], folder: Path) -> None:
    """Refuses lenses of cameras that a dataset does not have.

    Raises:
        UsageError: one of them.
    """
    known = list(channels)
    for channel, given in lenses.items():
        if channel not in known:
            hint = did_you_mean(channel, known) or f"There are: {', '.join(known[:12])}."
            raise UsageError(f"there is no such camera in {folder}.", where=given.where, hint=hint)
