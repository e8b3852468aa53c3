"""The same sheet and scene for POV-Ray 3.7, an independent check by a renderer without shared code.

Lengths are multiplied by 1000, because POV-Ray drops hits nearer than about 1e-4 units. Every rotation is
written as its nine matrix elements and the camera by its own vectors. No convention of angles or handedness
is involved: the numbers are those of the scene. Lenslets are in one flat union filled by two loops (nested
unions trace tens of times slower), each cut to its cell less a small gap, so that no two share a wall.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Floats
from clacad.base.vectors import picture_axes
from clacad.exporting.pov.pov_solids import NotForPov, colour, matrix, number, refuse, sheet_lines, vector
from clacad.scene import chess_knight
from clacad.scene.chess_knight import turned
from clacad.sheet.stack import Stack, StackedSheet
from clacad.sheet.window import Window, lifted

if TYPE_CHECKING:
    from clacad.scene import Camera, Scene, SceneObject


SCALE = 1000.0
"""POV-Ray units in one scene (or design) length."""

FAR = 1e7
"""Length that represents infinity, POV-Ray units."""


def write_pov(window: Window | Stack, path: Path, scene: Scene | None = None) -> None:
    """Write a scene file for POV-Ray.

    window : Prescribed from the scene's design, or from any design; the sheets of a scene of several.
    scene : A still; None shows the sheet alone before a chequered floor and a sky.
    Raises NotForPov: Biconic faces; opaque land on a web.
    """
    with path.open("w", encoding="utf-8", newline="\n") as stream:
        for line in pov_lines(window, scene):
            stream.write(line + "\n")


def pov_lines(given: Window | Stack, scene: Scene | None) -> Iterator[str]:
    """Lines of the file."""
    windows = [given] if isinstance(given, Window) else [_raised(one) for one in given.sheets]
    for one in windows:
        refuse(one)
    window = windows[0]
    name = window.name if scene is None or len(windows) == 1 else scene.name
    yield f"// {name}: written by clacad for POV-Ray 3.7; lengths times {SCALE:g}; linear light"
    if scene is not None:
        width, height = scene.camera.pixels
        yield f"// povray +I<this file> +W{width} +H{height} -A File_Gamma=1.0"
        if scene.camera.mirror:
            yield "// mirror image: the part made from this design shows the view flipped left-right"
    yield "#version 3.7;"
    yield f"global_settings {{ assumed_gamma 1.0 max_trace_level {24 * len(windows)} adc_bailout 0 }}"
    yield "#default { finish { ambient 0 diffuse 0 emission 1 } }"
    if scene is None:
        yield from _default_world(window)
    else:
        yield from _world(scene)
    for one in windows:
        yield from sheet_lines(one, SCALE if scene is None else SCALE * one.unit / scene.unit_m)


def _raised(one: StackedSheet) -> Window:
    """Sheet of a stack with every height counted from the stack's z = 0."""
    return lifted(one.window, one.z / one.scale)


# -- the scene ---------------------------------------------------------------------------------


def _default_world(window: Window) -> Iterator[str]:
    x0, x1, y0, y1 = window.lattice.extent()
    side = SCALE * max(x1 - x0, y1 - y0)
    yield f"camera {{ location <0, 0, {number(-20 * side)}> direction <0, 0, {number(20 * side)}>"
    yield f"  right <{number(1.1 * side)}, 0, 0> up <0, {number(1.1 * side)}, 0> }}"
    yield "background { rgb <0.62, 0.8, 1.0> }"
    yield (
        f"plane {{ y, {number(-0.6 * side)} pigment {{ checker rgb <0.42, 0.28, 0.16> rgb <0.86, 0.74, 0.55> "
    )
    yield f"  scale {number(side)} translate <0, {number(-0.6 * side)} - 0.5, 0> }} }}"


