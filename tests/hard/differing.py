"""Rays through non-uniform sheets, where the place of cell and lens is the difficulty; each with the reason."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

from clacad import Design, load, prescribe
from clacad.sheet.cell_places import VertexChange

BASE = {
    "format": 1,
    "name": "differing",
    "unit": "mm",
    "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 10, "index": 1.5, "offset": "paraxial"},
    "lattice": {"pitch": 0.5, "count": [21, 21]},
    "check": {"process": "none"},
}

FAR = [20_001, 20_001]
"""Cells of a sheet whose cell (10⁴, 10⁴) is the middle one, and (2·10⁴, 10⁴) lies 5 m out."""


def window_of(changes):
    """The sheet with some keys changed; `gradient` replaces the gradient that the design gives the places of lenses 2."""
    keys = dict(changes)
    gradient, etas = keys.pop("gradient", None), keys.pop("etas", None)
    if "faces" in keys:
        return listed(keys)
    window = prescribe(Design.from_dict(BASE).replace(keys)) if etas is None else tabled(keys, etas)
    if gradient is None:
        return window
    (body,) = window.bodies
    change = replace(body.back.change or VertexChange(), gradient=gradient)
    return replace(window, bodies=(replace(body, back=replace(body.back, change=change)),))


def listed(keys):
    """Plates of listed faces; `indices` replaces those of their media."""
    faces, indices = keys.pop("faces"), keys.pop("indices", None)
    pair = {"form": "plates", "wavelength": 546.1, "face": [{**face} for face in faces]}
    window = prescribe(Design.from_dict({**BASE, "pair": pair}).replace(keys))
    if indices is None:
        return window
    bodies = [replace(body, index=n, material=None) for body, n in zip(window.bodies, indices, strict=True)]
    return replace(window, bodies=tuple(bodies))


def tabled(keys, etas):
    """The sheet of a table whose cells (i, j) have the δx, δy and η, or η_x, η_y, φ and ψ, that `etas` gives for them."""
    with tempfile.TemporaryDirectory() as folder:
        design = Design.from_dict(BASE).replace(keys)
        cells = prescribe(design).lattice.cells().tolist()
        rows = []
        for i, j in cells:
            *own, x, y = etas(i, j)
            rows.append(",".join(map(repr, (i, j, x, y, *own))))
        rows.insert(0, "i,j,delta_x,delta_y," + ("eta" if len(own) == 1 else "eta_x,eta_y,phi,psi"))
        (Path(folder) / "cells.csv").write_text("\n".join(rows) + "\n")
        text = design.canonical_toml().replace("[law]\n", '[law]\nvarying = {table = "cells.csv"}\n')
        (Path(folder) / "design.toml").write_text(text)
        return prescribe(load(Path(folder) / "design.toml"))


def spread(low, high):
    """η from one to the other over a sheet of 21 cells, δ from its middle."""
    return lambda i, j: (low + (high - low) * (i + j) / 40.0, 2e-3 * (i - 10), -1e-3 * (j - 10))


def one_beside(cell, eta, others=-1.0):
    """η of one cell, and of all others."""
    return lambda i, j: (eta if (i, j) == cell else others, 1e-3 * i, 0.0)


def turning(by):
    """η of two axes and lens axes that turn by an angle (degrees) from cell to cell; none in the middle cell."""
    return lambda i, j: (
        -0.9 - 0.01 * i,
        -1.1 + 0.005 * j,
        by * (i - 10),
        by * (j - 10),
        2e-3 * (i - 10),
        -1e-3 * (j - 10),
    )


@dataclass(frozen=True)
class Differing:
    """A sheet, the cell a ray is sent at, from where in the cell, with which slope beyond its field centre."""

    name: str
    why: str
    changes: tuple
    cell: tuple
    off: tuple = (0.07, -0.11)
    slope: tuple = (0.001, -0.002)


def case(name, why, changes, cell, **more):
    """A case; keys of the design as they are written."""
    return Differing(name, why, tuple(changes.items()), cell, **more)


def aimed(z, **more):
    """Keys of a sheet aimed at a viewer on its axis."""
    return {"lattice.aperture": {"point": [0, 0, z]}, **more}


def pitched(ratio, **more):
    """Keys of a sheet whose array 2 has another pitch."""
    return {"lattice.pitch_2": 0.5 * ratio, **more}


def rotated(angle, ratio=1.0, **more):
    """Keys of a sheet whose array 2 is turned."""
    return {"lattice.rotation_2": angle, **({} if ratio == 1.0 else {"lattice.pitch_2": 0.5 * ratio}), **more}


WIDE = {"lattice.count": FAR}
VAST = {"lattice.count": [30_001, 30_001]}
PLANO = {"pair.form": "plano", "pair.thickness": 0.6}
BICONVEX = {"pair.form": "biconvex", "pair.thickness": 0.6}
BESIDE = {"lattice.aperture": {"point": [31.7, -12.9, -400]}}
TURNED = {"law.euler": [30, 0, 0], "law.eta": [-1, -0.8]}
TILTED = {**BICONVEX, "pair.thickness": 1.0, "law.euler": [20, 5, 0], "law.eta": [-1, -0.8]}
STEEP = {"lattice.aperture": {"point": [-53.2, 0, -400]}, "pair.offset": "traced", "lattice.count": [5, 5]}
GLENS = {"law.varying": {"gradient": [[1e-12, 0.0], [0.0, 1e-12]]}}
BENT = {"law.varying": {"gradient": [[-1e-12, 3e-13], [2e-13, 1e-12]]}}
TABLED = {"law.varying": {"f_image": 200}, "pair.offset": "traced", "lattice.count": [41, 41]}
LEANING = {"law.euler": [30, 3, 10], "law.varying": {"gradient": [[-5e-3, 0.0], [0.0, -5e-3]]}}
OWN = {"etas": spread(-0.5, -2.0)}
GIVEN = {"pair.prescription": "given", "pair.face": [
    {"radius": 2.5, "conic": -0.4, "a4": [1e-3, 2e-3, 1e-3]}, {"radius": 2.5, "a6": [-2e-4, 0, 0, 1e-4]}]}  # fmt: skip
CURL = ((1e-3, -7e-3), (5e-3, 2e-3))
SILICA, FLINT = {"behind": "Fused silica"}, {"radius": "inf", "behind": "N-SF6"}
FLAT = {"faces": [
    {"radius": 2.3, "conic": -0.449, "array": 1, **SILICA}, {"after": 1.65, **FLINT}, {"after": 14.02, "radius": "inf", **SILICA},
    {"after": 1.65, "radius": -2.3, "conic": -0.449, "array": 2, "behind": "air"},
]}  # fmt: skip
CEMENTED = {"faces": [
    {"radius": 2.3, "conic": -0.373, "array": 1, "behind": "PMMA"}, {"after": 1.0, "radius": -5.1, "array": 1, "behind": "PS"},
    {"after": 13.83, "radius": 5.1, "array": 2, "behind": "PMMA"}, {"after": 1.0, "radius": -2.3, "conic": -0.373, "array": 2, "behind": "air"},
]}  # fmt: skip
FILM = {"faces": [
    {"radius": 3.0, "array": 1, "behind": "PMMA"}, {"after": 9.0, "radius": "inf", "behind": "PS"}, {"after": 5e-7, "radius": "inf", "behind": "PMMA"},
    {"after": 9.0, "radius": -3.0, "array": 2, "behind": "air"},
]}  # fmt: skip
SKIN = {"faces": [
    {"radius": 3.0, "array": 1, "behind": "PMMA"}, {"after": 1.0, "radius": 4.0, "array": 1, "behind": "PS"},
    {"after": 5e-7, "radius": 4.0, "array": 1, "behind": "PMMA"}, {"after": 16.0, "radius": -3.0, "array": 2, "behind": "air"},
]}  # fmt: skip
AIR_GAPS = {"faces": [
    {"radius": 3.0, "array": 1, "behind": "PMMA"}, {"after": 2.0, "radius": "inf", "behind": "air"},
    {"after": 1.5, "radius": 4.0, "array": "field", "behind": "PS"}, {"after": 1.0, "radius": -4.0, "array": "field", "behind": "air"},
    {"after": 1.5, "radius": "inf", "behind": "PMMA"}, {"after": 2.0, "radius": -3.0, "array": 2, "behind": "air"},
]}  # fmt: skip
CASES = [
    case("cell (10^4, 10^4) of an aimed sheet", "the middle, where every place is 0", aimed(-8e4, **WIDE), (10_000, 10_000)),
    case("cell (2e4, 10^4), g = 1 + 1/8000", "5 m out the partner stands 1.25 pitches beside it", aimed(-8e4, **WIDE), (20_000, 10_000)),
    case("corner cell (2e4, 2e4), g = 1 + 1/8000", "both ways", aimed(-8e4, **WIDE), (20_000, 20_000)),
    case("cell (2e4, 10^4), g = 1 + 1/8000, no binary pitch", "multiples of .3 are rounded at 3 m",
         aimed(-4.8e4, **WIDE, **{"lattice.pitch": 0.3, "pair.separation": 6}), (20_000, 9_999), off=(0.04, -0.06)),
    case("corner cell (0, 0), a point behind the sheet", "g = 1 - 1/8000", aimed(8e4, **WIDE), (0, 0)),
    case("cell (2e4, 2e4), g - 1 = 1e-8", "a point 1e9 off: partners part by 5e-5", aimed(-1e9, **WIDE), (20_000, 20_000)),
    case("a point beside the axis", "array 2 is scaled and moved", {"lattice.aperture": {"point": [31.7, -12.9, -400]}}, (20, 3)),
    case("a viewer at ten separations", "the nearest that is built: g = 1.1", aimed(-100.0), (20, 0)),
    case("a viewer an ulp beyond ten separations", "g = 1.1 to the last bit", aimed(-100.00000000000001), (0, 20)),
    case("hexagonal, aimed", "skewed axes, and each array its own", aimed(-400, **{"lattice.kind": "hexagonal"}), (12, 17)),
    case("cell (10^4, 10^4), g = 1 + 1/8000", "2.5 m out both ways, neither the middle nor a corner", aimed(-8e4, **VAST), (10_000, 10_000)),
    case("cell (10^4, 10^4), g = 1 - 1/9000, a point beside the axis", "array 2 is narrower, and moved by .075",
         {"lattice.aperture": {"point": [600, -90, 9e4]}, **VAST}, (10_000, 10_000)),
    case("a point at ten separations behind the sheet", "the nearest that is built there: g = .9", aimed(100.0), (20, 0)),
    case("a point an ulp beyond ten separations behind", "g = .9 to the last bit", aimed(100.00000000000001), (0, 20)),
    case("a few last bits above a border of the aimed array", "g = 1.1: the border belongs to the cell above it", aimed(-100.0), (15, 10),
         off="border", slope=(0.02, 0.0)),
    case("a few last bits below a border of the aimed array", "the other side of it", aimed(-100.0), (15, 10), off="below", slope=(0.02, 0.0)),
    case("a few last bits above a border of an array aimed behind", "g = .9", aimed(100.0), (5, 10), off="border", slope=(0.02, 0.0)),
    case("a few last bits below a border of an array aimed and moved", "a shift beside the scale", BESIDE, (4, 16), off="below",
         slope=(0.02, 0.0)),
    case("a few last bits above a border of two bodies' array 2", "faces of a body of its own", {**aimed(-400.0), **BICONVEX}, (15, 10),
         off="border", slope=(0.02, 0.0)),
    case("plano, aimed", "a plane face before lens 2", {**BESIDE, **PLANO}, (20, 3)),
    case("plano, curved inside, aimed", "plane faces outside", {**BESIDE, **PLANO, "pair.curved": "inside"}, (0, 17)),
    case("biconvex, aimed", "both faces of lens 2 stand aside", {**BESIDE, **BICONVEX}, (20, 3)),
    case("turned, aimed", "lens axes across the borders, two focal ratios", {**BESIDE, **TURNED}, (20, 3)),
    case("turned, aimed, a ghost", "lens 2 of the next cell", {**BESIDE, **TURNED}, (9, 14), slope=(0.05, -0.02)),
    case("tilted, aimed", "lenses lean, their cells do not", {**BESIDE, **TILTED}, (3, 18)),
    case("tilted, aimed, a corner cell", "the farthest partner", {**BESIDE, **TILTED}, (20, 0)),
    case("a traced vertex near its bracket", ".298 of the pitch, of .3, from where paraxial light has it", STEEP, (4, 2)),
    case("a traced vertex near its bracket, a ghost", "the next lens stands elsewhere", STEEP, (2, 1), slope=(0.03, 0.0)),
    case("pitch_2 = pitch (1 + 1e-12)", "last cell: partners 1e-11 apart", pitched(1.0 + 1e-12), (20, 20)),
    case("pitch_2 = pitch (1 - 1e-12)", "the other way", pitched(1.0 - 1e-12), (0, 20)),
    case("pitch_2 = pitch (1 + 1e-12), 10^4 cells out", "the difference is 5e-9", pitched(1.0 + 1e-12, **WIDE), (20_000, 0)),
    case("pitch_2 = .9975 pitch", "a moiré magnifier", pitched(0.9975), (20, 7)),
    case("array 2 turned by 1 degree", "lenses stand along other axes than borders", rotated("1 deg"), (20, 7)),
    case("array 2 turned by 1e-12", "the last cell's partner stands 1e-11 aside", rotated("1e-12 rad"), (20, 20)),
    case("array 2 turned by 1e-6, 10^4 cells out", "5 mm turn into 5 nm", rotated("1e-6 rad", **WIDE), (20_000, 0)),
    case("array 2 turned by 44 degrees", "next to the most, where square cells look alike", rotated("44 deg"), (11, 10)),
    case("array 2 turned by -2 degrees, hexagonal", "the other way, skewed axes", rotated("-2 deg", **{"lattice.kind": "hexagonal"}), (12, 17)),
    case("array 2 of .9975 pitch, turned by 3 degrees", "a moiré magnifier turned", rotated("3 deg", 0.9975), (18, 4)),
    case("array 2 turned by 5 degrees, a ghost", "lens 2 of the next cell but one", rotated("5 deg"), (15, 10), slope=(0.06, -0.03)),
    case("a few last bits above a border of a turned array", "the border runs aslant", rotated("3 deg"), (13, 10), off="border", slope=(0.02, 0.0)),
    case("a ghost in an array of another pitch", "lens 2 of the next cell but one", pitched(1.02), (15, 10), slope=(0.06, -0.03)),
    case("a few last bits above a border of the wider array", "the border belongs to the cell above it", pitched(1.02), (15, 10),
         off="border", slope=(0.02, 0.0)),
    case("a few last bits below a border of the wider array", "the other side of it", pitched(1.02), (15, 10), off="below", slope=(0.02, 0.0)),
    case("a few last bits above a border of the narrower array", "the same where lenses 2 are narrower", pitched(0.98), (5, 10), off="border",
         slope=(0.02, 0.0)),
    case("kappa = 1e-12", "lenses stand 5e-11 aside", GLENS, (20, 20)),
    case("kappa = 1e-12, with curl", "four numbers", BENT, (20, 0)),
    case("kappa = 5e-3, vertices traced", "a table of vertices", TABLED, (40, 40)),
    case("kappa = 5e-3, hexagonal, vertices traced", "rows of the table begin elsewhere", {**TABLED, "lattice.kind": "hexagonal"},
         (18, 30)),
    case("kappa = 5e-3, vertices traced, a ghost", "the lens of the next cell stands elsewhere", TABLED, (30, 12), slope=(0.04, 0.0)),
    case("a gradient with curl beside a table", "lenses 2 turn about the middle", {**TABLED, "gradient": CURL}, (31, 9)),
    case("a gradient with curl beside another pitch", "the same in an array of its own pitch", pitched(1.02, gradient=CURL), (3, 16)),
    case("kappa = 5e-3, tilted by 3 degrees", "lenses 2 stand at heights of their own", LEANING, (20, 3), off=(0.05, -0.06)),
    case("kappa = 5e-3, tilted by 3 degrees, vertices traced", "heights follow a table", {**LEANING, "pair.offset": "traced"}, (2, 18),
         off=(-0.04, 0.07)),
    case("kappa = 1e-12, tilted", "heights differ by 1e-12", {**LEANING, **GLENS}, (20, 20), off=(0.01, 0.02)),
    case("kappa = 5e-3, vertices traced, middle", "where the table has 0", TABLED, (20, 20)),
    case("eta from -1/2 to -2, a corner cell", "radii from 2 to 4 times a cell, each pair's own", OWN, (0, 0)),
    case("eta from -1/2 to -2, the other corner", "the other end", OWN, (20, 20)),
    case("eta from -1/2 to -2, a ghost", "lens 2 of the next cell is another one", OWN, (7, 9), slope=(0.05, -0.02)),
    case("eta from -1/2 to -2, hexagonal", "rows of the table begin elsewhere", {**OWN, "lattice.kind": "hexagonal"}, (12, 17)),
    case("eta from -1/2 to -2, vertices traced", "moved as far as coma of that radius asks", {**OWN, "pair.offset": "traced"}, (3, 18)),
    case("eta = -1 beside -1 (1 + 1e-12)", "sizes differ by 5e-13", {"etas": one_beside((4, 5), -1.0 - 1e-12)}, (4, 5)),
    case("eta = -1 beside -1 (1 - 1e-12)", "the other way", {"etas": one_beside((4, 5), -1.0 + 1e-12)}, (4, 5)),
    case("eta = -1/4 beside -1", "lens 1 is 1.6 and lens 2 .4 times as large", {"etas": one_beside((4, 5), -0.25)}, (4, 5), off=(0.05, -0.06)),
    case("eta = -4 beside -1", "the other way", {"etas": one_beside((4, 5), -4.0)}, (4, 5), off=(0.05, -0.06)),
    case("eta = -4, the cell beside that of eta = -1/4", "ghosts through the odd one's lens 2", {"etas": one_beside((4, 5), -0.25, -4.0)}, (3, 5),
         off=(0.05, -0.06), slope=(0.05, 0.0)),
    case("eta from 1/4 to 3/4, lens 2 concave", "no real focus", {"law.eta": [0.5, 0.5], "etas": spread(0.25, 0.75)}, (2, 17)),
    case("eta from 3/2 to 3, lens 1 concave", "the other lens", {"law.eta": [2, 2], "etas": spread(1.5, 3.0)}, (2, 17)),
    case("plano, eta from -1/2 to -2", "lenses of two bodies", {**OWN, **PLANO}, (17, 3)),
    case("plano, curved inside, eta from -1/2 to -2", "faces towards one another", {**OWN, **PLANO, "pair.curved": "inside"}, (3, 17)),
    case("biconvex, eta from -.8 to -1.2", "thick lenses of one thickness", {**BICONVEX, "etas": spread(-0.8, -1.2)}, (17, 3)),
    case("biconvex, turned and tilted, eta from -.8 to -1.2", "figures lean, their sizes do not",
         {**TILTED, "law.eta": [-1, -1], "etas": spread(-0.8, -1.2)}, (17, 3), off=(0.02, 0.01)),
    case("a polynomial, eta from -1/2 to -2", "terms of given faces scale by other powers", {**OWN, **GIVEN}, (18, 2)),
    case("an ellipsoid of depth 3, eta from -1/2 to -2", "depths scale with their lenses", {**OWN, "pair.depth": [3, 2.6]}, (2, 17)),
    case("sharp pairs steered by .1", "array 2 is wider, and moved by two cells",
         {"pair.focus": {"object": -300, "image": 400}, "lattice.aperture": [0.1, -0.05]}, (19, 3)),
    case("sharp pairs tilted by 3 degrees", "each lens 1 has its own size, 1 + 1e-4 in the corners",
         {"law.euler": [30, 3, 10], "pair.focus": {"object": -300, "image": 400}}, (20, 3), off=(0.05, -0.06)),
    case("conics, eta from -1/2 to -2", "biconic faces are figures too", {**OWN, "pair.surface": "biconic"}, (18, 2)),
    case("joints of planes, aimed", "cells change behind two joints", {**BESIDE, **FLAT}, (20, 3)),
    case("joints of planes, aimed, a ghost", "lens 2 of the next cell", {**BESIDE, **FLAT}, (9, 14), slope=(0.05, -0.02)),
    case("joints of planes, cell (999, 1) of 10^6", "places are .25 m from the middle", aimed(-8e4, **FLAT, **{"lattice.count": [1000, 1000]}), (999, 1)),
    case("joints of planes, array 2 turned and narrower", "a plane has the cells of no array", rotated("1 deg", 0.998, **FLAT), (20, 7)),
    case("joints of planes, kappa = 1e-12", "lenses stand 5e-11 aside behind joints", {**FLAT, **GLENS}, (20, 20)),
    case("curved joints", "each is one surface, met once", CEMENTED, (3, 17)),
    case("curved joints, a ghost", "the second joint is that of the next cell", CEMENTED, (9, 14), slope=(0.05, -0.02)),
    case("curved joints, cell (999, 1) of 10^6", "heights of a joint from places .25 m off", {**CEMENTED, "lattice.count": [1000, 1000]}, (999, 1)),
    case("curved joints, index ratio 1 + 1e-12", "a joint that hardly bends must not lose the rest",
         {**CEMENTED, "indices": (1.5, 1.5 * (1.0 + 1e-12), 1.5)}, (3, 17)),
    case("curved joints, index ratio 1 - 1e-12", "from the dense side", {**CEMENTED, "indices": (1.5 * (1.0 + 1e-12), 1.5, 1.5)}, (3, 17)),
    case("a film of 1e-6 pitches between planes, aimed", "two joints closer than a chord of a lens is high", {**BESIDE, **FILM}, (20, 3)),
    case("a skin of 1e-6 pitches between curved joints", "the same on two curved faces", SKIN, (3, 17)),
    case("a field plate in air, aimed", "three arrays, each with cells of its own", {**BESIDE, **AIR_GAPS, "pair.offset": "paraxial"}, (12, 5), off=(0.02, -0.03)),
]  # fmt: skip
