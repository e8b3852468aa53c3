"""STEP and BREP files as other programs write them: units, assemblies, placements, fitted faces; light decides."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import clacad
from clacad.checks.file_kinds import THROUGH_FILE
from clacad.formats.step.step_files import read_step, write_step
from clacad.formats.step.text_health import patch_points, scan_step
from clacad.judging.delivery import Inspection
from clacad.judging.step_file import judge_solid
from clacad.judging.step_light import FACE_RAYS
from clacad.solid.occ_writer import box

IDS = tuple(kind.id for kind in THROUGH_FILE)

DESIGNS = Path(__file__).parents[2] / "designs"
UNITS = {"MM": 1.0, "INCH": 25.4, "M": 1000.0}


def design_of(name, cells):
    return clacad.load(str(DESIGNS / f"{name}.toml")).with_cells(cells)


ONE = ("slab", (4, 3))
TWO = ("paper-a-covered", (4, 3))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """One file of each form, written once."""
    folder = tmp_path_factory.mktemp("written")
    made = {}
    for key, (name, cells) in {"one": ONE, "two": TWO}.items():
        design = design_of(name, cells)
        window = clacad.prescribe(design)
        for mode in ("fused", "instanced"):
            path = folder / f"{key}-{mode}.step"
            write_step(window, path, mode=mode)
            made[key, mode] = path
        made[key] = (design, window)
    return made


def judged(design, window, path, stated=None, rays=FACE_RAYS):
    asked = Inspection(design, Path(path).name, rays, stated=stated or {})
    checks, facts = judge_solid(asked, window, Path(path))
    return {check.id: check for check in checks}, facts


def good(checks):
    return [
        f"{c.id}: {c.sentence}"
        for c in checks.values()
        if c.state == "fail" or (c.state == "not run" and c.required)
    ]


# -- another program ----------------------------------------------------------------------------------


def occ_shape(path):
    from clacad.formats.step.read_back import occ_shape

    return occ_shape(path)


def solids(shape):
    from OCP.TopAbs import TopAbs_SOLID
    from OCP.TopExp import TopExp_Explorer

    explorer, found = TopExp_Explorer(shape, TopAbs_SOLID), []
    while explorer.More():
        found.append(explorer.Current())
        explorer.Next()
    return found


def compound(shapes):
    from OCP.BRep import BRep_Builder
    from OCP.TopoDS import TopoDS_Compound

    builder, whole = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(whole)
    for shape in shapes:
        builder.Add(whole, shape)
    return whole


def moved(shape, x=0.0, y=0.0, z=0.0, factor=None, turn=0.0):
    from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
    from OCP.gp import gp_Ax1, gp_Dir, gp_Pnt, gp_Trsf, gp_Vec
    from OCP.TopLoc import TopLoc_Location

    trsf = gp_Trsf()
    if factor is not None:
        trsf.SetScale(gp_Pnt(0, 0, 0), factor)
        return BRepBuilderAPI_Transform(shape, trsf, True).Shape()
    if turn:
        trsf.SetRotation(gp_Ax1(gp_Pnt(0, 0, 0), gp_Dir(0, 0, 1)), turn)
    else:
        trsf.SetTranslation(gp_Vec(x, y, z))
    return shape.Moved(TopLoc_Location(trsf))


def written_by_another(shape, path, unit="MM", assembly=False):
    """The kernel's own writer, as many programs use it."""
    from OCP.Interface import Interface_Static
    from OCP.STEPControl import STEPControl_AsIs, STEPControl_Writer

    writer = STEPControl_Writer()
    Interface_Static.SetCVal_s("write.step.unit", unit)
    Interface_Static.SetIVal_s("write.step.assembly", 1 if assembly else 0)
    try:
        writer.Transfer(shape, STEPControl_AsIs)
        writer.Write(str(path))
    finally:
        Interface_Static.SetCVal_s("write.step.unit", "MM")
        Interface_Static.SetIVal_s("write.step.assembly", 0)
    return path


def levels(shape):
    """The same solids, each moved in its own frame and put back two levels up."""
    parts = solids(shape)
    inner = [compound([moved(part, x=3.0, z=-2.0)]) for part in parts]
    return compound([compound([moved(one, x=-3.0, z=2.0) for one in inner])])


