"""Grow the corpus: keep mutants that make a reader run lines in an order never seen before.

    python tests/fuzz/grow.py design 120      two minutes on the design reader; also stl, 3mf, ply, glb, obj

Run by hand; what it keeps is small and goes into tests/fuzz/corpus, which the tests replay and mutate further.
"""

from __future__ import annotations

import hashlib
import random
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT)]

from fuzz.bytes_of import CORPUS, NUMBERS, SUFFIX, WORDS, corpus, mutated, read, repacked  # noqa: E402

KEPT = 40
"""Most inputs kept for each kind."""


def recipe(rng):
    """A few random mutation steps."""
    extra = {
        "flip": lambda: rng.randrange(8), "set": lambda: rng.randrange(256), "insert": lambda: rng.randbytes(rng.randrange(6)),
        "word": lambda: rng.choice(WORDS), "number": lambda: rng.choice(NUMBERS), "delete": lambda: rng.randrange(1, 60),
        "repeat": lambda: rng.randrange(1, 60), "cut": lambda: 0, "int32": lambda: rng.choice([0, 1, -1, 2**31 - 1, -(2**31)]),
        "line": rng.random, "splice": rng.random,
    }  # fmt: skip
    names = [rng.choice(list(extra)) for _ in range(rng.randrange(1, 5))]
    return [(name, rng.random(), extra[name]()) for name in names]


def steps_of(kind, data, folder):
    """Pairs of lines of clacad run one after the other while reading."""
    seen, last = set(), {}
    package = str(ROOT / "clacad")

    def trace(frame, event, _):
        name = frame.f_code.co_filename
        if not name.startswith(package):
            return None
        seen.add((name, last.get(name), frame.f_lineno))
        last[name] = frame.f_lineno
        return trace

    sys.settrace(trace)
    try:
        read(kind, data, folder)
    finally:
        sys.settrace(None)
    return seen


def grow(kind, seconds):
    """Mutate for the given number of seconds and keep what is new."""
    rng, known = random.Random(time.time_ns()), set()
    pool = [path.read_bytes() for path in corpus(kind)]
    with tempfile.TemporaryDirectory() as folder:
        for data in pool:
            known |= steps_of(kind, data, folder)
        begun, tried, kept = time.monotonic(), 0, 0
        while time.monotonic() - begun < seconds:
            data, steps = rng.choice(pool), recipe(rng)
            inside = repacked(data, steps) if kind == "3mf" and rng.random() < 0.7 else None
            mutant = inside or mutated(data, steps, rng.choice(pool))
            tried += 1
            try:
                found = steps_of(kind, mutant, folder)
            except Exception as error:
                found = {
                    ("crash", type(error).__name__, "".join(c for c in str(error) if not c.isdigit())[:30])
                }
                if not found <= known:
                    print(f"CRASH {type(error).__name__}: {error}")
            if found <= known:
                continue
            known |= found
            pool.append(mutant)
            if len(corpus(kind)) < KEPT:
                name = hashlib.sha256(mutant).hexdigest()[:12]
                (CORPUS / kind / f"{name}{SUFFIX[kind]}").write_bytes(mutant)
                kept += 1
        print(f"{kind}: {tried} tried, {kept} kept, {len(known)} steps known")


if __name__ == "__main__":
    grow(sys.argv[1], float(sys.argv[2]))
