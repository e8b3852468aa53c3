"""Watertight meshes of a window, by slope error or by quads per cell side.

The land ring and the wall along the window's outline are part of them. Formats that repeat cells use one
closed cell, with exact normals at the corners of facets.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import groupby
from math import ceil
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bools, Floats, Ints
from clacad.base.vectors import doubled_normals
from clacad.mesh.body_mesh import BodyMesh, Mesh, Plain, no_plain, portions
from clacad.mesh.cell_blocks import OwnBlock
from clacad.mesh.cell_template import BACK, BACK_LAND, FRONT, FRONT_LAND, WALL, Template, TemplateMaker
from clacad.mesh.health import facet_errors
from clacad.mesh.integer_heights import NONE, CellLevels, merge_steps, z_step
from clacad.mesh.land_ring import Key, LandRing, Segment, Tiled, make_land
from clacad.mesh.prototile import make_prototile
from clacad.sheet.grid_steps import plate_of
from clacad.sheet.lattice import Lattice
from clacad.sheet.need_window import need_equal_cells, need_window
from clacad.sheet.plate import Plate
from clacad.sheet.window import Body, Face, Window, heights_and_normals_of_lenses, lens_height_and_normal
from clacad.topology.build_complex import cell_complex, saddle_count
from clacad.topology.complex_parts import CannotBuild, CellComplex, Tiling, refuse_buried_land

Vertex = tuple[int, int, int, int]  # owner cell, point, level


class _Builder:
    """Collects triangles of keyed vertices."""

    def __init__(self, step: float) -> None:
        self.step = step
        self.number: dict[Vertex, int] = {}
        self.position: list[tuple[float, float, float]] = []
        self.triangles: list[tuple[int, int, int]] = []
        self.kind: list[int] = []

    def vertex(self, key: Key, level: int, xy: tuple[float, float]) -> int:
        """Number of the vertex of a footprint point at a level."""
        full = (*key, level)
        if full not in self.number:
            self.number[full] = len(self.position)
            self.position.append((*xy, level * self.step))
        return self.number[full]

    def done(self) -> Plain:
        """Return the arrays."""
        if not self.triangles:
            return no_plain()
        return Plain(
            np.array(self.position),
            np.array(list(self.number), dtype=np.int64),
            np.array(self.triangles, dtype=np.int64),
            np.array(self.kind, dtype=np.uint8),
        )


def make_plain(window: Window, tiled: tuple[Tiled, ...], step: float) -> Plain:
    """Build the land out to the window's outline, and the wall along it.

    Raises ValueError: A cell reaches beyond the outline.
    """
    own = len(tiled) == 1 and not window.one_outline and not isinstance(window.outline, Plate)
    centre = tiled[0].shift if own else (0.0, 0.0)
    lands = [make_land(window, t, centre) for t in tiled]
    build = _Builder(step)
    last = len(tiled) - 1
    for side, kind in enumerate((FRONT_LAND, BACK_LAND)):
        of = min(side, last)
        _sheet(build, lands[of], tiled[of].maker.tile.land[side], kind, of)
    if last == 0:
        for _, p, q, cell in lands[0].rim:
            if cell is None:
                _quad(build, lands[0], p, q, *tiled[0].maker.tile.land)
        return build.done()
    sides = [[list(side) for _, side in groupby(land.rim, itemgetter(0))] for land in lands]
    for pair in zip(*sides, strict=True):
        _zip(build, *(_chain(build, lands[n], tiled[n], pair[n], n) for n in (0, 1)))
    return build.done()


def _key(key: Key, tiling: int) -> Key:
    """Key with a distinct number for points of the second tiling.

    Outline corners are common to both tilings.
    """
    return key if tiling == 0 or key[2] == -1 else (key[0], key[1], key[2] + 2**40)


def _sheet(build: _Builder, land: LandRing, level: int, kind: int, tiling: int) -> None:
    """The flat ring of one face."""
    number = [build.vertex(_key(key, tiling), level, land.position[key]) for key in land.keys]
    for a, b, c in land.triangles.tolist():
        # material is above a front face, so it is seen from below
        triangle = (
            (number[c], number[b], number[a]) if kind == FRONT_LAND else (number[a], number[b], number[c])
        )
        build.triangles.append(triangle)
        build.kind.append(kind)


def _quad(build: _Builder, land: LandRing, p: Key, q: Key, front: int, back: int) -> None:
    """The wall over one segment of the outline."""
    xp, xq = land.position[p], land.position[q]
    a, b = build.vertex(p, front, xp), build.vertex(q, front, xq)
    c, d = build.vertex(q, back, xq), build.vertex(p, back, xp)
    build.triangles += [(a, b, c), (a, c, d)]
    build.kind += [WALL, WALL]


def _chain(
    build: _Builder, land: LandRing, tiled: Tiled, segments: list[Segment], face: int
) -> list[tuple[float, int]]:
    """The face's edge along one side of the outline: (distance, vertex), jumps between cells included."""
    chain: list[tuple[float, int]] = []
    origin = np.array(land.position[segments[0][1]])
    own = iter(tiled.border_levels([s[3] for s in segments if s[3] is not None], face))
    for _, p, q, cell in segments:
        levels = (tiled.maker.tile.land[face],) * 2 if cell is None else next(own)
        for key, level in zip((p, q), levels):
            at = land.position[key]
            number = build.vertex(_key(key, face), level, at)
            if not chain or chain[-1][1] != number:
                chain.append((float(np.hypot(at[0] - origin[0], at[1] - origin[1])), number))
    return chain


