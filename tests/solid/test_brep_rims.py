"""Rims that are no plane curves: fitted within the error they state, closed solids, the volume of the true lens."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import mpmath
import numpy as np
import pytest
from brepwindows import biconvex, one_body, turn
from scipy.optimize import brentq

import clacad
from clacad.exporting.run import export
from clacad.formats.step.step_files import read_step, write_step
from clacad.mesh import tessellate
from clacad.sheet.feasibility import body_facts
from clacad.solid.fitted_rims import Gap, fitted_rim
from clacad.solid.occ_writer import OccWriter, is_valid, volume_and_area
from clacad.solid.solids import describe_body, layers
from clacad.topology.complex_parts import CannotBuild

BASE = {
    "format": 1,
    "name": "rimmed",
    "unit": "mm",
    "law": {"eta": [-0.5, -1.0], "euler": [0.0, 0.0, 0.0]},
    "pair": {"form": "biconvex", "separation": 10.0, "index": 1.5, "surface": "biconic", "conic": [-1.0, -2.0]},
    "lattice": {"pitch": 0.5, "count": [2, 2]},
}  # fmt: skip


def design(**changes):
    made = deepcopy(BASE)
    for key, value in changes.items():
        section, name = key.split("__")
        made.setdefault(section, {})[name] = value
    if made["pair"]["surface"] == "ellipsoid" or made["pair"]["form"] == "plano":
        del made["pair"]["conic"]
    return clacad.Design.from_dict(made)


def window(**changes):
    return clacad.prescribe(design(**changes))


def built(sheet, body):
    writer = OccWriter()
    shells = describe_body(sheet, body, writer)
    return [writer.solid(faces) for faces in shells.pieces()], shells.counts


def cells(sheet, body):
    return [face for part in layers(sheet, body) for face in part.cell.faces]


def sag(surface, x, y):
    """Sag of a biconic by its textbook formula; mpmath or numpy numbers."""
    q = surface.curvature_x * x * x + surface.curvature_y * y * y
    under = 1 - (1 + surface.conic_x) * (surface.curvature_x * x) ** 2 - (1 + surface.conic_y) * (
        surface.curvature_y * y
    ) ** 2  # fmt: skip
    return surface.side * q / (1 + under**0.5)


def height(face, x, y):
    """Height of a tilted biconic over (x, y), to 30 digits, by a root of its implicit equation."""
    with mpmath.workdps(30):
        rotation = mpmath.matrix(face.rotation.tolist())

        def off(z):
            p = rotation.T * mpmath.matrix([x - face.vertex[0], y - face.vertex[1], z - face.vertex[2]])
            return p[2] - sag(face.surface, p[0], p[1])

        return mpmath.findroot(off, mpmath.mpf(face.vertex[2]))


# -- the curves --------------------------------------------------------------------------------------

TILTED = {
    "closed": ({"pair__thickness": 0.004}, False),
    "from side to side, tilted": ({"pair__thickness": 0.02, "law__euler": [20.0, 1.0, 0.0]}, False),
    "on a web": ({"pair__thickness": 0.06, "pair__web": 0.03, "law__euler": [20.0, 3.0, 0.0]}, True),
}


@pytest.mark.daily_cases("on a web", "closed")
@pytest.mark.parametrize("name", TILTED)
def test_a_fitted_rim_lies_on_the_true_one_within_the_error_it_states(name):
    changes, landed = TILTED[name]
    sheet = window(lattice__count=[1, 1], **changes)
    body = sheet.bodies[0]
    front, _ = cells(sheet, body)
    assert 0.0 < front.rim_error <= 5e-11
    arcs = [arc for chain in front.rims for arc in chain]
    assert arcs
    for arc in arcs:
        for x, y, z in arc.at(np.array([0.0, 0.13, 0.5, 0.81])).tolist():
            step = 1e-6

            def gap(x, y):
                return (mpmath.mpf(body.front.land) if landed else height(body.back, x, y)) - height(
                    body.front, x, y
                )

            here = gap(x, y)
            slope = mpmath.hypot((gap(x + step, y) - here) / step, (gap(x, y + step) - here) / step)
            assert abs(here) / slope <= 1.2 * front.rim_error + 1e-13
            assert abs(z - (body.front.land if landed else height(body.front, x, y))) <= 2.0 * front.rim_error


def test_edge_and_parameter_curves_are_the_same_points_on_both_faces():
    sheet = window(pair__thickness=0.02, law__euler=[20.0, 1.0, 0.0])
    front, back = cells(sheet, sheet.bodies[0])
    t = np.linspace(0.0, 1.0, 21)
    assert front.rims
    assert front.rims is back.rims
    for face in (front, back):
        patch = face.lens.patch
        for arc in (arc for chain in front.rims for arc in chain):
            on_patch = patch.at(*face.lens.parameters(arc).at(t).T)
            assert np.abs(on_patch - arc.at(t)).max() <= 1e-10
            assert np.abs(on_patch[:, :2] - arc.at(t)[:, :2]).max() <= 1e-15


@pytest.mark.parametrize("tangled", ["ring", "two islands", "dip"])
def test_any_tangle_of_rims_divides_its_zone_into_regions_of_the_right_area(tangled):
    def ring(x, y):
        r = np.hypot(x, y)
        with np.errstate(invalid="ignore", divide="ignore"):
            return (r - 0.1) * (0.2 - r), ((0.3 - 2.0 * r) / r)[:, None] * np.stack([x, y], axis=1)

    def islands(x, y):
        return 0.01 - (np.abs(x) - 0.12) ** 2 - y**2, np.stack(
            [-2.0 * (np.abs(x) - 0.12) * np.sign(x), -2.0 * y], 1
        )

    def dip(x, y):  # a circle that reaches 1e-6 over the lower side only: nearer than any grid
        return np.hypot(x, y + 0.25 + 1.0) - (1.0 + 1e-6), np.stack([x, y + 1.25], 1) / np.hypot(x, y + 1.25)[
            :, None
        ]

    upper, lens = {
        "ring": (ring, np.pi * (0.2**2 - 0.1**2)), "two islands": (islands, 2.0 * np.pi * 0.01),
        "dip": (dip, 0.25 - 4.0 / 3.0 * np.sqrt(2e-6) * 1e-6),
    }[tangled]  # fmt: skip
    zone = 0.25 * np.array([(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)])
    flat = Gap(lambda x, y: (np.zeros(len(x)), np.zeros((len(x), 2))), upper)
    rim = fitted_rim(flat, zone, "land", 1e-12)
    areas = {"lens": 0.0, "land": 0.0}
    nodes, weights = np.polynomial.legendre.leggauss(24)
    for region in rim.pattern.regions:
        for loop in region.loops:
            for what, number, detail in loop:
                if what == "run":
                    a, b = zone[number], zone[(number + 1) % 4]
                    run = rim.pattern.runs[number][detail]
                    p, q = a + run.t0 * (b - a), a + run.t1 * (b - a)
                    areas[region.kind] += 0.5 * (p[0] * q[1] - p[1] * q[0])
                    continue
                for arc in rim.arcs[number]:  # Green's theorem, exact for the degree of the curve
                    t = 0.5 * (nodes + 1.0)
                    fine = np.array([arc.at(t + h)[:, :2] for h in (-1e-6, 0.0, 1e-6)])
                    way = (fine[2] - fine[0]) / 2e-6
                    turned = fine[1, :, 0] * way[:, 1] - fine[1, :, 1] * way[:, 0]
                    areas[region.kind] += 0.25 * detail * float(weights @ turned)
    assert areas["lens"] == pytest.approx(lens, rel=1e-9)
    assert areas["lens"] + areas["land"] == pytest.approx(0.25, rel=1e-9)


@pytest.mark.slow
def test_a_rim_with_a_throat_narrower_than_the_first_grid_stays_one_and_one_that_crosses_itself_is_refused():
    zone = 0.25 * np.array([(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)])

    def rim(function):
        return fitted_rim(
            Gap(lambda x, y: (np.zeros(len(x)), np.zeros((len(x), 2))), function), zone, "land", 5e-11
        )

    def throat(x, y):  # 0.006 wide
        return x**3 - y**2 + 1e-5, np.stack([3.0 * x**2, -2.0 * y], 1)

    def saddle(level):
        return lambda x, y: (x**2 - 0.7 * y**2 + level, np.stack([2.0 * x, -1.4 * y], 1))

    kinds = sorted(region.kind for region in rim(throat).pattern.regions)
    assert kinds == ["land", "lens"]
    with pytest.raises(CannotBuild, match="CL132: .*a little more or less thickness"):
        rim(saddle(0.0))
    assert rim(saddle(1e-4)).error < 1e-10  # the way out


def test_a_bump_between_the_points_of_the_first_grid_is_found():
    # a radius of 0.004 in a cell of 0.5
    zone = 0.25 * np.array([(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)])

    def bump(x, y):
        p, q = x - 0.0873, y + 0.0411
        return 0.004**2 - p**2 - q**2, np.stack([-2.0 * p, -2.0 * q], 1)

    rim = fitted_rim(Gap(lambda x, y: (np.zeros(len(x)), np.zeros((len(x), 2))), bump), zone, "land", 5e-11)
    assert sorted(region.kind for region in rim.pattern.regions) == ["land", "lens"]
    points = np.concatenate([arc.at(np.linspace(0.0, 1.0, 9))[:, :2] for arc in rim.arcs[0]])
    assert np.abs(np.hypot(*(points - [0.0873, -0.0411]).T) - 0.004).max() < 1e-10


# -- solids ------------------------------------------------------------------------------------------


def cap(surface, thickness, half_pitch, floor):
    """Volume within |x|, |y| < half_pitch of a biconic of half thickness T/2 above a floor, in polar coordinates."""
    nodes, weights = np.polynomial.legendre.leggauss(40)

    def reach(angle):
        """The rim from the centre, by the closed form r² = 2h/q − k h²/q², and the cell's border."""
        c, d = np.cos(angle), np.sin(angle)
        q = surface.curvature_x * c * c + surface.curvature_y * d * d
        k = (1.0 + surface.conic_x) * (surface.curvature_x * c) ** 2 + (1.0 + surface.conic_y) * (
            surface.curvature_y * d
        ) ** 2
        return np.sqrt(2.0 * high / q - k * (high / q) ** 2), half_pitch / np.maximum(np.abs(c), np.abs(d))

    high = 0.5 * thickness - floor
    grid = np.linspace(0.0, 0.5 * np.pi, 2001)
    rim, wall = reach(grid)
    turns = np.flatnonzero(np.diff(np.sign(rim - wall)))
    cuts = [brentq(lambda a: float(np.subtract(*reach(a))), grid[i], grid[i + 1], xtol=1e-15) for i in turns]
    stops = sorted([0.0, 0.25 * np.pi, 0.5 * np.pi, *cuts])
    total = 0.0
    for low, last in zip(stops[:-1], stops[1:]):
        angle = low + 0.5 * (last - low) * (nodes + 1.0)
        end = np.minimum(*reach(angle))
        r = 0.5 * end[:, None] * (nodes + 1.0)
        above = high - np.abs(sag(surface, r * np.cos(angle)[:, None], r * np.sin(angle)[:, None]))
        total += 0.5 * (last - low) * float(weights @ (0.5 * end * ((r * above) @ weights)))
    return 4.0 * total


