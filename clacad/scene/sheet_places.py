"""Places, in a scene file, of mistakes in its sheets and their designs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from clacad.config.mistakes import Mistake
from clacad.scene.sections import SheetSpec


def place_of(given: Mapping[str, Any], sheet: SheetSpec) -> str:
    """Dotted key of a sheet in a scene's file; `given`: the keys as written."""
    listed = given["sheet"]
    if not isinstance(listed, list):
        return "sheet"
    return f"sheet.{next(k for k, one in enumerate(listed) if one.get('id') == sheet.id)}"


def in_scene(mistake: Mistake, place: str) -> Mistake:
    """Return a mistake of the changed design with its place in the `set` of a scene's sheet."""
    return replace(mistake, key=f"{place}.set.{mistake.key}", path="", line=None, column=None, source_line="")
