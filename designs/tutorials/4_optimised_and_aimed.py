# %% [markdown]
# # Better faces, and cells that look somewhere
#
# The radii that make a pair confocal are not those that keep closest to the law over a field. `optimise` searches for
# better ones within the walls of the process, and writes an ordinary design with given faces.

# %%
import clacad
from clacad.design.shipped_folder import shipped_designs

design = clacad.load(shipped_designs() / "window-100mm.toml")
better = clacad.optimise(design, ("radii", "conic"))
before, after = better.before[1], better.after[1]  # at half, once and twice the field
print(f"{1e3 * before.law_rms:.4f} -> {1e3 * after.law_rms:.4f} mrad rms with {better.unknowns} unknowns")
assert after.law_rms < 0.2 * before.law_rms
print(better.design.pair.face)

# %% [markdown]
# Waves see the gain only where it is more than λ/w.

# %%
for one in (design, better.design):
    found = clacad.wave(one)
    print(
        f"Strehl ratio {found.exact.strehl:.4f}, half of the light in {1e3 * found.exact.marginals[0].half_energy:.4f} mrad"
    )

# %% [markdown]
# Cells need not look straight ahead. `aperture` moves the cells of array 2, not their lenses: light of that slope then
# meets its partner in full, and the law is the same.

# %%
slope = 0.03
aimed = design.replace("lattice.aperture", [slope, 0.0])
straight_share, aimed_share = (
    float((clacad.trace(clacad.prescribe(one), rays).fate == clacad.Fate.ALIVE).mean())
    for one in (design, aimed)
    for rays in [clacad.Rays([[0.5 * k / 64 - 0.25, 0.1, -5.0] for k in range(64)], [slope, 0.0, 1.0])]
)
print(
    f"of light of slope {slope}: {straight_share:.2f} to the partner, {aimed_share:.2f} once cells look there"
)
assert aimed_share > straight_share + 0.3
aimed
