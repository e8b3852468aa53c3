"""Names and contents of untrusted files, manifests and designs: shown, and never read as markup, formula or command."""

from __future__ import annotations

import csv
import io
import json
import xml.etree.ElementTree as ElementTree
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from filesonly import only_files
from oracle.plain_mesh import sheet_facets, write_stl

from clacad.base import log
from clacad.base.drawn_figure import drawn, no_formula
from clacad.cli import main
from clacad.cli.console import say, show_text
from clacad.design import Design
from clacad.prescription.prescribe import prescribe
from clacad.report import write_report
from clacad.report.figures import svg
from clacad.storage.atomic import canonical_json, file_hash
from clacad.verification import Report, verify
from clacad.verification.tolerance.study_files import harmless_cell

MARKUP = '"><h1>PASSED<i b="<script>alert(1)<!script> $\\frac$ =1+1 &amp; {{ 7*7 }} #set'
NAME = f"a{MARKUP}.stl"
CONTROL = "b\x1b[31m\n\u202e\x9b2J\r\udcff.stl"
TEXT = {
    "format": 1, "name": "page (1)", "unit": "mm", "notes": [MARKUP, "@SUM(A1)"],
    "law": {"eta": [-1.0, -1.0]}, "pair": {"form": "slab", "separation": 10.0, "index": 1.5},
    "lattice": {"pitch": 0.5, "count": 3},
    "check": {"allow": [{"code": "CL311", "reason": MARKUP}]},
}  # fmt: skip


def delivery(folder: Path, names: list[str], told: str) -> Path:
    """A folder with coarse meshes of these names, and a manifest that describes them in hostile words."""
    folder.mkdir()
    soup = sheet_facets(prescribe(Design.from_dict(TEXT)), 4)
    files = []
    for name in names:
        write_stl(folder / name, soup)
        path = folder / name
        files.append({"name": name, "sha256": file_hash(path), "bytes": path.stat().st_size, "format": "stl-binary",
                      "unit": told, "bodies": ["sheet"], "role": "optical-master", "note": told})  # fmt: skip
    files.append(
        {"name": f"gone {told}", "sha256": told, "bytes": told, "format": told, "bodies": [told, told]}
    )
    document = {"format": 1, "design": {"name": told, "sha256": told}, "files": files, "versions": {told: told},
                "options": {told: told}}  # fmt: skip
    (folder / "manifest.json").write_text(
        json.dumps(document) if "\udcff" in told else canonical_json(document)
    )
    return folder


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    folder = delivery(tmp_path_factory.mktemp("hostile") / "d", [NAME.replace("/", "!")], MARKUP)
    with pytest.MonkeyPatch.context() as patched:
        only_files(patched)
        return verify(Design.from_dict(TEXT), folder, rays=256).with_evidence()


