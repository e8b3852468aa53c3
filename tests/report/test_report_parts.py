"""Parts of the page other than the checks, each compared with another way to the same number."""

from __future__ import annotations

import base64
import io
import json
import re
from math import pi

import numpy as np
import pytest

from clacad.design import Design
from clacad.exporting.drawing.canvas import orientation
from clacad.exporting.drawing.views import across_cell, heights, outlines
from clacad.light.confocality import confocality
from clacad.mesh import tessellate
from clacad.prescription.prescribe import prescribe
from clacad.report.content import assembly, lens_detail, plan, telescopelet
from clacad.report.pictures import packed, parts, picture
from clacad.report.rows import fabrication
from clacad.sheet.feasibility import feasibility
from clacad.sheet.volume_and_extent import whole_extent
from clacad.verification.evidence import foci
from clacad.verification.light.error_attribution import ghost_map

TEXT = {
    "format": 1, "name": "parts", "unit": "mm", "law": {"eta": [-0.5, -1.0], "delta": [0.01, 0.0]},
    "pair": {"form": "biconvex", "separation": 5.0, "material": "PMMA"}, "lattice": {"pitch": 0.5, "count": [6, 4]},
}  # fmt: skip
FORMS = {
    "biconvex": {},
    "tilted": {"law.euler": [20.0, 1.0, 5.0]},
    "plano": {"pair": {"form": "plano", "separation": 5.0, "thickness": 1.0, "index": 1.5}},
    "slab": {"pair": {"form": "slab", "separation": 5.0, "index": 1.5}},
    "galilean": {"law": {"eta": [0.5, 0.5]}},
}


def window_of(name):
    changes = FORMS[name]
    text = {**TEXT, **{k: v for k, v in changes.items() if "." not in k}}
    design = Design.from_dict(text).replace({k: v for k, v in changes.items() if "." in k})
    return design, prescribe(design)


class Shown:
    """As much of a report as tables and drawings read."""

    def __init__(self, design, window):
        self.design, self.window, self.facts, self.evidence = design, window, feasibility(window), None
        self.checks = ()


@pytest.fixture(scope="module", params=list(FORMS))
def made(request):
    return Shown(*window_of(request.param))


def lines(shown):
    return {(line.about, line.name): line.value for line in fabrication(shown)}


# -- the table ------------------------------------------------------------------------------------


@pytest.mark.daily_cases("galilean", "biconvex", "plano", "slab")
def test_volume_and_mass_are_those_of_the_triangles(made):
    table, mesh = lines(made), tessellate(made.window, quads=16)
    for body in mesh.bodies:
        (volume,) = table[(body.body.name, "volume")]
        corners = body.vertices[body.triangles]
        crossed = np.cross(corners[:, 1], corners[:, 2])
        enclosed = float(np.einsum("ij,ij->", corners[:, 0], crossed)) / 6.0
        assert volume == pytest.approx(enclosed, rel=4e-3)
        if body.body.material is not None:
            (mass,) = table[(body.body.name, "mass")]
            assert mass == pytest.approx(volume * 1190.0e-6, rel=1e-12)  # PMMA: 1190 kg/m³


@pytest.mark.daily_cases("biconvex", "plano", "slab", "galilean")
def test_caliper_sizes_are_those_of_the_triangles(made):
    table = lines(made)
    for body in tessellate(made.window, quads=16).bodies:
        size = np.ptp(body.vertices, axis=0)
        assert table[("caliper", f"{body.body.name}: width, height, thickness")] == pytest.approx(
            size, rel=2e-3
        )


