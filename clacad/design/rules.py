"""Rules of [law] and [pair] that need more than one key but no solved lens.
Each rule yields its mistakes; all rules always run, see `clacad.design.sheet_rules.broken`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from clacad.base.units import Unit
from clacad.config.mistakes import Mistake
from clacad.config.value_kinds import shown
from clacad.design.faces import AIR
from clacad.design.sections import BODY, CHECK, LATTICE, LAW, LIGHT, PAIR, TOLERANCES, LightSpec


@dataclass(frozen=True, slots=True)
class Asked:
    """Values read so far.

    values : mapping of dotted key to converted value
        Includes defaults; keys whose value was refused are absent.
    written : mapping of dotted key to value as written. For messages.
    unit : Unit or None. None if the unit itself was refused: rules about absolute sizes are skipped.
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
            yield Mistake(
                "CL110",
                f"eta_{axis} = 0: no pair of lenses has it",
                f"{LAW.eta}.{i}",
                allowed="any other number; |eta| < 1 shrinks what is seen, eta < 0 turns it over",
                hint=f"eta_{axis} = -1 sends light on under minus the angle it came in",
            )
        elif 0.0 < abs(eta[i]) < 1e-6:
            yield Mistake(
                "CL106",
                f"eta_{axis} = {eta[i]!r} is out of range",
                f"{LAW.eta}.{i}",
                allowed="1e-6 <= |eta| <= 1e6",
            )
    if eta[0] == 1.0 and eta[1] == 1.0:
        yield Mistake(
            "CL110",
            "eta = 1 in both x and y: the sheet would be a plain window",
            LAW.eta,
            allowed="eta = 1 in at most one of x and y (a cylindrical sheet)",
        )
    elif delta is not None:
        for i, axis in enumerate("xy"):
            if eta[i] == 1.0 and delta[i] != 0.0:
                yield Mistake(
                    "CL111",
                    f"eta_{axis} = 1 with delta_{axis} = {delta[i]:g}: a lens without power has "
                    "no axis to offset",
                    f"{LAW.delta}.{i}",
                    allowed=f"delta_{axis} = 0, or eta_{axis} other than 1",
                )


def lens_faces_forward(a: Asked) -> Iterator[Mistake]:
    """The lens axis must point through the sheet: |θ| < 90°."""
    euler = a(LAW.euler)
    if euler is not None and abs(euler[1]) >= 90.0:
        yield Mistake(
            "CL106",
            f"theta = {euler[1]:g} deg turns the lens axis out of the forward half",
            f"{LAW.euler}.1",
            allowed="-90 deg < theta < 90 deg",
        )


def separation_or_thickness(a: Asked) -> Iterator[Mistake]:
    """A slab has exactly one of separation and thickness; the other forms need the separation."""
    form, thickness = a(PAIR.form), a(PAIR.thickness)
    if form == "slab":
        number = a.given(PAIR.thickness) and thickness != "auto"
        if a.given(PAIR.separation) and number and thickness is not None:
            yield Mistake(
                "CL112",
                "a slab takes either separation or thickness, not both",
                PAIR.thickness,
                found=f"{a.says(PAIR.separation)} and {a.says(PAIR.thickness)}",
                allowed="separation = T/n, or thickness = T",
            )
        if not a.given(PAIR.separation) and not number:
            yield Mistake(
                "CL103",
                "a slab needs its separation or its thickness",
                PAIR.separation,
                allowed="separation = T/n, or thickness = T (exactly one)",
            )
        if isinstance(a.written.get(PAIR.thickness), list) and thickness is not None:
            yield Mistake(
                "CL108",
                f"{a.says(PAIR.thickness)}: a slab is one body with one thickness",
                PAIR.thickness,
                allowed="one length",
            )
    elif form in ("biconvex", "plano") and not a.given(PAIR.separation):
        what = "centre to centre" if form == "biconvex" else "f1 + f2 in air"
        yield Mistake(
            "CL103",
            f"missing key pair.separation: a {form} pair needs it",
            PAIR.separation,
            allowed=f"a length > 0 ({what})",
        )


def keys_of_other_forms(a: Asked) -> Iterator[Mistake]:
    """Refuse keys that belong to other forms: web, curved, seam_depth, the thin recipe, a baffle."""
    form = a(PAIR.form)
    if form in (None, "plates"):
        return
    for key, forms in ((PAIR.curved, ("plano",)), (LATTICE.seam_depth, ("plano", "slab"))):
        if a.given(key) and form not in forms:
            yield Mistake(
                "CL114",
                f"{key} does not belong to a {form} pair",
                key,
                allowed=f"only with pair.form = {' | '.join(shown(f) for f in forms)}",
                hint="leave it out",
            )
    if form != "biconvex" and a(PAIR.web):
        yield Mistake(
            "CL114",
            f"pair.web does not belong to a {form} pair: its body holds together by itself",
            PAIR.web,
            allowed='only with pair.form = "biconvex"',
            hint="leave it out",
        )
    if form == "slab":
        yield from _keys_of_two_bodies(a)


