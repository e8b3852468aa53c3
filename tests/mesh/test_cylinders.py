"""Lenticular sheets: a cylinder needs half the width of its cell, and one step of the facet grid along it."""

from __future__ import annotations

from math import pi
from pathlib import Path

import numpy as np
import pytest

import clacad
from clacad.exporting.formats.format import RoughSheet
from clacad.exporting.limits import refuse_early
from clacad.exporting.tessellations import Meshes
from clacad.mesh import tessellate
from clacad.mesh.tessellation import slope_error_at
from clacad.sheet.bundle import bundle
from clacad.sheet.stack import stacked
from clacad.tracing.through_stack import launched

ROOT = Path(__file__).parents[2]
KEYS = {"law.eta": [-1.0, 1.0], "lattice.kind": "rectangular", "lattice.pitch": [0.5, 6.0], "lattice.count": [6, 3],
        "check.process": "none"}  # fmt: skip
SHEET = clacad.load(ROOT / "designs" / "window-100mm.toml").replace(KEYS)
"""Cells .5 x 6 mm, focal length 5 mm in x: radius 2.47 mm, more than half the width and less than half the diagonal."""


def closed(mesh) -> bool:
    """Whether each directed edge of every body occurs once, and its reverse once."""
    for body in mesh.bodies:
        t = body.triangles
        edges = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
        forth, back = (np.unique(one, axis=0, return_counts=True) for one in (edges, edges[:, ::-1]))
        if (forth[1] != 1).any() or not np.array_equal(forth[0], back[0]):
            return False
    return True


def test_a_cylinder_needs_half_the_width_of_its_cell():
    window = clacad.prescribe(SHEET)
    assert 0.25 < 1.0 / window.faces[0].surface.curvature_x < 3.0


def test_a_cylinder_wider_than_twice_its_radius_is_refused_with_the_width():
    with pytest.raises(clacad.DesignError) as caught:
        clacad.prescribe(SHEET.replace({"pair.separation": 1.0, "lattice.pitch": [0.6, 6.0]}))
    said = str(caught.value)
    assert "CL120" in said
    assert "less than half the width of its cell (0.3)" in said
    pitch = float(said.split("pitch along x < ")[1].split(",")[0])
    keys = {"pair.separation": 1.0, "lattice.pitch": [0.999 * pitch, 6.0], "lattice.aperture": "aligned"}
    clacad.prescribe(SHEET.replace(keys))


def test_a_lens_with_power_in_both_axes_still_needs_half_the_diagonal():
    with pytest.raises(clacad.DesignError, match="half the diagonal"):
        clacad.prescribe(SHEET.replace({"law.eta": [-1.0, -1.0]}))


def test_a_turned_cylinder_needs_the_width_of_its_cell_across_it():
    """Turned by 30 degrees a .5 x 6 mm cell is .5 cos 30 + 6 sin 30 = 3.43 mm wide across the cylinder."""
    with pytest.raises(clacad.DesignError, match=r"half the width of its cell \(1\.71651\)"):
        clacad.prescribe(SHEET.replace({"law.euler": [30.0, 0.0, 0.0], "pair.separation": 5.0}))


@pytest.mark.parametrize(
    "keys",
    [{}, {"body.border": 2.0}, {"law.delta": [0.01, 0.0]}, {"law.euler": [0.0, 1.0, 0.0], "pair.separation": 30.0},
     {"law.euler": [90.0, 0.0, 0.0], "lattice.pitch": [6.0, 0.5]}, {"pair.form": "plano", "pair.thickness": 1.0},
     {"pair.form": "biconvex", "pair.thickness": "auto", "pair.web": 0.3, "lattice.seam": 0.1, "lattice.count": [3, 2]},
     {"pair.form": "biconvex", "pair.thickness": "auto", "lattice.outline": {"circle": 15.0}}],
    ids=["plain", "border", "offset", "tilt", "turned", "plano", "seam", "round"],
)  # fmt: skip
def test_the_mesh_of_cylinders_is_closed(keys):
    assert closed(tessellate(clacad.prescribe(SHEET.replace(keys)), quads=6))


def test_facets_of_a_cylinder_are_as_long_as_its_cell():
    """Two faces of 18 cells, q strips each, two facets a strip; the side walls' are fewer than 10 q a cell."""
    window = clacad.prescribe(SHEET)
    for quads in (16, 64):
        found = tessellate(window, quads=quads).facet_count
        assert 2 * 18 * 2 * quads <= found <= 2 * 18 * 2 * quads + 10 * quads * 18
    assert Meshes(window).facets(64) == tessellate(window, quads=64).facet_count