def _zip(build: _Builder, low: list[tuple[float, int]], high: list[tuple[float, int]]) -> None:
    """Triangulate the wall between a lower and an upper chain that run in parallel.

    No triangle lies on one vertical line: a step of one chain waits until the other chain has moved on.
    """
    near = 3.9 * 2.0**-23 * max(low[-1][0], high[-1][0])  # less than any gap at the outline
    i = j = 0
    while i < len(low) - 1 or j < len(high) - 1:
        options = []
        for which, (chain, at, other) in enumerate(((low, i, high[j][0]), (high, j, low[i][0]))):
            if at == len(chain) - 1:
                continue
            here, there = chain[at][0], chain[at + 1][0]
            upright = there - here <= near
            if not (upright and abs(other - here) <= near):
                # advance first to a following step, and take it while the other chain is still elsewhere
                step_next = at + 2 < len(chain) and chain[at + 2][0] - there <= near
                options.append((not upright, there - near * step_next, which))
        if not options:
            raise ValueError("both faces step at one end of the outline: no wall can be drawn there")
        if min(options)[2] == 0:
            build.triangles.append((low[i][1], low[i + 1][1], high[j][1]))
            i += 1
        else:
            build.triangles.append((low[i][1], high[j + 1][1], high[j][1]))
            j += 1
        build.kind.append(WALL)


COARSEST = 1e-2  # largest step of heights, in body thicknesses
MOST_QUADS = 2048  # a prototile of 17 M triangles


def _quads(window: Window, slope_error: float | None, quads: int | None) -> int:
    """Grid steps as given, else those of the slope error (radians); refuses both and neither."""
    if (slope_error is None) == (quads is None):
        raise ValueError("tessellate needs exactly one of slope_error (radians) and quads (per cell side)")
    if slope_error is not None:
        quads = forecast_quads(window, slope_error)
    assert quads is not None
    if quads < 1:
        raise ValueError(f"quads = {quads}: at least 1 is needed")
    return quads


def tessellate(
    window: Window,
    slope_error: float | None = None,
    quads: int | None = None,
    merge: float | None = None,
    saddle_bevel: float = 0.0,
) -> Mesh:
    """Turn the bodies of a window into triangles, watertight by construction.

    Either `slope_error` or `quads` is given.

    Parameters
    ----------
    window : Window
    slope_error : float, optional
        Largest rms angle allowed between facet and exact normal (radians).
    quads : int, optional
        Grid steps along each side of a cell's optical zone.
    merge : length, optional
        Steps between neighbours below this height are closed. Default: four z steps.
    saddle_bevel : length, optional
        Width of the bevels that join columns which only touch at a saddle. Default 0: the exact surface.

    Returns
    -------
    Mesh

    Raises
    ------
    TypeError
        A design in place of the window.
    ValueError
        Neither or both were given; the slope error would need more than 2048 quads a side; a lenslet's
        surface ends inside its cell; a cell reaches beyond the outline; a bevel is too wide or too narrow.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> window = clacad.prescribe(design)
    >>> mesh = clacad.tessellate(window, quads=4)
    >>> mesh
    Mesh('slab', 4 quads a cell side, 672 facets)
    """
    need_window(window, "tessellate", ", quads=16")
    if saddle_bevel > 0.0:
        reason = "without them columns that touch keep vertices of their own"
        need_equal_cells(window, "a bevel at saddles", reason)
    quads = _quads(window, slope_error, quads)
    bodies = tuple(mesh_body(window, body, quads, merge, saddle_bevel) for body in window.bodies)
    return Mesh(window, bodies, quads)


