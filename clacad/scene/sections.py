"""The sections of a scene file as frozen values in the scene's unit.

Lengths are multiples of `Scene.unit_m` metres, wavelengths metres, angles radians (rotations in degrees, as
written, so that 90 degrees stays exact). Axes are the sheet's: right-handed, camera rays towards +z.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

Vector = tuple[float, float, float]
Rgb = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class SheetSpec:
    """A sheet of the scene, and how exactly rays pass it.

    Parameters
    ----------
    design : str
        File, relative to the scene's folder.
    set : mapping
        Dotted design key → value, laid over the file.
    rung : {"auto", "law", "thin", "surfaces", "mesh"}
    mesh : str or None
        Triangles as written, for rung mesh.
    quads : int
        Quads a cell side, for rung mesh without a file.
    surround : {"see-through", "opaque"}
        What is visible next to the sheet.
    tint : (red, green, blue)
        Linear transmission, 0 to 1, of light seen through the sheet; for a single sheet only.
    continuous : bool
        Rung law: apply a varying law at the exact point hit instead of that of the cell hit.
    id : str
        Name among several; "" for the only one.
    z : float, length
        Height of the sheet's own z = 0 in the scene.
    """

    design: str
    set: Mapping[str, Any]
    rung: Literal["auto", "law", "thin", "surfaces", "mesh"]
    mesh: str | None
    quads: int
    surround: Literal["see-through", "opaque"]
    continuous: bool = False
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    id: str = ""
    z: float = 0.0


@dataclass(frozen=True, slots=True)
class Camera:
    """Pinhole, or an opening of finite diameter, in front of the sheet.

    Parameters
    ----------
    position, target : (3,) lengths
        Position of the camera (z < 0) and the point it is aimed at.
    up : (3,)
        Direction that is up in the picture.
    frame : float or None, length
        Width of the picture at the target; None: given by `fov`.
    fov : float or None, radians
        Full width of the picture as an angle.
    pixels : (width, height)
    samples : int
        Rays per pixel.
    noise : float
        Standard error of a pixel's mean at which sampling stops; 0: always `samples` rays.
    most_samples : int
        Largest number of rays per pixel, where `noise` requires more than `samples`.
    aperture : float, length
        Diameter of the opening; 0 is a pinhole.
    focus : float or None, length
        Distance of the sharp plane; None: the target's.
    exposure : float
        Factor on the light when a file is written.
    mirror : bool
        Left-handed view, x to the right.
    encoding : {"srgb", "linear"}
        Of picture files.
    """

    position: Vector
    target: Vector
    up: Vector
    frame: float | None
    fov: float | None
    pixels: tuple[int, int]
    samples: int
    noise: float
    most_samples: int
    aperture: float
    focus: float | None
    exposure: float
    mirror: bool
    encoding: Literal["srgb", "linear"]


@dataclass(frozen=True, slots=True)
class Light:
    """Light on the objects: radiance = colour · (ambient + key · max(0, n · l)).

    Parameters
    ----------
    ambient, key : float
    direction : (3,)
        Towards the light, any length > 0.
    spectrum : "rgb", "D65" or float (metres)
        Wavelengths at which rays are traced.
    polariser, analyser : float or None, degrees
        Directions of a polarisation before and behind the sheet, from the x axis.
    """

    ambient: float
    key: float
    direction: Vector
    spectrum: Literal["rgb", "D65"] | float
    polariser: float | None
    analyser: float | None


@dataclass(frozen=True, slots=True)
class Background:
    """Sky, linear in elevation from the second colour (horizon) to the first (zenith), and ground."""

    sky: tuple[Rgb, Rgb]
    ground: Rgb


@dataclass(frozen=True, slots=True)
class SceneObject:
    """One visible object; its `kind` determines which fields apply (see `clacad.scene.keys.KEYS_OF`).

    Parameters
    ----------
    id : str
        Name for animation.
    kind : {"checker", "knight", "mesh", "screen", "sphere", "box", "cone", "group"}
    at : (3,) lengths
        Centre of sphere, box and screen; middle of the foot of knight, mesh and cone; origin of a group.
    size : tuple of lengths
        See `clacad.scene.keys.SIZES`.
    turn : (3,) degrees
        About the fixed x, y, z axes through `at`, in this order.
    colour : (3,) linear rgb
    height, tile : lengths
        Of a checker floor.
    reach : float or None, length
        Distance along a ray up to which a floor is drawn.
    colours : ((3,), (3,))
        Odd and even tiles, or the two stripes.
    file : str or None
        Mesh or picture, relative to the scene's folder.
    up : {"y", "z"}
        Axis of a mesh file that points up.
    pattern : {"colour", "coordinates", "image", "stripes"}
        What a screen shows.
    period : float or None, length
        Width of a pair of stripes.
    parts : tuple of SceneObject
        Of a group, relative to its `at`.
    """

    id: str
    kind: str
    at: Vector
    size: tuple[float, ...]
    turn: Vector
    colour: Rgb
    height: float
    tile: float
    reach: float | None
    colours: tuple[Rgb, Rgb]
    file: str | None
    up: str
    pattern: str
    period: float | None
    parts: tuple[SceneObject, ...] = ()


@dataclass(frozen=True, slots=True)
class EffectsSpec:
    """Effects to simulate.

    Parameters
    ----------
    mode : {"auto", "list", "none"}
    list, force, without : tuple of str
        Mode list: exactly these; mode auto: plus these, minus these.
    angle : float or None, radians
        Smallest angle that matters; None: half a pixel, never under 0.15 mrad.
    radiance : float
        Smallest relative radiance that matters.
    coating : {"none", "quarter-wave"}
    order : int
        Largest number of reflections in a path.
    """

    mode: Literal["auto", "list", "none"]
    list: tuple[str, ...]
    force: tuple[str, ...]
    without: tuple[str, ...]
    angle: float | None
    radiance: float
    coating: Literal["none", "quarter-wave"]
    order: int


@dataclass(frozen=True, slots=True)
class Move:
    """One key of the scene that changes with time.

    Parameters
    ----------
    key : str
        "object.<id>.<key>[.index]", "sheet.set.<design key>[.index]", of several sheets "sheet.<id>.set.<design key>[.index]"
        or "sheet.<id>.<key>", or "camera.<key>[.index]".
    times : tuple of float
        0 … 1, ascending.
    values : tuple
        A number, or a tuple of numbers, for each time; linear interpolation in between.
    ease : {"linear", "smooth"}
        Time profile: smooth starts and ends at rest (3t² − 2t³).
    """

    key: str
    times: tuple[float, ...]
    values: tuple[Any, ...]
    ease: Literal["linear", "smooth"]


@dataclass(frozen=True, slots=True)
class Animation:
    """Number of frames, and the keys that change."""

    frames: int
    fps: float
    moves: tuple[Move, ...]
