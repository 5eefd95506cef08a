"""The final verification: the output is opened again before it may look whole."""

from __future__ import annotations

import random
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from unidrive_cli.check.references import check_references
from unidrive_cli.convert.plan import Plan
from unidrive_cli.errors import CheckError, UnidriveError
from unidrive_cli.tables.dataset import Dataset, open_dataset
from unidrive_cli.tables.destination import Destination, as_finished
from unidrive_cli.tables.schema import SampleData
from unidrive_cli.tables.thinned import open_with_devkit
from unidrive_cli.warp.pictures import decode_picture

SAMPLED_PICTURES = 60


@dataclass(frozen=True)
class Verified:
    """What the verification looked at."""

    tables: int
    pictures_present: int
    pictures_decoded: int
    boxes_projected: int


def verify_staged(plan: Plan, destination: Destination, staged_tables: Path) -> Verified:
    """Verifies an output whose tables are still staged.

    Args:
        staged_tables: folder with the output's tables.

    Raises:
        CheckError: something is wrong; the sentence says what.
    """
    with as_finished(destination, staged_tables, plan.version) as root:
        return verify(plan, root)


def verify(plan: Plan, root: Path) -> Verified:
    """Checks the output of a plan: `verify_dataset`."""
    return verify_dataset(root, plan.version, plan.digest, whole=plan.options.verify == "full")


def verify_dataset(root: Path, version: str, seed: str, *, whole: bool) -> Verified:
    """Checks an output: our own rules, the pictures, and nuscenes-devkit.

    Args:
        root, version: the dataset and its version folder.
        seed: decides which pictures are decoded.
        whole: decode all of them, and open all scenes with the devkit.

    Raises:
        CheckError: something is wrong; the sentence says what.
    """
    try:
        dataset = open_dataset(root, version)
        findings = list(check_references(dataset))
    except UnidriveError as error:
        raise CheckError(
            f"the tables that were written cannot be read again: {error}", hint="Start over with --force."
        ) from error
    if findings:
        raise CheckError(findings[0].what, where=f"the output, {findings[0].where} ({findings[0].rule})")
    present, decoded = _check_pictures(dataset, root, seed, whole=whole)
    boxes = open_with_devkit(dataset, whole=whole)
    return Verified(len(list((root / version).glob("*.json"))), present, decoded, boxes)


def _check_pictures(dataset: Dataset, root: Path, seed: str, *, whole: bool) -> tuple[int, int]:
    rows = list(dataset.sample_data.rows_at(np.flatnonzero(dataset.of_cameras)))
    for row in rows:
        path = root / row.filename
        if not path.is_file() or not path.stat().st_size:
            raise CheckError(
                "the picture is missing.", where=f"the output, {row.filename}", hint="Start over with --force."
            )
    sampled = rows
    if not whole and len(rows) > SAMPLED_PICTURES:
        sampled = random.Random(seed).sample(rows, SAMPLED_PICTURES)
    for row in sampled:
        _decode(root, row)
    return len(rows), len(sampled)


def _decode(root: Path, row: SampleData) -> None:
    try:
        decode_picture((root / row.filename).read_bytes(), (row.width or 0, row.height or 0), row.filename)
    except UnidriveError as error:
        raise CheckError(f"a picture that was written is broken: {error}", where="the output") from error
