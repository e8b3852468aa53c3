"""Passage of a scene's rays through the sheet: the rung and the effects, planned once for the whole picture.

Each of several sheets has its own rung and effects, and light goes from one to the next. Light that a sheet
splits continues as several rays. Light that a sheet sends back does not meet the previous sheets again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from clacad.base.types import Bools, Floats, Rung
from clacad.effects import declared_all
from clacad.effects.engine.homogeneous_light import LightRays
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.stack import Stack, StackedSheet, standing
from clacad.storage.errors import BadRequest
from clacad.tracing.through_stack import entering, leaving
from clacad.tracing.trace import SheetTracer

if TYPE_CHECKING:
    from clacad.effects.engine.plan import Plan
    from clacad.mesh import Mesh
    from clacad.scene import Scene, SheetSpec
    from clacad.sheet.window import Window


@dataclass(frozen=True, eq=False)
class Passage:
    """Passage of rays through the sheet.

    rung : "law", "thin", "surfaces" or "mesh"
    shining : tuple of Fate
        Fates whose rays bring light where no effect but ghosts is on; all others are black.
    plan : The effects; None for geometry alone.
    mesh : str or None. Rung mesh: the triangles.
    continuous : Rung law: use the law at the very point met, not that of the cell hit.
    several : All sheets, where there are more than one; the other attributes describe the first.
    window : The sheet for which it was planned.
    """

    rung: Rung
    shining: tuple[int, ...]
    plan: Plan | None = None
    mesh: Mesh | str | None = None
    several: tuple[StackedPassage, ...] = ()
    continuous: bool = False
    window: Window | None = None

    @property
    def plain(self) -> bool:
        """Whether the trace alone suffices: no effect beyond labels of geometry, and no share of a law."""
        if self.several:
            return all(one.passage.plain for one in self.several)
        if self.plan is None:
            return True
        names = self.plan.traced()
        homogeneous = self.rung == "law" and (names or self.plan.rung_why != "as requested")
        return not homogeneous and all(kind.shows is Fate.GHOST for kind in declared_all(names))

    @property
    def by_lines(self) -> bool:
        """Whether an effect of any sheet traces each wavelength separately."""
        return any(kind.lines for kind in declared_all(self.names))

    @property
    def names(self) -> tuple[str, ...]:
        """Effects that are on, in any sheet."""
        if self.several:
            return tuple(dict.fromkeys(name for one in self.several for name in one.passage.names))
        return () if self.plan is None else self.plan.names

    @property
    def homogeneous(self) -> bool:
        """Whether the sheet is represented by its law alone."""
        return self.rung == "law" and self.plain and not self.several

    def light_of_all(
        self, window: Window, rays: Rays, compiled: bool, between: Between | None = None
    ) -> tuple[LightRays, Bools, Floats | None]:
        """Trace camera rays through every sheet; return what shines, and which rays (n,) met a sheet.

        Returns also the light (n, 3) of objects between sheets, None without `between`.
        """
        if self.several:
            return through_all(self.several, rays, compiled, between)
        beyond, result = self.light(window, rays, compiled)
        return beyond, np.asarray(result.fate != Fate.MISSED), None

    def light(self, window: Window, rays: Rays, compiled: bool) -> tuple[LightRays, TraceResult]:
        """Trace a block of rays through one sheet, in its frame, on this thread; return what shines."""
        known = window.uniform or self.rung in (
            "surfaces",
            "mesh",
        )  # rungs with kernels for non-uniform sheets
        path: Literal["numpy", "numba"] = "numba" if compiled and known else "numpy"
        options: dict[str, Any] = {} if self.mesh is None else {"mesh": self.mesh}
        if self.continuous:
            options["continuous"] = True
        if self.plain or self.plan is None:
            result = SheetTracer(window, self.rung, threads=1, path=path, **options)(rays)
            rows = np.flatnonzero(np.isin(result.fate, self.shining))
            return LightRays(rows, result.position[rows], result.direction[rows], result.flux[rows]), result
        light, result = self.plan.light(window, rays, threads=1, path=path, **options)
        return light, result


@dataclass(frozen=True, eq=False)
class StackedPassage:
    """Passage of rays through one of several sheets.

    opaque : Whether light that misses it is stopped.
    """

    sheet: StackedSheet
    passage: Passage
    opaque: bool


Between = Callable[[Floats, Floats, Floats], tuple[Floats, Bools]]
"""Light (n, 3) of objects that rays meet within a length (n,) of their position, and which do."""


def through_all(
    several: tuple[StackedPassage, ...], rays: Rays, compiled: bool, between: Between | None = None
) -> tuple[LightRays, Bools, Floats | None]:
    """Trace camera rays through several sheets; return what shines, and which rays (n,) met any.

    Frame and unit are those of the first sheet. Objects between sheets stop rays; their light (n, 3) is
    returned last.
    """
    many = len(rays)
    way = rays.direction / np.linalg.norm(rays.direction, axis=1)[:, None]
    light = LightRays(np.arange(many), rays.position, way, np.ones(many))
    met = np.zeros(many, dtype=bool)
    lit = None if between is None else np.zeros((many, 3))
    for number, one in enumerate(several):
        if between is not None and lit is not None and number:
            light = _stopped(light, one.sheet.span[0], met, between, lit)
        ahead = light.direction[:, 2] > 0.0
        rows = np.flatnonzero(ahead)
        parent = light.parent[rows]
        waves = None if rays.wavelength is None else rays.wavelength[parent]
        rung = one.passage.rung
        sent = entering(one.sheet, rung, Rays(light.position[rows], light.direction[rows], waves))
        beyond, result = one.passage.light(one.sheet.window, sent, compiled)
        missed = result.fate == Fate.MISSED
        met[parent[~missed]] = True
        if one.opaque and number:  # outside the first sheet it is the caller who shows nothing
            met[parent] = True
        passed = LightRays(
            parent[beyond.parent],
            leaving(one.sheet, rung, beyond.position),
            beyond.direction,
            light.flux[rows[beyond.parent]] * beyond.flux,
        )
        past = ~ahead
        past[rows[missed]] = not one.opaque
        light = LightRays.joined([light.take(past), passed])
    shining = met[light.parent]
    return light.take(shining), met, lit


def _stopped(light: LightRays, front: float, met: Bools, between: Between, lit: Floats) -> LightRays:
    """Rays that reach the plane of the next sheet; `lit` gains what stops the others.

    A ray that has met no sheet so far is stopped, too: it is shown with those that miss all sheets.
    """
    ahead = np.flatnonzero(light.direction[:, 2] > 0.0)
    reach = (front - light.position[ahead, 2]) / light.direction[ahead, 2]
    found, hit = between(light.position[ahead], light.direction[ahead], reach)
    rows = ahead[hit]
    shown = rows[met[light.parent[rows]]]
    colours = found[hit][met[light.parent[rows]]] * light.flux[shown, None]
    np.add.at(lit, light.parent[shown], colours)
    kept = np.ones(len(light.parent), dtype=bool)
    kept[rows] = False
    return light.take(kept)


def stack_of(scene: Scene) -> Stack:
    """The sheets of a still scene with their positions, in the first one's frame and unit.

    Raises SceneError, DesignError: A design that cannot be read or made.
    Raises BadStack: Sheets overlap.
    """
    from clacad.prescription.prescribe import prescribe_all

    windows = prescribe_all(scene.designs())
    unit = windows[0].unit
    sheets = [
        StackedSheet(spec.id, window, spec.z * (scene.unit_m / unit), window.unit / unit)
        for spec, window in zip(scene.sheets, windows, strict=True)
    ]
    return in_scene(sheets, unit, scene)


def in_scene(sheets: list[StackedSheet], unit: float, scene: Scene) -> Stack:
    """Sheets as a stack; where they overlap the message is in the scene's unit."""
    scale = unit / scene.unit_m
    told = [replace(one, z=one.z * scale, scale=one.scale * scale) for one in sheets]
    standing(told, scene.unit_m, scene.unit)
    return Stack(tuple(sheets), unit)


