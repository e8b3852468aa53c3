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
    pin_solids,
    pin_spec,
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


PINNED = {"border": 4.0, "baffle": None, "baffle_wall": None,
          "pins": {"diameter": 1.2, "at": [[-4.3, 1.0], [4.3, -1.0]], "play": "20 um"}}  # fmt: skip


@pytest.mark.slow
def test_shoulder_pins_hold_the_plates_at_the_separation_and_enter_neither():
    from build123d import Cylinder, Plane, Polyline, Pos, extrude, make_face

    window = window_of(**PINNED)
    pins = pin_spec(window)
    first, second = window.bodies
    flats = [face.land for body in (first, second) for face in (body.front, body.back)]
    assert pins.heights == pytest.approx(flats)
    assert pins.gap == pytest.approx(second.front.land - first.back.land)
    solid = pin_solids(pins)
    assert solid.is_valid
    assert len(solid.solids()) == 2
    radius, lead, ends = 0.6, pins.lead, flats[3] - flats[2] + flats[1] - flats[0]
    assert 0 < lead <= 0.3 * min(flats[1] - flats[0], flats[3] - flats[2]) * (1 + 1e-12)
    cones = 2 * np.pi * lead * (radius**2 - radius * lead + lead**2 / 3)
    wanted = np.pi * (radius**2 * (ends - 2 * lead) + 0.25 * pins.shoulder**2 * pins.gap) + cones
    assert solid.volume == pytest.approx(2 * wanted, rel=1e-9)
    box = window.outline.box
    for number, body in enumerate(window.bodies):
        corners = [(box[i], box[j]) for i, j in ((0, 2), (1, 2), (1, 3), (0, 3), (0, 2))]
        plate = extrude(Plane.XY * make_face(Polyline(*corners)), flats[2 * number + 1] - flats[2 * number])
        plate = Pos(0, 0, flats[2 * number]) * plate
        for x, y in PINNED["pins"]["at"]:
            plate -= Pos(x, y, 0) * Cylinder(0.5 * 1.22, 100)
        common = solid & plate
        assert (0.0 if common is None else sum(s.volume for s in common.solids())) < 1e-9
        away = [solid.distance_to(Pos(0, 0, way) * plate) for way in (1e-3, -1e-3)]
        assert sorted(away) == pytest.approx([0.0, 1e-3], abs=2e-4), (
            body.name
        )  # it bears, and lifts off one way only


def test_a_shoulder_keeps_off_cells_edges_and_other_holes():
    window = window_of(**PINNED | {"holes": [{"diameter": 1.0, "at": [[4.3, 0.85]]}]})
    pins = pin_spec(window)
    assert 0.5 * pins.shoulder == pytest.approx(1.2)  # nowhere nearer than that: at most twice the pin
    near = window_of(**PINNED | {"holes": [{"diameter": 1.0, "at": [[4.3, 0.4]]}]})
    assert 0.5 * pin_spec(near).shoulder == pytest.approx(0.95 * 0.9)
    close = window_of(**PINNED | {"holes": [{"diameter": 1.0, "at": [[4.3, 0.2]]}]})
    with pytest.raises(
        NoFixture,
        match=r"at \(4.3, -1\) stands 0.7 mm from the next cell, edge or hole: its shoulder needs 0.7684",
    ):
        pin_spec(close)
    beside = window_of(**PINNED | {"pins": PINNED["pins"] | {"at": [[-3.0, 1.0], [4.3, -1.0]]}})
    with pytest.raises(NoFixture, match=r"at \(-3, 1\) stands 0.7[0-9]* mm"):
        pin_spec(beside)


@pytest.mark.slow
def test_shoulder_pins_are_written_read_back_and_no_master(tmp_path):
    from build123d import import_step

    from clacad.cli.tables import holds_text
    from clacad.exporting.export_design import export

    data = {**BASE, "body": {"border": 4.0, "pins": PINNED["pins"]}}
    manifest = export(Design.from_dict(data), tmp_path / "out", formats=("pins",))
    (entry,) = manifest.files
    assert entry["role"] == "other"
    assert (
        holds_text(entry) == "2 solids with 18 faces, one a connected piece"
    )  # there is no other way to write them
    again = export(Design.from_dict(data), tmp_path / "again", formats=("pins",))
    assert [file["sha256"] for file in again.files] == [entry["sha256"]]
    found = import_step(str(tmp_path / "out" / "fixture.pins.step"))
    assert len(found.solids()) == 2
    box, window = found.bounding_box(), prescribe(Design.from_dict(data))
    assert (box.min.Z, box.max.Z) == pytest.approx(
        (window.bodies[0].front.land, window.bodies[1].back.land), abs=1e-6
    )


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
        ({}, pin_spec, "body.pins says where"),
        (PINNED, lambda w: frame_spec(w, 1.0), "--format pins"),
    ],
    ids=["no baffle", "narrow border", "no border", "no pins", "pins in a frame"],
)
def test_what_cannot_be_held_is_refused_with_words(changes, make, words):
    with pytest.raises(NoFixture, match=words):
        make(window_of(**changes))
