"""An even polynomial, compiled: one ray, one face; the same steps as `clacad.optics.surface.roots`."""

from __future__ import annotations

from math import copysign, inf, isfinite, isnan, nan, sqrt

from clacad.base.compiled import exact
from clacad.base.types import Floats
from clacad.optics.surface.roots import CLOSE, POLYNOMIAL_STEPS, SETTLED, TIGHT, UPRIGHT
from clacad.tracing.compiled import packing as slot
from clacad.tracing.compiled.records import Ray, Vector


@exact
def polynomial_over(
    faces: Floats, row: int, x: float, y: float, z: float
) -> tuple[float, float, float, float, float]:
    """Normal G towards +z over (x, y), its z component w, height of z over the face, size of the terms."""
    cx, cy, side = faces[row, slot.CX], faces[row, slot.CY], faces[row, slot.SIDE]
    xx, yy = x * x, y * y
    p = (1.0 + faces[row, slot.KX]) * cx * cx * xx + (1.0 + faces[row, slot.KY]) * cy * cy * yy
    w = sqrt(1.0 - p) if p < 1.0 else 0.0
    terms, px, py = _even_terms(faces, row, xx, yy)
    gx, gy = _lateral(faces, row, x, y, w, px, py)
    base = (cx * xx + cy * yy) / (1.0 + w)
    return gx, gy, w, z - side * (base + terms), abs(z) + abs(base) + abs(terms)


@exact
def polynomial_normal(faces: Floats, row: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Normal G towards +z at a hit; where the base is steep, w comes from the height, as in numpy."""
    gx, gy, w, gap, _ = polynomial_over(faces, row, x, y, z)
    q = faces[row, slot.CX] * x * x + faces[row, slot.CY] * y * y
    above = q / (1.0 + w) + faces[row, slot.SIDE] * gap
    if not 0.0 < w < UPRIGHT or above == 0.0 or not q / above - 1.0 > 0.0:
        return gx, gy, w
    w = q / above - 1.0
    _, px, py = _even_terms(faces, row, x * x, y * y)
    gx, gy = _lateral(faces, row, x, y, w, px, py)
    return gx, gy, w


@exact
def _lateral(
    faces: Floats, row: int, x: float, y: float, w: float, px: float, py: float
) -> tuple[float, float]:
    """G_x and G_y where G_z = w, and the terms have slopes px and py over x and y."""
    cx, cy, side = faces[row, slot.CX], faces[row, slot.CY], faces[row, slot.SIDE]
    skew = cx * cy * ((1.0 + faces[row, slot.KX]) * cx - (1.0 + faces[row, slot.KY]) * cy)
    twist = side * skew * x * y / ((1.0 + w) * (1.0 + w))
    gx = -side * cx * x - side * w * (x * px) - twist * y
    gy = -side * cy * y - side * w * (y * py) + twist * x
    return gx, gy


@exact
def _even_terms(faces: Floats, row: int, xx: float, yy: float) -> tuple[float, float, float]:
    """Height of the terms, and its slopes over x and y, from x² and y² (`optics.surface.sag_and_normal`)."""
    a, b, c = faces[row, slot.A40], faces[row, slot.A22], faces[row, slot.A04]
    height, px, py = (
        xx * (a * xx + b * yy) + yy * (c * yy),
        4.0 * a * xx + 2.0 * b * yy,
        2.0 * b * xx + 4.0 * c * yy,
    )
    a, b, c, d = faces[row, slot.A60], faces[row, slot.A42], faces[row, slot.A24], faces[row, slot.A06]
    six = xx * (xx * (a * xx + b * yy) + yy * (c * yy)) + yy * (yy * (d * yy))
    six_x = xx * (6.0 * a * xx + 4.0 * b * yy) + yy * (2.0 * c * yy)
    six_y = xx * (2.0 * b * xx + 4.0 * c * yy) + yy * (6.0 * d * yy)
    a, b, c, d = faces[row, slot.A80], faces[row, slot.A62], faces[row, slot.A44], faces[row, slot.A26]
    e = faces[row, slot.A08]
    inner = xx * (a * xx + b * yy) + yy * (c * yy)
    eight = xx * (xx * inner + yy * (yy * (d * yy))) + yy * (yy * (yy * (e * yy)))
    eight_x = xx * (xx * (8.0 * a * xx + 6.0 * b * yy) + yy * (4.0 * c * yy)) + yy * (yy * (2.0 * d * yy))
    eight_y = xx * (xx * (2.0 * b * xx + 4.0 * c * yy) + yy * (6.0 * d * yy)) + yy * (yy * (8.0 * e * yy))
    return height + (six + eight), px + (six_x + eight_x), py + (six_y + eight_y)


@exact
def polynomial_root(faces: Floats, row: int, ray: Ray, base: Vector) -> float:
    """Distance from the base point to where the ray crosses the face in its direction; NaN for none."""
    bx, by, bz = base
    sense = -1.0 if ray.N < 0.0 else 1.0
    L, M, N = sense * ray.L, sense * ray.M, sense * ray.N
    first, last = _real_stretch(faces, row, bx, by, L, M)
    if not first <= last:
        return nan
    t = min(max(0.0, first), last)
    low, high, stride = -inf, inf, 0.0
    for _ in range(POLYNOMIAL_STEPS):
        gx, gy, w, gap, size = polynomial_over(faces, row, bx + t * L, by + t * M, bz + t * N)
        if isnan(gap):
            return nan
        if gap < 0.0:
            low = t
        else:
            high = t
        onward = gx * L + gy * M + w * N
        step = t - gap * w / onward if onward > 0.0 else nan
        bracketed = isfinite(low) and isfinite(high)
        usable = low <= step <= high and first <= step <= last and isfinite(step)
        usable = usable and (step != t or gap == 0.0 or w > 0.0)
        if usable:
            following = step
            if abs(step - t) <= SETTLED * abs(step) and abs(gap) <= CLOSE * size:
                return sense * step
        elif bracketed:
            following = 0.5 * (low + high)
        else:
            stride = max(2.0 * stride, 2.0 * abs(gap))
            following = min(max(t + (stride if gap < 0.0 else -stride), first), last)
            if following == t:
                return nan
        if bracketed and onward > 0.0 and high - low <= TIGHT * max(abs(low), abs(high)):
            return sense * following
        t = following
    return nan


@exact
def _real_stretch(faces: Floats, row: int, x: float, y: float, L: float, M: float) -> tuple[float, float]:
    """Ends of the stretch of the line over which the base is real; see `clacad.optics.surface.roots`."""
    cx, cy = faces[row, slot.CX], faces[row, slot.CY]
    a, b = (1.0 + faces[row, slot.KX]) * cx * cx, (1.0 + faces[row, slot.KY]) * cy * cy
    square = -(a * L * L + b * M * M)
    half, constant = -(a * x * L + b * y * M), 1.0 - (a * x * x + b * y * y)
    square_root = half * half - square * constant
    q = 0.0
    if square_root >= 0.0:
        q = -(half + copysign(sqrt(square_root), half))
    if q == 0.0:
        return (-inf, inf) if constant > 0.0 else (inf, -inf)
    two = constant / q
    if square == 0.0:
        return (-inf, two) if q > 0.0 else (two, inf)
    low, high = min(q / square, two), max(q / square, two)
    if square < 0.0:
        return low, high
    if low >= 0.0 or (high > 0.0 and -low <= high):
        return -inf, low
    return high, inf