def _keys_of_two_bodies(a: Asked) -> Iterator[Mistake]:
    """Refuse keys of a slab that need two bodies."""
    if a(PAIR.confocal) == "thin":
        yield Mistake(
            "CL114",
            f"{a.says(PAIR.confocal)} does not belong to a slab",
            PAIR.confocal,
            allowed='"exact": a slab is afocal by construction; or "best": radii for the least error',
        )
    if a(TOLERANCES.separation):
        yield Mistake(
            "CL114",
            "tolerances.separation does not belong to a slab: its separation is its thickness",
            TOLERANCES.separation,
            allowed=TOLERANCES.thickness,
            hint="leave it out",
        )
    if a(BODY.baffle):
        yield Mistake(
            "CL114",
            "a slab has no room for a baffle between its faces",
            BODY.baffle,
            allowed='false, or pair.form = "biconvex" | "plano"',
        )


def index_or_material(a: Asked) -> Iterator[Mistake]:
    """Require exactly one of index and material, but of a list of faces, which states the media."""
    if a(PAIR.form) == "plates" or a(PAIR.layers):
        return
    if a.given(PAIR.index) and a.given(PAIR.material):
        yield Mistake(
            "CL112",
            "index and material exclude each other",
            PAIR.material,
            found=f"{a.says(PAIR.index)} and {a.says(PAIR.material)}",
            allowed="exactly one of them",
        )
    elif not a.given(PAIR.index) and not a.given(PAIR.material):
        yield Mistake(
            "CL103",
            "missing key pair.index (or pair.material)",
            PAIR.index,
            allowed='index = a number > 1, or material = a name such as "PMMA"',
        )


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


def light_is_known(a: Asked) -> Iterator[Mistake]:
    """Every material must have an index at the stated lines, and a dn/dT where a temperature is stated."""
    lines = next((key for key in (LIGHT.spectrum, CHECK.law_white) if a(key) is not None), "")
    warm = next((key for key in (LIGHT.temperature, CHECK.temperature) if a(key) is not None), "")
    if not lines and not warm and not a(LIGHT.thermal):
        return
    listed = [face.behind for face in a(PAIR.face) or () if face.behind not in (None, AIR)]
    media = listed if a(PAIR.form) == "plates" else a(PAIR.layers) or [a(PAIR.material)]
    names = {str(name) for name in media if name}
    from clacad.optics.material.catalogue import find
    from clacad.optics.material.material import NOT_PUBLISHED, state_it

    for key in filter(None, (lines, warm) if not names else ()):
        yield Mistake(
            "CL119",
            f"{key} needs a material: an index alone is known at one wavelength",
            key,
            allowed="with pair.material, a name of the table",
        )
    stated = {_called(one.material): one for one in a(LIGHT.thermal) or ()}
    for name in sorted(set(stated) - {_called(one) for one in names}):
        yield Mistake(
            "CL119",
            f"light.thermal states numbers of {name}, of which nothing is made here",
            LIGHT.thermal,
            allowed=f"the materials of this sheet: {', '.join(sorted(names)) or 'none'}",
        )
    for name in sorted(names):
        try:
            material = find(name)
        except ValueError:
            continue  # reported at the key that names it
        try:
            for wave in LightSpec(spectrum=a(LIGHT.spectrum)).lines if lines else ():
                material.index(wave)
        except ValueError as problem:
            yield Mistake("CL119", str(problem), lines, allowed="lines in that range")
            continue
        own = stated.get(material.name)
        if warm and material.thermal.dn_dt is None and (own is None or own.dn_dt is None):
            message = f"{warm} needs dn/dT of {name}: {NOT_PUBLISHED}"
            hint = state_it(material.name, "dn_dt")
            yield Mistake("CL119", message, warm, allowed="a material with dn/dT", hint=hint)


def _called(name: str) -> str:
    """Name of a material of the table; an unknown name is left as it is."""
    from clacad.optics.material.catalogue import find

    try:
        return find(name).name
    except ValueError:
        return name


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
    if surface == "ellipsoid" and a.given(PAIR.conic) and not a(PAIR.layers):
        yield Mistake(
            "CL113",
            'pair.conic needs surface = "biconic"',
            PAIR.conic,
            allowed='surface = "biconic", or pair.depth to shape an ellipsoid',
        )
    if surface == "biconic" and a.given(PAIR.depth):
        yield Mistake(
            "CL113",
            'pair.depth needs surface = "ellipsoid"',
            PAIR.depth,
            allowed='surface = "ellipsoid", or pair.conic to shape a biconic',
        )
    if surface == "biconic" and a(PAIR.form) == "biconvex" and not a.given(PAIR.conic):
        yield Mistake(
            "CL113",
            "a biconvex pair of biconics needs pair.conic: no conic is right by itself",
            PAIR.surface,
            allowed="conic = [K_x, K_y]",
            hint="conic = [0.0, 0.0] gives circular profiles",
        )


