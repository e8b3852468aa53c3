"""Forecast of the light through a file's facets, which decides whether a mesh is a master or a preview.

The rays of the checks go through one telescopelet of the tessellation that will be written. The error of
facets falls with their size: k/m at m quads per cell side, in quadrature with the error of the exact
surfaces. A few coarse grids therefore show where to search; the chosen grid is traced itself. No other
module of `exporting` traces.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import astuple, dataclass
from functools import cached_property
from math import hypot, inf, isfinite, isnan, nan, sqrt
from typing import TYPE_CHECKING

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.base.vectors import doubled_normals
from clacad.exporting.tessellations import Meshes, instanceable
from clacad.light.compare import Comparison, change_with_shift
from clacad.light.measure import FEWEST, Light, Send, measure, measure_each
from clacad.optics.law import difference_of_laws
from clacad.sheet.bundle import RequestedLaw, bundle, field_points
from clacad.sheet.window import WALL, Window

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.mesh import Mesh
    from clacad.optics.rays import TraceResult
    from clacad.sheet.bundle import Bundle
    from clacad.tracing.facets.telescopelet import FacetBody


POWERS = (4, 8, 16, 32, 64, 128, 256, 512, 1024)
"""Facet grids per cell side from which "auto" chooses."""

RAYS = 16384
POINT_RAYS = 1024
"""Number of rays over the field, and from each of its nine points."""

SAFE = 0.95
"""Target as a share of a limit: other cells and more rays give errors a few per cent larger."""

PROBE, FINE = 16, 64
"""Grids from which the errors of other grids are computed."""

NEAR = 1.25
"""A grid whose formula error is at most this multiple of the target is traced before it is rejected."""

CLOSE = 0.04
"""Relative error of the formula; closer to the limit than that, the grid must be traced."""


KEYS = ("law_rms", "law_bias", "eta", "delta", "confocality")
"""Keys of a design file for the fields of `LightLimits`, in their order."""


@dataclass(frozen=True, slots=True)
class LightLimits:
    """Limits of the light through a file.

    rms, bias : radians
        Direction error to the law over the field, and of the mean direction at a point of it.
    stretch : Relative error of the ratio of slopes before and behind the sheet.
    offset : slope. Error of the slope that leaves along the axis of the lenses.
    defocus : Shift of array 2 along the sheet's normal that compensates the facets, over the distance of the
        lenses.
    """

    rms: float
    bias: float = inf
    stretch: float = inf
    offset: float = inf
    defocus: float = inf

    @staticmethod
    def of(design: Design) -> LightLimits:
        """Limits of a design."""
        return LightLimits(*design.check.of_light)


@dataclass(frozen=True, slots=True)
class Grade(LightLimits):
    """Forecast of the light through facets; NaN where too few rays get through.

    Stretch, offset and defocus are differences to the exact surfaces over the same rays.

    quads : Facet grid a cell side; 0: the exact surfaces.
    """

    quads: int = 0

    def within(self, limits: LightLimits, part: float = 1.0) -> bool:
        """Whether every number is known and is at most `part` times its limit."""
        return not self.beyond(limits, part)

    def beyond(self, limits: LightLimits, part: float = 1.0) -> tuple[str, ...]:
        """Exceeded limits, by their keys in a design file."""
        pairs = zip(KEYS, astuple(self), astuple(limits), strict=False)
        return tuple(key for key, value, limit in pairs if not value <= part * limit)


class Grader:
    """Grades of the tessellations of one window, each traced once.

    meshes : Source of the tessellations; meshes made here are kept for writing.
    field : radians. Half angle of the cone of test rays.
    centre : "axis" or "normal". Centre of the cone.
    """

    def __init__(self, meshes: Meshes, limits: LightLimits, field: float, centre: str = "axis") -> None:
        self.meshes, self.limits = meshes, limits
        self._light = _Light(meshes.window, field, centre)
        self._grades: dict[int, Grade] = {}

    @staticmethod
    def of(meshes: Meshes, design: Design) -> Grader:
        """Grader with the limits and the field of a design's checks."""
        return Grader(meshes, LightLimits.of(design), design.check.field, design.check.field_centre)

    def grade(self, quads: int) -> Grade:
        """Trace the tessellation of `quads` quads per cell side."""
        if quads not in self._grades:
            self._grades[quads] = self._light.grade(quads, self._bodies(quads))
        return self._grades[quads]

    def _bodies(self, quads: int) -> tuple[FacetBody, ...]:
        window, made = self.meshes.window, self.meshes.at(quads)
        if not window.uniform:
            return telescopelet(self._light.window, self._like.at(quads).mesh, made.saddle_bevel, apart=False)
        if instanceable(window):
            return telescopelet(window, made.cell, made.saddle_bevel)
        return telescopelet(window, made.single, made.saddle_bevel, apart=False)

    @cached_property
    def _like(self) -> Meshes:
        """Meshes of the cell by which a non-uniform sheet is judged."""
        return Meshes(self._light.window)

    def law_rms(self, quads: int) -> float:
        """Rms direction error (radians) by the formula of the coarse grids, without tracing this grid."""
        if quads in self._grades:
            return self._grades[quads].rms
        slope, rounding = self._constants
        return hypot(self._light.exact, slope / quads, rounding * quads)

    @cached_property
    def _constants(self) -> tuple[float, float]:
        """Error of facets times quads a cell side, error of height steps over quads a cell side (radians)."""
        coarse, fine = (self._excess(quads) for quads in (PROBE, FINE))
        if FINE * fine <= PROBE * coarse:
            return FINE * fine, 0.0
        # (a/16)² + (16 b)² and (a/64)² + (64 b)²: height steps tilt fine facets more than coarse ones
        ratio = (FINE / PROBE) ** 2
        square = max(0.0, ratio * fine**2 - coarse**2) / (ratio - 1.0 / ratio)
        rounding = sqrt(square) / FINE if square > 0.0 else 0.0
        return PROBE * sqrt(max(0.0, coarse**2 - (PROBE * rounding) ** 2)), rounding

    def _excess(self, quads: int) -> float:
        rms = self.grade(quads).rms
        return sqrt(max(0.0, rms**2 - self._light.exact**2)) if isfinite(rms) else nan

    def least(self, most: int = POWERS[-1]) -> int | None:
        """Smallest power of two, 4 … `most`, whose traced grade is within SAFE times the limits, or None."""
        for quads in POWERS:
            if quads > most:
                break
            if self._worth_tracing(quads) and self.grade(quads).within(self.limits, SAFE):
                return quads
        return None

    def foreseen(self) -> int | None:
        """Result of `least` with as little fine meshing as possible.

        Grids above 64 are traced only where the formula does not decide.
        """
        aim = SAFE * self.limits.rms
        for quads in POWERS:
            if not self._worth_tracing(quads):
                continue
            far = quads > FINE and quads not in self._grades and abs(self.law_rms(quads) / aim - 1.0) > CLOSE
            if (
                self.law_rms(quads) <= aim
                if far or quads > 2 * FINE
                else self.grade(quads).within(self.limits, SAFE)
            ):
                return quads
        return None

    def _worth_tracing(self, quads: int) -> bool:
        """Whether a grid may be within the limits; False if the exact surfaces are not."""
        if not (self._light.exact <= self.limits.rms and self._light.exact_bias <= self.limits.bias):
            return False
        return self.law_rms(quads) <= NEAR * SAFE * self.limits.rms

    @property
    def exact(self) -> float:
        """Rms direction error of the exact surfaces (radians)."""
        return self._light.exact

    @property
    def cell(self) -> str:
        """The cell by which a non-uniform sheet is judged, in words."""
        return self._light.cell


