"""The scene file: what is viewed through a sheet, from which position, and in which light.

`load_scene` reads a file, `Scene.from_dict` a dictionary; a `SceneError` lists every mistake with its place.
A scene knows its design's file and the changes to it; this package computes no optics.
"""

from __future__ import annotations

from clacad.scene.model import Scene, load_scene
from clacad.scene.rules import SceneError
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
