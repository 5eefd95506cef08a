"""The plan of a merged dataset: everything that can be refused is refused here, before anything is written."""

from __future__ import annotations

import filecmp
import hashlib
import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from unidrive_cli import __version__
from unidrive_cli.check.references import check_references
from unidrive_cli.convert.options import Link, VerifyLevel, check_version_name
from unidrive_cli.errors import DatasetError, UsageError
from unidrive_cli.merge.drives import DRIVEN, Drive, drive_of
from unidrive_cli.merge.files import FileNames
from unidrive_cli.merge.inputs import Input, read_inputs
from unidrive_cli.merge.renaming import Renaming
from unidrive_cli.merge.splits import Membership, joined_splits
from unidrive_cli.merge.united import UNITED, United
from unidrive_cli.tables.converted import camera_mask_name
from unidrive_cli.tables.dataset import Dataset, open_dataset, version_folder
from unidrive_cli.tables.destination import digest_of
from unidrive_cli.tables.extra import IMAGE_ANNOTATIONS, ExtraTable
from unidrive_cli.tables.splits import SPLITS, own_splits
from unidrive_cli.tables.table import RawRow

_APART = (IMAGE_ANNOTATIONS, SPLITS)
"""Extra tables that are not joined row by row as they are."""


@dataclass
class Part:
    """What becomes of one dataset.

    Attributes:
        source: the dataset.
        version: its version folder.
        tables_digest: of its tables.
        scenes, samples, pictures, files: how many there are; files are those that sample_data names.
        renaming: its new tokens and names.
        carried: (old, new) names of further files.
        repeated: tokens of rows that an earlier dataset has too, by extra table.
    """

    source: Input
    version: str
    tables_digest: str
    scenes: int
    samples: int
    pictures: int
    files: int
    renaming: Renaming
    carried: list[tuple[str, str]] = field(default_factory=list)
    repeated: dict[str, set[str]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class MergePlan:
    """Everything that merging will do.

    Attributes:
        parts: the datasets, in their order.
        version: name of the output's version folder.
        link, verify: as `convert` has them.
        united: rows of the tables that are united.
        extra: names of the extra tables that are joined, and of which file each is that is no table.
        splits: of `splits.json`; empty where none is needed.
        masks: `frame`, `camera` or `none`.
        notes: what a user should know, one sentence each.
    """

    parts: list[Part]
    version: str
    link: Link
    verify: VerifyLevel
    united: dict[str, list[RawRow]]
    extra: list[str]
    loose: dict[str, Path]
    splits: dict[str, list[str]]
    masks: str
    notes: list[str]

    @property
    def identity(self) -> dict[str, Any]:
        """What the output depends on; its digest names it."""
        first = self.parts[0].source.made
        digests = [[part.source.made.plan_digest, part.tables_digest] for part in self.parts]
        digest = hashlib.sha256(json.dumps(digests).encode()).hexdigest()
        made = [part.source.made for part in self.parts]
        options = {"cameras": []} | _common([one.options for one in made])
        return {
            "method": first.plan["method"],
            "version": __version__,
            "source": {"version": self.version, "digest": digest, "datasets": len(self.parts)},
            "rig": first.plan["rig"],
            "options": options | {"masks": self.masks, "link": self.link},
            **_common([one.toolchain for one in made]),
        }

    @property
    def digest(self) -> str:
        """SHA-256 (hex) of `identity`."""
        return digest_of(self.identity)


def make_merge_plan(
    roots: Sequence[Path], version: str | None = None, link: Link = "hardlink", verify: VerifyLevel = "sample"
) -> MergePlan:
    """Plans how datasets become one; one of them is open at a time.

    Args:
        version: of the output's version folder; needed where theirs have several names.

    Raises:
        UsageError: not of one fleet, the same scenes twice, or version folders of several names.
        DatasetError: not converted, unfinished or broken.
    """
    inputs = read_inputs(roots)
    version = _version(inputs, version)
    united, names, drives, parts = United(), FileNames(version), list[Drive](), list[Part]()
    splits: list[Membership] = []
    extra, scenes, notes = _ExtraTables(), set[str](), list[str]()
    for position, source in enumerate(inputs, 1):
        dataset = open_dataset(source.root)
        _check(dataset)
        drive = drive_of(source, dataset)
        for other in drives:
            notes.extend(_refuse_twice(drive, other, position))
        renaming = Renaming(source.made.plan_digest)
        for table in DRIVEN:
            if any(np.isin(drive.tokens[table], other.tokens[table]).any() for other in drives):
                renaming.moved.add(table)
        renaming.scenes = _new_names([row.name for row in dataset.scene.rows], scenes, dataset)
        carried, more = names.add(drive, dataset, renaming)
        united.add(dataset, renaming)
        splits.append(Membership([row.name for row in dataset.scene.rows], _splits(dataset, more), renaming.scenes))
        part = Part(
            source,
            dataset.version,
            dataset.digest,
            len(dataset.scene.rows),
            len(dataset.sample.rows),
            int(np.count_nonzero(dataset.of_cameras)),
            len(dataset.sample_data.rows),
            renaming,
            carried,
        )
        more.extend(extra.add(dataset, part))
        notes.extend(f"Dataset {position}: {note}" for note in (*_renaming_notes(renaming), *more))
        parts.append(part)
        drives.append(drive)
        del dataset  # before the next one is opened
    united.check_labels()
    notes.extend(_option_notes(inputs))
    return MergePlan(
        parts,
        version,
        link,
        verify,
        {table: united.rows(table) for table in UNITED},
        extra.names,
        extra.loose,
        joined_splits(splits),
        _masks(inputs),
        notes,
    )


class _ExtraTables:
    """The extra tables of all datasets: what each of their rows is, by token."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.loose: dict[str, Path] = {}
        self._rows: dict[str, dict[str, bytes]] = {}

    def add(self, dataset: Dataset, part: Part) -> list[str]:
        """Decides which rows are left out and which tables get new tokens; says which files are left out."""
        notes = []
        changes = bool(part.renaming.moved or part.renaming.suffix or any(part.renaming.tokens.values()))
        for name, table in dataset.extra_tables.items():
            if name in _APART:
                continue
            if table.rows is None:
                kept = self.loose.setdefault(name, table.path)
                if name in self._rows or not filecmp.cmp(kept, table.path, shallow=False):
                    notes.append(f"{table.path.name} is no table, another one was there before; it is left out.")
                continue
            if name in self.loose:
                notes.append(f"{table.path.name} replaces a file of that name that is no table.")
                del self.loose[name]
            mine = _by_token(table)
            seen = self._rows.setdefault(name, {})
            both = mine.keys() & seen.keys()
            if any(changes or mine[token] != seen[token] for token in both):
                part.renaming.moved.add(name)
            else:
                part.repeated[name] = both
            seen.update({part.renaming.token(name, token): row for token, row in mine.items()})
        self.names = list(self._rows)
        return notes


def _by_token(table: ExtraTable) -> dict[str, bytes]:
    """A digest of every row that has a token."""
    return {
        token: hashlib.sha256(json.dumps(row, sort_keys=True).encode()).digest()
        for row in table.rows or []
        if isinstance(token := row.get("token"), str)
    }


def _version(inputs: Sequence[Input], version: str | None) -> str:
    """The version folder's name in the output.

    Raises:
        UsageError: it is not given, and theirs differ; or it is no name of a folder.
    """
    try:
        found = {version_folder(source.root, None).name: source.root for source in inputs}
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror}.", where=str(error.filename)) from error
    if version is None:
        if len(found) > 1:
            names = ", ".join(f"{name} in {root}" for name, root in found.items())
            raise UsageError(f"the version folders have several names: {names}.", hint="Choose one with --version.")
        return next(iter(found))
    check_version_name(version, "--version")
    return version


def _check(dataset: Dataset) -> None:
    """Refuses a dataset that was broken after it was written."""
    for finding in check_references(dataset):
        raise DatasetError(
            finding.what, where=finding.where, hint=f"See: unidrive validate {dataset.root}; or convert it again."
        )


def _refuse_twice(drive: Drive, other: Drive, position: int) -> list[str]:
    """Refuses a drive that is in another dataset too, unless its pictures are certainly those of another car.

    Raises:
        UsageError: the same scenes twice.
    """
    _, mine, others = np.intersect1d(drive.tokens["sample"], other.tokens["sample"], return_indices=True)
    alike = (drive.timestamps[mine] == other.timestamps[others]) & (
        drive.centres[mine] == other.centres[others]
    ).all(1)
    if not alike.any():
        return []
    sample = int(np.flatnonzero(alike)[-1])  # two drives may begin alike, where a simulator puts the car
    here, there = drive.source, other.source
    sources = [{leaf.source_digest for leaf in one.made.leaves} for one in (here, there)]
    what = f"{here.root} holds scenes that {there.root} holds too ({drive.pictures[mine[sample]][0]} is of both)"
    if sources[0] & sources[1] or _same_pictures(drive, other, int(mine[sample]), int(others[sample])):
        raise UsageError(f"{what}: the same scenes twice.", hint="Convert one of them without these (--scene).")
    if here.made.of_pictures != there.made.of_pictures:
        raise UsageError(
            f"{what}; whether other cameras recorded them is not to be told, because they were converted otherwise.",
            hint="Convert both with the same options, or one of them without these scenes (--scene).",
        )
    count = int(np.count_nonzero(alike))
    samples = "1 sample is a moment" if count == 1 else f"{count} samples are moments"
    return [f"Dataset {position}: {samples} of an earlier one, seen by other cameras."]


def _same_pictures(drive: Drive, other: Drive, sample: int, others_sample: int) -> bool:
    """Whether all pictures of a sample of both are the same bytes."""
    pairs = zip(sorted(drive.pictures[sample]), sorted(other.pictures[others_sample]), strict=False)
    try:
        return all(
            filecmp.cmp(drive.source.root / one, other.source.root / another, shallow=False)
            for one, another in pairs
        )
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror}.", where=str(error.filename)) from error


def _new_names(names: Sequence[str], taken: set[str], dataset: Dataset) -> dict[str, str]:
    """New names of the scenes whose own are taken, which they are then.

    Raises:
        DatasetError: two scenes of the dataset have one name.
    """
    own = set(names)
    if len(own) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise DatasetError("is the name of two scenes.", where=f"{dataset.scene.file}, name {twice}")
    found = {}
    for name in names:
        if name in taken:
            free = (f"{name}-{number}" for number in itertools.count(2))
            found[name] = next(new for new in free if new not in taken and new not in own)
            taken.add(found[name])
    taken |= own
    return found


def _splits(dataset: Dataset, notes: list[str]) -> dict[str, list[str]]:
    try:
        return own_splits(dataset)
    except DatasetError:
        notes.append(f"{SPLITS}.json is no list of scene names by split; it is left out.")
        return {}


def _renaming_notes(renaming: Renaming) -> list[str]:
    notes = []
    if renaming.scenes:
        some = ", ".join(f"{old} is {new}" for old, new in list(renaming.scenes.items())[:3])
        more = f" and {len(renaming.scenes) - 3} more" if len(renaming.scenes) > 3 else ""
        notes.append(f"scene names are taken: {some}{more} now; nuScenes' own splits do not know these names.")
    if renaming.moved:
        notes.append(f"tokens are taken: those of {', '.join(sorted(renaming.moved))} are new.")
    if renaming.suffix:
        notes.append(f"file names are taken: {renaming.suffix} is put into those of its recordings.")
    return notes


def _common(settings: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What all say, and say alike."""
    first, *others = settings
    return {
        name: value
        for name, value in first.items()
        if all(name in other and other[name] == value for other in others)
    }


def _option_notes(inputs: Sequence[Input]) -> list[str]:
    """A sentence for every option by which pictures, masks or boxes differ."""
    names = dict.fromkeys(name for one in inputs for name in one.made.of_pictures)
    notes = []
    for name in names:
        values = [one.made.of_pictures.get(name) for one in inputs]
        if name != "masks" and any(value != values[0] for value in values):
            shown = ", ".join(dict.fromkeys(json.dumps(value) for value in values))
            notes.append(f"The datasets were converted with different {name}: {shown[:200]}.")
    return notes


def _masks(inputs: Sequence[Input]) -> str:
    """What kind the output's masks are: one per picture, unless all have the same one per camera, or none."""
    kinds = {str(one.made.options["masks"]) for one in inputs}
    if kinds != {"camera"}:
        return "none" if kinds == {"none"} else "frame"
    names = [camera_mask_name(channel) for channel in inputs[0].made.rig["cameras"]]
    try:
        alike = all(
            filecmp.cmp(inputs[0].root / name, one.root / name, shallow=False)
            for one in inputs[1:]
            for name in names
        )
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror}.", where=str(error.filename)) from error
    return "camera" if alike else "frame"
