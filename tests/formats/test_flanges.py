"""Plates with an edge apart from that of their cells: a flange is π/4 (D² − d²) of land in solid, mesh, mask and light."""

from __future__ import annotations

from math import hypot, pi

import numpy as np
import pytest

from clacad.config.mistakes import DesignError
from clacad.design import Design
from clacad.formats.maps.mask import write_dxf
from clacad.formats.step.step_files import read_step, write_step
from clacad.mesh.tessellation import tessellate
from clacad.optics.rays import Fate, Rays
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import describe, feasibility
from clacad.sheet.plate import Plate
from clacad.sheet.volume_and_extent import body_volume, whole_extent
from clacad.tracing.trace import trace

BASE = {"format": 1, "name": "flange", "unit": "mm", "law": {"eta": [-0.5, -1.0]}}
SLAB = BASE | {"pair": {"form": "slab", "separation": 12, "index": 1.5}}
PLANO = BASE | {"pair": {"form": "plano", "separation": 12, "thickness": 1.5, "index": 1.5}}
BICONVEX = BASE | {
    "law": {"eta": [-1, -1]},
    "pair": {"form": "biconvex", "separation": 12, "thickness": 1, "index": 1.5},
}
ROUND = {"pitch": 1.0, "outline": {"circle": 6.5}}
OFF_AXIS = {"at": [[4.5, 0.0], [-3.2, 3.1]], "diameter": 0.8}


def window(base, lattice=None, **body):
    return prescribe(Design.from_dict(base | {"lattice": ROUND | (lattice or {}), "body": body}))


def mistakes(base, lattice=None, **body):
    with pytest.raises(DesignError) as error:
        prescribe(Design.from_dict(base | {"lattice": ROUND | (lattice or {}), "body": body}))
    return [(one.code, one.key) for one in error.value.mistakes]


def land_thickness(body):
    front, back = (face.vertex[2] if face.land is None else face.land for face in (body.front, body.back))
    return back - front


FORMS = [SLAB, pytest.param(PLANO, marks=pytest.mark.slow), pytest.param(BICONVEX, marks=pytest.mark.slow)]


@pytest.mark.ci_cases(
    "body0-53.40707511102649-base1",
    "body1-52.40176546187775-base2",
    "body3-76.2085202500476-base0",
    "body4-77.06692759645782-base1",
)
@pytest.mark.slow
@pytest.mark.parametrize("base", FORMS)
@pytest.mark.parametrize(("body", "added"), [
    pytest.param({"border": 2}, pi / 4 * (10.5**2 - 6.5**2), marks=pytest.mark.slow),
    ({"border": 2, "holes": [OFF_AXIS]}, pi / 4 * (10.5**2 - 6.5**2 - 2 * 0.8**2)),
    pytest.param({"outline": {"circle": 10.5}}, pi / 4 * (10.5**2 - 6.5**2), marks=pytest.mark.slow),
    ({"outline": {"rectangle": [10.5, 10.5]}, "corners": {"round": 1.0}}, 10.5**2 - (4 - pi) - pi / 4 * 6.5**2),
    pytest.param({"outline": {"polygon": [[-5.25, -5.25], [5.25, -5.25], [5.25, 5.25], [-5.25, 5.25]]}}, 10.5**2 - pi / 4 * 6.5**2, marks=pytest.mark.slow),
])  # fmt: skip
def test_a_plate_larger_than_its_round_sheet_adds_the_area_between_and_keeps_the_cells(
    tmp_path, base, body, added
):
    plain, plate = window(base), window(base, **body)
    assert plate.lattice.cell_count == plain.lattice.cell_count > 0
    assert np.allclose(whole_extent(plate)[:4], (-5.25, 5.25, -5.25, 5.25), rtol=0, atol=1e-12)
    wanted = sum(added * land_thickness(one) for one in plain.bodies)
    grown = sum(body_volume(plate, one).value for one in plate.bodies) - sum(
        body_volume(plain, one).value for one in plain.bodies
    )
    assert grown == pytest.approx(wanted, rel=1e-9)
    facts = []
    for name, one in (("plain", plain), ("plate", plate)):
        write_step(one, tmp_path / f"{name}.step", mode="fused")
        facts.append(read_step(tmp_path / f"{name}.step"))
    assert facts[1]["valid"]
    assert facts[1]["volume"] - facts[0]["volume"] == pytest.approx(wanted, rel=1e-7)
    assert np.allclose(np.abs(np.array(facts[1]["box"])[:, :2]), 5.25, rtol=0, atol=1e-5)


