"""Frames, engraved parts and BREP of sheets whose cells differ: true outlines, letters beside the cells, light as asked."""

from __future__ import annotations

import numpy as np
import pytest

import clacad
from clacad.exporting.fixtures import engraved_mesh, engravings, frame_solids, frame_spec
from clacad.solid.marks import mark_place

PAIR = clacad.Design.from_dict(
    {
        "format": 1, "name": "aimed-pair", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
        "pair": {"form": "plano", "separation": 10, "material": "PMMA", "wavelength": 550, "offset": "paraxial", "thickness": [1.5, 1.5]},
        "lattice": {"pitch": 0.5, "count": [9, 7], "aperture": {"point": [3, -2, -150]}},
        "body": {"border": 4}, "check": {"process": "none", "field": "0.1 deg"},
    }
)  # fmt: skip
SCALE = 1.0 + 10.0 / 150.0
"""Pitch of array 2 over that of array 1."""


def array_2():
    """Box (x0, x1, y0, y1) of the cells of array 2, by hand: scaled about the viewer's foot."""
    x, y = 4.5 * 0.5 * SCALE, 3.5 * 0.5 * SCALE
    dx, dy = -3.0 * 10.0 / 150.0, 2.0 * 10.0 / 150.0
    return dx - x, dx + x, dy - y, dy + y


@pytest.mark.slow
def test_letters_of_a_mesh_stand_beside_the_cells_of_the_wider_array_and_take_their_own_volume():
    window = clacad.prescribe(PAIR)
    x0, x1, y0, y1 = array_2()
    assert window.placements[1].extent(window.lattice) == pytest.approx((x0, x1, y0, y1), abs=1e-4)
    place = mark_place(window, window.bodies[1])
    assert place.centre[1] + 0.5 * place.height < y0 - 0.2
    plain = clacad.tessellate(window, quads=4).bodies[1]
    drawing = engravings(window, window.name)["array2"]
    made = engraved_mesh(plain, drawing)
    assert plain.own
    before, after = (np.concatenate(list(mesh.rows())) for mesh in (plain, made))
    assert made.facet_count == len(after) > len(before) == plain.facet_count
    trimesh = pytest.importorskip("trimesh")
    solid, whole = (trimesh.Trimesh(**trimesh.triangles.to_kwargs(facets)) for facets in (after, before))
    assert solid.is_watertight
    assert solid.is_winding_consistent
    assert solid.body_count == 1
    assert whole.volume - solid.volume == pytest.approx(drawing.area * drawing.depth, rel=1e-3)
    assert made.volume() == pytest.approx(solid.volume, rel=1e-12)


@pytest.mark.slow
def test_a_frame_holds_plates_as_large_as_the_wider_array_needs_and_leaves_their_cells_free():
    from build123d import Box, Pos

    window = clacad.prescribe(PAIR)
    spec = frame_spec(window, window.land.border)
    spacer = frame_solids(spec)["spacer"]
    assert spacer.is_valid
    x0, x1, y0, y1 = array_2()
    assert spec.plates[0] == spec.plates[1] == pytest.approx((x1 - x0 + 8.0, y1 - y0 + 8.0), abs=2e-4)
    assert spec.centres[1] == pytest.approx((0.5 * (x0 + x1), 0.5 * (y0 + y1)), abs=1e-4)

    def shared(solid):
        common = spacer & solid
        return 0.0 if common is None else sum(s.volume for s in common.solids())

    low, high = spec.ends(0)
    for k, body in enumerate(window.bodies):
        box = Box(*spec.plates[k], spec.thickness[k])
        middle = 0.5 * (spec.seats[k] + (low if k == 0 else high) + (0.2 if k == 0 else -0.2))
        assert shared(Pos(*spec.centres[k], middle) * box) < 1e-9, body.name
        assert (
            shared(Pos(spec.centres[k][0] - 0.05, spec.centres[k][1], middle) * box) > 1e-3
        )  # the nubs hold it
    cells = Pos(0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * (low + high)) * Box(x1 - x0, y1 - y0, high - low)
    assert shared(cells) == 0.0


@pytest.mark.slow
def test_engraved_parts_and_brep_are_masters_by_the_light_of_the_worst_cell(tmp_path):
    from build123d import import_brep, import_step

    out = tmp_path / "out"
    manifest = clacad.export(
        PAIR, out, formats=("step", "brep", "marked", "marked-stl", "marked-3mf"), quads=8
    )
    exact = sum(solid.volume for solid in import_step(str(out / "aimed-pair.step")).solids())
    assert sum(solid.volume for solid in import_brep(str(out / "aimed-pair.brep")).solids()) == pytest.approx(
        exact, rel=1e-9
    )
    engraved = sum(
        solid.volume
        for n in (1, 2)
        for solid in import_step(str(out / f"aimed-pair.array{n}.marked.step")).solids()
    )
    letters = [
        part["volume"]
        for entry in manifest.files
        if entry["format"] == "stl-binary" and "marks" in entry
        for part in entry["marks"].values()
    ]
    assert len(letters) == 2
    assert exact - engraved == pytest.approx(sum(letters), rel=2e-2)  # their own chords and levels
    report = clacad.verify(PAIR, files=out, rays=1024)
    assert report.word.startswith("passed"), [c.sentence for c in report.checks if c.state == "fail"]


def test_what_repeats_or_samples_one_cell_is_refused_by_one_code(tmp_path):
    from clacad.sheet.need_window import CellsDiffer

    for name in ("sag", "coupon", "zmx"):
        with pytest.raises(CellsDiffer, match=f"CL139: format {name}.*step, stl"):
            clacad.export(PAIR, tmp_path / "out", formats=(name,))
    assert not (tmp_path / "out").exists()
