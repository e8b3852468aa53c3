"""Heights as whole numbers of a binary step: equal heights are equal to the last bit, everywhere.

The step is the float32 spacing at the sheet's largest |z|, so that every height survives a float32
file unchanged; single linkage merges levels closer than a few steps, which leaves room for a vertex
between any two that differ.
"""

from __future__ import annotations

from math import ceil, frexp, ldexp

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.sheet.window import Window
from clacad.topology.walls import linked

FAR = 2**60  # the other side of a body whose faces are meshed apart
NONE = 2**61  # a front without a surface; −NONE a back without one
LENS, LAND, VOID = 0, 1, 2  # what a face of a footprint's triangle is
LEAST_GAP = 4  # steps between two levels that are not one


def z_step(window: Window) -> float:
    """The binary step of heights (length): float32 spacing at the largest |z| of the sheet."""
    lands = [abs(face.land) for face in window.faces if face.land is not None]
    top = max(abs(window.z_range[0]), abs(window.z_range[1]), *lands, 1e-300) * (1.0 + 1e-6)
    return ldexp(1.0, frexp(top)[1] - 24)


def to_levels(z: Floats, step: float, missing: int) -> Ints:
    """Round heights to levels; NaN gives `missing`, infinite heights ±FAR."""
    z = np.asarray(z, dtype=np.float64)
    known = np.isfinite(z)
    level = np.rint(np.where(known, z, 0.0) / step).astype(np.int64)
    return np.asarray(np.where(known, level, np.where(np.isnan(z), missing, np.where(z > 0, FAR, -FAR))))


def merge_steps(merge: float | None, step: float) -> int:
    """Merge height in steps: at least LEAST_GAP."""
    return LEAST_GAP if merge is None else max(LEAST_GAP, ceil(merge / step))


def cluster(levels: Ints, fixed: Bools, gap: int) -> Ints:
    """Single linkage along each row: levels whose sorted gaps are at most `gap` become one.

    Parameters
    ----------
    levels : (n, c) int64
        Values of magnitude FAR and beyond are left alone.
    fixed : (c,) bool
        Columns whose level a cluster takes over (land, plane faces); else it takes its middle.
    """
    order = np.argsort(levels, axis=1, kind="stable")
    z = np.take_along_axis(levels, order, axis=1)
    group = linked(
        z, gap
    )  # levels of magnitude FAR never lie within `gap` of a real one; equal ones may share a group
    n, c = z.shape
    flat = group + c * np.arange(n)[:, None]
    first = np.full(n * c, np.iinfo(np.int64).max)
    last = np.full(n * c, np.iinfo(np.int64).min)
    np.minimum.at(first, flat, z)
    np.maximum.at(last, flat, z)
    chosen = first + (last - first) // 2 if n * c else first
    held = fixed[order]
    chosen[flat[held]] = z[held]
    out = np.empty_like(z)
    np.put_along_axis(out, order, chosen[flat], axis=1)
    return out
