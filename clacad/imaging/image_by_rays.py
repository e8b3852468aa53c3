"""`clacad.image`: the image of a point formed by a sheet, by its law and by traced rays.

Through-focus picture: width of a point's light at each height, and its spot where the width is least.

The point nearest to a bundle of rays, and the distances at which they pass it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from clacad.base.drawn_figure import drawn, inline_svg, no_formula
from clacad.base.interactive import Tabular, by_axis, columns_of
from clacad.base.sobol import sobol
from clacad.base.types import Floats, Ints, Pair2, Rung
from clacad.base.vectors import axes_near, unit
from clacad.optics.law import angle_between
from clacad.optics.law.focusing import along_axes, cell_width
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.cell_places import CellLaws
from clacad.sheet.feasibility.as_rows import Zone, zone_of
from clacad.sheet.need_window import need_window
from clacad.sheet.vignetting import aperture_slopes
from clacad.tracing.trace import SheetTracer

if TYPE_CHECKING:
    from clacad.sheet.window import Window


PARALLEL = 1e-24
"""Mean square of slopes about their mean below which rays count as parallel: 1e-12 rad squared."""


@dataclass(frozen=True, eq=False)
class BestPoint:
    """Point at which rays are closest to one another.

    point : (3,) lengths. X* = argmin Σ |(1 − d dᵀ)(X − P)|²; NaN where the rays are parallel.
    spot : (2,) lengths. Rms distance of the rays from it along x and y, in its plane.
    """

    point: Floats
    spot: Pair2
    rays: int

    @property
    def missing(self) -> Literal["no light", "parallel"] | None:
        """Reason why no such point exists, if so: fewer than two rays, or parallel rays."""
        if np.isfinite(self.point).all():
            return None
        return "parallel" if self.rays >= 2 else "no light"


def best_point(position: Floats, direction: Floats) -> BestPoint:
    """Find the point nearest to rays that pass `position` (n, 3), lengths, along unit `direction` (n, 3).

    One 3 × 3 solve, taken about the mean of the positions: their common part would cause cancellation.
    """
    lost = BestPoint(np.full(3, np.nan), (np.nan, np.nan), len(position))
    if len(position) < 2:
        return lost
    middle = position.mean(axis=0)
    axis = direction.mean(axis=0)
    if np.mean(np.sum((direction - axis) ** 2, axis=1)) < PARALLEL:
        return lost
    place = position - middle
    along = np.einsum("ni,ni->n", place, direction)
    across = place - along[:, None] * direction
    # Σ(1 − d dᵀ) as a sum of squares about the mean direction loses nothing where rays are nearly parallel
    mean = unit(axis)
    basis = np.stack([*axes_near(mean), mean], axis=1)
    d = direction @ basis
    matrix = np.empty((3, 3))
    matrix[:2, :2] = len(d) * np.eye(2) - d[:, :2].T @ d[:, :2]
    matrix[:2, 2] = matrix[2, :2] = -(d[:, :2] * d[:, 2:]).sum(axis=0)
    matrix[2, 2] = np.sum(d[:, :2] ** 2)
    point = middle + basis @ np.linalg.solve(matrix, (across @ basis).sum(axis=0))
    x, y = spot_at(position, direction, point)
    return BestPoint(point, (x, y), len(position))


def spot_at(position: Floats, direction: Floats, point: Floats) -> Pair2:
    """Rms distances along x and y (lengths) at which rays pass a point (3,) in its plane of height z."""
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (point[2] - position[:, 2]) / direction[:, 2]
        off = position[:, :2] + reach[:, None] * direction[:, :2] - point[:2]
    x, y = np.sqrt(np.mean(off**2, axis=0)).tolist()
    return x, y


RUNGS: tuple[Rung, ...] = ("law", "thin", "surfaces")
RAYS = 100_000

LITTLE = 0.01
"""Share of the light below which `Image.instead` reports light that does get through."""

TRIED = 4096
"""Number of rays along the middle of the field that are traced for that report."""


@dataclass(frozen=True, eq=False)
class RungImage:
    """Image of a point on one rung.

    rung : "law", "thin" or "surfaces"
    predicted : Of the chief rays, by the law alone; for rung "law" through a sheet of zero thickness.
    found : Of the rays that obey the law. Lengths, sheet frame.
    share : Part of the light on the sheet that goes through lenses of one telescopelet.
    position, direction : (n, 3) lengths, unit. Of this light, behind the sheet.
    fates : Shares of all launched light by name of fate; fates that do not occur are absent.
    astray : (i, j) or None
        The commonest distance, in cells, from its partner of light through lenses of two telescopelets.
    """

    rung: Rung
    predicted: BestPoint
    found: BestPoint
    share: float
    position: Floats
    direction: Floats
    fates: Mapping[str, float]
    astray: tuple[int, int] | None

    @property
    def off(self) -> float:
        """Distance from the predicted point to the one found, length."""
        return float(np.linalg.norm(self.found.point - self.predicted.point))


@dataclass(frozen=True, eq=False)
class Middle:
    """Light that gets through, for a source whose requested light is almost all lost.

    source : (3,) lengths
        Position, given as `Image.source`: along the middle of the field, from lens 1's middle to lens 2's.
    rung : "law", "thin" or "surfaces"
    share : Part of that light that goes through lenses of one telescopelet on that rung.
    """

    source: Floats
    rung: Rung
    share: float


@dataclass(frozen=True, eq=False)
class Sampling:
    """Comparison of the law of the cell hit, which is built, with the smooth law that it samples.

    slope : radians. Rms angle between the directions of the two laws, for the launched light.
    smooth : Of this light by the smooth law: the limit of infinitely many cells.
    """

    slope: float
    smooth: BestPoint


@dataclass(frozen=True, eq=False)
class Image(Tabular):
    """Image of a point formed by a sheet, rung by rung.

    Parameters
    ----------
    source : (3,) lengths
        As requested; with z = −inf, parallel light of the slopes x and y.
    rungs : tuple of RungImage
    width : (2,) lengths or None
        Smallest full width of the image for cells of this size, along x and y: |η| p and more, 0 in the
        planes of sharp pairs. None where a table gives each cell its own image.
    sampling : Sampling or None
        Effect of the law's change from cell to cell. None where all cells share one law, or a table has no
        smooth law.
    zone : Zone or None
        Set where array 2 has its own pitch, or is rotated.
    instead : Middle or None
        Set where less than LITTLE of the light gets through on some rung.
    """

    source: Floats
    rungs: tuple[RungImage, ...]
    width: Pair2 | None
    sampling: Sampling | None = None
    zone: Zone | None = None
    instead: Middle | None = None

    def __repr__(self) -> str:
        x, y, z = self.source.tolist()
        return f"Image(of ({x:g}, {y:g}, {z:g}), {', '.join(one.rung for one in self.rungs)})"

    def to_columns(self) -> dict[str, Any]:
        """One row for each rung: predicted point, point found, distance between them, spot, share."""
        rows = [
            {
                "rung": one.rung,
                **by_axis("predicted", one.predicted.point.tolist()),
                **by_axis("found", one.found.point.tolist()),
                "off": one.off,
                **by_axis("spot", one.found.spot),
                "share": one.share,
                "rays": one.found.rays,
            }
            for one in self.rungs
        ]
        return columns_of(rows)

    def _picture(self) -> str:
        return inline_svg(plot_svg(self, "", "design unit"))

    def to_dict(self) -> dict[str, Any]:
        """All numbers, for JSON."""
        zone, sampling, instead = self.zone, self.sampling, self.instead
        return {
            "object": self.source.tolist(),
            "width": None if self.width is None else list(self.width),
            "zone": zone and {key: list(getattr(zone, key)) for key in ("width", "f_number", "moire")},
            "sampling": sampling
            and {
                "slope": sampling.slope,
                "found": sampling.smooth.point.tolist(),
                "spot": list(sampling.smooth.spot),
            },
            "instead": instead
            and {"object": instead.source.tolist(), "rung": instead.rung, "share": instead.share},
            "rungs": [
                {
                    "rung": one.rung,
                    "predicted": one.predicted.point.tolist(),
                    "found": one.found.point.tolist(),
                    "off": one.off,
                    "spot": list(one.found.spot),
                    "share": one.share,
                    "rays": one.found.rays,
                    "missing": one.found.missing,
                    "fates": dict(one.fates),
                    "astray": one.astray,
                }
                for one in self.rungs
            ],
        }


def image(window: Window, source: Sequence[float], rungs: Sequence[Rung] = RUNGS, rays: int = RAYS) -> Image:
    """Find where a sheet images a point: the place at which rays of that point meet behind the sheet, on
    each rung.

    Parameters
    ----------
    window : Window
    source : (3,) lengths
        A point before the sheet, z < 0; with z = −inf, parallel light of the slopes x and y.
    rungs : sequence of "law", "thin", "surfaces"
    rays : int
        Number sent on each rung, spread evenly over the sheet, always at identical points.

    Returns
    -------
    Image

    Raises
    ------
    TypeError
        No window.
    ValueError
        A source that is not before the sheet, an unknown rung, or fewer than 64 rays.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("slab", ["lattice.count = [3, 3]"])
    >>> window = clacad.prescribe(design)
    >>> found = clacad.image(window, (0.0, 0.0, -100.0), ["law", "surfaces"], rays=1024)
    >>> columns = found.to_columns()
    >>> [round(z) for z in columns["found_z"]], [round(share, 2) for share in columns["share"]]
    ([100, 100], [1.0, 0.93])
    """
    need_window(window, "image", ", (0, 0, -300)")
    place = np.asarray(source, dtype=np.float64)
    _refuse(window, source, place, rungs, rays)
    sent, which = sent_to(window, place, rays)
    cells = window.lattice.cells()[np.unique(which)]
    found = tuple(_on(window, rung, place, sent, cells) for rung in rungs)
    dark = [one.rung for one in found if one.share < LITTLE]
    instead = _middle(window, place, dark[-1]) if dark else None
    return Image(place, found, _width(window, place), _sampling(window, sent), zone_of(window), instead)


def _refuse(window: Window, source: Sequence[float], place: Floats, rungs: Sequence[Rung], rays: int) -> None:
    """Refuse a source that is no point before the sheet, unknown rungs, and too few rays."""
    if place.shape != (3,) or np.isnan(place).any() or not np.isfinite(place[:2]).all():
        raise ValueError(f"the object is {source!r}, not three numbers x, y, z")
    if not place[2] < min(window.z_range[0], 0.0):
        raise ValueError(
            f"the object lies at z = {place[2]:g}, not before the sheet, which begins at"
            f" {min(window.z_range[0], 0.0):g}"
        )
    if rays < 64:
        raise ValueError(f"{rays} rays determine no image: at least 64")
    wrong = [rung for rung in rungs if rung not in RUNGS]
    if not rungs:
        raise ValueError('no rung is named; there are "law", "thin" and "surfaces"')
    if wrong:
        raise ValueError(f'rung is {wrong[0]!r}, not "law", "thin" or "surfaces"')


def image_seconds(window: Window, rungs: Sequence[Rung], rays: int) -> float:
    """Processor seconds of `image` on the reference machine, where a non-uniform sheet is traced in numpy."""
    each = {"law": 0.7e-6, "thin": 6e-6, "surfaces": 16e-6}
    smooth = (
        2.0 * each["law"] if window.cell_laws is not None and window.cell_laws.smooth is not None else 0.0
    )
    return 0.05 + rays * (smooth + sum(each[rung] for rung in rungs)) + 2e-6 * window.lattice.cell_count


def sent_to(window: Window, source: Floats, rays: int) -> tuple[Rays, Ints]:
    """Rays from a source (3,) to points spread evenly over the sheet, and the kept cell (rays,) of each."""
    kept = window.lattice.cells()
    which = np.linspace(0, len(kept), rays, endpoint=False).astype(np.int64)
    cells = kept[which]
    at = window.lattice.centres(cells) + window.lattice.over_cell(sobol(rays, 2))
    direction = _towards(source, at)
    below = window.z_range[0] - max(window.lattice.pitch)
    below = max(below, 0.5 * (source[2] + window.z_range[0])) if np.isfinite(source[2]) else below
    start = np.column_stack([at, np.zeros(rays)]) + direction * (below / direction[:, 2:])
    return Rays(start, direction), which


def _towards(source: Floats, at: Floats) -> Floats:
    """Unit directions (n, 3) from the source to points (n, 2) of the plane z = 0."""
    if np.isinf(source[2]):
        slopes = np.broadcast_to(source[:2], at.shape)
    else:
        slopes = (at - source[:2]) / -source[2]
    way = np.column_stack([slopes, np.ones(len(at))])
    return np.asarray(way / np.linalg.norm(way, axis=1)[:, None])


def _on(window: Window, rung: Rung, source: Floats, sent: Rays, cells: Ints) -> RungImage:
    """Image formed by the rays on one rung."""
    seen: TraceResult = SheetTracer(window, rung, path="size")(sent)
    good = seen.fate == Fate.ALIVE
    gap = 0.0 if rung == "law" else lens_plane(window, rung)
    return RungImage(
        rung,
        _predicted(window, source, cells, gap),
        best_point(seen.position[good], seen.direction[good]),
        float(np.mean(good)),
        seen.position[good],
        seen.direction[good],
        {name: count / len(sent) for name, count in seen.counts().items() if count},
        _astray(seen),
    )


def _astray(seen: TraceResult) -> tuple[int, int] | None:
    """Commonest step from the partner, for light through lenses of two telescopelets."""
    steps, times = np.unique(seen.order[seen.fate == Fate.GHOST], axis=0, return_counts=True)
    if not len(steps):
        return None
    i, j = steps[times.argmax()].tolist()
    return i, j


def _middle(window: Window, source: Floats, rung: Rung) -> Middle:
    """Light along the middle of the field, from an equally distant source; share that gets through."""
    slopes = np.mean(aperture_slopes(window, window.lattice.cells()), axis=0)
    far = np.isinf(source[2])
    place = np.array([*(slopes if far else source[2] * slopes), source[2]])
    seen = SheetTracer(window, rung, path="size")(sent_to(window, place, TRIED)[0])
    return Middle(place, rung, float(np.mean(seen.fate == Fate.ALIVE)))


def lens_plane(window: Window, rung: Rung) -> float:
    """Height of array 2's lens centres over array 1's (length); light leaves for its image from there."""
    if rung == "thin":
        return float(window.thin.offset[2])
    return float(next(face.vertex[2] for face in window.faces if face.array == 1))


def _predicted(window: Window, source: Floats, cells: Ints, level: float) -> BestPoint:
    """Point where the chief rays of cells (n, 2) meet.

    Array 2 is at height `level`, optically s behind array 1.
    """
    centre = window.centres(0, cells)
    way = _towards(source, centre)
    laws = window.cell_laws
    out = window.law.refract(way) if laws is None else laws.refract(window.lattice, cells, way)
    reach = 0.0 if level == 0.0 else window.thin.separation
    at = np.column_stack([centre + reach * way[:, :2] / way[:, 2:], np.full(len(cells), level)])
    if window.law.theta != 0.0:  # planes of the lenses lie across their axis
        turn, lens = window.law.rotation, way @ window.law.rotation
        along = np.full(len(cells), 0.0 if level == 0.0 else level / turn[2, 2])
        local = np.column_stack([reach * lens[:, :2] / lens[:, 2:], along])
        at = np.column_stack([centre, np.zeros(len(cells))]) + local @ turn.T
    good = np.isfinite(out[:, 0])
    return best_point(at[good], out[good])


def _sampling(window: Window, sent: Rays) -> Sampling | None:
    """Compare light by the cells' laws with light by the smooth law."""
    if window.cell_laws is None or window.cell_laws.smooth is None:
        return None
    cells, smooth = (SheetTracer(window, "law", path="size", continuous=c)(sent) for c in (False, True))
    good = (cells.fate == Fate.ALIVE) & (smooth.fate == Fate.ALIVE)
    if not good.any():
        return None
    apart = angle_between(cells.direction[good], smooth.direction[good])
    return Sampling(
        float(np.sqrt(np.mean(apart**2))), best_point(smooth.position[good], smooth.direction[good])
    )


