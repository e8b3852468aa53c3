"""Plan of effects: which effects a scene needs, why, and the error made by leaving out the others.

Each effect's own file defines when it matters (`bound`). The plan compares the bounds with the scene's
tolerance, applies the user's wishes and chooses the cheapest faithful rung. The bounds are first order, or
counted on a probe of the scene's own rays; `exact=True` measures each by a trace with and without.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import degrees
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from clacad import effects as registry
from clacad.base.text import mrad_text
from clacad.base.types import Rung
from clacad.effects import declared, declared_all
from clacad.effects.engine.effect import Bound, Setting, Situation
from clacad.effects.engine.probe_rays import choose_rung, with_stand_ins, worst_bound
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.effects.engine.homogeneous_light import LightRays
    from clacad.scene import Scene
    from clacad.sheet.stack import Stack

State = Literal["on", "off", "forced", "without", "unknown"]
Mode = Literal["auto", "list", "none"]

EXACT_MARGIN = 1.25
"""Factor on a measured change: about its uncertainty with 4096 rays."""


@dataclass(frozen=True, slots=True)
class PlanRow:
    """One effect in a plan.

    state : "on", "off", "forced", "without" or "unknown"
        Unknown: off, and the error made by that is not bounded.
    angle : radians
    radiance : relative. Bounds of the error made without the effect.
    cost : Predicted time of a trace with this effect over the bare trace.
    measured : The bounds were measured rather than estimated.
    known : False: the error made without the effect is not bounded, because a number is not known.
    """

    effect: str
    state: State
    why: str
    angle: float
    radiance: float
    cost: float
    measured: bool = False
    known: bool = True

    @property
    def on(self) -> bool:
        """Whether it is simulated."""
        return self.state in ("on", "forced")


@dataclass(frozen=True, eq=False)
class Plan:
    """The effects of a scene.

    Attributes
    ----------
    rows : tuple of PlanRow, one per effect
    rung : "law", "thin", "surfaces" or "mesh"
    rung_why : str
    angle, radiance : float
        Smallest change that matters.
    setting : Setting
    tried : int
        Number of cells tried for the bounds, of which the worst counts; 0 for a uniform sheet.
    """

    rows: tuple[PlanRow, ...]
    rung: Rung
    rung_why: str
    angle: float
    radiance: float
    setting: Setting
    tried: int = 0

    def __repr__(self) -> str:
        return f"Plan(rung {self.rung!r}, {', '.join(self.names) or 'no effects'})"

    @property
    def names(self) -> tuple[str, ...]:
        """Effects that are simulated."""
        return tuple(row.effect for row in self.rows if row.on)

    @property
    def wavelengths(self) -> tuple[float, ...]:
        """Lines to trace separately, metres; empty: one line."""
        return self.setting.wavelengths if self.by_lines else ()

    @property
    def by_lines(self) -> bool:
        """Whether an effect traces each wavelength separately."""
        return any(one.lines for one in declared_all(self.names))

    @property
    def cost(self) -> float:
        """Predicted time over the bare trace of the same rung."""
        on = [(declared(row.effect), row.cost) for row in self.rows if row.on]
        lines = max((cost for kind, cost in on if kind.lines), default=1.0)
        return lines * (1.0 + sum(cost - 1.0 for kind, cost in on if not (kind.lines or kind.rung)))

    def row(self, effect: str) -> PlanRow:
        """The row of an effect.

        Raises
        ------
        KeyError
            There is no such effect.
        """
        for row in self.rows:
            if row.effect == effect:
                return row
        raise KeyError(effect)

    def traced(self) -> tuple[str, ...]:
        """Effects that run on camera rays; the camera itself handles its opening and the lines."""
        return tuple(
            kind.name for kind in declared_all(self.names) if not (kind.camera or kind.lines or kind.rung)
        )

    def light(self, window: Window, rays: Rays, **options: Any) -> tuple[LightRays, TraceResult]:
        """Trace rays as planned and return their light; see `clacad.effects.light_reaching_camera`."""
        from clacad.effects.engine.camera_light import light_reaching_camera

        return light_reaching_camera(window, rays, self.rung, self.traced(), self.setting, **options)

    def left_out(self) -> tuple[float, float]:
        """Largest angle, and the sum of radiances, of all effects left out."""
        off = [row for row in self.rows if not row.on and declared(row.effect).rung is None]
        return max((row.angle for row in off), default=0.0), sum(row.radiance for row in off)

    def summary(self) -> str:
        """One line for reports and pictures."""
        angle, radiance = self.left_out()
        simulated = ", ".join(self.names) or "none"
        unknown = [row.effect for row in self.rows if not (row.known or row.on)]
        note = f"; not bounded: {', '.join(unknown)}" if unknown else ""
        where = f" in the worst of {self.tried} cells tried" if self.tried else ""
        return (
            f"rung {self.rung}; simulated: {simulated}; left out: at most {radiance:.2%} of the light and "
            f"{mrad_text(angle, 3)}{where}{note}"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain values for reports, metadata and --json."""
        tried = {"cells_tried": self.tried} if self.tried else {}
        return {
            "rung": self.rung,
            "rung_why": self.rung_why,
            "angle": self.angle,
            "radiance": self.radiance,
            "cost": self.cost,
            "summary": self.summary(),
            **tried,
            "effects": [asdict(row) for row in self.rows],
        }


