"""Pixels of the explorer's view against rung `thin` in double precision; skipped where there is no browser."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from explorerpage import NOWHERE, QUANTUM, Page

import clacad
from clacad.optics.rays import NO_CELL, Fate

ROOT = Path(__file__).parents[2]
WIDE, TALL = 40, 26  # even: the middle of the picture, which looks at a corner of cells, is between pixels


def shipped(name, **changes):
    """A design of the repository, some dotted keys of it changed."""
    return clacad.load(ROOT / f"designs/{name}.toml").replace(changes)


ROUND = {"lattice.outline": {"circle": 8.0}, "lattice.seam": 0.03, "body.border": 0.4}
AIMED = {"lattice.aperture": {"point": [0.0, 0.0, -600.0]}}
EVERYDAY = ("paper, turned, offset and from aside", "tilted", "aimed, round, with border and seams")
"""Cases that always run."""

CASES = {
    "paper": (shipped("paper-a-covered"), {}),
    "paper, turned, offset and from aside": (shipped("paper-a-covered"), {
        "eta_x": -0.7, "delta_x": 0.01, "phi": 30.0, "azimuth": 8.0, "elevation": -5.0, "pitch": 0.004}),
    "window": (shipped("window-100mm"), {"separation": 12.0, "eye": 700.0, "elevation": 1.3}),
    "Galilean": (shipped("window-100mm"), {"eta_x": 0.5, "eta_y": 1.0, "azimuth": 2.0}),
    "hexagons": (shipped("hexagonal"), {"phi": 10.0, "azimuth": 3.0, "fov": 1.0}),
    "tilted": (shipped("tilted"), {}),
    "steeply tilted": (shipped("tilted"), {"theta": 35.0, "psi": 120.0, "azimuth": 20.0}),
    "tilted, with seams": (shipped("tilted-seam"), {"theta": 12.0, "elevation": -9.0}),
    "tilted hexagons": (shipped("hexagonal"), {"theta": -15.0, "phi": 40.0, "azimuth": 12.0}),
    "round, with border and seams": (shipped("slab", **ROUND), {"delta_x": 0.02, "azimuth": 1.5, "elevation": 0.6, "fov": 0.5}),
    "opaque land": (shipped("slab", **ROUND, **{"lattice.land": "opaque"}), {"theta": 3.0, "fov": 0.45, "azimuth": 0.7}),
    "baffle": (shipped("baffled"), {"azimuth": 1.0, "fov": 1.37}),
    "field lens": (shipped("window-100mm"), {"field": 1, "delta_x": 0.01, "azimuth": 3.0, "elevation": 1.3}),
    "field lens of hexagons": (shipped("hexagonal", **{"law.eta": [-0.5, -0.5]}), {"field": 1, "phi": 10.0, "azimuth": 4.0, "fov": 1.0}),
    "field lens of crossed cylinders": (shipped("paper-a-covered"), {"field": 1, "azimuth": 6.0, "elevation": -7.0}),
    "aimed": (shipped("window-100mm", **AIMED), {}),
    "aimed at an eye aside, moved": (shipped("window-100mm", **{"lattice.aperture": {"point": [60.0, -30.0, -1500.0]}}), {
        "delta_x": 0.01, "pitch": 0.4, "separation": 12.0, "azimuth": 1.5}),
    "aimed hexagons": (shipped("hexagonal", **{"lattice.aperture": {"point": [5.0, 2.0, -400.0]}}), {"phi": 10.0, "fov": 1.5}),
    "aimed, tilted, with seams": (shipped("tilted-seam", **{"lattice.aperture": {"point": [1.0, 0.0, -200.0]}}), {"azimuth": 3.0}),
    "aimed, round, with border and seams": (shipped("slab", **ROUND, **{"lattice.aperture": {"point": [5.0, 0.0, -600.0]}}), {"fov": 1.9}),
    "aimed, with opaque land": (shipped("slab", **ROUND, **{"lattice.land": "opaque", "lattice.aperture": {"point": [0.0, 0.0, -300.0]}}), {
        "azimuth": 0.7, "fov": 1.9}),
    "aimed slab with border": (shipped("slab", **{"body.border": 0.4, "lattice.aperture": {"point": [5.0, 0.0, -600.0]}}), {"fov": 2.5}),
    "aimed at an object": (shipped("window-100mm", **{"lattice.aperture": {"point": [0.0, 0.0, 500.0]}}), {"azimuth": 1.0}),
    "aimed, with baffle": (shipped("baffled", **{"lattice.aperture": {"point": [0.0, 0.0, -300.0]}}), {"fov": 1.37}),
    "aimed, with field lens": (shipped("window-100mm", **AIMED), {"field": 1, "delta_x": 0.01, "azimuth": 3.0, "elevation": 1.3}),
    "aimed, with field lens of crossed cylinders": (shipped("paper-a-covered", **{"lattice.aperture": {"point": [0.5, 0.0, -30.0]}}), {
        "field": 1, "elevation": -2.0}),
    "field lens, turned": (shipped("paper-a-covered"), {"field": 1, "eta_x": -0.6, "eta_y": -0.6, "phi": 25.0, "azimuth": 6.0}),
}  # fmt: skip


def named(cells):
    """Cells (n, 2) as the page writes them."""
    return np.where((cells == NO_CELL).any(axis=1)[:, None], NOWHERE, cells)


@pytest.mark.ci_cases(
    "paper, turned, offset and from aside",
    "tilted hexagons",
    "round, with border and seams",
    "baffle",
    "field lens of crossed cylinders",
    "aimed, tilted, with seams",
    "aimed, with field lens",
)
@pytest.mark.daily_cases("aimed, round, with border and seams")
@pytest.mark.parametrize("name", [
    name if name in EVERYDAY else pytest.param(name, marks=pytest.mark.slow) for name in CASES])  # fmt: skip
def test_a_thousand_pixels_agree_with_rung_thin_in_slope_cell_and_fate(chromium, tmp_path, name):
    design, moved = CASES[name]
    page = Page(chromium, tmp_path, design)
    page.set(**moved)
    slope, last, entered, fate = page.debug(WIDE, TALL)
    window = clacad.prescribe(page.design())
    traced = clacad.trace(window, clacad.Rays(*page.rays(WIDE, TALL)), rung="thin")
    assert chromium.complaints() == []
    lit = np.isin(traced.fate, (Fate.ALIVE, Fate.GHOST, Fate.LAND))
    assert lit.sum() > 100, "the view shows the sheet"
    known = lit & (traced.order != NO_CELL).all(axis=1)
    met = np.where(known[:, None], traced.cell + traced.order, last)
    same = (
        (fate == traced.fate)
        & (~lit | (entered == named(traced.cell)).all(axis=1))
        & (last == met).all(axis=1)
    )
    assert same.mean() >= 0.999, f"{(~same).sum()} of {len(same)} pixels"
    asked = traced.direction[:, :2] / traced.direction[:, 2:]
    shown = lit & same & (np.abs(asked) < 1.0).all(axis=1)
    assert np.abs(slope - asked)[shown].max() <= QUANTUM


@pytest.mark.slow
def test_an_own_photograph_stands_behind_the_sheet_and_nothing_is_requested(chromium, tmp_path):
    """A picture of two colours, twice as wide as high, seen through a sheet of magnification 1."""
    page = Page(chromium, tmp_path, shipped("paper-a-covered"))
    before = len(chromium.requests())
    card = page.picture(WIDE, TALL)
    chromium.run("""(async () => {
      const drawn = document.createElement('canvas'); drawn.width = 200; drawn.height = 100;
      const ink = drawn.getContext('2d'); ink.fillStyle = '#ff0000'; ink.fillRect(0, 0, 100, 100);
      ink.fillStyle = '#0000ff'; ink.fillRect(100, 0, 100, 100);
      await window.explorer.photo(await new Promise((done) => drawn.toBlob(done)));
      window.shown = true;
    })()""")
    chromium.wait("window.shown === true")
    photo = page.picture(WIDE, TALL).reshape(TALL, WIDE, -1).astype(float)
    red, blue = ((photo[..., a] - photo[..., b]) > 60.0 for a, b in ((0, 2), (2, 0)))
    assert red.sum() > 20
    assert blue.sum() > 20
    assert abs(np.nonzero(red)[1].mean() - np.nonzero(blue)[1].mean()) > 3.0
    chromium.run("document.querySelector('[name=card]').click()")
    assert (page.picture(WIDE, TALL) == card).all()
    assert len(chromium.requests()) == before
    assert chromium.complaints() == []


def test_every_number_is_explained_on_hover_and_focus(chromium, tmp_path):
    Page(chromium, tmp_path, shipped("paper-a-covered"))
    explained = chromium.run("""(() => {
      const field = document.querySelector('input[type=number]'), term = document.getElementById(field.getAttribute('aria-describedby'));
      const before = getComputedStyle(term).display; field.focus();
      return [before, getComputedStyle(term).display, term.textContent.length > 10,
        [...document.querySelectorAll('.row input')].every((one) => document.getElementById(one.getAttribute('aria-describedby')))];
    })()""")
    assert explained == ["none", "block", True, True]


@pytest.mark.slow
def test_the_colour_switch_turns_blue_light_as_real_faces_do(chromium, tmp_path):
    """Change of slope from the design wavelength to 464.2 nm, of the slab's own faces and of the page's lenses."""
    page = Page(chromium, tmp_path, shipped("window-100mm"))
    slopes, fates, pictures = [], [], []
    for colour in (0, 1):
        page.set(colour=colour)
        slope, _, _, fate = page.debug(WIDE, TALL)
        slopes.append(slope)
        fates.append(fate)
        pictures.append(page.picture(WIDE, TALL))
    window = clacad.prescribe(page.design())
    rays = page.rays(WIDE, TALL)
    base, blue = (clacad.trace(window, clacad.Rays(*rays, wave)) for wave in (None, 464.2e-9))
    shown = (fates[0] == Fate.ALIVE) & (fates[1] == Fate.ALIVE)
    real = (base.fate == Fate.ALIVE) & (blue.fate == Fate.ALIVE)
    turned = [one.direction[real, :2] / one.direction[real, 2:] for one in (base, blue)]
    wanted = np.sqrt(np.mean((turned[1] - turned[0]) ** 2))
    assert min(shown.sum(), real.sum()) > 300
    assert wanted > 10 * QUANTUM
    assert np.sqrt(np.mean((slopes[1] - slopes[0])[shown] ** 2)) == pytest.approx(wanted, rel=0.05)
    assert (pictures[0] != pictures[1]).any()
    assert chromium.complaints() == []


def test_a_bare_index_has_no_colours(chromium, tmp_path):
    page = Page(chromium, tmp_path, shipped("paper-a-covered"))
    assert chromium.run("document.querySelector('[name=colour]').disabled")
    pictures = []
    for colour in (0, 1):
        page.set(colour=colour)
        pictures.append(page.picture(WIDE, TALL))
    assert (pictures[0] == pictures[1]).all()
