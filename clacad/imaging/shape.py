"""A table of cells that sends parallel light into a picture or pattern on a screen.

Cell (i, j) at C sends light of slope t to T on a screen Z behind array 2:  δ = t − η (T − C − s t)/Z.
Cells are separate, so no integrable surface is needed. The trade-off: the picture has one spot for each
cell, of the width

    |η| p + 2 Z α/|η| + λ Z/(|η| p)      α: half angle of the source

Cells are assigned to points deterministically, at short distances. Up to `EXACT` cells the sum of squared
distances is minimal (scipy.optimize.linear_sum_assignment: D. F. Crouse, IEEE Trans. Aerosp. Electron. Syst.
52, 1679 (2016)). Larger sets are halved together with their points, across the longer side of the cells,
until at most `EXACT` are left: a transport by bisection, which keeps the order of cells along each cut.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.drawn_figure import drawn, no_formula
from clacad.base.text import percent_text
from clacad.base.types import Floats, Ints, Pair2
from clacad.imaging.image_by_rays import lens_plane, sent_to
from clacad.imaging.target import Target
from clacad.optics.law.imaging import deltas_to, spot_widths
from clacad.optics.rays import Fate
from clacad.tracing.trace import SheetTracer

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.sheet.lattice import Lattice
    from clacad.sheet.window import Window


EXACT = 512
"""Largest number of cells that are assigned optimally."""


def assigned(cells: Floats, places: Floats) -> Ints:
    """Index of the point assigned to each cell, (n,); each point is used once.

    cells, places : (n, 2) lengths
    """
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial.distance import cdist

    found = np.empty(len(cells), dtype=np.int64)
    waiting = [(np.arange(len(cells)), np.arange(len(places)))]
    while waiting:
        own, theirs = waiting.pop()
        if len(own) <= EXACT:
            _, chosen = linear_sum_assignment(cdist(cells[own], places[theirs], "sqeuclidean"))
            found[own] = theirs[chosen]
            continue
        axis = int(np.argmax(np.ptp(cells[own], axis=0)))
        half = len(own) // 2
        own, theirs = own[_sorted(cells[own], axis)], theirs[_sorted(places[theirs], axis)]
        waiting += [(own[:half], theirs[:half]), (own[half:], theirs[half:])]
    return found


def _sorted(points: Floats, axis: int) -> Ints:
    """Order (n,) of points (n, 2) along an axis, ties by the other axis."""
    return np.lexsort((points[:, 1 - axis], points[:, axis])).astype(np.int64)


@dataclass(frozen=True, eq=False)
class Blur:
    """Widths of one cell's spot on the screen along the lens axes, lengths, by cause.

    cell : |η| p; source : by its angle; diffraction : λ Z/(|η| p)
    """

    cell: Pair2
    source: Pair2
    diffraction: Pair2

    @property
    def all(self) -> Pair2:
        """Their sum."""
        x, y = (float(a + b + c) for a, b, c in zip(self.cell, self.source, self.diffraction, strict=True))
        return x, y


@dataclass(frozen=True, eq=False)
class Shaped:
    """Cells and the points to which they send their light.

    cells : (n, 2) int. Kept cells.
    places : (n, 2) lengths. On the screen.
    deltas : (n, 2)
    way : length. Rms lateral distance from a cell to its point.
    """

    cells: Any
    places: Floats
    deltas: Floats
    way: float
    blur: Blur
    target: Target


@dataclass(frozen=True, eq=False)
class Rendered:
    """Light of rays through the built sheet on the screen.

    seen, target, spots : (h, w) arrays
        Light in each square of the screen, over all the light on the sheet: by rays; as requested, spread by
        the width of a cell; and as one spot per cell of ideal lenses. Row 0 is the top.
    corners : (x_min, x_max, y_min, y_max), lengths
    through : Share of the light that goes through lenses of one telescopelet.
    within : Share of all the light that arrives within one blur of its cell's point.
    difference : Half the sum of |seen − target|, each scaled to 1: the part of the light that is misplaced.
    by_lenses : The difference from `spots` instead: the part caused by the lenses. The remainder of
        `difference` is caused by light coming in spots.
    """

    seen: Floats
    target: Floats
    spots: Floats
    corners: tuple[float, float, float, float]
    through: float
    within: float
    difference: float
    by_lenses: float


def shaped(design: Design, lattice: Lattice, target: Target, distance: float, source: float = 0.0) -> Shaped:
    """Find the δ of each cell.

    design : Gives η, s, the pitch and the wavelength; its own δ is not used.
    lattice : Of its cells.
    distance : length. From array 2 to the screen.
    source : radians. Half angle of the source.
    Raises NoTarget: More points than cells.
    """
    cells = lattice.cells()
    centres = lattice.centres(cells)
    wanted = target.places(len(cells))
    wanted = wanted[assigned(centres, wanted)]
    way = wanted - centres
    deltas = deltas_to(design.law, way, distance)
    far = float(np.sqrt(np.mean(np.sum(way**2, axis=1))))
    return Shaped(cells, wanted, deltas, far, blur_of(design, distance, source), target)


def blur_of(design: Design, distance: float, source: float) -> Blur:
    """Widths of a cell's spot on a screen `distance` (length) away.

    `source`: half angle of the source (radians).
    """
    waves = design.pair.wavelength / design.unit_m
    return Blur(*spot_widths(design.law, design.lattice.pitch, distance, source, waves))


def table_text(found: Shaped) -> str:
    """The table of cells as CSV, each number in its shortest form."""
    lines = ["i,j,delta_x,delta_y"]
    for (i, j), (x, y) in zip(found.cells.tolist(), (found.deltas + 0.0).tolist(), strict=True):
        lines.append(f"{i},{j},{x!r},{y!r}")
    return "\n".join(lines) + "\n"


def rendered(window: Window, found: Shaped, distance: float, rays: int) -> Rendered:
    """Trace parallel light through the built sheet to the screen.

    window : Built with the table.
    distance : length
    """
    sent, which = sent_to(window, np.array([0.0, 0.0, -np.inf]), rays)
    seen = SheetTracer(window, "surfaces", path="size")(sent)
    good = seen.fate == Fate.ALIVE
    level = lens_plane(window, "surfaces") + distance
    reach = (level - seen.position[good, 2]) / seen.direction[good, 2]
    at = seen.position[good, :2] + reach[:, None] * seen.direction[good, :2]
    blur = np.array(found.blur.all)
    near = (np.abs(at - found.places[which[good]]) <= blur).all(axis=1)
    low, high = found.places.min(axis=0) - blur, found.places.max(axis=0) + blur
    shape = np.clip(np.ceil((high - low) / (0.5 * blur)), 1, 256).astype(np.int64)
    edges = [np.linspace(low[k], high[k], int(shape[k]) + 1) for k in (0, 1)]
    light, _, _ = np.histogram2d(at[:, 0], at[:, 1], edges)
    spread = found.places[which] + _over_cell(window, sent.position, sent.direction, which, found)
    spots, _, _ = np.histogram2d(spread[:, 0], spread[:, 1], edges)
    asked = found.target.light((edges[0], edges[1]), found.blur.cell)
    light, asked, spots = light.T[::-1] / rays, asked.T[::-1], spots.T[::-1] / rays
    corners = (float(low[0]), float(high[0]), float(low[1]), float(high[1]))
    return Rendered(
        light,
        asked,
        spots,
        corners,
        float(np.mean(good)),
        float(near.sum() / rays),
        _elsewhere(light, asked),
        _elsewhere(light, spots),
    )


def _elsewhere(one: Floats, other: Floats) -> float:
    """Part of the light that one picture has at other points than another."""
    return 0.5 * float(np.abs(one / (one.sum() or 1.0) - other / (other.sum() or 1.0)).sum())


def _over_cell(window: Window, position: Floats, direction: Floats, which: Any, found: Shaped) -> Floats:
    """Hit of each ray about its cell's point (n, 2), lengths, for ideal lenses: the cell, scaled by |η|."""
    at = position[:, :2] - position[:, 2:] * direction[:, :2] / direction[:, 2:]
    scale = np.array(found.blur.cell) / np.array(window.lattice.pitch)
    return np.asarray((at - window.lattice.centres(found.cells[which])) * scale)


