"""Ways in which files store the faces of a part, which limit their accuracy."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Holding:
    """How a family of formats stores a vertex.

    Parameters
    ----------
    origin : "sheet", "cell" or "face"
        Origin of coordinates; "face": heights alone, from the face's reference plane.
    kind : "exact", "f64", "f32" or "levels"
        "exact" undoes the mesher's steps: vertices on the surfaces, as a reference.
    levels : int
        Steps of a height map over the range of a face's heights.
    """

    origin: str = "sheet"
    kind: str = "f32"
    levels: int = 65534


@dataclass(frozen=True, slots=True)
class Storing:
    """A way in which formats store a part.

    Parameters
    ----------
    note : str
    holding : Holding or None
        None: the surfaces themselves, or nothing optical.
    normals : "facet", "vertex" or ""
        Normals at which a reader refracts.
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
EXACT_FACES = Storing("exact faces; see row step")
ONE_TELESCOPELET = Storing("one telescopelet; optiland: faces of two radii within 1e-13 rad of slope")
OWN_NUMBERS = Storing("the surfaces' own numbers; see row surfaces")
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
