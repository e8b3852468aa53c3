"""Role of a file (master, preview, scan, tooling or other), and how files store the faces of a part.

Parts are made from an optical master, so light through it must obey the law. A preview is for viewing,
quoting and fit checks. A scan is a measured surface: it is verified, but never approved for production.
Tooling is not the part but what makes it (an insert, tool points, a dose map, a part scaled for its
shrinkage): it is judged by the part that the process makes of it.
Everything else (baffle, frame, pins, coupon, pictures' scenes) carries no light of the law, or is made into
no part (a prescription for a lens-design program, a drawing). The way of storing limits the accuracy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any


class Role(StrEnum):
    """Role of a file; manifests and reports use these words."""

    MASTER = "optical-master"
    PREVIEW = "shape-preview"
    SCAN = "scan"
    TOOLING = "tooling"
    OTHER = "other"


WORDS: Mapping[str, Role] = {
    "master": Role.MASTER,
    "preview": Role.PREVIEW,
    "scan": Role.SCAN,
    "tooling": Role.TOOLING,
    "optical-master": Role.MASTER,
    "shape-preview": Role.PREVIEW,
}
"""Words by which a role is declared; "other" cannot be declared."""


@dataclass(frozen=True, slots=True)
class Prospect:
    """Role of a file, and the forecast of the light through it.

    declared : Whether the role was requested; otherwise the forecast decided.
    quads : Facet grid per cell side; None: the file has no facets, and the following values are unused.
    law_rms : float or None, radians
        Rms direction error to the law; None where too little light gets through.
    limit : radians
    beyond : Limits of the design that the light is forecast to exceed, by their keys.
    master_quads, master_bytes : Facets, and size of the file, that a master of this format would take; None:
        no grid up to 1024 makes one.
    """

    role: Role
    declared: bool = False
    quads: int | None = None
    law_rms: float | None = None
    limit: float = 0.0
    beyond: tuple[str, ...] = ()
    master_quads: int | None = None
    master_bytes: int | None = None

    @property
    def overstated(self) -> bool:
        """Whether it is declared a master although the light is forecast beyond the limits."""
        return self.role is Role.MASTER and bool(self.beyond)

    def entry(self) -> dict[str, Any]:
        """Keys of a file's entry in the manifest."""
        told: dict[str, Any] = {"role": str(self.role), "role_declared": self.declared}
        if self.quads is None:
            return told
        told["forecast_law_rms"] = self.law_rms
        if self.beyond:
            told["forecast_beyond"] = list(self.beyond)
        if self.overstated:
            told["role_overstated"] = True
        if self.role is Role.PREVIEW:
            told |= {"master_quads": self.master_quads, "master_bytes": self.master_bytes}
        return told


@dataclass(frozen=True, slots=True)
class Holding:
    """How a family of formats stores a vertex.

    origin : "sheet", "cell" or "face"
        Origin of coordinates; "face": heights alone, from the face's reference plane.
    kind : "exact", "f64", "f32" or "levels"
        "exact" undoes the mesher's steps: vertices on the surfaces, as a reference.
    levels : Steps of a height map over the range of a face's heights.
    """

    origin: str = "sheet"
    kind: str = "f32"
    levels: int = 65534


@dataclass(frozen=True, slots=True)
class Storing:
    """A way in which formats store a part.

    holding : None: the surfaces themselves, or nothing optical.
    normals : "facet", "vertex" or "". Normals at which a reader refracts.
    """

    note: str
    holding: Holding | None = None
    normals: str = ""


IN_SHEET = Storing("float32 in sheet coordinates", Holding("sheet"), "facet")
IN_CELL = Storing("float32 in the coordinates of one cell", Holding("cell"), "facet")
DOUBLES = Storing("double precision, heights in the mesher's steps", Holding(kind="f64"), "facet")
DOUBLE_NORMALS = Storing("double precision, normals exact", Holding(kind="f64"), "vertex")
SINGLE_NORMALS = Storing("normals in float32", Holding("cell"), "vertex")
ABOVE_FACE = Storing("heights above the face's plane, float32", Holding("face"), "facet")
SIXTEEN_BITS = Storing("heights in 16 bits", Holding("face", "levels"), "facet")
LAYERS = Storing("heights in 64 layers", Holding("face", "levels", 64), "facet")
AS_PLAIN = Storing("as stl and 3mf: the lenses are the same facets")
EXACT_FACES = Storing("exact faces")
ONE_TELESCOPELET = Storing("one telescopelet; optiland: faces of two radii within 1e-13 rad of slope")
OWN_NUMBERS = Storing("the surfaces' own numbers")
AT_POINTS = Storing("exact heights and slopes at points; the reader interpolates")
NO_SURFACE = Storing("no refracting surface")

WAYS = (
    IN_SHEET,
    IN_CELL,
    DOUBLES,
    DOUBLE_NORMALS,
    SINGLE_NORMALS,
    ABOVE_FACE,
    SIXTEEN_BITS,
    LAYERS,
    AS_PLAIN,
    EXACT_FACES,
    ONE_TELESCOPELET,
    OWN_NUMBERS,
    AT_POINTS,
    NO_SURFACE,
)
"""In the order of tables."""
