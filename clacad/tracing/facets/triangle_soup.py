"""Triangles from any source, known only by their corners: read, and assigned to bodies.

A file of a part that a shop delivered contains no cells, faces or bodies. Triangles are joined where they
share a corner to the last bit. Each connected piece belongs to the body of the window whose heights it lies
nearest. `facets_of` lays triangles out in place of a window's faces, once, and keeps them with the window.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints
from clacad.base.vectors import doubled_normals
from clacad.sheet.cell_places import CellPlacement
from clacad.sheet.window import WALL, Window
from clacad.tracing.facets.hierarchy import hierarchy
from clacad.tracing.facets.squares import Triangles, find_squares
from clacad.tracing.facets.tiles import Normals, Tiles, lay_out_mesh, refuse_many
from clacad.tracing.layout import BodyPlan, Layout, lay_out, prepared

UNITS = (1.0, 1000.0, 0.001, 25.4, 1.0 / 25.4)
MATCH = 0.02
"""Share by which the extents of a file without a unit may differ from the window's."""


class UnusableMesh(ValueError):
    """A mesh that light cannot be traced through as requested, or of another sheet; exit status 2."""

    exit_status = 2


@dataclass(frozen=True, eq=False)
class TriangleSoup:
    """Triangles of all bodies, sheet frame, window units.

    corners : (t, 3, 3) lengths. Counter-clockwise seen from outside.
    normals : (t, 3, 3) or None. Unit outward normals at the corners, where the file has them.
    owner : (t,) ints or None. Body of each triangle; None where it is found from the triangles.
    """

    corners: Floats
    normals: Floats | None = None
    owner: Ints | None = None


def read_soup(path: str | os.PathLike[str], window: Window) -> TriangleSoup:
    """Read a mesh file (STL, 3MF, PLY, OBJ, GLB) in the window's units.

    Raises ValueError: The file states no unit and its size fits the window in none, or in more than one.
    """
    # readers are in the room of the formats' writers; the tracer needs them only when it is given a path
    from clacad.formats.mesh.readers import read_mesh

    return soup_of(read_mesh(path), window)


def soup_of(found: Any, window: Window) -> TriangleSoup:
    """Triangles of a `FileMesh`, every placement expanded, in the window's units."""
    if not found.expandable:
        raise UnusableMesh(f"the mesh represents {found.facet_count} triangles: too many to hold them all")
    corners, normals = [], []
    for part in found.parts:
        own = part.corners(0, part.facet_count)
        of_corners = part.corner_normals(0, part.facet_count)
        for place in part.placements:
            corners.append(own @ place[:3] + place[3])
            if of_corners is not None:
                turned = of_corners @ np.linalg.inv(place[:3]).T
                normals.append(turned / np.linalg.norm(turned, axis=2, keepdims=True))
    both = np.concatenate(corners) if corners else np.empty((0, 3, 3))
    factor = found.unit / window.unit if found.unit is not None else _factor(both, window)
    whole = len(normals) == len(corners) and normals
    return TriangleSoup(both * factor, np.concatenate(normals) if whole else None)


def _factor(corners: Floats, window: Window) -> float:
    """Window units per file unit, by size."""
    x0, x1, y0, y1 = window.lattice.extent()
    if window.outline is not None:
        boxes = [body.box for body in lay_out(window).bodies]
        x0, x1 = min(b[0] for b in boxes), max(b[1] for b in boxes)
        y0, y1 = min(b[2] for b in boxes), max(b[3] for b in boxes)
    elif len(window.bodies) > 1:
        dx, dy = np.subtract(window.shifts[1], window.shifts[0])  # a field lens lies between
        x0, x1, y0, y1 = min(x0, x0 + dx), max(x1, x1 + dx), min(y0, y0 + dy), max(y1, y1 + dy)
    size = np.ptp(corners.reshape(-1, 3), axis=0)[:2]
    wanted = np.array([x1 - x0, y1 - y0])
    fits = [f for f in UNITS if (np.abs(size * f / wanted - 1.0) < MATCH).all()]
    if len(fits) != 1:
        raise UnusableMesh(
            f"the mesh is {size[0]:.6g} by {size[1]:.6g} and states no unit; the window is "
            f"{wanted[0]:.6g} by {wanted[1]:.6g}: no unit fits"
        )
    return fits[0]


