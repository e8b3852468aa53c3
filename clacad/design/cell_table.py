"""Tables of δ, and optionally η, for each cell, from an untrusted file: CSV or NPZ.

CSV: the header ``i,j,delta_x,delta_y``, optionally followed by ``,eta`` or by ``,eta_x``, ``,eta_y`` or
both, and by any of ``,phi``, ``,theta``, ``,psi``, and one row for each cell, in any order. i and j are the
cell's indices as in `clacad.Lattice` (axial for hexagons). A byte order mark and Windows line ends are
accepted.

NPZ: an array ``delta`` (n1, n2, 2) of numbers, whose first index is the position in the row, and optionally
``eta``, or ``eta_x`` and ``eta_y``, ``phi``, ``theta``, ``psi`` (n1, n2); pickled data are not read.

eta applies to both lens axes, eta_x and eta_y to one each; an axis that none of them names has the law's. It
must lie on the same side of 0 and of 1 as the law's η, so that both lenses keep their signs. phi, theta and
psi are those of law.euler for one cell, in degrees.

A table has exactly one δ for each kept cell of the sheet. The design's canonical text contains the table's
SHA-256, so that the design's hash covers its table.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from hashlib import sha256
from typing import TYPE_CHECKING, Final

from clacad.base.text import printable
from clacad.base.untrusted_files import BUDGETS, require_regular
from clacad.config.compound_kinds import REQUIRED, key
from clacad.config.mistakes import design_error, too_large
from clacad.config.toml_text import folder_of, outside
from clacad.config.value_kinds import Text

if TYPE_CHECKING:  # a design is read without numpy
    from clacad.base.types import Pair2
    from clacad.design.cell_table_rows import CellNumbers
    from clacad.sheet.lattice import Lattice

KEY = "law.varying.table"
TABLE_NAME: Final = Text("the name of a CSV or NPZ file in the design's folder", 200)
_SHA: Final = Text("a SHA-256 in hexadecimal", 64, pattern="[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class TableSpec:
    """A table of cells as named in a design; `sha256` in hexadecimal."""

    file: str = key(TABLE_NAME, "path of the table, relative to the design's folder", REQUIRED)
    sha256: str = key(_SHA, "SHA-256 of the table's bytes", REQUIRED)


def table_path(design_path: str, file: str) -> str:
    """Path of a table named in the design at `design_path`.

    Raises DesignError: The path leads out of the design's folder, or there is no such file.
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
        raise design_error(
            "CL124",
            f"the table {printable(file)} {why}",
            KEY,
            allowed="the name of a CSV or NPZ file in the design's folder",
        )
    return path


def digest(path: str) -> str:
    """SHA-256 of a table's bytes, in hexadecimal. Raises DesignTooLarge: The table has more than 1 GB."""
    size, most = os.stat(path).st_size, BUDGETS["cell-table"].bytes
    if size > most:
        raise too_large("CL124", f"the table has {size:,} bytes", KEY, path, allowed=f"up to {most:,} bytes")
    made = sha256()
    with open(path, "rb") as stream:
        while block := stream.read(1 << 20):
            made.update(block)
    return made.hexdigest()


def read_table(
    design_path: str,
    table: TableSpec,
    lattice: Lattice,
    eta: Pair2,
    euler: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> CellNumbers:
    """δ of every cell, and η and angles if the table has them.

    design_path : Path of the design that names the table.
    eta, euler : η of the design's law, along the lens axes; its φ, θ, ψ in degrees.
    Returns: First index: the position in the row; 0 and the law's η for cells that an outline leaves out.
    Raises DesignError: With row and column: a wrong header, a cell twice or missing, an index outside, a
        value that is no finite number from -1e6 to 1e6, an η on another side of 0 or 1. Without: a file
        changed since its hash was taken; an array of another shape, or pickled.
    Raises DesignTooLarge: The table has more than 10⁷ cells or 1 GB.
    """
    from clacad.design.cell_table_rows import TableFile

    path = table_path(design_path, table.file)
    most = BUDGETS["cell-table"].items or 0
    if (count := lattice.count[0] * lattice.count[1]) > most:
        why = f"{count:,} cells are more than the {most:,} that a table may have"
        raise too_large("CL124", why, KEY, allowed=f"up to {most:,} cells")
    if (found := digest(path)) != table.sha256:
        why = f"{path} is not the table whose sha256 the design states"
        hint = "the name alone takes the table as it is"
        raise design_error("CL124", why, KEY, found=found, allowed=table.sha256, hint=hint)
    return TableFile(path, lattice, KEY, eta, euler).numbers()
