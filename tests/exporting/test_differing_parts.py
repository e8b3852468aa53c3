"""Frames, engraved parts and BREP of non-uniform sheets: true outlines, letters next to the cells, light as specified."""

from __future__ import annotations

import json

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
        "body": {"border": 4}, "check": {"process": "none"},
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


@pytest.mark.long
def test_engraved_parts_and_brep_are_masters_by_the_light_of_the_worst_cell(tmp_path):
    from build123d import import_brep, import_step

    design, out = PAIR.replace("pair.offset", "traced").with_cells((4, 3)), tmp_path / "out"
    manifest = clacad.export(design, out, formats=("brep", "marked", "marked-stl"), quads=4)
    exact = sum(solid.volume for solid in import_brep(str(out / "aimed-pair.brep")).solids())
    engraved = sum(
        solid.volume
        for n in (1, 2)
        for solid in import_step(str(out / f"aimed-pair.array{n}.marked.step")).solids()
    )
    letters = [
        part["volume"]
        for entry in manifest.files
        if entry["format"] == "stl-binary"
        for part in entry["marks"].values()
    ]
    assert len(letters) == 2
    assert exact - engraved == pytest.approx(sum(letters), rel=2e-2)  # their own chords and levels
    report = clacad.verify(design, files=out, rays=512)
    failed = {check.subject for check in report.checks if check.state == "fail"}
    assert not {name for name in failed if not name.endswith(".stl")}, (
        failed
    )  # 4 quads are too coarse for light
    for name in ("aimed-pair.brep", "aimed-pair.array2.marked.step"):
        light = {check.id: check for check in report.checks if check.subject == name}
        assert light["file_law_rms"].state == light["shape"].state == "pass"
        assert len(light["file_law_rms"].detail["cells"]) == 12


def test_what_repeats_or_samples_one_cell_is_refused_by_one_code(tmp_path):
    from clacad.sheet.need_window import CellsDiffer

    for name in ("sag", "coupon", "zmx"):
        with pytest.raises(CellsDiffer, match=f"CL139: format {name}.*step, brep"):
            clacad.export(PAIR, tmp_path / "out", formats=(name,))
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_gdsii_levels_of_every_cell_are_the_heights_of_its_own_lens(tmp_path):
    gdstk = pytest.importorskip("gdstk", reason="the extra gds is not installed")
    design = PAIR.with_cells((3, 2))
    clacad.export(design, tmp_path / "out", formats=("gds",), grey_levels=32)
    said = json.loads((tmp_path / "out" / "aimed-pair.gds.json").read_text())["faces"]["array2-back"]
    path = tmp_path / "out" / "aimed-pair.array2-back.gds"
    library = gdstk.read_gds(str(path))
    (sheet,) = library.top_level()
    assert sum(p.area() for p in sheet.get_polygons()) == pytest.approx(6 * (500.0 * SCALE) ** 2, rel=1e-3)
    scale = clacad.prescribe(design).placements[1].pitch[0] / 0.5
    radius = -1.0 / clacad.prescribe(design).faces[3].surface.curvature_y
    stands = sorted(tuple(one.origin) for one in sheet.references)
    lenses = [(0.5 * i, 0.5 * (j - 0.5)) for i in (-1, 0, 1) for j in (0, 1)]  # lens 2 stays over lens 1
    foot = np.array([3.0, -2.0]) * (1.0 - scale)
    for origin, lens in zip(stands, lenses, strict=True):
        assert np.array(origin) / 1e3 == pytest.approx(np.array(lens) * scale + foot, abs=2e-6)
    by_place = {tuple(one.origin): one for one in sheet.references}
    rng = np.random.default_rng(2)
    for origin, lens in zip(stands, lenses, strict=True):
        boxes = by_place[origin].get_polygons()
        for number in rng.integers(0, len(boxes), 60):
            (x0, y0), (x1, y1) = boxes[number].bounding_box()
            x = (
                x0
                + (rng.integers(0, max(1, round((x1 - x0) / said["pixel_um"][0]))) + 0.5)
                * said["pixel_um"][0]
            ) * 1e-3
            r2 = (x - lens[0]) ** 2 + (0.5e-3 * (y0 + y1) - lens[1]) ** 2
            sag = r2 / (abs(radius) + np.sqrt(radius**2 - r2))
            told = said["low_mm"] + boxes[number].layer * said["step_mm"]
            assert abs(told + sag) <= 0.52 * said["step_mm"]
    from clacad.formats.maps.gds import gds_misfit, grey_cell
    from clacad.storage.errors import FileDisagrees

    window = clacad.prescribe(design)
    cell = grey_cell(window, window.bodies[1], window.faces[3], "array2-back", 32, 1.0)
    assert gds_misfit(cell, path, 1.0) == (pytest.approx(0.0, abs=1e-6), 6)
    polygon = next(c for c in library.cells if c.name == "lenslet_4").polygons[99]
    polygon.layer = (polygon.layer + 1) % 32
    library.write_gds(str(tmp_path / "changed.gds"))
    with pytest.raises(FileDisagrees, match="lenslet_4 was read back with other levels"):
        gds_misfit(cell, tmp_path / "changed.gds", 1.0)
