"""Situation of a design, window or scene for the planner: probe rays, distances, brightness of objects.

The cheapest rung whose picture of a scene agrees with the exact surfaces within the tolerance.

Uniform equivalents of cells, on which effects are bounded for a non-uniform sheet.

An effect's bound is computed for one cell with identical neighbours (`clacad.sheet.like_cell`) and the light
that reaches that cell. The cells tried, among those lit, are the ones with the outermost lenses, and a
sample. The error without the effect is then at most that of the worst of them. Effects that only count rays
also count them on the whole sheet.

Averages over a cell for some effects: thickness of a body, height of its steps.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import hypot, inf, pi, radians, tan
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from clacad.base.sobol import sobol
from clacad.base.text import mrad_text
from clacad.base.types import Floats, Ints, Rung
from clacad.base.vectors import picture_axes
from clacad.effects.engine.effect import PROBE, Bound, Declaration, Setting, Situation
from clacad.light.compare import rms_between
from clacad.optics.rays import Fate, Rays
from clacad.sheet.like_cell import like_cell
from clacad.sheet.representative_cells import representative_cells, rows_through_outermost
from clacad.sheet.vignetting import aperture_slope, aperture_slopes, focal_ratio, thin_cells
from clacad.sheet.window import Body, Face, Window, column, face_height, optical_tile
from clacad.tracing.layout import prepared

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.scene import Scene, SceneObject


RAYS = 512
"""Number of rays through each cell that is tried."""

TINY = 1e-300
"""Replaces an angle or a radiance tolerance of 0."""


def worst_bound(situation: Situation, kind: Declaration) -> Bound:
    """Bound of an effect: that of a uniform sheet itself, else that of the worst cell tried."""
    if not situation.stand_ins:
        return kind.bound(situation)
    every = [kind.bound(one) for _, one in situation.stand_ins]
    unknown = [one for one in every if not one.known]
    if unknown:
        return unknown[0]
    parts = [
        max(one.angle / max(situation.angle, TINY), one.radiance / max(situation.radiance, TINY))
        for one in every
    ]
    worst = int(np.argmax(parts))
    i, j = situation.stand_ins[worst][0]
    counted = 0.0 if kind.shows is None else situation.share(kind.shows)
    radiance = max(one.radiance for one in every)
    if (
        kind.shows is Fate.WALL and situation.window.many_sizes
    ):  # steps between lenses of different sizes: a uniform sheet has none
        radiance = max(radiance, situation.most(counted))
    return Bound(
        max(one.angle for one in every),
        max(radiance, situation.most(counted)) if counted > 0.0 else radiance,
        f"in cell ({i}, {j}), the worst of {len(every)} tried: {every[worst].why}"
        if parts[worst] > min(parts)
        else every[worst].why,
        max(one.cost for one in every),
    )


def with_stand_ins(situation: Situation) -> Situation:
    """The situation, for a non-uniform sheet with the uniform equivalents that bound its effects."""
    window = situation.window
    if window.uniform:
        return situation
    return replace(situation, stand_ins=tuple(_stand_ins(situation)))


def _stand_ins(situation: Situation) -> Iterator[tuple[tuple[int, int], Situation]]:
    """Lit cells, each with its light on its uniform equivalent."""
    rays = situation.rays
    cells, x, y = situation.window.lattice.locate(*_in_sheet(rays).T)
    # the slope at the middle of the cell that a ray hits
    way = rays.direction[:, :2] / rays.direction[:, 2:] - np.column_stack([x, y]) / situation.sheet_distance
    for row in rows_through_outermost(situation.window, cells):
        like = like_cell(situation.window, cells[row], widest=False)
        slope = np.array(aperture_slope(like)) if situation.spread > 0.0 else way[row]
        light = _over_cell(like, cells[row], slope, situation)
        i, j = cells[row].tolist()
        yield (i, j), replace(situation, window=like, rays=light, stand_ins=())


def _in_sheet(rays: Rays) -> Floats:
    """Points (n, 2) where rays cross z = 0."""
    step = rays.position[:, 2:] / rays.direction[:, 2:]
    return np.asarray(rays.position[:, :2] - step * rays.direction[:, :2])


def _over_cell(like: Window, cell: Ints, slope: Floats, situation: Situation) -> Rays:
    """Light of a slope over a whole cell: as the camera sees it, or in a cone about it."""
    within = like.lattice.over_cell(sobol(RAYS, 2))
    point = like.centres(0, cell) + within
    slopes = slope + within / situation.sheet_distance
    if situation.spread > 0.0:
        slopes = slopes + situation.spread * _disc(sobol(RAYS, 4)[:, 2:])
    below = like.z_range[0] - 0.25 * min(like.lattice.pitch)
    start = np.column_stack([point + below * slopes, np.full(len(point), below)])
    return Rays(start, np.column_stack([slopes, np.ones(len(point))]))


def _disc(u: Floats) -> Floats:
    """Points (n, 2) of the unit disc, evenly, from points (n, 2) of the unit square."""
    radius, turn = np.sqrt(u[:, 0]), 2.0 * np.pi * u[:, 1]
    return np.asarray(radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)]))


GRID = 33


def cell_points(window: Window) -> Floats:
    """Points (m, 2) spread evenly over the optical zone of a cell, cell frame."""
    tile = optical_tile(window)
    low, high = tile.min(axis=0), tile.max(axis=0)
    steps = (np.arange(GRID) + 0.5) / GRID
    grid = np.stack(np.meshgrid(*(a + (b - a) * steps for a, b in zip(low, high, strict=True))), -1)
    points = grid.reshape(-1, 2)
    following = np.roll(tile, -1, axis=0)
    inside = np.ones(len(points), dtype=bool)
    for (ax, ay), (bx, by) in zip(tile, following, strict=True):
        inside &= (bx - ax) * (points[:, 1] - ay) - (by - ay) * (points[:, 0] - ax) >= 0.0
    return points[inside]


def mean_thickness(window: Window, body: Body) -> float:
    """Mean extent of a body along z for light near the axis, length.

    In a non-uniform sheet of a sample of cells.

    Lens 1's light arrives at lens 2 as a copy scaled by m = −f2/f1 per meridian. Only |m| of lens 2 is lit
    where |m| < 1; only 1/|m| of lens 1 is transmitted where |m| > 1.
    """
    if not window.uniform:
        return _over_cells(window, window.bodies.index(body))
    m = np.abs(focal_ratio(window.thin))
    scale = np.ones(2)
    arrays = {face.array for face in (body.front, body.back)}
    if 0 in arrays and 1 not in arrays:
        scale = np.minimum(1.0, 1.0 / m)
    elif 1 in arrays and 0 not in arrays:
        scale = np.minimum(1.0, m)
    elif 2 in arrays:  # light of one direction is a point there
        scale = np.zeros(2)
    turn = window.thin.rotation[:2, :2]
    points = (cell_points(window) @ turn * scale) @ np.linalg.inv(turn)
    front, back = _heights(window, body, *points.T)
    return float(np.nanmean(np.maximum(back - front, 0.0)))


def _over_cells(window: Window, number: int) -> float:
    """Mean thickness of a body over cells spread over the sheet; kept with the window."""
    kept: dict[int, float] = prepared(window).setdefault("mean_thickness", {})
    if number not in kept:
        likes = [like_cell(window, cell, widest=False) for cell in representative_cells(window, "sample")]
        kept[number] = float(np.mean([mean_thickness(like, like.bodies[number]) for like in likes]))
    return kept[number]


def _heights(window: Window, body: Body, x: Floats, y: Floats) -> tuple[Floats, Floats]:
    if body.columnar:
        return column(window, body, x, y)
    return face_height(window, body.front, x, y), face_height(window, body.back, x, y)


def mean_steps(window: Window) -> float:
    """Σ over faces and cell directions of mean step height over the cell's width.

    Where two cells meet, both have their own height of the face along the common border. Light of slope t
    loses at most about t times the mean step over the pitch there.
    """
    lattice = window.lattice
    total = 0.0
    for face in window.faces:
        if face.array is None:
            continue
        for step, half in zip(lattice.steps[: len(lattice.steps) // 2], lattice.half_widths):
            total += _mean_step(window, face, np.array(lattice.offset(*step))) / (2.0 * half)
    return total


def _mean_step(window: Window, face: Face, offset: Floats) -> float:
    """Mean |height here − height there| along the border towards the neighbour at `offset`."""
    length = float(np.hypot(*offset))
    normal = offset / length
    along = np.array([-normal[1], normal[0]])
    width = float(np.ptp(window.lattice.tile() @ along))
    if window.lattice.hexagonal:
        width = length / np.sqrt(3.0)
    places = (np.arange(GRID) + 0.5) / GRID - 0.5
    here = 0.5 * offset * (1.0 - 1e-9) + np.outer(places * width, along)
    there = here - offset * (1.0 - 1e-9)
    step = face_height(window, face, *here.T) - face_height(window, face, *there.T)
    return float(np.nanmean(np.abs(step))) if np.isfinite(step).any() else 0.0


FINEST = 0.15e-3
"""Smallest angle that angle = "auto" can request, radians: half a minute of arc."""

RADIANCE = 0.01
"""Default smallest relative radiance that matters."""

FIELD = pi / 180.0
"""Half angle of the bundle for a bare window, radians."""


def situation_of_window(
    window: Window,
    setting: Setting | None = None,
    angle: float = 1e-3,
    radiance: float = RADIANCE,
    field: float = FIELD,
) -> Situation:
    """A cone of parallel bundles about the middle of the field, over the cells in the middle of the sheet.

    For a non-uniform sheet: over a sample of cells, each about the middle of its own field.

    angle, radiance : Smallest change that matters.
    field : radians. Half angle of the cone.
    """
    spread = tan(field)
    return Situation(window, setting or Setting(), cone(window, field), angle, radiance, spread=spread)


def cone(window: Window, field: float, count: int = PROBE) -> Rays:
    """Rays of a cone about the middle of the field, starting below the sheet."""
    u = sobol(count, 4)
    cells = middle_cells(window) if window.uniform else representative_cells(window, "sample")
    centres = window.lattice.centres(cells)
    cell = np.minimum((u[:, 0] * len(centres)).astype(np.intp), len(centres) - 1)
    # one parallelogram of the lattice per cell: even for any outline of the cell
    part = np.column_stack([u[:, 0] * len(centres) % 1.0, u[:, 1]]) - 0.5
    within = part @ np.array([window.lattice.a1, window.lattice.a2])
    point = centres[cell] + within
    radius, turn = tan(field) * np.sqrt(u[:, 2]), 2.0 * pi * u[:, 3]
    middle = np.array(aperture_slope(window)) if window.uniform else aperture_slopes(window, cells)[cell]
    slope = middle + radius[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    depth = 0.25 * min(window.lattice.pitch)
    start = np.column_stack([point - depth * slope, np.full(count, window.z_range[0] - depth)])
    return Rays(start, np.column_stack([slope, np.ones(count)]))


def middle_cells(window: Window) -> NDArray[np.int64]:
    """Cells (m, 2) in the middle of the sheet, at most about 49."""
    cells = window.lattice.with_count(
        (min(7, window.lattice.count[0]), min(7, window.lattice.count[1]))
    ).cells()
    every = window.lattice.centres(window.lattice.cells()) if window.lattice.cell_count <= 4096 else None
    if every is None:
        return np.asarray(cells + (np.array(window.lattice.count) - np.array([7, 7])) // 2)
    near = np.argsort(np.hypot(*every.T), kind="stable")[: len(cells)]
    return np.asarray(window.lattice.cells()[near])


def situation_of_design(design: Design, angle: float | None = None, radiance: float = RADIANCE) -> Situation:
    """The bundle by which the design is verified; angles that matter: its `law_rms`."""
    from clacad.prescription.prescribe import prescribe

    window = prescribe(design)
    tolerance = design.check.law_rms if angle is None else angle
    return situation_of_window(window, design_setting(design), tolerance, radiance, design.check.field)


def design_setting(design: Design) -> Setting:
    """Parameters of the effects in a design; the lines of white light where it states them."""
    lines = {} if design.light.spectrum is None else design.light.lines
    return Setting(
        roughness=design.body.roughness * design.unit_m,
        slope_rms=design.body.slope_rms,
        wavelengths=tuple(lines),
        weights=tuple(lines.values()),
    )


def situation_of_scene(
    scene: Scene, window: Window | None = None, number: int = 0, rays: Rays | None = None
) -> Situation:
    """The camera's own rays on the sheet.

    window : If prescribed already.
    number : Number of the sheet, if the scene has several.
    rays : Light that reaches this sheet, in its frame and unit; None: the camera's rays.
    """
    from clacad.prescription.prescribe import prescribe

    design = scene.designs()[number]
    window = prescribe(design) if window is None else window
    scale = scene.unit_m / window.unit
    camera, effects = scene.camera, scene.effects
    distance = float(np.linalg.norm(np.array(camera.target) - np.array(camera.position)))
    pixel = camera.width_at(distance) / camera.pixels[0] / distance
    contrast, front = brightness(scene)
    near, far = depths(scene)
    return Situation(
        window=window,
        setting=replace(scene_setting(scene, design, scale), quads=scene.sheets[number].quads),
        rays=camera_rays(scene, window) if rays is None else rays,
        angle=max(FINEST, 0.5 * pixel) if effects.angle is None else effects.angle,
        radiance=effects.radiance,
        contrast=contrast,
        front=front,
        near=near * scale,
        far=far * scale,
        sheet_distance=abs(camera.position[2]) * scale,
        pixel=pixel,
    )


def scene_setting(scene: Scene, design: Design, scale: float) -> Setting:
    """Parameters of the effects in a scene and its design; `scale`: window lengths in one scene length."""
    camera, light = scene.camera, scene.light
    position, target = np.array(camera.position), np.array(camera.target)
    distance = float(np.linalg.norm(target - position))
    polariser, analyser = (
        None if degrees is None else radians(degrees) for degrees in (light.polariser, light.analyser)
    )
    return replace(
        design_setting(design),
        coating=scene.effects.coating,
        order=scene.effects.order,
        wavelengths=tuple(light.lines),
        weights=tuple(light.lines.values()),
        polariser=polariser,
        analyser=analyser,
        aperture=camera.aperture * scale,
        focus=(distance if camera.focus is None else camera.focus) * scale,
        axis=tuple((target - position) / distance),
        quads=scene.sheet.quads,
    )


def camera_rays(scene: Scene, window: Window, count: int = PROBE) -> Rays:
    """Rays of the camera that cross the sheet's plane inside its box, window units; at most `count`."""
    camera = scene.camera
    position, target = np.array(camera.position), np.array(camera.target)
    distance, right, up = picture_axes(position, target, np.array(camera.up))
    width = camera.width_at(distance)
    height = width * camera.pixels[1] / camera.pixels[0]
    u = sobol(8 * count, 2) - 0.5
    direction = (target - position) + width * u[:, :1] * right - height * u[:, 1:] * up
    start = position * (scene.unit_m / window.unit)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = start[:2] - (start[2] / direction[:, 2:]) * direction[:, :2]
    x0, x1, y0, y1 = window.lattice.extent()
    inside = (at[:, 0] > x0) & (at[:, 0] < x1) & (at[:, 1] > y0) & (at[:, 1] < y1) & (direction[:, 2] > 0.0)
    chosen = direction[inside][:count]
    return Rays(np.broadcast_to(start, chosen.shape).copy(), chosen)


