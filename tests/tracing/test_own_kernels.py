"""Uniform sheets pay nothing for non-uniform ones; the latter are traced through their own triangles, too."""

import subprocess
import sys

import numpy as np
import pytest
from hard import differing

import clacad
from clacad.formats.mesh.stl import write_stl
from clacad.mesh import tessellate
from clacad.optics.rays import Fate
from clacad.tracing import which_path

SCENE = """
import sys
import numpy as np
import clacad
from clacad.mesh import tessellate

design = clacad.load("designs/window-100mm.toml")
window = clacad.prescribe(design.with_cells((5, 5)))
rng = np.random.default_rng(0)
at = np.column_stack([rng.uniform(-1, 1, (400, 2)), np.full(400, -1.0)])
rays = clacad.Rays(at, np.column_stack([rng.normal(0, 0.01, (400, 2)), np.ones(400)]))
for path in PATHS:
    clacad.trace(window, rays, path=path)
clacad.trace(window, rays, rung="thin", path="numpy")
mesh = tessellate(window, quads=4)
assert sum(len(rows) for rows in mesh.bodies[0].rows()) == mesh.facet_count
print(" ".join(sorted(name for name in sys.modules if name.startswith("clacad."))))
"""

OF_OWN_CELLS = {
    "clacad.mesh.compiled_walls", "clacad.sheet.cell_heights",
    "clacad.prescription.aimed_cells", "clacad.prescription.cells",
    "clacad.prescription.traced_vertices", "clacad.prescription.sharp_pairs", "clacad.tracing.facets.own_sheet",
}  # fmt: skip


def loaded(paths):
    code = SCENE.replace("PATHS", repr(paths))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


def test_a_homogeneous_scene_loads_no_code_of_cells_that_differ():
    assert not loaded(["numpy"]) & OF_OWN_CELLS


SHEETS = {
    "aimed, vertices traced": {**differing.aimed(-400.0), "pair.offset": "traced"},
    "pitch of array 2": differing.pitched(1.002),
    "hexagonal, seam, aimed": {**differing.aimed(-400.0), "lattice.kind": "hexagonal", "lattice.seam": 0.02},
    "tilted lenses, aimed": {**differing.TILTED, **differing.aimed(-400.0)},
    "lenses that rise": differing.LEANING,
    "a table of offsets": differing.TABLED,
    "a table of eta": differing.OWN,
    "a table of eta, biconvex": {**differing.BICONVEX, **differing.OWN},
}

TURNED = {
    "cells turned": {"etas": differing.turning(7.0)},
    "cells turned, plano": {**differing.PLANO, "etas": differing.turning(7.0)},
    "cells turned, biconvex": {**differing.BICONVEX, "etas": differing.turning(0.2)},
    "cells turned, biconic": {"etas": differing.turning(7.0), "pair.surface": "biconic", "pair.conic": [-0.7, -0.6]},
    "cells turned, hexagonal": {"etas": differing.turning(7.0), "lattice.kind": "hexagonal", "lattice.seam": 0.02},
}  # fmt: skip
"""Cells with lens axes and two sizes of their own, which rung thin traces by numpy."""


