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
from clacad.design.given_faces import faces_read
from clacad.design.plate_keys import box_about_origin
from clacad.design.varying import MAGNIFIED, gradient_of, needed_eta, varying_read

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
    eta, delta = a("law.eta"), a("law.delta")
    if eta is None:
        return
    for i, axis in enumerate("xy"):
        if eta[i] == 0.0:
            yield Mistake("CL110", f"eta_{axis} = 0: no pair of lenses has it", f"law.eta.{i}",
                          allowed="any other number; |eta| < 1 shrinks what is seen, eta < 0 turns it over",
                          hint=f"eta_{axis} = -1 sends light on under minus the angle it came in")  # fmt: skip
        elif 0.0 < abs(eta[i]) < 1e-6:
            yield Mistake("CL106", f"eta_{axis} = {eta[i]!r} is out of range", f"law.eta.{i}",
                          allowed="1e-6 <= |eta| <= 1e6")  # fmt: skip
    if eta[0] == 1.0 and eta[1] == 1.0:
        yield Mistake("CL110", "eta = 1 in both x and y: the sheet would be a plain window", "law.eta",
                      allowed="eta = 1 in at most one of x and y (a cylindrical sheet)")  # fmt: skip
    elif delta is not None:
        for i, axis in enumerate("xy"):
            if eta[i] == 1.0 and delta[i] != 0.0:
                yield Mistake("CL111", f"eta_{axis} = 1 with delta_{axis} = {delta[i]:g}: a lens without power has "
                              "no axis to offset", f"law.delta.{i}", allowed=f"delta_{axis} = 0, or eta_{axis} other than 1")  # fmt: skip


def lens_faces_forward(a: Asked) -> Iterator[Mistake]:
    """The lens axis must point through the sheet: |θ| < 90°."""
    euler = a("law.euler")
    if euler is not None and abs(euler[1]) >= 90.0:
        yield Mistake("CL106", f"theta = {euler[1]:g} deg turns the lens axis out of the forward half", "law.euler.1",
                      allowed="-90 deg < theta < 90 deg")  # fmt: skip


def separation_or_thickness(a: Asked) -> Iterator[Mistake]:
    """A slab has exactly one of separation and thickness; the other forms need the separation."""
    form, thickness = a("pair.form"), a("pair.thickness")
    if form == "slab":
        number = a.given("pair.thickness") and thickness != "auto"
        if a.given("pair.separation") and number and thickness is not None:
            yield Mistake("CL112", "a slab takes either separation or thickness, not both", "pair.thickness",
                          found=f"{a.says('pair.separation')} and {a.says('pair.thickness')}",
                          allowed="separation = T/n, or thickness = T")  # fmt: skip
        if not a.given("pair.separation") and not number:
            yield Mistake("CL103", "a slab needs its separation or its thickness", "pair.separation",
                          allowed="separation = T/n, or thickness = T (exactly one)")  # fmt: skip
        if isinstance(a.written.get("pair.thickness"), list) and thickness is not None:
            yield Mistake("CL108", f"{a.says('pair.thickness')}: a slab is one body with one thickness",
                          "pair.thickness", allowed="one length")  # fmt: skip
    elif form in ("biconvex", "plano") and not a.given("pair.separation"):
        what = "centre to centre" if form == "biconvex" else "f1 + f2 in air"
        yield Mistake("CL103", f"missing key pair.separation: a {form} pair needs it", "pair.separation",
                      allowed=f"a length > 0 ({what})")  # fmt: skip


def keys_of_other_forms(a: Asked) -> Iterator[Mistake]:
    """Refuse keys that belong to other forms: web, curved, seam_depth, the thin recipe, a baffle."""
    form = a("pair.form")
    if form is None:
        return
    for key, forms in (
        ("pair.curved", ("plano",)),
        ("lattice.seam_depth", ("plano", "slab")),
    ):
        if a.given(key) and form not in forms:
            yield Mistake("CL114", f"{key} does not belong to a {form} pair", key,
                          allowed=f"only with pair.form = {' | '.join(shown(f) for f in forms)}", hint="leave it out")  # fmt: skip
    if form != "biconvex" and a("pair.web"):
        yield Mistake("CL114", f"pair.web does not belong to a {form} pair: its body holds together by itself",
                      "pair.web", allowed='only with pair.form = "biconvex"', hint="leave it out")  # fmt: skip
    if form == "slab" and a("pair.confocal") == "thin":
        yield Mistake("CL114", f"{a.says('pair.confocal')} does not belong to a slab", "pair.confocal",
                      allowed='"exact": a slab is afocal by construction; or "best": radii for the least error')  # fmt: skip
    if form == "slab" and a("tolerances.separation"):
        yield Mistake("CL114", "tolerances.separation does not belong to a slab: its separation is its thickness",
                      "tolerances.separation", allowed="tolerances.thickness", hint="leave it out")  # fmt: skip
    if form == "slab" and a("body.baffle"):
        yield Mistake("CL114", "a slab has no room for a baffle between its faces", "body.baffle",
                      allowed='false, or pair.form = "biconvex" | "plano"')  # fmt: skip


