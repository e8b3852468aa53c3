"""Maps of a part's deviation: folded into one cell, which shows the process, and cell by cell, which shows
damage.

Only corners of facets are compared: they were measured or written, while a mesh has no data between them.
Deviations are along the normals of the exact faces and averaged over bins. The noise averages out and is
reported separately.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import nan, sqrt
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.drawn_figure import drawn, no_formula
from clacad.base.text import plain, printable
from clacad.base.types import Floats, Ints
from clacad.base.units import millimetres
from clacad.base.vectors import doubled_normals
from clacad.judging.cell_triangles import levels
from clacad.judging.damage import MICRON, Dent
from clacad.judging.face_deviation import STEEP, believed, distance_to_faces, drawn_in
from clacad.sheet.feasibility import body_range
from clacad.sheet.window import Window
from clacad.storage.atomic import Stage, canonical_json, safe_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


BINS = 16
"""Bins along each side of the folded cell."""

OUTLIER = 3.0
"""A cell is damaged if its deviation exceeds this multiple of the median plus the limit."""

FEWEST = 4
"""Number of corners below which a bin is not used."""

GROSS = 0.25
"""Part of a body's height beyond which a point is not on the face that it faces."""

MOST = 2_000_000
"""Most facets that are examined; larger files are sampled evenly."""


@dataclass(frozen=True, eq=False)
class FaceMap:
    """Deviations of one lens face.

    name : Such as "array1 front".
    folded, count : (bins, bins)
        Mean deviation (length, weighted by area) over the bounding box of a cell, all cells on top of each
        other, x first, NaN in empty bins; and the effective number of equally weighted corners.
    noise : length. Rms of single corners about their bin's mean.
    cells : (n1, n2). Rms deviation of each cell; NaN where it has no corners.
    peaks : (n1, n2). Largest absolute deviation of a single corner of each cell; NaN likewise.
    number : Number of the face in the order of the light.
    """

    name: str
    folded: Floats
    count: Ints
    noise: float
    cells: Floats
    peaks: Floats
    number: int

    def damaged(self, limit: float) -> list[tuple[int, int]]:
        """Cells (counted from the first) that deviate more than the others, by their rms or by a single
        corner.

        limit : length. Allowed deviation of a sound face of this file.
        """
        with np.errstate(invalid="ignore"):
            bad = np.any([found > most for found, most in self._against(limit)] or [self.cells < 0.0], axis=0)
        return [(int(i), int(j)) for i, j in np.argwhere(bad)]

    def worst_cell(self, limit: float) -> tuple[float, float]:
        """Deviation of the most conspicuous cell, and its allowed deviation (lengths); NaN where too few are
        known.

        limit : length. As in `damaged`.
        """
        pairs = [(float(np.nanmax(found)), most) for found, most in self._against(limit)]
        return max(
            pairs, key=lambda pair: pair[0] / pair[1] if pair[1] > 0.0 else pair[0], default=(nan, nan)
        )

    def _against(self, limit: float) -> list[tuple[Floats, float]]:
        """Rms and peaks of the cells (n1, n2), each with a cell's limit; empty for fewer than four cells."""
        known = np.isfinite(self.cells)
        if known.sum() < 4:
            return []
        return [
            (found, OUTLIER * float(np.median(found[known])) + allowed)
            for found, allowed in ((self.cells, limit), (self.peaks, 3.0 * limit))
        ]

    @property
    def systematic(self) -> float:
        """Largest mean deviation of a well-filled bin, minus the noise that remains in it (length)."""
        filled = self.count >= FEWEST
        if not filled.any():
            return float("nan")
        left = np.abs(self.folded[filled]) - 3.0 * self.noise / np.sqrt(self.count[filled])
        return float(max(0.0, left.max()))

    @property
    def rms(self) -> float:
        """Rms of the bins' means, weighted by their corners (length)."""
        filled = self.count >= FEWEST
        if not filled.any():
            return float("nan")
        return sqrt(float(np.average(self.folded[filled] ** 2, weights=self.count[filled])))


