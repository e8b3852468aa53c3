"""The scene file: what is looked at through a sheet, from where, and in which light.

`load_scene` a file or `Scene.from_dict` a dictionary; a `SceneError` tells every mistake with its place.
A scene knows its design's file and changes; nothing of optics is computed here.
"""

from __future__ import annotations

from clacad.scene.model import Scene, load_scene
from clacad.scene.scene_error import SceneError
from clacad.scene.sections import (
    Animation,
    Background,
    Camera,
    EffectsSpec,
    Light,
    Move,
    SceneObject,
    SheetSpec,
)

__all__ = [
    "Animation",
    "Background",
    "Camera",
    "EffectsSpec",
    "Light",
    "Move",
    "Scene",
    "SceneError",
    "SceneObject",
    "SheetSpec",
    "load_scene",
]
