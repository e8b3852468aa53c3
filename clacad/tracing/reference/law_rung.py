"""Rung "law": the sheet as a plane z = 0 that obeys its law exactly, or in each cell the law of that cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clacad.base.types import Floats, Rows
from clacad.optics.rays import Fate
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
