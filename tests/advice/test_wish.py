"""Wishes: how they are read, the formulas they start from, the designs that come of them."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from math import inf, radians
from types import SimpleNamespace

import pytest
from mpmath import asin, atan, mp, mpf, sin, sqrt, tan
from trust.running import clacad

from clacad.advice.candidate import (
    PitchBound,
    Variant,
    balanced_pitch,
    built,
    lower_pitches,
    shape_of,
    sharpest_pitch,
    undistorted_conic,
    upper_pitches,
)
from clacad.advice.judged import judge
from clacad.advice.lens_shape import (
    AXIS,
    FAULTS,
    JUDGEMENT,
    UNEQUAL,
    Work,
    layered,
    least_of_one_material,
)
from clacad.advice.proposal import NoSuchSheet, design_for, nearest, not_met
from clacad.advice.wish import KEYS, Wish, parse_wish, read_wish
from clacad.advice.wish_search import Search, _rounded, impossible
from clacad.cli.new_command import _verdict
from clacad.design import DesignError, load, template
from clacad.design.body import Outline
from clacad.prescription.prescribe import prescribe
from clacad.sheet.feasibility import feasibility
from clacad.verification import verify

WAVELENGTH = 550e-9
"""Metres; the design file's default."""

ROUND = "eta=-1, circle=60 mm, kind=hexagonal, material=PC, process=moulding"


# --- reading ------------------------------------------------------------------------------------------------


def test_a_wish_is_read_with_units_lists_and_defaults():
    wish = read_wish(parse_wish(["eta=[-.5, -2], delta=[.1,.05]", "width=[4 cm, 30], viewing = 0.5 m"]))
    assert wish == Wish((-0.5, -2.0), Outline("rectangle", (40.0, 30.0)), delta=(0.1, 0.05), viewing=500.0)
    assert (wish.process, wish.material, wish.field) == ("diamond-turning", "PMMA", radians(1.0))


def test_what_a_wish_says_in_words_is_the_wish_again():
    texts = [ROUND, "eta=.5, width=[50, 20], euler=[0, 2, 0], object=300, field=0.5 deg"]
    for wish in (read_wish(parse_wish([text])) for text in texts):
        assert read_wish(wish.words()) == wish


def test_every_mistake_of_a_wish_is_told_at_once_with_what_is_allowed():
    with pytest.raises(DesignError) as caught:
        read_wish(
            parse_wish(["eta=[0, -1], process=moldin, outline=3, circle=60 m m, width=5, material=PMMB"])
        )
    text = str(caught.value)
    for part in ('did you mean "moulding"', "unknown word outline; did you mean circle?", "eta_x = 0", "exclude each other",
                 'circle = "60 m m"', "unknown material 'PMMB'"):  # fmt: skip
        assert part in text


@pytest.mark.parametrize("text", ["eta", "eta=", "=3"])
def test_what_is_not_key_and_value_is_refused(text):
    with pytest.raises(DesignError, match="KEY=VALUE"):
        parse_wish([text])


def test_a_wish_reads_index_wavelength_pitch_flange_and_holes_with_units_and_is_the_wish_again():
    text = "eta=-1, circle=60, index=1.52, wavelength=633 nm, pitch=500 um, flange=.8 cm, holes=6"
    wish = read_wish(parse_wish([text]))
    assert (wish.index, wish.pitch, wish.flange, wish.holes) == (1.52, 0.5, 8.0, 6)
    assert wish.wavelength == pytest.approx(633e-9, rel=1e-15)
    assert read_wish(wish.words()) == wish


@pytest.mark.parametrize(("words", "told"), [
    ("index=1.5, material=PMMA", "index and material exclude each other"),
    ("holes=4", "holes need a flange"),
    ("holes=3, flange=6", "do not fit the corners"),
    ("index=.9", "a number > 1, at most 10"),
    ("wavelength=1 km", "a wavelength from 10 nm to 1 mm"),
    ("flange=-3", "a length > 0"),
    ("holes=2.5, flange=6", "a whole number"),
])  # fmt: skip
def test_words_that_do_not_fit_are_refused_with_what_is_allowed(words, told):
    with pytest.raises(DesignError) as caught:
        read_wish(parse_wish([f"eta=-1, width=40, {words}"]))
    assert told in str(caught.value)


