"""`clacad explore` and `clacad.explore`: one file, whole or not there, the same bytes; messages and refusals."""

from __future__ import annotations

import json
from math import sqrt
from pathlib import Path

import pytest

import clacad
from clacad.cli import main
from clacad.explorer.write_page import LARGEST

DESIGN = Path(__file__).parents[2] / "designs/window-100mm.toml"


@pytest.mark.parametrize("designs", ["[ht]*.toml", pytest.param("*.toml", marks=pytest.mark.slow)])
def test_shipped_designs_have_pages_below_their_size_that_name_no_address(tmp_path, designs):
    for file in sorted(DESIGN.parent.glob(designs)):
        made = clacad.explore(clacad.load(file), tmp_path / f"{file.stem}.html")
        text = made.file.read_text()
        assert made.bytes == len(text.encode()) < LARGEST, file.stem
        assert not [
            word
            for word in ("http:", "https:", "//www", "@import", "url(", '<link rel="style')
            if word in text
        ], file.stem


def test_the_command_says_what_the_page_says_and_what_it_leaves_out(tmp_path, capsys):
    page = tmp_path / "made" / "page.html"
    assert main(["explore", str(DESIGN), "-o", str(page), "--json", "--set", 'check.object="0.2 m"']) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["file"], told["bytes"], told["written"]) == (str(page), page.stat().st_size, True)
    # by hand, in mm: p/s(1 + 1)/2; no slope free of ghosts; sqrt(lambda z)
    assert told["verdict"]["half_field"] == pytest.approx([0.05, 0.05])
    assert told["verdict"]["ghost_onset"] == [0.0, 0.0]
    assert told["verdict"]["advised_pitch"] == pytest.approx(sqrt(550e-6 * 200.0))
    assert any("glass of the slab" in one for one in told["not_shown"])
    assert any("rough" in one for one in told["not_shown"])
    assert main(["explore", str(DESIGN), "-o", str(tmp_path / "q.html"), "-q"]) == 0
    assert capsys.readouterr() == ("", "")


def test_a_dry_run_forecasts_the_size_and_writes_nothing(tmp_path, capsys):
    page = tmp_path / "page.html"
    assert main(["explore", str(DESIGN), "-o", str(page), "--dry-run", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert list(tmp_path.iterdir()) == []
    assert main(["explore", str(DESIGN), "-o", str(page)]) == 0
    assert told["bytes"] == page.stat().st_size
    assert main(["explore", str(DESIGN), "-o", str(page), "--dry-run"]) == 4
    assert "exists" in capsys.readouterr().err


def test_the_same_design_gives_the_same_bytes_and_an_existing_file_is_kept(tmp_path, capsys):
    page = tmp_path / "page.html"
    page.write_text("mine")
    assert main(["explore", str(DESIGN), "-o", str(page)]) == 4
    assert page.read_text() == "mine"
    assert main(["explore", str(DESIGN), "-o", str(page), "--overwrite"]) == 0
    first = page.read_bytes()
    assert main(["explore", str(DESIGN), "-o", str(page), "--overwrite"]) == 0
    assert page.read_bytes() == first


def test_the_page_of_the_showcase_is_the_one_that_is_made_now():
    """Else: python tests/benchmarks/gallery.py --no-views."""
    from clacad.explorer.write_page import page

    kept = DESIGN.parents[1] / "exports/showcase/explorer.html"
    assert page(clacad.load(DESIGN)) == kept.read_text(encoding="utf-8")


@pytest.mark.parametrize(("words", "status", "says"), [
    (["-o", "OUT/page.txt"], 2, "ends in .html"), (["-o", "OUT/p.html", "--set", "law.eta=[0,1]"], 2, "eta_x = 0"),
    (["-o", "OUT/p.html", "--set", "pair.separation=1"], 2, "less than half the diagonal"), ([], 2, "--out"),
    (["-o", "/proc/none/p.html"], 4, "cannot write"),
    (["-o", "OUT/p.html", "--set", "lattice.count=[1000000000,1000000000]"], 3, "lenslets"),
])  # fmt: skip
def test_what_cannot_be_is_refused_in_one_sentence_and_nothing_is_written(
    tmp_path, capsys, words, status, says
):
    assert main(["explore", str(DESIGN), *(word.replace("OUT", str(tmp_path)) for word in words)]) == status
    told = capsys.readouterr()
    assert says in told.err
    assert told.out == ""
    assert list(tmp_path.iterdir()) == []


SLAB = str(DESIGN.with_name("slab.toml"))
VARYING = ["--set", "lattice.count=[9,7]", "--set", "law.varying={gradient=[[0.001,0],[0,0.001]]}"]


def test_the_page_of_a_cell_names_it_and_how_the_others_differ(tmp_path, capsys):
    page = tmp_path / "page.html"
    dry = ["explore", SLAB, *VARYING[:2], "-o", str(page), "--dry-run", "--json", "--set"]
    for change in (VARYING[3], "lattice.pitch_2=0.501", "pair.focus={object=-300, image=400}"):
        assert main([*dry, change]) == 0
        assert json.loads(capsys.readouterr().out)["not_shown"][0].startswith("cell 4,3 of slab; the others")
    assert main(["explore", SLAB, *VARYING, "-o", str(page), "--cell", "9,0"]) == 2
    capsys.readouterr()
    assert main(["explore", SLAB, *VARYING, "-o", str(page), "--cell", "0,3", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    # by hand: delta of the last cell of the row, 8 pitches of 0.5 mm away, differs by 8 × 0.5 × 0.001
    first = "cell 0,3 of slab; the others differ by "
    assert told["not_shown"][0].startswith(first)
    assert f"{sqrt(0.004**2 + 0.0015**2):.3g} in δ" in told["not_shown"][0]
    assert first in page.read_text()