def index_or_material(a: Asked) -> Iterator[Mistake]:
    """Require exactly one of index and material."""
    if a.given("pair.index") and a.given("pair.material"):
        yield Mistake("CL112", "index and material exclude each other", "pair.material",
                      found=f"{a.says('pair.index')} and {a.says('pair.material')}", allowed="exactly one of them")  # fmt: skip
    elif not a.given("pair.index") and not a.given("pair.material"):
        yield Mistake("CL103", "missing key pair.index (or pair.material)", "pair.index",
                      allowed='index = a number > 1, or material = a name such as "PMMA"')  # fmt: skip


def material_is_known(a: Asked) -> Iterator[Mistake]:
    """The material must be in the table, and its index known at the design wavelength."""
    name, wavelength = a("pair.material"), a("pair.wavelength")
    if name is None:
        return
    from clacad.optics.material.catalogue import find

    try:
        material = find(name)
    except ValueError as problem:
        sentence, _, hint = str(problem).partition("; ")
        yield Mistake(
            "CL119", sentence, "pair.material", allowed="a name of the table, or pair.index", hint=hint
        )
        return
    if wavelength is not None:
        try:
            material.index(wavelength)
        except ValueError as problem:
            key = "pair.wavelength" if a.given("pair.wavelength") else "pair.material"
            yield Mistake("CL119", str(problem), key, allowed="a wavelength in that range, or pair.index")


def worked_materials_are_known(a: Asked) -> Iterator[Mistake]:
    """The materials of `check.materials` must be in the table."""
    asked = a("check.materials")
    if not asked:
        return
    from clacad.optics.material.catalogue import find

    for name in asked:
        try:
            find(name)
        except ValueError as problem:
            sentence, _, hint = str(problem).partition("; ")
            yield Mistake("CL119", sentence, "check.materials", allowed="names of the table", hint=hint)


def surface_and_its_keys(a: Asked) -> Iterator[Mistake]:
    """Conic belongs to a biconic, depth to an ellipsoid; a biconvex biconic needs its conic."""
    surface = a("pair.surface")
    if surface == "ellipsoid" and a.given("pair.conic"):
        yield Mistake("CL113", "pair.conic needs surface = \"biconic\"", "pair.conic",
                      allowed='surface = "biconic", or pair.depth to shape an ellipsoid')  # fmt: skip
    if surface == "biconic" and a.given("pair.depth"):
        yield Mistake("CL113", "pair.depth needs surface = \"ellipsoid\"", "pair.depth",
                      allowed='surface = "ellipsoid", or pair.conic to shape a biconic')  # fmt: skip
    if surface == "biconic" and a("pair.form") == "biconvex" and not a.given("pair.conic"):
        yield Mistake("CL113", "a biconvex pair of biconics needs pair.conic: no conic is right by itself",
                      "pair.surface", allowed="conic = [K_x, K_y]", hint="conic = [0.0, 0.0] gives circular profiles")  # fmt: skip


def faces_stand_alone(a: Asked) -> Iterator[Mistake]:
    """Given faces need prescription = "given", and exclude the keys of the recipes."""
    given = a("pair.prescription") == "given"
    for key in ("pair.face", "pair.vertex", "pair.search"):
        if a.given(key) and a("pair.prescription") == "derived":
            yield Mistake("CL113", f'{key} needs pair.prescription = "given"', key,
                          allowed='prescription = "given", or leave it out')  # fmt: skip
    if not given:
        return
    for key in ("pair.confocal", "pair.surface", "pair.conic", "pair.depth"):
        if a.given(key):
            yield Mistake("CL112", f"{key} and given faces exclude each other: the faces stand as they are", key,
                          found=a.says(key), allowed="leave it out", hint='or prescription = "derived" without pair.face')  # fmt: skip
    if a("pair.form") in ("biconvex", "plano") and a("pair.thickness") == "auto":
        yield Mistake("CL113", "given faces need their thickness: it fixes where their vertices lie", "pair.thickness",
                      found=a.says("pair.thickness"), allowed="a length > 0, or [lens 1, lens 2]")  # fmt: skip


