"""`clacad effects`: which effects a scene (or a design) calls for, why, and what the others would change."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from clacad.cli.console import show_json, show_text, table
from clacad.config.toml_text import top_keys

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.effects import Plan
    from clacad.scene import Scene

SIGNS = {"on": "on", "off": "-", "forced": "forced", "without": "LEFT OUT", "unknown": "unknown"}


class NoPlan(ValueError):
    """An unknown effect, or a wavelength outside a material's data; exit status 2."""

    exit_status = 2


def show_effects(
    path: Path,
    overrides: list[str],
    *,
    exact: bool,
    force: list[str],
    without: list[str],
    json: bool,
    quiet: bool,
) -> int:
    """Print the plan, or the plan as JSON."""
    from clacad.design import Design
    from clacad.exporting.limits import refuse_uncountable

    target = load_target(path, overrides)
    for design in (target,) if isinstance(target, Design) else target.designs():
        refuse_uncountable(design)
    from clacad.effects import plan_effects

    if not isinstance(target, Design) and len(target.sheets) > 1:
        return _show_sheets(target, exact=exact, force=force, without=without, json=json, quiet=quiet)
    try:
        plan = plan_effects(target, exact=exact, force=force, without=without)
    except ValueError as error:
        raise NoPlan(str(error)) from error
    if json:
        show_json(plan.to_dict())
    else:
        show_text(plan_text(plan), quiet=quiet)
    return 0


def _show_sheets(
    scene: Scene, *, exact: bool, force: list[str], without: list[str], json: bool, quiet: bool
) -> int:
    """Print the plan of each of several sheets, by its id."""
    from clacad.effects import plan_sheets
    from clacad.rendering.sheet_passage import stack_of

    still = scene.at(0) if scene.animation is not None else scene
    stack = stack_of(still)
    try:
        plans = plan_sheets(still, stack, exact=exact, force=force, without=without)
    except ValueError as error:
        raise NoPlan(str(error)) from error
    named = list(zip((one.id for one in stack.sheets), plans, strict=True))
    if json:
        show_json({"sheets": [{"id": name, **plan.to_dict()} for name, plan in named]})
    else:
        show_text("\n\n".join(f"sheet {name}\n{plan_text(plan)}" for name, plan in named), quiet=quiet)
    return 0


def load_target(path: Path, overrides: list[str]) -> Scene | Design:
    """Read a scene; a file with a [law] and no [sheet] is read as a design."""
    keys = top_keys(str(path))
    if "law" in keys and "sheet" not in keys:
        from clacad.design import load

        return load(path, tuple(overrides))
    from clacad.scene import load_scene

    return load_scene(path, tuple(overrides))


def plan_text(plan: Plan) -> str:
    """The plan as a person reads it."""
    head = [["effect", "", "angle", "radiance", "cost", "why"]]
    rows = [
        [
            row.effect,
            SIGNS[row.state],
            amount(1e3 * row.angle, " mrad"),
            amount(100.0 * row.radiance, " %"),
            f"x{row.cost:.3g}",
            row.why,
        ]
        for row in plan.rows
    ]
    kind = "measured" if any(row.measured for row in plan.rows) else "first-order"
    return "\n".join(
        [
            f"rung {plan.rung}: {plan.rung_why}",
            f"what matters: {1e3 * plan.angle:.3g} mrad, {plan.radiance:.2%} of the light; {kind} bounds of what each "
            "effect changes:",
            table(head + rows),
            f"predicted time: {plan.cost:.3g} x the bare trace",
            plan.summary(),
        ]
    )


def amount(value: float, unit: str) -> str:
    """A bound, or nothing where there is none."""
    return f"{value:.3g}{unit}" if value else ""
