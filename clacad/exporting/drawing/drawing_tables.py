"""Tables of a drawing: faces, sags, surfaces, errors and their effects, notes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.text import mrad_text, percent_text
from clacad.base.units import POWER, millimetres
from clacad.design.limit_sections import TolerancesSpec
from clacad.exporting.drawing.canvas import CHARACTER, Allowances, Canvas, orientation
from clacad.exporting.drawing.views import LENS_FINISH, OTHER_FINISH, mm_text
from clacad.formats.maps.pose_table import euler_degrees
from clacad.formats.maps.sag import structured_faces
from clacad.optics.surface import EvenPolynomial, conic_constants, principal_radii, sag
from clacad.sheet.cell_places import extreme_cells
from clacad.sheet.edge_columns import RADIUS, SENSE, X0, Y0
from clacad.sheet.face_order import plates_of
from clacad.sheet.lattice import Circle
from clacad.sheet.plate import Plate
from clacad.sheet.volume_and_extent import body_volume, grams
from clacad.sheet.window import Body, Face, Window

if TYPE_CHECKING:
    from clacad.design import Design

LINE = 15.0
"""Height of a row, px."""

SAG_STEPS = 8
"""Rows of the sag table: eighths of half a pitch."""

COSTS = {"image_shift": "image shift", "blur": "blur", "law_rms": "law rms"}
"""Measures of a tolerance study that the table of errors shows, in mrad."""


def table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> Canvas:
    """Rows of words under a title, each column at least as wide as its widest word."""
    lines = [list(head), *(list(row) for row in rows)]
    widths = [14.0 + CHARACTER * max(len(line[k]) for line in lines) for k in range(len(head))]
    wanted = 1.1 * CHARACTER * len(title)  # the title is bold
    spare = max(0.0, wanted - sum(widths)) / len(widths)
    edges = np.cumsum([6.0, *(width + spare for width in widths)])
    canvas = Canvas(float(edges[-1]) + 6.0, 26.0 + LINE * len(lines), title)
    canvas.text((6.0, 13.0), title, "start", "title")
    for number, line in enumerate(lines):
        y = 20.0 + LINE * (number + 1)
        canvas.line([(6.0, y), (float(edges[-1]), y)], "dim" if number in (0, len(lines) - 1) else "ext")
        for word, x in zip(line, edges, strict=False):
            canvas.text((float(x) + 3.0, y - 4.0), word, "start", "note" if number == 0 else "")
    return canvas


def _radius(value: float, mm: float, half: float) -> str:
    return "flat" if abs(value) == inf else mm_text(value * mm, abs(value) * mm * half)


def faces_table(window: Window, allowed: Allowances) -> Canvas:
    """Every face: radii and conic constants along its axes, apex in its cell, rotation."""
    mm = millimetres(window.unit)
    head = [
        "face",
        "radius x",
        "radius y",
        "conic x",
        "conic y",
        "apex in its cell x, y, z",
        "phi, theta, psi / deg",
    ]
    orders = _orders(window)
    head += [f"{HEADS[order]} / mm^-{POWER[order]}" for order in orders]
    rows = []
    for body in window.bodies:
        for side, face in (("front", body.front), ("back", body.back)):
            half = 0.0 if face.array is None else TolerancesSpec.of_array(allowed.radius, face.array)
            radii = [_radius(face.side * r, mm, half) for r in principal_radii(face.surface)]
            if face.change is not None and face.change.size is not None:
                radii = ["by cell"] * 2
            conics = ["-" if k is None else _conic(k) for k in conic_constants(face.surface)]
            place = ", ".join(mm_text(v * mm) for v in face.vertex)
            if face.change is not None:  # each its own: see the table of cells
                place = f"by cell, by cell, {mm_text(face.vertex[2] * mm)}"
            same = ", ".join(f"{v:.5g}" for v in euler_degrees(face.rotation))
            turned = "by cell" if face.own_axes else same
            lens = ["-", "-", place, "-"] if face.array is None else [*conics, place, turned]
            rows.append([f"{body.name} {side}", *radii, *lens])
            rows[-1] += [_terms(face, order, mm) for order in orders]
    return table("faces (mm; radius above 0: bends towards +z; lens axes)", head, rows)


HEADS = {
    "a4": "x^4, x^2 y^2, y^4",
    "a6": "x^6, x^4 y^2, x^2 y^4, y^6",
    "a8": "x^8, x^6 y^2, x^4 y^4, x^2 y^6, y^8",
}
"""Heads of the columns of even terms, in characters that the drawing fonts have."""


def _orders(window: Window) -> list[str]:
    """Orders of even terms that any face has; the fourth wherever a face is a polynomial."""
    surfaces = [face.surface for face in window.faces if isinstance(face.surface, EvenPolynomial)]
    return [order for order in HEADS if any(order == "a4" or any(getattr(one, order)) for one in surfaces)]


def _terms(face: Face, order: str, mm: float) -> str:
    """Coefficients of one order, positive towards +z like the radii."""
    if not isinstance(face.surface, EvenPolynomial):
        return "-"
    return ", ".join(f"{face.side * a / mm ** POWER[order] + 0.0:.6g}" for a in getattr(face.surface, order))


def layers_table(window: Window) -> Canvas:
    """Every layer and plate: medium, thickness at the vertices, sizes for a caliper, volume and mass."""
    rows = []
    for number, plate in enumerate(plates_of(window.bodies), 1):
        rows += [_layer(window, body.name, (body,)) for body in plate]
        if len(plate) > 1:
            rows.append(_layer(window, f"plate{number}", plate))
    head = ["layer", "medium", "at the vertices", "width, height, thickness", "volume / mm^3", "mass / g"]
    return table("layers and plates (mm; over all, for a caliper)", head, rows)


def _layer(window: Window, name: str, bodies: Sequence[Body]) -> list[str]:
    """Row of one layer, or of the layers of a plate together."""
    from clacad.sheet.feasibility.lenses import outer_size

    mm, first = millimetres(window.unit), bodies[0]
    thick = bodies[-1].back.vertex[2] - first.front.vertex[2]
    sizes = ", ".join(mm_text(length * mm) for length in outer_size(window, bodies))
    found = [body_volume(window, body) for body in bodies]
    cubic = [one.value * mm**3 for one in found if one is not None]
    mass = [one for one in map(grams, bodies, cubic) if one is not None]
    named = "all its layers" if len(bodies) > 1 else "" if first.material is None else first.material.name
    return [
        name,
        named or f"n = {first.index:.6g}",
        mm_text(thick * mm),
        sizes,
        f"{sum(cubic):.6g}" if len(cubic) == len(bodies) else "-",
        f"{sum(mass):.5g}" if len(cubic) == len(mass) == len(bodies) else "-",
    ]


def sag_table(window: Window) -> Canvas:
    """Heights of each lens over its apex along its axes x and y, to the farthest corner of a cell."""
    mm = millimetres(window.unit)
    curved = structured_faces(window)
    reach = _reach(window)
    head = ["distance", *(f"{label} {axis}" for _, _, label in curved for axis in "xy")]
    rows = []
    for k in range(1, SAG_STEPS + 1):
        at = reach * k / SAG_STEPS
        rows.append(
            [mm_text(at * mm), *(_sag(face, at, axis, mm) for _, face, _ in curved for axis in (0, 1))]
        )
    whose = ", lens of law.eta; of a cell both are times R over that lens's" if window.many_sizes else ""
    if window.many_aspects:
        whose = ", lens of law.eta; of a cell: --format table"
    return table(f"sag table (mm along lens x and y, height over the apex towards +z{whose})", head, rows)


def _reach(window: Window) -> float:
    """Largest distance from its apex at which a lens is used (length): cell corner plus lens offset."""
    moved = [
        np.hypot(*window.vertices(face, extreme_cells(face.change, window.lattice))[:, :2].T).max()
        for face in window.faces
        if face.change is not None
    ]
    corner = max(window.lattice_of(array).circumradius for array in range(len(window.placements)))
    return corner + float(max(moved, default=0.0))


def _conic(value: float) -> str:
    """A conic constant; rounding errors of a sphere's are 0."""
    return "0" if abs(value) < LEAST_CONIC else f"{value:.5g}"


