"""A block of rays for the effects' passes, and its crossings of each face; random draws for its rays.

Draws are deterministic: a ray with given bits and row number always gets the same numbers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.hashing import GOLDEN, mixed
from clacad.base.types import Bools, Floats, Rung
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.sheet.face_order import media_of
from clacad.sheet.window import Body, Window

if TYPE_CHECKING:
    from clacad.effects.engine.compiled_passes import Traced


@dataclass(frozen=True, eq=False)
class FaceCrossing:
    """One face and the rays of a block that went through it.

    before, after : (m, 3) unit directions
    through : (m,) bool or None. Rays that crossed it; None: all of them.
    """

    before: Floats
    after: Floats
    n1: float
    n2: float
    through: Bools | None


@dataclass(eq=False)
class RayBlock:
    """A block of traced rays for the passes, which change its columns in place.

    rays : As launched.
    result : Its direction, position, optical_path and flux may be written; fate, cell, order and surface are
        geometry and must not change.
    rung : str
    wavelength : float or None, metres. Of all rays of the block; None: the design wavelength.
    compiled : Whether the tracer uses compiled kernels, so that compiled passes may run.
    """

    window: Window
    rays: Rays
    result: TraceResult
    rung: Rung
    wavelength: float | None
    compiled: bool = False
    state: dict[str, Any] = field(default_factory=dict)
    """Data that passes of one effect keep from face to face."""

    def index(self, body: Body) -> float:
        """Refractive index of a body for this block."""
        return body.index_at(self.wavelength)

    def emerging(self) -> Bools:
        """Which rays (n,) go on behind the sheet."""
        return np.asarray(self.result.fate <= Fate.LAND)

    @property
    def media(self) -> Floats:
        """Refractive index before the first face and behind each, (faces + 1,)."""
        return np.array(media_of(self.window.bodies, self.wavelength))

    @property
    def air_wavelength(self) -> float:
        """Wavelength in metres, the window's where the block has none. Raises ValueError: Neither has one."""
        wavelength = self.wavelength if self.wavelength is not None else self.window.wavelength
        if wavelength is None:
            raise ValueError("this effect needs a wavelength, and neither the rays nor the design have one")
        return wavelength


def crossings(block: RayBlock) -> Iterator[FaceCrossing]:
    """Every face that the block's rays crossed, in the order of the light.

    On rungs surfaces and mesh these are the faces. Law and thin have no faces: each lens is represented by a
    plane plate across the lens axis, crossed as the ray arrives at lens 1 and as it leaves lens 2. That is
    exact for light through the lens centres.
    """
    if block.rung in ("law", "thin"):
        yield from plate_crossings(block)
        return
    result, media = block.result, media_of(block.window.bodies, block.wavelength)
    assert result.hits is not None
    assert result.directions is not None
    everywhere = bool((result.fate <= Fate.GHOST).all())
    before, point = unit_rows(block.rays.direction), block.rays.position
    for face, after in enumerate(result.directions):
        through = None if everywhere else crossed(result, face, point)
        yield FaceCrossing(before, after, media[face], media[face + 1], through)
        before, point = after, result.hits[face]


def crossed(result: TraceResult, face: int, point: Floats) -> Bools:
    """Rays (n,) that crossed a face at `point` (n, 3): it differs from their last point.

    They did not end there.
    """
    assert result.hits is not None
    ended = (result.fate >= Fate.TIR) & (result.surface == face)
    met = (result.surface >= face) & (result.fate < Fate.MISSED)
    moved = np.any(result.hits[face] != point, axis=1)
    return np.asarray(met & moved & ~ended)


