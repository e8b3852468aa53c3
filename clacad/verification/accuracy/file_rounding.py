"""Effect of a file's number format on a mesh: rounding of its vertices.

The mesher computes heights as whole steps of the float32 spacing at the sheet's greatest height, so that all formats
hold one mesh; a file in double precision keeps exactly these. Float32 files round again, in the file's unit: in the
coordinates of the whole sheet, or of one repeated cell. Height maps have an exact grid and store a height above the
face's own plane, as float32 or in 16 bits.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints
from clacad.base.units import millimetres
from clacad.mesh import Mesh
from clacad.mesh.body_mesh import BodyMesh
from clacad.mesh.prototile import Prototile
from clacad.sheet.window import Body, Window, lens_height

FINER = 1 << 20
"""Subdivisions of the mesher's step in which stored heights are counted: far below any rounding of a file."""

KNOWN = 1 << 59
"""Levels of at least this magnitude represent a missing face."""


@dataclass(frozen=True, slots=True)
class Holding:
    """How a family of formats stores a vertex.

    Parameters
    ----------
    origin : "sheet", "cell" or "face"
        Origin of coordinates; "face": heights alone, from the face's reference plane.
    kind : "exact", "f64", "f32" or "levels"
        "exact" undoes the mesher's steps: vertices on the surfaces, as a reference.
    levels : int
        Steps of a height map over the range of a face's heights.
    """

    origin: str = "sheet"
    kind: str = "f32"
    levels: int = 65534


EXACT = Holding(kind="exact")


def rounded(mesh: Mesh, cell: tuple[int, int], holding: Holding) -> Mesh:
    """Round the vertices of a mesh as a file in millimetres does, for one cell.

    Parameters
    ----------
    mesh : Mesh
    cell : (i, j)
        Rounding of sheet coordinates depends on the position of a cell in the sheet.
    holding : Holding
    """
    window = mesh.window
    bodies = [_held(window, *pair, cell, holding) for pair in zip(window.bodies, mesh.bodies, strict=True)]
    return replace(mesh, bodies=tuple(bodies))


def _held(window: Window, body: Body, part: BodyMesh, cell: tuple[int, int], holding: Holding) -> BodyMesh:
    """Mesh of one body as stored in a file."""
    tiled = []
    for one in part.tiled:
        tile = one.maker.tile
        scale = millimetres(window.unit)
        xy = tile.plan.xy
        if holding.kind == "f32" and holding.origin != "face":
            zero = window.lattice.centres(np.array(cell))[None] + np.asarray(one.shift)
            zero = zero if holding.origin == "sheet" else np.zeros((1, 2))
            xy = _single((xy + zero) * scale) / scale - zero
        made = _finer(tile)
        lens = np.column_stack([_levels(made, body, side, scale, holding) for side in (0, 1)])
        maker = copy(one.maker)  # a trace reads its tile only; the templates stay those of the mesh
        maker.tile = replace(made, plan=replace(tile.plan, xy=xy), lens=lens)
        tiled.append(replace(one, maker=maker))
    return replace(part, tiled=tuple(tiled))


def _finer(tile: Prototile) -> Prototile:
    """Copy of a tile with smaller steps."""
    front, back = (flat * FINER if abs(flat) < KNOWN else flat for flat in tile.land)
    lifted = None if tile.lifted is None else _times(tile.lifted)
    return replace(tile, step=tile.step / FINER, lens=_times(tile.lens), land=(front, back), lifted=lifted)


def _times(levels: Ints) -> Ints:
    known = np.abs(levels) < KNOWN
    return np.where(known, np.where(known, levels, 0) * FINER, levels)


def _levels(tile: Prototile, body: Body, side: int, scale: float, holding: Holding) -> Ints:
    """Levels (n,) of one face as stored in a file."""
    levels, face = tile.lens[:, side].copy(), (body.front, body.back)[side]
    known = np.abs(levels) < KNOWN
    height: Floats = np.asarray(levels[known] * tile.step, dtype=np.float64)
    if (
        holding.kind == "exact" or holding.origin == "face"
    ):  # a map is computed from the surface, not from a mesh
        height = _exact(height, FINER * tile.step, body, side, tile.plan.xy[known])
    if holding.kind in ("f32", "levels"):
        zero = face.vertex[2] if holding.origin == "face" else 0.0
        height = np.asarray(_rounded((height - zero) * scale, holding) / scale + zero)
    levels[known] = np.rint(height / tile.step).astype(np.int64)
    return levels


def _exact(height: Floats, step: float, body: Body, side: int, xy: Floats) -> Floats:
    """Heights of the surface where the mesher only rounded to its step."""
    face = (body.front, body.back)[side]
    if face.array is None:
        return height
    surface = lens_height(face, xy[:, 0], xy[:, 1])
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(surface - height) <= step, surface, height)


def _rounded(heights: Floats, holding: Holding) -> Floats:
    if holding.kind == "f32" or len(heights) == 0:
        return _single(heights)
    low, step = float(heights.min()), float(np.ptp(heights)) / holding.levels or 1.0
    return np.asarray(low + step * np.rint((heights - low) / step))


def _single(values: NDArray[np.floating]) -> Floats:
    return values.astype(np.float32).astype(np.float64)
