"""A mesh is called an optical master where light through its triangles keeps the limits, and nowhere else."""

from __future__ import annotations

from pathlib import Path

import pytest
from filesonly import only_files
from trust.bench import meshes, readers, sheets, tracer

from clacad.exporting.run import export
from clacad.prescription.prescribe import prescribe
from clacad.verification import verify

DAILY = {("galilean", 8), ("galilean", 32), ("tilted", 16), ("tilted", 32), ("biconvex, hexagonal", 8), ("biconvex, hexagonal", 32)}  # fmt: skip
PAIRS = [
    pytest.param(name, quads, marks=() if (name, quads) in DAILY else pytest.mark.long)
    for name in sheets.EVERY
    for quads in meshes.QUADS
]


@pytest.fixture(autouse=True)
def _only_files(monkeypatch: pytest.MonkeyPatch) -> None:
    only_files(monkeypatch)


@pytest.mark.ci_cases("tilted-32", "galilean-8", "biconvex, hexagonal-32")
@pytest.mark.slow
@pytest.mark.parametrize(("name", "quads"), PAIRS)
def test_a_mesh_is_a_master_where_light_through_its_triangles_keeps_the_limits(
    tmp_path: Path, name: str, quads: int
) -> None:
    row = meshes.judged(sheets.sheet(name), quads, tmp_path / "made")
    assert row.agrees, row
    assert row.stated == pytest.approx(row.rms, rel=0.06)  # of two samples of rays


@pytest.mark.slow
@pytest.mark.parametrize("name", [
    pytest.param(n, marks=() if n in ("tilted", "biconvex, hexagonal") else pytest.mark.long) for n in sheets.EVERY
])  # fmt: skip
def test_a_step_file_of_a_design_that_passes_is_a_master(tmp_path: Path, name: str) -> None:
    design = sheets.sheet(name)
    assert tracer.measure_exact(tracer.optics(design, prescribe(design))).fit_for_making
    made = export(design, tmp_path / "made", formats=("step",))
    (tmp_path / "made" / "manifest.json").unlink()
    report = verify(design, made.path("step"), rays=4096)
    assert (report.word, report.exit_status) == ("passed as optical master", 0), report.verdict()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "quads", "expected"), [("paper-a-covered", 8, 27.3), ("slab", 8, 14.0), ("window-100mm", 8, 7.2)]
)
def test_the_bench_s_own_tracer_finds_what_was_measured_before_it(
    tmp_path: Path, name: str, quads: int, expected: float
) -> None:
    """The rms to the law, mrad, by another tracer, of another day."""
    design = sheets.sheet(name)
    made = export(design, tmp_path / "made", formats=("stl",), quads=quads).path("stl-binary")
    optic = tracer.optics(design, prescribe(design))
    found = tracer.measure(optic, readers.triangles(made.name, made.read_bytes()))
    assert 1e3 * found.rms == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tilted", "biconvex, hexagonal"])
def test_the_bench_s_own_triangles_grow_into_its_own_faces(tmp_path: Path, name: str) -> None:
    """Facets' slopes stray in inverse proportion to their number; what is left is the exact surfaces' own error."""
    design = sheets.sheet(name)
    optic = tracer.optics(design, prescribe(design))
    exact = tracer.measure_exact(optic).rms
    strays = []
    for quads in (8, 32):
        made = export(design, tmp_path / str(quads), formats=("stl",), quads=quads).path("stl-binary")
        found = tracer.measure(optic, readers.triangles(made.name, made.read_bytes()))
        strays.append((found.rms**2 - exact**2) ** 0.5)
    assert strays[0] / strays[1] == pytest.approx(4.0, rel=0.05)
