"""The atlas: every figure's row holds in the rendered picture, and the page records it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from viewscenes import ROOT

from clacad.paper import paper_figures
from clacad.paper.figure1 import MeasuredLenses, quadrics, section_findings, section_svg, solid_findings
from clacad.paper.make_atlas import (
    Atlas,
    AtlasRequest,
    Movie,
    atlas_seconds,
    make_atlas,
    page_of,
    parameters,
    prepare,
)
from clacad.paper.paper_figures import AtlasFinding
from clacad.paper.sheet_figures import FIELD_LENS, ghosts_marked
from clacad.rendering.picture_files import label_lines, labelled
from clacad.scene import SceneError, load_scene

SCENES = ROOT / "designs" / "scenes"


def load(stem):
    return load_scene(SCENES / f"{stem}.toml")


def held(figure):
    found = list(figure.check(load))
    assert found
    bad = [one for one in found if not one.passed]
    assert not bad, bad


SLOW = ("F5",)
"""The row that turns the sheet step by step; the others take a second or two each."""


@pytest.mark.slow
@pytest.mark.ci_cases("F3", "F4", "F6", "F7", "F8")
@pytest.mark.parametrize(
    "figure", [f for f in paper_figures.FIGURES if f.row not in SLOW], ids=lambda f: f.row
)
def test_a_figure_shows_what_the_paper_says(figure):
    held(figure)


@pytest.mark.long
@pytest.mark.parametrize("figure", [f for f in paper_figures.FIGURES if f.row in SLOW], ids=lambda f: f.row)
def test_a_movie_s_figure_shows_what_the_paper_says(figure):
    held(figure)


@pytest.mark.slow
def test_the_first_figure_s_section_and_solids_are_what_the_paper_says():
    found = [*section_findings(load("fig1a")), *solid_findings(load("fig1b"))]
    assert [one for one in found if not one.passed] == []
    assert {"array 1: lenses", "array 2: watertight (1)"} <= {one.what for one in found}


def test_ellipsoids_are_found_again_from_points_on_them():
    from scipy.spatial.transform import Rotation

    radii, kappa = np.array([0.03, 0.011]), 50.0
    half = np.array([*np.sqrt(radii / kappa), 1.0 / kappa])  # R = a²/c, c = 1/κ
    turn = Rotation.from_euler("zxz", [40.0, 1.5, 75.0], degrees=True).as_matrix()  # fixed axes: φ, θ, ψ
    x, y = np.meshgrid(np.linspace(-0.004, 0.004, 9), np.linspace(-0.003, 0.005, 9))
    z = half[2] * (1.0 - np.sqrt(1.0 - (x / half[0]) ** 2 - (y / half[1]) ** 2))
    place = np.array([0.3, -0.2, 0.1])
    points = np.stack([x, y, z], axis=2).reshape(-1, 3) @ turn.T + place
    vertex, frame, found = quadrics(points[None], flatter_x=True)
    np.testing.assert_allclose(found[0], radii, rtol=1e-6)
    np.testing.assert_allclose(vertex[0], place, atol=1e-9)
    angles = MeasuredLenses(vertex, frame, found).euler()
    np.testing.assert_allclose(np.degrees([a[0] for a in angles]), [40.0, 1.5, 75.0], atol=1e-4)


@pytest.mark.slow
def test_no_place_on_a_sheet_that_is_not_tilted_loses_the_piece():
    """The check of the zones in which nothing is seen is no decoration: without a tilt the axis point stays in view."""
    flat = load("fig8-z-60").replace({"sheet.set": {"law.euler": [45.0, 0.0, 90.0]}})
    unseen = [one for one in paper_figures.visibility(flat) if "not seen" in one.what]
    assert len(unseen) == len(paper_figures.UNSEEN)
    assert not any(one.passed for one in unseen)


def test_the_law_alone_says_where_the_piece_of_figure_8_leaves_the_sheet():
    """From the closed form X = A + M x₀ with Q of the paper's angles, solved by hand for |x₀|, |y₀| = 1/2."""
    phi, theta, psi, D = np.radians(45.0), np.radians(0.5), np.radians(90.0), 20.0
    angle = phi + psi
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    Q = turn @ np.diag([-4.0, -1.0]) @ turn.T
    tilt = np.array([np.sin(psi) * np.sin(theta), -np.cos(psi) * np.sin(theta)]) / np.cos(theta)
    edges = paper_figures.unseen_zones(load("fig8-z-60"))
    assert len(edges) == 4
    for z in edges:
        at = np.linalg.solve(np.eye(2) + z / D * Q, -z * (tilt - Q @ tilt))
        assert np.abs(at).max() == pytest.approx(0.5, abs=0.004)