def test_what_is_wished_is_written_into_the_design_the_eye_the_flange_and_its_holes_too():
    words = "viewing=300, object=2 m, index=1.52, wavelength=633 nm, flange=6, holes=4"
    flat = built(read_wish(parse_wish([f"eta=-1, width=40, {words}"])), Variant("slab"), 0.5, 12.0, "x")
    assert (flat.check.viewer, flat.check.object) == (300.0, 2000.0)
    assert (flat.pair.index, flat.pair.wavelength) == (1.52, pytest.approx(633e-9, rel=1e-15))
    assert flat.body.border == 6.0
    places = flat.body.holes[0].places((52.0, 52.0))
    assert sorted(places) == [
        (x, y) for x in (-23.0, 23.0) for y in (-23.0, 23.0)
    ]  # 3 mm inside the 52 mm plate
    disc = built(read_wish(parse_wish([f"eta=-1, circle=40, {words}"])), Variant("slab"), 0.5, 12.0, "x")
    assert (disc.body.holes[0].circle, disc.body.holes[0].count) == (46.0, 4)


def test_an_eye_that_no_one_stated_is_not_written_and_not_judged():
    design = built(read_wish({"eta": -1, "width": 40}), Variant("slab"), 0.5, 12.0, "x")
    assert design.check.viewer is None


@pytest.mark.parametrize(("text", "told"), [
    ("eta=-1, width=5, euler=[10,89,3]", "theta = 89 deg"),
    ("eta=-2, width=40, viewing=400", "at most 25 % obey the law from any distance"),
    ("eta=-.9, width=190, flange=10, viewing=400", "width 210 mm of the part: the limit of diamond-turning is 200 mm"),
])  # fmt: skip
def test_what_no_sheet_can_do_is_known_before_one_is_built(text, told):
    search = Search(read_wish(parse_wish([text])), "x")
    assert search.run() is None
    assert told in search.refused[0]
    assert not search.tried


def test_the_nearest_wish_of_a_row_is_found_in_three_trials(monkeypatch):
    """Rows go from the least demanding wish to the most; here every eye at 800 mm or farther is served."""
    tried: list[float] = []

    def run(search):
        tried.append(search.wish.viewing)
        pitch = SimpleNamespace(value=1.0)
        return (
            SimpleNamespace(variant="slab", pitch=pitch, judged=SimpleNamespace(warning=()))
            if tried[-1] >= 800
            else None
        )

    search = Search(read_wish({"eta": -1, "width": 40, "viewing": 400}), "x")
    monkeypatch.setattr(Search, "run", run)
    assert next(nearest(search)) == "  viewing=800 comes true: slab, pitch 1 mm"
    assert tried == [1600, 800, 520]


def test_where_no_eye_is_served_the_wish_without_one_is_tried_whatever_was_spent(monkeypatch):
    def run(search):
        search.work.done += search.work.most
        judged = SimpleNamespace(warning=())
        one = SimpleNamespace(variant="slab", pitch=SimpleNamespace(value=1.0), judged=judged)
        return one if search.wish.viewing is None else None

    search = Search(read_wish({"eta": -1, "width": 20, "viewing": 300, "euler": [0, 5, 0]}), "x")
    monkeypatch.setattr(Search, "run", run)
    assert list(nearest(search)) == ["  leaving viewing out comes true: slab, pitch 1 mm"]


def test_the_help_of_a_wish_names_every_word():
    text = " ".join(clacad("new", "--help").out.split())
    listed = text[text.index("Find a design that does this") : text.index("--list")]
    assert [word for word in KEYS if not re.search(rf"\b{word}\b", listed)] == []


def test_a_lean_is_refused_only_where_the_arrays_would_cross():
    for theta in (5.0, 45.0, 80.0):
        assert not impossible(read_wish({"eta": -1, "width": 5, "euler": [0, theta, 0]}), 0.9)


def test_cells_fill_the_width_or_it_is_said():
    search = Search(read_wish({"eta": -1, "width": 40}), "x")
    assert _rounded(search.wish, PitchBound(6.4, "")) == pytest.approx(40 / 6, abs=1e-4)
    wished = Search(read_wish({"eta": -1, "width": 40, "pitch": 6.4}), "x")
    assert _rounded(wished.wish, PitchBound(6.4, "")) == 6.4
    found = list(not_met(wished.wish, judge(built(wished.wish, Variant("slab"), 6.4, 12.0, "x"))))
    assert found == ["width: requested 40 mm, 6 x 6.4 = 38.4 mm"]


