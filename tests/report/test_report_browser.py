"""The page in a real browser: nothing is loaded, nothing complains, the part turns; skipped where there is none."""

from __future__ import annotations

import importlib.util
import time

import browser
import numpy as np
import pytest

from clacad.design import Design
from clacad.report import write_report
from clacad.report.content import content
from clacad.verification import verify

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        browser.find() is None or importlib.util.find_spec("websockets") is None,
        reason="no Chromium on the path, or no package websockets to talk to it",
    ),
]

TEXT = {
    "format": 1, "name": "in a browser", "unit": "mm", "law": {"eta": [-0.5, -1.0]},
    "pair": {"form": "biconvex", "separation": 2.0, "index": 1.5}, "lattice": {"pitch": 0.5, "count": 5},
}  # fmt: skip

VIEW = "document.getElementById('solid')"


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    report = verify(Design.from_dict(TEXT), rays=2048)
    made = content(report, lambda _stage, _part: None)
    return write_report(made, tmp_path_factory.mktemp("browser"))[0]


@pytest.fixture(scope="module")
def chromium():
    opened = browser.Browser()
    yield opened
    opened.close()


@pytest.fixture
def page(chromium, address):
    """The report, opened afresh, with its view drawn."""
    chromium.open(address)
    chromium.wait(f"{VIEW}.dataset.state === 'drawn'")
    chromium.run(
        "document.querySelector('#solid canvas').scrollIntoView({block: 'center', behavior: 'instant'})"
    )
    time.sleep(0.2)
    return chromium


def canvas(page):
    """Pixels of the view as the browser shows them, and its middle in the window."""
    x, y, wide, tall, scroll = page.run(
        "(() => { const b = document.querySelector('#solid canvas').getBoundingClientRect();"
        " return [b.x, b.y, b.width, b.height, window.scrollY]; })()"
    )
    return page.picture((x, y + scroll, wide, tall)), (x + wide / 2, y + tall / 2)


def turned(page, act):
    """Part of the pixels that an action changes."""
    before, middle = canvas(page)
    seen = page.run(f"{VIEW}.dataset.view")
    act(middle)
    page.wait(f"{VIEW}.dataset.view !== '{seen}'")
    time.sleep(0.1)
    after, _ = canvas(page)
    return float((np.abs(after - before).sum(axis=2) > 20).mean())


def test_nothing_complains_and_nothing_is_asked_for(page, address):
    assert page.complaints() == []
    assert page.requests() == [address.resolve().as_uri()]


@pytest.mark.slow
def test_the_part_is_drawn_and_turns_when_dragged(page):
    shown, _ = canvas(page)
    assert shown.reshape(-1, 3).std(axis=0).max() > 15.0  # not of one colour
    assert len(np.unique(shown.reshape(-1, 3), axis=0)) > 40
    assert turned(page, lambda at: page.drag(at, (at[0] + 160, at[1] + 60))) > 0.02
    assert page.complaints() == []


@pytest.mark.slow
def test_the_part_turns_by_the_keyboard_and_starts_again(page):
    first = page.run(f"{VIEW}.dataset.view")
    page.run("document.querySelector('#solid canvas').focus()")

    def press(*names):
        for name in names:
            page.key(name)

    assert turned(page, lambda _at: press(*["ArrowLeft"] * 4)) > 0.005
    assert turned(page, lambda _at: page.key("+")) > 0.005
    assert page.run(f"{VIEW}.dataset.view") != first
    page.key("0")
    page.wait(f"{VIEW}.dataset.view === '{first}'")


@pytest.mark.slow
def test_a_cut_shows_the_inside(page):
    before, _ = canvas(page)
    page.run("document.querySelector('#solid [name=cut]').click()")
    time.sleep(0.3)
    after, _ = canvas(page)
    assert float((np.abs(after - before).sum(axis=2) > 20).mean()) > 0.005


def test_every_picture_is_there(page):
    sizes = page.run("[...document.images].map(i => [i.complete, i.naturalWidth])")
    assert len(sizes) >= 3
    assert all(complete and width > 100 for complete, width in sizes)
    boxes = page.run(
        "[...document.querySelectorAll('figure > svg')].map(s => { const b = s.getBoundingClientRect();"
        " return [b.width, b.height]; })"
    )
    assert len(boxes) >= 12
    assert all(wide > 150 and tall > 60 for wide, tall in boxes)


