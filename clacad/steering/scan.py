"""Steering by plates that move: the light of one direction at every position of a scan.

Each position is the sheet with its plates there, traced through exact surfaces over one cell. In coherent
light identical cells send light only into the orders of their lattice, sin θ' = sin θ + m λ/p. The efficiency
of an order is the part of the incident power in it: the far field of one cell, by the pupil method, in the
direction of that order.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.interactive import Tabular, by_axis, columns_of, shown_progress
from clacad.base.text import plain
from clacad.base.types import Floats, Pair2, Progress
from clacad.base.vectors import xy
from clacad.optics.law import linear_numbers, with_linear_numbers
from clacad.optics.rays import Fate, TraceResult
from clacad.optics.sequence import trace_sequence
from clacad.prescription.prescribe import prescribe
from clacad.sheet.bundle import Bundle, bundle
from clacad.sheet.face_order import plates_of
from clacad.sheet.feasibility.derived_numbers import DEFAULT_WAVELENGTH
from clacad.sheet.like_cell import interfaces
from clacad.sheet.moved_plates import CannotMove, moved_plates, paraxial_exit, tilted_plate
from clacad.sheet.need_window import equal_cells
from clacad.sheet.vignetting import LEAST_SHARE
from clacad.sheet.volume_and_extent import whole_extent
from clacad.sheet.window import Window
from clacad.storage.errors import LimitRefused
from clacad.tracing.trace import trace
from clacad.waves import exit_pupil

if TYPE_CHECKING:
    from clacad.design import Design

AXES: Mapping[str, tuple[float, float, float]] = {
    "x": (1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0),
    "xy": (1.0, 1.0, 0.0),
    "z": (0.0, 0.0, 1.0),
}
"""Word of an axis of travel → displacement per travel; "xy" moves by the travel along either axis."""

RAYS = 8192
"""Rays over the cell."""

POSITIONS = 11
"""Positions of a scan."""

MOST_POSITIONS = 1001

MOST_TILT = 0.1
"""Largest tilt of a plate, radians."""

WOBBLE_RAYS = 512
"""Rays over the cell for each tilt of a plate."""

ROOM = 4
"""Cells around the lit one within which light is followed."""

TERMS = 3
"""Terms of the odd polynomial of a scan."""


@dataclass(frozen=True, eq=False)
class OrderLight:
    """Light through lenses of one pair of cells.

    order : (i, j). Cell of the last array minus cell 1; (0, 0): the wanted light.
    share : Part of the light on the cell.
    slope : (x, y). Mean exit slopes.
    """

    order: tuple[int, int]
    share: float
    slope: Pair2

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        return {"order": list(self.order), "share": self.share, "slope": list(self.slope)}


@dataclass(frozen=True, eq=False)
class Position:
    """Light with the plates at one position.

    Attributes
    ----------
    travel : float, length
        Displacement along each axis of travel of a plate that moves by 1.
    slopes, closed_form : (x, y)
        Mean exit slopes of the wanted light, traced; of the paraxial ray.
    spread : float, radians
        Rms of the exit slopes of the wanted light about their mean, both axes.
    share : float
        Part of the light on a cell that leaves through its own partner.
    exit_beams : (x, y)
        Rms width of the wanted light where it leaves, over that where it enters.
    power : float, 1/m
        Minus the change of exit slope with position: convergence of the wanted light.
    orders : tuple of OrderLight
        The wanted light, then that which strays into other cells, strongest first.
    diffraction_order : (i, j)
        Order of the lattice nearest to the exit slopes.
    efficiency, efficiency_on_order : float
        Part of coherent light in that order; the same with the order at the peak of a cell's far field. NaN
        where the pupil method refuses.
    wobble, wobble_at_rim : float
        Largest change of the mean exit slopes by the tilt of a plate that moves, in the middle of the sheet
        and where its sides are farthest from the axis of the tilt; NaN without a tilt.
    """

    travel: float
    slopes: Pair2
    closed_form: Pair2
    spread: float
    share: float
    exit_beams: Pair2
    power: float
    orders: tuple[OrderLight, ...]
    diffraction_order: tuple[int, int] = (0, 0)
    efficiency: float = np.nan
    efficiency_on_order: float = np.nan
    wobble: float = np.nan
    wobble_at_rim: float = np.nan

    @property
    def exit_beam_over_pitch(self) -> float:
        """Rms width of the wanted light where it leaves over that where it enters, both axes together."""
        return float(np.sqrt(0.5 * (self.exit_beams[0] ** 2 + self.exit_beams[1] ** 2)))

    def row(self, axis: str) -> dict[str, Any]:
        """Numbers by name; "slope" is that along the travel."""
        along = 1 if axis == "y" else 0
        return {
            "travel": self.travel,
            "slope": self.slopes[along],
            "spread": self.spread,
            "share": self.share,
            "exit_beam_over_pitch": self.exit_beam_over_pitch,
            **by_axis("slope", self.slopes),
            **by_axis("closed_form", self.closed_form),
            **by_axis("exit_beam", self.exit_beams),
            "power": self.power,
            **by_axis("diffraction_order", self.diffraction_order),
            "efficiency": self.efficiency,
            "efficiency_on_order": self.efficiency_on_order,
            "wobble": self.wobble,
            "wobble_at_rim": self.wobble_at_rim,
        }


@dataclass(frozen=True, eq=False)
class Steered(Tabular):
    """Positions of a scan, in the order of travel.

    Attributes
    ----------
    name, sha256, unit : str
        Of the design.
    axis : str
        "x", "y", "xy" or "z".
    moves : mapping of plate number to displacement per travel
    wavelength : float, metres
    order_step : (x, y)
        Change of a direction cosine from one diffraction order to the next along either axis.
    positions : tuple of Position
    tilt : float, radians
        Tilt of the plates for which the wobble is measured; 0: none.
    """

    name: str
    sha256: str
    unit: str
    axis: str
    moves: Mapping[int, float]
    wavelength: float
    order_step: Pair2
    positions: tuple[Position, ...]
    tilt: float = 0.0

    def __repr__(self) -> str:
        first, last = self.positions[0], self.positions[-1]
        return (
            f"Steered({self.name!r}, {len(self.positions)} positions from {first.travel:g} to {last.travel:g}"
            f" {self.unit} along {self.axis}, spread up to {1e3 * self.worst_spread:.4g} mrad)"
        )

    @property
    def along(self) -> int:
        """Axis (0 or 1) whose slope the travel changes."""
        return 1 if self.axis == "y" else 0

    @property
    def lit(self) -> tuple[Position, ...]:
        """Positions at which light leaves through its own lenses."""
        return tuple(one for one in self.positions if one.share > 0.0)

    @property
    def worst_spread(self) -> float:
        """Largest spread, radians."""
        return max(one.spread for one in self.lit)

    @property
    def least_share(self) -> float:
        """Least share of the wanted light."""
        return min(one.share for one in self.positions)

    @cached_property
    def odd_terms(self) -> Floats:
        """Coefficients (k,) of travel, travel³, travel⁵ that fit the slope best; fewer for few positions."""
        travel, slope = self._curve
        reach = float(np.abs(travel).max()) or 1.0
        count = min(TERMS, len(set(np.abs(travel[travel != 0.0]).round(12))))
        powers = 2 * np.arange(count) + 1
        found = np.linalg.lstsq((travel[:, None] / reach) ** powers, slope, rcond=None)[0]
        return np.asarray(found / reach**powers)

    @property
    def nonlinearity(self) -> float:
        """Largest distance of the slope from the odd polynomial."""
        travel, slope = self._curve
        powers = 2 * np.arange(len(self.odd_terms)) + 1
        return float(np.abs(slope - travel[:, None] ** powers @ self.odd_terms).max())

    @property
    def cross_talk(self) -> float:
        """Largest change of the slope across the travel; along xy, of the difference of both slopes."""
        slopes = np.array([one.slopes for one in self.lit])
        across = slopes[:, 0] - slopes[:, 1] if self.axis == "xy" else slopes[:, 1 - self.along]
        return float(np.ptp(across))

    @property
    def wobble(self) -> Pair2:
        """Largest wobble of all positions, in the middle of the sheet and at its rim; NaN without a tilt."""
        both = np.array([(one.wobble, one.wobble_at_rim) for one in self.lit])
        return xy(both.max(axis=0))

    @property
    def _curve(self) -> tuple[Floats, Floats]:
        """Travels (n,) and slopes (n,) along the travel."""
        travel = np.array([one.travel for one in self.lit])
        return travel, np.array([one.slopes[self.along] for one in self.lit])

    def to_columns(self) -> dict[str, Any]:
        """One row for each position."""
        return columns_of([one.row(self.axis) for one in self.positions])

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON: travel in the design unit, slopes, radians, 1/m."""
        found = {
            "design": self.name,
            "sha256": self.sha256,
            "unit": self.unit,
            "axis": self.axis,
            "move": {f"plate{number}": part for number, part in self.moves.items()},
            "wavelength": self.wavelength,
            "order_step": list(self.order_step),
            "odd_terms": self.odd_terms.tolist(),
            "nonlinearity": self.nonlinearity,
            "cross_talk": self.cross_talk,
            **(
                {"tilt": self.tilt, "wobble": self.wobble[0], "wobble_at_rim": self.wobble[1]}
                if self.tilt
                else {}
            ),
            "positions": [
                one.row(self.axis) | {"orders": [light.to_dict() for light in one.orders]}
                for one in self.positions
            ],
        }
        return dict(plain(found))


