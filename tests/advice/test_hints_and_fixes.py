"""Forecast of verdicts by `check`, suggested keys for failing checks, and the changed design: each compared with `verify`."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from types import SimpleNamespace

import pytest

from clacad.advice import advise, fewest_keys, fix, hints, judge
from clacad.advice.lever_trials import Trials, found_in, levers_of, settings
from clacad.checks.check import kinds
from clacad.checks.design_kinds import EDGE
from clacad.checks.light_kinds import LAW_RMS, RESIDUAL
from clacad.cli.entry_point import main
from clacad.design import Design, load
from clacad.exporting.light_forecast import Grader
from clacad.exporting.tessellations import Meshes
from clacad.light.measure import measure
from clacad.prescription.prescribe import prescribe
from clacad.sheet.bundle import RequestedLaw, bundle
from clacad.tracing.worst_cell import tried_cells
from clacad.verification import passed
from clacad.verification.design_rules import design_checks
from clacad.verification.light.law_checks import judge_light

ROUND = """# Round window of polycarbonate.
format = 1
name = "round"
unit = "mm"

[law]
eta = [-1.0, -1.0]

[pair]
form = "slab"
separation = 5.0    # as in air
material = "PC"

[lattice]
kind = "hexagonal"
pitch = 1.0
count = [70, 80]
outline = {circle = 60.0}   # what the frame holds

