"""Array 2 with its own pitch, or turned, and lenses centred in their own cells: a superlens, a moiré
magnifier.

Cell (i, j) of array 2 and its lens lie g = p2/p1 times as far from the centre as the partner, and rotate with
the array about its centre: d(C) = d + (T g − 1) C. This is a law of δ(C) = δ₀ + K C with K = (T g − 1)/f1
along each lens axis. The cells are aimed at the nodal point. A rotation T gives K a curl. Only the positions
of lenses rotate; their axes stay those of the law.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Pair2
from clacad.prescription.radii import NoSuchLens
from clacad.sheet.cell_places import CellLaws, CellPlacement
from clacad.sheet.turn import cosine_and_sine
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.design import Design


def with_pitch_2(window: Window, design: Design) -> Window:
    """Uniform window with array 2 spread to its own pitch and turned.

    Raises
    ------
    NoSuchLens
        Lens 1 has no power in a meridian: δ does not determine the position of its partners.
    """
    pitch, turn = design.lattice.pitch_2, design.lattice.rotation_2
    focal = window.recipe["f"][0]
    if not np.isfinite(focal).all():
        key = "rotation_2" if pitch is None else "pitch_2"
        raise NoSuchLens(
            f"eta = 1 with {key}: a lens without power has no axis to stand aside of",
            key=f"lattice.{key}",
            code="CL111",
            hint="eta other than 1 in both x and y",
        )
    return spread_to(window, pitch, focal, turn)


def spread_to(window: Window, pitch: Pair2 | None, focal: Pair2, turn: float = 0.0) -> Window:
    """Uniform window with array 2 spread to a pitch (lengths) and turned (radians).

    `focal` (lengths) relates lens 2's displacement to δ.
    """
    place = CellPlacement(window.placements[1].shift, pitch, turn)
    return replace(
        window,
        placements=(CellPlacement(), place),
        cell_laws=CellLaws(window.law, _gradient(window, place, focal)),
        thin=replace(window.thin, pitch=pitch, turn=turn),
    )


def _gradient(
    window: Window, place: CellPlacement, focal: Pair2
) -> tuple[tuple[float, float], tuple[float, float]]:
    """K, 1/length: rows lens axes, columns sheet axes."""
    gx, gy = place.scale(window.lattice)
    axes = window.law.rotation[:2, :2]
    aside = np.diag([gx - 1.0, gy - 1.0])
    if place.turn:
        less, (s, _) = 2.0 * cosine_and_sine(0.5 * place.turn)[1][0] ** 2, cosine_and_sine(place.turn)[1]
        aside += np.array([[-less, -s], [s, -less]]) * [gx, gy]
    (a, b), (c, d) = ((axes.T @ aside) / np.asarray(focal)[:, None]).tolist()
    return (a, b), (c, d)
