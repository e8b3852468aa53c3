"""Rays through whole sheets where cell, border and distance are the difficulty; each with its reason."""

from __future__ import annotations

from dataclasses import dataclass

from clacad import Design, prescribe

BASE = {
    "format": 1,
    "name": "hard",
    "unit": "m",
    "law": {"eta": [-0.25, -1.0]},
    "pair": {"form": "biconvex", "separation": 0.05, "thickness": 0.001, "index": 1.5},
    "lattice": {"kind": "square", "pitch": 0.005, "count": [200, 200]},
}


def window_of(changes):
    """The paper's sheet with some keys changed; None takes a key away."""
    data = {key: dict(value) if isinstance(value, dict) else value for key, value in BASE.items()}
    for key, value in changes.items():
        section, name = key.split(".")
        part = data.setdefault(section, {})
        part[name] = value
        if value is None:
            del part[name]
    return prescribe(Design.from_dict(data))


@dataclass(frozen=True)
class HardSheet:
    """A sheet, a ray, and why the ray is hard; `facets`: why facets cannot decide its fate."""

    name: str
    why: str
    changes: tuple
    start: tuple
    direction: tuple
    undecidable: bool = False
    facets: str = ""


def sheet(name, why, start, direction, undecidable=False, facets="", **changes):
    """A case; keys of the design with __ for the dot."""
    pairs = tuple((key.replace("__", "."), value) for key, value in changes.items())
    return HardSheet(name, why, pairs, start, direction, undecidable, facets)


