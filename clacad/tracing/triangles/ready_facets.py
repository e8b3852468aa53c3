"""Triangles in place of a window's faces, read and laid out once and kept with the window."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING
from weakref import ref

from clacad.sheet.window import Window
from clacad.tracing.layout import Layout, prepared

if TYPE_CHECKING:
    from clacad.mesh import Mesh
    from clacad.tracing.triangles.squares import Triangles
    from clacad.tracing.triangles.tiles import Normals, Tiles
    from clacad.tracing.triangles.triangle_soup import TriangleSoup

    AnyMesh = Mesh | TriangleSoup | str | os.PathLike[str]


OWN_QUADS = 16
"""Quads a cell side of the sheet's own mesh where none is given, as in scenes."""


@dataclass(frozen=True, eq=False)
class Facets:
    """Triangles in place of a window's faces, ready for rays.

    layout : Layout
        The window, with the bounds of the triangles.
    found_in : Tiles or Triangles
    """

    layout: Layout
    found_in: Tiles | Triangles


def facets_of(window: Window, mesh: AnyMesh | int | Facets, normals: Normals) -> Facets:
    """Triangles ready for rays through a window; the last ones are kept with the window.

    For a non-uniform sheet they are those of a sheet without an end; the tracer finds cells afterwards from
    the points met.

    Raises
    ------
    ValueError
        The mesh has other bodies than the window, no normals where vertex normals are requested, or no unit
        that fits; or the requested number of quads cannot be made.
    LimitRefused
        The sheet is non-uniform and has more triangles than are held.
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
    """Function that returns the identity of a mesh: the object, None once it is deleted; of a file, its path,
    time and size.
    """
    if isinstance(mesh, int):
        return lambda: mesh
    if not isinstance(mesh, (str, os.PathLike)):
        return ref(mesh)
    facts = os.stat(mesh)
    known = (os.path.realpath(mesh), facts.st_mtime_ns, facts.st_size, facts.st_ino)
    return lambda: known


def _laid_out(window: Window, mesh: AnyMesh | int, normals: Normals) -> Facets:
    from clacad.tracing.triangles.tiles import lay_out_mesh
    from clacad.tracing.triangles.triangle_soup import TriangleSoup, lay_out_soup, read_soup

    if isinstance(mesh, int):
        from clacad.mesh import tessellate

        mesh = tessellate(window, quads=mesh)
    elif isinstance(mesh, (str, os.PathLike)):
        mesh = read_soup(mesh, window)
    if not window.uniform:
        from clacad.tracing.triangles.own_sheet import endless_layout, own_soup

        mesh = mesh if isinstance(mesh, TriangleSoup) else own_soup(mesh, normals)
        layout, triangles = lay_out_soup(window, mesh, normals)
        return Facets(endless_layout(layout), triangles)
    if isinstance(mesh, TriangleSoup):
        return Facets(*lay_out_soup(window, mesh, normals))
    return Facets(*lay_out_mesh(window, mesh, normals))