def _width(window: Window, source: Floats) -> Pair2 | None:
    """Full width along the lens axes of the image of a point formed by cells of finite size.

    None for a table.
    """
    laws = CellLaws(window.law) if window.cell_laws is None else window.cell_laws
    if laws.smooth is None:
        return None
    s, z = window.thin.separation, float(source[2])
    axes = along_axes(laws.smooth, s)
    if "focus" in window.recipe:
        (f1x, f1y), (f2x, f2y) = window.thin.focal_length
        pairs = ((f1x, f2x), (f1y, f2y))
        x, y = (
            cell_width(focal, s, (z, one.image_distance(z)), p)
            for one, focal, p in zip(axes, pairs, window.lattice.pitch, strict=True)
        )
        return x, y
    x, y = (one.width(z, p) for one, p in zip(axes, window.lattice.pitch, strict=True))
    return x, y


SIZE = (9.6, 4.2)
COLOURS = {"law": "#7a7a7a", "thin": "#b07aa1", "surfaces": "#1f4e79"}
HEIGHTS = 81
DOTS = 4000
"""Number of rays drawn in a spot."""


def plot_png(image: Image, name: str, unit: str) -> bytes:
    """Picture as PNG, reproducible for equal images; `name` of the design, `unit` of its lengths."""
    return drawn("png", SIZE, lambda figure: _draw(figure, image, name, unit), {"font.size": 9.0})


