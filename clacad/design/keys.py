"""All keys of a design file: kind, default and meaning. This module is the only place of the list.

The reader, the JSON Schema, the suggestions for misspelt keys and the canonical text all use it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final

from clacad.base import units
from clacad.base.text import did_you_mean, near
from clacad.base.units import Unit
from clacad.config.compound_kinds import InlineTable, ListOf, ListOrTable, Several, WordOr
from clacad.config.quantities import Quantity
from clacad.config.value_kinds import (
    LARGEST_COUNT,
    Flag,
    JsonSchema,
    Kind,
    Refusal,
    Text,
    Whole,
    Word,
    not_this,
)
from clacad.design.given_faces import FACES
from clacad.design.plate_keys import CORNERS, HOLES, PINS, POLYGON
from clacad.design.search_record import SEARCH
from clacad.design.varying import PLANES, VARYING

FORMAT: Final = 1
REQUIRED: Final = object()
"""Marks a key without a default."""


@dataclass(frozen=True, slots=True)
class Key:
    """One key of the file.

    Parameters
    ----------
    kind : Kind
        Reads the value.
    about : str
        Meaning, one line.
    default : object
        Converted value of an absent key; `REQUIRED` if the key must be written.
    """

    kind: Kind
    about: str
    default: Any = None


@dataclass(frozen=True, slots=True)
class UnitWord:
    """The value of `unit`."""

    def read(self, value: object, unit: Unit) -> str:
        """Return the text; its length in metres is `units.design_unit`."""
        if not isinstance(value, str):
            raise Refusal("CL104", not_this(value, "a text"), value, self.allowed(unit))
        if units.design_unit(value) is None:
            words = ("nm", "um", "mm", "cm", "m", "in")
            hint = did_you_mean(near(value.lower(), words, 0.5), quote='"')
            raise Refusal("CL105", "is not a length", value, self.allowed(unit), hint)
        return value

    def allowed(self, unit: Unit) -> str:
        """Return the words of the message."""
        return '"m" | "cm" | "mm" | "um" | "nm" | "in", or a length such as "100 mm"'

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of a string."""
        return {"type": "string", "examples": ["mm", "um", "m", "100 mm"]}


@dataclass(frozen=True, slots=True)
class FormatVersion:
    """The value of `format`: the version of the file format, so that old files stay readable forever."""

    def read(self, value: object, unit: Unit) -> int:
        """Return the version; refuse an unsupported one."""
        if isinstance(value, bool) or not isinstance(value, int):
            raise Refusal("CL104", not_this(value, "a whole number"), value, self.allowed(unit))
        if value != FORMAT:
            raise Refusal("CL109", "is not a format this version reads", value, self.allowed(unit))
        return value

    def allowed(self, unit: Unit) -> str:
        """Return the supported versions."""
        return str(FORMAT)

    def schema(self) -> JsonSchema:
        """Return the JSON Schema of a constant."""
        return {"const": FORMAT}


_ABOVE_0, _FROM_0 = (
    Quantity("length", "a length > 0", above=0.0),
    Quantity("length", "a length >= 0", least=0.0),
)
_ETA = Quantity("ratio", "a number, not 0, from -1e6 to 1e6", least=-1e6, most=1e6)
_DELTA = Quantity("ratio", "a number from -1e6 to 1e6", least=-1e6, most=1e6)
_EULER = Quantity("angle", "an angle from -36000 to 36000 deg", least=-36000.0, most=36000.0, degrees=True)
_CONIC = Quantity("ratio", "a number from -1e6 to 1e6", least=-1e6, most=1e6)
_SLOPE = Quantity("ratio", "a slope from -100 to 100", least=-100.0, most=100.0)
_INDEX = Quantity("ratio", "a number > 1, at most 10", above=1.0, most=10.0)
_WAVELENGTH = Quantity("wavelength", "a wavelength from 10 nm to 1 mm", least=1e-8, most=1e-3)
_TURN = Quantity("angle", "an angle from -45 to 45 deg", least=-math.pi / 4, most=math.pi / 4, bare=False)
_SMALL_ANGLE = Quantity("angle", "an angle >= 0 and below 90 deg", least=0.0, most=math.pi / 2)
_LIMIT_ANGLE = Quantity("angle", "an angle > 0, at most 90 deg", above=0.0, most=math.pi / 2, bare=False)
_NO_ANGLE = Quantity("angle", "an angle >= 0 and below 90 deg", least=0.0, most=math.pi / 2, bare=False)
_DIOPTRES = Quantity("ratio", "a number > 0, in dioptres (1/m)", above=0.0)
_PART_FROM_0 = Quantity("ratio", "a number >= 0, at most 1", least=0.0, most=1.0)
_LIMIT_LENGTH = Quantity("length", "a length >= 0", least=0.0, bare=False)
_PART = Quantity("ratio", "a number > 0, at most 1", above=0.0, most=1.0)
_FACTOR = Quantity("ratio", "a number > 0, at most 1000", above=0.0, most=1000.0)
_LATERAL = Quantity("length", "a length")
_XY = ("x", "y")
_LENSES = ("lens 1", "lens 2")
_ARRAYS = ("array 1", "array 2")

