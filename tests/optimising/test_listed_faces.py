"""Searches over listed faces: unknowns that read back, trials as a design is built, walls, the error that is reached."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clacad import DesignError, optimise, prescribe
from clacad.design import Design, load, template
from clacad.optimising.aim import LISTED_FIELDS
from clacad.optimising.face_search import Walls
from clacad.optimising.listed_unknowns import BOTH, listed_unknowns, with_listed
from clacad.optimising.search import design_text
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
