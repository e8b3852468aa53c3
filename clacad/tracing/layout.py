"""A window in the numbers a tracer needs: faces relative to their body, bounds, borders, displacements.

Every number is relative to a cell's centre and to a level inside its own body, so nothing here grows
with the size of the sheet or its distance from the origin.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import isfinite, nan
from typing import Any, NamedTuple

import numpy as np

from clacad.base.types import Bools, Floats, Ints
from clacad.optics.surface import sharpest_bend
from clacad.sheet.lattice import Circle, Lattice, Rectangle, relocate
from clacad.sheet.plate import Plate
from clacad.sheet.window import Body, Face, Surface, Window, in_optical_tile, lens_height_and_normal

SAMPLES = 49
"""Points a side on which a face's height is bounded; the slope times half a spacing is added."""

SLOPE_MARGIN = 1.25
"""Factor on the largest sampled slope: a lens is steepest at its corners, which are sampled."""


@dataclass(frozen=True, eq=False)
class FacePlan:
    """One face, relative to its body.

    Attributes
    ----------
    surface : Quadric, Biconic or EvenPolynomial
    vertex : (3,) lengths
        Apex: x, y from the cell's centre, z from the body's `level`.
    rotation : (3, 3) or None
        Lens → sheet; None when the axes coincide, so that nothing need be turned.
    array : int or None
    land : float
        Height of the land over the body's level; NaN without land.
    low, high : float, lengths
        Bounds of the face's height (lens and land) over the body's level.
    slope : float
        Bound of the lens's slope against the sheet plane.
    whole : bool
        The lens is a graph over all of its optical zone and stands proud of the land there.
    """

    surface: Surface
    vertex: tuple[float, float, float]
    rotation: Floats | None
    array: int | None
    land: float
    low: float
    high: float
    slope: float
    whole: bool


@dataclass(frozen=True, eq=False)
class BodyPlan:
    """One body: two faces, and where it ends.

    Attributes
    ----------
    front, back : FacePlan
    columnar : bool
    level : float, sheet-frame z that heights are relative to (the front apex)
    low, high : float
        Bounds of the material over `level`.
    covered : bool
        Front lies below back everywhere in a cell, so a hit on either lens is a hit on the body.
    separate : bool
        The front's highest point lies below the back's lowest.
    box : (x_min, x_max, y_min, y_max)
        Sheet-frame bounds of the footprint.
    inner : (half_x, half_y, radius)
        A convex region about `centre` that lies inside the footprint: a rectangle cut by a circle.
    outline : ("none" | "circle" | "rectangle" | "plate", half_x, half_y)
    centre : (x, y)
        Of the outline and of `inner`, sheet frame.
    plate : Plate or None
        Where the outline is one: it stands in the sheet frame.
    """

    front: FacePlan
    back: FacePlan
    columnar: bool
    level: float
    low: float
    high: float
    covered: bool
    separate: bool
    box: tuple[float, float, float, float]
    inner: tuple[float, float, float]
    outline: tuple[str, float, float]
    centre: tuple[float, float]
    plate: Plate | None = None

    @property
    def arrays(self) -> tuple[int, ...]:
        """The lens arrays this body carries, each once, in the order of the light."""
        seen = [face.array for face in (self.front, self.back) if face.array is not None]
        return tuple(dict.fromkeys(seen))


@dataclass(frozen=True, eq=False)
class Layout:
    """The window as the tracer sees it.

    Attributes
    ----------
    window : Window
    bodies : tuple of BodyPlan
    normals : (k, 2)
        Unit normals of the borders of a cell, one of each opposite pair (2 or 3).
    halves : (k,) lengths
    margin : float
        Land on the inside of every border: seam / 2.
    whole_steps : (2,) ints, residual : (2,) lengths
        Displacement of array 1 against array 0 = that many lattice steps plus the residual.
    """

    window: Window
    bodies: tuple[BodyPlan, ...]
    normals: Floats
    halves: Floats
    margin: float
    whole_steps: Ints
    residual: Floats

    @property
    def lattice(self) -> Lattice:
        """The pattern of cells."""
        return self.window.lattice

    @property
    def tiny(self) -> float:
        """Length below which a stretch of a ray decides nothing: 1e-12 of a cell, far above rounding."""
        return 1e-12 * float(self.halves.max())

    @cached_property
    def kept(self) -> dict[str, Any]:
        """What others worked out from this layout, kept as long as it lives."""
        return {}


