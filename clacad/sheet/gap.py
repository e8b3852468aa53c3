"""Gaps between bodies, and the exception that every fixture may raise."""

from __future__ import annotations

from clacad.sheet.window import Body, Window

FIELD = 2
"""Index of the array of a field lens; lens 1 and lens 2 have 0 and 1."""


class NoFixture(ValueError):
    """The window leaves no room for the fixture; exit status 2."""

    exit_status = 2


def bodies_apart(window: Window, what: str) -> tuple[Body, ...]:
    """Bodies of the arrays and of the field lens between them, in the order light reaches them.

    Raises
    ------
    NoFixture
        The window is one slab.
    """
    if len(window.bodies) < 2:
        raise NoFixture(f"a {what} stands between two arrays; {window.name} is one slab")
    return window.bodies


def array_of(body: Body) -> int:
    """Index of the array on a body that has one."""
    return next(face.array for face in (body.front, body.back) if face.array is not None)


def plane_of(body: Body, side: int) -> float:
    """Height (length) of the flat that a fixture touches: land or plane of a body's back (+1) or front (−1).

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