def faces_are_of_the_form(a: Asked) -> Iterator[Mistake]:
    """A slab has two faces, the other forms four; the plane sides of plano lenses are flat."""
    form, faces = a("pair.form"), a("pair.face")
    if a("pair.prescription") != "given" or form is None or faces is None:
        return
    eta, lensed = a("law.eta"), bool(a("pair.field_lens"))
    in_three = lensed and form == "slab" and eta is not None and eta[0] != eta[1]
    wanted = (2 if form == "slab" else 4) + 2 * lensed + 2 * in_three
    if len(faces) != wanted:
        what = f"a {form} pair" + (" with a field lens" if lensed else "")
        yield Mistake("CL108", f"{len(faces)} given faces: {what} has {wanted}", "pair.face",
                      allowed=f"{wanted} tables [[pair.face]], in the order light meets them")  # fmt: skip
    elif form == "plano" or in_three:
        last = len(faces) - 1
        for k in (1, last - 1) if a("pair.curved") != "inside" else (0, last):
            if not faces_read([faces[k]])[0].plane:
                yield Mistake("CL114", f"pair.face[{k}] is the plane side of a plano lens", f"pair.face.{k}.radius",
                              allowed="radius = inf and nothing else", hint='form = "biconvex" bends both sides')  # fmt: skip


def field_lens_has_a_focus(a: Asked) -> Iterator[Mistake]:
    """A field lens needs a real common focus: η < 0 in both meridians."""
    eta = a("law.eta")
    if not a("pair.field_lens") or eta is None:
        return
    for i, axis in enumerate("xy"):
        if eta[i] > 0.0:
            where = "there is none" if eta[i] == 1.0 else "it is virtual"
            yield Mistake("CL126", f"eta_{axis} = {eta[i]:g}: a field lens stands at the common focus, and {where}",
                          "pair.field_lens", allowed="false, or eta < 0 in both x and y",
                          hint=f"eta_{axis} = {-eta[i]:g}, or pair.field_lens = false")  # fmt: skip


def field_lens_is_made(a: Asked) -> Iterator[Mistake]:
    """A tilt needs a biconvex pair; separate foci need cells along the lens axes;
    keys of a field lens need one.
    """
    if a.given("pair.field") and a("pair.field_lens") is False:
        yield Mistake("CL113", "pair.field needs pair.field_lens = true", "pair.field",
                      allowed="field_lens = true, or leave it out")  # fmt: skip
    form, eta, euler = a("pair.form"), a("law.eta"), a("law.euler")
    if not a("pair.field_lens") or form is None or eta is None or euler is None:
        return
    if euler[1] != 0.0 and form != "biconvex":
        yield Mistake("CL127", f"theta = {euler[1]:g} deg: a field lens of a tilted {form} pair is not made", "law.euler.1",
                      allowed="theta = 0", hint='pair.form = "biconvex", or theta = 0')  # fmt: skip
    if eta[0] != eta[1]:
        if a("lattice.kind") == "hexagonal":
            yield Mistake("CL127", "eta_x and eta_y differ: the field lens is two arrays of cylinders, which hexagonal cells "
                          "would cut across", "lattice.kind", allowed="square | rectangular", hint="eta_x = eta_y")  # fmt: skip
        if (angle := euler[0] + euler[2]) % 90.0:
            yield Mistake("CL127", f"lenses turned by {angle:g} deg with eta_x and eta_y that differ: cells would cut across "
                          "the cylinders of the field lens", "law.euler.0", allowed="phi + psi = 0 deg, or a multiple of 90 deg",
                          hint="eta_x = eta_y, or lenses along the cells")  # fmt: skip
        if euler[1] != 0.0 and form == "biconvex":
            yield Mistake("CL127", f"theta = {euler[1]:g} deg with eta_x and eta_y that differ: the cylinders of the field lens "
                          "would fall into steps", "law.euler.1", allowed="theta = 0", hint="eta_x = eta_y, or theta = 0")  # fmt: skip
        if a("body.baffle") and form != "slab":
            yield Mistake("CL127", "eta_x and eta_y differ: between the two arrays of cylinders light would change its cell "
                          "inside the glass of their plate, where no wall of a baffle can stand", "body.baffle", allowed="false",
                          hint="eta_x = eta_y, or no baffle")  # fmt: skip
    if has_plate(a):
        yield Mistake("CL127", "a field lens in a plate of holes, corners, pins or a polygon is not made", "pair.field_lens",
                      allowed="false, or plain edges", hint="a circle or a rectangle is made")  # fmt: skip
    if "gap" in dict(a("pair.field") or ()) and form != "slab":
        yield Mistake("CL114", f"pair.field.gap does not belong to a {form} pair", "pair.field",
                      allowed='only with pair.form = "slab"', hint="leave it out")  # fmt: skip