def brightness(scene: Scene) -> tuple[float, float]:
    """Contrast (brightest over mean), and mean radiance on the camera's side over that behind the sheet."""
    light = scene.light
    shade = light.ambient + 0.5 * light.key
    floors = [thing for thing in scene.objects if thing.kind == "checker"]
    behind = [luminance(c) * shade for thing in scene.objects for c in colours(thing)]
    sky = [luminance(c) for c in scene.background.sky]
    ground = [luminance(scene.background.ground)]
    around = sky + ([luminance(c) * shade for thing in floors for c in thing.colours] if floors else ground)
    every = behind + around
    mean = float(np.mean(every))
    if mean <= 0.0:
        return 1.0, 0.0
    brightest = max(every) * (light.ambient + light.key) / shade if shade > 0.0 else max(every)
    return max(1.0, brightest / mean), float(np.mean(around)) / mean


def colours(thing: SceneObject) -> list[tuple[float, float, float]]:
    """Colours of an object and its parts."""
    if thing.parts:
        return [colour for part in thing.parts for colour in colours(part)]
    if thing.kind == "checker" or thing.pattern == "stripes":
        return list(thing.colours)
    return [thing.colour]


def luminance(colour: tuple[float, float, float]) -> float:
    """Luminance of linear sRGB (ITU-R BT.709)."""
    return 0.2126 * colour[0] + 0.7152 * colour[1] + 0.0722 * colour[2]