@dataclass(frozen=True)
class Scan:
    """Positions of plates that move.

    Parameters
    ----------
    travel : float
        Largest displacement, in the design unit; the scan runs from -travel to +travel.
    axis : "x", "y", "xy" or "z"
        Axis of travel; "xy": the travel along both; "z": along the normal, which focuses.
    move : mapping or None
        Number of a plate (1, 2, …) to its displacement per travel; None: the last plate by 1.
    positions : int
        Number of positions, evenly spaced.
    tilt : float, radians
        Tilt of each plate that moves, about x and about y; 0: no wobble is measured.

    Raises
    ------
    CannotMove
        An unknown axis, no travel, too many positions or a tilt outside 0 … 0.1.

    Examples
    --------
    >>> import clacad
    >>> clacad.Scan(0.05, positions=3).travels
    (-0.05, 0.0, 0.05)
    """

    travel: float
    axis: str = "x"
    move: Mapping[int, float] | None = None
    positions: int = POSITIONS
    tilt: float = 0.0

    def __post_init__(self) -> None:
        if self.axis not in AXES:
            raise CannotMove(f"axis {self.axis!r}: it is one of {', '.join(AXES)}")
        if not (self.travel > 0.0 and np.isfinite(self.travel)):
            raise CannotMove(f"travel {self.travel:g}: a length above 0")
        if not 2 <= self.positions <= MOST_POSITIONS:
            raise CannotMove(f"positions {self.positions}: 2 to {MOST_POSITIONS}")
        if not 0.0 <= self.tilt <= MOST_TILT:
            raise CannotMove(f"tilt {self.tilt:g}: 0 to {MOST_TILT:g} radians")

    @property
    def travels(self) -> tuple[float, ...]:
        """Travel of every position."""
        last = self.positions - 1
        return tuple(self.travel * (2 * number - last) / last for number in range(self.positions))

    def words(self, unit: str) -> str:
        """The scan as typed after `clacad optimise --scan`."""
        plates = ",".join(f"plate{number}={part:g}" for number, part in (self.move or {}).items())
        text = f'"±{self.travel:g} {unit}" --axis {self.axis}'
        return text + (f" --move {plates}" if plates else "")

    def moves_of(self, window: Window) -> dict[int, float]:
        """Displacement per travel of every plate of a sheet that moves.

        Raises CannotMove: The sheet has one plate.
        """
        plates = len(plates_of(window.bodies))
        if plates < 2:
            raise CannotMove("the design has one plate: nothing moves against it")
        return {plates: 1.0} if self.move is None else dict(self.move)

    def displacements(self, window: Window, travel: float) -> dict[int, Floats]:
        """Displacement (3,) of every plate that moves, lengths."""
        toward = np.array(AXES[self.axis])
        return {plate: travel * part * toward for plate, part in self.moves_of(window).items()}


