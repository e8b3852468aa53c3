"""The designs of the paper come with the package: as templates, and with their scenes for the atlas."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from trust.running import clacad

from clacad.design import load, starter_designs, template, templates
from clacad.scene import load_scene

DESIGNS = Path(__file__).parents[2] / "designs"
COMMENTED = {
    "achromat",
    "achromat-plastic",
    "galilean",
    "hexagonal",
    "paper",
    "plano",
    "scanner-f2",
    "scanner-f5",
    "slab",
    "three-plates-10deg",
    "three-plates-15deg",
    "tilted",
    "two-plates-10deg",
    "window",
}
"""Templates of their own; the template of any other form is the design of the same name."""


@pytest.mark.parametrize("path", sorted(DESIGNS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_design_is_a_template_under_its_name(tmp_path, path):
    assert path.stem in templates()
    written = tmp_path / "mine.toml"
    written.write_text(template("my own", path.stem), encoding="utf-8")
    made, asked = load(written), load(path)
    assert made.name == "my own"
    if path.stem in COMMENTED:
        assert made.pair.form == asked.pair.form
        assert made.lattice.kind == asked.lattice.kind
    else:
        assert replace(made, name=asked.name) == asked


def test_new_writes_a_design_of_the_paper_in_any_folder(tmp_path):
    ended = clacad("new", "mine", "--template", "fig3", cwd=tmp_path)
    assert ended.status == 0, ended.err
    text, paper = (tmp_path / "mine.toml").read_text(), (DESIGNS / "fig3.toml").read_text()
    assert text == paper.replace('name = "fig3"', 'name = "mine"')


def test_a_misspelt_figure_is_told_the_nearest(tmp_path):
    ended = clacad("new", "mine", "--template", "fig33", cwd=tmp_path)
    assert ended.status == 2
    assert 'did you mean "fig3"' in ended.err
    assert not list(tmp_path.iterdir())


def test_the_folder_of_an_installed_package_comes_before_the_one_beside_it(tmp_path, monkeypatch):
    monkeypatch.setattr(starter_designs, "_PACKAGE", tmp_path / "clacad")
    with pytest.raises(FileNotFoundError, match="install it again"):
        starter_designs.shipped_designs()
    beside, within = tmp_path / "designs", tmp_path / "clacad" / "designs"
    for folder in (beside, within):
        (folder / "scenes").mkdir(parents=True)
        assert starter_designs.shipped_designs() == folder


def test_in_a_checkout_the_folder_is_the_repositorys_own():
    assert starter_designs.shipped_designs() == DESIGNS


def test_every_scene_that_comes_with_the_package_is_read_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scenes = sorted((starter_designs.shipped_designs() / "scenes").glob("*.toml"))
    assert len(scenes) > 30
    for path in scenes:
        scene = load_scene(path)
        assert scene.design().name