@pytest.mark.slow
def test_a_wished_field_beyond_the_field_of_view_is_reported_as_not_met():
    """A slab of s = 12 p serves slopes up to p/s = 0.083, 4.8 deg from the normal."""
    for field, told in (("4 deg", 0), ("10 deg", 1)):
        wish = read_wish({"eta": -1, "width": 8, "pitch": 0.5, "form": "slab", "field": field})
        judged = judge(built(wish, Variant("slab"), 0.5, 12.0, "x"))
        found = list(not_met(wish, judged))
        assert len(found) == told
        assert all(text.startswith("field: 10 deg requested") for text in found)
        verdict = _verdict(SimpleNamespace(wish=wish, judged=judged))
        assert verdict == "verify will pass" + told * ", the wish is not met: field"


# --- formulas -----------------------------------------------------------------------------------------------


def exit_slope(form: str, index: float, conic: float, height: float) -> mpf:
    """Slope at which an axis ray leaves lens 2 (R = 1) at a height off its vertex, by Snell's law in 30 digits."""
    mp.dps = 30
    n, u = mpf(index), mpf(height)
    lean = atan(u / sqrt(1 - (1 + mpf(conic)) * u**2))  # slope of a conic of unit radius
    if form == "slab":  # out of the glass at the curved face
        return tan(asin(n * sin(lean)) - lean)
    return tan(asin(n * sin(lean - asin(sin(lean) / n))))  # into it there, out of it at the plane face


@pytest.mark.parametrize(("form", "curved"), [("slab", "outside"), ("plano", "inside")])
@pytest.mark.parametrize("index", [1.4, 1.4936, 1.6])
def test_the_undistorted_conic_leaves_an_error_of_fifth_order_only(form, curved, index):
    conic = undistorted_conic(form, curved, index)
    errors = [abs(exit_slope(form, index, conic, h) - (mpf(index) - 1) * mpf(h)) for h in (0.02, 0.01)]
    assert 30.0 < errors[0] / errors[1] < 34.0
    other = [abs(exit_slope(form, index, conic + 0.2, h) - (mpf(index) - 1) * mpf(h)) for h in (0.02, 0.01)]
    assert 7.5 < other[0] / other[1] < 8.5


def test_the_sharpest_pitch_leaves_a_quarter_wave_of_defocus_at_the_beams_edge():
    for eta in (-1.0, -0.25, -2.0, 0.5):
        wish, z = Wish((eta, eta), Outline("circle", (50.0, 50.0))), 300.0
        pitch = sharpest_pitch(wish, z)
        beam = pitch * min(1.0, 1.0 / abs(eta))
        vergence = eta * (eta - 1.0) / z  # of a cell's own image at z/eta^2 less the array's at z/eta
        assert 0.5 * (0.5 * beam) ** 2 * abs(vergence) == pytest.approx(1e3 * WAVELENGTH / 4.0)


def test_the_balanced_pitch_looks_as_wide_as_the_diffraction_of_what_comes_back():
    """The angles p/D and λ/(p min(1, 1/|η|)) are the same."""
    wish = read_wish(parse_wish(["eta=[-2, -.5], width=20, viewing=1 m"]))
    pitch = balanced_pitch(wish)
    assert pitch / 1000.0 == pytest.approx(WAVELENGTH * 1e3 / (pitch * 0.5))


@pytest.mark.parametrize("eta", ["[-2, -.5]", "[-.5, -2]", "[-.25, -1]", "[-1, -3]"])
def test_the_sharpest_pitch_is_the_one_that_check_prints(eta):
    """Of the axis that is blurred more, be it that of the lesser pitch or not."""
    wish = read_wish(parse_wish([f"eta={eta}, width=20, viewing=1 m, object=500 mm"]))
    design = built(wish, Variant("slab"), 0.75, 12.0, "x")
    told = feasibility(prescribe(design), viewer=1.0, distance=0.5).viewing
    assert sharpest_pitch(wish, 500.0) == pytest.approx(1e3 * told.advised)
    blurred_more = told.blur.index(max(told.blur))
    assert told.advised == told.sharpest[blurred_more]


