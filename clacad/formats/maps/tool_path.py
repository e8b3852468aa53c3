"""Points for a ball-nosed tool that cuts a face: surface, normal, centre of the nose, and whether it reaches.

Frame of a face: the face seen from outside, +z away from the material, z = 0 at the apexes. A front face is
turned by 180 degrees about x into it, a back face is as it lies in the sheet.

The centre of a nose of radius r that touches the face at P lies at P + r n. Where the offset surface of
another cell or of land is higher, the nose would cut into it. The path that does not is the upper envelope
of the offset surfaces of all cells, which end at their borders; along seams, in corners and at the foot of
steps it leaves material.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import islice
from math import sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.optics.surface import principal_radii
from clacad.sheet.representative_cells import representative_cells
from clacad.sheet.window import lens_height_and_normal, optical_tile
from clacad.storage.errors import NotPossible, UnreadableFile
from clacad.storage.reading import Spending

if TYPE_CHECKING:
    from clacad.sheet.lattice import Lattice
    from clacad.sheet.window import Face, Window

Order = Literal["raster", "spiral"]

COLUMNS = ("x", "y", "z", "nx", "ny", "nz", "cx", "cy", "cz", "reachable")
BLOCK = 1 << 14
EDGE_POINTS = 64
"""Points of every side of a cell through which the border of the reached area is drawn."""

ROUNDS, STEP, HALVINGS = 60, 1e-6, 27
"""Most rounds of the search of a point of contact; step of its differences over the pitch; halvings of a part
of a border, on which the error of the height is the square of that of the place."""

DEEP = 1e-9
"""Depth over the pitch from which on a nose cuts into the lens next to it."""

PLACES, SAMPLED = 24, 16
"""Places along a cell, and most cells besides extreme ones, at which it is seen whether a nose reaches."""


@dataclass(frozen=True, eq=False)
class Nose:
    """A ball nose on a face.

    nose : length. Radius of the nose.
    out : +1: the nose cuts the face itself; −1: the insert that moulds it, whose heights are the negative.
    """

    window: Window
    face: Face
    nose: float
    out: float = field(default=1.0, kw_only=True)

    @property
    def array(self) -> int:
        """Array on whose cells the face repeats."""
        return self.face.array or 0

    @property
    def way(self) -> float:
        """+1 for a back face, −1 for a front face, which is turned about x."""
        return -float(self.face.side)

    @property
    def pits(self) -> bool:
        """Whether the nose sees lenses sunk in the land, as in an insert, not raised above it."""
        return (self.out < 0.0) != self.face.sunk

    @cached_property
    def lattice(self) -> Lattice:
        """Pattern of the cells of the face."""
        return self.window.lattice_of(self.array)

    @cached_property
    def zone(self) -> Floats:
        """Corners (m, 2) of the part of a cell that lenses take."""
        return optical_tile(self.window, self.array)

    @cached_property
    def land(self) -> float | None:
        """Height of the flat land between lenses; None: there is none."""
        if self.face.land is None or not self.window.land.seam and (self.pits or _covered(self)):
            return None
        return self.way * self.out * (self.face.land - self.face.vertex[2])

    # x and y are counted from the middle of the cells `index` (n, 2) along the sheet's axes, z and normals
    # point away from the material. Without an index all lenses are the one that the face describes.

    def lens(self, x: Floats, y: Floats, index: Ints | None = None) -> tuple[Floats, Floats]:
        """Heights (n,) and unit normals (n, 3) of lenses, continued beyond their cells."""
        places, way = self.window.lenses(self.face, index), self.way * self.out
        z, normal = lens_height_and_normal(self.face, *places.seen(x, y))
        if (form := self.face.form) is not None:
            added, *slopes = form.with_slopes(self.window.lattice, index, x, y)
            z, normal = z + added, normal / normal[:, 2:] - np.stack([*slopes, np.zeros(len(x))], axis=1)
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        return way * (places.raised(z) - self.face.vertex[2]), normal * np.array([way, way, 1.0])

    def surface(self, x: Floats, y: Floats, index: Ints | None = None) -> tuple[Floats, Floats]:
        """Heights (n,) and unit normals (n, 3) of the face: the outermost of lens and land."""
        z, normal = self.lens(x, y, index)
        if self.land is None:
            return z, normal
        proud = self.land - z if self.pits else z - self.land
        flat = ~(proud > 0.0) | (self.past(x, y) > 1e-12 * min(self.lattice.pitch))
        return np.where(flat, self.land, z), np.where(flat[:, None], [0.0, 0.0, 1.0], normal)

    def past(self, x: Floats, y: Floats) -> Floats:
        """Distance (n,) of points past the nearest border of the zone of lenses; negative inside."""
        return np.asarray(self.lattice.past_borders(x, y).max(axis=0) + 0.5 * self.window.land.seam)

    def contact(self, x: Floats, y: Floats, index: Ints | None = None) -> tuple[Floats, Floats]:
        """Points (n,) of the lens that the nose touches with its centre over x, y : Newton's method."""
        h = STEP * min(self.window.lattice.pitch)
        p, q = (np.clip(at, -most, most) for at, most in zip((x, y), np.abs(self.zone).max(axis=0)))
        for _ in range(ROUNDS):
            at, right, up = (self.lens(p + a, q + b, index)[1] for a, b in ((0.0, 0.0), (h, 0.0), (0.0, h)))
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

    @cached_property
    def reach(self) -> float:
        """Distance within which the nose may touch what is higher than the place under its centre."""
        if self.window.uniform:
            return self.nose
        heights, _ = self.surface(*_sampled(self, np.vstack([self.lattice.tile(), [[0.0, 0.0]]])))
        return min(self.nose, sqrt(2.0 * self.nose * float(np.ptp(heights))))

    @cached_property
    def around(self) -> list[tuple[int, int]]:
        """Steps from a cell to those that the nose over it may touch; of equal ones the next."""
        most = 1 if self.window.uniform else 1 + int(0.5 * self.reach / min(self.lattice.half_widths))
        line = range(-most, most + 1)
        return [(i, j) for i in line for j in line]

    def path_height(self, x: Floats, y: Floats, index: Ints | None = None) -> Floats:
        """Height (n,) of the centre of the nose over points of cells: upper envelope of all offsets.

        A lens ends at its borders; at a step the nose rolls about the edge of the higher one.
        """
        first = np.zeros((1, 2), dtype=np.int64) if index is None else index
        at = self.window.centres(self.array, first) + np.stack([x, y], axis=1)
        cell, x, y = self.window.locate(self.array, at[:, 0], at[:, 1])  # the one under the centre
        index = None if index is None else cell
        found = over_land(self, x, y)
        for step in self.around:
            dx, dy = self.lattice.offset(*step)
            near = self.past(x - dx, y - dy) < self.reach
            beside = None if index is None else index + np.array(step)
            if beside is not None:
                near &= self.window.lattice.contains(beside)
            (rows,) = np.nonzero(near)
            if len(rows):
                there = self.rolled(x[rows] - dx, y[rows] - dy, None if beside is None else beside[rows])
                found[rows] = np.fmax(found[rows], there)
        return found

    def rolled(self, x: Floats, y: Floats, index: Ints | None) -> Floats:
        """Height (n,) of the centre of the nose on lenses that end at their borders."""
        p, q = self.contact(x, y, index)
        z, normal = self.lens(p, q, index)
        found = z + self.nose * normal[:, 2]
        (rows,) = np.nonzero(~(self.past(p, q) <= 0.0))
        x, y, own = x[rows], y[rows], None if index is None else index[rows]
        found[rows] = -np.inf
        if self.pits and self.land is not None:
            return found  # a pit ends at a wall, whose rim is higher
        for start, end in zip(self.zone, np.roll(self.zone, -1, axis=0), strict=True):
            found[rows] = np.fmax(found[rows], _on_edge(self, x, y, own, (start, end)))
        return found