def test_the_scenes_of_paper_figures_have_the_paper_s_global_numbers():
    for path in SCENES.glob("fig[2-8]*.toml"):
        scene = load(path.stem)
        design = scene.design()
        assert scene.camera.position == (0.0, 0.0, -20.0), path.stem
        assert (design.lattice.count, design.lattice.pitch) == ((200, 200), (0.005, 0.005)), path.stem
        assert (design.pair.separation, design.pair.form) == (0.05, "biconvex"), path.stem
        assert design.pair.thickness == 0.0005, path.stem
        assert {thing.id for thing in scene.objects} == {"floor", "pedestal", "knight"}, path.stem
        floor = next(thing for thing in scene.objects if thing.kind == "checker")
        assert floor.tile == 1.0
        assert floor.colours[0] != floor.colours[1]


@pytest.mark.parametrize(
    ("stem", "first", "last"),
    [("fig3-movie", "z = -2", "z = 38"), ("fig5-movie", "phi = 0°", "phi = 180°"),
     ("fig7-movie", "psi = 0°", "psi = 360°"), ("fig8-movie", "z = -2", "z = 38")],
)  # fmt: skip
def test_a_movie_goes_from_end_to_end_and_every_frame_says_where_it_is(stem, first, last):
    title = dict(paper_figures.MOVIES)[stem]
    scene = load(stem)
    movie = Movie(stem, title, 25.0, tuple(scene.at(k) for k in range(0, scene.animation.frames, 8)))
    labels = movie.labels()
    assert first in labels[0].split(": ")[1].split(", ")
    assert last in labels[-1].split(", ")
    assert len(set(labels)) == len(labels)
    assert len({label.count("=") for label in labels}) == 1
    for label in labels:
        for line in label_lines(label, 220):
            assert not line.endswith("=")
            assert not line.startswith("=")


@pytest.mark.parametrize("figure", paper_figures.FIGURES, ids=lambda f: f.row)
def test_a_figure_s_pictures_are_labelled_with_what_their_scenes_show(figure):
    for stem, label in figure.scenes:
        told = parameters(load(stem))
        for part in label.replace("eta_x = ", "eta = (").split(", z"):
            assert part.rstrip(")").split(", ")[0] in told, (label, told)


def test_a_label_fits_below_its_picture_and_frames_are_equally_high():
    text = "Fig. 8: eta = (-0.25, -1), phi = 45°, theta = 0.5°, psi = 90°, z = 24.5"
    lines = label_lines(text, 220)
    assert " ".join(lines) == text
    assert len(lines) > 1
    pixels = np.full((50, 220, 3), 9, dtype=np.uint8)
    long, short = labelled(pixels, text, len(lines)), labelled(pixels, "z = 1", len(lines))
    assert long.shape == short.shape
    assert (long[50:, -2:] == 255).all()  # no letter runs over the edge
    assert (long[-1] == 255).all()


def test_every_scene_of_the_atlas_is_in_a_figure_or_is_a_movie():
    named = {stem for figure in paper_figures.FIGURES for stem, _ in figure.scenes} | {
        stem for stem, _ in paper_figures.MOVIES
    }
    assert named | {"fig1a", "fig1b"} == {path.stem for path in SCENES.glob("fig*.toml")}


def test_every_scene_of_a_paper_figure_is_drawn_left_handed_as_the_paper_s_renderer_draws():
    for path in SCENES.glob("fig[2-8]*.toml"):
        assert load(path.stem).camera.mirror, path.stem


@pytest.mark.slow
def test_a_measured_row_fails_when_the_sheet_is_another(monkeypatch):
    """The check is no decoration: η_x = −0.3 instead of −0.25 is noticed."""

    def other(stem):
        scene = load(stem)
        eta = scene.design().law_spec.eta
        return scene.replace({"sheet.set": {"law.eta": [eta[0] * 1.2, eta[1]]}})

    squash = next(figure for figure in paper_figures.FIGURES if figure.row == "F2")
    assert not all(one.passed for one in squash.check(other))


