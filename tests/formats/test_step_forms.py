"""Every form the design file knows, written as STEP and read back: valid, exact volume, exact optical faces."""

from __future__ import annotations

from dataclasses import replace

import pytest
from meshwindows import window
from polar_volume import exact_volume

import clacad
from clacad.exporting.step_record import compare_step
from clacad.formats.step.step_files import read_step, write_step
from clacad.sheet.volume_and_extent import body_volume
from clacad.solid.solids import solids

FORMS = {
    "flat": {},
    "tilted": {"euler": (0.0, 2.0, 0.0)},
    "offset": {"delta": (0.02, -0.01), "euler": (10.0, 1.0, 0.0)},
    "turned by 45 degrees, a saddle at every corner": {"euler": (45.0, 0.0, 0.0)},
    "slab of two faces": {"form": "slab", "euler": (10.0, 0.3, 0.0), "border": 0.002},
    "biconvex with web and rim": {"thickness": 0.0006, "web": 0.0003, "euler": (5.0, 3.0, 0.0)},
    "plano": {"form": "plano", "euler": (20.0, 1.0, 0.0)},
    "plano, curved inside": {"form": "plano", "curved": "inside", "euler": (20.0, 0.5, 0.0)},
    "hexagonal": {"kind": "hexagonal", "euler": (30.0, 1.0, 0.0)},
    "seam": {"seam": 0.0004, "euler": (30.0, 1.0, 0.0)},
    "plano, seam": {"form": "plano", "seam": 0.0004, "euler": (30.0, 1.0, 0.0)},
    "Galilean": {"eta": (0.5, 0.5), "euler": (20.0, 1.0, 0.0)},
}


BARE = ("tilted", "turned by 45 degrees, a saddle at every corner", "plano")
CASES = [(name, True) for name in FORMS] + [(name, False) for name in BARE]


@pytest.mark.ci_cases(
    "turned by 45 degrees, a saddle at every corner",
    "slab of two faces",
    "biconvex with web and rim",
    "plano, curved inside",
    "hexagonal",
    "plano, seam",
)
@pytest.mark.daily_cases("Galilean")
@pytest.mark.parametrize(("name", "pcurves"), CASES, ids=[f"{n}{'' if c else ', bare'}" for n, c in CASES])
def test_every_form_reads_back_valid_with_its_integral_and_its_closed_form(tmp_path, name, pcurves):
    sheet = window(**{"count": (2, 2), **FORMS[name]})
    facts = write_step(sheet, tmp_path / "x.step", mode="fused", pcurves=pcurves)
    found = read_step(tmp_path / "x.step", sheet)
    scale = sheet.unit * 1e3
    pitch = min(sheet.lattice.pitch) * scale
    assert found["valid"]
    assert (found["kernel_solids"], found["kernel_faces"]) == (facts["solids"], facts["faces"])
    assert max(found["lens_error"], found["patch_error"]) <= 1e-9 * pitch
    assert found["tolerance"] <= 2e-7
    exact = sum(exact_volume(sheet, body) for body in sheet.bodies) * scale**3
    merged = facts["merged_steps"] * facts["merge"] * pitch * scale
    # without parameter curves the kernel integrates along edges it projected itself
    assert found["volume"] == pytest.approx(exact, rel=1e-10 if pcurves else 1e-8, abs=merged)


ISLANDS = {"seam": 4e-5, "web": 2e-5, "pitch": 5e-4}
WEAK = {"seam": 1.6e-6, "web": 8e-7, "pitch": 2e-5}


@pytest.mark.daily_cases("form3-20.0-False")
@pytest.mark.parametrize(("form", "tilt", "ruled"), [
    (ISLANDS, 1e-9, False),
    (ISLANDS, 2**0.5 * 1e-4, True),  # corners 1.2e-6 mm above the web: between once and twice the merge height
    (ISLANDS, 0.02, False),
    (ISLANDS, 20.0, False),
    (WEAK, 0.3, True),  # an arc that leaves the web at less than 2e-3
])  # fmt: skip
def test_walls_of_islands_are_planes_where_the_arc_leaves_the_web_steeply(tmp_path, form, tilt, ruled):
    pair = window(**form, count=(2, 2), euler=(33.0, tilt, 0.0))
    sheet = replace(pair, bodies=pair.bodies[1:])
    exact = exact_volume(sheet, sheet.bodies[0]) * (sheet.unit * 1e3) ** 3
    for pcurves in (True, False):
        facts = write_step(sheet, tmp_path / "x.step", mode="fused", pcurves=pcurves)
        assert ("B_SPLINE_SURFACE(2,1," in (tmp_path / "x.step").read_text()) == ruled
        found = read_step(tmp_path / "x.step", sheet)
        assert found["valid"]
        assert (found["kernel_solids"], found["kernel_faces"]) == (facts["solids"], facts["faces"])
        if pcurves:
            assert found["volume"] == pytest.approx(exact, rel=1e-10)
        integral = body_volume(sheet, sheet.bodies[0])  # what an export holds the file to, either way
        assert compare_step(facts, found, sheet, integral, "x.step") == (
            "closed",
            "shape",
            "placement",
            "volume",
        )


def test_solids_of_the_package_are_parts_like_any_other():
    import build123d as b

    sheet = window(count=(1, 1), euler=(20.0, 1.0, 0.0), border=0.002, web=0.0004)
    parts = clacad.solids(sheet)
    scale = sheet.unit * 1e3
    box = parts[0].bounding_box()
    half = 0.5 * sheet.outline.width * scale
    assert (box.min.X, box.max.X, box.min.Y, box.max.Y) == pytest.approx((-half, half, -half, half), abs=1e-6)
    drilled = parts[0] - b.Pos(0.9 * half, 0, 0) * b.Cylinder(0.02 * half, 10.0)
    assert drilled.is_valid
    assert drilled.volume < parts[0].volume
    both = b.Compound(children=parts)
    assert len(both.solids()) == 2
    edge = max(parts[0].edges().filter_by(b.Axis.Z), key=lambda e: e.center().X + e.center().Y)
    assert b.chamfer([edge], 0.1).is_valid
    assert [part.label for part in solids(sheet)] == ["array1", "array2"]
