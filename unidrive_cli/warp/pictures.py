"""Pictures in and out: strict decoding, JPEG and mask encoding."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import numpy.typing as npt
import simplejpeg

from unidrive_cli.errors import PictureError

Picture = npt.NDArray[np.uint8]

_JPEG_MAGIC = b"\xff\xd8\xff"
_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"


def picture_size(data: bytes, where: str) -> tuple[int, int]:
    """(width, height) in pixels, from the file's header alone.

    Raises:
        PictureError: neither a JPEG nor a PNG file.
    """
    if data.startswith(_PNG_MAGIC) and len(data) >= 24:
        width, height = struct.unpack(">II", data[16:24])
        return int(width), int(height)
    if data.startswith(_JPEG_MAGIC):
        try:
            height, width, _, _ = simplejpeg.decode_jpeg_header(data, strict=False)
        except (ValueError, KeyError) as error:
            raise PictureError(f"is a broken JPEG file ({_reason(error)}).", where=where) from error
        return int(width), int(height)
    what = "is empty" if not data else "is neither a JPEG nor a PNG file"
    raise PictureError(f"the picture {what}.", where=where)


def decode_picture(data: bytes, size_px: tuple[int, int], where: str) -> Picture:
    """Decodes a JPEG or PNG file as stored (EXIF orientation is ignored: the intrinsics know none).

    Args:
        data: the file.
        size_px: (width, height) that the tables promise; checked before memory is taken.
        where: what error sentences call the file.

    Returns:
        (height, width, 3) uint8, BGR.

    Raises:
        PictureError: broken, truncated, of another format or size.
    """
    check_size(data, size_px, where)
    if data.startswith(_JPEG_MAGIC):
        try:
            picture: Picture = simplejpeg.decode_jpeg(data, colorspace="BGR")
        except (ValueError, KeyError) as error:
            raise PictureError(f"is a broken JPEG file ({_reason(error)}).", where=where) from error
        return picture
    if not data.endswith(b"IEND\xaeB`\x82"):
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


def encode_jpeg(picture: Picture, quality: int) -> bytes:
    """JPEG bytes (4:2:0, accurate DCT) of a BGR picture (height, width, 3) uint8."""
    parameters = [
        cv2.IMWRITE_JPEG_QUALITY,
        quality,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420,
    ]
    return _encode(".jpg", picture, parameters)


def encode_mask(mask: npt.NDArray[np.uint8]) -> bytes:
    """1-bit PNG bytes of a mask (height, width) uint8: non-zero stays non-zero."""
    return _encode(".png", mask, [cv2.IMWRITE_PNG_BILEVEL, 1])


def _encode(suffix: str, picture: npt.NDArray[np.uint8], parameters: list[int]) -> bytes:
    done, data = cv2.imencode(suffix, picture, parameters)
    if not done:
        raise RuntimeError(f"OpenCV could not encode a {suffix} picture of shape {picture.shape}.")
    return bytes(data)


def _reason(error: Exception) -> str:
    if isinstance(error, KeyError):
        return "its header cannot be read"
    return str(error).split("(): ")[-1].rstrip(".")
