"""The fused kernel: where each virtual pixel looks, and its colour, in one pass over YUV 4:2:0 planes (numba).

A virtual pixel with the ray r = (x, y, 1) shows the scene point S = o + r / w with

    w = max(|r| / D0, -(n . R r) / h),

the half-ball of geometry.md in one formula: of two inverse depths the larger one counts, so the seam between
ground and ball needs no case. Seen from a source camera the point is P = A r + b w up to the positive
factor w, so its pixel is (U / Z, V / Z) with U, V, Z linear in (x, y, 1, w): no table of the picture's size
is made, and motion between the cameras costs nothing. Which pixels a source sees follows from bounds of w
on a row, and is decided in float64, pixel by pixel, where the bounds leave it open.

A source with lens distortion has no such forms of its pixel. Its point P is the same; the pixel follows from
the distortion polynomial (opencv), or from a polynomial of the stereographic projection P / (|P| + Pz)
(fisheye, whose arc tangent it replaces), in float32 for all pixels of a row. What lies by a border is decided,
and placed, in float64 by the lens's own formulas.

All arithmetic is strict IEEE (no contraction, no reassociation), so processors agree to the last bit.
Numba widens sums of 32-bit numbers to 64 bits unless told otherwise, which halves the width of the vector
loops, and takes signed indices for possibly negative: hence the casts. Constants of other modules come in
as arguments, because the compiled kernel on disk does not notice when they change.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from unidrive_cli.warp.compiled import can_cache

Array = npt.NDArray[Any]

_f4, _i4, _u8 = np.float32, np.int32, np.uint64


_OPTIONS: dict[str, Any] = {"cache": can_cache(), "error_model": "numpy", "nogil": True, "_nrt": False}
_INNER = {**_OPTIONS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
_TIGHT = {**_INNER, "forceinline": True}

CHUNK = 512
"""Pixels drawn at once: their coordinates and taps stay in the first-level cache."""
LANES = 8
"""Stretches are drawn in multiples of this; what is written beyond their end is drawn over, or is padding."""
_SHARED_CHUNK = 120
_NODE_STEP = 8
"""Shares of overlapping sources are computed at every eighth pixel of a row, and linear between,"""
_STEEP = 0.1
"""unless they change by more than this from one to the next: then at every fourth, second or single pixel."""

LIMITS, LUMA, CHROMA, BORDERS, POINT, ASIDE, HIDDEN = 0, 5, 8, 11, 15, 18, 19
"""Rows of a source's model, all but the last forms with the columns x, y, 1, w.

LIMITS: five that are >= 0 (the last: > 0) where the source sees the point. LUMA, CHROMA: U, V, Z of its pixel
in those planes; of a source with distortion what its pixel is multiplied with for that, and what is added. BORDERS:
four distances to the planes through its borders. POINT: the point in its frame. ASIDE: b in the virtual camera's
frame; r x b gives the parallax. HIDDEN: as LIMITS, of the box of
what is hidden; of a source with distortion its first u and v, and its columns and rows.
"""
MODEL_ROWS = 24
PLANES, STRIDES, SIZES = 0, 3, 5
"""Columns of a source's layout: where Y, U, V start; strides of luma and chroma; their widths and heights."""
HIDDEN_START, HIDDEN_WIDTH = 9, 10
"""and where in their memory its hidden pixels are, and how many in a row; 0 where none are."""
LAYOUT_COLUMNS = 11
KIND, EXACT, FOCAL, CENTRE, LOW, HIGH = 0, 1, 2, 4, 6, 7
"""Columns of a source's lens: 0 for a pinhole, OPENCV or FISHEYE; whether float32 will not do, which knows no tilt
either; fx, fy; cx, cy; the least u and v and the largest that are in the picture;"""
LIMIT, INSIDE, BEYOND = 9, 10, 11
"""the end of the model's field, as (x / z)^2 + (y / z)^2 of a ray or, of a fisheye, as its angle off the axis; up to
where, as that square or as the square of the stereographic radius, the model surely holds, and beyond where no ray
is in the picture;"""
TERMS, SERIES_SCALE, SERIES = 12, 24, 25
"""the coefficients; the fisheye's polynomial: ascending coefficients in SERIES_SCALE radius^2 - 1;"""
SERIES_TERMS = 16
SHARES = SERIES + SERIES_TERMS
"""and where the sines to its border are, of how many columns and rows of points of the stereographic plane, the
first of those, how many there are to a unit, and sine and cosine of the angle off the axis where the field ends."""
TILT = SHARES + 8
"""The homography of a tilted sensor, row by row; zeros without."""
LENS_COLUMNS = TILT + 9
OPENCV, FISHEYE = 1, 2
_SCAN_CHUNK = 64
_NOWHERE_PX = -1e6
_MARGIN_PX = 0.05
"""Nearer to a border than this whether a pixel is seen is decided in float64."""
PER_LENGTH, GROUND, BORDER_FLOOR, PARALLAX_FLOOR, MIN_SHARE = 0, 1, 4, 5, 6
"""Entries of the scene: 1 / D0; -(n . R r) / h as a form of x, y, 1; constants of the blend."""
_WS, _TOTALS, _NODE_XS, _NODE_WS, _LARGEST = 0, 1, 2, 3, 4
_GRID_AS, _GRID_BS, _RIMS, _DISTANCES, _WEIGHTS = 5, 6, 7, 8, 9
"""Rows of the float scratch; after the weights of all sources come their shares."""


@intrinsic
def _load_pair(typingctx: Any, array: Any, index: Any) -> Any:
    """Bytes `index` and `index + 1` of a uint8 array as one number: half the loads of a bilinear sample."""
    signature = types.int32(array, types.uint64)

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        place = builder.gep(data, [arguments[1]])
        place = builder.bitcast(place, ir.IntType(16).as_pointer())
        return builder.zext(builder.load(place, align=1), ir.IntType(32))

    return signature, codegen


@intrinsic
def _prefetch(typingctx: Any, array: Any, index: Any) -> Any:
    """Asks for the cache line of byte `index` of a uint8 array, which is soon to be read."""
    signature = types.void(array, types.uint64)

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        place = builder.bitcast(builder.gep(data, [arguments[1]]), ir.IntType(8).as_pointer())
        i32 = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [place.type, i32, i32, i32])
        function = builder.module.declare_intrinsic("llvm.prefetch", [place.type], kind)
        builder.call(function, [place, i32(0), i32(2), i32(1)])

    return signature, codegen


@intrinsic
def _store_ramp(typingctx: Any, array: Any, index: Any, value: Any, step: Any) -> Any:
    """Writes value, value + step, ... into LANES places of a float32 array from the flat `index` on."""
    signature = types.void(array, types.uint64, types.float32, types.float32)

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        vector = ir.VectorType(ir.FloatType(), LANES)

        def everywhere(number: Any) -> Any:
            one = builder.insert_element(ir.Constant(vector, ir.Undefined), number, ir.IntType(32)(0))
            lanes = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
            return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), lanes)

        places = ir.Constant(vector, [float(place) for place in range(LANES)])
        ramp = builder.fadd(everywhere(arguments[2]), builder.fmul(places, everywhere(arguments[3])))
        place = builder.bitcast(builder.gep(data, [arguments[1]]), vector.as_pointer())
        builder.store(ramp, place, align=4)

    return signature, codegen