STRUCTURES = ("flat", "assembly", "levels", "instanced")
OFTEN = {
    ("MM", "one", "flat"), ("INCH", "two", "flat"), ("M", "two", "assembly"), ("INCH", "one", "assembly"),
    ("MM", "two", "levels"), ("M", "one", "levels"), ("INCH", "two", "instanced"), ("M", "one", "instanced"),
}  # fmt: skip
EVERY = [
    pytest.param(*case, marks=[] if case in OFTEN else pytest.mark.long)
    for case in ((unit, bodies, how) for unit in UNITS for bodies in ("one", "two") for how in STRUCTURES)
]


@pytest.mark.ci_cases("MM-two-levels", "INCH-one-assembly", "M-one-instanced")
@pytest.mark.slow
@pytest.mark.parametrize(("unit", "bodies", "structure"), EVERY)
def test_a_good_part_written_again_passes_as_an_optical_master_in_any_unit_and_structure(
    written, tmp_path, unit, bodies, structure
):
    design, window = written[bodies]
    mode = "instanced" if structure == "instanced" else "fused"
    shape = occ_shape(written[bodies, mode])
    shape = levels(shape) if structure == "levels" else shape
    path = written_by_another(shape, tmp_path / "x.step", unit, structure != "flat")
    assert scan_step(path).units == (pytest.approx(UNITS[unit]),)
    checks, facts = judged(design, window, path)
    assert good(checks) == []
    assert {checks[name].state for name in IDS} == {"pass"}
    assert checks["placement"].state == "pass"
    assert facts["patch_error"] <= 1e-8 * min(window.lattice.pitch) * window.unit * 1e3
    assert facts["placement"]["instances"] == (12 * len(window.bodies) if structure == "instanced" else 0)


@pytest.mark.ci_cases("one-instanced", "two-fused")
@pytest.mark.slow
@pytest.mark.parametrize("mode", ["fused", "instanced"])
@pytest.mark.parametrize("bodies", ["one", "two"])
def test_a_kernel_s_own_file_gets_the_same_rows(written, tmp_path, bodies, mode):
    from OCP.BRepTools import BRepTools

    design, window = written[bodies]
    path = tmp_path / "x.brep"
    BRepTools.Write_s(occ_shape(written[bodies, mode]), str(path))
    checks, facts = judged(design, window, path)
    assert good(checks) == []
    assert {checks[name].state for name in (*IDS, "placement")} == {"pass"}
    assert facts["placement"]["instances"] == (0 if mode == "fused" else 12 * len(window.bodies))


@pytest.mark.ci_cases("MM-flat", "INCH-assembly")
@pytest.mark.slow
@pytest.mark.parametrize("structure", ["flat", "assembly"])
@pytest.mark.parametrize("unit", ["MM", "INCH"])
def test_a_part_a_thousandth_too_small_fails(written, tmp_path, unit, structure):
    design, window = written["two"]
    shape = compound([moved(s, factor=0.999) for s in solids(occ_shape(written["two", "fused"]))])
    checks, _ = judged(
        design, window, written_by_another(shape, tmp_path / "x.step", unit, structure != "flat")
    )
    assert checks["shape"].state == "fail"