@pytest.mark.parametrize(("body", "size"), [
    ({"border": 2}, "10.5 round"), ({"border": 2, "holes": [OFF_AXIS]}, "10.5 round"), ({"outline": {"circle": 10.5}}, "10.5 round"),
    ({"outline": {"rectangle": [10.5, 10.5]}, "corners": {"round": 1.0}}, "10.5 x 10.5"),
])  # fmt: skip
def test_a_drilled_flange_is_reported_as_round(body, size):
    sheet = window(SLAB, **body)
    rows = {row.name: row.value for row in describe(sheet, feasibility(sheet)) if row.about == "sheet"}
    assert rows["outer size"] == size


@pytest.mark.parametrize("base", FORMS)
def test_triangles_of_a_flange_close_and_grow_by_the_ring_alone(base):
    trimesh = pytest.importorskip("trimesh")
    ring, grown = pi / 4 * (10.5**2 - 6.5**2), []
    for sheet in (window(base), window(base, border=2)):
        solids = []
        for one in tessellate(sheet, quads=3).bodies:
            corners = np.concatenate(list(one.rows())).reshape(-1, 3)
            solids.append(trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3)))
            assert solids[-1].is_watertight
        grown.append(sum(solid.volume for solid in solids))
    wanted = ring * sum(land_thickness(one) for one in sheet.bodies)
    assert grown[1] - grown[0] == pytest.approx(wanted, rel=1e-4)  # heights are whole steps of float32


def test_light_on_a_flange_is_land_and_off_it_and_in_its_holes_missed():
    sheet = window(SLAB, border=2, holes=[OFF_AXIS])
    assert isinstance(sheet.outline, Plate)
    rng = np.random.default_rng(5)
    points = rng.uniform(-5.6, 5.6, (2000, 2))
    held = sheet.lattice.centres(sheet.lattice.cells())

    def wanted(x, y):
        if hypot(x, y) > 5.25 or any(hypot(x - a, y - b) < 0.4 for a, b in OFF_AXIS["at"]):
            return Fate.MISSED
        return None if (np.abs(held - (x, y)) < 0.5).all(axis=1).any() else Fate.LAND

    rays = Rays(np.column_stack([points, np.full(len(points), -1.0)]), (0.0, 0.0, 1.0))
    asked = [wanted(*p) for p in points.tolist()]
    assert {None, Fate.LAND, Fate.MISSED} == set(asked)
    for found in (
        trace(sheet, rays, path="numpy"),
        trace(sheet, rays, path="numba"),
        trace(sheet, rays, rung="thin"),
    ):
        assert all(f == a for f, a in zip(found.fate, asked, strict=True) if a is not None)


def test_a_mask_ends_where_the_flange_does(tmp_path):
    ezdxf = pytest.importorskip("ezdxf")
    sheet = window(SLAB, border=2)
    write_dxf(sheet, sheet.bodies[0], sheet.bodies[0].front, "flange", tmp_path / "m.dxf", 1.0)
    rings = [e for e in ezdxf.readfile(tmp_path / "m.dxf").modelspace() if e.dxf.layer == "OUTLINE"]
    assert [e.dxf.radius for e in rings] == [5.25]


def test_what_cuts_a_cell_that_the_lattice_states_is_refused_by_its_key():
    assert mistakes(SLAB, border=2, holes=[{"diameter": 0.8, "at": [[2.0, 0.0]]}]) == [
        ("CL141", "body.holes")
    ]
    assert mistakes(SLAB, outline={"rectangle": [6, 6]}) == [("CL141", "body.outline")]
    assert mistakes(SLAB, {"outline": {"rectangle": [8, 8]}}, border=1, holes=[OFF_AXIS]) == [
        ("CL141", "body.holes")
    ]


