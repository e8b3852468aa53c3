"""`clacad effects`: which effects a scene (or a design) requires, why, and what the others would change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from clacad.cli.command import Command, Overridden, flag, option, required
from clacad.cli.console import Console, table
from clacad.cli.option_values import words_of

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.effects import Plan
    from clacad.scene import Scene

SIGNS = {"on": "on", "off": "-", "forced": "forced", "without": "LEFT OUT", "unknown": "unknown"}

T = TypeVar("T")


class NoPlan(ValueError):
    """An unknown effect, or a wavelength outside a material's data; exit status 2."""

    exit_status = 2


@dataclass(frozen=True, kw_only=True)
class Effects(Overridden):
    """Which physical effects the scene calls for, why, and what is left out."""

    scene: Path = required("SCENE", "Scene file; or a design file.")
    exact: bool = flag("--exact-bounds", "Measure every bound by a trace with and without the effect.")
    force: tuple[str, ...] = option("--force A,B", "Effects to switch on anyway.", (), read=words_of)
    without: tuple[str, ...] = option("--without A,B", "Effects to leave out anyway.", (), read=words_of)


def run(request: Effects, console: Console) -> int:
    """Print the plan; of several sheets the plan of each."""
    from clacad.design import Design
    from clacad.exporting.limits import refuse_uncountable

    target = load_target(request.scene, request.set)
    for design in (target,) if isinstance(target, Design) else target.designs():
        refuse_uncountable(design)
    from clacad.effects import plan_effects

    if not isinstance(target, Design) and len(target.sheets) > 1:
        return _show_sheets(target, request, console)
    plan = _planned(
        lambda: plan_effects(target, exact=request.exact, force=request.force, without=request.without)
    )
    console.show(plan.to_dict, lambda: plan_text(plan))
    return 0


def _show_sheets(scene: Scene, request: Effects, console: Console) -> int:
    """Print the plan of each of several sheets, by its id."""
    from clacad.effects import plan_sheets
    from clacad.rendering.sheet_passage import stack_of

    still = scene.at(0) if scene.animation is not None else scene
    stack = stack_of(still)
    plans = _planned(
        lambda: plan_sheets(still, stack, exact=request.exact, force=request.force, without=request.without)
    )
    named = list(zip((one.id for one in stack.sheets), plans, strict=True))
    console.show(
        lambda: {"sheets": [{"id": name, **plan.to_dict()} for name, plan in named]},
        lambda: "\n\n".join(f"sheet {name}\n{plan_text(plan)}" for name, plan in named),
    )
    return 0


def _planned(plan: Callable[[], T]) -> T:
    """The plan; a request that has none is bad input.

    Raises
    ------
    NoPlan
    """
    try:
        return plan()
    except ValueError as error:
        raise NoPlan(str(error)) from error


def load_target(path: Path, overrides: tuple[str, ...]) -> Scene | Design:
    """Read a scene; a file with a [law] and no [sheet] is read as a design."""
    from clacad.config.toml_text import top_keys

    keys = top_keys(str(path))
    if "law" in keys and "sheet" not in keys:
        from clacad.design import load

        return load(path, overrides)
    from clacad.scene import load_scene

    return load_scene(path, overrides)


def plan_text(plan: Plan) -> str:
    """The plan as text: its rung, a table of effects, the predicted time."""
    rows = [["effect", "", "angle", "radiance", "cost", "why"]]
    for row in plan.rows:
        angle, radiance = _amount(1e3 * row.angle, " mrad"), _amount(100.0 * row.radiance, " %")
        rows.append([row.effect, SIGNS[row.state], angle, radiance, f"x{row.cost:.3g}", row.why])
    kind = "measured" if any(row.measured for row in plan.rows) else "first-order"
    return "\n".join(
        [
            f"rung {plan.rung}: {plan.rung_why}",
            f"what matters: {1e3 * plan.angle:.3g} mrad, {plan.radiance:.2%} of the light; {kind} bounds "
            "of what each effect changes:",
            table(rows),
            f"predicted time: {plan.cost:.3g} x the bare trace",
            plan.summary(),
        ]
    )


def _amount(value: float, unit: str) -> str:
    """A bound with its unit, or nothing for 0."""
    return f"{value:.3g}{unit}" if value else ""


COMMANDS = (Command("effects", "look", Effects, run),)
