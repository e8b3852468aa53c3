"""STEP files of plates listed face by face: layers of several media as solids that share their joints."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import hypot, sqrt

import numpy as np
import pytest

import clacad
from clacad.checks.file_kinds import PLACEMENT, SHAPE, SOLIDS, THROUGH_FILE, VOLUME
from clacad.formats.step.rays_through_faces import crossings, follow_patches, follow_rays
from clacad.formats.step.step_files import read_step, write_step
from clacad.formats.step.text_health import scan_step
from clacad.judging import step_light
from clacad.judging.delivery import Inspection
from clacad.judging.step_file import _checks_of_shape, judge_solid

HEAD = """format = 1
name = "{name}"
unit = "mm"
[law]
eta = [-1, -1]
[pair]
form = "plates"
wavelength = "546.1 nm"
{faces}
[lattice]
pitch = 0.5
count = {count}
{edges}
[check]
field = "1.0 deg"
"""

FACES = {
    "flat": [  # silica | N-SF6 | silica, joints without power
        (0.0, 2.3006771, -0.449236722, 1, "Fused silica"),
        (1.65260254, None, 0.0, None, "N-SF6"),
        (15.6758003, None, 0.0, None, "Fused silica"),
        (17.3284028, -2.3006771, -0.449236722, 2, "air"),
    ],
    "curved": [  # PMMA | polystyrene | PMMA, joints on the arrays
        (0.0, 2.29629077, -0.373266996, 1, "PMMA"),
        (1.0, -5.11080418, 0.0, 1, "PS"),
        (14.8294173, 5.11080418, 0.0, 2, "PMMA"),
        (15.8294173, -2.29629077, -0.373266996, 2, "air"),
    ],
    "two": [  # two plates, their inner faces on the arrays
        (0.0, 0.733276291, -1.06203256, 1, "PMMA"),
        (1.49190384, -0.425388892, -3.04632891, 1, "air"),
        (2.10953316, 0.425388892, -3.04632891, 2, "PMMA"),
        (3.601437, -0.733276291, -1.06203256, 2, "air"),
    ],
    "layers": [  # two planes between two media next to two planes of others
        (0.0, 2.3006771, -0.449236722, 1, "Fused silica"),
        (1.65260254, None, 0.0, None, "N-SF6"),
        (8.65260254, None, 0.0, None, "N-BK7"),
        (15.6526025, None, 0.0, None, "Fused silica"),
        (17.3284028, -2.3006771, -0.449236722, 2, "air"),
    ],
}
FACES["seamed"] = FACES["curved"]
EDGES = {"seamed": "seam = 0.02\n[body]\nborder = 0.5"}


def text_of(name, count=(3, 2)):
    parts = []
    for z, radius, conic, array, behind in FACES[name]:
        lines = ["[[pair.face]]", f"z = {z}" if z else "", f'behind = "{behind}"']
        lines += ['radius = ["inf", "inf"]'] if radius is None else [f"radius = [{radius}, {radius}]"]
        lines += [] if radius is None else [f"conic = [{conic}, {conic}]", f"array = {array}"]
        parts.append("\n".join(filter(None, lines)))
    return HEAD.format(name=name, faces="\n".join(parts), count=list(count), edges=EDGES.get(name, ""))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Each sheet: its design, its window and its fused file."""
    folder = tmp_path_factory.mktemp("plates")
    found = {}
    for name in FACES:
        (folder / f"{name}.toml").write_text(text_of(name))
        design = clacad.load(str(folder / f"{name}.toml"))
        window = clacad.prescribe(design)
        write_step(window, folder / f"{name}.step", mode="fused")
        found[name] = design, window, folder / f"{name}.step"
    return found


def judged(made, stated):
    design, window, path = made
    checks, _ = judge_solid(Inspection(design, "file.step", 256, stated=stated), window, path)
    return {check.kind: check for check in checks}


def shape_of(made, path=None):
    """Checks of what the reader finds in a file, without light."""
    design, window, own = made
    found = read_step(path or own, window)
    found["holds_words"] = ""
    return {
        check.kind: check for check in _checks_of_shape(Inspection(design, "file.step", 1), window, found)
    }