ROOT: Final[dict[str, Key]] = {
    "format": Key(FormatVersion(), "version of this file's format", REQUIRED),
    "name": Key(
        Text("a text of 1 to 80 letters, digits, spaces and - _ . , + ( ) =", 80, plain=True),
        "name of the design, used for files and reports",
        REQUIRED,
    ),
    "unit": Key(UnitWord(), "unit of every bare length", REQUIRED),
    "notes": Key(
        ListOf(Text("a text of 1 to 500 characters", 500), "texts"), "remarks the report prints", ()
    ),
}
LAW: Final[dict[str, Key]] = {
    "eta": Key(
        Several(_ETA, _XY, not_all=(0.0, 1.0), example="[-1.0, -1.0]"),
        "eta_i = -f2_i/f1_i in the lens frame",
        REQUIRED,
    ),
    "delta": Key(Several(_DELTA, _XY), "delta_i = d_i/f1_i, offset of lens 2", (0.0, 0.0)),
    "euler": Key(Several(_EULER, ("phi", "theta", "psi")), "turns about z, x, z", (0.0, 0.0, 0.0)),
    "euler_axes": Key(Word(("fixed", "moving")), "whether the turns are about fixed or moving axes", "fixed"),
    "varying": Key(VARYING, "how delta varies over the sheet: f_image, conjugates, gradient or table"),
}
PAIR: Final[dict[str, Key]] = {
    "form": Key(Word(("biconvex", "plano", "slab")), "how a lenslet pair is built", REQUIRED),
    "separation": Key(_ABOVE_0, "biconvex: centre to centre; plano: f1 + f2 in air; slab: thickness / index"),
    "thickness": Key(WordOr(("auto",), Several(_ABOVE_0, _LENSES, single=True)), "centre thickness", "auto"),
    "web": Key(_FROM_0, "biconvex: thickness of the plate that joins the lenslets of an array"),
    "confocal": Key(Word(("exact", "thin", "best")), "recipe for the radii", "exact"),
    "surface": Key(Word(("ellipsoid", "biconic")), "shape of the lens faces", "ellipsoid"),
    "conic": Key(Several(_CONIC, _XY), "biconic: conic constants"),
    "depth": Key(Several(_ABOVE_0, _LENSES, single=True), "ellipsoid: semi-axis along the optical axis"),
    "curved": Key(Word(("outside", "inside")), "plano: which faces are curved", "outside"),
    "index": Key(_INDEX, "refractive index"),
    "material": Key(Text("the name of a material", 60), "material instead of an index"),
    "wavelength": Key(_WAVELENGTH, "design wavelength", 550e-9),
    "prescription": Key(
        Word(("derived", "given")),
        "derived: faces follow from eta and delta; given: they stand in [[pair.face]]",
        "derived",
    ),
    "face": Key(FACES, "given: the faces in the order light meets them, in their own lens frames", ()),
    "vertex": Key(Several(_LATERAL, _XY), "given: lens 2's offset (d_x, d_y) instead of delta f1"),
    "offset": Key(
        Word(("paraxial", "traced")),
        "where lens 2 stands: by paraxial rays, or where the mean traced light of its cell obeys the law (default where cells differ)",
    ),
    "search": Key(
        SEARCH, "given: where the faces come from; clacad optimise writes it, nothing is built from it"
    ),
    "field_lens": Key(Flag(), "lenses at the common focus, which image lens 1 onto lens 2", False),
    "field": Key(
        InlineTable((("conic", _CONIC), ("gap", _ABOVE_0))),
        "field lens: conic constant of its faces, and air gap between the plates of a slab",
    ),
    "focus": Key(
        WordOr(("afocal",), PLANES),
        "afocal: parallel light leaves parallel; or two planes that every pair images sharply to one another",
        "afocal",
    ),
}
_OUTLINE: Final = InlineTable(
    (
        ("circle", _ABOVE_0),
        ("rectangle", Several(_ABOVE_0, ("width", "height"))),
        ("polygon", POLYGON),
        ("dxf", Text("the name of a DXF file in the design's folder", 200)),
    ),
    exactly_one=True,
)
LATTICE: Final[dict[str, Key]] = {
    "kind": Key(Word(("square", "rectangular", "hexagonal")), "pattern of the cells", "square"),
    "pitch": Key(Several(_ABOVE_0, _XY, single=True), "size of a cell", REQUIRED),
    "count": Key(
        Several(Whole(f"a whole number from 1 to {LARGEST_COUNT}"), ("n1", "n2"), single=True),
        "number of cells; may be left out with an outline, which is then filled",
    ),
    "seam": Key(_FROM_0, "width of the land along cell borders", 0.0),
    "seam_depth": Key(_ABOVE_0, "plano, slab: how far the land lies below the deepest optical point"),
    "outline": Key(_OUTLINE, "outer shape of the cells; cells wholly inside are kept"),
    "aperture": Key(
        WordOr(
            ("centred", "aligned"),
            ListOrTable(
                Several(_SLOPE, _XY),
                InlineTable((("point", Several(_LATERAL, ("x", "y", "z"))),), required=("point",)),
            ),
        ),
        "where cell 2 of a telescopelet stands; point: where the light of a viewer there arrives",
        "centred",
    ),
    "land": Key(Word(("clear", "opaque")), "whether land lets light through", "clear"),
    "pitch_2": Key(
        Several(_ABOVE_0, _XY, single=True), "size of a cell of array 2, where it is another: a superlens"
    ),
    "rotation_2": Key(
        _TURN, "turn of array 2 against array 1 about the sheet's normal: a moire magnifier", 0.0
    ),
}
BODY: Final[dict[str, Key]] = {
    "border": Key(
        _FROM_0, "width of the land round the sheet, beyond lattice.outline where there is one", 0.0
    ),
    "outline": Key(
        _OUTLINE,
        "edge of the plate where it is not that of the cells, which lie wholly inside; instead of border",
    ),
    "corners": Key(CORNERS, "rounded or chamfered corners of a rectangular plate"),
    "holes": Key(HOLES, "round holes through every plate, in its border", ()),
    "pins": Key(PINS, "dowel pins that align both plates: holes through both, and their play"),
    "neck": Key(_ABOVE_0, "least thickness left at a border between cells"),
    "baffle": Key(Flag(), "opaque honeycomb between the arrays", False),
    "baffle_wall": Key(_ABOVE_0, "wall thickness of the baffle"),
    "frame": Key(
        InlineTable((("width", _ABOVE_0), ("height", _ABOVE_0)), required=("width",)),
        "opaque frame round the sheet",
    ),
    "roughness": Key(_FROM_0, "rms roughness of the optical faces", 0.0),
    "slope_rms": Key(_SMALL_ANGLE, "rms slope error of the optical faces", 0.0),
}
CHECK: Final[dict[str, Key]] = {
    "field": Key(_LIMIT_ANGLE, "half angle of the cone of test rays", math.radians(1.0)),
    "field_centre": Key(Word(("axis", "normal")), "middle of that cone", "axis"),
    "process": Key(
        Word(("none", "diamond-turning", "two-photon", "greyscale", "moulding", "sla")),
        "process profile",
        "none",
    ),
    "law_rms": Key(_LIMIT_ANGLE, "limit of the rms law error", 0.003),
    "law_bias": Key(_LIMIT_ANGLE, "limit of the mean law error at a field point", 0.0025),
    "mesh_law_rms": Key(_LIMIT_ANGLE, "limit of the rms law error through facets"),
    "eta": Key(_PART, "limit of the relative error of eta", 0.01),
    "delta": Key(_PART, "limit of the error of delta", 0.005),
    "confocality": Key(_PART, "limit of the afocal defect over the separation"),
    "throughput": Key(_PART, "least share of the closed form that must pass", 0.9),
    "cover": Key(_PART, "least share of each optical cell that is lens", 1.0 - 1e-9),
    "clearance": Key(_LIMIT_LENGTH, "least gap between the bodies"),
    "graph": Key(_PART, "least z component of a face's normal", 0.1),
    "edge": Key(_LIMIT_LENGTH, "least edge thickness (instead of the profile's)"),
    "neck": Key(_LIMIT_LENGTH, "least neck thickness (instead of the profile's)"),
    "radius": Key(_LIMIT_LENGTH, "least radius of curvature (instead of the profile's)"),
    "sag": Key(_LIMIT_LENGTH, "largest sag (instead of the profile's)"),
    "part_height": Key(_LIMIT_LENGTH, "greatest height of a whole part (instead of the profile's)"),
    "part_width": Key(_LIMIT_LENGTH, "greatest width of a whole part (instead of the profile's)"),
    "materials": Key(
        ListOf(Text("the name of a material", 60), "texts"),
        "materials that can be worked (instead of the profile's)",
    ),
    "pitch": Key(_LIMIT_LENGTH, "least pitch (instead of the profile's)"),
    "tool": Key(_LIMIT_LENGTH, "nose radius of the tool (instead of the profile's)"),
    "wall": Key(_LIMIT_LENGTH, "highest step between neighbours (instead of the profile's)"),
    "draft": Key(
        _NO_ANGLE, "least angle of walls and faces to the sheet's normal (instead of the profile's)"
    ),
    "slope": Key(_LIMIT_ANGLE, "steepest slope of a face (instead of the profile's)"),
    "voxel": Key(_LIMIT_LENGTH, "lateral size of a voxel, pixel or spot (instead of the profile's)"),
    "layer": Key(_LIMIT_LENGTH, "thickness of a layer (instead of the profile's)"),
    "aspect": Key(_FACTOR, "greatest height over width of a feature (instead of the profile's)"),
    "volume": Key(_PART, "limit of the relative error of a file's volume", 1e-9),
    "shape": Key(_FACTOR, "limit of a mesh's sag error over the stated one", 1.1),
    "file_rms": Key(_FACTOR, "limit of a mesh's direction error over its forecast", 1.25),
    "pose": Key(_PART, "limit of a returned file's pose residual over the pitch", 0.05),
    "scale": Key(_PART, "limit of a returned file's shrink", 0.001),
    "fresnel_number": Key(_FACTOR, "Fresnel number below which a warning is given", 10.0),
    "viewed": Key(
        _PART, "least share of the viewer's light that must obey the law over the whole sheet", 0.9
    ),
    "viewer": Key(
        _ABOVE_0, "distance of the eye before array 1 (1 m); where written, the check viewed judges"
    ),
    "object": Key(_ABOVE_0, "distance behind the sheet of what is looked at (ten separations)"),
    "allow": Key(
        ListOf(
            InlineTable(
                (
                    ("code", Text("a code such as CL311", 5, pattern="CL[0-9]{3}")),
                    ("reason", Text("a text of 1 to 500 characters", 500)),
                ),
                required=("code", "reason"),
            ),
            "tables",
        ),
        "warnings that are accepted, each with a reason",
        (),
    ),
}
TOLERANCES: Final[dict[str, Key]] = {
    "decentre": Key(
        Several(_LIMIT_LENGTH, _ARRAYS, single=True), "an array's displacement in x and in y", (0.0, 0.0)
    ),
    "rotation": Key(_NO_ANGLE, "turn of array 2 against array 1 about the sheet's normal", 0.0),
    "separation": Key(
        _LIMIT_LENGTH, "displacement of array 2 along the sheet's normal (not for a slab)", 0.0
    ),
    "radius": Key(
        Several(_PART_FROM_0, _ARRAYS, single=True), "relative error of the radii of a face", (0.0, 0.0)
    ),
    "index": Key(_PART_FROM_0, "error of the refractive index of a body", 0.0),
    "thickness": Key(Several(_LIMIT_LENGTH, _ARRAYS, single=True), "error of a centre thickness", (0.0, 0.0)),
    "tilt": Key(_NO_ANGLE, "tilt of array 2 against array 1 about x and about y", 0.0),
    "roughness": Key(_LIMIT_LENGTH, "rms roughness of the optical faces, from 0 up", 0.0),
    "distribution": Key(
        Word(("normal", "uniform")),
        "normal: a tolerance is two standard deviations; uniform: it is the end",
        "normal",
    ),
    "samples": Key(
        Whole("a whole number from 1 to 1e7", most=10_000_000), "sheets drawn by Monte Carlo", 1000
    ),
    "seed": Key(Whole("a whole number from 0 to 1e9", least=0, most=1_000_000_000), "seed of the draws", 0),
    "image_shift": Key(_LIMIT_ANGLE, "largest image shift of a good sheet"),
    "blur": Key(_LIMIT_ANGLE, "largest rms blur of a good sheet"),
    "residual_power": Key(_DIOPTRES, "largest residual power of a good sheet"),
    "moire_period": Key(_LIMIT_LENGTH, "least moire period of a good sheet"),
}
LIGHT: Final[dict[str, Key]] = {
    "coherent": Key(Flag(), "whether the light is one wave over many cells, as a laser's", False),
}
SECTIONS: Final[dict[str, dict[str, Key]]] = {
    "law": LAW,
    "pair": PAIR,
    "lattice": LATTICE,
    "body": BODY,
    "check": CHECK,
    "tolerances": TOLERANCES,
    "light": LIGHT,
}
OPTIONAL: Final = ("body", "check", "tolerances", "light")
"""Sections that may be left out."""


