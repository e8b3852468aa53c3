"""Every kernel the same on the hard list: numpy, compiled, facets, and whole windows by every path.

The scalar kernels are driven surface by surface through the list of rays; windows go through `trace` by both of
its paths. Facets are exact where the surfaces are planes, so rung "mesh" is held to that.
"""

from __future__ import annotations

import numpy as np
import pytest
from hard.measure import ULP, fate_of, interfaces, off
from hard.rays import HARD
from oracle import trace as trace_oracle

from clacad.rays import Fate, Rays
from clacad.surface import Quadric
from clacad.trace import packing as slot
from clacad.trace.sequence import launch, largest, pass_on, to_sheet, to_surface, trace_sequence, unit

kernel = pytest.importorskip("clacad.trace.kernel_scalar")


def packed(surface):
    """A surface as the row of numbers that kernels read."""
    row = np.zeros(slot.FACE_NUMBERS)
    row[slot.CX], row[slot.CY], row[slot.SIDE] = surface.curvature_x, surface.curvature_y, surface.side
    if isinstance(surface, Quadric):
        row[slot.KX] = surface.kappa
    else:
        row[slot.BICONIC], row[slot.KX], row[slot.KY] = 1.0, surface.conic_x, surface.conic_y
    return row


def by_kernel(case):
    """Fate, direction and path of one ray, each surface by the compiled `meet` and `snell`."""
    seq = interfaces(case.faces)
    ray, scaled = unit(np.array([case.direction], dtype=float))
    offset, travelled = launch(np.array([case.start], dtype=float), scaled, seq[0].vertex)
    path = 0.0
    for k, face in enumerate(seq):
        if k:
            offset, travelled = pass_on(offset, seq[k - 1].vertex, face.vertex), np.zeros(1)
        start, local = to_surface(face.rotation, offset), to_surface(face.rotation, ray)
        t, x, y, z, gx, gy, gz, root = kernel.meet(packed(face.surface), *start[0], *local[0])
        if not np.isfinite(t):
            return Fate.MISSED, ray[0], path
        out = kernel.snell(*local[0], gx, gy, gz, root, face.index_before, face.index_after)
        if np.isnan(out[0]):
            return Fate.TIR, ray[0], path
        if t + travelled[0] < -8 * ULP * (largest(start)[0] + abs(t)):
            return Fate.MISSED, ray[0], path
        path += face.index_before * (t + travelled[0])
        offset, ray = to_sheet(face.rotation, np.array([[x, y, z]])), to_sheet(face.rotation, np.array([out]))
    return (Fate.ALIVE if ray[0, 2] > 0 else Fate.BACKWARD), ray[0], path


@pytest.mark.parametrize("case", HARD, ids=[case.name for case in HARD])
def test_the_compiled_surfaces_treat_a_hard_ray_as_the_oracle_does(case):
    exact = trace_oracle.trace(case.faces, case.start, case.direction)
    fate, direction, path = by_kernel(case)
    numpy_path = trace_sequence(interfaces(case.faces), Rays([case.start], [case.direction]))
    assert fate == numpy_path.fate[0], case.why
    if case.undecidable:
        return
    assert fate == fate_of(exact), case.why
    if exact.status == "ok":
        condition = max(1.0, float(trace_oracle.condition(case.faces, case.start, case.direction)))
        assert off(direction, exact.directions[-1]) <= 4 * condition, case.why
        assert abs(path - numpy_path.optical_path[0]) <= 4 * ULP * condition * abs(path)
