"""Estimated bytes of a file before it is written: a small part of its text is generated and scaled."""

from __future__ import annotations

import io
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from math import ceil, log10
from typing import TYPE_CHECKING, Literal

import numpy as np

from clacad.base.units import millimetres
from clacad.exporting.tessellations import Meshes, instanceable, weld
from clacad.formats.mesh.repeated_pieces import FLAT_LIMIT, Places
from clacad.sheet.lattice import Circle, Rectangle
from clacad.sheet.like_cell import like_cell
from clacad.sheet.plate import Plate
from clacad.sheet.representative_cells import representative_cells
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.base.types import Floats

SAMPLE = 6_000
"""Number of facets or places whose text is generated; the rest is assumed to be similar."""


OWN_CELLS = 1.15
"""Text length of a non-uniform sheet over that of a uniform one: its cells share no parameter curves."""


# -- 3MF -------------------------------------------------------------------------------------------


def threemf_bytes(meshes: Meshes, quads: int) -> int:
    """Size of the 3MF file without places: the text of the first facets of each body, deflated."""
    from clacad.formats.mesh import threemf

    repeated = meshes.repeats("3mf")
    mesh = meshes.at(quads).cell if repeated else meshes.at(quads).mesh
    total = 950.0
    packed = zlib.compressobj(6)
    for body, part in zip(meshes.window.bodies, mesh.bodies, strict=True):
        corners = _first_facets(part.rows())
        if not len(corners):
            continue
        piece = replace(weld(body, corners, np.zeros_like(corners)), normals=None)
        text = "".join(threemf.mesh_lines(piece, 1, millimetres(meshes.window.unit))).encode()
        # one stream for all bodies, as in the file: a second body similar to the first compresses well
        size = len(packed.compress(text)) + len(packed.flush(zlib.Z_SYNC_FLUSH))
        total += size * part.facets_about / len(corners)
    return int(total)


def threemf_place_bytes(window: Window) -> int:
    """Bytes of a 3MF file for the positions of the repeated cells of each body."""
    arrays = (next(f.array for f in (b.front, b.back) if f.array is not None) for b in window.bodies)
    return int(
        sum(
            _places_bytes(Places(window.lattice, window.shifts[array]), millimetres(window.unit))
            for array in arrays
        )
    )


def _first_facets(rows: Iterator[Floats]) -> Floats:
    kept, count = [], 0
    for block in rows:
        kept.append(block[: SAMPLE - count])
        count += len(kept[-1])
        if count >= SAMPLE:
            break
    return np.concatenate(kept) if kept else np.empty((0, 3, 3))


def _places_bytes(places: Places, scale: float) -> float:
    from clacad.formats.mesh import threemf

    if places.count > FLAT_LIMIT:
        offsets, standing = places.rows()
        lines = sum(len(row) for row in offsets) + len(standing)
        return 12.0 * lines
    sample = places.lattice.cells()[:SAMPLE] if places.count <= SAMPLE else places.lattice.row(0)
    centres = (places.lattice.centres(sample) + np.asarray(places.shift)) * scale
    text = (threemf.component_text(2, x, y) for x, y in centres.tolist())
    return _deflated(text) * places.count / max(1, len(sample))


def _deflated(lines: Iterable[str]) -> int:
    return len(zlib.compress("".join(lines).encode(), 6))


GLB_PLACE_IN_ARRAY = 12
"""Bytes of a place in a GLB file whose cells are one node: three numbers of single precision."""