def _covered(nose: Nose) -> bool:
    """Whether lenses cover their cells, so that land of theirs lies outside the array only."""
    if not nose.window.uniform:
        return False
    share = (np.arange(EDGE_POINTS) / EDGE_POINTS)[:, None]
    edge = np.concatenate([a + share * (b - a) for a, b in zip(nose.zone, np.roll(nose.zone, -1, axis=0))])
    land = nose.way * ((nose.face.land or 0.0) - nose.face.vertex[2])
    return bool((nose.lens(edge[:, 0], edge[:, 1])[0] > land).all())


def _on_edge(nose: Nose, x: Floats, y: Floats, index: Ints | None, ends: tuple[Floats, Floats]) -> Floats:
    """Height (n,) of the centre of the nose that touches a border of lenses; −infinite out of its reach.

    Height along the border plus a circle is concave: its slope is bisected.
    """
    start, length = ends[0], float(np.linalg.norm(ends[1] - ends[0]))
    ex, ey = (ends[1] - start) / length
    middle = (x - start[0]) * ex + (y - start[1]) * ey
    square = nose.nose**2 - ((y - start[1]) * ex - (x - start[0]) * ey) ** 2
    reach = np.sqrt(np.maximum(square, 0.0))
    low, high = (np.clip(middle + way * reach, 0.0, length) for way in (-1.0, 1.0))
    for _ in range(HALVINGS):
        t = 0.5 * (low + high)
        _, normal = nose.lens(start[0] + t * ex, start[1] + t * ey, index)
        across, ball = t - middle, np.sqrt(np.maximum(reach**2 - (t - middle) ** 2, 0.0))
        up = -(normal[:, 0] * ex + normal[:, 1] * ey) / normal[:, 2] * ball > across
        low, high = np.where(up, t, low), np.where(up, high, t)
    t = 0.5 * (low + high)
    z, _ = nose.lens(start[0] + t * ex, start[1] + t * ey, index)
    there = z + np.sqrt(np.maximum(reach**2 - (t - middle) ** 2, 0.0))
    return np.where((square > 0.0) & (np.abs(t - middle) <= reach), there, -np.inf)