def plot_svg(image: Image, name: str, unit: str) -> str:
    """Picture as SVG text."""
    style = {"svg.hashsalt": "clacad", "font.size": 9.0, "svg.fonttype": "path"}
    return drawn("svg", SIZE, lambda figure: _draw(figure, image, name, unit), style).decode()


def reach_of(one: RungImage) -> float:
    """Distance (length) from the image at which the light is about five times as wide."""
    slopes = one.direction[:, :2] / one.direction[:, 2:]
    cone = float(np.sqrt(np.mean(np.sum((slopes - slopes.mean(axis=0)) ** 2, axis=1))))
    return 5.0 * float(np.hypot(*one.found.spot)) / cone


def heights(one: RungImage, reach: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Heights (81,), lengths, up to `reach` about the image."""
    return np.asarray(one.found.point[2] + np.linspace(-reach, reach, HEIGHTS))


def _draw(figure: Any, image: Image, name: str, unit: str) -> None:
    left, right = figure.subplots(1, 2, width_ratios=(1.4, 1.0))
    seen = [one for one in image.rungs if np.isfinite(one.found.point).all()]
    reach = max((reach_of(one) for one in seen), default=0.0)
    for one in seen:
        z = heights(one, reach)
        widths = [spot_at(one.position, one.direction, np.array([*one.found.point[:2], h])) for h in z]
        for k, line in ((0, "-"), (1, ":")):
            left.plot(
                z,
                [w[k] for w in widths],
                line,
                color=COLOURS[one.rung],
                lw=1.1,
                label=f"{one.rung}, {'xy'[k]}",
            )
        left.axvline(one.predicted.point[2], color=COLOURS[one.rung], lw=0.6, ls="--")
    left.set_xlabel(f"height / {unit} (dashed: predicted)")
    left.set_ylabel(f"rms distance from the image point / {unit}")
    left.set_ylim(bottom=0.0)
    left.grid(True, color="#dddddd", lw=0.6)
    if seen:
        left.legend(fontsize=7)
        one = seen[-1]
        some = np.linspace(0, len(one.position), min(DOTS, len(one.position)), endpoint=False).astype(
            np.int64
        )
        reach = (one.found.point[2] - one.position[some, 2]) / one.direction[some, 2]
        at = one.position[some, :2] + reach[:, None] * one.direction[some, :2]
        right.plot(at[:, 0], at[:, 1], ",", color=COLOURS[one.rung])
        right.set_aspect("equal", "datalim")
        right.set_title(f"light of rung {one.rung} at z = {one.found.point[2]:.6g} {unit}", fontsize=8)
    figure.suptitle(no_formula(f"{name}: through focus"), fontsize=10)
