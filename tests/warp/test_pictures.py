"""Pictures in and out: every way a file can be broken is a sentence."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.frames import psnr_db
from unidrive_cli.errors import PictureError
from unidrive_cli.warp.pictures import decode_picture, encode_jpeg, encode_mask, picture_size


@pytest.fixture
def picture() -> np.ndarray:
    rows, columns = np.mgrid[0:90, 0:160]
    return np.stack([rows + columns, 255 - rows, columns], axis=-1).astype(np.uint8)


def _png(picture: np.ndarray) -> bytes:
    return bytes(cv2.imencode(".png", picture)[1])


def test_jpeg_and_png_come_back(picture: np.ndarray) -> None:
    jpeg = encode_jpeg(picture, 95)
    assert picture_size(jpeg, "x") == (160, 90)
    assert psnr_db(decode_picture(jpeg, (160, 90), "x"), picture) > 35
    np.testing.assert_array_equal(decode_picture(_png(picture), (160, 90), "x"), picture)


def test_exif_orientation_is_ignored(picture: np.ndarray) -> None:
    """A camera that tags its pictures as turned still delivers the pixels that its intrinsics describe."""
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    jpeg = encode_jpeg(picture, 95)
    turned = jpeg[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + jpeg[2:]
    assert cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_COLOR).shape == (160, 90, 3)
    np.testing.assert_array_equal(decode_picture(turned, (160, 90), "x"), decode_picture(jpeg, (160, 90), "x"))


def test_grey_png_becomes_three_channels(picture: np.ndarray) -> None:
    assert decode_picture(_png(picture[..., 0]), (160, 90), "x").shape == (90, 160, 3)


@pytest.mark.parametrize("keep", [0, 1, 3, 100, 0.5, -1])
@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_truncated_files_are_refused(picture: np.ndarray, suffix: str, keep: float) -> None:
    data = encode_jpeg(picture, 95) if suffix == "jpg" else _png(picture)
    kept = data[: int(len(data) * keep) if isinstance(keep, float) else keep]
    with pytest.raises(PictureError, match=r"^a/b\.img: ") as caught:
        decode_picture(kept, (160, 90), "a/b.img")
    assert caught.value.exit_code == 3


def test_damaged_jpeg_is_refused(picture: np.ndarray) -> None:
    data = bytearray(encode_jpeg(picture, 95))
    data[len(data) // 2 : len(data) // 2 + 2] = b"\xff\x33"
    with pytest.raises(PictureError, match="broken JPEG"):
        decode_picture(bytes(data), (160, 90), "x")


def test_another_size_is_refused_before_it_is_decoded() -> None:
    header = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + (60_000).to_bytes(4, "big") * 2
    with pytest.raises(PictureError, match="60000x60000 pixels, but its tables say 160x90"):
        decode_picture(header, (160, 90), "x")


def test_not_a_picture() -> None:
    with pytest.raises(PictureError, match="neither a JPEG nor a PNG"):
        decode_picture(b"GIF89a", (160, 90), "x")


@pytest.mark.parametrize("size", [(40, 60), (41, 67), (1, 1), (1, 9), (9, 1)])
def test_masks_are_one_bit_and_exact(size: tuple[int, int]) -> None:
    mask = (np.random.default_rng(1).integers(0, 3, size) * 100).astype(np.uint8)
    mask[size[0] // 2 :] = 255
    data = encode_mask(mask)
    assert data[24:26] == b"\x01\x00"  # bits per pixel; grey
    read = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(read, np.where(mask > 0, 255, 0))