@intrinsic
def _least_side(typingctx: Any, sides: Any, at: Any, below: Any, across: Any, down: Any) -> Any:
    """The least of four numbers, each bilinear in a grid of float32 fours: `at`, the one after, and two `below`."""
    signature = types.float32(sides, types.uint64, types.uint64, types.float32, types.float32)

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        i32, vector = ir.IntType(32), ir.VectorType(ir.FloatType(), 4)
        nothing = ir.Constant(vector, ir.Undefined)

        def four(index: Any, after: int) -> Any:
            place = builder.gep(data, [builder.add(index, ir.IntType(64)(after))])
            return builder.load(builder.bitcast(place, vector.as_pointer()), align=4)

        def turned(value: Any, lanes: list[int]) -> Any:
            return builder.shuffle_vector(value, nothing, ir.Constant(ir.VectorType(i32, 4), lanes))

        def between(one: Any, other: Any, share: Any) -> Any:
            everywhere = turned(builder.insert_element(nothing, share, i32(0)), [0, 0, 0, 0])
            return builder.fadd(one, builder.fmul(everywhere, builder.fsub(other, one)))

        upper, lower = (between(four(row, 0), four(row, 4), arguments[3]) for row in arguments[1:3])
        least = between(upper, lower, arguments[4])
        for lanes in ([2, 3, 0, 1], [1, 0, 3, 2]):
            other = turned(least, lanes)
            least = builder.select(builder.fcmp_ordered("<", other, least), other, least)
        return builder.extract_element(least, i32(0))

    return signature, codegen


@njit(**_TIGHT)
def _whole_lanes(n):
    return (n + LANES - 1) // LANES * LANES


@njit(inline="always", **_OPTIONS)
def _inverse_depth_at(x, square, per_length, ground_x, ground):
    """w of one pixel: `square` is y^2 + 1, `ground` what x leaves alone of -(n . R r) / h."""
    ball = np.sqrt(x * x + square) * per_length
    plane = ground_x * x + ground
    return ball if ball > plane else plane


@njit(**_TIGHT)
def _inverse_depth(xs, start, n, y, scene, floats):
    """w of `n` pixels of a row, from `start` on, into the same places of the scratch."""
    per_length, ground_x = _f4(scene[PER_LENGTH]), _f4(scene[GROUND])
    ground, square = _f4(scene[GROUND + 1] * y + scene[GROUND + 2]), _f4(y * y + 1)
    for i in range(_u8(start), _u8(start + n)):
        floats[_WS, i] = _inverse_depth_at(xs[i], square, per_length, ground_x, ground)


@njit(**_TIGHT)
def _place_nodes(x_start, x_step, n, y, scene, floats):
    """x and w of `n` nodes of a row."""
    per_length, ground_x = _f4(scene[PER_LENGTH]), _f4(scene[GROUND])
    ground, square = _f4(scene[GROUND + 1] * y + scene[GROUND + 2]), _f4(y * y + 1)
    for i in range(_u8(n)):
        x = x_start + _f4(_i4(i)) * x_step
        floats[_NODE_XS, i] = x
        floats[_NODE_WS, i] = _inverse_depth_at(x, square, per_length, ground_x, ground)


@njit(**_TIGHT)
def _form(models, j, row, y):
    """A form at one row of the picture: float32 factors of x, 1, w."""
    return _f4(models[j, row, 0]), _f4(models[j, row, 1] * y + models[j, row, 2]), _f4(models[j, row, 3])


@njit(**_TIGHT)
def _project(xs, floats, start, n, y, models, layout, j, chroma, ints, k):
    """Source pixels of a stretch of a row: byte index of the upper left tap, and 8-bit fractions."""
    rows = CHROMA if chroma else LUMA
    zx, z0, zw = _form(models, j, rows + 2, y)
    ux, u0, uw = _scaled(_form(models, j, rows, y), zx, z0, zw)
    vx, v0, vw = _scaled(_form(models, j, rows + 1, y), zx, z0, zw)
    one, low = _f4(1), _f4(0.5)
    high_u = _f4((layout[j, SIZES + 2 * chroma] - 1) * 256 + 0.5)
    high_v = _f4((layout[j, SIZES + 2 * chroma + 1] - 1) * 256 + 0.5)
    stride = _i4(layout[j, STRIDES + chroma])
    first, index, fraction = _u8(start), 2 * k, 2 * k + 1
    for i in range(_u8(n)):
        x, w = xs[first + i], floats[_WS, first + i]
        per_z = one / (z0 + zx * x + zw * w)
        u = (u0 + ux * x + uw * w) * per_z
        v = (v0 + vx * x + vw * w) * per_z
        u = u if u > low else low
        v = v if v > low else low
        u = u if u < high_u else high_u
        v = v if v < high_v else high_v
        iu, iv = _i4(u), _i4(v)
        ints[index, i] = _i4(_i4(_i4(iv >> _i4(8)) * stride) + _i4(iu >> _i4(8)))
        ints[fraction, i] = _i4(_i4(_i4(iv & _i4(255)) << _i4(8)) | _i4(iu & _i4(255)))


@njit(**_TIGHT)
def _opencv_terms(lenses, j):
    """fx, fy, cx, cy and the twelve coefficients of a lens, in float32."""
    one, two = TERMS, TERMS + 6
    return (
        _f4(lenses[j, FOCAL]), _f4(lenses[j, FOCAL + 1]), _f4(lenses[j, CENTRE]), _f4(lenses[j, CENTRE + 1]),
        _f4(lenses[j, one]), _f4(lenses[j, one + 1]), _f4(lenses[j, one + 2]), _f4(lenses[j, one + 3]),
        _f4(lenses[j, one + 4]), _f4(lenses[j, one + 5]), _f4(lenses[j, two]), _f4(lenses[j, two + 1]),
        _f4(lenses[j, two + 2]), _f4(lenses[j, two + 3]), _f4(lenses[j, two + 4]), _f4(lenses[j, two + 5]),
    )  # fmt: skip


@njit(inline="always", **_OPTIONS)
def _opencv_pixel(x, y, z, terms):
    """u, v of a point in front of an OpenCV lens, and (x / z)^2 + (y / z)^2."""
    fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = terms
    one, two = _f4(1), _f4(2)
    per_z = one / z
    a, b = x * per_z, y * per_z
    s, ab = a * a + b * b, two * a * b
    g = (one + s * (k1 + s * (k2 + s * k3))) / (one + s * (k4 + s * (k5 + s * k6)))
    u = a * g + p1 * ab + p2 * (s + two * a * a) + s * (s1 + s2 * s)
    v = b * g + p1 * (s + two * b * b) + p2 * ab + s * (s3 + s4 * s)
    return cx + fx * u, cy + fy * v, s


