"""The explorer page in a real browser: verdict, TOML, link, field lens, presets, hands; skipped where there is none."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import browser
import numpy as np
import pytest
from explorerpage import NOWHERE, QUANTUM, STATE, Page

import clacad
from clacad.design import Design
from clacad.explorer.page_facts import PRESETS, places
from clacad.explorer.write_page import first_verdict, share_from_eye
from clacad.optics.rays import Fate
from clacad.sheet.feasibility import feasibility
from clacad.sheet.vignetting import ghost_onset, half_field, thin_cells

ROOT = Path(__file__).parents[2]
PICTURES = Path(__file__).parent / "pictures"
SIDE = 128
SLAB = {
    "format": 1, "name": "a slab", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "thickness": 14.9, "index": 1.49}, "lattice": {"pitch": 0.5, "count": 40},
    "check": {"viewer": "600 mm"},
}  # fmt: skip


def everyday(*first, others):
    """Cases of which the first always run, and the others with `-m slow`."""
    return [
        *first,
        *(pytest.param(*(o if isinstance(o, tuple) else (o,)), marks=pytest.mark.slow) for o in others),
    ]


@pytest.fixture
def page(chromium, tmp_path):
    """The page of a slab, as designed."""
    return Page(chromium, tmp_path, Design.from_dict(SLAB))


def shipped(name):
    return clacad.load(ROOT / f"designs/{name}.toml")


def test_nothing_is_asked_for_and_nothing_complains_from_disk(page):
    page.browser.wait(f"{STATE} === 'fine'")
    assert page.browser.complaints() == []
    assert page.browser.requests() == [page.file.resolve().as_uri()]


def test_a_frame_that_comes_late_does_not_replace_the_fine_picture(page):
    """Where the browser is busy the fine picture is drawn first: frames are held back here, and come at once."""
    page.browser.run(
        "window.held = []; window.requestAnimationFrame = f => held.push(f);"
        "window.cancelAnimationFrame = n => { if (n) held[n - 1] = () => {}; }; explorer.set({ eta_x: -1.1 })"
    )
    assert page.browser.run("held.length") == 1
    page.browser.wait(f"{STATE} === 'fine'")
    page.browser.run("held.forEach(f => f())")
    assert page.browser.run(STATE) == "fine"


MOVED = {
    "paper-a-covered": {"eta_x": -0.6, "delta_y": 0.01, "pitch": 0.004, "azimuth": 4.0, "object": 0.8},
    "hexagonal": {"phi": 20.0, "eta_x": -1.7, "eye": 800.0},
    "tilted-seam": {"theta": 12.0, "psi": 70.0, "separation": 8.0},
    "baffled": {"eta_y": -0.4, "elevation": 2.0},
    "window-100mm": {"eta_x": 1.0, "object": 250.0},
}


@pytest.mark.ci_cases("hexagonal", "tilted-seam", "baffled")
@pytest.mark.slow
@pytest.mark.parametrize("name", everyday("hexagonal", others=[n for n in MOVED if n != "hexagonal"]))
def test_verdict_is_what_the_closed_forms_give_of_the_design_handed_out(chromium, tmp_path, name):
    """Reference: the sheet's own closed forms, of the window built from the page's TOML."""
    page = Page(chromium, tmp_path, shipped(name))
    page.set(**MOVED[name])
    told, design = page.verdict(), page.design()
    window = clacad.prescribe(design)
    state = chromium.run("explorer.state()")
    eye = chromium.run("explorer.camera(8, 8).eye")
    unit = window.unit
    facts = feasibility(window, state["eye"] * unit, state["object"] * unit)
    assert told["half_field"] == pytest.approx(half_field(thin_cells(window)), rel=1e-12)
    assert told["ghost_onset"] == pytest.approx(ghost_onset(thin_cells(window)), rel=1e-12, abs=1e-14)
    assert told["share_from_eye"] == pytest.approx(share_from_eye(window, tuple(eye)), rel=1e-10)
    sharpest = [np.inf if p is None else p for p in told["sharpest_pitch"]]
    assert sharpest == pytest.approx([p / unit for p in facts.viewing.sharpest], rel=1e-12)
    assert told["advised_pitch"] == pytest.approx(facts.viewing.advised / unit, rel=1e-12)
    assert told["share"] == pytest.approx(first_verdict(window, (0.0, 0.0, -1.0), 1.0).share, rel=1e-10)


@pytest.mark.slow
def test_verdict_before_anything_is_moved_is_the_one_python_tells(chromium, tmp_path):
    design = shipped("tilted")
    page = Page(chromium, tmp_path, design)
    window = clacad.prescribe(design)
    told, python = page.verdict(), first_verdict(window, *places(design, window)).to_dict()
    assert set(told) == set(python)
    for name, value in python.items():
        assert told[name] == pytest.approx(value, rel=1e-10, abs=1e-13), name


# -- design file and link --------------------------------------------------------------------------


@pytest.mark.ci_cases("hexagonal", "baffled")
@pytest.mark.parametrize(
    "name", everyday("tilted-seam", others=("paper-a-covered", "hexagonal", "baffled", "window-100mm"))
)
def test_an_untouched_page_hands_out_the_very_design(chromium, tmp_path, name):
    design = shipped(name)
    assert Page(chromium, tmp_path, design).design().sha256 == design.sha256


@pytest.mark.ci_cases("hexagonal", "plano")
@pytest.mark.daily_cases("window-100mm")
@pytest.mark.parametrize("name", everyday("paper-a-covered", others=("window-100mm", "hexagonal", "plano")))
def test_the_field_lens_is_in_the_design_file_that_check_reads(chromium, tmp_path, capsys, name):
    from clacad.cli import main

    page, start = Page(chromium, tmp_path, shipped(name)), shipped(name)
    page.set(field=1, object=page.browser.run("explorer.state().object") / 2)
    file = tmp_path / "copied.toml"
    file.write_text(page.browser.run("explorer.toml()"))
    assert main(["check", str(file), "--json"]) in (0, 1)
    capsys.readouterr()
    design = clacad.load(file)
    window = clacad.prescribe(design)
    assert window.thin.field
    assert design.check.field == start.check.field
    again = Page(chromium, tmp_path, design)
    assert again.design().sha256 == design.sha256
    assert again.verdict()["half_field"] == pytest.approx(half_field(thin_cells(window)), rel=1e-12)
    again.set(field=0)
    assert again.design().sha256 == design.replace("pair.field_lens", False).sha256


@pytest.mark.slow
def test_given_faces_stay_until_what_they_are_for_is_moved(chromium, tmp_path):
    """A slab of paraboloids; turned or of other cells they do as well, of another law they do not."""
    made = shipped("window-100mm").replace(
        {"pair.prescription": "given", "pair.face": [{"radius": [2.47, 2.47], "conic": [-0.4, -0.4]}] * 2}
    )
    page = Page(chromium, tmp_path, made)
    assert page.design().sha256 == made.sha256
    page.set(phi=20, pitch=0.4, object=123)
    assert page.design().pair == made.pair
    for moved in ({"eta_x": -0.8}, {"delta_y": 0.01}, {"separation": 12}, {"field": 1}):
        page.set(**moved)
        design = page.design()
        assert design.pair.prescription == "derived"
        clacad.prescribe(design)
        assert page.browser.run("explorer.toml()").startswith("# the faces that were given")


@pytest.mark.parametrize(("name", "changes", "why"), everyday(
    ("baffled", {}, "baffle"), others=[("window-100mm", {"body.border": 6, "body.corners": {"round": 3}}, "corners")]))  # fmt: skip
def test_what_no_field_lens_is_made_beside_takes_the_switch_away(chromium, tmp_path, name, changes, why):
    page = Page(chromium, tmp_path, shipped(name).replace(changes))
    page.set(field=1)
    assert page.browser.run("document.querySelector('[name=field]').disabled")
    assert why in page.browser.run("document.querySelector('[data-why]').textContent")
    assert page.design().pair.field_lens is False


@pytest.mark.slow
def test_moved_sliders_are_in_the_design_file_that_check_reads(page, tmp_path, capsys):
    from clacad.cli import main

    page.set(eta_x=-0.5, delta_y=0.015, phi=30, pitch=0.25, separation=9.5, object=150, eye=900)
    text = page.browser.run("explorer.toml()")
    file = tmp_path / "copied.toml"
    file.write_text(text)
    assert main(["check", str(file), "--json"]) in (0, 1)
    assert "sharpest" in capsys.readouterr().out
    design = clacad.load(file)
    assert design.law_spec.eta == (-0.5, -1.0)
    assert design.law_spec.delta == (0.0, 0.015)
    assert design.law_spec.euler_degrees == (30.0, 0.0, 0.0)
    assert (design.lattice.pitch, design.lattice.count) == ((0.25, 0.25), (80, 80))
    assert (design.pair.separation, design.pair.thicknesses) == (9.5, None)
    assert design.viewing_places == pytest.approx((0.9, 0.15))
    assert design.name == "a slab"


def test_eta_1_takes_no_offset_and_a_plain_window_is_no_design(page):
    page.set(eta_x=1, delta_x=0.01, delta_y=0.02)
    assert page.design().law_spec.delta == (0.0, 0.02)


@pytest.mark.ci_cases("window-100mm-moved2", "baffled-moved6", "paper-a-covered-moved8", "hexagonal-moved11")
@pytest.mark.parametrize(("name", "moved"), everyday(("window-100mm", {"eta_x": 1, "eta_y": 1}), others=[
    ("window-100mm", {"separation": 1.4}), ("window-100mm", {"separation": 1.5}),
    ("window-100mm", {"eta_x": 0.1}), ("window-100mm", {"eta_x": 0.7}), ("baffled", {"eta_y": 0.5}), ("baffled", {"eta_y": 3}),
    ("baffled", {"eta_x": -0.3}), ("paper-a-covered", {"eta_x": 0.5}), ("paper-a-covered", {"pitch": 0.02}), ("hexagonal", {"eta_x": -0.05}),
    ("hexagonal", {"eta_x": -0.3}),
]))  # fmt: skip
def test_the_page_says_that_no_such_sheet_can_be_made_where_prescribe_does(chromium, tmp_path, name, moved):
    page = Page(chromium, tmp_path, shipped(name))
    page.set(**moved)
    try:
        clacad.prescribe(page.design())
        refused = False
    except clacad.DesignError:
        refused = True
    assert chromium.run("document.querySelector('[name=copy-toml]').disabled") == refused
    assert (
        "Cannot be made" in chromium.run("document.querySelector('[data-verdict]').textContent")
    ) == refused


def test_a_link_carries_what_was_moved_and_nothing_else(page):
    page.set(eta_x=-0.5, azimuth=3.5)
    link = page.browser.run("location.href")
    assert link.partition("#")[2].split("&") == ["eta_x=-0.5", "azimuth=3.5"]
    page.browser.ask("Page.navigate", url="about:blank")
    page.browser.ask("Page.navigate", url=link)
    page.browser.wait("window.explorer !== undefined")
    state = page.browser.run("explorer.state()")
    assert (state["eta_x"], state["azimuth"], state["eta_y"]) == (-0.5, 3.5, -1)


@pytest.mark.parametrize("link", everyday(
    "phi=<img src=x>&__proto__=1&toString=2&eta_x=0", others=("pitch=-1&eye=1e99", "&&==&fov", "eta_x=NaN")))  # fmt: skip
def test_a_spoilt_link_gives_a_page_within_its_ranges(page, link):
    page.browser.ask("Page.navigate", url="about:blank")
    page.browser.ask("Page.navigate", url=page.file.as_uri() + "#" + link)
    page.browser.wait("window.explorer !== undefined")
    assert page.browser.complaints() == []
    assert page.design().name == "a slab"


# -- markup in a design cannot act -----------------------------------------------------------------


@pytest.mark.slow
def test_markup_in_a_design_stays_text(chromium, tmp_path):
    evil = "</title></script><script>window.broken = 1</script><img src=x onerror='window.broken = 1'>\"'&"
    design = replace(Design.from_dict({**SLAB, "notes": [evil]}), name="evil")
    design = replace(design, unit="mm")
    Page(chromium, tmp_path, replace(design, name="a" + evil.replace("/", "⁄")))
    assert chromium.run("window.broken") is None
    assert chromium.run("document.images.length") == 0
    assert chromium.run("document.querySelector('h1').textContent").startswith("a<")
    named = Page(chromium, tmp_path, design)
    assert chromium.run("window.broken") is None
    assert tomllib.loads(chromium.run("explorer.toml()"))["notes"] == [evil]
    policy = named.file.read_text().partition('Content-Security-Policy" content="')[2].partition('"')[0]
    assert policy.startswith("default-src 'none'; script-src 'sha256-")


# -- field lens ------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("eta", everyday([-0.25, -1.0], others=([-1.0, -1.0], [-2.0, -0.5])))
def test_with_a_field_lens_light_goes_where_the_closed_form_has_it(chromium, tmp_path, eta):
    """Closed form: u = ηξ + m p(1 − η) behind field lens m; share min(1, 1/|η|) for |t| < p(1 − η)/(2s); t' = (t − δ)/η in the partner."""
    delta = [0.004, -0.006]
    design = Design.from_dict({**SLAB, "law": {"eta": eta, "delta": delta}, "pair": {
        "form": "biconvex", "separation": 10.0, "index": 1.5}, "lattice": {"pitch": 0.5, "count": [60, 40]}})  # fmt: skip
    page = Page(chromium, tmp_path, design)
    page.set(field=1, eye=300, azimuth=2.0, elevation=1.5, fov=6.0)
    slope, last, entered, fate = page.debug(64, 40)
    eye, direction = page.rays(64, 40)
    t = direction[:, :2] / direction[:, 2:]
    eta, delta, s, p, count = np.array(eta), np.array(delta), 10.0, 0.5, np.array([60, 40])
    at = (eye[:, :2] - eye[:, 2:] * t) / p + 0.5 * count
    cell, xi = np.floor(at).astype(int), (at % 1.0 - 0.5) * p
    f1 = s / (1.0 - eta)
    centre = delta * f1  # cells of array 2 are aligned with lens 2's centres
    m = np.floor((f1 * t - centre * f1 / s) / p + 0.5)
    u = eta * xi + m * p * (1.0 - eta)
    met = cell + np.floor(u / p + 0.5).astype(int)
    on = ((cell >= 0) & (cell < count)).all(axis=1) & ((met >= 0) & (met < count)).all(axis=1)
    assert on.sum() > 500
    agrees = (entered == cell).all(axis=1) & (last == met).all(axis=1)
    assert agrees[on].mean() >= 0.999
    alive = on & agrees & (met == cell).all(axis=1)
    assert (fate[alive] == Fate.ALIVE).all()
    asked = (t - delta) / eta
    inside = alive & (m == 0).all(axis=1) & (np.abs(asked) < 1.0).all(axis=1)
    assert inside.sum() > 50
    assert np.abs(slope - asked)[inside].max() <= QUANTUM
    told = page.verdict()
    assert told["half_field"] == pytest.approx(0.5 * p * (1.0 - eta) / s, rel=1e-12)
    assert told["share"] == pytest.approx(np.prod(np.minimum(1.0, 1.0 / np.abs(eta))), rel=1e-12)
    assert (last[~on & ~((cell >= 0) & (cell < count)).all(axis=1)] == NOWHERE).all()


