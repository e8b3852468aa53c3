"""A check is declared once: its word occurs in one module, and one declaration reaches every command."""

from __future__ import annotations

import ast
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from package_source import literals, nodes

from clacad.advice import advise, judge
from clacad.advice.lever_trials import levers_of
from clacad.checks import check as checks
from clacad.checks.check import found_by, kinds
from clacad.cli import main
from clacad.design import Design
from clacad.design.sections import SECTIONS
from clacad.explain.look_up import explain
from clacad.report.content import content, numbers
from clacad.verification import verify

PACKAGE = Path(__file__).parents[2] / "clacad"

NOUNS = {
    "aspect", "bodies", "colour", "delta", "design", "draft", "edge", "eta", "field", "layer", "neck", "orders", "pitch", "pose",
    "pupil", "radius", "sag", "scale", "shape", "slope", "solids", "spread", "table", "temperature", "tilt", "tool", "volume", "voxel", "wall",
}  # fmt: skip
"""Ids that are also names of lengths, parts, formats or keys of a design and of JSON: these uses are free."""

ELSEWHERE = {
    "design/read.py": "reads a key of [check]",
    "explain/look_up.py": "describes the limits of a process profile",
    "design/process_profiles.py": "column of the table of process limits",
    "exporting/light_forecast.py": "names the keys of [check] that a forecast exceeds, for the manifest",
    "exporting/quads_and_roles.py": "names the keys of [check] that a forecast exceeds, for the manifest",
    "formats/mesh/compare_triangles.py": "states in the manifest what was compared",
    "exporting/step_record.py": "states in the manifest what was compared",
    "exporting/formats/parts.py": "states in the manifest what was compared",
    "exporting/manifest.py": "field of the manifest",
    "exporting/run.py": "field of the manifest",
    "advice/candidate.py": "writes a key of [check]",
    "advice/wish.py": "reads a key of [check]",
    "report/rows.py": "field of each line in the detail of a check",
    "measuring/measured.py": "field of what is measured",
    "making/light_as_made.py": "key of [process]",
    "making/correction.py": "field of what is measured, in the history of a correction",
    "cli/correct_command.py": "field of what is measured, in the history of a correction",
    "design/process.py": "key of [process]",
    "stacking/assembly.py": "states in the manifest what was compared",
    "formats/step/lenses_on_cells.py": "field of what is read from a STEP file",
    "formats/step/read_back.py": "field of what is read from a STEP file",
    "exporting/drawing/drawing_tables.py": "measure of a study of tolerances",
    "cli/tolerance_command.py": "measures of a study of tolerances",
    "advice/judged.py": "field of JSON",
    "cli/export_command.py": "key of [check] in the manifest",
    "cli/tables.py": "key of [check] in the manifest",
    "advice/hints.py": "field of JSON",
    "imaging/image_by_rays.py": "field of JSON",
    "optics/law/__init__.py": "public function",
    "report/better_faces.py": "measure of a study of tolerances",
    "report/report_files.py": "field of a template",
    "report/pdf.py": "field of a template",
    "sheet/feasibility/as_rows.py": "derived number",
    "tracing/layout.py": "field of a layout",
    "verification/accuracy/accuracy_table.py": "field of JSON",
    "verification/design_rules.py": "field of a check's detail",
    "judging/mesh_light.py": "field of a check's detail",
    "judging/step_file.py": "field of what is read from a STEP file",
    "judging/judge_files.py": "field of what is read from a STEP file",
    "light/confocality.py": "public function",
    "verification/light/special_checks.py": "field of a check's detail",
    "verification/tolerance/light_measures.py": "measures of a study of tolerances",
    "verification/tolerance/parameter_sweep.py": "measures of a study of tolerances",
    "verification/tolerance/study.py": "measures of a study of tolerances",
    "verification/tolerance/study_files.py": "measures of a study of tolerances",
    "verification/verification_report.py": "field of JSON",
    "waves/wave_report.py": "field of JSON",
}
"""Files in which the id of a check names something else, with what it names there."""


def declaring() -> set[str]:
    """Files that declare checks."""
    return {f"{family.removeprefix('clacad.').replace('.', '/')}.py" for family in checks.FAMILIES}


def modules() -> Iterator[tuple[str, Path]]:
    """Every module of the package outside the declarations."""
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).as_posix()
        if name not in declaring():
            yield name, path


def words(tree: ast.AST) -> set[str]:
    """Ids of checks among the string literals of a syntax tree."""
    return {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    } & set(kinds())


def uses_of_ids(path: Path) -> Iterator[ast.AST]:
    """Places where a string can only be the id of a check: next to `.id`, and as the first argument of `Check`."""
    for node in nodes(path):
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            if any(isinstance(side, ast.Attribute) and side.attr == "id" for side in sides):
                yield node
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Check":
            yield from node.args[:1]


