"""Rules that need more than one key but no solved lens.
Each rule yields its mistakes; all rules always run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from math import isinf
from typing import Any, Final

from clacad.base.digits import rounded_up
from clacad.base.units import Unit
from clacad.config.mistakes import Mistake
from clacad.config.value_kinds import LARGEST_COUNT, shown
from clacad.design.combinations import FEATURES, built_sheets, has_plate, why_not
from clacad.design.keys import BODY, CHECK, LATTICE, LAW, PAIR, TOLERANCES
from clacad.design.varying import MAGNIFIED, gradient_of, needed_eta

SMALLEST_PITCH_M: Final = 1e-7
"""Smallest pitch, metres: 0.1 µm is about a quarter of the shortest visible wavelength,
too small for a lens.
"""

MOST_CUT: Final = 1_000_000
"""Greatest number of rows or columns that are tested one by one against an outline: one or two seconds."""


@dataclass(frozen=True, slots=True)
class Asked:
    """Values read so far.

    Parameters
    ----------
    values : mapping of dotted key to converted value
        Includes defaults; keys whose value was refused are absent.
    written : mapping of dotted key to value as written
        For messages.
    unit : Unit or None
        None if the unit itself was refused: rules about absolute sizes are skipped.
    """

    values: Mapping[str, Any]
    written: Mapping[str, Any]
    unit: Unit | None

    def __call__(self, key: str) -> Any:
        """Return a value, None where it is absent."""
        return self.values.get(key)

    def given(self, key: str) -> bool:
        """Whether the key was written (with a valid value or not)."""
        return key in self.written

    def says(self, key: str) -> str:
        """Return "key = value" as written (or the default)."""
        value = self.written.get(key, self.values.get(key))
        return f"{key} = {shown(list(value) if isinstance(value, tuple) else value)}"


Rule = Callable[[Asked], Iterator[Mistake]]


def law_is_a_pair(a: Asked) -> Iterator[Mistake]:
    """Refuse η = 0, both η = 1, and η_i = 1 with δ_i ≠ 0."""
    eta, delta = a(LAW.eta), a(LAW.delta)
    if eta is None:
        return
    for i, axis in enumerate("xy"):
        if eta[i] == 0.0:
            yield Mistake("CL110", f"eta_{axis} = 0: no pair of lenses has it", f"{LAW.eta}.{i}",
                          allowed="any other number; |eta| < 1 shrinks what is seen, eta < 0 turns it over",
                          hint=f"eta_{axis} = -1 sends light on under minus the angle it came in")  # fmt: skip
        elif 0.0 < abs(eta[i]) < 1e-6:
            yield Mistake("CL106", f"eta_{axis} = {eta[i]!r} is out of range", f"{LAW.eta}.{i}",
                          allowed="1e-6 <= |eta| <= 1e6")  # fmt: skip
    if eta[0] == 1.0 and eta[1] == 1.0:
        yield Mistake("CL110", "eta = 1 in both x and y: the sheet would be a plain window", LAW.eta,
                      allowed="eta = 1 in at most one of x and y (a cylindrical sheet)")  # fmt: skip
    elif delta is not None:
        for i, axis in enumerate("xy"):
            if eta[i] == 1.0 and delta[i] != 0.0:
                yield Mistake("CL111", f"eta_{axis} = 1 with delta_{axis} = {delta[i]:g}: a lens without power has "
                              "no axis to offset", f"{LAW.delta}.{i}", allowed=f"delta_{axis} = 0, or eta_{axis} other than 1")  # fmt: skip


def lens_faces_forward(a: Asked) -> Iterator[Mistake]:
    """The lens axis must point through the sheet: |θ| < 90°."""
    euler = a(LAW.euler)
    if euler is not None and abs(euler[1]) >= 90.0:
        yield Mistake("CL106", f"theta = {euler[1]:g} deg turns the lens axis out of the forward half", f"{LAW.euler}.1",
                      allowed="-90 deg < theta < 90 deg")  # fmt: skip


def separation_or_thickness(a: Asked) -> Iterator[Mistake]:
    """A slab has exactly one of separation and thickness; the other forms need the separation."""
    form, thickness = a(PAIR.form), a(PAIR.thickness)
    if form == "slab":
        number = a.given(PAIR.thickness) and thickness != "auto"
        if a.given(PAIR.separation) and number and thickness is not None:
            yield Mistake("CL112", "a slab takes either separation or thickness, not both", PAIR.thickness,
                          found=f"{a.says(PAIR.separation)} and {a.says(PAIR.thickness)}",
                          allowed="separation = T/n, or thickness = T")  # fmt: skip
        if not a.given(PAIR.separation) and not number:
            yield Mistake("CL103", "a slab needs its separation or its thickness", PAIR.separation,
                          allowed="separation = T/n, or thickness = T (exactly one)")  # fmt: skip
        if isinstance(a.written.get(PAIR.thickness), list) and thickness is not None:
            yield Mistake("CL108", f"{a.says(PAIR.thickness)}: a slab is one body with one thickness",
                          PAIR.thickness, allowed="one length")  # fmt: skip
    elif form in ("biconvex", "plano") and not a.given(PAIR.separation):
        what = "centre to centre" if form == "biconvex" else "f1 + f2 in air"
        yield Mistake("CL103", f"missing key pair.separation: a {form} pair needs it", PAIR.separation,
                      allowed=f"a length > 0 ({what})")  # fmt: skip


def keys_of_other_forms(a: Asked) -> Iterator[Mistake]:
    """Refuse keys that belong to other forms: web, curved, seam_depth, the thin recipe, a baffle."""
    form = a(PAIR.form)
    if form is None:
        return
    for key, forms in (
        (PAIR.curved, ("plano",)),
        (LATTICE.seam_depth, ("plano", "slab")),
    ):
        if a.given(key) and form not in forms:
            yield Mistake("CL114", f"{key} does not belong to a {form} pair", key,
                          allowed=f"only with pair.form = {' | '.join(shown(f) for f in forms)}", hint="leave it out")  # fmt: skip
    if form != "biconvex" and a(PAIR.web):
        yield Mistake("CL114", f"pair.web does not belong to a {form} pair: its body holds together by itself",
                      PAIR.web, allowed='only with pair.form = "biconvex"', hint="leave it out")  # fmt: skip
    if form == "slab" and a(PAIR.confocal) == "thin":
        yield Mistake("CL114", f"{a.says(PAIR.confocal)} does not belong to a slab", PAIR.confocal,
                      allowed='"exact": a slab is afocal by construction; or "best": radii for the least error')  # fmt: skip
    if form == "slab" and a(TOLERANCES.separation):
        yield Mistake("CL114", "tolerances.separation does not belong to a slab: its separation is its thickness",
                      TOLERANCES.separation, allowed=TOLERANCES.thickness, hint="leave it out")  # fmt: skip
    if form == "slab" and a(BODY.baffle):
        yield Mistake("CL114", "a slab has no room for a baffle between its faces", BODY.baffle,
                      allowed='false, or pair.form = "biconvex" | "plano"')  # fmt: skip


def index_or_material(a: Asked) -> Iterator[Mistake]:
    """Require exactly one of index and material."""
    if a.given(PAIR.index) and a.given(PAIR.material):
        yield Mistake("CL112", "index and material exclude each other", PAIR.material,
                      found=f"{a.says(PAIR.index)} and {a.says(PAIR.material)}", allowed="exactly one of them")  # fmt: skip
    elif not a.given(PAIR.index) and not a.given(PAIR.material):
        yield Mistake("CL103", "missing key pair.index (or pair.material)", PAIR.index,
                      allowed='index = a number > 1, or material = a name such as "PMMA"')  # fmt: skip


def material_is_known(a: Asked) -> Iterator[Mistake]:
    """The material must be in the table, and its index known at the design wavelength."""
    name, wavelength = a(PAIR.material), a(PAIR.wavelength)
    if name is None:
        return
    from clacad.optics.material.catalogue import find

    try:
        material = find(name)
    except ValueError as problem:
        sentence, _, hint = str(problem).partition("; ")
        yield Mistake(
            "CL119", sentence, PAIR.material, allowed="a name of the table, or pair.index", hint=hint
        )
        return
    if wavelength is not None:
        try:
            material.index(wavelength)
        except ValueError as problem:
            key = PAIR.wavelength if a.given(PAIR.wavelength) else PAIR.material
            yield Mistake("CL119", str(problem), key, allowed="a wavelength in that range, or pair.index")


def worked_materials_are_known(a: Asked) -> Iterator[Mistake]:
    """The materials of `check.materials` must be in the table."""
    asked = a(CHECK.materials)
    if not asked:
        return
    from clacad.optics.material.catalogue import find

    for name in asked:
        try:
            find(name)
        except ValueError as problem:
            sentence, _, hint = str(problem).partition("; ")
            yield Mistake("CL119", sentence, CHECK.materials, allowed="names of the table", hint=hint)


def surface_and_its_keys(a: Asked) -> Iterator[Mistake]:
    """Conic belongs to a biconic, depth to an ellipsoid; a biconvex biconic needs its conic."""
    surface = a(PAIR.surface)
    if surface == "ellipsoid" and a.given(PAIR.conic):
        yield Mistake("CL113", "pair.conic needs surface = \"biconic\"", PAIR.conic,
                      allowed='surface = "biconic", or pair.depth to shape an ellipsoid')  # fmt: skip
    if surface == "biconic" and a.given(PAIR.depth):
        yield Mistake("CL113", "pair.depth needs surface = \"ellipsoid\"", PAIR.depth,
                      allowed='surface = "ellipsoid", or pair.conic to shape a biconic')  # fmt: skip
    if surface == "biconic" and a(PAIR.form) == "biconvex" and not a.given(PAIR.conic):
        yield Mistake("CL113", "a biconvex pair of biconics needs pair.conic: no conic is right by itself",
                      PAIR.surface, allowed="conic = [K_x, K_y]", hint="conic = [0.0, 0.0] gives circular profiles")  # fmt: skip


def faces_stand_alone(a: Asked) -> Iterator[Mistake]:
    """Given faces need prescription = "given", and exclude the keys of the recipes."""
    given = a(PAIR.prescription) == "given"
    for key in (PAIR.face, PAIR.vertex, PAIR.search):
        if a.given(key) and a(PAIR.prescription) == "derived":
            yield Mistake("CL113", f'{key} needs pair.prescription = "given"', key,
                          allowed='prescription = "given", or leave it out')  # fmt: skip
    if not given:
        return
    for key in (PAIR.confocal, PAIR.surface, PAIR.conic, PAIR.depth):
        if a.given(key):
            yield Mistake("CL112", f"{key} and given faces exclude each other: the faces stand as they are", key,
                          found=a.says(key), allowed="leave it out", hint='or prescription = "derived" without pair.face')  # fmt: skip
    if a(PAIR.form) in ("biconvex", "plano") and a(PAIR.thickness) == "auto":
        yield Mistake("CL113", "given faces need their thickness: it fixes where their vertices lie", PAIR.thickness,
                      found=a.says(PAIR.thickness), allowed="a length > 0, or [lens 1, lens 2]")  # fmt: skip


def faces_are_of_the_form(a: Asked) -> Iterator[Mistake]:
    """A slab has two faces, the other forms four; the plane sides of plano lenses are flat."""
    form, faces = a(PAIR.form), a(PAIR.face)
    if a(PAIR.prescription) != "given" or form is None or faces is None:
        return
    eta, lensed = a(LAW.eta), bool(a(PAIR.field_lens))
    in_three = lensed and form == "slab" and eta is not None and eta[0] != eta[1]
    wanted = (2 if form == "slab" else 4) + 2 * lensed + 2 * in_three
    if len(faces) != wanted:
        what = f"a {form} pair" + (" with a field lens" if lensed else "")
        yield Mistake("CL108", f"{len(faces)} given faces: {what} has {wanted}", PAIR.face,
                      allowed=f"{wanted} tables [[pair.face]], in the order light meets them")  # fmt: skip
    elif form == "plano" or in_three:
        last = len(faces) - 1
        for k in (1, last - 1) if a(PAIR.curved) != "inside" else (0, last):
            if not faces[k].plane:
                yield Mistake("CL114", f"pair.face[{k}] is the plane side of a plano lens", f"{PAIR.face}.{k}.radius",
                              allowed="radius = inf and nothing else", hint='form = "biconvex" bends both sides')  # fmt: skip


def field_lens_has_a_focus(a: Asked) -> Iterator[Mistake]:
    """A field lens needs a real common focus: η < 0 in both meridians."""
    eta = a(LAW.eta)
    if not a(PAIR.field_lens) or eta is None:
        return
    for i, axis in enumerate("xy"):
        if eta[i] > 0.0:
            where = "there is none" if eta[i] == 1.0 else "it is virtual"
            yield Mistake("CL126", f"eta_{axis} = {eta[i]:g}: a field lens stands at the common focus, and {where}",
                          PAIR.field_lens, allowed="false, or eta < 0 in both x and y",
                          hint=f"eta_{axis} = {-eta[i]:g}, or pair.field_lens = false")  # fmt: skip


def field_lens_is_made(a: Asked) -> Iterator[Mistake]:
    """A tilt needs a biconvex pair; separate foci need cells along the lens axes;
    keys of a field lens need one.
    """
    if a.given(PAIR.field) and a(PAIR.field_lens) is False:
        yield Mistake("CL113", "pair.field needs pair.field_lens = true", PAIR.field,
                      allowed="field_lens = true, or leave it out")  # fmt: skip
    form, eta, euler = a(PAIR.form), a(LAW.eta), a(LAW.euler)
    if not a(PAIR.field_lens) or form is None or eta is None or euler is None:
        return
    if euler[1] != 0.0 and form != "biconvex":
        yield Mistake("CL127", f"theta = {euler[1]:g} deg: a field lens of a tilted {form} pair is not made", f"{LAW.euler}.1",
                      allowed="theta = 0", hint='pair.form = "biconvex", or theta = 0')  # fmt: skip
    if eta[0] != eta[1]:
        if a(LATTICE.kind) == "hexagonal":
            yield Mistake("CL127", "eta_x and eta_y differ: the field lens is two arrays of cylinders, which hexagonal cells "
                          "would cut across", LATTICE.kind, allowed="square | rectangular", hint="eta_x = eta_y")  # fmt: skip
        if (angle := euler[0] + euler[2]) % 90.0:
            yield Mistake("CL127", f"lenses turned by {angle:g} deg with eta_x and eta_y that differ: cells would cut across "
                          "the cylinders of the field lens", f"{LAW.euler}.0", allowed="phi + psi = 0 deg, or a multiple of 90 deg",
                          hint="eta_x = eta_y, or lenses along the cells")  # fmt: skip
        if euler[1] != 0.0 and form == "biconvex":
            yield Mistake("CL127", f"theta = {euler[1]:g} deg with eta_x and eta_y that differ: the cylinders of the field lens "
                          "would fall into steps", f"{LAW.euler}.1", allowed="theta = 0", hint="eta_x = eta_y, or theta = 0")  # fmt: skip
        if a(BODY.baffle) and form != "slab":
            yield Mistake("CL127", "eta_x and eta_y differ: between the two arrays of cylinders light would change its cell "
                          "inside the glass of their plate, where no wall of a baffle can stand", BODY.baffle, allowed="false",
                          hint="eta_x = eta_y, or no baffle")  # fmt: skip
    if has_plate(a):
        yield Mistake("CL127", "a field lens in a plate of holes, corners, pins or a polygon is not made", PAIR.field_lens,
                      allowed="false, or plain edges", hint="a circle or a rectangle is made")  # fmt: skip
    field = a(PAIR.field)
    if field is not None and field.gap is not None and form != "slab":
        yield Mistake("CL114", f"pair.field.gap does not belong to a {form} pair", PAIR.field,
                      allowed='only with pair.form = "slab"', hint="leave it out")  # fmt: skip


def pitch_fits_lattice(a: Asked) -> Iterator[Mistake]:
    """Square and hexagonal cells have one pitch, rectangular ones two."""
    kind, pitch, written = a(LATTICE.kind), a(LATTICE.pitch), a.written.get(LATTICE.pitch)
    if kind is None or pitch is None:
        return
    if kind == "rectangular" and not isinstance(written, list | tuple):
        yield Mistake("CL116", "a rectangular lattice needs two pitches", LATTICE.pitch,
                      found=a.says(LATTICE.pitch), allowed="[x, y]",
                      hint=f'write [{shown(written)}, {shown(written)}], or kind = "square"')  # fmt: skip
    if kind != "rectangular" and pitch[0] != pitch[1]:
        yield Mistake("CL116", f"a {kind} lattice has one pitch", LATTICE.pitch, found=a.says(LATTICE.pitch),
                      allowed="one length", hint='kind = "rectangular" takes two')  # fmt: skip
    second = a(LATTICE.pitch_2)
    if second is not None and kind != "rectangular" and second[0] != second[1]:
        yield Mistake("CL116", f"a {kind} lattice has one pitch", LATTICE.pitch_2, found=a.says(LATTICE.pitch_2),
                      allowed="one length", hint='kind = "rectangular" takes two')  # fmt: skip
    if second is not None and any(
        not 0.5 <= one / other <= 2.0 for one, other in zip(second, pitch, strict=True)
    ):
        yield Mistake("CL106", f"{a.says(LATTICE.pitch_2)} is out of range", LATTICE.pitch_2,
                      allowed="half to twice lattice.pitch")  # fmt: skip
    if a.unit is not None and min(pitch) * float(a.unit.metres) < SMALLEST_PITCH_M:
        metres = min(pitch) * float(a.unit.metres)
        yield Mistake("CL115", f"{a.says(LATTICE.pitch)} is {metres * 1e6:.3g} um: below the wavelength of light",
                      LATTICE.pitch, allowed="0.1 um and above",
                      hint=f'check unit = "{a.unit.name}"')  # fmt: skip


def seam_leaves_a_lens(a: Asked) -> Iterator[Mistake]:
    """The seam must be narrower than the cell, and lenslets must be joined."""
    seam, pitch = a(LATTICE.seam), a(LATTICE.pitch)
    if seam and pitch is not None and seam >= min(pitch):
        yield Mistake("CL117", f"{a.says(LATTICE.seam)} leaves no lens in a cell of {a.says(LATTICE.pitch)}",
                      LATTICE.seam, allowed=f"below the pitch, {min(pitch):g}")  # fmt: skip
    if seam and a(PAIR.form) == "biconvex" and a.given(PAIR.web) and a(PAIR.web) == 0.0:
        yield Mistake("CL117", "web = 0 with a seam: nothing would join the lenslets", PAIR.web,
                      allowed="a length > 0, or leave pair.web out for the neck thickness",
                      found=f"{a.says(PAIR.web)} and {a.says(LATTICE.seam)}")  # fmt: skip


def outline_holds_a_cell(a: Asked) -> Iterator[Mistake]:
    """An outline must contain a whole cell; the positions of cells depend on their count."""
    outline, pitch = a(LATTICE.outline), a(LATTICE.pitch)
    kind, count = a(LATTICE.kind), a(LATTICE.count)
    if outline is None or pitch is None or kind is None or count is None:
        return
    if outline.shape in ("polygon", "dxf"):
        return  # polygons and their holes are checked when the cells are placed
    if max(count) > MOST_CUT:
        yield Mistake("CL106", f"{a.says(LATTICE.count)} is out of range where an outline cuts", LATTICE.count,
                      allowed=f"up to {MOST_CUT} each way with lattice.outline, which keeps the cells within it alone")  # fmt: skip
        return
    from clacad.sheet.lattice import Circle, Lattice, Rectangle

    shape, size = outline.shape, outline.size
    lattice = Lattice(kind, pitch, count, Circle(size[0]) if shape == "circle" else Rectangle(*size))
    if lattice.holds_a_cell:
        return
    least = lattice.least_outline()
    sides = (least.diameter,) if isinstance(least, Circle) else (least.width, least.height)
    need = ", ".join(map(rounded_up, sides))
    yield Mistake("CL117", f"{a.says(LATTICE.outline)} holds no cell of {count[0]} x {count[1]}", LATTICE.outline,
                  allowed=f"{shape} of at least {need if len(sides) == 1 else f'[{need}]'}, round the cell nearest to the middle",
                  hint="" if kind == "hexagonal" or all(n % 2 for n in count) else
                  "with an odd lattice.count a cell lies in the middle")  # fmt: skip


def count_or_outline(a: Asked) -> Iterator[Mistake]:
    """The number of cells must be given, or follow from the outline."""
    if a.given(LATTICE.count) or not any(key.startswith("lattice.") for key in a.written):
        return
    if not a.given(LATTICE.outline):
        yield Mistake("CL103", "missing key lattice.count", LATTICE.count,
                      allowed=f"a whole number from 1 to {LARGEST_COUNT}, or [n1, n2]; or leave it to lattice.outline, which is then "
                      "filled")  # fmt: skip
        return
    outline, pitch, kind = a(LATTICE.outline), a(LATTICE.pitch), a(LATTICE.kind)
    if outline is None or pitch is None or kind is None or outline.shape == "dxf":
        return
    most = max(across / along for across, along in zip(outline.box, pitch, strict=True))
    if most > LARGEST_COUNT / 2:  # rows of hexagons are closer than the pitch
        yield Mistake("CL117", f"{a.says(LATTICE.outline)} is {most:.3g} cells wide", LATTICE.outline,
                      allowed=f"at most {LARGEST_COUNT / 2:.3g} cells",
                      hint="a smaller outline or a larger pitch")  # fmt: skip


def outline_is_simple(a: Asked) -> Iterator[Mistake]:
    """A polygon must enclose an area, and its sides must not intersect."""
    for key in (LATTICE.outline, BODY.outline):
        outline = a(key)
        if outline is None or outline.shape != "polygon":
            continue
        from clacad.sheet.simple_outline import fault

        why = fault(outline.points)
        if why:
            yield Mistake("CL141", f"{key} is no outline: {why}", key,
                          allowed="corners of a closed polygon in order, the first not repeated, whose sides meet at corners alone")  # fmt: skip


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
            yield Mistake("CL113", f"{key} needs land round the cells", key,
                          allowed="body.border > 0, body.outline or lattice.outline")  # fmt: skip
    if a(BODY.corners) and shape != "rectangle":
        yield Mistake("CL114", f"body.corners does not belong to a {shape}", BODY.corners,
                      allowed="a rectangular plate: body.outline or lattice.outline = {rectangle = ...}, or body.border alone",
                      hint="give a polygon's corners themselves: [x, y, bulge] bends a side")  # fmt: skip
    if a(BODY.pins) and a(PAIR.form) == "slab":
        yield Mistake("CL114", "body.pins does not belong to a slab: it is one body", BODY.pins,
                      allowed='pair.form = "biconvex" | "plano"', hint="leave it out")  # fmt: skip
    for n in range(len(a(BODY.holes) or ())):
        yield from _one_way_to_place(a.written[BODY.holes][n], n, shape)


def _one_way_to_place(hole: dict[str, Any], n: int, shape: str) -> Iterator[Mistake]:
    """Holes need exactly one of points, a circle and the corners."""
    ways = [key for key in ("at", "circle", "corners") if key in hole]
    key = f"{BODY.holes}.{n}"
    if len(ways) != 1:
        yield Mistake("CL112" if ways else "CL103", f"body.holes[{n}] says {'two ways' if ways else 'nothing'} of where its holes are",
                      key, allowed="exactly one of at = [[x, y], ...], circle = diameter with count, corners = distance from both sides")  # fmt: skip
    elif ways == ["circle"] and "count" not in hole:
        yield Mistake(
            "CL103",
            f"body.holes[{n}] lacks the key count",
            key,
            allowed="count = a whole number from 1 to 360",
        )
    elif ways != ["circle"] and {"count", "start"} & set(hole):
        yield Mistake("CL113", f"body.holes[{n}]: count and start belong to circle", key, allowed="circle = a length > 0, or leave them out")  # fmt: skip
    if ways == ["corners"] and shape != "rectangle":
        yield Mistake("CL114", f"body.holes[{n}].corners does not belong to a {shape}", key,
                      allowed="at = [[x, y], ...], or circle = diameter with count")  # fmt: skip


def baffle_has_walls(a: Asked) -> Iterator[Mistake]:
    """A baffle needs its wall thickness, thinner than a cell; a wall needs a baffle."""
    wall, pitch = a(BODY.baffle_wall), a(LATTICE.pitch)
    if a(BODY.baffle) and not a.given(BODY.baffle_wall):
        yield Mistake("CL113", "body.baffle = true needs body.baffle_wall", BODY.baffle,
                      allowed="baffle_wall = a length > 0, below the pitch")  # fmt: skip
    if a.given(BODY.baffle_wall) and a(BODY.baffle) is False:
        yield Mistake("CL113", "body.baffle_wall needs body.baffle = true", BODY.baffle_wall,
                      allowed="baffle = true, or leave baffle_wall out")  # fmt: skip
    if wall is not None and pitch is not None and wall >= min(pitch):
        yield Mistake("CL117", f"{a.says(BODY.baffle_wall)} closes the channels", BODY.baffle_wall,
                      allowed=f"below the pitch, {min(pitch):g}")  # fmt: skip


def varying_law_has_lenses(a: Asked) -> Iterator[Mistake]:
    """δ varies only along axes with power; a table replaces delta; a magnification determines eta."""
    spec, eta, separation = a(LAW.varying), a(LAW.eta), a(PAIR.separation)
    if spec is None or eta is None:
        return
    if spec.table is not None and any(a(LAW.delta) or ()):
        yield Mistake("CL112", "law.delta and a table of cells exclude each other: the table has the delta of every cell",
                      LAW.delta, found=a.says(LAW.delta), allowed="leave it out")  # fmt: skip
    if 1.0 in eta:
        yield Mistake("CL111", "eta = 1 with a delta that varies: a lens without power has no axis to offset", LAW.varying,
                      allowed="eta other than 1 in both x and y")  # fmt: skip
    if separation is None:
        if spec.conjugates is not None and a(PAIR.form) == "slab" and a.given(PAIR.thickness):
            yield Mistake("CL113", "law.varying.conjugates needs pair.separation", PAIR.separation,
                          allowed="separation = T/n instead of thickness = T")  # fmt: skip
        return
    wanted = None if spec.conjugates is None else needed_eta(spec.conjugates, separation)
    if wanted is not None and any(abs(e - w) > MAGNIFIED * abs(w) for e, w in zip(eta, wanted, strict=True)):
        needed = ", ".join(repr(w) for w in wanted)
        yield Mistake("CL112", "law.eta and the magnification exclude each other", LAW.eta, found=a.says(LAW.eta),
                      allowed=f"eta = [{needed}]", hint="or leave magnification out: then it is as eta makes it")  # fmt: skip
    rows = gradient_of(spec, eta, separation)
    if rows is not None and not all(abs(v) < 1e9 for row in rows for v in row):
        yield Mistake("CL106", "the gradient of delta is out of range", LAW.varying,
                      allowed="planes farther from the sheet")  # fmt: skip


def focus_has_planes(a: Asked) -> Iterator[Mistake]:
    """At least one plane must be finite; both meridians need power;
    two pitch ratios must lie along the cells.
    """
    planes, eta, euler = a(PAIR.focus), a(LAW.eta), a(LAW.euler)
    if planes is None or eta is None:
        return
    if isinf(planes.object) and isinf(planes.image):
        yield Mistake("CL113", "pair.focus with both planes at infinity: parallel light that leaves parallel is the afocal pair",
                      PAIR.focus, allowed='a finite object or image, or "afocal"')  # fmt: skip
    if 1.0 in eta:
        yield Mistake("CL111", "eta = 1 with pair.focus: a lens without power focuses nothing", PAIR.focus,
                      allowed="eta other than 1 in both x and y")  # fmt: skip
    if eta[0] == eta[1]:
        return
    if a(LATTICE.kind) == "hexagonal":
        yield Mistake("CL116", "eta_x and eta_y differ: with pair.focus array 2 needs two pitches, and a hexagonal lattice has one",
                      LATTICE.kind, allowed="square | rectangular", hint="eta_x = eta_y")  # fmt: skip
    if euler is not None and (angle := euler[0] + euler[2]) % 90.0:
        yield Mistake("CL125", f"lenses turned by {angle:g} deg with eta_x and eta_y that differ: with pair.focus array 2's cells would "
                      "be sheared", f"{LAW.euler}.0", allowed="phi + psi = 0 deg, or a multiple of 90 deg", hint="eta_x = eta_y")  # fmt: skip


def sheet_is_built(a: Asked) -> Iterator[Mistake]:
    """Refuse features that cannot be combined with the requested non-uniform sheet."""
    for sheet in built_sheets(a):
        for feature in FEATURES:
            reason = why_not(sheet, feature.name)
            if reason and feature.present(a):
                yield Mistake("CL125", f"{feature.key} with {sheet}: {reason}", feature.key, allowed="one of the two",
                              hint=feature.instead)  # fmt: skip


RULES: Final[tuple[Rule, ...]] = (
    law_is_a_pair,
    lens_faces_forward,
    separation_or_thickness,
    keys_of_other_forms,
    index_or_material,
    material_is_known,
    worked_materials_are_known,
    surface_and_its_keys,
    faces_stand_alone,
    faces_are_of_the_form,
    field_lens_has_a_focus,
    field_lens_is_made,
    pitch_fits_lattice,
    seam_leaves_a_lens,
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
