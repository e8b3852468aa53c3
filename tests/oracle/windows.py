"""Windows built by hand for the tracer's tests: every form, with the lensmaker's thin formula and nothing clever."""

from __future__ import annotations

import numpy as np

from clacad.optics.law import Law
from clacad.optics.surface import Biconic, Quadric
from clacad.sheet.cell_places import CellPlacement
from clacad.sheet.lattice import Circle, Lattice, Rectangle
from clacad.sheet.window import IDENTITY, PLANE, Baffle, Body, Face, Land, ThinPair, Window

SPACING, PITCH, INDEX = 0.05, 0.005, 1.5


def _curved(radius_x, radius_y, side):
    """The ellipsoid with the geometric mean as third semi-axis; a saddle gets κ = 0."""
    cx, cy = 1.0 / radius_x, 1.0 / radius_y
    kappa = np.sign(cx) * np.sqrt(cx * cy) if cx * cy > 0 else 0.0
    return Quadric(cx, cy, float(kappa), side)


def _focal_lengths(eta):
    first = tuple(SPACING / (1.0 - e) for e in eta)
    return first, tuple(-e * f for e, f in zip(eta, first))


def _window(form, bodies, law, eta, rotation, shift, separation, **rest):
    first, second = _focal_lengths(eta)
    offset = np.array([law.delta_x * first[0], law.delta_y * first[1], SPACING])
    thin = ThinPair((first, second), tuple(rotation @ offset), rotation, tuple((rotation @ offset)[:2]))
    lattice = Lattice(
        rest.pop("kind", "square"), (PITCH, PITCH), rest.pop("count", (20, 30)), rest.pop("cut", None)
    )
    return Window(
        form,
        bodies,
        lattice,
        (CellPlacement(), CellPlacement(shift)),
        1.0,
        (-2 * PITCH, separation + 2 * PITCH),
        law,
        thin,
        **rest,
    )


def biconvex(eta=(-0.25, -1.0), delta=(0.0, 0.0), euler=(0.0, 0.0, 0.0), thickness=0.0009, web=None, **rest):
    """Two arrays of biconvex (or biconcave) lenses."""
    law = Law(*eta, *delta, *euler)
    rotation = law.rotation
    focal = _focal_lengths(eta)
    middle = rotation @ np.array([*(d * f for d, f in zip(delta, focal[0])), SPACING])
    shift = (float(middle[0]), float(middle[1]))
    bodies = []
    for array, (lengths, height) in enumerate(zip(focal, (0.0, middle[2]))):
        half = 0.5 * thickness * rotation[:, 2]
        faces = [
            Face(
                _curved(*(2 * (INDEX - 1) * f for f in lengths), side),
                tuple(np.array([0.0, 0.0, height]) - side * half),
                rotation if any(euler) else IDENTITY,
                array,
                None if web is None else height - side * web,
            )
            for side in (1, -1)
        ]
        bodies.append(Body(*faces, INDEX, f"array{array + 1}"))
    return _window("biconvex", tuple(bodies), law, eta, rotation, shift, middle[2], **rest)


def slab(
    eta=(-0.25, -1.0),
    delta=(0.0, 0.0),
    euler=(0.0, 0.0, 0.0),
    land=(None, None),
    biconic=False,
    margins=None,
    **rest,
):
    """One plate with a lens array on either face, displaced against each other by a tilt."""
    law = Law(*eta, *delta, *euler)
    rotation = law.rotation
    first = [(INDEX - 1) * SPACING / (1.0 - e) for e in eta]
    second = [-e * r for e, r in zip(eta, first)]
    decentre = [d * r / (INDEX - 1) for d, r in zip(delta, first)]
    apex = rotation @ np.array([*decentre, INDEX * SPACING])
    shift = (float(apex[0]), float(apex[1]))
    turned = rotation if any(euler) else IDENTITY
    shapes = [_curved(*first, 1), _curved(*second, -1)]
    if biconic:
        conic = -1.0 / INDEX**2
        shapes = [Biconic(1 / r[0], 1 / r[1], conic, conic, s) for r, s in ((first, 1), (second, -1))]
    front = Face(shapes[0], (0.0, 0.0, 0.0), turned, 0, land[0])
    back = Face(shapes[1], (0.0, 0.0, float(apex[2])), turned, 1, land[1])
    rest["land"] = margins or Land()
    return _window("slab", (Body(front, back, INDEX, "sheet"),), law, eta, rotation, shift, apex[2], **rest)


