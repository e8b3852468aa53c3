"""The compiled kernels against the numpy path: same rays, same fates."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from oracle.windows import beam, biconvex, collection, slab

from clacad import load, prescribe
from clacad.effects.trace import trace
from clacad.optics.rays import Fate, Rays

WINDOWS = collection()
DESIGNS = Path(__file__).parents[2] / "designs"


def compare(window, number, seed):
    rays = Rays(*beam(window, number, seed))
    one, two = (trace(window, rays, path=path, record=True) for path in ("numpy", "numba"))
    for column in ("fate", "cell", "order", "surface", "flux"):
        np.testing.assert_array_equal(getattr(one, column), getattr(two, column), column)
    # a ray near the critical angle amplifies rounding by as much as 1e4
    for column, size in (("position", 0.1), ("direction", 1.0), ("optical_path", 0.1), ("hits", 0.1)):
        np.testing.assert_allclose(getattr(one, column), getattr(two, column), rtol=0, atol=1e-11 * size)
    return one


@pytest.mark.daily_cases(
    "paper base",
    "offset",
    "tilted by 20 degrees",
    "holes outside the rim",
    "web",
    "opaque seam",
    "hexagonal",
    "galilean",
    "round of cells",
    "baffle",
    "displaced slab",
    "round slab with seam",
    "plano outside",
    "plano inside, hexagonal",
)
@pytest.mark.parametrize("name", WINDOWS)
def test_numpy_and_compiled_paths_give_every_ray_the_same_fate(name):
    result = compare(WINDOWS[name], 4000, 1)
    assert len(np.unique(result.fate)) >= 5


@pytest.mark.parametrize("slope", [1e-308, 1e-310, 5e-324])
@pytest.mark.parametrize("name", ["hexagonal", "tilted-seam", "paper-a-covered"])
def test_a_slope_so_small_that_distances_overflow_is_traced_like_none(name, slope):
    """Such rays were MISSED wherever the compiled path had to walk: on land, at steps, into neighbours."""
    window = prescribe(load(str(DESIGNS / f"{name}.toml")))
    centres = window.lattice.centres(window.lattice.cells()[:60])
    pitch = window.lattice.pitch[0]
    start = np.full((len(centres), 3), window.z_range[0] - pitch)
    start[:, :2] = centres + np.random.default_rng(0).uniform(-0.5, 0.5, centres.shape) * pitch
    tiny, none = ([s, -s, 1.0] * np.ones((len(centres), 1)) for s in (slope, 0.0))
    straight = trace(window, Rays(start, none), path="numpy")
    assert (straight.fate != Fate.ALIVE).any()
    for path in ("numpy", "numba"):
        result = trace(window, Rays(start, tiny), path=path)
        for column in ("fate", "cell", "order", "surface"):
            np.testing.assert_array_equal(
                getattr(result, column), getattr(straight, column), f"{path} {column}"
            )
        for column in ("position", "direction", "optical_path"):
            np.testing.assert_allclose(
                getattr(result, column), getattr(straight, column), rtol=0, atol=1e-11 * max(1.0, pitch)
            )


@pytest.mark.long
@pytest.mark.parametrize("name", WINDOWS)
def test_numpy_and_compiled_paths_agree_on_many_rays(name):
    compare(WINDOWS[name], 200_000, 2)


def test_threads_change_nothing(monkeypatch):
    window = biconvex()
    rays = Rays(*beam(window, 200_000, 3))
    one = trace(window, rays, path="numba", threads=1)
    for threads in (2, 5):
        more = trace(window, rays, path="numba", threads=threads)
        for column in ("position", "direction", "fate", "cell", "order", "optical_path", "surface"):
            np.testing.assert_array_equal(getattr(one, column), getattr(more, column))
    monkeypatch.setenv("CLACAD_THREADS", "3")
    np.testing.assert_array_equal(trace(window, rays, path="numba").fate, one.fate)
    for wrong in ("0", "-1", "many", "1.5"):
        monkeypatch.setenv("CLACAD_THREADS", wrong)
        with pytest.raises(ValueError, match="CLACAD_THREADS"):
            trace(window, rays, path="numba")


def test_a_small_job_does_not_load_the_compiler():
    code = (
        "import sys, numpy as np; from oracle.windows import biconvex, beam\n"
        "from clacad.effects.trace import trace; from clacad.optics.rays import Rays\n"
        "w = biconvex(); r = Rays(*beam(w, 10_000, 0))\n"
        "[trace(w, r, rung) for rung in ('law', 'thin', 'surfaces')]\n"
        "assert not {'numba', 'scipy', 'matplotlib', 'OCP'} & set(sys.modules), sorted(sys.modules)\n"
    )
    path = [p for p in sys.path if p]
    subprocess.run([sys.executable, "-c", f"import sys; sys.path[:0] = {path!r}\n{code}"], check=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["biconvex", "slab"])
def test_single_precision_shows_the_same_light_to_a_microradian(name):
    window = {"biconvex": biconvex, "slab": slab}[name]()
    rays = Rays(*beam(window, 20_000, 5))
    double, single = (trace(window, rays, path="numba", precision=p) for p in ("float64", "float32"))
    assert (double.fate == single.fate).mean() > 0.999
    lit = (
        (double.fate == single.fate)
        & (double.fate <= Fate.GHOST)
        & (double.order == single.order).all(axis=1)
    )
    assert lit.sum() > 1000
    apart = np.linalg.norm(double.direction - single.direction, axis=1)[lit]
    assert 1e-9 < np.median(apart) < 1e-6, "rounded to 24 bits, not to 53"
    assert np.quantile(apart, 0.999) < 100 * np.finfo(np.float32).eps
    for wrong in ({"rung": "thin"}, {"path": "numpy"}, {"record": True}, {"effects": ("fresnel",)}):
        with pytest.raises(ValueError, match="float32"):
            trace(window, rays, precision="float32", **wrong)


TRACED = """
import hashlib
import numpy as np
import clacad

seen = hashlib.sha256()
for name in ("slab", "tilted-biconvex"):
    window = clacad.prescribe(clacad.load({designs!r} + f"/{{name}}.toml"))
    chance = np.random.default_rng(1)
    reach = 8 * window.lattice.pitch[0]
    start = np.column_stack([chance.uniform(-reach, reach, (30_000, 2)), np.full(30_000, window.z_range[0] - reach)])
    rays = clacad.Rays(start, np.column_stack([chance.normal(0.0, 0.1, (30_000, 2)), np.ones(30_000)]))
    for options in ({{}}, {{"rung": "mesh", "mesh": clacad.tessellate(window, quads=8)}}, {{"effects": ("fresnel",)}}):
        found = clacad.trace(window, rays, path="numba", **options)
        for column in (found.direction, found.position, found.optical_path, found.flux):
            seen.update(np.ascontiguousarray(column).tobytes())
print(seen.hexdigest())
"""


@pytest.mark.long
def test_the_run_that_compiles_the_kernels_gives_the_bits_of_those_that_load_them(tmp_path):
    def traced(cache):
        line = [sys.executable, "-c", TRACED.format(designs=str(DESIGNS))]
        ended = subprocess.run(
            line, env=os.environ | {"NUMBA_CACHE_DIR": str(cache)}, capture_output=True, text=True, check=True
        )
        return ended.stdout

    first = traced(tmp_path)
    assert list(tmp_path.rglob("*.nbc"))
    assert traced(tmp_path) == first
