# %% [markdown]
# # Tolerances, on this machine or on a cluster
#
# Which fabrication error costs most, and how many sheets will pass? Every sheet is traced as it would be made. Sample k
# depends on the seed and on k alone, so that one process, four, or a cluster give the same numbers.

# %%
import clacad
from clacad.verification.tolerance import Farm, tolerance

design = clacad.Design.from_dict({
    "format": 1, "name": "study", "unit": "mm",
    "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 10, "material": "PMMA"},
    "lattice": {"pitch": 0.5, "count": [20, 20]},
    "tolerances": {"decentre": "4 um", "rotation": "0.2 mrad", "radius": 0.01, "thickness": "30 um", "image_shift": "1 mrad"},
})  # fmt: skip
SAMPLES = 32


# %%
def study(farm: Farm):
    """The same sheets on any workers."""
    return tolerance(design, SAMPLES, seed=1, rays=128, farm=farm)


if __name__ == "__main__":  # processes that are started read this file again
    alone = study(Farm(workers=1))
    for measure in ("image_shift", "blur"):
        name, change, part = alone.ranking(measure)[0]
        print(f"{measure}: {name} weighs most, {part:.0%} of the variance")
    part, low, high = alone.yields()
    print(f"good sheets: {part:.0%} ({low:.0%} to {high:.0%})")

# %% [markdown]
# `Farm(scheduler="tcp://host:8786")` sends the work to a Dask cluster (extra: clacad[dask]). Here one of two workers is
# started on this machine.

# %%
if __name__ == "__main__":
    try:
        from distributed import LocalCluster
    except ImportError:
        print("no cluster: pip install 'clacad[dask]'")
        there = study(Farm(workers=2))
    else:
        with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
            there = study(Farm(scheduler=cluster.scheduler_address))
    same = bool((there.column("image_shift") == alone.column("image_shift")).all())
    print("the same numbers, bit for bit:", same)
    assert same
