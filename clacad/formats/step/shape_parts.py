"""Parts of an OCC shape: each part once, with all its placements. Lengths in mm.

An assembly of 80,000 cells is a few shapes and a tree of placements; no function here visits a part twice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from clacad.base.types import Floats
from clacad.formats.placements import UNPLACED, Placements, composed, product, unturned

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])


@dataclass(frozen=True, eq=False)
class ShapePart:
    """A solid, or a shell or face outside of solids, with its placements.

    shape : kernel shape, unplaced
    faces : list of kernel faces
    """

    shape: Any
    solid: bool
    faces: list[Any]
    shells: int
    placements: Placements


def pieces(shape: Any) -> list[ShapePart]:
    """The pieces of a shape, in the order they are met.

    Raises UnreadableFile: A part contains itself, or occurs too often.
    """
    from OCP.TopAbs import TopAbs_FACE, TopAbs_SHELL, TopAbs_SOLID

    from clacad.solid.occ_writer import explored

    if shape.IsNull():
        return []
    shapes, held = _parts_held(shape)
    top = placement_of(shape.Location())
    placed = composed(held, list(shapes))
    found = []
    for key, one in shapes.items():
        kind = one.ShapeType()
        if kind.value < TopAbs_SOLID.value or kind.value > TopAbs_FACE.value:
            continue
        found.append(
            ShapePart(
                one,
                kind == TopAbs_SOLID,
                explored(one, TopAbs_FACE),
                len(explored(one, TopAbs_SHELL)),
                _under(top, placed[key]),
            )
        )
    return found


def _under(top: Floats, placements: Placements) -> Placements:
    """Placements of a part of a shape that is itself placed."""
    if np.array_equal(top, UNPLACED):
        return placements
    return Placements(product(top, placements.all()))


def _parts_held(shape: Any) -> tuple[dict[Any, Any], dict[Any, list[tuple[Any, Floats]]]]:
    """Every part of a shape by its key, unplaced, in order; children of each, with placements (k, 3, 4)."""
    from OCP.TopAbs import TopAbs_SOLID
    from OCP.TopLoc import TopLoc_Location
    from OCP.TopoDS import TopoDS_Iterator

    shapes: dict[Any, Any] = {}
    held: dict[Any, list[tuple[Any, Floats]]] = {}
    waiting = [shape]
    while waiting:
        one = waiting.pop()
        key = one.TShape()
        if key in shapes:
            continue
        shapes[key] = one.Located(TopLoc_Location())
        if one.ShapeType().value >= TopAbs_SOLID.value:
            continue
        own: dict[Any, list[Floats]] = {}
        inside = TopoDS_Iterator(shapes[key], True, True)
        while inside.More():
            child = inside.Value()
            own.setdefault(child.TShape(), []).append(placement_of(child.Location()))
            waiting.append(child)
            inside.Next()
        held[key] = [(child, np.array(many)) for child, many in own.items()]
    return shapes, held


def placement_of(location: Any) -> Floats:
    """A location of OCC as (3, 4)."""
    move = location.Transformation()
    return np.array([[move.Value(i, j) for j in (1, 2, 3, 4)] for i in (1, 2, 3)])


def moved(shape: Any, placement: Floats) -> Any:
    """A shape moved by a placement (3, 4)."""
    from OCP.gp import gp_Trsf
    from OCP.TopLoc import TopLoc_Location

    move = gp_Trsf()
    move.SetValues(*placement.ravel().tolist())
    return shape.Moved(TopLoc_Location(move))


def whole_box(several: list[ShapePart]) -> list[list[float]]:
    """Lowest and highest corner of all pieces in all their placements."""
    from clacad.solid.occ_writer import box

    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for piece in several:
        for turn, least, most in piece.placements.ends():
            corners = np.array(box(moved(piece.shape, turn)))
            low = np.minimum(low, corners[0] + least)
            high = np.maximum(high, corners[1] + most)
    return [low.tolist(), high.tolist()]


def boxes_of(faces: list[Any]) -> Floats:
    """Boxes (n, 2, 3) of faces."""
    from clacad.solid.occ_writer import box

    return np.array([box(face) for face in faces]).reshape(-1, 2, 3)


def reaching(piece: ShapePart, boxes: Floats, low: Floats, high: Floats) -> Iterator[Any]:
    """Faces of a piece, placed, whose boxes reach into the column low … high (2,) of x and y."""
    whole = np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])
    near = piece.placements.at(piece.placements.near(low - whole[1, :2], high - whole[0, :2]))
    for placement in near[_reach(whole[None], near, low, high)]:
        for number in np.flatnonzero(_reach(boxes, placement[None], low, high)):
            yield placement, piece.faces[number]


def _reach(boxes: Floats, placements: Floats, low: Floats, high: Floats) -> Any:
    """Whether boxes (n, 2, 3), or one of them in n placements, reach into a column."""
    if unturned(placements):
        least = boxes[:, 0, :2] + placements[:, :2, 3]
        most = (boxes[:, 0] + (boxes[:, 1] - boxes[:, 0]))[:, :2] + placements[:, :2, 3]
        return ((most >= low) & (least <= high)).all(axis=1)
    corners = boxes[:, :1] + CORNERS * (boxes[:, 1:] - boxes[:, :1])
    at = corners @ np.swapaxes(placements[:, :, :3], 1, 2) + placements[:, None, :, 3]
    flat = at[..., :2]
    return ((flat.max(axis=1) >= low) & (flat.min(axis=1) <= high)).all(axis=1)
