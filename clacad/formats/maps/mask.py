"""Aperture masks: where light must pass a face, as SVG and DXF. The area outside is land and may be painted.

One outline of the optical zone is repeated on the cells: a `<use>` in SVG, a block reference in DXF, so a
sheet of any size stays small.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clacad.base.polygons import distance_to_rim
from clacad.base.types import Floats
from clacad.formats.maps.sag import structured_faces
from clacad.sheet.edge_columns import RADIUS, SENSE, X0, X1, Y0, Y1
from clacad.sheet.face_order import array_at, lined_face
from clacad.sheet.lattice import Circle
from clacad.sheet.need_window import need_equal_cells
from clacad.sheet.plate import Plate
from clacad.sheet.plate_edges import bulges
from clacad.sheet.volume_and_extent import whole_extent
from clacad.sheet.window import Body, Face, Window, column, face_height, lens_height, optical_tile
from clacad.storage.archive import Attributes, parse_xml
from clacad.storage.errors import FileDisagrees, UnreadableFile
from clacad.storage.reading import Spending

DIRECTIONS = 720


def masked_faces(window: Window) -> list[tuple[Body, Face, str]]:
    """Faces with a mask each: the one that carries an opaque line, or all with lenses."""
    number = window.land.lined
    if number < 0:
        return structured_faces(window)
    body = window.bodies[number // 2]
    side, face = (("front", body.front), ("back", body.back))[number % 2]
    return [(body, face, f"{body.name}-{side}")]


def aperture(window: Window, body: Body, face: Face) -> Floats:
    """Outline of the lens of one cell, cell frame, counter-clockwise, (n, 2), design units.

    The optical zone's polygon where the lens fills it, else the rim traced in 720 directions from the highest
    point of the lens. Empty where no lens protrudes beyond its land.

    Raises CellsDiffer: The sheet is non-uniform, and there are rims: each would have an outline of its own.
    """
    if lined_face(window) is face:  # the line is the land of this face
        like = replace(window, land=replace(window.land, seam=window.land.line))
        return optical_tile(like, array_at(window, face))
    zone = optical_tile(window, array_at(window, face))
    if body.front.change is not None or body.back.change is not None:
        _refuse_rims(window, body, face, zone)
        return zone
    edge = np.concatenate(
        [
            zone[k] + np.linspace(0, 1, 64, endpoint=False)[:, None] * (zone[(k + 1) % len(zone)] - zone[k])
            for k in range(len(zone))
        ]
    )
    if _proud(window, body, face, edge * (1 - 1e-9)).all():
        return zone
    start = _inside_point(window, body, face, zone)
    if start is None:
        return np.empty((0, 2))
    angle = np.linspace(0.0, 2 * np.pi, DIRECTIONS, endpoint=False)
    ray = np.column_stack([np.cos(angle), np.sin(angle)])
    rim = distance_to_rim(zone, start, ray)
    low, high = np.zeros(len(ray)), rim
    whole = _proud(window, body, face, start + rim[:, None] * ray * (1 - 1e-9))
    for _ in range(50):
        middle = 0.5 * (low + high)
        proud = _proud(window, body, face, start + middle[:, None] * ray)
        low, high = np.where(proud, middle, low), np.where(proud, high, middle)
    reach = np.where(whole, rim, low)
    return np.asarray(start + reach[:, None] * ray)


def _refuse_rims(window: Window, body: Body, face: Face, zone: Floats) -> None:
    """Reject a non-uniform sheet where a cell does not fill its optical zone at corners, sides or middle."""
    at = (1.0 - 1e-9) * np.concatenate([zone, 0.5 * (zone + np.roll(zone, 1, axis=0)), [[0.0, 0.0]]])
    cells = window.lattice.cells()
    index = np.repeat(cells, len(at), axis=0)
    x, y = np.tile(at, (len(cells), 1)).T
    mine = face_height(window, face, x, y, index)
    with np.errstate(invalid="ignore"):
        fills = np.isfinite(mine)
        if face.land is not None:
            fills &= face.land_side * (face.land - mine) > 0.0
        if body.columnar:
            front, back = column(window, body, x, y, index)
            fills &= (back > front) & (mine == (front if face is body.front else back))
    if not fills.all():
        need_equal_cells(
            window,
            "a mask of lenses that end at rims",
            "height maps (tiff, png) hold rims that differ from cell to cell",
        )


def _proud(window: Window, body: Body, face: Face, points: Floats) -> NDArray[np.bool_]:
    """Whether the lens, not land or a hole, is the face over cell-frame points."""
    x, y = points.T
    lens = lens_height(face, x, y)
    with np.errstate(invalid="ignore"):
        proud = np.isfinite(lens)
        if face.land is not None:
            proud &= face.land_side * (face.land - lens) > 0.0
        if body.columnar:
            front, back = column(window, body, x, y)
            mine = front if face is body.front else back
            proud &= (back > front) & (np.abs(mine - lens) <= 1e-12 * window.lattice.pitch[0])
    return np.asarray(proud)


def _inside_point(window: Window, body: Body, face: Face, zone: Floats) -> Floats | None:
    """Point of the zone that lies deepest inside the lens: apex, or nearest grid point on the lens."""
    u = np.linspace(zone[:, 0].min(), zone[:, 0].max(), 65)
    v = np.linspace(zone[:, 1].min(), zone[:, 1].max(), 65)
    x, y = np.meshgrid(u, v)
    points = np.column_stack([x.ravel(), y.ravel()])
    points = points[distance_to_rim(zone, np.zeros(2), _unit(points)) > np.linalg.norm(points, axis=1)]
    proud = points[_proud(window, body, face, points)]
    if not len(proud):
        return None
    return np.asarray(proud[np.argmin(np.linalg.norm(proud - np.asarray(face.vertex[:2]), axis=1))])


def _unit(v: Floats) -> Floats:
    length = np.linalg.norm(v, axis=1, keepdims=True)
    return np.asarray(np.where(length > 0.0, v / np.where(length > 0.0, length, 1.0), np.array([1.0, 0.0])))


# -- SVG and DXF -----------------------------------------------------------------------------------


def write_svg(window: Window, body: Body, face: Face, label: str, path: Path, scale: float) -> None:
    """Write the mask of a face as SVG in millimetres: black is land, white is lens.

    The picture shows the sheet as seen by light (from −z, +x to the left) if the face is a front face, and as
    seen from +z otherwise; the title states which.
    """
    x0, x1, y0, y1 = (v * scale for v in whole_extent(window))
    mirror = face.side > 0
    view = (
        "seen from -z (the side light comes from), +x to the left"
        if mirror
        else "seen from +z, +x to the right"
    )
    with path.open("w", encoding="utf-8", newline="\n") as stream:
        stream.write(
            '<?xml version="1.0" encoding="UTF-8"?>\n<svg xmlns="http://www.w3.org/2000/svg"'
            f' xmlns:xlink="http://www.w3.org/1999/xlink" width="{x1 - x0!r}mm" height="{y1 - y0!r}mm"'
            f' viewBox="{(-x1 if mirror else x0)!r} {-y1!r} {x1 - x0!r} {y1 - y0!r}">\n<title>clacad aperture'
            f' mask {label}, {view}</title>\n<defs><polygon id="lens"'
            f' points="{_points(aperture(window, body, face) * scale)}"/></defs>\n<g'
            f' transform="scale({-1 if mirror else 1} -1)">\n'
        )
        stream.write(_ground(window, x0, x1, y0, y1, scale) + '<g id="lenses" fill="#ffffff">\n')
        for x, y in _centres(window, face, scale):
            stream.write(f'<use xlink:href="#lens" x="{x!r}" y="{y!r}"/>\n')
        stream.write("</g>\n</g>\n</svg>\n")


def _points(polygon: Floats) -> str:
    return " ".join(f"{x!r},{y!r}" for x, y in (polygon + 0.0).tolist())


def _ground(window: Window, x0: float, x1: float, y0: float, y1: float, scale: float) -> str:
    if isinstance(window.outline, Plate):
        return (
            f'<path d="{" ".join(_svg_loop(loop, scale) for loop in window.outline.loops)}"'
            ' fill="#000000"/>\n'
        )
    if isinstance(window.outline, Circle):
        cx, cy = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
        return (
            f'<circle cx="{cx!r}" cy="{cy!r}" r="{0.5 * window.outline.diameter * scale!r}"'
            ' fill="#000000"/>\n'
        )
    return f'<rect x="{x0!r}" y="{y0!r}" width="{x1 - x0!r}" height="{y1 - y0!r}" fill="#000000"/>\n'


def _svg_loop(loop: Floats, scale: float) -> str:
    """One loop of a plate as an SVG path; holes run the other way and stay free."""
    words = [f"M {loop[0, X0] * scale!r} {loop[0, Y0] * scale!r}"]
    for edge in loop.tolist():
        end = f"{edge[X1] * scale!r} {edge[Y1] * scale!r}"
        radius = edge[RADIUS] * scale
        sweep = int(
            edge[SENSE] > 0.0
        )  # y runs upwards within the turned group: counter-clockwise is the positive angle
        words.append(f"L {end}" if edge[SENSE] == 0.0 else f"A {radius!r} {radius!r} 0 0 {sweep} {end}")
    return " ".join([*words, "Z"])


def _dxf_loop(loop: Floats, scale: float) -> list[tuple[int, str]]:
    """One loop of a plate as a closed polyline with bulges on layer OUTLINE."""
    lines = [(0, "POLYLINE"), (8, "OUTLINE"), (66, "1"), (70, "1")]
    for edge, bulge in zip(loop.tolist(), bulges(loop).tolist(), strict=True):
        lines += [
            (0, "VERTEX"),
            (8, "OUTLINE"),
            (10, repr(edge[X0] * scale)),
            (20, repr(edge[Y0] * scale)),
            (42, repr(bulge)),
        ]
    return [*lines, (0, "SEQEND")]


def _centres(window: Window, face: Face, scale: float) -> Iterator[tuple[float, float]]:
    for j in range(window.lattice.count[1]):
        row = window.lattice.row(j)
        for place in (window.centres(array_at(window, face), row) * scale + 0.0).tolist():
            yield place[0], place[1]


def write_dxf(window: Window, body: Body, face: Face, label: str, path: Path, scale: float) -> None:
    """Write the mask of a face as DXF (R12) in millimetres, sheet coordinates: block LENS on layer APERTURE,
    the sheet's outline on layer OUTLINE.
    """
    x0, x1, y0, y1 = (v * scale for v in whole_extent(window))
    lens = aperture(window, body, face) * scale
    lines = [
        (999, f"clacad aperture mask {label}, unit mm"),
        (0, "SECTION"),
        (2, "BLOCKS"),
        (0, "BLOCK"),
        (8, "0"),
        (2, "LENS"),
        (70, "0"),
        (10, "0"),
        (20, "0"),
        *_polyline(lens, "APERTURE"),
        (0, "ENDBLK"),
        (0, "ENDSEC"),
        (0, "SECTION"),
        (2, "ENTITIES"),
    ]
    if isinstance(window.outline, Plate):
        for loop in window.outline.loops:
            lines += _dxf_loop(loop, scale)
    elif isinstance(window.outline, Circle):
        lines += [
            (0, "CIRCLE"),
            (8, "OUTLINE"),
            (10, repr(0.5 * (x0 + x1))),
            (20, repr(0.5 * (y0 + y1))),
            (40, repr(0.5 * window.outline.diameter * scale)),
        ]
    else:
        lines += _polyline(np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]), "OUTLINE")
    with path.open("w", encoding="ascii", newline="\n") as stream:
        stream.write(_text(lines))
        for x, y in _centres(window, face, scale):
            stream.write(_text([(0, "INSERT"), (8, "APERTURE"), (2, "LENS"), (10, repr(x)), (20, repr(y))]))
        stream.write(_text([(0, "ENDSEC"), (0, "EOF")]))


def _polyline(points: Floats, layer: str) -> list[tuple[int, str]]:
    lines = [(0, "POLYLINE"), (8, layer), (66, "1"), (70, "1")]
    for x, y in (points + 0.0).tolist():
        lines += [(0, "VERTEX"), (8, layer), (10, repr(x)), (20, repr(y))]
    return [*lines, (0, "SEQEND")]


def _text(lines: list[tuple[int, str]]) -> str:
    return "".join(f"{code}\n{value}\n" for code, value in lines)


def check_mask(window: Window, face: Face, svg: Path, dxf: Path, scale: float) -> None:
    """Read both files back: count and centres of the lenses, and the same outline in both.

    Raises FileDisagrees, UnreadableFile.
    """
    want = np.array(sorted(_centres(window, face, scale))).reshape(-1, 2)
    outlines = []
    for path, reader in ((svg, _read_svg), (dxf, _read_dxf)):
        outline, centres = reader(path)
        got = np.array(sorted(centres)).reshape(-1, 2)
        if got.shape != want.shape or not np.array_equal(got, want):
            raise FileDisagrees(
                f"{path.name}: {len(got)} lenses were read back, not the {len(want)} of the design in place"
            )
        outlines.append(np.array(outline).reshape(-1, 2))
    if not np.array_equal(outlines[0], outlines[1]):
        raise FileDisagrees(f"{svg.name}: its lens outline is not that of {dxf.name}")
    zone = np.abs(optical_tile(window, array_at(window, face))).max(axis=0) * scale
    if len(outlines[0]) and (np.abs(outlines[0]).max(axis=0) > zone * (1 + 1e-9)).any():
        raise FileDisagrees(f"{svg.name}: the lens outline leaves its cell")


def mask_misfit(window: Window, body: Body, face: Face, path: Path, scale: float) -> tuple[float, int]:
    """Largest deviation of outline and positions of an SVG or DXF mask from the face's, millimetres; the
    number of lenses.

    Infinite where there are other lenses, or an outline of other corners.

    Raises UnreadableFile.
    """
    outline, centres = (_read_svg if path.suffix.lower() == ".svg" else _read_dxf)(path)
    want = np.array(sorted(_centres(window, face, scale))).reshape(-1, 2)
    lens = aperture(window, body, face) * scale
    pairs = ((np.array(sorted(centres)).reshape(-1, 2), want), (np.array(outline).reshape(-1, 2), lens))
    if any(got.shape != asked.shape for got, asked in pairs):
        return np.inf, len(centres)
    apart = np.concatenate([np.abs(got - asked).ravel() for got, asked in pairs])
    return (float(apart.max(initial=0.0)) if np.isfinite(apart).all() else np.inf), len(centres)


Read = tuple[list[tuple[float, float]], list[tuple[float, float]]]


def _read_svg(path: Path) -> Read:
    """Outline and centres of an SVG mask, in the units of the file."""
    spent = Spending("mask", path)
    outline: list[tuple[float, float]] = []
    centres: list[tuple[float, float]] = []

    def start(tag: str, attributes: Attributes) -> None:
        if tag == "polygon":
            points = attributes["points"].split()
            spent.count(len(points))
            outline.extend((float(p.split(",")[0]), float(p.split(",")[1])) for p in points)
        elif tag == "use":
            spent.count(1)
            centres.append((float(attributes["x"]), float(attributes["y"])))

    with path.open("rb") as stream:
        try:
            parse_xml(stream, spent, start, lambda _: None)
        except (KeyError, IndexError, ValueError) as error:
            if isinstance(error, UnreadableFile):
                raise
            raise UnreadableFile(f"{path.name}: damaged ({error})") from error
    return outline, centres


def _read_dxf(path: Path) -> Read:
    """Outline and centres of a DXF mask, in the units of the file."""
    spent = Spending("mask", path)
    outline: list[tuple[float, float]] = []
    centres: list[tuple[float, float]] = []
    kind, x, in_block, code, value = "", 0.0, False, "", ""
    with path.open("rb") as stream:
        words = (line.rstrip(b"\r\n").decode("ascii", "replace") for line in spent.lines(stream))
        for code, value in zip(words, words):
            if not re.fullmatch(r"\d+", code):
                raise UnreadableFile(f"{path.name}: {code[:20]!r} is not a DXF group code")
            if code == "0":
                in_block = value == "BLOCK" or (in_block and value != "ENDBLK")
                kind = value
            elif code == "10":
                x = float(value)
            elif code == "20" and kind in ("VERTEX", "INSERT"):
                spent.count(1)
                if kind == "INSERT":
                    centres.append((x, float(value)))
                elif in_block:
                    outline.append((x, float(value)))
    if (code, value) != ("0", "EOF"):
        raise UnreadableFile(f"{path.name}: cut short")
    return outline, centres
