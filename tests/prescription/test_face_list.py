"""`form = "plates"`: faces in the order of the light, the medium behind each, joints between media."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpmath import mp
from oracle import trace as oracle

import clacad
from clacad.config.mistakes import DesignError
from clacad.design import Design, load
from clacad.design.faces import FaceSpec
from clacad.effects.engine.nonsequential import Rules, trace_nonsequential
from clacad.optics.rays import Fate
from clacad.optics.sequence import trace_sequence
from clacad.prescription.face_list import surface_of
from clacad.sheet.bundle import bundle
from clacad.sheet.face_order import media_of
from clacad.sheet.like_cell import interfaces
from clacad.sheet.window import PLANE, Body, Face, face_height

FOLDER = Path(__file__).parents[1] / "data" / "plates"
DESIGNS = Path(__file__).parents[2] / "designs"
NAMES = ("curved-joints", "flat-joints", "two-plates", "three-plates")
FOUND = {
    "curved-joints": ({486.1: 0.03961, 546.1: 0.07961, 587.6: 0.04091, 656.3: 0.08163}, 0.7184),
    "flat-joints": ({486.1: 0.0241, 546.1: 0.02653, 587.6: 0.02452, 656.3: 0.02602}, 0.725),
    "two-plates": ({486.1: 2.4963, 546.1: 1.6235, 587.6: 2.1468, 656.3: 3.6973}, 0.9822),
    "three-plates": ({486.1: 1.6616, 546.1: 0.5771, 587.6: 1.2467, 656.3: 2.7181}, 0.9853),
}
"""What another program found for these prescriptions: wavelength in nm → rms error of the law in mrad, and the share."""


def design(name: str, **changes: object) -> Design:
    data = load(FOLDER / f"{name}.toml").given
    for key, value in changes.items():
        section, _, word = key.partition("__")
        data = {**data, section: {**data.get(section, {}), word: value}}
    return Design.from_dict(data)


def window(name: str, **changes: object) -> clacad.Window:
    return clacad.prescribe(design(name, **changes))


def rays_over(sheet: clacad.Window, slope: float, count: int = 3000) -> clacad.Rays:
    """Rays over the whole sheet and beyond its rim, of slopes up to `slope`."""
    rng = np.random.default_rng(4)
    x0, x1, y0, y1 = sheet.lattice.extent()
    start = np.column_stack([1.1 * rng.uniform((x0, y0), (x1, y1), (count, 2)), np.full(count, -1.0)])
    return clacad.Rays(start, np.column_stack([rng.uniform(-slope, slope, (count, 2)), np.ones(count)]))


@pytest.mark.daily_cases("flat-joints")
@pytest.mark.parametrize("name", NAMES)
def test_light_of_four_lines_leaves_as_another_program_says(name):
    lines, share = FOUND[name]
    sheet, spec = window(name), design(name)
    lit = bundle(sheet, 16384, spec.check.field)
    asked = sheet.law.refract(lit.rays.direction)
    for line, mrad in lines.items():
        rays = clacad.Rays(lit.rays.position, lit.rays.direction, np.full(len(lit.rays), 1e-9 * line))
        seen = clacad.trace(sheet, rays)
        kept = seen.fate == Fate.ALIVE
        angle = np.linalg.norm(np.cross(seen.direction[kept], asked[kept]), axis=1)
        assert 1e3 * np.sqrt(np.mean(angle**2)) == pytest.approx(mrad, rel=0.012)
        if line == 546.1:
            assert kept.mean() == pytest.approx(share, abs=0.006)


@pytest.mark.parametrize("name", NAMES)
def test_both_tracers_agree_on_every_ray(name):
    """Rays that change cell, meet the rim or are turned back take the walk; the rest goes straight through."""
    sheet = window(name)
    rays = rays_over(sheet, 0.6)
    plain, compiled = (clacad.trace(sheet, rays, path=path, record=True) for path in ("numpy", "numba"))
    assert (plain.fate == compiled.fate).all()
    assert len(set(plain.fate.tolist())) > 2
    assert (plain.order == compiled.order).all()
    for one, other in ((plain.direction, compiled.direction), (plain.position, compiled.position)):
        assert np.abs(one - other).max() < 1e-11
    assert np.abs(plain.hits - compiled.hits).max() < 1e-11
    assert np.abs(plain.optical_path - compiled.optical_path).max() < 1e-11


@pytest.mark.parametrize("name", NAMES)
def test_light_in_its_own_cell_is_that_of_the_faces_one_by_one(name):
    sheet = window(name)
    rays = rays_over(sheet, 0.02)
    seen = clacad.trace(sheet, rays)
    kept = seen.fate == Fate.ALIVE
    centre = sheet.centres(0, seen.cell[kept])
    start = rays.position[kept] - np.column_stack([centre, np.zeros(len(centre))])
    single = trace_sequence(interfaces(sheet), clacad.Rays(start, rays.direction[kept]))
    assert kept.sum() > 200
    assert np.abs(single.direction - seen.direction[kept]).max() < 1e-14
    assert np.abs(single.optical_path - seen.optical_path[kept]).max() < 1e-12


def layered(index: tuple[float, float, float], part: float = 0.7) -> clacad.Window:
    """The slab of the designs with a layer between two planes, `part` of its thickness, and these refractive indices."""
    sheet = clacad.prescribe(load(DESIGNS / "slab.toml", ["lattice.count=4"]))
    (body,) = sheet.bodies
    high = body.back.vertex[2]
    cuts = 0.5 * (1.0 - part) * high, 0.5 * (1.0 + part) * high

    def plane(z: float, side: int) -> Face:
        return Face(replace(PLANE, side=side), (0.0, 0.0, z))

    layers = (
        Body(body.front, plane(cuts[0], -1), index[0], "first"),
        Body(plane(cuts[0], 1), plane(cuts[1], -1), index[1], "middle", joined=True),
        Body(plane(cuts[1], 1), body.back, index[2], "last", joined=True),
    )
    return replace(sheet, bodies=layers)


def test_layers_of_one_medium_are_a_slab():
    """Cutting a slab into layers of its own medium moves no ray, but that light from aside starts at the first body."""
    whole = clacad.prescribe(load(DESIGNS / "slab.toml", ["lattice.count=4"]))
    index = whole.bodies[0].index
    cut, rays = layered((index, index, index)), rays_over(whole, 0.4)
    for path in ("numpy", "numba"):
        one, other = (clacad.trace(sheet, rays, path=path) for sheet in (whole, cut))
        met = one.surface >= 0
        assert met.sum() > 1000
        assert (one.fate == other.fate)[met].all()
        assert (one.order == other.order)[met].all()
        assert np.abs(one.direction - other.direction)[met].max() < 1e-13
        assert np.abs(one.optical_path - other.optical_path)[met].max() < 1e-11


def test_light_beyond_the_critical_angle_of_a_joint_is_turned_back_there():
    dense, thin = 1.9, 0.8
    sheet = layered((dense, thin, dense), part=0.9)
    slope = np.linspace(0.05, 1.9, 200)
    start = np.tile([0.01, 0.0, -1e-3], (200, 1))
    rays = clacad.Rays(start, np.column_stack([slope, 0 * slope, 1 + 0 * slope]))
    for path in ("numpy", "numba"):
        seen = clacad.trace(sheet, rays, path=path, record=True)
        first = np.asarray(seen.directions)[0]  # inside the first layer
        beyond = np.hypot(first[:, 0], first[:, 1]) > thin / dense
        at_joint = seen.surface >= 1
        assert (((seen.fate == Fate.TIR) & (seen.surface == 1)) == (beyond & at_joint)).all()
        assert 20 < (beyond & at_joint).sum() < 180


@pytest.mark.parametrize("ratio", [1 + 1e-12, 1 - 1e-12, 1.0001, 1.25])
def test_a_joint_of_nearly_equal_media_bends_as_sixty_digits_say(ratio):
    sheet = layered((1.5, 1.5 * ratio, 1.5), part=1e-7)
    faces = [
        oracle.quadric(
            one.surface.curvature_x, one.surface.curvature_y, one.surface.kappa, one.surface.side,
            vertex=one.vertex, before=one.index_before, after=one.index_after,
        )
        for one in interfaces(sheet)
    ]  # fmt: skip
    start, ray = np.array([0.11, -0.07, -0.5]), np.array([0.02, 0.013, 1.0])
    centre = sheet.lattice.centres(np.array([[2, 2]]))[0]
    told = oracle.trace(faces, start, ray)
    for path in ("numpy", "numba"):
        seen = clacad.trace(sheet, clacad.Rays([start + [*centre, 0.0]], [ray]), path=path)
        assert seen.fate[0] == Fate.ALIVE
        with mp.workdps(40):
            error = max(abs(mp.mpf(float(a)) - b) for a, b in zip(seen.direction[0], told.directions[-1]))
        assert float(error) < 2e-15


def test_what_joints_reflect_is_fresnels_share():
    """Light along the axis through flat joints: the product of four closed forms; all of it is accounted for."""
    sheet = window("flat-joints")
    cell = sheet.centres(0, np.array([[1, 2]]))[0]
    axis = clacad.Rays([[*cell, -1.0]], [[0.0, 0.0, 1.0]])
    outer, inner = sheet.bodies[0].index, sheet.bodies[1].index
    passed = [1 - ((a - b) / (a + b)) ** 2 for a, b in ((1.0, outer), (outer, inner))]
    for path in ("numpy", "numba"):
        seen = clacad.trace(sheet, axis, effects=["fresnel"], path=path)
        assert seen.flux[0] == pytest.approx(passed[0] ** 2 * passed[1] ** 2, rel=1e-12)
    rays = rays_over(sheet, 0.02, 300)
    met = np.flatnonzero(clacad.trace(sheet, rays).fate < Fate.MISSED)
    rules = Rules(walls=True, total=True, losses=True, order=2, media=media_of(sheet.bodies))
    out = trace_nonsequential(sheet, rays, met, rules)
    assert np.abs(sum(out.share.values())[met] - 1.0).max() < 1e-12
    once = 1 - passed[0] * passed[0] * passed[1] * passed[1]
    assert out.share["front"][met].mean() == pytest.approx(once, rel=0.05)


def test_the_sign_of_a_radius_and_of_even_terms_is_towards_plus_z():
    """z(x, y) of a listed face by the textbook formula, whichever side its material is on."""
    spec = FaceSpec((3.0, -5.0), (0.2, -0.7), a4=(1e-3, 2e-3, -4e-3), a6=(1e-4, 0.0, 0.0, -2e-4))
    x, y = 0.4, -0.3
    q = x * x / 3.0 - y * y / 5.0
    w = np.sqrt(1 - 1.2 * (x / 3.0) ** 2 - 0.3 * (y / 5.0) ** 2)
    z = q / (1 + w) + 1e-3 * x**4 + 2e-3 * x**2 * y**2 - 4e-3 * y**4 + 1e-4 * x**6 - 2e-4 * y**6
    from clacad.sheet.window import lens_height

    for side in (1, -1):
        face = Face(surface_of(spec, side), (0.0, 0.0, 0.0), array=0)
        assert float(lens_height(face, np.array([x]), np.array([y]))[0]) == pytest.approx(z, abs=1e-15)


@pytest.mark.slow
def test_the_place_of_lens_2_gives_the_offset_that_is_asked():
    sheet = window("flat-joints", law__delta=[0.01, -0.004])
    seen = clacad.verify(design("flat-joints", law__delta=[0.01, -0.004]))
    measured = next(check for check in seen.checks if check.id == "delta").detail["measured"]
    assert measured == pytest.approx((0.01, -0.004), abs=2e-5)
    assert sheet.bodies[-1].back.vertex[0] == pytest.approx(0.0, abs=1e-12)  # centred on its own cell


@pytest.mark.slow
def test_cells_that_are_aimed_serve_the_eye_through_joints():
    spec = design("flat-joints", lattice__count=[16, 16], lattice__aperture={"point": [0, 0, -400]})
    found = {check.id: check for check in clacad.verify(spec).checks}
    assert found["viewed"].value > 0.99
    assert found["law_rms"].value < 3e-4


def test_canonical_text_is_read_back_the_same():
    spec = design("flat-joints")
    again = Design.from_dict(spec.to_dict())
    assert again.to_dict() == spec.to_dict()
    assert again.sha256 == spec.sha256


FACE = {"radius": 2.3, "array": 1, "behind": "PMMA"}
LAST = {"radius": -2.3, "after": 10, "array": 2, "behind": "air"}
WRONG = {
    "one face": ([FACE], "CL108", "pair.face"),
    "no array 2": ([FACE, {**LAST, "array": 1}], "CL113", "pair.face"),
    "no power": ([FACE, {**LAST, "radius": "inf"}], "CL113", "pair.face"),
    "arrays out of order": ([{**FACE, "array": 2}, {**LAST, "array": 1}], "CL113", "pair.face"),
    "air behind the first": ([{**FACE, "behind": "air"}, LAST], "CL113", "pair.face.0.behind"),
    "glass behind the last": ([FACE, {**LAST, "behind": "N-SF6"}], "CL113", "pair.face.1.behind"),
    "nothing behind": ([{k: v for k, v in FACE.items() if k != "behind"}, LAST], "CL113", "pair.face.0.behind"),
    "unknown glass": ([{**FACE, "behind": "N-SF66"}, LAST], "CL119", "pair.face.0.behind"),
    "one medium on both sides": (
        [FACE, {"radius": "inf", "after": 1, "behind": "PMMA"}, LAST], "CL113", "pair.face.1.behind",
    ),
    "two places": ([FACE, {**LAST, "z": 4}], "CL113", "pair.face.1.after"),
    "no place": ([FACE, {k: v for k, v in LAST.items() if k != "after"}], "CL113", "pair.face.1.after"),
    "a place before the last": (
        [FACE, {"radius": "inf", "z": 5, "behind": "PS"}, {k: v for k, v in LAST.items() if k != "after"} | {"z": 4}],
        "CL113", "pair.face.2.z",
    ),
    "a place of the first": ([{**FACE, "z": 1}, LAST], "CL113", "pair.face.0.z"),
    "curved without array": (
        [FACE, {"radius": 9, "after": 1, "behind": "PS"}, LAST], "CL113", "pair.face.1.array",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_a_list_that_makes_no_plates_is_refused_where_it_is_wrong(name):
    faces, code, key = WRONG[name]
    data = {
        "format": 1, "name": "wrong", "unit": "mm", "law": {"eta": [-1, -1]},
        "pair": {"form": "plates", "face": faces}, "lattice": {"pitch": 0.5, "count": 4},
    }  # fmt: skip
    with pytest.raises(DesignError) as caught:
        Design.from_dict(data)
    assert (code, key) in {(mistake.code, mistake.key) for mistake in caught.value.mistakes}


@pytest.mark.parametrize(("section", "key", "value"), [
    ("pair", "separation", 10), ("pair", "thickness", 3), ("pair", "index", 1.5), ("pair", "material", "PMMA"),
    ("pair", "confocal", "best"), ("pair", "conic", [0, 0]), ("pair", "field_lens", True), ("pair", "focus", "afocal"),
])  # fmt: skip
def test_keys_of_other_forms_are_refused_beside_a_list(section, key, value):
    with pytest.raises(DesignError) as caught:
        design("flat-joints", **{f"{section}__{key}": value})
    assert any(mistake.code == "CL114" and key in mistake.key for mistake in caught.value.mistakes)


def test_a_list_needs_its_form():
    with pytest.raises(DesignError, match="behind needs pair.form"):
        design("flat-joints", pair__form="slab")


@pytest.mark.parametrize("changes", [
    {"law__delta": [0.02, 0.0], "lattice__aperture": "aligned"}, {"lattice__aperture": [0.01, 0.0]},
    {"lattice__aperture": {"point": [0, 0, -400]}},
], ids=str)  # fmt: skip
def test_a_curved_joint_without_a_smooth_surface_is_refused(changes):
    with pytest.raises(DesignError, match="joint with steps") as caught:
        window("curved-joints", **changes)
    assert caught.value.mistakes[0].key.startswith("pair.face.")


EDGED = [
    {"lattice__seam": 0.04, "body__border": 1.0}, {"lattice__outline": {"circle": 1.6}},
    {"law__delta": [0.02, 0.0], "body__border": 0.5},
    {"law__delta": [0.02, 0.0], "lattice__aperture": "aligned", "lattice__seam": 0.03},
]  # fmt: skip


@pytest.mark.parametrize("changes", EDGED, ids=str)
def test_a_joint_is_one_surface_from_both_sides_lens_on_its_cells_and_land_beyond(changes):
    """Both bodies end there, at the sag of the conic in the optical zone and one plane elsewhere."""
    sheet, rng = window("curved-joints", **changes), np.random.default_rng(3)
    x, y = rng.uniform(-0.25, 0.25, (2, 400))
    half = 0.25 - 0.5 * sheet.land.seam
    for before, behind, spec in zip(sheet.bodies, sheet.bodies[1:], design("curved-joints").pair.face[1:]):
        low, high = (face_height(sheet, face, x, y) for face in (before.back, behind.front))
        assert (low == high).all()
        c, (dx, dy, dz) = spec.curvature[0], before.back.vertex
        r2 = (x - dx) ** 2 + (y - dy) ** 2
        lens = dz + c * r2 / (1.0 + np.sqrt(1.0 - (1.0 + spec.conic[0]) * c * c * r2))
        zone = np.maximum(abs(x), abs(y)) < half
        assert low[zone] == pytest.approx(lens[zone], abs=1e-14)
        assert zone.all() or set(low[~zone]) == {before.back.land}
        assert before.back.land == behind.front.land < low[zone].min()


@pytest.mark.parametrize("changes", EDGED, ids=str)
def test_both_tracers_agree_where_joints_have_land(changes):
    sheet = window("curved-joints", **changes)
    rays = rays_over(sheet, 0.6)
    plain, compiled = (clacad.trace(sheet, rays, path=path, record=True) for path in ("numpy", "numba"))
    assert (plain.fate == compiled.fate).all()
    assert {int(Fate.LAND), int(Fate.ALIVE)} <= set(plain.fate.tolist())
    assert np.abs(plain.direction - compiled.direction).max() < 1e-11
    assert np.abs(plain.hits - compiled.hits).max() < 1e-11


def test_faces_that_cross_are_named_with_what_would_part_them():
    data = design("flat-joints").given
    faces = [dict(face) for face in data["pair"]["face"]]
    faces[1]["z"] = 0.02
    with pytest.raises(DesignError, match="faces 1 and 2 cross"):
        clacad.prescribe(Design.from_dict({**data, "pair": {**data["pair"], "face": faces}}))


def test_faces_on_cells_of_a_field_lens_lie_on_the_line_between_the_cells():
    """Two weak field faces at the middle of a PMMA slab: half way to the cells of array 2, aimed ones too."""
    middle = [
        {"radius": -200, "after": 7.4, "array": "field", "behind": "air"},
        {"radius": 200, "after": 0.05, "array": "field", "behind": "PMMA"},
    ]
    lens = {"radius": 2.4693, "conic": -0.4481, "array": 1, "behind": "PMMA"}
    faces = [lens, *middle, {**lens, "radius": -2.4693, "array": 2, "after": 7.4, "behind": "air"}]
    pair = {"form": "plates", "wavelength": "546.1 nm", "face": faces}
    base = {**design("flat-joints").given, "pair": pair}
    sheet = clacad.prescribe(
        Design.from_dict({**base, "lattice": {"pitch": 0.5, "count": 4, "aperture": [0.02, 0.0]}})
    )
    first, last, field = sheet.shifts
    assert field[0] == pytest.approx(0.5 * last[0], rel=0.02)
    assert (first, field[1], last[1]) == ((0.0, 0.0), 0.0, 0.0)
    assert sheet.thin.field
    aimed = clacad.prescribe(
        Design.from_dict({**base, "lattice": {"pitch": 0.5, "count": 4, "aperture": {"point": [0, 0, -400]}}})
    )
    first, last, field = (aimed.centres(k, aimed.lattice.cells()) for k in range(3))
    assert np.abs(last - first).max() > 0.01
    assert np.abs(2.0 * field - first - last).max() < 0.02 * np.abs(last - first).max()


TILTED = {"law__euler": [20.0, 3.0, 10.0], "law__delta": [0.01, -0.004]}


def test_plates_without_planes_are_tilted_as_one_rigid_body():
    """Rays turned with the lens axes leave turned with them, to rounding."""
    level, tilted = window("two-plates", law__delta=[0.01, -0.004]), window("two-plates", **TILTED)
    turn, rng = tilted.law.rotation, np.random.default_rng(8)
    start = np.column_stack([rng.uniform(-0.15, 0.15, (200, 2)), np.full(200, -1.0)])
    ray = np.column_stack([rng.uniform(-0.05, 0.05, (200, 2)), np.ones(200)])
    plain, turned = (
        trace_sequence(interfaces(sheet), clacad.Rays(start @ by.T, ray @ by.T))
        for sheet, by in ((level, np.eye(3)), (tilted, turn))
    )
    assert (plain.fate == Fate.ALIVE).all()
    assert (turned.fate == Fate.ALIVE).all()
    assert np.abs(turned.direction - plain.direction @ turn.T).max() < 1e-12
    assert np.abs(turned.position - plain.position @ turn.T).max() < 1e-12


def test_the_axis_of_tilted_lenses_bends_at_joints_of_planes_and_leaves_as_it_came():
    """Snell at every plane by hand: the ray along the axis meets every vertex and no lens bends it."""
    sheet = window("flat-joints", law__euler=[20.0, 3.0, 10.0])
    axis = sheet.law.rotation[:, 2]
    seen = trace_sequence(interfaces(sheet), clacad.Rays([-axis], [axis]), record=True)
    assert np.abs(seen.direction[0] - axis).max() < 1e-15
    index = [body.index for body in sheet.bodies]
    sines = np.sin(np.radians(3.0)) * np.array([1.0, index[0] / index[1], 1.0])
    lengths = np.diff([0.0, *(face.z or 0.0 for face in design("flat-joints").pair.face[1:])])
    assert sheet.bodies[-1].back.vertex[2] == pytest.approx(
        float(lengths @ np.sqrt(1.0 - sines**2)), rel=1e-12
    )
    x, y = (np.array(sheet.bodies[-1].back.vertex) + [*sheet.shifts[1], 0.0])[:2]
    assert np.hypot(x, y) == pytest.approx(float(lengths @ sines), rel=1e-9)


@pytest.mark.parametrize(
    "changes",
    [TILTED, pytest.param({**TILTED, "lattice__seam": 0.04, "body__border": 0.5}, marks=pytest.mark.slow)],
    ids=["plain", "seam"],
)
def test_both_tracers_agree_on_tilted_plates(changes):
    sheet = window("flat-joints", **changes)
    rays = rays_over(sheet, 0.3, 1500)
    plain, compiled = (clacad.trace(sheet, rays, path=path) for path in ("numpy", "numba"))
    assert (plain.fate == compiled.fate).all()
    assert {int(Fate.ALIVE), int(Fate.GHOST)} <= set(plain.fate.tolist())
    assert np.abs(plain.direction - compiled.direction).max() < 1e-11


def test_planes_that_leave_the_axis_bent_are_refused():
    faces = [
        {"radius": "inf", "behind": "PMMA"}, {"radius": -1.0, "array": 1, "after": 1.0, "behind": "air"},
        {"radius": 1.0, "array": 2, "after": 4.0, "behind": "PMMA"}, {"radius": -4.0, "array": 2, "after": 1.0, "behind": "air"},
    ]  # fmt: skip
    assert window("two-plates", pair__face=faces).uniform
    with pytest.raises(DesignError, match="planes bend the axis"):
        window("two-plates", pair__face=faces, **TILTED)


def test_a_list_with_planes_under_cells_that_lean_differently_is_refused(tmp_path):
    """Without planes each cell leans about its own axis; planes would have to bend each of them."""
    plane = "".join(
        f"[[pair.face]]\nafter = 1.0\nradius = 'inf'\nbehind = '{glass}'\n"
        for glass in ("Fused silica", "PMMA")
    )
    (tmp_path / "t.csv").write_text("i,j,delta_x,delta_y,theta\n0,0,0,0,0\n1,0,0,0,1\n")

    def sheet(planes, last):
        (tmp_path / "d.toml").write_text(
            'format = 1\nname = "leaning"\nunit = "mm"\n[law]\neta = [-1, -1]\nvarying = {table = "t.csv"}\n'
            '[pair]\nform = "plates"\n[[pair.face]]\nz = 0\nradius = [1.0, 1.0]\narray = 1\nbehind = "PMMA"\n'
            f"{planes}[[pair.face]]\nafter = {last}\nradius = [-1.0, -1.0]\narray = 2\n"
            'behind = "air"\n[lattice]\npitch = 0.5\ncount = [2, 1]\n[check]\nprocess = "none"\n'
        )
        return clacad.prescribe(clacad.load(str(tmp_path / "d.toml")))

    assert not sheet("", 6.06).uniform
    with pytest.raises(DesignError, match="CL114: cells lean by different angles over planes"):
        sheet(plane, 4.06)
