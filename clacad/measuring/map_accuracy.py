"""What a measurement by height maps costs and gives: error of law_rms against pixel and noise.

Maps are made of the exact faces of a design, with noise, lost points, a tilt or a wrong scale of heights. The
truth is light through the exact faces of the same cells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin
from time import process_time
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.interactive import shown_progress
from clacad.base.text import mrad_text
from clacad.base.types import Floats, Progress
from clacad.light.measure import measure as measure_light
from clacad.measuring.light_through_form import RAYS
from clacad.measuring.measure import measure
from clacad.measuring.read_map import MeasuredMap
from clacad.measuring.sides import Side, sides_of
from clacad.optics.rays import TraceResult
from clacad.prescription.prescribe import prescribe
from clacad.sheet.bundle import Bundle, RequestedLaw, bundle
from clacad.sheet.like_cell import like_cell
from clacad.sheet.representative_cells import central_cell
from clacad.tracing.trace import trace

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.window import Window

WIDTH = 3.5
"""Width of the maps in cells: nine whole lenslets."""

KNOWN = 1e-4
"""Half width of the uncertainty of the scale of heights, where it is stated."""


@dataclass(frozen=True, kw_only=True)
class Condition:
    """How a map is made.

    across : Pixels across a cell.
    noise : metres, rms of a point.
    lost : Share of the points that are lost.
    tilt : radians
    z_scale : Scale of heights of the file.
    stated : Whether that scale is stated to the measurement.
    """

    name: str = ""
    across: float = 60.0
    noise: float = 20e-9
    lost: float = 0.0
    tilt: float = 0.0
    z_scale: float = 1.0
    stated: bool = True


CONDITIONS = (
    *(Condition(across=n, noise=1e-9 * noise) for n in (125.0, 60.0, 30.0) for noise in (5.0, 20.0, 80.0)),
    Condition(name="12 pixels across a lenslet", across=12.3, noise=5e-9),
    Condition(name="30 % of the points lost", lost=0.3),
    Condition(name="a tilt of 0.2 rad, near the limit", tilt=0.2),
    Condition(name="scale 1 % off, not stated: R/s is one number", z_scale=1.01, stated=False),
)


@dataclass(frozen=True)
class MapRow:
    """A condition and what was found.

    error, half : radians. Error of law_rms, half its stated range. seconds : of the processor.
    """

    condition: Condition
    pixel: float
    error: float
    half: float
    seconds: float
    verdict: str

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready content, lengths in metres."""
        of = self.condition
        return {
            "name": of.name,
            "pixels_across": of.across,
            "pixel": self.pixel,
            "noise": of.noise,
            "lost": of.lost,
            "tilt": of.tilt,
            "z_scale": of.z_scale,
            "error": self.error,
            "half": self.half,
            "seconds": self.seconds,
            "verdict": self.verdict,
        }


def map_accuracy(
    design: Design, conditions: Sequence[Condition] = CONDITIONS, progress: Progress | None = None
) -> list[MapRow]:
    """Measure maps of a perfect front under each condition.

    Raises NotPossible: The front has no lenslets that a map can show.
    """
    report = shown_progress(progress)
    window = prescribe(design)
    side = sides_of(window, 1e-3 / design.unit_m)["front"]
    middle = central_cell(window)
    rows = []
    for number, one in enumerate(conditions):
        report(one.name or f"{one.across:g} pixels, {1e9 * one.noise:g} nm", number / len(conditions))
        made = map_of(side, design.unit_m, one, middle)
        before = process_time()
        scale = (one.z_scale, KNOWN) if one.stated else None
        found = measure(design, (made, middle), z_scale=scale)
        seconds = process_time() - before
        light = found.light
        true = _true(window, design, light.cells)
        half = 0.5 * (light.high - light.low)
        rows.append(MapRow(one, made.pixel[0], light.rms - true, half, seconds, found.verdict))
    report("done", 1.0)
    return rows


def map_of(side: Side, unit_m: float, of: Condition, middle: tuple[int, int]) -> MeasuredMap:
    """Map of a perfect side about a cell of the sheet, as an instrument gives it."""
    random = np.random.default_rng(0)
    lattice = side.lattice
    pixel = min(lattice.pitch[0], lattice.row_height) / of.across
    count = int(WIDTH * max(lattice.pitch[0], lattice.row_height) / pixel)
    line = (np.arange(count) - 0.5 * count) * pixel
    x, y = (one.ravel() for one in np.meshgrid(line, line))
    steps = np.column_stack([lattice.a1, lattice.a2])
    near = np.stack(np.meshgrid(*(np.arange(-3, 4),) * 2), axis=-1).reshape(-1, 2)
    centres = near @ steps.T
    nearest = np.argmin((x[:, None] - centres[:, 0]) ** 2 + (y[:, None] - centres[:, 1]) ** 2, axis=1)
    z = np.empty(len(x))
    cells = side.cell(near) + np.array(middle)
    for k in np.unique(nearest):
        mine = nearest == k
        cell = cells[k] if side.window.lattice.contains(cells[k]) else np.array(middle)
        z[mine] = side.heights(cell, x[mine] - centres[k, 0], y[mine] - centres[k, 1])
    points = _tilted(np.stack([x, y, z]), of.tilt)
    points[2] = of.z_scale * (points[2] + random.normal(0.0, of.noise / unit_m, len(x)))
    kept = (random.random(len(x)) >= of.lost) & np.isfinite(points[2])
    size = (pixel * unit_m, pixel * unit_m)
    return MeasuredMap("map", points[:, kept] * unit_m, size, (count, count), regular=not of.tilt)


def _tilted(points: Floats, angle: float) -> Floats:
    c, s = cos(angle), sin(angle)
    return np.stack([points[0], c * points[1] - s * points[2], s * points[1] + c * points[2]])


def _true(window: Window, design: Design, cells: Sequence[tuple[int, int]]) -> float:
    """Rms error (radians) of light through the exact faces of cells."""
    squares = []
    for cell in cells if not window.uniform else cells[:1]:
        like = like_cell(window, np.array(cell))

        def send(lit: Bundle, sheet: Window = like) -> TraceResult:
            return trace(sheet, lit.rays, path="size")

        lit = bundle(like, RAYS, design.check.field, design.check.field_centre, cell=central_cell(like))
        squares.append(measure_light(send, lit, RequestedLaw.of(like)).rms ** 2)
    return float(np.sqrt(np.mean(squares)))


def as_lines(rows: Sequence[MapRow]) -> list[list[str]]:
    """Rows of a table, names of the columns first; errors in mrad."""
    head = ["pixels across a cell", "pixel / µm", "noise / nm", "", "error of law rms", "stated half range"]
    lines = [[*head, "seconds", "verdict"]]
    for row in rows:
        of = row.condition
        errors = [mrad_text(one, 2, unit="") for one in (row.error, row.half)]
        size = [f"{of.across:g}", f"{1e6 * row.pixel:.3g}", f"{1e9 * of.noise:g}"]
        lines.append([*size, of.name, *errors, f"{row.seconds:.2g}", row.verdict])
    return lines