@dataclass(frozen=True, eq=False)
class DeviationMap:
    """Deviations of all lens faces of a part.

    unit : Name of the design's unit.
    low, high : (2,) lengths. Bounding box of a cell.
    first : (2,) ints. First cell of the maps of cells.
    unit_m : One design unit in metres.
    dents : Dents in damaged cells, the deepest first.
    steps : (2,) lengths. Distance from cell to cell across, and from row to row.
    """

    unit: str
    low: Floats
    high: Floats
    faces: tuple[FaceMap, ...]
    first: Ints
    unit_m: float
    dents: tuple[Dent, ...] = ()
    steps: tuple[float, float] = (nan, nan)

    def damaged(self, limit: float) -> list[tuple[int, tuple[int, int]]]:
        """Number of the face and cell (as in the window) of every damaged face of a cell."""
        return [
            (face.number, (i + int(self.first[0]), j + int(self.first[1])))
            for face in self.faces
            for i, j in face.damaged(limit)
        ]

    def worst_cell(self, limit: float) -> tuple[float, float]:
        """`FaceMap.worst_cell` of the face farthest beyond its limit."""
        pairs = [face.worst_cell(limit) for face in self.faces]
        known = [pair for pair in pairs if pair[0] == pair[0]]
        return max(
            known, key=lambda pair: pair[0] / pair[1] if pair[1] > 0.0 else pair[0], default=(nan, nan)
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready content: numbers with seven digits, null in empty bins."""
        return {
            "unit": self.unit,
            "unit_mm": millimetres(self.unit_m),
            "low": self.low.tolist(),
            "high": self.high.tolist(),
            "faces": [
                {
                    "name": f.name,
                    "noise": f.noise,
                    "rms": f.rms,
                    "systematic": f.systematic,
                    "folded": _grid(f.folded),
                    "count": f.count.tolist(),
                    "cells": _grid(f.cells),
                }
                for f in self.faces
            ],
            "first_cell": self.first.tolist(),
            "dents": [dent.to_dict(self.unit_m) for dent in self.dents],
        }


def _grid(values: Floats) -> list[list[float | None]]:
    return [[float(f"{v:.7g}") if np.isfinite(v) else None for v in row] for row in values]


class Mapper:
    """Accumulates the deviations of the chunks of a part."""

    def __init__(
        self, window: Window, unit: str, present: Sequence[str], facets: int, noise: float = 0.0
    ) -> None:
        self.window, self.unit, self.present, self._noise = window, unit, present, noise
        self._stride = max(1, facets // MOST)
        self._between = levels(window)
        self._gross = GROSS * min(high - low for low, high in (body_range(window, b) for b in window.bodies))
        tile = window.lattice.tile()
        self._low, self._high = tile.min(axis=0), tile.max(axis=0)
        faces = 2 * len(window.bodies)
        self._sums = np.zeros((4, faces, BINS * BINS))
        cells = window.lattice.cells()
        self._first = cells.min(axis=0)
        self._shape = tuple(int(n) for n in np.ptp(cells, axis=0) + 1)
        self._cells = np.zeros((2, faces, self._shape[0] * self._shape[1]))
        self._peaks = np.zeros(faces * self._shape[0] * self._shape[1])

    def look(self, corners: Floats) -> None:
        """Add a chunk (k, 3, 3), sheet frame, design units."""
        corners = corners[:: self._stride]
        normal = doubled_normals(corners)
        length = np.linalg.norm(normal, axis=1)
        good = np.abs(normal[:, 2]) > STEEP * length
        facing = np.repeat(normal[good] / length[good, None], 3, axis=0)
        # a corner on a cell border belongs to two lenses: a small displacement to the facet's middle decides
        points = corners[good].reshape(-1, 3)
        inward = (corners[good].mean(axis=1, keepdims=True) - corners[good]).reshape(-1, 3)
        aside = drawn_in(self.window, inward, self._noise)
        off = distance_to_faces(self.window, points, facing, self.present, self._between, aside)
        # a scan's facets on a step may face either way: points nearer the other side are no deviation of
        # this one
        with np.errstate(invalid="ignore"):
            sound = np.abs(off.distance) < self._gross
        rows = np.flatnonzero(sound & self.window.lattice.contains(off.cell))
        up = np.where(facing[rows, 2] > 0.0, 1.0, -1.0)  # positive: too much material
        value = off.distance[rows] * up
        part = (off.local[rows] - self._low) / (self._high - self._low)
        place = np.clip((part * BINS).astype(np.int64), 0, BINS - 1)
        at = off.face[rows] * (BINS * BINS) + place[:, 0] * BINS + place[:, 1]
        # weighted by area: slivers along walls have many corners and little area
        area = np.repeat(0.5 * np.abs(normal[good, 2]), 3)[rows]
        for k, weights in enumerate((area, area * value, area * value**2, area**2)):
            self._sums[k] += np.bincount(at, weights, self._sums[k].size).reshape(self._sums[k].shape)
        cell = off.cell[rows] - self._first
        where = (off.face[rows] * self._shape[0] + cell[:, 0]) * self._shape[1] + cell[:, 1]
        for k, weights in enumerate((area, area * value**2)):
            self._cells[k] += np.bincount(where, weights, self._cells[k].size).reshape(self._cells[k].shape)
        told = np.repeat(believed(corners[good], self._noise), 3)[rows]
        np.maximum.at(self._peaks, where[told], np.abs(value[told]))

    def result(self) -> DeviationMap:
        """Maps of the lens faces that the part holds."""
        found = []
        for number, body in enumerate(self.window.bodies):
            for side, face in enumerate((body.front, body.back)):
                if face.array is not None and body.name in self.present:
                    found.append(self._face(2 * number + side, f"{body.name} {('front', 'back')[side]}"))
        lattice = self.window.lattice
        steps = lattice.a1[0], lattice.a2[1]
        return DeviationMap(
            self.unit, self._low, self._high, tuple(found), self._first, self.window.unit, steps=steps
        )

    def _face(self, number: int, name: str) -> FaceMap:
        """Map of one lens face from the accumulated sums."""
        area, total, square, own = self._sums[:, number]
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = total / area
            spread = np.maximum(square / area - mean**2, 0.0)
            count = np.nan_to_num(np.floor(area**2 / own))
            cells = np.sqrt(self._cells[1, number] / self._cells[0, number])
        filled = count >= FEWEST
        noise = (
            sqrt(float(np.average(spread[filled], weights=count[filled]))) if filled.any() else float("nan")
        )
        return FaceMap(
            name,
            mean.reshape(BINS, BINS),
            count.astype(np.int64).reshape(BINS, BINS),
            noise,
            cells.reshape(self._shape),
            np.where(np.isfinite(cells), self._peaks.reshape(len(self._sums[0]), -1)[number], np.nan).reshape(
                self._shape
            ),
            number,
        )


def deviation_map(
    window: Window, unit: str, chunks: Iterable[Floats], present: Sequence[str], facets: int
) -> DeviationMap:
    """Map a part given as chunks of corners (k, 3, 3) in the sheet frame, design units."""
    mapper = Mapper(window, unit, present, facets)
    for chunk in chunks:
        mapper.look(chunk)
    return mapper.result()


def plot_deviation(found: DeviationMap, title: str) -> bytes:
    """Draw both maps of every lens face as PNG; the same numbers give the same bytes."""
    style = {"font.size": 8.0}
    return drawn("png", (3.6 * len(found.faces), 6.8), lambda figure: _draw(figure, found, title), style)


def _draw(figure: Figure, found: DeviationMap, title: str) -> None:
    figure.suptitle(_title(title, len(found.faces)), fontsize=9)
    axes = figure.subplots(2, len(found.faces), squeeze=False)
    for column, face in enumerate(found.faces):
        _draw_cell(figure, axes[0, column], found, face)
        _draw_sheet(figure, axes[1, column], found, face)


TITLE_CHARACTERS = 44
"""Characters of the title on the width of one face."""


def _title(name: str, faces: int) -> str:
    """Quantity, unit and sign of a plot, in lines that fit on the width of all faces."""
    words = (
        f"{printable(name)}: deviation of the part from the design",
        "along the surface normal, in µm; positive: too much material, negative: too little",
    )
    return no_formula("\n".join(line for text in words for line in wrap(text, TITLE_CHARACTERS * faces)))


def _draw_cell(figure: Figure, axes: Axes, found: DeviationMap, face: FaceMap) -> None:
    """Draw the map of all cells folded into one."""
    microns, mm = found.unit_m / MICRON, millimetres(found.unit_m)
    folded = face.folded * microns
    most = float(np.nanmax(np.abs(folded))) if np.isfinite(folded).any() else 1.0
    x0, y0, x1, y1 = *(found.low * mm), *(found.high * mm)
    image = axes.imshow(
        folded.T, origin="lower", cmap="RdBu_r", vmin=-most, vmax=most, extent=(x0, x1, y0, y1)
    )
    axes.set_title(f"{face.name}: mean over all cells,\nnoise {face.noise * microns:.2g} µm", fontsize=8)
    axes.set(xlabel="x in the cell / mm", ylabel="y in the cell / mm")
    figure.colorbar(image, ax=axes, label="mean deviation / µm")


def _draw_sheet(figure: Figure, axes: Axes, found: DeviationMap, face: FaceMap) -> None:
    """Draw the map cell by cell, dents framed."""
    microns = found.unit_m / MICRON
    i0, j0 = (int(v) for v in found.first)
    n1, n2 = face.cells.shape
    image = axes.imshow(
        (face.cells * microns).T,
        origin="lower",
        cmap="viridis",
        aspect="equal",
        vmin=0.0,
        extent=(i0 - 0.5, i0 + n1 - 0.5, j0 - 0.5, j0 + n2 - 0.5),
    )
    mine = [dent for dent in found.dents if dent.face == face.name]
    (
        axes.scatter(
            *zip(*(d.cell for d in mine), strict=True), marker="s", facecolors="none", edgecolors="red"
        )
        if mine
        else None
    )
    worst = f"\n{mine[0].words(found.unit_m).split(' is ', 1)[1]}" if mine else ""
    axes.set_title(f"rms of each cell{worst}", fontsize=8)
    across, along = (step * millimetres(found.unit_m) for step in found.steps)
    axes.set(xlabel=f"cell i (every {across:.4g} mm)", ylabel=f"cell j (rows every {along:.4g} mm)")
    figure.colorbar(image, ax=axes, label="rms deviation / µm")


def write_deviation(
    found: DeviationMap, name: str, folder: str | os.PathLike[str], *, overwrite: bool = False
) -> list[Path]:
    """Write deviation-NAME.json and .png of a file called `name`. Raises CannotWrite, ExportRefused."""
    stem = f"deviation-{safe_name(Path(name).stem)}"
    contents = {
        f"{stem}.json": (
            canonical_json({"kind": "deviation", "file": name, **plain(found.to_dict())}).encode()
        ),
        f"{stem}.png": plot_deviation(found, name),
    }
    with Stage(folder, overwrite=overwrite or _ours(Path(folder) / f"{stem}.json")) as stage:
        for target, content in contents.items():
            stage.path(target).write_bytes(content)
        stage.publish()
    return [Path(folder) / target for target in contents]


def _ours(path: Path) -> bool:
    """Whether a file was written by an earlier run of `write_deviation`."""
    try:
        with path.open(encoding="utf-8") as stream:
            return '"kind": "deviation"' in stream.read()
    except (OSError, UnicodeDecodeError):
        return False
