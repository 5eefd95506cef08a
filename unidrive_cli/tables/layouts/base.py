"""What a layout says: how it is known, what its tables mean otherwise, and what becomes of its files."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

from unidrive_cli.tables.table import Indices, Table

OFFICIAL_VERSIONS = ("v1.0-mini", "v1.0-trainval", "v1.0-test")
"""Version folders that nuscenes-devkit's splits and evaluation, and most trainers, accept."""
_GLIMPSE_BYTES = 1 << 16


class Layout(ABC):
    """A family of datasets.

    Attributes:
        name: what `--layout` takes.
        title: what people call it.
        sorts_files: whether files of lidars and radars get nuScenes' places in the output,
            `samples/<CHANNEL>/` and `sweeps/<CHANNEL>/`, because the layout has others.
        mends_rows: whether `mend` changes rows of the tables that grow; these are read into memory then, however
            large they are.
        top_files: files beside the version folder that go along.
        can_be_kept: whether `--keep-layout` writes it.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    sorts_files: ClassVar[bool] = False
    mends_rows: ClassVar[bool] = False
    top_files: ClassVar[tuple[str, ...]] = ()
    can_be_kept: ClassVar[bool] = False

    @abstractmethod
    def is_at(self, folder: Path) -> bool:
        """Whether a version folder is of this layout.

        Raises:
            OSError: it cannot be read.
        """

    def output_version(self, version: str) -> str:
        """The version folder's name in a dataset in nuScenes' own layout."""
        split = re.search(r"-(mini|test)$", version)
        return f"v1.0-{split.group(1)}" if split else "v1.0-trainval"

    def mend(self, tables: dict[str, Any]) -> Iterator[str]:
        """Brings the tables that were read to nuScenes' meaning, in place; says each assumption in a sentence.

        Args:
            tables: by name; those that may be missing are not made up yet.
        """
        yield from ()

    def log_fields(self, record: dict[str, Any]) -> dict[str, Any]:
        """Fields that nuScenes' readers want of a log, and that this one lacks."""
        return {}

    def calibration_fields(self) -> dict[str, Any]:
        """Fields that this layout wants of a virtual camera's calibration, where it is kept."""
        return {}

    def picture_name(self, channel: str, number: int) -> str:
        """Where a virtual picture goes, where the layout is kept.

        Args:
            number: of the sample.
        """
        raise NotImplementedError

    def further_files(self, sample_data: Table[Any], rows: Indices) -> Iterator[tuple[str, str]]:
        """Files that rows of sample_data name beside their `filename`, each after what errors call the field."""
        yield from ()


def glimpse(path: Path) -> bytes:
    """The first bytes of a table; none where it is missing."""
    try:
        with path.open("rb") as stream:
            return stream.read(_GLIMPSE_BYTES)
    except FileNotFoundError:
        return b""