def glb_place_bytes(window: Window) -> float:
    """Bytes of one node of a GLB file, from the cells of one row."""
    row = window.lattice.row(window.lattice.count[1] // 2)
    centres = (window.lattice.centres(row) * millimetres(window.unit)).tolist()
    nodes = [f'{{"mesh":0,"translation":[{x!r},{y!r},0.0]}},{window.lattice.cell_count},' for x, y in centres]
    return sum(map(len, nodes)) / max(1, len(nodes))


# -- pictures, tables, masks -----------------------------------------------------------------------


def png_bytes(window: Window, per_cell: int) -> int:
    """Size of the PNG files: one row of cells of each map, deflated."""
    from clacad.formats.maps.sag import height_map, map_levels, structured_faces

    total = 0.0
    for body, face, label in structured_faces(window):
        map_ = height_map(window, body, face, label, per_cell)
        rows = min(map_.height, 8 * per_cell)  # rows of cells repeat: what deflate learns in a few, it knows
        # in a non-uniform sheet nothing repeats, and the first rows are representative
        strip = replace(map_, height=rows)
        packer = zlib.compressobj(6)
        size = sum(
            len(packer.compress(map_levels(strip, block).astype(">u2").tobytes())) for block in strip.blocks()
        )
        total += (size + len(packer.flush())) * map_.height / rows + 200
    return int(total) + 600 * len(structured_faces(window))


def table_bytes(window: Window) -> int:
    """Size of the two files of the surface table: the JSON generated in full, the CSV from its first row of
    cells.
    """
    from clacad.formats.maps.pose_table import pose_lines, surface_table
    from clacad.storage.atomic import canonical_json

    total = float(len(canonical_json(surface_table(window, millimetres(window.unit)))))
    row = window.lattice.row(window.lattice.count[1] // 2)
    text = io.StringIO()
    lines = 0
    for line in pose_lines(window, millimetres(window.unit), [row]):
        text.write(",".join(str(word) for word in line) + "\n")
        lines += 1
    faces = max(1, lines // max(1, len(row)))
    return int(total + len(text.getvalue()) / max(1, lines) * window.lattice.cell_count * faces)


def mask_bytes(window: Window) -> int:
    """Size of the SVG and DXF masks: outlines as they are, cells by their first row."""
    from clacad.formats.maps.mask import aperture
    from clacad.formats.maps.sag import structured_faces

    total = 0.0
    scale = millimetres(window.unit)
    for body, face, _ in structured_faces(window):
        assert face.array is not None
        outline = (aperture(window, body, face) * scale + 0.0).tolist()
        total += sum(len(f"{x!r}{y!r}") for x, y in outline) * 2 + 40 * len(outline) + 1400
        row = window.lattice.row(window.lattice.count[1] // 2)
        centres = (window.centres(face.array, row) * scale).tolist()
        digits = sum(len(f"{x!r}{y!r}") for x, y in centres) / max(1, len(centres))
        total += window.lattice.cell_count * (2 * digits + 34 + 36)
    return int(total)


def pov_bytes(window: Window) -> int:
    """Size of the POV-Ray scene, generated in full: its loops do not grow; 0 for a sheet it cannot hold."""
    from clacad.formats.pov.pov_scene import pov_lines
    from clacad.storage.errors import ExportError

    try:
        return sum(len(line.encode()) + 1 for line in pov_lines(window, None))
    except ExportError:  # reported at writing, so that the other formats are still made
        return 0


def prescription_bytes(window: Window, name: str) -> int:
    """Size of the prescription of one telescopelet, generated in full; 0 for one that optiland cannot hold."""
    import json

    from clacad.formats.sequential.optiland_json import optiland_document
    from clacad.formats.sequential.zmx import zmx_lines
    from clacad.storage.errors import ExportError

    if name == "zmx":
        return sum(len(line) + 2 for line in zmx_lines(window))
    try:
        return len(json.dumps(optiland_document(window), indent=1).encode()) + 1
    except ExportError:  # reported at writing, so that the other formats are still made
        return 0


def xyz_bytes(window: Window, per_cell: int) -> int:
    """Size of the point files: the text of one cell of each face, times the number of cells."""
    from clacad.formats.maps.sag import point_lines, structured_faces

    row = window.lattice.row(window.lattice.count[1] // 2)
    middle = row[len(row) // 2 : len(row) // 2 + 1]
    total = 0.0
    for _, face, _ in structured_faces(window):
        lines = point_lines(window, face, per_cell, middle, millimetres(window.unit))
        total += sum(len(line) + 1 for line in lines) * window.lattice.cell_count + 80
    return int(total)


# -- STEP ------------------------------------------------------------------------------------------


def step_bytes(window: Window, mode: Literal["fused", "instanced"], pcurves: bool = True) -> int:
    """Size of the STEP file, from the text of small sheets: it grows as A + B (n1 + n2) + C n1 n2."""
    from clacad.formats.step.step_files import step_text_length

    n1, n2 = window.lattice.count
    if max(n1, n2) <= 8:
        return step_text_length(window, mode, pcurves)
    if not window.uniform:  # the same number of cells like the outermost one, each written out
        like = like_cell(window, representative_cells(window, "displaced")[0])
        return int(OWN_CELLS * step_bytes(like, "fused", pcurves))
    if isinstance(window.outline, Plate):
        return _plate_step_bytes(window, window.outline, mode, pcurves)
    if window.lattice.outline is not None:  # a disc: its border is written piece by piece in either mode
        small, large = _smaller_sheet(window, 8), _smaller_sheet(window, 16)
        one, two = step_text_length(small, mode, pcurves), step_text_length(large, mode, pcurves)
        power = 1.0 if mode == "fused" else 0.5
        first, second, whole = (sheet.lattice.cell_count**power for sheet in (small, large, window))
        return int(two + (two - one) / (second - first) * (whole - second)) if second > first else two
    if mode == "instanced" and instanceable(window):
        a, b = (step_text_length(_smaller_sheet(window, n), mode, pcurves) for n in (2, 6))
        return int(a + (b - a) / 8 * (n1 + n2 - 4))
    a, b, c = (step_text_length(_smaller_sheet(window, n), mode, pcurves) for n in (1, 4, 8))
    # Through n = 1, 4, 8 on the diagonal: f = A + B n + C n^2. Longer numbers add some per cent a decade.
    square = ((c - b) / 4 - (b - a) / 3) / 7
    linear = (b - a) / 3 - 5 * square
    digits = 1.0 + 0.07 * max(0.0, log10(n1 * n2 / 64))
    return int((a - linear - square + 0.5 * linear * (n1 + n2) + square * n1 * n2) * digits)


EDGE_BYTES = 1900
"""Text of one side face of a plate, its edges and curves included, about."""


def _plate_step_bytes(
    window: Window, plate: Plate, mode: Literal["fused", "instanced"], pcurves: bool
) -> int:
    """Size of the STEP file of a plate: that of as many cells in a plain sheet, and that of its edges."""
    cells = window.lattice.cell_count
    side = max(1, round(cells**0.5))
    plain = window.with_cells((side, max(1, round(cells / side))))
    return step_bytes(plain, mode, pcurves) + EDGE_BYTES * len(plate.edges) * len(window.bodies)


def _smaller_sheet(window: Window, n: int) -> Window:
    """A sheet of about n × n of the same cells, with the same border."""
    lattice = window.lattice
    if isinstance(lattice.outline, Circle):
        share = min(1.0, n / max(lattice.count))
        disc = Circle(lattice.outline.diameter * share)
        count = (ceil(lattice.count[0] * share), ceil(lattice.count[1] * share))
        whole = window.outline.diameter if isinstance(window.outline, Circle) else lattice.outline.diameter
        # a border, and for a slab's displaced arrays the room that both take
        held = Circle(disc.diameter + whole - lattice.outline.diameter)
        return replace(window, lattice=replace(lattice, count=count, outline=disc), outline=held)
    small = window.with_cells((min(n, lattice.count[0]), min(n, lattice.count[1])))
    if not isinstance(window.outline, Rectangle):
        return small
    x0, x1, y0, y1 = lattice.extent()
    u0, u1, v0, v1 = small.lattice.extent()
    width, height = (
        window.outline.width - (x1 - x0) + (u1 - u0),
        window.outline.height - (y1 - y0) + (v1 - v0),
    )
    return replace(small, outline=Rectangle(width, height))
