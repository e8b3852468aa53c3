"""Every code the program can print is explained, and what is not known is answered with what is nearest."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from clacad.cli import main
from clacad.design.combinations import matrix
from clacad.design.process_profiles import profiles
from clacad.design.sections import SECTIONS
from clacad.effects import NAMES
from clacad.explain.glossary import SYNONYMS, WORDS
from clacad.explain.look_up import Unexplained, entries, explain
from clacad.optics.material.catalogue import names as materials
from clacad.verification import CODES, Check

PACKAGE = Path(__file__).parents[2] / "clacad"


def test_every_code_in_the_program_is_explained():
    printed = {
        code
        for path in PACKAGE.rglob("*.py")
        if "explain" not in path.parts
        for code in re.findall(r"CL\d{3}", re.sub(r"CL100 … CL129", "", path.read_text(encoding="utf-8")))
    }
    assert printed
    assert printed <= set(entries())


@pytest.mark.parametrize("entry", list(entries().values()), ids=lambda e: e.code or e.name)
def test_an_explanation_says_what_it_means_and_what_to_do(entry):
    assert len(entry.means) > 30
    assert entry.do or not entry.code
    for text in (entry.means, entry.why, entry.do):
        assert not text or text[-1] in ".):" or not entry.code, text
    assert entry.title


@pytest.mark.parametrize("name", list(CODES))
def test_a_check_is_found_by_its_code_and_by_its_name(name):
    assert explain(CODES[name]).name == name
    assert explain(CODES[name].lower()) == explain(CODES[name][2:])
    assert name in explain(name).name


@pytest.mark.parametrize(("asked", "near"), [
    ("CL159", "CL139"), ("cl399", "CL385"), ("wal", "wall"), ("thruput", "throughput"), ("qqq", "lists all"),
])  # fmt: skip
def test_what_is_unknown_is_answered_with_what_is_nearest(asked, near, capsys):
    with pytest.raises(Unexplained, match=near):
        explain(asked)
    assert main(["explain", asked, "--all"]) == 2
    assert near in capsys.readouterr().err


@pytest.mark.parametrize("command", ["wave", "explore", "stack", "image", "optimise"])
def test_what_a_command_makes_is_explained_by_the_commands_name(command):
    assert f"see clacad {command} " in explain(command).do


@pytest.mark.slow
def test_every_word_sends_to_a_key_that_there_is_or_to_a_command():
    for entry in entries().values():
        if entry.do.startswith("see ") and entry.do.endswith(" of the design file"):
            key = entry.do.removeprefix("see ").removesuffix(" of the design file")
            assert key in explain(key).title, entry.name


@pytest.mark.parametrize(
    "key", ["tolerances.rotation", "pair.web", "seam_depth", "check.process", "tolerances", "unit"]
)
def test_keys_of_the_design_file_are_explained_too(key):
    assert key in explain(key).title or key in explain(key).name


def test_the_command_prints_text_json_and_the_list(capsys):
    assert main(["explain", "CL337"]) == 0
    text = capsys.readouterr().out
    assert "why:" in text
    assert "what to do:" in text
    assert main(["explain", "CL337", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["name"] == "wall"
    assert main(["explain", "--all"]) == 0
    listed = capsys.readouterr().out
    assert all(code in listed for code in CODES.values())
    assert main(["explain", "--json"]) == 0
    assert {e["code"] for e in json.loads(capsys.readouterr().out)} >= set(CODES.values())


@pytest.mark.parametrize("old", ["file_rms", "file_eta", "file_delta", "file-rms"])
def test_a_former_name_gives_the_check_and_says_what_it_is_called_now(old):
    new = old.replace("-", "_").replace("file_", "faithful_")
    entry = explain(old)
    assert entry.code == CODES[new]
    assert f"now called {new}" in entry.title
    assert Check(new, "pass", "x").to_dict()["alias"] == old.replace("-", "_")
    assert "alias" not in Check("law_rms", "pass", "x").to_dict()


@pytest.mark.parametrize(("word", "says"), [
    ("role", "optical-master"), ("master", "made from"), ("optical-master", "made from"), ("shape-preview", "looking"),
    ("preview", "looking"), ("scan", "never called fit"), ("other", "no verdict"), ("verdict", "not judged"),
    ("shape only", "coarsely"), ("shape-only", "coarsely"), ("not judged", "nothing optical"), ("not-judged", "nothing optical"),
    ("diffraction", "λ/w"), ("sharpest pitch", "defocus"), ("invisible pitch", "one minute of arc"), ("F-number", "Focal length"),
])  # fmt: skip
def test_the_words_of_roles_and_verdicts_are_explained(word, says):
    assert says in explain(word).means


def test_tilt_says_what_it_measures():
    entry = explain("tilt")
    assert "turn" in entry.means
    assert "acts on light as δ does" in entry.means
    assert "tells them apart" not in entry.why


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ("moulding", ("draft at least 1°", "radii at least 20 µm", 'check.process = "moulding"')),
        ("diamond-turning", ("tool nose 25 µm", "no undercut")),
        ("none", ("no limit of a process is checked",)),
        ("walls", ("fate WALL", "when the share of WALL light exceeds the radiance")),
        ("effect diffraction", ("sinc²",)),
        (
            "fused silica",
            ("n = 1.4599 at 550 nm", "Malitson", 'pair.material = "Fused silica"'),
        ),  # Malitson 1965
        ("pmma", ("1190 kg/m³",)),
        ("pair.material", ("PMMA, PS, PC", "Fused silica", "SU-8")),
        ("verdict", ("passed as optical master, shape only, failed, or not judged",)),
    ],
)
def test_processes_effects_and_materials_are_explained_too(asked, words, capsys):
    assert main(["explain", asked, "--all"]) == 0
    said = capsys.readouterr().out
    assert all(word in said for word in words)


def test_every_process_effect_and_material_is_listed(capsys):
    assert main(["explain", "--all"]) == 0
    listed = capsys.readouterr().out
    for kind, names in (
        ("process", [p.name for p in profiles()]),
        ("effect", NAMES),
        ("material", materials()),
    ):
        assert all(f"{kind} {name}" in listed for name in names)
    assert explain("diffraction").title == "diffraction", "a word keeps its name where an effect has it, too"


PLAIN = """resin, printer, flange, mount, homogeniser, superlens, Gabor, fly's eye, steering, viewing, focal length, f-number, aperture,
conic, sag, tolerance, master, preview, slicer, seam, web, baffle, crosstalk, moiré, ghost, field, pitch, fill factor, diffraction
limit, Strehl, field of view, lenslet, microlens array, confocal, afocal, Abbe number, refractive index, dispersion, temperature,
eye, misalignment, roughness, spacer, slab, biconvex, 3D printer, injection molding, lathe, STL, STEP, manifest, drawing,
infrared, honeycomb, mold, aberration, vignetting, clear aperture, polycarbonate, Zeonex, homogenizer, quads, dowel"""


@pytest.mark.parametrize("word", [" ".join(word.split()) for word in PLAIN.split(",")])
def test_plain_words_of_newcomers_engineers_and_machinists_are_explained(word):
    entry = explain(word)
    assert len(entry.means) > 30
    assert entry.do or entry.code or entry.name in WORDS


def test_a_word_names_a_key_of_the_design_file_or_a_command():
    paths = {f"{section}.{name}" for section, keys in SECTIONS.items() for name in keys}
    assert {where for _, where in WORDS.values() if "." in where and " " not in where} <= paths


def test_synonyms_are_no_words_and_lead_to_words():
    assert set(SYNONYMS.values()) <= {entry.name for entry in entries().values()}
    assert not set(SYNONYMS) & set(WORDS)


def test_combinations_are_a_matrix_of_yes_and_letters_that_fits_a_hundred_columns(capsys):
    assert main(["explain", "combinations", "--all"]) == 0
    lines = capsys.readouterr().out.splitlines()
    (_, *sheets), *rows = matrix()
    assert [sheet.rpartition(".")[2] for sheet in sheets] == lines[1].split()
    legend = dict(line.strip().split("  ", 1) for line in lines[len(rows) + 2 :] if line.strip()[1:3] == "  ")
    for line, (feature, *cells) in zip(lines[2:], rows, strict=False):
        assert line.strip().startswith(feature)
        assert len(line) <= 100
        for shown, cell in zip(line.strip().removeprefix(feature).split(), cells, strict=True):
            assert {"yes": "built", "-": "itself"}.get(shown) == cell or legend[shown] == cell
