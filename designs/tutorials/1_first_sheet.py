# %% [markdown]
# # A first sheet
#
# A telescopelet is a pair of lenslets that share a focal plane. A sheet of them sends light of slope t on with
# t' = (t − δ)/η. One design says which law, from which pair, on which lattice; everything else follows from it.

# %%
import tempfile
from pathlib import Path

import numpy as np

import clacad

design = clacad.Design.from_dict({
    "format": 1, "name": "first", "unit": "mm",
    "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 10, "material": "PMMA"},
    "lattice": {"pitch": 0.5, "count": [20, 20]},
})  # fmt: skip
design

# %% [markdown]
# `prescribe` makes geometry of it: radii from focal lengths, focal lengths from η and the separation (for η = −1 both
# are half of it). In a slab light focuses inside the material, so R = (n − 1) f.

# %%
window = clacad.prescribe(design)
lens = window.faces[0].surface
print(window, "front face:", lens)
clacad.plot(window)

# %% [markdown]
# Any key may be changed; the new design is checked as a file would be, and every mistake is reported with its place.

# %%
coarser = design.replace("lattice.pitch", 1.0)
try:
    design.replace("pair.seperation", 12)
except clacad.DesignError as mistake:
    print(mistake)

# %% [markdown]
# Rays: each ends in exactly one named fate. Those that are ALIVE went through both lenses of one telescopelet and
# should leave as the law says.

# %%
x, y = np.meshgrid(np.linspace(-2.4, 2.4, 60), np.linspace(-2.4, 2.4, 60))
start = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -5.0)])
rays = clacad.Rays(start, [0.01, 0.0, 1.0])
seen = clacad.trace(window, rays)
print(seen)
alive = seen.fate == clacad.Fate.ALIVE
error = seen.direction[alive] - design.law.refract(rays.direction[alive])
rms = float(np.sqrt((error**2).sum(axis=1).mean()))
print(f"{alive.mean():.1%} obey the law, within {1e3 * rms:.3f} mrad rms")
assert rms < 3e-4

# %% [markdown]
# Write it, and judge what was written by light through that very file. STEP keeps the faces exact.

# %%
folder = Path(tempfile.mkdtemp(prefix="clacad-")) / "first"
clacad.export(design, folder, ("step",), cells=(3, 3))
report = clacad.verify(design, folder, rays=4096)
print(report.verdict())
assert report.passed
report
