"""Thickness "auto" where the cells of array 2 have a size of their own: each lens covers the cells of its own array."""

from __future__ import annotations

from math import hypot, sqrt

import pytest

from clacad.design import Design
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import feasibility
from clacad.sheet.window import lens_height
from clacad.verification import design_checks

WEB = 0.1
BICONVEX = {
    "format": 1, "name": "sharp", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "biconvex", "separation": 10.0, "material": "PMMA", "thickness": "auto", "web": WEB},
    "lattice": {"pitch": 0.5, "count": [9, 9]},
}  # fmt: skip
FOCUS = {"pair": BICONVEX["pair"] | {"focus": {"object": -300, "image": 400}}}
WIDER = {"lattice": BICONVEX["lattice"] | {"pitch_2": 0.52}}
NARROWER = {"lattice": BICONVEX["lattice"] | {"pitch_2": 0.48}}


@pytest.mark.daily_cases("narrower")
@pytest.mark.parametrize("change", [FOCUS, WIDER, NARROWER], ids=["focus", "wider", "narrower"])
def test_each_lens_is_as_thick_as_the_cells_of_its_own_array_ask(change):
    """Two equal spheres of radius R meet the web at the corner of a cell: T = web + 2 (R − √(R² − ρ²)), ρ = p_k/√2."""
    design = Design.from_dict(BICONVEX | change)
    window = prescribe(design)
    facts = feasibility(window)
    for array, lens in enumerate(facts.lenses[:2]):
        pitch = window.lattice_of(array).pitch
        rho, radius = hypot(0.5 * pitch[0], 0.5 * pitch[1]), lens.radius[0]
        assert lens.thickness == pytest.approx(WEB + 2.0 * (radius - sqrt(radius**2 - rho**2)), rel=1e-9)
        assert lens.corner == pytest.approx(WEB, rel=1e-9)
        assert lens.f_number[0] == pytest.approx(lens.focal_length[0] / pitch[0], rel=1e-6)
    assert window.lattice_of(1).pitch != window.lattice.pitch
    checks = [c for c in design_checks(design, window, facts) if c.id == "cover"]
    assert [c.state for c in checks] == ["pass", "pass"]


def test_cells_of_array_2_of_another_shape_are_covered_too():
    """Ratios differ in x and y, and each array has its own two pitches: the corner of each cell is as thick as the web."""
    law = {
        "law": {"eta": [-1.2, -0.8]},
        "lattice": {"kind": "rectangular", "pitch": [0.6, 0.4], "count": [5, 5]},
    }
    pair = BICONVEX["pair"] | {"separation": 6.0, "focus": {"object": -300, "image": 100}}
    design = Design.from_dict(BICONVEX | law | {"pair": pair})
    window = prescribe(design)
    facts = feasibility(window)
    scale = window.placements[1].scale(window.lattice)
    assert abs(scale[0] - scale[1]) > 0.005
    assert [lens.corner for lens in facts.lenses[:2]] == pytest.approx([WEB, WEB], rel=1e-9)
    checks = [c for c in design_checks(design, window, facts) if c.id == "cover"]
    assert [c.state for c in checks] == ["pass", "pass"]


@pytest.mark.parametrize("angle", [0, 3])
def test_outer_cells_of_a_sheet_aimed_at_a_near_point_are_covered_also_under_tilt(angle):
    """Vertices of lens 2 lie .28 from the middle of the outermost cells, and .52 aside under 3 degrees."""
    aim = {"lattice": BICONVEX["lattice"] | {"count": [12, 3], "aperture": {"point": [0, 0, -200]}}}
    design = Design.from_dict(BICONVEX | aim | {"law": {"eta": [-1, -1], "euler": [0, angle, 0]}})
    window = prescribe(design)
    body = window.bodies[1]
    for cell in window.lattice.cells():
        front, back = (window.in_cell(face, cell) for face in (body.front, body.back))
        x, y = (window.lattice_of(1).tile() * (1.0 - 1e-9)).T
        low, high = (lens_height(face, x, y) for face in (front, back))
        assert (high - low).min() > 0.95 * WEB


@pytest.mark.slow
def test_a_lens_that_is_too_thin_for_its_array_is_the_one_that_fails():
    made = prescribe(Design.from_dict(BICONVEX | WIDER))
    thick = [lens.thickness for lens in feasibility(made).lenses]
    for array in (0, 1):
        given = [t * (0.97 if k == array else 1.03) for k, t in enumerate(thick)]
        design = Design.from_dict(BICONVEX | WIDER | {"pair": BICONVEX["pair"] | {"thickness": given}})
        window = prescribe(design)
        checks = {c.subject: c for c in design_checks(design, window, feasibility(window)) if c.id == "cover"}
        assert checks[f"lens {array + 1}"].state == "fail"
        assert f"lens {array + 1} fills" in checks[f"lens {array + 1}"].sentence
        assert checks[f"lens {2 - array}"].state == "pass"
