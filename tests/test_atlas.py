"""The atlas: every figure's row holds in the rendered picture, and the page says so."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from viewscenes import ROOT

from clacad.render import rows
from clacad.render.atlas import AtlasRequest, make_atlas
from clacad.render.section import section_svg
from clacad.scene import load_scene

SCENES = ROOT / "designs" / "scenes"


def load(stem):
    return load_scene(SCENES / f"{stem}.toml")


def held(figure):
    found = list(figure.check(load))
    assert found
    bad = [one for one in found if not one.passed]
    assert not bad, bad


FAST = ("F2", "F4", "F6")
"""Rows that take a second or two each; the others turn the sheet step by step."""


@pytest.mark.parametrize("figure", [f for f in rows.FIGURES if f.row in FAST], ids=lambda f: f.row)
def test_a_figure_shows_what_the_paper_says(figure):
    held(figure)


@pytest.mark.long
@pytest.mark.parametrize("figure", [f for f in rows.FIGURES if f.row not in FAST], ids=lambda f: f.row)
def test_a_movie_s_figure_shows_what_the_paper_says(figure):
    held(figure)


def test_every_scene_of_the_atlas_is_in_a_figure_or_is_a_movie():
    named = {stem for figure in rows.FIGURES for stem, _ in figure.scenes} | {stem for stem, _ in rows.MOVIES}
    assert named | {"fig1a", "fig1b"} == {path.stem for path in SCENES.glob("fig*.toml")}


def test_every_scene_of_a_paper_figure_is_drawn_left_handed_as_the_paper_s_renderer_draws():
    for path in SCENES.glob("fig[2-8]*.toml"):
        assert load(path.stem).camera.mirror, path.stem


def test_a_measured_row_fails_when_the_sheet_is_another(monkeypatch):
    """The check is no decoration: η_x = −0.3 instead of −0.25 is noticed."""

    def other(stem):
        scene = load(stem)
        eta = scene.design().law_spec.eta
        return scene.replace({"sheet.set": {"law.eta": [eta[0] * 1.2, eta[1]]}})

    squash = next(figure for figure in rows.FIGURES if figure.row == "F2")
    assert not all(one.passed for one in squash.check(other))


def test_winding_counts_turns():
    def spun(degrees, stretch):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        turn = np.array([[c, -s], [s, c]])
        return np.linalg.inv(turn @ np.diag(stretch) @ turn.T)

    angles = np.linspace(0.0, 180.0, 19)
    assert abs(rows.winding([spun(a, (-1.0, 2.0)) for a in angles])) == pytest.approx(360.0)
    assert rows.winding([spun(a, (1.0, 2.0)) for a in angles]) == pytest.approx(0.0, abs=1e-9)


def test_an_atlas_holds_figures_measurements_and_a_page_and_can_be_made_again(tmp_path):
    request = AtlasRequest(SCENES, tmp_path / "a", size=48, samples=1, movies=False, rows=("F4",))
    atlas = make_atlas(request)
    assert atlas.passed
    made = {path.name: path.read_bytes() for path in (tmp_path / "a").iterdir()}
    assert {f"fig4-delta-{d}.png" for d in ("0-0.01", "0.005-0.01", "0.01-0", "m0.005-0.005")} < set(made)
    page = made["index.html"].decode()
    for name in re.findall(r'src="([^"]+)"', page):
        assert name in made
    record = json.loads(made["atlas.json"])
    assert record["passed"]
    assert len(record["rows"]["F4"]) == 12
    make_atlas(request)
    assert {path.name: path.read_bytes() for path in (tmp_path / "a").iterdir()} == made


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


def test_render_writes_a_picture_says_how_and_refuses_to_overwrite(tmp_path):
    out = tmp_path / "x.png"
    scene = SCENES / "fig3-z-8.toml"
    done = run("render", scene, "-o", out, "--pixels", 32, "--samples", 1, "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)["pictures"][0]
    assert told["samples"] == 32 * 32
    assert told["metadata"]["clacad:rung"].startswith("surfaces")
    assert out.read_bytes()[:4] == b"\x89PNG"
    again = run("render", scene, "-o", out, "--pixels", 32, "--samples", 1)
    assert again.returncode == 4
    assert "overwrite" in again.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["render", "designs/scenes/fig3-z-8.toml", "-o", "x.jpg"], "a picture is one of"),
        (["render", "designs/scenes/nothing.toml", "-o", "x.png"], "cannot read the scene"),
        (["render", "designs/paper-base.toml", "-o", "x.png"], "it belongs in a design file"),
        (
            ["render", "designs/scenes/fig3-z-8.toml", "-o", "x.png", "--set", "camera.frame=-1"],
            "camera.frame",
        ),
        (["render", "designs/scenes/fig3-z-8.toml", "-o", "x.png", "--preset", "ear"], "there is no preset"),
        (["render", "designs/paper-base.toml", "-o", "x.png", "--preset", "eye"], "PHOTO"),
        (["atlas", "-o", "x", "--scenes", "nowhere"], "there is no such folder"),
    ],
)
def test_bad_input_ends_with_status_2_and_one_sentence(arguments, words):
    done = run(*arguments)
    assert done.returncode == 2, done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert not Path(ROOT / "x.png").exists()


def test_an_eye_sees_a_photograph_before_and_after(tmp_path):
    from PIL import Image

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
    np.testing.assert_allclose(after[:, :3], before[:, :3], atol=6)  # beside the sheet nothing changes
