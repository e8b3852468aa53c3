"""Rung "mesh" of non-uniform sheets of two bodies: fates, cells and effects are those of the faces within the tessellation error."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hard import differing

import clacad
from clacad.effects import Setting, light_reaching_camera
from clacad.formats.mesh.stl import write_stl
from clacad.mesh import tessellate
from clacad.optics.rays import NO_CELL, Fate
from clacad.sheet.cell_places import CellPlacement, VertexChange
from clacad.storage.errors import LimitRefused
from clacad.tracing.facets import own_sheet
from clacad.tracing.facets.own_sheet import told
from clacad.tracing.facets.triangle_soup import lay_out_soup, own_soup, read_soup

AIMED = {
    "format": 1, "name": "aimed", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "plano", "separation": 10, "index": 1.5, "thickness": 0.6},
    "lattice": {"pitch": 0.5, "count": [6, 5], "aperture": {"point": [-40, 10, -400]}},
}  # fmt: skip
BICONVEX = {"form": "biconvex", "separation": 10, "index": 1.5, "offset": "paraxial"}
INSIDE = {**AIMED["pair"], "curved": "inside"}


def sheet(pair=None, body=None, **lattice):
    """The aimed sheet, of another pair, body or lattice."""
    keys = {"pair": pair or AIMED["pair"], "lattice": {**AIMED["lattice"], **lattice}}
    return clacad.prescribe(clacad.Design.from_dict({**AIMED, **keys, **({"body": body} if body else {})}))


def light(n=3000, wide=0.03):
    """Rays of the viewer, over the whole sheet and past its edge, a third of them steeper."""
    rng = np.random.default_rng(4)
    at = np.column_stack([rng.uniform(-1.8, 1.8, n), rng.uniform(-1.5, 1.5, n), np.zeros(n)])
    way = at - [-40.0, 10.0, -400.0]
    way /= np.linalg.norm(way, axis=1)[:, None]
    way[2 * n // 3 :, :2] += rng.normal(0.0, wide, (n - 2 * n // 3, 2))
    way /= np.linalg.norm(way, axis=1)[:, None]
    return clacad.Rays(at - way * (1.0 / way[:, 2:]), way)


def room(window, exact, faces):
    """Distance (n,) of the places where rays met the faces from the nearest border of their cells, and of the sheet."""
    least = np.full(len(exact), np.inf)
    for f in faces:
        array = window.faces[f].array
        pitch = np.asarray(window.placements[array].pitch or window.lattice.pitch)
        _, x, y = window.locate(array, *exact.hits[f, :, :2].T)
        least = np.minimum(least, (0.5 * pitch - np.abs(np.column_stack([x, y]))).min(axis=1))
    return least


def turned_aside(window, quads):
    """Length by which facets move light between the arrays at most: their slope error at a corner times the way."""
    radius = 1.0 / abs(next(face.surface.curvature_x for face in window.faces if face.array == 0))
    side = window.lattice.pitch[0] / quads
    faces = sum(face.array == 0 for face in window.faces)
    return faces * 0.5 * side / (np.sqrt(2.0) * radius) * window.thin.separation


@pytest.mark.slow
@pytest.mark.parametrize(
    "pair",
    [
        AIMED["pair"],
        pytest.param(INSIDE, marks=pytest.mark.slow, id="curved inside"),
        pytest.param(BICONVEX, marks=pytest.mark.slow, id="biconvex"),
    ],
)
def test_light_through_triangles_of_two_bodies_goes_where_that_through_their_faces_does(pair):
    window, rays, rms = sheet(pair), light(), []
    exact = clacad.trace(window, rays, path="numpy", record=True)
    straight = exact.fate <= Fate.GHOST
    for quads in (8, 16):
        seen = clacad.trace(window, rays, rung="mesh", mesh=quads)
        second = [f for f, face in enumerate(window.faces) if face.array == 1]
        aside = turned_aside(window, quads)
        # steps between lenses block light that passes a border at their height
        clear = (
            straight
            & (room(window, exact, second) > aside + 0.03)
            & (
                room(
                    window,
                    exact,
                    [0, 1]
                    if pair is BICONVEX
                    else [f for f, face in enumerate(window.faces) if face.array == 0],
                )
                > 0.03
            )
        )
        assert clear.sum() > 200 * (quads // 8)
        assert (seen.fate == exact.fate)[clear].all()
        assert (seen.order == exact.order)[clear].all()
        assert (seen.cell == exact.cell)[clear].all()
        assert (seen.surface == exact.surface)[clear].all()
        alive = clear & (exact.fate == Fate.ALIVE)
        rms.append(np.sqrt((np.linalg.norm(seen.direction - exact.direction, axis=1)[alive] ** 2).mean()))
        assert (seen.fate == exact.fate).mean() > 0.88
    assert 0.4 < rms[1] / rms[0] < 0.65  # the slope of a facet is off by its size


@pytest.mark.slow
@pytest.mark.parametrize("how", ["looked up", "in trees"])
def test_what_passes_array_2_beside_it_has_missed_the_sheet_and_comes_back_as_launched(how):
    window, rays = sheet(), light(1500, 0.1)
    exact = clacad.trace(window, rays, path="numpy", record=True)
    mesh = 16 if how == "looked up" else own_soup(tessellate(window, quads=16), "facet")
    seen = clacad.trace(window, rays, rung="mesh", mesh=mesh, record=True)
    beside = (exact.fate == Fate.MISSED) & (exact.cell != NO_CELL).all(axis=1) & (seen.fate == Fate.MISSED)
    assert beside.sum() > 50  # through lens 1, and past array 2
    for name in ("cell", "order", "surface", "optical_path", "position", "direction"):
        assert (getattr(seen, name) == getattr(exact, name))[beside].all(), name
    for name in ("hits", "directions"):
        assert (getattr(seen, name) == getattr(exact, name))[:, beside].all(), name


OTHERS = {
    "aimed": lambda: sheet(),
    "inside, seam": lambda: sheet(INSIDE, seam=0.06),
    "hexagonal": lambda: sheet(kind="hexagonal"),
    "hexagonal, seam": lambda: differing.window_of(
        {
            **differing.aimed(-400.0),
            "lattice.kind": "hexagonal",
            "lattice.seam": 0.02,
            "lattice.count": [9, 9],
        }
    ),
    "tilted lenses": lambda: differing.window_of({**differing.TILTED, **differing.aimed(-400.0)}),
    "rims and steps": lambda: differing.window_of(differing.LEANING),
    "two figures": lambda: differing.window_of({**differing.BICONVEX, **differing.OWN}),
    "axes of their own": lambda: differing.window_of({"etas": differing.turning(7.0)}),
}


def of_all_kinds(window, n=4000):
    """Rays of the viewer, oblique ones, and some past the edge of the sheet."""
    rng = np.random.default_rng(1)
    x0, x1, y0, y1 = window.lattice.extent()
    at = np.column_stack([rng.uniform((1.1 * x0, 1.1 * y0), (1.1 * x1, 1.1 * y1), (n, 2)), np.zeros(n)])
    slope = at[:, :2] / 400.0 + rng.normal(0.0, 0.004, (n, 2))
    slope[: n // 4] = rng.normal(0.0, 0.3, (n // 4, 2))
    slope[n // 4 : n // 2] = rng.normal(0.0, 0.03, (n // 4, 2))
    way = np.column_stack([slope, np.ones(n)])
    return clacad.Rays(at - 2.0 * way, way)


@pytest.mark.ci_cases("two figures-vertex", "hexagonal, seam-facet", "rims and steps-facet")
@pytest.mark.parametrize("normals", ["facet", pytest.param("vertex", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "name", ["aimed", *(pytest.param(n, marks=pytest.mark.slow) for n in OTHERS if n != "aimed")]
)
def test_facets_looked_up_are_those_that_a_search_of_all_triangles_finds(name, normals):
    """Every column of every ray but the place where one ends at a side wall: a polygon's there, a circle's here."""
    window = OTHERS[name]()
    rays, mesh = of_all_kinds(window), tessellate(window, quads=3)
    tracer = clacad.Tracer(window, rung="mesh", mesh=mesh, normals=normals)
    assert tracer.bare.facets.found_in.own is not None
    seen = tracer(rays)
    found = clacad.trace(window, rays, rung="mesh", mesh=own_soup(mesh, normals), normals=normals)
    for column in ("fate", "cell", "order", "surface"):
        assert (getattr(seen, column) == getattr(found, column)).all(), column
    assert len(np.unique(seen.fate)) >= 3
    through = seen.fate <= Fate.LAND
    assert np.abs(seen.direction - found.direction)[through].max() < 1e-11
    for column in ("position", "optical_path"):
        assert np.abs(getattr(seen, column) - getattr(found, column))[through].max() < 1e-8, column


def met_by(triangles, start, way):
    """Facets that one ray meets, edges and corners included, by Cramer's rule: their numbers and distances."""
    a, b, c = triangles.transpose(1, 0, 2)
    matrix = np.stack([b - a, c - a, np.broadcast_to(-way, a.shape)], axis=2)
    flat = np.abs(np.linalg.det(matrix)) > 1e-14
    u, v, t = np.linalg.solve(matrix[flat], (start - a[flat])[..., None])[..., 0].T
    held = (u > -1e-9) & (v > -1e-9) & (u + v < 1.0 + 1e-9) & (t > 0.0)
    return np.flatnonzero(flat)[held], t[held]