@pytest.mark.parametrize(("moved", "why"), everyday(
    ({"eta_x": 0.5}, "virtual"), others=[({"theta": 5}, "tilted"), ({"eta_x": -0.5, "phi": 20}, "crossed")]))  # fmt: skip
def test_where_there_can_be_no_field_lens_the_page_says_why(page, moved, why):
    page.set(**moved, field=1)
    assert page.browser.run("document.querySelector('[name=field]').disabled")
    assert why in page.browser.run("document.querySelector('[data-why]').textContent")
    assert page.verdict()["half_field"] == pytest.approx(
        half_field(thin_cells(clacad.prescribe(page.design())))
    )


# -- pictures --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_every_preset_looks_as_it_did(chromium, tmp_path):
    """Saved by `python tests/explore/save_pictures.py`; at most 1 % of the pixels differ by more than 8 of 255."""
    from PIL import Image

    page = Page(chromium, tmp_path, shipped("paper-a-covered"))
    seen, states = set(), set()
    for number, (name, changes) in enumerate(PRESETS):
        page.set(**changes)
        now = page.picture(SIDE, SIDE)
        saved = np.asarray(Image.open(PICTURES / f"{number}.png").convert("RGB")).astype(int)
        assert (np.abs(now - saved).max(axis=2) > 8).mean() <= 0.01, name
        seen.add(now.tobytes())
        states.add(str(chromium.run("explorer.state()")))
    assert len(seen) == len(states) >= len(PRESETS) - 1, (
        "each is another picture, but what is the design itself"
    )


