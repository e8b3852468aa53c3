"""The law between two spaces: light that is straight in the common space, in 50 digits, and what no sheet does."""

from __future__ import annotations

import numpy as np
import pytest
from mpmath import matrix, mp, mpf

import clacad
from clacad.optics.law import image_point

EYE = np.eye(3)


def behind(last: list[float]) -> np.ndarray:
    """A map that leaves the plane of the sheet alone and sends (0, 0, 1) to `last`."""
    return np.column_stack([EYE[:, 0], EYE[:, 1], last])


HARD = {
    "half the depth": (EYE, behind([0, 0, 0.5])),
    "negative space": (EYE, behind([0, 0, -1])),
    "nearly unchanged": (EYE, behind([0, 0, 1 + 2**-40])),
    "nearly flat": (EYE, behind([0.25, 0, 1e-12])),
    "depth grows by 1e150": (behind([0, 0, 1e-75]), behind([0, 0, 1e75])),
    "shear that cancels to its last bits": (behind([1 + 2**-50, 0, 1]), behind([1.0, 0, 2])),
    "sheared both ways": (behind([0.3, -0.1, 2]), behind([-0.7, 0.2, -3])),
    "turned and stretched together": (
        np.array([[2, 1, 0.1], [-1, 3, 0.2], [0.5, -0.25, 1]]),
        np.array([[2, 1, 0.7], [-1, 3, -0.4], [0.5, -0.25, -2]]),
    ),
}


def exact_way(map_1, map_2, way):
    """J2^-1 J1 d in 50 digits, towards +z."""
    first, second = (
        matrix([[mpf(float(v)) for v in row[:3]] for row in one.tolist()]) for one in (map_1, map_2)
    )
    out = mp.lu_solve(second, first * matrix([mpf(float(v)) for v in way]))
    out = out / mp.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    return out if out[2] > 0 else -out  # a line; light goes on forwards


@pytest.mark.parametrize("maps", HARD.values(), ids=HARD)
def test_straight_light_of_the_common_space_obeys_the_law_in_50_digits(maps):
    law = clacad.law_between(*maps)
    with mp.workdps(50 + 200):
        for way in ([0.0, 0.0, 1.0], [0.1, -0.2, 1.0], [1e-9, 0.3, 1.0]):
            found, exact = law.refract(np.array(way)), exact_way(*maps, way)
            away = max(abs(mpf(float(a)) - b) for a, b in zip(found, exact))
            assert away < 4 * mpf(2) ** -52


def test_sheets_one_behind_the_other_lead_from_the_first_space_to_the_last():
    spaces = [EYE, behind([0.1, 0.2, -2]), behind([-0.3, 0, 0.7])]
    whole = clacad.law_between(spaces[0], spaces[2])
    assert clacad.law_between(*spaces[:2]).then(clacad.law_between(*spaces[1:])).same_as(whole)
    assert clacad.law_between(spaces[1], spaces[0]).same_as(clacad.law_between(*spaces[:2]).inverse())


def test_a_point_is_seen_where_the_maps_put_it():
    """The image of a point at depth z behind the sheet: both maps lead to one point of the common space."""
    map_2 = behind([0.2, -0.1, -0.5])
    law, point = clacad.law_between(EYE, map_2), np.array([3.0, 2.0, 40.0])
    common = map_2 @ point
    place, plane = image_point(law, point)
    np.testing.assert_allclose([*place, plane[0]], common, rtol=1e-12)


@pytest.mark.parametrize(
    ("map_1", "map_2", "said"),
    [
        (EYE, np.diag([1.0, 1.0, 0.0]), "map_2 flattens space"),
        (np.diag([1.0, 1.0, 0.0]), EYE, "map_1 flattens space"),
        (EYE, np.diag([1.0, 2.0, 1.0]), "disagree on the plane of the sheet along y"),
        (EYE, np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), "disagree on the plane of the sheet along x"),
        (np.column_stack([EYE, [0, 0, 5.0]]), EYE, "at its origin, by 5"),
        (EYE, behind([0.1, 0, 1]), "shear space by .* at unchanged depth: eta = 1 with an offset"),
        (EYE, np.eye(2), r"map_2 is no affine map of space"),
        (np.full((3, 3), np.nan), EYE, r"map_1 is no affine map of space"),
        (EYE, np.full((3, 4), np.inf), r"map_2 is no affine map of space"),
        (np.diag([2.0, 1.0, 1.0]), EYE, "disagree on the plane of the sheet along x, by 1"),
        (behind([0, 0, 2]), behind([0, 0.5, 2]), "shear space by .0, -0.5. at unchanged depth: eta = 1"),
    ],
)
def test_what_no_sheet_does_is_refused_with_the_condition_that_fails(map_1, map_2, said):
    with pytest.raises(ValueError, match=said):
        clacad.law_between(map_1, map_2)


def test_equal_spaces_need_no_sheet():
    law = clacad.law_between(EYE, np.column_stack([EYE, np.zeros(3)]))
    assert (law.eta_x, law.delta_x, law.delta_y) == (1.0, 0.0, 0.0)