def test_the_word_of_a_check_occurs_in_the_module_that_declares_it():
    found = {(name, word) for name, path in modules() for word in literals(path) & set(kinds()) - NOUNS}
    assert {(name, word) for name, word in found if name not in ELSEWHERE} == set()
    assert set(ELSEWHERE) - {name for name, _ in found} == set(), "exceptions that nothing needs"


def test_nothing_asks_for_a_check_by_its_word():
    assert [
        (name, word) for name, path in modules() for use in uses_of_ids(path) for word in words(use)
    ] == []


def test_no_code_of_a_check_occurs_outside_its_declaration():
    codes = {kind.code for kind in kinds().values()}
    found = {name: literals(path) & codes for name, path in modules()}
    assert {name: some for name, some in found.items() if some} == {}


def test_ids_and_codes_are_unique_and_limits_are_keys_of_the_design():
    declared = [
        one
        for family in checks.FAMILIES
        for one in vars(sys.modules[family]).values()
        if isinstance(one, checks.CheckKind)
    ]
    assert len({kind.id for kind in declared}) == len(set(declared)) == len(kinds())
    assert len({kind.code for kind in declared}) == len(kinds())
    assert {kind.limit for kind in declared} - {""} <= set(SECTIONS["check"])


@pytest.mark.parametrize("stage", ["cell", "part", "light", "sheet"])
def test_every_stage_has_functions(stage):
    assert found_by(stage)


TOY = '''
"""A check of nothing but the pitch."""

from clacad.checks.levers import FINER
from clacad.checks.check import CheckKind

PITCH_IN_HAND = CheckKind("toy_pitch", "CL399", "of an inch", rule="a whim", levers=(FINER,)).explained(
    means="Whether the pitch is below a hundredth of an inch.", why="It is a toy.", do="Make it smaller."
)
FOUND_BY = {"cell": ("toy_checks:toy_pitch",)}


def toy_pitch(built):
    pitch = built.design.lattice.pitch[0] * built.design.unit_m / 0.0254
    yield PITCH_IN_HAND.judge(pitch, 0.01, f"the pitch is {pitch:.3g} of an inch")
'''


@pytest.fixture
def toy(tmp_path, monkeypatch):
    """A declaration in a module of its own, and nothing else."""
    (tmp_path / "toy_checks.py").write_text(TOY, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(checks, "FAMILIES", (*checks.FAMILIES, "toy_checks"))
    for cached in (kinds, found_by):
        cached.cache_clear()
    yield kinds()["toy_pitch"]
    sys.modules.pop("toy_checks", None)
    monkeypatch.undo()
    for cached in (kinds, found_by):
        cached.cache_clear()


SMALL = {
    "format": 1, "name": "toy", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "index": 1.49, "separation": 8.0}, "lattice": {"pitch": 0.5, "count": [4, 4]},
    "check": {"process": "none"},
}  # fmt: skip


@pytest.mark.slow
def test_a_check_of_one_module_is_verified_explained_reported_and_advised(toy, tmp_path, capsys):
    design = Design.from_dict(SMALL)
    report = verify(design, rays=2048)
    found = toy.first(report.checks)
    assert (found.state, found.unit, found.source) == ("fail", "of an inch", "a whim")
    assert not report.passed
    assert report.verdict() == "failed: toy_pitch"
    row = next(one for one in report.to_dict()["checks"] if one["id"] == "toy_pitch")
    assert (row["code"], row["relation"], row["limit"]) == ("CL399", "<=", 0.01)

    page = content(report, lambda *_: None)
    assert [one["id"] for one in page.checked.failures] == ["toy_pitch"]
    assert any(one["id"] == "toy_pitch" for one in numbers(page)["checks"])

    assert explain("CL399").do == explain("toy_pitch").do == "Make it smaller."
    assert main(["explain", "--all"]) == 0
    assert "CL399" in capsys.readouterr().out

    judged = judge(design)
    assert [check.kind for check in judged.failing] == [toy]
    assert [lever.key for lever in levers_of(design, judged.failing)] == ["lattice.pitch"]
    ((check, hints),) = [pair for pair in advise(design, judged=judged).hints if pair[0].kind is toy]
    assert check.id == "toy_pitch"
    assert {key for hint in hints for key in hint.changes} >= {"lattice.pitch"}

    path = tmp_path / "toy.toml"
    path.write_text(design.toml, encoding="utf-8")
    assert main(["check", str(path), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["verdict"] == "verify will fail: toy_pitch"
    assert any(one["check"] == "toy_pitch" for one in document["advice"]["checks"])