def depths(scene: Scene) -> tuple[float, float]:
    """Nearest and farthest distance of visible objects from the camera; infinite with sky."""
    position = np.array(scene.camera.position)
    places = [np.array(thing.at) - position for thing in scene.objects if thing.kind != "checker"]
    near = min((hypot(*place) for place in places), default=inf)
    return float(near), inf


COVERED = 2.0
"""Number of lenslets across a pixel from which on a picture does not resolve them."""


def choose_rung(situation: Situation, asked: str) -> tuple[Rung, str]:
    """The requested rung, or for "auto" the cheapest whose error does not matter, and the reason.

    Notes
    -----
    Law, the homogeneous sheet with the closed-form share of the light, requires: unresolved lenslets,
    direction and share correct on the scene's own rays, and a negligible lateral displacement of light at the
    sheet. Thin requires correct directions and fates on those rays. Otherwise the exact surfaces are used.
    """
    if asked != "auto":
        return cast("Rung", asked), "as requested"
    if not len(situation.met):
        return "law", "the camera does not see the sheet"
    refused, why = homogeneous(situation)
    if not refused:
        return "law", why
    rms, disagree = compared(situation, "thin")
    if rms <= situation.angle and disagree <= situation.radiance:
        return (
            "thin",
            f"{refused}; ideal lenslets are off by {mrad_text(rms, 2)} and {disagree:.2%} of fates",
        )
    return (
        "surfaces",
        (
            f"{refused}; ideal lenslets are off by {mrad_text(rms, 2)} and {disagree:.2%} of fates, "
            f"{mrad_text(situation.angle, 2)} and {situation.radiance:.2%} are allowed"
        ),
    )


