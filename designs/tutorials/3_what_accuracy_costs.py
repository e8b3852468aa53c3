# %% [markdown]
# # What accuracy costs
#
# The same rays go up a ladder of four rungs: the law alone, ideal lenslets, the exact surfaces, and the triangles
# of a file. Each has an error and a price. Choose the one that is good enough.

# %%
import time

import numpy as np

import clacad
from clacad.design.starter_designs import shipped_designs
from clacad.optics.law import angle_between
from clacad.sheet.bundle import bundle

design = clacad.load(shipped_designs() / "window-100mm.toml")
window = clacad.prescribe(design)
rays = bundle(window, 4096, design.check.field).rays
exact = clacad.trace(window, rays, path="numpy")


def error_and_seconds(rung: str, **more: object) -> tuple[float, float]:
    """Rms angle to the exact trace, and processor seconds."""
    tracer = clacad.Tracer(window, rung, path="numpy", **more)
    tracer(
        rays
    )  # the first call may make machine code of the facets' kernel, which is kept for the next time
    began = time.process_time()
    seen = tracer(rays)
    seconds = time.process_time() - began
    both = (seen.fate == clacad.Fate.ALIVE) & (exact.fate == clacad.Fate.ALIVE)
    return float(np.sqrt((angle_between(seen.direction[both], exact.direction[both]) ** 2).mean())), seconds


# %%
rungs = [("law", {}), ("thin", {}), ("surfaces", {})]
rungs += [("mesh", {"mesh": q, "normals": n}) for n in ("facet", "vertex") for q in (8, 16, 32)]
errors = {}
for rung, more in rungs:
    errors[rung, *more.values()], seconds = error_and_seconds(rung, **more)
    print(f"{rung:9} {str(more):42} {1e3 * errors[rung, *more.values()]:9.4f} mrad  {1e3 * seconds:6.1f} ms")

# %% [markdown]
# Facets err in the first order of their size, exact normals at their corners in the second: twice as many quads a cell
# side halve the one error and quarter the other.

# %%
facet = errors["mesh", 16, "facet"] / errors["mesh", 32, "facet"]
vertex = errors["mesh", 16, "vertex"] / errors["mesh", 32, "vertex"]
print(f"from 16 to 32 quads: facets {facet:.2f} times better, vertex normals {vertex:.2f} times")
assert 1.7 < facet < 2.3
assert 3.3 < vertex < 4.7

# %% [markdown]
# Rays are not the last word: a lenslet of half a millimetre spreads green light by λ/w = 1.1 mrad whatever its faces do.
# Exactness beyond that buys confidence, not sharpness.

# %%
found = clacad.wave(design)
print(f"half of the light in {1e3 * found.rays.half_energy[0]:.3f} mrad as rays, in "
      f"{1e3 * found.far_field.marginals[0].half_energy:.3f} mrad as waves")  # fmt: skip
assert found.far_field.marginals[0].half_energy > 3.0 * found.rays.half_energy[0]
