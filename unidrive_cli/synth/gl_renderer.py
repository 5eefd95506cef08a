"""The renderer that draws triangles with OpenGL, on a graphics card or on Mesa's llvmpipe, without a display."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from unidrive_cli.errors import UnidriveError
from unidrive_cli.geometry.arrays import Float
from unidrive_cli.geometry.lenses import Pinhole
from unidrive_cli.synth import light
from unidrive_cli.synth.light import GRIDS
from unidrive_cli.synth.mesh import Mesh, merged
from unidrive_cli.synth.stage import (
    FIRST_ACTOR_ID,
    GROUND_ID,
    SKY_ID,
    STRUCTURE_ID,
    Depth,
    Instances,
    Picture,
    Stage,
    View,
)
from unidrive_cli.synth.textures import LAYERS

_CELL_M = 24.0
"""Side of the ground squares by which the triangles that do not move are culled."""
_TILES, _SHADOWS, _STILL, _VISIBLE, _TRIANGLES, _CORNERS, _BODIES = range(7)
"""Texture units."""
_ROW = 1024
"""Triangles, or vertices, in a row of the textures that hold them; samples name up to 4 million triangles."""
_GLOSSY, _VARIED = 1, 2
"""Kinds of surfaces, or both, or neither: what their shading takes more time for."""
_SKY_ONLY, _MIXED = 4, 5
"""Beside the kinds: what else can be seen in a pixel."""
_SUN_RANGE_M = 2048.0
"""Shadow maps hold what is this near their middle, along the sun's rays."""
_SHADOW_M = 100.0
"""Actors throw no shadow farther than this."""
_WELL_INSIDE = 0.98
"""Nothing that a surface outside of a cascade can read lies in this share of it: shaders leave it at 0.995, and look
up to three texels of the next one aside."""
_GROUND, _STRUCTURES, _FIRST_ACTOR = 0, 1, 2
"""Bodies: the meshes of a stage, in this order."""
_NEAR_M = 25.0
"""What is this near is drawn first, and may then hide what is farther away."""
_SQUARE = 16
"""What is hidden is looked up in squares of so many samples a side."""
_DEPTH_ERROR = 1e-6
"""More than GL's rounding changes a depth between 0 and 1."""

Box = tuple[int, int, int, int]
"""x, y, width, height in texels or pixels."""


@dataclass(frozen=True)
class _Cascade:
    """One square shadow map, centred near the camera.

    Attributes:
        half_m: half of the side that it covers.
        step_m: its centre stays where it is until the camera has left a square of this side.
        x, y, side: where it lies in the atlas, in texels.
    """

    half_m: float
    step_m: float
    x: int
    y: int
    side: int

    @property
    def texel_m(self) -> float:
        return 2 * self.half_m / self.side

    def centre(self, eye: Float) -> Float:
        """(2,) its middle in the sun's frame, for a camera at `eye` (3,) in the sun's frame."""
        centre: Float = np.round(eye[:2] / self.step_m) * self.step_m
        return centre


