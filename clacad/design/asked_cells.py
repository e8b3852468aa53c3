"""The cells that a design asks for, and the law of each."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clacad.design.cell_table import read_table
from clacad.design.varying import gradient_of
from clacad.sheet.cell_laws import CellLaws
from clacad.sheet.lattice import Circle, Lattice, Rectangle

if TYPE_CHECKING:
    from clacad.design.model import Design


def lattice_of(design: Design) -> Lattice:
    """The pattern of its cells."""
    spec = design.lattice
    outline: Circle | Rectangle | None = None
    if spec.outline is not None:
        size = spec.outline.size
        outline = Circle(size[0]) if spec.outline.shape == "circle" else Rectangle(*size)
    return Lattice(spec.kind, spec.pitch, spec.count, outline)


def cell_laws(design: Design) -> CellLaws:
    """The law of each cell.

    Raises
    ------
    DesignError
        Its table cannot be read.
    """
    law, spec = design.law, design.law_spec.varying
    if spec is None:
        return CellLaws(law)
    if spec.table is not None:
        return CellLaws(law, table=read_table(design.path, spec.table, lattice_of(design)))
    rows = np.array(gradient_of(spec, design.law_spec.eta, design.pair.separation or 0.0))
    if spec.gradient is None:  # planes are given along the lens axes
        rows = rows @ law.rotation[:2, :2].T
    (xx, xy), (yx, yy) = rows.tolist()
    return CellLaws(law, ((xx, xy), (yx, yy)))
