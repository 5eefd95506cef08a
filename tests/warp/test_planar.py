"""The renderer on planes: files of all kinds in, files out, with either codec."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import simplejpeg

from tests.frames import psnr_db
from unidrive_cli.errors import PictureError, UsageError
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.geometry.poses import inverse, pose, rotation_from_yaw_pitch_roll
from unidrive_cli.rig.model import Camera, Rig
from unidrive_cli.warp import turbojpeg
from unidrive_cli.warp.choices import WarpChoices
from unidrive_cli.warp.opencv_kernel import OpenCVRenderer
from unidrive_cli.warp.pictures import Picture, encode_jpeg
from unidrive_cli.warp.remap import Source
from unidrive_cli.warp.render import Renderer, Toolchain, choose_toolchain, open_renderer

CODECS = [
    pytest.param(
        "libturbojpeg",
        marks=pytest.mark.skipif(not turbojpeg.found(), reason="the library libturbojpeg is not installed"),
    ),
    "simplejpeg",
]
pytest.importorskip("numba", reason="the fused kernel needs numba")


def scene(width: int, height: int) -> Picture:
    """Soft colours and a few edges: what JPEG keeps well."""
    x, y = np.meshgrid(np.linspace(0, 1, width), np.linspace(0, 1, height))
    picture = np.stack([60 + 120 * x, 90 + 80 * y, 160 - 100 * x * y], axis=-1)
    picture[height // 3 : height // 2, width // 4 : width // 2] += 40
    return picture.astype(np.uint8)


def rig_of(width: int, height: int, hfov_deg: float = 70) -> Rig:
    at = pose(rotation_from_yaw_pitch_roll(5.0, -4.0, 3.0), [1.5, 0.1, 1.6])
    return Rig("r", "", (Camera("V", Pinhole.from_hfov(hfov_deg, width, height), at),))


def rendered(renderer: Renderer, path: Path, width: int, height: int) -> tuple[Picture, np.ndarray]:
    lens = Pinhole.from_hfov(110, width, height)
    source = Source(lens, inverse(pose(rotation_from_yaw_pitch_roll(0.0, 0.0, 0.0), [1.4, 0.0, 1.5])))
    (picture,) = renderer.render([path], [source], 95, "")
    return simplejpeg.decode_jpeg(picture.jpeg, colorspace="BGR"), picture.mask.copy()


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("size", [(320, 180), (321, 181), (33, 19)])
@pytest.mark.parametrize("kind", ["420", "422", "444", "grey", "png"])
def test_any_file_comes_out_as_the_opencv_path_shows_it(
    tmp_path: Path, codec: str, size: tuple[int, int], kind: str
) -> None:
    picture = scene(*size)
    path = tmp_path / "source"
    if kind == "png":
        path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
    elif kind == "grey":
        path.write_bytes(cv2.imencode(".jpg", picture[..., 0])[1].tobytes())
    else:
        path.write_bytes(simplejpeg.encode_jpeg(picture, 95, "BGR", kind))
    rig, choices = rig_of(size[0] - 1, size[1]), WarpChoices()
    fast, mask = rendered(open_renderer(Toolchain("numba", codec), rig, choices), path, *size)
    slow, same_mask = rendered(OpenCVRenderer(rig, choices), path, *size)
    np.testing.assert_array_equal(mask, same_mask)
    assert psnr_db(fast, slow) >= 38


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("cut", ["truncated", "garbled", "another size"])
def test_a_broken_file_is_refused(tmp_path: Path, codec: str, cut: str) -> None:
    data = bytearray(encode_jpeg(scene(320, 180), 95))
    if cut == "truncated":
        del data[len(data) // 2 :]
    elif cut == "garbled":
        data[len(data) // 2 : len(data) // 2 + 40] = b"\xff\xd9" * 20
    path = tmp_path / "source.jpg"
    path.write_bytes(data)
    size = (640, 180) if cut == "another size" else (320, 180)
    what = "is 320x180 pixels" if cut == "another size" else "is a broken JPEG file"
    with pytest.raises(PictureError, match=rf"source\.jpg: {what}"):
        rendered(open_renderer(Toolchain("numba", codec), rig_of(100, 60), WarpChoices()), path, *size)


def test_what_no_source_sees_is_black(tmp_path: Path) -> None:
    path = tmp_path / "source.jpg"
    path.write_bytes(encode_jpeg(np.full((180, 320, 3), 200, np.uint8), 95))
    renderer = open_renderer(Toolchain("numba", "simplejpeg"), rig_of(320, 180, 170), WarpChoices())
    picture, mask = rendered(renderer, path, 320, 180)
    far_from_covered = cv2.erode((mask == 0).astype(np.uint8), np.ones((33, 33))) > 0
    assert far_from_covered.any()
    assert picture[far_from_covered].max() <= 2


def test_the_toolchain_says_what_is_missing() -> None:
    assert choose_toolchain("opencv").identity["kernel"] == "opencv-fixed-point"
    assert choose_toolchain("numba", "simplejpeg") == Toolchain("numba", "simplejpeg")
    with pytest.raises(UsageError, match="--codec libturbojpeg works with --kernel numba only"):
        choose_toolchain("opencv", "libturbojpeg")
    if turbojpeg.found():
        assert choose_toolchain().codec == "libturbojpeg"
    else:
        with pytest.raises(UsageError, match="needs the library libturbojpeg, which was not found"):
            choose_toolchain("numba", "libturbojpeg")