def plate_crossings(block: RayBlock) -> Iterator[FaceCrossing]:
    """Crossings of the plates that represent the lenses on rungs law and thin."""
    result = block.result
    through = None if bool((result.fate <= Fate.GHOST).all()) else block.emerging()
    start, end = unit_rows(block.rays.direction), result.direction
    axis = block.window.thin.rotation[:, 2]
    first, last = block.window.bodies[0], block.window.bodies[-1]
    if first is last:
        index = block.index(first)
        inside, outside = inside_plate(start, axis, index), inside_plate(end, axis, index)
        yield FaceCrossing(start, inside, 1.0, index, through)
        yield FaceCrossing(inside, outside, index, index, through)
        yield FaceCrossing(outside, end, index, 1.0, through)
        return
    for body, ray in ((first, start), (last, end)):
        index = block.index(body)
        inside = inside_plate(ray, axis, index)
        if body is last:
            yield FaceCrossing(start, end, 1.0, 1.0, through)  # the deflection by the lenses loses no light
        yield FaceCrossing(ray, inside, 1.0, index, through)
        yield FaceCrossing(inside, ray, index, 1.0, through)


def inside_plate(direction: Floats, axis: Floats, index: float) -> Floats:
    """Unit directions (m, 3) inside a plane plate of normal (3,) and index, light coming from air."""
    from clacad.optics.surface import refract

    return refract(direction, np.broadcast_to(axis, direction.shape), direction @ axis, 1.0, index)[0]


def unit_rows(direction: Floats) -> Floats:
    """Unit directions (m, 3) of rows of any length."""
    from clacad.optics.sequence import unit_directions

    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        return unit_directions(direction)[0]


def lens_slopes(block: RayBlock) -> tuple[Floats, Floats]:
    """Exit slopes (m, 2) in the lens frame, and the lens-frame directions (m, 3) themselves."""
    turned = block.result.direction @ block.window.thin.rotation
    with np.errstate(invalid="ignore", divide="ignore"):
        return turned[:, :2] / turned[:, 2:], turned


def bend(block: RayBlock, slopes: Floats, rows: Bools) -> None:
    """Set the exit direction of some rays (n,) from lens-frame slopes (n, 2).

    Rays turned back are unchanged.
    """
    out = np.column_stack([slopes[rows], np.ones(int(rows.sum()))]) @ block.window.thin.rotation.T
    out /= np.sqrt((out * out).sum(axis=1))[:, None]
    chosen = np.flatnonzero(rows)
    forwards = out[:, 2] > 0.0
    block.result.direction[chosen[forwards]] = out[forwards]


def traced_of(block: RayBlock) -> Traced:
    """Record for compiled passes of a block whose trace kept hits and directions."""
    from clacad.effects.engine.compiled_passes import Traced

    rays, result = block.rays, block.result
    assert result.hits is not None
    assert result.directions is not None
    kept = result.hits, result.directions, result.fate, result.surface
    return Traced(rays.position, rays.direction, *kept, block.media)


def uniform(rays: Rays, count: int, seed: int, salt: int) -> Floats:
    """Numbers in (0, 1), `count` columns per ray.

    rays : Their bits and their row numbers are the key, so blocks and tiles have different draws.
    salt : One for each effect, so that effects draw independently.
    Returns (n, count) array.

    Notes
    -----
    SplitMix64 (Steele, Lea and Flood, OOPSLA 2014) as a hash; 53 bits and half a step, never 0 or 1.
    """
    columns = (*rays.position.T, *rays.direction.T)
    word = mixed(np.arange(len(rays), dtype=np.uint64) * np.uint64(GOLDEN) + np.uint64(seed))
    for column in columns:
        word = mixed(word ^ np.ascontiguousarray(column).view(np.uint64))
    out = np.empty((len(rays), count))
    for k in range(count):
        step = np.uint64((97 * salt + k + 1) * GOLDEN % 2**64)
        bits = mixed(word + step) >> np.uint64(11)
        out[:, k] = (bits.astype(np.float64) + 0.5) * 2.0**-53
    return out


def normal(rays: Rays, pairs: int, seed: int, salt: int) -> Floats:
    """Standard normal numbers (n, 2 pairs), by Box and Muller."""
    u = uniform(rays, 2 * pairs, seed, salt)
    radius = np.sqrt(-2.0 * np.log(u[:, :pairs]))
    angle = 2.0 * np.pi * u[:, pairs:]
    return np.concatenate([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def disc(rays: Rays, seed: int, salt: int) -> Floats:
    """Points (n, 2) spread evenly over the unit disc."""
    u = uniform(rays, 2, seed, salt)
    radius, angle = np.sqrt(u[:, 0]), 2.0 * np.pi * u[:, 1]
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
