"""Random rays through random designs: how many rows break a promise. None may.

    python tests/benchmarks/soak.py 1e8 --write --jobs 16   a hundred million rays, recorded in tests/hard/soak.json
    python tests/benchmarks/soak.py 1e5 --seed 7            a short one, printed only

The rays are drawn in parts of two million, each from its own stream of random numbers: the record is the same for
any number of jobs (processes). It is written after every part, so a run that is stopped still records how far it came.

Promises: every launched ray ends in exactly one fate; no row but INVALID holds a NaN or an infinity; directions of
light that goes on have length 1 and d_z > 0; the order of an ALIVE ray is (0, 0), that of a GHOST is not; what was
INVALID when launched is INVALID, and nothing else is.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import numpy as np

from clacad import Design, DesignError, Rays, prescribe, trace
from clacad.optics.rays import Fate

PAGE = Path(__file__).parents[1] / "hard" / "soak.json"
BATCH = 250_000
PART = 2_000_000
RUNGS = (("surfaces", 0.8), ("thin", 0.1), ("law", 0.1))


def design(rng):
    """Anything the design file allows, within reason and a little beyond."""
    form = str(rng.choice(["biconvex", "biconvex", "plano", "slab"]))
    ratio = 10 ** rng.uniform(0.6, 2.5)
    pitch = 10 ** rng.uniform(-4, 1)
    seam = float(rng.choice([0.0, 0.0, 0.1])) * pitch
    data = {
        "format": 1, "name": "soak", "unit": str(rng.choice(["mm", "m"])),
        "law": {
            "eta": [float(rng.choice([-1, -1, 1]) * 10 ** rng.uniform(-1, 1)) for _ in range(2)],
            "delta": [float(v) for v in rng.normal(0, 0.05, 2) * rng.integers(0, 2)],
            "euler": [float(rng.uniform(-180, 180)), float(rng.choice([0, 0, 0.5, 3, 20]) * rng.normal()), float(rng.uniform(-180, 180))],
        },
        "pair": {"form": form, "separation": pitch * ratio, "index": float(rng.uniform(1.05, 2.5))},
        "lattice": {"kind": str(rng.choice(["square", "hexagonal"])), "pitch": pitch,
                    "count": [int(v) for v in 10 ** rng.uniform(0, rng.choice([1, 4]), 2)]},
    }  # fmt: skip
    if form != "slab" and rng.random() < 0.5:
        data["pair"]["thickness"] = pitch * 10 ** rng.uniform(-1.5, 0.3)
    if form == "slab" or rng.random() < 0.2:
        data["pair"]["surface"] = str(rng.choice(["ellipsoid", "biconic"]))
    if seam and form == "biconvex":
        data["lattice"]["seam"] = seam
    return data


def light(rng, window, count):
    """Rays from near and far, steep and grazing, some of them no rays at all."""
    x0, x1, y0, y1 = window.lattice.extent()
    low, high = window.z_range
    size = max(high - low, window.lattice.circumradius)
    aim = np.column_stack(
        [rng.uniform(x0, x1, count), rng.uniform(y0, y1, count), rng.uniform(low, high, count)]
    )
    aim[rng.random(count) < 0.8, 2] = low  # most of them onto lens 1
    edge = rng.random(count) < 0.1  # onto borders and corners exactly
    cells = window.lattice.centres(rng.integers(0, window.lattice.count, (count, 2)))
    corners = window.lattice.tile()[rng.integers(0, len(window.lattice.tile()), count)]
    aim[edge, :2] = (cells + corners * rng.choice([0.0, 0.5, 1.0], (count, 1)))[edge]
    spread = 10 ** rng.uniform(-4, rng.choice([-1, 0.3]))
    ray = np.column_stack([rng.normal(0, spread, (count, 2)), np.ones(count)])
    axial = rng.random(count) < 0.05
    ray[axial, :2] = 0.0
    wild = rng.random(count) < 0.02
    ray[wild] = rng.normal(0, 1, (int(wild.sum()), 3)) * 10.0 ** rng.uniform(-8, 0, (int(wild.sum()), 3))
    away = size * 10 ** rng.uniform(-2, rng.choice([1, 6]), (count, 1))
    start = aim - away * ray
    ray *= 10.0 ** rng.choice([0, 0, 0, 200, -200], (count, 1))
    bad = rng.random(count) < 1e-3
    start[bad, rng.integers(0, 3)] = rng.choice([np.nan, np.inf, -np.inf])
    none = rng.random(count) < 1e-3
    ray[none] = 0.0
    invalid = ~(np.isfinite(start).all(axis=1) & np.isfinite(ray).all(axis=1) & (ray != 0).any(axis=1))
    return Rays(start, ray), invalid


def broken(result, invalid, count):
    """Promises a result breaks, with how many rows."""
    found = Counter()
    goes_on = np.isin(result.fate, (Fate.ALIVE, Fate.GHOST, Fate.LAND))
    valid = result.fate != Fate.INVALID
    found["fates do not add up"] += abs(sum(result.counts().values()) - count)
    found["wrong INVALID"] += int((valid == invalid).sum())
    for name in ("position", "direction", "optical_path", "flux"):
        column = np.asarray(getattr(result, name)).reshape(count, -1)
        found[f"{name} not finite"] += int((~np.isfinite(column[valid]).all(axis=1)).sum())
    length = np.sqrt((result.direction[goes_on] ** 2).sum(axis=1))
    found["direction not of length 1"] += int((np.abs(length - 1) > 1e-12).sum())
    found["goes on backwards"] += int((~(result.direction[goes_on, 2] > 0)).sum())
    order = (result.order != 0).any(axis=1)
    found["ALIVE of another order"] += int((order & (result.fate == Fate.ALIVE)).sum())
    found["GHOST of order 0"] += int((~order & (result.fate == Fate.GHOST)).sum())
    return +found


def soak(total, seed, part=0, path="numba"):
    """Send one part's rays; return what was used and met, and examples of what broke."""
    rng = np.random.default_rng([seed, part])
    fates, wrong, used, sent = Counter(), Counter(), Counter(), 0
    examples = []
    while sent < total:
        data = design(rng)
        try:
            window = prescribe(Design.from_dict(data))
        except DesignError:
            used["refused"] += 1
            continue
        used["designs"] += 1
        rung = str(rng.choice([name for name, _ in RUNGS], p=[share for _, share in RUNGS]))
        count = int(min(BATCH if rung == "surfaces" else BATCH // 5, math.ceil(total - sent)))
        rays, invalid = light(rng, window, count)
        result = trace(window, rays, rung=rung, path=path if rung == "surfaces" else None)
        found = broken(result, invalid, count)
        if rung == "law":  # the homogeneous sheet has no cells
            found.pop("GHOST of order 0", None), found.pop("ALIVE of another order", None)
        if found:
            examples.append({"part": part, "design": data, "rung": rung, "broken": dict(found)})
        wrong += found
        fates += Counter({k: v for k, v in result.counts().items() if v})
        used[f"rays on rung {rung}"] += count
        sent += count
    return sent, used, fates, wrong, examples


def sizes(total):
    """How many rays each part sends."""
    total = math.ceil(total)
    return [min(PART, total - start) for start in range(0, total, PART)]


def record(seed, parts):
    """The page's text for the parts done."""
    used, fates, wrong = Counter(), Counter(), Counter()
    for _, part_used, part_fates, part_wrong, _ in parts:
        used, fates, wrong = used + part_used, fates + part_fates, wrong + part_wrong
    page = {
        "rays": sum(part[0] for part in parts),
        "parts": len(parts),
        "designs": used.pop("designs", 0),
        "refused": used.pop("refused", 0),
        "seed": seed,
        **dict(sorted(used.items())),
        "fates": dict(sorted(fates.items())),
        "broken": dict(wrong),
    }
    return page, json.dumps(page, indent=1) + "\n"


def main():
    """Parse, run, print, record."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("rays", type=float)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    begun, done = time.monotonic(), []

    def finished(part):
        done.append(part)
        page, text = record(given.seed, done)
        print(
            f"{page['rays']:.3g} rays, {page['designs']} designs, {time.monotonic() - begun:.0f} s, "
            f"broken {page['broken']}",
            flush=True,
        )
        for example in part[-1][:5]:
            print(json.dumps(example), flush=True)
        if given.write:  # what was done stays known if the run is stopped
            PAGE.write_text(text, encoding="utf-8")

    rays = sizes(given.rays)
    if given.jobs == 1:
        for number, count in enumerate(rays):
            finished(soak(count, given.seed, number))
    else:
        soak(1000, given.seed)  # compiled once, into the cache that the processes read
        os.environ["NUMBA_NUM_THREADS"] = "1"
        with ProcessPoolExecutor(given.jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
            waiting = [pool.submit(soak, count, given.seed, number) for number, count in enumerate(rays)]
            for part in as_completed(waiting):
                finished(part.result())
    page, text = record(given.seed, done)
    print(text)
    return int(bool(page["broken"]))


if __name__ == "__main__":
    raise SystemExit(main())
