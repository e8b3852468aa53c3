"""Sheets behind one another: their positions, rays through all of them, the images of space and objects."""

from __future__ import annotations

import json
from dataclasses import replace
from math import atan
from pathlib import Path

import numpy as np
import pytest
from mpmath import mp, mpf
from oracle import trace as oracle

import clacad
from clacad import Fate, Rays
from clacad.base.sobol import sobol
from clacad.sheet.stack import BadStack, StackedSheet, lens_planes, stacked, standing
from clacad.stacking import chief_matrices, stack
from clacad.stacking.chief_matrices import meridian
from clacad.stacking.stack_light import measure_image, measure_light, nearest_point
from clacad.tracing.through_stack import StackTracer, launched, trace_stack

ROOT = Path(__file__).parents[2]
GOLDEN = json.loads((ROOT / "tests" / "data" / "stack.json").read_text(encoding="utf-8"))
DESIGN = clacad.load(ROOT / "designs" / "window-100mm.toml")
WINDOW = clacad.prescribe(DESIGN)
FIELD = atan(0.02)
"""Slopes of ± .02, as of the independent prototype whose numbers are cited below."""


def silent(*_: object) -> None:
    """Print nothing."""


def windows(*etas: float) -> list[clacad.Window]:
    """The 100 mm window with other eta, isotropic; equal ones are one."""
    made = {
        eta: WINDOW if eta == -1.0 else clacad.prescribe(DESIGN.replace("law.eta", [eta, eta]))
        for eta in etas
    }
    return [made[eta] for eta in etas]


def alive_by_hand(etas, gap, place, slope, s=10.0, pitch=0.5):
    """Thin lenses with cells in one meridian, written from t' = t − x/f: who meets the partner in every sheet, and B."""
    good = np.ones(len(place), dtype=bool)
    x, t = place.copy(), slope.copy()
    for number, eta in enumerate(etas):
        f1, f2 = s / (1.0 - eta), -eta * s / (1.0 - eta)
        cell = np.floor(x / pitch + 0.5)
        t = t - (x - cell * pitch) / f1
        x = x + s * t
        good &= np.floor(x / pitch + 0.5) == cell
        t = t - (x - np.floor(x / pitch + 0.5) * pitch) / f2
        if number < len(etas) - 1:
            x = x + gap * t
    return good, x, t


def thin_share_by_hand(etas, gap, count=2000):
    """Share of one meridian through thin cells: a regular grid of places in a cell and of slopes up to ± .02."""
    middles = (np.arange(count) + 0.5) / count
    place, slope = np.meshgrid(0.5 * (middles - 0.5), 0.02 * (2.0 * middles - 1.0))
    return float(alive_by_hand(etas, gap, place.ravel(), slope.ravel())[0].mean())


@pytest.mark.daily_cases("etas1-0.2-2")
@pytest.mark.parametrize(
    ("etas", "product", "column"),
    [((-1.0, -1.0), 1 - 0.4 + 0.16 / 3, 0), ((0.2, 5.0), 1 / 5, 2)],  # ⟨(1 − 20|t|)²⟩; all, then a fifth
)
def test_shares_of_thin_lenses_in_the_documentation_are_those_of_plain_rays(etas, product, column):
    """Two sheets 100 mm apart: rays find less than the product of what each sheet passes of a direction."""
    rays = thin_share_by_hand(etas, 100.0)
    assert rays < product
    lines = (ROOT / "docs/how-to/stack.md").read_text(encoding="utf-8").splitlines()
    for name, share in (("thin lenses, by rays", rays), ("shares of the thin sheets, closed form", product)):
        printed = next(line for line in lines if name in line).split("|")[2 + column]
        assert [float(part) for part in printed.split(";")] == [round(share, 3), round(share**2, 3)]