def sag(radius, conic, r2):
    return 0.0 if radius is None else r2 / (radius * (1.0 + np.sqrt(1.0 - (1.0 + conic) * r2 / radius**2)))


def height_under(face, half=0.25, nodes=24):
    """Mean height of a listed face over its square cell, from the sag formula of a conic."""
    z, radius, conic, *_ = face
    t, w = np.polynomial.legendre.leggauss(nodes)
    x, y = np.meshgrid(half * t, half * t)
    return z + float((np.outer(w, w) * sag(radius, conic, x**2 + y**2)).sum()) / 4.0


SEAM, BORDER, DEPTH = 0.02, 0.5, 0.01  # of "seamed": the land lies a fiftieth of the pitch beyond the lens


def content_under(name, face, first):
    """Integral of the height of a listed face over 3 x 2 cells; beyond the lenses of "seamed" it is land."""
    if name != "seamed":
        return height_under(face) * 6 * 0.25
    z, radius, conic, *_ = face
    half = 0.5 * (0.5 - SEAM)
    ends = z, z + sag(radius, conic, 2.0 * half**2)
    land = max(ends) + DEPTH if first else min(ends) - DEPTH
    lenses = 6 * (2.0 * half) ** 2
    return height_under(face, half) * lenses + land * ((1.5 + 2 * BORDER) * (1.0 + 2 * BORDER) - lenses)


@pytest.mark.daily_cases("flat")
@pytest.mark.parametrize("name", FACES)
def test_every_layer_is_a_solid_of_its_own_with_the_volume_of_the_closed_form(made, name):
    """The land of a joint is that of the face before it: behind the lens, seen from the light."""
    _, window, path = made[name]
    found = read_step(path, window)
    under = [content_under(name, face, k == 0) for k, face in enumerate(FACES[name])]
    listed = [face[4] for face in FACES[name]]
    want = [under[k + 1] - under[k] for k in range(len(listed)) if listed[k] != "air"]
    names = [body.name for body in window.bodies]
    assert found["solids"] == found["kernel_solids"] == len(want) == len(names)
    assert found["valid"]
    assert not found["open_edges"]
    assert not found["dangling"]
    assert found["volume"] == pytest.approx(sum(want), rel=1e-9)
    if name != "two":
        assert [found["volumes"][one] for one in names] == pytest.approx(want, rel=1e-9)
    assert set(names) <= set(found["names"])


def test_the_tree_of_the_file_has_a_part_for_every_plate_with_its_layers_named_after_their_media(made):
    from build123d import import_step

    flat, two = (import_step(str(made[name][2])) for name in ("flat", "two"))
    assert flat.label == "flat"
    assert [part.label for part in flat.children] == ["plate1"]
    assert [part.label for part in two.children] == ["plate1", "plate2"]
    layers = [solid.label for solid in flat.children[0].children]
    assert layers == ["plate1-1-fused-silica", "plate1-2-n-sf6", "plate1-3-fused-silica"]


def test_both_layers_of_a_joint_have_the_same_patches_to_the_last_bit_of_the_text(made):
    scan = scan_step(made["curved"][2])
    at = dict(zip(scan.points.ids, np.array(scan.points.values).reshape(-1, 3).tolist(), strict=True))
    poles = [sorted(at[n] for n in numbers) for numbers, _, _ in scan.patches.values()]
    assert len(poles) == 3 * 2 * 6
    front_and_back = [one for one in poles if 0.5 < np.mean(one, axis=0)[2] < 15.5]
    once = {tuple(map(tuple, one)) for one in front_and_back}
    assert len(front_and_back) == 2 * len(once) == 24  # each patch of a joint twice, once in either layer