@njit(**_TIGHT)
def _fisheye_terms(lenses, j):
    """fx, fy, cx, cy of a lens and its polynomial, the highest term first, in float32."""
    one, two = SERIES, SERIES + 8
    return (
        _f4(lenses[j, FOCAL]), _f4(lenses[j, FOCAL + 1]), _f4(lenses[j, CENTRE]), _f4(lenses[j, CENTRE + 1]),
        _f4(lenses[j, SERIES_SCALE]),
        _f4(lenses[j, two + 7]), _f4(lenses[j, two + 6]), _f4(lenses[j, two + 5]), _f4(lenses[j, two + 4]),
        _f4(lenses[j, two + 3]), _f4(lenses[j, two + 2]), _f4(lenses[j, two + 1]), _f4(lenses[j, two]),
        _f4(lenses[j, one + 7]), _f4(lenses[j, one + 6]), _f4(lenses[j, one + 5]), _f4(lenses[j, one + 4]),
        _f4(lenses[j, one + 3]), _f4(lenses[j, one + 2]), _f4(lenses[j, one + 1]), _f4(lenses[j, one]),
    )  # fmt: skip


@njit(inline="always", **_OPTIONS)
def _fisheye_pixel(x, y, z, terms):
    """u, v of a point before a fisheye, the square of its stereographic radius, and what that divides by."""
    fx, fy, cx, cy, scale, t15, t14, t13, t12, t11, t10, t9, t8, t7, t6, t5, t4, t3, t2, t1, t0 = terms
    depth = z + np.sqrt(x * x + y * y + z * z)
    per_depth = _f4(1) / depth
    a, b = x * per_depth, y * per_depth
    s = a * a + b * b
    t = s * scale - _f4(1)
    square = t * t
    fourth = square * square  # in four chains, because a processor waits for each step of a single one
    g0 = t0 + fourth * (t4 + fourth * (t8 + fourth * t12))
    g1 = t1 + fourth * (t5 + fourth * (t9 + fourth * t13))
    g2 = t2 + fourth * (t6 + fourth * (t10 + fourth * t14))
    g3 = t3 + fourth * (t7 + fourth * (t11 + fourth * t15))
    g = (g0 + t * g1) + square * (g2 + t * g3)
    return cx + fx * a * g, cy + fy * b * g, s, depth


@njit(**_OPTIONS)
def place_points(points, lenses, j, pixels):
    """Where points (n, 3) float32 before a lens fall: fills `pixels` (n, 2) float32."""
    opencv, fisheye = _opencv_terms(lenses, j), _fisheye_terms(lenses, j)
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if lenses[j, KIND] == OPENCV:
            u, v, _ = _opencv_pixel(x, y, z, opencv)
        else:
            u, v, _, _ = _fisheye_pixel(x, y, z, fisheye)
        pixels[i, 0], pixels[i, 1] = u, v


@njit(inline="always", **_OPTIONS)
def _told(u, s, depth, low, inside, beyond):
    """u, or what says more: in the picture's border where the model may not hold, far out where it does not."""
    u = u if s <= inside else low
    return u if (s <= beyond) & (depth > _f4(0)) else _f4(_NOWHERE_PX)


@njit(**_INNER)
def _place(xs, start, n, y, models, lenses, j, floats, places, seen):
    """Pixels of a source with distortion on a stretch of a row, and whether it sees them: 0 no, 2 yes, 1 open.

    In two loops, because of more than some arrays at once a compiler does not find out that they are apart.
    """
    p0x, p00, p0w = _form(models, j, POINT, y)
    p1x, p10, p1w = _form(models, j, POINT + 1, y)
    p2x, p20, p2w = _form(models, j, POINT + 2, y)
    low, high_u, high_v = _f4(lenses[j, LOW]), _f4(lenses[j, HIGH]), _f4(lenses[j, HIGH + 1])
    inside, beyond = _f4(lenses[j, INSIDE]), _f4(lenses[j, BEYOND])
    row_u, row_v = _u8(2 * j), _u8(2 * j + 1)
    begin, end = _u8(start), _u8(start + n)
    if lenses[j, KIND] == OPENCV:
        terms = _opencv_terms(lenses, j)
        for i in range(begin, end):
            x, w = xs[i], floats[_WS, i]
            px, py, pz = p0x * x + p00 + p0w * w, p1x * x + p10 + p1w * w, p2x * x + p20 + p2w * w
            u, v, s = _opencv_pixel(px, py, pz, terms)
            places[row_u, i] = _told(u, s, pz, low, inside, beyond)
            places[row_v, i] = v
    else:
        fisheye = _fisheye_terms(lenses, j)
        for i in range(begin, end):
            x, w = xs[i], floats[_WS, i]
            px, py, pz = p0x * x + p00 + p0w * w, p1x * x + p10 + p1w * w, p2x * x + p20 + p2w * w
            u, v, s, depth = _fisheye_pixel(px, py, pz, fisheye)
            places[row_u, i] = _told(u, s, depth, low, inside, beyond)
            places[row_v, i] = v
    margin = _f4(_MARGIN_PX)
    for i in range(begin, end):
        u, v = places[row_u, i], places[row_v, i]
        left, right, above, below = u - low, high_u - u, v - low, high_v - v
        least = left if left < right else right
        upright = above if above < below else below
        least = upright if upright < least else least
        seen[i] = np.uint8(_i4(2) if least > margin else (_i4(1) if least >= -margin else _i4(0)))


@njit(**_INNER)
def _place_exactly(x, y, w, models, lenses, j):
    """u, v of one pixel by the lens's own formulas in float64, and whether the source sees it."""
    px = models[j, POINT, 0] * x + (models[j, POINT, 1] * y + models[j, POINT, 2]) + models[j, POINT, 3] * w
    py = models[j, POINT + 1, 0] * x + (models[j, POINT + 1, 1] * y + models[j, POINT + 1, 2])
    py += models[j, POINT + 1, 3] * w
    pz = models[j, POINT + 2, 0] * x + (models[j, POINT + 2, 1] * y + models[j, POINT + 2, 2])
    pz += models[j, POINT + 2, 3] * w
    k = lenses[j, TERMS : TERMS + 12]
    if lenses[j, KIND] == OPENCV:
        if pz <= 0:
            return 0.0, 0.0, False
        a, b = px / pz, py / pz
        s = a * a + b * b
        in_model = s < lenses[j, LIMIT]
        g = (1 + s * (k[0] + s * (k[1] + s * k[4]))) / (1 + s * (k[5] + s * (k[6] + s * k[7])))
        u = a * g + 2 * k[2] * a * b + k[3] * (s + 2 * a * a) + s * (k[8] + k[9] * s)
        v = b * g + k[2] * (s + 2 * b * b) + 2 * k[3] * a * b + s * (k[10] + k[11] * s)
        t = lenses[j, TILT : TILT + 9]
        if t[8] > 0:
            depth = t[6] * u + t[7] * v + t[8]
            in_model &= depth > 0
            u, v = (t[0] * u + t[1] * v + t[2]) / depth, (t[3] * u + t[4] * v + t[5]) / depth
    else:
        off_axis = np.hypot(px, py)
        theta = np.arctan2(off_axis, pz)
        in_model = (theta < lenses[j, LIMIT]) & ((off_axis > 0) | (pz > 0))
        t = theta * theta
        g = theta * (1 + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3])))) / (off_axis if off_axis > 0 else 1.0)
        u, v = px * g, py * g
    u, v = u * lenses[j, FOCAL] + lenses[j, CENTRE], v * lenses[j, FOCAL + 1] + lenses[j, CENTRE + 1]
    low, high_u, high_v = lenses[j, LOW], lenses[j, HIGH], lenses[j, HIGH + 1]
    return u, v, in_model & (u >= low) & (u <= high_u) & (v >= low) & (v <= high_v)


