"""Imaging by a sheet with a varying law: foci and nodal point by the law,
and the area where a superlens is one lens.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from clacad.base.digits import digits
from clacad.base.types import Pair2
from clacad.optics.law.focusing import Superlens, along_axes
from clacad.sheet.window import Window


@dataclass(frozen=True, slots=True)
class Zone:
    """Area where a superlens acts as one lens: normal light stays with its partner over `width`, (2,)
    lengths.

    moire : (2,) lengths
        Period of the pattern that both arrays make.
    """

    width: Pair2
    f_number: Pair2
    moire: Pair2


def zone_of(window: Window) -> Zone | None:
    """Zone of a sheet whose array 2 has its own pitch, along the cells' axes; None for other sheets."""
    second = window.thin.second
    if not second.own or window.cell_laws is None:
        return None
    own = window.lattice.pitch if second.pitch is None else second.pitch
    (f1x, f1y), (f2x, f2y) = window.thin.focal_length
    x, y = (
        Superlens((a, b), focal, second.turn)
        for a, b, focal in zip(window.lattice.pitch, own, ((f1x, f2x), (f1y, f2y)), strict=True)
    )
    return Zone((x.zone_period, y.zone_period), (x.f_number, y.f_number), (x.moire_period, y.moire_period))


def imaging_rows(
    window: Window, of_length: Callable[[float | Pair2], str], name: str
) -> list[tuple[str, ...]]:
    """Name, value, unit and definition of each number; empty for uniform sheets.

    `of_length` writes lengths in the unit `name`.
    """
    laws = window.cell_laws
    if laws is not None and laws.ratios is not None:
        etas = laws.ratios_of(window.lattice, window.lattice.cells())
        means = "of the cells; focal lengths and what follows from them are told of the middle one"
        return [
            (
                "eta, least and greatest",
                f"{digits(float(etas.min()))}, {digits(float(etas.max()))}",
                "",
                means,
            )
        ]
    if laws is None or laws.smooth is None:
        return []
    x, y = along_axes(laws.smooth, window.thin.separation)
    rows: list[tuple[str, ...]] = [
        (
            "focus of light from before the sheet, lens x, y",
            of_length((x.f_image, y.f_image)),
            name,
            "η/κ, from array 2",
        ),
        (
            "focus of light from behind, lens x, y",
            of_length((x.f_object, y.f_object)),
            name,
            "−1/κ, from array 1",
        ),
        (
            "nodal point, lens x, y",
            of_length((x.nodal_z, y.nodal_z)),
            name,
            "(η − 1)/κ, from array 1: light through it is not turned",
        ),
    ]
    if "focus" in window.recipe:
        ends = ("object", "-inf"), ("image", "inf")
        planes = ", ".join(
            far if (z := window.recipe["focus"][key]) is None else of_length(z) for key, far in ends
        )
        rows.append(
            (
                "planes that pairs image sharply",
                planes,
                name,
                "the object's height before array 1, the image's behind array 2",
            )
        )
    zone = zone_of(window)
    if zone is not None:
        rows += [
            ("width of one lens, x, y", of_length(zone.width), name,
             "p1²/|p2 − p1|, with a turn p1²/√((p2 − p1)² + 4 p1 p2 sin²(α/2)): over it light along the normal stays with its partner; a superlens is a lattice of lenses of that period"),
            ("F-number of one lens, x, y", ", ".join(map(digits, zone.f_number)), "", "|f2|/p1; law.varying makes one large lens"),
            ("moire period, x, y", of_length(zone.moire), name,
             "of the two arrays: no field of a cell survives beyond it; over a pitch it is the magnification of a moire magnifier"),
        ]  # fmt: skip
    return rows