@pytest.mark.daily_cases("0.004-0.0")
@pytest.mark.parametrize(("thickness", "web"), [(0.004, 0.0), (0.02, 0.0), (0.03, 0.012)])
def test_a_rimmed_biconic_has_the_volume_of_the_true_surface(thickness, web):
    sheet = window(lattice__count=[1, 1], pair__thickness=thickness, pair__web=web)
    for body in sheet.bodies[thickness > 0.02 :]:
        solids, _ = built(sheet, body)
        assert [is_valid(solid) for solid in solids] == [True]
        expected = 2.0 * cap(body.front.surface, thickness, 0.25, 0.5 * web) + 0.25 * web
        # heights within 5e-11 of a lens 0.004 thick
        assert volume_and_area(solids[0])[0] == pytest.approx(expected, rel=3e-9)


RIMMED = {
    "islands": {"pair__thickness": 0.004},
    "cut corners": {"pair__thickness": 0.02},
    "sunk in a web": {"pair__thickness": 0.06, "pair__web": 0.03, "law__euler": [20.0, 3.0, 0.0]},
    "seam": {"pair__thickness": 0.03, "pair__web": 0.02, "lattice__seam": 0.06, "law__euler": [20.0, 1.0, 0.0]},
    "hexagons": {
        "pair__thickness": 0.03, "pair__web": 0.02, "lattice__kind": "hexagonal", "law__euler": [20.0, 1.0, 0.0],
    },
    "border": {"pair__thickness": 0.03, "pair__web": 0.02, "body__border": 0.2, "law__euler": [20.0, 1.0, 0.0]},
    "plano": {"pair__form": "plano", "pair__thickness": 0.015, "pair__curved": "inside"},
    "plano ellipsoid": {"pair__form": "plano", "pair__surface": "ellipsoid", "pair__thickness": 0.002},
}  # fmt: skip
QUICK = ("sunk in a web", "plano")


