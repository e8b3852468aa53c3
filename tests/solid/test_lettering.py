"""Letters as plane faces: the same order every time, regardless of addresses in memory."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from build123d import FontStyle, Text

from clacad.base.polygons import polygon_area
from clacad.exporting.fixtures.engraving import polygons
from clacad.solid.marks import lettering

TEXT = "B8 i= 0.98 ,+"
"""Glyphs of two pieces and glyphs of two holes."""


def drawn(text: str) -> list[np.ndarray]:
    return polygons(lettering(text, 7.0), 0.01)


def test_text_drawn_again_among_other_things_in_memory_comes_in_the_same_order():
    chance, kept, found = np.random.default_rng(3), [], set()
    for _ in range(12):
        kept += [bytearray(int(size)) for size in chance.integers(1, 4000, 2000)][::7]
        found.add(b"".join(loop.tobytes() for loop in drawn(TEXT)))
    assert len(found) == 1


def test_pieces_of_letters_and_the_holes_of_each_run_from_left_to_right():
    loops = drawn(TEXT)
    outer = [loop for loop in loops if polygon_area(loop) > 0.0]
    assert all(a[:, 0].min() <= b[:, 0].min() for a, b in pairwise(outer))
    holes = [loop for loop in loops if polygon_area(loop) < 0.0]
    assert len(holes) == 2 + 2 + 1 + 1 + 2  # B, 8, 0, 9, 8
    for piece, hole in pairwise(loops):
        if polygon_area(hole) < 0.0 < polygon_area(piece):  # a hole follows the piece it is in
            assert (piece.min(axis=0) < hole.min(axis=0)).all()
            assert (piece.max(axis=0) > hole.max(axis=0)).all()


def test_nothing_of_the_letters_is_lost_or_turned_over():
    plain = Text(TEXT, 7.0, font_style=FontStyle.BOLD)
    ordered = lettering(TEXT, 7.0)
    assert ordered.is_valid
    assert len(ordered.faces()) == len(plain.faces())
    assert np.isclose(ordered.area, plain.area, rtol=1e-12)
    assert all(face.normal_at().Z > 0.0 for face in ordered.faces())