def homogeneous(situation: Situation) -> tuple[str, str]:
    """Reason against the homogeneous sheet ("" if none), and reason for it."""
    window = situation.window
    if window.many_sizes:
        return "light of a cell that meets a neighbour's lens 2, of another size, obeys no law", ""
    pitch = max(window.lattice.pitch)
    covered = situation.pixel * situation.sheet_distance / pitch if situation.pixel > 0.0 else 0.0
    if covered < COVERED:
        return f"a pixel covers {covered:.2g} lenslets, which can be seen", ""
    step = max(abs(1.0 - m) * min(1.0, 1.0 / abs(m)) for m in focal_ratio(window.thin)) * pitch
    seen = step / situation.sheet_distance
    if seen > situation.angle:
        return f"light steps aside by {seen:.2g} rad as seen from the camera", ""
    rms, _ = compared(situation, "law")
    if rms > situation.angle:
        return f"lenslets miss the law by {mrad_text(rms, 2)}", ""
    gap = share_gap(situation)
    if gap > situation.radiance:
        return f"the closed-form share of the light is off by {gap:.2%}", ""
    return (
        "",
        (
            f"a pixel covers {covered:.2g} lenslets and nothing shows them singly: the law"
            f" ({mrad_text(rms, 2)} off) with the closed-form share of the light ({gap:.2%} off)"
        ),
    )


