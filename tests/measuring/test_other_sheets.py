"""Measured maps of sheets whose lenslets are tilted, differ from cell to cell, or have faces between them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from measuring.made_parts import Made
from measuring.test_measure import mapped, states

from clacad.design import Design, load
from clacad.light.measure import measure as measure_light
from clacad.measuring.find_lattice import NotMeasurable
from clacad.measuring.measure import measure
from clacad.prescription.prescribe import prescribe
from clacad.sheet.bundle import RequestedLaw, bundle
from clacad.sheet.like_cell import like_cell
from clacad.storage.errors import BadRequest, NotPossible
from clacad.tracing.trace import trace

SEEN = {"front": (1, -1), "back": (-1, -1)}
"""Signs of a map's x and y along the sheet's, as docs/how-to/measured.md states them."""


@dataclass
class Turned(Made):
    """A part of quadrics c x² + d y² + k z² = 2 z about axes that are turned, in the axes of the sheet."""

    curvature: tuple[float, float] = (0.4, 0.4)
    kappa: float = 0.4
    axes: np.ndarray = field(default_factory=lambda: np.eye(3))
    side: str = "front"
    columns: tuple[int, int] | None = None  # cells (i from, to) that have a lenslet; the others are flat

    def surface(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        _, seam = super().surface(x, y)
        steps = self.steps()
        who = np.rint(np.linalg.solve(steps, np.stack([x, y]).reshape(2, -1)))
        u, v = np.stack([x, y]).reshape(2, -1) - steps @ who
        u = u - np.array([self.cells.get((i, j), (0.0, 0.0, 0.0))[0] for i, j in who.T.astype(int)])
        v = v - np.array([self.cells.get((i, j), (0.0, 0.0, 0.0))[1] for i, j in who.T.astype(int)])
        sx, sy = SEEN[self.side]
        c, d = self.curvature
        z = np.zeros_like(u)
        for _ in range(30):  # Newton along the sheet's normal
            p = self.axes.T @ np.stack([sx * u, sy * v, z])
            off = c * p[0] ** 2 + d * p[1] ** 2 + self.kappa * p[2] ** 2 - 2.0 * p[2]
            slope = 2.0 * np.stack([c * p[0], d * p[1], self.kappa * p[2] - 1.0])
            z = z - off / np.einsum("ik,i->k", slope, self.axes[2])
        height = -z if self.side == "front" else z
        if self.columns is not None:
            height = np.where((who[0] < self.columns[0]) | (who[0] > self.columns[1]), -0.01, height)
        return height.reshape(x.shape), seam.reshape(x.shape)


def like(design: Design, side: str, first: tuple[int, int] = (0, 0), **other) -> Turned:
    """The part as designed, its cell `first` in the middle of the map."""
    window = prescribe(design)
    face = window.faces[0 if side == "front" else -1]
    surface, sign = face.surface, 1.0 if side == "front" else -1.0
    conic = getattr(surface, "conic_x", None)
    kappa = surface.kappa if conic is None else (1.0 + conic) * surface.curvature_x
    made = Turned(
        pitch=window.lattice_of(face.array).pitch, side=side, axes=np.asarray(face.rotation),
        curvature=(sign * surface.curvature_x, sign * surface.curvature_y), kappa=sign * kappa, **other,
    )  # fmt: skip
    (sx, sy), count = SEEN[side], window.lattice.count
    for i, j in made.cells:
        cell = np.clip([first[0] + sx * i, first[1] + sy * j], 0, np.array(count) - 1)
        x, y, _ = window.vertices(face, cell)
        made.cells[i, j] = (float(sx * x), float(sy * y), 1.0)
    return made


def exact(design: Design, cells) -> float:
    """Rms error of light through the exact surfaces of these cells."""
    window, squares = prescribe(design), []
    for cell in cells:
        one = like_cell(window, np.array(cell))
        lit = bundle(one, 1024, design.check.field, design.check.field_centre)
        send = lambda rays, sheet=one: trace(sheet, rays.rays, path="size")  # noqa: E731
        squares.append(measure_light(send, lit, RequestedLaw.of(one)).rms ** 2)
    return float(np.sqrt(np.mean(squares)))


AIMED = load("window-100mm", [
    "lattice.count=[21,21]", "lattice.aperture={point=[0,0,-400]}", 'pair.surface="biconic"',
    "pair.conic=[-0.7,-0.7]", 'pair.offset="traced"',
])  # fmt: skip
FIELD_LENS = load("plano", ["lattice.count=[5,5]", "pair.field_lens=true"])
OTHERS = {
    "tilted front": (load("tilted", ["lattice.count=[5,5]"]), "front", (2, 2)),
    "tilted back": (load("tilted", ["lattice.count=[5,5]"]), "back", (2, 2)),
    "four faces": (load("tilted-biconvex", ["lattice.count=[5,5]"]), "front", (2, 2)),
    "field lens": (FIELD_LENS, "back", (2, 2)),
    "aimed back": (AIMED, "back", (15, 12)),
}


@pytest.mark.parametrize("name", OTHERS)
def test_light_through_a_perfect_part_is_that_through_the_exact_faces(name):
    design, side, cell = OTHERS[name]
    made = like(design, side, cell, noise=1e-6, spikes=0, dirt=0, lost=0.0, rim=0.0)
    found = measure(design, **{side: mapped(made)}, z_scale=1.0, cell=cell)
    true = exact(design, found.light.cells)
    assert found.light.rms == pytest.approx(true, rel=0.02, abs=4e-6)
    assert found.radii()[side][0] == pytest.approx(found.sides[side].radius, rel=1e-4)
    assert np.abs(found.sides[side].deviation[np.isfinite(found.sides[side].deviation)]).max() < 30e-6
    assert len(found.sides[side].lenslets.index) >= 9
