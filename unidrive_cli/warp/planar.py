"""The renderer on YUV 4:2:0 planes: files decoded to planes in reused memory, the fused kernel, planes encoded."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import simplejpeg

from unidrive_cli.errors import PictureError
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.geometry.blending import BORDER_FLOOR, PARALLAX_FLOOR
from unidrive_cli.geometry.lenses import Lens, Pinhole
from unidrive_cli.rig.model import Rig
from unidrive_cli.warp import fused
from unidrive_cli.warp.choices import WarpChoices
from unidrive_cli.warp.common import CommonMasks, blanks_of
from unidrive_cli.warp.exposure import Exposure, brighten
from unidrive_cli.warp.lens_numbers import lens_numbers, numbers_of_all
from unidrive_cli.warp.own_car import HALF_PX, OwnCar, hidden_of
from unidrive_cli.warp.pictures import check_size, decode_picture, hinting, is_jpeg, read_file, reason
from unidrive_cli.warp.reduction import MAX_REDUCTION, STEPS, Reductions, reduced_size
from unidrive_cli.warp.remap import MIN_SHARE, Mask, Source, VirtualView, virtual_views
from unidrive_cli.warp.render import VirtualPicture
from unidrive_cli.warp.turbojpeg import Planes, TurboJpeg

Bytes = npt.NDArray[np.uint8]
Sizes = tuple[tuple[int, int], ...]


class PlanarRenderer:
    """Renders with the fused kernel; its memory does not depend on the number of frames."""

    def __init__(self, rig: Rig, choices: WarpChoices, codec: str, common: CommonMasks | None = None) -> None:
        """
        Args:
            codec: `libturbojpeg` or `simplejpeg`.
            common: blackens what is not common.

        Raises:
            RigError: a virtual camera below the ground, or a depth limit below its height.
        """
        views = virtual_views(rig, choices.depth_limit_m, choices.ground_height_m)
        memory = np.empty(max(Canvas.bytes_of(view.camera.lens) for view in views), dtype=np.uint8)
        self._canvases = [Canvas(view, memory) for view in views]
        self._blanks = blanks_of(common, len(views))
        self._nearest = choices.blend == "nearest"
        self._reductions = Reductions(views, anti_alias=choices.anti_alias)
        self._exposure = Exposure(views) if choices.exposure == "gain" else None
        self._turbo = TurboJpeg() if codec == "libturbojpeg" else None
        self._atlas: Atlas | None = None

    def render(
        self, paths: Sequence[Path], sources: Sequence[Source], quality: int, hint: str
    ) -> Iterator[VirtualPicture]:
        """See `unidrive_cli.warp.render.Renderer`."""
        sizes = tuple((source.lens.width_px, source.lens.height_px) for source in sources)
        reductions = self._reductions.of(sources)
        copies = tuple(sorted({(j, n) for of_view in reductions for j, n in enumerate(of_view) if n > 1}))
        if self._atlas is None or (self._atlas.sizes, self._atlas.copies) != (sizes, copies):
            self._atlas = Atlas(sizes, copies)
        with hinting(hint):
            for index, path in enumerate(paths):
                self._atlas.load(index, path, self._turbo)
        if self._exposure:
            self._atlas.brighten(self._exposure.gains(sources, self._atlas.lumas))
        self._atlas.reduce()
        for canvas, blanks, of_view in zip(self._canvases, self._blanks, reductions, strict=True):
            canvas.draw(self._atlas, sources, nearest=self._nearest, reductions=of_view)
            covered_px = canvas.covered_px
            if blanks:
                blanks.cover(canvas.mask)
                blanks.blank_planes(canvas.planes)
                covered_px = cv2.countNonZero(canvas.mask)
            yield VirtualPicture(self._encode(canvas.planes, quality), canvas.mask, covered_px)

    def _encode(self, planes: Planes, quality: int) -> bytes:
        if self._turbo:
            return self._turbo.encode(planes, quality)
        return bytes(simplejpeg.encode_jpeg_yuv_planes(*planes, quality, fastdct=False))


class Atlas:
    """The planes of all source pictures of a frame, and of their reduced copies, in one block of memory.

    Attributes:
        sizes: (width, height) in pixels of each picture.
        copies: (picture, n) of each copy that is n times smaller.
        layout: (pictures + copies, LAYOUT_COLUMNS) int64, where the kernel finds them.
        memory: uint8.
    """

    def __init__(self, sizes: Sizes, copies: tuple[tuple[int, float], ...] = ()) -> None:
        self.sizes = sizes
        self.copies = copies
        self.layout = np.zeros((len(sizes) + len(copies), fused.LAYOUT_COLUMNS), dtype=np.int64)
        planes = [np.array([width, height, _half(width), _half(height)]) for width, height in sizes]
        planes += [np.array([reduced_size(side, n) for side in planes[j]]) for j, n in copies]
        offset = 0
        for row, sides in zip(self.layout, planes, strict=True):
            row[fused.SIZES : fused.SIZES + 4] = sides
            for plane in range(3):
                chroma = plane > 0
                plane_width, plane_height = row[fused.SIZES + 2 * chroma : fused.SIZES + 2 * chroma + 2]
                row[fused.STRIDES + chroma] = plane_width + 2
                row[fused.PLANES + plane] = offset
                offset += int(plane_width + 2) * int(plane_height + 2)
        self.memory = np.zeros(offset, dtype=np.uint8)
        self._bgr = np.empty(0, dtype=np.uint8)
        widest = max((width for width, _ in sizes), default=0)
        self._sums = np.empty((2, widest + int(MAX_REDUCTION) + 2), dtype=np.uint32)

    def layout_of(self, reductions: Sequence[float]) -> npt.NDArray[np.int64]:
        """The layout (pictures, LAYOUT_COLUMNS) of the copies that one virtual camera samples; 1 is the picture."""
        rows = [j if n == 1 else len(self.sizes) + self.copies.index((j, n)) for j, n in enumerate(reductions)]
        layout: npt.NDArray[np.int64] = self.layout[rows]
        return layout

    def planes(self, index: int) -> Planes:
        """Y, U, V of a picture or a copy, each with two rows and two columns more than its samples."""
        row = self.layout[index]
        return _plane(self.memory, row, 0), _plane(self.memory, row, 1), _plane(self.memory, row, 2)

    def load(self, index: int, path: Path, turbo: TurboJpeg | None) -> None:
        """Reads a picture file into its planes.

        Raises:
            PictureError: missing, broken, or of another size.
        """
        data, planes = read_file(path), self.planes(index)
        check_size(data, self.sizes[index], str(path))
        if turbo and is_jpeg(data):
            try:
                if turbo.is_yuv_420(data):
                    turbo.decode(data, planes, self.sizes[index])
                    return
            except ValueError as error:
                raise PictureError(f"is a broken JPEG file ({reason(error)}).", where=str(path)) from error
        width, height = self.sizes[index]
        if self._bgr.size < 3 * width * height:
            self._bgr = np.empty(3 * width * height, dtype=np.uint8)
        picture = decode_picture(data, (width, height), str(path), replicate_chroma=True, memory=self._bgr)
        fused.split_planes(picture, *planes)

    @property
    def lumas(self) -> list[Bytes]:
        """Y of each picture."""
        return [self.planes(index)[0] for index in range(len(self.sizes))]

    def brighten(self, gains: Float) -> None:
        """Multiplies the colours of each picture by its gain (n,)."""
        for index, gain in enumerate(gains):
            for plane, zero in zip(self.planes(index), (0, 128, 128), strict=True):
                brighten(plane, gain, zero)

    def reduce(self) -> None:
        """Makes the copies of the pictures."""
        for row, (picture, n) in enumerate(self.copies, len(self.sizes)):
            sides = self.layout[picture, fused.SIZES : fused.SIZES + 4]
            for plane, (whole, copy) in enumerate(zip(self.planes(picture), self.planes(row), strict=True)):
                width, height = sides[2 * (plane > 0) :][:2]
                fused.reduce_plane(whole, height, width, round(STEPS * n), *self._sums, copy)


class Canvas:
    """A virtual camera and the memory that its picture is drawn into.

    Attributes:
        view: the virtual camera.
        scene: (7,) float64, see `fused.PER_LENGTH`.
        xs, ys: coordinates of the pixels, and of the chroma samples, on the plane z = 1; (n,) float64 each.
        covered_px: how many pixels of the picture that was drawn last a source saw.
    """

    def __init__(self, view: VirtualView, memory: Bytes | None = None) -> None:
        """
        Args:
            memory: at least `bytes_of` the lens, to be used instead of its own: canvases that are encoded before
                the next is drawn share it, and it stays in the cache.
        """
        lens = view.camera.pinhole
        width, height = lens.width_px, lens.height_px
        ground, centre = view.half_ball.ground, view.half_ball.centre_ego
        self.view = view
        self.scene = np.array(
            [
                1 / view.half_ball.radius_m,
                *(-(ground.normal @ view.camera.ego_from_cam[:3, :3]) / float(ground.height_m(centre))),
                BORDER_FLOOR,
                PARALLAX_FLOOR,
                MIN_SHARE,
            ]
        )
        self.xs = [
            (columns - lens.cx_px) / lens.fx_px for columns in (np.arange(float(width)), _chroma_places(width))
        ]
        self._xs32 = [np.append(xs, np.zeros(fused.LANES)).astype(np.float32) for xs in self.xs]
        self.ys = [(rows - lens.cy_px) / lens.fy_px for rows in (np.arange(float(height)), _chroma_places(height))]
        self._memory = np.empty(self.bytes_of(lens), dtype=np.uint8) if memory is None else memory
        self._covered = np.empty(width * height, dtype=np.uint8)
        self.covered_px = 0
        self._scratch: tuple[npt.NDArray[np.generic], ...] = ()
        self._sources = 0

    @staticmethod
    def bytes_of(lens: Lens) -> int:
        """What the three planes of a picture take, with their padding."""
        return lens.width_px * lens.height_px + 2 * _half(lens.width_px) * _half(lens.height_px) + 3 * fused.LANES

    @property
    def mask(self) -> Mask:
        """(H, W) uint8, 255 where a source saw the pixel."""
        return self._covered.reshape(len(self.ys[0]), len(self.xs[0]))

    @property
    def planes(self) -> Planes:
        """Y (H, W), U and V (H / 2, W / 2, rounded up) of the picture that was drawn last."""
        planes, start = [], 0
        for chroma in (0, 1, 1):
            shape = len(self.ys[chroma]), len(self.xs[chroma])
            planes.append(self._memory[start : start + shape[0] * shape[1]].reshape(shape))
            start += shape[0] * shape[1] + fused.LANES
        return planes[0], planes[1], planes[2]

    def draw(
        self, atlas: Atlas, sources: Sequence[Source], *, nearest: bool, reductions: Sequence[float] = ()
    ) -> None:
        """Draws the picture and its mask.

        Args:
            reductions: which copy of each source is sampled; the full pictures where empty.
        """
        reductions = tuple(reductions) or (1.0,) * len(sources)
        boxes, hidden = _hidden(tuple(source.own_car for source in sources), reductions)
        layout = atlas.layout_of(reductions)
        layout[:, fused.HIDDEN_START : fused.HIDDEN_WIDTH + 1] = boxes[:, :2]
        if self._sources != len(sources):
            self._sources, self._scratch = len(sources), fused.scratch(len(self.xs[0]), len(sources))
        self.covered_px = fused.draw_view(
            self.xs[0],
            self._xs32[0],
            self.ys[0],
            self.xs[1],
            self._xs32[1],
            self.ys[1],
            self.scene,
            source_models(self.view, sources, reductions, boxes),
            layout,
            *numbers_of_all(tuple(source.lens for source in sources)),
            hidden,
            nearest,
            atlas.memory,
            self._memory,
            self._covered,
            *self._scratch,
        )


def source_models(
    view: VirtualView, sources: Sequence[Source], reductions: Sequence[float], boxes: npt.NDArray[np.int64]
) -> Float:
    """What the kernel knows of each source and the copy that is sampled: (n, MODEL_ROWS, 4), see `fused.LIMITS`.

    Args:
        boxes: of what is hidden, see `_hidden`.
    """
    models = np.zeros((len(sources), fused.MODEL_ROWS, 4))
    points = np.array([source.cam_from_ego for source in sources]).reshape(-1, 4, 4) @ view.camera.ego_from_cam
    forms = np.array([lens_numbers(source.lens).forms for source in sources]).reshape(-1, fused.ASIDE, 3)
    models[:, : fused.ASIDE] = forms @ points[:, :3]
    for model, source, n, (_, width, height, left, top) in zip(models, sources, reductions, boxes, strict=True):
        if not isinstance(source.lens, Pinhole):
            model[fused.LUMA, :2] = 1 / n, 0.5 / n - 0.5
            model[fused.CHROMA, :2] = 0.5 / n, 0.25 / n - 0.5
            model[fused.HIDDEN] = left - HALF_PX, top - HALF_PX, width, height
            continue
        if width:
            u, v, depth = model[fused.LUMA : fused.LUMA + 3]
            sides = u - (left - HALF_PX) * depth, (left + width - HALF_PX) * depth - u
            ends = v - (top - HALF_PX) * depth, (top + height - HALF_PX) * depth - v
            model[fused.HIDDEN : fused.HIDDEN + 5] = *sides, *ends, depth
        for row in (fused.LUMA, fused.CHROMA) if n > 1 else ():
            model[row : row + 2] = model[row : row + 2] / n + (0.5 / n - 0.5) * model[row + 2]
    models[:, fused.ASIDE, :3] = np.matmul(points[:, None, :3, 3], points[:, :3, :3])[:, 0]
    return models


@functools.lru_cache(maxsize=64)
def _hidden(
    cars: tuple[OwnCar | None, ...], reductions: tuple[float, ...]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.uint8]]:
    """What is hidden of several sources: boxes (n, 5) of start in memory, width, height, left, top; and that memory.

    There is a row of zeros after the pixels of each box.
    """
    boxes, planes, start = np.zeros((len(cars), 5), np.int64), [np.zeros(1, np.uint8)], 1
    for box, car, n in zip(boxes, cars, reductions, strict=True):
        hidden = hidden_of(car, n) if car else None
        if hidden is None or not hidden.pixels.size:
            continue
        height, width = hidden.pixels.shape
        box[:] = start, width, height, hidden.left, hidden.top
        planes += [hidden.pixels.ravel(), np.zeros(width, np.uint8)]
        start += (height + 1) * width
    return boxes, np.concatenate(planes)


def _half(size_px: int) -> int:
    """Samples of a 4:2:0 chroma plane along a side of the picture."""
    return (size_px + 1) // 2


def _chroma_places(size_px: int) -> Float:
    """Pixel coordinates of the chroma samples along a side: each stands between two pixels."""
    return 2.0 * np.arange(_half(size_px)) + 0.5


def _plane(memory: Bytes, row: npt.NDArray[np.int64], plane: int) -> Bytes:
    chroma = plane > 0
    start, stride = row[fused.PLANES + plane], row[fused.STRIDES + chroma]
    rows = row[fused.SIZES + 2 * chroma + 1] + 2
    return memory[start : start + rows * stride].reshape(rows, stride)
