"""Keys of plates that mount: read, written back, refused by name; outlines drawn by another program."""

from __future__ import annotations

import tomllib
from math import pi, tan

import pytest

from clacad.design import Design, DesignError, load
from clacad.prescription.prescribe import prescribe
from clacad.sheet.plate import Plate

SLAB = {
    "format": 1, "name": "plate", "unit": "mm", "law": {"eta": [-0.8, -1.0]},
    "pair": {"form": "slab", "separation": 6, "index": 1.5}, "lattice": {"pitch": 1.0, "count": [6, 5]},
}  # fmt: skip
PLANO = SLAB | {"pair": {"form": "plano", "separation": 8, "thickness": 1.5, "index": 1.5}}


def made(base=SLAB, lattice=None, **body):
    return Design.from_dict(base | {"lattice": base["lattice"] | (lattice or {}), "body": body})


def plate_of(design):
    found = prescribe(design).outline
    assert isinstance(found, Plate)
    return found


def mistakes(base=SLAB, lattice=None, **body):
    """Codes and texts of what is wrong, the design read and its plate built."""
    with pytest.raises(DesignError) as caught:
        prescribe(made(base, lattice, **body))
    return " | ".join(
        str(mistake.code) + " " + mistake.message + " " + mistake.hint for mistake in caught.value.mistakes
    )


def test_designs_without_a_plate_keep_their_hash():
    """The hash of a shipped design as it was before there were plates."""
    assert (
        load("designs/slab.toml").sha256 == "2e6800dd4747adf8e4cb062276db41a10a4c8d3e27bae2b9d47b4c2175135f2b"
    )


def test_every_key_comes_back_from_the_canonical_text():
    asked = made(
        PLANO, border=4, corners={"round": 1.5}, pins={"diameter": 2, "at": [[-5.2, 0], [5.2, 0]], "play": "10 um"},
        holes=[{"diameter": 1.2, "corners": 2}, {"diameter": 0.8, "circle": 10.4, "count": 2, "start": 90}],
    )  # fmt: skip
    assert Design.from_dict(tomllib.loads(asked.canonical_toml())) == asked
    bent = made(lattice={"outline": {"polygon": [[-4, -3], [4, -3, 0.3], [4, 3], [-4, 3]]}})
    assert Design.from_dict(tomllib.loads(bent.canonical_toml())) == bent
    assert asked.sha256 != made(PLANO, border=4).sha256


def test_holes_stand_at_points_on_circles_and_in_corners():
    plate = plate_of(made(
        border=4, corners={"chamfer": 1},
        holes=[{"diameter": 1.2, "corners": 2}, {"diameter": 0.8, "circle": 12, "count": 3, "start": 90}, {"diameter": 0.5, "at": [[6, 1]]}],
    ))  # fmt: skip
    assert plate.box == (-7.0, 7.0, -6.5, 6.5)  # 6 x 5 cells of 1 and a border of 4
    found = [(hole.x, hole.y, hole.diameter) for hole in plate.holes]
    wanted = [(5, -4.5, 1.2), (5, 4.5, 1.2), (-5, 4.5, 1.2), (-5, -4.5, 1.2)]
    wanted += [(0, 6, 0.8), (-6 * 0.75**0.5, -3, 0.8), (6 * 0.75**0.5, -3, 0.8), (6, 1, 0.5)]
    assert [pytest.approx(one, abs=1e-12) for one in wanted] == found
    assert plate.area == pytest.approx(14 * 13 - 4 * 0.5 - pi / 4 * (4 * 1.44 + 3 * 0.64 + 0.25), rel=1e-13)


def test_pins_are_holes_in_both_plates_as_wide_as_the_pin_and_its_play():
    plate = plate_of(
        made(PLANO, border=4, pins={"diameter": 2, "at": [[-5.2, 0], [5.2, 0]], "play": "10 um"})
    )
    assert [(hole.x, hole.diameter, hole.purpose) for hole in plate.holes] == [
        (-5.2, 2.01, "pin"),
        (5.2, 2.01, "pin"),
    ]


