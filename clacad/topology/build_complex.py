"""Build a body's cell complex from its window."""

from __future__ import annotations

from functools import lru_cache

from clacad.sheet.grid_steps import one_tiling
from clacad.sheet.pieces_and_holes import count_together
from clacad.sheet.window import Body, Window
from clacad.topology.borders import make_border
from clacad.topology.complex_parts import SIDES, CellComplex, Tiling
from clacad.topology.nodes import make_nodes


@lru_cache(maxsize=16)  # windows and bodies are immutable: every grid of a sheet shares its complex
def cell_complex(
    window: Window, body: Body, merge: float | None = None, spacing: float | None = None
) -> CellComplex:
    """Build the one topology of a body that mesh and B-Rep share.

    Parameters
    ----------
    window : Window
    body : Body
        One of `window.bodies`.
    merge : length, optional
        Heights at a node or border that differ by less are merged. Default 1 nm (1e-6 mm, ten times
        the uncertainty stated in a STEP file), at most 1e-3 of the pitch.
    spacing : length, optional
        Crossings closer than that to a node or to one another are dropped. Default: `merge`.

    Raises
    ------
    ValueError
        The body's two faces repeat on displaced arrays but the window has no outline; or an outline is
        requested for a face without land.
    """
    if merge is None:
        merge = min(1e-9 / window.unit, 1e-3 * min(window.lattice.pitch))
    spacing = merge if spacing is None else spacing
    arrays = one_tiling(window, body)
    if len(arrays) == 2 and window.outline is None:
        raise ValueError(
            f"body {body.name!r} has its faces on arrays displaced by {window.shifts[1]}, so their cells have no "
            "common footprint; the window needs an outline (body.border or lattice.outline)"
        )
    columnar = len(arrays) == 1
    tilings = tuple(_make_tiling(window, body, array, columnar, merge, spacing) for array in arrays)
    return CellComplex(window, body, merge, tilings)


def _make_tiling(
    window: Window, body: Body, array: int, columnar: bool, merge: float, spacing: float
) -> Tiling:
    """The complex of the faces that repeat on one array; `columnar`: it cuts the whole body into columns."""
    names = tuple(
        name
        for name, face in zip(SIDES, (body.front, body.back))
        if (face.array is not None if columnar else face.array == array)
    )
    borders = tuple(
        make_border(window, body, array, columnar, k, merge, spacing)
        for k in range(len(window.lattice.steps) // 2)
    )
    nodes = make_nodes(window, body, array, names, merge)
    tile = window.lattice_of(array).tile()
    return Tiling(array, window.shifts[array], tile, borders, nodes)


def saddle_count(cells: CellComplex) -> int:
    """Count the inner nodes' saddles (front and back each count)."""
    total = 0
    for node in (node for tiling in cells.tilings for node in tiling.nodes):
        each = int(node.saddle_front) + int(node.saddle_back)
        total += each * count_together(cells.window.lattice, [step for step, _ in node.cells]) if each else 0
    return total
