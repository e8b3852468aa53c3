"""Non-uniform sheets: positions of the cells of an array, and of the lenses in them."""

import hashlib
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import clacad
from clacad.optics.rays import Fate
from clacad.sheet.cell_places import CellPlacement, VertexChange
from clacad.sheet.need_window import CellsDiffer
from clacad.tracing.layout import lay_out
from clacad.tracing.reference.launch import cell_in

SCALE = 1.0 + 1.0 / 40.0


def stretched(name="window-100mm", scale=SCALE, shift=(0.013, -0.007), **changes):
    """A window whose array 2 is wider by `scale`, its lenses over those of array 1."""
    window = clacad.prescribe(clacad.load(f"designs/{name}.toml"))
    pitch = tuple(p * scale for p in window.lattice.pitch)
    place = CellPlacement(shift, pitch)
    (gx, gy) = place.scale(window.lattice)
    change = VertexChange(((1.0 - gx, 0.0), (0.0, 1.0 - gy)))

    def moved(face):
        if face.array != 1:
            return face
        x, y, z = face.vertex
        return replace(face, vertex=(x - shift[0], y - shift[1], z), change=change)

    bodies = tuple(replace(b, front=moved(b.front), back=moved(b.back)) for b in window.bodies)
    return replace(window, bodies=bodies, placements=(CellPlacement(), place), **changes)


def exact_axis(lattice, index, axis):
    n, p = lattice.count[axis], lattice.pitch[axis]
    return Fraction(2 * int(index) - (n - 1)) * Fraction(p) / 2


@pytest.mark.parametrize("far", [0, 3, 10_000, 10**8])
def test_points_change_from_array_to_array_as_exact_fractions_say(far):
    window = stretched()
    window = replace(window, lattice=replace(window.lattice, count=(2 * far + 7, 2 * far + 7)))
    layout = lay_out(
        replace(
            window,
            bodies=tuple(
                replace(b, front=replace(b.front, change=None), back=replace(b.back, change=None))
                for b in window.bodies
            ),
        )
    )
    rng = np.random.default_rng(far)
    cell = rng.integers(0, 2 * far + 7, (200, 2))
    local = rng.uniform(-0.25, 0.25, (200, 2))
    for of, array in ((0, 1), (1, 0)):
        _, there, found = cell_in(layout, of, array, cell, local)
        for k in range(200):
            for axis in (0, 1):
                place = exact_axis(layout.lattices[of], cell[k, axis], axis) + Fraction(local[k, axis])
                place += Fraction(window.shifts[of][axis]) - Fraction(window.shifts[array][axis])
                own = place - exact_axis(layout.lattices[array], found[k, axis], axis)
                half = Fraction(layout.lattices[array].pitch[axis]) / 2
                assert -half <= own < half or abs(abs(own) - half) < Fraction(1, 2**60)
                assert abs(Fraction(there[k, axis]) - own) <= Fraction(1, 2**53) * abs(own) + Fraction(
                    1, 10**25
                )


def test_a_border_of_a_wider_array_belongs_to_the_cell_above_it():
    window = stretched(shift=(0.0, 0.0))
    layout = lay_out(window)
    wide = layout.lattices[1]
    index = np.array([[190, 100], [7, 3]])
    low = wide.centres(index) - 0.5 * np.asarray(wide.pitch)
    found, x, y = wide.locate(*low.T)
    exact = [
        [exact_axis(wide, i, k) - Fraction(wide.pitch[k]) / 2 for k, i in enumerate(row)] for row in index
    ]
    for row, (i, j), at in zip(low, found, exact, strict=True):
        for k, cell in enumerate((i, j)):
            assert cell == (
                index[np.flatnonzero((low == row).all(axis=1))[0], k] - (Fraction(row[k]) < at[k])
            )