def _sag(face: Face, at: float, axis: int, mm: float) -> str:
    x, y = (at, 0.0) if axis == 0 else (0.0, at)
    value = float(sag(face.surface, np.array([x]), np.array([y]))[0]) * mm
    return f"{value:.6g}" if np.isfinite(value) else "none"


LEAST_CONIC = 1e-12
"""Conic constants below are rounding errors: they change no lens by a millionth of a wavelength."""

MOST_EDGES = 32
"""Edges of a plate that a table lists; a longer boundary is drawn to scale alone."""


def plate_tables(design: Design, window: Window) -> list[Canvas]:
    """Holes of a plate and corners of its boundary about the middle of the cells (mm), if it is one."""
    plate = window.outline
    if not isinstance(plate, Plate):
        return []
    mm, pins = millimetres(window.unit), design.body.pins
    made = []
    rows = []
    for number, hole in enumerate(plate.holes, 1):
        use = (
            "mounting"
            if hole.purpose == "mount" or pins is None
            else (f"pin {mm_text(pins.diameter * mm)}, play {mm_text(pins.play * mm)}")
        )
        place = (_coordinate(v, plate, mm) for v in (hole.x, hole.y))
        rows.append([str(number), *place, mm_text(hole.diameter * mm), use])
    if rows:
        made.append(
            table("holes, through (mm about the sheet's origin)", ["hole", "x", "y", "diameter", "for"], rows)
        )
    if len(plate.loops[0]) <= MOST_EDGES:
        made.append(_boundary_table(plate, mm))
    return made


