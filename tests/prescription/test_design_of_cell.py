"""The uniform sheet of one cell of an aimed sheet, or of one whose law varies: the same lenses and light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import clacad
from clacad.design import Design, load
from clacad.prescription.prescribe import design_of_cell
from clacad.sheet.like_cell import like_cell
from clacad.sheet.need_window import CellsDiffer
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
        assert made.surface == wanted.surface
        # from the middle of cell 1, where both cells lie at the same place
        places = [
            np.add(face.vertex[:2], one.shifts[face.array or 0])
            for face, one in ((made, own), (wanted, like))
        ]
        assert places[0] == pytest.approx(places[1], abs=4e-4)  # lenses of a varying sheet follow a gradient


def test_arrays_of_other_pitches_have_no_uniform_sheet_of_a_cell():
    design = slab().replace("lattice.pitch_2", 0.51)
    with pytest.raises(CellsDiffer, match="uniform sheet of a cell"):
        design_of_cell(design, clacad.prescribe(design), CELL)


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
