"""Fused solids: closed, valid, of the right volume, for every form and every border."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from brepwindows import SWEEPS, biconvex, column_volume
from often import often

import clacad
from clacad.sheet.feasibility import body_facts
from clacad.sheet.lattice import Circle, Rectangle
from clacad.sheet.window import column
from clacad.solid.occ_writer import OccWriter, is_valid, volume_and_area
from clacad.solid.solids import describe_body
from clacad.topology.build_complex import cell_complex
from clacad.topology.complex_parts import CannotBuild

DESIGNS = Path(__file__).parents[2] / "designs"


def built(window, body):
    writer = OccWriter()
    shells = describe_body(window, body, writer)
    return [writer.solid(faces) for faces in shells.pieces()], shells.counts


COVERED = {
    "flat": {},
    "tilted": {"euler": (20.0, 3.0, 0.0)},
    "much tilted": {"euler": (20.0, 20.0, 40.0), "thickness": 0.3},
    "offset": {"delta": (0.05, -0.02), "euler": (0.0, 1.0, 0.0)},
    "turned": {"euler": (45.0, 0.0, 0.0)},
    "hexagonal": {"kind": "hexagonal", "euler": (10.0, 2.0, 0.0)},
    "galilean": {"eta": (0.5, 0.3), "thickness": 0.3, "euler": (30.0, 1.0, 0.0)},
    "saddle lens": {"eta": (-0.5, 0.4), "thickness": 0.2},
    "cylinder": {"eta": (-0.5, 1.0 - 1e-15), "thickness": 0.2},
    "flat lens": {"eta": (-0.5, -1.0), "separation": 5e6, "euler": (0.0, 2.0, 0.0)},
    "micrometres": {"pitch": 0.005, "separation": 0.05, "thickness": 0.0015, "euler": (10.0, 2.0, 0.0)},
}


@pytest.mark.daily_cases("flat", "tilted", "offset", "turned", "saddle lens", "cylinder", "micrometres")
@pytest.mark.parametrize("name", COVERED)
def test_a_covered_body_is_one_valid_solid_with_the_volume_of_its_columns(name):
    window = biconvex(**COVERED[name])
    # Lens 2 of the flat pair lies 5 km away, where doubles are a nanometre apart.
    for body in window.bodies[: 1 if name == "flat lens" else 2]:
        solids, counts = built(window, body)
        assert len(solids) == 1
        assert is_valid(solids[0])
        # What a merged border leaves out is at most its length times the merge height.
        merged = counts.merged_steps * 1e-6 * window.lattice.pitch[0]
        expected = column_volume(window, body)
        assert abs(volume_and_area(solids[0])[0] - expected) <= 1e-10 * expected + merged


RIMMED = {
    "web": {"thickness": 0.14, "web": 0.03, "euler": (30.0, 4.0, 0.0)},
    "web untilted": {"thickness": 0.05, "web": 0.02},
    "seam": {"seam": 0.05, "web": 0.02, "thickness": 0.12, "euler": (0.0, 1.0, 0.0)},
    "seam and rim": {"seam": 0.05, "web": 0.03, "thickness": 0.06, "euler": (0.0, 1.0, 0.0)},
    "rectangle": {"web": 0.03, "thickness": 0.09, "outline": Rectangle(2.0, 2.2)},
    "circle": {"web": 0.03, "thickness": 0.09, "outline": Circle(3.0), "euler": (0.0, 2.0, 0.0)},
    "loose strips": {"thickness": 0.05},
    "hexagonal web": {"kind": "hexagonal", "web": 0.02, "thickness": 0.05, "euler": (0.0, 2.0, 10.0)},
    "flat seam": {"kind": "hexagonal", "seam": 0.05, "web": 0.02, "thickness": 0.12},
}


@pytest.mark.daily_cases("web", "seam and rim", "circle", "loose strips")
@pytest.mark.parametrize("name", RIMMED)
def test_rims_lands_seams_and_outlines_give_valid_solids_as_many_as_are_counted(name):
    window = biconvex(**RIMMED[name])
    for body in window.bodies:
        solids, _ = built(window, body)
        assert len(solids) == body_facts(window, body).pieces
        assert all(is_valid(solid) for solid in solids)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", often(["web", "web untilted", "seam", "seam and rim", "hexagonal web"], "web", "seam")
)
def test_rims_and_lands_lie_where_the_columns_of_the_sheet_have_them(name):
    window = replace(biconvex(**RIMMED[name]), outline=None)
    window = replace(window, lattice=window.with_cells((1, 1)).lattice)
    extent = window.lattice.extent()
    n = 600
    x, y = (low + (high - low) * (np.arange(n) + 0.5) / n for low, high in (extent[:2], extent[2:]))
    x, y = (grid.ravel() for grid in np.meshgrid(x, y))
    index, _, _ = window.lattice.locate(x, y)
    inside = window.lattice.contains(index)
    cell = (extent[1] - extent[0]) * (extent[3] - extent[2]) / n**2
    for body in window.bodies:
        front, back = column(window, body, x[inside], y[inside])
        solids, _ = built(window, body)
        # Midpoints of a grid of 600 meet jumps of the height within 1/600 of the cell.
        assert volume_and_area(solids[0])[0] == pytest.approx(float(np.sum(back - front)) * cell, rel=2e-3)


def test_a_web_too_thin_for_the_rim_of_its_tilted_lens_is_refused_with_the_thickness_that_holds_it():
    thin = biconvex(count=(1, 1), thickness=0.02, web=0.002, euler=(0.0, 5.0, 0.0))
    with pytest.raises(ValueError, match=r"a web of at least ([0-9.]+) mm") as found:
        describe_body(thin, thin.bodies[0], OccWriter())
    needed = float(str(found.value).split("at least ")[1].split(" mm")[0])
    enough = biconvex(count=(1, 1), thickness=0.02, web=needed * 1.001, euler=(0.0, 5.0, 0.0))
    solids, _ = built(enough, enough.bodies[0])
    assert is_valid(solids[0])


def test_a_biconic_slab_is_a_valid_solid_of_fitted_faces():
    raw = tomllib.loads((DESIGNS / "tilted.toml").read_text())
    raw["pair"]["surface"] = "biconic"
    window = clacad.prescribe(clacad.Design.from_dict(raw)).with_cells((2, 2))
    solids, counts = built(window, window.bodies[0])
    assert counts.faces["lens"] == 8
    assert is_valid(solids[0])


TOUCHING = {
    "cells fill the outline": {"count": (4, 3), "outline": Rectangle(2.0, 1.5)},
    "cells touch two sides": {"count": (4, 3), "outline": Rectangle(2.0, 1.9)},
    "one cell in its circle": {"count": (1, 1), "outline": Circle(0.5 * np.sqrt(2.0))},
    "circle through lattice points": {"count": (8, 8), "outline": Circle(5.0 * 0.5)},
    "hexagons in their box": {
        "kind": "hexagonal",
        "count": (4, 4),
        "outline": Rectangle(2.25, 3.25 / np.sqrt(3.0)),
    },
}


@pytest.mark.daily_cases("one cell in its circle")
@pytest.mark.parametrize("name", TOUCHING)
def test_cells_that_touch_the_outline_leave_no_sliver_of_land(name):
    window = biconvex(web=0.03, thickness=0.09, euler=(20.0, 2.0, 0.0), **TOUCHING[name])
    window = replace(window, lattice=replace(window.lattice, outline=window.outline))
    body = window.bodies[0]
    solids, counts = built(window, body)
    assert len(solids) == 1
    assert is_valid(solids[0])
    assert counts.faces["side"] == 4
    outline = window.outline
    area = np.pi * outline.diameter**2 / 4 if isinstance(outline, Circle) else outline.width * outline.height
    cells = window.lattice.cell_count
    alone, _ = built(
        replace(window.with_cells((1, 1)), outline=None, lattice=window.with_cells((1, 1)).lattice), body
    )
    land = 0.03 * (area - cells * window.lattice.cell_area)
    assert volume_and_area(solids[0])[0] == pytest.approx(
        cells * volume_and_area(alone[0])[0] + land, rel=1e-11
    )


def test_a_lens_on_a_plate_has_the_volume_of_a_plate_and_two_ellipsoid_caps():
    window = biconvex(count=(2, 2), thickness=0.012, web=0.002, eta=(-0.6, -1.0))
    for body in window.bodies:
        cx, cy, kappa = (
            body.front.surface.curvature_x,
            body.front.surface.curvature_y,
            body.front.surface.kappa,
        )
        h = 0.5 * (0.012 - 0.002)
        a, b, c = 1.0 / np.sqrt(kappa * cx), 1.0 / np.sqrt(kappa * cy), 1.0 / kappa
        cap = np.pi * a * b * h * h * (3.0 * c - h) / (3.0 * c * c)
        solids, counts = built(window, body)
        assert counts.faces["lens"] == 8
        assert volume_and_area(solids[0])[0] == pytest.approx(
            4.0 * (0.5 * 0.5 * 0.002 + 2.0 * cap), rel=1e-12
        )


def test_a_lens_without_land_is_two_caps_meeting_in_an_ellipse():
    window = biconvex(count=(1, 1), thickness=0.006, eta=(-0.6, -1.0))
    for body in window.bodies:
        cx, cy, kappa = (
            body.front.surface.curvature_x,
            body.front.surface.curvature_y,
            body.front.surface.kappa,
        )
        h, a, b, c = 0.003, 1.0 / np.sqrt(kappa * cx), 1.0 / np.sqrt(kappa * cy), 1.0 / kappa
        solids, counts = built(window, body)
        assert dict(counts.faces) == {"lens": 2}
        assert is_valid(solids[0])
        cap = np.pi * a * b * h * h * (3.0 * c - h) / (3.0 * c * c)
        assert volume_and_area(solids[0])[0] == pytest.approx(2.0 * cap, rel=1e-12)


def test_seams_remove_steps_between_neighbours_saddles_and_wedges():
    counts = [
        built(window, window.bodies[0])[1]
        for window in (
            biconvex(euler=(45.0, 1.0, 0.0), web=0.02, thickness=0.2),
            biconvex(euler=(45.0, 1.0, 0.0), web=0.02, thickness=0.2, seam=0.02),
        )
    ]
    assert counts[0].saddles > 0
    assert counts[0].wedges > 0
    assert counts[1].saddles == 0
    assert counts[1].wedges == 0


@pytest.mark.daily_cases("square-euler0", "square-euler2", "hexagonal-euler1")
@pytest.mark.parametrize("euler", [(45.0, 0.0, 0.0), (20.0, 3.0, 10.0), (0.0, 2.0, 0.0)])
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_saddles_and_crossings_are_those_of_the_cell_complex(euler, kind):
    n1, n2 = 4, 3
    window = biconvex(euler=euler, count=(n1, n2), kind=kind)
    for body in window.bodies:
        _, counts = built(window, body)
        tiling = cell_complex(window, body).tilings[0]
        cells = {tuple(index) for index in window.lattice.cells().tolist()}
        crossings = sum(
            len(border.breaks)
            for border in tiling.borders
            for i, j in cells
            if (i + border.step[0], j + border.step[1]) in cells
        )
        saddles = sum(
            int(node.saddle_front) + int(node.saddle_back)
            for node in tiling.nodes
            for i, j in cells
            if all((i + di, j + dj) in cells for (di, dj), _ in node.cells)
        )
        assert counts.crossings == crossings
        assert counts.saddles == saddles


SHIPPED = ("fig8", "galilean", "plano", "slab", "tilted", "tilted-seam")


@pytest.mark.daily_cases("galilean", "plano", "slab", "tilted", "tilted-seam")
@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_designs_of_every_form_are_built_as_valid_solids(name):
    check_design(DESIGNS / f"{name}.toml")


@pytest.mark.long
@pytest.mark.parametrize("path", sorted(DESIGNS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_design_is_built_as_valid_solids(path):
    check_design(path)


def check_design(path):
    window = clacad.prescribe(clacad.load(str(path)))
    if window.lattice.cell_count > 16:
        window = window.with_cells((3, 3))
    for body in window.bodies:
        solids, _ = built(window, body)
        assert len(solids) == body_facts(window, body).pieces
        assert all(is_valid(solid) for solid in solids)


def test_a_lens_that_comes_near_its_equator_is_one_exact_patch_of_higher_degree():
    window = biconvex(
        eta=(-1.0, -1.0), separation=0.4, thickness=0.3, count=(1, 1)
    )  # R = 0.2, rim at 76 degrees
    solids, counts = built(window, window.bodies[0])
    assert dict(counts.faces) == {"lens": 2}
    assert is_valid(solids[0])
    h, r = 0.15, 0.2
    assert volume_and_area(solids[0])[0] == pytest.approx(2.0 * np.pi * h * h * (3.0 * r - h) / 3.0, rel=1e-8)


def test_a_lens_undercut_at_its_rim_is_refused_and_built_with_less_tilt():
    undercut = {"eta": (-1.0, -1.0), "separation": 0.4, "thickness": 0.3, "web": 0.25, "count": (1, 1)}
    window = biconvex(**undercut, euler=(0.0, 40.0, 0.0))
    with pytest.raises(CannotBuild, match="CL133: .*tilt it less"):
        built(window, window.bodies[0])
    window = biconvex(**undercut, euler=(0.0, 10.0, 0.0))
    solids, _ = built(window, window.bodies[0])
    assert is_valid(solids[0])


def test_a_surface_that_ends_before_its_plane_is_refused_and_built_with_a_longer_radius_or_smaller_pitch():
    def domed(**changes):
        """Front lenses on a plane as far away as their radius is long."""
        sheet = biconvex(
            **({"eta": (-1.0, -1.0), "separation": 0.3, "thickness": 0.3, "count": (2, 2)} | changes)
        )
        front = sheet.bodies[0].front
        plane = replace(front, array=None, surface=clacad.Quadric(0.0, 0.0, 0.0, -1), vertex=(0.0, 0.0, 0.1))
        return replace(sheet, bodies=(replace(sheet.bodies[0], back=plane),))

    short = domed()  # R = 0.15, half diagonal 0.35
    with pytest.raises(CannotBuild, match="CL133: .*passes its equator before it meets .*a longer radius"):
        built(short, short.bodies[0])
    for out in ({"separation": 1.0}, {"pitch": 0.2}):
        sheet = domed(**out)
        solids, _ = built(sheet, sheet.bodies[0])
        assert [is_valid(solid) for solid in solids] == [True]


def test_a_cell_beyond_the_outline_is_refused_by_solids_and_meshes_alike():
    web = {"web": 0.03, "thickness": 0.09}
    for outline in (Rectangle(1.2, 1.6), Circle(1.2)):
        window = biconvex(**web, outline=outline)
        for make in (lambda w: built(w, w.bodies[0]), lambda w: clacad.tessellate(w, quads=4)):
            with pytest.raises(CannotBuild, match="CL136: .*a larger outline or fewer cells"):
                make(window)
    for out in ({"outline": Rectangle(1.5, 1.6)}, {"outline": Circle(1.2), "count": (1, 1)}):
        solids, _ = built(window := biconvex(**web, **out), window.bodies[0])
        assert [is_valid(solid) for solid in solids] == [True]


def test_an_outline_round_lenses_without_land_is_refused_and_a_web_is_the_way_out():
    window = biconvex(thickness=0.3, outline=Rectangle(2.0, 2.0))
    with pytest.raises(CannotBuild, match=r"CL134: .*give pair\.web"):
        built(window, window.bodies[0])
    window = biconvex(thickness=0.3, web=0.03, outline=Rectangle(2.0, 2.0))
    solids, _ = built(window, window.bodies[0])
    assert [is_valid(solid) for solid in solids] == [True]


@pytest.mark.daily_cases("1e-09", "2.7144176165949066e-06", "0.0073680629972807735", "20.0")
@pytest.mark.parametrize("tilt", np.geomspace(1e-9, 20.0, 10).tolist())
def test_steps_of_any_height_give_valid_solids(tilt):
    window = biconvex(euler=(33.0, tilt, 0.0), thickness=0.25, count=(2, 3))
    solids, counts = built(window, window.bodies[1])
    assert len(solids) == 1
    assert is_valid(solids[0])
    assert counts.largest_shift <= 3e-6


@pytest.mark.parametrize("family", SWEEPS)
@pytest.mark.long
def test_sweep_of_sixty_four_angles_stays_valid(family):
    for angle in np.geomspace(1e-9, 20.0, 64):
        window = biconvex(thickness=0.25, count=(2, 3), **SWEEPS[family](float(angle)))
        for body in window.bodies:
            solids, _ = built(window, body)
            assert len(solids) == 1
            assert is_valid(solids[0]), angle


@pytest.mark.long
def test_sixty_four_tilts_of_a_turned_pair_stay_valid():
    for angle in np.geomspace(1e-9, 20.0, 64):
        window = biconvex(thickness=0.25, count=(2, 1), **SWEEPS["anamorphic tilt"](float(angle)))
        solids, _ = built(window, window.bodies[1])
        assert len(solids) == 1
        assert is_valid(solids[0]), angle
