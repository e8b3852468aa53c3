"""Drawings and frames of non-uniform sheets, read by ezdxf, pdftotext and the kernel."""

from __future__ import annotations

import re
import shutil
import subprocess

import numpy as np
import pytest

import clacad

PAIR = {
    "format": 1, "name": "aimed-pair", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "plano", "separation": 10, "material": "PMMA", "wavelength": 550, "offset": "paraxial", "thickness": [1.5, 1.5]},
    "lattice": {"pitch": 0.5, "count": [9, 7], "aperture": {"point": [30, -20, -1500]}},
    "body": {"border": 6}, "check": {"process": "none"},
}  # fmt: skip
SCALE = 1.0 + 10.0 / 1500.0
"""Pitch of array 2 over that of array 1, for light in air: the plates are crossed nearly straight on."""


def design(**changes):
    return clacad.Design.from_dict(PAIR).replace(changes)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    pytest.importorskip("ezdxf", reason="the extra dxf is not installed")
    pytest.importorskip("typst", reason="the extra pdf is not installed")
    folder = tmp_path_factory.mktemp("drawn") / "out"
    clacad.export(design(), folder, formats=("drawing",))
    return folder


def rows_of(words):
    """Rows of the table of cells: name, index, then pairs of numbers and steps."""
    found = {}
    for at, word in enumerate(words):
        if word in ("first", "middle", "worst"):
            found[word] = [[float(v) for v in one.split(", ")] for one in words[at + 1 : at + 8]]
    return found


@pytest.mark.slow
def test_the_drawing_names_the_key_and_tables_the_first_the_middle_and_the_worst_cell(drawn):
    import ezdxf

    texts = [text.dxf.text for text in ezdxf.readfile(next(drawn.glob("*.dxf"))).modelspace().query("TEXT")]
    assert "not uniform (lattice.aperture.point)" in " ".join(texts)
    rows = rows_of(texts)
    assert [rows[name][0] for name in ("first", "middle", "worst")] == [[0, 0], [4, 3], [0, 6]]
    for (i, j), centre, apex, step, partner, lens, highest in rows.values():
        c1 = np.array([i - 4, j - 3]) * 0.5
        aim = np.array([30.0, -20.0])
        assert centre == c1.tolist()
        assert apex == [0.0, 0.0]
        assert step == [0.0]
        c2 = (
            c1 + (c1 - aim) * 10.0 / 1500.0
        )  # where the light of the viewer through the middle of cell 1 arrives
        assert partner == pytest.approx(c2, abs=2e-4)
        assert lens == pytest.approx(c1 - c2, abs=2e-4)  # lens 2 stays over lens 1
        along = (
            0.5 * SCALE * np.abs(lens) / 2.468
        )  # two spheres side by side: pitch × offset / radius, by parabolas
        assert along.max() < highest[0] < 1.2 * along.sum()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("pdftotext") is None, reason="pdftotext is not installed")
def test_the_pdf_says_the_same(drawn):
    made = subprocess.run(
        ["pdftotext", "-layout", next(drawn.glob("*.pdf")), "-"], check=True, capture_output=True, text=True
    )
    words = re.sub(r"\s+", " ", made.stdout)
    # a text of the views can come between two lines of a note
    assert re.search(
        r"The sheet is not uniform \(lattice\.aperture\.point\): the views show the cell nearest .{0,40}?the middle",
        words,
    )
    assert re.search(r"worst 0, 6 -2, 1.5", words)
    assert "by cell, by cell, " in words


@pytest.mark.slow
def test_the_view_of_lens_2_is_of_a_cell_as_wide_as_those_of_its_own_array(drawn):
    import ezdxf

    measured = [
        float(np.asarray(one.get_measurement())) * one.override().get("dimlfac")
        for one in ezdxf.readfile(next(drawn.glob("*.dxf"))).modelspace().query("DIMENSION")
    ]
    assert any(value == pytest.approx(0.5 * SCALE, rel=3e-5) for value in measured)
    assert any(value == pytest.approx(0.5, rel=3e-5) for value in measured)