@pytest.mark.daily_cases("biconvex", "plano", "slab", "galilean")
def test_sag_is_that_of_the_triangles_of_the_lens(made):
    table = lines(made)
    alone = made.window.with_cells((1, 1))
    for lens in made.facts.lenses:
        face = next(f for f in alone.faces if f.array == lens.array)
        body = next(b for b in alone.bodies if face in (b.front, b.back))
        corners = tessellate(alone, quads=16).bodies[alone.bodies.index(body)].vertices
        place = corners[:, :2] - np.asarray(alone.shifts[lens.array])
        from clacad.sheet.window import lens_height

        inside = np.abs(place).max(axis=1) < 0.2499
        z = corners[inside, 2]
        own = lens_height(face, *place[inside].T)
        on = np.abs(z - own) < 1e-6
        (sag,) = table[(f"lens {lens.array + 1}", "sag over the cell")]
        assert np.ptp(z[on]) <= sag * (1.0 + 1e-3)
        assert np.ptp(z[on]) >= 0.75 * sag


def test_orientation_says_what_turning_does_to_the_geometry():
    """Turned by a quarter, square and round-lensed pairs are the same solid; others are not."""
    quarter = "by quarter turns"
    round_one = Design.from_dict({**TEXT, "law": {"eta": [-0.5, -0.5]}})
    assert any(quarter in s for s in orientation(prescribe(round_one)))
    assert not any(quarter in s for s in orientation(window_of("tilted")[1]))
    same = Design.from_dict({**TEXT, "law": {"eta": [-1.0, -1.0]}, "pair": FORMS["slab"]["pair"]})
    assert any("turned over, too" in s for s in orientation(prescribe(same)))
    assert any("may not be turned over" in s for s in orientation(prescribe(round_one)))


@pytest.mark.parametrize(("changes", "quarter", "over"), [
    ({}, True, True),
    ({"pair.face.0.conic": [-1, 0]}, False, False),
    ({"pair.face.0.conic": [-1, -1]}, True, False),
    ({"pair.face.0.a4": [1e-3, 0, 2e-3], "pair.face.1.a4": [1e-3, 0, 2e-3]}, False, True),
    ({"pair.face.0.a4": [1e-3, 5e-4, 1e-3], "pair.face.1.a4": [1e-3, 6e-4, 1e-3]}, True, False),
])  # fmt: skip
def test_given_faces_that_differ_in_more_than_their_radii_are_not_alike(changes, quarter, over):
    faces = [{"radius": [1.6, 1.6], "conic": [0, 0], "a4": [0, 0, 0]} for _ in range(2)]
    pair = {
        "form": "slab",
        "thickness": 7.5,
        "index": 1.5,
        "prescription": "given",
        "face": faces,
    }
    design = Design.from_dict({**TEXT, "law": {"eta": [-1, -1]}, "pair": pair})
    for key, value in changes.items():
        design = design.replace(key, value)
    said = orientation(prescribe(design))
    assert any("by quarter turns" in s for s in said) == quarter
    assert any("turned over, too" in s for s in said) == over


def test_lenses_of_unlike_thickness_are_not_turned_over():
    pair = {"form": "biconvex", "separation": 5.0, "index": 1.5}
    for thickness, over in ((0.4, True), ([0.4, 0.5], False)):
        design = Design.from_dict({**TEXT, "law": {"eta": [-1, -1]}, "pair": pair | {"thickness": thickness}})
        assert any("turned over, too" in s for s in orientation(prescribe(design))) == over


@pytest.mark.parametrize(("body", "words"), [
    ({}, ("by quarter turns", "turned over, too")),
    ({"corners": {"round": 0.5}}, ("by quarter turns", "turned over, too")),
    ({"holes": [{"diameter": 0.5, "circle": 4.6, "count": 4}]}, ("by quarter turns", "turned over, too")),
    ({"holes": [{"diameter": 0.5, "circle": 4.6, "count": 2}]}, ("not by a quarter", "turned over, too")),
    ({"holes": [{"diameter": 0.5, "at": [[2.3, 2.0], [-2.3, -2.0]]}]}, ("not by a quarter", "over: outline or holes")),
    ({"holes": [{"diameter": 0.5, "at": [[0, 2.3]]}]}, ("may not be turned about z: outline or holes", "turned over, too")),
    ({"holes": [{"diameter": 0.5, "at": [[1, 2.3]]}]}, ("may not be turned about z: outline or holes", "over: outline or holes")),
])  # fmt: skip
def test_outline_and_holes_say_how_a_plate_fits(body, words):
    """Alike lenses on a square of 4 x 4 cells: what is drawn round them decides."""
    design = Design.from_dict({
        **TEXT, "law": {"eta": [-1, -1]}, "pair": FORMS["slab"]["pair"], "lattice": {"pitch": 0.8, "count": [4, 4]},
        "body": {"border": 1.5} | body,
    })  # fmt: skip
    said = orientation(prescribe(design))
    assert all(any(word in one for one in said) for word in words)


