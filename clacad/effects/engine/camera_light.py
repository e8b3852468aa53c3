"""The light a picture needs: for every camera ray, the rays that carry radiance to it.

A trace gives one row per ray. A picture may need more than one (a ghost on the homogeneous sheet, a split
path) or none (a ghost that is not shown). `light_reaching_camera` returns them as one flat list.

Rung law has no cells: every ray carries the closed-form share of the light that stays with its partner, and
with `ghosts` one further ray per ghost order (`clacad.effects.engine.camera_light`).

Split paths are compiled for rays through lenses only; the non-sequential trace finds the rest, and follows
rays that ended for effects that let them continue. The change that an effect makes is measured on the scene's
probe rays, traced with it and without.

Light through the homogeneous sheet: the law's direction, with the share that lenslets would transmit.

Where a picture point covers many lenslets, one ray represents the light of all of them. A share V follows the
law. Shares V_m go into ghost orders m, whose slopes differ from the law's by a constant. Both are closed
forms of the thin pair (`clacad.sheet.vignetting`).

Rays that carry radiance to the camera, as one flat list: the common result of all kinds of light.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.polygons import polygon_area
from clacad.base.types import Bools, Floats, Ints, Rows, Rung
from clacad.effects import declared_all
from clacad.effects.engine.effect import Declaration, Effect, RayBlock, Setting, Situation, unit_rows
from clacad.effects.engine.nonsequential import Rules, trace_nonsequential
from clacad.effects.engine.passes import blocks, take_rays, trace_with
from clacad.light.compare import angles
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.optics.surface import Quadric
from clacad.sheet.face_order import media_of
from clacad.sheet.need_window import need_one_eta
from clacad.sheet.vignetting import (
    ThinCells,
    arrivals,
    ghost_step,
    off_partner,
    partner_step,
    partner_zone,
    scale_of_image,
    share_of_zone,
    thin_cells,
)
from clacad.sheet.window import Window
from clacad.tracing.layout import lay_out
from clacad.tracing.ledger import RayColumns


@dataclass(frozen=True, eq=False)
class LightRays(RayColumns):
    """Rays that carry radiance from the scene to the camera.

    Attributes
    ----------
    parent : (m,) ints
        The launched ray whose picture point receives the light.
    position, direction : (m, 3), sheet frame
        Point where the ray leaves the sheet and its unit direction; d_z < 0 goes back to the camera's side.
    flux : (m,)
        Factor on the radiance at which the ray ends.
    """

    parent: Rows
    position: Floats
    direction: Floats
    flux: Floats

    def __len__(self) -> int:
        return len(self.flux)


FAINT = 1e-6
"""Shares below this are not listed."""


def law_light(window: Window, rays: Rays, result: TraceResult, ghosts: bool) -> LightRays:
    """Light of the rays that pass the sheet on rung law.

    Raises CellsDiffer: Ghosts of cells with an eta of their own.
    """
    if ghosts:
        other = "rungs thin and surfaces trace those of cells with an eta of their own"
        need_one_eta(window, "ghosts on rung law", other)
    rows = np.flatnonzero(result.fate == Fate.ALIVE)
    cells = thin_cells(window)
    slopes = cells.slopes(rays.direction[rows])
    index = None if window.uniform else result.cell[rows].astype(np.int64)
    parts = [_order(window, cells, result, (rows, index), slopes, (0, 0))]
    if ghosts and window.baffle is None:
        met = orders(cells, slopes, index)
        parts += [_order(window, cells, result, (rows, index), slopes, order) for order in met]
    return LightRays.joined(parts)


def _order(
    window: Window,
    cells: ThinCells,
    result: TraceResult,
    chosen: tuple[NDArray[np.intp], Ints | None],
    slopes: Floats,
    order: tuple[int, int],
) -> LightRays:
    """Light of one order, from rays, rows (k,), cells of a non-uniform sheet, lens-frame slopes (k, 2)."""
    rows, index = chosen
    flux = result.flux[rows] * shares(cells, slopes, order, index)
    kept = np.flatnonzero(flux > FAINT)  # most rays reach but a few of the orders that some ray reaches
    rows, flux = rows[kept], flux[kept]
    index = None if index is None else index[kept]
    direction = result.direction[rows]
    if order != (0, 0):
        rotation = window.thin.rotation
        turned = direction @ rotation
        with np.errstate(divide="ignore", invalid="ignore"):
            out = np.column_stack(
                [turned[:, :2] / turned[:, 2:] + ghost_step(cells, order, index), np.ones(len(rows))]
            )
        direction = (out / np.sqrt((out * out).sum(axis=1))[:, None]) @ rotation.T
        ahead = direction[:, 2] > 0.0
        rows, flux, direction = rows[ahead], flux[ahead], direction[ahead]
    return LightRays(rows, result.position[rows], direction, flux)


def orders(cells: ThinCells, slopes: Floats, index: Ints | None = None) -> list[tuple[int, int]]:
    """Ghost orders that light of lens-frame slopes (m, 2) can reach.

    `index` (m, 2): cells of a non-uniform sheet.
    """
    if not len(slopes):
        return []
    reach = arrivals(cells, slopes) - cells.centre if index is None else off_partner(cells, index, slopes)
    zone = partner_zone(cells)
    low = reach.min(axis=0) + cells.image.min(axis=0) + zone.min(axis=0)
    high = reach.max(axis=0) + cells.image.max(axis=0) + zone.max(axis=0)
    steps = np.array([partner_step(cells, (1, 0)), partner_step(cells, (0, 1))])
    corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
    indices = corners @ np.linalg.inv(steps)
    bounds = [(int(np.floor(indices[:, k].min())), ceil(indices[:, k].max())) for k in (0, 1)]
    listed = [
        (i, j) for i in range(bounds[0][0], bounds[0][1] + 1) for j in range(bounds[1][0], bounds[1][1] + 1)
    ]
    return [order for order in listed if order != (0, 0)]


def shares(cells: ThinCells, slopes: Floats, order: tuple[int, int], index: Ints | None = None) -> Floats:
    """Share (m,) of the light of lens-frame slopes (m, 2) that goes into an order; `index` as in `orders`."""
    if index is None:
        shift = arrivals(cells, slopes) - cells.neighbour(order)
    else:
        shift = off_partner(cells, index, slopes) - partner_step(cells, order)
    ratio = None if index is None else scale_of_image(cells, index)
    if ratio is None:
        found = cells.part / polygon_area(cells.image) * overlap(cells.image, partner_zone(cells), shift)
    else:
        found = share_of_zone(cells, shift, ratio)
    if index is None or order == (0, 0):
        return np.asarray(found)
    return np.where(cells.window.lattice.contains(index + np.array(order)), found, 0.0)


def overlap(moved: Floats, fixed: Floats, shift: Floats) -> Floats:
    """Area (n,) that two convex polygons share when the first is moved by each shift (n, 2).

    moved, fixed : (k, 2), (m, 2). Corners, counter-clockwise.

    Notes
    -----
    The border of the common area consists of the parts of each polygon's sides inside the other. Its area is
    half the sum of x dy − y dx along them: no corner is ever constructed. Coincident sides are counted once.
    For two rectangles along the axes it is the product of the overlaps on each axis.
    """
    low, high = fixed.min(axis=0) - moved.max(axis=0), fixed.max(axis=0) - moved.min(axis=0)
    meet = np.flatnonzero(((shift > low) & (shift < high)).all(axis=1))
    near, area = shift[meet], np.zeros(len(shift))
    if _upright(moved) and _upright(fixed):
        right = np.minimum(moved.max(axis=0) + near, fixed.max(axis=0))
        area[meet] = (right - np.maximum(moved.min(axis=0) + near, fixed.min(axis=0))).prod(axis=1)
    else:
        first = _along_sides(moved, fixed, near, closed=True)
        area[meet] = first + _along_sides(fixed, moved, -near, closed=False, origin=near)
    return area


def _upright(polygon: Floats) -> bool:
    """Whether a convex polygon (m, 2) is a rectangle along the axes."""
    low, high = polygon.min(axis=0), polygon.max(axis=0)
    off = np.minimum(polygon - low, high - polygon)
    return len(polygon) == 4 and bool((np.abs(off) <= 1e-14 * (high - low)).all())


def _along_sides(
    polygon: Floats, other: Floats, shift: Floats, closed: bool, origin: Floats | None = None
) -> Floats:
    """½ ∮ (x dy − y dx), (n,), along the sides of a polygon moved by `shift`, as far as inside the other.

    `origin` is the reference point of the area: both polygons must use the same.
    """
    area = np.zeros(len(shift))
    normals = np.roll(other, -1, axis=0) - other
    inward = np.column_stack([-normals[:, 1], normals[:, 0]])
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        low, high = np.zeros(len(shift)), np.ones(len(shift))
        for corner, normal in zip(other, inward, strict=True):
            here = (start - corner + shift) @ normal
            speed = float((end - start) @ normal)
            if abs(speed) <= 1e-12 * float(np.hypot(*(end - start)) * np.hypot(*normal)):
                outside = here < 0.0 if closed else here <= 0.0
                high = np.where(outside, low, high)
            elif speed > 0.0:
                low = np.maximum(low, -here / speed)
            else:
                high = np.minimum(high, -here / speed)
        place = start + shift if origin is None else start + shift + origin
        along = end - start
        swept = place[:, 0] * along[1] - place[:, 1] * along[0]
        area += 0.5 * swept * np.maximum(high - low, 0.0)
    return area


def rules_for(window: Window, setting: Setting, wavelength: float | None, order: int = 0) -> Rules:
    """Rules of the interfaces with the effects that are on."""
    kinds = declared_all(setting.active)
    follows = {kind.shows for kind in kinds if kind.follows}
    attenuation: tuple[float, ...] = ()
    for kind in kinds:
        if kind.attenuations is not None:
            attenuation = kind.attenuations(window, setting, wavelength)
    ratio = 1.0
    if window.wavelength is not None and wavelength is not None:
        ratio = window.wavelength / wavelength
    return Rules(
        walls=Fate.WALL in follows,
        total=Fate.TIR in follows,
        losses=any(kind.loses for kind in kinds),
        order=order,
        faces=setting.faces,
        attenuation=attenuation,
        media=media_of(window.bodies, wavelength),
        coating=setting.coating,
        ratio=ratio,
    )


def trace_ended_rays(block: RayBlock, setting: Setting, fate: Fate) -> None:
    """Follow the block's rays of one fate until they leave; rays that do not leave get flux 0."""
    result = block.result
    rows = np.flatnonzero(result.fate == fate)
    if not len(rows) or block.rung in ("law", "thin"):
        return
    out = trace_nonsequential(
        block.window, block.rays, rows, rules_for(block.window, setting, block.wavelength)
    )
    result.flux[rows] = 0.0
    result.flux[out.parent] = out.flux
    result.position[out.parent] = out.position
    result.direction[out.parent] = out.direction
    result.optical_path[out.parent] = out.optical_path


