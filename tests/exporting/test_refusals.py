"""Every format's refusal comes before the first byte of any, and a dry run reports all of them."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

import pytest

import clacad
from clacad.cli import main
from clacad.exporting.run import export
from clacad.solid.marks import TALL, WIDEST, lettering
from clacad.storage.errors import LimitRefused, NotPossible

DESIGNS = Path(__file__).parents[2] / "designs"
PLANO = str(DESIGNS / "plano.toml")


def plano(*changes: str) -> clacad.Design:
    return clacad.load(PLANO, overrides=["lattice.count=[3, 3]", *changes])


@pytest.mark.parametrize(
    ("format", "changes", "words"),
    [
        ("baffle", (), "has no baffle: set body.baffle"),
        ("frame", (), "no flat border|body.border"),
        ("marked", (), "give body.border a width"),
        ("marked-stl", (), "give body.border a width"),
        ("marked-3mf", ("body.border=0.1",), "body.border >= '0.4 mm'"),
        pytest.param(
            "marked-stl",
            ("body.border=0.42", "lattice.count=[1, 1]", f"name={'n' * 80}"),
            "a shorter name",
            marks=pytest.mark.slow,
            id="a name drawn to see that it is too long",
        ),
    ],
)
def test_nothing_is_written_of_any_format_where_one_cannot_be(tmp_path, monkeypatch, format, changes, words):
    monkeypatch.setattr(import_module("clacad.storage.atomic").Stage, "path", None)  # no file is even named
    with pytest.raises(NotPossible, match=words):
        export(plano(*changes), tmp_path / "x", ("table", "stl", format), quads=2)
    assert list(tmp_path.iterdir()) == []


def test_solids_of_too_many_cells_are_refused_before_the_other_files(tmp_path):
    with pytest.raises(LimitRefused, match="BREP of 3,600 cells"):
        export(plano("lattice.count=[60, 60]"), tmp_path / "x", ("table", "brep"), force=True)
    assert not (tmp_path / "x").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("format", "limit"), [("glb", "formats.mesh.glb.MOST_NODES"), ("3mf", "formats.mesh.threemf.MOST_PLACES")]
)
def test_a_file_of_more_places_than_its_reader_takes_is_refused_before_it_is_written(
    tmp_path, monkeypatch, format, limit
):
    """With the reader's own limit made as small: what it does not take is refused, even if forced; what is not, is read."""
    monkeypatch.setattr(f"clacad.{limit}", 2200)
    with pytest.raises(LimitRefused, match=r"(nodes|places) are more than the 2,200 .*--cells (\d+)x\2"):
        export(plano(), tmp_path / "x", (format,), quads=2, cells=(50, 30), force=True)
    assert not (tmp_path / "x").exists()
    export(plano(), tmp_path / "x", (format,), quads=2, cells=(10, 10))
    export(plano(), tmp_path / "y", ("glb",), quads=2, cells=(50, 30), gpu_instancing=True)


def test_a_dry_run_tells_all_refusals_at_once(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(import_module("clacad.formats.maps.gds"), "find_spec", lambda name: None)
    asked = ["export", PLANO, "-o", str(tmp_path / "x"), "--format", "table,gds,baffle,frame,marked,brep,stl", "--quads",
             "stl=2000", "--cells", "60x60"]  # fmt: skip
    assert main([*asked, "--dry-run"]) == 2
    said = capsys.readouterr().err
    for words in ("clacad[gds]", "has no baffle", "body.border", "BREP of 3,600 cells", "stl: at least"):
        assert said.count(words) >= 1
    assert main(asked) == 2
    assert capsys.readouterr().err.count("has no baffle") == 1
    assert list(tmp_path.iterdir()) == []


def test_what_a_target_measures_is_not_measured_where_a_format_cannot_be(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(import_module("clacad.verification.accuracy.choose_setting"), "facets_for", None)
    assert (
        main(["export", PLANO, "-o", str(tmp_path / "x"), "--format", "stl,baffle", "--target", "5 mrad"])
        == 2
    )
    assert "has no baffle" in capsys.readouterr().err


def test_a_table_that_is_not_written_is_refused_before_the_sweep(monkeypatch, capsys):
    monkeypatch.setattr(import_module("clacad.verification.tolerance.parameter_sweep"), "sweep", None)
    monkeypatch.setattr(import_module("clacad.verification.tolerance"), "sweep", None)
    monkeypatch.setattr(
        import_module("clacad.verification.tolerance.study_files"), "find_spec", lambda name: None
    )
    sweep = ["sweep", PLANO, "--vary", "pair.separation=5:6:2"]
    for word, said in (("parquet", "clacad[parquet]"), ("xls", "csv or parquet")):
        assert main([*sweep, "--format", word]) == 2
        assert said in capsys.readouterr().err


@pytest.mark.slow
def test_no_letter_is_wider_or_taller_than_what_tells_without_drawing_that_a_line_fits():
    for text in ("W" * 20, "M" * 20, "@" * 20, "VIEWER SIDE", "jgpqy()" * 3, "ÅÄÖŒ"):
        box = lettering(text, 1.0).bounding_box()
        assert box.size.X <= WIDEST * len(text)
        assert box.size.Y <= TALL / 0.7


@pytest.mark.parametrize("how", [(), ("--dry-run",)])
@pytest.mark.parametrize("inside", ["a file", "/proc"])
def test_a_folder_that_cannot_be_made_is_status_4_before_any_work(tmp_path, capsys, monkeypatch, how, inside):
    place = tmp_path / "file"
    place.touch()
    out = (place if inside == "a file" else Path(inside)) / "x"
    monkeypatch.setattr(import_module("clacad.exporting.run"), "chosen_quads", None)  # nothing is meshed
    assert main(["export", PLANO, "-o", str(out), "--format", "table", "--cells", "2x2", *how]) == 4
    said = capsys.readouterr().err
    assert "clacad:" in said
    assert str(out.parent) in said


@pytest.mark.parametrize(
    ("command", "work"),
    [
        (("accuracy", PLANO, "-o", "PLACE/x.svg"), "clacad.verification.accuracy.accuracy_table:accuracy"),
        (("verify", PLANO, "-o", "PLACE/x"), "clacad.verification.run:verified"),
        (
            ("render", str(DESIGNS / "scenes" / "effects-narrow.toml"), "-o", "PLACE/x.png"),
            "clacad.rendering.picture:view_through",
        ),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_long_work_is_not_begun_for_a_folder_that_cannot_be_written(
    tmp_path, capsys, monkeypatch, command, work
):
    (tmp_path / "file").touch()
    module, name = work.split(":")
    monkeypatch.setattr(import_module(module), name, None)
    assert main([word.replace("PLACE", str(tmp_path / "file")) for word in command]) == 4
    assert "file; a folder is needed there" in capsys.readouterr().err