def pitch_fits_lattice(a: Asked) -> Iterator[Mistake]:
    """Square and hexagonal cells have one pitch, rectangular ones two."""
    kind, pitch, written = a("lattice.kind"), a("lattice.pitch"), a.written.get("lattice.pitch")
    if kind is None or pitch is None:
        return
    if kind == "rectangular" and not isinstance(written, list | tuple):
        yield Mistake("CL116", "a rectangular lattice needs two pitches", "lattice.pitch",
                      found=a.says("lattice.pitch"), allowed="[x, y]",
                      hint=f'write [{shown(written)}, {shown(written)}], or kind = "square"')  # fmt: skip
    if kind != "rectangular" and pitch[0] != pitch[1]:
        yield Mistake("CL116", f"a {kind} lattice has one pitch", "lattice.pitch", found=a.says("lattice.pitch"),
                      allowed="one length", hint='kind = "rectangular" takes two')  # fmt: skip
    second = a("lattice.pitch_2")
    if second is not None and kind != "rectangular" and second[0] != second[1]:
        yield Mistake("CL116", f"a {kind} lattice has one pitch", "lattice.pitch_2", found=a.says("lattice.pitch_2"),
                      allowed="one length", hint='kind = "rectangular" takes two')  # fmt: skip
    if second is not None and any(
        not 0.5 <= one / other <= 2.0 for one, other in zip(second, pitch, strict=True)
    ):
        yield Mistake("CL106", f"{a.says('lattice.pitch_2')} is out of range", "lattice.pitch_2",
                      allowed="half to twice lattice.pitch")  # fmt: skip
    if a.unit is not None and min(pitch) * float(a.unit.metres) < SMALLEST_PITCH_M:
        metres = min(pitch) * float(a.unit.metres)
        yield Mistake("CL115", f"{a.says('lattice.pitch')} is {metres * 1e6:.3g} um: below the wavelength of light",
                      "lattice.pitch", allowed="0.1 um and above",
                      hint=f'check unit = "{a.unit.name}"')  # fmt: skip


def seam_leaves_a_lens(a: Asked) -> Iterator[Mistake]:
    """The seam must be narrower than the cell, and lenslets must be joined."""
    seam, pitch = a("lattice.seam"), a("lattice.pitch")
    if seam and pitch is not None and seam >= min(pitch):
        yield Mistake("CL117", f"{a.says('lattice.seam')} leaves no lens in a cell of {a.says('lattice.pitch')}",
                      "lattice.seam", allowed=f"below the pitch, {min(pitch):g}")  # fmt: skip
    if seam and a("pair.form") == "biconvex" and a.given("pair.web") and a("pair.web") == 0.0:
        yield Mistake("CL117", "web = 0 with a seam: nothing would join the lenslets", "pair.web",
                      allowed="a length > 0, or leave pair.web out for the neck thickness",
                      found=f"{a.says('pair.web')} and {a.says('lattice.seam')}")  # fmt: skip


def outline_holds_a_cell(a: Asked) -> Iterator[Mistake]:
    """An outline must contain a whole cell; the positions of cells depend on their count."""
    outline, pitch, kind, count = (a(f"lattice.{key}") for key in ("outline", "pitch", "kind", "count"))
    if outline is None or pitch is None or kind is None or count is None:
        return
    if outline[0][0] in ("polygon", "dxf"):
        return  # polygons and their holes are checked when the cells are placed
    if max(count) > MOST_CUT:
        yield Mistake("CL106", f"{a.says('lattice.count')} is out of range where an outline cuts", "lattice.count",
                      allowed=f"up to {MOST_CUT} each way with lattice.outline, which keeps the cells within it alone")  # fmt: skip
        return
    from clacad.sheet.lattice import Circle, Lattice, Rectangle

    shape, size = outline[0]
    lattice = Lattice(kind, pitch, count, Circle(size) if shape == "circle" else Rectangle(*size))
    if lattice.holds_a_cell:
        return
    least = lattice.least_outline()
    sides = (least.diameter,) if isinstance(least, Circle) else (least.width, least.height)
    need = ", ".join(map(rounded_up, sides))
    yield Mistake("CL117", f"{a.says('lattice.outline')} holds no cell of {count[0]} x {count[1]}", "lattice.outline",
                  allowed=f"{shape} of at least {need if len(sides) == 1 else f'[{need}]'}, round the cell nearest to the middle",
                  hint="" if kind == "hexagonal" or all(n % 2 for n in count) else
                  "with an odd lattice.count a cell lies in the middle")  # fmt: skip