def test_nothing_is_wider_than_a_small_screen(page):
    page.ask("Emulation.setDeviceMetricsOverride", width=400, height=800, deviceScaleFactor=1, mobile=False)
    try:
        assert page.run("document.documentElement.scrollWidth") <= 400
    finally:
        page.ask("Emulation.clearDeviceMetricsOverride")


def contrast(page, selector):
    """Contrast ratio of an element's text and the page behind it (WCAG 2)."""
    ink, paper = page.run(
        f"(() => {{ const e = document.querySelector('{selector}');"
        " return [getComputedStyle(e).color, getComputedStyle(document.body).backgroundColor]; })()"
    )
    levels = []
    for text in (ink, paper):
        value = np.array([float(v) for v in text[text.index("(") + 1 : -1].split(",")[:3]]) / 255.0
        linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
        levels.append(float(linear @ [0.2126, 0.7152, 0.0722]))
    return (max(levels) + 0.05) / (min(levels) + 0.05)


@pytest.mark.daily_cases("light")
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_can_be_read_in_light_and_dark(page, scheme):
    page.ask("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    try:
        for selector in ("h1", ".soft", "td.state", "nav a", "table th", "#solid p"):
            assert contrast(page, selector) >= 4.5, (scheme, selector)
    finally:
        page.ask("Emulation.setEmulatedMedia", features=[])


@pytest.mark.slow
def test_on_paper_the_picture_stands_for_the_view(page):
    page.ask("Emulation.setEmulatedMedia", media="print")
    try:
        shown = page.run(
            "['#solid canvas', '#solid img', '#solid .controls', 'nav'].map("
            "s => getComputedStyle(document.querySelector(s)).display)"
        )
        assert shown == ["none", "block", "none", "none"]
    finally:
        page.ask("Emulation.setEmulatedMedia", media="")


@pytest.mark.slow
def test_without_webgl_there_is_a_picture_and_no_complaint(address):
    plain = browser.Browser(flags=("--disable-webgl", "--disable-3d-apis"))
    try:
        plain.open(address)
        plain.wait(f"(({VIEW}.dataset.state) || '').startsWith('no WebGL')")
        assert plain.run("document.querySelector('#solid canvas').hidden")
        assert plain.run("document.querySelector('#solid img').getBoundingClientRect().width") > 200
        assert [c for c in plain.complaints() if "exception" in c.lower()] == []
    finally:
        plain.close()


@pytest.mark.slow
def test_on_a_telephone_nothing_is_wider_than_the_screen(chromium, address):
    chromium.ask(
        "Emulation.setDeviceMetricsOverride", width=400, height=900, deviceScaleFactor=1, mobile=True
    )
    try:
        chromium.open(address)
        assert chromium.run("document.documentElement.scrollWidth") == 400
        wider = chromium.run(
            "[...document.querySelectorAll('main *')].filter(e => e.getBoundingClientRect().right > 400.5)"
            ".map(e => e.tagName + ' ' + e.textContent.slice(0, 40))"
        )
        assert wider == []
        # a number that is apart from its column's head has its own label
        told = chromium.run(
            "getComputedStyle(document.querySelector('td[data-label=limit]'), '::before').content"
        )
        assert told.startswith('"limit')
    finally:
        chromium.ask("Emulation.clearDeviceMetricsOverride")


def test_passed_checks_are_folded_on_the_screen_and_shown_on_paper(page):
    states = "document.querySelector('details.passed').open"
    assert page.run(states) is False
    assert page.run("document.querySelectorAll('details.passed tr.pass').length") > 5
    assert page.run("document.querySelectorAll('tr.fail').length") == page.run(
        "[...document.querySelectorAll('tr.fail')].filter(row => !row.closest('details')).length"
    )
    page.ask("Emulation.setEmulatedMedia", media="print")
    try:
        assert page.run("document.querySelector('details.passed table').getBoundingClientRect().height") > 100
    finally:
        page.ask("Emulation.setEmulatedMedia", media="")
