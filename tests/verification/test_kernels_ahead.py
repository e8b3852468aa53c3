"""Kernels to be compiled are forecast by the very types that kernels are called with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clacad import Tracer, tessellate
from clacad.base import kernel_cache
from clacad.cli.console import Console
from clacad.design import load
from clacad.optics.rays import Rays
from clacad.prescription.prescribe import prescribe
from clacad.tracing.compiled import chunk as surfaces
from clacad.tracing.which_path import COMPILING
from clacad.verification.accuracy.accuracy_table import OF_TABLE, climb, compiling_seconds

DESIGNS = Path(__file__).parents[2] / "designs"


def test_nothing_is_compiled_where_all_is_kept_and_all_where_nothing_is(monkeypatch, capsys):
    window = prescribe(load(DESIGNS / "slab.toml"))
    homes = ("clacad.base.kernel_cache", "clacad.tracing.compiled.chunk")
    for home in homes:
        monkeypatch.setattr(f"{home}.is_kept", lambda *_: False)
    assert compiling_seconds(window, OF_TABLE) == sum(COMPILING.values())
    assert compiling_seconds(window, ("mesh",)) == COMPILING["mesh"]
    for home in homes:
        monkeypatch.setattr(f"{home}.is_kept", lambda *_: True)
    assert compiling_seconds(window, OF_TABLE) == 0.0
    Console().announce_compiling("some", 0.0)
    assert capsys.readouterr().err == ""
    Console().announce_compiling("some", 40.0)
    assert "once on this machine" in capsys.readouterr().err


def test_the_ladder_of_a_report_compiles_nothing(monkeypatch):
    def asked(*_):
        raise AssertionError("a kernel was asked for")

    for kernel in ("trace_chunk", "straight_chunk_single", "trace_chunk_of_triangles"):
        monkeypatch.setattr(surfaces, kernel, asked)
    design = load(DESIGNS / "window-100mm.toml")
    ladder = climb(design, prescribe(design), lambda *_: None)
    assert [row.rung for row in ladder.rows] == ["law", "thin", "surfaces", *["mesh"] * 8]
    facets = [row.model_rms for row in ladder.rows if row.normals == "facet"]
    assert all(1.7 < coarse / fine < 2.3 for coarse, fine in zip(facets, facets[1:]))  # first order


@pytest.mark.parametrize("name", ["slab", "hexagonal", "plano"])
def test_the_kernel_of_meshes_is_asked_for_by_the_types_that_it_is_called_with(name, monkeypatch):
    window = prescribe(load(DESIGNS / f"{name}.toml")).with_cells((3, 3))
    asked, called = [], []
    monkeypatch.setattr(kernel_cache, "is_kept", lambda _, arguments: asked.append(arguments) or True)
    assert compiling_seconds(window, ("mesh",)) == 0.0
    monkeypatch.setattr(surfaces, "trace_chunk", lambda *arguments: called.append(arguments))
    rays = Rays(np.array([[0.0, 0.0, -100.0]]), np.array([[0.0, 0.0, 1.0]]))
    Tracer(window, "mesh", mesh=tessellate(window, quads=4), threads=1)(rays)
    (one,), (other,) = asked, called
    assert [kernel_cache.numba.typeof(a) for a in one] == [kernel_cache.numba.typeof(a) for a in other]
