"""Non-uniform sheets as POV-Ray finds them: a renderer that knows nothing of cells, and the file's own numbers."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from povpictures import before_stripes, needs_povray, povray
from viewscenes import ROOT

import clacad
from clacad.cli.entry_point import main
from clacad.exporting.pov.pov_scene import NotForPov, pov_lines
from clacad.rendering import view_through
from clacad.rendering.screen_measure import sheet_points

AIM = {"lattice.aperture": {"point": [3, -2, -150]}}
CONIC = {"pair.surface": "biconic", "pair.conic": [-0.7, -0.7]}
DESIGNS = {
    "aimed": ("window-100mm", {"lattice.count": [13, 12], **AIM, **CONIC, "check.process": "none"}),
    "varying": (
        "window-100mm",
        {"lattice.count": [13, 12], "law.varying": {"f_image": 60}, "check.process": "none"},
    ),
    "other pitch": (
        "window-100mm",
        {"lattice.count": [13, 12], "lattice.pitch_2": 0.49, "check.process": "none"},
    ),
    "aimed steeply": (
        "window-100mm",
        {
            "lattice.count": [50, 9],
            "lattice.aperture": {"point": [0, 0, -100]},
            **CONIC,
            "check.process": "none",
        },
    ),
    "aimed hexagons in a disc": (
        "hexagonal",
        {"lattice.count": [16, 16], "lattice.outline": {"circle": 6.0}, **AIM},
    ),
    "aimed biconvex": (
        "window-100mm",
        {
            "lattice.count": [13, 12],
            **AIM,
            "pair.form": "biconvex",
            "pair.offset": "paraxial",
            "lattice.seam": 0.03,
            "pair.web": 0.05,
            "check.process": "none",
        },
    ),
    "aimed plano": (
        "plano",
        {"lattice.count": [12, 12], **AIM, "pair.offset": "paraxial", "lattice.seam": 0.02},
    ),
}


DESIGNS["the middle of one aimed steeply"] = (
    "window-100mm",
    DESIGNS["aimed steeply"][1] | {"lattice.count": [40, 40]},
)
VIEWS = {
    "aimed steeply": ([11, 0, 0], 3.0),
    "the middle of one aimed steeply": ([0.07, 0.05, 0], 3.03),
    "aimed biconvex": ([0, 0, 0], 7.1),  # at 7.0 a row of pixels lies along the edge of a row of lenses
}
"""Point and width of a camera's view; lenses at the rim lie lower than those in the middle."""


def scene_of(kind, pixels=120):
    design, changes = DESIGNS[kind]
    point = changes.get("lattice.aperture", {"point": [3, -2, -150]})["point"]
    target, frame = VIEWS.get(kind, ([0, 0, 0], 7.0))
    return before_stripes(
        "differing",
        {"design": f"designs/{design}.toml", "set": changes},
        {"position": point, "target": target, "frame": frame, "pixels": [pixels, pixels]},
    )


FEW = pytest.mark.slow
KINDS = [kind if kind in ("aimed", "varying") else pytest.param(kind, marks=FEW) for kind in DESIGNS]


@pytest.mark.ci_cases("other pitch", "aimed hexagons in a disc", "aimed plano")
@pytest.mark.daily_cases("varying")
@needs_povray
@pytest.mark.parametrize("kind", KINDS)
def test_a_sheet_of_cells_that_differ_shows_the_rays_that_povray_finds(kind, tmp_path):
    """Slabs, a plano and a biconvex pair, hexagons, land, a disc, lenses as a formula and as a table has them."""
    scene = scene_of(kind)
    off = np.abs(view_through(scene).light - povray(scene, tmp_path)).max(axis=-1)
    at, inside = sheet_points(scene, clacad.prescribe(scene.design()), off.shape)
    # rays of the outermost cells that end in the outer wall are black here and followed on there
    inner = inside & (np.abs(at) < 0.8 * np.abs(at[inside]).max(axis=0)).all(axis=1)
    assert (off.ravel()[inner] <= 3 / 255).mean() > 0.995
    assert inner.sum() > 1500


def numbers(text):
    return [float(word) for word in re.findall(r"[-+]?[0-9.]+(?:e[-+]?[0-9]+)?", text)]


