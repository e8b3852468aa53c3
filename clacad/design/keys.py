"""All keys of a design file, from the fields of its sections, and their dotted paths.

`PAIR.separation` is the path "pair.separation". The keys themselves are declared in `clacad.design.sections`,
`clacad.design.body` and `clacad.design.limits`.
"""

from __future__ import annotations

from typing import Any, Final

from clacad.config import json_schema as schema
from clacad.config.key_reader import FileForm, head_keys
from clacad.config.keys import Key, KeyPaths, keys_of
from clacad.design.body import BodySpec
from clacad.design.limits import CheckSpec, TolerancesSpec
from clacad.design.sections import LatticeSpec, LawSpec, LightSpec, PairSpec

ROOT: Final = head_keys(
    "name of the design, used for files and reports", "unit of every bare length", "remarks the report prints"
)

SPECS: Final[dict[str, type]] = {
    "law": LawSpec,
    "pair": PairSpec,
    "lattice": LatticeSpec,
    "body": BodySpec,
    "check": CheckSpec,
    "tolerances": TolerancesSpec,
    "light": LightSpec,
}
"""Section → the dataclass whose fields are its keys."""

SECTIONS: Final[dict[str, dict[str, Key]]] = {name: keys_of(spec) for name, spec in SPECS.items()}

LAW, PAIR, LATTICE, BODY, CHECK, TOLERANCES, LIGHT = (KeyPaths(name, keys) for name, keys in SECTIONS.items())

DESIGN: Final = FileForm(
    ROOT,
    SECTIONS,
    optional=("body", "check", "tolerances", "light"),
    synonyms={
        **dict.fromkeys(("phi", "theta", "psi", "tilt", "angles"), LAW.euler),
        **dict.fromkeys(("eta_x", "eta_y"), LAW.eta),
        **dict.fromkeys(("delta_x", "delta_y", "offset"), LAW.delta),
        **dict.fromkeys(("n", "refractive_index"), PAIR.index),
        **dict.fromkeys(("gap", "distance"), PAIR.separation),
        **dict.fromkeys(("size", "cells"), LATTICE.count),
        "glass": PAIR.material,
        "lambda": PAIR.wavelength,
        "recipe": PAIR.confocal,
        "type": PAIR.form,
        "period": LATTICE.pitch,
        "shape": LATTICE.outline,
        "wall": BODY.baffle_wall,
        "dowels": BODY.pins,
        "mounting": BODY.holes,
        "chamfer": BODY.corners,
        "units": "unit",
        "version": "format",
        "title": "name",
    },
    elsewhere=dict.fromkeys(
        ("sheet", "camera", "background", "object", "effects", "animation"), ("scene", "")
    ),
)
"""Keys of a design file, their other names, and the sections of a scene file."""


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of a design file, for editors that complete keys.

    Returns
    -------
    dict
        With `$schema`, `title` and one property for each key; unknown keys are refused.
    """
    titles = {name: name.capitalize() for name in SECTIONS}
    properties = schema.properties_of(ROOT) | {
        name: {"$ref": f"#/$defs/{title}"} for name, title in titles.items()
    }
    required = schema.required_of(ROOT) + [name for name in SECTIONS if name not in DESIGN.optional]
    definitions = {title: schema.table(SECTIONS[name], title) for name, title in titles.items()}
    return schema.document("clacad design", properties, required, definitions)
