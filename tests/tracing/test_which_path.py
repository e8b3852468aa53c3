"""Choice of the path: when kernels are loaded without a request, and when the number of rays alone decides."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracle.windows import slab

import clacad
from clacad.optics.rays import Rays
from clacad.tracing import trace as tracers
from clacad.tracing import which_path
from clacad.tracing.compiled import chunk as kept_kernels

DESIGNS = Path(__file__).parents[2] / "designs"


@pytest.fixture
def by_numpy(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of rays that numpy traced."""
    given: list[int] = []
    kept = tracers._by_numpy
    monkeypatch.setattr(
        tracers, "_by_numpy", lambda a, rays, *more: given.append(len(rays)) or kept(a, rays, *more)
    )
    return given


def upright(count: int) -> Rays:
    place = np.random.default_rng(1).uniform(-1e-4, 1e-4, (count, 2))
    return Rays(np.column_stack([place, np.full(count, -0.05)]), np.tile([0.0, 0.0, 1.0], (count, 1)))


@pytest.mark.parametrize("rung", ["law", "surfaces"])
def test_kernels_are_loaded_once_numpy_has_worked_for_as_long_as_that_takes(
    rung: Any, by_numpy: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(which_path, "LOADING", 3500.0)
    monkeypatch.setattr(
        which_path, "IN_NUMPY", dict.fromkeys(which_path.IN_NUMPY, 1.0)
    )  # a second a ray-surface
    monkeypatch.setattr(kept_kernels, "rung_is_kept", lambda *_: True)
    window, rays = slab(count=(4, 4)), upright(1000 if rung == "surfaces" else 500)
    clacad.trace(window, rays, rung, path="numpy")
    assert not which_path.WAITED, "what was asked to be numpy's did not wait"
    fates = [clacad.trace(window, rays, rung).fate for _ in range(3)]
    assert by_numpy == [len(rays)] * 2, "2000 + 2000 ray-surfaces are more than loading is worth"
    assert all((fate == fates[0]).all() for fate in fates)


def test_kernels_that_are_not_kept_are_waited_for_longer(
    by_numpy: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(which_path, "LOADING", 1e-4)
    monkeypatch.setattr(kept_kernels, "rung_is_kept", lambda *_: False)
    window, rays = slab(count=(4, 4)), upright(1000)
    for _ in range(3):
        clacad.trace(window, rays)
    assert by_numpy == [1000] * 3


def test_seconds_that_were_measured_decide_and_not_the_number_of_rays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Cells that differ take numpy longer than equal ones, and slow machines longer than fast ones."""
    monkeypatch.setattr(kept_kernels, "rung_is_kept", lambda *_: True)
    layout, clock = clacad.tracing.layout.lay_out(slab(count=(4, 4))), iter([10.0, 10.2, 20.0, 20.002])
    monkeypatch.setattr(which_path, "thread_time", lambda: next(clock))
    rays = which_path.LEAST_MEASURED
    with which_path.measuring("surfaces", layout, rays, 4):
        pass  # .2 s
    suits = [which_path.compiled_suits("surfaces", None, rays, 4, layout) for _ in range(5)]
    assert suits == [False] * 4 + [True], "loading takes .8 s: the fifth call is beyond that"
    which_path.WAITED.clear()
    with which_path.measuring("surfaces", layout, rays, 4):
        pass  # .002 s
    assert not any(which_path.compiled_suits("surfaces", None, rays, 4, layout) for _ in range(100))


def test_surfaces_that_numpy_iterates_are_left_to_kernels_sooner(monkeypatch: pytest.MonkeyPatch) -> None:
    """200,000 rays through two biconics take numpy 2.4 s, through two ellipsoids .3 s; loading takes .8 s."""
    monkeypatch.setattr(kept_kernels, "rung_is_kept", lambda *_: True)
    plain = clacad.load(DESIGNS / "window-100mm.toml").with_cells((3, 3))
    biconic = plain.replace({"pair.surface": "biconic", "pair.conic": [-0.7, -0.6]})
    for design, suits in ((plain, False), (biconic, True)):
        which_path.WAITED.clear()
        layout = clacad.tracing.layout.lay_out(clacad.prescribe(design))
        assert which_path.compiled_suits("surfaces", None, 200_000, 2, layout) is suits


@pytest.mark.parametrize("rung", ["law", "thin", "surfaces"])
def test_what_is_kept_is_known_before_it_is_loaded(
    rung: Any, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    window = slab(count=(4, 4))
    layout = clacad.tracing.layout.lay_out(window)
    clacad.trace(window, upright(10), rung, path="numba")
    assert kept_kernels.rung_is_kept(rung, layout)
    for module, name in ((clacad.tracing.compiled.chunk, "trace_chunk"), (clacad.tracing.compiled.law_rung, "law_chunk"), (clacad.tracing.compiled.thin, "thin_chunk")):  # fmt: skip
        monkeypatch.setattr(getattr(module, name)._cache._cache_file, "_folder", str(tmp_path))
    assert not kept_kernels.rung_is_kept(rung, layout)


def test_the_number_of_rays_alone_decides_where_it_is_said_to() -> None:
    layout = clacad.tracing.layout.lay_out(slab(count=(4, 4)))
    for _ in range(2):
        assert which_path.compiled_suits("surfaces", "size", 750_001, 4, layout)
        assert not which_path.compiled_suits("surfaces", "size", 750_000, 4, layout)
        which_path.LOADED.add("surfaces")
    assert which_path.compiled_suits("surfaces", None, 1, 4, layout)
    assert not which_path.compiled_suits("surfaces", "numpy", 10**9, 4, layout)


@pytest.mark.parametrize("name", ["window-100mm", "hexagonal"])
def test_rung_law_of_aimed_cells_is_compiled_and_gives_what_numpy_gives(name: str) -> None:
    design = clacad.load(DESIGNS / f"{name}.toml", ["lattice.aperture={point=[0,0,-400]}"]).with_cells(
        (30, 30)
    )
    window = clacad.prescribe(design)
    assert not window.uniform
    x0, x1, y0, y1 = window.lattice.extent()
    rng = np.random.default_rng(3)
    position = np.column_stack(
        [rng.uniform(1.1 * x0, 1.1 * x1, 5000), rng.uniform(1.1 * y0, 1.1 * y1, 5000), np.full(5000, x0)]
    )
    rays = Rays(position, np.column_stack([rng.normal(0.0, 0.05, (5000, 2)), np.ones(5000)]))
    plain, compiled = (clacad.trace(window, rays, "law", path=path) for path in ("numpy", "numba"))
    for column in ("fate", "cell", "order", "surface", "direction"):
        assert np.array_equal(getattr(plain, column), getattr(compiled, column)), column
    assert np.abs(plain.position - compiled.position).max() < 1e-14 * x1
    assert 0.0 < (plain.fate == clacad.Fate.ALIVE).mean() < 1.0