_CASCADES = (
    _Cascade(64.0, 16.0, 0, 0, 4096),
    _Cascade(288.0, 64.0, 0, 4096, 3072),
    _Cascade(1800.0, 400.0, 3072, 4096, 1024),
)
_ATLAS = (4096, 7168)


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Runs of triangles in the index buffer with the boxes that hold them.

    Attributes:
        first, count: (p,) vertex indices.
        kind: (p,) _GLOSSY plus _VARIED, or less.
        middle, half: (p, 3) of the boxes, metres.
    """

    first: npt.NDArray[np.int64]
    count: npt.NDArray[np.int64]
    kind: npt.NDArray[np.int64]
    middle: Float
    half: Float

    def inside(self, normals: Float, limits: Float) -> npt.NDArray[np.bool_]:
        """(p,) where a box reaches into `normals @ point >= limits` of all planes (k, 3), (k,)."""
        reach = self.middle @ normals.T + self.half @ np.abs(normals).T
        inside: npt.NDArray[np.bool_] = (reach >= limits).all(axis=1)
        return inside


def gl_missing() -> str | None:
    """Why GL cannot be had on this machine, or None where it can."""
    try:
        open_context().release()
    except UnidriveError as error:
        return str(error)
    return None


def open_context() -> Any:
    """A GL context without a window.

    Raises:
        UnidriveError: there is none; the hint says what to install.
    """
    try:
        import moderngl
    except ImportError as error:
        raise UnidriveError(
            f"drawing with GL needs the Python package moderngl ({error}).", hint="Install it: pip install moderngl."
        ) from error
    reasons = []
    ways: tuple[dict[str, Any], ...] = (
        {"backend": "egl", "libgl": "libEGL.so.1", "libegl": "libEGL.so.1"},
        {"backend": "egl"},
        {},
    )
    for settings in ways:
        try:
            context: Any = moderngl.create_context(standalone=True, require=330, **settings)
        except Exception as error:  # moderngl and its backends raise bare exceptions of many kinds
            reasons.append(str(error) or type(error).__name__)
        else:
            return context
    raise UnidriveError(
        f"no GL 3.3 context can be made without a display ({reasons[0]}).",
        hint="Debian, Ubuntu: apt install libegl1 libgl1-mesa-dri.",
    )


def gl_name(context: Any) -> str:
    """What draws in a context, for people."""
    return f"GL ({context.info['GL_RENDERER']})"


class GlRenderer:
    """Draws one stage with GL: a grid of samples per pixel, shadow maps, everything else as `light` says."""

    def __init__(self, stage: Stage) -> None:
        """
        Raises:
            UnidriveError: no GL context can be made.
        """
        self._stage = stage
        self._light = light.Light.of(stage.day)
        self._context = open_context()
        with self._context:
            self._name = gl_name(self._context)
            self._build(stage)

    @property
    def name(self) -> str:
        return self._name

    def close(self) -> None:
        self._context.gc_mode = "context_gc"
        self._context.release()

    def picture(self, view: View, samples: int) -> Picture:
        lens = view.lens
        grid = GRIDS.get(samples)
        if grid is None:
            raise ValueError(f"samples must be 1, 4 or 16, got {samples}")
        with self._context:
            self._draw_shadows(view)
            self._set_bodies(view)
            parts = _parts(lens, max(grid // 2, 1))
            target = self._target(lens, parts[0], grid)
            for part in parts:
                target.samples.use()
                target.samples.viewport = (0, 0, part[2] * grid, part[3] * grid)
                target.samples.clear()
                self._context.enable_only(self._context.DEPTH_TEST)
                self._draw_all(self._visible, target.samples, view, part)
                self._shade(target, view, part, grid)
            pixels = target.bytes.read(viewport=(0, 0, lens.width_px, lens.height_px), components=4)
        picture = np.frombuffer(pixels, dtype=np.uint8).reshape(lens.height_px, lens.width_px, 4)
        return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGRA2BGR), dtype=np.uint8)

    def instances(self, view: View) -> tuple[Instances, Depth]:
        lens = view.lens
        with self._context:
            target = self._instance_target(lens)
            target.use()
            target.viewport = (0, 0, lens.width_px, lens.height_px)
            target.clear(SKY_ID, np.inf)
            self._context.enable_only(self._context.DEPTH_TEST)
            self._instance.program["axis"] = tuple(view.global_from_cam[:3, 2])
            self._draw_all(self._instance, target, view, (0, 0, lens.width_px, lens.height_px))
            values = target.read(components=2, dtype="f4")
        both = np.frombuffer(values, dtype=np.float32).reshape(lens.height_px, lens.width_px, 2)
        return both[..., 0].astype(np.uint16), both[..., 1].copy()

    # Building

    def _build(self, stage: Stage) -> None:
        context = self._context
        meshes = [stage.ground, stage.structures, *stage.actors]
        vertices = np.cumsum([0, *(len(mesh.positions_m) for mesh in meshes)])
        indices = np.cumsum([0, *(mesh.triangles.size for mesh in meshes)])
        cells = [_CELL_M, _CELL_M, *(np.inf for _ in stage.actors)]
        self._ground, self._structures, *self._actors = (
            _pieces(mesh, cell, int(first)) for mesh, cell, first in zip(meshes, cells, indices[:-1], strict=True)
        )
        order = [
            mesh.triangles[_order(mesh, cell)[0]].ravel() + first
            for mesh, cell, first in zip(meshes, cells, vertices[:-1], strict=True)
        ]
        boxes = [_bounds(mesh.positions_m) for mesh in stage.actors]
        self._box_middle = np.array([middle for middle, _ in boxes]).reshape(-1, 3)
        self._box_half = np.array([half for _, half in boxes]).reshape(-1, 3)
        whole = merged(meshes)
        self._places = context.buffer(np.ascontiguousarray(whole.positions_m).tobytes() or bytes(12))
        self._indices = context.buffer(np.concatenate(order).astype(np.int32).tobytes() or bytes(12))
        self._build_tables(whole, np.concatenate(order), np.diff(indices) // 3)
        self._instance = self._drawing("instance_fragment")
        self._shadow = self._drawing("shadow_fragment")
        self._visible = self._drawing("visible_fragment")
        self._restore = self._filling(_program(context, "screen_vertex", "restore_fragment"))
        self._build_textures(stage)
        self._build_shadows()
        self._shadings: dict[int, _Shadings] = {}
        self._targets: dict[tuple[int, int, int], _Target] = {}
        self._instance_targets: dict[tuple[int, int], Any] = {}
        self._depths = np.empty(0, dtype=np.float32)

    def _drawing(self, fragment: str) -> _Drawing:
        """Draws triangles of the index buffer."""
        program = _program(self._context, "flat_vertex", fragment)
        return _Drawing(
            program, self._context.vertex_array(program, [(self._places, "3f", "position")], self._indices)
        )

    def _filling(self, program: Any) -> _Drawing:
        """Draws the whole viewport."""
        corners = np.array([-1, -1, 1, -1, -1, 1, 1, 1], dtype=np.float32)
        content = [(self._context.buffer(corners.tobytes()), "2f", "corner")]
        return _Drawing(program, self._context.vertex_array(program, content, mode=self._context.TRIANGLE_STRIP))

    def _build_tables(self, whole: Mesh, corners: npt.NDArray[Any], counts: npt.NDArray[np.int64]) -> None:
        """What the shading looks up.

        Args:
            whole: all bodies' vertices.
            corners: (3 t,) vertices of the triangles, in the order of the index buffer.
            counts: (b,) triangles of each body.
        """
        columns = (
            whole.positions_m,
            whole.layer[:, None] + whole.gloss[:, None] / 2,
            whole.normals,
            whole.uv[:, :1],
            whole.albedo,
            whole.uv[:, 1:],
        )
        body = np.repeat(np.arange(len(counts)), counts)
        self._corners = self._table(np.hstack(columns), 3)
        self._triangles = self._table(np.hstack([corners.reshape(-1, 3), body[:, None]]), 1)
        self._bodies = self._context.texture((3, len(counts)), 4, dtype="f4")

    def _table(self, rows: npt.NDArray[Any], texels: int) -> Any:
        """A texture of rows (n, 4 * texels), _ROW of them side by side."""
        padded = np.zeros((max(-(-len(rows) // _ROW), 1) * _ROW, 4 * texels), dtype=np.float32)
        padded[: len(rows)] = rows
        return self._context.texture((_ROW * texels, len(padded) // _ROW), 4, padded.tobytes(), dtype="f4")

    def _build_textures(self, stage: Stage) -> None:
        chain = light.mip_chain(stage.textures)
        count, side = stage.textures.shape[:2]
        padded = np.concatenate([stage.textures, np.full((count, side, side, 1), 255, dtype=np.uint8)], axis=-1)
        self._tiles = self._context.texture_array((side, side, count), 4, padded.tobytes())
        self._tiles.build_mipmaps()
        self._tiles.filter = (self._context.LINEAR_MIPMAP_LINEAR, self._context.LINEAR)
        self._tiles.repeat_x = self._tiles.repeat_y = True
        self._means = light.layer_means(chain).tolist()

    def _shading(self, grid: int) -> _Shadings:
        """The programs that turn grid x grid samples into a pixel."""
        if grid not in self._shadings:
            names = {"GRID": grid, "ROW": _ROW, "SKY_ONLY": _SKY_ONLY, "MIXED": _MIXED}
            sort = self._filling(_program(self._context, "screen_vertex", "visible", "sort_fragment", **names))
            sort.set(visible=_VISIBLE)
            shade = []
            for shading in range(_MIXED + 1):
                mixed = shading == _MIXED
                kind = _GLOSSY | _VARIED if mixed else shading % _SKY_ONLY
                program = _program(
                    self._context,
                    "screen_vertex",
                    *("visible", "light", "shade_fragment"),
                    SKY=int(shading >= _SKY_ONLY),
                    SURFACE=int(shading != _SKY_ONLY),
                    GLOSSY=kind & _GLOSSY,
                    VARIED=kind & _VARIED,
                    **names,
                )
                drawing = self._filling(program)
                drawing.set(level=shading / 8, **self._lighting())
                shade.append(drawing)
            self._shadings[grid] = _Shadings(sort, tuple(shade))
        return self._shadings[grid]

    def _lighting(self) -> dict[str, Any]:
        """The uniforms of a shading program that stay as they are."""
        colours = ("to_sun", "sun", "zenith", "horizon", "sky_mean", "bounce", "cloud_bright", "cloud_dark")
        varies = [light.VARIED_DEPTH if index in light.VARIED_LAYERS else 0.0 for index in range(len(LAYERS))]
        return {
            **{name: tuple(getattr(self._light, name).ravel()) for name in colours},
            **{"cloud": self._light.cloud, "haze_m": self._light.haze_m, "side": self._tiles.width},
            **{"means": self._means, "varies": varies, "sun_axes": tuple(self._sun_axes.T.ravel())},
            **{"tiles": _TILES, "shadows": _SHADOWS, "visible": _VISIBLE},
            **{"triangles": _TRIANGLES, "corners": _CORNERS, "bodies": _BODIES},
        }

    def _build_shadows(self) -> None:
        self._sun_axes = _sun_axes(self._light.to_sun.ravel().astype(np.float64))
        self._still, self._shaded = (self._context.depth_texture(_ATLAS) for _ in range(2))
        self._still.compare_func = ""
        self._still.filter = (self._context.NEAREST, self._context.NEAREST)
        self._shaded.compare_func = "<="
        self._shaded.filter = (self._context.LINEAR, self._context.LINEAR)
        self._still_map, self._shaded_map = (
            self._context.framebuffer(depth_attachment=texture) for texture in (self._still, self._shaded)
        )
        self._restore.program["still"] = _STILL
        self._centres: list[Float | None] = [None for _ in _CASCADES]
        self._stale: list[list[Box]] = [[] for _ in _CASCADES]
        self._cast: tuple[Any, ...] | None = None

    # Shadows

    def _draw_shadows(self, view: View) -> None:
        """Brings the shadow maps up to date: buildings where the camera has moved on, actors every time."""
        eye = self._sun_axes @ view.global_from_cam[:3, 3]
        centres = [cascade.centre(eye) for cascade in _CASCADES]
        casting = self._casting(view)
        key = (np.array(centres).tobytes(), view.global_from_actor[casting].tobytes(), casting.tobytes())
        if key == self._cast:
            return
        self._cast = key
        self._context.enable_only(self._context.DEPTH_TEST)
        for index, cascade in enumerate(_CASCADES):
            square = (cascade.x, cascade.y, cascade.side, cascade.side)
            old = self._centres[index]
            if old is None or not np.array_equal(old, centres[index]):
                self._draw_still_shadows(cascade, centres[index])
                self._centres[index] = centres[index]
                self._stale[index] = [square]
            self._renew(self._stale[index])
            self._stale[index], done = self._draw_actor_shadows(cascade, centres[index], view, casting)
            casting = casting[~done]

    def _casting(self, view: View) -> npt.NDArray[np.int64]:
        """The actors whose shadows may fall into the picture: those whose boxes, drawn out along the sun's rays,
        reach into it."""
        lens, eye = view.lens, view.global_from_cam[:3, 3]
        planes = _sides(lens, (0, 0, lens.width_px, lens.height_px)) @ view.global_from_cam[:3, :3].T
        shown = _shown(view, len(self._actors))
        middle, half = self._extents(view, shown, planes)
        thrown = np.maximum(-_SHADOW_M * planes @ self._sun_axes[2], 0)
        casts: npt.NDArray[np.int64] = shown[(middle - planes @ eye + half + thrown >= 0).all(axis=1)]
        return casts

    def _extents(self, view: View, actors: npt.NDArray[np.int64], along: Float) -> tuple[Float, Float]:
        """Where the boxes of `actors` (a,) lie along directions (k, 3): their middles and half widths, (a, k)."""
        poses = view.global_from_actor[actors]
        turned = along @ poses[:, :3, :3]
        middle = np.einsum("aki,ai->ak", turned, self._box_middle[actors]) + poses[:, :3, 3] @ along.T
        return middle, np.einsum("aki,ai->ak", np.abs(turned), self._box_half[actors])

    def _draw_still_shadows(self, cascade: _Cascade, centre: Float) -> None:
        square = (cascade.x, cascade.y, cascade.side, cascade.side)
        self._still_map.use()
        self._still_map.viewport = square
        self._still_map.scissor = square
        self._still_map.clear(depth=1.0, viewport=square)
        axes = self._sun_axes[:2]
        normals = np.concatenate([axes, -axes])
        limits = np.concatenate([centre - cascade.half_m, -centre - cascade.half_m])
        pieces = self._structures
        self._shadow.program["clip_from_q"] = self._sun_clip(cascade, centre)
        self._shadow.place(np.eye(3), np.zeros(3))
        for index in np.flatnonzero(pieces.inside(normals, limits)):
            self._shadow.draw(pieces, int(index))

    def _renew(self, boxes: Sequence[Box]) -> None:
        """Puts the shadows of what does not move back into the working map."""
        self._still.use(_STILL)
        self._shaded_map.use()
        self._context.depth_func = "1"
        for box in boxes:
            self._shaded_map.viewport = box
            self._shaded_map.scissor = box
            self._restore.vertices.render()
        self._context.depth_func = "<="

    def _draw_actor_shadows(
        self, cascade: _Cascade, centre: Float, view: View, actors: npt.NDArray[np.int64]
    ) -> tuple[list[Box], npt.NDArray[np.bool_]]:
        """Draws actors into the working map.

        Returns:
            The boxes of texels that it may have changed, and which actors no wider cascade needs.
        """
        square = (cascade.x, cascade.y, cascade.side, cascade.side)
        self._shaded_map.viewport = square
        self._shaded_map.scissor = square
        self._shadow.program["clip_from_q"] = self._sun_clip(cascade, centre)
        middle, reach = self._extents(view, actors, self._sun_axes[:2])
        middle -= centre
        low = np.floor((middle - reach + cascade.half_m) / cascade.texel_m).astype(int) - 1
        high = np.ceil((middle + reach + cascade.half_m) / cascade.texel_m).astype(int) + 1
        low, high = np.clip(low, 0, cascade.side), np.clip(high, 0, cascade.side)
        boxes = np.hstack([low + np.array([cascade.x, cascade.y]), high - low])
        touched = (high > low).all(axis=1)
        for index in actors[touched]:
            pose = view.global_from_actor[index]
            self._shadow.place(pose[:3, :3], pose[:3, 3])
            self._shadow.draw_all(self._actors[index])
        done = (np.abs(middle) + reach < _WELL_INSIDE * cascade.half_m).all(axis=1)
        return [tuple(box) for box in boxes[touched].tolist()], done

    def _sun_clip(self, cascade: _Cascade, centre: Float) -> tuple[float, ...]:
        """The projection along the sun's rays, in the order that GL takes."""
        clip = np.eye(4)
        clip[:2, :3] = self._sun_axes[:2] / cascade.half_m
        clip[:2, 3] = -centre / cascade.half_m
        clip[2, :3] = -self._sun_axes[2] / _SUN_RANGE_M
        return tuple(clip.T.ravel())

    def _shadow_places(self, view: View) -> dict[str, Any]:
        """Where the shadow maps lie from this camera, as uniforms."""
        eye = self._sun_axes @ view.global_from_cam[:3, 3]
        cascades, squares = [], []
        for cascade in _CASCADES:
            offset = (eye[:2] - cascade.centre(eye)) / cascade.half_m
            cascades.append((1 / cascade.half_m, offset[0], offset[1], cascade.texel_m))
            half = np.array([cascade.side / 2, cascade.side / 2])
            middle = (np.array([cascade.x, cascade.y]) + half) / _ATLAS
            squares.append((*middle, *(half / _ATLAS)))
        depth = -0.5 / _SUN_RANGE_M, 0.5 - 0.5 * float(eye[2]) / _SUN_RANGE_M
        return {"cascades": cascades, "squares": squares, "sun_depth": depth}

    # Pictures

    def _set_bodies(self, view: View) -> None:
        """Tells the shading how the meshes lie to the camera."""
        eye = view.global_from_cam[:3, 3]
        rows = np.zeros((2 + len(self._actors), 3, 4))
        rows[:2, :, :3], rows[:2, :, 3] = np.eye(3), eye
        turned = view.global_from_actor[:, :3, :3].transpose(0, 2, 1)
        rows[2:, :, :3] = turned
        rows[2:, :, 3] = np.einsum("aij,aj->ai", turned, eye - view.global_from_actor[:, :3, 3])
        self._bodies.write(rows.astype(np.float32).tobytes())

    def _draw_all(self, drawing: _Drawing, target: Any, view: View, box: Box) -> None:
        """Draws all that can be seen in the part `box` of the picture: first what is near, then what that leaves."""
        clip = _clip_from_cam(view.lens, box)
        drawing.set(clip_from_q=tuple((clip @ _padded(view.global_from_cam[:3, :3].T)).T.ravel()))
        seen = self._in_view(view, box)
        depth_m = seen.corners_cam[..., 2].min(axis=1)
        order = np.lexsort((depth_m, seen.body, seen.body == _GROUND))
        near = depth_m[order] < _NEAR_M
        self._draw_pieces(drawing, view, seen, order[near])
        order = order[~near]
        if len(order):
            squares = np.array(target.viewport[2:]) / _SQUARE
            hidden = _hidden(seen.corners_cam[order], clip, squares, self._deepest(target))
            self._draw_pieces(drawing, view, seen, order[~hidden])

    def _in_view(self, view: View, box: Box) -> _Seen:
        """What reaches into the part `box` of the picture."""
        rotation, eye = view.global_from_cam[:3, :3], view.global_from_cam[:3, 3]
        planes = _sides(view.lens, box) @ rotation.T
        body, piece, corners = [], [], []
        for number, pieces in ((_GROUND, self._ground), (_STRUCTURES, self._structures)):
            inside = np.flatnonzero(pieces.inside(planes, planes @ eye))
            body.append(np.full(len(inside), number))
            piece.append(inside)
            corners.append(_corners(pieces.middle[inside], pieces.half[inside]) - eye)
        shown = _shown(view, len(self._actors))
        middle, half = self._extents(view, shown, planes)
        for index in shown[(middle - planes @ eye + half >= 0).all(axis=1)].tolist():
            pose, pieces = view.global_from_actor[index], self._actors[index]
            body.append(np.full(len(pieces.kind), _FIRST_ACTOR + index))
            piece.append(np.arange(len(pieces.kind)))
            corners.append(_corners(pieces.middle, pieces.half) @ pose[:3, :3].T + (pose[:3, 3] - eye))
        return _Seen(np.concatenate(body), np.concatenate(piece), np.concatenate(corners) @ rotation)

    def _draw_pieces(self, drawing: _Drawing, view: View, seen: _Seen, order: npt.NDArray[np.int64]) -> None:
        eye = view.global_from_cam[:3, 3]
        placed = -1
        for body, piece in zip(seen.body[order].tolist(), seen.piece[order].tolist(), strict=True):
            index = body - _FIRST_ACTOR
            if body != placed:
                pose = np.eye(4) if index < 0 else view.global_from_actor[index]
                drawing.place(pose[:3, :3], pose[:3, 3] - eye)
                drawing.set(id=(GROUND_ID, STRUCTURE_ID)[body] if index < 0 else FIRST_ACTOR_ID + index)
                placed = body
            drawing.draw((self._ground, self._structures)[body] if index < 0 else self._actors[index], piece)

    def _deepest(self, target: Any) -> npt.NDArray[np.float32]:
        """Depths that nothing in squares of _SQUARE x _SQUARE samples of the viewport exceeds, 0 to 1."""
        viewport = target.viewport
        size = viewport[3] * viewport[2]
        if len(self._depths) < size:
            self._depths = np.empty(size, dtype=np.float32)
        target.read_into(self._depths, viewport, components=1, attachment=-1, dtype="f4")
        depths = self._depths[:size].reshape(viewport[3], viewport[2])
        rows, columns = (np.arange(0, side, _SQUARE) for side in depths.shape)
        deepest: npt.NDArray[np.float32] = np.maximum.reduceat(np.maximum.reduceat(depths, rows), columns, axis=1)
        return deepest

    def _shade(self, target: _Target, view: View, part: Box, grid: int) -> None:
        """Turns samples into pixels."""
        lens, shading = view.lens, self._shading(grid)
        cam_from_window = np.linalg.inv(lens.matrix) @ np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])
        seen = {
            "start": part[:2],
            "ray_from_window": tuple((view.global_from_cam[:3, :3] @ cam_from_window).T.ravel()),
            **self._shadow_places(view),
        }
        textures = (self._tiles, self._shaded, target.visible, self._triangles, self._corners, self._bodies)
        units = (_TILES, _SHADOWS, _VISIBLE, _TRIANGLES, _CORNERS, _BODIES)
        for texture, unit in zip(textures, units, strict=True):
            texture.use(unit)
        target.bytes.use()
        target.bytes.viewport = part
        self._context.depth_func = "1"
        shading.sort.set(start=part[:2])
        shading.sort.vertices.render()
        self._context.depth_func = "=="
        for drawing in shading.shade:
            drawing.set(**seen)
            drawing.vertices.render()
        self._context.depth_func = "<="

    def _target(self, lens: Pinhole, part: Box, grid: int) -> _Target:
        key = (lens.width_px, lens.height_px, grid)
        if key not in self._targets:
            size = (part[2] * grid, part[3] * grid)
            visible = self._context.texture(size, 1, dtype="f4")
            samples = self._context.framebuffer(visible, self._context.depth_renderbuffer(size))
            coded = self._context.renderbuffer(key[:2], 4)
            bytes_ = self._context.framebuffer(coded, self._context.depth_renderbuffer(key[:2]))
            self._targets[key] = _Target(samples, visible, bytes_)
        return self._targets[key]

    def _instance_target(self, lens: Pinhole) -> Any:
        size = (lens.width_px, lens.height_px)
        if size not in self._instance_targets:
            colour = self._context.renderbuffer(size, 2, dtype="f4")
            self._instance_targets[size] = self._context.framebuffer(colour, self._context.depth_renderbuffer(size))
        return self._instance_targets[size]