@pytest.mark.parametrize("eta", [(-1.0, -1.0), (-0.5, -2.0), (0.5, 0.5)])
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_a_pitch_by_the_fresnel_formula_has_that_number(eta, kind):
    wish = Wish(eta, Outline("rectangle", (20.0, 20.0)), process="none", kind=kind)
    bound = next(lower_pitches(wish, 12.0, shape_of("slab", 1.49)))
    facts = feasibility(prescribe(built(wish, Variant("slab"), bound.value, 12.0, "x")))
    assert 10.3 <= facts.fresnel_number <= 12.0  # the more where a hexagon is cut across its corners


@pytest.mark.parametrize("process", ["diamond-turning", "moulding", "greyscale", "sla"])
def test_the_bounds_on_the_pitch_keep_the_rules_of_the_process(process):
    wish = Wish((-1.0, -1.0), Outline("rectangle", (500.0, 500.0)), process=process)
    shape = shape_of("slab", 1.49)
    low = max(bound.value for bound in lower_pitches(wish, 10.0, shape))
    high = min(bound.value for bound in upper_pitches(wish, 10.0, shape))
    for pitch in (low, high):
        rules = {
            check.id: check.state for check in judge(built(wish, Variant("slab"), pitch, 10.0, "x")).rules
        }
        of_sizes = ("pitch", "radius", "sag", "tool", "voxel", "layer", "edge", "fresnel_number")
        assert {rules[name] for name in of_sizes if name in rules} == {"pass"}


# --- designs ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_wish_comes_true_as_a_commented_file_that_verify_passes(tmp_path):
    found = design_for(parse_wish([ROUND]), name="round")
    (tmp_path / "round.toml").write_text(found.text, encoding="utf-8")
    design = load(tmp_path / "round.toml")
    assert design == found.design
    assert (design.law_spec.eta, design.pair.material, design.check.process) == (
        (-1.0, -1.0),
        "PC",
        "moulding",
    )
    assert design.lattice.outline == Outline("circle", (60.0, 60.0))
    report = verify(design)
    assert report.exit_status == 0
    assert {check.id for check in report.checks if check.state == "warn"} <= {"viewed"}
    assert found.trades[0].rms < 0.003
    assert {trade.name for trade in found.trades} >= {"this design", "half the pitch", "lenses nearer"}


@pytest.mark.slow
def test_nearer_lenses_see_more_and_err_more_by_the_third_power():
    found = design_for({"eta": -1, "width": 30, "process": "none"})
    own, nearer = (
        next(t for t in found.trades if t.name == name) for name in ("this design", "lenses nearer")
    )
    assert nearer.field > own.field
    assert nearer.rms / own.rms == pytest.approx((own.separation / nearer.separation) ** 3, rel=0.15)


@pytest.mark.slow
def test_what_a_person_sets_is_kept_by_every_design_tried():
    found = design_for({"eta": -1, "width": 20}, ["pair.separation=14", "body.roughness='5 nm'"])
    assert found.design.pair.separation == 14.0
    assert found.design.body.roughness == pytest.approx(5e-6)


@pytest.mark.slow
def test_a_wish_that_cannot_come_true_names_what_binds_and_a_wish_that_does():
    with pytest.raises(NoSuchSheet) as caught:
        design_for({"eta": -1, "width": 2, "process": "sla", "viewing": 300})
    text = str(caught.value)
    assert "asks for a pitch of" in text
    assert "5 cells across the sheet" in text
    [word] = [line.strip().split(" comes true")[0] for line in text.splitlines() if " comes true" in line][:1]
    words = {"eta": -1, "width": 2, "process": "sla", "viewing": 300}
    assert design_for(words | parse_wish([word])).judged.passes


@pytest.mark.slow
def test_a_search_ends_by_the_work_done_and_not_by_the_clock(monkeypatch):
    """A tilted wish with work for two judgements: two designs are judged, however fast the machine is."""
    wish = read_wish({"eta": -1, "width": 5, "form": "slab", "euler": [10, 3, 0], "process": "none"})
    ended = [Search(wish, "w", work=Work(2 * JUDGEMENT)) for _ in range(2)]
    for number, search in enumerate(ended):
        monkeypatch.setattr("time.process_time", lambda number=number: 1e3 * number)
        search.run()
    assert (
        ended[0].work.done == ended[1].work.done <= 3 * JUDGEMENT + len(ended[0].refused) + AXIS + 18 * FAULTS
    )
    assert [one.ratio for one in ended[0].tried] == [one.ratio for one in ended[1].tried]
    assert ended[0].over
    assert len(ended[0].tried) <= 2