def reflected_paths(
    window: Window, rays: Rays, result: TraceResult, setting: Setting, compiled: bool
) -> LightRays:
    """Paths with at least one partial reflection, of the rays that hit the sheet.

    rays : n as launched.
    result : Their trace without splitting: n rows.
    setting : With the effects that are on; `order` is the largest number of reflections in a path.
    compiled : Use compiled code for rays through lenses only; it ends paths at steps, seams and edges.
    """
    left = result.fate < Fate.MISSED
    parts = []
    if compiled and known_to_compiled(window, setting):
        light, done = split_by_compiled(window, rays, setting)
        parts.append(light)
        left &= ~done
    every = np.arange(len(rays))
    for chosen, wavelength in blocks(rays, by_colour=True):
        rows = every[chosen]
        met = np.flatnonzero(left[rows])
        if not len(met):
            continue
        rules = rules_for(window, setting, wavelength, setting.order)
        out = trace_nonsequential(window, take_rays(rays, rows), met, rules)
        kept = out.bounces > 0
        parts.append(
            LightRays(rows[out.parent[kept]], out.position[kept], out.direction[kept], out.flux[kept])
        )
    nothing = LightRays(np.zeros(0, dtype=np.intp), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    return LightRays.joined(parts) if parts else nothing


def known_to_compiled(window: Window, setting: Setting) -> bool:
    """Whether the compiled paths support everything in the window."""
    plain = window.uniform and all(isinstance(face.surface, Quadric) for face in window.faces)
    apart = window.baffle is None and not any(body.joined for body in window.bodies)
    return plain and apart and setting.order <= 2


def split_by_compiled(window: Window, rays: Rays, setting: Setting) -> tuple[LightRays, Bools]:
    """Split paths of the rays that passed lenses only, and which rays (n,) those are.

    setting : With the effects that are on.
    """
    from clacad.effects.engine.compiled_passes import Passing, SplitPaths, bounce_pass
    from clacad.tracing.compiled.packing import pack
    from clacad.tracing.trace import trace

    sheet = pack(lay_out(window))
    done = np.zeros(len(rays), dtype=bool)
    parts = []
    every = np.arange(len(rays))
    for chosen, wavelength in blocks(rays, by_colour=True):
        part = take_rays(rays, chosen)
        result = trace(window, part, "surfaces", record=True, threads=1, path="numba")
        assert result.hits is not None
        assert result.directions is not None
        rows = np.flatnonzero(result.fate <= Fate.GHOST)
        done[every[chosen][rows]] = True
        rules = rules_for(window, setting, wavelength, setting.order)
        index = np.array(rules.media)
        rates = np.array(rules.attenuation or (0.0,) * len(window.bodies))
        shape = len(rows), len(sheet.faces) * (len(sheet.faces) + 1) // 2
        paths = SplitPaths(np.empty((*shape, 3)), np.empty((*shape, 3)), np.zeros(shape))
        passing = Passing(index, rates, rules.ratio if setting.coating == "quarter-wave" else 0.0)
        onwards = unit_rows(part.direction)
        bounce_pass(sheet, passing, setting.order, rows, onwards, result.hits, result.directions, paths)
        lit = paths.flux > 0.0
        parent = np.broadcast_to(every[chosen][rows][:, None], lit.shape)[lit]
        parts.append(LightRays(parent, paths.position[lit], paths.direction[lit], paths.flux[lit]))
    return LightRays.joined(parts), done


MANY = 50_000
"""Number of rays above which split paths are compiled: loading costs as much as some thousand rays."""


def light_reaching_camera(
    window: Window,
    rays: Rays,
    rung: Rung,
    effects: Sequence[str | Effect] = (),
    setting: Setting | None = None,
    **options: Any,
) -> tuple[LightRays, TraceResult]:
    """Trace camera rays and return the light that they collect.

    Parameters
    ----------
    effects : names of the effects that are on, or `Effect`
    setting : Setting
        Their parameters.
    options
        Passed on to `clacad.tracing.trace.trace`.

    Returns
    -------
    light : LightRays
        ALIVE and LAND rays; GHOST with `ghosts`; WALL and TIR with `walls` and `tir_paths`; split paths with
        `reflections`. Rays that miss the sheet are not listed: the caller knows what surrounds it.
    result : TraceResult
        One row a ray.
    """
    setting = setting or Setting()
    names = tuple(effect if isinstance(effect, str) else effect.name for effect in effects)
    kinds = declared_all(names)
    ghosts = any(kind.shows is Fate.GHOST for kind in kinds)
    result = trace_with(window, rays, rung, effects, setting=setting, **options)
    if rung == "law":
        return law_light(window, rays, result, ghosts), result
    rows = np.flatnonzero(shining(result, names))
    light = LightRays(rows, result.position[rows], result.direction[rows], result.flux[rows])
    if any(kind.splits for kind in kinds) and rung in ("surfaces", "mesh"):
        compiled = options.get("path") == "numba" or (options.get("path") != "numpy" and len(rays) > MANY)
        extra = reflected_paths(window, rays, result, replace(setting, active=names), compiled)
        light = LightRays.joined([light, extra])
    return light, result


def shining(result: TraceResult, names: Sequence[str]) -> Bools:
    """Which rows of a trace carry light, given the effects that are on, (n,)."""
    fates = {Fate.ALIVE, Fate.LAND, *(kind.shows for kind in declared_all(names) if kind.shows is not None)}
    return np.isin(result.fate, list(fates)) & (result.flux > 0.0)


MOST = 0.99
"""Share of the light over which the largest change of direction is taken."""


def measure(situation: Situation, kind: Declaration) -> tuple[float, float]:
    """Change of direction (radians) and of radiance (relative) that an effect makes.

    Returns
    -------
    angle : float
        As defined by the effect's `measured`: the largest of 99 % of the light (a few rays at borders change
        lenslets without changing order), the largest, the rms, or the angle that contains half of the light.
    radiance : float
        Mean over the rays on the sheet of the light added or removed; light redirected by reflection
        counts with the contrast and brightness of the scene that it then comes from.
    """
    if kind.measured is not None:
        return kind.measured(situation)
    return 0.0, radiance_change(situation, kind.name)


def radiance_change(situation: Situation, name: str) -> float:
    """Mean change (relative) of the light that reaches the camera from the rays on the sheet."""
    n = len(situation.rays)
    before, after = (
        np.bincount(light.parent, weights=light.flux, minlength=n)
        for light in (light_with(situation), light_with(situation, name))
    )
    return float(np.abs(after - before)[situation.met].mean())


def traced_with(situation: Situation, *names: str) -> TraceResult:
    """The probe rays with these effects, by exact surfaces; reproducible to the bit."""
    window, rays = situation.window, situation.rays
    return trace_with(window, rays, "surfaces", names, setting=situation.setting, path="size")


def light_with(situation: Situation, *names: str) -> LightRays:
    """The light that reaches the camera with these effects, by exact surfaces."""
    window, rays = situation.window, situation.rays
    return light_reaching_camera(window, rays, "surfaces", names, situation.setting, path="size")[0]


def turned_angles(situation: Situation, name: str, last: Fate = Fate.GHOST) -> Floats:
    """Angles (k,), radians, by which an effect deflects rays that pass with fates up to `last`.

    Without such rays the result is (1,) zero.
    """
    turned = angles(traced_with(situation), traced_with(situation, name), last)
    return turned if len(turned) else np.zeros(1)
