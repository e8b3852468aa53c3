"""Objective of a search over a scan: the spread at every position of moving plates, with the beam held.

A search for little spread alone shrinks the exit beam, and the scanner resolves fewer points: their number is
the width of the beam times the range of slopes. The exit beam, the slope at the end of the travel and the
share of the light are therefore walls.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from clacad.base.types import Floats
from clacad.optics.fit import LOST
from clacad.optics.law import linear_numbers
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import trace_sequence
from clacad.optimising.aim import BORDER, SHARE_ROOM, way_out
from clacad.optimising.unknowns import refused
from clacad.sheet.bundle import bundle
from clacad.sheet.like_cell import interfaces
from clacad.sheet.moved_plates import moved_plates
from clacad.sheet.window import Window
from clacad.steering.scan import AXES, Scan

SCAN_RAYS = 384
"""Rays over the cell at each position of a search."""

SCAN_POSITIONS = 6
"""Positions of a search from rest to the end of the travel."""

NORM = 8
"""Order of the mean over positions: nearly the largest spread, with a derivative."""

BEAM = 0.047
"""Largest relative deviation of the exit beam from its width by the law: less than the 5 % of a scanner."""

SCAN_MARGIN = 0.05
"""Margin of the walls of a scan as a share of their limits. A wide one may be soft: a search that is stopped
hard at the beam ends in a worse minimum."""

END = 0.005
"""Largest relative change of the slope at the end of the travel."""

NO_AXIS = "a scan along the normal focuses: no beam is steered, and its spread is no error"


@dataclass(frozen=True, eq=False)
class _Position:
    """Light of a trial at every position (p).

    residuals : (p, 2 n) radians. Exit slopes about their mean: their sum of squares is the spread squared.
    mean : (p, 2). Mean exit slopes.
    beam : (p, 2). Rms width of the light where it leaves over that where it enters.
    share : (p,). Share inside the cells of all faces.
    """

    residuals: Floats
    mean: Floats
    beam: Floats
    share: Floats

    @property
    def spread(self) -> Floats:
        """Rms exit slopes about their mean (p,), radians, both axes."""
        return np.asarray(np.linalg.norm(self.residuals, axis=1))


@dataclass(eq=False)
class ScanLight:
    """Light along the normal at the positions of a scan.

    rays : Over cell 1.
    travels : Travel of each position, lengths; from 0 where the sheet is its own mirror image.
    by_law : (2,). Width of the exit beam by the law, over that of the cell.
    """

    scan: Scan
    rays: Rays
    travels: tuple[float, ...]
    by_law: Floats
    start: _Position = field(init=False)
    _last: tuple[Window, _Position] | None = None

    @staticmethod
    def of(scan: Scan, window: Window) -> ScanLight:
        """Light of a scan for a start window.

        Raises CannotMove: The sheet has no such plates.
        Raises DesignError: The scan is along the normal.
        """
        if scan.axis == "z":
            raise refused("CL106", NO_AXIS, "scan", found="z", allowed="x, y or xy")
        one = window.with_cells((1, 1))
        rays = bundle(one, SCAN_RAYS, 0.0, middle=np.array([0.0, 0.0, 1.0])).rays
        straight = all(face.untilted for face in window.faces) and not np.any(window.shifts)
        ends = np.linspace(0.0 if straight else -1.0, 1.0, SCAN_POSITIONS)
        by_law = np.abs(linear_numbers(window.law)[:2])
        light = ScanLight(scan, rays, tuple((scan.travel * ends).tolist()), by_law)
        light.start = light.seen(one)
        return light

    def seen(self, trial: Window) -> _Position:
        """Light of a trial at every position; that of the last trial is kept."""
        if self._last is None or self._last[0] is not trial:
            rows = [self._at(moved_plates(trial, self.scan.displacements(trial, at))) for at in self.travels]
            self._last = trial, _Position(*(np.array(column) for column in zip(*rows, strict=True)))
        return self._last[1]

    def _at(self, there: Window) -> tuple[Floats, Floats, Floats, float]:
        """Residuals, mean slopes, beam and share of a sheet with its plates moved."""
        light = trace_sequence(interfaces(there), self.rays, record=True)
        alive = light.fate == Fate.ALIVE
        weight = np.clip(0.5 - way_out(there, light, 1.0) / BORDER, 0.0, 1.0) * alive
        part = weight / max(float(weight.sum()), 1e-300)
        with np.errstate(divide="ignore", invalid="ignore"):
            slopes = np.where(alive[:, None], light.direction[:, :2] / light.direction[:, 2:], LOST)
        mean = part @ slopes
        places = [np.where(alive[:, None], one.position[:, :2], 0.0) for one in (light, self.rays)]
        out, enters = (np.sqrt(part @ (place - part @ place) ** 2) for place in places)
        residuals = np.sqrt(part)[:, None] * (slopes - mean)
        beam = out / np.maximum(enters, 1e-300)
        return residuals.ravel(), mean, beam, float(weight.mean())

    def residuals(self, trial: Window) -> Floats:
        """Residuals (m,), radians: their norm is the mean of order `NORM` of the spreads of all positions."""
        seen = self.seen(trial)
        spread = np.maximum(seen.spread, 1e-15)
        mean = float((spread**NORM).mean() ** (1.0 / NORM))
        part = (spread / mean) ** (NORM / 2 - 1) / np.sqrt(len(spread))
        return np.asarray((part[:, None] * seen.residuals).ravel())

    def slack(self, trial: Window) -> dict[str, float]:
        """Slack of the walls of a scan over their limits; below 0: violated."""
        seen = self.seen(trial)
        off = float(np.abs(seen.beam / self.by_law - 1.0).max())
        moving = np.flatnonzero(AXES[self.scan.axis][:2])
        change = float(np.abs(seen.mean[-1, moving] / self.start.mean[-1, moving] - 1.0).max())
        lost = float(self.start.share.min() - seen.share.min())
        return {
            "exit beam": 1.0 - off / BEAM,
            "slope at the end of the travel": 1.0 - change / END,
            "share of the scan": 1.0 - lost / SHARE_ROOM,
        }