def test_ghosts_are_tinted_or_black(page):
    tinted = page.picture(64, 64)
    page.set(ghosts=0)
    dark = page.picture(64, 64)
    changed = np.abs(tinted - dark).max(axis=2) > 8
    assert changed.mean() > 0.05
    assert dark[changed].sum() < 0.8 * tinted[changed].sum()


# -- hands -----------------------------------------------------------------------------------------


def test_sliders_fields_keys_and_reset_move_the_view(page):
    run = page.browser.run
    run("document.querySelector('[data-slide=eta_x]').focus()")
    page.browser.key("ArrowRight")
    assert run("explorer.state().eta_x") > -1
    run(
        "(() => { const n = document.querySelector('[name=phi]'); n.value = '12.5'; n.dispatchEvent(new Event('input')); })()"
    )
    assert run("explorer.state().phi") == 12.5
    run("document.querySelector('canvas').focus()")
    page.browser.key("ArrowLeft")
    page.browser.key("+")
    moved = run("explorer.state()")
    assert moved["azimuth"] != 0
    start = run(
        "JSON.parse(document.getElementById('explorer').dataset.facts).sliders.find(s => s.id === 'fov').start"
    )
    assert moved["fov"] < start
    run("document.querySelector('[name=reset]').click()")
    assert run("[explorer.state().eta_x, explorer.state().phi, explorer.state().azimuth, location.hash]") == [
        -1,
        0,
        0,
        "",
    ]


