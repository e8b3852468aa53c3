"""How the part must be held, told from its geometry alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from clacad.sheet.window import Window


def orientation(window: Window) -> list[str]:
    """How the part must be held: sentences, told from the geometry alone."""
    first, last = window.bodies[0].name, window.bodies[-1].name
    found = [
        "The light of the checks travels towards +z and meets lens 1 first"
        + (
            f", on {first}; {last} carries lens 2."
            if first != last
            else "; lens 2 is the back of the same body."
        ),
        "The axes are right-handed: with the light at your back and +y up, +x points to the left. No file is mirrored.",
    ]
    faces = [f for f in window.faces if f.array is not None]
    centred = all(f.untilted and f.vertex[:2] == (0.0, 0.0) for f in faces) and all(
        shift == (0.0, 0.0) for shift in window.shifts
    )
    alike = all(f.surface.curvature_x == f.surface.curvature_y for f in faces)
    square = not window.lattice.hexagonal and window.lattice.pitch[0] == window.lattice.pitch[1]
    if centred and alike and square:
        found.append("It may be turned by quarter turns about z: the optics stay the same.")
    elif centred:
        found.append("It may be turned by half a turn about z, not by a quarter: the optics stay the same.")
    else:
        found.append(
            "It may not be turned about z: lens axes or offsets point one way. Mark the corner +x, +y."
        )
    found.append(
        "It may be turned over, too: both sides are alike."
        if centred and _both_sides_alike(faces)
        else "It may not be turned over: the two sides differ. Mark the side of lens 1."
    )
    if window.recipe.get("field", {}).get("equal_plates"):
        found.append(
            f"{first} and {last} are the same part: order it twice and put the two back to back, field lenses inside."
        )
    return found


def _both_sides_alike(faces: Sequence[Any]) -> bool:
    one = [f.surface for f in faces]
    return all(
        np.isclose(getattr(a, f"curvature_{k}"), getattr(b, f"curvature_{k}"), rtol=1e-9, atol=0.0)
        for a, b in zip(one, one[::-1], strict=True)
        for k in ("x", "y")
    )
