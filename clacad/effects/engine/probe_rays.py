"""Situation of a design, window or scene for the planner: probe rays, distances, brightness of objects.

The cheapest rung whose picture of a scene agrees with the exact surfaces within the tolerance.
"""

from __future__ import annotations

from dataclasses import replace
from math import hypot, inf, pi, radians, tan
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import NDArray

from clacad.base.sobol import sobol
from clacad.base.text import mrad_text
from clacad.base.types import Ints, Rung
from clacad.base.vectors import picture_axes
from clacad.effects.engine.effect import PROBE, Setting, Situation
from clacad.light.compare import rms_between
from clacad.optics.rays import Fate, Rays
from clacad.sheet.representative_cells import representative_cells
from clacad.sheet.vignetting import aperture_slope, aperture_slopes, focal_ratio, thin_cells
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.scene import Scene, SceneObject


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