def test_one_finger_moves_the_eye_and_two_zoom(page):
    x, y, wide, tall = page.browser.run(
        "(() => { document.querySelector('canvas').scrollIntoView(); const b = document.querySelector('canvas')"
        ".getBoundingClientRect(); return [b.x, b.y, b.width, b.height]; })()"
    )
    cx, cy = x + wide / 2, y + tall / 2

    def touch(kind, *points):
        page.browser.ask("Input.dispatchTouchEvent", type=kind, touchPoints=[
            {"x": px, "y": py, "id": k} for k, (px, py) in enumerate(points)])  # fmt: skip

    before = page.browser.run("explorer.state()")
    touch("touchStart", (cx, cy))
    touch("touchMove", (cx + 40, cy))
    touch("touchMove", (cx + 60, cy))
    touch("touchEnd")
    assert page.browser.run("explorer.state().azimuth") > before["azimuth"]
    touch("touchStart", (cx - 30, cy), (cx + 30, cy))
    touch("touchMove", (cx - 60, cy), (cx + 60, cy))
    touch("touchEnd")
    assert page.browser.run("explorer.state().fov") < before["fov"]


def test_a_preset_is_chosen_by_name(page):
    page.browser.run(
        "(() => { const s = document.querySelector('[name=preset]'); s.value = '4'; s.dispatchEvent(new Event('change')); })()"
    )
    state = page.browser.run("explorer.state()")
    assert (state["eta_x"], state["phi"]) == (-0.25, 45)


