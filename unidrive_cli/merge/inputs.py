"""The datasets that are merged: whether each was converted and finished, and whether they are of one fleet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from unidrive_cli.errors import DatasetError, UsageError
from unidrive_cli.tables.converted import PROVENANCE, refuse_unfinished

OF_SUBSETS = ("scenes", "splits", "max_samples", "cameras", "link", "keep_layout", "output_version")
"""Options that may differ without a word: they choose what is converted, or where it lies."""


class Leaf(msgspec.Struct, frozen=True):
    """A conversion that is in a dataset.

    Attributes:
        plan_digest: names its source, rig and options.
        source_digest: names its source's tables.
    """

    plan_digest: str
    source_digest: str


class Provenance(msgspec.Struct, frozen=True):
    """What `unidrive.json` says of a dataset that was converted, or merged already."""

    plan: dict[str, Any]
    plan_digest: str
    rig: dict[str, Any]
    counts: dict[str, Any]
    covered: dict[str, float]
    picture_bytes: int
    failures: list[dict[str, str]]
    merged: list[Leaf] = []

    @property
    def leaves(self) -> list[Leaf]:
        """The conversions that are in it."""
        return self.merged or [Leaf(self.plan_digest, self.plan["source"]["digest"])]

    @property
    def rig_digest(self) -> str:
        """Of the virtual rig."""
        digest: str = self.plan["rig"]["digest"]
        return digest

    @property
    def options(self) -> dict[str, Any]:
        """All options that it depends on, by name."""
        options: dict[str, Any] = self.plan["options"]
        return options

    @property
    def toolchain(self) -> dict[str, Any]:
        """Kernel and codec."""
        apart = ("method", "version", "source", "rig", "options")
        return {name: value for name, value in self.plan.items() if name not in apart}

    @property
    def of_pictures(self) -> dict[str, Any]:
        """What its pictures depend on beside source and rig, by name."""
        return self.toolchain | {name: value for name, value in self.options.items() if name not in OF_SUBSETS}


@dataclass(frozen=True)
class Input:
    """A dataset that is merged.

    Attributes:
        root: its folder, as it was given.
        made: what is known of it.
    """

    root: Path
    made: Provenance


def read_inputs(roots: Sequence[Path]) -> list[Input]:
    """The datasets in some folders, which must be of one fleet.

    Raises:
        UsageError: fewer than two, a folder twice, other virtual rigs, METHOD versions or kinds of masks, or a
            conversion that is in two of them.
        DatasetError: not converted, not finished, or a broken provenance file.
    """
    if len(roots) < 2:
        raise UsageError("two datasets or more are needed to merge.", hint="unidrive merge DST DST... --out DIR")
    places: dict[Path, Path] = {}
    for root in roots:
        other = places.setdefault(root.resolve(), root)
        if other is not root:
            raise UsageError(f"{root} is given twice.")
    inputs = [Input(root, _provenance(root)) for root in roots]
    first = inputs[0]
    holders: dict[str, Input] = {}
    for one in inputs:
        if one.made.plan["method"] != first.made.plan["method"]:
            raise UsageError(
                f"{one.root} was converted by METHOD {one.made.plan['method']}, {first.root} by METHOD "
                f"{first.made.plan['method']}: their pictures are not alike.",
                hint="Convert both with the same version of unidrive.",
            )
        if one.made.rig_digest != first.made.rig_digest:
            raise UsageError(
                f"{one.root} and {first.root} have different virtual rigs: {_rig_difference(first, one)}.",
                hint="Convert them through the same rig.",
            )
        masks, of_first = one.made.options.get("masks"), first.made.options.get("masks")
        if masks != of_first and "none" in (masks, of_first):
            raise UsageError(
                f"{one.root} was converted with --masks {masks}, {first.root} with --masks {of_first}: only some "
                "pictures would have masks.",
                hint="Convert both with masks, or both without.",
            )
        for leaf in one.made.leaves:
            other_holder = holders.setdefault(leaf.plan_digest, one)
            if other_holder is not one:
                raise UsageError(
                    f"{one.root} holds the same conversion as {other_holder.root}: the same scenes twice."
                )
    return inputs


def _provenance(root: Path) -> Provenance:
    path = root / PROVENANCE
    try:
        if not root.is_dir():
            raise DatasetError("there is no such folder.", where=str(root))
        refuse_unfinished(root)
        made = msgspec.json.decode(path.read_bytes(), type=Provenance)
        needed = made.plan["method"], made.rig_digest, made.options["masks"], made.rig["cameras"], made.leaves
        if not all(needed):
            raise KeyError("rig")
    except FileNotFoundError as error:
        raise DatasetError(
            f"was not written by unidrive convert: it has no {PROVENANCE}.",
            where=str(root),
            hint="Convert it first; only datasets of one virtual rig can be merged.",
        ) from error
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror}.", where=str(path)) from error
    except (msgspec.DecodeError, UnicodeDecodeError, KeyError, TypeError) as error:
        raise DatasetError(
            f"is not a provenance file of unidrive: {error}.", where=str(path), hint="Convert the dataset again."
        ) from error
    return made


def _rig_difference(one: Input, other: Input) -> str:
    """How two rigs differ, in words: names, channels, picture sizes, or a camera's numbers."""
    mine, others = one.made.rig["cameras"], other.made.rig["cameras"]
    names = f"{other.made.plan['rig'].get('name')} and {one.made.plan['rig'].get('name')}"
    if list(mine) != list(others):
        return f"{names}, with the cameras {', '.join(others)} and {', '.join(mine)}"
    for channel, camera in mine.items():
        if camera != others[channel]:
            sizes = [f"{rig[channel]['width']}x{rig[channel]['height']}" for rig in (others, mine)]
            if sizes[0] != sizes[1]:
                return f"{names}, with pictures of {' and '.join(sizes)} pixels for {channel}"
            fields = ", ".join(name for name, value in camera.items() if value != others[channel][name])
            return f"{names}, which differ in {channel} ({fields})"
    return names