def count_or_outline(a: Asked) -> Iterator[Mistake]:
    """The number of cells must be given, or follow from the outline."""
    if a.given("lattice.count") or not any(key.startswith("lattice.") for key in a.written):
        return
    if not a.given("lattice.outline"):
        yield Mistake("CL103", "missing key lattice.count", "lattice.count",
                      allowed=f"a whole number from 1 to {LARGEST_COUNT}, or [n1, n2]; or leave it to lattice.outline, which is then "
                      "filled")  # fmt: skip
        return
    outline, pitch, kind = a("lattice.outline"), a("lattice.pitch"), a("lattice.kind")
    if outline is None or pitch is None or kind is None or outline[0][0] == "dxf":
        return
    shape, size = outline[0]
    size = (size, size) if shape == "circle" else size if shape == "rectangle" else box_about_origin(size)
    most = max(across / along for across, along in zip(size, pitch, strict=True))
    if most > LARGEST_COUNT / 2:  # rows of hexagons are closer than the pitch
        yield Mistake("CL117", f"{a.says('lattice.outline')} is {most:.3g} cells wide", "lattice.outline",
                      allowed=f"at most {LARGEST_COUNT / 2:.3g} cells",
                      hint="a smaller outline or a larger pitch")  # fmt: skip


def outline_is_simple(a: Asked) -> Iterator[Mistake]:
    """A polygon must enclose an area, and its sides must not intersect."""
    for key in ("lattice.outline", "body.outline"):
        outline = a(key)
        if outline is None or outline[0][0] != "polygon":
            continue
        from clacad.sheet.simple_outline import fault

        why = fault(outline[0][1])
        if why:
            yield Mistake("CL141", f"{key} is no outline: {why}", key,
                          allowed="corners of a closed polygon in order, the first not repeated, whose sides meet at corners alone")  # fmt: skip


def one_edge(a: Asked) -> Iterator[Mistake]:
    """The edge of the plate is that of the cells, a border around them, or its own outline."""
    cells, plate, border = a("lattice.outline"), a("body.outline"), a("body.border")
    if border and plate is not None:
        yield Mistake(
            "CL112",
            "body.border and body.outline both say where the plate ends",
            "body.border",
            allowed="one of the two",
            hint="leave body.border out",
        )
    elif border and cells is not None and cells[0][0] in ("polygon", "dxf"):
        yield Mistake(
            "CL114",
            f"body.border does not belong to a {cells[0][0]}",
            "body.border",
            allowed="lattice.outline = {circle = ...} or {rectangle = ...}, or no border",
            hint="body.outline = {...} is the edge of a plate round a polygon of cells",
        )


def plate_has_a_border(a: Asked) -> Iterator[Mistake]:
    """Corners, holes and pins need land around the cells, and a shape that can have them."""
    outline, border = a("body.outline") or a("lattice.outline"), a("body.border")
    shape = "rectangle" if outline is None else outline[0][0]
    for key in ("body.corners", "body.holes", "body.pins"):
        if a(key) and outline is None and not border:
            yield Mistake("CL113", f"{key} needs land round the cells", key,
                          allowed="body.border > 0, body.outline or lattice.outline")  # fmt: skip
    if a("body.corners") and shape != "rectangle":
        yield Mistake("CL114", f"body.corners does not belong to a {shape}", "body.corners",
                      allowed="a rectangular plate: body.outline or lattice.outline = {rectangle = ...}, or body.border alone",
                      hint="give a polygon's corners themselves: [x, y, bulge] bends a side")  # fmt: skip
    if a("body.pins") and a("pair.form") == "slab":
        yield Mistake("CL114", "body.pins does not belong to a slab: it is one body", "body.pins",
                      allowed='pair.form = "biconvex" | "plano"', hint="leave it out")  # fmt: skip
    for n, table in enumerate(a("body.holes") or ()):
        yield from _one_way_to_place(dict(table), n, shape)


