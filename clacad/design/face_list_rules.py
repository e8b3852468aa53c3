"""Rules of `form = "plates"`: faces listed with the medium behind each, and keys that do not go with them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

from clacad.config.mistakes import Mistake
from clacad.design.faces import AIR, FaceSpec, vertices_of
from clacad.design.sections import BODY, LATTICE, LAW, PAIR, TOLERANCES

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
    if a(TOLERANCES.separation):
        yield Mistake(
            "CL114",
            "tolerances.separation does not belong to a list of faces",
            TOLERANCES.separation,
            allowed=TOLERANCES.thickness,
        )
    euler = a(LAW.euler)
    if euler is not None and euler[1] != 0.0:
        yield Mistake(
            "CL114",
            f"theta = {euler[1]:g} deg: faces of a list are level with the sheet",
            f"{LAW.euler}.1",
            allowed="theta = 0",
            hint='pair.form = "slab" or "biconvex"',
        )
    if a(BODY.baffle) or a(BODY.pins):
        yield Mistake(
            "CL114",
            "a baffle or pins between listed plates are not made",
            BODY.baffle if a(BODY.baffle) else BODY.pins,
            allowed="leave it out",
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
        if a(PAIR.form) != "plates" or face.behind in (None, AIR):
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


FACE_LIST_RULES: Final = (face_list_stands_alone, faces_make_plates, media_are_known)
