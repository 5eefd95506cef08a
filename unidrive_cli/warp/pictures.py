"""Pictures in and out: strict decoding, JPEG and mask encoding."""

from __future__ import annotations

import contextlib
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import simplejpeg

from unidrive_cli.errors import PictureError

Picture = npt.NDArray[np.uint8]

_JPEG_MAGIC = b"\xff\xd8\xff"
_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"IEND\xaeB`\x82"
_PNG_FILTER_UP = 2
_QUALITIES = (50, 80, 90, 95, 100)
_BYTES_PER_PIXEL = (0.06, 0.11, 0.145, 0.21, 0.55)


def picture_size(data: bytes, where: str) -> tuple[int, int]:
    """(width, height) in pixels, from the file's header alone.

    Raises:
        PictureError: neither a JPEG nor a PNG file.
    """
    if data.startswith(_PNG_MAGIC) and len(data) >= 24:
        width, height = struct.unpack(">II", data[16:24])
        return int(width), int(height)
    if is_jpeg(data):
        try:
            height, width, _, _ = simplejpeg.decode_jpeg_header(data, strict=False)
        except (ValueError, KeyError) as error:
            raise PictureError(f"is a broken JPEG file ({reason(error)}).", where=where) from error
        return int(width), int(height)
    what = "is empty" if not data else "is neither a JPEG nor a PNG file"
    raise PictureError(f"the picture {what}.", where=where)


def is_jpeg(data: bytes) -> bool:
    """Whether a file starts like a JPEG file."""
    return data.startswith(_JPEG_MAGIC)


def decode_picture(
    data: bytes,
    size_px: tuple[int, int],
    where: str,
    *,
    replicate_chroma: bool = False,
    memory: Picture | None = None,
) -> Picture:
    """Decodes a JPEG or PNG file as stored (EXIF orientation is ignored: the intrinsics know none).

    Args:
        data: the file.
        size_px: (width, height) that the tables promise; checked before memory is taken.
        where: what error sentences call the file.
        replicate_chroma: spread the chroma of a JPEG file without smoothing.
        memory: contiguous bytes, enough for the picture, that a JPEG file may be decoded into.

    Returns:
        (height, width, 3) uint8, BGR.

    Raises:
        PictureError: broken, truncated, of another format or size.
    """
    check_size(data, size_px, where)
    if is_jpeg(data):
        try:
            picture: Picture = simplejpeg.decode_jpeg(
                data, colorspace="BGR", fastupsample=replicate_chroma, buffer=memory
            )
        except (ValueError, KeyError) as error:
            raise PictureError(f"is a broken JPEG file ({reason(error)}).", where=where) from error
        return picture
    if not data.endswith(_PNG_END):
        raise PictureError("is a truncated PNG file: its end is missing.", where=where)
    decoded = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if decoded is None:
        raise PictureError("is a broken PNG file.", where=where)
    return np.asarray(decoded, dtype=np.uint8)


def check_size(data: bytes, size_px: tuple[int, int], where: str) -> None:
    """Refuses a picture whose header says another size than (width, height) in pixels.

    Raises:
        PictureError: it does, or has no header.
    """
    size = picture_size(data, where)
    if size != size_px:
        raise PictureError(
            f"is {size[0]}x{size[1]} pixels, but its tables say {size_px[0]}x{size_px[1]}.",
            where=where,
            hint="The intrinsics would not fit; correct the tables or the picture.",
        )


def size_of_file(path: Path) -> tuple[int, int]:
    """(width, height) in pixels of a picture file, from its header.

    Raises:
        PictureError: it cannot be read, or is no picture.
    """
    return picture_size(read_head(path), str(path))


def read_head(path: Path, hint: str = "") -> bytes:
    """The first 64 kB of a picture, which hold its size.

    Raises:
        PictureError: it cannot be read; `hint` says what to do about it.
    """
    try:
        with path.open("rb") as stream:
            return stream.read(1 << 16)
    except OSError as error:
        raise PictureError(f"the picture cannot be read: {error.strerror}.", where=str(path), hint=hint) from error