def test_nothing_is_wider_than_a_small_screen(page):
    page.browser.ask(
        "Emulation.setDeviceMetricsOverride", width=400, height=800, deviceScaleFactor=1, mobile=True
    )
    try:
        assert page.browser.run("document.documentElement.scrollWidth") <= 400
        sizes = page.browser.run(
            "[...document.querySelectorAll('canvas, input[type=range], button, select')].map(e => e.getBoundingClientRect().width)"
        )
        assert min(sizes) > 50
    finally:
        page.browser.ask("Emulation.clearDeviceMetricsOverride")


@pytest.mark.slow
@pytest.mark.usefixtures("chromium")  # skipped where there is no browser
def test_without_webgl_it_says_so_and_the_rest_works(tmp_path):
    plain = browser.Browser(flags=("--disable-webgl", "--disable-3d-apis"))
    try:
        page = Page(plain, tmp_path, Design.from_dict(SLAB))
        assert plain.run("document.querySelector('canvas').hidden")
        assert plain.run("document.querySelector('[data-no-view]').getBoundingClientRect().height") > 40
        assert "no WebGL" in plain.run("document.querySelector('[data-no-view]').textContent")
        page.set(eta_x=-0.5)
        assert page.design().law_spec.eta == (-0.5, -1.0)
        assert [c for c in plain.complaints() if "exception" in c.lower()] == []
    finally:
        plain.close()