def plano(eta=(-0.25, -1.0), euler=(0.0, 0.0, 0.0), inside=False, thickness=0.003, **rest):
    """Two plates with one structured face each, turned outwards or inwards."""
    law = Law(*eta, 0.0, 0.0, *euler)
    rotation = law.rotation
    turned = rotation if any(euler) else IDENTITY
    first, second = ([(INDEX - 1) * f for f in lengths] for lengths in _focal_lengths(eta))
    height = SPACING if inside else SPACING + 2 * thickness * (1 - 1 / INDEX)
    shift = (float(rotation[0, 2] * SPACING), float(rotation[1, 2] * SPACING))
    if inside:
        faces = (
            Face(PLANE, (0.0, 0.0, -thickness)),
            Face(_curved(*first, -1), (0.0, 0.0, 0.0), turned, 0),
            Face(_curved(*second, 1), (0.0, 0.0, height), turned, 1),
            Face(PLANE, (0.0, 0.0, height + thickness)),
        )
    else:
        faces = (
            Face(_curved(*first, 1), (0.0, 0.0, 0.0), turned, 0),
            Face(PLANE, (0.0, 0.0, thickness)),
            Face(PLANE, (0.0, 0.0, height - thickness)),
            Face(_curved(*second, -1), (0.0, 0.0, height), turned, 1),
        )
    bodies = (Body(faces[0], faces[1], INDEX, "array1"), Body(faces[2], faces[3], INDEX, "array2"))
    return _window("plano", bodies, law, eta, rotation, shift, height, **rest)


def collection():
    """A window of every kind a tracer could trip over, by name."""
    return {
        "paper base": biconvex(),
        "offset": biconvex(delta=(0.01, -0.02), eta=(-0.5, -1.5)),
        "tilted by 20 degrees": biconvex(euler=(0.3, 0.35, 0.2), thickness=0.003),
        "holes outside the rim": biconvex(euler=(0.3, 0.1, 0.2), thickness=0.0005),
        "web": biconvex(euler=(0.3, 0.2, 0.2), web=0.0002),
        "opaque seam": biconvex(
            euler=(0.3, 0.2, 0.2), thickness=0.002, web=0.0003, land=Land(0.0008, opaque=True)
        ),
        "hexagonal": biconvex(
            euler=(0.3, 0.1, 0.2), thickness=0.0012, kind="hexagonal", eta=(-0.5, -0.7), count=(24, 24)
        ),
        "galilean": biconvex(eta=(0.4, 0.5), thickness=0.0004),
        "round of cells": biconvex(cut=Circle(0.08)),
        "baffle": biconvex(euler=(0.0, 0.1, 0.0), baffle=Baffle(0.0004)),
        "displaced slab": slab(euler=(0.2, 0.2, 0.4), land=(0.002, 0.05), outline=Rectangle(0.2, 0.2)),
        "biconic slab": slab(biconic=True),
        "round slab with seam": slab(land=(0.0004, 0.0746), outline=Circle(0.2), margins=Land(0.0006)),
        "plano outside": plano(),
        "plano inside, hexagonal": plano(inside=True, euler=(0.0, 0.05, 0.0), kind="hexagonal"),
    }


def beam(window, number, seed, steepest=1.5, spread=1.0):
    """Rays from all directions about the field's middle, from before the sheet to inside its first array."""
    rng = np.random.default_rng(seed)
    x0, x1, y0, y1 = window.lattice.extent()
    pad = spread * PITCH
    position = np.column_stack(
        [
            rng.uniform(x0 - pad, x1 + pad, number),
            rng.uniform(y0 - pad, y1 + pad, number),
            rng.uniform(-2 * PITCH, 0.2 * PITCH, number),
        ]
    )
    polar = rng.uniform(0.0, steepest, number) ** 1.5 / steepest**0.5
    azimuth = rng.uniform(0.0, 2 * np.pi, number)
    direction = np.column_stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    )
    middle = np.divide(window.thin.shift, window.thin.offset[2])
    direction[:, :2] += middle * direction[:, 2:]
    return position, direction
