"""Rays before and after a trace: `Rays`, `Fate`, `TraceResult`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clacad.base.interactive import Tabular, by_axis
from clacad.base.types import Floats

OneRay = tuple[ArrayLike, ArrayLike]
"""Origin (3,) and direction (3,) of a single ray."""

NO_CELL = -(2**31)
"""Value of integer columns where no cell, or no surface, was hit."""


class Fate(IntEnum):
    """Fate of a ray; stored as uint8. Every launched ray ends in exactly one."""

    ALIVE = 0  # left the last face forwards, every lens face of one telescopelet
    GHOST = 1  # as ALIVE, through lenslets of different telescopelets
    LAND = 2  # as ALIVE, through at least one face that is no lens
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
    position : (n, 3) array, or (3,) for one common start, design units
    direction : (n, 3) array, or (3,) for one common direction
        Any length but zero; a zero or non-finite row becomes fate INVALID, never an error.
    wavelength : (n,) array, one number, or None, metres
        None is the design wavelength.

    Raises
    ------
    ValueError
        The shapes are not (n, 3), (n, 3), (n,), nor those of one common value.
    """

    position: Floats
    direction: Floats
    wavelength: Floats | None = None

    def __init__(
        self, position: ArrayLike, direction: ArrayLike, wavelength: ArrayLike | None = None
    ) -> None:
        places, ways = _rows("position", position), _rows("direction", direction)
        count = len(places if ways.ndim == 1 else ways)
        count = 1 if places.ndim == ways.ndim == 1 else count
        places, ways = (np.tile(one, (count, 1)) if one.ndim == 1 else one for one in (places, ways))
        object.__setattr__(self, "position", places)
        object.__setattr__(self, "direction", ways)
        if len(places) != len(ways):
            raise ValueError(f"{len(places)} positions but {len(ways)} directions")
        waves = None if wavelength is None else np.asarray(wavelength, dtype=np.float64)
        waves = np.full(count, waves) if waves is not None and waves.ndim == 0 else waves
        if waves is not None and waves.shape != (len(self.position),):
            raise ValueError(
                f"wavelength has shape {waves.shape}; {len(self.position)} rays need ({len(self.position)},)"
            )
        object.__setattr__(self, "wavelength", waves)

    def __len__(self) -> int:
        return len(self.position)

    def __repr__(self) -> str:
        return f"Rays({len(self)}{'' if self.wavelength is None else ', with wavelengths'})"

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
class TraceResult(Tabular):
    """One row for each launched ray, in the order of launch.

    Attributes
    ----------
    position, direction : (n, 3) arrays
        Last point hit and unit direction there, in the sheet frame. TIR, WALL, VIGNETTED: the last hit and
        the direction before it. MISSED and INVALID: as launched.
    fate : (n,) uint8 array of `Fate`
    optical_path : (n,) array, design units
        Sum of index times distance from the start to `position`.
    cell, order : (n, 2) int32 arrays
        Cell of lens 1; cell of lens 2 minus cell 1. `NO_CELL` where no cell was hit.
    surface : (n,) int32 array
        Index of the last face hit, `NO_CELL` where none was.
    flux : (n,) array
        1 unless an effect changes it.
    hits, directions : (surfaces, n, 3) arrays or None
        With ``record=True``: the point hit at each surface and the unit direction after it, sheet frame. A
        ray that ended earlier repeats its last point and direction.
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

    def __repr__(self) -> str:
        fates = ", ".join(f"{count} {name}" for name, count in self.counts().items() if count)
        return f"TraceResult({fates or 'no rays'})"

    def counts(self) -> dict[str, int]:
        """Number of rays of each fate, by name; every fate is listed and the numbers add up to n."""
        return fate_counts(self.fate)

    def to_columns(self) -> dict[str, Any]:
        """Columns by name, each (n,): position and direction by axis, fate as a word, cell and order."""
        names = np.array([fate.name for fate in Fate])
        return {
            **by_axis("position", self.position.T),
            **by_axis("direction", self.direction.T),
            "fate": names[self.fate],
            "optical_path": self.optical_path,
            **by_axis("cell", self.cell.T, "ij"),
            **by_axis("order", self.order.T, "ij"),
            "surface": self.surface,
            "flux": self.flux,
        }

    def rows(self, part: slice) -> TraceResult:
        """Result of some of the rays."""
        of_surfaces = [None if one is None else one[:, part] for one in (self.hits, self.directions)]
        return TraceResult(
            self.position[part],
            self.direction[part],
            self.fate[part],
            self.optical_path[part],
            self.cell[part],
            self.order[part],
            self.surface[part],
            self.flux[part],
            *of_surfaces,
        )


def joined_results(parts: Sequence[TraceResult]) -> TraceResult:
    """Results of several traces, one after another; without the columns of single surfaces."""

    def joined(name: str) -> Any:
        return np.concatenate([getattr(one, name) for one in parts])

    return TraceResult(*map(joined, TraceResult.__slots__[:-2]))


def fate_counts(fates: NDArray[np.uint8]) -> dict[str, int]:
    """Number of rays of each fate (n,), by name; every fate is listed and the numbers add up to n."""
    number = np.bincount(fates, minlength=len(Fate))
    return {fate.name: int(number[fate]) for fate in Fate}


def as_rays(rays: Rays | OneRay) -> Rays:
    """Return rays unchanged, or the one ray of a pair (origin, direction).

    Raises TypeError: Neither rays nor a pair of points.
    """
    if isinstance(rays, Rays):
        return rays
    if isinstance(rays, tuple) and len(rays) == 2 and all(np.shape(one) == (3,) for one in rays):
        return Rays(*rays)
    raise TypeError(
        f"rays are a {type(rays).__name__}, not clacad.Rays(positions, directions) or one ray ((x, y, z),"
        " (dx, dy, dz))"
    )


def _rows(name: str, value: ArrayLike) -> Floats:
    """The value as an (n, 3) or (3,) float64 array, or a ValueError that names it."""
    rows = np.asarray(value, dtype=np.float64)
    if rows.ndim not in (1, 2) or rows.shape[-1] != 3:
        raise ValueError(f"{name} has shape {rows.shape}; rays need (n, 3), or (3,) for one that all share")
    return rows