[check]
process = "diamond-turning"
"""
BICONVEX = {
    "format": 1, "name": "thin edge", "unit": "mm", "law": {"eta": [-0.5, -1.0]},
    "pair": {"form": "biconvex", "separation": 8.0, "index": 1.5, "thickness": 0.3},
    "lattice": {"pitch": 0.5, "count": [10, 10]}, "check": {"process": "sla"},
}  # fmt: skip


@pytest.fixture(scope="module")
def too_close(tmp_path_factory):
    path = tmp_path_factory.mktemp("advice") / "round.toml"
    path.write_text(ROUND)
    return path


def by_all_rays(design):
    """What verify judges a design by: its own numbers of rays, and the design rules."""
    judged = judge(design)
    light, _ = judge_light(design, judged.window, 65536)
    return {(c.id, c.subject): c for c in (*light, *design_checks(design, judged.window, judged.facts))}


@pytest.mark.slow
def test_check_says_of_every_check_what_verify_says(too_close):
    for design in (load(too_close), load(too_close, ("pair.separation=10",))):
        mine, theirs = {(c.id, c.subject): c for c in judge(design).checks}, by_all_rays(design)
        assert {key: c.state for key, c in mine.items()} == {key: c.state for key, c in theirs.items()}
        assert mine["law_rms", ""].value == pytest.approx(theirs["law_rms", ""].value, rel=0.01)
        assert judge(design).passes == passed(theirs.values())


@pytest.mark.slow
def test_each_key_that_is_advised_makes_all_the_rays_of_verify_pass_and_is_one_key(too_close):
    design = load(too_close)
    advice = advise(design)
    told = {check.id: hints for check, hints in advice.hints}
    assert set(told) == {"law_rms", "spread"}  # of the assumed eye the check itself names what was tried
    first = told["law_rms"][0]
    assert list(first.changes) == ["pair.separation"]
    assert str(first).startswith(f"pair.separation = {first.changes['pair.separation']} passes: law_rms ")
    changed = by_all_rays(design.replace(first.changes))
    assert passed(changed.values())
    stated = next(c for c in first.mends if c.id == "law_rms")
    assert stated.value == pytest.approx(changed["law_rms", ""].value, rel=0.01)


@pytest.mark.slow
def test_a_fix_changes_the_fewest_keys_keeps_the_law_and_every_comment_and_passes(
    too_close, tmp_path, capsys
):
    out = tmp_path / "better.toml"
    assert main(["check", str(too_close), "--fix", "-o", str(out), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert len(document["changes"]) == 1
    before, after = ROUND.splitlines(), out.read_text().splitlines()
    assert len(after) == len(before)
    changed = [(a, b) for a, b in zip(before, after, strict=True) if a != b]
    assert [b.split("=")[0].strip() for _, b in changed] == ["separation"]
    assert changed[0][1].endswith("# as in air")
    asked, fixed = load(too_close), load(out)
    assert fixed.law_spec == asked.law_spec
    assert fixed.check == asked.check
    assert passed(by_all_rays(fixed).values())


@pytest.mark.slow
def test_overrides_are_written_too(too_close, tmp_path):
    out = tmp_path / "better.toml"
    assert (
        main(["check", str(too_close), "--set", "lattice.outline.circle=30", "--fix", "-o", str(out), "-q"])
        == 0
    )
    assert tomllib.loads(out.read_text())["lattice"]["outline"] == {"circle": 30}
    assert "# what the frame holds" in out.read_text()


def test_a_name_that_is_taken_is_refused_before_anything_is_tried(too_close, tmp_path, monkeypatch, capsys):
    def tried(*_):
        raise AssertionError("it was searched first")

    monkeypatch.setattr("clacad.advice.fix", tried, raising=False)
    taken = tmp_path / "better.toml"
    taken.write_text("mine")
    assert main(["check", str(too_close), "--fix", "-o", str(taken)]) == 4
    assert taken.read_text() == "mine"
    assert main(["check", str(too_close), "--fix", "-o", str(tmp_path / "better.txt")]) == 2
    assert main(["check", str(too_close), "-o", str(tmp_path / "other.toml")]) == 2
    assert sorted(p.name for p in tmp_path.iterdir()) == ["better.toml"]
    capsys.readouterr()


@pytest.mark.slow
def test_where_nothing_passes_the_limits_that_bind_are_named_and_nothing_is_written(
    too_close, tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(fewest_keys, "TRIALS", 3)
    out = tmp_path / "better.toml"
    words = ["check", str(too_close), "--set", "check.law_rms=0.0001 mrad", "--fix", "--all", "-o", str(out)]
    assert main(words) == 1
    said = capsys.readouterr().out
    assert "nothing passes of 3 designs tried" in said
    assert "law_rms" in said.splitlines()[-1]
    assert "design file" in said.splitlines()[-1]
    assert not out.exists()


@pytest.mark.slow
def test_a_design_that_cannot_be_built_is_led_to_one_that_can():
    design = Design.from_dict(tomllib.loads(ROUND)).replace({"pair.separation": 0.5})
    with pytest.raises(ValueError, match="radius"):
        judge(design)
    fixed = fix(design)
    assert fixed.passes
    assert fixed.design.law_spec == design.law_spec


@pytest.mark.slow
def test_an_edge_too_thin_is_told_of_the_keys_of_its_form_and_one_of_them_passes():
    design = Design.from_dict(BICONVEX)
    judged = judge(design)
    edge = next(c for c in judged.failing if c.id == "edge")
    for key in ("pair.thickness", "pair.web", "body.border"):
        assert key in edge.sentence
        assert key in {lever.key for lever in EDGE.levers}
    fixed = fix(design)
    assert fixed.passes
    assert set(fixed.changes) <= {"pair.thickness", "pair.web", "body.border"}


@pytest.mark.parametrize(("key", "value"), [
    ("lattice.aperture", {"point": [0, 0, -400]}), ("lattice.aperture", [0.01, 0.0]), ("lattice.aperture", "aligned"), ("body.border", 1.0),
])  # fmt: skip
def test_no_lever_moves_what_a_design_states_as_its_intent(key, value):
    design = Design.from_dict(BICONVEX)
    checks = [SimpleNamespace(kind=kind, id=kind.id, state="fail") for kind in kinds().values()]
    section, name = key.split(".")
    stated = Design.from_dict(BICONVEX | {section: BICONVEX.get(section, {}) | {name: value}})
    assert key in {lever.key for lever in levers_of(design, checks)}
    assert key not in {lever.key for lever in levers_of(stated, checks)}
    assert not {lever.key for lever in levers_of(stated, checks)} & {
        "law.eta",
        "check.viewer",
        "check.field",
        "lattice.outline",
        "body.holes",
    }


@pytest.mark.slow
def test_a_fix_for_a_stated_eye_gives_it_a_field_lens_and_keeps_the_eye():
    given = tomllib.loads(ROUND)
    given["pair"]["separation"], given["lattice"] = 8.0, {"pitch": 1.0, "count": [20, 20]}
    design = Design.from_dict(given | {"check": {"process": "diamond-turning", "viewer": 120.0}})
    assert [check.id for check in judge(design).failing] == ["viewed"]
    fixed = fix(design)
    assert fixed.passes
    assert "pair.field_lens" in fixed.changes
    assert fixed.design.check == design.check


def test_the_residual_of_a_recipe_names_the_key_of_recipes():
    assert "pair.confocal" in {lever.key for lever in RESIDUAL.levers}


def test_another_pitch_keeps_the_size_of_the_sheet():
    design = Design.from_dict(BICONVEX)
    lever = next(one for one in levers_of(design, judge(design).failing) if one.key == "lattice.pitch")
    for changes in settings(lever, design, None, ()):
        width = changes["lattice.pitch"] * changes["lattice.count"][0]
        assert abs(width - 5.0) <= 0.5 * changes["lattice.pitch"] + 1e-9


@pytest.mark.slow
def test_check_ends_with_the_verdict_of_verify_and_tells_json_the_same(too_close, capsys):
    assert main(["check", str(too_close), "--set", "pair.separation=10", "--all"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "verify will pass, warning of viewed"
    assert main(["check", str(too_close), "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["passed"] is False
    assert document["verdict"] == "verify will fail: law_rms, spread"
    assert document["advice"]["checks"][0]["hints"][0]["passes"] is True


def test_shipped_templates_are_said_to_pass_or_fail_as_recorded():
    """The paper's literal sheet does not cover; that the same sheet covered passes is the README's first promise."""
    folder = Path(__file__).parents[2] / "designs"
    assert not judge(load(folder / "paper-base.toml")).passes
    assert judge(load(folder / "paper-a-covered.toml")).passes


@pytest.mark.slow
@pytest.mark.parametrize(("name", "better"), [("window-100mm", 5.0), ("slab", 1.2)])
def test_a_slab_of_ellipsoids_is_told_of_the_conic_constant_that_costs_nothing(name, better):
    design = load(Path(__file__).parents[2] / "designs" / f"{name}.toml")
    free = advise(design).sharper
    assert free is not None
    assert free.changes == {"pair.surface": "biconic"}
    conics = prescribe(design.replace(free.changes)).faces[0].surface.conic_x
    assert conics == pytest.approx(-1.0 / prescribe(design).bodies[0].index ** 2, rel=1e-12)
    after = by_all_rays(design.replace(free.changes))["law_rms", ""].value
    assert free.after == pytest.approx(after, rel=0.02)
    assert free.before > better * after
    assert "costs nothing" in str(free)


@pytest.mark.slow
def test_what_is_no_slab_of_ellipsoids_is_told_of_nothing_that_costs_nothing():
    designs = Path(__file__).parents[2] / "designs"
    for design in (
        load(designs / "plano.toml"),
        load(designs / "window-100mm.toml", ['pair.surface="biconic"']),
    ):
        assert advise(design).sharper is None


def aimed_off_axis(limit):
    """Sixteen cells aimed so far aside that their light fails."""
    keys = {
        "lattice.count": [4, 4],
        "lattice.aperture": {"point": [12, 3, -105]},
        "check.process": "none",
        "check.law_rms": limit,
    }
    return load("window-100mm").replace(keys)


@pytest.mark.parametrize("viewer", [-105, 400])
def test_check_and_forecast_judge_the_one_cell_whose_light_leaves_farthest_from_the_law(viewer):
    """All 16 cells, each by its own bundle."""
    design = aimed_off_axis("3 mrad").replace({"lattice.aperture": {"point": [viewer / -8.75, 3, viewer]}})
    judged, field = judge(design), design.check.field
    tried = tried_cells(judged.window, field)
    assert len(tried) == 16
    rms = [measure(one, bundle(one.like, 2048, field), RequestedLaw.of(one.like)).rms for one in tried]
    assert max(rms) == rms[0] > 1.01 * min(rms)
    (check,) = (one for one in judged.light if one.kind is LAW_RMS)
    assert tuple(check.detail["cell"]) == tried[0].index
    assert Grader.of(Meshes(judged.window), design).cell == tried[0].words


AIMED = {
    "format": 1, "name": "aimed", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 10.0, "material": "PMMA", "surface": "biconic", "conic": [-0.7, -0.7]},
    "lattice": {"pitch": 0.5, "count": [40, 40], "aperture": {"point": [0, 0, -150]}},
    "check": {"process": "none", "law_rms": "0.5 mrad", "field": "1 deg"},
}  # fmt: skip


@pytest.mark.parametrize(
    "changes",
    [{"pair.separation": 8}, {"pair.separation": 9.5}, {"lattice.pitch": 0.45, "lattice.count": [45, 45]}],
)
def test_one_cell_of_a_non_uniform_sheet_forecasts_what_a_changed_sheet_fails(changes):
    """Light through the whole changed sheet, in its own worst cell, fails by about as much."""
    design = Design.from_dict(AIMED)
    base = judge(design)
    trials = Trials(design, 9, cell=hints._worst_cell(base))
    failing = [LAW_RMS.first(base.checks)]
    assert failing[0].state == "fail"
    assert trials._fails_in_cell(changes, failing)
    assert not trials.made
    assert trials.tried == 1
    of_cell = LAW_RMS.first(next(iter(trials.of_cell.values())))
    changed = design.replace(changes)
    whole = LAW_RMS.first(judge_light(changed, prescribe(changed), 8192, 1024)[0])
    assert whole.state == "fail"
    assert of_cell.value == pytest.approx(whole.value, rel=0.06)


def test_a_trial_by_light_computes_no_rules_and_a_trial_by_rules_no_light():
    design = Design.from_dict(AIMED).replace("lattice.count", [6, 6])
    base = judge(design)
    for check, other in ((LAW_RMS.first(base.checks), "rules"), (base.rules[0], "light")):
        trial = judge(design, judged_only=True)
        assert found_in(trial, check).id == check.id
        assert other not in vars(trial)