def _exactly(window: Window) -> Send:
    """Sender through the exact surfaces; compiled kernels would take longer to load."""
    from clacad.tracing.trace import trace

    return lambda lit: trace(window, lit.rays, path="numpy")


class _Light:
    """Bundles of the checks over the cell by which a sheet is judged, and their light by exact surfaces.

    cell : That cell in words, with the spread over the others; "" for a uniform sheet.
    """

    def __init__(self, window: Window, field: float, centre: str) -> None:
        from clacad.tracing.worst_cell import worst_cell

        seen = worst_cell(window, field)
        self.window, self.cell = seen.like.with_cells((1, 1)), seen.words
        self._field, self._centre, self._law = field, centre, RequestedLaw.of(self.window)

    @cached_property
    def _truth(self) -> Light:
        lit = bundle(self.window, RAYS, self._field, self._centre)
        return measure(_exactly(self.window), lit, self._law)

    @cached_property
    def _points(self) -> list[Bundle]:
        directions = field_points(self.window, self._field, self._centre)
        return [bundle(self.window, POINT_RAYS, 0.0, middle=direction) for direction in directions]

    @property
    def exact(self) -> float:
        """Rms direction error (radians) of the exact surfaces."""
        return self._truth.rms

    @cached_property
    def exact_bias(self) -> float:
        """Worst angle (radians) of the mean direction to the law at a point of the field, exact surfaces."""
        return self._bias(_exactly(self.window))

    def grade(self, quads: int, bodies: tuple[FacetBody, ...]) -> Grade:
        """Trace the rays through facets."""
        from clacad.tracing.facets.telescopelet import trace_facets

        def send(lit: Bundle) -> TraceResult:
            return trace_facets(bodies, lit.rays)

        light = measure(send, self._truth.lit, self._law)
        found = Comparison(light, self._truth)
        stretch, offset = (nan, nan) if found.laws is None else difference_of_laws(*found.laws)
        return Grade(light.rms, self._bias(send), stretch, offset, self._defocus(found), quads)

    def _bias(self, send: Send) -> float:
        """Worst angle of the mean direction to the law over the points of the field that are not dark."""
        found = [light.bias for light in measure_each(send, self._points, self._law)]
        return max((error for error in found if not isnan(error)), default=nan)

    @cached_property
    def _change(self) -> Floats:
        return change_with_shift(self.window, (0, 0), self._truth.lit.rays)

    def _defocus(self, found: Comparison) -> float:
        """Shift of array 2 that compensates the facets, over the distance between the lenses, worse axis."""
        if (found.both & np.isfinite(self._change[:, 0])).sum() < FEWEST:
            return nan
        return float(np.nanmax(np.abs(found.focus(self.window, self._change)), initial=0.0))


