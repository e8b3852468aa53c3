"""No ray is lost: rays from all directions end in one fate each, the same by numpy and by the compiled kernels."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from oracle.windows import biconvex

from clacad.optics.rays import Fate

HERE = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def fates():
    sys.path.insert(0, str(HERE / "benchmarks"))
    try:
        import fates
    finally:
        sys.path.remove(str(HERE / "benchmarks"))
    return fates


@pytest.mark.parametrize("degrees", [0, 5, 10, 20])
def test_rays_from_all_directions_end_in_one_fate_each_by_both_paths(fates, degrees):
    window = biconvex(euler=(0.3, np.radians(degrees), 0.4) if degrees else (0.0, 0.0, 0.0))
    rays = fates.all_directions(window, 25_000, degrees + 1)
    counts, apart = fates.compare(window, rays)
    assert counts.sum() == len(rays)
    assert not len(apart)
    assert (counts[[Fate.GHOST, Fate.WALL, Fate.MISSED]] > 0).all()


COMPILED = """
import sys; sys.path[:0] = {path!r}
from numba.core import event
class Count(event.Listener):
    compiled = 0
    def on_start(self, e): pass
    def on_end(self, e): self.compiled += 1
count = Count()
event.register('numba:compile', count)
from oracle.windows import beam, biconvex
from clacad.optics.rays import Rays
from clacad.effects.trace import trace
window = biconvex()
trace(window, Rays(*beam(window, 1000, 0)), path='numba')
print(count.compiled)
import numba
numba.njit(lambda x: x + 1)(1)
print(count.compiled)
"""


@pytest.mark.slow
def test_kernels_are_kept_on_disk_so_that_a_second_process_compiles_nothing():
    code = COMPILED.format(path=[p for p in sys.path if p])
    runs = [
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True) for _ in "12"
    ]
    kernels, counter_works = map(int, runs[1].stdout.split())
    assert kernels == 0
    assert counter_works == 1


@pytest.mark.slow
def test_a_small_verify_does_not_load_the_compiler(tmp_path):
    code = (
        "import sys; sys.path[:0] = {path!r}\n"
        "import clacad\n"
        "report = clacad.verify(clacad.load({design!r}), rays=10_000)\n"
        "assert report.checks\n"
        "assert 'numba' not in sys.modules\n"
    ).format(path=[p for p in sys.path if p], design=str(HERE.parent / "designs" / "paper-base.toml"))
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)
