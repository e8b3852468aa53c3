"""The page and its numbers: one object, no network, nothing a design writes can act."""

from __future__ import annotations

import base64
import hashlib
import importlib
import io
import json
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from PIL import Image

from clacad.checks.check import Check
from clacad.design import Design, load
from clacad.prescription.prescribe import prescribe
from clacad.report import content as contents
from clacad.report import write_report
from clacad.report.content import content
from clacad.report.pictures import seen_by_viewer
from clacad.report.report_files import Section, is_report, number
from clacad.verification import verify

TEXT = {
    "format": 1, "name": "page", "unit": "mm", "notes": ["<script>alert(1)</script> & \"quotes\""],
    "law": {"eta": [-1.0, -1.0]}, "pair": {"form": "slab", "separation": 10.0, "index": 1.5},
    "lattice": {"pitch": 0.5, "count": 6},
}  # fmt: skip


@pytest.fixture(scope="module")
def report():
    return verify(Design.from_dict(TEXT), rays=2048).with_evidence()


@pytest.fixture(scope="module")
def made(report):
    """The report with everything its page shows."""
    return content(report, lambda _stage, _part: None)


@pytest.fixture(scope="module")
def page(made, tmp_path_factory):
    html, _ = write_report(made, tmp_path_factory.mktemp("report"))
    return html.read_text(encoding="utf-8")


@pytest.fixture
def short(monkeypatch):
    """A page of the checks alone, for what does not depend on the figures."""
    home = importlib.import_module("clacad.report.report_files")
    monkeypatch.setattr(home, "SECTIONS", tuple(s for s in home.SECTIONS if s[0] == "checks"))


