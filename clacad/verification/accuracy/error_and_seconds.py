"""The accuracy table: rows of error and time, the cheapest sufficient row, and the conclusion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from clacad.base.text import plain
from clacad.verification.accuracy.accuracy_row import AccuracyRow, pareto
from clacad.verification.accuracy.conclusion import conclusion

if TYPE_CHECKING:
    from clacad.verification.accuracy.file_floors import Floor

MOST_DISAGREEMENT = 0.01
"""Largest share of rays with another fate or order than the truth at which a setting may be chosen."""


class TargetOutOfReach(ValueError):
    """No setting reaches the requested error; exit status 3."""

    exit_status = 3


@dataclass(frozen=True)
class AccuracyTable:
    """Result of `clacad.accuracy`.

    Parameters
    ----------
    design : str
    rows : tuple of AccuracyRow
    reference : mapping
        The 50-digit check of the truth: rays, rms, max.
    floors : tuple of Floor
        Limit of useful refinement: for each family of file formats the best facet grid and its error.
    notes : tuple of str
    """

    design: str
    rows: tuple[AccuracyRow, ...]
    reference: Mapping[str, float]
    floors: tuple[Floor, ...] = ()
    notes: tuple[str, ...] = ()
    target: float | None = None
    rays: int = field(default=0)

    def __repr__(self) -> str:
        return f"AccuracyTable({self.design!r}, {len(self.rows)} settings, {self.rays} rays each)"

    def cheapest(
        self, target: float, rays: int | None = None, rungs: Sequence[str] | None = None
    ) -> AccuracyRow:
        """Row with the least predicted seconds and `model_rms` within `target`; of the sheet itself if non-uniform.

        Parameters
        ----------
        target : float, radians
        rays : int or None
            Number of rays to trace; default as in the table.
        rungs : sequence of str or None
            Only these rungs.

        Raises
        ------
        TargetOutOfReach
            The message names the closest row.
        """
        count = rays or max((row.rays for row in self.rows), default=1)
        own = any(row.own_cells for row in self.rows)
        open_to = [row for row in self.rows if (rungs is None or row.rung in rungs) and row.own_cells == own]
        good = [row for row in open_to if row.model_rms <= target and row.disagree <= MOST_DISAGREEMENT]
        if good:
            return min(good, key=lambda row: (row.predicted_seconds(count), row.model_rms))
        closest = min(open_to, key=lambda row: (row.disagree > MOST_DISAGREEMENT, row.model_rms))
        raise TargetOutOfReach(
            f"no setting is within {1e3 * target:.4g} mrad; the closest is {closest.rung} {closest.setting} with "
            f"{1e3 * closest.model_rms:.4g} mrad and {closest.disagree:.2%} of the rays in another fate"
        )

    def pareto(self) -> tuple[AccuracyRow, ...]:
        """Rows for which no other row is better in both error and seconds, cheapest first."""
        return pareto(self.rows)

    @property
    def conclusion(self) -> str:
        """Conclusion of the measured rows in words."""
        return conclusion(self.rows, self.floors)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able form."""
        return {
            "format": 1,
            "design": self.design,
            "conclusion": self.conclusion,
            "reference": plain(self.reference),
            "rows": [row.to_dict() for row in self.rows],
            "pareto": [self.rows.index(row) for row in self.pareto()],
            "floors": [plain(floor.to_dict()) for floor in self.floors],
            "notes": list(self.notes),
        }