# -- drawings -------------------------------------------------------------------------------------


def test_the_outline_of_a_cell_is_the_section_of_its_triangles(made):
    """Corners of the mesh that lie on the line of the section lie on the drawn outline."""
    window = made.window
    for number, body in enumerate(window.bodies):
        array = number if len(window.bodies) > 1 else 0
        x, y = across_cell(window, array)
        front, back = heights(window, body, x, y)
        area = 0.0
        for piece in outlines(x, front, back):
            u, v = piece.T
            area += 0.5 * abs(u @ np.roll(v, -1) - v @ np.roll(u, -1))
        assert area == pytest.approx(float(np.trapezoid(back - front, x)), rel=1e-9)
        assert np.nanmin(front) >= window.z_range[0] - 1e-9
        assert np.nanmax(back) <= window.z_range[1] + 1e-9


def words(svg):
    return re.findall(r"<text[^>]*>([^<]*)</text>", svg)


def test_the_numbers_of_the_drawings_are_those_of_the_part(made):
    window = made.window
    x0, x1, y0, y1 = whole_extent(window)
    low, high = window.z_range
    said = words(assembly(made.window))
    assert {f"{x1 - x0:.5g}", f"{high - low:.5g}"} <= set(said)
    assert {f"{x1 - x0:.5g}", f"{y1 - y0:.5g}"} <= set(words(plan(made.window)))
    assert "0.5" in words(telescopelet(made))
    for array, lens in enumerate(made.facts.lenses):
        text = " ".join(words(lens_detail(made, array)))
        assert f"{lens.radius[0]:.5g}, {lens.radius[1]:.5g}" in text
        assert f"sag {lens.sag:.5g}" in text


def test_drawings_are_to_scale(made):
    """Width over height of the drawn body is that of the part."""
    window = made.window
    svg = assembly(made.window)
    points = [np.array([[float(v) for v in p.split(",")] for p in s.split()])
              for s in re.findall(r'<polygon class="(?:body|cut)" points="([^"]+)"', svg)]  # fmt: skip
    drawn = np.ptp(np.concatenate(points), axis=0)
    x0, x1, _, _ = whole_extent(window)
    assert drawn[0] / drawn[1] == pytest.approx((x1 - x0) / np.subtract(*window.z_range[::-1]), rel=0.02)


# -- foci -----------------------------------------------------------------------------------------


def test_both_foci_coincide_where_the_pair_is_confocal(made):
    for focus in foci(made.window):
        assert abs(focus.gap) < 1e-6 * focus.distance


def test_sliding_a_lens_parts_the_foci_by_what_the_parabasal_check_measures():
    from dataclasses import replace

    _, window = window_of("biconvex")
    second = window.bodies[1]
    slide = 0.05

    def moved(face):
        return replace(face, vertex=(*face.vertex[:2], face.vertex[2] + slide))

    out = replace(
        window, bodies=(window.bodies[0], replace(second, front=moved(second.front), back=moved(second.back)))
    )
    measured = confocality(out)
    for k, focus in enumerate(foci(out)):
        assert focus.gap == pytest.approx(slide, rel=1e-4)
        assert measured.shift[k] == pytest.approx(-slide, rel=1e-3)


