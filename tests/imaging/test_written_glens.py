"""A glens as it is written: its STEP file read back by a kernel, its cells meshed, both traced here in plain numpy, cell by cell."""

from __future__ import annotations

from math import comb

import numpy as np
import pytest

import clacad
from clacad.exporting.step_record import write

PITCH, FOCUS, ACROSS = 0.5, 200.0, 100
DESIGN = {
    "format": 1, "name": "glens", "unit": "mm", "law": {"eta": [-1.0, -1.0], "varying": {"f_image": FOCUS}},
    "pair": {"form": "slab", "separation": 10.0, "material": "PMMA", "surface": "biconic"},
    "lattice": {"pitch": PITCH, "count": [ACROSS, ACROSS]},
}  # fmt: skip


def patches(path):
    """Bezier patches of a STEP file: poles and their weights (m, n, 4)."""
    from OCP.BRep import BRep_Tool
    from OCP.STEPControl import STEPControl_Reader
    from OCP.TopAbs import TopAbs_FACE
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    reader = STEPControl_Reader()
    reader.ReadFile(str(path))
    reader.TransferRoots()
    faces, found = TopExp_Explorer(reader.OneShape(), TopAbs_FACE), []
    while faces.More():
        surface = BRep_Tool.Surface_s(TopoDS.Face(faces.Current()))
        faces.Next()
        if surface.DynamicType().Name() != "Geom_BSplineSurface":
            continue
        assert surface.NbUKnots() == surface.NbVKnots() == 2
        poles = [
            [
                (p.X(), p.Y(), p.Z(), surface.Weight(i, j))
                for j in range(1, surface.NbVPoles() + 1)
                for p in [surface.Pole(i, j)]
            ]
            for i in range(1, surface.NbUPoles() + 1)
        ]
        found.append(np.array(poles))
    return found


def bernstein(n, t):
    return np.stack([comb(n, k) * t**k * (1 - t) ** (n - k) for k in range(n + 1)], axis=-1)


def evaluated(poles, u, v):
    """Points and both derivatives of a rational Bezier patch at parameters (n,), by the quotient rule."""
    poles = np.concatenate([poles[..., :3] * poles[..., 3:], poles[..., 3:]], axis=-1)
    m, n = poles.shape[0] - 1, poles.shape[1] - 1
    a, b = bernstein(m, u), bernstein(n, v)
    da, db = bernstein(m - 1, u), bernstein(n - 1, v)
    whole = np.einsum("ri,rj,ijk->rk", a, b, poles)
    along = m * np.einsum("ri,rj,ijk->rk", da, b, np.diff(poles, axis=0))
    across = n * np.einsum("ri,rj,ijk->rk", a, db, np.diff(poles, axis=1))
    weight = whole[:, 3:]
    point = whole[:, :3] / weight
    return point, *((one[:, :3] - point * one[:, 3:]) / weight for one in (along, across))


def met(poles, start, way):
    """Where rays meet a patch, and its unit normals there towards the light; which hit inside it."""
    u, v, reach = np.full(len(start), 0.5), np.full(len(start), 0.5), np.zeros(len(start))
    for _ in range(12):
        point, along, across = evaluated(poles, u, v)
        jacobian = np.stack([along, across, -way], axis=-1)
        step = np.linalg.solve(jacobian, (start + reach[:, None] * way - point)[..., None])[..., 0]
        u, v, reach = u + step[:, 0], v + step[:, 1], reach + step[:, 2]
    point, along, across = evaluated(poles, u, v)
    normal = np.cross(along, across)
    normal /= -np.copysign(np.linalg.norm(normal, axis=1), (normal * way).sum(axis=1))[:, None]
    inside = (np.abs(u - 0.5) <= 0.5) & (np.abs(v - 0.5) <= 0.5)
    return point, normal, inside


def refracted(way, normal, ratio):
    """Snell: unit directions behind a face, `ratio` = n before / n behind."""
    cosine = -(way * normal).sum(axis=1)[:, None]
    return ratio * way + (ratio * cosine - np.sqrt(1 - ratio**2 * (1 - cosine**2))) * normal


def best_focus(place, way, low, high):
    """Height of least rms in x, and that rms."""
    slope = way[:, 0] / way[:, 2]
    heights = np.linspace(low, high, 4001)
    wide = [np.std(place[:, 0] + (z - place[:, 2]) * slope) for z in heights]
    k = int(np.argmin(wide))
    return heights[k], wide[k]


def through_cells(found, cells, index):
    """Parallel light through the cells of some columns, of the row nearest to the axis: places and ways behind the part."""
    middles = np.array([0.5 * (p[0, 0, :3] + p[-1, -1, :3]) for p in found])
    heights = middles[:, 2]
    front, back = (np.flatnonzero(side) for side in (heights < heights.mean(), heights > heights.mean()))
    rng = np.random.default_rng(7)
    places, ways = [], []
    for i in cells:
        centre = np.array([(i - 0.5 * (ACROSS - 1)) * PITCH, 0.5 * PITCH])
        first, second = (
            found[side[int(np.argmin(((middles[side, :2] - centre) ** 2).sum(axis=1)))]]
            for side in (front, back)
        )
        local = rng.uniform(-0.5 * PITCH, 0.5 * PITCH, (256, 2))
        start = np.column_stack([centre + local, np.full(256, -2.0)])
        way = np.tile([0.0, 0.0, 1.0], (256, 1))
        at, normal, inside = met(first, start, way)
        assert inside.all()
        way = refracted(way, normal, 1 / index)
        at, normal, inside = met(second, at, way)
        places.append(at[inside])
        ways.append(refracted(way, normal, index)[inside])
    kept = sum(len(one) for one in places) / (256 * len(cells))
    return np.concatenate(places), np.concatenate(ways), kept


