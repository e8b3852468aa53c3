"""Rung "law": the sheet as a plane z = 0 that obeys its law exactly, or in each cell the law of that cell.

Sums over traced rays, in numpy: the contribution of each to the numbers of `clacad.tracing.light_sums`.

In the frame of the lenses a ray m is incident and the law sends it along w = (m_x/η_x − m_z δ_x/η_x, …, m_z).
With u = w/|w| and r the ray's own exit direction minus u, one step of Gauss and Newton in (1/η_x, 1/η_y,
δ_x/η_x, δ_y/η_y) solves N s = g with N = Σ Jᵀ J, g = Σ Jᵀ r and J = (1 − u uᵀ) ∂w/|w|, which needs only the
products below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clacad.base.types import Bools, Floats, Rows
from clacad.optics.law import Law, angle_between, linear_numbers
from clacad.optics.rays import Fate, TraceResult
from clacad.tracing.layout import Layout, sheet_position
from clacad.tracing.ledger import Ledger
from clacad.tracing.reference.launch import launch

LARGE = 2.0**100
"""Laws with a number above this, or an η below its inverse, are left to numpy."""


def ordinary(law: Floats) -> bool:
    """Whether compiled code, which has no separate powers of two, can represent a law's numbers; see
    `law_numbers`.
    """
    return bool(np.abs(law[:2]).min() > 1.0 / LARGE and np.abs(law).max() < LARGE)


@dataclass(frozen=True)
class SheetPlane:
    """The sheet plane as the space that the sheet occupies."""

    box: tuple[float, float, float, float]
    level: float = 0.0
    low: float = 0.0
    high: float = 0.0


def trace_law(layout: Layout, ledger: Ledger, rows: Rows, continuous: bool = False) -> None:
    """Write the rows (k,) of rays that cross a kept cell's footprint in z = 0.

    Rays are ALIVE where the law has an answer, BACKWARD where it has none; the rest stay MISSED.
    `continuous`: use the law at the very point met instead of the law at the centre of the cell hit.
    """
    window = layout.window
    plane = SheetPlane(window.lattice.extent())
    beam, carried = launch(layout, plane, ledger.position, ledger.direction, rows)
    met = layout.lattice.contains(beam.cell) & (carried >= 0.0)
    beam, carried = beam.take(met), carried[met]
    position = sheet_position(layout, 0, beam.cell, beam.local, np.zeros(len(beam)))
    smooth = None if window.cell_laws is None else window.cell_laws.smooth
    if window.cell_laws is None:
        out = window.law.refract(ledger.direction[beam.rows])
    elif continuous and smooth is not None:
        out = smooth.refract(ledger.direction[beam.rows], position[:, :2])
    else:
        out = window.cell_laws.refract(layout.lattice, beam.cell, ledger.direction[beam.rows])
    refused = np.isnan(out[:, 0])
    fate = np.where(refused, Fate.BACKWARD, Fate.ALIVE).astype(np.uint8)
    direction = np.where(refused[:, None], beam.direction, out)
    ledger.record(0, beam.rows, position, direction)
    ledger.end(beam.rows, fate, position, direction, carried, 0)
    ledger.cell[beam.rows] = beam.cell
    ledger.order[beam.rows[~refused]] = 0


KNOWN = len(Fate)
"""Index of the ALIVE rays for which the law has an answer; counts by fate come first."""

SQUARE, OUT = KNOWN + 1, KNOWN + 2
"""Indices of the squared angles to the law and of the exit directions of the ALIVE rays (3)."""

NORMAL, GRADIENT, NUMBERS = KNOWN + 5, KNOWN + 15, KNOWN + 19
"""Indices of the ten products that make up N, and of g (4)."""


def sums_of(law: Law, ray: Floats, result: TraceResult) -> tuple[Floats, float]:
    """Sums (NUMBERS,) over the rays of a result and the largest angle to the law (radians).

    ray : (m, 3)
        Directions before the sheet.
    """
    sums = np.zeros(NUMBERS)
    sums[:KNOWN] = np.bincount(result.fate, minlength=KNOWN)
    alive = result.fate == Fate.ALIVE
    sums[OUT : OUT + 3] = [np.ascontiguousarray(c).sum() for c in result.direction[alive].T]
    asked = law.refract(ray[alive])
    known = np.isfinite(asked[:, 0])
    angle = angle_between(result.direction[alive][known], asked[known])
    sums[KNOWN], sums[SQUARE] = known.sum(), (angle * angle).sum()
    sums[NORMAL:] = _step_sums(law, ray[alive], result.direction[alive], known)
    return sums, float(angle.max(initial=0.0))


def _step_sums(law: Law, ray: Floats, out: Floats, known: Bools) -> Floats:
    """N and g: (14,)."""
    m = (ray[known] / np.linalg.norm(ray[known], axis=1)[:, None]) @ law.rotation
    power_x, power_y, offset_x, offset_y = linear_numbers(law)
    w = np.stack([m[:, 0] * power_x - m[:, 2] * offset_x, m[:, 1] * power_y - m[:, 2] * offset_y, m[:, 2]])
    length = np.sqrt((w * w).sum(axis=0))
    x, y, z = w / length
    a, b, c = m.T / length
    more = (out[known] @ law.rotation).T - [x, y, z]
    gx, gy = more[:2] - (more * [x, y, z]).sum(axis=0) * [x, y]
    xx, yy, xy = 1.0 - x * x, 1.0 - y * y, -x * y
    terms = (
        xx * a * a,
        xx * a * c,
        xx * c * c,
        yy * b * b,
        yy * b * c,
        yy * c * c,
        xy * a * b,
        xy * a * c,
        xy * b * c,
        xy * c * c,
        a * gx,
        b * gy,
        c * gx,
        c * gy,
    )
    return np.array([term.sum() for term in terms])
