"""Rules of media in the order of the light: `form = "plates"`, faces listed with the medium behind each, and
`pair.layers`, three materials that undo one another's colour; keys that do not go with either.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from clacad.config.mistakes import Mistake
from clacad.design.faces import AIR, FaceSpec, vertices_of
from clacad.design.sections import BODY, CHECK, LATTICE, LAW, LIGHT, PAIR, LightSpec

if TYPE_CHECKING:
    from clacad.design.rules import Asked

NOT_ASKED: Final = (
    PAIR.separation,
    PAIR.web,
    PAIR.confocal,
    PAIR.surface,
    PAIR.conic,
    PAIR.depth,
    PAIR.curved,
    PAIR.index,
    PAIR.material,
    PAIR.prescription,
    PAIR.field_lens,
    PAIR.field,
    PAIR.focus,
    LATTICE.seam_depth,
)
"""Keys that the list of faces answers, or that only the other forms have."""


def face_list_stands_alone(a: Asked) -> Iterator[Mistake]:
    """Refuse keys of other forms, and keys of a list in faces of another form."""
    if a(PAIR.form) != "plates":
        for number, face in enumerate(a(PAIR.face) or ()):
            for name in ("after", "z", "array", "behind"):
                if getattr(face, name) is not None:
                    yield Mistake(
                        "CL113",
                        f'pair.face[{number}].{name} needs pair.form = "plates"',
                        f"{PAIR.face}.{number}.{name}",
                        allowed='form = "plates", or leave it out',
                    )
        return
    for key in NOT_ASKED:
        if a.given(key):
            yield Mistake(
                "CL114",
                f"{key} does not belong to a list of faces: [[pair.face]] states place, shape and medium",
                key,
                allowed="leave it out",
            )
    if a.given(PAIR.thickness) and a(PAIR.thickness) != "auto":
        yield Mistake(
            "CL114",
            "pair.thickness does not belong to a list of faces: their places state it",
            PAIR.thickness,
            allowed='leave it out, and give each [[pair.face]] its "after" or "z"',
        )
    if any(face.array == "field" for face in a(PAIR.face) or ()):
        yield from axes_are_level(a, "field lenses of a list")
    faces: tuple[FaceSpec, ...] = a(PAIR.face) or ()
    for key in (BODY.baffle, BODY.pins):
        if a(key) and not any(face.behind == AIR for face in faces[:-1]):
            yield Mistake(
                "CL114",
                f"{key} does not belong to a list of one plate",
                key,
                allowed='a face with behind = "air" before the last, or leave it out',
            )


def axes_are_level(a: Asked, what: str) -> Iterator[Mistake]:
    """Require the lens axes to be normal to the sheet."""
    euler = a(LAW.euler)
    if euler is not None and euler[1] != 0.0:
        yield Mistake(
            "CL114",
            f"theta = {euler[1]:g} deg: {what} are level with the sheet",
            f"{LAW.euler}.1",
            allowed="theta = 0",
            hint='pair.form = "slab" or "biconvex"',
        )


def faces_make_plates(a: Asked) -> Iterator[Mistake]:
    """Require faces in order, each with what lies behind it, air last, and lenses of both arrays."""
    faces = a(PAIR.face)
    if a(PAIR.form) != "plates" or faces is None:
        return
    if len(faces) < 2:
        yield Mistake(
            "CL108",
            f"{len(faces)} faces make no plate",
            PAIR.face,
            allowed="two or more tables [[pair.face]], in the order of the light",
        )
        return
    for number in range(len(faces)):
        for name, fault, allowed in _faults(faces, number):
            key = f"{PAIR.face}.{number}.{name}"
            yield Mistake("CL113", f"pair.face[{number}] {fault}", key, allowed=allowed)
    arrays = [face.array for face in faces if face.array is not None and not face.plane]
    firsts = [arrays.index(array) for array in (1, 2) if array in arrays]
    lasts = [len(arrays) - 1 - arrays[::-1].index(array) for array in (1, 2) if array in arrays]
    if len(firsts) < 2:
        yield Mistake(
            "CL113",
            "the list has no lens of array " + ("1" if 1 not in arrays else "2"),
            PAIR.face,
            allowed="a curved face with array = 1, and one with array = 2",
        )
    elif lasts[0] > firsts[1] or any(
        not lasts[0] < k < firsts[1] for k, array in enumerate(arrays) if array == "field"
    ):
        yield Mistake(
            "CL113",
            f"faces of the arrays {', '.join(map(str, arrays))} are in no order",
            PAIR.face,
            allowed='those of array 1 first, then those of "field", then those of array 2',
        )


def _faults(faces: tuple[FaceSpec, ...], number: int) -> Iterator[tuple[str, str, str]]:
    """Faults of one face: key, words that follow "pair.face[k]", and what is allowed."""
    face, last, z = faces[number], number == len(faces) - 1, vertices_of(faces)
    if face.behind is None:
        yield "behind", "does not say what lies behind it", '"air", or the name of a material'
    elif last and face.behind != AIR:
        yield "behind", f'is the last one and has "{face.behind}" behind it', 'behind = "air"'
    elif number == 0 and face.behind == AIR:
        yield "behind", "is the first one and has air behind it", "the name of a material"
    elif number and face.behind == faces[number - 1].behind:
        yield "behind", f'has "{face.behind}" on both sides', "another medium, or leave the face out"
    if number == 0 and (face.after is not None or face.z):
        yield "z", "is the first one: places count from it", "leave after and z out"
    elif number and (face.after is None) == (face.z is None):
        yield "after", "needs its place", "after = a length > 0, or z = a length (exactly one)"
    elif number and z[number] <= z[number - 1]:
        yield "z", f"lies at {z[number]:g}, not behind the face before it", "a larger z"
    if face.array is None and not face.plane:
        yield "array", "is curved and on no array", 'array = 1, 2 or "field", or radius = "inf" alone'


def media_are_known(a: Asked) -> Iterator[Mistake]:
    """The media behind listed faces must be in the table, and known at the design wavelength."""
    faces: tuple[FaceSpec, ...] = a(PAIR.face) or ()
    wavelength: Any = a(PAIR.wavelength)
    for number, face in enumerate(faces):
        if a(PAIR.form) != "plates" or face.behind in (None, AIR, DIFFRACTIVE):
            continue
        from clacad.optics.material.catalogue import find

        try:
            material = find(str(face.behind))
            if wavelength is not None:
                material.index(wavelength)
        except ValueError as problem:
            sentence, _, hint = str(problem).partition("; ")
            key = f"{PAIR.face}.{number}.behind"
            yield Mistake("CL119", sentence, key, allowed='"air", or a name of the table', hint=hint)


OF_ONE_MEDIUM: Final = (
    *(key for key in NOT_ASKED if key not in (PAIR.separation, PAIR.conic)),
    PAIR.thickness,
    PAIR.face,
)
"""Keys that layers answer, or that only a slab of one medium has."""

DIFFRACTIVE: Final = "diffractive"
"""Layer that is refused with the number of its zones."""

LEAST_ZONES: Final = 10.0
"""Zones of a cell below which a diffractive term is no grating."""


@dataclass(frozen=True, slots=True)
class Colour:
    """Index of a material at the design wavelength, and its fall between the outermost lines of light."""

    index: float
    change: float

    @property
    def v(self) -> float:
        """(n − 1)/Δn."""
        return (self.index - 1.0) / self.change if self.change else math.inf


def layers_are_achromatic(a: Asked) -> Iterator[Mistake]:
    """Require three layers of known materials, the outer ones alike, and no key that they answer."""
    layers: tuple[str, ...] = a(PAIR.layers) or ()
    if not layers:
        return
    if a(PAIR.form) != "slab":
        yield Mistake("CL114", "pair.layers belongs to a slab", PAIR.layers, allowed='pair.form = "slab"')
        return
    for key in OF_ONE_MEDIUM:
        if a.given(key) and a(key) != "auto":
            yield Mistake(
                "CL114", f"{key} does not belong to layers: they state the media", key, allowed="leave it out"
            )
    yield from axes_are_level(a, "joints of layers")
    colours: dict[str, Colour] = {}
    for number, name in enumerate(layers):
        try:
            if name not in (AIR, DIFFRACTIVE):
                colours[name] = _colour(a, name)
        except ValueError as problem:
            sentence, _, hint = str(problem).partition("; ")
            key = f"{PAIR.layers}.{number}"
            yield Mistake("CL119", sentence, key, allowed="a name of the table", hint=hint)
            return
    yield from _order(a, layers, colours)


def plates_are_achromatic(a: Asked) -> Iterator[Mistake]:
    """Refuse, with numbers, what cannot undo the colour of listed plates: a diffractive term, and a second
    material across air, where `check.law_white` is written.
    """
    faces: tuple[FaceSpec, ...] = a(PAIR.face) or ()
    media = [str(face.behind) for face in faces if face.behind is not None]
    if a(PAIR.form) != "plates" or len(media) < len(faces):
        return
    try:
        colours = {name: _colour(a, name) for name in media if name not in (AIR, DIFFRACTIVE)}
    except ValueError:  # another rule reports it
        return
    if DIFFRACTIVE in media and colours:
        z = vertices_of(faces)
        steps = zip(media[:-1], z[1:], z[:-1], strict=True)
        length = sum((high - low) / (colours[m].index if m in colours else 1.0) for m, high, low in steps)
        name = next(iter(colours))
        yield from _diffractive(
            a, name, colours[name], length, f"{PAIR.face}.{media.index(DIFFRACTIVE)}.behind"
        )
    elif a(CHECK.law_white) is not None and len(media) == 4 and media[1] == AIR and media[0] != media[2]:
        yield from _across_air(a, media[0], media[2], colours)


def _across_air(a: Asked, one: str, two: str, colours: dict[str, Colour]) -> Iterator[Mistake]:
    """Refuse plates of two materials with air between them in white light."""
    eta = a(LAW.eta)
    if eta is None or min(eta) >= 0.0:
        return
    first, last = colours[one].v, colours[two].v
    yield Mistake(
        "CL114",
        f"lens 1 of {one} (V = {first:.4g}) and lens 2 of {two} (V = {last:.4g}) with air between them: the"
        f" colour of eta vanishes at eta = {last / first:.3g} alone, and at no eta below 0 (here"
        f" {min(eta):g})",
        f"{PAIR.face}.2.behind",
        allowed="one material for both, or a joint in each plate; any without check.law_white",
        hint="clacad new --template achromat-doublets",
    )


def _order(a: Asked, layers: tuple[str, ...], colours: dict[str, Colour]) -> Iterator[Mistake]:
    """Require one material of both lenses, another between them, and nothing else."""
    if DIFFRACTIVE in layers and colours:
        name = next(iter(colours))
        yield from _diffractive(a, name, colours[name], a(PAIR.separation), PAIR.layers)
    elif layers[0] != layers[-1] and {layers[0], layers[-1]} <= colours.keys():
        first, last = (colours[layers[k]].v for k in (0, -1))
        yield Mistake(
            "CL114",
            f"lens 1 of {layers[0]} (V = {first:.4g}) and lens 2 of {layers[-1]} (V = {last:.4g}): the colour"
            f" of eta vanishes at eta = {last / first:.3g} alone, and at no eta below 0",
            PAIR.layers,
            allowed="one material for both lenses, another between them",
            hint=f'layers = ["{layers[0]}", "{layers[-1]}", "{layers[0]}"]',
        )
    elif len(layers) != 3 or layers[0] != layers[-1] or len(colours) != 2:
        yield Mistake(
            "CL108",
            f"layers {', '.join(layers)} have no flat joint of two materials",
            PAIR.layers,
            allowed="three materials: outer, inner and outer",
        )


def _colour(a: Asked, name: str) -> Colour:
    """Colour of a material; ValueError where its index is not known."""
    from clacad.optics.material.catalogue import find

    lines, one = LightSpec(spectrum=a(LIGHT.spectrum)).lines, find(name)
    return Colour(one.index(a(PAIR.wavelength) or 0.0), one.index(min(lines)) - one.index(max(lines)))


def _diffractive(a: Asked, name: str, colour: Colour, s: float | None, key: str) -> Iterator[Mistake]:
    """Refuse a diffractive term with its zones over a cell, and the size of cells that have enough.

    s : length in air that equals that between the lenses
    """
    pitch, eta, unit = a(LATTICE.pitch), a(LAW.eta), a.unit
    if pitch is None or s is None or eta is None or unit is None:
        return
    lines, wavelength = LightSpec(spectrum=a(LIGHT.spectrum)).lines, a(PAIR.wavelength)
    size = max(pitch) ** 2 / s
    zones = diffractive_zones(
        colour, size * unit.metres, min(eta), (max(lines) - min(lines)) / wavelength, wavelength
    )
    yield Mistake(
        "CL114",
        f"a diffractive term that undoes the colour of {name} has {zones:.2g} zones over a cell, and a"
        f" grating needs {LEAST_ZONES:g}: pitch²/separation = {size * LEAST_ZONES / zones:.2g} {unit.name},"
        f" not {size:.2g}",
        key,
        allowed="materials only: a diffractive term is not built",
        hint="three layers of two materials",
    )


def diffractive_zones(colour: Colour, size: float, eta: float, spread: float, wavelength: float) -> float:
    """Zones, to the corner of a square cell, of the diffractive part of lens 1 that makes a slab achromatic.

    The lens must gain power as T/n falls: with the share k of its power diffractive,
    (1 − k) Δn/(n − 1) − k Δλ/λ = Δn/n. Power φ has r² φ/(2 λ) zones, r² = p²/2 and φ = (1 − η)/s.

    size : metres. p²/s; spread : Δλ/λ of the outermost lines; wavelength : metres
    """
    n, change = colour.index, colour.change
    share = change * (1.0 / (n - 1.0) - 1.0 / n) / (change / (n - 1.0) + spread)
    return share * abs(1.0 - eta) * size / (4.0 * wavelength)


MEDIA_RULES: Final = (
    face_list_stands_alone,
    faces_make_plates,
    media_are_known,
    layers_are_achromatic,
    plates_are_achromatic,
)
