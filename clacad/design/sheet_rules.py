"""Rules of [lattice] and [body], and all rules of a design.
Each rule yields its mistakes; all rules always run.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import isinf
from typing import Any, Final

from clacad.base.text import rounded_up
from clacad.config.mistakes import Mistake
from clacad.config.value_kinds import LARGEST_COUNT, shown
from clacad.design.combinations import FEATURES, REASONS, SHEETS
from clacad.design.face_list_rules import MEDIA_RULES
from clacad.design.rules import PAIR_RULES, Asked, Rule
from clacad.design.sections import BODY, LATTICE, LAW, PAIR
from clacad.design.varying import MAGNIFIED, VaryingSpec, gradient_of, needed_eta

SMALLEST_PITCH_M: Final = 1e-7
"""Smallest pitch, metres: 0.1 µm, about a quarter of the shortest visible wavelength."""

MOST_CUT: Final = 1_000_000
"""Greatest number of rows or columns that are tested one by one against an outline: one or two seconds."""


def pitch_fits_lattice(a: Asked) -> Iterator[Mistake]:
    """Square and hexagonal cells have one pitch, rectangular ones two."""
    kind, pitch, written = a(LATTICE.kind), a(LATTICE.pitch), a.written.get(LATTICE.pitch)
    if kind is None or pitch is None:
        return
    if kind == "rectangular" and not isinstance(written, list | tuple):
        yield Mistake(
            "CL116",
            "a rectangular lattice needs two pitches",
            LATTICE.pitch,
            found=a.says(LATTICE.pitch),
            allowed="[x, y]",
            hint=f'write [{shown(written)}, {shown(written)}], or kind = "square"',
        )
    for key, pitches in ((LATTICE.pitch, pitch), (LATTICE.pitch_2, a(LATTICE.pitch_2))):
        if pitches is not None and kind != "rectangular" and pitches[0] != pitches[1]:
            yield Mistake(
                "CL116",
                f"a {kind} lattice has one pitch",
                key,
                found=a.says(key),
                allowed="one length",
                hint='kind = "rectangular" takes two',
            )
    yield from _pitch_in_range(a, pitch)


def _pitch_in_range(a: Asked, pitch: tuple[float, float]) -> Iterator[Mistake]:
    """Array 2's pitch is half to twice array 1's, which is above the wavelength of light."""
    if any(not 0.5 <= one / other <= 2.0 for one, other in zip(a(LATTICE.pitch_2) or (), pitch)):
        message = f"{a.says(LATTICE.pitch_2)} is out of range"
        yield Mistake("CL106", message, LATTICE.pitch_2, allowed="half to twice lattice.pitch")
    if a.unit is not None and min(pitch) * float(a.unit.metres) < SMALLEST_PITCH_M:
        metres = min(pitch) * float(a.unit.metres)
        yield Mistake(
            "CL115",
            f"{a.says(LATTICE.pitch)} is {metres * 1e6:.3g} um: below the wavelength of light",
            LATTICE.pitch,
            allowed="0.1 um and above",
            hint=f'check unit = "{a.unit.name}"',
        )


def seam_leaves_a_lens(a: Asked) -> Iterator[Mistake]:
    """The seam must be narrower than the cell, and lenslets must be joined."""
    seam, pitch = a(LATTICE.seam), a(LATTICE.pitch)
    if seam and pitch is not None and seam >= min(pitch):
        yield Mistake(
            "CL117",
            f"{a.says(LATTICE.seam)} leaves no lens in a cell of {a.says(LATTICE.pitch)}",
            LATTICE.seam,
            allowed=f"below the pitch, {min(pitch):g}",
        )
    if seam and a(PAIR.form) == "biconvex" and a.given(PAIR.web) and a(PAIR.web) == 0.0:
        yield Mistake(
            "CL117",
            "web = 0 with a seam: nothing would join the lenslets",
            PAIR.web,
            allowed="a length > 0, or leave pair.web out for the neck thickness",
            found=f"{a.says(PAIR.web)} and {a.says(LATTICE.seam)}",
        )


def line_leaves_a_lens(a: Asked) -> Iterator[Mistake]:
    """An opaque line must be narrower than the cell and lie on a face."""
    line, pitch = a(LATTICE.line), a(LATTICE.pitch)
    if line is None:
        return
    if pitch is not None and line.width >= min(pitch):
        yield Mistake(
            "CL117",
            f"a line of {line.width:g} leaves no lens in a cell of {a.says(LATTICE.pitch)}",
            LATTICE.line,
            allowed=f"width below the pitch, {min(pitch):g}",
        )
    faces = len(a(PAIR.face)) if a(PAIR.form) == "plates" and a(PAIR.face) else 0
    if faces and line.face > faces:
        yield Mistake(
            "CL117",
            f"lattice.line is on face {line.face} of {faces}",
            LATTICE.line,
            allowed=f"a face from 1 to {faces}, in the order of the light",
        )


def outline_holds_a_cell(a: Asked) -> Iterator[Mistake]:
    """An outline must contain a whole cell; the positions of cells depend on their count."""
    outline, pitch = a(LATTICE.outline), a(LATTICE.pitch)
    kind, count = a(LATTICE.kind), a(LATTICE.count)
    if outline is None or pitch is None or kind is None or count is None:
        return
    if outline.shape in ("polygon", "dxf"):
        return  # polygons and their holes are checked when the cells are placed
    if max(count) > MOST_CUT:
        yield Mistake(
            "CL106",
            f"{a.says(LATTICE.count)} is out of range where an outline cuts",
            LATTICE.count,
            allowed=f"up to {MOST_CUT} each way with lattice.outline, which keeps the cells within it alone",
        )
        return
    from clacad.sheet.lattice import Circle, Lattice, Rectangle

    shape, size = outline.shape, outline.size
    lattice = Lattice(kind, pitch, count, Circle(size[0]) if shape == "circle" else Rectangle(*size))
    if lattice.holds_a_cell:
        return
    least = lattice.least_outline()
    sides = (least.diameter,) if isinstance(least, Circle) else (least.width, least.height)
    need = ", ".join(map(rounded_up, sides))
    yield Mistake(
        "CL117",
        f"{a.says(LATTICE.outline)} holds no cell of {count[0]} x {count[1]}",
        LATTICE.outline,
        allowed=f"{shape} of at least {need if len(sides) == 1 else f'[{need}]'}, round the cell nearest to"
        " the middle",
        hint=(
            ""
            if kind == "hexagonal" or all(n % 2 for n in count)
            else "with an odd lattice.count a cell lies in the middle"
        ),
    )


def count_or_outline(a: Asked) -> Iterator[Mistake]:
    """The number of cells must be given, or follow from the outline."""
    if a.given(LATTICE.count) or not any(key.startswith("lattice.") for key in a.written):
        return
    if not a.given(LATTICE.outline):
        yield Mistake(
            "CL103",
            "missing key lattice.count",
            LATTICE.count,
            allowed=f"a whole number from 1 to {LARGEST_COUNT}, or [n1, n2]; or leave it to lattice.outline,"
            " which is then filled",
        )
        return
    outline, pitch, kind = a(LATTICE.outline), a(LATTICE.pitch), a(LATTICE.kind)
    if outline is None or pitch is None or kind is None or outline.shape == "dxf":
        return
    most = max(across / along for across, along in zip(outline.box, pitch, strict=True))
    if most > LARGEST_COUNT / 2:  # rows of hexagons are closer than the pitch
        yield Mistake(
            "CL117",
            f"{a.says(LATTICE.outline)} is {most:.3g} cells wide",
            LATTICE.outline,
            allowed=f"at most {LARGEST_COUNT / 2:.3g} cells",
            hint="a smaller outline or a larger pitch",
        )


def outline_is_simple(a: Asked) -> Iterator[Mistake]:
    """A polygon must enclose an area, and its sides must not intersect."""
    for key in (LATTICE.outline, BODY.outline):
        outline = a(key)
        if outline is None or outline.shape != "polygon":
            continue
        from clacad.sheet.plate import fault

        why = fault(outline.points)
        if why:
            yield Mistake(
                "CL141",
                f"{key} is no outline: {why}",
                key,
                allowed="corners of a closed polygon in order, the first not repeated, whose sides meet at"
                " corners alone",
            )


def one_edge(a: Asked) -> Iterator[Mistake]:
    """The edge of the plate is that of the cells, a border around them, or its own outline."""
    cells, plate, border = a(LATTICE.outline), a(BODY.outline), a(BODY.border)
    if border and plate is not None:
        yield Mistake(
            "CL112",
            "body.border and body.outline both say where the plate ends",
            BODY.border,
            allowed="one of the two",
            hint="leave body.border out",
        )
    elif border and cells is not None and cells.shape in ("polygon", "dxf"):
        yield Mistake(
            "CL114",
            f"body.border does not belong to a {cells.shape}",
            BODY.border,
            allowed="lattice.outline = {circle = ...} or {rectangle = ...}, or no border",
            hint="body.outline = {...} is the edge of a plate round a polygon of cells",
        )


def plate_has_a_border(a: Asked) -> Iterator[Mistake]:
    """Corners, holes and pins need land around the cells, and a shape that can have them."""
    outline, border = a(BODY.outline) or a(LATTICE.outline), a(BODY.border)
    shape = "rectangle" if outline is None else outline.shape
    for key in (BODY.corners, BODY.holes, BODY.pins):
        if a(key) and outline is None and not border:
            yield Mistake(
                "CL113",
                f"{key} needs land round the cells",
                key,
                allowed="body.border > 0, body.outline or lattice.outline",
            )
    if a(BODY.corners) and shape != "rectangle":
        yield Mistake(
            "CL114",
            f"body.corners does not belong to a {shape}",
            BODY.corners,
            allowed="a rectangular plate: body.outline or lattice.outline = {rectangle = ...}, or body.border"
            " alone",
            hint="give a polygon's corners themselves: [x, y, bulge] bends a side",
        )
    if a(BODY.pins) and a(PAIR.form) == "slab":
        yield Mistake(
            "CL114",
            "body.pins does not belong to a slab: it is one body",
            BODY.pins,
            allowed='pair.form = "biconvex" | "plano"',
            hint="leave it out",
        )
    for n in range(len(a(BODY.holes) or ())):
        yield from _one_way_to_place(a.written[BODY.holes][n], n, shape)


def _one_way_to_place(hole: dict[str, Any], n: int, shape: str) -> Iterator[Mistake]:
    """Holes need exactly one of points, a circle and the corners."""
    ways = [key for key in ("at", "circle", "corners") if key in hole]
    key = f"{BODY.holes}.{n}"
    if len(ways) != 1:
        yield Mistake(
            "CL112" if ways else "CL103",
            f"body.holes[{n}] says {'two ways' if ways else 'nothing'} of where its holes are",
            key,
            allowed="exactly one of at = [[x, y], ...], circle = diameter with count, corners = distance from"
            " both sides",
        )
    elif ways == ["circle"] and "count" not in hole:
        yield Mistake(
            "CL103",
            f"body.holes[{n}] lacks the key count",
            key,
            allowed="count = a whole number from 1 to 360",
        )
    elif ways != ["circle"] and {"count", "start"} & set(hole):
        yield Mistake(
            "CL113",
            f"body.holes[{n}]: count and start belong to circle",
            key,
            allowed="circle = a length > 0, or leave them out",
        )
    if ways == ["corners"] and shape != "rectangle":
        yield Mistake(
            "CL114",
            f"body.holes[{n}].corners does not belong to a {shape}",
            key,
            allowed="at = [[x, y], ...], or circle = diameter with count",
        )


def baffle_has_walls(a: Asked) -> Iterator[Mistake]:
    """A baffle needs its wall thickness, thinner than a cell; a wall needs a baffle."""
    wall, pitch = a(BODY.baffle_wall), a(LATTICE.pitch)
    if a(BODY.baffle) and not a.given(BODY.baffle_wall):
        yield Mistake(
            "CL113",
            "body.baffle = true needs body.baffle_wall",
            BODY.baffle,
            allowed="baffle_wall = a length > 0, below the pitch",
        )
    if a.given(BODY.baffle_wall) and a(BODY.baffle) is False:
        yield Mistake(
            "CL113",
            "body.baffle_wall needs body.baffle = true",
            BODY.baffle_wall,
            allowed="baffle = true, or leave baffle_wall out",
        )
    if wall is not None and pitch is not None and wall >= min(pitch):
        yield Mistake(
            "CL117",
            f"{a.says(BODY.baffle_wall)} closes the channels",
            BODY.baffle_wall,
            allowed=f"below the pitch, {min(pitch):g}",
        )


def varying_law_has_lenses(a: Asked) -> Iterator[Mistake]:
    """δ varies only along axes with power; a table replaces delta; a magnification determines eta."""
    spec, eta, separation = a(LAW.varying), a(LAW.eta), a(PAIR.separation)
    if spec is None or eta is None:
        return
    if spec.table is not None and any(a(LAW.delta) or ()):
        yield Mistake(
            "CL112",
            "law.delta and a table of cells exclude each other: the table has the delta of every cell",
            LAW.delta,
            found=a.says(LAW.delta),
            allowed="leave it out",
        )
    if 1.0 in eta:
        yield Mistake(
            "CL111",
            "eta = 1 with a delta that varies: a lens without power has no axis to offset",
            LAW.varying,
            allowed="eta other than 1 in both x and y",
        )
    if separation is not None:
        yield from _law_fits_its_planes(a, spec, eta, separation)
    elif spec.conjugates is not None and a(PAIR.form) == "slab" and a.given(PAIR.thickness):
        yield Mistake(
            "CL113",
            "law.varying.conjugates needs pair.separation",
            PAIR.separation,
            allowed="separation = T/n instead of thickness = T",
        )


def _law_fits_its_planes(
    a: Asked, spec: VaryingSpec, eta: tuple[float, float], separation: float
) -> Iterator[Mistake]:
    """The magnification and eta agree, and the gradient of delta is finite."""
    wanted = None if spec.conjugates is None else needed_eta(spec.conjugates, separation)
    if wanted is not None and any(abs(e - w) > MAGNIFIED * abs(w) for e, w in zip(eta, wanted, strict=True)):
        needed = ", ".join(repr(w) for w in wanted)
        yield Mistake(
            "CL112",
            "law.eta and the magnification exclude each other",
            LAW.eta,
            found=a.says(LAW.eta),
            allowed=f"eta = [{needed}]",
            hint="or leave magnification out: then it is as eta makes it",
        )
    rows = gradient_of(spec, eta, separation)
    if rows is not None and not all(abs(v) < 1e9 for row in rows for v in row):
        yield Mistake(
            "CL106",
            "the gradient of delta is out of range",
            LAW.varying,
            allowed="planes farther from the sheet",
        )


def focus_has_planes(a: Asked) -> Iterator[Mistake]:
    """A plane must be finite; both meridians need power; two pitch ratios must lie along the cells."""
    planes, eta, euler = a(PAIR.focus), a(LAW.eta), a(LAW.euler)
    if planes is None or eta is None:
        return
    if isinf(planes.object) and isinf(planes.image):
        yield Mistake(
            "CL113",
            "pair.focus with both planes at infinity: parallel light that leaves parallel is the afocal pair",
            PAIR.focus,
            allowed='a finite object or image, or "afocal"',
        )
    if 1.0 in eta:
        yield Mistake(
            "CL111",
            "eta = 1 with pair.focus: a lens without power focuses nothing",
            PAIR.focus,
            allowed="eta other than 1 in both x and y",
        )
    if eta[0] == eta[1]:
        return
    if euler is not None and euler[1]:
        yield Mistake(
            "CL125",
            f"lenses tilted by {euler[1]:g} deg with eta_x and eta_y that differ: with pair.focus lenses 1 of"
            " two cells would differ in figure, not in size alone",
            f"{LAW.euler}.1",
            allowed="theta = 0 deg",
            hint="eta_x = eta_y",
        )
    if a(LATTICE.kind) == "hexagonal":
        yield Mistake(
            "CL116",
            "eta_x and eta_y differ: with pair.focus array 2 needs two pitches, and a hexagonal lattice"
            " has one",
            LATTICE.kind,
            allowed="square | rectangular",
            hint="eta_x = eta_y",
        )
    if euler is not None and (angle := euler[0] + euler[2]) % 90.0:
        yield Mistake(
            "CL125",
            f"lenses turned by {angle:g} deg with eta_x and eta_y that differ: with pair.focus array 2's"
            " cells would be sheared",
            f"{LAW.euler}.0",
            allowed="phi + psi = 0 deg, or a multiple of 90 deg",
            hint="eta_x = eta_y",
        )


def sheet_is_built(a: Asked) -> Iterator[Mistake]:
    """Refuse features that cannot be combined with the requested non-uniform sheet."""
    named = set()
    for sheet in (name for name, asked in SHEETS.items() if asked(a)):
        for feature in FEATURES:
            reason, keys = REASONS.get((sheet, feature.name)), frozenset((sheet, feature.key))
            if reason and keys not in named and feature.present(a):
                named.add(keys)
                yield Mistake(
                    "CL125",
                    f"{feature.key} with {sheet}: {reason}",
                    feature.key,
                    allowed="one of the two",
                    hint=feature.instead,
                )


RULES: Final[tuple[Rule, ...]] = (
    *PAIR_RULES,
    *MEDIA_RULES,
    pitch_fits_lattice,
    seam_leaves_a_lens,
    line_leaves_a_lens,
    outline_holds_a_cell,
    count_or_outline,
    outline_is_simple,
    one_edge,
    plate_has_a_border,
    baffle_has_walls,
    varying_law_has_lenses,
    focus_has_planes,
    sheet_is_built,
)


def broken(asked: Asked) -> list[Mistake]:
    """Return the mistakes of all rules."""
    return [mistake for rule in RULES for mistake in rule(asked)]