def mesh_body(
    window: Window, body: Body, quads: int, merge: float | None = None, saddle_bevel: float = 0.0
) -> BodyMesh:
    """Mesh one body; see `tessellate`."""
    parts = _parts(window, body, merge, saddle_bevel)
    tiled = tuple(parts.tiled(n, quads) for n in range(len(parts.cells.tilings)))
    tiles = [one.maker.tile for one in tiled]
    ringed = window.outline is not None and all(abs(level) != NONE for tile in tiles for level in tile.land)
    if len(tiled) > 1 and not ringed:
        raise CannotBuild(
            "CL134",
            f"body {body.name!r} needs land on both faces out to its outline: give body.border a width",
        )
    ring = cache(partial(make_plain, window, tiled, parts.step) if ringed else no_plain)
    if all(one.own is None for one in tiled):
        ring()  # refuses what cannot be built; that of a non-uniform sheet is made when it is used
    return BodyMesh(
        body.name,
        window,
        body,
        tiled,
        ringed,
        ring,
        parts.step,
        saddle_count(parts.cells),
        window.lattice.cell_count * sum(tile.bevel_volume() for tile in tiles),
    )


@dataclass(frozen=True, eq=False)
class _Parts:
    """A body's complex and the z lattice its meshes use."""

    window: Window
    body: Body
    cells: CellComplex
    step: float
    gap: int
    bevel: float

    def tiled(self, number: int, quads: int) -> Tiled:
        """One tiling: with one prototile, or with one per cell."""
        tiling = self.cells.tilings[number]
        make = self._levels(self.body, self.cells, tiling)
        make = replace(make, joined=tuple(self._joined(tiling)))
        lattice = self.window.lattice_of(tiling.array)
        faces = [self.body.front, self.body.back]
        mine = [face for face, here in zip(faces, make.meshed()) if here and face.change is not None]
        if not mine:
            return Tiled(TemplateMaker(make_prototile(make, quads), lattice), tiling.shift, lattice)
        from clacad.mesh.cell_batch import OwnMeshCells

        rows = (self.window.lattice.row(n) for n in range(self.window.lattice.count[1]))
        i, j = next(row[0] for row in rows if len(row)).tolist()
        own = OwnMeshCells(make, quads, (i, j))
        return Tiled(own.rare.at((i, j)), tiling.shift, lattice, own)

    def _levels(self, body: Body, cells: CellComplex, tiling: Tiling) -> CellLevels:
        return CellLevels(self.window, body, cells, tiling, self.step, self.gap, self.bevel)

    def _joined(self, tiling: Tiling) -> Iterator[CellLevels]:
        """Levels of the other bodies of the plate, where they have the same cells."""
        place = self.window.placements[tiling.array]
        for body in plate_of(self.window, self.body):
            if body is not self.body:
                cells = cell_complex(self.window, body, merge=self.gap * self.step, spacing=0.0)
                for other in cells.tilings:
                    if self.window.placements[other.array] == place:
                        yield self._levels(body, cells, other)


def _parts(window: Window, body: Body, merge: float | None, bevel: float = 0.0) -> _Parts:
    refuse_buried_land(body.front, body.back)
    step = z_step(window)
    thick = abs(body.back.vertex[2] - body.front.vertex[2])
    if step > COARSEST * thick > 0.0:
        raise CannotBuild(
            "CL137",
            f"heights near z = {max(map(abs, window.z_range)):.3g} are multiples of {step:.3g} in a float32"
            f" file, and body {body.name!r} is {thick:.3g} thick: no mesh holds it; STEP does, or a shorter"
            " pair.separation",
        )
    gap = merge_steps(merge, step)
    cells = cell_complex(window, body, merge=gap * step, spacing=0.0)
    return _Parts(window, body, cells, step, gap, bevel)


def slope_error_at(window: Window, quads: int) -> float:
    """The slope error (radians) of the mesh with this number of quads."""
    worst = 0.0
    for body in window.bodies:
        parts = _parts(window, body, None)
        for n in range(len(parts.cells.tilings)):
            judged = parts.tiled(n, quads).judged(window, body)
            worst = max(worst, *(facet_errors(maker.tile, one)[0] for maker, one in judged))
    return worst


def forecast_quads(window: Window, slope_error: float) -> int:
    """Fewest quads per cell side whose slope error does not exceed the given one (radians).

    Raises
    ------
    ValueError
        More than 2048 would be needed.
    """
    if not slope_error > 0.0:
        raise ValueError(f"slope_error = {slope_error}: must be positive (radians)")
    probe = 8
    guess = max(1, ceil(probe * slope_error_at(window, probe) / slope_error))
    while guess <= MOST_QUADS:
        found = slope_error_at(window, guess)
        if found <= slope_error:
            while guess > 1 and slope_error_at(window, guess - 1) <= slope_error:
                guess -= 1
            return guess
        guess = max(guess + 1, ceil(guess * found / slope_error * 0.999))
    raise ValueError(
        f"a slope error of {slope_error:.3g} rad needs more than {MOST_QUADS} quads a cell side "
        f"({guess}); {slope_error_at(window, 64):.3g} rad takes 64"
    )


