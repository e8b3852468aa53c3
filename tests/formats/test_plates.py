"""Plates with holes in every file: volumes of the closed forms, the same edges for solids, meshes, masks and light."""

from __future__ import annotations

import re
from math import hypot, pi

import numpy as np
import pytest

from clacad.design import Design
from clacad.exporting.pov.pov_scene import write_pov
from clacad.formats.maps.mask import write_dxf, write_svg
from clacad.formats.step.step_files import read_step, write_step
from clacad.mesh.health import check_closed
from clacad.mesh.tessellation import tessellate
from clacad.optics.rays import NO_CELL, Fate, Rays
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import feasibility
from clacad.sheet.volume_and_extent import body_volume
from clacad.tracing.facets.triangle_soup import TriangleSoup
from clacad.tracing.trace import trace
from clacad.verification.tolerance import draw, parameters, telescopelet

BASE = {"format": 1, "name": "plate", "unit": "mm", "law": {"eta": [-0.8, -1.0]}}
SLAB = BASE | {
    "pair": {"form": "slab", "separation": 6, "index": 1.5},
    "lattice": {"pitch": 1.0, "count": [6, 5]},
}
PLANO = BASE | {
    "pair": {"form": "plano", "separation": 8, "thickness": 1.5, "index": 1.5}, "lattice": {"pitch": 1.0, "count": [6, 5]},
}  # fmt: skip
BICONVEX = BASE | {
    "law": {"eta": [-1, -1]}, "pair": {"form": "biconvex", "separation": 8, "thickness": 1, "index": 1.5},
    "lattice": {"pitch": 1.0, "count": [6, 5], "kind": "hexagonal"},
}  # fmt: skip
HOLES = [{"diameter": 1.2, "corners": 1.6}, {"diameter": 0.7, "at": [[0, 4.6]]}]
BENT = [[-6, -5], [6, -5, 0.3], [6, 1], [1, 1, -0.414], [0, 2], [0, 6], [-6, 6]]
"""Not convex, with a bulge either way; rows of cells fall into two runs."""


def window(base, lattice=None, **body):
    return prescribe(Design.from_dict(base | {"lattice": base["lattice"] | (lattice or {}), "body": body}))


def land_thickness(body):
    front, back = (face.vertex[2] if face.land is None else face.land for face in (body.front, body.back))
    return back - front


@pytest.mark.slow
@pytest.mark.parametrize(("base", "corners", "lost"), [
    (PLANO, {"chamfer": 1.5}, 2 * 1.5**2),
    pytest.param(SLAB, {"round": 1.5}, (4 - pi) * 1.5**2, marks=pytest.mark.slow),
    pytest.param(BICONVEX, {"round": 1.5}, (4 - pi) * 1.5**2, marks=pytest.mark.slow),
])  # fmt: skip
def test_corners_and_holes_take_their_closed_forms_off_solid_and_mesh(tmp_path, base, corners, lost):
    plain, plate = window(base, border=3), window(base, border=3, corners=corners, holes=HOLES)
    lost += pi / 4 * (4 * 1.2**2 + 0.7**2)
    wanted = sum(lost * land_thickness(body) for body in plain.bodies)
    for mode in ("fused", "instanced"):
        facts = []
        for name, one in (("plain", plain), ("plate", plate)):
            write_step(one, tmp_path / f"{name}.step", mode=mode)
            facts.append(read_step(tmp_path / f"{name}.step"))
        assert facts[1]["valid"]
        assert facts[0]["volume"] - facts[1]["volume"] == pytest.approx(wanted, rel=1e-7)
        assert np.allclose(facts[0]["box"], facts[1]["box"], rtol=0, atol=1e-6)
    for one, two in zip(tessellate(plain, quads=4).bodies, tessellate(plate, quads=4).bodies, strict=True):
        front, back = one.tiled[0].maker.tile.land  # whole steps of a float32 file's heights
        assert one.volume() - two.volume() == pytest.approx(lost * (back - front) * one.step, rel=1e-12)
    for before, after in zip(plain.bodies, plate.bodies, strict=True):
        one, two = body_volume(plain, before), body_volume(plate, after)
        assert one.value - two.value == pytest.approx(lost * land_thickness(before), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["square", pytest.param("hexagonal", marks=pytest.mark.slow)])
