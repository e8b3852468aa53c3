"""Baffle, frame and coupon: closed, of the right size, in the right place."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from clacad import Design, Fate, Rays, prescribe, trace
from clacad.exporting.fixtures import (
    COMPENSATIONS,
    NoFixture,
    baffle_mesh,
    coupon_solid,
    frame_solids,
    frame_spec,
)
from clacad.exporting.fixtures.frame import MARK_DEPTH

BASE = {
    "format": 1,
    "name": "fixture",
    "unit": "mm",
    "law": {"eta": [-0.5, -1.0], "delta": [0.004, 0.0], "euler": [0.0, 1.0, 0.0]},
    "pair": {"form": "biconvex", "separation": 10.0, "thickness": "auto", "index": 1.5},
    "lattice": {"kind": "square", "pitch": 0.5, "count": [9, 7]},
    "body": {"border": 3.0, "baffle": True, "baffle_wall": 0.05},
}


def window_of(kind="square", **body):
    data = {k: dict(v) if isinstance(v, dict) else v for k, v in BASE.items()}
    data["lattice"]["kind"] = kind
    data["body"] = {k: v for k, v in (data["body"] | body).items() if v is not None}
    return prescribe(Design.from_dict(data))


def as_trimesh(baffle):
    corners = np.concatenate(list(baffle.rows()))
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return trimesh.Trimesh(vertices, index.reshape(-1, 3), process=False)


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_the_baffle_is_one_closed_honeycomb_of_the_closed_forms_volume(kind):
    baffle = baffle_mesh(window_of(kind))
    mesh = as_trimesh(baffle)
    assert len(mesh.faces) == baffle.facet_count
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(baffle.volume(), rel=1e-12)
    assert mesh.body_count == 1
    assert mesh.euler_number == 2 - 2 * 63  # one hole a channel


def test_the_baffle_stops_the_ghosts_and_lets_partners_through_where_the_tracer_says_so():
    window = window_of()
    rng = np.random.default_rng(3)
    start = np.column_stack([rng.uniform(-1.5, 1.5, (400, 2)), np.full(400, -1.0)])
    slope = rng.uniform(-0.02, 0.02, (400, 2)) + [0.0, -np.tan(np.radians(1.0))]
    rays = Rays(start, np.column_stack([slope, np.ones(400)]))
    from dataclasses import replace

    fates = trace(window, rays).fate
    bare = trace(replace(window, baffle=None), rays, record=True)
    mesh = as_trimesh(baffle_mesh(window))
    through = np.isin(bare.fate, [Fate.ALIVE, Fate.GHOST])
    gap = bare.hits[2, through] - bare.hits[1, through]
    origin = bare.hits[1, through]
    hit = mesh.ray.intersects_any(origin, gap)
    stopped = fates[through] == Fate.VIGNETTED
    assert stopped.any()
    assert (~stopped).any()
    # the solid leaves a clearance to the lenslets that the tracer's channel does not have: a few rays may slip
    assert np.mean(hit == stopped) > 0.97
    assert not (hit & ~stopped).any()


def test_the_frame_holds_the_plates_at_the_separation_and_nothing_collides():
    window = window_of()
    spec = frame_spec(window, window.land.border)
    parts = frame_solids(spec, "ab 1")
    _carries_its_marks(parts, spec)
    for part in parts.values():
        assert part.is_valid
        assert len(part.solids()) == 1
    first, second = window.bodies
    assert spec.seats == pytest.approx((first.back.land, second.front.land))
    from build123d import Box, Pos

    plates = [
        Pos(spec.centres[k][0], spec.centres[k][1], 0.5 * (body.front.land + body.back.land))
        * Box(*spec.plates[k], body.back.land - body.front.land)
        for k, body in enumerate(window.bodies)
    ]
    for plate in plates:
        common = parts["spacer"] & plate
        volume = 0.0 if common is None else sum(s.volume for s in common.solids())
        assert volume < 1e-9  # it touches its pads and nubs, it does not enter them
    for name in ("retainer1", "retainer2"):
        common = parts["spacer"] & parts[name]
        volume = 0.0 if common is None else sum(s.volume for s in common.solids())
        assert volume < 1e-9


def _carries_its_marks(parts, spec):
    """Letters and arrow: on retainer 1 towards the viewer (−z) and up, on the spacer's −y side pointing to the viewer."""
    ring, spacer = parts["retainer1"], parts["spacer"]
    floor = ring.bounding_box().min.Z + MARK_DEPTH
    letters = [f for f in ring.faces() if abs(f.center().Z - floor) < 1e-6 and f.normal_at().Z < -0.9]
    assert len(letters) >= 13  # an arrow and twelve letters
    arrow = max(letters, key=lambda f: f.center().X)  # seen from −z, +x is on the left, where the line begins
    tip = max(arrow.vertices(), key=lambda v: v.Y)
    assert tip.X == pytest.approx(arrow.bounding_box().center().X, abs=1e-6)
    inside = -0.5 * spec.outer[1] + MARK_DEPTH
    sunk = [f for f in spacer.faces() if abs(f.center().Y - inside) < 1e-6 and f.normal_at().Y < -0.9]
    assert len(sunk) >= 13
    arrow = max(sunk, key=lambda f: f.center().X)
    tip = min(arrow.vertices(), key=lambda v: v.Z)  # towards the viewer
    assert tip.X == pytest.approx(arrow.bounding_box().center().X, abs=1e-6)


@pytest.mark.long
def test_the_coupon_is_one_solid_with_five_scaled_patches():
    coupon = coupon_solid(window_of(border=None, baffle=None, baffle_wall=None))
    assert coupon.is_valid
    assert len(coupon.solids()) == 1
    assert len(COMPENSATIONS) == 5


@pytest.mark.parametrize(
    ("changes", "make", "words"),
    [
        ({"baffle": None, "baffle_wall": None}, baffle_mesh, "has no baffle"),
        ({"border": 0.5}, lambda w: frame_spec(w, 1.0), "body.border >= '1 mm'"),
        ({"border": None}, lambda w: frame_spec(w, 1.0), "no flat border"),
    ],
    ids=["no baffle", "narrow border", "no border"],
)
def test_what_cannot_be_held_is_refused_with_words(changes, make, words):
    with pytest.raises(NoFixture, match=words):
        make(window_of(**changes))
