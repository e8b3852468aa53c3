"""The same sheet and scene for POV-Ray 3.7, for a second opinion by a renderer that shares nothing with this one.

Lengths are multiplied by 1000: POV-Ray drops hits nearer than about 1e-4 units. Every rotation is written as
its nine matrix elements and the camera by its own vectors, so no reading of angles and no handedness enters:
the numbers are those of the scene. Lenslets stand in one flat union filled by two loops (nested unions trace
tens of times slower), each cut to its cell less a hair, so that no two share a wall.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clacad.export.errors import ExportError
from clacad.scene import knight
from clacad.scene.place import turned
from clacad.sheet import Body, Face, Window
from clacad.surface import Quadric

if TYPE_CHECKING:
    from clacad.scene import Camera, Scene, SceneObject

Floats = NDArray[np.float64]

SCALE = 1000.0
"""POV-Ray units in one scene (or design) length."""

GAP = 2e-4
"""Part of a pitch by which a lens keeps off each border of its cell."""

FAR = 1e7
"""Length that stands for infinity, POV-Ray units."""


class NotForPov(ExportError):
    """A sheet that this form of scene cannot hold; exit status 3."""

    exit_status = 3


def write_pov(window: Window, path: Path, scene: Scene | None = None) -> None:
    """Write a scene file for POV-Ray.

    Parameters
    ----------
    window : Window
        Prescribed from the scene's design, or from any design.
    path : Path
    scene : Scene or None
        A still; None shows the sheet alone before a chequered floor and a sky.

    Raises
    ------
    NotForPov
        A slab, land (seam, web, border), a hexagonal lattice or a biconic face.
    """
    with path.open("w", encoding="utf-8", newline="\n") as stream:
        for line in pov_lines(window, scene):
            stream.write(line + "\n")


def pov_lines(window: Window, scene: Scene | None) -> Iterator[str]:
    """Lines of the file."""
    refuse(window)
    yield f"// {window.name}: written by clacad for POV-Ray 3.7; lengths times {SCALE:g}; linear light"
    if scene is not None:
        width, height = scene.camera.pixels
        yield f"// povray +I<this file> +W{width} +H{height} -A File_Gamma=1.0"
        if scene.camera.mirror:
            yield "// mirror image: the part made from this design shows the view flipped left-right"
    yield "#version 3.7;"
    yield "global_settings { assumed_gamma 1.0 max_trace_level 24 adc_bailout 0 }"
    yield "#default { finish { ambient 0 diffuse 0 emission 1 } }"
    if scene is None:
        yield from _default_world(window)
    else:
        yield from _world(scene)
    units = SCALE if scene is None else SCALE * window.unit / scene.unit_m
    for number, body in enumerate(window.bodies):
        yield from _body(window, body, number, units)


def refuse(window: Window) -> None:
    """Refuse what the file cannot hold.

    Raises
    ------
    NotForPov
    """
    faces = window.faces
    why = ""
    if window.form == "slab":
        why = "a slab, whose two arrays are displaced in one body"
    elif window.lattice.hexagonal:
        why = "hexagonal cells"
    elif window.outline is not None or any(face.land is not None for face in faces):
        why = "land between or around lenslets (seam, web, border, outline)"
    elif window.lattice.outline is not None:
        why = "a lattice cut by an outline"
    elif not all(isinstance(face.surface, Quadric) for face in faces):
        why = "biconic faces"
    elif window.baffle is not None:
        why = "a baffle"
    if why:
        raise NotForPov(f"{window.name}: the POV-Ray scene cannot hold {why}; export its mesh instead")


# -- the sheet ---------------------------------------------------------------------------------


def _body(window: Window, body: Body, number: int, units: float) -> Iterator[str]:
    """One array as a flat union of its lenslets."""
    array = next(face.array for face in (body.front, body.back) if face.array is not None)
    px, py = window.lattice.pitch
    hx, hy = (0.5 * p * (1.0 - 2.0 * GAP) * units for p in (px, py))
    low, high = (units * z for z in _depth(window, body))
    yield f"#declare Lens{number} = intersection {{"
    for face in (body.front, body.back):
        yield f"  {_face(face, units)}"
    yield f"  box {{ <{_n(-hx)}, {_n(-hy)}, {_n(low)}>, <{_n(hx)}, {_n(hy)}, {_n(high)}> }}"
    yield f"  bounded_by {{ box {{ <{_n(-hx)}, {_n(-hy)}, {_n(low)}>, <{_n(hx)}, {_n(hy)}, {_n(high)}> }} }}"
    yield "}"
    n1, n2 = window.lattice.count
    x0, y0 = window.lattice.first_centre
    x0, y0 = x0 + window.shifts[array][0], y0 + window.shifts[array][1]
    yield "union {"
    yield f"  #declare J = 0; #while (J < {n2})"
    yield f"    #declare I = 0; #while (I < {n1})"
    place = f"{_n(x0 * units)} + I*{_n(px * units)}, {_n(y0 * units)} + J*{_n(py * units)}, 0"
    yield f"      object {{ Lens{number} translate <{place}> }}"
    yield "    #declare I = I + 1; #end"
    yield "  #declare J = J + 1; #end"
    yield "  texture { pigment { rgbt <1, 1, 1, 1> } finish { ambient 0 diffuse 0 emission 0 specular 0 reflection 0 } }"
    yield f"  interior {{ ior {_n(body.index)} }}"
    yield "}"


def _depth(window: Window, body: Body) -> tuple[float, float]:
    """Heights between which a body lies, with room to spare: the mid plane between the arrays is never passed."""
    z0, z1 = window.z_range
    room = 0.05 * (z1 - z0)
    vertices = [face.vertex[2] for face in (body.front, body.back)]
    reach = 2.0 * max(window.lattice.pitch)
    return max(z0 - room, min(vertices) - reach), min(z1 + room, max(vertices) + reach)


def _face(face: Face, units: float) -> str:
    """The half space behind a front face, or before a back one, as a quadric turned and moved into its cell."""
    s = face.surface
    assert isinstance(s, Quadric)  # `refuse` has seen to it
    a, b, c = (v / units for v in (s.curvature_x, s.curvature_y, s.kappa))
    quadric = f"quadric {{ <{_n(a)}, {_n(b)}, {_n(c)}>, <0, 0, 0>, <0, 0, {_n(-2.0 * s.side)}>, 0"
    return f"{quadric} {_matrix(face.rotation, np.array(face.vertex) * units)} }}"


def _matrix(rotation: Floats, origin: Floats) -> str:
    """Placement by its nine elements and a move; POV-Ray multiplies rows from the left."""
    return "matrix <" + ", ".join(_n(v) for v in [*rotation.T.ravel(), *origin]) + ">"


# -- the scene ---------------------------------------------------------------------------------


def _default_world(window: Window) -> Iterator[str]:
    x0, x1, y0, y1 = window.lattice.extent()
    side = SCALE * max(x1 - x0, y1 - y0)
    yield f"camera {{ location <0, 0, {_n(-20 * side)}> direction <0, 0, {_n(20 * side)}>"
    yield f"  right <{_n(1.1 * side)}, 0, 0> up <0, {_n(1.1 * side)}, 0> }}"
    yield "background { rgb <0.62, 0.8, 1.0> }"
    yield f"plane {{ y, {_n(-0.6 * side)} pigment {{ checker rgb <0.42, 0.28, 0.16> rgb <0.86, 0.74, 0.55> "
    yield f"  scale {_n(side)} translate <0, {_n(-0.6 * side)} - 0.5, 0> }} }}"


def _world(scene: Scene) -> Iterator[str]:
    yield _camera(scene.camera)
    zenith, horizon = scene.background.sky
    ground = scene.background.ground
    yield "sky_sphere { pigment { function { asin(max(-1, min(1, y)))/pi + 0.5 } color_map {"
    yield f"  [0 {_rgb(ground)}] [0.5 {_rgb(ground)}] [0.5 {_rgb(horizon)}] [1 {_rgb(zenith)}] }} }} }}"
    light = scene.light
    if light.key > 0.0:
        x, y, z = (_n(FAR * v / math.hypot(*light.direction)) for v in light.direction)
        yield f"light_source {{ <{x}, {y}, {z}> rgb 1 parallel point_at <0, 0, 0> shadowless }}"
    yield f"#declare Lit = finish {{ ambient 0 emission {_n(light.ambient)} diffuse {_n(light.key)} }}"
    for thing in scene.objects:
        yield from _thing(scene, thing, np.eye(3), np.zeros(3))


def _camera(camera: Camera) -> str:
    """The camera by its own vectors: right = look × up, or its opposite in a mirrored view."""
    position, target = np.array(camera.position), np.array(camera.target)
    look = target - position
    ahead = look / np.linalg.norm(look)
    right = np.cross(ahead, np.array(camera.up))
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    if camera.frame is not None:
        across = camera.frame
    else:
        assert camera.fov is not None  # the scene's rules ask for one of the two
        across = 2.0 * float(np.linalg.norm(look)) * math.tan(0.5 * camera.fov)
    width, height = camera.pixels
    sign = -1.0 if camera.mirror else 1.0
    return (
        f"camera {{ location {_v(position * SCALE)} direction {_v(look * SCALE)}\n"
        f"  right {_v(sign * across * SCALE * right)} up {_v(across * SCALE * height / width * up)} }}"
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
        "sphere": _sphere, "box": _box, "cone": _cone, "screen": _screen, "knight": _knight, "mesh": _mesh,
    }  # fmt: skip
    where = _matrix(turn, at * SCALE)
    for shape, pigment in shapes[thing.kind](scene, thing):
        shines = thing.kind == "screen" and thing.pattern in ("coordinates", "image")
        finish = "" if shines else " finish { Lit }"
        yield f"{shape} pigment {{ {pigment} }}{finish} {where} }}"


Shapes = Sequence[tuple[str, str]]


def _sphere(scene: Scene, thing: SceneObject) -> Shapes:
    return [(f"sphere {{ <0, 0, 0>, {_n(0.5 * thing.size[0] * SCALE)}", _rgb(thing.colour))]


def _box(scene: Scene, thing: SceneObject) -> Shapes:
    half = 0.5 * SCALE * np.array(thing.size)
    return [(f"box {{ {_v(-half)}, {_v(half)}", _rgb(thing.colour))]


def _cone(scene: Scene, thing: SceneObject) -> Shapes:
    below, above, height = (SCALE * v for v in thing.size)
    return [(_frustum(0.0, height, 0.5 * below, 0.5 * above), _rgb(thing.colour))]


def _frustum(y0: float, y1: float, below: float, above: float) -> str:
    return f"cone {{ <0, {_n(y0)}, 0>, {_n(below)}, <0, {_n(y1)}, 0>, {_n(above)}"


def _knight(scene: Scene, thing: SceneObject) -> Shapes:
    s = SCALE * thing.size[0]
    shapes = [
        (_frustum(s * y0, s * y1, s * r0, s * r1), _rgb(thing.colour)) for y0, y1, r0, r1 in knight.PLINTH
    ]
    # a prism lies along y: its outline's x, y go to x, z and it is laid back
    outline = [*knight.PROFILE, knight.PROFILE[0]]
    points = ", ".join(f"<{_n(s * x)}, {_n(s * y)}>" for x, y in outline)
    half = s * knight.HALF_THICKNESS
    lie = "matrix <1, 0, 0, 0, 0, 1, 0, 1, 0, 0, 0, 0>"
    shapes.append(
        (
            f"prism {{ linear_spline {_n(-half)}, {_n(half)}, {len(outline)}, {points} {lie}",
            _rgb(thing.colour),
        )
    )
    x, y, radius = (s * v for v in knight.EYE)
    dark = tuple(knight.EYE_SHADE * v for v in thing.colour)
    ends = f"<{_n(x)}, {_n(y)}, {_n(-1.02 * half)}>, <{_n(x)}, {_n(y)}, {_n(1.02 * half)}>"
    shapes.append((f"cylinder {{ {ends}, {_n(radius)}", _rgb(dark)))
    return shapes


def _screen(scene: Scene, thing: SceneObject) -> Shapes:
    w, h = (SCALE * v for v in thing.size)
    sheet = f"box {{ <{_n(-0.5 * w)}, {_n(-0.5 * h)}, 0>, <{_n(0.5 * w)}, {_n(0.5 * h)}, {_n(1e-3)}>"
    if thing.pattern == "coordinates":
        return [(sheet, _coordinates(w, h))]
    if thing.pattern == "stripes":
        first, second = thing.colours
        period = SCALE * (thing.period or 1.0)
        bands = f"[0 {_rgb(first)}] [0.5 {_rgb(first)}] [0.5 {_rgb(second)}] [1 {_rgb(second)}]"
        return [(sheet, f"gradient x color_map {{ {bands} }} scale {_n(period)}")]
    if thing.pattern == "image":
        assert thing.file is not None  # the scene's rules ask for it
        kind = {".jpg": "jpeg", ".jpeg": "jpeg", ".tif": "tiff", ".tiff": "tiff"}.get(
            Path(thing.file).suffix.lower(), "png"
        )
        image = f'image_map {{ {kind} "{scene.file(thing.file)}" interpolate 2 once }}'
        # a picture's right edge stands at -x, where a viewer before the screen sees it right
        return [(sheet, f"{image} translate <-0.5, -0.5, 0> scale <{_n(-w)}, {_n(h)}, 1>")]
    return [(sheet, _rgb(thing.colour))]


def _coordinates(w: float, h: float) -> str:
    """Red and green rise from 0 to 1 across the screen, blue is 1: an average of three maps, each three times as strong."""
    across = f"gradient x color_map {{ [0 rgb 0] [1 rgb <3, 0, 0>] }} scale {_n(w)} translate <{_n(-0.5 * w)}, 0, 0>"
    up = f"gradient y color_map {{ [0 rgb 0] [1 rgb <0, 3, 0>] }} scale {_n(h)} translate <0, {_n(-0.5 * h)}, 0>"
    return f"average pigment_map {{ [1 {across}] [1 {up}] [1 color rgb <0, 0, 3>] }}"


def _mesh(scene: Scene, thing: SceneObject) -> Shapes:
    from clacad.export.standing import standing_corners

    corners = SCALE * standing_corners(scene, thing)
    triangles = " ".join(f"triangle {{ {_v(a)}, {_v(b)}, {_v(c)} }}" for a, b, c in corners)
    return [(f"mesh {{ {triangles}", _rgb(thing.colour))]


def _floor(thing: SceneObject) -> str:
    """Unit cubes of the checker pattern: their middle plane is laid on the floor, so that no edge falls on it."""
    odd, even = thing.colours
    side, y = SCALE * thing.tile, SCALE * thing.height
    # POV-Ray's first colour fills the cube at the origin, where floor(x) + floor(z) is even
    pattern = (
        f"checker {_rgb(even)} {_rgb(odd)} translate <0, -0.5, 0> scale {_n(side)} translate <0, {_n(y)}, 0>"
    )
    return f"plane {{ y, {_n(y)} pigment {{ {pattern} }} finish {{ Lit }} }}"


# -- numbers -----------------------------------------------------------------------------------


def _n(value: Any) -> str:
    """A number in as many digits as it has."""
    return repr(float(value) + 0.0)


def _v(vector: Floats) -> str:
    return "<" + ", ".join(_n(v) for v in vector) + ">"


def _rgb(colour: Sequence[float]) -> str:
    return f"rgb <{', '.join(_n(v) for v in colour)}>"
