"""Sheets of equal cells pay nothing for sheets whose cells differ: none of their code is loaded."""

import subprocess
import sys

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
    "clacad.tracing.compiled.own_cells", "clacad.mesh.own_cells", "clacad.sheet.own_steps",
    "clacad.prescription.aimed_cells", "clacad.prescription.varying_cells", "clacad.prescription.superlens",
    "clacad.prescription.traced_vertices",
}  # fmt: skip


def loaded(paths):
    code = SCENE.replace("PATHS", repr(paths))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


def test_a_homogeneous_scene_loads_no_code_of_cells_that_differ():
    assert not loaded(["numpy"]) & OF_OWN_CELLS
