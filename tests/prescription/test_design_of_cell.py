"""The uniform sheet of one cell of an aimed sheet, or of one whose law varies: the same lenses and light."""

from __future__ import annotations

from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

import clacad
from clacad.design import Design, load
from clacad.optics.rays import Fate
from clacad.prescription.prescribe import design_of_cell
from clacad.sheet.like_cell import like_cell
from clacad.sheet.vignetting import aperture_slopes
from clacad.tracing.worst_cell import worst_cell

PLATES = Path(__file__).parents[1] / "data" / "plates"
CELL = (9, 2)


def cemented(**keys: object) -> Design:
    """Plates of flat joints with other keys."""
    changes = {"lattice.count": [12, 10], **{key.replace("__", "."): value for key, value in keys.items()}}
    return load(PLATES / "flat-joints.toml").replace(changes)


def slab(**keys: object) -> Design:
    return Design.from_dict(
        {
            "format": 1, "name": "slab", "unit": "mm", "law": {"eta": [-1.0, -1.0], **keys},
            "pair": {"form": "slab", "separation": 10, "material": "PMMA", "wavelength": 546.1},
            "lattice": {"pitch": 0.5, "count": [12, 10]},
        }
    )  # fmt: skip


DESIGNS = {
    "cemented, aimed before": cemented(lattice__aperture={"point": [1.0, 0.5, -200]}),
    "cemented, aimed behind": cemented(lattice__aperture={"point": [1.0, 0.5, 300]}),
    "cemented, varying": cemented(law__varying={"f_image": 200}),
    "turned": slab().replace({"lattice.rotation_2": "0.3 deg", "lattice.pitch_2": 0.503}),
    "aimed from near": slab().replace({"lattice.aperture": {"point": [3.0, 1.5, -120]}}),
    "sharp": slab().replace({"pair.focus": {"object": -300, "image": 400}}),
    "sharp, ellipsoids of a depth": slab(eta=[-0.8, -1.0]).replace(
        {"pair.focus": {"object": -300, "image": 400}, "pair.depth": [2.4, 2.4]}
    ),
    "sharp, with a field lens": slab().replace(
        {"pair.focus": {"object": -300, "image": 400}, "pair.field_lens": True}
    ),
    "sharp, curved inside": slab().replace(
        {
            "pair.focus": {"object": -300, "image": 400},
            "pair.form": "plano",
            "pair.curved": "inside",
            "pair.thickness": 1.0,
        }
    ),
    "sharp, biconvex": slab().replace(
        {"pair.focus": {"object": -300, "image": 400}, "pair.form": "biconvex"}
    ),
    "sharp, tilted": slab(euler=[20, 4, 0]).replace({"pair.focus": {"object": -300, "image": 400}}),
    "slab, varying": slab(varying={"gradient": [[-5e-3, 1e-3], [2e-3, 4e-3]]}),
}


@pytest.mark.parametrize("name", DESIGNS)
def test_a_uniform_sheet_of_a_cell_has_its_lenses_and_its_law(name):
    design = DESIGNS[name]
    window = clacad.prescribe(design)
    assert not window.uniform
    own, like = (
        clacad.prescribe(design_of_cell(design, window, CELL)),
        like_cell(window, np.array(CELL), widest=False),
    )
    assert own.uniform
    assert own.law == like.law
    assert own.shifts[1] == pytest.approx(
        like.shifts[1], abs=2e-4
    )  # arrays of a sheet are one scale and shift
    for made, wanted in zip(own.faces, like.faces, strict=True):
        assert astuple(made.surface) == pytest.approx(astuple(wanted.surface), rel=1e-14)
        # from the middle of cell 1, where both cells lie at the same place
        places = [
            np.add(face.vertex[:2], one.shifts[face.array or 0])
            for face, one in ((made, own), (wanted, like))
        ]
        assert places[0] == pytest.approx(places[1], abs=4e-4)  # lenses of a varying sheet follow a gradient


@pytest.mark.parametrize(
    "name",
    ["turned", "aimed from near", "sharp", "sharp, with a field lens", "sharp, biconvex", "sharp, tilted"],
)
def test_light_leaves_the_uniform_sheet_of_a_cell_as_it_leaves_that_cell(name):
    """Traced through the sheet itself, from the light of the cell's centre of the field and aside of it."""
    design = DESIGNS[name]
    window = clacad.prescribe(design)
    own = clacad.prescribe(design_of_cell(design, window, CELL))
    points = np.random.default_rng(4).uniform(-0.15, 0.15, (50, 2))
    slope = aperture_slopes(window, np.array([CELL]))[0] + [0.002, -0.001]
    found = []
    for sheet, cell in ((window, CELL), (own, (6, 5))):
        start = np.column_stack([sheet.lattice.centres(np.array(cell)) + points - slope, np.full(50, -1.0)])
        seen = clacad.trace(sheet, clacad.Rays(start, (*slope, 1.0)), path="numpy")
        assert (seen.fate == Fate.ALIVE).all()
        found.append(seen.direction)
    off = {"turned": 1e-4, "sharp, with a field lens": 1e-8}.get(name, 1e-12)
    assert np.abs(found[0] - found[1]).max() < off


def test_light_of_other_wavelengths_goes_through_the_worst_cell_as_such():
    """An aimed sheet of one glass has colour, as one index a line gives it."""
    design = slab().replace("lattice.aperture", {"point": [0.0, 0.0, -400.0]})
    window = clacad.prescribe(design)
    seen = worst_cell(window, 0.01)
    errors = [
        clacad.measure_light(window, 0.01, [line], rays=2048).rms for line in (486.1e-9, 546.1e-9, 656.3e-9)
    ]
    assert min(errors[0], errors[2]) > 1.02 * errors[1]
    assert f"cell ({seen.cell[0]}, {seen.cell[1]}), the worst of {seen.tried} tried" in seen.words
    assert "in the others" in seen.words