def plan_effects(
    target: Scene | Design | Window | Situation,
    tolerance: float | tuple[float, float] | None = None,
    *,
    exact: bool = False,
    mode: Mode | None = None,
    chosen: Sequence[str] = (),
    force: Sequence[str] = (),
    without: Sequence[str] = (),
    window: Window | None = None,
) -> Plan:
    """Choose the physical effects that a scene needs; each that is left out has a bound of what it would
    change.

    Parameters
    ----------
    target : Scene, Design, Window or Situation
    tolerance : float or (float, float), optional
        Smallest angle, and relative radiance, that matter; default the scene's, or the design's `law_rms`
        and 1 %.
    exact : bool
        Measure each bound by a trace with and without the effect.
    mode : "auto", "list" or "none", optional
        Default: the scene's, else "auto".
    chosen, force, without : names
        Mode list: exactly these; mode auto: plus these, minus these. Added to the scene's.
    window : Window, optional
        The sheet of a scene, if prescribed already.

    Raises
    ------
    ValueError
        An unknown effect or mode, or a wavelength outside a material's data.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> plan = clacad.plan_effects(design)
    >>> plan
    Plan(rung 'surfaces', ghosts, walls, fresnel, reflections)
    """
    situation, wishes, asked = _look_at(target, window)
    return _planned(_within(situation, tolerance), wishes.with_(mode, chosen, force, without), asked, exact)


def plan_sheets(
    scene: Scene, stack: Stack, *, exact: bool = False, force: Sequence[str] = (), without: Sequence[str] = ()
) -> tuple[Plan, ...]:
    """Choose the effects of each sheet of a scene, by the light that reaches it.

    Parameters
    ----------
    scene : Scene
        A still.
    stack : Stack
        Its sheets, at their positions.
    exact, force, without
        As of `plan_effects`, for every sheet.

    Raises
    ------
    ValueError
        As of `plan_effects`.
    """
    from clacad.effects.engine import probe_rays
    from clacad.tracing.through_stack import StackTracer, entering

    wishes = _wishes(scene).with_(None, (), force, without)
    sent = probe_rays.camera_rays(scene, stack.sheets[0].window)
    plans: list[Plan] = []
    for number, (one, spec) in enumerate(zip(stack.sheets, scene.sheets, strict=True)):
        if number:
            before = StackTracer(replace(stack, sheets=stack.sheets[number - 1 : number]), path="size")
            found = before(sent)
            on = np.isin(found.fate, (Fate.ALIVE, Fate.GHOST, Fate.LAND))
            sent = Rays(found.position[on], found.direction[on])
        own = entering(one, "surfaces", sent)
        plans.append(
            _planned(probe_rays.situation_of_scene(scene, one.window, number, own), wishes, spec.rung, exact)
        )
    return tuple(plans)


def _planned(situation: Situation, wishes: Wishes, asked: str, exact: bool) -> Plan:
    """The plan for a situation with the user's wishes."""
    situation = with_stand_ins(situation)
    rung, why = choose_rung(situation, asked)
    bounds = _bounds(situation, rung, exact)
    rows = tuple(
        _row(name, bound, _state(name, bound, situation, wishes, rung), exact)
        for name, bound in bounds.items()
    )
    tried = len(situation.stand_ins)
    return Plan(rows, rung, why, situation.angle, situation.radiance, situation.setting, tried)