def _world(scene: Scene) -> Iterator[str]:
    yield _camera(scene.camera)
    zenith, horizon = scene.background.sky
    ground = scene.background.ground
    yield "sky_sphere { pigment { function { asin(max(-1, min(1, y)))/pi + 0.5 } color_map {"
    yield (
        f"  [0 {colour(ground)}] [0.5 {colour(ground)}] [0.5 {colour(horizon)}] [1 {colour(zenith)}] }} }} }}"
    )
    light = scene.light
    if light.key > 0.0:
        x, y, z = (number(FAR * v / math.hypot(*light.direction)) for v in light.direction)
        yield f"light_source {{ <{x}, {y}, {z}> rgb 1 parallel point_at <0, 0, 0> shadowless }}"
    yield (
        f"#declare Lit = finish {{ ambient 0 emission {number(light.ambient)} diffuse {number(light.key)} }}"
    )
    for thing in scene.objects:
        yield from _thing(scene, thing, np.eye(3), np.zeros(3))


def _camera(camera: Camera) -> str:
    """The camera by its own vectors: right = look × up, or its opposite in a mirrored view."""
    position, target = np.array(camera.position), np.array(camera.target)
    look = target - position
    distance, right, up = picture_axes(position, target, np.array(camera.up))
    across = camera.width_at(distance)
    width, height = camera.pixels
    sign = -1.0 if camera.mirror else 1.0
    return (
        f"camera {{ location {vector(position * SCALE)} direction {vector(look * SCALE)}\n  right"
        f" {vector(sign * across * SCALE * right)} up {vector(across * SCALE * height / width * up)} }}"
    )


def _thing(scene: Scene, thing: SceneObject, rotation: Floats, origin: Floats) -> Iterator[str]:
    """One object, placed by the frame of its group."""
    turn = rotation @ turned(thing.turn)
    at = rotation @ np.array(thing.at) + origin
    if thing.kind == "group":
        for part in thing.parts:
            yield from _thing(scene, part, turn, at)
        return
    if thing.kind == "checker":
        yield _floor(thing)
        return
    shapes = {
        "sphere": _sphere,
        "box": _box,
        "cone": _cone,
        "screen": _screen,
        "knight": _knight,
        "mesh": _mesh,
    }
    where = matrix(turn, at * SCALE)
    for shape, pigment in shapes[thing.kind](scene, thing):
        shines = thing.kind == "screen" and thing.pattern in ("coordinates", "image")
        finish = "" if shines else " finish { Lit }"
        yield f"{shape} pigment {{ {pigment} }}{finish} {where} }}"


Shapes = Sequence[tuple[str, str]]


def _sphere(scene: Scene, thing: SceneObject) -> Shapes:
    return [(f"sphere {{ <0, 0, 0>, {number(0.5 * thing.size[0] * SCALE)}", colour(thing.colour))]


def _box(scene: Scene, thing: SceneObject) -> Shapes:
    half = 0.5 * SCALE * np.array(thing.size)
    return [(f"box {{ {vector(-half)}, {vector(half)}", colour(thing.colour))]


def _cone(scene: Scene, thing: SceneObject) -> Shapes:
    below, above, height = (SCALE * v for v in thing.size)
    return [(_frustum(0.0, height, 0.5 * below, 0.5 * above), colour(thing.colour))]


def _frustum(y0: float, y1: float, below: float, above: float) -> str:
    return f"cone {{ <0, {number(y0)}, 0>, {number(below)}, <0, {number(y1)}, 0>, {number(above)}"


def _knight(scene: Scene, thing: SceneObject) -> Shapes:
    """Shapes of a chess knight: a turned plinth, the outline as a prism, the eye."""
    s = SCALE * thing.size[0]
    shapes = [
        (_frustum(s * y0, s * y1, s * r0, s * r1), colour(thing.colour))
        for y0, y1, r0, r1 in chess_knight.PLINTH
    ]
    # a prism lies along y: its outline's x, y go to x, z and it is laid back
    outline = [*chess_knight.PROFILE, chess_knight.PROFILE[0]]
    points = ", ".join(f"<{number(s * x)}, {number(s * y)}>" for x, y in outline)
    half = s * chess_knight.HALF_THICKNESS
    lie = "matrix <1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 0>"
    shapes.append(
        (
            f"prism {{ linear_spline {number(-half)}, {number(half)}, {len(outline)}, {points} {lie}",
            colour(thing.colour),
        )
    )
    x, y, radius = (s * v for v in chess_knight.EYE)
    dark = tuple(chess_knight.EYE_SHADE * v for v in thing.colour)
    ends = (
        f"<{number(x)}, {number(y)}, {number(-1.02 * half)}>, <{number(x)}, {number(y)},"
        f" {number(1.02 * half)}>"
    )
    shapes.append((f"cylinder {{ {ends}, {number(radius)}", colour(dark)))
    return shapes