def test_long_facets_lose_no_accuracy():
    """Chords of a circle: the rms slope error of q strips over p is p/(q R sqrt 12), and the volume is that of the polygon."""
    window = clacad.prescribe(SHEET)
    radius = 1.0 / window.faces[0].surface.curvature_x
    assert slope_error_at(window, 16) == pytest.approx(0.5 / (16 * radius * 12**0.5), rel=0.01)
    half = np.arcsin(0.25 / radius)
    segment = 0.5 * radius**2 * (2.0 * half - np.sin(2.0 * half))  # of the disc above the chord
    thick = window.z_range[1] - 2.0 * (radius - np.sqrt(radius**2 - 0.25**2))
    exact = 18 * 6.0 * (0.5 * thick + 2.0 * segment)
    assert tessellate(window, quads=64).bodies[0].volume() == pytest.approx(exact, rel=1e-6)
    assert half < pi / 2


def test_tilted_off_its_axis_and_crossed_cylinders_keep_all_their_quads():
    diagonal = clacad.prescribe(SHEET.replace({"law.euler": [45.0, 0.0, 0.0], "pair.separation": 40.0}))
    assert tessellate(diagonal, quads=8).facet_count >= 2 * 18 * 2 * 8 * 8
    across = clacad.prescribe(SHEET.replace({"law.euler": [90.0, 1.0, 0.0], "pair.separation": 40.0}))
    assert tessellate(across, quads=8).facet_count >= 2 * 18 * 2 * 8


def test_forecasts_before_a_mesh_is_made_know_cylinders():
    window = clacad.prescribe(SHEET)
    for rough in (RoughSheet.of_design(SHEET), RoughSheet.of_window(window)):
        assert rough.facets(64) * rough.cells == pytest.approx(
            tessellate(window, quads=64).facet_count, rel=0.4
        )
    refuse_early(SHEET.replace({"lattice.count": [1000, 200]}), ["stl"], {"stl": 64})
    with pytest.raises(Exception, match="facets"):
        refuse_early(SHEET.replace({"lattice.count": [1000, 200], "law.eta": [-1, -1]}), ["stl"], {"stl": 64})


def test_crossed_cylinders_as_a_pair_are_refused_and_two_sheets_of_cylinders_are_what_works():
    faces = [{"radius": [2.5, "inf"]}, {"radius": ["inf", 2.5]}]
    plain = clacad.load(ROOT / "designs" / "window-100mm.toml")
    with pytest.raises(clacad.DesignError) as caught:
        clacad.prescribe(plain.replace({"pair.prescription": "given", "pair.face": faces}))
    said = str(caught.value)
    assert "each axis needs two lenses" in said
    assert "law.eta = [-1, 1]" in said
    assert "law.eta = [1, -1]" in said
    pair = [
        clacad.prescribe(plain.replace({"law.eta": eta, "lattice.count": [8, 8], "pair.separation": s}))
        for eta, s in (([-1, 1], 10.0), ([1, -1], 12.0))
    ]
    made = stacked(pair, [2.0])
    rays = launched(made, 256, 0.004)
    out = clacad.trace_stack(made, rays)
    alive = out.fate == clacad.Fate.ALIVE
    assert alive.mean() > 0.5
    slopes = [d[alive, :2] / d[alive, 2:] for d in (rays.direction, out.direction)]
    np.testing.assert_allclose(slopes[1], -slopes[0], atol=1e-3)  # eta = -1 in x by sheet a, in y by sheet b


@pytest.mark.slow
def test_light_through_long_facets_goes_as_through_the_cylinders():
    """Within twice what the slopes of the facets, p/(q R sqrt 12) on either face, bend by n - 1."""
    window = clacad.prescribe(SHEET)
    rays = bundle(window, 2000, 0.01).rays
    mesh, exact = clacad.trace(window, rays, "mesh", mesh=64), clacad.trace(window, rays)
    alive = (mesh.fate == clacad.Fate.ALIVE) & (exact.fate == clacad.Fate.ALIVE)
    assert alive.mean() > 0.9
    slope = 0.5 * abs(window.faces[0].surface.curvature_x) / (64 * 12**0.5)
    apart = np.linalg.norm(mesh.direction - exact.direction, axis=1)[alive]
    assert np.sqrt(np.mean(apart**2)) < 2.0 * slope