def check_step(name, path):
    sheet = window(**RIMMED[name])
    total = 0.0
    for body in sheet.bodies:
        solids, _ = built(sheet, body)
        assert len(solids) == body_facts(sheet, body).pieces
        assert all(is_valid(solid) for solid in solids)
        total += sum(volume_and_area(solid)[0] for solid in solids)
    for mode in ("fused", "instanced"):
        written = write_step(sheet, path, mode)
        found = read_step(path, sheet)
        assert found["valid"]
        assert (found["kernel_solids"], found["kernel_faces"]) == (written["solids"], written["faces"])
        assert found["tolerance"] <= 3e-7
        assert found["lens_error"] <= 5.1e-11
        assert written["rim_error"] <= 5.1e-11
        assert found["volume"] == pytest.approx(total, rel=1e-9)
        assert found["open_edges"] == found["dangling"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_rimmed_forms_are_valid_solids_in_memory_and_as_step_files_read_again(name, tmp_path):
    check_step(name, tmp_path / "x.step")


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(set(RIMMED) - set(QUICK)))
def test_more_rimmed_forms_are_valid_solids_in_memory_and_as_step_files_read_again(name, tmp_path):
    check_step(name, tmp_path / "x.step")


def test_a_plano_lens_that_ends_on_its_plane_is_an_ellipsoid_cap_on_a_plane_face():
    sheet = window(
        pair__form="plano", pair__surface="ellipsoid", pair__thickness=0.002, lattice__count=[1, 1]
    )
    for body, face in zip(sheet.bodies, (sheet.bodies[0].front, sheet.bodies[1].back)):
        solids, counts = built(sheet, body)
        assert dict(counts.faces) == {"lens": 1, "plane": 1}
        s = face.surface
        a, b, c, h = (
            1.0 / np.sqrt(s.kappa * s.curvature_x),
            1.0 / np.sqrt(s.kappa * s.curvature_y),
            1.0 / s.kappa,
            0.002,
        )
        assert volume_and_area(solids[0])[0] == pytest.approx(
            np.pi * a * b * h * h * (3.0 * c - h) / (3.0 * c * c), rel=1e-12
        )