def test_a_plate_has_one_edge():
    assert mistakes(SLAB, border=1, outline={"circle": 20}) == [("CL112", "body.border")]
    triangle = {"outline": {"polygon": [[-5, -4], [5, -4], [0, 5]]}, "count": 9}
    assert mistakes(SLAB, triangle, border=1) == [("CL114", "body.border")]
    assert mistakes(SLAB, outline={"polygon": [[0, 0], [9, 9], [9, 0], [0, 9]]}) == [
        ("CL141", "body.outline")
    ]
    assert mistakes(SLAB, outline={"circle": 20}, corners={"round": 1}) == [("CL114", "body.corners")]


def test_a_plate_apart_from_aimed_cells_is_built_and_refused_where_array_2_reaches_its_edge():
    aimed = {"aperture": {"point": [0, 0, -300]}}
    plate = window(PLANO, aimed, outline={"circle": 20})
    assert plate.outline.diameter == 20.0
    assert window(PLANO, aimed, border=2).outline.diameter == 10.5
    tight, cells = {"rectangle": [6.2, 6.2]}, {"outline": {"circle": 6.9}}  # arrays are 6 and 6.24 wide
    assert window(PLANO, cells, outline=tight).lattice.cell_count == 24
    assert mistakes(PLANO, aimed | cells, outline=tight) == [("CL141", "body.outline")]


@pytest.mark.daily_cases("instanced")
@pytest.mark.parametrize("mode", ["fused", "instanced"])
def test_cad_finds_round_holes_corners_and_edges_as_cylinders_of_their_radius_and_axis(tmp_path, mode):
    from OCP.BRepAdaptor import BRepAdaptor_Surface
    from OCP.GeomAbs import GeomAbs_Cylinder
    from OCP.STEPControl import STEPControl_Reader
    from OCP.TopAbs import TopAbs_FACE
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    flange = window(SLAB, border=2, holes=[OFF_AXIS])
    corners = window(SLAB, outline={"rectangle": [12, 10]}, corners={"round": 1.5})
    plain = window(SLAB, {"outline": {"circle": 9}})
    expected = (
        {(0.0, 0.0, 5.25), (4.5, 0.0, 0.4), (-3.2, 3.1, 0.4)},
        {(x, y, 1.5) for x in (-4.5, 4.5) for y in (-3.5, 3.5)},
        {(0.0, 0.0, 4.5)},
    )
    for sheet, wanted in zip((flange, corners, plain), expected, strict=True):
        write_step(sheet, tmp_path / "part.step", mode=mode)
        facts = read_step(tmp_path / "part.step")
        assert facts["valid"]
        exact = sum(body_volume(sheet, body).value for body in sheet.bodies)
        assert facts["volume"] == pytest.approx(exact, rel=1e-7)
        reader = STEPControl_Reader()
        reader.ReadFile(str(tmp_path / "part.step"))
        reader.TransferRoots()
        found, faces = set(), TopExp_Explorer(reader.OneShape(), TopAbs_FACE)
        while faces.More():
            surface = BRepAdaptor_Surface(TopoDS.Face(faces.Current()))
            if surface.GetType() == GeomAbs_Cylinder:
                cylinder = surface.Cylinder()
                at, way = cylinder.Axis().Location(), cylinder.Axis().Direction()
                assert abs(way.Z()) == 1.0
                found.add((round(at.X(), 9), round(at.Y(), 9), round(cylinder.Radius(), 9)))
            faces.Next()
        assert found == wanted


@pytest.mark.slow
def test_verify_finds_a_flange_of_the_wrong_diameter(tmp_path):
    from clacad.verification import verify

    keys = {"format": 1, "lattice": {"pitch": 1.0, "outline": {"circle": 6.5}}}
    asked, other = (Design.from_dict(SLAB | keys | {"body": {"border": b}}) for b in (2.0, 2.1))
    write_step(prescribe(other), tmp_path / "flange.step", mode="fused")
    failed = {
        one.id for one in verify(asked, tmp_path / "flange.step", rays=2000).checks if one.state == "fail"
    }
    assert failed & {"volume", "shape"}
