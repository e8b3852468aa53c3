"""Names and kinds of the export formats, available before any writer is loaded."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from clacad.base.text import did_you_mean, near
from clacad.storage.errors import UnknownFormat

if TYPE_CHECKING:
    from clacad.sheet.window import Window

FORMATS = (
    "step", "stl", "stl-parts", "3mf", "ply", "glb", "sag", "tiff", "png", "xyz", "table", "mask", "gds", "pov", "brep",
    "baffle", "frame", "pins", "coupon", "marked", "marked-stl", "marked-3mf", "zmx", "optiland",
    "drawing",
)  # fmt: skip
"""Names of the formats, as requested."""

MESHES = ("stl", "stl-parts", "marked-stl", "3mf", "ply", "glb", "marked-3mf")
"""Formats of facets: their role depends on the facet grid."""

STL_FORMATS = ("stl", "stl-parts", "marked-stl")
"""Streams of facets without shared vertices."""

WELDED_FORMATS = ("3mf", "ply", "glb", "marked-3mf")
"""Facets of shared vertices."""

REPEATING = ("3mf", "glb")
"""Formats that store one cell and its positions if the sheet is `tessellations.instanceable`."""

FUSABLE = ("step", *REPEATING)
"""Formats to which `fused` applies."""

MARKED_MESHES = ("marked-stl", "marked-3mf")
"""Meshes with their name and an arrow engraved in the border."""

PRESCRIPTIONS = ("zmx", "optiland")
"""One telescopelet as lens-design programs read it."""

SOLIDS = ("baffle", "frame", "pins", "coupon", "brep", "marked")
"""Parts modelled solid by solid; the baffle is a mesh of walls."""


OF_ANY_CELLS = (
    "step", "brep", "stl", "stl-parts", "3mf", "ply", "glb", "tiff", "png", "xyz", "table", "mask", "gds", "pov",
    "frame", "marked", "marked-stl", "marked-3mf", "drawing",
)  # fmt: skip
"""Formats that hold non-uniform sheets; the others hold one cell, or a few copies of it."""


OF_STRAIGHT_ARRAYS = ("gds", "pov")
"""Those of `OF_ANY_CELLS` that do not hold a rotated array."""
OF_ONE_SIZE = ("pov",)
"""Those of `OF_ANY_CELLS` that do not hold lenses of many sizes."""


def refuse_other_cells(window: Window, format: str) -> None:
    """Refuse a format that holds uniform sheets only, for a window of a non-uniform sheet.

    Raises
    ------
    CellsDiffer
    """
    from clacad.sheet.need_window import need_equal_cells

    turned = any(place.turn for place in window.placements)
    without = (OF_STRAIGHT_ARRAYS if turned else ()) + (OF_ONE_SIZE if window.many_sizes else ())
    held = [name for name in OF_ANY_CELLS if name not in without]
    if format not in held:
        need_equal_cells(window, f"format {format}", f"such sheets are held by: {', '.join(held)}")


def known_formats(asked: Sequence[str]) -> tuple[str, ...]:
    """Requested formats without duplicates, in the order requested.

    Raises
    ------
    UnknownFormat
        A format is unknown; the message gives the nearest name and the list.
    """
    unknown = [name for name in asked if name not in FORMATS]
    if unknown or not asked:
        hint = did_you_mean(near(unknown[0], FORMATS), before="; ") if unknown else ""
        what = f"unknown format {unknown[0]!r}{hint}" if unknown else "no format was asked for"
        raise UnknownFormat(f"{what}\n  allowed: {', '.join(FORMATS)}")
    return tuple(dict.fromkeys(asked))
