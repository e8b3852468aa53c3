"""The result under construction: every ray's row is written once, when its fate is known.

On its way a ray goes from one event to the next; the kinds of events are named here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import Field, dataclass
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Bools, Floats, Ints, Rows
from clacad.optics.rays import NO_CELL, Fate, Rays, TraceResult

# Ends of a stretch: crossings of the faces' surfaces and levels, or one of three other ends.
FRONT, FRONT_LAND, BACK, BACK_LAND, WALL, ABOVE, ASIDE = range(7)


class RayColumns:
    """Columns of m rays: in a dataclass of this class every array, or columns, has a row for each ray."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def take(self, chosen: Rows | Bools) -> Self:
        """The chosen rays: row numbers, or which (m,); what is no column is the same for all."""
        return type(self)(*(_taken(getattr(self, name), chosen) for name in self.__dataclass_fields__))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Rays of several, one after another; what is no column is that of the first."""
        if len(parts) == 1:
            return parts[0]
        columns = ([getattr(one, name) for one in parts] for name in cls.__dataclass_fields__)
        return cls(*map(_in_turn, columns))


def _taken(column: Any, chosen: Rows | Bools) -> Any:
    if isinstance(column, dict):
        return {name: one[chosen] for name, one in column.items()}
    if isinstance(column, RayColumns):
        return column.take(chosen)
    return column[chosen] if isinstance(column, np.ndarray) else column


def _in_turn(columns: list[Any]) -> Any:
    if isinstance(columns[0], RayColumns):
        return columns[0].joined(columns)
    return np.concatenate(columns) if isinstance(columns[0], np.ndarray) else columns[0]


@dataclass(frozen=True, slots=True, eq=False)
class Ledger:
    """Columns of a `TraceResult`, opened with every ray MISSED or INVALID, as launched."""

    position: Floats
    direction: Floats
    fate: NDArray[np.uint8]
    optical_path: Floats
    cell: NDArray[np.int32]
    order: NDArray[np.int32]
    surface: NDArray[np.int32]
    flux: Floats
    hits: Floats
    directions: Floats

    @classmethod
    def opened(cls, rays: Rays, recorded: int) -> Ledger:
        """Rays as launched; `recorded` surfaces keep their hits (0: none)."""
        n = len(rays)
        fate = np.where(rays.valid(), np.uint8(Fate.MISSED), np.uint8(Fate.INVALID))
        ledger = cls(
            position=rays.position.copy(),
            direction=rays.direction.copy(),
            fate=fate.astype(np.uint8),
            optical_path=np.zeros(n),
            cell=np.full((n, 2), NO_CELL, dtype=np.int32),
            order=np.full((n, 2), NO_CELL, dtype=np.int32),
            surface=np.full(n, NO_CELL, dtype=np.int32),
            flux=np.ones(n),
            hits=np.empty((recorded, n, 3)),
            directions=np.empty((recorded, n, 3)),
        )
        ledger.hits[:] = ledger.position
        ledger.directions[:] = ledger.direction
        return ledger

    @classmethod
    def blank(cls, n: int, recorded: int) -> Ledger:
        """Uninitialised columns, for a tracer that writes every row itself."""
        return cls(
            position=np.empty((n, 3)),
            direction=np.empty((n, 3)),
            fate=np.empty(n, dtype=np.uint8),
            optical_path=np.empty(n),
            cell=np.empty((n, 2), dtype=np.int32),
            order=np.empty((n, 2), dtype=np.int32),
            surface=np.empty(n, dtype=np.int32),
            flux=np.broadcast_to(np.float64(1.0), (n,)),  # no effect ran: nothing to store
            hits=np.empty((recorded, n, 3)),
            directions=np.empty((recorded, n, 3)),
        )

    def launchable(self) -> Rows:
        """Rows (k,) of rays that go forwards at the start; the others are already MISSED or INVALID."""
        with np.errstate(invalid="ignore"):
            return np.flatnonzero((self.fate == Fate.MISSED) & (self.direction[:, 2] > 0.0))

    def record(self, face: int, rows: Rows, position: Floats, direction: Floats) -> None:
        """Record where k rays met a face and directions behind it, (k, 3); later faces repeat them."""
        if len(self.hits):
            self.hits[face:, rows] = position
            self.directions[face:, rows] = direction

    def end(
        self,
        rows: Rows,
        fate: NDArray[np.uint8] | Fate,
        position: Floats,
        direction: Floats,
        optical_path: Floats,
        surface: Ints | int,
    ) -> None:
        """Write the end of k rays that crossed or met the sheet: (k,) each, points and directions (k, 3)."""
        self.fate[rows] = fate
        self.position[rows] = position
        self.direction[rows] = direction
        self.optical_path[rows] = optical_path
        self.surface[rows] = surface

    def miss(self, rows: Rows) -> None:
        """Reset rays (k,) to their launched state."""
        if len(self.hits):
            self.hits[:, rows] = self.position[rows]
            self.directions[:, rows] = self.direction[rows]

    def closed(self) -> TraceResult:
        """Result of the trace."""
        columns = {name: getattr(self, name) for name in self.__slots__}
        return TraceResult(**(columns if len(self.hits) else columns | {"hits": None, "directions": None}))
