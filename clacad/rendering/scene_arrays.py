"""The scene's objects as arrays for intersection with rays: primitives, paints, bounds.

Lengths are in the scene's unit. A primitive has its own frame: local = Rᵀ (point − origin). Primitives of one
object form a cluster with one bounding sphere, so a ray that misses the object costs one test.

A stage laid out for compiled code: four plain arrays.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clacad.base.types import Floats
from clacad.rendering.photographs import read_picture
from clacad.scene import chess_knight
from clacad.scene.chess_knight import turned
from clacad.tracing.facets.hierarchy import Hierarchy, joined, mesh_tree

if TYPE_CHECKING:
    from clacad.base.types import Floats, Ints
    from clacad.scene import Background, Light, Scene, SceneObject


FLOOR, SPHERE, BOX, CONE, PRISM, SCREEN, MESH = range(7)
"""Kinds of primitive."""

LIT, CHECKER, COORDINATES, STRIPES, IMAGE = range(5)
"""Kinds of paint; coordinates and image are luminous."""


@dataclass(frozen=True, eq=False)
class Primitive:
    """One primitive before it is put into the arrays; fields as in `SceneArrays`."""

    kind: int
    rotation: Floats
    origin: Floats
    size: tuple[float, float, float, float]
    colours: tuple[tuple[float, float, float], tuple[float, float, float]]
    paint: int = LIT
    pattern: float = 1.0
    outline: Floats | None = None
    image: Floats | None = None
    tree: Hierarchy | None = None


@dataclass(frozen=True, eq=False)
class SceneArrays:
    """All objects of a scene.

    kind : (n,) ints
    rotation : (n, 3, 3), local → scene
    origin : (n, 3)
    size : (n, 4). Sphere: radius. Box, screen: half extents. Cone: bottom radius, top radius, height. Prism:
        half thickness. Floor: reach.
    box : (n, 2, 3). Low and high corner, scene frame, of a box round the primitive (infinite for a floor).
    paint : (n,) ints
    colours : (n, 2, 3)
    pattern : (n,). Side of a tile, width of a pair of stripes.
    piece : (n, 2) ints
        First and end row of the primitive's own data: corners in `outline`, pixels, or trees of the forest.
    outline : (k, 2). Corners of prisms.
    pixels : (k, 3), picture : (n, 2) ints. Linear light of pictures, row by row; height and width.
    forest : All meshes, each in its tree.
    cluster : (m, 2) ints, cluster_box : (m, 2, 3)
        First and end primitive of each object, and a box round it.
    towards_light : (3,) unit
    sky : (2, 3), ground : (3,)
    """

    kind: Ints
    rotation: Floats
    origin: Floats
    size: Floats
    box: Floats
    paint: Ints
    colours: Floats
    pattern: Floats
    piece: Ints
    outline: Floats
    pixels: Floats
    picture: Ints
    forest: Hierarchy
    cluster: Ints
    cluster_box: Floats
    ambient: float
    key: float
    towards_light: Floats
    sky: Floats
    ground: Floats


def set_stage(scene: Scene) -> SceneArrays:
    """Lay out the objects of a scene.

    Raises SceneError: A file is missing.
    Raises UnreadableFile: A mesh is damaged; a picture raises OSError.
    """
    return stage_of(
        [list(_primitives(scene, thing)) for thing in scene.objects], scene.light, scene.background
    )


def stage_of(clusters: list[list[Primitive]], light: Light, sky: Background) -> SceneArrays:
    """Lay out primitives, those of one object together."""
    clusters = [cluster for cluster in clusters if cluster]
    flat = [one for cluster in clusters for one in cluster]
    towards = np.array(light.direction) / math.hypot(*light.direction)
    outlines = [one.outline if one.outline is not None else np.zeros((0, 2)) for one in flat]
    images = [one.image if one.image is not None else np.zeros((0, 0, 3)) for one in flat]
    trees = tuple(one.tree for one in flat if one.tree is not None)
    ends = np.cumsum([len(cluster) for cluster in clusters], dtype=np.int64)
    starts = np.concatenate([[0], ends[:-1]]).astype(np.int64) if len(ends) else np.zeros(0, np.int64)
    boxes = np.array([_box(one) for one in flat]).reshape(-1, 2, 3)
    around = [(boxes[a:b, 0].min(axis=0), boxes[a:b, 1].max(axis=0)) for a, b in zip(starts, ends)]
    return SceneArrays(
        kind=np.array([one.kind for one in flat], dtype=np.int64),
        rotation=np.array([one.rotation for one in flat]).reshape(-1, 3, 3),
        origin=np.array([one.origin for one in flat], dtype=np.float64).reshape(-1, 3),
        size=np.array([one.size for one in flat], dtype=np.float64).reshape(-1, 4),
        box=boxes,
        paint=np.array([one.paint for one in flat], dtype=np.int64),
        colours=np.array([one.colours for one in flat], dtype=np.float64).reshape(-1, 2, 3),
        pattern=np.array([one.pattern for one in flat], dtype=np.float64),
        piece=_pieces(flat, outlines, images),
        outline=np.concatenate(outlines) if flat else np.zeros((0, 2)),
        pixels=np.concatenate([i.reshape(-1, 3) for i in images]) if flat else np.zeros((0, 3)),
        picture=np.array([i.shape[:2] for i in images], dtype=np.int64).reshape(-1, 2),
        forest=joined(trees),
        cluster=np.stack([starts, ends], axis=-1) if len(ends) else np.zeros((0, 2), np.int64),
        cluster_box=np.array(around).reshape(-1, 2, 3),
        ambient=light.ambient,
        key=light.key,
        towards_light=towards,
        sky=np.array(sky.sky),
        ground=np.array(sky.ground),
    )


def _pieces(flat: list[Primitive], outlines: list[Floats], images: list[Floats]) -> Ints:
    found, corner, pixel, mesh = [], 0, 0, 0
    for one, outline, image in zip(flat, outlines, images, strict=True):
        rows = image.shape[0] * image.shape[1]
        if one.tree is not None:
            found.append((mesh, mesh + 1))
            mesh += 1
        else:
            found.append((corner, corner + len(outline)) if len(outline) else (pixel, pixel + rows))
        corner, pixel = corner + len(outline), pixel + rows
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def _primitives(scene: Scene, thing: SceneObject) -> Iterator[Primitive]:
    """The primitives of one object, placed in the scene."""
    frame, at = turned(thing.turn), np.array(thing.at, dtype=np.float64)
    if thing.kind == "group":
        for part in thing.parts:
            for one in _primitives(scene, part):
                yield replace(one, rotation=frame @ one.rotation, origin=frame @ one.origin + at)
        return
    both = (thing.colour, thing.colour)
    size = thing.size
    if thing.kind == "checker":
        reach = math.inf if thing.reach is None else thing.reach
        origin = np.array([0.0, thing.height, 0.0])
        yield Primitive(FLOOR, np.eye(3), origin, (reach, 0, 0, 0), thing.colours, CHECKER, thing.tile)
    elif thing.kind == "sphere":
        yield Primitive(SPHERE, frame, at, (0.5 * size[0], 0, 0, 0), both)
    elif thing.kind == "box":
        yield Primitive(BOX, frame, at, (0.5 * size[0], 0.5 * size[1], 0.5 * size[2], 0), both)
    elif thing.kind == "cone":
        yield Primitive(CONE, frame, at, (0.5 * size[0], 0.5 * size[1], size[2], 0), both)
    elif thing.kind == "screen":
        yield _screen(scene, thing, frame, at)
    elif thing.kind == "knight":
        yield from _knight(thing, frame, at)
    else:
        yield Primitive(MESH, frame, at, (0, 0, 0, 0), both, tree=_mesh(scene, thing))


def _knight(thing: SceneObject, frame: Floats, at: Floats) -> Iterator[Primitive]:
    s, both = thing.size[0], (thing.colour, thing.colour)
    for y0, y1, r0, r1 in chess_knight.PLINTH:
        origin = frame @ np.array([0.0, s * y0, 0.0]) + at
        yield Primitive(CONE, frame, origin, (s * r0, s * r1, s * (y1 - y0), 0), both)
    half = s * chess_knight.HALF_THICKNESS
    yield Primitive(PRISM, frame, at, (half, 0, 0, 0), both, outline=s * chess_knight.PROFILE)
    x, y, radius = chess_knight.EYE
    red, green, blue = (chess_knight.EYE_SHADE * part for part in thing.colour)
    dark = ((red, green, blue), (red, green, blue))
    lying = frame @ turned((90.0, 0.0, 0.0))  # the rod's axis y along the head's z
    origin = frame @ np.array([s * x, s * y, -1.02 * half]) + at
    yield Primitive(CONE, lying, origin, (s * radius, s * radius, 2.04 * half, 0), dark)


def _screen(scene: Scene, thing: SceneObject, frame: Floats, at: Floats) -> Primitive:
    w, h = thing.size
    size = (0.5 * w, 0.5 * h, 0.0, 0.0)
    both = (thing.colour, thing.colour)
    if thing.pattern == "image":
        assert thing.file is not None  # the scene's rules require it
        return Primitive(SCREEN, frame, at, size, both, IMAGE, image=read_picture(scene.file(thing.file)))
    if thing.pattern == "stripes":
        return Primitive(SCREEN, frame, at, size, thing.colours, STRIPES, thing.period or 1.0)
    paint = COORDINATES if thing.pattern == "coordinates" else LIT
    return Primitive(SCREEN, frame, at, size, both, paint)


def _mesh(scene: Scene, thing: SceneObject) -> Hierarchy:
    """The tree of a mesh object; cached, because every frame of a movie needs it."""
    assert thing.file is not None  # the scene's rules require it
    path = scene.file(thing.file)
    try:
        facts = os.stat(path)
    except OSError:  # reported by the reader
        return _grown(scene, thing)
    key = (str(path), facts.st_mtime_ns, facts.st_size, thing.size, thing.up)
    if key not in _TREES:
        if len(_TREES) >= KEPT_TREES:
            _TREES.pop(next(iter(_TREES)), None)
        _TREES[key] = _grown(scene, thing)
    return _TREES[key]


def _grown(scene: Scene, thing: SceneObject) -> Hierarchy:
    from clacad.formats.mesh.readers import standing_corners

    assert thing.file is not None  # the scene's rules require it
    return mesh_tree(standing_corners(scene.file(thing.file), thing.up, thing.size[0]))


KEPT_TREES = 4
"""Largest number of cached trees."""

_TREES: dict[tuple[str, int, int, tuple[float, ...], str], Hierarchy] = {}


# Columns of `Tables.prim`.
KIND, PAINT, PATTERN, PIECE, END, ROWS, COLUMNS, SIZE, BOUND, ORIGIN, TURN, COLOUR = (
    *range(8),
    11,
    17,
    20,
    29,
)
PRIM_WIDTH = 35
# Numbers of `Tables.world`.
AMBIENT, KEY, TOWARDS_LIGHT, ZENITH, HORIZON, GROUND = 0, 1, 2, 5, 8, 11

# Columns of `Tables.cluster`.
FIRST, PAST, CENTRE, EXTENT = 0, 1, 2, 5

BLOCK = 256
"""Rays of a block: its columns stay in the first-level cache."""


class Tables(NamedTuple):
    """A `SceneArrays` in plain arrays: compiled code passes few arrays quickly and many slowly.

    world : (14,). Ambient, key, direction to the light (3), zenith (3), horizon (3), ground (3).
    cluster : (m, 8). First primitive and one past the last, centre and half extents of a box round them
        (infinite round a floor).
    prim : (n, 35)
        A primitive a row, columns as named above; BOUND: low and high corner of a box round it, scene frame.
    store : (k,). Corners of prisms and pixels; indices into it are absolute.
    trees : Meshes; the piece of a primitive is its number there.
    """

    world: Floats
    cluster: Floats
    prim: Floats
    store: Floats
    trees: Hierarchy


def tables(stage: SceneArrays) -> Tables:
    """Lay a stage out for compiled code."""
    n, pixel0 = len(stage.kind), stage.outline.size
    store = np.concatenate([stage.outline.ravel(), stage.pixels.ravel()])
    piece = np.zeros((n, 2))
    for kind, start, width in ((PRISM, 0, 2), (SCREEN, pixel0, 3), (MESH, 0, 1)):
        rows = stage.kind == kind
        piece[rows] = start + width * stage.piece[rows]
    prim = np.column_stack(
        [
            stage.kind,
            stage.paint,
            stage.pattern,
            piece,
            stage.picture,
            stage.size,
            stage.box.reshape(-1, 6),
            stage.origin,
            stage.rotation.reshape(-1, 9),
            stage.colours.reshape(-1, 6),
        ]
    )
    world = np.concatenate([[stage.ambient, stage.key], stage.towards_light, stage.sky.ravel(), stage.ground])
    low, high = stage.cluster_box[:, 0], stage.cluster_box[:, 1]
    with np.errstate(invalid="ignore"):  # a floor has no middle
        middle, half = np.where(np.isfinite(low), 0.5 * (low + high), 0.0), 0.5 * (high - low)
    cluster = np.column_stack([stage.cluster, middle, half])
    cluster, prim = np.ascontiguousarray(cluster, dtype=np.float64), prim.reshape(-1, PRIM_WIDTH)
    return Tables(world, cluster, prim, store, stage.forest)


def _box(one: Primitive) -> Floats:
    """Low and high corner (2, 3), scene frame, of a box round a primitive."""
    kind, (a, b, c, _) = one.kind, one.size
    half, middle = np.array([a, b, c]), np.zeros(3)
    if kind == FLOOR:
        return np.array([[-np.inf] * 3, [np.inf] * 3])
    if kind == SPHERE:
        half = np.full(3, a)
    elif kind == CONE:
        radius = max(a, b)
        half, middle = np.array([radius, 0.5 * c, radius]), np.array([0.0, 0.5 * c, 0.0])
    elif kind == SCREEN:
        half = np.array([a, b, 0.0])
    elif one.outline is not None:
        low, high = np.append(one.outline.min(axis=0), -a), np.append(one.outline.max(axis=0), a)
        half, middle = 0.5 * (high - low), 0.5 * (high + low)
    elif one.tree is not None:
        low, high = one.tree.box[0, :3], one.tree.box[0, 3:]
        half, middle = 0.5 * (high - low), 0.5 * (high + low)
    centre, reach = one.rotation @ middle + one.origin, np.abs(one.rotation) @ half
    reach = reach + 1e-9 * reach.max()
    return np.array([centre - reach, centre + reach])
