"""Content of instanced formats: one small mesh, and its positions on the lattice."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints
from clacad.sheet.lattice import Lattice
from clacad.storage.errors import FileDisagrees

FLAT_LIMIT = 50_000
"""Number of positions up to which components of 3MF are written in one level, which every tested reader
understands.
"""


@dataclass(frozen=True, eq=False)
class Piece:
    """A closed mesh and its positions.

    Parameters
    ----------
    name : str
        Body it belongs to.
    vertices : (v, 3) array, design units
        About the piece's own origin (the centre of its cell, z of the sheet).
    triangles : (t, 3) int array
    normals : (v, 3) array or None
        Exact unit normals at the vertices, for formats that keep them.
    places : Places or None
        None: the piece occurs once, at its coordinates.
    index : float
        Refractive index, for formats that draw glass.
    """

    name: str
    vertices: Floats
    triangles: Ints
    normals: Floats | None = None
    places: Places | None = None
    index: float = 1.5

    @property
    def count(self) -> int:
        """Number of instances of the piece."""
        return 1 if self.places is None else self.places.count

    def sound(self, scale: float, centre: Floats | None = None) -> tuple[Floats, Floats]:
        """Positions (v, 3), scaled, about `centre` (design units) if given, and normals: finite, without −0.

        Raises
        ------
        FileDisagrees
            There are no normals, or a number is not finite.
        """
        if self.normals is None:
            raise FileDisagrees(f"{self.name}: this format needs vertex normals")
        position = (self.vertices if centre is None else self.vertices + centre) * scale + 0.0
        normal = self.normals + 0.0
        if not (np.isfinite(position).all() and np.isfinite(normal).all()):
            raise FileDisagrees(f"{self.name}: a vertex or normal is not a finite number")
        return position, normal


@dataclass(frozen=True, eq=False)
class Places:
    """Positions of the cells of an array, row by row.

    Parameters
    ----------
    lattice : Lattice
    shift : (x, y), lengths
        Displacement of the array against the lattice.
    """

    lattice: Lattice
    shift: tuple[float, float]

    @property
    def count(self) -> int:
        """Number of cells."""
        return self.lattice.cell_count

    def centres(self) -> NDArray[np.float64]:
        """Centres of all cells, row by row, (m, 3), lengths; z is 0."""
        flat = self.lattice.centres(self.lattice.cells()) + np.asarray(self.shift)
        return np.column_stack([flat, np.zeros(len(flat))])

    def rows(self) -> tuple[list[Floats], list[tuple[int, tuple[float, float]]]]:
        """Group cells into kinds of rows, so that equal rows are written once.

        Returns
        -------
        kinds : list of (k,) arrays
            x of the cells of a row, from its first cell.
        `standing` : list of (kind, (x, y))
            For every row: its kind, and the position of its first cell.
        """
        kinds: dict[tuple[int, ...], int] = {}
        offsets: list[Floats] = []
        standing = []
        for j in range(self.lattice.count[1]):
            row = self.lattice.row(j)
            if not len(row):
                continue
            pattern = tuple((row[:, 0] - row[0, 0]).tolist())
            if pattern not in kinds:
                kinds[pattern] = len(kinds)
                offsets.append(np.array(pattern, dtype=np.float64) * self.lattice.pitch[0])
            x, y = self.lattice.centres(row[0]) + np.asarray(self.shift)
            standing.append((kinds[pattern], (float(x), float(y))))
        return offsets, standing