@pytest.mark.slow
def test_a_judged_non_uniform_sheet_counts_as_several():
    """A pitch of array 2 of its own: with work for one such judgement, one design is judged."""
    wish = read_wish({"eta": -1, "width": 5, "form": "slab", "process": "moulding"})
    search = Search(wish, "w", ["lattice.pitch_2=.51"], work=Work(UNEQUAL * JUDGEMENT))
    search.run()
    assert len(search.tried) == 1
    assert search.over


@pytest.mark.slow
def test_a_lean_beyond_reach_is_answered_in_seconds_with_one_that_comes_true():
    """Once more than 60 s of processor time; counted work bounds it."""
    work: list[int] = []
    with pytest.raises(NoSuchSheet) as caught:
        design_for(
            {"eta": -1, "width": 5, "euler": [10, 89, 3]},
            progress=lambda words, share: work.append(len(words)),
        )
    assert "theta = 89 deg" in str(caught.value)
    assert "euler=[10, 17.8, 3] comes true" in str(caught.value)
    assert len(work) < 20


def test_a_file_that_is_there_is_refused_by_a_sentence_that_names_overwrite(tmp_path):
    (tmp_path / "w.toml").write_text("mine")
    ended = clacad("new", "w", cwd=tmp_path)
    assert ended.status == 4
    assert "--overwrite" in ended.err
    assert (tmp_path / "w.toml").read_text() == "mine"


@pytest.mark.parametrize(
    ("kind", "told"), [("fig5", "fig5-phi-45"), ("fig7-psi", "fig7-psi-270"), ("slap", "slab")]
)
def test_a_template_that_is_not_there_names_those_that_begin_so(kind, told):
    with pytest.raises(DesignError) as caught:
        template("x", kind)
    assert told in caught.value.mistakes[0].hint


def test_the_list_groups_the_designs_of_the_paper_and_says_what_differs(tmp_path):
    ended = clacad("new", "--list", "--all", cwd=tmp_path)
    lines = ended.out.splitlines()
    head = next(k for k, line in enumerate(lines) if "Fig. 5" in line)
    under = lines[head + 1 : head + 6]
    assert all(line.startswith("  fig5-phi-") for line in under)
    assert any("law.euler = [26.57, 0.0, 0.0]" in line for line in under)


@pytest.mark.slow
def test_the_commands_named_next_are_complete(tmp_path):
    """Each of them runs as it is printed: where files are written, -o is stated."""
    said = clacad("new", "w", "--template", "slab", cwd=tmp_path).out.partition("next: ")[2].splitlines()
    lines = [line.strip().removeprefix("clacad ").split() for line in said]
    assert [words[0] for words in lines] == ["check", "export"]
    assert all("-o" in words for words in lines if words[0] == "export")
    ended = clacad(*lines[1], "--dry-run", cwd=tmp_path)
    assert ended.status == 0, ended.err


# --- the command --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_new_for_a_wish_writes_the_design_and_the_schema_beside_it(tmp_path):
    ended = clacad("new", "w", "--for", "eta=.5, width=20, process=moulding", "--json", cwd=tmp_path)
    assert ended.status == 0, ended.err
    told = json.loads(ended.out)
    assert (tmp_path / "w.toml").read_text(encoding="utf-8") == told["text"]
    assert told["passed"] is True
    schema = json.loads((tmp_path / "clacad.schema.json").read_text(encoding="utf-8"))
    assert schema["title"] == "clacad design"
    assert told["text"].startswith("#:schema clacad.schema.json\n")
    assert not ended.packages & {"OCP", "build123d", "matplotlib", "trimesh"}


def test_a_dry_run_prints_the_file_and_writes_nothing(tmp_path):
    ended = clacad("new", "w", "--template", "biconvex", "--dry-run", cwd=tmp_path)
    assert ended.status == 0
    assert 'form = "biconvex"' in ended.out
    assert not list(tmp_path.iterdir())


def test_a_schema_of_another_program_is_left_alone_and_an_older_one_of_ours_is_renewed(tmp_path):
    beside = tmp_path / "clacad.schema.json"
    for text, kept in (('{"title": "mine"}', True), ('{"title": "clacad design"}', False)):
        beside.write_text(text)
        ended = clacad("new", "w", "--overwrite", cwd=tmp_path)
        assert ended.status == 0
        assert (beside.read_text() == text) is kept
        assert ("was left as it is" in ended.err) is kept


