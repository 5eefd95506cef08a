"""The destination folder: whose it is, whether it is finished, and the marker until it is."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from unidrive_cli.errors import OutputError, UsageError

PROVENANCE = "unidrive.json"
RUN = "run.json"
WORK = ".unidrive"
RECEIPTS = "receipts"
MARKER = "UNFINISHED.txt"
_MARKER_TEXT = "unidrive convert has not finished here. Run the same command again to complete this dataset.\n"


@dataclass(frozen=True)
class Destination:
    """DST and the folders that the conversion keeps in it while it is not finished.

    Attributes:
        root: DST.
        made: whether this run made the folder; otherwise it was there, empty.
    """

    root: Path
    made: bool = False

    @property
    def work(self) -> Path:
        """Receipts, the plan and the tables before they are verified; gone when finished."""
        return self.root / WORK

    @property
    def receipts(self) -> Path:
        """One file per finished unit."""
        return self.work / RECEIPTS

    def write(self, name: str, data: bytes) -> None:
        """Writes a file below DST, whole or not at all: in the work folder first, then renamed.

        Args:
            name: POSIX path relative to DST.

        Raises:
            OutputError: it cannot be written.
        """
        path = self.root / name
        temporary = self.work / f"{path.name}.{os.getpid()}.part"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary.write_bytes(data)
            temporary.replace(path)
        except OSError as error:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise OutputError(
                f"cannot be written: {error.strerror}.",
                where=str(path),
                hint="When that is mended, the same command continues.",
            ) from error

    @property
    def finished(self) -> bool:
        """Whether this is a dataset of ours that was completed and verified."""
        return (self.root / PROVENANCE).is_file() and not self.work.exists()


def check_apart(source: Path, destination: Path) -> None:
    """Refuses a destination that is the source, lies inside it, or holds it.

    Raises:
        UsageError: it does.
    """
    src, dst = source.resolve(), destination.resolve()
    if src == dst or src in dst.parents:
        raise UsageError(f"DST {destination} is inside SRC {source}; the source is never written to.")
    if dst in src.parents:
        raise UsageError(f"SRC {source} is inside DST {destination}; choose another DST.")


def free_bytes(destination: Path) -> int:
    """Free space where the destination is or would be."""
    place = destination.absolute()
    while not place.exists():
        place = place.parent
    return shutil.disk_usage(place).free


def check_destination(root: Path, identity: dict[str, Any], *, force: bool) -> bool:
    """Whether DST already holds this very conversion, whole or in part.

    Raises:
        OutputError: DST is a file, or a folder of somebody else's.
        UsageError: DST holds a conversion with other options, and `force` is not given.
    """
    if not root.exists() and not root.is_symlink():
        return False
    if not root.is_dir():
        raise OutputError("is a file; a folder was expected.", where=str(root))
    destination = Destination(root)
    try:
        if not any(root.iterdir()):
            return False
        held = _held_identity(destination)
    except OSError as error:
        raise OutputError(f"cannot be read: {error.strerror}.", where=str(root)) from error
    if held is None:
        raise OutputError(
            "exists and was not made by unidrive; nothing in it is touched.",
            where=str(root),
            hint="Choose a DST that does not exist, or an empty folder.",
        )
    if held == identity:
        return True
    if not force:
        raise UsageError(
            f"{root} holds a conversion with other options ({_difference(held, identity)}).",
            hint="Choose another DST, or replace it with --force.",
        )
    return False


def begin(root: Path, identity: dict[str, Any], *, same: bool, force: bool) -> Destination:
    """Makes DST ready for the units; an old tree that is replaced is renamed before it is deleted.

    Args:
        same: DST holds this very conversion (`check_destination`).
        force: start over even so.

    Raises:
        OutputError: DST cannot be written.
    """
    try:
        if root.exists() and (force or not same) and any(root.iterdir()):
            old = root.with_name(f".{root.name}.unidrive-old")
            shutil.rmtree(old, ignore_errors=True)
            root.rename(old)
            shutil.rmtree(old)
        destination = Destination(root, made=not root.exists())
        destination.receipts.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}.", where=str(root)) from error
    destination.write(MARKER, _MARKER_TEXT.encode())
    destination.write(f"{WORK}/plan.json", json.dumps(identity, indent=1, sort_keys=True).encode())
    return destination


def abandon(destination: Destination) -> None:
    """Removes a destination in which nothing was finished, so that no trace of a failed start stays."""
    if not destination.work.is_dir() or any(destination.receipts.glob("*.json")):
        return
    for entry in destination.root.iterdir():
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry, ignore_errors=True)
        else:
            entry.unlink()
    if destination.made:
        destination.root.rmdir()


def _held_identity(destination: Destination) -> dict[str, Any] | None:
    for path, key in ((destination.work / "plan.json", None), (destination.root / PROVENANCE, "plan")):
        try:
            document = json.loads(path.read_bytes())
            held = document if key is None else document[key]
        except FileNotFoundError:
            continue
        except (ValueError, KeyError, TypeError):
            return None
        return held if isinstance(held, dict) else None
    return None


def _difference(held: dict[str, Any], wanted: dict[str, Any]) -> str:
    differences = []
    for group in ("options", "rig", "source"):
        old, new = held.get(group) or {}, wanted[group]
        for name in new:
            if isinstance(old, dict) and old.get(name) != new[name]:
                if name == "digest":
                    differences.append(f"another {group}")
                else:
                    differences.append(f"{name} {old.get(name)!r}, now {new[name]!r}")
    if not differences:
        differences.append("another version of unidrive")
    return "; ".join(dict.fromkeys(differences))