@njit(**_TIGHT)
def _alike(seen, start, end):
    """The code that a whole stretch of pixels has; 1 where they differ, or are open."""
    least, most = _i4(2), _i4(0)
    for i in range(_u8(start), _u8(end)):
        code = _i4(seen[i])
        least = code if code < least else least
        most = code if code > most else most
    return least if least == most else _i4(1)


@njit(**_TIGHT)
def _is_hidden(u, v, models, layout, hidden, j):
    """Whether a pixel of a source with distortion may not be sampled."""
    across, down = u - models[j, HIDDEN, 0], v - models[j, HIDDEN, 1]
    columns, rows = models[j, HIDDEN, 2], models[j, HIDDEN, 3]
    if (across < 0) | (down < 0) | (across >= columns) | (down >= rows):
        return False
    return hidden[layout[j, HIDDEN_START] + int(down) * layout[j, HIDDEN_WIDTH] + int(across)] > 0


@njit(**_INNER)
def _placed_runs(xs, start, end, y, scene, models, layout, lenses, hidden, j, places, seen, runs, count):
    """The runs of columns that a source with distortion sees, put after the first `count` runs; returns the sum.

    What is open is decided, and placed anew, in float64.
    """
    per_length, ground_x, square = scene[PER_LENGTH], scene[GROUND], y * y + 1
    ground = scene[GROUND + 1] * y + scene[GROUND + 2]
    exact, opened, column = lenses[j, EXACT] > 0, -1, start
    hides = layout[j, HIDDEN_WIDTH] > 0
    while column < end:
        stop = min(column + _SCAN_CHUNK, end)
        code = _i4(1) if exact or hides else _alike(seen, column, stop)
        while column < stop:
            sees = code == 2
            if code == 1:
                sees = seen[column] == 2
                if exact or seen[column] == 1:
                    w = _inverse_depth_at(xs[column], square, per_length, ground_x, ground)
                    u, v, sees = _place_exactly(xs[column], y, w, models, lenses, j)
                    if sees:
                        places[2 * j, column], places[2 * j + 1, column] = u, v
            if sees and hides:
                u, v = np.float64(places[2 * j, column]), np.float64(places[2 * j + 1, column])
                sees = not _is_hidden(u, v, models, layout, hidden, j)
            if sees and opened < 0:
                opened = column
            elif opened >= 0 and not sees:
                runs[count, 0], runs[count, 1], runs[count, 2] = opened, column, j
                count += 1
                opened = -1
            column = column + 1 if code == 1 else stop
    if opened >= 0:
        runs[count, 0], runs[count, 1], runs[count, 2] = opened, end, j
        count += 1
    return count


@njit(**_INNER)
def _project_placed(places, start, n, models, layout, j, chroma, ints, k):
    """As `_project`, of a source whose pixels are known."""
    low, row = _f4(0.5), CHROMA if chroma else LUMA
    scale, offset = _f4(256 * models[j, row, 0]), _f4(256 * models[j, row, 1] + 0.5)
    high_u = _f4((layout[j, SIZES + 2 * chroma] - 1) * 256 + 0.5)
    high_v = _f4((layout[j, SIZES + 2 * chroma + 1] - 1) * 256 + 0.5)
    stride = _i4(layout[j, STRIDES + chroma])
    first, index, fraction = _u8(start), 2 * k, 2 * k + 1
    row_u, row_v = 2 * j, 2 * j + 1
    for i in range(_u8(n)):
        u, v = places[row_u, first + i] * scale + offset, places[row_v, first + i] * scale + offset
        u = u if u > low else low
        v = v if v > low else low
        u = u if u < high_u else high_u
        v = v if v < high_v else high_v
        iu, iv = _i4(u), _i4(v)
        ints[index, i] = _i4(_i4(_i4(iv >> _i4(8)) * stride) + _i4(iu >> _i4(8)))
        ints[fraction, i] = _i4(_i4(_i4(iv & _i4(255)) << _i4(8)) | _i4(iu & _i4(255)))


@njit(**_INNER)
def _border_distances(n, y, models, lenses, borders, j, floats, row):
    """|P| sin(angle to the border of its picture) of a source with distortion at `n` nodes of a row."""
    p0x, p00, p0w = _form(models, j, POINT, y)
    p1x, p10, p1w = _form(models, j, POINT + 1, y)
    p2x, p20, p2w = _form(models, j, POINT + 2, y)
    begin, columns, rows = int(lenses[j, SHARES]), int(lenses[j, SHARES + 1]), int(lenses[j, SHARES + 2])
    low_a, low_b, per_node = _f4(lenses[j, SHARES + 3]), _f4(lenses[j, SHARES + 4]), _f4(lenses[j, SHARES + 5])
    sine_rim, cosine_rim = _f4(lenses[j, SHARES + 6]), _f4(lenses[j, SHARES + 7])
    none = _f4(0)
    for i in range(_u8(n)):
        x, w = floats[_NODE_XS, i], floats[_NODE_WS, i]
        px, py, pz = p0x * x + p00 + p0w * w, p1x * x + p10 + p1w * w, p2x * x + p20 + p2w * w
        per_depth = per_node / (np.sqrt(px * px + py * py + pz * pz) + pz)
        floats[_GRID_AS, i] = px * per_depth - low_a * per_node
        floats[_GRID_BS, i] = py * per_depth - low_b * per_node
    for i in range(_u8(n)):
        x, w = floats[_NODE_XS, i], floats[_NODE_WS, i]
        px, py, pz = p0x * x + p00 + p0w * w, p1x * x + p10 + p1w * w, p2x * x + p20 + p2w * w
        aside = px * px + py * py
        distance = np.sqrt(aside + pz * pz)
        off_axis = np.sqrt(aside)
        within = sine_rim * pz - cosine_rim * off_axis
        floats[_RIMS, i] = within if cosine_rim * pz + sine_rim * off_axis > none else distance
        floats[_DISTANCES, i] = distance
    last_a, last_b = _f4(columns - 1), _f4(rows - 1)
    for i in range(_u8(n)):
        a, b = floats[_GRID_AS, i], floats[_GRID_BS, i]
        if not ((a >= none) & (b >= none) & (a < last_a) & (b < last_b)):
            floats[row, i] = none
            continue
        column, line = _i4(a), _i4(b)
        at = _u8(begin + 4 * (line * columns + column))
        side = _least_side(borders, at, at + _u8(4 * columns), a - _f4(column), b - _f4(line))
        side *= floats[_DISTANCES, i]
        floats[row, i] = side if side < floats[_RIMS, i] else floats[_RIMS, i]


@njit(**_TIGHT)
def _scaled(form, zx, z0, zw):
    """A form whose quotient with Z is 256 times as large, and rounds when it is cut to a whole number."""
    scale, half = _f4(256), _f4(0.5)
    return scale * form[0] + half * zx, scale * form[1] + half * z0, scale * form[2] + half * zw


@njit(**_TIGHT)
def _gather(atlas, offset, stride, ints, k, n, taps):
    """The four taps of each pixel, packed into 32 bits."""
    index = 2 * k
    upper, lower, soon = _u8(offset), _u8(offset + stride), _u8(offset + 3 * stride)
    for i in range(_u8(0), _u8(n), _u8(48)):
        _prefetch(atlas, soon + _u8(np.uint32(ints[index, i])))
    for i in range(_u8(n)):
        at = _u8(np.uint32(ints[index, i]))
        taps[i] = _i4(_load_pair(atlas, upper + at) | _i4(_load_pair(atlas, lower + at) << _i4(16)))


