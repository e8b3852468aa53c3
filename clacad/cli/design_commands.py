"""`clacad new`, `clacad schema`, `clacad check`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from clacad.cli.console import show_json, show_text

if TYPE_CHECKING:
    from clacad.design import Design


def new_design(name: str, template: str, *, overwrite: bool, json: bool, quiet: bool) -> int:
    """Write NAME.toml from a template and say what to do next."""
    from clacad.design import template as text_of
    from clacad.storage.atomic import write_content

    stem = name.removesuffix(".toml")
    text = text_of(Path(stem).name, template)
    target = Path(f"{stem}.toml")
    write_content(target, text, overwrite=overwrite)
    if json:
        show_json({"path": str(target), "template": template})
    else:
        show_text(f"wrote {target}\nnext: clacad check {target}", quiet=quiet)
    return 0


def print_schema(*, scene: bool) -> int:
    """Print the JSON Schema of design files, or of scene files."""
    if scene:
        from clacad.scene.schema import scene_schema as made
    else:
        from clacad.design import json_schema as made
    show_json(made())
    return 0


def load_design(path: Path, overrides: list[str]) -> Design:
    """Read a design with --set overrides applied."""
    from clacad.design import load

    return load(path, tuple(overrides))


def load_counted(path: Path, overrides: list[str]) -> Design:
    """Read a design, and refuse one of more lenslets than can be gone through.

    Raises
    ------
    DesignError, LimitRefused
    """
    from clacad.exporting.limits import refuse_uncountable

    design = load_design(path, overrides)
    refuse_uncountable(design)
    return design


def check_design(path: Path, overrides: list[str], *, json: bool, quiet: bool) -> int:
    """Derive everything, judge it by the design rules, print it; exit 1 when a rule fails, 3 when nothing could be written."""
    from clacad.exporting.forecast import outlook
    from clacad.exporting.limits import refuse_uncountable
    from clacad.prescription.prescribe import prescribe
    from clacad.sheet.feasibility import describe, feasibility
    from clacad.storage.errors import LimitRefused
    from clacad.verification import design_checks

    design = load_design(path, overrides)
    if design.lattice.outline is not None:  # its cells are gone through one by one
        refuse_uncountable(design)
    window = prescribe(design)
    facts = feasibility(window)
    checks = design_checks(design, window, facts)
    forecast = outlook(window)
    failed = [check for check in checks if check.state == "fail"]
    if json:
        show_json(
            {
                "design": design.name,
                "derived": [list(row) for row in describe(window, facts)],
                "recipe": dict(window.recipe),
                "residual": dict(window.residual),
                "checks": [check.to_dict() for check in checks],
                "forecast": forecast,
                "passed": not failed,
            }
        )
    else:
        from clacad.cli.tables import check_text

        show_text(check_text(design.name, describe(window, facts), checks, forecast), quiet=quiet)
    if not failed and all(row["refused"] for row in forecast):
        raise LimitRefused(str(forecast[0]["refused"]))
    return 1 if failed else 0