def through(name, window, position, direction):
    """Exit directions of rays in the frame of their cell by Snell's law at the listed faces."""
    inside, out = iter([body.index for body in window.bodies]), []
    index = [1.0] + [1.0 if face[4] == "air" else next(inside) for face in FACES[name]]
    for p, d in zip(np.array(position), np.array(direction), strict=True):
        d = d / np.linalg.norm(d)
        for (z, radius, conic, *_), before, after in zip(FACES[name], index[:-1], index[1:], strict=True):
            for _ in range(60):
                p = p + d * ((z + sag(radius, conic, p[0] ** 2 + p[1] ** 2) - p[2]) / d[2])
            r = hypot(p[0], p[1])
            slope = 0.0 if radius is None else 1.0 / (radius * sqrt(1.0 - (1.0 + conic) * (r / radius) ** 2))
            normal = np.array([-slope * p[0], -slope * p[1], 1.0])
            normal /= np.linalg.norm(normal)
            m, c = before / after, float(normal @ d)
            d = m * d + (sqrt(1.0 - m * m * (1.0 - c * c)) - m * c) * normal
        out.append(d)
    return np.array(out)


@pytest.mark.parametrize("mode", ["fused", "instanced"])
@pytest.mark.parametrize("name", FACES)
def test_rays_through_the_faces_of_the_file_refract_once_at_a_joint(made, tmp_path, name, mode):
    _, window, path = made[name]
    if mode == "instanced":
        path = tmp_path / "file.step"
        write_step(window, path, mode="instanced")
    draw = np.random.default_rng(4)
    place = np.column_stack([draw.uniform(-0.2, 0.2, (12, 2)), np.full(12, -0.5)])
    way = np.column_stack([draw.uniform(-0.002, 0.002, (12, 2)), np.ones(12)])
    place[:, :2] -= 0.5 * way[:, :2]
    want, column = through(name, window, place, way), ((-0.3, -0.05), (0.3, 0.55))
    faces, sent = crossings(window, window.bodies), place + [0.0, 0.25, 0.0]
    numbers = [n for n in range(2 * len(window.bodies)) if n % 2 or not window.bodies[n // 2].joined]
    assert len(faces) == len(numbers) == len(FACES[name])
    by_occ = follow_rays(path, sent, way, faces, *column)
    by_text = follow_patches(path, sent, way, faces, *column, window, numbers)
    for found in (by_occ, by_text):
        assert found["end"] == [0] * 12
        assert set(found["crossings"]) == {len(faces)}
        assert np.abs(np.array(found["direction"]) - want).max() < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize("name", ["flat", "curved", pytest.param("seamed", marks=pytest.mark.slow)])
def test_a_right_file_passes_and_its_light_is_that_of_the_design(made, monkeypatch, name):
    monkeypatch.setattr(step_light, "POINT_RAYS", 256 if name == "seamed" else 64)
    checks = judged(made[name], stated={"solids": len(made[name][1].bodies)})
    assert {
        kind.id: one.sentence for kind, one in checks.items() if one.state not in ("pass", "not run")
    } == {}
    assert all(checks[kind].state == "pass" for kind in (SOLIDS, SHAPE, VOLUME, PLACEMENT, *THROUGH_FILE[:3]))


def moved(window, number, side, by):
    """The window with one face of one body moved along z."""
    bodies = list(window.bodies)
    face = getattr(bodies[number], side)
    x, y, z = face.vertex
    bodies[number] = replace(bodies[number], **{side: replace(face, vertex=(x, y, z + by))})
    return replace(window, bodies=tuple(bodies))


def wrong_in(made, tmp_path, window):
    path = tmp_path / "wrong.step"
    write_step(window, path, mode="fused")
    return {kind for kind, one in shape_of(made, path).items() if one.state == "fail"}


@pytest.mark.daily_cases("flat-kind0")
@pytest.mark.parametrize(("name", "kind"), [("flat", VOLUME), ("curved", SHAPE), ("seamed", SHAPE)])
def test_a_joint_five_micrometres_off_in_one_layer_is_found(made, tmp_path, name, kind):
    window = made[name][1]
    for number, side in ((0, "back"), (1, "front")):
        assert kind in wrong_in(made[name], tmp_path, moved(window, number, side, 5e-3))


def test_a_flat_joint_off_in_both_layers_is_found_although_the_whole_volume_is_right(made, tmp_path):
    both = moved(moved(made["flat"][1], 0, "back", 5e-3), 1, "front", 5e-3)
    assert VOLUME in wrong_in(made["flat"], tmp_path, both)


@pytest.mark.ci_cases("0-curved", "1-flat", "2-seamed")
@pytest.mark.daily_cases("0-flat", "2-flat")
@pytest.mark.parametrize("name", ["flat", "curved", "seamed"])
@pytest.mark.parametrize("lost", [0, 1, 2])
def test_a_missing_layer_is_named(made, tmp_path, name, lost):
    window, path = made[name][1], tmp_path / "wrong.step"
    write_step(
        replace(window, bodies=tuple(b for k, b in enumerate(window.bodies) if k != lost)), path, mode="fused"
    )
    check = shape_of(made[name], path)[SOLIDS]
    assert check.state == "fail"
    assert window.bodies[lost].name in check.sentence


@pytest.mark.daily_cases("flat")
@pytest.mark.parametrize("name", ["flat", "curved", "seamed"])
def test_exchanged_materials_are_found(made, tmp_path, name):
    _, window, path = made[name]
    one, two = (body.name for body in window.bodies[:2])
    text = path.read_text().replace(one, "-").replace(two, one).replace("'-'", f"'{two}'")
    assert shape_of(made[name])[SOLIDS].state != "fail"
    other = tmp_path / "wrong.step"
    other.write_text(text)
    check = shape_of(made[name], other)[SOLIDS]
    assert check.state == "fail"
    assert two in check.sentence


def test_two_layers_of_planes_that_exchange_their_names_are_found(made, tmp_path):
    _, window, path = made["layers"]
    one, two = (body.name for body in window.bodies[1:3])
    assert shape_of(made["layers"])[SOLIDS].state != "fail"
    other = tmp_path / "wrong.step"
    other.write_text(path.read_text().replace(one, "-").replace(two, one).replace("'-'", f"'{two}'"))
    sentence = shape_of(made["layers"], other)[SOLIDS].sentence
    assert f"named {one} lies where the design has {two}" in sentence
    assert f"named {two} lies where the design has {one}" in sentence


def test_the_drawing_lists_volume_and_mass_of_every_layer_and_the_outer_sizes_of_every_plate(made):
    from clacad.exporting.drawing.canvas import Words
    from clacad.exporting.drawing.drawing_tables import layers_table

    words = [mark.words for mark in layers_table(made["flat"][1]).marks if isinstance(mark, Words)]
    rows = [words[k : k + 6] for k in range(1, len(words), 6)]
    assert [row[0] for row in rows[1:]] == [*(body.name for body in made["flat"][1].bodies), "plate1"]
    heights = [height_under(face) for face in FACES["flat"]]
    volumes = [(b - a) * 1.5 for a, b in pairwise(heights)]
    density = {"Fused silica": 2.2, "N-SF6": 3.36}  # g/cm^3, of the makers' data sheets
    for row, volume in zip(rows[1:], [*volumes, sum(volumes)], strict=True):
        assert float(row[4]) == pytest.approx(volume, rel=1e-5)
        if row[1] in density:
            assert float(row[5]) == pytest.approx(1e-3 * density[row[1]] * volume, rel=0.01)
    assert [float(one) for one in rows[-1][3].split(", ")] == pytest.approx([1.5, 1.0, 17.3284028], abs=1e-3)
    assert float(rows[1][2]) == pytest.approx(1.65260254, abs=1e-3)


def test_a_layer_between_planes_is_a_prism_of_the_outline(tmp_path):
    (tmp_path / "edged.toml").write_text(text_of("flat") + "[body]\nborder = 1.0\n")
    window = clacad.prescribe(clacad.load(str(tmp_path / "edged.toml")))
    facts = write_step(window, tmp_path / "edged.step", mode="fused")
    found = read_step(tmp_path / "edged.step", window)
    layer = window.bodies[1].name
    assert next(body["faces"] for body in facts["bodies"] if body["name"] == layer) == {"plane": 2, "side": 4}
    assert found["volumes"][layer] == pytest.approx(3.5 * 3.0 * (15.6758003 - 1.65260254), rel=1e-12)
