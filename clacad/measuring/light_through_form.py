"""Light through the measured form of a sheet: the fitted lenslets in place of the design's, cell by cell.

Texture is not traced: rays would take its slopes for errors of direction, while a wave much longer than the
texture is high leaves it undisturbed but for a small share. The form of a lenslet goes on to the border of
its
cell; light that meets a seam, or a place without points, is counted apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import exp, nan, pi

import numpy as np

from clacad.base.types import Bools, Floats
from clacad.light.measure import Light, measure
from clacad.measuring.find_lattice import NotMeasurable
from clacad.measuring.fit_lenslets import Lenslets, parts_of
from clacad.measuring.sides import Name, ShownCells, Side
from clacad.optics.rays import TraceResult
from clacad.sheet.bundle import Bundle, RequestedLaw, bundle
from clacad.sheet.like_cell import like_cell
from clacad.sheet.representative_cells import central_cell
from clacad.sheet.window import Face, Window
from clacad.tracing.facets.telescopelet import AnyFace, ExactFace, FacetBody, sampled_face, trace_facets

RAYS = 1024
"""Rays of a cell."""

NODES = 33
"""Heights along a side of a cell of which the form is a bicubic surface."""

MOST_CELLS = 36
"""Most cells that are lit; of more, as many evenly chosen ones."""

DRAWS = 6
"""Sets of numbers within their uncertainty by which the uncertainty of the error of light is found."""

PHASE = 1.0
"""Rms phase (radians) up to which the undisturbed share of light is exp(−phase²)."""


@dataclass(frozen=True, eq=False)
class MeasuredSide:
    """A side with its fitted lenslets, and where their cells are form.

    cells : Cells of the sheet that they are.
    formed : (m, bins, bins) Whether light meets formed surface in each part of the bounding box of each cell.
    bounds : (2,) lengths. Half sizes of that box.
    u_scale : Half width of the stated relative uncertainty of heights, of a coverage of 95 %.
    """

    cells: ShownCells
    lenslets: Lenslets
    formed: Bools
    bounds: Floats
    u_scale: float

    @property
    def side(self) -> Side:
        """Side of the sheet."""
        return self.cells.side

    @cached_property
    def rows(self) -> dict[tuple[int, int], int]:
        """Cell of the sheet → number of the lenslet."""
        return {(int(i), int(j)): k for k, (i, j) in enumerate(self.cells.of(self.lenslets.index))}

    def meets_form(self, number: int, x: Floats, y: Floats) -> Bools:
        """Whether sheet places (n,) relative to the centre of the cell are formed surface."""
        sheet = self.side.in_sheet(x, y, np.zeros(len(x)))  # the signs are their own inverse
        return np.asarray(
            self.formed[number, *parts_of(sheet[:, 0], sheet[:, 1], self.bounds, self.formed.shape[1])]
        )

    def values(self, number: int, draw: Floats | None) -> Floats:
        """Numbers (7,) of a lenslet, changed within their uncertainty where a draw (7,) is given."""
        found: Floats = self.lenslets.values[number]
        if draw is None:
            return found
        root = np.linalg.cholesky(self.lenslets.covariance[number] + 1e-30 * np.eye(7))
        return np.asarray(found + root @ draw)

    def samples(self, number: int, scale: float = 1.0, draw: Floats | None = None) -> tuple[Floats, Floats]:
        """Points (k, 3) of one lenslet over its cell, cell frame of the sheet, and their spacing (2,).

        scale : Factor of all heights, for another scale of the instrument.
        """
        half = np.abs(self.side.lattice.tile()).max(axis=0)
        lines = [np.linspace(-h, h, NODES) for h in half]
        u, v = (one.ravel() for one in np.meshgrid(*lines, indexing="ij"))
        height = self.lenslets.heights(number, u, v, self.values(number, draw))
        if draw is not None:
            doubt = self.lenslets.u_form[number]
            change = np.random.default_rng(number).standard_normal(len(doubt)) * doubt
            height = height + self.lenslets.forms(u, v) @ change
        return self.side.in_sheet(u, v, scale * height), 2.0 * half / (NODES - 1)


@dataclass(frozen=True, eq=False)
class FormLight:
    """Light through the measured form.

    cells : Steps of the lattice of the cells that were lit.
    rms, bias : radians. Error to the law of the formed light, and of its mean direction; NaN if too dark.
    low, high : radians. Range of `rms` within the stated uncertainties.
    slope : radians. Change of `rms` over the relative change of the scale of heights, the larger of both
    sides.
    formed, seam : Shares of all light that pass clear of seams, and that pass but met one.
    by_cell : (cells,) radians
    """

    cells: tuple[tuple[int, int], ...]
    rms: float
    bias: float
    low: float
    high: float
    slope: float
    formed: float
    seam: float
    by_cell: Floats

    @property
    def u_rms(self) -> float:
        """Standard uncertainty of `rms`, radians."""
        return 0.5 * max(self.high - self.rms, self.rms - self.low)


def light_through_form(
    window: Window, sides: Mapping[Name, MeasuredSide], field: float, centre: str
) -> FormLight:
    """Send light through every cell that was measured on every measured side.

    sides : Measured ones; the other faces are as designed.
    field : radians. Half angle of the cone of directions; `centre`: its middle, as in `bundle`.
    """
    seen, lights, clear = _lit_cells(window, sides, field, centre)
    cells = list(seen)
    value = _rms(lights, clear)
    few = cells if len(cells) <= 9 else [cells[k] for k in np.linspace(0, len(cells) - 1, 9).astype(int)]
    base = _rms([seen[one].light() for one in few])
    u_scale = max(one.u_scale for one in sides.values())
    steps = [
        _rms([seen[one].light(1.0 / (1.0 + part * u_scale)) for one in few]) - base
        for part in (-1.0, -0.5, 0.5, 1.0)
    ]
    draws = np.random.default_rng(0).standard_normal((DRAWS, 7))
    noisy = np.array([_rms([seen[one].light(1.0, draw) for one in few]) for draw in draws])
    noise, added = 2.0 * float(np.std(noisy)), max(0.0, float(np.mean(noisy**2)) - base**2)
    fuller = base - float(np.sqrt(max(0.0, base**2 - added)))  # noise of the fit is error of light, too
    down, up = min(0.0, *steps), max(0.0, *steps)
    alive = np.array([light.alive.mean() for light in lights])
    formed = np.array([(light.alive & good).mean() for light, good in zip(lights, clear, strict=True)])
    return FormLight(
        tuple(cells),
        value,
        mean_error(lights),
        max(0.0, value - float(np.linalg.norm([down, noise, fuller]))),
        value + float(np.hypot(up, noise)),
        max(up, -down) / u_scale if u_scale else nan,
        float(formed.mean()),
        float((alive - formed).mean()),
        np.array([_rms([light], [good]) for light, good in zip(lights, clear, strict=True)]),
    )


def law_rms_of_form(window: Window, sides: Mapping[Name, MeasuredSide], field: float, centre: str) -> float:
    """Error (radians) to the law of the formed light alone, as `FormLight.rms`; NaN if too dark."""
    _, lights, clear = _lit_cells(window, sides, field, centre)
    return _rms(lights, clear)


def _lit_cells(
    window: Window, sides: Mapping[Name, MeasuredSide], field: float, centre: str
) -> tuple[dict[tuple[int, int], _Seen], list[Light], list[Bools]]:
    """Cells that are lit, the light of each, and which rays met formed surface."""
    lattice = window.lattice
    every = sorted(set.intersection(*(set(one.rows) for one in sides.values())))
    common = every if window.uniform else [one for one in every if lattice.contains(np.array(one))]
    if not common:
        raise NotMeasurable("the maps show no cell of the sheet in common")
    cells = [common[k] for k in np.linspace(0, len(common) - 1, min(len(common), MOST_CELLS)).astype(int)]
    seen = {cell: _Seen.of(window, cell, sides, field, centre) for cell in cells}
    lights = [one.light() for one in seen.values()]
    clear = [one.clear(light) for one, light in zip(seen.values(), lights, strict=True)]
    return seen, lights, clear


def _rms(lights: Sequence[Light], clear: Sequence[Bools] | None = None) -> float:
    """Rms error (radians) of the light of several cells together, of the rays that are `clear`."""
    error = [
        light.error[light.known if clear is None else light.known & clear[k]]
        for k, light in enumerate(lights)
    ]
    every = np.concatenate(error)
    return float(np.sqrt(np.mean(every**2))) if len(every) >= 64 else nan


def mean_error(lights: Sequence[Light]) -> float:
    """Length (radians) of the mean difference of direction to the law."""
    off = np.concatenate([(one.direction - one.expected)[one.known] for one in lights])
    return float(np.linalg.norm(off.mean(axis=0))) if len(off) >= 64 else nan


@dataclass(frozen=True, eq=False)
class _Seen:
    """One cell of a sheet and its measured lenslets.

    window : Uniform equivalent of the cell; the sheet itself where it is uniform.
    lit : Bundle in front of it.
    held : Number of a face → measured side, and number of the lenslet.
    """

    window: Window
    lit: Bundle
    held: Mapping[int, tuple[MeasuredSide, int]]

    @staticmethod
    def of(
        window: Window, cell: tuple[int, int], sides: Mapping[Name, MeasuredSide], field: float, centre: str
    ) -> _Seen:
        """Prepare the light of a cell."""
        like = like_cell(window, np.array(cell))
        held = {one.side.number: (one, one.rows[cell]) for one in sides.values()}
        return _Seen(like, bundle(like, RAYS, field, centre, cell=central_cell(like)), held)

    def light(self, scale: float = 1.0, draw: Floats | None = None) -> Light:
        """Light through the cell as measured, heights times `scale`, or changed within their uncertainty."""
        faces = [self._face(number, scale, draw) for number in range(len(self.window.faces))]
        bodies = tuple(
            FacetBody(faces[2 * k], faces[2 * k + 1], body) for k, body in enumerate(self.window.bodies)
        )

        def send(one: Bundle) -> TraceResult:
            return trace_facets(bodies, one.rays)

        return measure(send, self.lit, RequestedLaw.of(self.window))

    def _place(self, face: Face) -> Floats:
        """Centre (3,) of the cell of a face, sheet frame, z = 0."""
        return np.array([*self.window.centres(face.array or 0, np.array(self.lit.cell)), 0.0])

    def _face(self, number: int, scale: float, draw: Floats | None) -> AnyFace:
        """A face of the cell, as measured or as designed."""
        face = self.window.faces[number]
        if number not in self.held:
            return ExactFace(face, self._place(face), self.window)
        side, lenslet = self.held[number]
        points, step = side.samples(lenslet, scale, draw)
        return sampled_face(self.window, face, self._place(face), points, step)

    def clear(self, light: Light) -> Bools:
        """Which rays (n,) met formed surface on every measured side."""
        good = np.ones(len(light.seen), dtype=bool)
        start, way = light.lit.rays.position, light.lit.rays.direction
        last = len(self.window.faces) - 1
        for number, (side, lenslet) in self.held.items():
            face = self.window.faces[number]
            if number == last:
                at = light.seen.position[:, :2]
            else:  # rays are straight up to the first face, and nearly so to a second one
                at = (start + way * ((face.vertex[2] - start[:, 2]) / way[:, 2])[:, None])[:, :2]
            good &= side.meets_form(lenslet, *(at - self._place(face)[:2]).T)
        return good


def texture_share(texture: float, index: float, wavelength: float) -> float:
    """Share of light that a texture leaves undisturbed; NaN where its phase is above `PHASE`.

    texture : metres, rms. index : of the material. wavelength : metres.
    """
    phase = 2.0 * pi * (index - 1.0) * texture / wavelength
    return exp(-(phase**2)) if phase <= PHASE else nan