def over_land(nose: Nose, x: Floats, y: Floats) -> Floats:
    """Height (n,) of the centre of the nose that touches land; −infinite out of its reach.

    On the part land lies below all lenses. In an insert lenses are pits, and the nose rolls over their rim.
    """
    if nose.land is None:
        return np.full(np.shape(x), -np.inf)
    if not nose.pits:
        return np.full(np.shape(x), nose.land + nose.nose)
    square = nose.nose**2 - np.maximum(-nose.past(x, y), 0.0) ** 2
    return np.where(square >= 0.0, nose.land + np.sqrt(np.maximum(square, 0.0)), -np.inf)


@dataclass(frozen=True, eq=False)
class ToolFace(Nose):
    """A face, the nose that cuts it, and the order of its points.

    step : length. Distance of neighbouring points and passes.
    """

    step: float

    @cached_property
    def alike(self) -> bool:
        """Whether the lenses are upright, at the middle of identical cells, and meet without land."""
        off = max(abs(self.face.vertex[0]), abs(self.face.vertex[1]))
        plain = self.window.uniform and self.face.untilted and self.land is None and self.face.form is None
        return plain and off <= 1e-9 * min(self.lattice.pitch)

    def below(self, x: Floats, y: Floats, index: Ints | None) -> Floats:
        """Depth (n,) below the path of the centre of the nose that touches the face; 0 where it reaches."""
        z, normal = self.surface(x, y, index)
        cx, cy, cz = x + self.nose * normal[:, 0], y + self.nose * normal[:, 1], z + self.nose * normal[:, 2]
        found = np.maximum(over_land(self, cx, cy) - cz, 0.0)
        (rows,) = np.nonzero(self.past(cx, cy) > -self.reach)  # else it touches its own lens alone
        if len(rows):
            own = None if index is None else index[rows]
            path = self.path_height(cx[rows], cy[rows], own)
            found[rows] = np.fmax(path - cz[rows], 0.0)
        return found

    def rows(self, x: Floats, y: Floats) -> Floats:
        """Rows (n, 10) of points of the sheet, in the order of `COLUMNS`, without points off the cells."""
        table = self.table(x, y)
        table[:, 9] = table[:, 9] <= DEEP * min(self.lattice.pitch)
        return table

    def table(self, x: Floats, y: Floats) -> Floats:
        """Rows (n, 10) as `rows`, with the depth below the path in place of the flag."""
        index, u, v = self.window.locate(self.array, x, y)
        kept = self.window.lattice.contains(index)
        x, y, u, v, index = x[kept], y[kept], u[kept], v[kept], index[kept]
        own = None if self.window.uniform else index
        z, normal = self.surface(u, v, own)
        centre = np.column_stack([x, y, z]) + self.nose * normal
        table = np.column_stack([x, y, z, normal, centre, self.below(u, v, own)])
        table[:, [1, 4, 7]] *= self.way
        return table

    @cached_property
    def depths(self) -> tuple[Floats, Floats, Ints | None]:
        """Depths (m, k) below the path at k places of m cells, closer at borders; the share (k,) of a cell
        that each place represents, and the indices (m, 2) of the cells.
        """
        angle = 0.5 * np.pi * ((np.arange(PLACES) + 0.5) / PLACES * 2.0 - 1.0)
        u, v = (one.ravel() for one in np.meshgrid(angle, angle))
        at = np.sin(np.stack([u, v], axis=1)) * np.abs(self.zone).max(axis=0)
        held = self.past(*at.T) <= 0.0
        at, share = at[held], (np.cos(u) * np.cos(v))[held]
        x, y, index = _sampled(self, at)
        found = self.below(x, y, index).reshape(-1, len(at))
        return found, share / share.sum(), None if index is None else index[:: len(at)]

    def left(self) -> dict[str, float]:
        """Material that stays and the part of a cell that is not reached, lengths in design units."""
        tile, small = self.lattice.tile(), DEEP * min(self.lattice.pitch)
        heights = []
        for corner in (False, True):
            above = 0.0
            for ends in [tile] if self.land is None else [self.zone] if self.pits else [tile, self.zone]:
                places = _sampled(self, ends if corner else 0.5 * (ends + np.roll(ends, -1, axis=0)))
                foot = self.lens(*places)[0] if self.land is None or self.pits else self.land  # of a step
                above = max(above, float((self.path_height(*places) - self.nose - foot).max()))
            heights.append(above if above > small else 0.0)
        if not self.alike:
            depths, area, _ = self.depths
            return {
                "seam": heights[0],
                "corner": heights[1],
                "share": float(((depths > small) @ area).mean()),
            }
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