# --- chief rays -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", GOLDEN["cases"], ids=lambda c: "+".join(s["eta"] for s in c["sheets"]))
def test_matrices_and_images_are_those_of_the_reference(case):
    sheets = [
        chief_matrices.sheet(float(s["eta"]), float(s["separation"]), kappa=float(s["kappa"]))
        for s in case["sheets"]
    ]
    row = [sheets[0]]
    for gap, sheet in zip(case["gaps"], sheets[1:], strict=True):
        row += [chief_matrices.space(float(gap)), sheet]
    found, tolerance = chief_matrices.in_a_row(row), GOLDEN["tolerance"]
    expected = np.array([[float(v) for v in line] for line in case["matrix"]])
    np.testing.assert_allclose(found.matrix, expected, rtol=tolerance, atol=tolerance)
    assert found.determinant == pytest.approx(float(case["determinant"]), rel=tolerance)
    beyond, _, size = found.image(-float(case["object_z"]))
    assert beyond == pytest.approx(float(case["image_distance_from_last_array"]), rel=tolerance)
    assert size == pytest.approx(float(case["magnification"]), rel=tolerance)
    if "acts_as_space_of_length" in case:
        assert found.matrix[0, 1] == pytest.approx(float(case["acts_as_space_of_length"]), rel=tolerance)
        nearer = float(case["length"]) - found.matrix[0, 1]
        assert nearer == pytest.approx(float(case["image_moves_towards_viewer_by"]), rel=tolerance)