def lay_out_soup(window: Window, soup: TriangleSoup, normals: Normals) -> tuple[Layout, Triangles]:
    """Prepare a window and triangles from any source for tracing.

    Raises ValueError: A body of the window has no triangles, or vertex normals are requested for a file
        without them.
    """
    if normals == "vertex" and soup.normals is None:
        raise UnusableMesh('normals = "vertex", but the mesh has none; they are never estimated')
    exact = lay_out(window)
    owner = _of_plates(exact, soup.corners) if soup.owner is None else soup.owner
    bodies = [np.flatnonzero(owner == b) for b in range(len(exact.bodies))]
    for mine, body in zip(bodies, window.bodies, strict=True):
        if len(mine) == 0:
            raise UnusableMesh(f"no triangles of the mesh belong to {body.name!r}")
    rank, trees = hierarchy([soup.corners[mine] for mine in bodies])
    if normals == "vertex":
        trees = trees._replace(corner_normal=_upward(soup, np.concatenate(bodies)[rank]))
    plans = tuple(_bounded(plan, soup.corners[mine]) for plan, mine in zip(exact.bodies, bodies, strict=True))
    return replace(exact, bodies=plans), Triangles(trees, find_squares(trees, _slope_of_rows(window)))


def _slope_of_rows(window: Window) -> float:
    """Slope of the rows of a mesh's triangles: hexagonal cells have sides along y and 30° off x."""
    return 3.0**-0.5 if window.lattice.hexagonal and not window.lattice.turn else 0.0


def _upward(soup: TriangleSoup, which: Ints) -> Floats:
    assert soup.normals is not None
    return np.ascontiguousarray(soup.normals[which])


def _bounded(plan: BodyPlan, corners: Floats) -> BodyPlan:
    """Body with the triangles' heights as its bounds."""
    low, high = float(corners[..., 2].min()) - plan.level, float(corners[..., 2].max()) - plan.level
    pad = 1e-9 * (plan.box[1] - plan.box[0])
    return replace(plan, low=low - pad, high=high + pad)


def _of_plates(layout: Layout, corners: Floats) -> Ints:
    """Body (t,) of each triangle: pieces belong to plates, divided at joints by height and facing."""
    joined = [body.joined for body in layout.window.bodies]
    first = np.flatnonzero(~np.array(joined))
    last = np.append(first[1:], len(joined)) - 1
    plates = [(layout.bodies[a], layout.bodies[b]) for a, b in zip(first, last, strict=True)]
    owner = _owners(plates, corners)
    if not any(joined):
        return owner
    from clacad.formats.mesh.compare_instances import body_facing, levels

    between = levels(layout.window)
    normal = doubled_normals(corners)
    middle = corners.mean(axis=1)
    optical = np.abs(normal[:, 2]) > WALL * np.linalg.norm(normal, axis=1)
    body = np.where(
        optical, body_facing(between, middle[:, 2], normal[:, 2]), np.searchsorted(between[2], middle[:, 2])
    )
    return np.asarray(np.clip(body, first[owner], last[owner]))


def _owners(plates: list[tuple[BodyPlan, BodyPlan]], corners: Floats) -> NDArray[np.int64]:
    """Plate (t,) of each triangle: that of its connected piece, by the piece's middle height; plates by
    their first and last body.
    """
    if len(plates) == 1 or len(corners) == 0:
        return np.zeros(len(corners), dtype=np.int64)
    piece = _pieces(corners)
    low = np.full(int(piece.max()) + 1, np.inf)
    high = -low
    np.minimum.at(low, piece, corners[..., 2].min(axis=1))
    np.maximum.at(high, piece, corners[..., 2].max(axis=1))
    middles = np.array(
        [
            a.level + 0.5 * (a.low + a.high) if a is b else 0.5 * (a.level + a.low + b.level + b.high)
            for a, b in plates
        ]
    )
    nearest = np.abs(0.5 * (low + high)[:, None] - middles).argmin(axis=1)
    return np.asarray(nearest[piece])


def _pieces(corners: Floats) -> Ints:
    """Number the connected pieces: triangles are joined where they share a corner exactly."""
    points = corners.reshape(-1, 3)
    order = np.lexsort(points.T)
    in_order = points[order]
    vertex = np.zeros(len(points), dtype=np.int64)
    vertex[order[1:]] = np.cumsum((in_order[1:] != in_order[:-1]).any(axis=1))
    triangles = vertex.reshape(-1, 3)
    label = np.arange(int(triangles.max()) + 1)
    while True:  # labels fall to the least of their piece; pointers halve the way at every round
        least = label[triangles].min(axis=1)
        new = label.copy()
        np.minimum.at(new, triangles.ravel(), np.repeat(least, 3))
        new = new[new]
        if np.array_equal(new, label):
            break
        label = new
    _, piece = np.unique(label[triangles[:, 0]], return_inverse=True)
    return np.asarray(piece.ravel(), dtype=np.int64)


if TYPE_CHECKING:
    from clacad.mesh import Mesh
    from clacad.tracing.facets.squares import Triangles

    AnyMesh = Mesh | TriangleSoup | str | os.PathLike[str]


OWN_QUADS = 16
"""Quads a cell side of the sheet's own mesh where none is given, as in scenes."""


