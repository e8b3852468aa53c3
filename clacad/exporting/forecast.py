"""Forecast of the cost of an export before any work.

Facets and the bytes of STL and TIFF are exact, other bytes are within 20 %, seconds and memory are ranges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from clacad.base.machine_rates import Rates
from clacad.base.units import millimetres
from clacad.exporting import costs
from clacad.exporting.format_names import (
    MARKED_MESHES,
    PRESCRIPTIONS,
    SOLIDS,
    WELDED_FORMATS,
)
from clacad.exporting.limits import (
    QUADS,
)
from clacad.exporting.price import Forecast
from clacad.exporting.request import DEFAULTS, Request
from clacad.exporting.rough_sizes import RoughSheet
from clacad.formats.step.step_mode import chosen_mode

if TYPE_CHECKING:
    from clacad.exporting.tessellations import Meshes
    from clacad.formats.step.step_mode import Mode
    from clacad.sheet.window import Window

DRAWING = 400_000
"""Approximate bytes of DXF and PDF together; views are drawn with a fixed number of points."""

LETTER_POINTS = 30
"""Approximate number of points of the outline of a letter."""


def forecast(
    meshes: Meshes,
    formats: Sequence[str],
    quads: int | Mapping[str, int],
    asked: Request = DEFAULTS,
) -> list[Forecast]:
    """Forecast each format.

    Parameters
    ----------
    meshes : Meshes
    formats : sequence of str
    quads : int or mapping
        Facet grid per cell side for the mesh formats: one for all, or one per format.
    `asked` : Request
        Options of STEP and GDSII.
    """
    grids = dict.fromkeys(formats, quads) if isinstance(quads, int) else quads
    return timed([
        _forecast_one(meshes, name, grids.get(name, QUADS[-1]), asked) for name in formats
    ])  # fmt: skip


def timed(rows: Sequence[Forecast]) -> list[Forecast]:
    """Rows with their seconds on this machine, from its recorded times."""
    rates = Rates.here()
    spans = [rates.span(row.task, row.modelled) for row in rows]
    return [replace(row, seconds=(span.low, span.high)) for row, span in zip(rows, spans, strict=True)]


def _forecast_one(meshes: Meshes, name: str, quads: int, asked: Request = DEFAULTS) -> Forecast:
    window = meshes.window
    if name in MARKED_MESHES:
        return _forecast_marked(meshes, name, quads)
    if name in ("stl", "stl-parts"):
        files = 1 if name == "stl" else len(window.bodies)
        row = forecast_stl(name, meshes.facets(quads), files, quads, exact=window.uniform)
        return _of_own_cells(window, row, quads)
    if name in WELDED_FORMATS:
        return _of_own_cells(window, _forecast_welded(meshes, name, quads, asked.gpu_instancing), quads)
    if name == "step":
        return _forecast_step(window, asked.step, asked.pcurves)
    if name == "drawing":
        return Forecast(name, DRAWING, False, None, None, costs.drawing_seconds(), (150_000_000, 500_000_000))
    if name in PRESCRIPTIONS:
        return _forecast_prescription(window, name)
    if name in SOLIDS:
        return _forecast_fixture(window, name)
    return _forecast_map(window, name, asked.grey_levels)


def _forecast_fixture(window: Window, name: str) -> Forecast:
    """Price of baffle, frame, pins, coupon and BREP: the first exactly, the modelled ones by size classes."""
    cells = window.lattice.cell_count
    if name == "baffle":
        honeycombs = max(1, len(window.bodies) - 1)
        facets = 6 * len(window.lattice.steps) * cells * honeycombs
        row = Forecast(name, 84 * honeycombs + 50 * facets, False, facets, None, costs.stl_seconds(facets),
                       (80_000_000, 400_000_000))  # fmt: skip
        return row
    size = {"frame": 400_000, "pins": 40_000, "coupon": 2_000_000}.get(
        name, 15_000 + 8_000 * cells * len(window.bodies)
    )
    return Forecast(name, size, False, None, None, costs.solid_seconds(size), (500_000_000, 2_500_000_000))


def _forecast_prescription(window: Window, name: str) -> Forecast:
    """Price of one telescopelet for a lens-design program: small for any sheet."""
    from clacad.exporting.file_sizes import prescription_bytes

    memory = (400_000_000, 2_000_000_000) if name == "optiland" else (80_000_000, 200_000_000)
    size = prescription_bytes(window, name)
    return Forecast(name, size, name == "zmx", None, None, costs.prescription_seconds(name), memory)


def _forecast_marked(meshes: Meshes, name: str, quads: int) -> Forecast:
    """Price of a mesh format with letters: that of the format, four facets per outline point, and OCC's
    start.
    """
    from clacad.solid.marks import mark_text

    window = meshes.window
    texts = [mark_text(f"{window.name} {body.name}").replace(" ", "") for body in window.bodies]
    letters = 4 * LETTER_POINTS * sum(1 + len(text) for text in texts)
    if name == "marked-stl":
        plain = forecast_stl(name, meshes.facets(quads), len(window.bodies), quads, exact=False)
    else:
        plain = replace(_forecast_welded(meshes, "3mf", quads), format=name)
    facets = plain.facets or 1
    share = (facets + letters) / facets
    seconds = plain.modelled * share + costs.solid_seconds(0)
    return replace(
        plain, bytes=int(plain.bytes * share), facets=facets + letters, modelled=seconds, stored=None
    )


def forecast_stl(name: str, facets: int, files: int, quads: int, exact: bool) -> Forecast:
    """Forecast binary STL files: 84 bytes a file and 50 a facet."""
    size = 84 * files + 50 * facets
    return Forecast(name, size, exact, facets, quads, costs.stl_seconds(facets), (80_000_000, 400_000_000))


def _forecast_welded(meshes: Meshes, name: str, quads: int, in_one_node: bool = False) -> Forecast:
    """Price of a mesh of shared vertices: PLY, GLB (in_one_node: its cells are one node a body) or 3MF."""
    from clacad.exporting.file_sizes import (
        GLB_PLACE_IN_ARRAY,
        glb_place_bytes,
        threemf_bytes,
        threemf_place_bytes,
    )
    from clacad.formats.mesh.ply import ply_bytes

    window = meshes.window
    held = meshes.welded(quads, name)
    instanced = meshes.repeats(name)
    places = window.lattice.cell_count * len(window.bodies) if instanced else 0
    listed = RoughSheet.of_window(window).listed if instanced and name == "3mf" else places
    facets = held * window.lattice.cell_count if instanced else held
    # Half a vertex per facet, and more where walls and rims split vertices by their normals.
    vertices = held * (0.5 + 1.9 / max(quads, 2))
    nodes = 0
    if name == "ply":
        size = ply_bytes(int(vertices), held, header=300)
    elif name == "glb":
        each = GLB_PLACE_IN_ARRAY if in_one_node else glb_place_bytes(window)
        nodes, listed = int(each * places), len(window.bodies) if places and in_one_node else places
        size = int(24 * vertices + 12 * held + nodes + 2500)
    else:
        nodes = threemf_place_bytes(window) if places else 0
        size = threemf_bytes(meshes, quads) + nodes
    return replace(welded_row(name, size, held, facets, listed, quads), places=nodes)


def welded_row(name: str, size: int, held: int, facets: int, places: int, quads: int) -> Forecast:
    """Forecast a mesh of shared vertices from its bytes, the facets that it stores and the places of repeated cells."""
    memory = int(700 * held + 400 * places)
    seconds = costs.welded_seconds(name, held, places)
    return Forecast(
        name, size, False, facets, quads, seconds, (memory // 2 + 100_000_000, 2 * memory + 200_000_000), stored=held,
    )  # fmt: skip


def _forecast_step(window: Window, step: Mode, pcurves: bool = True) -> Forecast:
    from clacad.exporting.file_sizes import step_bytes

    mode = chosen_mode(window, step)
    return step_row(window, mode, step_bytes(window, mode, pcurves))


def own_cells_note(window: Window) -> str:
    """Note on the extra cost of a file of a non-uniform sheet; "" for a uniform sheet."""
    if window.uniform:
        return ""
    return f"every cell differs: {window.lattice.cell_count:,} are written out, none can be repeated"


def pov_note(window: Window) -> str:
    """Note on the extra cost of a POV-Ray scene of a non-uniform sheet; "" for a uniform sheet."""
    if window.uniform:
        return ""
    cells = window.lattice.cell_count
    arrays = {face.array for face in window.faces if face.array is not None}
    moved = {face.array: face.change for face in window.faces if face.change is not None}
    tables = any(change.table is not None for change in moved.values())
    held = f"the places of {cells:,} lenses are a table" if tables else "a formula moves its lens, no larger"
    plain, whole = (costs.pov_reading_seconds(cells * len(arrays), cells * n) for n in (0, len(moved)))
    return (
        f"every cell differs: {held}; POV-Ray reads it in {whole:.2g} s, equal cells in {plain:.2g} s, and "
        "traces both as fast"
    )


def _of_own_cells(window: Window, row: Forecast, quads: int) -> Forecast:
    """Row of a mesh format with the extra cost of a non-uniform sheet."""
    if window.uniform:
        return row
    bodies = sum(any(f.change is not None for f in (body.front, body.back)) for body in window.bodies)
    more = costs.own_mesh_seconds(window.lattice.cell_count * bodies, quads)
    return replace(row, modelled=row.modelled + more, note=own_cells_note(window))


def step_row(window: Window, mode: Literal["fused", "instanced"], size: int) -> Forecast:
    """Forecast a STEP file from its mode and its bytes."""
    columns = window.lattice.cell_count * len(window.bodies)
    if mode == "fused":
        each = 250_000 if window.uniform else 50_000  # non-uniform: cells are described one by one
        memory = (400_000_000, 900_000_000 + each * columns)
    else:
        written_out = columns if window.lattice.outline is not None else 0  # else rows stay rows
        memory = (250_000_000, 700_000_000 + 100 * size + 1000 * written_out)
    seconds = costs.step_seconds(size, mode) + (0.0 if window.uniform else costs.OWN_CELL * columns)
    return Forecast("step", size, False, None, None, seconds, memory, note=own_cells_note(window))


def _forecast_map(window: Window, name: str, levels: int) -> Forecast:
    """Price of maps, points, tables, masks and scenes; `levels` of GDSII."""
    from clacad.exporting import file_sizes
    from clacad.formats.maps.sag import samples_per_cell, structured_faces

    faces, cells = len(structured_faces(window)), window.lattice.cell_count
    per_cell = samples_per_cell(window, None) if name != "xyz" else min(16, samples_per_cell(window, None))
    pixels = per_cell * per_cell * cells * faces
    if name == "png":
        size = file_sizes.png_bytes(window, per_cell)
    elif name == "table":
        size = file_sizes.table_bytes(window)
    elif name == "mask":
        size = file_sizes.mask_bytes(window)
    elif name == "gds":
        from clacad.formats.maps.gds import gds_bytes

        size = gds_bytes(window, levels, millimetres(window.unit))
    elif name == "pov":
        size = file_sizes.pov_bytes(window)
    elif name == "xyz":
        size = file_sizes.xyz_bytes(window, per_cell)
    else:  # six bytes a pixel of two TIFFs, one cell of 65 x 65 lines of 70
        size = {"tiff": 6 * pixels, "sag": faces * 70 * 65 * 65}[name]
    drawn = {"tiff": pixels, "png": pixels, "xyz": pixels, "pov": 1, "gds": faces * 64 * 64}.get(
        name, 100 * cells * faces
    )
    seconds, memory, note = costs.map_seconds(name, drawn, faces), 400_000_000, ""
    if name == "pov":
        note = pov_note(window)
    elif name == "gds" and not window.uniform:  # written as a stream, read back as a whole
        seconds, memory = seconds + costs.OWN_GDS * size, memory + int(3.5 * size)
        note = own_cells_note(window)
    return Forecast(name, size, False, None, None, seconds, (100_000_000, memory), note=note)