PENCIL = {
    # (eta, s, kappa, delta) of each sheet; gaps; A, B, C, D; place and slope of the ray that enters at 0, 0
    "a sheet that focuses": ([(-0.5, 10, 0.01, 0)], [], (1, 10, 0.02, -2), (0, 0)),
    "negative space": ([(-1, 6, 0, 0)] * 2, [40], (1, -40, 0, 1), (0, 0)),
    "compressed space": ([(2, 8, 0, 0), (0.5, 8, 0, 0)], [20], (1, 22, 0, 1), (0, 0)),
    "stretched space": ([(0.5, 8, 0, 0), (2, 8, 0, 0)], [20], (1, 64, 0, 1), (0, 0)),
    "offsets add up": ([(-0.5, 10, 0, 0.01)] * 2, [30], (1, -70, 0, 4), (0.8, -0.02)),
    "imaging pair": ([(-1, 10, -0.02, 0)] * 2, [90], (-1, -90, 0.036, 2.6), (0, 0)),
    "relay, parallel light stays parallel": (
        [(-0.5, 10, -0.02, 0), (-0.5, 10, 0.04, 0)], [50], (-1.4, -110, 0, -3.2), (0, 0)
    ),
    "telescope": ([(-1, 0, 0.05, 0), (0.5, 0, 1 / 60, 0)], [40], (3, -40, 0, -2 / 3), (0, 0)),
    "cloak of three": (
        [(-2, 0, -1 / 25, 0), (1 / 3, 0, 2 / 75, 0), (-1.5, 0, 1 / 50, 0)], [100, 100], (1, 200, 0, 1), (0, 0)
    ),
    "three sheets of three lengths": (
        [(-1, 1, 0.1, 0), (0.5, 2, 0, 0), (-2, 3, 0.2, 0)], [10, 20], (6.8, -57, 0.52, -4.1), (0, 0)
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", PENCIL.values(), ids=PENCIL)
def test_ten_stacks_have_the_matrices_worked_out_by_pencil(case):
    """Two rays, (1, 0) and (0, 1), followed through t' = (t - delta - kappa x)/eta and x' = x + s t."""
    sheets, gaps, (a, b, c, d), shift = case
    made = [chief_matrices.sheet(eta, s, delta, kappa) for eta, s, kappa, delta in sheets]
    row = [made[0]]
    for gap, one in zip(gaps, made[1:], strict=True):
        row += [chief_matrices.space(gap), one]
    found = chief_matrices.in_a_row(row)
    np.testing.assert_allclose(found.matrix, [[a, b], [c, d]], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.shift, shift, atol=1e-14)


@pytest.mark.parametrize("case", PENCIL.values(), ids=PENCIL)
def test_rays_through_ideal_cells_keep_to_the_ten_matrices_within_their_blur(case):
    """Two thin lenses in every cell of .01, f1 + f2 = s, the second displaced by (delta + kappa c) f1.

    A ray at a from the middle c of its cell leaves as the chief ray of c does, moved by a (eta - 1); so it is
    off the matrix by that and by kappa a/eta in slope, which later sheets and gaps carry on.
    """
    sheets, gaps, (a, b, c, d), shift = case
    pitch, few = 0.01, 20000
    rng = np.random.default_rng(5)
    first = np.stack([rng.uniform(-3.0, 3.0, few), rng.uniform(-0.02, 0.02, few)])
    x, t, room = first[0].copy(), first[1].copy(), np.zeros(2)
    for (eta, s, kappa, delta), gap in zip(sheets, [*gaps, 0.0], strict=True):
        middle = pitch * np.rint(x / pitch)
        offset = delta + kappa * middle
        if s:
            f1 = s / (1.0 - eta)
            inside = t - (x - middle) / f1
            x = x + s * inside
            t = inside - (x - middle - offset * f1) / (-eta * f1)
        else:  # lenses of no length: their law alone
            x, t = x + (eta - 1.0) * (x - middle), (t - offset) / eta
        blur = 0.5 * pitch * np.array([abs(1.0 - eta), abs(kappa / eta)])
        room = np.abs([[1.0, s], [-kappa / eta, 1.0 / eta]]) @ room + blur
        x, room = x + gap * t, np.array([[1.0, gap], [0.0, 1.0]]) @ room
    made = [chief_matrices.sheet(eta, s, delta, kappa) for eta, s, kappa, delta in sheets]
    row = [made[0]]
    for gap, one in zip(gaps, made[1:], strict=True):
        row += [chief_matrices.space(gap), one]
    found = chief_matrices.in_a_row(row)
    off = np.stack([x, t]) - found.matrix @ first - np.array(found.shift)[:, None]
    assert (np.abs(off) <= room[:, None] + 1e-12).all()
    assert np.abs(off[0]).max() > 0.2 * room[0]  # and the blur is of that size
    assert np.abs(off.mean(axis=1)) == pytest.approx(0.0, abs=0.05 * room.max())
    fitted = np.linalg.lstsq(np.vstack([first, np.ones(few)]).T, np.stack([x, t]).T, rcond=None)[0].T
    np.testing.assert_allclose(
        fitted[:, :2], [[a, b], [c, d]], rtol=0.03, atol=0.03 * max(map(abs, (a, b, c, d)))
    )
    np.testing.assert_allclose(fitted[:, 2], shift, atol=0.05 * room.max())


def test_an_imaging_pair_with_kappa_images_by_pencil():
    """100 before (-1, -90; .036, 2.6): B is -190, D is 6.2, so the image is 950/31 behind, 16/155 as large."""
    one = chief_matrices.sheet(-1.0, 10.0, kappa=-0.02)
    pair = chief_matrices.in_a_row([one, chief_matrices.space(90.0), one])
    assert pair.determinant == pytest.approx(0.64, rel=1e-12)  # of each sheet (1 + s kappa)/eta = -.8
    assert pair.image(100.0) == pytest.approx((950 / 31, 0.0, 16 / 155), rel=1e-12)


@pytest.mark.parametrize(("etas", "gap"), [((-1.0, -1.0), 100.0), ((0.5, -0.25), 37.0)])
def test_slabs_have_the_matrices_of_their_air_equivalents(etas, gap):
    """A gap is what is clear between vertices: a slab of thickness n s acts over s."""
    made = meridian(stacked(windows(*etas), [gap]), 0)
    assert made is not None
    first, second = windows(*etas)
    sink = (
        first.z_range[1]
        - first.bodies[0].back.vertex[2]
        + second.bodies[0].front.vertex[2]
        - second.z_range[0]
    )
    expected = 10.0 + (gap + sink) / etas[0] + 10.0 / etas[0]
    assert made.matrix[0, 1] == pytest.approx(expected, rel=1e-12)


def test_tilted_sheets_have_no_meridians_and_are_measured_all_the_same():
    tilted = clacad.prescribe(clacad.load(ROOT / "designs" / "tilted.toml"))
    light = measure_light([StackTracer(stacked([tilted, tilted], [1.0]), "surfaces")], 512, 0.005, silent)[0]
    assert light.meridians[0].matrix is None
    assert 0.0 <= light.share <= 1.0


def test_lens_planes_are_where_a_thick_lens_seems_to_bend():
    """Parallel light through lens 2 alone, nearly on the axis: where its straight continuations cross."""
    window = clacad.prescribe(clacad.load(ROOT / "designs" / "paper-a-covered.toml"))
    body = window.bodies[1]
    h = 1e-7
    faces = [
        clacad.Interface(body.front.surface, body.front.vertex, 1.0, body.index),
        clacad.Interface(body.back.surface, body.back.vertex, body.index, 1.0),
    ]
    for axis in (0, 1):
        start = np.zeros(3)
        start[axis], start[2] = h, body.front.vertex[2] - 1e-3
        out = clacad.trace_sequence(faces, Rays(start[None], [[0.0, 0.0, 1.0]]))
        slope = out.direction[0, axis] / out.direction[0, 2]
        bends_at = out.position[0, 2] + (h - out.position[0, axis]) / slope
        assert lens_planes(window)[1][axis] == pytest.approx(bends_at, abs=1e-9)


# --- positions of sheets ----------------------------------------------------------------------------------


def test_gaps_are_clear_distances_whatever_the_units():
    small = clacad.prescribe(clacad.load(ROOT / "designs" / "paper-a-covered.toml"))  # in metres
    made = stacked([WINDOW, small, WINDOW], [3.0, 4.0])
    assert made.gaps == pytest.approx((3.0, 4.0), rel=1e-12)
    assert made.sheets[1].scale == pytest.approx(1000.0)
    assert made.sheets[1].span[0] == pytest.approx(WINDOW.z_range[1] + 3.0)


@pytest.mark.parametrize(
    ("gaps", "message"),
    [([-1.0], "the gap before sheet b is -1"), ([float("nan")], "is nan"), ([float("inf")], "is inf"), ([], "0 gaps for 2 sheets"),
     ([1.0, 2.0], "2 gaps for 2 sheets")],
)  # fmt: skip
def test_gaps_that_are_none_are_refused(gaps, message):
    with pytest.raises(BadStack, match=message):
        stacked([WINDOW, WINDOW], gaps)


def test_sheets_that_overlap_are_refused_with_the_place_that_would_do():
    sheets = [StackedSheet("front", WINDOW, 0.0), StackedSheet("back", WINDOW, 10.0)]
    with pytest.raises(BadStack, match=r"sheet back .* overlaps sheet front .* sheet\.back\.z >= ") as caught:
        standing(sheets, 1e-3, "mm")
    z = float(str(caught.value).split(">= ")[1].split()[0])
    made = standing([replace(sheets[1], z=z + 1e-6), sheets[0]], 1e-3, "mm")
    assert [one.id for one in made.sheets] == ["front", "back"]


# --- rays -------------------------------------------------------------------------------------------------


def test_a_stack_of_one_sheet_is_that_sheet():
    rays = launched(stacked([WINDOW], []), 2000, 0.05)
    one, alone = (
        trace_stack(stacked([WINDOW], []), rays, path="numpy"),
        clacad.trace(WINDOW, rays, path="numpy"),
    )
    for name in ("position", "direction", "fate", "optical_path"):
        np.testing.assert_array_equal(getattr(one, name), getattr(alone, name))


def test_touching_sheets_obey_the_laws_one_after_the_other():
    first, second = windows(-0.5, 0.25)
    made = stacked([first, second], [0.0])
    rays = launched(made, 500, 0.02)
    found = trace_stack(made, rays, "law")
    asked = first.law.then(second.law).refract(rays.direction)
    np.testing.assert_allclose(found.direction, asked, atol=4e-16)


@pytest.mark.parametrize("etas", [(-1.0, -1.0), (0.5, -0.25), (0.2, 5.0)])
def test_ideal_lenslets_pass_what_a_few_lines_by_hand_pass(etas):
    """Fates, places and slopes of rays in the x–z plane against thin lenses written from scratch."""
    made = stacked(windows(*etas), [100.0])
    first, last = made.sheets[0].lens_planes[0], made.sheets[-1].lens_planes[1]
    air = made.sheets[1].lens_planes[0] - made.sheets[0].lens_planes[1]
    u = sobol(4000, 2)
    place, slope = 0.25 + (u[:, 0] - 0.5) * 0.5, (2.0 * u[:, 1] - 1.0) * 0.02
    start = np.column_stack([place - slope, np.full(len(u), 0.25), np.full(len(u), first - 1.0)])
    found = trace_stack(
        made, Rays(start, np.column_stack([slope, np.zeros(len(u)), np.ones(len(u))])), "thin"
    )
    good, x, t = alive_by_hand(etas, air, place - 0.25, slope)
    edge = np.abs(np.abs((x / 0.5) % 1.0 - 0.5)) < 1e-9
    np.testing.assert_array_equal((found.fate == Fate.ALIVE)[~edge], good[~edge])
    out = found.direction[:, 0] / found.direction[:, 2]
    at = found.position[:, 0] + out * (last - found.position[:, 2])
    np.testing.assert_allclose(out[good & ~edge], t[good & ~edge], atol=1e-12)
    np.testing.assert_allclose(at[good & ~edge] - 0.25, x[good & ~edge], atol=1e-10)


def exactly(made, found, row):
    """Direction of a ray through the very surfaces it met, in 50 digits."""
    faces = []
    for one, (rows, result) in zip(made.sheets, found.passed, strict=True):
        k = int(np.flatnonzero(rows == row)[0])
        for body in one.window.bodies:
            for face, before, after in ((body.front, 1.0, body.index), (body.back, body.index, 1.0)):
                x, y, z = (mpf(v) for v in face.vertex)
                if face.array is not None:
                    index = result.cell[k].astype(np.int64) + (result.order[k] if face.array else 0)
                    centre = one.window.lattice.centres(index[None])[0] + np.asarray(
                        one.window.shifts[face.array]
                    )
                    x, y = x + mpf(float(centre[0])), y + mpf(float(centre[1]))
                s = face.surface
                faces.append(oracle.quadric(s.curvature_x, s.curvature_y, s.kappa, s.side, vertex=(x, y, z + mpf(one.z)),
                                            before=before, after=after))  # fmt: skip
    return faces


@pytest.mark.parametrize("gap", [0.0, 100.0, 2500.0], ids=["touching", "100 mm", "5000 pitches"])
def test_exact_rays_through_two_sheets_keep_to_fifty_digits(gap):
    """However far the sheets are apart: 8.3e-16 rad at most were seen over 200 rays of each gap."""
    made = stacked([WINDOW, WINDOW], [gap])
    rays = launched(made, 4096, 0.004)
    found = trace_stack(made, rays)
    rows = np.flatnonzero(found.fate == Fate.ALIVE)[:20]
    assert len(rows) == 20
    with mp.workdps(50):
        for row in rows:
            path = oracle.trace(exactly(made, found, row), rays.position[row], rays.direction[row], digits=50)
            assert path.status == "ok"
            away = max(
                abs(mpf(float(a)) - b) for a, b in zip(found.direction[row], path.directions[-1], strict=True)
            )
            assert away < 4e-15


def test_a_ray_is_what_the_worst_of_its_sheets_made_of_it():
    made = stacked([WINDOW, WINDOW.with_cells((8, 8))], [100.0])
    rays = launched(made, 20_000, 0.03)
    found = trace_stack(made, rays)
    (_, first), (rows, second) = found.passed
    assert sum(found.counts().values()) == len(rays)
    np.testing.assert_array_equal(found.fate == Fate.ALIVE, _both(len(rays), first, rows, second))
    missed = found.fate == Fate.MISSED
    assert missed.any()
    assert (found.ended[missed] == 1).all()
    # where a ray leaves the first sheet is where it ended
    np.testing.assert_allclose(found.position[missed], first.position[missed], atol=1e-12)
    ghost = np.flatnonzero(first.fate == Fate.GHOST)
    assert not (found.fate[ghost] == Fate.ALIVE).any()


def _both(many, first, rows, second):
    alive = np.zeros(many, dtype=bool)
    alive[rows] = second.fate == Fate.ALIVE
    return alive & (first.fate == Fate.ALIVE)


def test_the_same_stack_in_other_units_sends_light_the_same_way():
    metres = clacad.prescribe(_in_metres())
    mixed, plain = stacked([WINDOW, metres], [50.0]), stacked([WINDOW, WINDOW], [50.0])
    rays = launched(plain, 2000, 0.02)
    one, other = trace_stack(mixed, rays), trace_stack(plain, rays)
    same = one.fate == other.fate
    assert same.mean() > 0.999
    np.testing.assert_allclose(one.direction[same], other.direction[same], atol=1e-11)
    np.testing.assert_allclose(one.position[same], other.position[same], atol=1e-9)
    np.testing.assert_allclose(one.optical_path[same], other.optical_path[same], rtol=1e-12)


def _in_metres():
    """The window with its lengths in metres."""
    text = (ROOT / "designs" / "window-100mm.toml").read_text(encoding="utf-8")
    for mm, metres in (
        ('unit = "mm"', 'unit = "m"'),
        ("separation = 10.0 ", 'separation = "10 mm" '),
        ("pitch = 0.5", 'pitch = "0.5 mm"'),
    ):
        assert mm in text
        text = text.replace(mm, metres)
    import tomllib

    return clacad.Design.from_dict(tomllib.loads(text))


@pytest.mark.parametrize(("rung", "most"), [("thin", 3e-4), ("surfaces", 0.0), ("law", 3e-3)])
def test_every_rung_goes_through_all_sheets(rung, most):
    made = stacked([WINDOW, WINDOW], [100.0])
    rays = launched(made, 4000, 0.004)
    found, truth = trace_stack(made, rays, rung), trace_stack(made, rays)
    both = (found.fate == Fate.ALIVE) & (truth.fate == Fate.ALIVE)
    assert both.any()
    assert np.sqrt(np.mean((found.direction - truth.direction)[both] ** 2)) <= most


@pytest.mark.slow
def test_facets_of_every_sheet_are_traced_in_a_row():
    few = WINDOW.with_cells((6, 6))
    made = stacked([few, few], [5.0])
    rays = launched(made, 400, 0.004)
    found, truth = trace_stack(made, rays, "mesh", mesh=32), trace_stack(made, rays)
    both = (found.fate == Fate.ALIVE) & (truth.fate == Fate.ALIVE)
    assert both.mean() > 0.8
    assert np.abs((found.direction - truth.direction)[both]).max() < 0.02


def test_lens_planes_within_one_another_are_refused_on_ideal_rungs_alone():
    plate = clacad.prescribe(clacad.load(ROOT / "designs" / "plano.toml"))
    made = stacked([plate, plate], [0.0])
    crossed = replace(made, sheets=(made.sheets[0], replace(made.sheets[1], z=made.sheets[1].z - 5.0)))
    with pytest.raises(BadStack, match="rung thin cannot distinguish them"):
        StackTracer(crossed, "thin")
    StackTracer(crossed, "surfaces")


# --- the two worked examples ------------------------------------------------------------------------------


@pytest.mark.slow
def test_two_sheets_of_minus_one_are_negative_space():
    """An independent prototype of thin cells: share .65 an axis, B = −99.0, position scatter .69 p."""
    made = stacked(windows(-1.0, -1.0), [100.0])
    thin, exact = measure_light(
        [StackTracer(made, rung) for rung in ("thin", "surfaces")], 1 << 15, FIELD, silent
    )
    axis = thin_share_by_hand((-1.0, -1.0), 100.0)
    error = (axis * (1.0 - axis) / thin.rays) ** 0.5
    for one in thin.meridians:
        assert one.acts_as_space == pytest.approx(-100.0, rel=1e-12)
        assert one.length == pytest.approx(
            2 * 14.9362867285548 + 100.0, rel=1e-12
        )  # slabs n s thick, and the gap
        assert one.moves_image == pytest.approx(one.length + 100.0, rel=1e-12)  # as pictures of it show
        assert one.share == pytest.approx(axis, abs=5.0 * error)
        assert one.measured_space == pytest.approx(-99.0, abs=0.2)
        assert one.scatter == pytest.approx(0.69, abs=0.01)
    assert thin.expected_share == pytest.approx(
        (1 - 0.4 + 0.16 / 3) ** 2, abs=1e-4
    )  # (1 − 20|t|)², the mean over ± .02
    assert thin.share == pytest.approx(axis**2, abs=5.0 * error)
    assert exact.share == pytest.approx(thin.share, abs=0.01)
    assert exact.meridians[0].measured_space == pytest.approx(-99.2, abs=0.3)
    assert thin.error < 1e-3


@pytest.mark.daily_cases("slab")
@pytest.mark.parametrize("form", ["slab", "biconvex"])
def test_field_lenses_give_each_sheet_its_light_and_a_stack_all_of_its_space(form):
    """Prototype: share .649 to 1.000 an axis, B = −100.02: chief rays cross a sheet from a middle to a middle, B = G/η."""
    keys = {"pair.field_lens": True, "pair.form": form, "lattice.count": [201, 201], "check.process": "none"}
    window = clacad.prescribe(
        DESIGN.replace(keys | ({"pair.thickness": "auto"} if form == "biconvex" else {}))
    )
    made = stacked([window, window], [100.0])
    tracers = [StackTracer(made, rung) for rung in ("thin", "surfaces")]
    thin, exact = measure_light(tracers, 1 << 15, FIELD, silent)
    first, last = lens_planes(window)
    space = (
        100.0 + first[0] - last[0] + (window.z_range[1] - window.z_range[0])
    )  # from lens planes to lens planes
    for one, real in zip(thin.meridians, exact.meridians):
        assert one.acts_as_space == pytest.approx(-space, rel=1e-12)
        assert one.beams == one.acts_as_space
        assert one.measured_space == pytest.approx(-space, abs=0.3)
        assert real.measured_space == pytest.approx(-space, rel=0.005 if form == "slab" else 0.01)
        assert one.share == pytest.approx(1.0, abs=1e-3)
        assert real.share > 0.99
        assert one.moves_image == pytest.approx(one.length + space, rel=1e-12)
    assert exact.share > 0.99


def test_light_off_the_axis_leaves_a_sheet_with_a_field_lens_in_the_middle_of_its_partner():
    """δ and an aperture put array 2 aside: by ideal rays through the middles of lenses 1."""
    keys = {
        "pair.field_lens": True,
        "law.eta": [-0.5, -0.5],
        "law.delta": [0.02, -0.01],
        "check.process": "none",
    }
    window = clacad.prescribe(DESIGN.replace(keys | {"lattice.aperture": [0.01, 0.0]}))
    made = stacked([window], [])
    centre = np.append(window.lattice.centres(np.array([[100, 100]]))[0], made.sheets[0].lens_planes[0])
    slope = np.array([[0.0, 0.0], [0.02, 0.01], [0.03, -0.02]])
    direction = np.column_stack([slope, np.ones(3)])
    out = clacad.trace_stack(made, Rays(centre - 5.0 * direction, direction), rung="thin")
    assert (out.fate == Fate.ALIVE).all()
    gone = (made.sheets[0].lens_planes[1] - out.position[:, 2]) / out.direction[:, 2]
    left = (out.position + gone[:, None] * out.direction)[:, :2] - centre[:2]
    for axis in (0, 1):
        found = meridian(made, axis)
        for row in range(3):
            x, t = found.matrix @ [0.0, slope[row, axis]] + found.shift
            assert left[row, axis] == pytest.approx(x, abs=1e-9)
            assert out.direction[row, axis] / out.direction[row, 2] == pytest.approx(t, abs=1e-12)


def test_a_fifth_and_five_compress_space_as_far_as_the_second_sheet_chooses_rays():
    """B = s + G/η + s/(η η') in the middle of the light that the second sheet passes, a fifth of it an axis."""
    made = stacked(windows(0.2, 5.0), [100.0])
    thin, _ = measure_light(
        [StackTracer(made, rung) for rung in ("thin", "surfaces")], 1 << 15, FIELD, silent
    )
    sunk = made.sheets[1].lens_planes[0] - made.sheets[0].lens_planes[1] - 100.0
    for one in thin.meridians:
        assert one.acts_as_space == pytest.approx(10.0 + (100.0 + sunk) / 0.2 + 50.0, rel=1e-12)
        assert one.beams == pytest.approx(10.0 + (100.0 + sunk) / 0.2 + 10.0, rel=1e-12)
        assert one.measured_space == pytest.approx(one.beams, rel=0.005)
        assert one.share == pytest.approx(0.2, abs=0.01)


def test_a_point_is_imaged_where_chief_rays_say():
    made = stacked(windows(-1.0, -1.0), [100.0])
    seen = measure_image(StackTracer(made, "surfaces"), 1 << 14, FIELD, 300.0)
    assert seen.predicted == pytest.approx((-200.0, -200.0), rel=1e-12)
    assert seen.magnification == pytest.approx((1.0, 1.0), rel=1e-12)
    assert seen.point is not None
    assert seen.point[2] == pytest.approx(-200.0, abs=3.0)
    assert np.hypot(*seen.point[:2]) < 1e-3
    assert seen.by_rays[0] == pytest.approx(seen.point[2], abs=0.1)


def test_the_nearest_point_of_lines_is_theirs_and_parallel_ones_have_none():
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(50, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    point = np.array([3.0, -2.0, 700.0])
    found, spread = nearest_point(point + rng.uniform(-9.0, 9.0, (50, 1)) * direction, direction)
    np.testing.assert_allclose(found, point, atol=1e-11)
    assert spread < 1e-11
    assert nearest_point(rng.normal(size=(5, 3)), np.tile([0.0, 0.0, 1.0], (5, 1)))[0] is None


def test_equal_designs_are_one_window_and_numbers_are_the_same_every_time():
    one, again = (stack([DESIGN, DESIGN], 100, rays=512, cells=(20, 20)) for _ in range(2))
    assert one.stack.sheets[0].window is one.stack.sheets[1].window
    assert json.dumps(one.to_dict(), sort_keys=True, default=str) == json.dumps(
        again.to_dict(), sort_keys=True, default=str
    )
    assert one.share == one.exact.share
