"""Compare a mesh file that was read back with the design: closed, volume, extent, 1,000 points per face."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.base.vectors import doubled_normals
from clacad.formats.mesh.compare_instances import standing
from clacad.formats.mesh.file_mesh import FileMesh
from clacad.formats.mesh.measure import Measure, measure_mesh
from clacad.mesh.border_samples import in_corners
from clacad.sheet.volume_and_extent import Integral, distance_to_face, least_extent, whole_extent
from clacad.sheet.window import WALL, Window
from clacad.solid.marks import Pocket
from clacad.storage.errors import FileDisagrees

SAMPLES = 6000
"""Number of facets sampled from a file; at least about 1,000 lie on each optical face."""


@dataclass(frozen=True, slots=True)
class Promise:
    """Properties of a written mesh, as the mesher reports them.

    facets : Number of facets; every instance is counted.
    sag_error : Largest distance of facets from the exact surface, design units.
    merge : Largest height by which vertices may have been moved to close tiny steps, design units.
    single : Whether coordinates were rounded to float32.
    bevel : Width of the bevels at saddles, design units; the corners of the cells are then not compared.
    added : Volume that the bevels add, less what engraved letters take, design units cubed.
    pockets : Where letters are engraved.
    """

    facets: int
    sag_error: float
    merge: float = 0.0
    single: bool = False
    bevel: float = 0.0
    added: float = 0.0
    pockets: tuple[Pocket, ...] = ()


@dataclass(frozen=True, slots=True)
class Verdict:
    """Measured properties of a file, design units; `checks` names the comparisons that passed."""

    volume: float
    volume_exact: float | None
    checks: tuple[str, ...]


def compare_mesh(
    mesh: FileMesh, window: Window, promise: Promise, name: str, volume: Integral | None = None
) -> Verdict:
    """Compare a file with the design from which it was made.

    mesh : As read back.
    window : All of its bodies are expected in the file.
    name : File name, for messages.
    volume : Exact volume of the window's bodies (`sheet.volume_and_extent.body_volume`); None: the volume is
        not compared.
    Raises FileDisagrees: The message states the first difference found, with both numbers.
    """
    scale = (mesh.unit if mesh.unit is not None else 1e-3) / window.unit
    sample = _Sample.of(mesh)
    found = measure_mesh(mesh, scale, sample.passing)
    if found.facets != promise.facets:
        raise FileDisagrees(f"{name}: {found.facets} facets were read back, {promise.facets} were written")
    if not found.closed:
        raise FileDisagrees(f"{name}: the surface is not closed and consistently wound")
    _compare_places(mesh, window, scale, name)
    slack = rounding(window, promise.single)
    _compare_box(found, window, promise, slack, name)
    chord = _compare_shape(sample.facets(mesh) * scale, window, promise, slack, name)
    exact = None
    if volume is not None:
        exact = _compare_volume(found, window, promise, chord, slack, volume, name)
    checks = ("closed", "shape") if exact is None else ("closed", "volume", "shape")
    return Verdict(found.volume, exact, checks)


def rounding(window: Window, single: bool) -> float:
    """Largest height error (length) due to rounding of coordinates, for slopes up to 10."""
    x0, x1, y0, y1 = whole_extent(window)
    reach = max(abs(v) for v in (x0, x1, y0, y1, *window.z_range))
    return reach * (2.0**-24 if single else 2.0**-50) * 12.0


def _compare_box(found: Measure, window: Window, promise: Promise, slack: float, name: str) -> None:
    """Compare the bounding box of a file with that of the design."""
    x0, x1, y0, y1 = whole_extent(window)
    least = least_extent(window)
    pairs = [
        ("x", found.low[0], x0, least[0]),
        ("x", found.high[0], x1, least[1]),
        ("y", found.low[1], y0, least[2]),
        ("y", found.high[1], y1, least[3]),
    ]
    for axis, got, want, reached in pairs:
        # Instanced and fused outlines end on the design's own; a round outline is a polygon inside it.
        room = slack + (promise.sag_error if window.outline is None else 1e-3 * (x1 - x0)) + 1e-9 * (x1 - x0)
        # A lens that ends inside its cell is cut to facets, whose corners lie on its rim.
        rim = 0.0 if reached == want else 0.05 * _pitch(window)
        if not min(want, reached) - room - rim <= got <= max(want, reached) + room + rim:
            raise FileDisagrees(f"{name}: it ends at {axis} = {got:.9g}, the design at {want:.9g}")
    low, high = window.z_range
    room = slack + promise.merge + promise.sag_error + 1e-6 * (high - low)
    if found.low[2] < low - room or found.high[2] > high + room:
        raise FileDisagrees(
            f"{name}: heights {found.low[2]:.9g} … {found.high[2]:.9g} leave the design's {low:.9g} …"
            f" {high:.9g}"
        )


@dataclass(eq=False, slots=True)
class _Sample:
    """Random sample of SAMPLES facets of a mesh, the same for each reading of a file.

    The facets are collected while they are streamed, unless a part is repeated.


    chosen : (n,) ints, ascending. Indices of the sampled facets; every place of a part is counted.
    passed : Number of facets streamed so far.
    """

    chosen: Ints
    passed: int
    found: list[Floats]

    @classmethod
    def of(cls, mesh: FileMesh) -> _Sample:
        """Choose indices from all facets of the file, instances included."""
        count = mesh.facet_count
        return cls(
            np.unique(np.random.default_rng(0).integers(0, max(1, count), size=min(SAMPLES, 2 * count))),
            0,
            [],
        )

    def passing(self, points: Floats, facets: Ints) -> None:
        """Collect the sampled ones among the next facets (k, 3), given by rows of points (n, 3)."""
        first, last = np.searchsorted(self.chosen, [self.passed, self.passed + len(facets)])
        self.found.append(points[facets[self.chosen[first:last] - self.passed]])
        self.passed += len(facets)

    def facets(self, mesh: FileMesh) -> Floats:
        """The facets (n, 3, 3), file unit."""
        if any(part.repeated for part in mesh.parts):
            return self._picked(mesh)
        return np.concatenate(self.found)

    def _picked(self, mesh: FileMesh) -> Floats:
        found, first = [], 0
        for part in mesh.parts:
            every = part.facet_count * len(part.places)
            mine = self.chosen[(self.chosen >= first) & (self.chosen < first + every)] - first
            place, facet = np.divmod(mine, max(1, part.facet_count))
            spots = part.placed_at(place)
            found.append(np.einsum("kcx,kxy->kcy", part.picked(facet), spots[:, :3]) + spots[:, None, 3])
            first += every
        return np.concatenate(found)


def _compare_places(mesh: FileMesh, window: Window, scale: float, name: str) -> None:
    """Compare every place of a repeated part with the lattice, not a sample of them."""
    found = standing(mesh, window, scale)
    if found is None:
        if any(part.repeated for part in mesh.parts):
            raise FileDisagrees(f"{name}: what it repeats covers no cell of the design")
    elif not found.sound:
        raise FileDisagrees(f"{name}: {found.words} (rounding: {found.limit:.2g})")


def _compare_shape(
    facets: Floats, window: Window, promise: Promise, slack: float, name: str
) -> tuple[float, float]:
    """Compare sampled facets with the exact faces; return the chord volume and its standard error.

    For a surface of second order the mean height of chord over arc is 3/4 of that at the centroid.
    """
    normal = doubled_normals(facets)
    length = np.linalg.norm(normal, axis=1)
    n_z = np.where(length > 0.0, normal[:, 2] / np.where(length > 0.0, length, 1.0), 0.0)
    optical = np.abs(n_z) >= WALL
    if promise.bevel > 0.0:
        optical &= ~in_corners(window, facets.mean(axis=1), promise.bevel)
    off = _off_surface(facets, np.where(optical, np.sign(n_z), 0.0), window, promise, slack)[optical]
    upright = np.abs(n_z[optical])
    at_corners = (off[:, :3].max(axis=1) * upright).max(initial=0.0)
    at_middle = (off[:, 3] * upright).max(initial=0.0)
    if at_corners > slack + promise.merge + 1e-9 * _pitch(window):
        raise FileDisagrees(
            f"{name}: a corner lies {at_corners:.3g} off the exact surface (rounding: {slack:.2g})"
        )
    if at_middle > 1.1 * promise.sag_error + slack + promise.merge:
        raise FileDisagrees(
            f"{name}: a facet lies {at_middle:.3g} off the exact surface; its sag error is"
            f" {promise.sag_error:.3g}"
        )
    area = 0.5 * np.abs(normal[optical, 2])
    share = 0.75 * off[:, 3] * area
    everything = len(facets) or 1
    return float(share.sum() / everything), float(share.std() / np.sqrt(everything))


def _off_surface(facets: Floats, side: Floats, window: Window, promise: Promise, slack: float) -> Floats:
    """Distance (n, 4) of the corners and the middle of each facet from the nearest face of the same
    orientation.

    side : (n,) +1 where a facet faces +z, −1 where it faces −z, 0 where it is not optical (infinite distance)
    """
    middle = facets.mean(axis=1)
    points = np.concatenate([facets, middle[:, None]], axis=1)
    off = np.full((len(facets), 4), np.inf)
    for body in window.bodies:
        for face in (body.front, body.back):
            mine = np.flatnonzero(side == -face.side)
            if len(mine):
                found = distance_to_face(window, face, points[mine], middle[mine, :2])
                off[mine] = np.minimum(off[mine], found)
    for pocket in promise.pockets:
        floor = pocket.on_floor(facets, slack + promise.merge)
        off[floor] = np.abs(points[floor, :, 2] - pocket.floor)
    return off


def _pitch(window: Window) -> float:
    return min(window.lattice.pitch)


def _compare_volume(
    found: Measure,
    window: Window,
    promise: Promise,
    chord: tuple[float, float],
    slack: float,
    volume: Integral,
    name: str,
) -> float:
    """Compare the enclosed volume with the exact integral, allowing for the sampled chord volume."""
    exact, error = volume.value + promise.added, volume.error
    x0, x1, y0, y1 = whole_extent(window)
    faces = 2 * len(window.bodies)
    area = (x1 - x0) * (y1 - y0) * faces
    # Every sampled facet represents facets/samples of the file; allow five standard errors of that estimate.
    room = found.facets * (chord[0] + 5.0 * chord[1]) * 1.1 + area * (slack * 0.1 + promise.merge * 1e-2)
    room += error + 1e-12 * abs(exact) + _outline_room(window)
    if found.volume <= 0.0 or abs(found.volume - exact) > room:
        raise FileDisagrees(
            f"{name}: it encloses {found.volume:.12g}, the design {exact:.12g}; chords explain {room:.2g} of"
            " difference"
        )
    return exact


def _outline_room(window: Window) -> float:
    """Volume by which a polygon may be smaller than a round outline."""
    from clacad.sheet.lattice import Circle

    if not isinstance(window.outline, Circle):
        return 0.0
    low, high = window.z_range
    return 1e-3 * window.outline.diameter**2 * (high - low)