def test_outlines_that_are_not_convex_make_closed_meshes_and_valid_solids(tmp_path, kind):
    sheet = window(
        SLAB, {"outline": {"polygon": BENT}, "count": [11, 11], "kind": kind},
        holes=[{"diameter": 0.8, "at": [[-5, 5.2], [-2.1, -0.9]]}],
    )  # fmt: skip
    (body,), (mesh,) = sheet.bodies, tessellate(sheet, quads=3).bodies
    health = check_closed(np.concatenate(list(mesh.rows())))
    assert health.closed
    used = len(np.unique(mesh.triangles))
    assert used - len(mesh.triangles) // 2 == 2 - 2 * 2  # Euler: a body with two holes
    write_step(sheet, tmp_path / "bent.step", mode="fused")
    facts = read_step(tmp_path / "bent.step")
    assert facts["valid"]
    assert facts["volume"] == pytest.approx(body_volume(sheet, body).value, rel=1e-9)
    fine = tessellate(sheet, quads=12).bodies[0]
    coarse, finer = mesh.volume() - facts["volume"], fine.volume() - facts["volume"]
    assert abs(finer) < 0.08 * abs(coarse)  # chords of lenses alone: 16 times less


@pytest.mark.parametrize("base", [SLAB, PLANO])
def test_gaps_of_the_cells_that_holes_cut_are_land_and_no_pinholes(base):
    """A hole amid the cells leaves cells out all round; under them lies one plate, of any form."""
    sheet = window(base, {"outline": {"rectangle": [11, 9]}}, holes=[{"diameter": 1.2, "at": [[0.2, 0.3]]}])
    assert 0 < sheet.lattice.cell_count < 99
    for body in feasibility(sheet).bodies:
        assert (body.pieces, body.holes) == (1, 0)


@pytest.mark.slow
def test_light_straight_down_meets_holes_land_and_air_where_plain_words_say():
    sheet = window(SLAB, border=3, corners={"round": 1.5}, holes=HOLES)
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-6.6, 6.6, 600), rng.uniform(-6.1, 6.1, 600)])
    points[:300] = rng.choice([(4.4, 3.9), (-4.4, 3.9), (0, 4.6), (5, 4.5)], 300) + rng.normal(
        0, 0.5, (300, 2)
    )

    def wanted(x, y):
        if (
            any(hypot(x - a, y - b) < 0.6 for a in (4.4, -4.4) for b in (3.9, -3.9))
            or hypot(x, y - 4.6) < 0.35
        ):
            return Fate.MISSED
        u, v = abs(x), abs(y)
        if u > 6 or v > 5.5 or (u > 4.5 and v > 4 and hypot(u - 4.5, v - 4) > 1.5):
            return Fate.MISSED
        return Fate.LAND if u > 3 or v > 2.5 else None

    rays = Rays(np.column_stack([points, np.full(len(points), -1.0)]), (0.0, 0.0, 1.0))
    asked = [wanted(*p) for p in points.tolist()]
    mesh = tessellate(sheet, quads=4)
    soup = TriangleSoup(np.concatenate([rows for body in mesh.bodies for rows in body.rows()]))
    for found in (
        trace(sheet, rays, path="numpy"), trace(sheet, rays, path="numba"), trace(sheet, rays, rung="thin"),
        trace(sheet, rays, rung="mesh", mesh=4),
    ):  # fmt: skip
        assert all(f == a for f, a in zip(found.fate, asked, strict=True) if a is not None)
    by_file = trace(sheet, rays, rung="mesh", mesh=soup)
    rim = (
        np.abs(np.hypot(np.abs(points[:, 0]) - 4.5, np.abs(points[:, 1]) - 4) - 1.5) < 1e-3
    )  # a polygon in place of arcs
    for x, y, r in ((4.4, 3.9, 0.6), (-4.4, 3.9, 0.6), (4.4, -3.9, 0.6), (-4.4, -3.9, 0.6), (0, 4.6, 0.35)):
        rim |= np.abs(np.hypot(points[:, 0] - x, points[:, 1] - y) - r) < 1e-3
    assert all(
        f == a for f, a, near in zip(by_file.fate, asked, rim, strict=True) if a is not None and not near
    )


