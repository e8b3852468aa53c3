"""Cells that a design requests, and the law of each cell."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.design.body import BodySpec
from clacad.design.cell_table import read_table
from clacad.design.sections import LatticeSpec, LawSpec, PairSpec
from clacad.design.varying import Planes, VaryingSpec, gradient_of
from clacad.optics.law import Law
from clacad.sheet.cell_places import CellLaws, as_table
from clacad.sheet.lattice import Circle, Lattice, Rectangle


class Requested(Protocol):
    """What the cells depend on; a `Design` has it."""

    @property
    def law(self) -> Law:
        """Law of the sheet's centre."""

    @property
    def law_spec(self) -> LawSpec:
        """Section [law]."""

    @property
    def pair(self) -> PairSpec:
        """Section [pair]."""

    @property
    def lattice(self) -> LatticeSpec:
        """Section [lattice]."""

    @property
    def body(self) -> BodySpec:
        """Section [body]."""

    @property
    def path(self) -> str:
        """Name of the file, "" without one."""


def lattice_of(design: Requested) -> Lattice:
    """Pattern of the design's cells."""
    spec = design.lattice
    outline: Circle | Rectangle | None = None
    if spec.outline is not None:
        size = spec.outline.size
        outline = Circle(size[0]) if spec.outline.shape == "circle" else Rectangle(*size)
    return Lattice(spec.kind, spec.pitch, spec.count, outline)


def cell_laws(design: Requested) -> CellLaws:
    """The law of each cell.

    Raises DesignError: The table cannot be read.
    """
    laws = _laws_of(design, design.law_spec.varying)
    if laws.ratios is None and cut_across(design):
        return replace(laws, ratios=_alike(design, design.law_spec.eta))
    return laws


def _laws_of(design: Requested, spec: VaryingSpec | None) -> CellLaws:
    """As `cell_laws`, of cells that have the law's η unless a table states another."""
    law = design.law
    if spec is None:
        if design.pair.focus is None or law.theta == 0.0:
            return CellLaws(law)
        return CellLaws(law, table=_inclined_deltas(design, design.pair.focus))
    if spec.table is not None:
        asked = design.law_spec
        found = read_table(design.path, spec.table, lattice_of(design), asked.eta, asked.euler_degrees)
        angles = None if found.euler is None else np.radians(found.euler)
        return CellLaws(law, table=found.deltas, ratios=found.etas, angles=angles)
    if spec.gradient is None and law.theta != 0.0:
        return CellLaws(law, table=_inclined_deltas(design, spec.conjugates, spec.f_image))
    rows = np.array(gradient_of(spec, design.law_spec.eta, design.pair.separation or 0.0))
    if spec.gradient is None:  # planes are given along the lens axes
        rows = rows @ law.rotation[:2, :2].T
    (xx, xy), (yx, yy) = rows.tolist()
    return CellLaws(law, ((xx, xy), (yx, yy)))


def cut_across(design: Requested) -> bool:
    """Whether cells or their tilt would cut the cylinders of a field lens of two η, or a baffle interrupt
    them: its faces are then curved along both axes, as those of a table of such cells.
    """
    eta, euler = design.law_spec.eta, design.law_spec.euler_degrees
    if not design.pair.field_lens or eta[0] == eta[1]:
        return False
    turned = bool(euler[1] or (euler[0] + euler[2]) % 90.0)
    return turned or design.lattice.kind == "hexagonal" or (design.body.baffle and design.pair.form != "slab")


def _alike(design: Requested, numbers: Pair2) -> Floats:
    """The same two numbers in all cells, as a table (n1, n2, 2)."""
    lattice = lattice_of(design)
    cells = lattice.cells()
    return as_table(lattice, cells, np.tile(numbers, (len(cells), 1)))


def _inclined_deltas(design: Requested, planes: Planes | None, f_image: Pair2 | None = None) -> Floats:
    """δ (n1, n2, 2) of the cells of a sheet inclined to its lenses, which image one point of the axis to one
    behind the sheet.

    Planes lie across the lens axis, so each cell has its own distances. A chief ray of slope t through the
    centre c of lens 1, lens frame, reaches lens 2 at c + s t and leaves with t' = (t − δ)/η to the image.
    """
    law, eta = design.law, np.array(design.law_spec.eta)
    lattice = replace(lattice_of(design), outline=None)
    centres = lattice.centres(cells := lattice.cells())
    x, y, z = (np.column_stack([centres, np.zeros(len(centres))]) @ law.rotation).T
    across, separation = np.column_stack([x, y]), design.pair.separation or 0.0
    image = np.array(f_image if planes is None else (planes.image, planes.image))
    apart = z - (-np.inf if planes is None else planes.object)
    slope = across / apart[:, None]
    deltas = slope + np.array(design.law_spec.delta)
    for axis in np.flatnonzero(np.isfinite(image)):
        reach = image[axis] - z
        arrival = across[:, axis] + separation * slope[:, axis]
        deltas[:, axis] += (eta[axis] * arrival + design.law_spec.delta[axis] * z) / reach
    return as_table(lattice, cells, deltas)