@njit(inline="always", **_OPTIONS)
def _bilinear(tap, f):
    """The bilinear sample of packed taps, times 2^16."""
    fx, fy = _i4(f & _i4(255)), _i4(f >> _i4(8))
    a, b = _i4(tap & _i4(255)), _i4(_i4(tap >> _i4(8)) & _i4(255))
    c, d = _i4(_i4(tap >> _i4(16)) & _i4(255)), _i4(_i4(tap >> _i4(24)) & _i4(255))
    upper = _i4(_i4(a << _i4(8)) + _i4(fx * _i4(b - a)))
    lower = _i4(_i4(c << _i4(8)) + _i4(fx * _i4(d - c)))
    return _i4(_i4(upper << _i4(8)) + _i4(fy * _i4(lower - upper)))


@njit(**_TIGHT)
def _store(taps, ints, k, n, canvas, start):
    """Writes the bilinear samples of packed taps to `canvas` from `start` on."""
    first, fraction = _u8(start), 2 * k + 1
    for i in range(_u8(n)):
        canvas[first + i] = np.uint8(_i4(_i4(_bilinear(taps[i], ints[fraction, i]) + _i4(32768)) >> _i4(16)))


@njit(**_TIGHT)
def _add(taps, ints, k, n, floats, share):
    """Adds share * bilinear sample of packed taps to the totals."""
    fraction = 2 * k + 1
    for i in range(_u8(n)):
        value = _f4(_bilinear(taps[i], ints[fraction, i])) * _f4(1 / 65536)
        floats[_TOTALS, i] += floats[share, i] * value


@njit(**_TIGHT)
def _store_totals(floats, n, canvas, start):
    first = _u8(start)
    for i in range(_u8(n)):
        canvas[first + i] = np.uint8(_i4(floats[_TOTALS, i]))


@njit(**_TIGHT)
def _pinhole_distances(n, y, models, j, floats, row):
    """|P| sin(angle to the border of its picture) of a pinhole source at `n` nodes of a row."""
    n0x, n00, n0w = _form(models, j, BORDERS, y)
    n1x, n10, n1w = _form(models, j, BORDERS + 1, y)
    n2x, n20, n2w = _form(models, j, BORDERS + 2, y)
    n3x, n30, n3w = _form(models, j, BORDERS + 3, y)
    for i in range(_u8(n)):
        x, w = floats[_NODE_XS, i], floats[_NODE_WS, i]
        left, right = n0x * x + n00 + n0w * w, n1x * x + n10 + n1w * w
        top, bottom = n2x * x + n20 + n2w * w, n3x * x + n30 + n3w * w
        least = left if left < right else right
        least = top if top < least else least
        floats[row, i] = bottom if bottom < least else least


@njit(**_TIGHT)
def _weigh(n, y, models, lenses, borders, j, scene, floats, row):
    """Angular weights of a source at `n` nodes of a row (`geometry.blending.angular_weights`)."""
    if lenses[j, KIND] > 0:
        _border_distances(n, y, models, lenses, borders, j, floats, row)
    else:
        _pinhole_distances(n, y, models, j, floats, row)
    p0x, p00, p0w = _form(models, j, POINT, y)
    p1x, p10, p1w = _form(models, j, POINT + 1, y)
    p2x, p20, p2w = _form(models, j, POINT + 2, y)
    a, b, c = _f4(models[j, ASIDE, 0]), _f4(models[j, ASIDE, 1]), _f4(models[j, ASIDE, 2])
    border_floor, parallax_floor = _f4(scene[BORDER_FLOOR]), _f4(scene[PARALLAX_FLOOR])
    one, two, y4 = _f4(1), _f4(2), _f4(y)
    for i in range(_u8(n)):
        x, w = floats[_NODE_XS, i], floats[_NODE_WS, i]
        px, py, pz = p0x * x + p00 + p0w * w, p1x * x + p10 + p1w * w, p2x * x + p20 + p2w * w
        to_source = px * px + py * py + pz * pz
        to_virtual = x * x + y4 * y4 + one
        cx, cy, cz = y4 * c - b, a - x * c, x * b - y4 * a
        both = to_source * to_virtual
        sine_square = w * w * (cx * cx + cy * cy + cz * cz) / both
        cosine = (to_virtual + w * (x * a + y4 * b + c)) / np.sqrt(both)
        chord = np.sqrt(two * sine_square / (one + cosine)) if cosine > _f4(-0.999) else two
        sine = floats[row, i] / np.sqrt(to_source)
        sine = sine if sine > border_floor else border_floor
        sine *= sine
        floored = chord + parallax_floor
        floats[row, i] = sine * sine / (floored * floored)


@njit(**_TIGHT)
def _share(among, n, min_share, floats):
    """Turns weights into shares that sum to 1; those below `min_share` are dropped."""
    for _ in range(2):
        for i in range(_u8(n)):
            floats[_TOTALS, i] = floats[_WEIGHTS, i]
        for k in range(1, among):
            for i in range(_u8(n)):
                floats[_TOTALS, i] += floats[_WEIGHTS + k, i]
        for k in range(among):
            for i in range(_u8(n)):
                share = floats[_WEIGHTS + k, i] / floats[_TOTALS, i]
                floats[_WEIGHTS + k, i] = share if share >= min_share else _f4(0)


@njit(**_INNER)
def _choose_largest(among, n, floats):
    """Turns weights into 1 for the first of the largest and 0 for the others."""
    for i in range(n):
        best = 0
        for k in range(1, among):
            best = k if floats[_WEIGHTS + k, i] > floats[_WEIGHTS + best, i] else best
        for k in range(among):
            floats[_WEIGHTS + k, i] = _f4(1) if k == best else _f4(0)


@njit(**_TIGHT)
def _summarise(among, n, floats):
    """Notes the largest share of each source; returns the largest step of any from one node to the next.

    In whole numbers, whose largest vector instructions find.
    """
    scale, steepest = _f4(1 << 20), _i4(0)
    for k in range(among):
        row = _WEIGHTS + k
        most = _i4(0)
        for i in range(_u8(n)):
            share = _i4(floats[row, i] * scale)
            most = share if share > most else most
        for i in range(_u8(n - 1)):
            step = _i4((floats[row, i + _u8(1)] - floats[row, i]) * scale)
            step = step if step > _i4(0) else _i4(-step)
            steepest = step if step > steepest else steepest
        floats[_LARGEST, k] = _f4(most)
    return _f4(steepest) / scale


@njit(**_TIGHT)
def _spread(floats, weights, n, apart, shares):
    """Shares between nodes that are `apart` pixels apart (LANES at most), linear, of `n` intervals."""
    columns, part = _u8(floats.shape[1]), _f4(1) / _f4(apart)
    for i in range(_u8(n)):
        value = floats[weights, i]
        step = (floats[weights, i + _u8(1)] - value) * part
        _store_ramp(floats, _u8(shares) * columns + i * _u8(apart), value, step)


