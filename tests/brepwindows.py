"""Windows built by hand for the solid tests: thin-lens radii, any pose, any form of land."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clacad.optics.law import Law
from clacad.optics.surface import Quadric
from clacad.sheet.cell_places import CellPlacement
from clacad.sheet.lattice import Lattice
from clacad.sheet.window import Body, Face, Land, ThinPair, Window


def turn(phi, theta, psi):
    """Rz(psi) Rx(theta) Rz(phi), degrees."""

    def about_z(a):
        c, s = np.cos(a), np.sin(a)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    def about_x(a):
        c, s = np.cos(a), np.sin(a)
        return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])

    phi, theta, psi = np.radians([phi, theta, psi])
    return about_z(psi) @ about_x(theta) @ about_z(phi)


def biconvex(
    euler=(0.0, 0.0, 0.0),
    eta=(-0.25, -1.0),
    delta=(0.0, 0.0),
    pitch=0.5,
    separation=5.0,
    thickness=0.15,
    count=(3, 3),
    kind="square",
    seam=0.0,
    web=None,
    outline=None,
    unit=1e-3,
    n=1.5,
):
    """A pair of biconvex arrays, lengths in mm unless `unit` states another unit."""
    rotation = np.eye(3) if not any(euler) else turn(*euler)
    f1 = [separation / (1.0 - e) for e in eta]
    f2 = [-e * f for e, f in zip(eta, f1)]
    second = rotation @ np.array([delta[0] * f1[0], delta[1] * f1[1], separation])
    bodies = []
    for k, (f, z) in enumerate(((f1, 0.0), (f2, float(second[2])))):
        cx, cy = (1.0 / (2.0 * (n - 1.0) * value) for value in f)
        kappa = np.copysign(np.sqrt(cx * cy), cx) if cx * cy > 0.0 else 0.0
        half = 0.5 * thickness * rotation[:, 2]
        faces = [
            Face(
                Quadric(cx, cy, kappa, side),
                (-side * half[0], -side * half[1], z - side * half[2]),
                rotation,
                k,
                None if web is None else z - side * 0.5 * web,
            )
            for side in (1, -1)
        ]
        bodies.append(Body(faces[0], faces[1], n, f"array{k + 1}"))
    shift = (float(second[0]), float(second[1]))
    thin = ThinPair(((f1[0], f1[1]), (f2[0], f2[1])), tuple(second), rotation, shift)
    law = Law(eta[0], eta[1], delta[0], delta[1], *np.radians(euler))
    lattice = Lattice(kind, (pitch, pitch), count)
    return Window(
        "biconvex",
        tuple(bodies),
        lattice,
        (CellPlacement(), CellPlacement(shift)),
        unit,
        (-1.0, separation + 1.0),
        law,
        thin,
        land=Land(seam=seam),
        outline=outline,
    )


def one_body(window, k):
    """The same window with body k only."""
    return replace(window, bodies=(window.bodies[k],))


SWEEPS = {
    "tilt": lambda angle: {"euler": (0.0, angle, 0.0), "eta": (-0.8, -0.8)},
    "anamorphic tilt": lambda angle: {"euler": (33.0, angle, 0.0)},
    "turn": lambda angle: {"euler": (angle, 0.0, 0.0)},
    "turned tilt": lambda angle: {"euler": (45.0, angle, 0.0)},
    "nearly round, turned": lambda angle: {"euler": (45.0, 0.0, 0.0), "eta": (-0.8, -0.8 - 0.01 * angle)},
    "hexagonal": lambda angle: {"euler": (20.0, angle, 0.0), "kind": "hexagonal"},
    "galilean": lambda angle: {"euler": (20.0, angle, 0.0), "eta": (0.5, 0.3)},
}
"""Families of sheets whose steps between neighbours go from nothing to much with one angle (degrees)."""


def column_volume(window, body, order=48):
    """Volume (mm³) of a body whose faces cover their cells, by Gauss quadrature of the exact heights."""
    from clacad.sheet.window import face_height

    nodes, weights = np.polynomial.legendre.leggauss(order)
    volume = 0.0
    tile = window.lattice.tile()
    corners = [(np.zeros(2), a, b) for a, b in zip(tile, np.roll(tile, -1, axis=0))]
    u, v = np.meshgrid(0.5 * (nodes + 1.0), 0.5 * (nodes + 1.0), indexing="ij")
    w = 0.25 * np.outer(weights, weights)
    for origin, a, b in corners:  # each triangle from the centre, collapsed square (Duffy)
        points = origin + u[..., None] * ((1.0 - v)[..., None] * (a - origin) + v[..., None] * (b - origin))
        jacobian = u * abs(a[0] * b[1] - a[1] * b[0])
        height = face_height(window, body.back, points[..., 0].ravel(), points[..., 1].ravel()) - face_height(
            window, body.front, points[..., 0].ravel(), points[..., 1].ravel()
        )
        volume += float(np.sum(w * jacobian * height.reshape(u.shape)))
    return volume * window.lattice.cell_count * (window.unit * 1e3) ** 3