@pytest.mark.parametrize(
    ("wanted", "lattice", "body"),
    [
        ("CL113 body.holes needs land", {}, {"holes": [{"diameter": 1, "at": [[0, 0]]}]}),
        ("CL113 body.corners needs land", {}, {"corners": {"round": 1}}),
        ("CL114 body.corners does not belong to a circle", {"outline": {"circle": 8}}, {"corners": {"round": 1}}),
        ("CL114 body.pins does not belong to a slab", {}, {"border": 3, "pins": {"diameter": 1, "at": [[0, 4], [0, -4]], "play": 0}}),
        ("CL112 body.holes[0] says two ways", {}, {"border": 3, "holes": [{"diameter": 1, "at": [[0, 4]], "corners": 1}]}),
        ("CL103 body.holes[0] says nothing", {}, {"border": 3, "holes": [{"diameter": 1}]}),
        ("CL103 body.holes[0] lacks the key count", {}, {"border": 3, "holes": [{"diameter": 1, "circle": 9}]}),
        ("CL113 body.holes[0]: count and start", {}, {"border": 3, "holes": [{"diameter": 1, "at": [[0, 4]], "count": 2}]}),
        ("CL114 body.holes[0].corners", {"outline": {"circle": 8}}, {"holes": [{"diameter": 1, "corners": 1}]}),
        ("CL141 body.corners: round = 6 leaves no side", {}, {"border": 3, "corners": {"round": 6}}),
        ("CL141 body.holes.0: a hole of diameter 1 at (5.8, 0) cuts the edge", {}, {"border": 3, "holes": [{"diameter": 1, "at": [[5.8, 0]]}]}),
        ("CL141 body.holes.0: a hole of diameter 1 at (9, 0) lies outside", {}, {"border": 3, "holes": [{"diameter": 1, "at": [[9, 0]]}]}),
        ("CL141 body.holes.0: a hole of diameter 2 at (5, 0) meets", {}, {"border": 4, "holes": [{"diameter": 2, "at": [[5, 1.8], [5, 0]]}]}),
        ("CL141 body.holes: 1 of 30 cells are cut", {}, {"border": 3, "holes": [{"diameter": 1, "at": [[3.2, 0]]}]}),
        ("CL117 lattice.outline holds no whole cell", {"outline": {"polygon": [[9, 9], [14, 9], [14, 14], [9, 14]]}}, {}),
        ("CL141 lattice.outline is no outline: the sides", {"outline": {"polygon": [[0, 0], [5, 5], [5, 0], [0, 5]]}}, {}),
        ("CL108 lattice.outline.polygon", {"outline": {"polygon": [[0, 0]]}}, {}),
        ("CL108 lattice.outline.polygon[1]", {"outline": {"polygon": [[0, 0], [1, 2, 3, 4], [0, 5]]}}, {}),
        ("CL108 lattice.outline.polygon", {"outline": {"polygon": [[0, 0]] * 10_001}}, {}),
        ("CL106 lattice.outline.polygon[1][2]", {"outline": {"polygon": [[0, 0], [1, 2, 1e4], [0, 5]]}}, {}),
        ("CL106 lattice.count", {"outline": {"polygon": [[0, 0], [4, 0], [0, 4]]}, "count": [10_000, 10_000]}, {}),
    ],
)  # fmt: skip
def test_what_makes_no_plate_is_refused_by_its_key(wanted, lattice, body):
    assert wanted in mistakes(SLAB, lattice, **body)


def test_the_way_out_that_is_named_works():
    """A hole among counted cells: the outline that the hint names leaves the cut cells out."""
    body = {"border": 3, "holes": [{"diameter": 1, "at": [[3.2, 0]]}]}
    said = mistakes(SLAB, {}, **body)
    sides = said.split("rectangle = [")[1].split("]")[0]
    found = prescribe(
        made(SLAB, {"outline": {"rectangle": [float(v) for v in sides.split(",")]}}, holes=body["holes"])
    )
    assert found.lattice.cell_count == 29
    edge = mistakes(SLAB, {}, border=3, holes=[{"diameter": 1, "at": [[5.8, 0]]}])
    inward = float(edge.split("more than ")[1].split(" farther")[0])
    assert plate_of(made(border=3, holes=[{"diameter": 1, "at": [[5.8 - inward * 1.001, 0]]}])).holes


def test_a_sheet_of_another_number_of_cells_is_a_plain_one():
    asked = made(PLANO, border=4, corners={"round": 1}, holes=[{"diameter": 1, "at": [[5, 5]]}])
    few = asked.with_cells((2, 2))
    assert not isinstance(prescribe(few).outline, Plate)
    assert few == Design.from_dict(few.given) == made(PLANO, {"count": [2, 2]}, border=4)


# -- drawings ---------------------------------------------------------------------------------------


def drawn(tmp_path, draw, unit=4, name="plate.dxf"):
    """A DXF drawn by ezdxf, and the design that names it."""
    ezdxf = pytest.importorskip("ezdxf")
    document = ezdxf.new("R2010")
    document.header["$INSUNITS"] = unit
    draw(document.modelspace())
    document.saveas(tmp_path / name)
    text = f"""
format = 1
name = "plate"
unit = "mm"
[law]
eta = [-0.8, -1.0]
[pair]
form = "slab"
separation = 6
index = 1.5
[lattice]
pitch = 1.0
outline = {{dxf = "{name}"}}
"""
    (tmp_path / "plate.toml").write_text(text)
    return load(tmp_path / "plate.toml")


def polyline(space):
    space.add_lwpolyline([(-5, -4, 0), (5, -4, 0.25), (5, 4, 0), (-5, 4, 0)], format="xyb", close=True)


