"""The stream of a Part 21 (STEP) file: header, units, products, assemblies, colours; fused or instanced.

No clock, host or user name is written: equal entities give equal bytes. Lengths in mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, log10
from typing import IO, TYPE_CHECKING, Literal

import numpy as np

from clacad.base.types import Floats

if TYPE_CHECKING:
    from clacad.sheet.window import Window

Mode = Literal["auto", "fused", "instanced"]

FUSED_CELLS = 2500
"""Cells up to which mode "auto" writes fused solids."""

SCHEMAS = {
    "AP242": (
        "AP242_MANAGED_MODEL_BASED_3D_ENGINEERING_MIM_LF { 1 0 10303 442 1 1 4 }",
        "managed model based 3d engineering",
        "ap242_managed_model_based_3d_engineering",
        2013,
    ),
    "AP214": ("AUTOMOTIVE_DESIGN { 1 0 10303 214 1 1 1 1 }", "automotive_design", "automotive_design", 2000),
}

EPOCH = "1970-01-01T00:00:00"
"""Time stamp of every file: the format requires one, equal designs must give equal bytes."""

_FLUSH = 1 << 20


def quoted(text: str) -> str:
    """Encode a string of Part 21: quotes and backslashes doubled, other than ASCII in hexadecimal."""
    out = []
    for character in text:
        code = ord(character)
        if character in "'\\":
            out.append(character * 2)
        elif 32 <= code < 127:
            out.append(character)
        elif code < 0x10000:
            out.append(f"\\X2\\{code:04X}\\X0\\")
        else:
            out.append(f"\\X4\\{code:08X}\\X0\\")
    return "'" + "".join(out) + "'"


def real(value: float) -> str:
    """Write a number with all its digits."""
    text = repr(float(value))
    if "e" in text:
        mantissa, _, exponent = text.partition("e")
        return f"{mantissa if '.' in mantissa else mantissa + '.'}E{exponent}"
    return text[:-1] if text.endswith(".0") else text


def weight(value: float) -> str:
    """Write a weight; its 13 digits move no point of a patch farther than the rounding of its poles does."""
    return f"{value:.13f}".rstrip("0")


def chosen_mode(window: Window, mode: Mode) -> Literal["fused", "instanced"]:
    """Resolve mode "auto"; a non-uniform sheet has no cell to repeat, but may have a sector.

    Raises CellsDiffer: An assembly is requested for a sheet that has neither.
    """
    if mode not in ("auto", "fused", "instanced"):
        raise ValueError(f"STEP mode must be auto, fused or instanced, not {mode!r}")
    from clacad.sheet.representative_cells import sectors_of

    if mode == "auto" and window.lattice.cell_count <= FUSED_CELLS:
        return "fused"
    if window.uniform or (mode != "fused" and sectors_of(window) > 1):
        return "instanced" if mode == "auto" else mode
    if mode == "instanced":
        from clacad.sheet.need_window import need_equal_cells

        need_equal_cells(
            window, "a STEP assembly of one cell and its places", "fused is one solid of all of them"
        )
    return "fused"


@dataclass(frozen=True, slots=True)
class StepColour:
    """An sRGB colour, 0 … 1."""

    red: float
    green: float
    blue: float


class Part21:
    """Stream of entities of one file, with the units and contexts that every STEP file needs."""

    def __init__(self, stream: IO[str], schema: str, name: str, program: str, pitch: float) -> None:
        if schema not in SCHEMAS:
            raise ValueError(f"schema must be one of {', '.join(SCHEMAS)}, not {schema!r}")
        self._stream = stream
        self._lines: list[str] = []
        self._pending = 0
        self._next = 1
        # Twelve digits beyond the pitch: a thousand times finer than the 1e-9 pitch the faces are checked to.
        self.decimals = max(6, 12 + ceil(-log10(pitch)))
        self._styles: dict[StepColour, int] = {}
        identifier, application, protocol, year = SCHEMAS[schema]
        self.raw(
            "ISO-10303-21;\nHEADER;\nFILE_DESCRIPTION((''),'2;1');\n"
            f"FILE_NAME({quoted(name)},'{EPOCH}',(''),(''),{quoted(program)},{quoted(program)},'');\n"
            f"FILE_SCHEMA(('{identifier}'));\nENDSEC;\nDATA;\n"
        )
        context = self.add(f"APPLICATION_CONTEXT('{application}')")
        self.add(f"APPLICATION_PROTOCOL_DEFINITION('international standard','{protocol}',{year},#{context})")
        self._product_context = self.add(f"PRODUCT_CONTEXT('',#{context},'mechanical')")
        self._definition_context = self.add(
            f"PRODUCT_DEFINITION_CONTEXT('part definition',#{context},'design')"
        )
        length = self.add("(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.))")
        angle = self.add("(NAMED_UNIT(*)PLANE_ANGLE_UNIT()SI_UNIT($,.RADIAN.))")
        solid = self.add("(NAMED_UNIT(*)SI_UNIT($,.STERADIAN.)SOLID_ANGLE_UNIT())")
        accuracy = self.add(
            f"UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.E-07),#{length},"
            "'distance_accuracy_value','confusion accuracy')"
        )
        self.space = self.add(
            f"(GEOMETRIC_REPRESENTATION_CONTEXT(3)GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT((#{accuracy}))"
            f"GLOBAL_UNIT_ASSIGNED_CONTEXT((#{length},#{angle},#{solid}))REPRESENTATION_CONTEXT('','3D'))"
        )
        self.parameter_space = self.add(
            "(GEOMETRIC_REPRESENTATION_CONTEXT(2)"
            "PARAMETRIC_REPRESENTATION_CONTEXT()REPRESENTATION_CONTEXT('','2D'))"
        )
        self.up = self.add("DIRECTION('',(0.,0.,1.))")
        self.across = self.add("DIRECTION('',(1.,0.,0.))")
        self.origin = self.placement(np.zeros(3))

    def add(self, entity: str) -> int:
        """Write an entity; return its number."""
        number = self.reserve()
        self.put(number, entity)
        return number

    def reserve(self, count: int = 1) -> int:
        """Reserve numbers for entities that are written later; return the first."""
        self._next += count
        return self._next - count

    def put(self, number: int, entity: str) -> None:
        """Write an entity under a reserved number."""
        self.raw(f"#{number}={entity};\n")

    def raw(self, text: str, last: bool = False) -> None:
        """Write text through a buffer; a megabyte of it, or the last, is passed to the stream."""
        self._lines.append(text)
        self._pending += len(text)
        if last or self._pending > _FLUSH:
            self._stream.write("".join(self._lines))
            self._lines.clear()
            self._pending = 0

    def close(self) -> None:
        """Write the end of the file."""
        self.raw("ENDSEC;\nEND-ISO-10303-21;\n", last=True)

    def coordinate(self, value: float) -> str:
        """Write a length, rounded to 1e-12 of the pitch or finer."""
        text = f"{value:.{self.decimals}f}".rstrip("0")
        return "0." if text == "-0." else text

    def coordinates(self, point: Sequence[float] | Floats) -> str:
        """Write (x, y, z)."""
        return f"({','.join([self.coordinate(value) for value in point])})"

    def placement(self, point: Floats, across: tuple[float, float] = (1.0, 0.0)) -> int:
        """A placement at a point, its x axis along `across` (2,), unit."""
        at = self.add(f"CARTESIAN_POINT('',{self.coordinates(point.tolist())})")
        x = self.across
        if across != (1.0, 0.0):
            x = self.add(f"DIRECTION('',({real(across[0])},{real(across[1])},0.))")
        return self.add(f"AXIS2_PLACEMENT_3D('',#{at},#{self.up},#{x})")

    # -- products ---------------------------------------------------------------------------------

    def product(self, name: str, items: Sequence[int], kind: str) -> tuple[int, int]:
        """A part with a shape representation of the given kind; (product definition, representation)."""
        product = self.add(f"PRODUCT({quoted(name)},{quoted(name)},'',(#{self._product_context}))")
        self.add(f"PRODUCT_RELATED_PRODUCT_CATEGORY('part',$,(#{product}))")
        formation = self.add(f"PRODUCT_DEFINITION_FORMATION('','',#{product})")
        definition = self.add(f"PRODUCT_DEFINITION('design','',#{formation},#{self._definition_context})")
        shape = self.add(f"PRODUCT_DEFINITION_SHAPE('','',#{definition})")
        listed = ",".join(f"#{item}" for item in items)
        representation = self.add(f"{kind}({quoted(name)},({listed}),#{self.space})")
        self.add(f"SHAPE_DEFINITION_REPRESENTATION(#{shape},#{representation})")
        return definition, representation

    def component(self, parent: tuple[int, int], child: tuple[int, int], name: str, placement: int) -> None:
        """Put an instance of `child` into the assembly `parent` at a placement of its representation."""
        use = self.add(
            f"NEXT_ASSEMBLY_USAGE_OCCURRENCE({quoted(name)},{quoted(name)},'',#{parent[0]},#{child[0]},$)"
        )
        shape = self.add(f"PRODUCT_DEFINITION_SHAPE('','',#{use})")
        move = self.add(f"ITEM_DEFINED_TRANSFORMATION('','',#{self.origin},#{placement})")
        relation = self.add(
            f"(REPRESENTATION_RELATIONSHIP('','',#{child[1]},#{parent[1]})"
            f"REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION(#{move})SHAPE_REPRESENTATION_RELATIONSHIP())"
        )
        self.add(f"CONTEXT_DEPENDENT_SHAPE_REPRESENTATION(#{relation},#{shape})")

    # -- colours ----------------------------------------------------------------------------------

    def style(self, colour: StepColour) -> int:
        """The presentation style of a colour."""
        if colour not in self._styles:
            rgb = self.add(f"COLOUR_RGB('',{real(colour.red)},{real(colour.green)},{real(colour.blue)})")
            fill = self.add(f"FILL_AREA_STYLE_COLOUR('',#{rgb})")
            area = self.add(f"FILL_AREA_STYLE('',(#{fill}))")
            surface = self.add(f"SURFACE_STYLE_FILL_AREA(#{area})")
            side = self.add(f"SURFACE_SIDE_STYLE('',(#{surface}))")
            usage = self.add(f"SURFACE_STYLE_USAGE(.BOTH.,#{side})")
            self._styles[colour] = self.add(f"PRESENTATION_STYLE_ASSIGNMENT((#{usage}))")
        return self._styles[colour]

    def styled(self, item: int, colour: StepColour, over: int | None = None) -> int:
        """StepColour an item; `over`: the styled item whose colour this one overrides."""
        style = self.style(colour)
        if over is None:
            return self.add(f"STYLED_ITEM('',(#{style}),#{item})")
        return self.add(f"OVER_RIDING_STYLED_ITEM('',(#{style}),#{item},#{over})")

    def presentation(self, items: Sequence[int]) -> None:
        """List all styled items."""
        if items:
            listed = ",".join(f"#{item}" for item in items)
            self.add(f"MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION('',({listed}),#{self.space})")
