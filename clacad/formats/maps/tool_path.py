"""Points for a ball-nosed tool that cuts a face: surface, normal, centre of the nose, and whether it reaches.

Frame of a face: the face seen from outside, +z away from the material, z = 0 at the apexes. A front face is
turned by 180 degrees about x into it, a back face is as it lies in the sheet.

The centre of a nose of radius r that touches the face at P lies at P + r n. Where it leaves the cell of P,
the nose would cut into the lens next to it. The path that does not is the upper envelope of the offset
surfaces of all cells; along seams and in corners it leaves material.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from math import sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.optics.surface import principal_radii
from clacad.sheet.window import face_height, lens_height_and_normal
from clacad.storage.errors import NotPossible, UnreadableFile
from clacad.storage.reading import Spending

if TYPE_CHECKING:
    from clacad.sheet.window import Face, Window

Order = Literal["raster", "spiral"]

COLUMNS = ("x", "y", "z", "nx", "ny", "nz", "cx", "cy", "cz", "reachable")
BLOCK = 1 << 14
EDGE_POINTS = 64
"""Points of every side of a cell through which the border of the reached area is drawn."""

ROUNDS, STEP = 60, 1e-6
"""Most rounds of the search of a point of contact; step of its differences over the pitch."""


@dataclass(frozen=True, eq=False)
class ToolFace:
    """A face and the nose that cuts it.

    nose : length. Radius of the nose.
    step : length. Distance of neighbouring points and passes.
    """

    window: Window
    face: Face
    nose: float
    step: float

    @property
    def array(self) -> int:
        """Array on whose cells the face repeats."""
        return self.face.array or 0

    @property
    def way(self) -> float:
        """+1 for a back face, −1 for a front face, which is turned about x."""
        return -float(self.face.side)

    # Up to `rows`, x and y lie along the sheet's axes, z and normals point away from the material.

    def surface(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Heights (n,) and unit normals (n, 3) of the lens over points (n,) of a cell."""
        z, normal = lens_height_and_normal(self.face, x, y)
        return self.way * (z - self.face.vertex[2]), normal * np.array([self.way, self.way, 1.0])

    def in_cell(self, x: Floats, y: Floats) -> Bools:
        """Whether points (n,) lie in the cell about whose centre they are counted."""
        return np.asarray((self.window.lattice_of(self.array).past_borders(x, y) <= 0.0).all(axis=0))

    def contact(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Points (n,) of the lens that the nose touches with its centre over x, y : Newton's method."""
        h = STEP * min(self.window.lattice.pitch)
        p, q = x.copy(), y.copy()
        for _ in range(ROUNDS):
            at, right, up = (self.surface(p + a, q + b)[1] for a, b in ((0.0, 0.0), (h, 0.0), (0.0, h)))
            off = [p + self.nose * at[:, 0] - x, q + self.nose * at[:, 1] - y]
            (a, c), (b, d) = (
                [float(k == j) + self.nose * (turned[:, k] - at[:, k]) / h for k in (0, 1)]
                for j, turned in enumerate((right, up))
            )
            det = a * d - b * c
            dp, dq = (d * off[0] - b * off[1]) / det, (a * off[1] - c * off[0]) / det
            p, q = p - dp, q - dq
            if not (np.abs(dp) + np.abs(dq) > 1e-15 * h / STEP).any():
                break
        return p, q

    def path_height(self, x: Floats, y: Floats) -> Floats:
        """Height (n,) of the centre of the nose over points of a cell: upper envelope of the cells' offsets.

        A concave lens ends at its own border: beyond it the next one is higher, and none is compared.
        """
        lattice = self.window.lattice_of(self.array)
        convex = min(principal_radii(self.face.surface)) > 0.0
        sides = [lattice.offset(*s) for s in lattice.steps] if convex else []
        corners = [(a + c, b + d) for (a, b), (c, d) in zip(sides, [*sides[1:], *sides[:1]], strict=True)]
        found = np.full(np.shape(x), -np.inf)
        for dx, dy in ((0.0, 0.0), *sides, *corners):
            p, q = self.contact(x - dx, y - dy)
            z, normal = self.surface(p, q)
            found = np.fmax(found, z + self.nose * normal[:, 2])
        return found

    def rows(self, x: Floats, y: Floats) -> Floats:
        """Rows (n, 10) of points of the sheet, in the order of `COLUMNS`, without points off the cells."""
        index, u, v = self.window.locate(self.array, x, y)
        kept = self.window.lattice.contains(index)
        x, y, u, v = x[kept], y[kept], u[kept], v[kept]
        z, normal = self.surface(u, v)
        aside = self.nose * normal[:, :2]
        reached = self.in_cell(u + aside[:, 0], v + aside[:, 1])
        table = np.column_stack(
            [x, y, z, normal, x + aside[:, 0], y + aside[:, 1], z + self.nose * normal[:, 2], reached]
        )
        table[:, [1, 4, 7]] *= self.way
        return table

    def left(self) -> dict[str, float]:
        """Material that stays and the part of a cell that is not reached, lengths in design units."""
        tile = self.window.lattice_of(self.array).tile()
        middles = 0.5 * (tile + np.roll(tile, -1, axis=0))
        heights = []
        for at in (middles, tile):
            tip = self.path_height(at[:, 0], at[:, 1]) - self.nose
            own = self.in_cell(*self.contact(at[:, 0], at[:, 1]))  # else the edge between cells is met
            above = np.where(own, tip - self.surface(at[:, 0], at[:, 1])[0], 0.0)
            heights.append(max(0.0, float(above.max())))
        share = (np.arange(EDGE_POINTS) / EDGE_POINTS)[:, None]
        edge = np.concatenate([a + share * (b - a) for a, b in zip(tile, np.roll(tile, -1, axis=0))])
        reached = _area(np.stack(self.contact(edge[:, 0], edge[:, 1]), axis=1)) / _area(tile)
        return {"seam": heights[0], "corner": heights[1], "share": max(0.0, 1.0 - reached)}

    # -- order -----------------------------------------------------------------------------------

    def places(self, order: Order) -> Iterator[tuple[Floats, Floats]]:
        """Points of the sheet in the order of cutting, some at a time, those off the cells included."""
        x0, x1, y0, y1 = self.window.placements[self.array].extent(self.window.lattice)
        if order == "spiral":
            yield from self._spiral(0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * float(np.hypot(x1 - x0, y1 - y0)))
            return
        count = [max(1, round(length / self.step)) for length in (x1 - x0, y1 - y0)]
        x = x0 + (x1 - x0) * (np.arange(count[0]) + 0.5) / count[0]
        for row in range(count[1]):  # forth and back
            yield x if row % 2 == 0 else x[::-1], np.full(count[0], y0 + (y1 - y0) * (row + 0.5) / count[1])

    def _spiral(self, x: float, y: float, reach: float) -> Iterator[tuple[Floats, Floats]]:
        """From the rim to the middle on a spiral of Archimedes: turns and points a step apart."""
        turns = reach / self.step
        total = max(1, round(np.pi * turns * turns))  # length over the step
        for first in range(0, total, BLOCK):
            along = (total - np.arange(first, min(total, first + BLOCK)) - 0.5) / total
            radius, angle = reach * np.sqrt(along), 2.0 * np.pi * turns * np.sqrt(along)
            yield x + radius * np.cos(angle), y + radius * np.sin(angle)


def _area(polygon: Floats) -> float:
    (x, y), (u, v) = polygon.T, np.roll(polygon, -1, axis=0).T
    return 0.5 * abs(float((x * v - u * y).sum()))


def tool_face(window: Window, face: Face, label: str, nose: float, step: float | None, most: int) -> ToolFace:
    """The face and its nose, lengths in design units.

    step : Distance of points and passes; None: about `most` points in all.
    Raises NotPossible: No such tool cuts the face.
    """
    if not nose > 0.0:
        raise NotPossible("tool: no radius of the nose; set process.nose or --nose, such as '25 um'")
    pitch = window.lattice_of(face.array or 0).pitch
    off = max(abs(face.vertex[0]), abs(face.vertex[1]))
    odd = {
        "lenses of its own in each cell": not window.uniform,
        "tilted lenses": not face.untilted,
        "lenses displaced in their cells": off > 1e-9 * min(pitch),
    }
    for what in (name for name, found in odd.items() if found):
        raise NotPossible(
            f"tool: {label} has {what}: they meet in steps, whose walls a ball nose would cut; points are"
            " written for upright lenses in identical cells, at their middle; use --format insert"
        )
    concave = [-r for r in principal_radii(face.surface) if r < 0.0]
    if concave and nose > min(concave):
        raise NotPossible(
            f"tool: nose larger than the radius of the concave face: {nose:.6g} against {min(concave):.6g} of"
            f" {label}; take a nose of at most {min(concave):.6g}"
        )
    lattice = window.lattice_of(face.array or 0)
    tile = 0.999 * lattice.tile()
    covered = face_height(window, face, tile[:, 0], tile[:, 1]) != lens_height_and_normal(face, *tile.T)[0]
    if window.land.seam > 0.0 or covered.any():
        raise NotPossible(
            f"tool: {label} has flat land between its lenses; points are written for lenses that meet: set"
            " lattice.seam = 0, or mill the land first and export with lattice.seam = 0"
        )
    cells = max(1, window.lattice.cell_count)
    chosen = min(pitch) / min(64.0, max(4.0, sqrt(most / cells))) if step is None else step
    return ToolFace(window, face, nose, chosen)


# -- text ------------------------------------------------------------------------------------------


def write_tool(tool: ToolFace, path: Path, scale: float, order: Order, label: str) -> dict[str, Any]:
    """Write the points of a face as CSV, millimetres; return the facts of the file.

    scale : Millimetres per design unit.
    """
    left, count, reached = tool.left(), 0, 0
    head = [
        f"clacad tool points of {label}, unit mm, order {order}, nose {tool.nose * scale!r}",
        "face seen from outside, +z out of the material, z = 0 at the apexes"
        + (": the front turned by 180 degrees about x" if tool.way < 0.0 else ""),
        "c: centre of the nose = surface + nose n; tip = centre - nose z; reachable 0: it leaves the cell",
        f"left at seams {left['seam'] * scale!r}, at corners {left['corner'] * scale!r}, not reached"
        f" {left['share']!r} of the area",
    ]
    with path.open("w", encoding="ascii", newline="\n") as stream:
        stream.writelines(f"# {line}\n" for line in head)
        stream.write(",".join(COLUMNS) + "\n")
        for x, y in tool.places(order):
            table = tool.rows(x, y)
            table[:, [0, 1, 2, 6, 7, 8]] *= scale
            for *numbers, flag in table.tolist():
                stream.write(",".join(map(repr, numbers)) + f",{int(flag)}\n")
            count, reached = count + len(table), reached + int(table[:, 9].sum())
    return {
        "points": count,
        "reachable": reached,
        "nose": tool.nose * scale,
        "order": order,
        "left_at_seams": left["seam"] * scale,
        "left_at_corners": left["corner"] * scale,
        "share_not_reached": left["share"],
    }


def read_tool(path: Path) -> Iterator[Floats]:
    """Read tool points in blocks, tables (k, 10), millimetres.

    Raises UnreadableFile: Other columns, a line that is no row of numbers, or no points.
    Raises OverBudget: More bytes, points or seconds than are read.
    """
    spent, any_points = Spending("points", path), False
    with path.open("rb") as stream:
        lines = (line for line in spent.lines(stream) if line.strip() and not line.startswith(b"#"))
        head = next(lines, b"").decode("ascii", "replace").strip().split(",")
        if tuple(head) != COLUMNS:
            odd = next((name for name in head if name not in COLUMNS), "a column is missing")
            raise UnreadableFile(f"{path.name}: column {odd[:40]!r}; its columns are {','.join(COLUMNS)}")
        while block := list(islice(lines, BLOCK)):
            spent.count(len(block))
            any_points = True
            yield _table(path, block)
    if not any_points:
        raise UnreadableFile(f"{path.name}: no points")


def _table(path: Path, block: list[bytes]) -> Floats:
    try:
        table = np.array([[float(word) for word in line.split(b",")] for line in block])
    except ValueError as error:
        raise UnreadableFile(f"{path.name}: a line that is not {len(COLUMNS)} numbers") from error
    if table.ndim != 2 or table.shape[1] != len(COLUMNS) or not np.isfinite(table).all():
        raise UnreadableFile(f"{path.name}: a line that is not {len(COLUMNS)} finite numbers")
    return table


def tool_misfit(tool: ToolFace, path: Path, scale: float) -> tuple[float, int]:
    """Largest distance (mm) of a point or a centre from where it belongs, and the number of points.

    Infinite where the radius of the nose changes or a centre that leaves its cell is called reachable. The
    radius is that of the file's first row.
    """
    worst, count, nose = 0.0, 0, 0.0
    for table in read_tool(path):
        nose = nose or float(np.linalg.norm(table[0, 6:9] - table[0, :3]))
        own = ToolFace(tool.window, tool.face, nose / scale, tool.step)
        wanted = own.rows(table[:, 0] / scale, table[:, 1] * own.way / scale)
        if len(wanted) != len(table):
            return np.inf, count
        wanted[:, [0, 1, 2, 6, 7, 8]] *= scale
        off = np.abs(wanted - table)
        edge = 1e-9 * min(tool.window.lattice.pitch)
        u, v = (table[:, 6] / scale, table[:, 7] * own.way / scale)
        sure = _off_the_border(own, u, v, edge)
        if (off[:, 9][sure] > 0.0).any() or not np.isfinite(off).all():
            return np.inf, count
        worst, count = max(worst, float(off[:, :9].max())), count + len(table)
    return worst, count


def _off_the_border(tool: ToolFace, x: Floats, y: Floats, edge: float) -> Bools:
    """Points (n,) farther from the borders of cells than rounding moves them."""
    _, u, v = tool.window.locate(tool.array, x, y)
    past = tool.window.lattice_of(tool.array).past_borders(u, v)
    return np.asarray((np.abs(past) > edge).all(axis=0))
