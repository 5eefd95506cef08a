"""What marks a dataset that `unidrive convert` has written, and what its provenance file says of the conversion."""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Literal

import msgspec

from unidrive_cli.errors import DatasetError

PROVENANCE = "unidrive.json"
MARKER = "UNFINISHED.txt"
WORK = ".unidrive"
MASKS = "masks"


class ConversionOptions(msgspec.Struct, frozen=True):
    """Options that the pictures and masks depend on; names and meanings are those of `convert`."""

    depth_limit_m: float
    ground_height_m: float
    ego_motion: bool
    cameras: list[str]
    masks: Literal["frame", "camera", "none"]
    low_coverage: str = "keep"


class SourceTables(msgspec.Struct, frozen=True):
    """The tables that were converted: the version folder's name and their digest."""

    version: str
    digest: str


class Conversion(msgspec.Struct, frozen=True):
    """How a dataset was converted."""

    options: ConversionOptions
    source: SourceTables


class _Provenance(msgspec.Struct, frozen=True):
    plan: Conversion


def is_converted(root: Path) -> bool:
    """Whether `unidrive convert` has written, or begun to write, the dataset in a folder."""
    return any((root / name).exists() for name in (PROVENANCE, MARKER, WORK))


def refuse_unfinished(root: Path) -> None:
    """Refuses a dataset that a command of ours has begun, or begun again, and not finished.

    Raises:
        DatasetError: it holds the marker or the work folder.
    """
    for name in (MARKER, WORK):
        if (root / name).exists():
            raise DatasetError(
                f"has not been finished ({name}).",
                where=str(root),
                hint="Give the same unidrive command again to complete it.",
            )


def read_conversion(root: Path) -> Conversion:
    """How the dataset in a folder was converted.

    Raises:
        DatasetError: it was not, the conversion has not finished, or its provenance file is broken.
    """
    path = root / PROVENANCE
    refuse_unfinished(root)
    try:
        return msgspec.json.decode(path.read_bytes(), type=_Provenance).plan
    except FileNotFoundError as error:
        raise DatasetError(
            f"was not written by unidrive convert: it has no {PROVENANCE}.", where=str(root)
        ) from error
    except OSError as error:
        raise DatasetError(f"cannot be read: {error.strerror}.", where=str(path)) from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise DatasetError(
            f"is not a provenance file of unidrive: {error}.", where=str(path), hint="Convert the dataset again."
        ) from error


def mask_name(picture_name: str) -> str:
    """Where the mask of a virtual picture is: masks/<CHANNEL>/<the picture's name>.png."""
    path = PurePosixPath(picture_name)
    return f"{MASKS}/{path.parent.name}/{path.stem}.png"


def camera_mask_name(channel: str) -> str:
    """Where the one mask of a virtual camera is (`--masks camera`)."""
    return f"{MASKS}/{channel}.png"
