"""Text as plane faces, in an order that depends on the text alone.

OCC orders the pieces of a glyph ("i", "=") and the holes of one ("8", "B") by their memory addresses. A text
drawn twice would have two orders, and so would every mesh and file made of it.
"""

from __future__ import annotations

from typing import Any


def lettering(text: str, size: float) -> Any:
    """A line of bold text in the plane z = 0, about the origin: a build123d sketch, faces and holes from left to right.

    Parameters
    ----------
    text : str
    size : float
        Height of the font (mm).
    """
    from build123d import Compound, FontStyle, Sketch, Text

    drawn: Any = Text(text, size, font_style=FontStyle.BOLD)
    faces = sorted(drawn.faces(), key=lambda face: _place(face.outer_wire()))
    return Sketch(Compound([_with_ordered_holes(face) for face in faces]).wrapped)


def _with_ordered_holes(face: Any) -> Any:
    """The face with the same wires, its holes from left to right."""
    from build123d import Face
    from OCP.BRep import BRep_Builder
    from OCP.TopAbs import TopAbs_Orientation

    forward = Face(face.wrapped.Oriented(TopAbs_Orientation.TopAbs_FORWARD))
    made = forward.wrapped.EmptyCopied()
    build = BRep_Builder()
    for wire in (forward.outer_wire(), *sorted(forward.inner_wires(), key=_place)):
        build.Add(made, wire.wrapped)
    return Face(made.Oriented(face.wrapped.Orientation()))


def _place(wire: Any) -> tuple[float, float, float, float]:
    """Corners of a wire's box: left, bottom, right, top."""
    box = wire.bounding_box()
    return (box.min.X, box.min.Y, box.max.X, box.max.Y)