def _boundary_table(plate: Plate, mm: float) -> Canvas:
    """Corners of the boundary of a plate, and the edge from each to the next; `mm`: millimetres a length."""
    rows = []
    for n, edge in enumerate(plate.loops[0], 1):
        way = "out" if edge[SENSE] > 0.0 else "in"
        to_next = "straight" if edge[SENSE] == 0.0 else f"{way}wards, R {mm_text(edge[RADIUS] * mm)}"
        rows.append([str(n), _coordinate(edge[X0], plate, mm), _coordinate(edge[Y0], plate, mm), to_next])
    title = "boundary, counter-clockwise with +x to the right (mm)"
    return table(title, ["corner", "x", "y", "to the next"], rows)


def _coordinate(value: float, plate: Plate, mm: float) -> str:
    """Coordinate on a plate; rounding errors of 0 (cos 90°) are 0."""
    return mm_text(0.0 if abs(value) < 1e-12 * max(plate.reach) else value * mm)


def errors_table(
    design: Design, window: Window, allowed: Allowances, study: Mapping[str, Any] | None
) -> Canvas:
    """Possible errors with their sizes, and the effect of each where a tolerance study computed it."""
    if study is not None:
        return _studied(design, study)
    two = len(window.bodies) > 1
    named = {
        "decentre of array 1, array 2 (x and y)": [f"±{mm_text(v)} mm" for v in allowed.decentre if v > 0.0],
        "rotation of array 2 about the normal of A": (
            [f"±{mrad_text(allowed.rotation, 3)}"] if allowed.rotation else []
        ),
        "tilt of array 2 against A": [f"±{mrad_text(allowed.tilt, 3)}"] if allowed.tilt else [],
        "lens to lens": [f"±{mm_text(allowed.separation)} mm"] if two and allowed.separation else [],
        "play of the pins (x and y)": (
            []
            if design.body.pins is None
            else [f"±{mm_text(design.body.pins.play * millimetres(design.unit_m))} mm"]
        ),
        "centre thickness of the bodies": [
            f"±{mm_text(v)} mm" for v in allowed.thickness[: len(window.bodies)] if v > 0.0
        ],
        "radii of array 1, array 2": [f"±{percent_text(v)}" for v in allowed.radius if v > 0.0],
    }
    rows = [[name, ", ".join(values), "not studied"] for name, values in named.items() if values]
    rows = rows or [["none stated: [tolerances] of the design is empty", "-", "not studied"]]
    return table(
        "errors allowed (what each costs: clacad tolerance, into this folder)",
        ["error", "allowed", "costs"],
        rows,
    )


