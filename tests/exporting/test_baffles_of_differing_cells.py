"""Baffles between arrays of different pitch: frusta that tile, seen by another library, by the tracer and by verify."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

import clacad
from clacad.exporting.fixtures.baffle import baffle_meshes, between
from clacad.formats.mesh.stl import write_stl
from clacad.judging.delivery import Inspection, Subject
from clacad.judging.without_optics import Reason, judge_other
from clacad.optics.rays import Fate, Rays
from clacad.tracing.layout import lay_out
from clacad.tracing.reference.launch import reach
from clacad.tracing.trace import trace

BASE = {
    "format": 1, "name": "b", "unit": "mm", "law": {"eta": [-1, -1]}, "lattice": {"pitch": 1.0, "count": 8},
    "pair": {"form": "biconvex", "thickness": 0.6, "separation": 10, "index": 1.5},
    "body": {"baffle": True, "baffle_wall": 0.06},
}  # fmt: skip
AIM = {"aperture": {"point": [2, 0, -150]}}
SHEETS = {
    "aimed": AIM,
    "aimed hexagons": AIM | {"kind": "hexagonal"},
    "other pitches": {"kind": "rectangular", "pitch": [1.0, 0.8], "pitch_2": [1.05, 0.79]},
    "turned": {"rotation_2": "2.5 deg"},
    "turned hexagons": {"kind": "hexagonal", "rotation_2": "2.5 deg"},
    "turned, other pitches": {"kind": "rectangular", "pitch": [1.0, 0.8], "pitch_2": [1.03, 0.79], "rotation_2": "1 deg"},
}  # fmt: skip


def built(name, **pair):
    keys = BASE | {"lattice": BASE["lattice"] | SHEETS[name], "pair": BASE["pair"] | pair}
    return clacad.prescribe(clacad.Design.from_dict(keys))


def as_trimesh(baffle):
    corners = np.concatenate(list(baffle.rows()))
    vertices, index = np.unique(np.round(corners.reshape(-1, 3), 10), axis=0, return_inverse=True)
    return trimesh.Trimesh(vertices, index.reshape(-1, 3), process=False)


def light(name, many=400):
    rng = np.random.default_rng(3)
    xy, slope = rng.uniform(-4.0, 4.0, (many, 2)), rng.uniform(-0.06, 0.06, (many, 2))
    if name.startswith("aimed"):
        slope = 0.7 * slope + (xy - [2.0, 0.0]) / 150.0
    return Rays(np.column_stack([xy, np.full(many, -1.0)]), np.column_stack([slope, np.ones(many)]))


@pytest.mark.parametrize("name", SHEETS)
def test_channels_tile_the_gap_with_walls_as_thick_as_stated_at_both_arrays(name):
    window = built(name)
    assert window.lattice_of(0) != window.lattice_of(1)
    (baffle,) = baffle_meshes(window)
    mesh = as_trimesh(baffle)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert len(mesh.faces) == baffle.facet_count
    assert mesh.euler_number == 2 - 2 * 64  # one hole a channel
    assert mesh.volume == pytest.approx(baffle.volume(), rel=1e-8)
    ends = [0.5 * (body.front.vertex[2] + body.back.vertex[2]) for body in window.bodies]
    low, high = (one.place[2] for one in (baffle.low, baffle.high))
    for array, height in enumerate(ends):  # the walls go on straight to the lenses
        level = between(baffle.low, baffle.high, (height - low) / (high - low))
        own = window.lattice_of(array)
        cell, channel = (window.lattice.tile() @ m.T for m in (level.cells, level.channels))
        assert cell + np.array(level.place[:2]) == pytest.approx(
            own.tile() + np.array(window.shifts[array]), abs=1e-12
        )
        way = np.roll(cell, -1, axis=0) - cell
        normal = np.column_stack([way[:, 1], -way[:, 0]]) / np.hypot(*way.T)[:, None]
        assert ((cell - channel) * normal).sum(axis=1) == pytest.approx(0.03, abs=1e-12)


@pytest.mark.parametrize("name", SHEETS)
def test_the_tracer_stops_what_the_walls_stop(name):
    window, rays = built(name), light(name)
    fates = trace(window, rays, path="numpy").fate
    bare = trace(replace(window, baffle=None), rays, record=True, path="numpy")
    through = np.isin(bare.fate, [Fate.ALIVE, Fate.GHOST])
    origin = bare.hits[1, through]
    hit = as_trimesh(*baffle_meshes(window)).ray.intersects_any(origin, bare.hits[2, through] - origin)
    stopped = fates[through] == Fate.VIGNETTED
    assert 20 < stopped.sum() < 0.9 * len(stopped)
    assert np.mean(hit == stopped) > 0.95  # the solid ends before the rims of the lenses
    assert not (hit & ~stopped).any()
    assert not (fates == Fate.GHOST).any()
    ideal = trace(window, rays, rung="thin", path="numpy").fate
    assert not (ideal == Fate.GHOST).any()
    assert (ideal == Fate.VIGNETTED).any()


@pytest.mark.parametrize(
    "name", ["aimed", "aimed hexagons", "other pitches", "turned", "turned hexagons", "turned, other pitches"]
)
def test_light_meets_a_wall_where_it_first_leaves_the_section_of_its_channel(name):
    window = built(name)
    (baffle,) = baffle_meshes(window)
    ends = [0.5 * (body.front.vertex[2] + body.back.vertex[2]) for body in window.bodies]
    low, high = (one.place[2] for one in (baffle.low, baffle.high))
    rng = np.random.default_rng(1)
    left, met = rng.uniform(-0.6, 0.6, (2, 300, 2))
    share = reach(lay_out(window), (0, 1), left, met, np.zeros((300, 2), dtype=np.int64))
    first = np.full(300, np.inf)
    for t in np.linspace(0.0, 1.0, 1001)[::-1]:
        height = ends[0] + t * (ends[1] - ends[0])
        channel = (
            window.lattice.tile() @ between(baffle.low, baffle.high, (height - low) / (high - low)).channels.T
        )
        way, point = np.roll(channel, -1, axis=0) - channel, left + t * (met - left)
        off = way[:, :1] * (point[:, 1] - channel[:, 1:]) - way[:, 1:] * (point[:, 0] - channel[:, :1])
        first[(off < 0.0).any(axis=0)] = t
    assert (np.isfinite(share) == np.isfinite(first)).all()
    stopped = np.isfinite(first)
    assert 50 < stopped.sum() < 290
    assert share[stopped] == pytest.approx(first[stopped], abs=1.001e-3)


@pytest.mark.ci_cases("aimed-biconvex", "other pitches-plano")
@pytest.mark.slow
@pytest.mark.parametrize("form", ["plano", "biconvex"])
@pytest.mark.parametrize("name", ["aimed", pytest.param("other pitches", marks=pytest.mark.slow)])
def test_kernels_stop_the_same_light(name, form):
    window, rays = built(name, form=form), light(name, 2000)
    for rung in ("surfaces", "thin"):
        one, other = (trace(window, rays, rung=rung, path=path) for path in ("numpy", "numba"))
        assert (one.fate == other.fate).all()
        assert (one.fate == Fate.VIGNETTED).any()
        assert np.nanmax(np.abs(one.position - other.position)) < 1e-12


@pytest.mark.slow
def test_kernels_stop_light_before_the_plane_face_of_a_displaced_array():
    keys = BASE | {
        "lattice": BASE["lattice"] | {"aperture": [0.02, 0.01]},
        "pair": BASE["pair"] | {"form": "plano"},
    }
    window, rays = clacad.prescribe(clacad.Design.from_dict(keys)), light("", 2000)
    one, other = (trace(window, rays, path=path) for path in ("numpy", "numba"))
    assert (one.fate == Fate.VIGNETTED).sum() > 200
    assert (one.fate == other.fate).all()


def judged(window, triangles, path):
    class Stream:
        name, facet_count = "baffle", len(triangles)

        def rows(self):
            yield triangles

    write_stl([Stream()], path, 1.0, "baffle")
    subject = Subject(Path(path), "b.baffle.stl", "stl", {"bodies": ["baffle"]})
    asked = Inspection(clacad.Design.from_dict(BASE), subject.name, 64)
    found = judge_other(asked, window, subject, Reason("no part of the optics"))
    return {check.id: check.state for check in found}


def test_a_baffle_is_judged_by_its_walls_and_one_closed_channel_fails(tmp_path):
    window = built("aimed")
    (baffle,) = baffle_meshes(window)
    triangles = np.concatenate(list(baffle.rows()))
    assert judged(window, triangles, tmp_path / "a.stl") == {
        "readable": "pass",
        "closed": "pass",
        "volume": "pass",
    }
    tile = window.lattice.tile() @ baffle.low.channels.T, window.lattice.tile() @ baffle.high.channels.T
    centre = window.lattice.centres(np.array([3, 4]))
    ends = [
        np.column_stack(
            [corners + centre @ level.cells.T + np.array(level.place[:2]), np.full(4, level.place[2])]
        )
        for corners, level in zip(tile, (baffle.low, baffle.high), strict=True)
    ]
    plug = trimesh.convex.convex_hull(np.concatenate(ends)).triangles
    assert judged(window, np.concatenate([triangles, plug]), tmp_path / "b.stl")["volume"] == "fail"
    fewer = replace(baffle, lattice=replace(window.lattice, count=(8, 7)))
    assert judged(window, np.concatenate(list(fewer.rows())), tmp_path / "c.stl")["volume"] == "fail"