# -- facets of one telescopelet ------------------------------------------------------------------


def telescopelet(window: Window, mesh: Mesh, bevel: float = 0.0, apart: bool = True) -> tuple[FacetBody, ...]:
    """Facets of one telescopelet of a mesh of one cell, ready to be traced.

    window : Of any number of cells.
    mesh : Of a single cell.
    bevel : length. Width of the bevels at saddles, which are no optical faces.
    apart : bool
        Whether each body was meshed about the centre of its own array's cell; otherwise in sheet coordinates.
    """
    from clacad.tracing.facets.telescopelet import FacetBody, facet_face, on_land

    bodies = []
    for body, part in zip(window.bodies, mesh.bodies, strict=True):
        array = body.arrays[0]
        place = np.array([*(window.shifts[array] if apart else (0.0, 0.0)), 0.0])
        corners, back = _optical(mesh.window, part.rows(), bevel)
        faces = [
            facet_face(mine + place, place + [0.0, 0.0, body.front.vertex[2]], on_land(window, face, mine))
            for face, mine in ((body.front, corners[~back]), (body.back, corners[back]))
        ]
        bodies.append(FacetBody(faces[0], faces[1], body))
    return tuple(bodies)


def _optical(window: Window, rows: Iterator[Floats], bevel: float) -> tuple[Floats, Bools]:
    """Facets (t, 3, 3) that are neither walls nor bevels, and whether each belongs to the back (t,)."""
    from clacad.mesh.border_samples import in_corners

    corners = np.concatenate([np.asarray(block, dtype=np.float64) for block in rows])
    normal = doubled_normals(corners)
    keep = np.abs(normal[:, 2]) > WALL * np.linalg.norm(normal, axis=1)
    if bevel > 0.0:
        keep &= ~in_corners(window, corners.mean(axis=1), bevel)
    return corners[keep], normal[keep, 2] > 0.0
