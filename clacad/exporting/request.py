"""The options of an export, declared once: the command line, the API and the manifest read them here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Literal, TypedDict

from clacad.exporting.roles import Role
from clacad.storage.errors import BadRequest

if TYPE_CHECKING:
    from clacad.exporting.compensation import Compensation

Quads = int | Literal["auto"]
AskedQuads = Quads | Mapping[str, Quads] | None
"""Facets per cell side: one for every mesh format, or one per format; None: see `Request`."""

AskedRole = str | Mapping[str, str] | None
"""Declared role: one for every file that has optics, or one per format."""


# -- the declaration -----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Option:
    """Command-line form and allowed values of one export option.

    flag : As typed; of a switch that is on by default, with its opposite.
    help : "{formats}" is replaced by the words of all formats.
    metavar : Placeholder of the value in the help.
    words : Allowed words; empty: any text that the option's reader accepts.
    least, most : Range of a whole number.
    rare : Recorded in the manifest only if it differs from the default.
    """

    flag: str
    help: str
    metavar: str | None = None
    words: tuple[str, ...] = ()
    least: int | None = None
    most: int | None = None
    rare: bool = False


def _declared(default: Any, option: Option) -> Any:
    """Field of `Request` with its default and command-line form."""
    made = {"default_factory": dict} if default is dict else {"default": default}
    return field(**made, metadata={"option": option})


@dataclass(frozen=True, slots=True)
class Request:
    """Options of an export.

    formats : Words of `clacad.exporting.formats`; `clacad explain formats` lists them.
    slope_error : float or "auto"
        Wanted rms angle between facets and surface, radians; "auto" chooses the facets of each format by the
        light through them, as `quads` "auto" does. If no master stays within the limits, it writes a declared
        preview of at most 64 quads per cell side. Files declared previews are left out.
    quads : mapping; of `export` also int, "auto" or None. Facet grid per cell side of each mesh format, as in
        {"3mf": "auto", "stl": 4}; a single value applies to all. Overrides `slope_error`. "auto" is the
        smallest power of two from 4 to 1024 through which light is forecast to meet the design's limits
        (within 95 %), if such a file stays within the limits of facets and bytes; else the finest that does.
        For formats that repeat one cell (3MF, GLB), the limits apply to the stored cell.
    step : "auto", "fused" or "instanced". auto is fused up to 2,500 cells.
    cells : (a, b) or None. The same design with another count, centred.
    cell : (i, j) or None. Cell that formats of one cell describe, an index of the lattice that is written; a
        non-uniform sheet needs it.
    overwrite : Replace files that are in no manifest of clacad.
    force : Ignore the limits on facets, bytes and memory.
    step_schema : "ap242" or "ap214". Application protocol of STEP files.
    pcurves : Whether fused STEP files hold the exact parameter curves; without them they are smaller and
        readers recompute the curves.
    saddle_bevel : length. Meshes: width of the bevels that give columns which touch at a saddle real contact;
        0: none, the columns touch and the surface is exact. STEP is exact always.
    gpu_instancing : GLB: one node for all cells of a body (EXT_mesh_gpu_instancing) instead of one each.
    grey_levels : GDSII: number of layers from the lowest to the highest point of a face.
    role : mapping; of `export` also "master", "preview" or None
        Role of the files of each format, as in {"stl": "preview"}; a single value applies to all. An
        undeclared mesh is a master if the light through it is forecast within the design's limits, else a
        preview. That preview counts as declared if `quads` and `slope_error` were left out too. A preview
        declared here has 4 quads per cell side unless specified. Everything else with optics is a master.
    paper : "a4", "a3" or "a2". Sheets of the drawing.
    nose : length or None. Tool points: radius of the nose; None: that of the design's process.
    tool_step : length or None. Tool points: distance of points and of passes; None: 4 to 64 a cell.
    tool_order : "raster" or "spiral". Tool points: row by row, forth and back, or on a spiral from the rim.
    calibration : str or None
        Dose: CSV of levels and measured depths, from `clacad calibrate`; None: in proportion to depth.
    compensate : Files of every format hold the part before it shrinks and sinks, and are tooling.
    fused : One solid a connected piece in STEP (`step` is then "fused") and one mesh a body in 3MF and GLB,
        which otherwise repeat one cell of a uniform sheet without border.
    compensation : Of the process of the design; the export fills it in.
    as_made : Light through the sheet as its process makes it, for the manifest; None: not requested.
    """

    formats: tuple[str, ...] = _declared(
        ("step", "stl"), Option("--format", "Formats, separated by commas: {formats}.", "F,G")
    )
    slope_error: float | Literal["auto"] = _declared(
        "auto",
        Option(
            "--slope-error",
            "rms facet slope error, e.g. '5 mrad', or 'auto' (default): the coarsest facets that make a"
            " master; where none fit, the finest that do, up to 64 quads a cell side, a declared preview.",
            "E",
        ),
    )
    quads: Mapping[str, Quads] = _declared(
        dict,
        Option(
            "--quads",
            "Facet grid: N quads per cell side, or 'auto': the coarsest grid that makes a master; of all"
            " meshes or per format: 3mf=auto,stl=4.",
            "N|F=N,...",
        ),
    )
    step: Literal["auto", "fused", "instanced"] = _declared(
        "auto", Option("--step", "auto, fused or instanced.", words=("auto", "fused", "instanced"))
    )
    cells: tuple[int, int] | None = _declared(
        None, Option("--cells", "A x B cells of the design, centred; default all.", "AxB")
    )
    cell: tuple[int, int] | None = _declared(
        None,
        Option(
            "--cell",
            "Cell that formats of one cell describe; all of a uniform sheet are equal.",
            "I,J",
            rare=True,
        ),
    )
    overwrite: bool = _declared(False, Option("--overwrite", "Replace files of another origin."))
    force: bool = _declared(False, Option("--force", "Pass the limits on facets, bytes and memory."))
    step_schema: Literal["ap242", "ap214"] = _declared(
        "ap242", Option("--step-schema", "STEP: ap242 or ap214.", words=("ap242", "ap214"), rare=True)
    )
    pcurves: bool = _declared(
        True,
        Option(
            "--pcurves/--no-pcurves",
            "STEP: write exact parameter curves; without them files are smaller.",
            rare=True,
        ),
    )
    saddle_bevel: float = _declared(
        0.0,
        Option(
            "--saddle-bevel",
            "Meshes: fill the corners where cells only touch, W wide, e.g. '5 um'; default: they touch, the "
            "surface is exact.",
            "W",
            rare=True,
        ),
    )
    gpu_instancing: bool = _declared(
        False, Option("--gpu-instancing", "GLB: one node for all cells of a body.", rare=True)
    )
    grey_levels: int = _declared(
        64,
        Option("--grey-levels", "GDSII: layers from lowest to highest.", "N", least=2, most=256, rare=True),
    )
    role: Mapping[str, Role] = _declared(
        dict,
        Option(
            "--role",
            "What files are for: master or preview; of all or per format: stl=preview. Default: what the"
            " light through them allows.",
            "R|F=R,...",
        ),
    )
    paper: Literal["a4", "a3", "a2"] = _declared(
        "a3", Option("--paper", "Drawing: sheets of a4, a3 or a2.", words=("a4", "a3", "a2"), rare=True)
    )
    nose: float | None = _declared(
        None, Option("--nose", "Tool points: radius of the nose, e.g. '25 um'.", "R", rare=True)
    )
    tool_step: float | None = _declared(
        None,
        Option("--tool-step", "Tool points: distance of points and passes, e.g. '5 um'.", "L", rare=True),
    )
    tool_order: Literal["raster", "spiral"] = _declared(
        "raster",
        Option("--tool-order", "Tool points: raster or spiral.", words=("raster", "spiral"), rare=True),
    )
    calibration: str | None = _declared(
        None,
        Option("--calibration", "Dose: CSV of levels and depths, from clacad calibrate.", "FILE", rare=True),
    )
    compensate: bool = _declared(
        False,
        Option(
            "--compensate",
            "Scale and bend files so that the process makes the part of them (shrinkage, sink of [process]);"
            " formats for tools always do.",
            rare=True,
        ),
    )
    fused: bool = _declared(
        False,
        Option(
            "--fused",
            "One solid a connected piece in STEP, one mesh a body in 3MF and GLB, however large; default:"
            " STEP is fused up to 2,500 cells, 3MF and GLB repeat one cell where the sheet is uniform.",
            rare=True,
        ),
    )

    compensation: Compensation | None = None
    as_made: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        """Apply `fused` to the STEP mode. Raises BadRequest: Fused and instanced are requested together."""
        if self.fused and self.step == "instanced":
            raise BadRequest(
                "fused and step = instanced: STEP is either one or the other; leave one of them out"
            )
        if self.fused:
            object.__setattr__(self, "step", "fused")

    def to_dict(self) -> dict[str, Any]:
        """Options as the manifest records them; rare ones only if they differ from the default."""
        plain = {
            "formats": list(self.formats),
            "slope_error": self.slope_error,
            "quads": dict(self.quads) or None,
            "step": self.step,
            "cells": None if self.cells is None else list(self.cells),
        }
        rare = {name: getattr(self, name) for name, option in OPTIONS.items() if option.rare}
        rare["cell"] = None if self.cell is None else list(self.cell)
        asked = {name: value for name, value in rare.items() if value != getattr(DEFAULTS, name)}
        roles = {"role": {name: str(role) for name, role in self.role.items()}} if self.role else {}
        made = {} if self.as_made is None else {"as_made": dict(self.as_made)}
        return plain | asked | roles | made


class MoreOptions(TypedDict, total=False):
    """Fields of `Request` that `clacad.export` takes by keyword only and hands on unchanged."""

    cells: tuple[int, int] | None
    cell: tuple[int, int] | None
    overwrite: bool
    force: bool
    step_schema: Literal["ap242", "ap214"]
    pcurves: bool
    saddle_bevel: float
    gpu_instancing: bool
    grey_levels: int
    paper: Literal["a4", "a3", "a2"]
    nose: float | None
    tool_step: float | None
    tool_order: Literal["raster", "spiral"]
    calibration: str | None
    compensate: bool
    fused: bool


OPTIONS: Mapping[str, Option] = {one.name: one.metadata["option"] for one in fields(Request) if one.metadata}
"""Field of `Request` → its command-line form."""

DEFAULTS = Request()
"""Export request with all defaults."""


def assignments(text: str) -> list[tuple[str, str]] | None:
    """NAME=VALUE,NAME=VALUE as pairs in their order; None where a part lacks its name or its value."""
    parts = [tuple(word.strip() for word in part.partition("=")) for part in text.split(",")]
    return [(name, value) for name, _, value in parts] if all(map(all, parts)) else None