@pytest.mark.daily_cases("words0-2-a NAME is needed", "words4-2-must not hold")
@pytest.mark.parametrize(("words", "status", "told"), [
    (("new",), 2, "a NAME is needed"),
    (("new", "w", "--for", "eta=-1"), 2, "the sheet's size"),
    (("new", "w", "--for", "eta=-1, width=5", "--template", "slab"), 2, "exclude each other"),
    (("new", "w", "--set", "pair.index=1.5"), 2, "--set belongs to --for"),
    (("new", "a/../../b?", "--for", "eta=-1, width=5"), 2, "must not hold"),
    pytest.param(("new", "w", "--for", "eta=-1, width=2, process=sla, viewing=300"), 1, "no design was found",
                 marks=pytest.mark.long),
])  # fmt: skip
def test_what_cannot_be_written_is_said_and_nothing_is(tmp_path, words, status, told):
    ended = clacad(*words, cwd=tmp_path)
    assert ended.status == status
    assert told in ended.err
    assert not list(tmp_path.rglob("*.toml"))


@pytest.mark.slow
def test_a_file_that_is_there_is_refused_before_the_search(tmp_path):
    (tmp_path / "w.toml").write_text("mine")
    ended = clacad("new", "w", "--for", ROUND, cwd=tmp_path)
    assert ended.status == 4
    assert "clacad.tracing" not in ended.modules
    assert (tmp_path / "w.toml").read_text() == "mine"


def test_questions_have_defaults_and_a_wrong_answer_is_explained_and_asked_again(monkeypatch, capsys):
    from clacad.cli.new_command import ask

    typed = iter(["", "0", "-.5", "", "", "circle 6 cm", "2 m", "moldin", "moulding", "PC", "", "hexagonal"])
    monkeypatch.setattr("builtins.input", lambda question: next(typed))
    name, words = ask()
    said = capsys.readouterr().out
    assert "eta_x = 0" in said
    assert 'did you mean "moulding"?' in said
    assert name == "window"
    assert read_wish(words) == Wish(
        (-0.5, -0.5), Outline("circle", (60.0, 60.0)), viewing=2000.0, process="moulding", material="PC", kind="hexagonal"
    )  # fmt: skip


def test_a_person_who_gives_no_more_answers_ends_the_command(monkeypatch):
    from clacad.cli.new_command import ask

    def gone(question):
        raise EOFError

    monkeypatch.setattr("builtins.input", gone)
    with pytest.raises(KeyboardInterrupt):
        ask()


# -- white light -------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_wish_for_white_light_finds_layers_and_says_what_they_cost():
    words = parse_wish(["eta=-1, width=40 mm, pitch=0.5, white < 0.06 mrad"])
    assert read_wish(words).white == 6e-5
    assert parse_wish(["white=0.06 mrad"]) == parse_wish(["white <= 0.06 mrad"])
    found = design_for(words)
    white = next(check for check in found.judged.checks if check.id == "law_white")
    assert white.value < white.limit == 6e-5
    assert [body.material.name for body in found.judged.window.bodies] == ["PMMA", "PC", "PMMA"]
    reasons = " ".join(found.reasons)
    assert "one material (PMMA) leaves 0.0" in reasons
    assert "cost: 3 layers, PMMA, PC, PMMA, cemented along 2 curved joints" in reasons
    assert read_wish(found.wish.words()) == found.wish


@pytest.mark.slow
def test_what_one_material_leaves_of_white_light_is_the_floor_of_the_traced_sheet():
    wish = read_wish({"eta": -1, "width": 20, "white": "1 mrad"})
    design = built(wish, Variant("slab", conic=-0.448), 0.25, 57.29, "far")
    white = next(check for check in judge(design).light if check.id == "law_white")
    assert least_of_one_material(wish) == pytest.approx(white.detail["floor"], rel=0.01)
    assert least_of_one_material(replace(wish, eta=(0.5, -2.0))) < inf


def test_wishes_for_white_light_that_cannot_be_are_refused_with_their_reasons():
    with pytest.raises(DesignError, match="white needs a material"):
        read_wish({"eta": -1, "width": 20, "white": "1 mrad", "index": 1.5})
    shapes, refused = read_wish({"eta": -0.5, "width": 20, "white": "0.05 mrad"}), []
    assert list(layered(shapes, refused)) == []
    assert "diamond-turning works none of N-BK7|N-SF6" in refused[0]