@pytest.mark.parametrize("kind", ["aimed", "aimed hexagons in a disc"])
def test_the_lenses_stand_where_the_file_s_own_numbers_have_them(kind):
    """Loop, formula and table are computed here as POV-Ray computes them, and compared with every vertex."""
    scene = scene_of(kind)
    window = clacad.prescribe(scene.design())
    text = "\n".join(pov_lines(window, scene))
    held = re.search(r"#declare MOVED0 = array\[(\d+)\] \{(.*?)\n\}", text, re.S)
    table = np.array(numbers(held[2].replace("<", " ").replace(">", " "))).reshape(-1, 3)
    assert len(table) == int(held[1]) == window.lattice.cell_count
    loop = text[text.index("#macro Layer0b()") :]
    centre = re.search(r"#declare C = <(.*) \+ \(I(.*)\)\*(.*), (.*) \+ J\*(.*), 0>;", loop)
    place = re.search(r"Layer0b\(\) translate <(.*) \+ \(I(.*)\)\*(.*), (.*) \+ J\*(.*), 0>", loop)
    xx, xy, yx, yy, zero, units = numbers(
        re.search(r"#declare Move0 = <(.*)> \+ (.*)\*MOVED0", loop)
        .expand(r"\1 \2")
        .replace("C.x", "")
        .replace("C.y", "")
    )
    assert zero == 0.0
    assert units == 1000.0
    vertex = numbers(re.search(r"quadric .* matrix <(.*)> translate Move0", loop)[1])[9:]
    cells = window.lattice.cells()  # row by row, as the loops run
    i, j = cells.astype(float).T

    def at(found):
        x0, slant, px, y0, py = found.groups()
        column = i + (0.5 * j if slant else 0.0)
        return np.column_stack([float(x0) + column * float(px), float(y0) + j * float(py)])

    moved = at(centre) @ np.array([[xx, xy], [yx, yy]]).T + units * table[:, :2]
    lenses = window.vertices(window.faces[1], cells)
    want = 1000.0 * np.column_stack([window.centres(1, cells) + lenses[:, :2], lenses[:, 2]])
    stands = np.column_stack([at(place) + moved + vertex[:2], np.full(len(cells), vertex[2])])
    assert np.abs(stands - want).max() < 1e-9
    assert np.ptp(moved, axis=0).min() > 20.0  # a fiftieth of a millimetre and more


def test_only_a_table_of_vertices_makes_the_file_grow_with_the_sheet():
    design = scene_of("aimed").design()

    def size(offset, cells):
        lines = pov_lines(
            clacad.prescribe(design.replace("pair.offset", offset).with_cells((cells, cells))), None
        )
        return sum(len(line) + 1 for line in lines)

    assert abs(size("paraxial", 15) - size("paraxial", 3)) < 100
    assert 20 * 216 < size("traced", 15) - size("traced", 3) < 60 * 216


def test_a_conic_of_revolution_is_a_quadric_and_others_are_refused_in_words():
    design = scene_of("aimed").design()
    text = "\n".join(pov_lines(clacad.prescribe(design), None))
    c = 0.001 / 2.4681433642774
    a, b, kappa = numbers(re.search(r"quadric \{ <(.*?)>", text)[1])
    assert (a, b, kappa) == pytest.approx((c, c, 0.3 * c), rel=1e-9)
    with pytest.raises(NotForPov, match="cannot hold biconic or polynomial faces"):
        list(pov_lines(clacad.prescribe(design.replace("pair.conic", [-0.7, -0.6])), None))


@pytest.mark.parametrize(
    "changes",
    [
        {"lattice.rotation_2": "1 deg"},
        {"law.euler": [0, 3, 0], "law.varying": {"gradient": [[-4e-3, 0.0], [0.0, -4e-3]]}},
    ],
)
def test_turned_arrays_and_lenses_at_heights_of_their_own_are_refused_in_words(changes):
    design = clacad.load(ROOT / "designs" / "window-100mm.toml")
    window = clacad.prescribe(design.replace({"lattice.count": [5, 5], "check.process": "none", **changes}))
    with pytest.raises(NotForPov, match="arrays that are turned, or lenses at individual heights"):
        list(pov_lines(window, None))


@pytest.mark.parametrize("format", ["gds", "pov"])
def test_a_turned_array_is_refused_by_formats_that_do_not_hold_it(format, tmp_path):
    design = clacad.load(ROOT / "designs" / "window-100mm.toml")
    turned = design.replace({"lattice.count": [5, 5], "lattice.rotation_2": "1 deg"})
    with pytest.raises(ValueError, match=r"CL139.*held by: step") as refused:
        clacad.export(turned, tmp_path / "out", formats=(format,))
    assert f", {format}" not in str(refused.value)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_price_is_said_before_work_to_the_byte(tmp_path, capsys):
    design, changes = DESIGNS["aimed"]
    asked = [
        "export",
        str(ROOT / "designs" / f"{design}.toml"),
        "-o",
        str(tmp_path / "out"),
        "--format",
        "pov",
        "-q",
    ]
    for key, value in changes.items():
        asked += [
            "--set",
            f"{key}={json.dumps(value).replace(': ', ' = ').replace(chr(34) + 'point' + chr(34), 'point')}",
        ]
    assert main([*asked, "--dry-run", "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert not (tmp_path / "out").exists()
    assert main(asked) == 0
    assert row["bytes"] == (tmp_path / "out" / "window-100mm.pov").stat().st_size
    assert row["note"].startswith(
        "every cell differs: the places of 156 lenses are a table; POV-Ray reads it in"
    )
