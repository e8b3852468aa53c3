"""The gap between the two arrays, and the refusal that every fixture may give."""

from __future__ import annotations

from clacad.sheet.window import Body, Window


class NoFixture(ValueError):
    """A fixture that this window leaves no room for; exit status 2."""

    exit_status = 2


def two_bodies(window: Window, what: str) -> tuple[Body, Body]:
    """Bodies of array 1 and array 2.

    Raises
    ------
    NoFixture
        The window is one slab, or has a field lens on a plate of its own.
    """
    if len(window.bodies) > 2:
        raise NoFixture(
            f"a {what} stands between two bodies; {window.name} has three, with the field lens: shim it on either side"
        )
    if len(window.bodies) != 2:
        raise NoFixture(f"a {what} stands between two arrays; {window.name} is one slab")
    return window.bodies[0], window.bodies[1]


def plane_of(body: Body, side: int) -> float:
    """Height (length) of the flat a fixture touches: the land or plane of a body's back (+1) or front (−1).

    Raises
    ------
    NoFixture
        The body has no flat there.
    """
    face = body.back if side > 0 else body.front
    if face.array is None:
        return face.vertex[2]
    if face.land is None:
        raise NoFixture(
            f"{body.name} has no flat border to be held by: give body.border a width, so that a plate runs round the "
            "lenslets"
        )
    return face.land