def light_of_all_kinds(window, many=4000):
    """Rays of a viewer, oblique rays and rays with directions of any length, and some past the edge of the sheet."""
    rng = np.random.default_rng(1)
    x0, x1, y0, y1 = window.lattice.extent()
    at = np.column_stack(
        [rng.uniform((1.05 * x0, 1.05 * y0), (1.05 * x1, 1.05 * y1), (many, 2)), np.zeros(many)]
    )
    slope = at[:, :2] / 400.0 + rng.normal(0.0, 0.004, (many, 2))
    slope[: many // 4] = rng.normal(0.0, 0.3, (many // 4, 2))
    slope[many // 4 : many // 2] = rng.normal(0.0, 0.03, (many // 4, 2))
    way = np.column_stack([slope, np.ones(many)])
    way[many // 2 :] /= np.linalg.norm(way[many // 2 :], axis=1)[:, None]
    return clacad.Rays(at - 2.0 * way, way)


@pytest.mark.daily_share(4)
@pytest.mark.ci_cases(
    "aimed, vertices traced-surfaces",
    "pitch of array 2-surfaces",
    "tilted lenses, aimed-surfaces",
    "a table of eta, biconvex-surfaces",
)
@pytest.mark.parametrize("rung", ["law", "thin", pytest.param("surfaces", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", SHEETS | TURNED)
def test_kernels_of_every_rung_give_what_numpy_gives(name, rung):
    """Offsets by gradient and table, rises, sizes, axes, laws of cells; fates and cells to the last ray."""
    window = differing.window_of((SHEETS | TURNED)[name])
    if rung == "thin" and name in TURNED:
        assert not which_path.has_kernel(rung, window)
        return
    assert not window.uniform
    assert which_path.has_kernel(rung, window)
    rays = light_of_all_kinds(window)
    one, two = (clacad.trace(window, rays, rung, path=path) for path in ("numpy", "numba"))
    for column in ("fate", "cell", "order", "surface"):
        np.testing.assert_array_equal(getattr(one, column), getattr(two, column), column)
    np.testing.assert_allclose(two.direction, one.direction, rtol=0, atol=2e-15)
    way = np.maximum(window.lattice.pitch[0], np.abs(one.optical_path))
    size = np.maximum(way[:, None], np.abs(one.position))
    assert (np.abs(two.position - one.position) <= 1.4e-15 * size).all()
    assert (np.abs(two.optical_path - one.optical_path) <= 1.4e-15 * way).all()
    assert len(np.unique(one.fate)) >= (2 if rung == "law" else 3)


AIMED = {
    "format": 1, "name": "aimed", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 10, "material": "PMMA", "surface": "biconic", "conic": [-0.7, -0.7]},
    "lattice": {"pitch": 0.5, "count": [6, 5], "aperture": {"point": [-40, 10, -400]}},
}  # fmt: skip


def light():
    """Rays of the viewer, over the whole sheet and slightly past its edge, and some that are steeper."""
    rng = np.random.default_rng(4)
    at = np.column_stack([rng.uniform(-1.7, 1.7, 3000), rng.uniform(-1.4, 1.4, 3000), np.zeros(3000)])
    way = at - [-40.0, 10.0, -400.0]
    way /= np.linalg.norm(way, axis=1)[:, None]
    way[2000:, :2] += rng.normal(0.0, 0.03, (1000, 2))
    way /= np.linalg.norm(way, axis=1)[:, None]
    return clacad.Rays(at - way * (1.0 / way[:, 2:]), way)


@pytest.mark.slow
def test_triangles_of_cells_that_differ_send_light_where_their_faces_do_the_nearer_the_finer(tmp_path):
    window = clacad.prescribe(clacad.Design.from_dict(AIMED))
    rays = light()
    exact = clacad.trace(window, rays, path="numpy")
    rms = []
    for quads in (8, 16):
        seen = clacad.trace(window, rays, rung="mesh", mesh=quads)
        same = (
            (seen.fate == exact.fate) & (exact.fate <= Fate.GHOST) & (seen.order == exact.order).all(axis=1)
        )
        # the others pass within .03 mm, what a facet turns lens 1's light aside, of a border with its steps of .2 mm
        assert (seen.fate == exact.fate).mean() > 0.95
        assert same.sum() > 0.93 * (exact.fate <= Fate.GHOST).sum()
        assert (seen.cell == exact.cell)[same].all()
        alive = same & (exact.fate == Fate.ALIVE)
        assert alive.sum() > 1000
        assert (same & (exact.fate == Fate.GHOST)).sum() > 100
        rms.append(np.sqrt((np.linalg.norm(seen.direction - exact.direction, axis=1)[alive] ** 2).mean()))
    assert 0.4 < rms[1] / rms[0] < 0.6  # the slope of a facet is off by its size
    write_stl(tessellate(window, quads=8).bodies, tmp_path / "sheet.stl", 1.0, "sheet")
    again, first = (
        clacad.trace(window, rays, rung="mesh", mesh=mesh) for mesh in (str(tmp_path / "sheet.stl"), 8)
    )
    assert (again.fate == first.fate).mean() > 0.995  # float32
    around = np.column_stack([np.random.default_rng(1).uniform(-4.0, 4.0, (800, 2)), np.full(800, -1.0)])
    beside = clacad.Rays(around, np.tile([0.0, 0.0, 1.0], (800, 1)))
    missed = [
        clacad.trace(window, beside, **how).fate == Fate.MISSED
        for how in ({"path": "numpy"}, {"rung": "mesh", "mesh": 8})
    ]
    assert (missed[0] == missed[1]).all()
    assert 400 < missed[0].sum() < 800
    recorded = clacad.trace(window, rays, rung="mesh", mesh=8, record=True)
    assert recorded.hits is not None
    assert (recorded.fate == first.fate).all()
