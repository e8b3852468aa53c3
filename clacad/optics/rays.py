"""Rays before, and what became of them after: `Rays`, `Fate`, `TraceResult`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clacad.base.types import Floats

NO_CELL = -(2**31)
"""Stands in integer columns where no cell, or no surface, was met."""


class Fate(IntEnum):
    """What became of a ray; stored as uint8. Every launched ray ends in exactly one."""

    ALIVE = 0  # left the last face forwards, every lens face of one telescopelet
    GHOST = 1  # the same, through lenslets of different telescopelets
    LAND = 2  # the same, through at least one face that is no lens
    BACKWARD = 3  # left with d_z <= 0, or the law has no answer
    TIR = 4  # ended at total internal reflection
    WALL = 5  # ended at a bare step or side wall
    VIGNETTED = 6  # ended at something opaque
    MISSED = 7  # never crossed the sheet, or passed outside the rim of a face
    INVALID = 8  # zero or non-finite input; the only fate whose row may hold NaN


@dataclass(frozen=True, slots=True, eq=False)
class Rays:
    """Starts and directions of n rays, kept as given.

    Parameters
    ----------
    position : (n, 3) array, design units
    direction : (n, 3) array
        Any length but zero; a zero or non-finite row becomes fate INVALID, never an error.
    wavelength : (n,) array or None, metres
        None is the design wavelength.

    Raises
    ------
    ValueError
        The shapes are not (n, 3), (n, 3), (n,).
    """

    position: Floats
    direction: Floats
    wavelength: Floats | None = None

    def __init__(
        self, position: ArrayLike, direction: ArrayLike, wavelength: ArrayLike | None = None
    ) -> None:
        object.__setattr__(self, "position", _rows("position", position))
        object.__setattr__(self, "direction", _rows("direction", direction))
        if len(self.position) != len(self.direction):
            raise ValueError(f"{len(self.position)} positions but {len(self.direction)} directions")
        waves = None if wavelength is None else np.asarray(wavelength, dtype=np.float64)
        if waves is not None and waves.shape != (len(self.position),):
            raise ValueError(
                f"wavelength has shape {waves.shape}; {len(self.position)} rays need ({len(self.position)},)"
            )
        object.__setattr__(self, "wavelength", waves)

    def __len__(self) -> int:
        return len(self.position)

    def valid(self) -> NDArray[np.bool_]:
        """(n,) mask of the rows that can be traced: finite, direction not zero, wavelength positive."""
        columns = [*self.position.T, *self.direction.T]
        good = np.any([c != 0 for c in columns[3:]], axis=0)
        for column in columns:
            good &= np.isfinite(column)
        if self.wavelength is not None:
            good &= np.isfinite(self.wavelength) & (self.wavelength > 0)
        return np.asarray(good, dtype=np.bool_)


@dataclass(frozen=True, slots=True, eq=False)
class TraceResult:
    """One row for each launched ray, in the order of launch.

    Attributes
    ----------
    position, direction : (n, 3) arrays
        Last point met and unit direction there, in the sheet frame. TIR, WALL, VIGNETTED: the last hit and the
        direction before it. MISSED and INVALID: as launched.
    fate : (n,) uint8 array of `Fate`
    optical_path : (n,) array, design units
        Sum of index times distance from the start to `position`.
    cell, order : (n, 2) int32 arrays
        Cell of lens 1; cell of lens 2 minus cell 1. `NO_CELL` where no cell was met.
    surface : (n,) int32 array
        Index of the last face met, `NO_CELL` where none was.
    flux : (n,) array
        1 unless an effect changes it.
    hits, directions : (surfaces, n, 3) arrays or None
        With ``record=True``: the point met at each surface and the unit direction after it, sheet frame. A ray
        that ended earlier repeats its last point and direction.
    """

    position: Floats
    direction: Floats
    fate: NDArray[np.uint8]
    optical_path: Floats
    cell: NDArray[np.int32]
    order: NDArray[np.int32]
    surface: NDArray[np.int32]
    flux: Floats
    hits: Floats | None = None
    directions: Floats | None = None

    def __len__(self) -> int:
        return len(self.fate)

    def counts(self) -> dict[str, int]:
        """Number of rays of each fate, by name; every fate is listed and the numbers add up to n."""
        number = np.bincount(self.fate, minlength=len(Fate))
        return {fate.name: int(number[fate]) for fate in Fate}


def _rows(name: str, value: ArrayLike) -> Floats:
    """The value as an (n, 3) float64 array, or a ValueError that names it."""
    rows = np.asarray(value, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise ValueError(f"{name} has shape {rows.shape}; rays need (n, 3), a single ray (1, 3)")
    return rows
