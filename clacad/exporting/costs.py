"""What each format costs in processor seconds, as formulas of its size.

The constants hold for one reference machine, an x86-64 server core; `clacad.base.machine_rates` scales them
to other machines. A file of text or triangles costs a constant per item; welding costs a sort.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import log2

BASE = 0.02
"""Seconds to open, hash and read back a very small file."""

PREPARE = "export prepare"
"""Name under which the time of an export before its first file is recorded."""


def prepare_seconds(quads: Sequence[int]) -> float:
    """Seconds of an export outside the files themselves.

    Prescription, forecast, meshing and tracing one cell at every grid, and publishing.
    """
    return 0.11 + 0.9e-4 * sum(grid * grid for grid in quads) + (1.6 if quads else 0.0)


def stl_seconds(facets: int) -> float:
    """Seconds to stream triangles to a file and back."""
    return BASE + 3.5e-7 * facets


def welded_seconds(name: str, held: int, places: int) -> float:
    """Seconds for shared vertices, exact normals and the places of repeated cells."""
    if name == "ply":
        return BASE + 4.2e-7 * held * log2(max(2, held))
    each, place = {"glb": (4.0e-6, 1.3e-5), "3mf": (4.5e-6, 6.0e-6)}[name]
    if places == 0:  # the whole sheet is welded: sorting decides
        return BASE + 6.0e-7 * held * log2(max(2, held))
    return BASE + 0.01 + each * held + place * places


OWN_CELL = 0.012
"""Seconds per cell with a lens of its own: its patch, borders and nodes are computed separately."""


def own_mesh_seconds(cells: int, quads: int) -> float:
    """Seconds that a non-uniform sheet adds to a mesh: each cell is cut and joined to its neighbours
    separately.
    """
    return cells * (1.5e-3 + 2.5e-4 * quads + 2e-6 * quads * quads)


def step_seconds(size: int, mode: str) -> float:
    """Seconds to write STEP text and read it with OCC in a separate process."""
    return 0.68 + 1.12e-6 * size if mode == "fused" else 0.6 + 1.4e-6 * size


def solid_seconds(size: int) -> float:
    """Seconds for solids made by OCC: frame, coupon, BREP."""
    return 1.5 + 2.0e-6 * size


OWN_GDS = 9.6e-8
"""Seconds per byte of GDSII for a non-uniform sheet: boxes of every cell, written, read back and compared."""


def pov_reading_seconds(cells: int, own: int) -> float:
    """Seconds for POV-Ray to read the lenses of a scene, all arrays together; `own` lenses are defined per
    cell.
    """
    return 7.6e-6 * cells + 2.4e-5 * own


PER_DRAWN = {"tiff": 4.4e-7, "png": 2.2e-7, "xyz": 1.3e-6, "table": 4e-8, "mask": 8.5e-8}
"""Seconds per pixel or point; for tables and masks, per hundredth of a lenslet."""


def prescription_seconds(name: str) -> float:
    """Seconds to write one telescopelet as text and trace it; optiland is slow to load and to compile."""
    return BASE + (6.0 if name == "optiland" else 0.03)


def drawing_seconds() -> float:
    """Seconds for the views, dimensions and tables of any sheet as DXF and PDF, library loading included."""
    return BASE + 2.5


def map_seconds(name: str, drawn: int, faces: int) -> float:
    """Seconds for height maps, points, tables and masks; the sag grid of one cell does not depend on the
    count.
    """
    return BASE + (0.015 * faces if name in ("sag", "pov") else PER_DRAWN.get(name, 4e-7) * drawn)
