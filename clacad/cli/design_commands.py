"""`clacad new`, `clacad schema`, and how commands read a design."""

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