@pytest.mark.slow
def test_lenses_whose_radius_is_off_by_a_hundredth_fail(tmp_path):
    design = design_of(*ONE)
    window = clacad.prescribe(design)
    front = window.bodies[0].front
    curved = replace(
        front.surface,
        curvature_x=front.surface.curvature_x / 1.01,
        curvature_y=front.surface.curvature_y / 1.01,
    )
    body = replace(window.bodies[0], front=replace(front, surface=curved))
    write_step(replace(window, bodies=(body,)), tmp_path / "x.step")
    checks, _ = judged(design, window, tmp_path / "x.step")
    assert checks["shape"].state == "fail"
    assert checks["faithful_rms"].state == "fail"
    assert checks["file_law_eta"].value == pytest.approx(0.01, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(("axis", "unit"), [("x", "MM"), ("z", "INCH"), ("z", "M")])
def test_one_body_moved_by_a_two_hundredth_of_the_separation_fails(written, tmp_path, unit, axis):
    design, window = written["two"]
    far = 0.005 * window.thin.separation * window.unit * 1e3
    first, second = solids(occ_shape(written["two", "fused"]))
    path = written_by_another(
        compound([first, moved(second, **{axis: far})]), tmp_path / "x.step", unit, True
    )
    checks, _ = judged(design, window, path)
    assert checks["shape"].state == "fail"
    if axis == "z":  # confocality measures how far array 2 is from where it should be along the normal
        shift = np.abs(checks["file_confocality"].detail["shift"])
        assert shift == pytest.approx([0.005, 0.005], rel=0.05)
        assert checks["file_confocality"].state == "fail"
    else:  # a thin lens aside by d turns light by d / f
        found = checks["file_law_delta"].detail
        turned = (np.array(found["measured"]) - found["exact"])[0] * window.thin.focal_length[0][0]
        assert abs(turned) == pytest.approx(0.005 * window.thin.separation, rel=0.1)


# -- placements ---------------------------------------------------------------------------------------


def shifted_use(path, target, name, by):
    """One usage of a row or run of cells moved along x, by editing the text."""
    text = path.read_text()
    use = re.search(rf"#(\d+)=NEXT_ASSEMBLY_USAGE_OCCURRENCE\('[^']*{name}'", text)
    shape = re.search(rf"#(\d+)=PRODUCT_DEFINITION_SHAPE\('','',#{use[1]}\)", text)[1]
    relation = re.search(rf"CONTEXT_DEPENDENT_SHAPE_REPRESENTATION\(#(\d+),#{shape}\)", text)[1]
    move = re.search(rf"#{relation}=.*WITH_TRANSFORMATION\(#(\d+)\)", text)[1]
    spot = re.search(rf"#{move}=ITEM_DEFINED_TRANSFORMATION\('','',#\d+,#(\d+)\)", text)[1]
    point = re.search(rf"#{spot}=AXIS2_PLACEMENT_3D\('',#(\d+),", text)[1]
    where = re.search(rf"#{point}=CARTESIAN_POINT\('',\(([^,]*),", text)
    assert len(re.findall(rf"#{point}[,)]", text)) == 1
    target.write_text(text[: where.start(1)] + repr(float(where[1]) + by) + text[where.end(1) :])


@pytest.mark.slow
@pytest.mark.parametrize("part", [0.04, 1e-3, 1e-6])
def test_one_row_of_instances_off_the_lattice_is_named_with_its_cell_and_distance(tmp_path, part):
    design = design_of("slab", (2, 150))
    window = clacad.prescribe(design)
    pitch = window.lattice.pitch[0] * window.unit * 1e3
    write_step(window, tmp_path / "good.step", mode="instanced")
    stated = {"solids": 300}
    checks, _ = judged(design, window, tmp_path / "good.step", stated)
    assert checks["placement"].state == "pass"
    assert good(checks) == []
    shifted_use(tmp_path / "good.step", tmp_path / "bad.step", "row 60", part * pitch)
    checks, facts = judged(design, window, tmp_path / "bad.step", stated)
    found = checks["placement"]
    assert found.state == "fail"
    assert found.value == pytest.approx(part * pitch, rel=1e-6)
    assert facts["placement"]["moved"] == 2 * len({0, 1})
    assert facts["placement"]["lattice_cell"][1] == 59
    assert "60" not in found.sentence.split("cell")[0]


CONCAVE = [
    [-1.3, -1.3],
    [1.3, -1.3],
    [1.3, 1.3],
    [0.4, 1.3],
    [0.4, 0.1],
    [-0.2, 0.1],
    [-0.2, 1.3],
    [-1.3, 1.3],
]
"""Boundary of a U: its upper rows have two runs of cells."""


@pytest.mark.slow
@pytest.mark.parametrize("outline", [{"circle": 2.4}, {"polygon": CONCAVE}], ids=lambda one: next(iter(one)))
def test_rows_of_several_lengths_are_runs_of_cells_and_one_run_aside_is_found(tmp_path, outline):
    keys = {
        "lattice.count": [24, 24],
        "lattice.pitch": 0.1,
        "lattice.outline": outline,
        "body.outline": {"circle": 4.2},
    }
    design = clacad.load(str(DESIGNS / "window-100mm.toml")).replace(keys | {"check.process": "none"})
    window = clacad.prescribe(design)
    write_step(window, tmp_path / "good.step", mode="instanced")
    uses = (tmp_path / "good.step").read_text().count("NEXT_ASSEMBLY_USAGE_OCCURRENCE")
    assert uses < 0.5 * window.lattice.cell_count * len(window.bodies)
    extents = [np.array(box(solid)) for solid in solids(occ_shape(tmp_path / "good.step"))]
    middles = [(low + high)[:2] for low, high in extents if np.all((high - low)[:2] < 0.2)]
    lattice = window.lattice.centres(window.lattice.cells())
    per_body = len(middles) // len(lattice)
    assert len(middles) == per_body * len(lattice) > 0
    found = np.unique(np.round(0.5 * np.array(middles), 6), axis=0)
    assert found == pytest.approx(np.unique(np.round(lattice, 6), axis=0), abs=1e-6)
    checks, _ = judged(design, window, tmp_path / "good.step")
    assert good(checks) == []
    shifted_use(tmp_path / "good.step", tmp_path / "bad.step", "half 2", 1e-4)
    checks, _ = judged(design, window, tmp_path / "bad.step")
    assert checks["placement"].state == "fail"
    assert checks["placement"].value == pytest.approx(1e-4, rel=1e-6)


@pytest.mark.slow
def test_a_cell_left_out_and_a_cell_put_twice_are_named(written, tmp_path):
    design, window = written["one"]
    text = written["one", "instanced"].read_text()
    use = re.search(r"#\d+=NEXT_ASSEMBLY_USAGE_OCCURRENCE\('[^']*row 2'.*\n", text)[0]
    (tmp_path / "less.step").write_text(text.replace(use, ""))
    checks, facts = judged(design, window, tmp_path / "less.step")
    assert checks["placement"].state == "fail"
    assert facts["placement"]["missing"] == 2 * 4
    assert facts["placement"]["missing_cell"][2] == 1
    pitch = window.lattice.pitch[1] * window.unit * 1e3
    shape = occ_shape(written["one", "instanced"])
    first = solids(shape)[0]
    twice = compound([shape, first, moved(first, y=0.0)])
    checks, facts = judged(design, window, written_by_another(twice, tmp_path / "more.step", "MM", True))
    assert pitch > 0
    assert checks["placement"].state == "fail"
    assert facts["placement"]["doubled"] > 0


def test_mapped_items_and_turned_parts_are_placed(tmp_path):
    """Placements of the text against the kernel's own, for a part turned about its normal in an assembly of inches."""
    design = design_of("slab", (2, 2))
    window = clacad.prescribe(design)
    write_step(window, tmp_path / "x.step", mode="fused")
    part = occ_shape(tmp_path / "x.step")
    parts = compound([moved(moved(part, turn=0.3), x=5.0 * k, y=1.0, z=2.0) for k in range(3)])
    path = written_by_another(compound([moved(parts, turn=-1.1)]), tmp_path / "y.step", "INCH", True)
    scan = scan_step(path)
    from clacad.formats.placements import applied

    lenses = patch_points(scan)
    ours = np.concatenate([
        applied(one.placements.all(), lenses.of_part(k).place[None]).reshape(-1, 3) for k, one in enumerate(scan.parts)
    ])  # fmt: skip
    assert len(ours) == 3 * 8 * 9
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeVertex
    from OCP.BRepExtrema import BRepExtrema_DistShapeShape
    from OCP.gp import gp_Pnt

    read = occ_shape(path)
    for point in ours[:: len(ours) // 12]:
        vertex = BRepBuilderAPI_MakeVertex(gp_Pnt(*point.tolist())).Vertex()
        assert BRepExtrema_DistShapeShape(vertex, read).Value() < 1e-6


# -- fitted again -------------------------------------------------------------------------------------


def fitted(shape, closeness):
    """A shape whose rational faces a kernel fitted again by polynomial splines of several spans, so closely (mm)."""
    from OCP.GeomAbs import GeomAbs_C1
    from OCP.ShapeCustom import ShapeCustom, ShapeCustom_RestrictionParameters

    rules = ShapeCustom_RestrictionParameters()
    return ShapeCustom.BSplineRestriction_s(
        shape, closeness, 1e-7, 5, 60, GeomAbs_C1, GeomAbs_C1, True, True, rules
    )


def rippled(shape, height):
    """Poles inside every lens face lifted and lowered by turns (mm), its border left alone."""
    from OCP.BRep import BRep_Tool
    from OCP.Geom import Geom_BSplineSurface
    from OCP.gp import gp_Pnt
    from OCP.TopAbs import TopAbs_FACE

    from clacad.solid.occ_writer import explored

    for face in explored(shape, TopAbs_FACE):
        surface = BRep_Tool.Surface_s(face)
        if not isinstance(surface, Geom_BSplineSurface) or min(surface.UDegree(), surface.VDegree()) < 2:
            continue
        for i in range(2, surface.NbUPoles()):
            for j in range(2, surface.NbVPoles()):
                pole = surface.Pole(i, j)
                surface.SetPole(i, j, gp_Pnt(pole.X(), pole.Y(), pole.Z() + height * (-1) ** i))
    return shape


@pytest.mark.slow
@pytest.mark.parametrize("bodies", ["one", "two"])
def test_lens_faces_that_another_program_fitted_closely_pass_by_their_light(written, tmp_path, bodies):
    design, window = written[bodies]
    pitch = min(window.lattice.pitch) * window.unit * 1e3
    shape = fitted(occ_shape(written[bodies, "fused"]), 1e-6 * pitch)
    checks, facts = judged(design, window, written_by_another(shape, tmp_path / "x.step"))
    assert facts["patches"] == 0 or facts["uneven"] or facts["patch_error"] > 1e-12 * pitch
    assert good(checks) == []
    assert {checks[name].state for name in (*IDS, "placement")} == {"pass"}


@pytest.mark.slow
def test_lens_faces_that_another_program_fitted_badly_fail(written, tmp_path):
    design, window = written["one"]
    pitch = min(window.lattice.pitch) * window.unit * 1e3
    shape = rippled(fitted(occ_shape(written["one", "fused"]), 1e-6 * pitch), 0.01 * pitch)
    checks, _ = judged(design, window, written_by_another(shape, tmp_path / "x.step"))
    assert checks["shape"].state == "fail"
    assert checks["faithful_rms"].state == "fail"
    assert "fail" in {
        checks[name].state for name in ("file_law_rms", "file_law_bias", "file_law_eta", "file_confocality")
    }


# -- files too large for a kernel ---------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("bodies", ["one", "two"])
def test_light_through_the_patches_of_the_text_goes_where_the_kernel_sends_it(
    written, tmp_path, monkeypatch, bodies
):
    from clacad.judging.step_light import FaceTracer
    from clacad.optics.rays import Fate
    from clacad.sheet.bundle import bundle
    from clacad.storage.worker import Worker

    design, window = written[bodies]
    path = str(written[bodies, "fused"])
    lit = bundle(window, 512, design.check.field)
    held = [body.name for body in window.bodies]
    with Worker() as worker:
        kernel, text = (FaceTracer(worker, path, window, held, how)(lit) for how in (True, False))
    alive = kernel.fate == Fate.ALIVE
    assert alive.sum() > 300
    assert np.array_equal(alive, text.fate == Fate.ALIVE)
    assert np.abs(kernel.direction[alive] - text.direction[alive]).max() < 1e-9


def test_what_a_file_holds_is_said(written):
    read = read_step(written["one", "instanced"])
    assert read["holds"]["prototypes"] == 1
    assert read["holds"]["parts"][0]["instances"] == read["holds"]["solids"] == 12


# -- measured parts -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_piece_with_a_drilled_hole_is_recognised_and_the_hole_is_named(tmp_path):
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeCylinder
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt

    from clacad.verification.run import verify

    design = clacad.load(str(DESIGNS / "slab.toml"))
    write_step(clacad.prescribe(design.with_cells((4, 4))), tmp_path / "x.step", mode="fused")
    drill = BRepPrimAPI_MakeCylinder(gp_Ax2(gp_Pnt(0.7, -0.3, -5), gp_Dir(0, 0, 1)), 0.15, 40).Shape()
    part = BRepAlgoAPI_Cut(occ_shape(tmp_path / "x.step"), drill).Shape()
    report = verify(design, written_by_another(part, tmp_path / "piece.step"), rays=2048)
    found = {check.id: check for check in report.checks if check.where == "file"}
    assert report.files[0].window.lattice.count == (4, 4)
    assert found["placement"].state == "pass"
    assert found["volume"].state == "fail"
    # centres of a sheet of 4 cells of 0.5 mm lie at ±0.25, ±0.75: the drill goes through column 3, row 1
    assert "0.3 mm across in cell (3, 1) at x 0.7, y -0.3" in found["volume"].sentence
    assert found["file_law_rms"].state == "pass"  # the middle cell is whole