def template_normals(lattice: Lattice, body: Body, template: Template) -> Floats:
    """Outward unit normals at the corners of a template's triangles, (t, 3, 3)."""
    corners = template.local(lattice)[template.triangles]

    def exact(face: Face, mine: Ints) -> Floats:
        at = corners[mine].reshape(-1, 3)
        return lens_height_and_normal(face, at[:, 0], at[:, 1])[1]

    return _with_exact(_facet_normals(corners), template.kind, body, exact)


def _with_exact(
    normals: Floats, kinds: NDArray[np.uint8], body: Body, exact: Callable[[Face, Ints], Floats]
) -> Floats:
    """Normals (t, 3, 3) with the exact ones at the corners of optical facets.

    exact : `exact(face, facets)` → normals (3 k, 3) of a face at the corners of some facets (k,)
    """
    for kind, face, outward in ((FRONT, body.front, -1.0), (BACK, body.back, 1.0)):
        mine = np.flatnonzero(kinds == kind)
        if face.array is not None and len(mine):
            true = outward * exact(face, mine).reshape(-1, 3, 3)
            normals[mine] = np.where(np.isnan(true), normals[mine], true)
    return normals


class Portion(NamedTuple):
    """Some triangles of a body.

    row : Least row of their cells.
    corners : (k, 3, 3) lengths
    normals : (k, 3, 3) or None. Outward, at the corners.
    places : Where the corners lie in their cells; see `clacad.formats.mesh.measure.CornerPlaces`.
    """

    row: int
    corners: Floats
    normals: Floats | None
    places: Callable[[], tuple[Ints, Ints, Bools] | None]


def shaded_portions(mesh: BodyMesh, shaded: bool = True) -> Iterator[Portion]:
    """Yield the blocks of `mesh.rows()`; `shaded`: with normals."""
    known: dict[int, Floats] = {}
    count, row = len(mesh.ring().triangles), 0
    for block, first, last in portions(mesh):
        corners, row = block.corners(first, last), int(block.cells[first:last, 1].min())
        count += len(corners)
        places = partial(block.places, first, last)
        if not shaded:
            yield Portion(row, corners, None, places)
            continue
        if isinstance(block, OwnBlock):
            yield Portion(row, corners, own_normals(mesh, block), places)
            continue
        template = block.template
        if id(template) not in known:
            known[id(template)] = template_normals(block.tiled.lattice, mesh.body, template)
        yield Portion(row, corners, np.tile(known[id(template)], (last - first, 1, 1)), places)
    mesh.counted[:] = [count]
    if len(mesh.ring().triangles):
        yield Portion(row, mesh.ring().corners, plain_normals(mesh) if shaded else None, lambda: None)


def plain_normals(mesh: BodyMesh) -> Floats:
    """Outward normals (t, 3, 3) at the corners of the land ring and of the wall along the outline."""
    return _facet_normals(mesh.ring().corners)


def shaded_rows(mesh: BodyMesh) -> Iterator[tuple[Floats, Floats]]:
    """Yield corners and their outward normals (k, 3, 3) of each block of `mesh.rows()`, in the same order."""
    for _, corners, normals, _ in shaded_portions(mesh):
        assert normals is not None
        yield corners, normals


def own_normals(mesh: BodyMesh, block: OwnBlock) -> Floats:
    """Outward corner normals (t, 3, 3) of a block of cells that differ."""
    from clacad.mesh.compiled_walls import corner_normals

    rows, exact = np.full(block.points.shape, -1, dtype=np.int64), [np.empty((0, 3))]
    shift, lattice = np.array(block.tiled.shift), block.tiled.lattice
    for kind, face, outward in ((FRONT, mesh.body.front, -1.0), (BACK, mesh.body.back, 1.0)):
        if face.array is None:
            continue
        chosen, points, which, facets = block.optical(kind)
        owners = np.repeat(block.cells, np.diff(block.start), axis=0)[facets]
        regular, rare = block.xy[chosen][:, points], block.facets[facets, :, :2]
        base = sum(map(len, exact))
        np.copyto(rows, base + which, where=which >= 0)
        for cells, xy in ((block.cells[chosen], regular), (owners, rare)):
            at = xy - (lattice.centres(cells) + shift)[:, None]
            places = mesh.window.lenses(face, cells[:, None])
            true = heights_and_normals_of_lenses(face, places, at[..., 0], at[..., 1])[1]
            exact.append(outward * true.reshape(-1, 3))
    normals = np.empty_like(block.facets)
    corner_normals(block.facets, np.concatenate(exact), rows, normals)
    return normals


def _facet_normals(corners: Floats) -> Floats:
    """Unit normals (k, 3, 3) of facets, one for each corner; (0, 0, 1) for a facet without area."""
    normal = doubled_normals(corners)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 0.0, normal / np.where(length > 0.0, length, 1.0), [0.0, 0.0, 1.0])
    return np.repeat(normal[:, None, :], 3, axis=1)