# -- non-uniform sheets ----------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("field", everyday(False, others=(True,)))
def test_an_aimed_sheet_is_seen_evenly_from_where_it_is_aimed(chromium, tmp_path, field):
    """Light of the point that a sheet is aimed at meets each partner as light along the middle of the field does."""
    made = shipped("slab").replace(
        {"lattice.count": [60, 60], "lattice.aperture": {"point": [5.0, -3.0, -900.0]}}
    )
    page = Page(chromium, tmp_path, made)
    assert page.design().sha256 == made.sha256
    assert chromium.run("explorer.camera(8, 8).eye") == pytest.approx([5.0, -3.0, -900.0])
    page.set(field=int(field))
    told, design = page.verdict(), page.design()
    window = clacad.prescribe(design)
    python = first_verdict(window, *places(design, window)).to_dict()
    for name, value in python.items():
        assert told[name] == pytest.approx(value, rel=1e-10, abs=1e-13), name
    assert told["share_from_eye"] == pytest.approx(told["share"], rel=0.02)
    page.set(field=int(field), azimuth=4.0)
    assert page.verdict()["share_from_eye"] < 0.3 * told["share_from_eye"]
    aligned = Page(chromium, tmp_path, made.replace("lattice.aperture", "aligned"))
    aligned.set(field=int(field), eye=900.0)
    assert field or aligned.verdict()["share_from_eye"] < 0.9 * told["share_from_eye"]


@pytest.mark.slow
def test_a_point_too_near_to_aim_at_is_said_before_a_design_is_copied(chromium, tmp_path):
    made = shipped("slab").replace(
        {"lattice.count": [20, 20], "lattice.aperture": {"point": [0.0, 0.0, -200.0]}}
    )
    page = Page(chromium, tmp_path, made)
    page.set(separation=21.0)
    assert chromium.run("document.querySelector('[name=copy-toml]').disabled")
    assert "nearer than 10 separations" in chromium.run(
        "document.querySelector('[data-verdict]').textContent"
    )
    with pytest.raises(clacad.DesignError, match="CL122"):
        clacad.prescribe(page.design())
