"""Baffles, pins and frames of listed plates: one for each gap, found again by other libraries."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh

import clacad
from clacad import Design, Fate
from clacad.design import load
from clacad.exporting.fixtures import baffle_meshes, frame_solids, frame_spec, pin_solids, pin_spec
from clacad.sheet.face_order import plates_of
from clacad.sheet.window import Window

FOLDER = Path(__file__).parents[1] / "data" / "plates"
WALLS = {"border": 2.0, "baffle": True, "baffle_wall": 0.03}
PINS = {"diameter": 1.0, "at": [[-2.4, 0.0], [2.4, 0.0]], "play": "10 um"}


def doublets(**lattice: object) -> Design:
    """Two cemented doublets of flat joints with air between them."""
    faces = [
        {"radius": 2.0, "array": 1, "behind": "PMMA"},
        {"radius": "inf", "after": 0.8, "behind": "PS"},
        {"radius": "inf", "after": 0.4, "behind": "air"},
        {"radius": "inf", "after": 5.0, "behind": "PS"},
        {"radius": "inf", "after": 0.4, "behind": "PMMA"},
        {"radius": -2.0, "array": 2, "after": 0.8, "behind": "air"},
    ]
    return Design.from_dict(
        {
            "format": 1, "name": "doublets", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
            "pair": {"form": "plates", "wavelength": 546.1, "face": faces},
            "lattice": {"pitch": 0.5, "count": [9, 7], **lattice},
            "body": {"border": 2.0, "baffle": True, "baffle_wall": 0.04},
        }
    )  # fmt: skip


def sample(name: str, aperture: object = "centred", **body: object) -> Window:
    """Plates of a sample with other edges."""
    data = load(FOLDER / f"{name}.toml").given
    lattice = {**data["lattice"], "count": [5, 4], "aperture": aperture}
    return clacad.prescribe(Design.from_dict({**data, "lattice": lattice, "body": body}))


def as_trimesh(baffle):
    corners = np.concatenate(list(baffle.rows()))
    vertices, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return trimesh.Trimesh(vertices, index.reshape(-1, 3), process=False)


def rays_over(window: Window, slope: float, count: int = 1500) -> clacad.Rays:
    rng = np.random.default_rng(7)
    start = np.column_stack([rng.uniform(-0.9, 0.9, (count, 2)), np.full(count, -1.0)])
    return clacad.Rays(start, np.column_stack([rng.uniform(-slope, slope, (count, 2)), np.ones(count)]))


def leaves_and_meets(window: Window) -> list[tuple[int, int]]:
    """Numbers of the faces at either side of each gap: two faces a body."""
    ends = np.cumsum([2 * len(plate) for plate in plates_of(window.bodies)])
    return [(int(end) - 1, int(end)) for end in ends[:-1]]


@pytest.mark.parametrize(
    ("window", "slope"),
    [
        (sample("three-plates", **WALLS), 0.3),
        (sample("three-plates", [0.05, 0.0], **WALLS), 0.3),
        (sample("two-plates", [0.05, 0.0], **WALLS), 0.3),
        (clacad.prescribe(doublets()), 0.08),
        (clacad.prescribe(doublets(aperture=[0.05, 0.0])), 0.08),
    ],
    ids=["three plates", "three plates displaced", "two plates displaced", "doublets", "doublets displaced"],
)
def test_honeycombs_in_every_gap_stop_what_their_solids_stop(window, slope):
    rays = rays_over(window, slope)
    bare = clacad.trace(replace(window, baffle=None), rays, record=True, path="numpy")
    plain, compiled = (clacad.trace(window, rays, path=path) for path in ("numpy", "numba"))
    assert (plain.fate == compiled.fate).all()
    meshes = [as_trimesh(baffle) for baffle in baffle_meshes(window)]
    assert [mesh.is_watertight for mesh in meshes] == [True] * (len(plates_of(window.bodies)) - 1)
    through = np.isin(bare.fate, [Fate.ALIVE, Fate.GHOST])
    hit = np.zeros(through.sum(), dtype=bool)
    for mesh, (leaves, meets) in zip(meshes, leaves_and_meets(window), strict=True):
        origin = bare.hits[leaves, through]
        hit |= mesh.ray.intersects_any(origin, bare.hits[meets, through] - origin)
    stopped = plain.fate[through] == Fate.VIGNETTED
    assert stopped.sum() > 50
    assert (~stopped).sum() > 50
    # sheared walls begin at vertices, those of the tracer where a ray leaves its curved face
    assert np.mean(hit & ~stopped) < (0.02 if window.shifts[1] != (0.0, 0.0) else 1e-9)
    assert np.mean(hit == stopped) > 0.9  # the solids leave a clearance to the curved faces


@pytest.mark.parametrize("slope", [0.02, 0.2])
def test_light_that_a_baffle_between_cemented_plates_passes_is_that_without_it(slope):
    """The walls touch no ray that the channels let through, and a joint has no walls."""
    window = clacad.prescribe(doublets())
    rays = rays_over(window, slope)
    bare = clacad.trace(replace(window, baffle=None), rays)
    held = clacad.trace(window, rays)
    kept = held.fate == Fate.ALIVE
    assert kept.sum() > 30
    assert (bare.fate[kept] == Fate.ALIVE).all()
    assert np.array_equal(bare.direction[kept], held.direction[kept])


def test_a_baffle_is_refused_where_plates_have_no_air_between_them():
    data = doublets().to_dict()
    data["pair"]["face"] = [
        {**face, "behind": "PMMA" if n % 2 else "PS"} for n, face in enumerate(data["pair"]["face"])
    ]
    data["pair"]["face"][-1]["behind"] = "air"
    with pytest.raises(clacad.DesignError, match=r"body\.baffle does not belong to a list of one plate"):
        Design.from_dict(data)


def test_pins_go_through_all_plates_with_a_shoulder_or_a_sleeve_in_every_gap():
    window = sample("three-plates", border=4.0, pins=PINS)
    spec = pin_spec(window)
    flats = [z for body in window.bodies for z in (body.front.land, body.back.land)]
    assert spec.heights == pytest.approx(flats)
    made = pin_solids(spec)
    assert made.is_valid
    pins, sleeves = made.solids()[::2], made.solids()[1::2]
    assert len(pins) == len(sleeves) == 2
    from build123d import Box, Cylinder, Pos

    for (x, y), pin, sleeve in zip(PINS["at"], pins, sleeves, strict=True):
        box = pin.bounding_box()
        assert (box.min.Z, box.max.Z) == pytest.approx((flats[0], flats[-1]), abs=1e-6)
        tube = sleeve.bounding_box()
        assert (tube.min.Z, tube.max.Z) == pytest.approx((flats[3], flats[4]), abs=1e-6)
        for low, high in zip(flats[::2], flats[1::2], strict=True):
            plate = Pos(x, y, 0.5 * (low + high)) * (
                Box(2, 2, high - low) - Cylinder(0.5 * spec.bore, high - low)
            )
            for part in (pin, sleeve):
                common = part & plate
                assert common is None or sum(s.volume for s in common.solids()) < 1e-9
        common = pin & sleeve
        assert common is None or sum(s.volume for s in common.solids()) < 1e-9


def test_a_frame_has_a_spacer_for_every_gap():
    data = load(FOLDER / "three-plates.toml").given
    lattice = {**data["lattice"], "count": [5, 4]}
    big = {**data, "unit": "4 mm", "lattice": lattice, "body": {"border": 1.0}}
    window = clacad.prescribe(Design.from_dict(big))
    spec = frame_spec(window, window.land.border)
    assert spec.gaps == 2
    lands = [4.0 * z for body in window.bodies for z in (body.front.land, body.back.land)]
    assert spec.seats == pytest.approx(lands[1:-1])
    assert spec.thickness == pytest.approx(
        [high - low for low, high in zip(lands[::2], lands[1::2], strict=True)]
    )
    assert all(low[1] == high[0] for low, high in pairwise(spec.ends(gap) for gap in range(2)))


@pytest.mark.slow
def test_spacers_of_a_frame_for_thin_plates_rest_on_each_other_with_pins_in_their_holes():
    """Three plates 0.7 mm apart: the second spacer is 1.2 mm high, and its pins are as deep as that allows."""
    from clacad.design import template

    kind = "three-plates-10deg"
    small = Design.from_dict(tomllib.loads(template(kind, kind))).with_cells((8, 8))
    spec = frame_spec(clacad.prescribe(small.replace("body.border", 3.0)), 6.0)
    assert 0.3 < spec.rail < 0.4
    parts = frame_solids(spec)
    assert set(parts) == {"spacer1", "spacer2", "retainer1", "retainer2"}
    boxes = {name: part.bounding_box() for name, part in parts.items()}
    assert boxes["spacer2"].min.Z < boxes["spacer1"].max.Z == pytest.approx(spec.ends(0)[1])
    assert boxes["retainer2"].min.Z < boxes["spacer2"].max.Z == pytest.approx(spec.ends(1)[1])
    for one, two in (("spacer1", "spacer2"), ("spacer2", "retainer2"), ("retainer1", "spacer1")):
        common = parts[one] & parts[two]
        assert common is None or sum(s.volume for s in common.solids()) < 1e-9


@pytest.mark.slow
def test_a_spacer_holds_cemented_plates_without_entering_them():
    from build123d import Box, Pos

    window = clacad.prescribe(doublets().replace("body.border", 3.0))
    spec = frame_spec(window, window.land.border)
    parts = frame_solids(spec, "ab 1")
    assert set(parts) == {"spacer", "retainer1", "retainer2"}
    for k, plate in enumerate(plates_of(window.bodies)):
        low, high = plate[0].front, plate[-1].back
        ends = [face.vertex[2] if face.array is None else face.land for face in (low, high)]
        solid = Pos(*spec.centres[k], 0.5 * sum(ends)) * Box(*spec.plates[k], ends[1] - ends[0])
        for part in parts.values():
            common = part & solid
            assert common is None or sum(s.volume for s in common.solids()) < 1e-9
