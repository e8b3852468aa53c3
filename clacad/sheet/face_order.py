"""Faces of bodies in the order of the light: media around them, plates, joints, and where outlines lie."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from clacad.sheet.window import Body, Face, Window


class Refraction(NamedTuple):
    """A face where light goes from one medium to another: its body (of a joint the one before it), and the
    refractive indices at the design wavelength.
    """

    body: Body
    face: Face
    before: float
    after: float


def plates_of(bodies: Sequence[Body]) -> tuple[tuple[Body, ...], ...]:
    """Bodies without air between them, in the order light reaches them."""
    found: list[list[Body]] = []
    for body in bodies:
        if body.joined and found:
            found[-1].append(body)
        else:
            found.append([body])
    return tuple(map(tuple, found))


def media_of(bodies: Sequence[Body], wavelength: float | None = None) -> tuple[float, ...]:
    """Refractive index before the first face and behind each face, (2 bodies + 1,).

    Of the two faces of a joint, the second has the same medium on both sides.

    wavelength : metres; None: the design wavelength
    Raises ValueError: The wavelength lies outside a material's data.
    """
    inside = [body.index_at(wavelength) for body in bodies]
    found = [1.0]
    for number, body in enumerate(bodies[1:], start=1):
        found += [inside[number - 1], inside[number] if body.joined else 1.0]
    return (*found, inside[-1], 1.0)


def refractions(bodies: Sequence[Body]) -> tuple[Refraction, ...]:
    """Faces in the order of the light, a joint once."""
    around = media_of(bodies)
    return tuple(
        Refraction(body, face, around[2 * number + side], around[2 * number + side + 1])
        for number, body in enumerate(bodies)
        for side, face in enumerate((body.front, body.back))
        if side or not body.joined
    )


def outline_centre(window: Window, body: Body) -> tuple[float, float]:
    """Centre (x, y) of a body's outline, lengths: the sheet's, or that of the body's own array."""
    own = len(body.arrays) == 1 and not window.one_outline
    return window.shifts[body.arrays[0]] if own else (0.0, 0.0)


def lined_face(window: Window) -> Face | None:
    """The face with an opaque line."""
    return None if window.land.lined < 0 else window.faces[window.land.lined]


def lined_array(window: Window) -> int:
    """The array along whose cells an opaque line runs; -1 without one."""
    face = lined_face(window)
    return -1 if face is None else array_at(window, face)


def array_at(window: Window, face: Face) -> int:
    """The array of a face; of a plane face, which has none, that of the nearest lens."""
    if face.array is not None:
        return face.array
    apart = [
        (abs(one.vertex[2] - face.vertex[2]), one.array) for one in window.faces if one.array is not None
    ]
    return min(apart)[1]


def lined_surfaces(window: Window) -> tuple[int, ...]:
    """Numbers of the surfaces of a trace with an opaque line: two of a joint, which both bodies have."""
    number = window.land.lined
    joints = [2 * k for k, body in enumerate(window.bodies) if body.joined]
    pairs = [(k - 1, k) for k in joints]
    return next((pair for pair in pairs if number in pair), (number,) if number >= 0 else ())