def share_gap(situation: Situation) -> float:
    """Difference of the partner's share, closed form minus counted, mean over the scene's rays."""
    from clacad.effects.engine.homogeneous_light import shares

    cells = thin_cells(situation.window)
    index = None if situation.window.uniform else cells_met(situation.window, situation.rays)[situation.met]
    closed = float(shares(cells, situation.slopes, (0, 0), index).mean())
    return abs(closed - situation.share(Fate.ALIVE))


def cells_met(window: Window, rays: Rays) -> Ints:
    """Cells (n, 2) of array 0 in which rays cross z = 0."""
    step = rays.position[:, 2:] / rays.direction[:, 2:]
    return window.lattice.locate(*(rays.position[:, :2] - step * rays.direction[:, :2]).T)[0]


def compared(situation: Situation, rung: Rung, mesh: str | None = None) -> tuple[float, float]:
    """Rms angle of a rung against the surfaces where both are ALIVE, and the share of rays whose fate
    differs; zeros without rays.

    mesh : file of the facets of rung "mesh"
    """
    from clacad.tracing.trace import trace

    if not len(situation.rays):
        return 0.0, 0.0
    truth = situation.probe
    result = trace(situation.window, situation.rays, rung, mesh=mesh, path="size")
    both = (truth.fate == Fate.ALIVE) & (result.fate == Fate.ALIVE)
    disagree = float(np.mean(truth.fate != result.fate))
    return rms_between(truth.direction, result.direction, both) if both.any() else 0.0, disagree
