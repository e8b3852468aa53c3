"""What each format costs in processor seconds, as formulas of its size.

The constants are those of one reference machine, an x86-64 server core; `clacad.base.machine_rates` knows what another machine
makes of them. Forms: a file of text or triangles costs a constant a piece, welding sorts.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import log2

BASE = 0.02
"""Opening, hashing and reading back a file of next to nothing."""

PREPARE = "export prepare"
"""Name under which is noted what an export takes before its first file."""


def prepare_seconds(quads: Sequence[int]) -> float:
    """Everything before the first file and after the last: prescribing, forecasting, meshing a cell at every grid and
    tracing it, publishing.
    """
    return 0.11 + 0.9e-4 * sum(grid * grid for grid in quads) + (1.6 if quads else 0.0)


def stl_seconds(facets: int) -> float:
    """Triangles streamed out and back."""
    return BASE + 3.5e-7 * facets


def welded_seconds(name: str, held: int, places: int) -> float:
    """Shared vertices, exact normals and, where cells repeat, their places."""
    if name == "ply":
        return BASE + 4.2e-7 * held * log2(max(2, held))
    each, place = {"glb": (4.0e-6, 1.3e-5), "3mf": (4.5e-6, 6.0e-6)}[name]
    if places == 0:  # the whole sheet is welded: sorting decides
        return BASE + 6.0e-7 * held * log2(max(2, held))
    return BASE + 0.01 + each * held + place * places


OWN_CELL = 0.012
"""Seconds a cell whose lens is like no other's: its patch, its borders and nodes are worked out by themselves."""


def own_mesh_seconds(cells: int, quads: int) -> float:
    """What cells that differ add to a mesh: each is cut, joined to its neighbours and forgotten by itself."""
    return cells * (1.5e-3 + 2.5e-4 * quads + 2e-6 * quads * quads)


def step_seconds(size: int, mode: str) -> float:
    """STEP: text, and OCC reading it in a process of its own."""
    return 0.68 + 1.12e-6 * size if mode == "fused" else 0.6 + 1.4e-6 * size


def solid_seconds(size: int) -> float:
    """Solids made by OCC: frame, coupon, BREP."""
    return 1.5 + 2.0e-6 * size


OWN_GDS = 9.6e-8
"""Seconds a byte of GDSII cells that differ: boxes of every one, written, read back and compared."""


def pov_reading_seconds(cells: int, own: int) -> float:
    """What POV-Ray takes to read the lenses of a scene, all arrays together, of which `own` are made anew in their cells."""
    return 7.6e-6 * cells + 2.4e-5 * own


PER_DRAWN = {"tiff": 4.4e-7, "png": 2.2e-7, "xyz": 1.3e-6, "table": 4e-8, "mask": 8.5e-8}
"""Seconds a pixel or point; of tables and masks, a hundredth of a lenslet."""


def prescription_seconds(name: str) -> float:
    """One telescopelet's faces as text, and light through them; optiland takes its time to load and to compile."""
    return BASE + (6.0 if name == "optiland" else 0.03)


def drawing_seconds() -> float:
    """Views, dimensions and tables of any sheet, as DXF and PDF, and the libraries that make them."""
    return BASE + 2.5


def map_seconds(name: str, drawn: int, faces: int) -> float:
    """Height maps, points, tables, masks; one cell of a face as a grid of sag costs the same however many there are."""
    return BASE + (0.015 * faces if name in ("sag", "pov") else PER_DRAWN.get(name, 4e-7) * drawn)