@pytest.mark.slow
@pytest.mark.parametrize("base", [SLAB, pytest.param(PLANO, marks=pytest.mark.slow)])
def test_slanted_light_ends_alike_on_every_path_and_through_its_triangles(base):
    sheet = window(
        base,
        {"outline": {"polygon": BENT}, "count": [11, 11]},
        holes=[{"diameter": 0.8, "at": [[-5, 5.2], [-2.1, -0.9]]}],
    )
    rng = np.random.default_rng(4)
    start = np.column_stack([rng.uniform(-7, 7, 4000), rng.uniform(-6, 7, 4000), np.full(4000, -1.0)])
    rays = Rays(start, np.column_stack([rng.normal(0, 0.3, (4000, 2)), np.ones(4000)]))
    exact, compiled = trace(sheet, rays, path="numpy"), trace(sheet, rays, path="numba")
    assert (exact.fate == compiled.fate).all()
    assert np.abs(exact.position - compiled.position).max() < 1e-12
    assert {Fate.WALL, Fate.MISSED, Fate.LAND, Fate.ALIVE} <= set(exact.fate.tolist())
    facets = [trace(sheet, rays, rung="mesh", mesh=6, path=path) for path in ("numpy", "numba")]
    assert (facets[0].fate == facets[1].fate).all()
    mesh = tessellate(sheet, quads=6)
    soup = TriangleSoup(np.concatenate([rows for body in mesh.bodies for rows in body.rows()]))
    through = trace(sheet, rays, rung="mesh", mesh=soup)
    assert (through.fate != facets[1].fate).mean() < 2e-3  # arcs are polygons there
    beside = ((exact.cell == NO_CELL) & (through.cell == NO_CELL)).all(
        axis=1
    )  # rays that met no lens on either
    assert {Fate.WALL, Fate.MISSED, Fate.LAND} <= set(exact.fate[beside].tolist())
    assert (through.fate != exact.fate)[beside].mean() < 2e-3


def test_masks_hold_the_holes_and_the_bends(tmp_path):
    ezdxf = pytest.importorskip("ezdxf")
    sheet = window(SLAB, border=3, corners={"round": 1.5}, holes=HOLES)
    body = sheet.bodies[0]
    write_dxf(sheet, body, body.front, "plate", tmp_path / "m.dxf", 1.0)
    write_svg(sheet, body, body.front, "plate", tmp_path / "m.svg", 1.0)
    loops = [
        e
        for e in ezdxf.readfile(tmp_path / "m.dxf").modelspace().query("POLYLINE")
        if e.dxf.layer == "OUTLINE"
    ]
    assert len(loops) == 1 + 5

    def area(loop):
        corners = [(v.dxf.location.x, v.dxf.location.y, v.dxf.bulge) for v in loop.vertices]
        total = 0.0
        for (x0, y0, bulge), (x1, y1, _) in zip(corners, [*corners[1:], corners[0]], strict=True):
            total += 0.5 * (x0 * y1 - x1 * y0)
            if bulge:
                angle = 4 * np.arctan(abs(bulge))
                radius = hypot(x1 - x0, y1 - y0) / (2 * np.sin(angle / 2))
                total += np.sign(bulge) * 0.5 * radius**2 * (angle - np.sin(angle))
        return total

    wanted = 12 * 11 - (4 - pi) * 1.5**2 - pi / 4 * (4 * 1.2**2 + 0.7**2)
    assert sum(map(area, loops)) == pytest.approx(wanted, rel=1e-12)
    (path,) = re.findall(r'<path d="([^"]*)"', (tmp_path / "m.svg").read_text())
    assert path.count("M") == path.count("Z") == 6
    assert path.count("A") == 4 + 4 * 5


