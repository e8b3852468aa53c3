"""Light in sums: against the rows of the same trace, against the fit of its rays, and the same bits on any number of threads."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
import pytest
from oracle.windows import biconvex, slab

import clacad
from clacad.light import sums as light_sums
from clacad.light.sums import fitted
from clacad.optics.law import Law, angle_between
from clacad.optics.law.law import law_in_axes
from clacad.optics.rays import Fate, Rays
from clacad.sheet.bundle import bundle

WINDOWS = {
    "biconvex": lambda: biconvex(count=(6, 6)),
    "tilted": lambda: biconvex(euler=(0.4, 0.1, 0.2), count=(6, 6)),
    "slab": lambda: slab(count=(6, 6)),
}


def beam(window: Any, count: int = 40_000) -> Rays:
    """Light of the field on one cell, among it rays that miss, are lost and are no rays."""
    rays = bundle(window, count, 0.02, "axis", 1.4).rays
    direction = rays.direction * np.linspace(0.5, 2.0, count)[:, None]
    direction[::50, 0] += 0.7
    direction[7] = 0.0
    position = rays.position.copy()
    position[::90, 0] += 1.0
    return Rays(position, direction)


def close(one: float, other: float, part: float) -> bool:
    return abs(one - other) <= part * abs(other)


@pytest.mark.daily_cases("tilted-numpy", "biconvex-numpy", "slab-numpy", "tilted-numba", "slab-numba")
@pytest.mark.parametrize("path", ["numpy", "numba"])
@pytest.mark.parametrize("name", WINDOWS)
def test_sums_are_those_of_the_rows_of_the_trace(name: str, path: Any) -> None:
    window = WINDOWS[name]()
    rays, tracer = beam(window), clacad.Tracer(window, path=path)
    found, rows = tracer.sums(rays), tracer(rays)
    alive = rows.fate == Fate.ALIVE
    angle = angle_between(rows.direction[alive], window.law.refract(rays.direction[alive]))
    known = angle[np.isfinite(angle)]
    assert found.counts == rows.counts()
    assert found.known == len(known) > 5000
    assert close(found.rms, sqrt(np.mean(known.astype(np.longdouble) ** 2)), 1e-12)
    assert close(found.worst, known.max(), 1e-12)
    mean = rows.direction[alive].astype(np.longdouble).mean(axis=0)
    assert np.abs(found.mean_direction - mean).max() < 2e-16


@pytest.mark.daily_cases("slab-numpy", "biconvex-numba", "tilted-numba", "slab-numba")
@pytest.mark.parametrize("path", ["numpy", "numba"])
@pytest.mark.parametrize("name", WINDOWS)
def test_the_law_that_sums_settle_on_is_the_one_fitted_to_the_rays(name: str, path: Any) -> None:
    window = WINDOWS[name]()
    rays, tracer = bundle(window, 30_000, 0.01, "axis", 0.5).rays, clacad.Tracer(window, path=path)
    rows = tracer(rays)
    alive = rows.fate == Fate.ALIVE
    asked = law_in_axes(rays.direction[alive], rows.direction[alive], window.law)
    found = fitted(tracer.sums, rays)
    for key in ("eta_x", "eta_y", "delta_x", "delta_y"):
        assert abs(getattr(found.law, key) - getattr(asked, key)) < 1e-9, key
    away = Law(window.law.eta_x * 1.3, window.law.eta_y * 0.8, 0.01, -0.02, *np.array([window.law.phi, window.law.theta, window.law.psi]))  # fmt: skip
    again = fitted(tracer.sums, rays, away).law
    assert abs(again.eta_x - found.law.eta_x) < 1e-11
    assert found.rms <= tracer.sums(rays).rms * (1.0 + 1e-12)


def test_one_thread_and_five_give_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(light_sums, "PIECE", 1000)
    window = WINDOWS["biconvex"]()
    rays = beam(window, 10_500)
    one, five = (clacad.Tracer(window, path="numba", threads=n).sums(rays) for n in (1, 5))
    assert one.sums.tobytes() == five.sums.tobytes()
    assert (one.worst, one.counts) == (five.worst, five.counts)


@pytest.mark.daily_cases("law", "thin")
@pytest.mark.parametrize("rung", ["law", "thin", "mesh"])
def test_every_rung_is_summed(rung: Any) -> None:
    window = WINDOWS["slab"]()
    mesh = clacad.tessellate(window, quads=4) if rung == "mesh" else None
    tracer, rays = clacad.Tracer(window, rung, mesh=mesh), beam(window, 3000)
    found, rows = tracer.sums(rays), tracer(rays)
    assert found.counts == rows.counts()
    angle = angle_between(rows.direction, window.law.refract(rays.direction))[rows.fate == Fate.ALIVE]
    assert abs(found.rms - sqrt(np.nanmean(angle**2))) < 1e-15 + 1e-12 * found.rms


def test_angles_of_every_size_are_those_of_the_rows() -> None:
    """The arc sine of small chords passes into the arc tangent of large ones."""
    window = WINDOWS["biconvex"]()
    rays, tracer = bundle(window, 2000, 0.01, "axis").rays, clacad.Tracer(window, path="numba")
    rows = tracer(rays)
    alive = rows.fate == Fate.ALIVE
    for turn in (0.0, 1e-9, 0.009, 0.011, 0.3, 1.2):
        law = Law(window.law.eta_x, window.law.eta_y, turn)
        angle = angle_between(rows.direction[alive], law.refract(rays.direction[alive]))
        assert close(tracer.sums(rays, law).rms, sqrt(np.mean(angle**2)), 1e-12)


def test_no_light_and_too_little_of_it_are_said() -> None:
    window = WINDOWS["biconvex"]()
    tracer = clacad.Tracer(window)
    none = tracer.sums(Rays(np.empty((0, 3)), np.empty((0, 3))))
    assert sum(none.counts.values()) == 0
    assert np.isnan([none.rms, *none.mean_direction]).all()
    with pytest.raises(ValueError, match="no light"):
        none.nearer_law()
    with pytest.raises(ValueError, match="too much alike"):
        fitted(tracer.sums, bundle(window, 500, 0.0, "axis").rays)
    with pytest.raises(ValueError, match="whole rays"):
        clacad.Tracer(window, effects=("fresnel",)).sums(beam(window, 10))
