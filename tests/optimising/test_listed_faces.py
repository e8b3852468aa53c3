"""Searches over listed faces: unknowns that read back, trials as a design is built, walls, the error that is reached."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clacad import DesignError, Scan, optimise, prescribe, steer
from clacad.base.types import silent
from clacad.design import Design, load, template
from clacad.optimising.aim import LISTED_FIELDS
from clacad.optimising.face_search import Walls
from clacad.optimising.scan_light import BEAM, ScanLight
from clacad.optimising.search import design_text
from clacad.optimising.unknowns import BOTH, listed_unknowns, with_listed
from clacad.prescription.face_matrices import matrices

DATA = Path(__file__).parents[1] / "data"
WORDS = ("radii", "conic", "a4", "a6", "thickness")


def starter(kind: str) -> Design:
    return Design.from_dict(tomllib.loads(template(kind, kind))).with_cells((12, 12))


@pytest.mark.parametrize(("kind", "count"), [("two-plates-10deg", 10), ("scanner-f5", 19), ("achromat", 6)])
def test_unknowns_read_back_as_the_faces_and_mirror_images_share_them(kind, count):
    design = starter(kind)
    unknowns = listed_unknowns(design, prescribe(design), WORDS)
    assert len(unknowns.free) == count
    assert all(one.part == BOTH for one in unknowns.free)
    vector = unknowns.vector + 0.01
    again = replace(unknowns, start=unknowns.faces(vector)[0])
    assert again.vector == pytest.approx(vector, rel=1e-12)
    for face, one in zip(design.pair.face, unknowns.faces(unknowns.vector)[0], strict=True):
        assert one.radius == pytest.approx(face.radius, rel=1e-6)


def test_a_trial_is_the_window_of_the_design_with_its_faces():
    design = load(DATA / "plates" / "curved-joints.toml")
    window = prescribe(design)
    unknowns = listed_unknowns(design, window, ("radii", "conic", "joints"))
    faces, _ = unknowns.faces(unknowns.vector * 1.01)
    trial = with_listed(window, faces)
    built = prescribe(replace(design, pair=replace(design.pair, face=faces)))
    for one, two in zip(trial.faces, built.faces, strict=True):
        assert one.vertex == pytest.approx(two.vertex, rel=1e-12)
        assert one.surface == two.surface


@pytest.mark.slow
def test_a_search_over_plates_returns_to_the_error_of_the_starter_with_its_walls_kept(tmp_path):
    design = starter("two-plates-10deg")
    faces = tuple(
        replace(face, radius=tuple(r * (1.01 if k in (0, 3) else 0.995) for r in face.radius))
        for k, face in enumerate(design.pair.face)
    )
    start = replace(design, pair=replace(design.pair, face=faces))
    start = Design.from_dict({**start.given, "pair": start.given["pair"] | {"face": _tables(faces)}})
    found = optimise(start, ("radii", "conic"), progress=lambda *_: None)
    assert found.before[-1].law_rms > 2.5e-3
    assert found.after[-1].law_rms <= 1.8e-3
    assert found.after[-1].throughput >= 0.98
    assert [seen.field / found.field for seen in found.after] == pytest.approx(LISTED_FIELDS)
    b = [matrices(one.pair)[0][0, 1] for one in (start, found.design)]
    assert b[1] == pytest.approx(b[0], rel=0.0101)
    assert min(Walls.of(start, prescribe(start)).slack(prescribe(found.design)).values()) >= 0.0
    out = tmp_path / "better.toml"
    out.write_text(design_text(found), encoding="utf-8")
    assert load(out).pair.face == found.design.pair.face


@pytest.mark.slow
def test_terms_of_sixth_order_are_kept_and_searched_together_with_the_others():
    """Terms too weak to take a tenth of the error; the list stays its own mirror image, and the walls are kept."""
    design = starter("two-plates-10deg")
    found = optimise(design, ("a6",), progress=lambda *_: None)
    assert found.left_out == ()
    assert found.history[-1][1] < 0.999 * found.history[0][1]
    terms = [face.a6[0] for face in found.design.pair.face]
    assert any(terms)
    assert terms == [-term for term in terms[::-1]]
    assert min(Walls.of(design, prescribe(design)).slack(prescribe(found.design)).values()) >= 0.0


def _tables(faces):
    from clacad.design.faces import face_table

    return [face_table(face) for face in faces]


@pytest.mark.parametrize(
    ("word", "says"),
    [
        ("offset", "follows delta"),
        ("field", "listed with the others"),
        ("joints", "no face is one"),
        ("x", "nothing that"),
    ],
)
def test_words_that_a_list_lacks_are_refused(word, says):
    design = starter("two-plates-10deg")
    with pytest.raises(DesignError, match=says):
        listed_unknowns(design, prescribe(design), (word,))


def test_walls_keep_b_and_the_air_between_plates():
    design = starter("two-plates-10deg")
    window = prescribe(design)
    walls, unknowns = Walls.of(design, window), listed_unknowns(design, window, ("thickness",))
    assert min(walls.slack(window).values()) >= 0.0
    wider = with_listed(window, unknowns.faces(unknowns.vector * 1.05)[0])
    assert walls.slack(wider)["B of the faces"] < 0.0
    air = [k for k, one in enumerate(unknowns.free) if one.faces == (1,)]
    closer = unknowns.vector.copy()
    closer[air] = 0.01
    slack = walls.slack(with_listed(window, unknowns.faces(closer)[0]))
    assert slack["air behind plate 1"] < 0.0
    assert np.isfinite(list(slack.values())).all()


F2 = Scan(0.0491, "x", {2: 0.5, 3: 1.0})
F2_UNHELD = Path(__file__).parents[1] / "data" / "scanner-f2.toml"
"""Faces of a search without a wall for the exit beam, which shrinks to 0.93."""


def test_light_of_a_scan_is_that_of_the_positions_that_are_traced_through_cells():
    design = load(F2_UNHELD).with_cells((12, 12))
    light = ScanLight.of(F2, prescribe(design).with_cells((1, 1)))
    seen = light.start
    found = steer(design, replace(F2, positions=11), waves=False, progress=silent).positions[5:]
    assert light.travels == pytest.approx([one.travel for one in found], abs=1e-15)
    assert seen.mean == pytest.approx(np.array([one.slopes for one in found]), abs=2e-4)
    assert seen.spread == pytest.approx([one.spread for one in found], rel=0.04)
    assert seen.share == pytest.approx([one.share for one in found], abs=0.015)
    assert seen.beam == pytest.approx(np.array([one.exit_beams for one in found]), abs=0.01)
    mean = np.mean([one.spread**8 for one in found]) ** 0.125
    window = prescribe(design)
    assert np.linalg.norm(light.residuals(window)) == pytest.approx(mean, rel=0.03)
    slack = light.slack(window)
    assert slack["exit beam"] == pytest.approx(1.0 - (1.0 - found[-1].exit_beams[0]) / BEAM, abs=0.1)
    assert slack["exit beam"] < 0.0 < slack["share of the scan"]


@pytest.mark.slow
def test_a_scan_is_searched_with_its_beam_slope_and_share_held(tmp_path):
    design = starter("scanner-f5")
    scan = Scan(0.04925, positions=3)
    found = optimise(design, ("conic",), scan, progress=lambda *_: None)
    before, after = found.scans
    assert after.worst_spread < before.worst_spread
    assert np.mean([one.spread for one in after.positions]) < np.mean(
        [one.spread for one in before.positions]
    )
    assert after.least_share >= 0.96
    assert all(abs(width - 1.0) <= 0.05 for one in after.positions for width in one.exit_beams)
    assert after.positions[-1].slopes[0] == pytest.approx(before.positions[-1].slopes[0], rel=5e-3)
    out = tmp_path / "better.toml"
    out.write_text(design_text(found), encoding="utf-8")
    assert load(out).pair.search.scan == '"±0.04925 mm" --axis x'
    assert found.to_dict()["scan"][1]["positions"][0]["spread"] == after.positions[0].spread


@pytest.mark.long
def test_a_search_brings_the_beam_of_the_wide_scanner_within_five_percent():
    design = load(F2_UNHELD).with_cells((12, 12))
    found = optimise(design, ("radii", "conic", "thickness"), F2, progress=lambda *_: None)
    before, after = found.scans
    assert min(one.exit_beams[0] for one in before.positions) < 0.94
    assert all(abs(width - 1.0) <= 0.05 for one in after.positions for width in one.exit_beams)
    assert after.worst_spread <= 1.9e-3
    assert after.least_share >= 0.96
    assert after.positions[-1].slopes[0] >= 0.244


def test_scans_of_what_has_none_are_refused():
    with pytest.raises(DesignError, match="moves listed plates"):
        optimise(starter("slab"), ("radii",), Scan(0.01))
    with pytest.raises(DesignError, match="focuses"):
        optimise(starter("scanner-f5"), ("radii",), Scan(0.01, "z"))
    with pytest.raises(DesignError, match="at one wavelength"):
        optimise(starter("scanner-f5"), ("radii",), Scan(0.01), spectrum="visible")