def lay_out(window: Window) -> Layout:
    """Prepare a window for tracing (a few thousand heights are sampled); kept with the window."""
    kept: Layout | None = window.kept.get("layout")
    if kept is None:
        kept = window.kept["layout"] = _laid_out(window)
    return kept


def _laid_out(window: Window) -> Layout:
    lattice = window.lattice
    borders = lattice.steps[: len(lattice.steps) // 2]
    offsets = np.array([lattice.offset(*step) for step in borders])
    lengths = np.hypot(offsets[:, 0], offsets[:, 1])
    shift = np.subtract(window.shifts[1], window.shifts[0])
    sampled = _sample_cell(window)
    steps, residual = relocate(lattice, shift[None, :])
    return Layout(
        window=window,
        bodies=tuple(_plan_body(window, body, sampled) for body in window.bodies),
        normals=offsets / lengths[:, None],
        halves=0.5 * lengths,
        margin=0.5 * window.land.seam,
        whole_steps=steps[0],
        residual=residual[0],
    )


def sheet_position(layout: Layout, array: int, cell: Ints, local: Floats, z: Floats) -> Floats:
    """Sheet-frame points (m, 3) from cell, local coordinates and sheet-frame z; for output only."""
    centre = layout.lattice.centres(cell) + np.asarray(layout.window.shifts[array])
    return np.column_stack([centre + local, z])


# -- bounds ------------------------------------------------------------------------------------


class SampledCell(NamedTuple):
    """Points of a cell where faces are sampled: x, y (m,) and their spacing, lengths; which lie in the optical zone, (m,)."""

    x: Floats
    y: Floats
    spacing: float
    zone: Bools


def _plan_body(window: Window, body: Body, sampled: SampledCell) -> BodyPlan:
    """A body as the tracer needs it: bounds from heights sampled over a cell, lengths over its own level."""
    level = body.front.vertex[2]
    x, y, spacing, zone = sampled
    front_z, front_slope = _sampled(body.front, x, y)
    back_z, back_slope = _sampled(body.back, x, y)
    solid = np.ones(x.shape, dtype=bool)
    if body.columnar:
        with np.errstate(invalid="ignore"):
            solid = front_z <= back_z
    front = _plan_face(body.front, level, front_z, front_slope, zone, solid, spacing)
    back = _plan_face(body.back, level, back_z, back_slope, zone, solid, spacing)
    apart = max(float(np.hypot(*face.vertex[:2])) for face in (body.front, body.back))
    covered = _covered((back_z - front_z)[zone], body, spacing, window.lattice.circumradius + apart)
    if not body.columnar:
        covered = front.high < back.low and front.whole and back.whole
    box, inner, outline, centre = _footprint(window, body)
    pad = 1e-9 * window.lattice.circumradius
    return BodyPlan(
        front=front,
        back=back,
        columnar=body.columnar,
        level=level,
        low=front.low - pad,
        high=back.high + pad,
        covered=covered,
        separate=front.high < back.low,
        box=box,
        inner=inner,
        outline=outline,
        centre=centre,
        plate=window.outline if isinstance(window.outline, Plate) else None,
    )


def _covered(gap: Floats, body: Body, spacing: float, reach: float) -> bool:
    """Whether the sampled thickness is positive by more than a lens, `reach` (length) wide, can bend between two samples."""
    bend = sum(sharpest_bend(face.surface, reach) for face in (body.front, body.back))
    return bool(np.isfinite(gap).all() and gap.min() > bend * spacing * spacing)


def _sample_cell(window: Window) -> SampledCell:
    """Points over one cell, its borders and corners included."""
    tile = window.lattice.tile()
    low, high = tile.min(axis=0), tile.max(axis=0)
    grid = np.stack(
        np.meshgrid(*(np.linspace(a, b, SAMPLES) for a, b in zip(low, high, strict=True))), axis=-1
    ).reshape(-1, 2)
    along = np.linspace(0.0, 1.0, SAMPLES)[:, None, None]
    edges = (tile * (1.0 - along) + np.roll(tile, -1, axis=0) * along).reshape(-1, 2)
    if window.lattice.hexagonal:
        step = window.lattice.steps[:3]
        half = window.lattice.half_widths
        keep = np.ones(len(grid), dtype=bool)
        for s, h in zip(step, half):
            ox, oy = window.lattice.offset(*s)
            keep &= np.abs(grid @ np.array([ox, oy])) <= 2.0 * h * h
        grid = grid[keep]
    x, y = np.concatenate([grid, edges]).T
    return SampledCell(x, y, float(np.max(high - low)) / (SAMPLES - 1), in_optical_tile(window, x, y))


def _sampled(face: Face, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Height and slope of a face's lens at the sample points."""
    if face.array is None:
        return np.full(x.shape, face.vertex[2]), np.zeros(x.shape)
    z, normal = lens_height_and_normal(face, x, y)
    with np.errstate(invalid="ignore", divide="ignore"):
        return z, np.hypot(normal[:, 0], normal[:, 1]) / normal[:, 2]


def _plan_face(
    face: Face, level: float, z: Floats, slope: Floats, zone: Bools, solid: Bools, spacing: float
) -> FacePlan:
    """A face over the body's level, with bounds from m sampled heights and slopes, `spacing` apart."""
    land = nan if face.land is None else face.land - level
    seen = zone & solid & np.isfinite(z)
    steepest = SLOPE_MARGIN * float(slope[seen].max(initial=0.0))
    heights = z[seen] - level
    margin = steepest * spacing
    low = float(heights.min(initial=np.inf)) - margin
    high = float(heights.max(initial=-np.inf)) + margin
    if face.array is None:
        low = high = face.vertex[2] - level
    if isfinite(land):
        low, high = min(low, land), max(high, land)
    if not low <= high:  # no lens and no land anywhere: the body is empty
        low = high = 0.0
    proud = face.land is None or bool(
        ((z[zone] - level - land) * face.side <= 0.0).all() if seen[zone].all() else False
    )
    return FacePlan(
        surface=face.surface,
        vertex=(face.vertex[0], face.vertex[1], face.vertex[2] - level),
        rotation=None if face.untilted else face.rotation,
        array=face.array,
        land=land,
        low=low,
        high=high,
        slope=steepest,
        whole=bool(seen[zone].all()) and proud,
    )


Box = tuple[float, float, float, float]
Footprint = tuple[Box, tuple[float, float, float], tuple[str, float, float], tuple[float, float]]


def _footprint(window: Window, body: Body) -> Footprint:
    """Bounding box, a region inside, the outline and the centre of both."""
    arrays = {face.array for face in (body.front, body.back) if face.array is not None}
    if window.outline is None:
        shift = window.shifts[body.front.array if body.front.array is not None else arrays.pop()]
        x0, x1, y0, y1 = window.lattice.extent()
        box = (x0 + shift[0], x1 + shift[0], y0 + shift[1], y1 + shift[1])
        middle = (0.5 * (box[0] + box[1]), 0.5 * (box[2] + box[3]))
        return box, _inside_cells(window.lattice, box), ("none", 0.0, 0.0), middle
    if isinstance(window.outline, Plate):
        x0, x1, y0, y1 = window.outline.box
        middle = (0.5 * (x0 + x1), 0.5 * (y0 + y1))
        return (x0, x1, y0, y1), (*window.outline.free_box, np.inf), ("plate", 0.0, 0.0), middle
    cx, cy = window.shifts[arrays.pop()] if len(arrays) == 1 else (0.0, 0.0)
    if isinstance(window.outline, Circle):
        half = 0.5 * window.outline.diameter
        return (
            (cx - half, cx + half, cy - half, cy + half),
            (half, half, half),
            ("circle", half, half),
            (cx, cy),
        )
    hx, hy = 0.5 * window.outline.width, 0.5 * window.outline.height
    return (cx - hx, cx + hx, cy - hy, cy + hy), (hx, hy, np.inf), ("rectangle", hx, hy), (cx, cy)


def _inside_cells(lattice: Lattice, box: Box) -> tuple[float, float, float]:
    """A region about the middle of `box` that lies in the union of the kept cells."""
    half_x, half_y = 0.5 * (box[1] - box[0]), 0.5 * (box[3] - box[2])
    if not lattice.hexagonal and lattice.outline is None:
        return half_x, half_y, np.inf
    lost = 2.0 * lattice.circumradius  # a cell that is cut is left out
    if isinstance(lattice.outline, Circle):
        # the box of the kept cells need not be centred on the outline to better than a cell
        return half_x, half_y, 0.5 * lattice.outline.diameter - 2.0 * lost
    if isinstance(lattice.outline, Rectangle):
        return 0.5 * lattice.outline.width - 2.0 * lost, 0.5 * lattice.outline.height - 2.0 * lost, np.inf
    return half_x - lost, half_y - lost, np.inf
