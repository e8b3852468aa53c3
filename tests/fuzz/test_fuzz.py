"""Readers of files from elsewhere: any bytes give a result or an error message, and never anything else.

The corpus in tests/fuzz/corpus is replayed always. A minute of mutations of it for each kind is a long test, which
continuous integration runs: the rounds come in the same order everywhere, a slow machine does fewer of them.

    CLACAD_FUZZ_SEED=new CLACAD_FUZZ_SECONDS=3600 pytest -m long tests/fuzz/test_fuzz.py      an hour of rounds never seen before
"""

from __future__ import annotations

import os
import resource
import time
from pathlib import Path

import pytest
from fuzz.bytes_of import CORPUS, SUFFIX, corpus, mutated, mutations, read, repacked
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from noworker import without_worker

KINDS = list(SUFFIX)
SECONDS = float(os.environ.get("CLACAD_FUZZ_SECONDS", "60"))
FIRST = os.environ.get("CLACAD_FUZZ_SEED", "0")
KEPT = [(kind, path) for kind in KINDS for path in corpus(kind)]
QUIET = settings(
    deadline=None,
    database=None,
    suppress_health_check=list(HealthCheck),
    phases=[Phase.generate, Phase.shrink],
)


@pytest.fixture(autouse=True)
def _no_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    without_worker(monkeypatch)


@pytest.mark.timeout(60)
@pytest.mark.parametrize(("kind", "path"), KEPT, ids=[f"{kind}-{path.stem}" for kind, path in KEPT])
def test_every_kept_input_is_read_or_refused(kind: str, path: Path, tmp_path: Path) -> None:
    assert read(kind, path.read_bytes(), tmp_path)


@pytest.mark.parametrize("kind", KINDS)
def test_the_corpus_holds_good_files_and_bad_ones(kind: str, tmp_path: Path) -> None:
    verdicts = {read(kind, path.read_bytes(), tmp_path) for path in corpus(kind)}
    assert "read" in verdicts
    assert len(verdicts) >= 4
    assert sum(path.stat().st_size for path in (CORPUS / kind).iterdir()) < 200_000


def attack(kind: str, folder: Path, examples: int, number: int) -> None:
    """One round of mutations, shrunk to the smallest input if something is wrong."""
    pool = [path.read_bytes() for path in corpus(kind)]

    @seed(number)
    @settings(QUIET, max_examples=examples)
    @given(st.sampled_from(pool), st.sampled_from(pool), mutations, st.booleans())
    def round_of(data: bytes, other: bytes, recipe: list, inside: bool) -> None:
        mutant = repacked(data, recipe) if inside and kind == "3mf" else None
        assert read(kind, mutant or mutated(data, recipe, other), folder)

    round_of()


@pytest.mark.parametrize("kind", KINDS)
def test_a_few_mutations_are_read_or_refused(kind: str, tmp_path: Path) -> None:
    attack(kind, tmp_path, 25, 0)


@pytest.mark.long
@pytest.mark.timeout(SECONDS + 120)
@pytest.mark.parametrize("kind", ["design", "stl", "3mf", "ply"])
def test_a_minute_of_mutations_is_read_or_refused(kind: str, tmp_path: Path) -> None:
    begun = time.monotonic()
    number = time.time_ns() % 10**6 if FIRST == "new" else int(FIRST)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    while time.monotonic() - begun < SECONDS:
        number += 1
        attack(kind, tmp_path, 200, number)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < 500_000, f"memory grew by {grown} kB on inputs of 20 kB"