def read_picture(path: Path, size_px: tuple[int, int], hint: str = "") -> Picture:
    """The decoded picture (height, width, 3) of a file, BGR.

    Args:
        size_px: (width, height) that the tables promise.
        hint: what to do about a file that is missing or broken.

    Raises:
        PictureError: missing, broken, or of another size.
    """
    with hinting(hint):
        return decode_picture(read_file(path), size_px, str(path))


@contextlib.contextmanager
def hinting(hint: str) -> Iterator[None]:
    """Adds what to do to the picture errors that have no hint of their own."""
    try:
        yield
    except PictureError as error:
        raise PictureError(error.what, where=error.where, hint=error.hint or hint) from error


def read_mask(path: Path, size_px: tuple[int, int]) -> npt.NDArray[np.bool_]:
    """Where a mask file (a PNG with one channel) of (width, height) pixels is not zero.

    Raises:
        PictureError: missing, broken, of another form or size.
    """
    mask: npt.NDArray[np.bool_] = _read_plane(path, size_px) > 0
    return mask


def read_instances(path: Path, size_px: tuple[int, int]) -> npt.NDArray[np.uint16]:
    """The numbers (height, width) in an instance picture, a 16-bit PNG with one channel.

    Raises:
        PictureError: missing, broken, of another form or size.
    """
    plane = _read_plane(path, size_px)
    if plane.dtype != np.uint16:
        raise PictureError(f"has {plane.dtype} pixels; a 16-bit PNG was expected.", where=str(path))
    return plane


def _read_plane(path: Path, size_px: tuple[int, int]) -> npt.NDArray[Any]:
    data = read_file(path)
    check_size(data, size_px, str(path))
    plane = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if plane is None or not data.endswith(_PNG_END):
        raise PictureError("is a broken PNG file.", where=str(path))
    if plane.ndim != 2:
        raise PictureError(f"has {plane.shape[2]} channels; one was expected.", where=str(path))
    return np.asarray(plane)


def read_file(path: Path) -> bytes:
    """The bytes of a picture file.

    Raises:
        PictureError: it is missing or cannot be read.
    """
    try:
        if not path.is_file():
            raise PictureError("the picture is missing or is no file.", where=str(path))
        return path.read_bytes()
    except OSError as error:
        raise PictureError(f"the picture cannot be read: {error.strerror}.", where=str(path)) from error


def encode_jpeg(picture: Picture, quality: int) -> bytes:
    """JPEG bytes (4:2:0, accurate DCT) of a BGR picture (height, width, 3) uint8."""
    parameters = [
        cv2.IMWRITE_JPEG_QUALITY,
        quality,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420,
    ]
    return _encode(".jpg", picture, parameters)


def jpeg_bytes(pixels: int, quality: int) -> int:
    """Roughly the size of JPEG files of streets with so many pixels in all, as nuScenes' pictures were measured."""
    return int(pixels * np.interp(quality, _QUALITIES, _BYTES_PER_PIXEL))


def encode_mask(mask: npt.NDArray[np.uint8]) -> bytes:
    """1-bit PNG bytes of a mask (height, width) uint8: non-zero stays non-zero.

    Rows are stored as differences to the row above, which are nearly all zero.
    """
    height, width = mask.shape
    packed = np.packbits(mask, axis=1)
    rows = np.full((height, 1 + packed.shape[1]), _PNG_FILTER_UP, dtype=np.uint8)
    rows[0, 1:] = packed[0]
    np.subtract(packed[1:], packed[:-1], out=rows[1:, 1:])
    header = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    chunks = (b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), zlib.Z_BEST_SPEED)), (b"IEND", b"")
    return _PNG_MAGIC + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


def _encode(suffix: str, picture: npt.NDArray[np.uint8], parameters: list[int]) -> bytes:
    done, data = cv2.imencode(suffix, picture, parameters)
    if not done:
        raise RuntimeError(f"OpenCV could not encode a {suffix} picture of shape {picture.shape}.")
    return bytes(data)


def reason(error: Exception) -> str:
    """What a JPEG decoder complains of."""
    if isinstance(error, KeyError):
        return "its header cannot be read"
    return str(error).split("(): ")[-1].rstrip(".")