@pytest.mark.slow
def test_sixty_four_cells_of_the_written_step_focus_where_the_glens_shall(tmp_path):
    window = clacad.prescribe(clacad.Design.from_dict(DESIGN).with_cells((ACROSS, 2)))
    write(window, str(tmp_path / "glens.step"), "fused")
    found = patches(tmp_path / "glens.step")
    assert len(found) == 4 * ACROSS
    cells = np.unique(np.linspace(0, ACROSS - 1, 64).round().astype(int))
    assert len(cells) == 64
    place, way, kept = through_cells(found, cells, window.bodies[0].index)
    level = window.faces[1].vertex[2]
    focus, spot = best_focus(place, way, level + 190.0, level + 210.0)
    assert kept > 0.97
    assert focus - level == pytest.approx(199.9, abs=0.3)
    assert spot <= 0.13
    assert np.abs(place[:, 0]).max() > 24.5


def facets_over(mesh, upwards, quads):
    """Triangles of one side by the square of a grid over the cell that holds their middle: {square: corners (k, 3, 3)}."""
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    side = normal[:, 2] > 0.0 if upwards else normal[:, 2] < 0.0
    corners = corners[side]
    square = np.floor((corners.mean(axis=1)[:, :2] / PITCH + 0.5) * quads).astype(int)
    table = np.full((quads, quads, 2), -1)
    order = np.lexsort(square.T)
    place, first = np.unique(square[order], axis=0, return_index=True)
    assert len(place) == quads**2
    table[place[:, 0], place[:, 1], 0] = order[first]
    table[place[:, 0], place[:, 1], 1] = order[first + 1]
    return corners, table


def facet_met(over, start, way, quads):
    """Where rays meet the facets, their unit normals towards the light, and which rays do."""
    corners, table = over
    point, normal = np.full(start.shape, np.nan), np.full(start.shape, np.nan)
    flat = corners[:, 0, 2].mean()
    guess = start + ((flat - start[:, 2]) / way[:, 2])[:, None] * way
    middle = np.floor((guess[:, :2] / PITCH + 0.5) * quads).astype(int)
    reach = range(-3, 4)
    for dx in reach:
        for dy in reach:
            for k in (0, 1):
                square = middle + (dx, dy)
                known = ((square >= 0) & (square < quads)).all(axis=1)
                rows = np.flatnonzero(known & np.isnan(point[:, 0]))
                a, b, c = np.moveaxis(corners[table[square[rows, 0], square[rows, 1], k]], 1, 0)
                n = np.cross(b - a, c - a)
                t = ((a - start[rows]) * n).sum(axis=1) / (way[rows] * n).sum(axis=1)
                hit = start[rows] + t[:, None] * way[rows]
                inside = np.ones(len(rows), bool)
                for p, q in ((a, b), (b, c), (c, a)):
                    inside &= (np.cross(q - p, hit - p) * n).sum(axis=1) >= -1e-12 * (n**2).sum(axis=1)
                good = rows[inside]
                point[good] = hit[inside]
                unit = n[inside] / np.linalg.norm(n[inside], axis=1)[:, None]
                normal[good] = -np.sign((unit * way[good]).sum(axis=1))[:, None] * unit
    return point, normal, np.isfinite(point[:, 0])


@pytest.mark.long
def test_sixty_four_cells_meshed_at_256_quads_focus_where_the_glens_shall():
    from clacad.sheet.like_cell import like_cell

    window = clacad.prescribe(clacad.Design.from_dict(DESIGN).with_cells((ACROSS, 2)))
    quads, index = 256, window.bodies[0].index
    rng = np.random.default_rng(7)
    places, ways = [], []
    cells = np.unique(np.linspace(0, ACROSS - 1, 64).round().astype(int))
    for i in cells:
        cell = np.array([i, 1])
        mesh = clacad.tessellate(like_cell(window, cell, widest=False).with_cells((1, 1)), quads=quads)
        local = rng.uniform(-0.499 * PITCH, 0.499 * PITCH, (64, 2))
        start, way = np.column_stack([local, np.full(64, -2.0)]), np.tile([0.0, 0.0, 1.0], (64, 1))
        at, normal, inside = facet_met(facets_over(mesh, False, quads), start, way, quads)
        assert inside.all()
        way = refracted(way, normal, 1 / index)
        at, normal, inside = facet_met(facets_over(mesh, True, quads), at, way, quads)
        centre = window.lattice.centres(cell)
        places.append(at[inside] + [*centre, 0.0])
        ways.append(refracted(way[inside], normal[inside], index))
    place, way = np.concatenate(places), np.concatenate(ways)
    assert len(place) > 0.96 * 64 * 64
    level = window.faces[1].vertex[2]
    focus, spot = best_focus(place, way, level + 190.0, level + 210.0)
    assert focus - level == pytest.approx(199.9, abs=0.3)
    assert spot <= 0.13