def _screen(scene: Scene, thing: SceneObject) -> Shapes:
    """A flat screen with its pattern."""
    w, h = (SCALE * v for v in thing.size)
    sheet = (
        f"box {{ <{number(-0.5 * w)}, {number(-0.5 * h)}, 0>, <{number(0.5 * w)}, {number(0.5 * h)},"
        f" {number(1e-3)}>"
    )
    if thing.pattern == "coordinates":
        return [(sheet, _coordinates(w, h))]
    if thing.pattern == "stripes":
        first, second = thing.colours
        period = SCALE * (thing.period or 1.0)
        bands = f"[0 {colour(first)}] [0.5 {colour(first)}] [0.5 {colour(second)}] [1 {colour(second)}]"
        return [(sheet, f"gradient x color_map {{ {bands} }} scale {number(period)}")]
    if thing.pattern == "image":
        assert thing.file is not None  # the scene's rules require it
        kind = {".jpg": "jpeg", ".jpeg": "jpeg", ".tif": "tiff", ".tiff": "tiff"}.get(
            Path(thing.file).suffix.lower(), "png"
        )
        image = f'image_map {{ {kind} "{scene.file(thing.file)}" interpolate 2 once }}'
        # a picture's right edge is at -x, where a viewer before the screen sees it right
        return [(sheet, f"{image} translate <-0.5, -0.5, 0> scale <{number(-w)}, {number(h)}, 1>")]
    return [(sheet, colour(thing.colour))]


def _coordinates(w: float, h: float) -> str:
    """Red and green rise from 0 to 1 across the screen, blue is 1: mean of three maps, thrice as strong."""
    across = (
        f"gradient x color_map {{ [0 rgb 0] [1 rgb <3, 0, 0>] }} scale {number(w)} translate"
        f" <{number(-0.5 * w)}, 0, 0>"
    )
    up = (
        f"gradient y color_map {{ [0 rgb 0] [1 rgb <0, 3, 0>] }} scale {number(h)} translate <0,"
        f" {number(-0.5 * h)}, 0>"
    )
    return f"average pigment_map {{ [1 {across}] [1 {up}] [1 color rgb <0, 0, 3>] }}"


def _mesh(scene: Scene, thing: SceneObject) -> Shapes:
    from clacad.formats.mesh.readers import standing_corners

    assert thing.file is not None  # the scene's rules require it
    corners = SCALE * standing_corners(scene.file(thing.file), thing.up, thing.size[0])
    triangles = " ".join(f"triangle {{ {vector(a)}, {vector(b)}, {vector(c)} }}" for a, b, c in corners)
    return [(f"mesh {{ {triangles}", colour(thing.colour))]


def _floor(thing: SceneObject) -> str:
    """Unit cubes of the checker pattern, their middle plane on the floor so that no edge falls on it."""
    odd, even = thing.colours
    side, y = SCALE * thing.tile, SCALE * thing.height
    # POV-Ray's first colour fills the cube at the origin, where floor(x) + floor(z) is even
    pattern = (
        f"checker {colour(even)} {colour(odd)} translate <0, -0.5, 0> scale {number(side)} translate <0,"
        f" {number(y)}, 0>"
    )
    return f"plane {{ y, {number(y)} pigment {{ {pattern} }} finish {{ Lit }} }}"


__all__ = ["NotForPov", "pov_lines", "refuse", "write_pov"]
