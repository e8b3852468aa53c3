"""Files a scene names, and the design of its sheet."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from clacad.config.design_error import DesignError
from clacad.config.key_positions import located
from clacad.config.mistakes import Mistake
from clacad.config.named_paths import outside
from clacad.scene.scene_error import SceneError

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.scene.model import Scene
    from clacad.scene.sections import SheetSpec


def file_of(scene: Scene, name: str) -> str:
    """Path of a file the scene names; see `Scene.file`."""
    levels = 2 if name in [one.mesh for one in scene.sheets] else 1
    why = outside(scene.folder, name, levels, "scene")
    path = os.path.join(scene.folder, name)
    if not why and not os.path.isfile(path):
        why = "does not exist"
    if why:
        raise SceneError([Mistake("CL100", f"the file {name} {why}", path=scene.path)])
    return path


def design_of(scene: Scene, sheet: SheetSpec) -> Design:
    """Read a sheet's design; see `Scene.design`."""
    from clacad.design import load

    path = file_of(scene, sheet.design)
    try:
        design = load(path)
    except DesignError as error:
        raise SceneError(error.mistakes) from None
    if not sheet.set:
        return design
    try:
        return design.replace(sheet.set)
    except DesignError as error:
        mistakes = [_in_scene(mistake, place_of(scene.given, sheet)) for mistake in error.mistakes]
        raise SceneError(located(mistakes, scene.source, scene.path, ())) from None


def place_of(given: Mapping[str, Any], sheet: SheetSpec) -> str:
    """Where a sheet stands in a scene's file, as a dotted key; `given`: the keys as written."""
    listed = given["sheet"]
    if not isinstance(listed, list):
        return "sheet"
    return f"sheet.{next(k for k, one in enumerate(listed) if one.get('id') == sheet.id)}"


def _in_scene(mistake: Mistake, place: str) -> Mistake:
    """A mistake of the changed design, at home in the `set` of a scene's sheet."""
    return replace(mistake, key=f"{place}.set.{mistake.key}", path="", line=None, column=None, source_line="")
