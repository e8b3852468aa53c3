"""Measurement of a mesh file without expansion: a repeated part is measured once per orientation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import fsum

import numpy as np

from clacad.base.types import Floats
from clacad.formats.mesh.closed_stream import Measure, measure
from clacad.formats.mesh.file_mesh import CHUNK, FileMesh, Part, kinds_and_ends

MOST_KINDS = 16
"""Largest number of orientations and scales of one part that are measured; a sheet needs one."""


def measure_mesh(
    mesh: FileMesh, factor: float, passing: Callable[[Floats], Floats] = lambda corners: corners
) -> Measure:
    """Measure a file in design units; a repeated part is measured once per orientation.

    Parameters
    ----------
    mesh : FileMesh
    factor : float
        Design units per file unit.
    passing : callable
        Receives and returns the corners (k, 3, 3) of the unrepeated parts, file unit.
    """
    single = [part for part in mesh.parts if not part.repeated]
    return joined(
        [
            measure(
                (passing(chunk) * factor for part in single for chunk in part.chunks()), origin=np.zeros(3)
            ),
            measure_repeated(mesh, factor),
        ]
    )


def measure_repeated(mesh: FileMesh, factor: float) -> Measure:
    """Measure the repeated parts; the result is closed if each of them is closed by itself.

    Parts that share one list of places are one object, as a GLB mesh of several primitives is.
    """
    found = []
    for parts in objects(mesh):
        imbalance = [0, 0]
        for part in parts:
            for one in _measures(part, factor):
                imbalance = [(a + b) % (1 << 64) for a, b in zip(imbalance, one.imbalance, strict=True)]
                found.append(_with(one, (0, 0)))
        found.append(Measure(0, (imbalance[0], imbalance[1]), 0.0, 0.0, (np.inf,) * 3, (-np.inf,) * 3))
    # an open object is not closed by another with the opposite gap
    whole = joined([_with(one, (0, 0)) for one in found])
    return _with(whole, next((one.imbalance for one in found if one.imbalance != (0, 0)), (0, 0)))


def objects(mesh: FileMesh) -> list[list[Part]]:
    """Repeated parts, grouped by identical lists of places."""
    found: dict[int, list[Part]] = {}
    for part in mesh.parts:
        if part.repeated:
            found.setdefault(id(part.places), []).append(part)
    return list(found.values())


def joined(measures: Sequence[Measure]) -> Measure:
    """Combined measures of several meshes."""
    if not measures:
        return measure(())
    low = np.min([one.low for one in measures], axis=0)
    high = np.max([one.high for one in measures], axis=0)
    sums = [sum(one.imbalance[k] for one in measures) % (1 << 64) for k in (0, 1)]
    return Measure(
        sum(one.facets for one in measures),
        (sums[0], sums[1]),
        fsum(one.volume for one in measures),
        fsum(one.area for one in measures),
        _triple(low),
        _triple(high),
    )


def _measures(part: Part, factor: float) -> Iterator[Measure]:
    """Measure a part for each orientation, times the number of its places in that orientation."""
    for number, (linear, times, first, last) in enumerate(kinds_and_ends(part)):
        if number == MOST_KINDS:  # too many orientations: the comparison of its places fails anyway
            break
        turn = linear * factor
        one = measure(
            (part.corners(k, k + CHUNK) @ turn for k in range(0, part.facet_count, CHUNK)), origin=np.zeros(3)
        )
        yield Measure(
            one.facets * times,
            one.imbalance,
            one.volume * times,
            one.area * times,
            _triple(one.low + first * factor),
            _triple(one.high + last * factor),
        )


def _with(one: Measure, imbalance: tuple[int, int]) -> Measure:
    return Measure(one.facets, imbalance, one.volume, one.area, one.low, one.high)


def _triple(values: Floats) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