def _studied(design: Design, study: Mapping[str, Any]) -> Canvas:
    """Parameters of a study with the change over the tolerance, the largest effect on the law first."""
    changes = {
        measure: {row["parameter"]: row["change"] for row in study["ranking"].get(measure, ())}
        for measure in COSTS
    }
    parameters = sorted(study["parameters"], key=lambda p: -(changes["law_rms"].get(p["name"]) or 0.0))
    rows = []
    for p in parameters:
        if p["unit"] == "rad":
            stated = mrad_text(p["tolerance"], 3)
        elif p["unit"]:
            stated = f"{mm_text(p['tolerance'] * millimetres(design.unit_m))} mm"
        else:
            stated = f"{p['tolerance']:.3g}"
        costs = [changes[measure].get(p["name"]) for measure in COSTS]
        rows.append(
            [
                p["name"],
                ("" if p["one_sided"] else "±") + stated,
                *("-" if c is None else mrad_text(c, 3, unit="") for c in costs),
            ]
        )
    title = "errors allowed, and what each alone changes (mrad), by a tolerance study of this design"
    return table(title, ["error", "allowed", *COSTS.values()], rows)


def surfaces_table(window: Window, allowed: Allowances, slope_rms: float) -> Canvas:
    """Texture of every kind of face (ISO 21920), with form, centring and imperfections of lens faces (ISO
    10110).

    What the design does not state is to be agreed: no value is assumed.
    """
    texture = f"Rq {1e6 * allowed.roughness:.3g} nm" if allowed.roughness > 0.0 else AGREE
    form = f"slope {mrad_text(slope_rms, 3)} rms" if slope_rms > 0.0 else AGREE
    centred = [allowed.decentre[0] > 0.0, max(allowed.decentre[1], allowed.tilt, allowed.rotation) > 0.0]
    rows = [
        [
            LENS_FINISH,
            f"lens {array + 1}",
            texture,
            f"3/ {form}",
            f"4/ {'see errors allowed' if known else AGREE}",
            f"5/ {AGREE}",
        ]
        for array, known in enumerate(centred)
    ]
    rows.append([OTHER_FINISH, "all others: sides, land, holes", f"Ra {AGREE}", "-", "-", "-"])
    head = ["symbol", "faces", "texture, at most", "form", "centring", "imperfections"]
    return table("surfaces (texture: ISO 21920; 3/, 4/, 5/: ISO 10110)", head, rows)


AGREE = "to be agreed"
"""Of what the design does not state."""


def _datum_sides(window: Window) -> str:
    """Datums B and C of an outline."""
    if isinstance(window.outline, Plate):
        return (
            "B: the outermost side towards -y; C: towards -x; holes and corners are placed about the middle"
            " of the cells"
        )
    if isinstance(window.outline, Circle):
        return "B: the round side"
    return "B: the -y side; C: the -x side; the mark is at the corner +x, +y"


def notes(
    window: Window, allowed: Allowances, slope_rms: float, width: float, more: Sequence[str] = ()
) -> Canvas:
    """Datums, finish, tolerances, how the part is held, and further notes; lines broken at `width` px."""
    mm = millimetres(window.unit)
    rough = (
        f"Rq at most {1e6 * allowed.roughness:.3g} nm"
        if allowed.roughness > 0.0
        else "to be agreed, the design states no roughness"
    )
    slope = f", slope error at most {mrad_text(slope_rms, 3)} rms" if slope_rms > 0.0 else ""
    said = [
        (
            f"Datum A: the plane z = {mm_text(window.z_range[0] * mm)} through the lowest points of the side"
            f" of lens 1; {_datum_sides(window)}."
        ),
        (
            f"Surface finish of lens faces: {rough}{slope}. Land and sides are opaque where the design says"
            " so. All faces: see the table of surfaces."
        ),
        (
            "± is an error that the design allows. Dimensions without ± are theoretically exact; agree on the"
            " workshop's own class."
        ),
        *orientation(window),
        *more,
    ]
    most = int((width - 24.0) / CHARACTER)
    lines = [(line, k) for text in said for k, line in enumerate(_broken(text, most))]
    canvas = Canvas(width, 26.0 + LINE * len(lines), "notes")
    canvas.text((6.0, 13.0), "notes", "start", "title")
    for number, (line, k) in enumerate(lines):
        canvas.text((6.0 if k == 0 else 16.0, 16.0 + LINE * (number + 1)), line, "start")
    return canvas


def _broken(text: str, most: int) -> list[str]:
    """Words in lines of at most `most` characters."""
    lines = [""]
    for word in text.split():
        if lines[-1] and len(lines[-1]) + 1 + len(word) > most:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".lstrip()
    return lines