@pytest.mark.parametrize("kind", ["POLYLINE", "LWPOLYLINE"])
def test_a_closed_polyline_of_either_kind_is_read_with_its_bulges(tmp_path, kind):
    def draw(space):
        if kind == "POLYLINE":
            space.add_polyline2d(
                [(-5, -4, 0), (5, -4, 0.25), (5, 4, 0), (-5, 4, 0)], format="xyb", close=True
            )
        else:
            polyline(space)

    design = drawn(tmp_path, draw)
    assert design.lattice.outline.points == ((-5, -4, 0), (5, -4, 0.25), (5, 4, 0), (-5, 4, 0))
    same = made(
        lattice={
            "outline": {"polygon": [[-5, -4], [5, -4, 0.25], [5, 4], [-5, 4]]},
            "count": list(design.lattice.count),
        }
    )
    assert design.sha256 == same.sha256


def test_what_rounding_left_of_nothing_is_nothing(tmp_path):
    """A corner at cos 90° of a program that turns: 3e-16, which no design takes for a length."""

    def draw(space):
        space.add_lwpolyline([(5, 3e-16), (-2e-15, 5), (-5, 6e-16), (-9e-16, -5)], close=True)

    assert [p[:2] for p in drawn(tmp_path, draw).lattice.outline.points] == [(5, 0), (0, 5), (-5, 0), (0, -5)]


@pytest.mark.parametrize(("unit", "millimetres"), [(1, 25.4), (4, 1.0), (5, 10.0), (6, 1000.0), (13, 1e-3)])
def test_the_drawings_unit_is_read(tmp_path, unit, millimetres):
    size = 10.0 / millimetres

    def draw(space):
        space.add_lwpolyline([(-size, -size), (size, -size), (size, size), (-size, size)], close=True)

    points = drawn(tmp_path, draw, unit).lattice.outline.points
    assert [p[:2] for p in points] == [
        pytest.approx((10 * a, 10 * b), rel=1e-15) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]


def test_lines_and_arcs_are_linked_in_any_order_and_direction(tmp_path):
    def draw(space):
        space.add_line((5, 3), (5, -4))  # runs backwards
        space.add_arc((4, 3), 1, 0, 90)
        space.add_line((-5, -4), (5, -4))
        space.add_line((4, 4), (-5, 4))
        space.add_line((-5, -4), (-5, 4))

    design = drawn(tmp_path, draw)
    assert plate_of(design).area == pytest.approx(80 - (1 - pi / 4), rel=1e-12)
    bulges = [b for _, _, b in design.lattice.outline.points if b]
    assert [abs(b) for b in bulges] == [pytest.approx(tan(pi / 8))]


def test_the_layer_outline_alone_is_read_where_there_is_one(tmp_path):
    def draw(space):
        space.add_lwpolyline(
            [(-5, -4), (5, -4), (5, 4), (-5, 4)], close=True, dxfattribs={"layer": "OUTLINE"}
        )
        space.add_circle((0, 0), 1)
        space.add_text("a word")

    assert len(drawn(tmp_path, draw).lattice.outline.points) == 4


def test_the_design_tells_its_corners_without_the_file(tmp_path):
    design = drawn(tmp_path, polyline)
    (tmp_path / "plate.dxf").unlink()
    assert Design.from_dict(tomllib.loads(design.toml)) == design
    assert design.replace("lattice.pitch", 0.5).lattice.outline == design.lattice.outline


@pytest.mark.parametrize(
    ("draw", "unit", "wanted"),
    [
        (lambda s: polyline(s), 0, "CL105 plate.dxf states no unit"),
        (lambda s: polyline(s), 20, "CL105 plate.dxf has $INSUNITS = \"20\""),
        (lambda s: s.add_lwpolyline([(0, 0), (5, 0), (5, 5)]), 4, "CL141 plate.dxf, line"),
        (lambda s: (polyline(s), s.add_circle((3, 2), 0.5)), 4, "body.holes = [{diameter = 1, at = [[3, 2]]}]"),
        (lambda s: (polyline(s), polyline(s)), 4, "CL141 plate.dxf: 2 closed outlines"),
        (lambda s: s.add_line((0, 0), (5, 0)), 4, "does not close: at"),
        (lambda s: s.add_spline([(0, 0), (5, 0), (5, 5)]), 4, "a \"SPLINE\" is no outline"),
        (lambda s: s.add_lwpolyline([(0, 0), (5, 5), (5, 0), (0, 5)], close=True), 4, "CL141 lattice.outline is no outline"),
        (lambda s: s.add_lwpolyline([(k % 200, k // 200) for k in range(10_001)], close=True), 4, "CL108"),
    ],
)  # fmt: skip
def test_drawings_that_are_no_outline_are_refused_by_name(tmp_path, draw, unit, wanted):
    with pytest.raises(DesignError) as caught:
        drawn(tmp_path, draw, unit)
    said = " | ".join(f"{m.code} {m.message} {m.hint}" for m in caught.value.mistakes)
    assert wanted in said
    assert len(caught.value.mistakes) == 1