def test_the_caustic_of_a_spherical_face_has_the_length_of_third_order_aberration():
    """For a sphere of radius R the ray at height h crosses the axis n R/(n − 1) − h²/(2 R n (n − 1)) behind the apex.

    (Snell's law at the sphere, expanded in h.) Neighbouring rays cross three times as far from the focus.
    """
    pair = {"form": "slab", "separation": 5.0, "index": 1.5}
    window = prescribe(Design.from_dict({**TEXT, "law": {"eta": [-1.0, -1.0]}, "pair": pair}))
    fan = foci(window)[0].lens1
    n, radius = 1.5, 1.25
    assert fan.focus[0] == pytest.approx(n * radius / (n - 1.0), rel=1e-6)
    h = float(np.abs(fan.height).max())
    third = h * h / (2.0 * radius * n * (n - 1.0))
    assert foci(window)[0].length[0] == pytest.approx(3.0 * third, rel=0.12)


# -- ghosts ---------------------------------------------------------------------------------------


def test_the_ghost_map_follows_the_closed_form_and_all_light_is_somewhere(made):
    found = ghost_map(made.window)
    assert found.worst < 0.25
    assert np.abs(found.alive - found.closed_form).mean() < 0.05
    assert (found.alive + found.ghost <= 1.0 + 1e-12).all()


def test_the_closed_form_of_a_square_pair_is_a_product_of_two_triangles():
    """η = −1, aligned: both apertures are equal squares, their overlap (1 − |t|s/p) in each direction."""
    pair = {"form": "slab", "separation": 5.0, "index": 1.5}
    window = prescribe(Design.from_dict({**TEXT, "law": {"eta": [-1.0, -1.0]}, "pair": pair}))
    found = ghost_map(window)
    sx, sy = (np.clip(1.0 - np.abs(s) * 5.0 / 0.5, 0.0, 1.0) for s in found.slope)
    assert np.abs(found.closed_form - np.outer(sy, sx)).max() < 0.02


# -- the part in three dimensions -----------------------------------------------------------------


def test_the_packed_part_is_the_mesh_again(made):
    shown = parts(made.window)
    facts, text = packed(shown)
    facts, data = json.loads(facts), base64.b64decode(text)
    assert len(text) < 450_000
    for entry, piece in zip(facts["bodies"], shown.pieces, strict=True):
        v, t = entry["vertices"], entry["triangles"]
        assert v < 1 << 16
        place = np.frombuffer(data, "<i2", v * 4, entry["place"]).reshape(v, 4)[:, :3] * facts["unit"]
        normal = np.frombuffer(data, "i1", v * 4, entry["normal"]).reshape(v, 4)[:, :3] / 127.0
        index = np.frombuffer(data, "<u2", t * 3, entry["index"]).reshape(t, 3)
        corners = place[index]
        facet = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        large = np.linalg.norm(facet, axis=1) > 1e-3 * np.linalg.norm(facet, axis=1).max()
        facet = facet[large] / np.linalg.norm(facet[large], axis=1, keepdims=True)
        assert (np.einsum("tj,tkj->tk", facet, normal[index][large]) > 0.7).all()  # outward, as wound
        volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0
        assert volume > 0.0
        assert len(piece.triangles) == t


@pytest.mark.daily_cases("plano")
def test_the_picture_shows_every_body(made):
    from PIL import Image

    pixels = (
        np.asarray(Image.open(io.BytesIO(picture(parts(made.window)))).convert("RGB"))
        .reshape(-1, 3)
        .astype(int)
    )
    drawn = pixels[pixels.max(axis=1) < 240]
    assert 0.03 < len(drawn) / len(pixels) < 0.9
    blue, green = drawn[:, 2] > drawn[:, 1] + 5, drawn[:, 1] > drawn[:, 2] + 5
    assert blue.mean() > 0.05
    assert (green.mean() > 0.05) == (len(made.window.bodies) > 1)


def test_a_round_sheet_has_the_area_of_its_circle():
    from clacad.report.rows import fabrication_dict

    design = Design.from_dict({**TEXT, "lattice": {"pitch": 0.5, "count": 8, "outline": {"circle": 4.0}}})
    window = prescribe(design)
    assert fabrication_dict((), window, window)["footprint_mm2"] == pytest.approx(4.0 * pi)