SYNONYMS: Final[dict[str, str]] = {
    "phi": "law.euler", "theta": "law.euler", "psi": "law.euler", "tilt": "law.euler", "angles": "law.euler",
    "eta_x": "law.eta", "eta_y": "law.eta", "delta_x": "law.delta", "delta_y": "law.delta", "offset": "law.delta",
    "n": "pair.index", "refractive_index": "pair.index", "glass": "pair.material", "lambda": "pair.wavelength",
    "gap": "pair.separation", "distance": "pair.separation", "recipe": "pair.confocal", "type": "pair.form",
    "period": "lattice.pitch", "size": "lattice.count", "cells": "lattice.count", "shape": "lattice.outline",
    "wall": "body.baffle_wall", "units": "unit", "dowels": "body.pins", "mounting": "body.holes", "chamfer": "body.corners", "version": "format", "title": "name",
}  # fmt: skip
"""Other names of keys → key."""

SCENE_SECTIONS: Final = ("sheet", "camera", "background", "object", "effects", "animation")
"""Sections of a scene file, which is a separate file."""


def homes(name: str) -> list[str]:
    """Return the dotted keys whose last part is this name ("pitch" → lattice.pitch, check.pitch)."""
    return [f"{section}.{name}" for section, keys in SECTIONS.items() if name in keys] + (
        [name] if name in ROOT or name in SECTIONS else []
    )


def suggestion(section: str, name: str) -> str:
    """Return the dotted key a person probably meant, "" if none is near.

    Parameters
    ----------
    section : str
        Section that contains the unknown key, "" for the top level (or for an unknown section).
    name : str
        The unknown key.
    """
    here = SECTIONS.get(section, {}) if section else {**ROOT, **SECTIONS}
    dot = f"{section}." if section else ""
    folded = name.lower().replace("-", "_")
    if folded in here:
        return dot + folded
    if folded in SYNONYMS:
        return SYNONYMS[folded]
    elsewhere = homes(folded)
    if elsewhere:
        return elsewhere[0]
    close = near(folded, here, 0.65)
    if close:
        return dot + close[0]
    every = [key for keys in SECTIONS.values() for key in keys] + list(ROOT)
    close = near(folded, every, 0.75)
    return homes(close[0])[0] if close else ""


def known_in(section: str) -> str:
    """Return the keys of a section as messages list them."""
    names = list(SECTIONS[section]) if section in SECTIONS else [*ROOT, *(f"[{name}]" for name in SECTIONS)]
    return ", ".join(names)
