"""`solids` gives build123d objects that behave like any other part."""

from __future__ import annotations

import re
import tomllib

import mpmath as mp
import pytest
from brepwindows import biconvex, column_volume

from clacad.design import Design, template
from clacad.prescription.prescribe import prescribe
from clacad.solid.solids import solids


@pytest.fixture(scope="module")
def parts():
    return solids(biconvex(count=(3, 3), euler=(20.0, 2.0, 0.0)))


def test_there_is_one_labelled_solid_per_body_of_the_right_volume(parts):
    import build123d

    window = biconvex(count=(3, 3), euler=(20.0, 2.0, 0.0))
    assert [part.label for part in parts] == ["array1", "array2"]
    for part, body in zip(parts, window.bodies):
        assert isinstance(part, build123d.Solid)
        assert part.is_valid
        assert part.volume == pytest.approx(column_volume(window, body), rel=1e-9)


def test_a_solid_can_be_cut_and_moved_and_exported(parts, tmp_path):
    import build123d

    part = parts[0]
    bored = part - build123d.Cylinder(0.1, 5.0)
    removed = part & build123d.Cylinder(0.1, 5.0)
    assert bored.is_valid
    assert bored.volume + removed.volume == pytest.approx(part.volume, rel=1e-6)
    moved = build123d.Pos(1.0, 2.0, 3.0) * part
    assert moved.volume == pytest.approx(part.volume, rel=1e-12)
    assert build123d.export_step(part, str(tmp_path / "x.step"))


def test_another_cell_count_is_the_same_design_again():
    few = solids(biconvex(count=(5, 5)), cells=(2, 1))
    window = biconvex(count=(2, 1))
    assert few[0].volume == pytest.approx(column_volume(window, window.bodies[0]), rel=1e-9)


def test_a_body_of_loose_strips_is_a_compound():
    import build123d

    parts = solids(biconvex(thickness=0.05, count=(2, 3)))
    assert isinstance(parts[1], build123d.Compound)
    assert len(parts[1].solids()) == 3 or len(parts[1].solids()) == 2


@pytest.mark.slow
def test_a_volume_over_steep_conics_is_that_of_a_double_integral():
    """Plate 1 of the f/5 scanner: OCC's adaptive quadrature alone errs by 5e-9 there, and states 1e-12."""
    from clacad.solid.occ_writer import volume_and_area

    design = Design.from_dict(tomllib.loads(template("scanner", "scanner-f5"))).replace(
        "lattice.count", [1, 1]
    )
    front, back = design.pair.face[:2]
    half = mp.mpf(design.lattice.pitch[0]) / 2

    def under(face):
        c, k = 1 / mp.mpf(face.radius[0]), mp.mpf(face.conic[0])

        def sag(x, y):
            return c * (x * x + y * y) / (1 + mp.sqrt(1 - (1 + k) * c * c * (x * x + y * y)))

        return 4 * mp.quad(sag, [0, half], [0, half])

    exact = mp.mpf(back.z) * 4 * half * half + under(back) - under(front)
    found, _ = volume_and_area(solids(prescribe(design))[0].wrapped)
    assert found == pytest.approx(float(exact), rel=1e-12)


def test_faces_that_are_alike_are_integrated_once_and_a_spoilt_one_by_itself(tmp_path):
    """Volume and area of a sheet of equal lenses are OCC's own sums over all its faces."""
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    from clacad.formats.step.read_back import occ_shape
    from clacad.formats.step.step_files import write_step
    from clacad.solid.occ_writer import _alike, volume_and_area

    def measured(path):
        shape, volume, area = occ_shape(path), GProp_GProps(), GProp_GProps()
        BRepGProp.VolumeProperties_s(shape, volume, 1e-12)
        BRepGProp.SurfaceProperties_s(shape, area, 1e-12)
        assert volume_and_area(shape) == pytest.approx((volume.Mass(), area.Mass()), rel=1e-9)
        found = _alike(shape, 1e-11)
        return len(found), sum(many for _, many in found), volume_and_area(shape)[0]

    window = prescribe(Design.from_dict(tomllib.loads(template("slab"))).replace("lattice.count", [4, 4]))
    write_step(window, tmp_path / "whole.step", "fused")
    few, faces, volume = measured(tmp_path / "whole.step")
    assert (few, faces) == (2 + 16, 32 + 16)  # a lens of each face, and walls
    text = (tmp_path / "whole.step").read_text()
    patch = re.search(r"B_SPLINE_SURFACE\w*\((?:'',)?\d+,\d+,\(\([#\d,]+\),\(#\d+,#(\d+)", text)
    pole = re.search(rf"#{patch[1]}=CARTESIAN_POINT\('',\(([^,]+),([^,]+),([^)]+)\)\)", text)
    spoilt = pole[0].replace(pole[3], f"{float(pole[3]) + 1e-3:.17g}")
    (tmp_path / "spoilt.step").write_text(text.replace(pole[0], spoilt))
    few, faces, other = measured(tmp_path / "spoilt.step")
    assert (few, faces) == (3 + 16, 32 + 16)
    assert abs(other - volume) == pytest.approx(
        1e-3 * 0.5**2 / 7**2, rel=1e-6
    )  # a pole of 7 x 7 over .5 x .5 mm