@dataclass(frozen=True, eq=False)
class _Seen:
    """Pieces that may be seen.

    Attributes:
        body, piece: (n,) which piece of which body.
        corners_cam: (n, 8, 3) of the boxes that hold them, metres.
    """

    body: npt.NDArray[np.int64]
    piece: npt.NDArray[np.int64]
    corners_cam: Float


@dataclass(frozen=True, eq=False)
class _Drawing:
    """A program with the vertices that it is fed."""

    program: Any
    vertices: Any

    def set(self, **values: Any) -> None:
        """Sets those uniforms that the program has."""
        for name, value in values.items():
            if name in self.program:
                self.program[name] = value

    def place(self, rotation: Float, offset: Float) -> None:
        """Sets where the mesh lies."""
        high = offset.astype(np.float32).astype(np.float64)
        self.set(turn=tuple(rotation.T.ravel()), offset_high=tuple(high), offset_low=tuple(offset - high))

    def draw(self, pieces: _Pieces, index: int) -> None:
        first = int(pieces.first[index])
        self.set(first=4 * (first // 3) + int(pieces.kind[index]) + 1)
        self.vertices.render(vertices=int(pieces.count[index]), first=first)

    def draw_all(self, pieces: _Pieces) -> None:
        for index in range(len(pieces.first)):
            self.draw(pieces, index)


@dataclass(frozen=True, eq=False)
class _Shadings:
    """The programs that make pixels: `sort` tells which of `shade` a pixel needs."""

    sort: _Drawing
    shade: tuple[_Drawing, ...]


@dataclass(frozen=True, eq=False)
class _Target:
    """Where a picture is drawn: what each sample sees in `visible`, then its bytes."""

    samples: Any
    visible: Any
    bytes: Any


def _parts(lens: Pinhole, count: int) -> list[Box]:
    """The picture cut into count x count parts, the first the largest."""
    width, height = -(-lens.width_px // count), -(-lens.height_px // count)
    return [
        (x, y, min(width, lens.width_px - x), min(height, lens.height_px - y))
        for y in range(0, lens.height_px, height)
        for x in range(0, lens.width_px, width)
    ]


def _clip_from_cam(lens: Pinhole, box: Box) -> Float:
    """(4, 4) GL's projection of one part of the picture.

    GL's window coordinates of pixel centres are halves and OpenCV's are integers, hence the 0.5. The rows
    are drawn top first, so that what is read back needs no turning; that swaps front and back faces.
    """
    x, y, width, height = box
    clip = np.zeros((4, 4))
    clip[0, 0], clip[0, 2] = 2 * lens.fx_px / width, 2 * (lens.cx_px + 0.5 - x) / width - 1
    clip[1, 1], clip[1, 2] = 2 * lens.fy_px / height, 2 * (lens.cy_px + 0.5 - y) / height - 1
    clip[2, 2] = (light.FAR_M + light.NEAR_M) / (light.FAR_M - light.NEAR_M)
    clip[2, 3] = -2 * light.FAR_M * light.NEAR_M / (light.FAR_M - light.NEAR_M)
    clip[3, 2] = 1
    return clip


def _sides(lens: Pinhole, box: Box) -> Float:
    """(5, 3) inward normals, camera frame, of the planes through the camera that bound the part `box`; and ahead."""
    x, y, width, height = box
    left, top = x - 0.5 - lens.cx_px, y - 0.5 - lens.cy_px
    return np.array(
        [
            [lens.fx_px, 0, -left],
            [-lens.fx_px, 0, left + width],
            [0, lens.fy_px, -top],
            [0, -lens.fy_px, top + height],
            [0, 0, 1],
        ]
    )


def _corners(middle: Float, half: Float) -> Float:
    """(n, 8, 3) corners of boxes (n, 3)."""
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), axis=-1).reshape(8, 3)
    corners: Float = middle[:, None] + half[:, None] * signs
    return corners


def _hidden(
    corners_cam: Float, clip_from_cam: Float, squares: Float, deepest: npt.NDArray[np.float32]
) -> npt.NDArray[np.bool_]:
    """(n,) where all of a box (n, 8, 3) is behind what has been drawn.

    Args:
        squares: (2,) how many of _SQUARE samples a side the viewport holds, across and down.
        deepest: (rows, columns) depths that nothing drawn in these squares exceeds, 0 to 1.
    """
    clip = corners_cam @ clip_from_cam[:, :3].T + clip_from_cam[:, 3]
    ahead = clip[..., 3].min(axis=1) > light.NEAR_M
    window = (clip[..., :3] / np.maximum(clip[..., 3:], light.NEAR_M) + 1) / 2
    nearest = window[..., 2].min(axis=1) - _DEPTH_ERROR
    most = deepest.shape[::-1]
    low = np.clip(np.floor(window[..., :2].min(axis=1) * squares - 0.1), 0, most).astype(int)
    high = np.clip(np.ceil(window[..., :2].max(axis=1) * squares + 0.1), 0, most).astype(int)
    return np.array(
        [
            clear and near > deepest[top:bottom, left:right].max(initial=0)
            for clear, near, (left, top), (right, bottom) in zip(ahead, nearest, low, high, strict=True)
        ]
    )


def _padded(rotation: Float) -> Float:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    return matrix


def _shown(view: View, count: int) -> npt.NDArray[np.int64]:
    """Which of `count` actors are there."""
    return np.arange(count) if view.shown is None else np.flatnonzero(view.shown)


def _sun_axes(to_sun: Float) -> Float:
    """(3, 3) rows: two axes across the sun's rays, and the direction to the sun."""
    aside = np.cross([0.0, 0.0, 1.0], to_sun)
    if np.linalg.norm(aside) < 1e-6:
        aside = np.array([1.0, 0.0, 0.0])
    aside /= np.linalg.norm(aside)
    return np.stack([aside, np.cross(to_sun, aside), to_sun])


def _bounds(points_m: npt.NDArray[Any]) -> tuple[Float, Float]:
    """Middle and half size (3,) of the box round some points (n, 3)."""
    if not len(points_m):
        return np.zeros(3), np.zeros(3)
    low, high = points_m.min(axis=0).astype(np.float64), points_m.max(axis=0).astype(np.float64)
    return (low + high) / 2, (high - low) / 2


def _order(mesh: Mesh, cell_m: float) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The order of triangles that puts one ground square and kind together; their codes in it, and their kinds."""
    last = mesh.triangles[:, 2]
    kind = (mesh.gloss[last] > 0) + 2 * np.isin(mesh.layer[last], light.VARIED_LAYERS).astype(np.int64)
    code = kind
    if np.isfinite(cell_m):
        middle = mesh.positions_m[mesh.triangles].astype(np.float64)[..., :2].mean(axis=1)
        cells = np.floor(middle / cell_m).astype(np.int64)
        code = (cells[:, 0] * 100_003 + cells[:, 1]) * 4 + kind
    order = np.argsort(code, kind="stable")
    return order, code[order], kind[order]


def _pieces(mesh: Mesh, cell_m: float, first_index: int) -> _Pieces:
    """A mesh cut into ground squares and kinds, in the order of `_order`."""
    order, code, kind = _order(mesh, cell_m)
    starts = np.flatnonzero(np.diff(code, prepend=code[:1] - 1))
    ends = np.append(starts[1:], len(order)) if len(starts) else starts
    corners = mesh.positions_m[mesh.triangles[order]].astype(np.float64)
    boxes = [_bounds(corners[start:end].reshape(-1, 3)) for start, end in zip(starts, ends, strict=True)]
    return _Pieces(
        first_index + 3 * starts.astype(np.int64),
        3 * (ends - starts).astype(np.int64),
        kind[starts],
        np.array([middle for middle, _ in boxes]).reshape(-1, 3),
        np.array([half for _, half in boxes]).reshape(-1, 3),
    )


def _program(context: Any, vertex: str, *fragment: str, **switches: int) -> Any:
    """A GL program of files in `shaders/`, headed by the constants of `light`."""
    folder = resources.files("unidrive_cli.synth") / "shaders"
    lines = ["#version 330", f"#define LAYER_COUNT {len(LAYERS)}"]
    lines += [f"#define {name} {value}" for name, value in switches.items()]
    for name, value in light.constants().items():
        lines.append(f"#define {name} {int(value) if name.endswith('_LAYER') else value!r}")
    head = "\n".join(lines) + "\n"
    whole = [
        head + "".join((folder / f"{name}.glsl").read_text(encoding="utf-8") for name in names)
        for names in ((vertex,), fragment)
    ]
    return context.program(vertex_shader=whole[0], fragment_shader=whole[1])
