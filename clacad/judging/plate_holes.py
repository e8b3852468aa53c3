"""Holes of a plate in a file: each lies where the design has it, as wide and through every body.

A volume, an extent and the light of cells do not notice a hole that lies elsewhere in the land.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import pi
from typing import Any, Final

import numpy as np

from clacad.base.types import Floats
from clacad.base.vectors import doubled_normals
from clacad.checks.check import Check
from clacad.sheet.plate import Hole, Plate
from clacad.sheet.window import Body, Window

ROOM: Final = 1e-3
"""Distance by which the wall of a hole may lie off its circle, as part of the diameter."""

LEAST: Final = 0.9
"""Least part of a hole's wall that lies on its circle in a sound mesh."""


def holes_of(window: Window) -> tuple[Hole, ...]:
    """Holes through the plate of a window."""
    return window.outline.holes if isinstance(window.outline, Plate) else ()


def wall_areas(window: Window, walls: Floats) -> Floats:
    """Area (bodies, holes), length², of upright facets (k, 3, 3) that lie on the circle of each hole."""
    holes = holes_of(window)
    found = np.zeros((len(window.bodies), len(holes)))
    for n, hole in enumerate(holes):
        near = (np.abs(walls[:, 0, :2] - (hole.x, hole.y)) <= 0.6 * hole.diameter).all(axis=1)
        some = walls[near]
        off = np.hypot(some[..., 0] - hole.x, some[..., 1] - hole.y) - 0.5 * hole.diameter
        some = some[(np.abs(off) <= ROOM * hole.diameter).all(axis=1)]
        area, height = 0.5 * np.linalg.norm(doubled_normals(some), axis=1), some[..., 2].mean(axis=1)
        for number, body in enumerate(window.bodies):
            low, high = _land(body)
            found[number, n] = area[(height > low) & (height < high)].sum()
    return found


def _land(body: Body) -> tuple[float, float]:
    """Heights (lengths) of the land on both sides of a body."""
    front, back = (face.vertex[2] if face.land is None else face.land for face in (body.front, body.back))
    return front, back


def lost_in_mesh(window: Window, areas: Floats, present: Sequence[str] | None) -> list[Hole]:
    """Holes whose wall is not found in every body that a file holds; `areas` from `wall_areas`."""
    held = [present is None or body.name in present for body in window.bodies]
    thick = np.array([high - low for low, high in map(_land, window.bodies)])
    return [
        hole
        for hole, area in zip(holes_of(window), areas.T, strict=True)
        if (area < LEAST * pi * hole.diameter * thick)[held].any()
    ]


def lost_in_solid(
    window: Window, found: Iterable[Mapping[str, Any]], mm: float, alone: bool = True
) -> list[Hole]:
    """Holes that none of the upright cylinders `found` in a file is, or that another of them overlaps.

    found : of `clacad.formats.step.lens_placements.holes_in`
    mm : millimetres in a design unit
    alone : whether `found` holds holes only, so that none may have its axis in another
    """
    across = np.array(
        [[*one["at"][:2], one["diameter"]] for one in found if abs(one["axis"][2]) > 1.0 - ROOM]
    )
    across = across.reshape(-1, 3) / mm
    lost = []
    for hole in holes_of(window):
        off = np.hypot(across[:, 0] - hole.x, across[:, 1] - hole.y)
        room = ROOM * hole.diameter
        same = (off <= room) & (np.abs(across[:, 2] - hole.diameter) <= room)
        if not same.any() or (alone and (~same & (off < 0.5 * hole.diameter)).any()):
            lost.append(hole)
    return lost


def with_holes(check: Check, lost: Sequence[Hole], unit: str) -> Check:
    """Return the check of a shape, failed where holes are lost."""
    if not lost or check.state not in ("pass", "fail", "warn"):
        return check
    one = lost[0]
    words = (
        f"{check.sentence}; {len(lost)} of the holes through the plate are not where the design has them,"
        f" such as that of diameter {one.diameter:.6g} {unit} at ({one.x:.6g}, {one.y:.6g})"
    )
    return replace(check, state="fail", sentence=words)