@dataclass(frozen=True, slots=True)
class Wishes:
    """The user's choice of effects, which overrides their bounds."""

    mode: Mode = "auto"
    chosen: tuple[str, ...] = ()
    force: tuple[str, ...] = ()
    without: tuple[str, ...] = ()

    def with_(
        self, mode: Mode | None, chosen: Sequence[str], force: Sequence[str], without: Sequence[str]
    ) -> Wishes:
        """These wishes plus further ones."""
        merged = Wishes(
            mode or self.mode, (*self.chosen, *chosen), (*self.force, *force), (*self.without, *without)
        )
        if merged.mode not in ("auto", "list", "none"):
            raise ValueError(f'mode is {merged.mode!r}, not "auto", "list" or "none"')
        for name in (*merged.chosen, *merged.force, *merged.without):
            if name not in registry.NAMES:
                raise ValueError(f"no effect is called {name!r}; known are {', '.join(registry.NAMES)}")
        return merged


def _look_at(
    target: Scene | Design | Window | Situation, window: Window | None
) -> tuple[Situation, Wishes, str]:
    """Situation, wishes and requested rung of the target of a plan."""
    from clacad.effects.engine import probe_rays

    if isinstance(target, Situation):
        return target, Wishes(), "auto"
    if isinstance(target, Window):
        return probe_rays.situation_of_window(target), Wishes(), "surfaces"
    from clacad.design import Design

    if isinstance(target, Design):
        return probe_rays.situation_of_design(target), Wishes(), "surfaces"
    if len(target.sheets) > 1:
        raise ValueError("the scene has several sheets: clacad.effects.plan_sheets plans each of them")
    return probe_rays.situation_of_scene(target, window), _wishes(target), target.sheet.rung


def _wishes(scene: Scene) -> Wishes:
    """Choice of effects in a scene."""
    effects = scene.effects
    return Wishes(effects.mode, tuple(effects.list), tuple(effects.force), tuple(effects.without))


def _within(situation: Situation, tolerance: float | tuple[float, float] | None) -> Situation:
    """The situation with the requested tolerance: smallest angle, or angle and radiance, that matter."""
    if tolerance is None:
        return situation
    angle, radiance = tolerance if isinstance(tolerance, tuple) else (tolerance, situation.radiance)
    return replace(situation, angle=angle, radiance=radiance)


def _bounds(situation: Situation, rung: Rung, exact: bool) -> dict[str, Bound]:
    """Bound of every effect on a rung, measured by traces if `exact`."""
    bounds = {name: worst_bound(situation, declared(name)) for name in registry.NAMES}
    if exact:
        for name in registry.NAMES:
            if declared(name).rung in (
                None,
                rung,
            ):  # otherwise a mesh would be built to evaluate an effect that is not simulated
                bounds[name] = _measured(situation, name, bounds[name])
    if rung == "mesh":
        bounds = {name: _smooth(name, bound) for name, bound in bounds.items()}
    return bounds


def _state(name: str, bound: Bound, situation: Situation, wishes: Wishes, rung: Rung) -> State:
    """State of an effect, which includes who decided it."""
    kind = declared(name)
    if kind.rung is not None:  # the rung decides
        return "on" if rung == kind.rung else "off"
    if kind.stated(situation) and name not in wishes.without:
        return "on"
    if wishes.mode == "none":
        return "without" if _matters(bound, situation) else "off"
    if wishes.mode == "list":
        if name in wishes.chosen:
            return "forced"
        return "without" if _matters(bound, situation) else "off"
    if name in wishes.without:
        return "without"
    if name in wishes.force:
        return "forced"
    if not bound.known:
        return "unknown"
    return "on" if _matters(bound, situation) else "off"


def _matters(bound: Bound, situation: Situation) -> bool:
    return bound.angle > situation.angle or bound.radiance > situation.radiance


def _row(name: str, bound: Bound, state: State, measured: bool) -> PlanRow:
    measured = measured and bound.known
    return PlanRow(name, state, bound.why, bound.angle, bound.radiance, bound.cost, measured, bound.known)


def _smooth(name: str, bound: Bound) -> Bound:
    """Bound, on rung mesh, of an effect that traces its own paths."""
    if not (declared(name).follows or declared(name).splits):
        return bound
    return replace(bound, why=f"{bound.why}; these paths follow the exact surfaces, not the facets")


def _measured(situation: Situation, name: str, bound: Bound) -> Bound:
    from clacad.effects.engine.camera_light import measure

    if not bound.known or (bound.angle == 0.0 and bound.radiance == 0.0):
        return bound
    angle, radiance = measure(situation, declared(name))
    why = f"{bound.why}; measured {degrees(angle):.2g}° and {radiance:.2g}"
    return replace(bound, angle=EXACT_MARGIN * angle, radiance=EXACT_MARGIN * radiance, why=why)