SIZE = (9.6, 4.0)


def plot_png(seen: Rendered, name: str, unit: str) -> bytes:
    """Both pictures and their difference as PNG, reproducible for equal light; `unit` of the lengths."""
    return drawn("png", SIZE, lambda figure: _draw(figure, seen, name, unit), {"font.size": 8.0})


def _draw(figure: Any, seen: Rendered, name: str, unit: str) -> None:
    panels = figure.subplots(1, 3)
    x0, x1, y0, y1 = seen.corners
    most = float(np.quantile(seen.seen[seen.seen > 0.0], 0.98)) if seen.seen.any() else 1.0
    most = max(float(seen.target.max()), most)
    both = {"extent": (x0, x1, y0, y1), "interpolation": "nearest"}
    panels[0].imshow(seen.target, cmap="gray", vmin=0.0, vmax=most, **both)
    panels[1].imshow(seen.seen, cmap="gray", vmin=0.0, vmax=most, **both)
    panels[2].imshow(seen.seen - seen.target, cmap="RdBu_r", vmin=-most, vmax=most, **both)
    titles = (
        "requested, as wide as a cell",
        f"by rays: {percent_text(seen.within, 4)} within one blur",
        (
            f"by rays less requested: {percent_text(seen.difference)} elsewhere,\nof which lenses alone make"
            f" {percent_text(seen.by_lenses, unit='')}"
        ),
    )
    for panel, title in zip(panels, titles, strict=True):
        panel.set_title(title, fontsize=8)
        panel.set_xlabel(f"x / {unit}")
    panels[0].set_ylabel(f"y / {unit}, seen from behind the screen")
    figure.suptitle(no_formula(name), fontsize=10)