def _one_way_to_place(hole: dict[str, Any], n: int, shape: str) -> Iterator[Mistake]:
    """Holes need exactly one of points, a circle and the corners."""
    ways = [key for key in ("at", "circle", "corners") if key in hole]
    key = f"body.holes.{n}"
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
    wall, pitch = a("body.baffle_wall"), a("lattice.pitch")
    if a("body.baffle") and not a.given("body.baffle_wall"):
        yield Mistake("CL113", "body.baffle = true needs body.baffle_wall", "body.baffle",
                      allowed="baffle_wall = a length > 0, below the pitch")  # fmt: skip
    if a.given("body.baffle_wall") and a("body.baffle") is False:
        yield Mistake("CL113", "body.baffle_wall needs body.baffle = true", "body.baffle_wall",
                      allowed="baffle = true, or leave baffle_wall out")  # fmt: skip
    if wall is not None and pitch is not None and wall >= min(pitch):
        yield Mistake("CL117", f"{a.says('body.baffle_wall')} closes the channels", "body.baffle_wall",
                      allowed=f"below the pitch, {min(pitch):g}")  # fmt: skip


def varying_law_has_lenses(a: Asked) -> Iterator[Mistake]:
    """δ varies only along axes with power; a table replaces delta; a magnification determines eta."""
    read, eta, separation = a("law.varying"), a("law.eta"), a("pair.separation")
    if read is None or eta is None:
        return
    spec = varying_read(read)
    if spec.table is not None and any(a("law.delta") or ()):
        yield Mistake("CL112", "law.delta and a table of cells exclude each other: the table has the delta of every cell",
                      "law.delta", found=a.says("law.delta"), allowed="leave it out")  # fmt: skip
    if 1.0 in eta:
        yield Mistake("CL111", "eta = 1 with a delta that varies: a lens without power has no axis to offset", "law.varying",
                      allowed="eta other than 1 in both x and y")  # fmt: skip
    if separation is None:
        if spec.conjugates is not None and a("pair.form") == "slab" and a.given("pair.thickness"):
            yield Mistake("CL113", "law.varying.conjugates needs pair.separation", "pair.separation",
                          allowed="separation = T/n instead of thickness = T")  # fmt: skip
        return
    wanted = None if spec.conjugates is None else needed_eta(spec.conjugates, separation)
    if wanted is not None and any(abs(e - w) > MAGNIFIED * abs(w) for e, w in zip(eta, wanted, strict=True)):
        needed = ", ".join(repr(w) for w in wanted)
        yield Mistake("CL112", "law.eta and the magnification exclude each other", "law.eta", found=a.says("law.eta"),
                      allowed=f"eta = [{needed}]", hint="or leave magnification out: then it is as eta makes it")  # fmt: skip
    rows = gradient_of(spec, eta, separation)
    if rows is not None and not all(abs(v) < 1e9 for row in rows for v in row):
        yield Mistake("CL106", "the gradient of delta is out of range", "law.varying",
                      allowed="planes farther from the sheet")  # fmt: skip


def focus_has_planes(a: Asked) -> Iterator[Mistake]:
    """At least one plane must be finite; both meridians need power;
    two pitch ratios must lie along the cells.
    """
    read, eta, euler = a("pair.focus"), a("law.eta"), a("law.euler")
    if read in (None, "afocal") or eta is None:
        return
    planes = dict(read)
    if isinf(planes["object"]) and isinf(planes["image"]):
        yield Mistake("CL113", "pair.focus with both planes at infinity: parallel light that leaves parallel is the afocal pair",
                      "pair.focus", allowed='a finite object or image, or "afocal"')  # fmt: skip
    if 1.0 in eta:
        yield Mistake("CL111", "eta = 1 with pair.focus: a lens without power focuses nothing", "pair.focus",
                      allowed="eta other than 1 in both x and y")  # fmt: skip
    if eta[0] == eta[1]:
        return
    if a("lattice.kind") == "hexagonal":
        yield Mistake("CL116", "eta_x and eta_y differ: with pair.focus array 2 needs two pitches, and a hexagonal lattice has one",
                      "lattice.kind", allowed="square | rectangular", hint="eta_x = eta_y")  # fmt: skip
    if euler is not None and (angle := euler[0] + euler[2]) % 90.0:
        yield Mistake("CL125", f"lenses turned by {angle:g} deg with eta_x and eta_y that differ: with pair.focus array 2's cells would "
                      "be sheared", "law.euler.0", allowed="phi + psi = 0 deg, or a multiple of 90 deg", hint="eta_x = eta_y")  # fmt: skip


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
