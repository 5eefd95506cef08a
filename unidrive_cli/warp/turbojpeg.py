"""libturbojpeg, where the system has it: JPEG files to YUV 4:2:0 planes and back, without a colour conversion.

The functions of the library's second interface (1.4 and later, kept by version 3) are called directly: they are
few, and the wrappers in the package index want one version of the library or take new memory for every picture.
"""

from __future__ import annotations

import ctypes
import functools
from ctypes import c_char_p, c_int, c_ulong, c_void_p
from typing import Any

import numpy as np
import numpy.typing as npt

Plane = npt.NDArray[np.uint8]
Planes = tuple[Plane, Plane, Plane]

_NAMES = ("libturbojpeg.so.0", "libturbojpeg.dylib", "libturbojpeg.0.dylib")
_SUBSAMPLING_420 = 2
_YCBCR = 1
_ACCURATE_DCT = 4096
_NO_REALLOCATION = 1024


@functools.lru_cache(maxsize=1)
def _library() -> ctypes.CDLL | None:
    for name in _NAMES:
        try:
            return _typed(ctypes.CDLL(name))
        except (OSError, AttributeError):
            continue
    return None


def _typed(library: ctypes.CDLL) -> ctypes.CDLL:
    for function, result, arguments in (
        ("tjInitDecompress", c_void_p, []),
        ("tjInitCompress", c_void_p, []),
        ("tjGetErrorStr2", c_char_p, [c_void_p]),
        ("tjDecompressHeader3", c_int, [c_void_p, c_char_p, c_ulong, *[ctypes.POINTER(c_int)] * 4]),
        ("tjDecompressToYUVPlanes", c_int, [c_void_p, c_char_p, c_ulong, c_void_p, c_int, c_void_p, c_int, c_int]),
        (
            "tjCompressFromYUVPlanes",
            c_int,
            [c_void_p, c_void_p, c_int, c_void_p, c_int, c_int, c_void_p, c_void_p, c_int, c_int],
        ),
        ("tjBufSize", c_ulong, [c_int, c_int, c_int]),
        ("tjDestroy", c_int, [c_void_p]),
    ):
        entry = getattr(library, function)
        entry.restype, entry.argtypes = result, arguments
    return library


def found() -> bool:
    """Whether the library is here and has what is needed."""
    return _library() is not None


class TurboJpeg:
    """One handle for decoding and one for encoding, with the memory of the encoded file."""

    def __init__(self) -> None:
        library = _library()
        if library is None:
            raise RuntimeError("libturbojpeg was not found")
        self._library = library
        self._reader, self._writer = library.tjInitDecompress(), library.tjInitCompress()
        self._file = np.empty(0, dtype=np.uint8)

    def __del__(self) -> None:
        for handle in (getattr(self, "_reader", None), getattr(self, "_writer", None)):
            if handle:
                self._library.tjDestroy(handle)

    def is_yuv_420(self, data: bytes) -> bool:
        """Whether a JPEG file holds YCbCr with chroma of half the size both ways.

        Raises:
            ValueError: its header is broken.
        """
        width, height, subsampling, space = c_int(), c_int(), c_int(), c_int()
        self._check(
            self._library.tjDecompressHeader3(
                self._reader, data, len(data), *map(ctypes.byref, (width, height, subsampling, space))
            ),
            self._reader,
        )
        return subsampling.value == _SUBSAMPLING_420 and space.value == _YCBCR

    def decode(self, data: bytes, planes: Planes, size_px: tuple[int, int]) -> None:
        """Decodes a 4:2:0 JPEG file of (width, height) pixels into planes.

        Args:
            planes: Y, U, V, each with at least one row and one column more than its samples.

        Raises:
            ValueError: a broken or truncated file.
        """
        addresses, strides = _addresses(planes)
        width, height = size_px
        done = self._library.tjDecompressToYUVPlanes(
            self._reader, data, len(data), addresses, width, strides, height, _ACCURATE_DCT
        )
        self._check(done, self._reader)

    def encode(self, planes: Planes, quality: int) -> bytes:
        """A 4:2:0 JPEG file of planes Y (H, W), U and V (H / 2, W / 2, rounded up)."""
        height, width = planes[0].shape
        room = int(self._library.tjBufSize(width, height, _SUBSAMPLING_420))
        if self._file.size < room:
            self._file = np.empty(room, dtype=np.uint8)
        addresses, strides = _addresses(planes)
        file, size = c_void_p(self._file.ctypes.data), c_ulong(self._file.size)
        done = self._library.tjCompressFromYUVPlanes(
            self._writer, addresses, width, strides, height, _SUBSAMPLING_420, ctypes.byref(file),
            ctypes.byref(size), quality, _ACCURATE_DCT | _NO_REALLOCATION,
        )  # fmt: skip
        self._check(done, self._writer)
        return self._file[: size.value].tobytes()

    def _check(self, done: int, handle: int) -> None:
        if done != 0:
            raise ValueError(self._library.tjGetErrorStr2(handle).decode(errors="replace"))


def _addresses(planes: Planes) -> tuple[Any, Any]:
    addresses = (c_void_p * 3)(*(plane.ctypes.data for plane in planes))
    strides = (c_int * 3)(*(plane.strides[0] for plane in planes))
    return addresses, strides
