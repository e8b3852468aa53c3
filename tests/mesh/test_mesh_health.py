"""The examination of closedness: finds what is broken, the same in any number of passes."""

from __future__ import annotations

import numpy as np
import pytest
from meshwindows import FORMS, window

from clacad.mesh import check_closed, health, mesh_body


@pytest.fixture(scope="module")
def corners():
    sheet = window(**FORMS["tilted"])
    return np.concatenate(list(mesh_body(sheet, sheet.bodies[0], 4).rows())).astype(np.float32)


def test_a_good_mesh_is_closed_outward_and_one_piece(corners):
    found = check_closed(corners)
    assert found.closed
    assert found.outward
    assert (found.pieces, found.open_edges, found.four_face_edges) == (1, 0, 0)


def test_a_dropped_facet_leaves_three_open_edges_where_it_was(corners):
    found = check_closed(np.delete(corners, 100, axis=0))
    assert not found.closed
    assert found.open_edges == 3
    assert {tuple(p) for p in found.bad_edges.reshape(-1, 3)} == {
        tuple(p) for p in corners[100].astype(float)
    }


def test_a_flipped_facet_is_three_badly_directed_edges(corners):
    flipped = corners.copy()
    flipped[7] = flipped[7, ::-1]
    found = check_closed(flipped)
    assert found.open_edges == 3
    assert found.four_face_edges == 0


def test_a_doubled_facet_is_three_overused_edges(corners):
    found = check_closed(np.concatenate([corners, corners[5:6]]))
    assert found.four_face_edges == 3
    assert not found.closed


def test_a_facet_and_its_reverse_laid_on_a_mesh_are_not_closed(corners):
    found = check_closed(np.concatenate([corners, corners[5:6], corners[5:6, ::-1]]))
    assert found.four_face_edges == 3


def test_an_inside_out_mesh_is_closed_but_not_outward(corners):
    found = check_closed(np.ascontiguousarray(corners[:, ::-1]))
    assert found.closed
    assert not found.outward


def test_a_degenerate_facet_is_counted(corners):
    collapsed = corners[:1].copy()
    collapsed[0, 1] = collapsed[0, 0]
    found = check_closed(np.concatenate([corners, collapsed]))
    assert found.degenerate == 1
    assert not found.closed


def test_copies_beside_one_another_are_pieces(corners):
    aside = corners + np.array([1.0, 0.0, 0.0], dtype=np.float32)
    assert check_closed(np.concatenate([corners, aside])).pieces == 2


def test_minus_zero_is_zero():
    triangle = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    other = triangle[:, ::-1] * np.array([1.0, 1.0, -1.0])
    assert check_closed(np.concatenate([triangle, other])).closed


@pytest.mark.parametrize("broken", [False, True])
def test_passes_over_partitions_find_the_same(corners, broken, monkeypatch):
    mesh = np.delete(corners, [3, 50, 51], axis=0) if broken else corners
    whole = check_closed(mesh)
    monkeypatch.setattr(health, "_EDGES_A_PASS", 700)
    monkeypatch.setattr(health, "_JOINED_A_PASS", 500)
    for pieces in (True, False):
        parts = check_closed(lambda: iter([mesh[:150], mesh[150:]]), pieces=pieces)
        assert (parts.open_edges, parts.four_face_edges) == (whole.open_edges, whole.four_face_edges)
        assert parts.closed is not broken
        assert parts.pieces == (whole.pieces if pieces else None)


def test_shared_vertices_are_examined_like_plain_corners(corners):
    vertices, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    assert check_closed((vertices, number.reshape(-1, 3))).closed
