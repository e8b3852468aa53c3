"""Features that can be combined with a non-uniform sheet:
one table for refusals and for the printed matrix.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from clacad.design.sections import BODY, LATTICE, LAW, PAIR, TOLERANCES, AimedAt

Ask = Callable[[str], Any]


@dataclass(frozen=True, slots=True)
class Feature:
    """A feature of a design that may be combined with a non-uniform sheet.

    Parameters
    ----------
    name : str
        Name in the matrix.
    key : str
        Key of a design that requests it.
    present : callable
        Whether the values of a design have it.
    instead : str
        The nearest way out.
    """

    name: str
    key: str
    present: Callable[[Ask], bool]
    instead: str = ""


def has_point(a: Ask) -> bool:
    """Whether the sheet is aimed at a point."""
    return isinstance(a(POINT), AimedAt)


def has_plate(a: Ask) -> bool:
    """Whether bodies end at a polygon, or have holes, corners or pins."""
    outline = a(LATTICE.outline)
    polygon = outline is not None and outline.shape not in ("circle", "rectangle")
    return polygon or any(bool(a(key)) for key in (BODY.holes, BODY.corners, BODY.pins))


def _tilted(a: Ask) -> bool:
    """Whether lenses are tilted against the sheet."""
    return bool((a(LAW.euler) or (0.0, 0.0, 0.0))[1])


def _images(a: Ask) -> bool:
    """Whether the law varies in order to image planes."""
    varying = a(LAW.varying)
    return varying is not None and (varying.f_image or varying.conjugates) is not None


def _focused(a: Ask) -> bool:
    """Whether pairs are requested to image two planes sharply."""
    return a(PAIR.focus) is not None


def _field_lens(a: Ask) -> bool:
    """Whether there are faces with cells of a field lens."""
    return bool(a(PAIR.field_lens)) or any(face.array == "field" for face in a(PAIR.face) or ())


def _is_slope(a: Ask) -> bool:
    """Whether the aperture is a slope, neither a word nor a point."""
    aperture = a(LATTICE.aperture)
    return aperture not in (None, "centred", "aligned") and not has_point(a)


def _auto_thickness(a: Ask) -> bool:
    """Whether the thickness of biconvex lenses is to be solved."""
    return a(PAIR.form) == "biconvex" and a(PAIR.thickness) in (None, "auto")


def _tolerated(a: Ask) -> bool:
    """Whether any tolerance is stated."""
    return any(a(key) not in (None, 0.0, (0.0, 0.0)) for key in _TOLERATED)


_TOLERATED: Final = (
    TOLERANCES.decentre,
    TOLERANCES.rotation,
    TOLERANCES.separation,
    TOLERANCES.radius,
    TOLERANCES.index,
    TOLERANCES.thickness,
    TOLERANCES.tilt,
    TOLERANCES.roughness,
)

FEATURES: Final = (
    Feature("hexagonal cells", LATTICE.kind, lambda a: a(LATTICE.kind) == "hexagonal"),
    Feature("seam", LATTICE.seam, lambda a: bool(a(LATTICE.seam))),
    Feature("outline", LATTICE.outline, lambda a: a(LATTICE.outline) is not None),
    Feature("tilt", LAW.euler, _tilted, "theta = 0"),
    Feature(
        "tilt where planes are imaged",
        LAW.euler,
        lambda a: _tilted(a) and _images(a),
        "theta = 0, or gradient or table instead of planes",
    ),
    Feature("offset", LAW.delta, lambda a: any(a(LAW.delta) or ())),
    Feature("biconvex", PAIR.form, lambda a: a(PAIR.form) == "biconvex", 'form = "slab"'),
    Feature("plano", PAIR.form, lambda a: a(PAIR.form) == "plano", 'form = "slab"'),
    Feature("slab", PAIR.form, lambda a: a(PAIR.form) == "slab"),
    Feature(
        "given faces",
        PAIR.prescription,
        lambda a: a(PAIR.prescription) == "given",
        'prescription = "derived"',
    ),
    Feature("tolerances", "tolerances", _tolerated, "leave [tolerances] out"),
    Feature("aimed at a point", LATTICE.aperture, has_point, 'aperture = "centred", or a slope'),
    Feature("steered", LATTICE.aperture, _is_slope, 'aperture = "centred"'),
    Feature("traced vertices", PAIR.offset, lambda a: a(PAIR.offset) == "traced", 'offset = "paraxial"'),
    Feature("law that varies", LAW.varying, lambda a: a(LAW.varying) is not None, "leave one of the two out"),
    Feature(
        "other pitch", LATTICE.pitch_2, lambda a: a(LATTICE.pitch_2) is not None, "leave one of the two out"
    ),
    Feature(
        "turned array", LATTICE.rotation_2, lambda a: bool(a(LATTICE.rotation_2)), "leave one of the two out"
    ),
    Feature("sharp pairs", PAIR.focus, _focused, "leave one of the two out"),
    Feature(
        "curved inside",
        PAIR.curved,
        lambda a: a(PAIR.form) == "plano" and a(PAIR.curved) == "inside",
        'curved = "outside"',
    ),
    Feature("thin recipe", PAIR.confocal, lambda a: a(PAIR.confocal) == "thin", 'confocal = "exact"'),
    Feature("confocal best", PAIR.confocal, lambda a: a(PAIR.confocal) == "best", 'confocal = "exact"'),
    Feature("plate with holes, corners or pins", BODY.holes, has_plate, "plain edges"),
    Feature(
        "plate with an outline of its own",
        BODY.outline,
        lambda a: a(BODY.outline) is not None,
        "body.border, or the edge of lattice.outline",
    ),
    Feature("field lens", PAIR.field_lens, _field_lens, "field_lens = false"),
    Feature("baffle", BODY.baffle, lambda a: bool(a(BODY.baffle)), "baffle = false"),
    Feature(
        "eta_x and eta_y that differ", LAW.eta, lambda a: a(LAW.eta)[0] != a(LAW.eta)[1], "eta_x = eta_y"
    ),
    Feature("depth of a lens", PAIR.depth, lambda a: a(PAIR.depth) is not None, "leave depth out"),
    Feature("biconvex of a thickness to be found", PAIR.thickness, _auto_thickness, "thickness = a length"),
)


POINT: Final = LATTICE.aperture
VARYING: Final = LAW.varying
PITCH_2: Final = LATTICE.pitch_2
ROTATION_2: Final = LATTICE.rotation_2
FOCUS: Final = PAIR.focus
SHEETS: Final[Mapping[str, Callable[[Ask], bool]]] = {
    POINT: has_point,
    VARYING: lambda a: a(VARYING) is not None,
    PITCH_2: lambda a: a(PITCH_2) is not None,
    ROTATION_2: lambda a: bool(a(ROTATION_2)),
    FOCUS: _focused,
}
"""Kind of non-uniform sheet, named by the key that requests it → whether a design requests it."""
ETAS: Final = "eta in law.varying.table"
"""Kind of `law.varying` that is known only after reading its table."""

_ONE_WAY: Final = "lenses 2 are traced for light of one direction over the sheet"
_NODAL: Final = "its cells look at the nodal point"
_CHIEF: Final = "its cells look along its chief rays"
_ALONG: Final = "its radii are for light along the axis alone"
_FIELD: Final = "field lenses would have a different place in every cell"
_HEIGHTS: Final = (
    "its lenses 2 are centred on their cells in one plane, and tilted pairs would need them to rise"
    " with their places"
)
_PATTERN: Final = "the cells that a plate keeps are those of one pattern, and array 2 has another"
_CHANNELS: Final = "the channels of a baffle are alike, and here each would lean its own way"
_APART: Final = (
    "its cells are aligned with their partners, and images of sharp pairs would not fall on one another"
)
_FOLLOWS: Final = "the pitch of array 2 follows from the two planes"

_OWN_ARRAY: Final[Mapping[str, str]] = {
    "tilt": _HEIGHTS,
    "tilt where planes are imaged": _HEIGHTS,
    "aimed at a point": _NODAL,
    "steered": _NODAL,
    "traced vertices": "its lenses are centred on their own cells",
    "law that varies": "the places of its lenses are its law",
    "sharp pairs": _FOLLOWS,
    "confocal best": _ALONG,
    "plate with holes, corners or pins": _PATTERN,
    "plate with an outline of its own": _PATTERN,
    "field lens": _FIELD,
    "baffle": _CHANNELS,
}
"""Features excluded from a sheet whose array 2 has another pitch, or is turned → reason."""

_VARIED: Final[Mapping[str, str]] = {
    "tilt where planes are imaged": (
        "cells of a sheet inclined to its lenses are at many distances from a plane across them"
    ),
    "aimed at a point": _ONE_WAY,
    "other pitch": "its cells are aligned with their partners",
    "turned array": "its cells are aligned with their partners",
    "sharp pairs": _APART,
    "confocal best": _ALONG,
    "plate with holes, corners or pins": _PATTERN,
    "plate with an outline of its own": _PATTERN,
    "field lens": _FIELD,
    "baffle": _CHANNELS,
}
"""Features excluded from a sheet with a varying law → reason."""

_WHY_NOT: Final[Mapping[str, Mapping[str, str]]] = {
    POINT: {
        "tilt where planes are imaged": _ONE_WAY,
        "law that varies": _ONE_WAY,
        "other pitch": _NODAL,
        "turned array": _NODAL,
        "sharp pairs": _CHIEF,
        "confocal best": _ALONG,
        "plate with holes, corners or pins": _PATTERN,
        "plate with an outline of its own": _PATTERN,
        "field lens": _FIELD,
        "baffle": _CHANNELS,
    },
    VARYING: _VARIED,
    ETAS: {
        **_VARIED,
        "given faces": "its faces are of one size as they are given",
        "eta_x and eta_y that differ": "its lenses are one figure in many sizes, the same along both axes",
        "depth of a lens": "the depth is that of lenses of one size",
        "biconvex of a thickness to be found": (
            "the thickness that is found is that for lenses of law.eta alone"
        ),
    },
    PITCH_2: _OWN_ARRAY,
    ROTATION_2: _OWN_ARRAY,
    FOCUS: {
        "tilt": _HEIGHTS,
        "tilt where planes are imaged": _HEIGHTS,
        "given faces": "its faces follow from the two planes",
        "tolerances": "a study of tolerances holds parallel light against the law, and sharp pairs focus it",
        "aimed at a point": _CHIEF,
        "steered": _CHIEF,
        "traced vertices": "its lenses are centred on their own cells",
        "law that varies": _APART,
        "other pitch": _FOLLOWS,
        "turned array": _CHIEF,
        "thin recipe": "it leaves out the thickness that sharp lenses are solved for",
        "confocal best": "its radii are for parallel light along the axis",
        "plate with holes, corners or pins": _PATTERN,
        "plate with an outline of its own": _PATTERN,
        "field lens": "there is no common focus at which it could be mounted",
        "baffle": _CHANNELS,
    },
}
REASONS: Final[Mapping[tuple[str, str], str]] = {
    (sheet, feature): why for sheet, whys in _WHY_NOT.items() for feature, why in whys.items()
}
"""Sheet and feature → reason why they cannot be combined; combinations not listed are built."""


BUILT: Final = "built"
"""Entry of the matrix for a combination that is built."""
ITSELF: Final = "itself"
_PART_OF: Final = {ETAS: VARYING}


def built_sheets(a: Ask) -> list[str]:
    """Kinds of non-uniform sheet that a design requests."""
    return [name for name, asked in SHEETS.items() if asked(a)]


def why_not(sheet: str, feature: str) -> str:
    """Return the reason why a sheet is not built with a feature, "" if it is built."""
    return REASONS.get((sheet, feature), "")


def matrix() -> list[list[str]]:
    """Rows of the combination table: a head, then one row for each feature."""
    kinds = [*SHEETS, ETAS]
    rows = (
        [f.name, *(ITSELF if f.key in (s, _PART_OF.get(s)) else why_not(s, f.name) or BUILT for s in kinds)]
        for f in FEATURES
    )
    return [["", *kinds], *rows]
