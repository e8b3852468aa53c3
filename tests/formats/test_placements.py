"""Placements that only move are added: the same places as products of matrices give."""

from __future__ import annotations

import numpy as np

from clacad.formats.placements import applied, by_turn, product, unturned


def whole(placements: np.ndarray) -> np.ndarray:
    """As matrices (…, 4, 4)."""
    last = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (*placements.shape[:-2], 1, 4))
    return np.concatenate([placements, last], axis=-2)


def moves(count: int) -> np.ndarray:
    found = np.tile(np.eye(3, 4), (count, 1, 1))
    found[:, :, 3] = np.random.default_rng(count).normal(size=(count, 3)) * 1e3
    return found


def turned(count: int) -> np.ndarray:
    found = moves(count)
    found[:, :, :3] = np.linalg.qr(np.random.default_rng(7).normal(size=(count, 3, 3)))[0]
    return found


def test_products_are_those_of_matrices_whether_parts_turn_or_not():
    for outer, inner in (
        (moves(5), moves(4)),
        (turned(5), moves(4)),
        (moves(5), turned(4)),
        (turned(5), turned(4)),
    ):
        found = product(outer[:, None], inner[None])
        np.testing.assert_allclose(whole(found), whole(outer)[:, None] @ whole(inner)[None], atol=1e-12)
        if unturned(outer) and unturned(inner):
            np.testing.assert_array_equal(found[..., 3], outer[:, None, :, 3] + inner[None, :, :, 3])


def test_points_are_placed_as_matrices_place_them():
    points = np.random.default_rng(3).normal(size=(6, 3))
    for placements in (moves(4), turned(4)):
        wanted = np.concatenate([points, np.ones((6, 1))], axis=1) @ np.swapaxes(whole(placements), 1, 2)
        np.testing.assert_allclose(applied(placements, points[None]), wanted[..., :3], atol=1e-12)


def test_an_almost_unturned_placement_is_not_taken_for_a_move():
    placements = moves(3)
    placements[1, 0, 1] = 5e-324
    assert not unturned(placements)
    assert unturned(placements[[0, 2]])


def test_placements_are_grouped_by_how_they_turn():
    placements = np.concatenate([moves(3), turned(2), moves(4)])
    groups = sorted(rows.tolist() for rows in by_turn(placements))
    assert groups == [[0, 1, 2, 5, 6, 7, 8], [3], [4]]
    assert [rows.tolist() for rows in by_turn(moves(3))] == [[0, 1, 2]]
    assert by_turn(moves(0)) == []
