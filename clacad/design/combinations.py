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

    name : Name in the matrix.
    key : Key of a design that requests it.
    present : Whether the values of a design have it.
    instead : The nearest way out.
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
    TOLERANCES.shrinkage,
    TOLERANCES.shrinkage_lateral,
    TOLERANCES.gamma,
    TOLERANCES.nose,
    TOLERANCES.scatter_pitch,
    TOLERANCES.scatter_radius,
    TOLERANCES.scatter_vertex,
    getattr(TOLERANCES, "class"),
)

FEATURES: Final = (
    Feature("hexagonal cells", LATTICE.kind, lambda a: a(LATTICE.kind) == "hexagonal"),
    Feature("seam", LATTICE.seam, lambda a: bool(a(LATTICE.seam))),
    Feature("outline", LATTICE.outline, lambda a: a(LATTICE.outline) is not None),
    Feature("tilt", LAW.euler, _tilted, "theta = 0"),
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
_GROWTH: Final = "both state how delta grows over the sheet"
_PLACES: Final = "both state where the cells of array 2 lie"

_TWICE: Final = (
    ("law that varies", "other pitch", _GROWTH),
    ("law that varies", "turned array", _GROWTH),
    ("law that varies", "sharp pairs", _GROWTH),
    ("aimed at a point", "other pitch", _PLACES),
    ("aimed at a point", "turned array", _PLACES),
    ("aimed at a point", "sharp pairs", _PLACES),
    ("turned array", "sharp pairs", _PLACES),
    ("other pitch", "sharp pairs", "both state the pitch of array 2"),
    ("given faces", "sharp pairs", "both state the radii of the lenses"),
)
"""Two features that exclude one another, and the reason."""

_FEATURES_OF: Final[Mapping[str, tuple[str, ...]]] = {
    POINT: ("aimed at a point",),
    VARYING: ("law that varies",),
    PITCH_2: ("other pitch",),
    ROTATION_2: ("turned array",),
    FOCUS: ("sharp pairs",),
}
REASONS: Final[Mapping[tuple[str, str], str]] = {
    (sheet, other): why
    for sheet, own in _FEATURES_OF.items()
    for one, two, why in _TWICE
    for name, other in ((one, two), (two, one))
    if name in own
}
"""Sheet and feature → reason why they cannot be combined; combinations not listed are built."""


BUILT: Final = "built"
"""Entry of the matrix for a combination that is built."""
ITSELF: Final = "itself"


def matrix() -> list[list[str]]:
    """Rows of the combination table: a head, then one row for each feature."""
    rows = (
        [f.name, *(ITSELF if f.key == sheet else REASONS.get((sheet, f.name), BUILT) for sheet in SHEETS)]
        for f in FEATURES
    )
    return [["", *SHEETS], *rows]
