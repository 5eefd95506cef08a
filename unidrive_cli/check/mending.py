"""What `--fix` mends: broken lists are linked anew in the order of time, counts and ends are set right.

A list whose rows are linked against the order of time is left alone: either may be wrong. A table is written anew
under its name, and what it was is kept beside it (`.bak`); other names of that file (hard links) keep the old one.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from unidrive_cli.check.subject import Lists, Subject
from unidrive_cli.errors import DatasetError, OutputError
from unidrive_cli.tables.subset import mended_instances, mended_scenes
from unidrive_cli.tables.table import EMPTY, Indices, Table, write_rows

Changes = dict[int, dict[str, Any]]


def mend(subject: Subject) -> dict[str, int]:
    """Mends what can be mended safely, in place.

    Returns:
        How many rows were changed, by table.

    Raises:
        DatasetError: the version folder is a link, so that the tables are those of another dataset.
        OutputError: a table cannot be written.
    """
    if subject.folder.is_symlink():
        raise DatasetError(
            "is a link; its tables may be those of another dataset.",
            where=str(subject.folder),
            hint="Copy the version folder here, or fix the dataset that it leads to.",
        )
    data = subject.dataset
    changes = {name: _relinked(lists) for name, lists in subject.lists.items() if name not in subject.missing}
    changes["scene"] = _ends(dict(mended_scenes(data, data.sample.by_token.keys())), subject.lists["sample"])
    if not {"instance", "sample_annotation"} & subject.missing:
        all_annotations = np.ones(len(data.sample_annotation.rows), dtype=bool)
        mended = dict(mended_instances(data, all_annotations))
        changes["instance"] = _ends(mended, subject.lists["sample_annotation"])
    fixed = {}
    for name, rows in changes.items():
        changed = {index: fields for index, fields in rows.items() if fields}
        if changed:
            _rewrite(subject.folder / f"{name}.json", getattr(data, name), changed)
            fixed[name] = len(changed)
    return fixed


def _relinked(lists: Lists) -> Changes:
    """Changes of `prev` and `next` in the lists that are broken."""
    rows = np.flatnonzero((lists.groups >= 0) & ~np.isin(lists.groups, _out_of_order(lists)))
    rows = rows[np.lexsort((lists.times[rows], lists.groups[rows]))]
    continues = lists.groups[rows[1:]] == lists.groups[rows[:-1]]
    before, after = np.full(len(rows), EMPTY), np.full(len(rows), EMPTY)
    before[1:][continues] = rows[:-1][continues]
    after[:-1][continues] = rows[1:][continues]
    changes: Changes = {}
    for field, links, wanted in (("prev", lists.prev, before), ("next", lists.next, after)):
        wrong = np.flatnonzero(links[rows] != wanted)
        for row, token in zip(rows[wrong].tolist(), _tokens(lists.table, wanted[wrong]), strict=True):
            changes.setdefault(row, {})[field] = token
    return changes


def _ends(changes: Changes, lists: Lists) -> Changes:
    """The changes of the owners of lists, without ends of those that are out of order."""
    stay = set(_out_of_order(lists).tolist())
    return {
        index: {name: value for name, value in fields.items() if index not in stay or name.startswith("nbr_")}
        for index, fields in changes.items()
    }


def _out_of_order(lists: Lists) -> Indices:
    """The groups whose rows are linked against the order of time, or have no order."""
    joined = lists.joined
    against = lists.groups[joined[~(lists.times[lists.next[joined]] > lists.times[joined])]]
    order = np.lexsort((lists.times, lists.groups))
    groups, times = lists.groups[order], lists.times[order]
    tied = groups[1:][(groups[1:] == groups[:-1]) & ~(times[1:] > times[:-1])]
    return np.union1d(against, tied)


def _tokens(table: Table[Any], rows: Indices) -> list[str]:
    """The tokens of some rows, an empty text for EMPTY."""
    named = iter([row.token for row in table.rows_at(rows[rows >= 0])])
    return [next(named) if row >= 0 else "" for row in rows.tolist()]


def _rewrite(path: Path, table: Table[Any], changes: Changes) -> None:
    try:
        _keep(path)
        write_rows(path, table.runs(np.arange(len(table.rows)), changes))
    except BaseException as error:
        with contextlib.suppress(OSError):
            for end in (".part", ".bak.part"):
                path.with_name(path.name + end).unlink(missing_ok=True)
        if not isinstance(error, OSError):
            raise
        raise OutputError(f"cannot be written: {error.strerror}.", where=str(path)) from error


def _keep(path: Path) -> None:
    """Keeps a table as it is under a further name that is free."""
    number = 0
    while True:
        backup = path.with_name(f"{path.name}.bak{number or ''}")
        try:
            os.link(path, backup, follow_symlinks=True)
            return
        except FileExistsError:
            number += 1
        except OSError:
            half_written = path.with_name(f"{path.name}.bak.part")
            shutil.copy2(path, half_written)
            half_written.rename(backup)
            return
