"""The shipped designs: each loads, and those of the paper hold the paper's numbers."""

from __future__ import annotations

from pathlib import Path

import pytest

from clacad.design import load

DESIGNS = Path(__file__).parents[2] / "designs"
FILES = sorted(DESIGNS.glob("*.toml"))
PAPER = [path for path in FILES if path.stem.startswith(("paper", "fig"))]
LITERAL = [path for path in PAPER if path.stem not in ("paper-a-covered", "paper-b", "paper-c", "fig1b")]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_every_shipped_design_loads_is_named_as_its_file_and_says_what_it_is(path):
    design = load(path)
    assert design.name == path.stem
    assert path.read_text(encoding="utf-8").startswith("#:schema clacad.schema.json\n# ")


@pytest.mark.parametrize("path", LITERAL, ids=lambda path: path.stem)
def test_a_figure_is_the_base_sheet_with_another_law(path):
    base, design = load(DESIGNS / "paper-base.toml"), load(path)
    assert (design.pair, design.lattice, design.unit) == (base.pair, base.lattice, base.unit)


@pytest.mark.parametrize("path", PAPER, ids=lambda path: path.stem)
def test_a_paper_design_names_what_the_text_leaves_open(path):
    notes = " ".join(load(path).notes)
    assert "index" in notes
    tells_ratio = "1:10" in notes or "1:100" in notes
    assert tells_ratio or path.stem == "fig1b"


def test_the_three_readings_differ_by_exactly_what_contradicts_the_text():
    a, b, c = (load(DESIGNS / f"paper-{name}.toml") for name in ("base", "b", "c"))
    assert [d.lattice.count for d in (a, b, c)] == [(200, 200), (200, 200), (2000, 2000)]
    assert [d.lattice.pitch[0] for d in (a, b, c)] == [0.005, 0.005, 0.0005]
    assert [d.pair.separation for d in (a, b, c)] == [0.05, 0.5, 0.05]
    assert {d.pair.thickness for d in (a, b, c)} == {0.0005}
    assert {d.law_spec for d in (a, b, c)} == {a.law_spec}
    for d in (a, b, c):
        assert d.lattice.pitch[0] * d.lattice.count[0] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("stem", "eta", "delta", "euler"),
    [
        ("fig2-eta-1", (-1.0, -1.0), (0, 0), (0, 0, 0)),
        ("fig2-eta-0.5", (-0.5, -1.0), (0, 0), (0, 0, 0)),
        ("fig2-eta-0.25", (-0.25, -1.0), (0, 0), (0, 0, 0)),
        ("fig2-eta-2", (-2.0, -1.0), (0, 0), (0, 0, 0)),
        ("fig3", (-0.25, -1.0), (0, 0), (0, 0, 0)),
        ("fig4-delta-0.005-0.01", (-0.25, -1.0), (0.005, 0.01), (0, 0, 0)),
        ("fig5-phi-45", (-0.25, -1.0), (0, 0), (45, 0, 0)),
        ("fig6-theta-0.5", (-0.25, -1.0), (0, 0), (45, 0.5, 0)),
        ("fig7-psi-180", (-0.25, -1.0), (0, 0), (45, 0.5, 180)),
        ("fig8", (-0.25, -1.0), (0, 0), (45, 0.5, 90)),
        ("fig1b", (-0.25, -1.0), (0, 0), (45, 0.5, 90)),
    ],
)
def test_a_figure_has_the_parameters_the_text_gives(stem, eta, delta, euler):
    law = load(DESIGNS / f"{stem}.toml").law_spec
    assert (law.eta, law.delta, law.euler_degrees, law.euler_axes) == (eta, delta, euler, "fixed")


def test_the_window_is_100_mm_of_200_cells_in_acrylic():
    window = load(DESIGNS / "window-100mm.toml")
    assert window.pair.form == "slab"
    assert window.pair.material == "PMMA"
    width = window.lattice.pitch[0] * window.lattice.count[0] * window.unit_m
    assert width == pytest.approx(0.1)
    assert window.pair.separation / window.lattice.pitch[0] >= 20


def test_each_form_kind_and_sign_of_eta_has_a_design():
    designs = [load(path) for path in FILES]
    assert {d.pair.form for d in designs} == {"biconvex", "plano", "slab"}
    assert {d.lattice.kind for d in designs} >= {"square", "hexagonal"}
    assert any(0 < d.law_spec.eta[0] < 1 for d in designs)
    assert any(d.lattice.seam > 0 for d in designs)
