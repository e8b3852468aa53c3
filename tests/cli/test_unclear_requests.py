"""Requests that name nothing, or the wrong kind of file, are refused at once with what to give."""

from __future__ import annotations

from pathlib import Path

from clacad.cli import main

ROOT = Path(__file__).parents[2]
DESIGN = str(ROOT / "designs" / "window-100mm.toml")


def test_an_atlas_of_no_rows_is_refused(tmp_path, capsys):
    assert (
        main(["atlas", "--rows", "", "-o", str(tmp_path / "a"), "--scenes", str(ROOT / "designs" / "scenes")])
        == 2
    )
    assert "names no row" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_rendering_a_design_names_the_preset_that_needs_no_scene(tmp_path, capsys):
    assert main(["render", DESIGN, "-o", str(tmp_path / "x.png")]) == 2
    assert "--preset eye" in capsys.readouterr().err


def test_a_sweep_says_which_light_it_judges(capsys):
    line = [
        "sweep",
        DESIGN,
        "--vary",
        "law.delta.0=0,0.01",
        "--set",
        "lattice.count=[4,4]",
        "--rays",
        "64",
        "--workers",
        "1",
    ]
    assert main(line) == 0
    assert "light: over the field about its middle" in capsys.readouterr().out
