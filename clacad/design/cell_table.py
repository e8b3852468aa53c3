"""Tables of δ, and perhaps η, cell by cell, from a file that anybody may have written: CSV or NPZ.

CSV: the header ``i,j,delta_x,delta_y``, or that and ``,eta``, and one row for each cell, in any order; i and j are the
cell's indices as `clacad.Lattice` counts them (of hexagons axial ones). A byte order mark and Windows line ends are taken.
NPZ: an array ``delta`` (n1, n2, 2) of numbers, whose first index is the place in the row, and perhaps ``eta`` (n1, n2);
what is pickled is not read. η is of both lens axes, and on the same side of 0 and of 1 as the law's, so that both lenses keep
their signs.

A table has exactly one δ for each cell that the sheet keeps. Its SHA-256 stands in the design's canonical text, so that
the hash of the design is that of its table too.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from hashlib import sha256
from typing import TYPE_CHECKING

from clacad.base.reading_budgets import BUDGETS
from clacad.base.regular_file import require_regular
from clacad.base.text import printable
from clacad.config.design_error import DesignError, DesignTooLarge
from clacad.config.mistakes import Mistake
from clacad.config.named_paths import folder_of, outside

if TYPE_CHECKING:  # a design is read without numpy
    from clacad.design.cell_table_rows import CellNumbers
    from clacad.sheet.lattice import Lattice

KEY = "law.varying.table"


@dataclass(frozen=True, slots=True)
class TableSpec:
    """A table of cells as a design names it.

    Parameters
    ----------
    file : str
        Relative to the design's folder.
    sha256 : str
        Of the file's bytes, in hexadecimal.
    """

    file: str
    sha256: str


def table_path(design_path: str, file: str) -> str:
    """Path of a table that a design at `design_path` names.

    Raises
    ------
    DesignError
        It leads out of the design's folder, or there is no file.
    """
    folder = folder_of(design_path)
    path = os.path.join(folder, file)
    why = outside(folder, file)
    if not why:
        try:
            require_regular(path)
        except OSError as problem:
            why = f"cannot be read: {(problem.strerror or str(problem)).lower()}"
    if why:
        raise DesignError([Mistake("CL124", f"the table {printable(file)} {why}", KEY,
                                   allowed="the name of a CSV or NPZ file in the design's folder")])  # fmt: skip
    return path


def digest(path: str) -> str:
    """SHA-256 of a table's bytes, in hexadecimal.

    Raises
    ------
    DesignTooLarge
        More than 1 GB.
    """
    size, most = os.stat(path).st_size, BUDGETS["cell-table"].bytes
    if size > most:
        raise DesignTooLarge([Mistake("CL124", f"the table has {size:,} bytes", KEY, path,
                                      allowed=f"up to {most:,} bytes")])  # fmt: skip
    made = sha256()
    with open(path, "rb") as stream:
        while block := stream.read(1 << 20):
            made.update(block)
    return made.hexdigest()


def read_table(design_path: str, table: TableSpec, lattice: Lattice, eta: float) -> CellNumbers:
    """δ of every cell, and η where the table has it.

    Parameters
    ----------
    design_path : str
        Of the design that names the table.
    table : TableSpec
    lattice : Lattice
    eta : float
        Of the design's law, along x.

    Returns
    -------
    CellNumbers
        First index: the place in the row; 0 and the law's η for cells that an outline leaves out.

    Raises
    ------
    DesignError
        With row and column: a wrong header, a cell twice or missing, an index outside, what is no finite number from
        -1e6 to 1e6, an η of another kind; a file that has changed since its hash was taken; an array of another shape, or pickled.
    DesignTooLarge
        More than 10⁷ cells or 1 GB.
    """
    from clacad.design.cell_table_rows import TableFile

    path = table_path(design_path, table.file)
    most = BUDGETS["cell-table"].items or 0
    if (count := lattice.count[0] * lattice.count[1]) > most:
        raise DesignTooLarge([Mistake("CL124", f"{count:,} cells are more than the {most:,} that a table may have", KEY,
                                      allowed=f"up to {most:,} cells")])  # fmt: skip
    if (found := digest(path)) != table.sha256:
        raise DesignError([Mistake("CL124", f"{path} is not the table whose sha256 the design states", KEY, found=found,
                                   allowed=table.sha256, hint="the name alone takes the table as it is")])  # fmt: skip
    return TableFile(path, lattice, KEY, eta).numbers()
