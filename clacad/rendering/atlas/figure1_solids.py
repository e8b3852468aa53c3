"""A picture of the sheet itself: its bodies as tinted solids over the scene, for the paper's Fig. 1(b).

The glass is drawn, not traced: each body is a lit, half-transparent surface, so that the shape of the lenses
is visible. `clacad.rendering.view` renders the view *through* a sheet.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clacad.base.types import Bytes, Floats
from clacad.mesh import Mesh, tessellate
from clacad.prescription.prescribe import prescribe
from clacad.rendering.camera import aim, offsets, rays
from clacad.rendering.compiled.scene_hits import look_all
from clacad.rendering.compiled.scene_tables import Tables, tables
from clacad.rendering.picture_files import encode
from clacad.rendering.scene_arrays import MESH, Primitive, set_stage, stage_of
from clacad.scene import Scene
from clacad.sheet.window import Window
from clacad.tracing.triangles.hierarchy import mesh_tree

CLEAR = 0.45
"""Share of the background that shows through one lit surface."""

QUADS = 8
"""Facets along a cell's side."""


def solid_picture(scene: Scene) -> Bytes:
    """Picture of a scene with its sheet drawn as solids of the colour `sheet.tint`, encoded bytes (h, w, 3)."""
    window = prescribe(scene.design())
    tint = scene.sheet.tint
    scale = scene.unit_m / window.unit
    mesh = sheet_triangles(window)
    corners = np.concatenate([body.vertices[body.triangles] for body in mesh.bodies]) / scale
    background = tables(set_stage(scene))
    glass = tables(stage_of(
        [[Primitive(MESH, np.eye(3), np.zeros(3), (0, 0, 0, 0), (tint, tint), tree=mesh_tree(corners))]],
        replace(scene.light, ambient=0.25, key=0.9), scene.background,
    ))  # fmt: skip
    view = aim(scene.camera)
    count = scene.camera.samples
    light = np.zeros((view.height * view.width, 3))
    for first in range(0, len(light), 4096):
        pixels = np.arange(first, min(first + 4096, len(light)))
        position, direction = rays(view, pixels, offsets(pixels, 1, count, count))
        light[pixels] = (
            _seen(background, glass, position, direction).reshape(len(pixels), count, 3).mean(axis=1)
        )
    return encode(light.reshape(view.height, view.width, 3), scene.camera.exposure, scene.camera.encoding)


def sheet_triangles(window: Window) -> Mesh:
    """The triangles of a sheet as they are drawn."""
    return tessellate(window, quads=QUADS)


def _seen(background: Tables, glass: Tables, position: Floats, direction: Floats) -> Floats:
    """Background seen through at most four surfaces of glass."""
    n = len(position)
    start, ray = np.array(position, dtype=np.float64), np.ascontiguousarray(direction)
    behind, found = np.empty((n, 3)), np.empty((n, 3))
    met, left, distance = np.empty(n, dtype=np.bool_), np.full(n, np.inf), np.empty(n)
    look_all(background, start, ray, left.copy(), behind, met, left)
    light, through = np.zeros((n, 3)), np.ones(n)
    for _ in range(4):
        look_all(glass, start, ray, left, found, met, distance)
        light += np.where(met, through * (1.0 - CLEAR), 0.0)[:, None] * np.where(met[:, None], found, 0.0)
        through = np.where(met, through * CLEAR, through)
        step = np.where(met, distance * (1.0 + 1e-9) + 1e-9, 0.0)
        start, left = start + step[:, None] * ray, left - step
    return light + through[:, None] * behind