def test_two_quadrics_that_meet_in_no_plane_share_a_fitted_rim():
    sheet = biconvex(thickness=0.03, count=(2, 1), euler=(20.0, 1.0, 0.0))
    bodies = []
    for body in sheet.bodies:
        s = body.back.surface
        flatter = clacad.Quadric(0.6 * s.curvature_x, 1.1 * s.curvature_y, s.kappa, s.side)
        bodies.append(replace(body, back=replace(body.back, surface=flatter)))
    sheet = replace(sheet, bodies=tuple(bodies))
    for body in sheet.bodies:
        solids, _ = built(sheet, body)
        assert len(solids) == body_facts(sheet, body).pieces
        assert all(is_valid(solid) for solid in solids)
        front, back = cells(sheet, body)
        assert 0.0 < front.rim_error <= 5e-11
        for arc in (arc for chain in front.rims for arc in chain):
            points = arc.at(np.linspace(0.0, 1.0, 9))
            for face in (body.front, body.back):  # the implicit equation of each quadric
                p, s = (points - face.vertex) @ face.rotation, face.surface
                off = s.curvature_x * p[:, 0] ** 2 + s.curvature_y * p[:, 1] ** 2 + s.kappa * p[:, 2] ** 2
                assert np.abs(0.5 * (off - 2.0 * s.side * p[:, 2])).max() <= 5e-11


@pytest.mark.slow
def test_the_mesh_of_a_rimmed_biconic_is_closed_and_converges_to_the_solid():
    import trimesh

    sheet = one_body(
        window(pair__thickness=0.03, pair__web=0.02, law__euler=[20.0, 1.0, 0.0], lattice__count=[1, 1]), 0
    )
    exact = sum(volume_and_area(solid)[0] for body in sheet.bodies for solid in built(sheet, body)[0])
    errors = []
    for quads in (6, 18):
        mesh = tessellate(sheet, quads=quads)
        errors.append(abs(sum(body.volume() for body in mesh.bodies) / exact - 1.0))
        if quads == 6:
            for body in mesh.bodies:
                assert trimesh.Trimesh(body.vertices, body.triangles).is_watertight
    assert errors[1] < 0.2 * errors[0]
    assert errors[1] < 2e-3


