"""Array 2 of another pitch, its lenses in the middle of their own cells: a superlens, a moiré magnifier.

Cell (i, j) of array 2 stands g = p2/p1 times as far out as its partner, and so does its lens: d(C) = d + (g − 1) C, which is
a law of δ(C) = δ₀ + K C with K = (g − 1)/f1 along each lens axis. Its cells look at the nodal point.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Pair2
from clacad.prescription.radii import NoSuchLens
from clacad.sheet.cell_laws import CellLaws
from clacad.sheet.cell_places import CellPlacement
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.design import Design


def with_pitch_2(window: Window, design: Design) -> Window:
    """The window of equal cells, array 2 spread to a pitch of its own.

    Raises
    ------
    NoSuchLens
        Lens 1 has no power in a meridian: no δ tells where its partners stand.
    """
    pitch = design.lattice.pitch_2
    assert pitch is not None  # who calls this has looked
    focal = window.recipe["f"][0]
    if not np.isfinite(focal).all():
        raise NoSuchLens("eta = 1 with pitch_2: a lens without power has no axis to stand aside of",
                         key="lattice.pitch_2", code="CL111", hint="eta other than 1 in both x and y")  # fmt: skip
    return spread_to(window, pitch, focal)


def spread_to(window: Window, pitch: Pair2, focal: Pair2) -> Window:
    """The window of equal cells, array 2 spread to a pitch (lengths); `focal` (lengths) takes lens 2's place to δ."""
    place = CellPlacement(window.placements[1].shift, pitch)
    return replace(
        window,
        placements=(CellPlacement(), place),
        cell_laws=CellLaws(window.law, _gradient(window, place, focal)),
        thin=replace(window.thin, pitch=pitch),
    )


def _gradient(
    window: Window, place: CellPlacement, focal: Pair2
) -> tuple[tuple[float, float], tuple[float, float]]:
    """K, 1/length: lens axes by sheet axes."""
    (gx, gy) = place.scale(window.lattice)
    turn = window.law.rotation[:2, :2]
    (a, b), (c, d) = ((turn.T @ np.diag([gx - 1.0, gy - 1.0])) / np.asarray(focal)[:, None]).tolist()
    return (a, b), (c, d)