@pytest.mark.parametrize("rung", ["surfaces", "thin"])
@pytest.mark.parametrize("name", ["window-100mm", "plano", "hexagonal", "tilted", "paper-a-covered"])
def test_an_array_of_the_same_pitch_said_in_words_of_its_own_traces_the_same(name, rung):
    """Pitch 1 × and no change of vertices take the other branch of every function, and must find the same light."""
    window = clacad.prescribe(clacad.load(f"designs/{name}.toml"))
    still = VertexChange()
    own = CellPlacement(window.shifts[1], tuple(p * (1.0 + 2.0**-50) for p in window.lattice.pitch))
    bodies = tuple(
        replace(
            b,
            front=replace(b.front, change=still if b.front.array == 1 else None),
            back=replace(b.back, change=still if b.back.array == 1 else None),
        )
        for b in window.bodies
    )
    differs = replace(
        window, bodies=bodies, placements=(CellPlacement(), own),
        thin=replace(window.thin, pitch=own.pitch, change=still),
    )  # fmt: skip
    assert window.uniform
    assert not differs.uniform
    rng = np.random.default_rng(5)
    x0, x1, y0, y1 = window.lattice.extent()
    at = np.column_stack(
        [rng.uniform(x0, x1, 3000), rng.uniform(y0, y1, 3000), np.full(3000, window.z_range[0])]
    )
    rays = clacad.Rays(at, np.column_stack([rng.normal(0.0, 0.06, (3000, 2)), np.ones(3000)]))
    one, two = (clacad.trace(w, rays, rung=rung, path="numpy") for w in (window, differs))
    same = (one.fate == two.fate) & (one.order == two.order).all(axis=1)
    assert same.mean() > 0.999  # rays within 1e-12 of a border may change sides
    alive = same & (one.fate == Fate.ALIVE)
    assert np.abs(one.direction - two.direction)[alive].max() < 1e-9


def test_a_lens_moved_in_its_cell_is_a_lens_moved():
    """Cell (150, 20) of the stretched window bends light as a homogeneous sheet whose cells all are like it."""
    window = stretched()
    cell = np.array([150, 20])
    apart = window.centres(1, cell) - window.centres(0, cell)
    back = window.bodies[0].back
    vertex = window.vertices(back, cell)
    same = replace(
        clacad.prescribe(clacad.load("designs/window-100mm.toml")),
        placements=(CellPlacement(), CellPlacement(tuple(apart))),
    )
    body = same.bodies[0]
    same = replace(same, bodies=(replace(body, back=replace(body.back, vertex=tuple(vertex))),))
    rng = np.random.default_rng(1)
    place = window.centres(0, cell)
    at = np.column_stack([place + rng.uniform(-0.2, 0.2, (400, 2)), np.full(400, -1.0)])
    slope = apart / 10.0
    rays = clacad.Rays(
        at - [*slope, 0.0], np.column_stack([slope + rng.normal(0, 0.002, (400, 2)), np.ones(400)])
    )
    one, two = (clacad.trace(w, rays, path="numpy") for w in (window, same))
    both = (one.fate == Fate.ALIVE) & (two.fate == Fate.ALIVE)
    assert both.sum() > 300
    assert np.abs(one.direction - two.direction)[both].max() < 1e-13
    assert np.abs(one.position - two.position)[both].max() < 1e-12


def test_a_window_of_equal_cells_is_uniform_and_the_other_says_what_it_cannot():
    window = stretched()
    assert not window.uniform
    rays = clacad.Rays([0.0, 0.0, -1.0], [0.0, 0.0, 1.0])
    with pytest.raises(CellsDiffer, match="CL139"):
        clacad.Tracer(window, precision="float32")
    assert clacad.trace(window, rays, effects=("fresnel",)).flux[0] == pytest.approx(0.92, abs=0.01)


GOLDEN = {
    ("window-100mm", "surfaces"): "8e3744ec76c401f0",
    ("paper-base", "surfaces"): "75ad8018ec6a0fa7",
    ("hexagonal", "thin"): "fec2bb4b43459605",
    ("tilted", "surfaces"): "89d9281b01186d6a",
}


@pytest.mark.parametrize(("name", "rung"), GOLDEN)
def test_sheets_of_equal_cells_trace_bit_for_bit_as_before(name, rung):
    window = clacad.prescribe(clacad.load(f"designs/{name}.toml"))
    assert window.uniform
    rng = np.random.default_rng(0)
    spread = rng.uniform(-0.4, 0.4, (4000, 2)) * window.lattice.extent()[1] * 2
    at = np.column_stack([spread, np.full(4000, window.z_range[0] - window.lattice.pitch[0])])
    rays = clacad.Rays(at, np.column_stack([rng.normal(0, 0.1, (4000, 2)), np.ones(4000)]))
    r = clacad.trace(window, rays, rung=rung, path="numpy")
    bits = b"".join(part.tobytes() for part in (r.position, r.direction, r.fate, r.cell, r.order))
    assert hashlib.sha256(bits).hexdigest()[:16] == GOLDEN[name, rung]