def test_winding_counts_turns():
    def spun(degrees, stretch):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        turn = np.array([[c, -s], [s, c]])
        return np.linalg.inv(turn @ np.diag(stretch) @ turn.T)

    angles = np.linspace(0.0, 180.0, 19)
    assert abs(paper_figures.winding([spun(a, (-1.0, 2.0)) for a in angles])) == pytest.approx(360.0)
    assert paper_figures.winding([spun(a, (1.0, 2.0)) for a in angles]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_an_atlas_holds_figures_measurements_and_a_page_and_can_be_made_again(tmp_path):
    request = AtlasRequest(SCENES, tmp_path / "a", size=48, samples=1, movies=False, rows=("F4",))
    atlas = make_atlas(prepare(request))
    assert atlas.passed
    made = {path.name: path.read_bytes() for path in (tmp_path / "a").iterdir()}
    assert {f"fig4-delta-{d}.png" for d in ("0-0.01", "0.005-0.01", "0.01-0", "m0.005-0.005")} < set(made)
    page = made["index.html"].decode()
    for name in re.findall(r'src="([^"]+)"', page):
        assert name in made
    record = json.loads(made["atlas.json"])
    assert record["passed"]
    assert len(record["rows"]["F4"]) == 12
    make_atlas(prepare(request))
    assert {path.name: path.read_bytes() for path in (tmp_path / "a").iterdir()} == made


HOSTILE = """<script>alert("x")</script> ' onerror='y' & <img src=z>"""


class Parsed(HTMLParser):
    """Tags, attributes and text of a page."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.text = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text.append(data)


def test_names_in_the_page_are_text_and_it_loads_nothing_but_its_pictures():
    figure = paper_figures.Figure(HOSTILE, HOSTILE, HOSTILE, ((HOSTILE, HOSTILE),), lambda load: iter(()))
    finding = AtlasFinding(HOSTILE, 1.0, 1.0, 0.1)
    page = Parsed(
        page_of([figure], {HOSTILE: (finding,)}, [(HOSTILE, HOSTILE)], ["fig1a.svg", "fig1b.png", HOSTILE])
    )
    allowed = {"html", "head", "meta", "title", "style", "body", "h1", "h2", "p", "figure", "img", "figcaption",
               "table", "tr", "th", "td"}  # fmt: skip
    assert {tag for tag, _ in page.tags} <= allowed
    for tag, attributes in page.tags:
        assert not [key for key in attributes if key.startswith("on")], (tag, attributes)
    assert "".join(page.text).count(HOSTILE) >= 4
    assert [a["src"] for tag, a in page.tags if tag == "img"].count(f"{HOSTILE}.png") == 1
    policy = next(a["content"] for tag, a in page.tags if a.get("http-equiv") == "Content-Security-Policy")
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["img-src"] == "'self'"
    assert "script-src" not in rules


def test_a_design_s_name_is_text_in_the_section():
    from xml.etree import ElementTree

    scene = load("fig1a")
    for change in ({"name": HOSTILE}, {"sheet.set": {**dict(scene.sheet.set), "name": HOSTILE}}):
        with pytest.raises(SceneError, match="name"):  # no file brings such a name as far as this
            scene.replace(change).design()
    design = replace(scene.design(), name=HOSTILE)
    tree = ElementTree.fromstring(section_svg(design))
    space = "{http://www.w3.org/2000/svg}"
    assert {e.tag for e in tree.iter()} <= {
        space + tag for tag in ("svg", "style", "defs", "marker", "path", "rect", "polygon", "polyline", "circle", "text")
    }  # fmt: skip
    assert any(HOSTILE in (e.text or "") for e in tree.iter(space + "text"))


def test_a_long_atlas_says_first_how_long_it_takes(tmp_path, monkeypatch, capsys):
    from clacad.cli.accuracy_command import MakeAtlas
    from clacad.cli.accuracy_command import run_atlas as run
    from clacad.cli.console import Console
    from clacad.paper import make_atlas as atlas

    monkeypatch.setattr(atlas, "make_atlas", lambda job, progress: Atlas(job.request.out, {}, ()))
    for size, quiet in ((440, False), (440, True), (16, False)):
        request = MakeAtlas(
            scenes=SCENES,
            out=tmp_path / "a",
            size=size,
            samples=64,
            movies=False,
            rows=("F2",),
            measure=False,
        )
        assert run(request, Console(json=True, quiet=quiet)) == 0
        said = capsys.readouterr()
        assert json.loads(said.out)["passed"]
        told = re.search(r"this takes (\S+)–(\S+) (s|min) of processor time", said.err)
        assert bool(told) == (size == 440 and not quiet)
        if told:
            assert float(told[1]) < float(told[2])


@pytest.mark.slow
def test_the_forecast_of_an_atlas_grows_with_what_is_asked():
    def asked(**options):
        return atlas_seconds(prepare(AtlasRequest(SCENES, Path("x"), **options)))

    still = asked(rows=("F6",), movies=False, measured=False)
    assert asked(rows=("F6",), movies=False) > still
    assert asked(rows=("F6",), movies=False, measured=False, samples=64) > 2.0 * still
    assert asked(rows=("F5",), measured=False) > 5.0 * asked(rows=("F5",), movies=False, measured=False)


def test_the_section_is_drawn_from_traced_rays_that_meet_in_one_point():
    svg = section_svg(load("fig1a").design())
    rays = [
        np.array([[float(v) for v in point.split(",")] for point in line.split()])
        for line in re.findall(r'class="ray" points="([^"]+)"', svg)
    ]
    assert len(rays) >= 5
    x, y = (float(re.search(rf'class="dot"[^>]* {k}="([^"]+)"', svg)[1]) for k in ("cx", "cy"))
    for ray in rays:  # start, four faces, end: between lens 1 and lens 2 every ray passes the focus
        a, b = ray[2], ray[3]
        across = (b - a) / np.linalg.norm(b - a)
        off = (np.array([x, y]) - a) @ np.array([-across[1], across[0]])
        assert abs(off) < 6.0  # of 900 drawing units: spherical aberration of thick lenses
    starts = [ray[1] - ray[0] for ray in rays]
    ends = [ray[-1] - ray[-2] for ray in rays]
    for bundle, slack in ((starts, 1e-3), (ends, 0.05)):
        slopes = [v[1] / v[0] for v in bundle]
        assert np.ptp(slopes) < slack  # parallel in, parallel out
    law_error = float(re.search(r"Ideal lenses obey the law to ([0-9.e+-]+) rad", svg)[1])
    assert law_error < 1e-12


def run(*arguments, cwd=ROOT):
    return subprocess.run(
        [sys.executable, "-m", "clacad", *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=cwd,
        check=False,
    )


@pytest.mark.slow
def test_render_of_a_movie_tells_each_frame_in_json(tmp_path):
    out = tmp_path / "x.webp"
    done = run("render", SCENES / "fig3-movie.toml", "-o", out, "--pixels", 16, "--samples", 2, "--json",
               "--set", "animation.frames=3")  # fmt: skip
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told == {"files": [str(out)], "frames": [{"rays": 2 * 16 * 16, "rung": "surfaces"}] * 3}
    with Image.open(out) as movie:
        assert movie.n_frames == 3


@pytest.mark.slow
def test_render_writes_a_picture_says_how_and_refuses_to_overwrite(tmp_path):
    out = tmp_path / "x.png"
    scene = SCENES / "fig3-z-8.toml"
    done = run("render", scene, "-o", out, "--pixels", 32, "--samples", 1, "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)["pictures"][0]
    assert told["samples"] == 32 * 32
    assert told["metadata"]["clacad:rung"].startswith("surfaces")
    with Image.open(out) as picture:
        assert picture.format == "PNG"
        assert picture.size == (32, 32)
        assert {key: picture.text[key] for key in told["metadata"]} == told["metadata"]
    assert told["file"] == str(out)
    assert told["error"] == 0.0  # one sample: no error is known
    assert told["plan"]["rung"] == "surfaces"
    assert told["metadata"]["clacad:effects"] == told["plan"]["summary"]
    again = run("render", scene, "-o", out, "--pixels", 32, "--samples", 1)
    assert again.returncode == 4
    assert "overwrite" in again.stderr


@pytest.mark.ci_cases(
    "arguments1-cannot read the scene", "arguments3-camera.frame", "arguments7-there is no row F9"
)
@pytest.mark.daily_cases("arguments4-there is no preset", "arguments5-PHOTO")
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["render", "designs/scenes/fig3-z-8.toml", "-o", "x.jpg"], "a picture is one of"),
        (["render", "designs/scenes/nothing.toml", "-o", "x.png"], "cannot read the scene"),
        (["render", "designs/paper-base.toml", "-o", "x.png"], "is a design, which has no camera"),
        (
            ["render", "designs/scenes/fig3-z-8.toml", "-o", "x.png", "--set", "camera.frame=-1"],
            "camera.frame",
        ),
        (["render", "designs/scenes/fig3-z-8.toml", "-o", "x.png", "--preset", "ear"], "there is no preset"),
        (["render", "designs/paper-base.toml", "-o", "x.png", "--preset", "eye"], "PHOTO"),
        (["atlas", "-o", "x", "--scenes", "nowhere"], "there is no such folder"),
        (["atlas", "-o", "x", "--rows", "F9"], "there is no row F9"),
    ],
)
def test_bad_input_ends_with_status_2_and_one_sentence(arguments, words):
    done = run(*arguments)
    assert done.returncode == 2, done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert not Path(ROOT / "x.png").exists()


@pytest.mark.slow
def test_the_atlas_is_made_in_any_folder(tmp_path):
    done = run(
        "atlas",
        "-o",
        "x",
        "--rows",
        "F4",
        "--size",
        32,
        "--samples",
        1,
        "--no-movies",
        "--no-measure",
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "x").glob("fig4-*.png"))) == 4


@pytest.mark.slow
def test_an_eye_sees_a_photograph_before_and_after(tmp_path):
    photo = tmp_path / "photo.png"
    Image.fromarray(np.tile(np.arange(0, 250, 10, dtype=np.uint8)[None, :, None], (25, 1, 3))).save(photo)
    design = tmp_path / "sheet.toml"
    design.write_text((ROOT / "designs" / "window-100mm.toml").read_text())
    out = tmp_path / "eye.png"
    done = run("render", "--preset", "eye", design, photo, "-o", out, "--eye", "400 mm", "--distance", "20 cm",
               "--pixels", 60, "--samples", 4)  # fmt: skip
    assert done.returncode == 0, done.stderr
    after, before = (
        np.asarray(Image.open(tmp_path / name)).astype(float) for name in ("eye.png", "eye-without.png")
    )
    rise = np.diff(before[20:40].mean(axis=(0, 2)))
    assert rise[5:-5].mean() > 0.5  # brighter to the right, as in the photograph
    inside = np.diff(after[25:35, 20:40].mean(axis=(0, 2))).mean()
    assert (
        inside > 0
    )  # eta = -1 seen from 400 mm with the picture at 200 mm: upright, (1 + 200/400)/(1 - 200/400) as large
    np.testing.assert_allclose(after[:, :3], before[:, :3], atol=6)  # around the sheet nothing changes


@pytest.mark.slow
def test_a_field_lens_keeps_the_light_that_ghosts_take_without_one():
    held(FIELD_LENS)
    for stem, _ in FIELD_LENS.scenes:
        scene = load(stem)
        camera = replace(scene.camera, pixels=(56, 56), samples=2)
        picture = ghosts_marked(replace(scene, camera=camera)).light[10:46, 10:46]
        pink = np.mean((picture[..., 0] > 3.0 * picture[..., 1]) & (picture[..., 2] > picture[..., 1]))
        assert (pink > 0.2) == (stem in ("no-field-lens-1.5", "no-field-lens-2.5"))


def test_every_scene_of_the_field_lens_figure_is_there_and_differs_by_it_alone():
    for stem, label in FIELD_LENS.scenes:
        design = load(stem).design()
        assert design.pair.field_lens == ("with a" in label)
        other = load(stem.replace("no-", "")).design()
        assert design.replace("pair.field_lens", True) == other


def test_a_circle_marks_the_piece_of_figure_8_where_the_paper_has_it():
    """The axis point at z = 60 is seen at (0.381, 0.143) tiles; the picture is 1.1 tiles wide and left-handed."""
    from clacad.paper.make_atlas import circled
    from clacad.paper.paper_figures import piece_on_sheet

    scene = load_scene(SCENES / "fig8-z-60.toml").replace("object.knight.at", [0.0, 0.0, 60.0])
    place, half = piece_on_sheet(scene)
    assert np.abs(place - [0.381, 0.143]).max() < 5e-3
    assert 0.5 * 0.42 * 0.45 < half < 0.5 * 0.42 * 0.55  # the larger stretch is -1/2
    blank = np.zeros((440, 440, 3), np.uint8)
    rows, columns = np.nonzero(circled(blank, scene)[..., 0])
    assert abs(0.5 * (columns.min() + columns.max()) - 440 * (0.5 + 0.381 / 1.1)) < 4
    assert abs(0.5 * (rows.min() + rows.max()) - 440 * (0.5 - 0.143 / 1.1)) < 4
    assert blank.max() == 0
