# %% [markdown]
# # Make it fabricable
#
# A sheet that obeys its law may still fall into pieces, need radii that no tool cuts, or pass little light. Checks
# find this, and `fix` finds the fewest keys that mend it.

# %%
import clacad

wanted = clacad.Design.from_dict({
    "format": 1, "name": "wanted", "unit": "mm",
    "law": {"eta": [-0.5, -0.5]},
    "pair": {"form": "biconvex", "separation": 6, "thickness": 0.02, "material": "PMMA"},
    "lattice": {"pitch": 0.5, "count": [40, 40]},
    "check": {"process": "moulding"},
})  # fmt: skip
advice = clacad.advise(wanted)
for check, hints in advice.hints:
    print(f"{check.subject or 'sheet'}, {check.id}: {check.sentence}")
    for hint in hints[:1]:
        print(f"    {hint}")

# %% [markdown]
# What failed, and which key would mend it at which value; each value was tried before it is printed. `fix` changes
# as few keys as it can and keeps law, material and limits.

# %%
fixed = clacad.fix(wanted)
print(fixed)
print(fixed.changes)
assert fixed.passes

# %% [markdown]
# The other direction: state what the sheet is for and get a design that passes, with the reasons for its numbers.

# %%
proposal = clacad.design_for({"eta": -1, "width": "60 mm", "process": "moulding", "material": "PC"})
print(proposal.text)
for reason in proposal.reasons:
    print("*", reason)

# %% [markdown]
# Light is lost to neighbours off the middle of the field, and to diffraction everywhere: .164/√N along an axis.
# `wave` looks at one telescopelet as a wave.

# %%
found = clacad.wave(proposal.design)
print(
    f"share to the partner: rays {found.rays.share:.3f}, waves {found.share:.3f}; Strehl ratio {found.far_field.strehl:.3f}"
)
assert found.share < found.rays.share
proposal.design