def test_the_pov_scene_sweeps_the_boundary_and_drills_the_holes(tmp_path):
    sheet = window(
        SLAB,
        {"outline": {"polygon": BENT}, "count": [11, 11]},
        holes=[{"diameter": 0.8, "at": [[-5, 5.2], [-2.1, -0.9]]}],
    )
    write_pov(sheet, tmp_path / "p.pov")
    text = (tmp_path / "p.pov").read_text()
    assert text.count("prism {") >= 1
    runs = {
        name: [int(v) for v in re.search(rf"{name} = array\[\d+\] {{ ([^}}]*) }}", text)[1].split(",")]
        for name in ("ROW", "FIRST", "END")
    }
    cells = {
        (i, j) for j, a, b in zip(runs["ROW"], runs["FIRST"], runs["END"], strict=True) for i in range(a, b)
    }
    assert cells == {tuple(cell) for cell in sheet.lattice.cells().tolist()}
    assert len(runs["ROW"]) > len(set(runs["ROW"]))  # a row falls into two runs


# -- pins -------------------------------------------------------------------------------------------

PINS = {"diameter": 2, "at": [[-5.2, 1], [5.2, 0]], "play": "10 um"}


def pinned():
    return Design.from_dict(PLANO | {"body": {"border": 4, "pins": PINS}})


def test_the_play_of_pins_is_an_error_with_the_ends_of_its_formula():
    design = pinned()
    found = {p.name: p for p in parameters(design, prescribe(design))}
    assert list(found) == ["pins.x", "pins.y", "pins.turn"]
    assert found["pins.x"].half == found["pins.y"].half == pytest.approx(0.01)
    assert found["pins.turn"].half == pytest.approx(2 * 0.01 / hypot(10.4, 1))
    drawn = np.array([list(draw(list(found.values()), 1, k).values()) for k in range(2000)])
    ends = np.array([p.half for p in found.values()])
    assert (np.abs(drawn) <= ends).all()  # though the design's errors are normal
    assert np.abs(drawn / ends).mean(axis=0) == pytest.approx(0.5, abs=0.03)
    assert not parameters(design.replace("body.pins.play", 0), prescribe(design))


def test_a_loose_pin_shifts_array_2_as_a_decentre_does_and_turns_it_about_the_middle_of_the_pins():
    sheet = prescribe(pinned())
    at = sheet.lattice.centres(np.array([5, 4]))
    shifted = telescopelet(sheet, {"pins.x": 0.004, "pins.y": -0.002}, at)
    same = telescopelet(sheet, {"decentre.2.x": 0.004, "decentre.2.y": -0.002}, at)
    plain = telescopelet(sheet, {}, at)
    for one, two in zip(shifted.seq, same.seq, strict=True):
        assert np.array_equal(one.vertex, two.vertex)
    turn = 1.5e-3
    turned = telescopelet(sheet, {"pins.turn": turn}, at)
    middle = complex(0.0, 0.5)
    for number, (before, after) in enumerate(zip(plain.seq, turned.seq, strict=True)):
        place, moved = (complex(*(np.array(one.vertex[:2]) + at)) for one in (before, after))
        wanted = middle + (place - middle) * np.exp(1j * turn) if number >= 2 else place
        assert moved == pytest.approx(wanted, abs=1e-12)


@pytest.mark.slow
def test_the_sheet_of_a_hole_pattern_verifies_as_master(tmp_path):
    from clacad.exporting.run import export
    from clacad.verification import verify

    design = Design.from_dict(BASE | {
        "law": {"eta": [-0.25, -1.0]}, "pair": {"form": "slab", "separation": 20, "material": "PMMA"},
        "lattice": {"pitch": 1.0, "outline": {"rectangle": [12, 9]}},
        "body": {"corners": {"round": 2}, "holes": [{"diameter": 1.2, "corners": 1.8}, {"diameter": 0.8, "at": [[1.2, 0.3]]}]},
    })  # fmt: skip
    export(design, tmp_path / "out", formats=("step", "stl"), quads={"stl": 64})
    report = verify(design, files=tmp_path / "out")
    words = {one.name: one.word for one in report.verdicts if one.name.endswith((".step", ".stl"))}
    assert words == {"plate.step": "passed as optical master", "plate.stl": "passed as optical master"}
    judged = {check.subject: check.state for check in report.checks if check.id == "volume"}
    assert judged == {"plate.step": "pass", "plate.stl": "pass"}
    holes = next(
        check.sentence for check in report.checks if (check.id, check.subject) == ("pieces", "plate.stl")
    )
    assert "1 connected piece with 5 holes" in holes
