"""The window mirrored, z → −z, so that returning light travels forward."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clacad.sheet.window import IDENTITY, Body, Face, Window

FLIP = np.diag([1.0, 1.0, -1.0])


def mirrored(window: Window) -> Window:
    """The mirror image of a window in the plane z = 0: bodies in reverse order, arrays keep their numbers.

    Every surface is even in its own x and y, so the mirror image is that surface on its other side with
    the rotation F R F, F = diag(1, 1, −1), again a proper one. For tracing only: `law`, `thin` and `recipe`
    still describe the original window.
    """
    low, high = window.z_range
    bodies = tuple(_body(body) for body in reversed(window.bodies))
    return replace(window, bodies=bodies, z_range=(-high, -low))


def _body(body: Body) -> Body:
    return replace(body, front=_face(body.back), back=_face(body.front))


def _face(face: Face) -> Face:
    x, y, z = face.vertex
    turned = IDENTITY if face.untilted else FLIP @ face.rotation @ FLIP
    return Face(
        surface=replace(face.surface, side=-face.surface.side),
        vertex=(x, y, -z),
        rotation=turned,
        array=face.array,
        land=None if face.land is None else -face.land,
        change=None
        if face.change is None
        else replace(face.change, slope=(-face.change.slope[0], -face.change.slope[1])),
    )
