"""The destination folder: whose it is, whether it is finished, and the marker until it is."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import hashlib
import json
import os
import shutil
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from unidrive_cli.errors import DatasetError, OutputError, UsageError
from unidrive_cli.tables.converted import MARKER, MASKS, PROVENANCE, WORK

RUN = "run.json"
TRAINING = "TRAINING.md"
FAILED = "failures.txt"
KEPT_WORK = ".unidrive-done"
OLD = ".unidrive-old"
RECEIPTS = "receipts"
PLAN = "plan.json"
RESERVED = (PROVENANCE, RUN, TRAINING, FAILED, WORK, KEPT_WORK, OLD, MARKER, MASKS)
"""Names at the top of DST that no file of the source may take."""
_MARKER_TEXT = "unidrive has not finished here. Run the same command again to complete this dataset.\n"


@dataclass(frozen=True)
class Destination:
    """DST and the folders that a command keeps in it while the dataset is not finished.

    Attributes:
        root: DST, an absolute path without links.
        started: whether this run put the first things into it.
        provenance: name of the file that says how a finished dataset was made.
    """

    root: Path
    started: bool = False
    provenance: str = PROVENANCE

    @property
    def work(self) -> Path:
        """Receipts, the plan and the tables before they are verified."""
        return self.root / WORK

    @property
    def kept_work(self) -> Path:
        """What becomes of `work` in the one step that finishes a dataset.

        Kept where samples were left out, so that the same command tries those again; removed otherwise.
        """
        return self.root / KEPT_WORK

    @property
    def finished(self) -> bool:
        """Whether this is a dataset of ours that was completed and verified."""
        return (self.root / self.provenance).is_file() and not self.work.exists()

    @property
    def folds_case(self) -> bool:
        """Whether names that differ only by case are one file here; known once `begin` or `join` were called."""
        return (self.work / PLAN.upper()).exists()

    def write(self, name: str, data: bytes) -> None:
        """Writes a file below DST, whole or not at all: in the work folder first, then renamed.

        Args:
            name: POSIX path relative to DST.

        Raises:
            OutputError: it cannot be written.
        """
        path = self.root / name
        temporary = self.work / f"{path.name[:100]}.{uuid.uuid4().hex}.part"  # no two machines choose the same
        try:
            temporary.write_bytes(data)  # fails where the work folder is gone: a late worker adds nothing to DST
            try:
                temporary.replace(path)
            except FileNotFoundError:
                path.parent.mkdir(parents=True, exist_ok=True)
                temporary.replace(path)
        except OSError as error:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise OutputError(
                f"cannot be written: {error.strerror}.",
                where=str(path),
                hint="When that is mended, the same command continues.",
            ) from error


def check_apart(source: Path, destination: Path, names: tuple[str, str] = ("SRC", "DST")) -> None:
    """Refuses a destination that is the source, lies inside it, or holds it.

    Folders at the top of the source may be links to other disks; their targets count too.

    Args:
        names: what the command calls the two.

    Raises:
        UsageError: it does.
        DatasetError, OutputError: a path that cannot be followed.
    """
    try:
        tops = [entry for entry in source.iterdir() if entry.is_symlink()] if source.is_dir() else []
        places = [source, *tops]
        sources = [place.resolve() for place in places]
    except (OSError, RuntimeError) as error:
        raise DatasetError(f"cannot be read: {error}.", where=str(source)) from error
    dst = resolved_destination(destination)
    of_src, of_dst = names
    for place, src in zip(places, sources, strict=True):
        if src == dst or src in dst.parents:
            lies = "is" if src == dst else "is inside"
            raise UsageError(f"{of_dst} {destination} {lies} {of_src} {place}, which is never written to.")
        if dst in src.parents:
            raise UsageError(f"{of_src} {place} is inside {of_dst} {destination}; choose another {of_dst}.")


def resolved_destination(root: Path) -> Path:
    """DST as an absolute path without links.

    Raises:
        OutputError: a link that leads to itself, or a name that cannot be.
    """
    try:
        path = root.resolve()
        if root.is_symlink() and not path.exists():
            raise OutputError("is a link that leads nowhere.", where=str(root))
        path.exists()
    except (OSError, RuntimeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(f"cannot be used: {reason}.", where=str(root)[:200]) from error
    return path


def free_bytes(destination: Path) -> int:
    """Free space where the destination is or would be."""
    return shutil.disk_usage(_existing(resolved_destination(destination))).free


def check_space(destination: Destination, needed_bytes: int) -> None:
    """Refuses a destination on a disk that is too full.

    Args:
        needed_bytes: an estimate of what will be written.

    Raises:
        OutputError: less is free.
    """
    free = free_bytes(destination.root)
    if needed_bytes > free:
        raise OutputError(
            f"what is to be written will take about {needed_bytes / 1e9:.3g} GB, and {free / 1e9:.3g} GB are free.",
            where=str(destination.root),
            hint="Free some, or start all the same with --no-space-check: where the disk is full the run stops, "
            "and the same command continues.",
        )


def same_device(source: Path, destination: Path) -> bool:
    """Whether hard links from the source to the destination are possible at all."""
    return source.stat().st_dev == _existing(resolved_destination(destination)).stat().st_dev


def check_destination(root: Path, identity: dict[str, Any], *, force: bool, provenance: str = PROVENANCE) -> bool:
    """Whether DST already holds this very dataset, whole or in part.

    Args:
        root: `resolved_destination`.
        identity: all that the dataset depends on, in groups of named values.
        provenance: name of the file that says how a finished dataset was made.

    Raises:
        OutputError: DST is a file, a folder of somebody else's, or cannot be made.
        UsageError: DST holds a dataset of ours with other options, and `force` is not given.
    """
    try:
        if not root.exists():
            existing = _existing(root)
            if not os.access(existing, os.W_OK | os.X_OK):
                code = errno.EROFS if os.statvfs(existing).f_flag & os.ST_RDONLY else errno.EACCES
                raise OutputError(f"cannot be written: {os.strerror(code)}.", where=str(root))
            return False
        if not root.is_dir():
            raise OutputError("is a file; a folder was expected.", where=str(root))
        if {entry.name for entry in root.iterdir()} <= {WORK, MARKER, OLD} and not (root / WORK / PLAN).exists():
            return False
        held = _held_identity(Destination(root, provenance=provenance))
    except OSError as error:
        raise OutputError(f"cannot be read: {error.strerror}.", where=str(root)) from error
    if held is None:
        raise OutputError(
            "exists and was not made by unidrive; nothing in it is touched.",
            where=str(root),
            hint="Choose a DST that does not exist, or an empty folder.",
        )
    if held != identity and not force:
        raise UsageError(
            f"{root} holds a dataset with other options ({_difference(held, identity)}).",
            hint="Choose another DST, or replace it with --force.",
        )
    return held == identity


def digest_of(identity: dict[str, Any]) -> str:
    """SHA-256 (hex) of what a dataset depends on."""
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()


def begun_identity(destination: Destination) -> dict[str, Any] | None:
    """What the dataset depends on that was begun here and is not finished; None where there is none."""
    try:
        document = json.loads((destination.work / PLAN).read_bytes())
    except (OSError, ValueError):
        return None
    return document if isinstance(document, dict) else None


@contextlib.contextmanager
def held(root: Path, *, shared: bool = False) -> Iterator[None]:
    """Makes DST and holds it for this process: a second conversion into it is refused.

    The hold ends with the process, however it ends. A folder that was made and stays empty is removed.

    Args:
        root: `resolved_destination`.
        shared: hold it together with others that share it; only those that do not are refused.

    Raises:
        OutputError: DST cannot be made, or another process holds it.
    """
    missing = [place for place in (root, *root.parents) if not place.exists()]
    try:
        root.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(root, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}.", where=str(root)) from error
    try:
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(descriptor)
        raise OutputError(
            "another unidrive is writing here.", where=str(root), hint="Wait until it has ended, or stop it."
        ) from error
    except OSError:
        pass  # a file system without locks
    try:
        yield
    finally:
        os.close(descriptor)
        with contextlib.suppress(OSError):
            for place in missing:
                place.rmdir()


def begin(
    root: Path, identity: dict[str, Any], *, same: bool, force: bool, provenance: str = PROVENANCE
) -> Destination:
    """Makes DST ready for the units; an old tree that is replaced is moved aside before it is deleted.

    Args:
        root: `resolved_destination`, which this process holds.
        same: DST holds this very dataset (`check_destination`).
        force: start over even so.

    Raises:
        OutputError: DST cannot be written.
    """
    try:
        if force or not same:
            _clear(root, provenance)
        destination = Destination(root, not (root / WORK).exists(), provenance)
        if destination.kept_work.exists() and destination.started:
            destination = Destination(root, provenance=provenance)
            destination.kept_work.rename(destination.work)
        destination.work.mkdir(exist_ok=True)
        for half_written in destination.work.glob("*.part"):
            half_written.unlink()
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}.", where=str(root)) from error
    try:
        _write_plan(destination, identity)
    except OutputError:
        abandon(destination)
        raise
    return destination


def join(root: Path, identity: dict[str, Any]) -> Destination:
    """Makes DST ready for a share of the units; others may be at work there, or do this at the same moment.

    Args:
        root: `resolved_destination`, which this process holds together with the others.

    Raises:
        OutputError: DST cannot be written.
    """
    destination = Destination(root)
    try:
        shutil.rmtree(root / OLD, ignore_errors=True)
        if not destination.work.exists():
            with contextlib.suppress(FileNotFoundError):
                destination.kept_work.rename(destination.work)
        destination.work.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror}.", where=str(root)) from error
    if begun_identity(destination) is None or not (root / MARKER).exists():
        _write_plan(destination, identity)
    return destination


@contextlib.contextmanager
def writing(
    destination: Destination, hint: str = "Run the same command again when this is mended."
) -> Iterator[None]:
    """What the disk refuses meanwhile is an error of the destination.

    Raises:
        OutputError: a file could not be written.
    """
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"cannot be written: {error.strerror}.", where=str(error.filename or destination.root), hint=hint
        ) from error


def finish(destination: Destination, *, keep_work: bool) -> None:
    """Takes the marker away: the rename is the moment from which the dataset is complete.

    Everything is on the disk before it, so that no loss of power leaves a dataset that looks complete and is not.

    Args:
        keep_work: keep the receipts, because samples were left out.

    Raises:
        OutputError: DST cannot be written.
    """
    to_disk(destination.root)
    try:
        shutil.rmtree(destination.kept_work, ignore_errors=True)
        destination.work.rename(destination.kept_work)
        sweep(destination, keep_work=keep_work)
    except OSError as error:
        raise OutputError(f"cannot be removed: {error.strerror}.", where=str(destination.work)) from error


def to_disk(root: Path) -> None:
    """Waits until all that was written to the file system of a folder is on its disk.

    Raises:
        OutputError: it could not be brought there.
    """
    try:
        descriptor = os.open(root, os.O_RDONLY | os.O_DIRECTORY)
        try:
            if ctypes.CDLL(None, use_errno=True).syncfs(descriptor):
                raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
        finally:
            os.close(descriptor)
    except OSError as error:
        raise OutputError(
            f"what was written did not reach the disk: {error.strerror}.",
            where=str(root),
            hint="When that is mended, the same command continues.",
        ) from error


def sweep(destination: Destination, *, keep_work: bool) -> None:
    """Removes what a finished dataset does not need."""
    (destination.root / MARKER).unlink(missing_ok=True)
    if not keep_work:
        shutil.rmtree(destination.kept_work, ignore_errors=True)


def abandon(destination: Destination) -> None:
    """Removes what this run put into DST, where it was the first to do so and finished nothing."""
    finished_units = any((destination.work / RECEIPTS).glob("*.json"))
    if not destination.started or finished_units or (destination.root / destination.provenance).exists():
        return
    with contextlib.suppress(OSError):
        _clear(destination.root, destination.provenance)


def _existing(place: Path) -> Path:
    while not place.exists():
        place = place.parent
    return place


def _write_plan(destination: Destination, identity: dict[str, Any]) -> None:
    destination.write(f"{WORK}/{PLAN}", json.dumps(identity, indent=1, sort_keys=True).encode())
    destination.write(MARKER, _MARKER_TEXT.encode())


def _clear(root: Path, provenance: str) -> None:
    """Empties DST. What makes it look like a dataset is moved aside first, in case this is interrupted."""
    old = root / OLD
    entries = [entry for entry in root.iterdir() if entry != old]
    if entries:
        old.mkdir(exist_ok=True)
        for entry in sorted(entries, key=lambda entry: entry.name != provenance):
            aside = old / entry.name
            if aside.is_dir() and not aside.is_symlink():
                shutil.rmtree(aside)
            entry.rename(aside)
    if old.exists():
        shutil.rmtree(old)


def _held_identity(destination: Destination) -> dict[str, Any] | None:
    for path, key in ((destination.work / PLAN, None), (destination.root / destination.provenance, "plan")):
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
    for group, new in wanted.items():
        old = held.get(group) or {}
        for name in {**new, **old} if isinstance(new, dict) and isinstance(old, dict) else ():
            if old.get(name) != new.get(name):
                if name == "digest":
                    differences.append(f"another {group}")
                else:
                    differences.append(f"{name} {old.get(name)!r}, now {new.get(name)!r}")
    if not differences:
        differences.append("another version of unidrive")
    return "; ".join(dict.fromkeys(differences))


@contextlib.contextmanager
def as_finished(destination: Destination, staged_tables: Path, version: str) -> Iterator[Path]:
    """A folder of links that shows an unfinished dataset as it will be, for its verification.

    Args:
        staged_tables: folder with the tables, which are not in their place yet.
        version: name of the version folder that they will be.
    """
    root = destination.work / "check"
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir()
    for entry in destination.root.iterdir():
        if entry.name not in (WORK, KEPT_WORK, MARKER, version):
            (root / entry.name).symlink_to(entry)
    (root / version).symlink_to(staged_tables)
    yield root
    shutil.rmtree(root)
