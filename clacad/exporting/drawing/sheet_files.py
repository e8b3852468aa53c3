"""A drawing as DXF (R2010) and as PDF.

DXF is written and read by ezdxf: sheets next to each other in model space, mm of paper, with true
dimensions. A DIMENSION measures its own two points; its factor (DIMLFAC) converts paper to part, so that a
CAD program reads true sizes in any view. Needs the extra `dxf`.

PDF is each sheet as SVG, set by Typst as in the report. Needs the extra `pdf`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from clacad.exporting.drawing.canvas import (
    STYLE,
    CircleMark,
    DimensionMark,
    LineMark,
    Mark,
    ScaleNote,
    Words,
    said_scale,
)
from clacad.exporting.drawing.sheet_layout import PlacedBlock, Sheet
from clacad.storage.atomic import scratch_folder
from clacad.storage.errors import FileDisagrees, NotPossible, UnreadableFile

GAP = 20.0
"""Gap between two sheets, mm."""

LAYERS = {
    "OUTLINE": (5, 35),
    "DIMENSIONS": (7, 18),
    "TEXT": (7, 18),
    "AXES": (8, 18),
    "LIGHT": (30, 18),
    "FRAME": (7, 50),
}
"""Layer: colour (AutoCAD's index), line weight (hundredths of a millimetre)."""

LAYER_OF = {
    "body": "OUTLINE",
    "cut": "OUTLINE",
    "axis": "AXES",
    "ext": "DIMENSIONS",
    "dim": "DIMENSIONS",
    "head": "DIMENSIONS",
    "ray": "LIGHT",
    "focus": "LIGHT",
    "frame": "FRAME",
}

TYPE = 7.6
"""Height of capital letters, px of the drawing boards."""

DIGITS = 1e-4
"""Relative rounding of a dimension's words, which have five digits."""


def require_drawing() -> None:
    """Raise an error that names the missing extras. Raises NotPossible."""
    lacking = {extra: name for name, extra in (("ezdxf", "dxf"), ("typst", "pdf")) if find_spec(name) is None}
    if lacking:
        raise NotPossible(
            f"format drawing needs the package{'s' if len(lacking) > 1 else ''}"
            f" {' and '.join(lacking.values())}\n"
            f'  install with: pip install "clacad[{",".join(lacking)}]"'
        )


def write_drawing_dxf(made: Sequence[Sheet], path: Path) -> int:
    """Write all sheets; return the number of dimensions. Equal sheets give equal bytes. Raises OSError."""
    import ezdxf
    from ezdxf import units

    fixed = ezdxf.options.write_fixed_meta_data_for_testing
    ezdxf.options.write_fixed_meta_data_for_testing = True  # no clock and no random numbers in the header
    try:
        document = ezdxf.new("R2010")
        document.units = units.MM
        for name, (colour, weight) in LAYERS.items():
            document.layers.add(name, color=colour, lineweight=weight)
        document.styles.add("CLACAD", font="LiberationSans-Regular.ttf")
        document.dimstyles.duplicate_entry("Standard", "CLACAD")
        pen = _Pen(document)
        for number, sheet in enumerate(made):
            pen.sheet(sheet, number * (sheet.paper[0] + GAP))
        for name in sorted(
            document.entitydb.dxf_types_in_use()
        ):  # ezdxf would take them in the order of a set
            document.classes.add_class(name)
        document.saveas(path)
    finally:
        ezdxf.options.write_fixed_meta_data_for_testing = fixed
    return pen.dimensions


class _Pen:
    """Draws marks of boards into a document: px of a board become mm of model space, y upwards."""

    def __init__(self, document: Any) -> None:
        self.document, self.space = document, document.modelspace()
        self.dimensions = 0
        self._left, self._top, self._unit = 0.0, 0.0, 1.0

    def sheet(self, sheet: Sheet, x: float) -> None:
        wide, tall = sheet.paper
        corners = [(x, 0.0), (x + wide, 0.0), (x + wide, tall), (x, tall)]
        self.space.add_lwpolyline(corners, close=True, dxfattribs={"layer": "FRAME"})
        for placed in sheet.drawn:
            self._board(sheet, placed, x)

    def _board(self, sheet: Sheet, placed: PlacedBlock, x: float) -> None:
        self._left, self._top, self._unit = x + placed.x, sheet.paper[1] - placed.y, sheet.unit
        for mark in placed.canvas.marks:
            if isinstance(mark, DimensionMark):
                self._measure(mark, placed.canvas.scale)
            else:
                self._mark(self.space, mark, placed.canvas.scale, sheet.zoom)

    def _at(self, point: Any) -> tuple[float, float]:
        return self._left + float(point[0]) * self._unit, self._top - float(point[1]) * self._unit

    def _mark(self, into: Any, mark: Mark, scale: float | None, zoom: float) -> None:
        if isinstance(mark, LineMark):
            self._shape(into, mark)
        elif isinstance(mark, CircleMark):
            layer = {"layer": LAYER_OF.get(mark.kind, "OUTLINE")}
            into.add_circle(self._at(mark.at), mark.radius * self._unit, dxfattribs=layer)
        elif isinstance(mark, ScaleNote):
            self._words(into, said_scale(mark, scale, zoom))
        elif isinstance(mark, Words):
            self._words(into, mark)

    def _shape(self, into: Any, shape: LineMark) -> None:
        points = [self._at(point) for point in shape.points]
        layer = {"layer": LAYER_OF.get(shape.kind, "OUTLINE")}
        if shape.kind in ("head", "mark"):
            into.add_solid([*points, points[-1]], dxfattribs=layer)
        else:
            into.add_lwpolyline(points, close=shape.closed, dxfattribs=layer)

    def _words(self, into: Any, words: Words) -> None:
        from ezdxf.enums import TextEntityAlignment

        where = {
            "start": TextEntityAlignment.LEFT,
            "middle": TextEntityAlignment.CENTER,
            "end": TextEntityAlignment.RIGHT,
        }
        height = TYPE * self._unit * (1.15 if words.kind == "title" else 1.0)
        attributes = {"layer": "TEXT", "style": "CLACAD", "width": 0.85}
        text = into.add_text(words.words, height=height, dxfattribs=attributes)
        text.set_placement(self._at(words.at), align=where[words.anchor])

    def _measure(self, mark: DimensionMark, scale: float | None) -> None:
        """A DIMENSION with the picture of the board: ezdxf's depends on the fonts of this machine."""
        assert scale is not None, "a dimension belongs to a view to scale"
        factor = 1.0 / (scale * self._unit)
        dimension = self.space.add_linear_dim(
            base=self._at(mark.base),
            p1=self._at(mark.ends[0]),
            p2=self._at(mark.ends[1]),
            angle=90 if mark.upright else 0,
            text=mark.words,
            dimstyle="CLACAD",
            override={"dimlfac": factor},
            dxfattribs={"layer": "DIMENSIONS"},
        )
        dimension.commit()
        made, picture = dimension.dimension, self.document.blocks.new_anonymous_block(type_char="D")
        made.dxf.geometry = picture.name
        made.dxf.text_midpoint = self._at(next(one.at for one in mark.drawn if isinstance(one, Words)))
        made.dxf.actual_measurement = float(np.asarray(made.get_measurement())) * factor
        for one in mark.drawn:
            self._mark(picture, one, scale, 1.0)
        self.dimensions += 1


# -- reading back --------------------------------------------------------------------------------------
def dimensions_in(path: Path) -> Iterator[tuple[str, float]]:
    """Words of each dimension of a drawing, and the length (mm of the part) between its two points.

    Raises UnreadableFile.
    """
    import ezdxf

    try:
        document = ezdxf.readfile(path)
    except (OSError, ezdxf.DXFError, ValueError) as error:
        raise UnreadableFile(f"{path.name}: {error}") from error
    faults = document.audit().errors
    if faults:
        raise UnreadableFile(f"{path.name}: {faults[0].message}")
    for entity in document.modelspace().query("DIMENSION"):
        measured = float(np.asarray(entity.get_measurement()))
        yield entity.dxf.text, measured * float(entity.override().get("dimlfac", 1.0))


def check_drawing_dxf(path: Path, written: int) -> None:
    """Read a drawing back: every dimension exists, and its words agree with the distance of its points.

    Raises FileDisagrees, UnreadableFile.
    """
    found = list(dimensions_in(path))
    if len(found) != written:
        raise FileDisagrees(f"{path.name}: {len(found)} dimensions were read back, {written} were written")
    for words, measured in found:
        stated = re.search(r"-?\d[\d.]*(?:e[-+]?\d+)?(?=$| ±)", words)
        if stated is None or not abs(float(stated[0]) - measured) <= DIGITS * max(measured, 1e-9) + 1e-9:
            raise FileDisagrees(
                f"{path.name}: a dimension says {words!r} where {measured:.6g} mm lie between its points"
            )


def sheet_svg(sheet: Sheet) -> str:
    """A sheet of paper as SVG, a millimetre a unit."""
    wide, tall = sheet.paper
    boards = "\n".join(
        f'<g transform="translate({one.x:.4f} {one.y:.4f})'
        f' scale({sheet.unit:.7f})">\n{one.canvas.body(sheet.zoom)}\n</g>'
        for one in sheet.drawn
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide:g} {tall:g}" width="{wide:g}mm"'
        f' height="{tall:g}mm"><style>{STYLE}</style>\n{boards}\n</svg>'
    )


def write_drawing_pdf(made: Sequence[Sheet], path: Path) -> None:
    """Write all sheets, a page each; equal sheets give equal bytes."""
    import typst

    with scratch_folder() as place:
        lines = []
        for number, sheet in enumerate(made):
            (place / f"{number}.svg").write_text(sheet_svg(sheet), encoding="utf-8")
            wide, tall = sheet.paper
            lines.append(
                f'#page(width: {wide:g}mm, height: {tall:g}mm, margin: 0mm, image("{number}.svg", width:'
                f" {wide:g}mm))"
            )
        main = '#set document(title: "drawing", author: "clacad", date: none)\n' + "\n".join(lines)
        (place / "main.typ").write_text(main, encoding="utf-8")
        path.write_bytes(
            bytes(typst.compile(str(place / "main.typ"), root=str(place), ignore_system_fonts=True))
        )


def check_drawing_pdf(path: Path, pages: int) -> None:
    """Reject a file that is not a whole PDF with this number of pages. Raises FileDisagrees."""
    data = path.read_bytes()
    if not data.startswith(b"%PDF") or b"%%EOF" not in data[-64:] or b"/Count %d" % pages not in data:
        raise FileDisagrees(f"{path.name}: no whole PDF of {pages} pages")