def _sampled(nose: Nose, at: Floats) -> tuple[Floats, Floats, Ints | None]:
    """Places (k, 2) of a cell in the cells by which a sheet is judged; without an index of equal lenses."""
    if nose.window.uniform:
        return at[:, 0], at[:, 1], None
    cells = representative_cells(nose.window, "facets", SAMPLED)
    x, y = np.tile(at, (len(cells), 1)).T
    return x, y, np.repeat(cells, len(at), axis=0)


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
    size = window.lenses(face, window.lattice.cells()).size if face.change is not None else None
    smallest = 1.0 if size is None else float(size.min())
    concave = [-r * smallest for r in principal_radii(face.surface) if r < 0.0]
    if concave and nose > min(concave):
        raise NotPossible(
            f"tool: nose larger than the radius of the concave face: {nose:.6g} against {min(concave):.6g} of"
            f" {label}; take a nose of at most {min(concave):.6g}"
        )
    cells, pitch = max(1, window.lattice.cell_count), window.lattice_of(face.array or 0).pitch
    chosen = min(pitch) / min(64.0, max(4.0, sqrt(most / cells))) if step is None else step
    tool = ToolFace(window, face, nose, chosen)
    depths, _, index = tool.depths
    if not np.isfinite(depths).all():
        raise NotPossible(
            f"tool: {label} has holes between its lenses, into which a nose falls; give it land (layout.form)"
        )
    least = depths.min(axis=1)
    if (worst := int(least.argmax())) >= 0 and least[worst] > DEEP * min(pitch):
        where = "every cell" if index is None else f"cell ({index[worst][0]}, {index[worst][1]})"
        raise NotPossible(
            f"tool: a nose of {nose:.6g} does not enter {where} of {label}: where it touches the lens there"
            f" it cuts {least[worst]:.3g} or more into what is higher around it; take a smaller nose (--nose)"
        )
    return tool


# -- text ------------------------------------------------------------------------------------------


def write_tool(tool: ToolFace, path: Path, scale: float, order: Order, label: str) -> dict[str, Any]:
    """Write the points of a face as CSV, millimetres; return the facts of the file.

    scale : Millimetres per design unit.
    """
    left, count, reached = tool.left(), 0, 0
    head = [
        f"clacad tool points of {label}, unit mm, order {order}, nose {tool.nose * scale!r}",
        "seen from outside, +z out of the material, z = 0 at the apexes"
        + (": the front turned by 180 degrees about x" if tool.way < 0.0 else ""),
        "c: centre of the nose = surface + nose n; tip = centre - nose z; reachable 0: it cuts elsewhere",
        f"left at seams {left['seam'] * scale!r}, at corners {left['corner'] * scale!r}, not reached"
        f" {left['share']!r} of the lenses' area",
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


def tool_misfit(tool: ToolFace, path: Path, scale: float) -> tuple[float, int, int]:
    """Largest distance (mm) of a point or a centre from where it belongs, the number of
    points, and of those reached.

    Infinite where the radius of the nose changes or a centre that leaves its cell is called reachable. The
    radius is that of the file's first row.
    """
    worst, count, reached, nose = 0.0, 0, 0, 0.0
    for table in read_tool(path):
        nose = nose or float(np.linalg.norm(table[0, 6:9] - table[0, :3]))
        own = ToolFace(tool.window, tool.face, nose / scale, tool.step)
        at = table[:, 0] / scale, table[:, 1] * own.way / scale
        wanted = own.table(*at)
        if len(wanted) != len(table):
            return np.inf, count, reached
        wanted[:, [0, 1, 2, 6, 7, 8]] *= scale
        size = min(own.lattice.pitch)
        depth = wanted[:, 9] / size / DEEP
        sure = np.abs(depth - 1.0) > 0.5
        if ((depth <= 1.0) != (table[:, 9] > 0.0))[sure].any() or not np.isfinite(table).all():
            return np.inf, count, reached
        off = np.abs(wanted - table)[_off_the_border(own, *at, 1e-9 * size), :9]
        worst, count = max(worst, float(off.max(initial=0.0))), count + len(table)
        reached += int((table[:, 9] > 0.0).sum())
    return worst, count, reached


def _off_the_border(tool: ToolFace, x: Floats, y: Floats, edge: float) -> Bools:
    """Points (n,) farther from the borders of cells and lenses than rounding moves them."""
    _, u, v = tool.window.locate(tool.array, x, y)
    past = tool.past(u, v)
    return np.asarray((np.abs(past) > edge) & (np.abs(past - 0.5 * tool.window.land.seam) > edge))
