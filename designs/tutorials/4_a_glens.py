# %% [markdown]
# # A glens
#
# If the offset δ grows with the position, δ = δ₀ + κ r, the sheet is a lens: parallel light meets η/κ behind it. With
# η < 0 both foci lie on the same side, unlike those of an ordinary lens. One key requests it.

# %%
import tempfile
from math import inf
from pathlib import Path

import numpy as np

import clacad

design = clacad.Design.from_dict({
    "format": 1, "name": "glens", "unit": "mm",
    "law": {"eta": [-1.0, -1.0], "varying": {"f_image": 200}},
    "pair": {"form": "slab", "separation": 10, "material": "PMMA", "surface": "biconic"},
    "lattice": {"pitch": 0.5, "count": [100, 5]},
})  # fmt: skip
for cell in ((0, 2), (49, 2), (99, 2)):
    print(cell, "delta =", design.law_at(cell).delta_x)
assert design.law_at((99, 2)).delta_x == -design.law_at((0, 2)).delta_x

# %% [markdown]
# Cells stay where they are, so that they tile; only lens 2 of each is displaced. Off its vertex a lens has coma, so
# paraxial rays are no good guide to where: each vertex is moved until the mean of the cell's traced light obeys
# its law. Left where paraxial rays have it the focus of this sheet, 50 mm wide, is 6 mm off.

# %%
window = clacad.prescribe(design)
paraxial = clacad.prescribe(design.replace("pair.offset", "paraxial"))
focus = {}
for name, one in (("traced", window), ("paraxial", paraxial)):
    (seen,) = clacad.image(one, (0, 0, -inf), ("surfaces",), 20_000).rungs
    slope = seen.direction[:, 0] / seen.direction[:, 2]
    level = one.faces[1].vertex[2]
    heights = level + np.linspace(190, 205, 601)
    widths = [np.std(seen.position[:, 0] + (z - seen.position[:, 2]) * slope) for z in heights]
    focus[name] = heights[int(np.argmin(widths))] - level
    print(f"{name}: focus {focus[name]:.2f} mm behind array 2, {min(widths):.3f} mm rms in x")
assert abs(focus["traced"] - 200) < 0.5 < 4 < abs(focus["paraxial"] - 200)

# %% [markdown]
# A cell does not focus: it sends a beam as wide as itself. So the image of a point is one cell wide, 0.5/√12 = 0.144 mm
# rms, however good the lenses are; the law without cells would leave a point. `clacad.image` reports this for every
# rung and any point. A point 2 m before the sheet is imaged where the closed form predicts. Light of nearer points arrives at
# steeper angles, and more of it misses its partner lens: the share falls.

# %%
found = clacad.image(window, (20, 0, -2000))
for rung in found.rungs:
    print(
        rung.rung,
        "predicted",
        rung.predicted.point.round(3),
        "found",
        rung.found.point.round(3),
        "share",
        round(rung.share, 3),
    )
sampling = found.sampling
print(
    f"cells turn light {1e3 * sampling.slope:.2f} mrad rms from the smooth law, whose spot would be {max(sampling.smooth.spot):.1e} mm"
)
thin = found.rungs[1]
distance = thin.predicted.point[2] - 10
assert abs(distance - -1 * (-2000 - 10) / (1 + -1 / 200 * -2000)) < 1e-9  # ζ = η (z − s)/(1 + κz)
assert max(sampling.smooth.spot) < 1e-9
assert thin.share > 0.7

# %% [markdown]
# For one pair of planes there is something sharper: pairs that are not afocal but image one plane to the other
# themselves, their images on top of one another. Then nothing is left of the cells.

# %%
sharp = design.replace(
    {"law": {"eta": [-1.0, -1.0]}, "pair.focus": {"object": -300, "image": 400}, "lattice.count": [11, 11]}
)
(ideal, real) = clacad.image(clacad.prescribe(sharp), (0, 0, -300), ("thin", "surfaces"), 20_000).rungs
print(
    f"spot of a point at -300 mm: ideal lenses {max(ideal.found.spot):.1e} mm, these {max(real.found.spot):.3f} mm"
)
assert max(ideal.found.spot) < 1e-9
assert max(real.found.spot) < 0.5 / 12**0.5

# %% [markdown]
# A glens is a part like any other: exported, read back, and judged cell by cell, each by its own law. The checks
# `image_point` and `spot` are its own.

# %%
small = design.replace({"lattice.count": [9, 9], "check.viewer": "2 m"})
report = clacad.verify(small, rays=2000)
print({check.id: check.state for check in report.checks if check.where == "surfaces"})
assert {check.id: check.state for check in report.checks}["image_point"] == "pass"
with tempfile.TemporaryDirectory() as folder:
    clacad.export(small.replace("lattice.count", [3, 3]), Path(folder), ["step"])
    print(sorted(path.name for path in Path(folder).iterdir()))
clacad.plot(design)