class Tags(HTMLParser):
    """Counts tags, and gathers attributes and text."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: Counter[str] = Counter()
        self.attributes: list[tuple[str, str | None]] = []
        self.shown = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1
        self.attributes += attrs

    def handle_data(self, data: str) -> None:
        self.shown += data


@pytest.mark.slow
def test_the_page_and_the_pdf_show_every_stranger_s_word_and_obey_none(
    report: Report, tmp_path: Path
) -> None:
    typst = pytest.importorskip("typst", reason="the PDF is an extra")
    html, numbers, pdf = write_report(report, tmp_path, pdf=True)
    page = Tags()
    page.feed(html.read_text())
    assert page.tags["h1"] == 1
    assert page.tags["i"] == 0
    assert page.tags["script"] == 1
    assert "49" not in page.shown.split("7*7")[1][:5]
    assert page.shown.count("<h1>PASSED<i") >= 5
    assert {name for name, _ in page.attributes if name.startswith("on") or name == "b"} == set()
    for drawing in html.read_text().split("<svg ")[1:]:
        ElementTree.fromstring("<svg " + drawing.split("</svg>")[0] + "</svg>")
    assert "<h1>PASSED" in json.dumps(json.loads(numbers.read_text()))
    assert pdf.read_bytes().startswith(b"%PDF")
    assert typst is not None


def test_a_drawing_says_what_it_shows_in_one_attribute() -> None:
    text = svg(2.0, 1.0, f"error of {MARKUP}", lambda figure: figure.subplots())
    element = ElementTree.fromstring(text)
    assert element.attrib["aria-label"] == f"error of {MARKUP}"
    assert "h1" not in {child.tag.rpartition("}")[2] for child in element.iter()}


@pytest.mark.parametrize("text", ["$\\frac$", "$", "$$", "a$b$c", "\\$", NAME])
def test_a_name_in_a_figure_is_no_formula(text: str) -> None:
    def draw(figure: object) -> None:
        panel = figure.subplots()  # type: ignore[attr-defined]
        panel.barh([no_formula(text)], [1.0])
        panel.set_title(no_formula(text))

    assert drawn("png", (9.0, 2.0), draw, {}).startswith(b"\x89PNG")


@pytest.mark.parametrize("cell", ["=1+1", "+1+1", "-1+1", "@SUM(A1)", "\t=1", "\r=1", "=cmd|' /C calc'!A0"])
def test_no_cell_of_a_table_is_a_formula(cell: str) -> None:
    assert harmless_cell(cell) == f"'{cell}"


@pytest.mark.parametrize(
    "cell", ["-1.5", "+2", "1e-300", "-inf", "nan", "", "slab", "a=b", "0.5 mm", "failed: -3"]
)
def test_numbers_and_words_of_a_table_stay_as_they_are(cell: str) -> None:
    assert harmless_cell(cell) == cell


@pytest.mark.slow
def test_a_sweep_over_words_writes_no_formula(tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    path.write_text(json.dumps({key: value for key, value in TEXT.items() if key not in ("notes", "check")}))
    words = [
        "sweep",
        str(path),
        "--vary",
        "pair.confocal==1+1,@A1,exact",
        "-o",
        str(tmp_path / "out"),
        "--rays",
        "64",
        "--workers",
        "1",
        "-q",
    ]
    assert main(words) in (0, 1)
    rows = list(csv.reader(io.StringIO((tmp_path / "out" / "sweep.csv").read_text())))
    assert {row[0] for row in rows[1:]} == {"'=1+1", "'@A1", "exact"}


@pytest.mark.slow
def test_a_stranger_s_name_steers_no_terminal_and_the_log_is_plain_lines(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    only_files(monkeypatch)
    folder = delivery(tmp_path / "d", [CONTROL], CONTROL)
    design = tmp_path / "t.json"
    design.write_text(json.dumps(TEXT))
    assert main(["verify", str(design), "--files", str(folder), "--rays", "64", "-v"]) == 1
    told = capsys.readouterr()
    for text in (told.out, told.err):
        assert all(c == "\n" or c.isprintable() for c in text if c not in "\u202f\xa0")
    assert main(["verify", str(design), "--files", str(folder / f"no{CONTROL}"), "--rays", "64"]) == 2
    assert all(c == "\n" or c.isprintable() for c in capsys.readouterr().err)


def test_what_is_said_never_moves_the_cursor(capsys: pytest.CaptureFixture[str]) -> None:
    show_text("one\x1b[2J\ntwo\u202e\n")
    say("three\x9b1m\r")
    assert capsys.readouterr() == ("one?[2J\ntwo?\n", "three?1m?\n")


def test_a_line_of_the_log_stays_one_line_whatever_is_in_it() -> None:
    stream = io.StringIO()
    log.start(stream)
    try:
        log.note("file", name=CONTROL + "\u2028" + MARKUP, number=np.float64(1.5))
    finally:
        log.stop()
    (line,) = stream.getvalue().splitlines()
    assert line.isascii()
    assert json.loads(line)["name"] == CONTROL + "\u2028" + MARKUP