def steer(
    design: Design,
    travel: float | Scan,
    axis: str = "x",
    move: Mapping[int, float] | None = None,
    *,
    positions: int = POSITIONS,
    rays: int = RAYS,
    waves: bool = True,
    progress: Progress | None = None,
) -> Steered:
    """Move plates of a design and measure light along the normal at every position.

    Parameters
    ----------
    design : Design
        Of two plates or more, with identical cells.
    travel : float or Scan
        Largest displacement, in the design unit; the scan runs from -travel to +travel. A Scan also has the
        axis, the plates, the positions, and a tilt of the plates for the wobble.
    axis : "x", "y", "xy" or "z"
        Axis of travel; "xy": the travel along both; "z": along the normal, which focuses.
    move : mapping or None
        Number of a plate (1, 2, …) to its displacement per travel; None: the last plate by 1.
    positions, rays : int
        Number of positions, evenly spaced; rays over the cell at each.
    waves : bool
        Whether to compute the efficiency of orders in coherent light, which takes most of the time.
    progress : callable or None
        (stage, done 0 … 1).

    Returns
    -------
    Steered

    Raises
    ------
    CannotMove
        An unknown axis, no travel, or plates that cannot move so; light that leaves through its own lenses at
        fewer than two positions.
    DesignError, NoSuchLens
        The design cannot be built, or is a non-uniform sheet.

    Examples
    --------
    >>> import clacad
    >>> design = clacad.load("biconvex", ["lattice.count = [3, 3]"])
    >>> clacad.steer(design, 0.05, positions=3, rays=256, waves=False)
    Steered('biconvex', 3 positions from -0.05 to 0.05 mm along x, ...)
    """
    scan = travel if isinstance(travel, Scan) else Scan(travel, axis, move, positions)
    window = equal_cells(prescribe(design), "a scan", "a uniform sheet")
    moves = scan.moves_of(window)
    wavelength = window.wavelength or DEFAULT_WAVELENGTH
    report, found = shown_progress(progress), []
    for number, at in enumerate(scan.travels):
        there = scan.displacements(window, at)
        moved = moved_plates(window, there)
        one = _position(moved, at, rays, wavelength, waves=waves)
        if scan.tilt:
            middle, rim = _wobble(moved, there, scan.tilt)
            one = replace(one, wobble=middle, wobble_at_rim=rim)
        found.append(one)
        report("moving plates", (number + 1) / scan.positions)
    step = xy(np.abs(_order_directions(window, wavelength)).max(axis=0))
    about = (design.name, design.sha256, design.unit, scan.axis, moves, wavelength, step)
    steered = Steered(*about, tuple(found), scan.tilt)
    if len(steered.lit) < 2:
        most = max(window.lattice.pitch) / 2.0
        raise CannotMove(
            f"travel {scan.travel:g} {design.unit}: light leaves through its own lenses at fewer than two"
            f" positions; try {most:g} {design.unit}, half a pitch"
        )
    return steered


