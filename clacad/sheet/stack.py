"""Several sheets in series: position of each window, and the planes between which each sheet acts.

The stack's frame is that of its first sheet: z = 0 is that sheet's own plane, and lengths are in that sheet's
unit. Other sheets are displaced along z only. Sheets of other units keep their own unit; lengths are
converted where rays pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any

from clacad.base.interactive import Tabular, columns_of
from clacad.sheet.volume_and_extent import FIELD

if TYPE_CHECKING:
    from clacad.sheet.window import Body, Face, Window

MOST = len(ascii_lowercase)
"""Greatest number of sheets in a stack: one letter names each."""


class BadStack(ValueError):
    """Sheets cannot be placed as requested; exit status 2."""

    exit_status = 2


@dataclass(frozen=True, eq=False)
class StackedSheet:
    """One sheet of a stack.

    id : Name within the stack.
    z : length of the stack. Position of the sheet's own z = 0.
    scale : Stack lengths per window length.
    """

    id: str
    window: Window
    z: float
    scale: float = 1.0

    @property
    def span(self) -> tuple[float, float]:
        """Lowest and highest point of the material, lengths of the stack."""
        low, high = self.window.z_range
        return self.z + self.scale * low, self.z + self.scale * high

    @property
    def lens_planes(self) -> tuple[float, float]:
        """Entrance plane of lens 1 and exit plane of lens 2, mean of both meridians, lengths of the stack."""
        first, last = (self.z + self.scale * sum(two) / 2.0 for two in lens_planes(self.window))
        return first, last


@dataclass(frozen=True, eq=False)
class Stack(Tabular):
    """Sheets in the order light reaches them.

    Parameters
    ----------
    sheets : tuple of StackedSheet
        Separate from one another, towards +z.
    unit : float, metres
        Unit of all lengths of the stack.
    """

    sheets: tuple[StackedSheet, ...]
    unit: float

    def __repr__(self) -> str:
        return f"Stack({', '.join(f'{one.id}: {one.window.name!r} at {one.z:g}' for one in self.sheets)})"

    def to_columns(self) -> dict[str, Any]:
        """One row for each sheet: place of its z = 0, lowest and highest point of its material, lengths."""
        rows = [
            {
                "sheet": one.id,
                "design": one.window.name,
                "form": one.window.form,
                "cells": one.window.lattice.cell_count,
                "z": one.z,
                "low": one.span[0],
                "high": one.span[1],
            }
            for one in self.sheets
        ]
        return columns_of(rows)

    @property
    def gaps(self) -> tuple[float, ...]:
        """Clear distances between neighbours, from material to material, lengths."""
        return tuple(b.span[0] - a.span[1] for a, b in zip(self.sheets, self.sheets[1:]))


def stacked(windows: Sequence[Window], gaps: Sequence[float], ids: Sequence[str] | None = None) -> Stack:
    """Place windows in series.

    windows : In the order light reaches them; one window may occur several times.
    gaps : Clear distances between neighbours, ≥ 0, in the unit of the first window; one fewer than windows.
    ids : Names; None: a, b, c, …
    Raises BadStack: No windows or too many, a wrong number of gaps, or a gap that is negative or not finite.
    """
    names = [chr(ord("a") + k) for k in range(len(windows))] if ids is None else list(ids)
    if not 1 <= len(windows) <= MOST:
        raise BadStack(f"a stack of {len(windows)} sheets: it has 1 to {MOST}")
    if len(gaps) != len(windows) - 1:
        raise BadStack(
            f"{len(gaps)} gaps for {len(windows)} sheets: give one for all of them, or {len(windows) - 1}"
        )
    for gap, name in zip(gaps, names[1:]):
        if not (isfinite(gap) and gap >= 0.0):
            raise BadStack(
                f"the gap before sheet {name} is {gap:g}: it is a length from 0 on, between what is solid of"
                " both sheets"
            )
    unit = windows[0].unit
    sheets = [StackedSheet(names[0], windows[0], 0.0)]
    for window, name, gap in zip(windows[1:], names[1:], gaps):
        scale = window.unit / unit
        low = sheets[-1].span[1] + gap
        sheets.append(StackedSheet(name, window, low - scale * window.z_range[0], scale))
    return Stack(tuple(sheets), unit)


def standing(sheets: Sequence[StackedSheet], unit: float, unit_name: str) -> Stack:
    """Combine sheets with given positions, in any order, into a stack.

    unit : metres
    unit_name : Used in the message.
    Raises BadStack: Two of them overlap; the message names both, the overlap and a valid position of the
        second.
    """
    order = sorted(sheets, key=lambda one: one.span)
    for before, after in zip(order, order[1:]):
        high, low = before.span[1], after.span[0]
        if low < high:
            raise BadStack(
                f"sheet {after.id} (z from {low:.6g} to {after.span[1]:.6g} {unit_name}) overlaps sheet"
                f" {before.id} (to {high:.6g} {unit_name}): sheet.{after.id}.z >= {after.z + high - low:.9g}"
                " keeps them apart"
            )
    return Stack(tuple(order), unit)


def lens_planes(window: Window) -> tuple[tuple[float, float], tuple[float, float]]:
    """Entrance principal plane of lens 1 and exit principal plane of lens 2, ((x, y), (x, y)), z in the sheet
    frame.

    Between them the sheet acts as its ideal pair of thin lenses does over the separation; the material is
    more or less deep than that. The plane of a single face is at its vertex: each face of a slab, or the face
    of a plate that also carries a field lens. Meridians are the sheet's: lenses turned about z by less than
    45° count as not turned.
    """
    first, last = window.bodies[0], window.bodies[-1]
    if first is last or first.back.array == last.front.array == FIELD:
        return (first.front.vertex[2],) * 2, (last.back.vertex[2],) * 2
    turn = window.thin.rotation
    swapped = abs(turn[0, 0]) < abs(turn[0, 1])
    axes = ("y", "x") if swapped else ("x", "y")
    (x1, _), (y1, _) = (_principal(first, axis) for axis in axes)
    (_, x2), (_, y2) = (_principal(last, axis) for axis in axes)
    return (x1, y1), (x2, y2)


def _principal(body: Body, axis: str) -> tuple[float, float]:
    """Front and back principal plane of a lens in a meridian, z; of a plate: as of a weak lens."""
    low, high, n = body.front.vertex[2], body.back.vertex[2], body.index
    thick = (high - low) / n
    front, back = ((n - 1.0) * _curvature(face, axis) for face in (body.front, body.back))
    power = front + back - thick * front * back
    total = abs(front) + abs(back)
    if total * thick < 1e-12 or abs(power) < 1e-9 * total:
        return low + 0.5 * thick, high - 0.5 * thick
    return low + thick * back / power, high - thick * front / power


def _curvature(face: Face, axis: str) -> float:
    """Curvature of a face at its apex in a meridian, > 0 convex, 1/length."""
    return float(face.surface.curvature_x if axis == "x" else face.surface.curvature_y)
