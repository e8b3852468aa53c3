"""The column walk against brute force: rays marched in small steps through the sheet's own definition."""

from __future__ import annotations

import numpy as np
import pytest
from often import often
from oracle.marching import march
from oracle.windows import PITCH, beam, collection

from clacad.effects.trace import trace
from clacad.optics.rays import Fate, Rays

# the honeycomb between the arrays is no part of `clacad.sheet.window`; its own tests are in test_trace_thin
WINDOWS = {name: window for name, window in collection().items() if name != "baffle"}


def agree(found, result, ray):
    """Whether the marched ray and row `ray` of the result ended alike."""
    same = found.name == Fate(result.fate[ray]).name
    same &= bool(np.abs(found.direction - result.direction[ray]).max() < 1e-5)
    # a hole has no face to be on; any point of the ray will do there
    if found.name not in ("MISSED", "LAND"):
        # the step at a tilted lens's rim is noticed where the ray next crosses a face: lost there, a little later
        error = 1e-2 if found.name == "WALL" else 1e-5
        same &= bool(np.abs(found.position - result.position[ray]).max() < error * PITCH)
    return same


def disagreements(window, number, seed):
    position, direction = beam(window, number, seed, steepest=1.2)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    result = trace(window, Rays(position, direction), path="numpy")
    out = []
    for ray in range(number):
        for step in (PITCH / 60, PITCH / 4000):  # a coarse march may jump over a corner: march again, finely
            found = march(window, position[ray], direction[ray], step)
            if agree(found, result, ray):
                break
        else:
            out.append((ray, found.name, Fate(result.fate[ray]).name))
    return out


@pytest.mark.ci_cases("tilted by 20 degrees", "opaque seam", "hexagonal")
@pytest.mark.daily_cases("offset")
@pytest.mark.parametrize("name", often(WINDOWS, "web", "offset", "opaque seam", "hexagonal", "tilted by 20 degrees",
                                      "holes outside the rim"))  # fmt: skip
def test_the_walk_ends_where_a_march_in_small_steps_ends(name):
    assert disagreements(WINDOWS[name], 20, 20) == []


@pytest.mark.long
@pytest.mark.parametrize("name", WINDOWS)
def test_the_walk_agrees_with_the_march_on_many_rays(name):
    # a march of finite step misses corners thinner than itself: one ray in hundreds may disagree
    assert len(disagreements(WINDOWS[name], 300, 21)) <= 1