def _position(window: Window, travel: float, rays: int, wavelength: float, *, waves: bool) -> Position:
    """Light along the normal through the middle cell of a sheet with its plates moved."""
    few = window.with_cells((2 * ROOM + 1, 2 * ROOM + 1))
    lit = bundle(few, rays, 0.0, middle=np.array([0.0, 0.0, 1.0]))
    seen = trace(few, lit.rays, path="numpy")
    wanted = seen.fate == Fate.ALIVE
    slopes = seen.direction[:, :2] / seen.direction[:, 2:]
    closed = xy(paraxial_exit(few, np.zeros(2), np.zeros(2))[1])
    orders = tuple(_orders(seen, slopes))
    if not wanted.any():
        return Position(travel, (np.nan, np.nan), closed, np.nan, 0.0, (np.nan, np.nan), np.nan, orders)
    mean = slopes[wanted].mean(axis=0)
    spread = float(np.sqrt(((slopes[wanted] - mean) ** 2).sum(axis=1).mean()))
    found = Position(
        travel,
        xy(mean),
        closed,
        spread,
        float(wanted.mean()),
        _beams(lit, seen),
        _power(seen, slopes, window.unit),
        orders,
    )
    steps = _order_directions(few, wavelength)
    found = replace(found, diffraction_order=_nearest_order(found, steps))
    return _with_waves(found, few, steps, wavelength) if waves else found