def plan_passage(scene: Scene, window: Window | None = None) -> Passage:
    """Choose rung and effects of a still scene, for each of several sheets.

    window : Of a scene with one sheet, if prescribed already.
    Raises ValueError: An unknown effect, or sheets that overlap.
    """
    from clacad.effects.engine.plan import plan_effects, plan_sheets
    from clacad.prescription.prescribe import prescribe

    if len(scene.sheets) == 1:
        window = prescribe(scene.design()) if window is None else window
        return _passage(scene, scene.sheet, plan_effects(scene, window=window), window)
    stack = stack_of(scene)
    several = tuple(
        StackedPassage(one, _passage(scene, spec, plan, one.window), spec.surround == "opaque")
        for one, spec, plan in zip(stack.sheets, scene.sheets, plan_sheets(scene, stack), strict=True)
    )
    return replace(several[0].passage, several=several)


def _passage(scene: Scene, sheet: SheetSpec, plan: Plan, window: Window) -> Passage:
    """Passage of rays through one sheet, as planned."""
    mesh: Mesh | str | None = None
    if plan.rung == "mesh":
        from clacad.mesh import tessellate

        mesh = scene.file(sheet.mesh) if sheet.mesh else tessellate(window, quads=sheet.quads)
    ghosts = Fate.GHOST in {kind.shows for kind in declared_all(plan.names)}
    shining = (int(Fate.ALIVE), int(Fate.LAND), *((int(Fate.GHOST),) if ghosts else ()))
    return Passage(plan.rung, shining, plan, mesh, continuous=_smooth(sheet, window), window=window)


def _smooth(sheet: SheetSpec, window: Window) -> bool:
    """Whether a sheet is shown by the law at the very point met.

    Raises BadRequest: The law comes from a table, which has no values between its cells.
    """
    if sheet.continuous and window.cell_laws is not None and window.cell_laws.smooth is None:
        raise BadRequest(
            "sheet.continuous: the law of this sheet is a table's, which has no values between its cells;"
            " leave the key out"
        )
    return sheet.continuous


def geometry_alone(scene: Scene, direct: bool = False) -> Passage:
    """A passage without effects; `direct` shows nothing but light through corresponding lenslets."""
    rung: Rung = "surfaces" if scene.sheet.rung == "auto" else scene.sheet.rung
    shining = (int(Fate.ALIVE),) if direct else (int(Fate.ALIVE), int(Fate.LAND))
    return Passage(rung, shining, continuous=scene.sheet.continuous)