class Outline(HTMLParser):
    """Collects tags with their attributes, and notices what would load or run something."""

    VOID = {"meta", "link", "img", "br", "hr", "input"}

    def __init__(self):
        super().__init__()
        self.tags, self.open, self.bad, self.text = [], [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name.startswith("on") or (
                name in ("src", "href", "xlink:href") and not (value or "").startswith(("#", "data:"))
            ):
                self.bad.append((tag, name, value))

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag not in self.VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def outline(page):
    parser = Outline()
    parser.feed(page)
    parser.close()
    return parser


def test_the_page_is_well_formed_and_loads_nothing(page):
    found = outline(page)
    assert found.open == []
    assert found.bad == []
    assert not [tag for tag, _ in found.tags if tag in ("iframe", "object", "embed", "form", "base")]
    assert [a for t, a in found.tags if t == "link"] == [{"rel": "icon", "href": "data:,"}]
    policy = next(
        a["content"]
        for t, a in found.tags
        if t == "meta" and a.get("http-equiv") == "Content-Security-Policy"
    )
    assert "default-src 'none'" in policy
    assert "http" not in policy
    assert "unsafe-eval" not in policy
    scripts = re.findall(r"<script[^>]*>(.*?)</script>", page, flags=re.DOTALL)
    assert len(scripts) == 1
    digest = base64.b64encode(hashlib.sha256(scripts[0].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in policy
    assert not re.search(r"url\((?!#)", page)
    assert len(page.encode()) < 5_000_000


def test_what_a_design_says_is_text_and_nothing_else(page):
    assert "<script>" not in page
    assert '<script>alert(1)</script> & "quotes"' in "".join(outline(page).text)


def test_the_verdict_comes_first_and_is_that_of_the_report(report, page):
    text = "".join(outline(page).text)
    assert report.verdict() in text
    assert text.index(report.verdict()) < text.index("Checks")


def test_every_check_is_on_the_page_and_in_the_numbers(report, page):
    text = re.sub(r"\s+", " ", "".join(outline(page).text))
    numbers = json.loads(report.to_json())
    assert not {"evidence"} & set(numbers)
    assert [c["id"] for c in numbers["checks"]] == [c.id for c in report.checks]
    for check in report.checks:
        assert re.sub(r"\s+", " ", check.sentence) in text
        assert check.code in text


def test_every_figure_has_something_drawn_and_a_caption(page):
    figures = re.findall(r"<figure>(.*?)</figure>", page, flags=re.DOTALL)
    assert len(figures) >= 15
    for figure in figures:
        assert "<figcaption>" in figure
        if "<img" in figure:
            assert re.search(r'alt="[^"]{15,}"', figure)
            continue
        assert sum(figure.count(f"<{shape}") for shape in ("path", "use", "polygon", "polyline")) > 8
        assert 'role="img"' in figure
        assert "aria-label=" in figure


def test_the_page_and_the_exit_status_are_one_object(report, made, short, tmp_path):
    failing = replace(report, checks=(*report.checks, Check("eta", "fail", "off by a lot", 0.5, 0.01)))
    html, numbers = write_report(replace(made, report=failing), tmp_path)
    assert failing.exit_status == 1
    assert json.loads(numbers.read_text(encoding="utf-8"))["passed"] is False
    text = html.read_text(encoding="utf-8")
    assert "<b>Failed</b>" in text
    assert text.count("off by a lot") == 2  # at the head and in the table
    assert 'class="verdict passed"' not in text


def test_a_check_that_did_not_run_is_never_green(report, made, short, tmp_path):
    first = report.checks[0]
    missing = replace(report, checks=(replace(first, state="not run", value=None), *report.checks[1:]))
    html, _ = write_report(replace(made, report=missing), tmp_path)
    assert missing.exit_status == 1
    text = html.read_text(encoding="utf-8")
    row = re.search(
        rf'<tr class="([a-z-]+)"><td class="state">([^<]+)</td><td><span class="mono">{first.id}<', text
    )
    assert row is not None
    assert row.groups() == ("not-run", "not run")
    assert "<b>Failed</b>" in text


@pytest.mark.long
def test_the_same_report_gives_the_same_bytes(page, made, tmp_path):
    """Measured, pictured and drawn again from the design."""
    html, numbers = write_report(verify(Design.from_dict(TEXT), rays=2048), tmp_path)
    assert html.read_text(encoding="utf-8") == page
    _, again = write_report(made, tmp_path / "again")
    assert numbers.read_bytes() == again.read_bytes()


def test_a_report_replaces_a_report_but_nothing_else(made, short, tmp_path):
    from clacad.storage.errors import CannotWrite

    write_report(made, tmp_path)
    write_report(made, tmp_path)
    assert json.loads((tmp_path / "run.json").read_text())["seconds"] > 0.0
    for name, text in (("report.html", "a page of somebody else"), ("report.json", '{\n "checks": 1\n}')):
        kept = (tmp_path / name).read_text()
        (tmp_path / name).write_text(text)
        with pytest.raises(CannotWrite):
            write_report(made, tmp_path)
        assert (tmp_path / name).read_text() == text
        (tmp_path / name).write_text(kept)
    write_report(made, tmp_path, overwrite=True)


def test_run_facts_of_an_export_are_left_alone(made, short, tmp_path):
    (tmp_path / "run.json").write_text('{"seconds": 3}')
    write_report(made, tmp_path)
    assert (tmp_path / "run.json").read_text() == '{"seconds": 3}'


def test_no_number_of_the_page_is_a_nan(page):
    text = "".join(outline(page).text)
    assert not re.search(r"\b(nan|NaN|inf)\b", text)


def test_numbers_are_shown_in_milliradians_and_missing_ones_as_a_dash():
    assert number(0.00265, "rad") == "2.65"
    assert number(None) == "–"
    assert number(float("inf")) == "none"


@pytest.mark.slow
def test_figures_use_no_global_state_of_matplotlib(report):
    import matplotlib as mpl

    figures = importlib.import_module("clacad.report.figures")
    before = dict(mpl.rcParams)
    figures.transfer(report)
    assert dict(mpl.rcParams) == before


def test_names_inside_the_drawings_are_each_used_once(page):
    names = [a["id"] for _, a in outline(page).tags if "id" in a]
    assert len(names) == len(set(names))
    wanted = set(re.findall(r'url\(#([^)]+)\)|href="#([^"]+)"', page))
    assert {a or b for a, b in wanted} <= set(names)


def test_the_numbers_hold_what_the_page_shows(made, page):
    numbers = json.loads(json.dumps(contents.numbers(made)))
    text = "".join(outline(page).text)
    for key in (
        "attribution",
        "foci",
        "ghosts",
        "accuracy",
        "effects",
        "fabrication",
        "budget",
        "transfer",
        "field",
    ):
        assert numbers[key], key
    for part in numbers["attribution"][0]["parts"]:
        assert f"{1e3 * part['rms']:.3g}" in text
    for row in numbers["fabrication"]["rows"]:
        for value in row["value"] if isinstance(row["value"], list) else [row["value"]]:
            assert (value if isinstance(value, str) else f"{value:.6g}") in text or abs(value) < 1e-12
    for row in numbers["accuracy"]["rows"]:
        assert f"{1e3 * row['model_rms']:.3g}" in text
    for row in numbers["effects"]["effects"]:
        assert row["why"] in text


def test_seconds_of_the_run_are_in_the_report_only_when_asked_for(made, page, short, tmp_path):
    assert "timings" not in contents.numbers(made)
    assert "--timings" not in page
    html, told = write_report(replace(made, timings=True), tmp_path)
    assert json.loads(told.read_text())["timings"][0]["seconds"] >= 0.0
    assert "--timings" in html.read_text(encoding="utf-8")


def test_further_sections_come_after_the_pages_own(made, short, tmp_path):
    html, _ = write_report(
        made, tmp_path, more=[Section("extra", "Something more", "<p>its <b>body</b></p>")]
    )
    text = html.read_text(encoding="utf-8")
    assert '<a href="#extra">Something more</a>' in text
    assert "<p>its <b>body</b></p>" in text
    assert text.index('id="checks"') < text.index('id="extra"') < text.index('id="again"')


def test_where_a_limit_comes_from_is_said(report):
    given = {**TEXT, "check": {"law_rms": "9 mrad", "eta": 0.02}}
    found = {c.id: c for c in verify(Design.from_dict(given), rays=2048).checks}
    assert found["law_rms"].source == "design file"
    assert found["eta"].source == "design file"
    assert found["spread"].source == "derived from law_rms (design file)"
    assert found["law_bias"].source == "default"
    assert {c.id: c for c in report.checks}["law_rms"].source == "default"
    assert found["edge"].source.startswith("process profile none")


def test_headings_and_controls_have_names_and_the_page_can_be_walked_by_keyboard(page):
    found = outline(page)
    assert [a.get("lang") for t, a in found.tags if t == "html"] == ["en"]
    images = [a for t, a in found.tags if t == "img"]
    assert len(images) >= 3
    assert all(a.get("alt") for a in images)
    canvas = next(a for t, a in found.tags if t == "canvas")
    assert canvas["tabindex"] == "0"
    assert "Arrow keys" in canvas["aria-label"]
    anchors = {a["href"][1:] for t, a in found.tags if t == "a" and a.get("href", "").startswith("#")}
    assert anchors <= {a["id"] for _, a in found.tags if "id" in a}


@pytest.mark.long
def test_the_paper_version_says_the_same_and_is_the_same_every_time(made, short, tmp_path, monkeypatch):
    pytest.importorskip("typst")
    paper = importlib.import_module("clacad.report.pdf")
    compose, composed = paper._document, []

    def kept(content, shelf):
        composed.append(compose(content, shelf))
        return composed[-1]

    monkeypatch.setattr(paper, "_document", kept)
    *_, path = write_report(made, tmp_path, pdf=True)
    data = path.read_bytes()
    assert data.startswith(b"%PDF")
    assert data == paper.pdf_bytes(made)
    assert is_report(path)
    said = json.dumps(composed[0], ensure_ascii=False)
    for check in made.report.checks:
        assert json.dumps(check.sentence, ensure_ascii=False)[1:-1] in said
    for about, lines in made.fabrication:
        assert about in said
        assert all(json.dumps(line.text, ensure_ascii=False) in said for line in lines)
    for part in made.light.attributions[0]["parts"]:
        assert all(json.dumps(value, ensure_ascii=False) in said for value in part)


def test_without_the_typesetter_the_error_says_what_to_install(made, tmp_path, monkeypatch):
    from clacad.report.pdf import PdfMissing

    monkeypatch.setitem(sys.modules, "typst", None)
    with pytest.raises(PdfMissing, match=r"clacad\[pdf\]") as error:
        write_report(made, tmp_path / "new", pdf=True)
    assert error.value.exit_status == 2
    assert not (tmp_path / "new").exists()


@pytest.mark.slow
def test_progress_is_told_from_beginning_to_end(report, tmp_path, short):
    told = []
    full = verify(Design.from_dict(TEXT), rays=2048, progress=lambda stage, _part: told.append(stage))
    write_report(
        replace(full, evidence=report.evidence), tmp_path, progress=lambda stage, _part: told.append(stage)
    )
    assert list(dict.fromkeys(told)) == [
        "building the window", "tracing the exact surfaces", "tracing the field of view", "done",
        "looking through the sheet", "meshing the parts to look at", "drawing the report",
    ]  # fmt: skip
    assert all(len(stage) < 60 for stage in told)


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ["window-100mm", "paper-base"])
def test_a_whole_report_is_small_whatever_the_count_of_lenslets(name, tmp_path):
    """How long it takes is in tests/benchmarks/report.md."""
    design = load(Path(__file__).parents[2] / "designs" / f"{name}.toml")
    html, _ = write_report(verify(design), tmp_path)
    assert html.stat().st_size < 5_000_000


def test_waves_stand_in_the_page_where_an_effect_or_coherent_light_calls_for_them(made, monkeypatch):
    from clacad.waves import wave

    home = importlib.import_module("clacad.report.report_files")
    monkeypatch.setattr(home, "SECTIONS", tuple(s for s in home.SECTIONS if s[0] == "effects"))
    evidence = made.report.evidence
    assert ("diffraction" in evidence.plan.names) is (evidence.waves is not None) is False
    assert "<h3>Waves</h3>" not in home.sections(made)[0].body
    assert "waves" not in evidence.to_dict()
    found = wave(made.report.design)
    told = replace(made, report=replace(made.report, evidence=replace(evidence, waves=found)))
    body = home.sections(told)[0].body
    assert "<h3>Waves</h3>" in body
    assert "waves, exact surfaces" in body
    assert f"{found.share:.4g}" in body
    assert told.evidence.to_dict()["waves"]["share"] == found.share


@pytest.mark.slow
def test_a_design_in_coherent_light_has_its_waves_measured(monkeypatch):
    evidence = importlib.import_module("clacad.verification.evidence")
    monkeypatch.setattr(evidence, "climb", lambda *_: None)  # the ladder is another's
    coherent = Design.from_dict({**TEXT, "light": {"coherent": True}})
    found = verify(coherent, rays=1024).with_evidence()
    assert found.evidence.waves.exact is not None
    assert "orders" in {check.id for check in found.checks}


def test_the_first_screen_has_the_share_and_the_view_of_the_viewer(report, page):
    head = page.partition("<header>")[2].partition("</header>")[0]
    (check,) = (c for c in report.checks if c.id == "viewed")
    assert f"{100.0 * check.value:.3g} % of the light of an assumed eye at (0, 0, -1000) mm" in head
    assert f"limit {100.0 * check.limit:.4g} %" in head
    (picture,) = re.findall(r'<img src="data:image/png;base64,([^"]+)"', head)
    with Image.open(io.BytesIO(base64.b64decode(picture))) as image:
        assert image.size == (200, 200)


@pytest.mark.slow
def test_the_view_is_that_of_the_stated_viewer_and_none_of_one_behind_the_sheet():
    design = Design.from_dict(TEXT)
    window = prescribe(design)
    near, far = (seen_by_viewer(design.replace({"check.viewer": d}), window) for d in (200, 800))
    assert near != far
    for nowhere in ({"check.viewer": 0.01}, {"check.viewer": 1e9, "check.object": 1e9}):
        assert seen_by_viewer(design.replace(nowhere), window) is None
    behind = design.replace({"lattice.aperture": {"point": [0, 0, 400]}})
    assert seen_by_viewer(behind, prescribe(behind)) is None


@pytest.mark.slow
def test_lines_of_white_light_and_temperatures_have_a_row_each_with_the_floor_and_its_source(page):
    """The mean is that of another program for this sheet, .293 mrad, and the floor .285; a bare index has none."""
    from clacad.report.rows import LightRows

    design = load(Path(__file__).parents[2] / "designs" / "window-100mm.toml").with_cells((12, 12))
    rows = LightRows(verify(design, rays=4096), None, timings=False)
    table = {row[0]: row[1:] for row in rows.daylight}
    assert list(table) == ["486.1 nm", "546.1 nm", "587.6 nm", "656.3 nm", "mean", "-20 K", "+20 K"]
    assert float(table["mean"][1]) == pytest.approx(0.293, rel=0.01)
    assert all(
        float(change) == pytest.approx(float(closed), rel=0.03) for _, _, change, closed, _ in table.values()
    )
    floor = re.search(r"less than ([0-9.]+) mrad", rows.daylight_sentence)
    assert float(floor[1]) == pytest.approx(0.2848, rel=0.01)
    assert "Kasarova et al. 2007" in rows.daylight_sentence
    unknown = LightRows(verify(design.replace("pair.material", "SAN"), rays=1024), None, timings=False)
    assert "no published value is in the table" in unknown.daylight_sentence
    assert "Daylight and temperature" not in page


@pytest.mark.slow
def test_the_page_shows_the_lines_of_white_light(tmp_path, monkeypatch):
    home = importlib.import_module("clacad.report.report_files")
    monkeypatch.setattr(home, "SECTIONS", tuple(s for s in home.SECTIONS if s[0] == "errors"))
    glass = {**TEXT, "pair": {"form": "slab", "separation": 10.0, "material": "PMMA", "wavelength": 546.1}}
    found = verify(Design.from_dict(glass), rays=2048).with_evidence()
    html, _ = write_report(content(found, lambda _stage, _part: None), tmp_path)
    text = html.read_text(encoding="utf-8")
    assert "<h3>Daylight and temperature</h3>" in text
    assert text.count("486.1 nm</td>") == 1
