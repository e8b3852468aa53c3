"""Baffle, frame and coupon: closed, of the right size, in the right place."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from clacad import Design, Fate, Rays, prescribe, trace
from clacad.exporting.fixtures import (
    COMPENSATIONS,
    NoFixture,
    baffle_meshes,
    coupon_solid,
    frame_solids,
    frame_spec,
    pin_solids,
    pin_spec,
)
from clacad.exporting.fixtures.frame import MARK_DEPTH
from clacad.sheet.bundle import bundle
from clacad.sheet.vignetting import aperture_slope, share, thin_cells

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


@pytest.mark.daily_cases("hexagonal")
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_the_baffle_is_one_closed_honeycomb_of_the_closed_forms_volume(kind):
    (baffle,) = baffle_meshes(window_of(kind))
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
    fates = trace(window, rays).fate
    bare = trace(replace(window, baffle=None), rays, record=True)
    mesh = as_trimesh(*baffle_meshes(window))
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


@pytest.mark.slow
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


def with_field_lens(**body):
    """Three bodies, the one in the middle a field lens; off the axis and tilted."""
    data = {k: dict(v) if isinstance(v, dict) else v for k, v in BASE.items()}
    data["law"] |= {"eta": [-0.5, -0.5]}
    data["pair"] |= {"field_lens": True}
    data["body"] |= body
    return prescribe(Design.from_dict(data))


def test_two_honeycombs_beside_a_field_lens_stop_every_ghost_and_what_their_solids_stop():
    """Segments before and behind the field lens against the triangles of either honeycomb, by another library."""
    window = with_field_lens()
    rng = np.random.default_rng(4)
    start = np.column_stack([rng.uniform(-1.5, 1.5, (600, 2)), np.full(600, -1.0)])
    slope = rng.uniform(-0.06, 0.06, (600, 2)) + [0.0, -np.tan(np.radians(1.0))]
    rays = Rays(start, np.column_stack([slope, np.ones(600)]))
    fates, ideal = trace(window, rays).fate, trace(window, rays, rung="thin").fate
    assert not np.isin(fates, Fate.GHOST).any()
    assert not np.isin(ideal, Fate.GHOST).any()
    bare = trace(replace(window, baffle=None), rays, record=True)
    meshes = [as_trimesh(baffle) for baffle in baffle_meshes(window)]
    assert [mesh.is_watertight for mesh in meshes] == [True, True]
    through = np.isin(bare.fate, [Fate.ALIVE, Fate.GHOST])
    hit = np.zeros(through.sum(), dtype=bool)
    for mesh, (leaves, meets) in zip(meshes, ((1, 2), (3, 4)), strict=True):
        origin = bare.hits[leaves, through]
        hit |= mesh.ray.intersects_any(origin, bare.hits[meets, through] - origin)
    stopped = fates[through] == Fate.VIGNETTED
    assert (bare.fate == Fate.GHOST).sum() > 20
    assert stopped.sum() > 50
    assert (~stopped).sum() > 50
    # honeycombs end a clearance before the lenslets, and in the middle of lens 1 where light has not yet been bent
    assert np.mean(hit == stopped) > 0.96


def test_a_baffle_beside_a_field_lens_passes_its_channels_share():
    """Of light in the middle of the field, (1 − w/p)² of a cell; none beyond the slope at which a wall of the field lens is met."""
    window = with_field_lens()
    cells, wall, pitch = thin_cells(window), 0.05, 0.5
    axis = np.array([*aperture_slope(window), 1.0])
    edge = 0.5 * (pitch - wall) * 1.5 / 10.0  # over f1
    light = [axis + [part * edge, 0.0, 0.0] for part in (0.0, 0.97, 1.03)]
    want = [(1.0 - wall / pitch) ** 2] * 2 + [0.0]
    np.testing.assert_allclose(share(cells, light), want, rtol=1e-2)
    for direction, expected in zip(light, want, strict=True):
        lit = bundle(window, 4000, 0.0, middle=direction / np.linalg.norm(direction))
        for rung in ("thin", "surfaces"):
            alive = (trace(window, lit.rays, rung=rung).fate == Fate.ALIVE).mean()
            assert alive == pytest.approx(expected, abs=0.06 if rung == "surfaces" else 0.02)


@pytest.mark.slow
def test_a_frame_of_three_plates_is_two_spacers_that_stand_on_each_other():
    window = with_field_lens()
    spec = frame_spec(window, window.land.border)
    parts = frame_solids(spec, "ab 1")
    assert set(parts) == {"spacer1", "spacer2", "retainer1", "retainer2"}
    assert all(part.is_valid and len(part.solids()) == 1 for part in parts.values())
    from build123d import Box, Pos

    plates = []
    for body in window.bodies:
        array = 2 if body.name == "field" else int(body.name[-1]) - 1
        low = body.front.land if body.front.array is not None else body.front.vertex[2]
        high = body.back.land if body.back.array is not None else body.back.vertex[2]
        size = (window.outline.width, window.outline.height, high - low)
        plates.append(Pos(*window.shifts[array], 0.5 * (low + high)) * Box(*size))
    for one, other in itertools.combinations([*parts.values(), *plates], 2):
        common = one & other
        assert (0.0 if common is None else sum(solid.volume for solid in common.solids())) < 1e-9
    ends = [parts[name].bounding_box() for name in ("spacer1", "spacer2")]
    for plate, (low, high) in zip(plates, ((0, 0), (0, 0), (1, 1)), strict=True):
        box = plate.bounding_box()
        assert ends[low].min.Z < box.min.Z
        assert box.max.Z < ends[high].max.Z


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
        match=r"at \(4.3, -1\) is 0.7 mm from the next cell, edge or hole: its shoulder needs 0.7684",
    ):
        pin_spec(close)
    beside = window_of(**PINNED | {"pins": PINNED["pins"] | {"at": [[-3.0, 1.0], [4.3, -1.0]]}})
    with pytest.raises(NoFixture, match=r"at \(-3, 1\) is 0.7[0-9]* mm"):
        pin_spec(beside)


@pytest.mark.slow
def test_shoulder_pins_are_written_read_back_and_no_master(tmp_path):
    from build123d import import_step

    from clacad.cli.tables import holds_text
    from clacad.exporting.run import export

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
        ({"baffle": None, "baffle_wall": None}, baffle_meshes, "has no baffle"),
        ({"border": 0.5}, lambda w: frame_spec(w, 1.0), "body.border >= '1 mm'"),
        ({"border": None}, lambda w: frame_spec(w, 1.0), "no flat border"),
        ({}, pin_spec, "body.pins states where"),
        (PINNED, lambda w: frame_spec(w, 1.0), "--format pins"),
    ],
    ids=["no baffle", "narrow border", "no border", "no pins", "pins in a frame"],
)
def test_what_cannot_be_held_is_refused_with_words(changes, make, words):
    with pytest.raises(NoFixture, match=words):
        make(window_of(**changes))
