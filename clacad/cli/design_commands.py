"""`clacad schema`, and how commands read a design."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from clacad.cli.console import show_json

if TYPE_CHECKING:
    from clacad.design import Design


def print_schema(*, scene: bool) -> int:
    """Print the JSON Schema of design files, or of scene files."""
    if scene:
        from clacad.scene.keys import scene_schema as made
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