def _wobble(window: Window, moves: Mapping[int, Floats], tilt: float) -> Pair2:
    """Wobble in the middle and at the rim of a sheet with its plates moved, each tilted about x and y."""
    few = window.with_cells((1, 1))
    rays = bundle(few, WOBBLE_RAYS, 0.0, middle=np.array([0.0, 0.0, 1.0])).rays
    straight, halves = (
        trace_sequence(interfaces(few), rays),
        0.5 * np.ptp(np.reshape(whole_extent(window), (2, 2)), axis=1),
    )
    changes: dict[bool, list[float]] = {False: [0.0], True: [0.0]}
    for plate, about, way, place in product(moves, (0, 1), (-tilt, tilt), (-1.0, 0.0, 1.0)):
        turn, aside = np.zeros(3), np.zeros(3)
        turn[about], aside[1 - about] = way, place * halves[1 - about]
        seen = trace_sequence(tilted_plate(few, plate, turn, aside), rays)
        both = (seen.fate == Fate.ALIVE) & (straight.fate == Fate.ALIVE)
        after, before = (one.direction[both, :2] / one.direction[both, 2:] for one in (seen, straight))
        changes[place != 0.0].append(float(np.linalg.norm((after - before).mean(axis=0))))
    return max(changes[False]), max(changes[True])


def _beams(lit: Bundle, seen: TraceResult) -> Pair2:
    """Rms width of the wanted light where it leaves, over that where it enters, along x and y."""
    wanted = seen.fate == Fate.ALIVE
    return xy(seen.position[wanted, :2].std(axis=0) / lit.points[wanted].std(axis=0))


def _power(seen: TraceResult, slopes: Floats, unit: float) -> float:
    """Convergence (1/m) of the wanted light: the fit of its slopes by its position, mean of both axes."""
    wanted = seen.fate == Fate.ALIVE
    place, slope = (one[wanted, :2] - one[wanted, :2].mean(axis=0) for one in (seen.position, slopes))
    return float(-((place * slope).sum(axis=0) / (place**2).sum(axis=0)).mean() / unit)


def _orders(seen: TraceResult, slopes: Floats) -> list[OrderLight]:
    """The wanted light, then that which strays, by pair of cells; shares of at least `LEAST_SHARE`."""
    wanted, stray = seen.fate == Fate.ALIVE, seen.fate == Fate.GHOST
    groups = [((0, 0), wanted)]
    for i, j in np.unique(seen.order[stray], axis=0).tolist():
        groups.append(((i, j), stray & (seen.order == (i, j)).all(axis=1)))
    found = [
        OrderLight(order, float(rays.mean()), xy(slopes[rays].mean(axis=0)))
        for order, rays in groups
        if rays.mean() >= LEAST_SHARE
    ]
    return found[:1] + sorted(found[1:], key=lambda one: (-one.share, one.order))


def _order_directions(window: Window, wavelength: float) -> Floats:
    """Change (2, 2) of the direction cosines from one diffraction order to the next, a row an index."""
    lattice = window.lattice
    return np.asarray(wavelength / window.unit * np.linalg.inv(np.array([lattice.a1, lattice.a2])).T)


def _toward(found: Position) -> Floats:
    """Unit direction (3,) of the wanted light."""
    toward = np.array([*found.slopes, 1.0])
    return np.asarray(toward / np.linalg.norm(toward))


def _nearest_order(found: Position, steps: Floats) -> tuple[int, int]:
    """Diffraction order nearest to the wanted light."""
    i, j = np.rint(np.linalg.solve(steps.T, _toward(found)[:2])).astype(int).tolist()
    return i, j


def _with_waves(found: Position, window: Window, steps: Floats, wavelength: float) -> Position:
    """The position with the efficiency of its diffraction order in coherent light."""
    toward, normal = _toward(found), np.array([0.0, 0.0, 1.0])
    numbers, turn = linear_numbers(window.law).copy(), window.law.rotation
    before, after = (one[:2] / one[2] for one in (normal @ turn, toward @ turn))
    numbers[2:] = numbers[:2] * before - after  # the law that sends the light where it goes
    sent = replace(window, law=with_linear_numbers(window.law, numbers))
    try:
        side = exit_pupil.rays_needed(sent, normal, wavelength)
    except LimitRefused:
        return found
    pupil = exit_pupil.pupil(sent, normal, wavelength, side)
    length, order = wavelength / window.unit, np.array(found.diffraction_order) @ steps
    return replace(
        found,
        efficiency=exit_pupil.order_efficiency(pupil, sent, toward, length, order),
        efficiency_on_order=exit_pupil.order_efficiency(pupil, sent, toward, length),
    )