def faces_stand_alone(a: Asked) -> Iterator[Mistake]:
    """Given faces need prescription = "given", and exclude the keys of the recipes."""
    given = a(PAIR.prescription) == "given"
    if a(PAIR.form) == "plates":
        return
    for key in (PAIR.face, PAIR.vertex, PAIR.search):
        if a.given(key) and a(PAIR.prescription) == "derived":
            yield Mistake(
                "CL113",
                f'{key} needs pair.prescription = "given"',
                key,
                allowed='prescription = "given", or leave it out',
            )
    if not given:
        return
    for key in (PAIR.confocal, PAIR.surface, PAIR.conic, PAIR.depth):
        if a.given(key):
            yield Mistake(
                "CL112",
                f"{key} and given faces exclude each other: given faces are used as they are",
                key,
                found=a.says(key),
                allowed="leave it out",
                hint='or prescription = "derived" without pair.face',
            )
    if a(PAIR.form) in ("biconvex", "plano") and a(PAIR.thickness) == "auto":
        yield Mistake(
            "CL113",
            "given faces need their thickness: it fixes where their vertices lie",
            PAIR.thickness,
            found=a.says(PAIR.thickness),
            allowed="a length > 0, or [lens 1, lens 2]",
        )


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
        yield Mistake(
            "CL108",
            f"{len(faces)} given faces: {what} has {wanted}",
            PAIR.face,
            allowed=f"{wanted} tables [[pair.face]], in the order light meets them",
        )
    elif form == "plano" or in_three:
        last = len(faces) - 1
        for k in (1, last - 1) if a(PAIR.curved) != "inside" else (0, last):
            if not faces[k].plane:
                yield Mistake(
                    "CL114",
                    f"pair.face[{k}] is the plane side of a plano lens",
                    f"{PAIR.face}.{k}.radius",
                    allowed="radius = inf and nothing else",
                    hint='form = "biconvex" bends both sides',
                )


def field_lens_has_a_focus(a: Asked) -> Iterator[Mistake]:
    """A field lens needs a real common focus: η < 0 in both meridians."""
    eta = a(LAW.eta)
    if not a(PAIR.field_lens) or eta is None:
        return
    for i, axis in enumerate("xy"):
        if eta[i] > 0.0:
            where = "there is none" if eta[i] == 1.0 else "it is virtual"
            yield Mistake(
                "CL126",
                f"eta_{axis} = {eta[i]:g}: a field lens is mounted at the common focus, and {where}",
                PAIR.field_lens,
                allowed="false, or eta < 0 in both x and y",
                hint=f"eta_{axis} = {-eta[i]:g}, or pair.field_lens = false",
            )


def field_lens_is_made(a: Asked) -> Iterator[Mistake]:
    """No plane bends the axis towards the lens, nor do imaged planes lean; its keys need a lens."""
    if a.given(PAIR.field) and a(PAIR.field_lens) is False:
        yield Mistake(
            "CL113",
            "pair.field needs pair.field_lens = true",
            PAIR.field,
            allowed="field_lens = true, or leave it out",
        )
    form, eta, euler = a(PAIR.form), a(LAW.eta), a(LAW.euler)
    if not a(PAIR.field_lens) or form is None or eta is None or euler is None:
        return
    sharp = a(PAIR.focus) is not None
    kind = "sharp" if sharp else form
    if euler[1] != 0.0 and ((form == "plano" and a(PAIR.curved) != "inside") or sharp):
        yield Mistake(
            "CL127",
            f"theta = {euler[1]:g} deg: a field lens of a tilted {kind} pair is not made",
            f"{LAW.euler}.1",
            allowed="theta = 0",
            hint="theta = 0" if sharp else 'pair.curved = "inside", or theta = 0',
        )
    if eta[0] != eta[1] and sharp and a(BODY.baffle) and form != "slab":
        yield Mistake(
            "CL127",
            "eta_x and eta_y differ, a baffle in the plate and pair.focus: both faces of the field lens are"
            " curved along both axes, at which pair.focus has no one focus",
            BODY.baffle,
            allowed="baffle = false, or eta_x = eta_y",
            hint="eta_x = eta_y, or no baffle",
        )
    field = a(PAIR.field)
    if field is not None and field.gap is not None and form != "slab":
        yield Mistake(
            "CL114",
            f"pair.field.gap does not belong to a {form} pair",
            PAIR.field,
            allowed='only with pair.form = "slab"',
            hint="leave it out",
        )


PAIR_RULES: Final[tuple[Rule, ...]] = (
    law_is_a_pair,
    lens_faces_forward,
    separation_or_thickness,
    keys_of_other_forms,
    index_or_material,
    material_is_known,
    light_is_known,
    worked_materials_are_known,
    surface_and_its_keys,
    faces_stand_alone,
    faces_are_of_the_form,
    field_lens_has_a_focus,
    field_lens_is_made,
)
