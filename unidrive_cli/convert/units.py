"""One unit of work: the pictures of a moment read, warped, encoded and written, its receipt last."""

from __future__ import annotations

import functools
import hashlib
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from unidrive_cli.convert.boxes import Box2d, seen_boxes
from unidrive_cli.convert.options import Masks, Options
from unidrive_cli.errors import OutputError, UnidriveError
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.rig.model import Rig
from unidrive_cli.tables.converted import WORK, mask_name
from unidrive_cli.tables.destination import RECEIPTS, Destination, begun_identity, digest_of
from unidrive_cli.warp.common import CommonMasks
from unidrive_cli.warp.pictures import encode_mask
from unidrive_cli.warp.remap import Source
from unidrive_cli.warp.render import Renderer, Toolchain, choose_toolchain, open_renderer

_JPEG_END = b"\xff\xd9"
_PNG_END = b"IEND\xaeB`\x82"
SKIP_HINT = "Restore it, or leave its sample out with --on-error skip."


@dataclass(frozen=True, eq=False)
class Job:
    """What all units of one conversion share; equal where the plan is the same.

    Attributes:
        destination: DST.
        rig, options, toolchain: the plan's.
        key: digest of the plan.
        common: the pixels that are not blackened; None blackens none.
    """

    destination: Destination
    rig: Rig
    options: Options
    toolchain: Toolchain
    key: str
    common: CommonMasks | None = None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Job) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


@dataclass(frozen=True, eq=False)
class Frame:
    """A unit as its worker needs it.

    Attributes:
        token: names it.
        pictures: file name of each virtual picture below DST, in the rig's order.
        paths, sources: file and camera of each source picture.
        witnesses: all cameras that took a picture of the sample, whether they are sources or not:
            the annotated visibility refers to them.
        ego_from_box: (n, 4, 4) annotated boxes in the reference ego frame, in table order.
        box_sizes_m: (n, 3) width, length, height.
    """

    token: str
    pictures: tuple[str, ...]
    paths: tuple[str, ...]
    sources: tuple[Source, ...]
    witnesses: tuple[Source, ...]
    ego_from_box: Float
    box_sizes_m: Float


class Receipt(msgspec.Struct, frozen=True):
    """What a finished unit leaves behind.

    Attributes:
        token: the unit's.
        covered: share of covered pixels per virtual camera.
        picture_bytes: size of each picture's file; 0 where it is left out.
        shown: per box, the share of what the source cameras see of it that the virtual rig still
            shows, 0 to 1; 0 where no virtual pixel shows it.
        unwitnessed: how many boxes no real camera saw.
        boxes: 2D boxes.
    """

    token: str
    covered: list[float]
    picture_bytes: list[int]
    shown: list[float]
    unwitnessed: int
    boxes: list[Box2d]


def receipt_name(token: str) -> str:
    """The receipt of a unit, below DST; hashed because tokens are not to be trusted as file names."""
    return f"{WORK}/{RECEIPTS}/{hashlib.sha256(token.encode()).hexdigest()[:32]}.json"


def read_receipt(destination: Destination, token: str, pictures: Sequence[str], masks: Masks) -> Receipt | None:
    """The receipt of a finished unit; None where it, a picture or a mask is missing, of another size or cut off.

    After a loss of power a receipt can be there and what it stands for not: empty, or zeros of the right length.
    """
    root = destination.root
    try:
        receipt = msgspec.json.decode((root / receipt_name(token)).read_bytes(), type=Receipt)
        whole = all(
            _ends_with(root / name, _JPEG_END, size)
            and (masks != "frame" or _ends_with(root / mask_name(name), _PNG_END))
            for name, size in zip(pictures, receipt.picture_bytes, strict=True)
            if size
        )
    except (OSError, ValueError):
        return None
    return receipt if whole else None


def _ends_with(path: Path, end: bytes, size: int | None = None) -> bool:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        length = os.fstat(descriptor).st_size
        if length < len(end) or (size is not None and length != size):
            return False
        return os.pread(descriptor, len(end), length - len(end)) == end
    finally:
        os.close(descriptor)


def check_machine(job: Job, source: Path) -> None:
    """Refuses a machine on which a unit would not become what the plan promises.

    Args:
        source: the version folder of SRC.

    Raises:
        OutputError: DST, with this very plan begun in it, is not seen here.
        UnidriveError: SRC is not seen here, or codec or kernel are others than the plan's.
        UsageError: they are not here.
    """
    plan = begun_identity(job.destination)
    if plan is None or digest_of(plan) != job.key:
        raise OutputError(
            f"{platform.node()} does not see this conversion in this folder.",
            where=str(job.destination.root),
            hint="SRC and DST must lie where all machines see them under the same paths, and DST takes one "
            "conversion at a time.",
        )
    if not source.is_dir():
        raise UnidriveError(
            f"{platform.node()} does not see this folder.",
            where=str(source),
            hint="SRC and DST must lie where all machines see them under the same paths.",
        )
    for name, here in choose_toolchain(job.toolchain.kernel, job.toolchain.codec).identity.items():
        if here != plan.get(name):
            raise UnidriveError(
                f"{platform.node()} would work with the {name} {here!r}, the plan with {plan.get(name)!r}; the "
                "pictures would not be the same.",
                hint="Install the same packages on all machines.",
            )


def run_unit(job: Job, frame: Frame) -> Receipt:
    """Does one unit of work.

    Raises:
        PictureError: a source picture is missing, broken or of another size.
        OutputError: a file cannot be written.
    """
    paths = [Path(path) for path in frame.paths]
    rendered = renderer_of(job).render(paths, frame.sources, job.options.quality, SKIP_HINT)
    sizes, covered, masks = [], [], []
    for picture, name in zip(rendered, frame.pictures, strict=True):
        covered.append(round(picture.covered, 6))
        if job.options.drops_picture(covered[-1]):
            sizes.append(0)
            masks.append(np.zeros_like(picture.mask))
            continue
        job.destination.write(name, picture.jpeg)
        if job.options.masks == "frame":
            job.destination.write(mask_name(name), encode_mask(picture.mask))
        sizes.append(len(picture.jpeg))
        masks.append(picture.mask)
    shown, unwitnessed, boxes = seen_boxes(
        frame.ego_from_box,
        frame.box_sizes_m,
        frame.witnesses,
        list(zip(job.rig.cameras, masks, strict=True)),
    )
    receipt = Receipt(frame.token, covered, sizes, shown, unwitnessed, boxes)
    job.destination.write(receipt_name(frame.token), msgspec.json.encode(receipt))
    return receipt


@functools.lru_cache(maxsize=1)
def renderer_of(job: Job) -> Renderer:
    """The job's renderer: one per worker process, because its memory and its tables outlive a unit."""
    return open_renderer(job.toolchain, job.rig, job.options, job.common)