def bent(way, normal, n1, n2):
    """Direction of a ray behind a facet, by Snell's law for vectors."""
    normal = normal / np.linalg.norm(normal) * np.sign(normal @ way)
    across = n1 / n2 * (way - (way @ normal) * normal)
    return across + np.sqrt(1.0 - across @ across) * normal


def directions_of(triangles, start, way):
    """All directions in which a ray may leave a body of index 1.5, whichever facet an edge belongs to."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    found = []
    facets, far = met_by(triangles, start, way)
    for k, t in zip(facets[far < far.min() + 1e-9], far[far < far.min() + 1e-9]):
        inner, at = bent(way, normals[k], 1.0, 1.5), start + t * way
        inside, far_in = met_by(triangles, at + 1e-6 * inner, inner)
        found += [bent(inner, normals[m], 1.5, 1.0) for m in inside[far_in < far_in.min() + 1e-6]]
    return np.array(found)


def test_light_through_corners_and_edges_of_facets_leaves_by_one_of_the_facets_there():
    window = sheet({"form": "slab", "separation": 10, "index": 1.5})
    mesh = tessellate(window, quads=4)
    (body,) = mesh.bodies
    triangles = np.concatenate(list(body.rows()))
    i, j = np.meshgrid(np.arange(-3, 4), np.arange(-3, 4))
    at = np.column_stack([i.ravel(), j.ravel()]) * 0.0625  # corners, edges and diagonals of squares of .125
    at = at + window.lattice.centres(np.array([2, 2]))
    rays = clacad.Rays(np.column_stack([at, np.full(len(at), -2.0)]), np.tile([0.0, 0.0, 1.0], (len(at), 1)))
    seen = clacad.trace(window, rays, rung="mesh", mesh=mesh)
    assert (seen.fate <= Fate.GHOST).all()
    for k in range(len(at)):
        wanted = directions_of(triangles, rays.position[k], rays.direction[k])
        assert np.abs(wanted - seen.direction[k]).max(axis=1).min() < 1e-11


def test_rays_without_a_way_through_facets_have_the_fates_of_the_faces():
    window = sheet()
    at = np.array([0.1, 0.1, -2.0])
    ways = np.array(
        [[np.nan, 0, 1], [0, 0, 0], [1, 0, 0], [0, 0, -1], [1, 0, 1e-9], [1, 1e-3, 1e-3], [0, 0, np.inf]]
    )
    rays = clacad.Rays(np.tile(at, (len(ways), 1)), ways)
    seen = clacad.trace(window, rays, rung="mesh", mesh=4)
    assert (seen.fate == clacad.trace(window, rays, path="numpy").fate).all()
    assert set(seen.fate.tolist()) == {Fate.INVALID, Fate.MISSED}


def test_heights_of_more_facets_than_are_held_are_refused(monkeypatch):
    monkeypatch.setattr(own_sheet, "MOST_LOOKED_UP", 100)
    with pytest.raises(LimitRefused, match="fewer quads or fewer cells"):
        clacad.trace(sheet(), light(10), rung="mesh", mesh=4)


SAME = {
    "plano": {"pair": AIMED["pair"]},
    "inside": {"pair": INSIDE},
    "biconvex": {"pair": BICONVEX},
    "seam": {"pair": AIMED["pair"], "lattice": {"seam": 0.06}},
}


def said_twice(name):
    """A uniform sheet, and the same one described as a non-uniform one."""
    lattice = {"pitch": 0.5, "count": [6, 5], "aperture": [0.1, -0.03], **SAME[name].get("lattice", {})}
    equal = clacad.prescribe(
        clacad.Design.from_dict({**AIMED, "pair": SAME[name]["pair"], "lattice": lattice})
    )
    own = CellPlacement(equal.shifts[1], tuple(p * (1.0 + 2.0**-50) for p in equal.lattice.pitch))

    def still(face):
        return replace(face, change=VertexChange()) if face.array == 1 else face

    bodies = tuple(replace(b, front=still(b.front), back=still(b.back)) for b in equal.bodies)
    thin = replace(equal.thin, pitch=own.pitch, change=VertexChange())
    differs = replace(equal, bodies=bodies, placements=(CellPlacement(), own), thin=thin)
    assert equal.uniform
    assert not differs.uniform
    return equal, differs


@pytest.mark.ci_cases("biconvex", "seam")
@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["biconvex", *(pytest.param(n, marks=pytest.mark.slow) for n in SAME if n != "biconvex")]
)
def test_equal_cells_told_by_what_was_met_are_those_that_the_kernels_count(name, tmp_path):
    """A uniform sheet, and the same one described as a non-uniform one: all columns, fates of every kind."""
    equal, differs = said_twice(name)
    path = tmp_path / "sheet.stl"
    write_stl(tessellate(equal, quads=4).bodies, path, 1.0, "sheet")
    rays = light(4000, 0.2)
    one, two = (clacad.trace(w, rays, rung="mesh", mesh=str(path), record=True) for w in (equal, differs))
    assert len(np.unique(one.fate)) >= 4
    for column in ("fate", "cell", "order", "surface"):
        assert (getattr(one, column) == getattr(two, column)).all(), column
    for column in ("position", "direction", "optical_path", "hits", "directions"):
        assert np.abs(getattr(one, column) - getattr(two, column)).max() < 1e-9, column


def border_places(window, seen):
    """Points as near borders of array 2's cells as half of the last bit of half a pitch leaves room, and their cells by
    rational numbers.
    """
    place, near = window.placements[1], Fraction(1, 2**55)
    where, cells = seen.hits[2:].copy(), np.zeros((len(seen), 2), dtype=int)
    for axis in (0, 1):
        pitch, shift = Fraction(place.pitch[axis]), Fraction(place.shift[axis])
        n = window.lattice.count[axis]
        for k in range(len(seen)):
            border = shift + pitch * (Fraction(1 + k % (n - 1)) - Fraction(n, 2))
            aside = (-1) ** (k // n) * near * Fraction(6, 5)
            x = float(border + aside)
            while abs(Fraction(x) - border) <= near:
                x = float(np.nextafter(x, np.copysign(np.inf, float(aside))))
            where[:, k, axis] = x
            cells[k, axis] = ((Fraction(x) - shift) / pitch + Fraction(n, 2)).__floor__()
    return where, cells


@pytest.mark.slow
def test_light_on_a_border_of_a_scaled_array_is_in_the_cell_that_rational_numbers_say():
    window, rays = sheet(), light(400)
    tracer = clacad.Tracer(window, rung="mesh", mesh=4)
    seen = tracer(rays, record=True)
    through = seen.fate <= Fate.GHOST
    assert through.sum() > 100
    where, cells = border_places(window, seen)
    found = told(
        window,
        tracer.bare.facets.layout.bodies,
        rays,
        replace(seen, hits=np.concatenate([seen.hits[:2], where])),
        True,
    )
    assert ((found.cell + found.order)[through] == cells[through]).all()
    assert (found.cell == seen.cell)[through].all()
    ghost = (cells != found.cell).any(axis=1)
    assert (found.fate == np.where(ghost, Fate.GHOST, Fate.ALIVE))[through].all()


SETTING = Setting(extinction=1e-5, roughness=2e-9, slope_rms=1e-4)
PASSES = ("ghosts", "walls", "fresnel", "absorption", "tir_paths", "scatter", "polarisation")


@pytest.mark.ci_cases("names0", "names3", "names7")
@pytest.mark.slow
@pytest.mark.parametrize(
    "names", [("ghosts", "fresnel", "walls"), *(pytest.param((n,), marks=pytest.mark.slow) for n in PASSES)]
)
def test_effects_change_light_through_triangles_as_those_of_equal_cells(names, tmp_path):
    equal, differs = said_twice("biconvex")
    path = tmp_path / "sheet.stl"
    write_stl(tessellate(equal, quads=4).bodies, path, 1.0, "sheet")
    rays = light(600, 0.2)
    rays = clacad.Rays(rays.position, rays.direction, np.full(600, 550e-9))
    one, two = (
        light_reaching_camera(w, rays, "mesh", names, SETTING, mesh=read_soup(path, w), path="numpy")
        for w in (equal, differs)
    )
    assert (one[1].fate == two[1].fate).all()
    assert len(one[0].parent) == len(two[0].parent)
    assert (one[0].parent == two[0].parent).all()
    for column in ("flux", "direction", "position"):
        assert np.abs(getattr(one[0], column) - getattr(two[0], column)).max() < 1e-9, column
    assert (one[0].flux < 0.99).any() == bool({"fresnel", "absorption", "polarisation"} & set(names))


@pytest.mark.slow
def test_what_an_aimed_sheet_reflects_by_its_triangles_tends_to_what_its_faces_do():
    window, rays = sheet(), light()
    exact = clacad.trace(window, rays, effects=("fresnel",), path="numpy")
    off = []
    for quads in (8, 32):
        seen = clacad.trace(window, rays, rung="mesh", mesh=quads, effects=("fresnel",))
        alive = (seen.fate == Fate.ALIVE) & (exact.fate == Fate.ALIVE)
        off.append(np.sqrt(((seen.flux - exact.flux)[alive] ** 2).mean()))
    assert 0 < off[1] < 0.35 * off[0]


@pytest.mark.slow
def test_a_part_of_a_mesh_sends_light_through_its_cells_as_the_whole_does():
    window = sheet()
    whole = tessellate(window, quads=4)
    cells = np.array([[2, 2], [3, 2], [2, 3]])
    part = whole.part(cells)
    counts = [sum(len(rows) for rows in body.rows()) for body in part.bodies]
    again = [sum(len(rows) for rows in body.rows()) for body in part.bodies]
    assert counts == again == [body.facets_about for body in part.bodies]
    assert all(few < body.facet_count for few, body in zip(counts, whole.bodies, strict=True))
    at = np.column_stack([window.lattice.centres(cells), np.zeros(len(cells))])
    way = at - [-40.0, 10.0, -400.0]
    rays = clacad.Rays(at - way / way[:, 2:], way / np.linalg.norm(way, axis=1)[:, None])
    one, other = (clacad.trace(window, rays, rung="mesh", mesh=mesh) for mesh in (whole, part))
    assert (one.fate == Fate.ALIVE).all()
    assert np.array_equal(one.cell, other.cell)
    assert np.array_equal(one.direction, other.direction)


@pytest.mark.parametrize("pair", [AIMED["pair"], BICONVEX])
def test_bodies_of_the_own_triangles_are_those_found_from_their_pieces(pair):
    """The mesh knows the body of each triangle; pieces joined at corners give the same bodies."""
    window = sheet(pair)
    soup = own_soup(tessellate(window, quads=3), "facet")
    alone = lay_out_soup(window, replace(soup, owner=None), "facet")
    told_of = lay_out_soup(window, soup, "facet")
    assert np.array_equal(alone[1].trees.corner, told_of[1].trees.corner)
    assert np.array_equal(alone[1].trees.tree, told_of[1].trees.tree)
    assert len(window.bodies) == len(told_of[1].trees.tree) == 2