ONTO_BORDER = "lens 1 sends the light onto a border of lens 2, nearer than its facets' slope error carries it"
MILLION, MILLIARD = [2_000_000, 2_000_000], [2_000_000_000, 2_000_000_000]
SLAB = {"pair__form": "slab", "pair__thickness": None}
FIELD = {"pair__field_lens": True}
TINY = {"lattice__pitch": 5e-7, "pair__separation": 5e-6, "pair__thickness": 1e-7}
HUGE = {"lattice__pitch": 5e6, "pair__separation": 5e7, "pair__thickness": 1e6}
SHEETS = [
    sheet("last cell", "cell (199, 199): sheet coordinates cost four bits", (0.4981, 0.4972, -0.01), (-0.02, 0.01, 1)),
    sheet("first cell", "cell (0, 0), the other end", (-0.4981, -0.4972, -0.01), (0.02, -0.01, 1)),
    sheet("on a border", "the wall belongs to the cell above it", (0.005, 0.0012, -0.01), (0, 0, 1)),
    sheet("on a corner", "four cells meet in one point", (0.005, -0.01, -0.01), (0, 0, 1), facets=ONTO_BORDER),
    sheet("one place below a corner", "the quotient rounds onto the corner", (0.004999999999999999, -0.010000000000000002, -0.01), (0, 0, 1), facets=ONTO_BORDER),
    sheet("along a border", "every hit lies on the wall", (0.005, 0.0012, -0.01), (0, 0.02, 1)),
    sheet("through a corner, oblique", "front and back lie in different cells", (0.005 - 1e-5, -0.01 - 2e-5, -0.0105), (0.001, 0.002, 1)),
    sheet("on the outer rim", "the last wall belongs to no cell", (0.5, 0.1012, -0.01), (0, 0, 1), undecidable=True),
    sheet("one place inside the rim", "the last light that counts", (0.49999999999999994, 0.1012, -0.01), (0, 0, 1)),
    sheet("outside the rim", "no cell is met", (0.5000001, 0.1012, -0.01), (0, 0, 1)),
    sheet("start on an apex", "the distance to the first face is 0", (0.0025, 0.0025, -0.0005), (0.01, 0.02, 1),
          facets="the start lies on the surface, the facets stand within their sag error before or behind it"),
    sheet("on a lens's axis", "every offset is 0", (0.0025, 0.0025, -0.01), (0, 0, 1)),
    sheet("source at 1 km", "the cell hangs on the thirteenth digit", (0.0012 - 20.0, 0.0007 + 10.0, -1000.0), (0.02, -0.01, 1)),
    sheet("source at 1 km, on a border", "exact arithmetic says which cell", (0.005 - 15.625, 0.0007, -1000.0), (0.015625, 0, 1)),
    sheet("source at 1e9", "only the ratios of the direction may count", (0.0012, 0.0007, -1e9), (0, 0, 1)),
    sheet("a ghost", "lens 2 of the next cell", (0.0012, 0.0007, -0.01), (0.055, 0.0, 1)),
    sheet("a million pitches out", "p k is rounded to 1e-12", (4999.9981, -4999.9972, -0.01), (0.01, 0.02, 1), lattice__count=MILLION),
    sheet("a million pitches out, from 1 km", "far both ways", (4999.9981 - 10, -4999.9972 - 20, -1000), (0.01, 0.02, 1), lattice__count=MILLION),
    sheet("1e9 pitches out", "p k is rounded to 1e-9", (4999999.9981, -4999999.9972, -0.01), (0.01, 0.02, 1), lattice__count=MILLIARD),
    sheet("scale 1e-4", "the smallest pitch a design may have", (1.2e-7, 7e-8, -1e-6), (0.02, -0.01, 1), **TINY),
    sheet("scale 1e9", "the same from the other end", (1.2e6, 7e5, -1e7), (0.02, -0.01, 1), **HUGE),
    sheet("one cell", "40 000 cells must give what one gives", (0.0012, 0.0007, -0.01), (0.02, -0.01, 1), lattice__count=[1, 1]),
    sheet("offset 0.2 f", "lens 2 stands half a pitch aside", (0.0012, 0.0007, -0.01), (0.2, -0.1, 1), law__delta=[0.2, -0.1]),
    sheet("offset of many pitches", "the partner is 12 cells away", (0.0012, 0.0007, -0.01), (1.25, 0.0, 1), law__delta=[1.6, 0.0], law__eta=[-0.3, -1.0]),
    sheet("Galilean", "concave second lens", (0.0012, 0.0007, -0.01), (0.01, -0.01, 1), law__eta=[0.5, 0.25]),
    sheet("slab", "one body, two grids", (0.0012, 0.0007, -0.01), (0.01, -0.01, 1), **SLAB),
    sheet("slab, biconic", "Newton in every cell", (0.0012, 0.0007, -0.01), (0.01, -0.01, 1), pair__surface="biconic", **SLAB),
    sheet("plano, curved outside", "planes between the lenses", (0.0012, 0.0007, -0.01), (0.01, -0.01, 1), pair__form="plano", pair__thickness=0.002),
    sheet("field lens, both faces at the focus to 1e-9", "light meets at a vertex where every offset is 0", (0.0012, 0.0007, -0.01), (0.01, -0.01, 1),
          law__eta=[-1.0, -1.0], pair__field={"gap": 1e-9}, **FIELD, **SLAB),
    sheet("field lens, along the axis", "every offset and every slope is 0", (0.0025, 0.0025, -0.01), (0, 0, 1), law__eta=[-1.0, -1.0], **FIELD, **SLAB),
    sheet("field lens, foci nearly in one", "crossed cylinders on a plate as thin as their heights", (0.00012, 0.00007, -0.01), (0.001, -0.002, 1),
          law__eta=[-0.97, -1.0], lattice__pitch=5e-4, pair__thickness=5e-5, **FIELD),
    sheet("field lens, radius at its limit", "a field face that all but ends in its cell, met by its border", (0.0005, 0.0007, -0.01), (0.088, 0.0, 1),
          lattice__pitch=0.0075, pair__thickness=0.0022, **FIELD),
    sheet("field lens, next cell's", "light beyond the field goes by another field lens to the lens but one", (0.0012, 0.0007, -0.01), (0.13, 0.0, 1),
          law__eta=[-1.0, -1.0], **FIELD),
    sheet("field lens, a million pitches out", "p k is rounded to 1e-12 at four faces", (4999.9981, -4999.9972, -0.01), (0.01, 0.02, 1),
          law__eta=[-1.0, -1.0], lattice__count=MILLION, **FIELD, **SLAB),
    sheet("hexagonal", "skewed axes", (0.0012, 0.0007, -0.01), (0.01, -0.01, 1), lattice__kind="hexagonal"),
    sheet("hexagonal, last cell", "rows of sqrt(3)", (0.4975, 0.4301, -0.01), (0.01, -0.01, 1), lattice__kind="hexagonal"),
    sheet("a pitch of 1 : 100", "cells small beside their distance", (0.0001, 0.0002, -0.01), (0.001, -0.002, 1), lattice__pitch=0.0005, pair__thickness=2e-5),
    sheet("index 1.001", "radii a five-hundredth of the focal lengths", (4e-6, 7e-6, -0.01), (1e-5, -2e-5, 1), pair__index=1.001, lattice__pitch=2e-5, pair__thickness=1e-4),
    sheet("index 4", "strong lenses", (0.0012, 0.0007, -0.01), (0.01, -0.01, 1), pair__index=4.0),
]  # fmt: skip
