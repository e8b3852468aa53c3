"""Errors by source: one source is switched on at a time, and the others are seen to be nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clacad.design import Design
from clacad.judging.cell_triangles import CellFacets, Gatherer, onto_face, owner
from clacad.mesh import tessellate
from clacad.optics.law import angle_between
from clacad.optics.rays import Fate
from clacad.optics.surface import Quadric
from clacad.prescription.prescribe import prescribe
from clacad.sheet.bundle import bundle
from clacad.tracing.trace import trace
from clacad.verification.light.error_attribution import (
    NAMES,
    FacetTraces,
    as_it_would_be_written,
    as_written,
    attribute,
)

ULP = 2.0**-52
NOTHING = 8 * ULP
"""A few roundings of a direction."""

SLAB = {
    "format": 1, "name": "apart", "unit": "mm", "law": {"eta": [-0.5, -1.0], "delta": [0.02, 0.0]},
    "pair": {"form": "slab", "separation": 10.0, "index": 1.5}, "lattice": {"pitch": 0.5, "count": 8},
    "check": {"field": "1 deg"},
}  # fmt: skip


def made(**pair):
    design = Design.from_dict({**SLAB, "pair": {**SLAB["pair"], **pair}})
    return design, prescribe(design)


def exact(window):
    """No triangles at all: the surfaces themselves on both last rungs."""
    return FacetTraces("surfaces", (4, 4), lambda rays: trace(window, rays), lambda rays: trace(window, rays))


def sizes(found):
    return {part.name: part.rms for part in found.parts}


@pytest.fixture(scope="module")
def slab():
    return made()


@pytest.fixture(scope="module")
def whole(slab):
    return attribute(*slab, as_it_would_be_written(slab[1]))


def test_the_five_parts_of_every_ray_add_up_to_its_error(whole):
    assert tuple(part.name for part in whole.parts) == NAMES
    added = sum(part.vector for part in whole.parts)
    assert np.abs(added - whole.whole).max() < NOTHING
    assert abs(sum(part.share for part in whole.parts) - whole.rms) < NOTHING
    assert all(part.rms > 0.0 for part in whole.parts)


@pytest.mark.slow
def test_the_whole_is_the_angle_to_the_law_that_the_checks_measure(slab):
    """Without triangles the whole must equal that of a plain trace and the law, ray by ray."""
    design, window = slab
    found = attribute(design, window, exact(window), rays=4096)
    lit = bundle(window, 4096, design.check.field)
    result = trace(window, lit.rays)
    alive = result.fate == Fate.ALIVE
    angle = angle_between(result.direction[alive], window.law.refract(lit.rays.direction[alive]))
    assert found.rms == pytest.approx(np.sqrt(np.mean(angle**2)), rel=0.02)  # other places within the cell
    assert sizes(found)["tessellation"] == sizes(found)["file precision"] == 0.0


def test_in_the_parabasal_limit_only_rounding_is_left(slab):
    """The recipe is exact there: aperture and field shrink, and design and aberration with them."""
    design, window = slab
    straight = design.replace({"law.delta": [0.0, 0.0]})
    window = prescribe(straight)
    small = sizes(attribute(straight, window, exact(window), aperture=1e-5, angle=1e-7))
    assert 0.0 < small["kernel rounding"] < NOTHING
    assert small["design"] < NOTHING
    assert small["aberration"] < NOTHING


def test_the_design_part_is_what_a_finite_angle_does(slab):
    """A pinhole aperture at a finite field: no aberration; and it grows as the cube of the angle on the axis."""
    design, _ = slab
    straight = design.replace({"law.delta": [0.0, 0.0]})
    window = prescribe(straight)
    found = [
        sizes(attribute(straight, window, exact(window), aperture=1e-7, angle=angle))
        for angle in (0.01, 0.02)
    ]
    assert all(f["aberration"] < 1e-6 * f["design"] for f in found)
    assert np.log2(found[1]["design"] / found[0]["design"]) == pytest.approx(3.0, abs=0.1)


def test_aberration_alone_is_left_where_all_light_is_parallel_to_the_axis(slab):
    """Spherical aberration: one direction along the axis; it grows as the cube of the aperture."""
    design, _ = slab
    straight = design.replace({"law.delta": [0.0, 0.0]})
    window = prescribe(straight)
    found = [sizes(attribute(straight, window, exact(window), aperture=a, angle=0.0)) for a in (0.4, 0.8)]
    assert all(f["design"] < NOTHING for f in found)
    assert np.log2(found[1]["aberration"] / found[0]["aberration"]) == pytest.approx(3.0, abs=0.1)


def stigmatic():
    """Ellipsoids of conic -1/n²: light along the axis comes to a perfect point (Descartes)."""
    return made(surface="biconic")[0].replace({"law.delta": [0.0, 0.0], "law.eta": [-0.63, -0.63]})


def test_perfect_surfaces_leave_neither_design_nor_aberration():
    design = stigmatic()
    window = prescribe(design)
    found = sizes(attribute(design, window, exact(window), angle=0.0))
    assert found["design"] < NOTHING
    assert found["aberration"] < 4 * NOTHING
    assert 0.0 < found["kernel rounding"] < NOTHING


def test_triangles_on_perfect_surfaces_show_tessellation_alone_and_it_halves_with_their_size():
    design = stigmatic()
    window = prescribe(design)
    found = []
    for quads in (8, 16):
        facets = as_it_would_be_written(window, quads)
        ideal = replace(facets, held=facets.exact)
        found.append(sizes(attribute(design, window, ideal, angle=0.0)))
    for one in found:
        assert one["file precision"] == 0.0
        assert max(one["design"], one["aberration"], one["kernel rounding"]) < 1e-9 * one["tessellation"]
    assert found[0]["tessellation"] / found[1]["tessellation"] == pytest.approx(2.0, rel=0.1)


def coarser(window, bits):
    """Triangles of one cell whose corners keep a given number of bits of their coordinates."""
    one = window.with_cells((1, 1))
    held = CellFacets(((0, 0),))
    gatherer = Gatherer(one, [(0, 0)])
    for body in tessellate(one, quads=8).bodies:
        for rows in body.rows():
            gatherer.look(np.asarray(rows, dtype=np.float64))
    size = max(abs(v) for v in window.z_range)
    step = size * 2.0**-bits
    for key, found in gatherer.result.facets.items():
        body = one.bodies[key[0]]
        face = (body.front, body.back)[key[1]]
        place = np.asarray(one.shifts[owner(body, face)])
        smooth = [
            onto_face(one, face, corners, place) for corners in found
        ]  # the mesh rounds its heights itself
        held.facets[key] = [np.rint(corners / step) * step for corners in smooth]
    return as_written(one, held, f"{bits} bits")


@pytest.mark.slow
def test_coarser_numbers_raise_file_precision_alone(slab):
    design, window = slab
    one = window.with_cells((1, 1))
    found = [attribute(design, one, coarser(window, bits)) for bits in (44, 30, 24)]
    fine, middle, rough = (sizes(f) for f in found)
    for name in ("design", "aberration", "kernel rounding"):
        assert middle[name] == pytest.approx(fine[name], rel=1e-3)
    assert middle["tessellation"] == pytest.approx(fine["tessellation"], rel=1e-2)
    halves = [f.part("file precision").half for f in found]
    assert halves[0] < 1e-9
    # half of the rays: those whose facet stays the same, so the error is that of the corners and falls as the bits
    assert np.log2(halves[2] / halves[1]) == pytest.approx(6.0, abs=0.6)
    assert rough["file precision"] > middle["file precision"] > 0.0


def test_kernel_rounding_is_that_of_a_trace_in_mpmath(slab):
    """One telescopelet's ray, traced again in 40 digits from the textbook, without anything of the package."""
    import mpmath as mp

    design, window = slab
    found = attribute(design, window, exact(window), rays=256)
    lit = found.part("kernel rounding").vector
    assert 0.0 < np.linalg.norm(lit, axis=1).max() < NOTHING
    mp.mp.dps = 40
    rays = bundle(window, 64, design.check.field).rays
    result = trace(window, rays)
    worst = 0.0
    for k in np.flatnonzero((result.fate == Fate.ALIVE) & (result.order == 0).all(axis=1))[:8]:
        truth = _traced(mp, window, rays.position[k], rays.direction[k], result.cell[k])
        worst = max(worst, max(abs(float(mp.mpf(float(g)) - t)) for g, t in zip(result.direction[k], truth)))
    assert 0.0 < worst < NOTHING


