"""No file that must not be made passes, and none that may be made fails: the mutation bench.

A tenth of the cases, the same every time, runs by default; all of them with -m long.
"""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from filesonly import only_files
from trust.bench.cases import MESHES, Case, Kits, every_case, judged

SOLID = ("step", "brep")
CHEAP = [
    c for c in every_case()
    if c.kit == "slab" and (c.name.endswith("forged") or not any(word in c.name for word in SOLID))
]  # fmt: skip
"""One design to export, and no solid but by its text: the tenth takes half a minute of a processor."""
TENTH = {id(c) for c in random.Random(9).sample(CHEAP, len(every_case()) // 10)}


@pytest.fixture(autouse=True)
def _only_files(monkeypatch: pytest.MonkeyPatch) -> None:
    only_files(monkeypatch)


@pytest.fixture(scope="session")
def kits(tmp_path_factory: pytest.TempPathFactory) -> Kits:
    """The designs of the bench and their exports."""
    return Kits(tmp_path_factory.mktemp("bench"))


@pytest.mark.ci_cases(
    "copy: slab stl forged",
    "coarse, declared when handed in: stl",
    "one facet missing: slab glb forged",
    "one facet turned: slab 3mf forged",
    "mirrored: slab stl alone",
    "radius of a corner lens 5 % off: slab ply forged",
    "a lens left out: slab 3mf forged",
    "grown by .2 %: slab 3mf",
    "25.4 times as large: slab stl forged",
    "manifest states large errors: mirrored stl",
    "closed, inside out, declared a scan: slab stl",
    "open, a master by its manifest: slab stl",
)
@pytest.mark.daily_cases(
    'manifest says bodies ["x"]: damaged stl',
    "manifest says no bodies: coarse stl",
    "coarse, declared in its manifest: slab glb",
    'manifest says format "coupon": damaged stl',
    "bytes changed after the manifest: ply",
    'manifest says role "other": coarse stl',
    "manifest lists an empty entry",
)
@pytest.mark.parametrize("case", [
    pytest.param(case, id=case.name, marks=() if id(case) in TENTH else pytest.mark.long) for case in every_case()
])  # fmt: skip
def test_the_verdict_is_the_one_that_is_optically_right(kits: Kits, tmp_path: Path, case: Case) -> None:
    outcome = judged(case, kits, tmp_path / "case")
    assert outcome.kind == "right", outcome


def test_the_bench_holds_every_format_handed_in_every_way() -> None:
    names = [case.name for case in every_case()]
    assert len(names) == len(set(names)) >= 150
    for format in (*MESHES, "step", "brep"):
        for how in ("alone", "forged"):
            assert any(format in name and name.endswith(how) for name in names), (format, how)
