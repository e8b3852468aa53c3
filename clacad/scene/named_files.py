"""Files a scene names, and the design of its sheet."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import TYPE_CHECKING

from clacad.config.design_error import DesignError
from clacad.config.key_positions import located
from clacad.config.mistakes import Mistake
from clacad.config.named_paths import outside
from clacad.scene.scene_error import SceneError

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.scene.model import Scene


def file_of(scene: Scene, name: str) -> str:
    """Path of a file the scene names; see `Scene.file`."""
    levels = 2 if name == scene.sheet.mesh else 1
    why = outside(scene.folder, name, levels, "scene")
    path = os.path.join(scene.folder, name)
    if not why and not os.path.isfile(path):
        why = "does not exist"
    if why:
        raise SceneError([Mistake("CL100", f"the file {name} {why}", path=scene.path)])
    return path


def design_of(scene: Scene) -> Design:
    """Read the sheet's design; see `Scene.design`."""
    from clacad.design import load

    path = file_of(scene, scene.sheet.design)
    try:
        design = load(path)
    except DesignError as error:
        raise SceneError(error.mistakes) from None
    if not scene.sheet.set:
        return design
    try:
        return design.replace(scene.sheet.set)
    except DesignError as error:
        mistakes = [_in_scene(mistake) for mistake in error.mistakes]
        raise SceneError(located(mistakes, scene.source, scene.path, ())) from None


def _in_scene(mistake: Mistake) -> Mistake:
    """A mistake of the changed design, at home in the scene's [sheet] set."""
    return replace(mistake, key=f"sheet.set.{mistake.key}", path="", line=None, column=None, source_line="")