def test_light_meets_the_lens_inside_the_solids_rim_and_none_outside():
    sheet = window(pair__thickness=0.004, lattice__count=[1, 1])
    front, _ = cells(sheet, sheet.bodies[0])
    rim = np.concatenate([arc.at(np.array([0.2, 0.7]))[:, :2] for chain in front.rims for arc in chain])
    for share, lens in ((1.0 - 1e-6, True), (1.0 + 1e-6, False)):
        position = np.column_stack([share * rim, np.full(len(rim), -1.0)])
        light = clacad.trace(sheet, clacad.Rays(position, np.tile([0.0, 0.0, 1.0], (len(rim), 1))))
        # outside it flies on through the holes of both arrays; inside the pair returns it all but parallel
        assert ((light.direction[:, :2] != 0.0).any(axis=1) == lens).all()


@pytest.mark.long
def test_an_export_states_the_errors_of_fitted_faces_and_rims(tmp_path):
    wanted = design(pair__thickness=0.012, pair__web=0.008, lattice__count=[1, 1])
    (step,) = export(wanted, tmp_path / "x", ("step",)).files
    assert step["checks"] == ["closed", "shape", "placement", "volume"]
    assert 0.0 < step["rim_error"] <= 5e-11
    assert 0.0 < step["fit_error"] <= 5e-11


# -- the web of a tilted lens ------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("surface", "tilt"), [("ellipsoid", 1.0), ("biconic", 15.0)])
def test_the_web_that_a_refusal_names_holds_the_rim_and_less_leaves_an_overhang(surface, tilt):
    changes = {
        "pair__surface": surface,
        "pair__thickness": 0.02,
        "law__euler": [20.0, tilt, 0.0],
        "lattice__count": [1, 1],
    }
    sheet = window(**changes, pair__web=2e-4)
    with pytest.raises(CannotBuild, match="CL131") as caught:
        built(sheet, sheet.bodies[0])
    named = float(str(caught.value).split("at least ")[1].split(" mm")[0])
    thin = window(**changes, pair__web=0.9 * named).bodies[0]
    # somewhere on the vertical line over a point just inside the rim, air lies between plate and lens.
    x, y = (g.ravel() for g in np.meshgrid(*[np.linspace(-0.2499, 0.2499, 100)] * 2))
    front, back = (clacad.sheet.window.lens_height(face, x, y) for face in (thin.front, thin.back))
    overhangs = (front <= back) & ((front > thin.back.land) | (back < thin.front.land))
    assert overhangs.any()
    held = window(**changes, pair__web=named)
    front, back = (
        clacad.sheet.window.lens_height(face, x, y) for face in (held.bodies[0].front, held.bodies[0].back)
    )
    assert not (
        (front <= back) & ((front > held.bodies[0].back.land) | (back < held.bodies[0].front.land))
    ).any()
    for body in held.bodies:
        solids, _ = built(held, body)
        assert [is_valid(solid) for solid in solids] == [True]


@pytest.mark.slow
def test_more_thickness_is_the_other_way_out_of_a_web_that_a_rim_leaves():
    sheet = window(law__euler=[20.0, 8.0, 0.0], pair__web=2e-4, pair__thickness="auto")
    for body in sheet.bodies:
        solids, _ = built(sheet, body)
        assert [is_valid(solid) for solid in solids] == [True]


def test_a_lens_too_thin_for_its_tilt_is_said_to_be_buried_and_is_a_bare_plate_in_that_web():
    changes = {"pair__surface": "ellipsoid", "pair__thickness": 0.004, "law__euler": [20.0, 8.0, 0.0]}
    sheet = window(**changes, pair__web=2e-4, lattice__count=[1, 1])
    with pytest.raises(CannotBuild, match="holds it, and buries it") as caught:
        built(sheet, sheet.bodies[0])
    named = float(str(caught.value).split("at least ")[1].split(" mm")[0])
    held = window(**changes, pair__web=named, lattice__count=[1, 1])
    solids, counts = built(held, held.bodies[0])
    # beyond the lens's own rim its surface leaves the plate again, which is no lens
    assert dict(counts.faces) == {"land": 2, "side": 4}
    assert volume_and_area(solids[0])[0] == pytest.approx(0.25 * named, rel=1e-12)


def test_the_turn_of_the_test_windows_is_the_designs_own():
    assert np.allclose(turn(20.0, 3.0, 10.0), window(law__euler=[20.0, 3.0, 10.0]).bodies[0].front.rotation)