@dataclass(frozen=True, eq=False)
class Facets:
    """Triangles in place of a window's faces, ready for rays.

    layout : The window, with the bounds of the triangles.
    """

    layout: Layout
    found_in: Tiles | Triangles

    @property
    def nbytes(self) -> int:
        """Bytes of the heights of cells that differ, or of the triangles."""
        held = self.found_in
        own = held.own if isinstance(held, Tiles) else held.trees
        return 0 if own is None else sum(one.nbytes for one in own)


def facets_of(window: Window, mesh: AnyMesh | int | Facets, normals: Normals) -> Facets:
    """Triangles ready for rays through a window; the last ones are kept with the window.

    Triangles from any source are, for a non-uniform sheet, those of a sheet without an end; the tracer finds
    cells afterwards from the points met.

    Raises ValueError: The mesh has other bodies than the window, no normals where vertex normals are
        requested, or no unit that fits; or the requested number of quads cannot be made.
    Raises LimitRefused: The sheet is non-uniform and has more triangles than are held.
    """
    if isinstance(mesh, Facets):
        return mesh
    key = _identity(mesh)
    kept: tuple[Callable[[], object], Normals, Facets] | None = prepared(window).get("facets")
    if kept is not None and kept[0]() == key() and kept[1] == normals:
        return kept[2]
    facets = _laid_out(window, mesh, normals)
    prepared(window)["facets"] = key, normals, facets
    return facets


def _identity(mesh: AnyMesh | int) -> Callable[[], object]:
    """Function that gives a mesh's identity: the object, None once deleted; of a file path, time and size."""
    if isinstance(mesh, int):
        return lambda: mesh
    if not isinstance(mesh, (str, os.PathLike)):
        return ref(mesh)
    facts = os.stat(mesh)
    known = (os.path.realpath(mesh), facts.st_mtime_ns, facts.st_size, facts.st_ino)
    return lambda: known


def _laid_out(window: Window, mesh: AnyMesh | int, normals: Normals) -> Facets:
    if isinstance(mesh, int):
        from clacad.mesh import tessellate

        mesh = tessellate(window, quads=mesh)
    elif isinstance(mesh, (str, os.PathLike)):
        mesh = read_soup(mesh, window)
    if not isinstance(mesh, TriangleSoup) and not any(place.turn for place in window.placements):
        if window.uniform:
            return Facets(*lay_out_mesh(window, mesh, normals))
        from clacad.tracing.facets.own_sheet import own_tiling

        return Facets(*lay_out_mesh(window, mesh, normals, own_tiling))
    mesh = mesh if isinstance(mesh, TriangleSoup) else own_soup(mesh, normals)
    layout, triangles = lay_out_soup(window, mesh, normals)
    return Facets(layout if window.uniform else endless_layout(layout), triangles)


MOST_FACETS = 4_000_000
"""Largest number of triangles in trees that are held for tracing, none of them a copy of another."""

ENDLESS = 1_000_001
"""Cells in each direction of a sheet so wide that no light passes outside it."""


def own_soup(mesh: Mesh, normals: Normals) -> TriangleSoup:
    """All the triangles of the mesh of a sheet with turned arrays. Raises LimitRefused: Too many."""
    refuse_many(sum(body.facets_about for body in mesh.bodies), MOST_FACETS)
    from clacad.mesh.tessellation import shaded_portions

    smooth = normals == "vertex"
    corners, shaded, each = [], [], []
    for body in mesh.bodies:
        made = list(shaded_portions(body, smooth))
        corners += [one.corners for one in made]
        shaded += [one.normals for one in made if one.normals is not None]
        each.append(sum(len(one.corners) for one in made))
    owner = np.repeat(np.arange(len(each)), each)
    return TriangleSoup(np.concatenate(corners), np.concatenate(shaded) if smooth else None, owner)


def endless_layout(layout: Layout) -> Layout:
    """Uniform sheet without an end that replaces a non-uniform one where only triangles are searched.

    layout : Of the sheet, with the bounds of the triangles.
    """
    window = layout.window
    still = tuple(
        replace(body, front=replace(body.front, change=None), back=replace(body.back, change=None))
        for body in window.bodies
    )
    wide = lay_out(
        replace(
            window,
            bodies=still,
            placements=tuple(CellPlacement(place.shift) for place in window.placements),
            lattice=replace(window.lattice, count=(ENDLESS, ENDLESS), outline=None),
            outline=None,
            thin=replace(window.thin, pitch=None, turn=0.0, change=None, change_1=None),
            cell_laws=None,
            land=replace(window.land, lined=-1),
        )
    )
    bounded = tuple(
        replace(body, low=own.low, high=own.high)
        for body, own in zip(wide.bodies, layout.bodies, strict=True)
    )
    return replace(wide, bodies=bounded)