@pytest.mark.ci_cases("plano", "hexagonal")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["window-100mm", "plano", "hexagonal", "paper-a-covered", "slab"])
def test_the_compiled_twin_finds_what_numpy_finds(name):
    scale = 1.0005 if name == "paper-a-covered" else SCALE
    window = stretched(name, scale, (0.0, 0.0))
    rng = np.random.default_rng(3)
    x0, x1, y0, y1 = window.lattice.extent()
    n = 4000
    at = np.column_stack([rng.uniform(x0, x1, n), rng.uniform(y0, y1, n), np.full(n, window.z_range[0])])
    slope = at[:, :2] * (scale - 1.0) / window.thin.separation
    rays = clacad.Rays(at, np.column_stack([slope + rng.normal(0.0, 0.02, (n, 2)), np.ones(n)]))
    one, two = (clacad.trace(window, rays, path=path, threads=1) for path in ("numpy", "numba"))
    assert (one.fate == two.fate).all()
    assert (one.cell == two.cell).all()
    assert (one.order == two.order).all()
    assert (one.fate == Fate.ALIVE).sum() > 100
    assert np.abs(one.direction - two.direction).max() < 1e-14
    size = max(x1, y1)
    assert np.abs(one.position - two.position).max() < 1e-14 * size
    assert np.abs(one.optical_path - two.optical_path).max() < 1e-13 * size


@pytest.mark.ci_cases("plano", "hexagonal", "tilted-seam")
@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["window-100mm", "plano", "hexagonal", "tilted", "tilted-seam", "paper-a-covered", "slab"]
)
def test_rays_from_everywhere_meet_the_same_walls_and_neighbours_compiled_as_in_numpy(name):
    """Half of them start on the sheet's level and go anywhere: what does not pass straight is walked, and recorded."""
    window = stretched(name, 1.001, (0.0, 0.0) if name == "paper-a-covered" else (0.013, -0.007))
    rng = np.random.default_rng(8)
    x0, x1, y0, y1 = window.lattice.extent()
    n, pitch = 3001, window.lattice.pitch[0]
    at = np.column_stack(
        [rng.uniform(x0, x1, n), rng.uniform(y0, y1, n), np.full(n, window.z_range[0] - pitch)]
    )
    at[::2] *= 0.02
    way = rng.normal(size=(n, 3))
    way[:, 2] = np.abs(way[:, 2]) + np.where(np.arange(n) % 2, 0.0, 3.0)
    rays = clacad.Rays(at, way)
    one, two = (clacad.trace(window, rays, path=path, threads=1, record=True) for path in ("numpy", "numba"))
    for column in ("fate", "cell", "order", "surface"):
        np.testing.assert_array_equal(getattr(one, column), getattr(two, column), column)
    assert len(np.unique(one.fate)) >= 4
    size = max(x1, y1)
    # a ray near the critical angle amplifies rounding by as much as 1e4
    for column, unit in (("position", size), ("direction", 1.0), ("optical_path", size), ("hits", size)):
        np.testing.assert_allclose(getattr(one, column), getattr(two, column), rtol=0, atol=1e-11 * unit)


@pytest.mark.slow
def test_rays_come_out_the_same_however_many_are_traced_with_them():
    """Blocks, eights and what is left over of both; ranges of rays and rows in an array."""
    rng = np.random.default_rng(2)
    for window in (stretched(), clacad.prescribe(clacad.load("designs/window-100mm.toml"))):
        at = np.column_stack([rng.uniform(-40.0, 40.0, (700, 2)), np.full(700, window.z_range[0])])
        way = np.column_stack(
            [at[:, :2] * (SCALE - 1.0) / 10.0 + rng.normal(0.0, 0.02, (700, 2)), np.ones(700)]
        )
        whole = clacad.trace(window, clacad.Rays(at, way), path="numba", record=True)
        for first, count in ((0, 1), (3, 7), (11, 8), (19, 9), (200, 255), (30, 257), (5, 263)):
            part = slice(first, first + count)
            some = clacad.trace(window, clacad.Rays(at[part], way[part]), path="numba")
            for column in ("position", "direction", "fate", "cell", "order", "surface", "optical_path"):
                np.testing.assert_array_equal(getattr(whole, column)[part], getattr(some, column), column)


@pytest.mark.slow
def test_sheets_of_equal_cells_load_nothing_of_those_that_differ():
    script = (
        "import sys, clacad, numpy as np\n"
        "w = clacad.prescribe(clacad.load('designs/window-100mm.toml'))\n"
        "clacad.trace(w, clacad.Rays([0, 0, -1.0], [0, 0, 1.0]), path='numba')\n"
        "bad = [m for m in sys.modules if m.endswith(('own_cells', 'aimed_cells', 'traced_vertices'))]\n"
        "assert not bad, bad\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True, timeout=300)