@njit(**_INNER)
def _share_chunk(xs, start, n, y, scene, covering, among, models, lenses, borders, nearest, floats):
    """Shares of the sources that cover a stretch of a row; returns how many have any.

    Those are moved to the front of `covering` and of the shares.
    """
    first_share = _WEIGHTS + models.shape[0]
    spacing = xs[1] - xs[0]
    apart, chosen = 1 if nearest else _NODE_STEP, False
    while True:
        nodes = _whole_lanes(n if apart == 1 else (n + apart - 1) // apart + 1)
        _place_nodes(xs[start], _f4(apart) * spacing, nodes, y, scene, floats)
        for k in range(among):
            _weigh(nodes, y, models, lenses, borders, covering[k], scene, floats, _WEIGHTS + k)
        if nearest:
            _choose_largest(among, nodes, floats)
        else:
            _share(among, nodes, _f4(scene[MIN_SHARE]), floats)
        steepest = _summarise(among, nodes, floats)
        if chosen or apart == 1 or steepest <= _f4(_STEEP):
            break
        apart = 4 if steepest <= _f4(2 * _STEEP) else (2 if steepest <= _f4(4 * _STEEP) else 1)
        chosen = True
    left = 0
    for k in range(among):
        if floats[_LARGEST, k] > 0:
            covering[left] = covering[k]
            if apart == 1:
                for i in range(_u8(nodes)):
                    floats[first_share + left, i] = floats[_WEIGHTS + k, i]
            else:
                _spread(floats, _WEIGHTS + k, nodes - 1, apart, first_share + left)
            left += 1
    return left


@njit(**_TIGHT)
def _column(x, x_first, x_step, count, slack):
    """The column at x, moved by `slack` columns, clipped to [0, count]."""
    column = (x - x_first) / x_step + slack
    if column <= 0:
        return 0
    return count if column >= count else int(column)


@njit(**_TIGHT)
def _bounds(models, j, limits, y, w_low, w_high, x_first, x_step, count):
    """Columns of a row that a source sees at most, and those that it sees for certain: start, first, last, end.

    `w_low` and `w_high` bound w on the row.
    """
    outer_low, outer_high = -np.inf, np.inf
    inner_low, inner_high = -np.inf, np.inf
    for k in range(limits, limits + 5):
        a, rest, b = models[j, k, 0], models[j, k, 1] * y + models[j, k, 2], models[j, k, 3]
        one, other = rest + b * w_low, rest + b * w_high
        most, least = (one, other) if one > other else (other, one)
        if a > 0:
            outer, inner = -most / a, -least / a
            outer_low = outer if outer > outer_low else outer_low
            inner_low = inner if inner > inner_low else inner_low
        elif a < 0:
            outer, inner = -most / a, -least / a
            outer_high = outer if outer < outer_high else outer_high
            inner_high = inner if inner < inner_high else inner_high
        else:
            if most < 0:
                outer_high = -np.inf
            if least <= 0:
                inner_high = -np.inf
    start, end = _column(outer_low, x_first, x_step, count, -1), _column(outer_high, x_first, x_step, count, 2)
    first, last = _column(inner_low, x_first, x_step, count, 2), _column(inner_high, x_first, x_step, count, -1)
    first, last = first if first > start else start, last if last < end else end
    if end <= start:
        return 0, 0, 0, 0
    if last <= first:
        return start, start, start, end
    return start, first, last, end


@njit(**_TIGHT)
def _see(xs, start, end, y, scene, models, j, seen):
    """Whether a source sees each pixel of a stretch of a row, in float64."""
    per_length, ground_x, square = scene[PER_LENGTH], scene[GROUND], y * y + 1
    ground = scene[GROUND + 1] * y + scene[GROUND + 2]
    for i in range(_u8(start), _u8(end)):
        x = xs[i]
        w = _inverse_depth_at(x, square, per_length, ground_x, ground)
        least = np.inf
        for k in range(LIMITS, LIMITS + 4):
            value = models[j, k, 0] * x + (models[j, k, 1] * y + models[j, k, 2]) + models[j, k, 3] * w
            least = value if value < least else least
        k = LIMITS + 4
        ahead = models[j, k, 0] * x + (models[j, k, 1] * y + models[j, k, 2]) + models[j, k, 3] * w
        seen[i] = 1 if (least >= 0) & (ahead > 0) else 0


@njit(**_INNER)
def _hide(xs, start, end, y, scene, models, j, layout, hidden, seen):
    """Takes pixels of a stretch of a row out of `seen` whose place in the source is hidden, in float64."""
    per_length, ground_x, square = scene[PER_LENGTH], scene[GROUND], y * y + 1
    ground = scene[GROUND + 1] * y + scene[GROUND + 2]
    at, columns = layout[j, HIDDEN_START], layout[j, HIDDEN_WIDTH]
    for i in range(_u8(start), _u8(end)):
        x = xs[i]
        w = _inverse_depth_at(x, square, per_length, ground_x, ground)
        least = np.inf
        for k in range(HIDDEN, HIDDEN + 4):
            value = models[j, k, 0] * x + (models[j, k, 1] * y + models[j, k, 2]) + models[j, k, 3] * w
            least = value if value < least else least
        k = HIDDEN + 4
        ahead = models[j, k, 0] * x + (models[j, k, 1] * y + models[j, k, 2]) + models[j, k, 3] * w
        if (least < 0) | (ahead <= 0):
            continue
        k = HIDDEN
        across = (models[j, k, 0] * x + (models[j, k, 1] * y + models[j, k, 2]) + models[j, k, 3] * w) / ahead
        k = HIDDEN + 2
        down = (models[j, k, 0] * x + (models[j, k, 1] * y + models[j, k, 2]) + models[j, k, 3] * w) / ahead
        column = min(int(across), columns - 1)
        if hidden[at + int(down) * columns + column]:
            seen[i] = 0


@njit(**_TIGHT)
def _inverse_depth_bounds(xs, y, scene):
    """Bounds of w on a row."""
    x_first, x_last, square = xs[0], xs[xs.size - 1], y * y + 1
    ground_x, ground = scene[GROUND], scene[GROUND + 1] * y + scene[GROUND + 2]
    nearest = x_first if x_first > 0 else (x_last if x_last < 0 else 0.0)
    farthest = x_last if x_last > -x_first else x_first
    ball_low = np.sqrt(nearest * nearest + square) * scene[PER_LENGTH]
    ball_high = np.sqrt(farthest * farthest + square) * scene[PER_LENGTH]
    one, other = ground + ground_x * x_first, ground + ground_x * x_last
    plane_low, plane_high = (one, other) if one < other else (other, one)
    return ball_low if ball_low > plane_low else plane_low, ball_high if ball_high > plane_high else plane_high


@njit(**_INNER)
def _runs(xs, xs32, y, scene, models, layout, lenses, hidden, sources, source_count, runs, seen, floats, places):
    """The runs of columns that each source sees on a row: fills `runs` (n, 3) with start, end, source; returns n.

    Of sources with distortion `places` (2 sources, W) then holds the pixels.
    """
    width, count = xs.size, 0
    step = (xs[width - 1] - xs[0]) / (width - 1) if width > 1 else 1.0
    low, high = _inverse_depth_bounds(xs, y, scene)
    known_to = 0
    for s in range(source_count):
        j = sources[s]
        start, first, last, end = _bounds(models, j, LIMITS, y, low, high, xs[0], step, width)
        if end == start:
            continue
        if lenses[j, KIND] > 0:
            if known_to == 0:
                known_to = _whole_lanes(width)
                _inverse_depth(xs32, 0, known_to, y, scene, floats)
            _place(xs32, start, _whole_lanes(end - start), y, models, lenses, j, floats, places, seen)
            count = _placed_runs(
                xs, start, end, y, scene, models, layout, lenses, hidden, j, places, seen, runs, count
            )
            continue
        left = right = start
        if layout[j, HIDDEN_WIDTH] > 0:
            left, _, _, right = _bounds(models, j, HIDDEN, y, low, high, xs[0], step, width)
            left, right = max(left, start), min(right, end)
        if left < right:
            first, last = (first, min(last, left)) if left - first > last - right else (max(first, right), last)
            first, last = (first, last) if first < last else (start, start)
        _see(xs, start, first, y, scene, models, j, seen)
        _see(xs, last, end, y, scene, models, j, seen)
        if left < right:
            _hide(xs, left, right, y, scene, models, j, layout, hidden, seen)
        opened, column = -1, start
        while column < end:
            if column == first and last > first:
                opened = column if opened < 0 else opened
                column = last
                continue
            if seen[column]:
                opened = column if opened < 0 else opened
            elif opened >= 0:
                runs[count, 0], runs[count, 1], runs[count, 2] = opened, column, j
                count += 1
                opened = -1
            column += 1
        if opened >= 0:
            runs[count, 0], runs[count, 1], runs[count, 2] = opened, end, j
            count += 1
    return count


@njit(**_INNER)
def _possible_sources(xs, ys, scene, models, sources):
    """Indices of the sources that may see some pixel of a view; returns their number."""
    count = 0
    low, high = np.inf, -np.inf
    for row in range(ys.size):
        row_low, row_high = _inverse_depth_bounds(xs, ys[row], scene)
        low = row_low if row_low < low else low
        high = row_high if row_high > high else high
    for j in range(models.shape[0]):
        possible = True
        for k in range(LIMITS, LIMITS + 5):
            of_x, of_y, of_w = models[j, k, 0], models[j, k, 1], models[j, k, 3]
            most = models[j, k, 2] + of_w * (high if of_w > 0 else low)
            most += of_x * (xs[xs.size - 1] if of_x > 0 else xs[0])
            most += of_y * (ys[ys.size - 1] if of_y > 0 else ys[0])
            possible = possible and most >= 0
        if possible:
            sources[count] = j
            count += 1
    return count


@njit(**_TIGHT)
def _cuts(runs, count, width, cuts):
    """Sorted columns where some run starts or ends, 0 and `width` among them; returns their number."""
    cuts[0], cuts[1], number = 0, width, 2
    for k in range(count):
        cuts[number], cuts[number + 1] = runs[k, 0], runs[k, 1]
        number += 2
    for i in range(1, number):
        value, k = cuts[i], i
        while k > 0 and cuts[k - 1] > value:
            cuts[k] = cuts[k - 1]
            k -= 1
        cuts[k] = value
    return number


@njit(**_TIGHT)
def _covering(runs, count, start, end, covering):
    """The sources whose runs hold a stretch; returns their number."""
    among = 0
    for k in range(count):
        if runs[k, 0] <= start and runs[k, 1] >= end:
            covering[among] = runs[k, 2]
            among += 1
    return among


@njit(**_TIGHT)
def _fill(canvas, start, end, value):
    for i in range(_u8(start), _u8(end)):
        canvas[i] = value


@njit(**_INNER)
def _draw_row(
    xs64, xs, y, sources, source_count, scene, models, layout, lenses, borders, hidden, nearest, atlas, chroma,
    canvas, at, plane_size, covered, covered_at, runs, cuts, covering, seen, ints, taps, floats, places
):  # fmt: skip
    """Draws one row of the luma plane (chroma 0) or of both chroma planes (1), which starts at `at` in `canvas`.

    Returns the number of its pixels that a source sees.
    """
    width, seen_pixels = xs64.size, 0
    count = _runs(
        xs64, xs, y, scene, models, layout, lenses, hidden, sources, source_count, runs, seen, floats, places
    )
    number = _cuts(runs, count, width, cuts)
    if count:
        _inverse_depth(xs, cuts[1], _whole_lanes(cuts[number - 2] - cuts[1]), y, scene, floats)
    first_share = _WEIGHTS + models.shape[0]
    for cut in range(number - 1):
        start, stop = cuts[cut], cuts[cut + 1]
        if start == stop:
            continue
        among = _covering(runs, count, start, stop, covering)
        seen_pixels += stop - start if among else 0
        if not chroma:
            _fill(covered, covered_at + start, covered_at + stop, np.uint8(255 if among else 0))
        if among == 0:
            for p in range(1 + chroma):
                line = at + p * plane_size
                _fill(canvas, line + start, line + stop, np.uint8(128 if chroma else 0))
            continue
        longest = _SHARED_CHUNK if among > 1 else CHUNK
        while start < stop:
            n = stop - start if stop - start < longest else longest
            if longest == _SHARED_CHUNK:
                among = _covering(runs, count, start, stop, covering)
                among = _share_chunk(
                    xs, start, n, y, scene, covering, among, models, lenses, borders, nearest, floats
                )
            padded = _whole_lanes(n)
            for k in range(among):
                if lenses[covering[k], KIND] > 0:
                    _project_placed(places, start, padded, models, layout, covering[k], chroma, ints, k)
                else:
                    _project(xs, floats, start, padded, y, models, layout, covering[k], chroma, ints, k)
            for p in range(1 + chroma):
                line = at + p * plane_size
                if among > 1:
                    for i in range(_u8(padded)):
                        floats[_TOTALS, i] = _f4(0.5)
                for k in range(among):
                    j = covering[k]
                    offset, stride = layout[j, PLANES + p + chroma], layout[j, STRIDES + chroma]
                    _gather(atlas, offset, stride, ints, k, padded, taps)
                    if among == 1:
                        _store(taps, ints, k, padded, canvas, line + start)
                    else:
                        _add(taps, ints, k, padded, floats, first_share + k)
                if among > 1:
                    _store_totals(floats, padded, canvas, line + start)
            start += n
    return seen_pixels


@njit(**_OPTIONS)
def draw_view(
    xs, xs32, ys, xs_chroma, xs_chroma32, ys_chroma, scene, models, layout, lenses, borders, hidden, nearest, atlas,
    canvas, covered, runs, cuts, sources, covering, seen, ints, taps, floats, places
):  # fmt: skip
    """Draws a virtual picture in planes: Y (H, W), then U and V (H / 2, W / 2, rounded up).

    Args:
        xs, ys: (W,), (H,) float64 coordinates of the pixels on the virtual camera's plane z = 1.
        xs32: (W + LANES,) float32, the same.
        xs_chroma, xs_chroma32, ys_chroma: the same of the chroma samples.
        scene: (7,) float64, see PER_LENGTH.
        models: (sources, MODEL_ROWS, 4) float64, see LIMITS.
        layout: (sources, LAYOUT_COLUMNS) int64, see PLANES.
        lenses: (sources, LENS_COLUMNS) float64, see KIND.
        borders: float32, sines to the four sides of the pictures of sources with distortion.
        hidden: uint8, not 0 where nothing may be sampled: boxes of the sources' pictures, and a row more of 0.
        nearest: take the source with the largest weight instead of mixing.
        atlas: uint8, the source planes; each row has a byte more, each plane a row more than the picture.
        canvas: uint8 result, three planes with LANES bytes of padding after each; Y 0 and chroma 128 where no
            source sees the pixel.
        covered: (H W,) uint8 result, 255 where one does.
        runs, cuts, sources, covering, seen, ints, taps, floats, places: memory to work in, shaped as by `scratch`.

    Returns:
        How many pixels a source sees.
    """
    height, width, chroma_width = ys.size, xs.size, xs_chroma.size
    chroma_size = ys_chroma.size * chroma_width + LANES
    count = _possible_sources(xs, ys, scene, models, sources)
    seen_pixels = 0
    for row in range(height):
        for chroma in range(1 if row % 2 else 2):
            half = row // 2
            in_row = _draw_row(
                xs_chroma if chroma else xs, xs_chroma32 if chroma else xs32, ys_chroma[half] if chroma else ys[row],
                sources, count, scene, models, layout, lenses, borders, hidden, nearest, atlas, chroma, canvas,
                height * width + LANES + half * chroma_width if chroma else row * width, chroma_size,
                covered, row * width, runs, cuts, covering, seen, ints, taps, floats, places,
            )  # fmt: skip
            seen_pixels += 0 if chroma else in_row
    return seen_pixels


def scratch(width_px: int, sources: int) -> tuple[Array, ...]:
    """The memory that `draw_view` works in, for pictures of a width and a number of sources."""
    runs = sources * (width_px // 2 + 2)
    return (
        np.empty((runs, 3), np.int64),
        np.empty(2 * runs + 2, np.int64),
        np.empty(sources, np.int64),
        np.empty(sources, np.int64),
        np.empty(width_px + LANES, np.uint8),
        np.empty((2 * sources, CHUNK), np.int32),
        np.empty(CHUNK, np.int32),
        np.empty((_WEIGHTS + 2 * sources, max(width_px, _SHARED_CHUNK) + 2 * LANES), np.float32),
        np.zeros((2 * sources, width_px + 2 * LANES), np.float32),
    )


@njit(**_OPTIONS)
def split_planes(picture, luma, blue, red):
    """Y, Cb and Cr (full range, as JPEG has them) of a BGR picture (H, W, 3) uint8; chroma is the mean of four.

    The planes may be larger than the picture needs; what is beyond stays.
    """
    height, width = picture.shape[0], picture.shape[1]
    for row in range(_u8(height)):
        for column in range(_u8(width)):
            b, g, r = _i4(picture[row, column, 0]), _i4(picture[row, column, 1]), _i4(picture[row, column, 2])
            y = _i4(_i4(_i4(19595) * r) + _i4(_i4(38470) * g))
            luma[row, column] = np.uint8(_i4(_i4(_i4(y + _i4(_i4(7471) * b)) + _i4(32768)) >> _i4(16)))
    for row in range(_u8((height + 1) // 2)):
        upper, lower = _u8(2) * row, _u8(2) * row + _u8(1)
        lower = lower if lower < _u8(height) else upper
        for column in range(_u8((width + 1) // 2)):
            left, right = _u8(2) * column, _u8(2) * column + _u8(1)
            right = right if right < _u8(width) else left
            b, g, r = _i4(0), _i4(0), _i4(0)
            for at in ((upper, left), (upper, right), (lower, left), (lower, right)):
                b = _i4(b + _i4(picture[at[0], at[1], 0]))
                g = _i4(g + _i4(picture[at[0], at[1], 1]))
                r = _i4(r + _i4(picture[at[0], at[1], 2]))
            cb = _i4(_i4(_i4(32768) * b) - _i4(_i4(_i4(11059) * r) + _i4(_i4(21709) * g)))
            cr = _i4(_i4(_i4(32768) * r) - _i4(_i4(_i4(27439) * g) + _i4(_i4(5329) * b)))
            blue[row, column] = np.uint8(_i4(_i4(_i4(cb >> _i4(2)) + _i4(128 * 65536 + 32767)) >> _i4(16)))
            red[row, column] = np.uint8(_i4(_i4(_i4(cr >> _i4(2)) + _i4(128 * 65536 + 32767)) >> _i4(16)))


@njit(**_OPTIONS)
def reduce_plane(plane, height, width, quarters, sums, integral, reduced):
    """Means (rounded to nearest) of squares of a plane; its last row and column go on beyond it.

    Args:
        plane: uint8, at least (height, width).
        quarters: side of the squares in quarters of a sample, 5 to 256.
        sums, integral: memory to work in, uint32, of the width and 66 more.
        reduced: uint8 result, at least ceil(4 height / quarters) x ceil(4 width / quarters).
    """
    side, area = np.uint32(quarters), _u8(quarters) * _u8(quarters)
    half, inverse = area // _u8(2), (_u8(1 << 48) + area - _u8(1)) // area
    columns = (4 * width + quarters - 1) // quarters
    whole = (columns * quarters + 3) // 4
    for row in range((4 * height + quarters - 1) // quarters):
        first, end = row * quarters, (row + 1) * quarters
        for i in range(_u8(whole)):
            sums[i] = np.uint32(0)
        for line in range(first // 4, (end + 3) // 4):
            part = np.uint32(min(end, 4 * line + 4) - max(first, 4 * line))
            at = line if line < height else height - 1
            for i in range(_u8(width)):
                sums[i] += np.uint32(part * np.uint32(plane[at, i]))
        for i in range(_u8(width), _u8(whole + 1)):
            sums[i] = sums[width - 1]
        total = np.uint32(0)
        for i in range(_u8(whole + 1)):
            integral[i] = total
            total = np.uint32(total + (sums[i] << np.uint32(2)))
        before, quarter = np.uint32(0), np.uint32(0)
        for i in range(_u8(columns)):
            quarter = np.uint32(quarter + side)
            at_end = quarter >> np.uint32(2)
            until = np.uint32(integral[at_end] + np.uint32((quarter & np.uint32(3)) * sums[at_end]))
            reduced[row, i] = np.uint8((_u8(np.uint32(until - before)) + half) * inverse >> _u8(48))
            before = until


def warm_up() -> None:
    """Compiles the kernel, or loads it from the disk; once, before worker processes do so side by side."""
    axis, axis32, planes = np.zeros(2), np.zeros(2 + LANES, np.float32), np.zeros(6 + 3 * LANES, np.uint8)
    models, layout = np.zeros((0, MODEL_ROWS, 4)), np.zeros((0, LAYOUT_COLUMNS), np.int64)
    lenses, borders = np.zeros((0, LENS_COLUMNS)), np.zeros(0, np.float32)
    half = axis[:1].copy()
    draw_view(
        axis, axis32, axis, half, axis32, half, np.ones(MIN_SHARE + 1), models, layout, lenses, borders,
        planes.copy(), False, planes, planes.copy(), planes.copy(), *scratch(2, 0),
    )  # fmt: skip
    split_planes(np.zeros((2, 2, 3), np.uint8), *np.zeros((3, 2, 2), np.uint8))
    plane = np.zeros((2, 2), np.uint8)
    reduce_plane(plane, 2, 2, 8, *np.zeros((2, 68), np.uint32), plane.copy())
