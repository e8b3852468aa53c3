"""The cell by which a whole sheet is judged, and light through that cell.

For a uniform sheet it is the middle cell. Else it is the cell whose light leaves farthest from the law, among
those whose lenses have the largest offsets and a sample over the sheet. Bundles are made for its uniform
equivalent, and sent through the whole sheet, neighbours included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from weakref import WeakKeyDictionary

import numpy as np

from clacad.base.text import mrad_text
from clacad.base.types import Floats, Ints, Pair2
from clacad.light.measure import Light, Weights, measure, rms_angles
from clacad.optics.law import angle_between
from clacad.optics.rays import Fate, Rays, TraceResult, joined_results
from clacad.sheet.bundle import Bundle, RequestedLaw, bundle, bundles
from clacad.sheet.like_cell import heated, like_cell
from clacad.sheet.representative_cells import SAMPLED, central_cell, representative_cells
from clacad.sheet.window import Window
from clacad.tracing.trace import SheetTracer, trace

TRIED_RAYS = 256
"""Rays through each cell from which the worst is chosen."""

FEWEST_TRIED = 8
"""Of these, rays that must get through for a cell to be judged by their directions."""

MOST_SCREENED = 2000
"""Cells of a sheet up to which all are screened: .3 ms each."""

SCREENING_RAYS = 32
"""Rays through each cell that is screened."""

WORST = 8
"""Cells with the largest screened error that are added to the sample."""

_ERRORS: WeakKeyDictionary[Window, dict[tuple[float, int, bytes], Floats]] = WeakKeyDictionary()
"""Rms errors of cells of a window, by the field, the rays of each, and the cells."""


@dataclass(frozen=True, eq=False)
class SeenCell:
    """One cell of a sheet: bundles are made for its uniform equivalent, and sent through the sheet itself.

    window : The sheet.
    like : Uniform equivalent of the cell; the sheet itself where it is uniform.
    cell : (2,) ints
    tried : Cells of which this is the worst; 0 for a uniform sheet.
    others : (float, float) or None, radians
        Least and largest rms error of light of the other tried cells, by few rays; None where none is known.
    """

    window: Window
    like: Window
    cell: Ints
    tried: int = 0
    others: Pair2 | None = None

    @property
    def index(self) -> tuple[int, int]:
        """The cell as plain numbers."""
        return int(self.cell[0]), int(self.cell[1])

    @property
    def words(self) -> str:
        """The cell and the spread over the others, in words; "" for a uniform sheet."""
        if not self.tried:
            return ""
        i, j = self.cell.tolist()
        found = f"cell ({i}, {j}), the worst of {self.tried} tried"
        if self.others is not None:
            low, high = mrad_text(self.others[0], unit=""), mrad_text(self.others[1])
            found += f", in the others {low} to {high} rms from the law"
        return found

    def __call__(self, lit: Bundle) -> TraceResult:
        """Send a bundle that was made for `like` through this cell of the sheet."""
        return self.send(lit)

    def heated(self, kelvin: float) -> SeenCell:
        """The cell at a temperature `kelvin` higher.

        Raises ValueError: The change of an index with temperature is not known.
        """
        whole, like = (heated(one, kelvin) for one in (self.window, self.like))
        return replace(self, window=whole, like=whole if self.like is self.window else like)

    @property
    def buildable(self) -> Window:
        """`like` without a cut outline, with room for displaced partners: the window that meshes and solids
        are made of.
        """
        return self.like if self.like is self.window else self.like.with_cells(self.like.lattice.count)

    def send(self, lit: Bundle) -> TraceResult:
        """Trace a bundle that was made for `like` through this cell of the sheet."""
        return trace(self.window, self.placed(lit).rays, path="size")

    def in_lines(self, lit: Bundle, waves: Sequence[float]) -> list[TraceResult]:
        """Trace a bundle in several lines of light (metres): what no colour changes is traced once."""
        tracer = SheetTracer(self.window, path="size")
        pieces = list(tracer.in_lines(self.placed(lit).rays, waves))
        return [*pieces[0]] if len(pieces) == 1 else [joined_results(parts) for parts in zip(*pieces)]

    def placed(self, lit: Bundle) -> Bundle:
        """Move a bundle that was made for `like` in front of this cell of the sheet."""
        if self.like is self.window:
            return lit
        return replace(
            lit, cell=self.index, rays=Rays(self.moved(lit), lit.rays.direction, lit.rays.wavelength)
        )

    def moved(self, lit: Bundle) -> Floats:
        """Starts (n, 3) of a bundle that was made for `like`, moved in front of this cell of the sheet."""
        apart = self.window.centres(0, self.cell) - self.like.centres(0, np.array(lit.cell))
        return np.asarray(lit.rays.position + [*apart, 0.0])


def measure_light(
    window: Window, field: float, wavelengths: Weights = (), temperatures: Weights = (), rays: int = 16384
) -> Light:
    """Measure how well light through a sheet obeys the law, in several colours and at several temperatures.

    Parameters
    ----------
    window : Window
    field : float, radians
        Half angle of the cone of rays about the axis; 0 for parallel light.
    wavelengths : mapping of metres to weight, or sequence of metres
        Lines of the light; empty: the design's.
    temperatures : mapping of kelvin to weight, or sequence of kelvin
        Temperatures above that of the design, at which the index is n + dn/dT times that; empty: the
        design's.
    rays : int
        Rays of each line, over the cell by which the sheet is judged.

    Returns
    -------
    Light
        Of all lines together; `Light.lines` holds them one by one.

    Raises
    ------
    ValueError
        A weight is not positive; or an index is not known at a wavelength, or its change with temperature.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> window = clacad.prescribe(design)
    >>> light = clacad.measure_light(window, field=0.02, wavelengths=[486e-9, 656e-9], rays=256)
    >>> len(light.lines)
    2
    """
    cell = worst_cell(window, field)
    return measure(
        cell, bundle(cell.like, rays, field), RequestedLaw.of(cell.like), wavelengths, temperatures
    )


def worst_cell(window: Window, field: float) -> SeenCell:
    """The cell by which a sheet is judged: the first of `tried_cells`."""
    return tried_cells(window, field)[0]


def tried_cells(window: Window, field: float) -> list[SeenCell]:
    """Cells that a sheet is judged by: the one of a uniform sheet; else a sample, the outermost and the worst
    cells.

    First is the cell through which almost no light of a cone (half angle `field`, radians) gets, else whose
    light leaves farthest (rms) from the law. Up to `MOST_SCREENED` cells all are screened by few rays. Those
    with the largest rms direction error are added.
    """
    if window.uniform:
        return [SeenCell(window, window, np.array(central_cell(window)))]
    cells = representative_cells(window, "light")
    if SAMPLED < window.lattice.cell_count <= MOST_SCREENED:
        cells = np.concatenate([cells, _screened(window, field)])
    cells = np.unique(cells, axis=0)
    error = _rms_errors(window, cells, field, TRIED_RAYS)
    order = np.argsort(-error, kind="stable")
    known = error[order[1:]][np.isfinite(error[order[1:]])]
    others = (float(known.min()), float(known.max())) if len(known) else None
    seen = [
        SeenCell(window, like_cell(window, cell, widest=False), cell, len(cells)) for cell in cells[order]
    ]
    return [replace(seen[0], others=others), *seen[1:]]


def _screened(window: Window, field: float) -> Ints:
    """The cells (WORST, 2) through which few rays leave farthest from the law, or get lost."""
    every = window.lattice.cells()
    error = _rms_errors(window, every, field, SCREENING_RAYS)
    return np.asarray(every[np.argsort(-error, kind="stable")[:WORST]])


def _rms_errors(window: Window, cells: Ints, field: float, count: int) -> Floats:
    """Rms angle (n,) of the light of cells (n, 2) to the law, infinite where almost all is lost; kept."""
    kept, key = _ERRORS.setdefault(window, {}), (field, count, cells.tobytes())
    if key in kept:
        return kept[key]
    rays, seen = through_all(window, cells, field, count)
    alive = seen.fate == Fate.ALIVE
    if window.cell_laws is None:
        asked = window.law.refract(rays.direction)
    else:
        asked = window.cell_laws.refract(window.lattice, np.repeat(cells, count, axis=0), rays.direction)
    error = np.where(alive, angle_between(seen.direction, asked), np.nan).reshape(len(cells), -1)
    through = alive.reshape(len(cells), -1).sum(axis=1)
    kept[key] = np.where(through < FEWEST_TRIED * count / TRIED_RAYS, np.inf, rms_angles(error))
    return kept[key]


def through_all(
    window: Window, cells: Ints, field: float, count: int = TRIED_RAYS
) -> tuple[Rays, TraceResult]:
    """Trace `count` rays through each of some cells (n, 2); the result is without the requested focus."""
    sent, local = bundles(window, cells, count, field)
    result = trace(window, sent, path="size")
    return sent, replace(result, direction=RequestedLaw.of(window).without_focus(local, result.direction))