def _traced(mp, window, position, direction, cell):
    p = [mp.mpf(float(v)) for v in position]
    d = [mp.mpf(float(v)) for v in direction]
    length = mp.sqrt(sum(v * v for v in d))
    d = [v / length for v in d]
    n = mp.mpf(window.bodies[0].index)
    for face, mu in ((window.bodies[0].front, 1 / n), (window.bodies[0].back, n)):
        surface = face.surface
        assert isinstance(surface, Quadric)
        assert face.untilted
        centre = [
            (2 * int(c) - m + 1) * mp.mpf(h) / 2
            for c, m, h in zip(cell, window.lattice.count, window.lattice.pitch)
        ]
        apex = [mp.mpf(v) + mp.mpf(s) + c for v, s, c in zip(face.vertex, window.shifts[face.array], centre)]
        apex.append(mp.mpf(face.vertex[2]))
        q = [a - b for a, b in zip(p, apex)]
        c = [mp.mpf(surface.curvature_x), mp.mpf(surface.curvature_y), mp.mpf(surface.kappa)]
        s = surface.side
        a = sum(k * u * u for k, u in zip(c, d))
        b = sum(k * u * v for k, u, v in zip(c, d, q)) - s * d[2]
        e = sum(k * v * v for k, v in zip(c, q)) - 2 * s * q[2]
        roots = [(-b + w * mp.sqrt(b * b - a * e)) / a for w in (1, -1)]
        t = min(roots, key=lambda r: abs(q[2] + r * d[2]))
        q = [v + t * u for v, u in zip(q, d)]
        p = [u + v for u, v in zip(q, apex)]
        g = [-s * c[0] * q[0], -s * c[1] * q[1], 1 - s * c[2] * q[2]]
        size = mp.sqrt(sum(v * v for v in g))
        g = [v / size for v in g]
        cosine = sum(u * v for u, v in zip(d, g))
        root = mp.sqrt(1 - mu * mu * (1 - cosine * cosine))
        d = [mu * u + (root - mu * cosine) * v for u, v in zip(d, g)]
    return d
