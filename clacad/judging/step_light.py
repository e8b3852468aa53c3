"""Light through the faces of a file of solids, for the checks of a master.

The faces are those OCC reads, in a worker that has read the file already. Where the file is too large for
OCC, the lens patches of its text are used. A body the file lacks is taken from the design.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats
from clacad.base.units import millimetres
from clacad.formats.step.rays_through_faces import crossings
from clacad.judging.file_light import FileLight, measure_light
from clacad.light.measure import Light, Send
from clacad.optics.rays import NO_CELL, Fate, Rays, TraceResult
from clacad.sheet.bundle import Bundle, RequestedLaw, bundle
from clacad.sheet.face_order import plates_of
from clacad.sheet.like_cell import lit_by
from clacad.sheet.vignetting import share, thin_cells
from clacad.sheet.window import Body, Window, lifted, optical_tile
from clacad.tracing.facets.telescopelet import ExactFace, FacetBody, trace_facets
from clacad.tracing.worst_cell import tried_cells

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.storage.worker import Worker


FACE_RAYS = 1024
"""Rays of the main bundle through faces: OCC needs half a millisecond per ray."""

POINT_RAYS = 256
"""Rays of each of the nine field points; four times as many where little light is transmitted."""

CELL_RAYS = 64
"""Rays of each further cell of a non-uniform sheet; a cell that passes under a quarter of them is lost."""

MARGIN = 0.1
"""Pitches around a telescopelet within which faces are searched."""

SECONDS = 600.0
OCC_RAYS, PATCH_RAYS = (
    "clacad.formats.step.rays_through_faces:follow_rays",
    "clacad.formats.step.rays_through_faces:follow_patches",
)


def point_rays(window: Window) -> int:
    """Rays of each field point, so that enough of them are transmitted."""
    middle = np.array([[0.0, 0.0, 1.0]])
    return POINT_RAYS if float(share(thin_cells(window), middle)[0]) > 0.5 else 4 * POINT_RAYS


def light_of_cells(
    design: Design, window: Window, send: Send, rays: int
) -> tuple[FileLight, list[float], list[tuple[int, int]]]:
    """Light through the cell by which a sheet is judged; in a non-uniform sheet through other cells too.

    design, window
    send : Bundle → TraceResult through the file.
    rays : Of the main bundle.

    Returns
    -------
    light : FileLight
        Of the cell whose light through the exact surfaces leaves farthest from the law; of the central cell
        of a uniform sheet.
    rms : list of float, radians
        Of that cell, then of the other measured cells.
    cells : list of (i, j)
    """
    if window.uniform:
        return measure_light(design, window, send, rays, point_rays(window)), [], []
    worst, *tried = tried_cells(window, design.check.field)
    light = measure_light(
        design, worst.like, lambda lit: send(worst.placed(lit)), rays, POINT_RAYS, exact=worst.send
    )
    rms, cells = [light.light.rms], [worst.index]
    for one in tried:
        lit = bundle(one.like, CELL_RAYS, design.check.field)
        found = Light(lit, send(one.placed(lit)), RequestedLaw.of(one.like), fewest=CELL_RAYS // 4)
        rms.append(np.inf if found.rms != found.rms else found.rms)
        cells.append(one.index)
    return light, rms, cells


@dataclass(frozen=True, eq=False)
class FaceTracer:
    """Traces bundles through the faces of one file.

    worker : Worker that has read the file.
    held : names of the bodies the file holds
    by_occ : Whether the faces are those OCC reads, else the patches of the text.
    z : mm. Height of the sheet's own z = 0 in the file.
    """

    worker: Worker
    path: str
    window: Window
    held: Sequence[str]
    by_occ: bool
    z: float = 0.0

    def __call__(self, lit: Bundle) -> TraceResult:
        """Trace a bundle.

        ALIVE: in and out of every body through lens faces of one telescopelet, and onwards. GHOST: through
        lenses of several telescopelets. LAND: through a face that is no lens. WALL: at a wall, or where no
        face was hit.
        """
        if lit.rays.wavelength is not None:
            rays = Rays(lit.rays.position, lit.rays.direction)
            return replace(self, window=lit_by(self.window, lit.rays))(replace(lit, rays=rays))
        state = _State(lit.rays)
        for inside, plates in groupby(plates_of(self.window.bodies), self._holds):
            bodies = tuple(body for plate in plates for body in plate)
            if inside:
                self._through_file(state, lit, bodies)
            else:
                _through_design(state, self.window, lit, bodies)
        return state.closed()

    def _holds(self, plate: tuple[Body, ...]) -> bool:
        """Whether the file has every layer of a plate."""
        return all(body.name in self.held for body in plate)

    def _through_file(self, state: _State, lit: Bundle, bodies: tuple[Body, ...]) -> None:
        """Trace the bodies of the file through its own faces; the state continues behind them."""
        live = state.alive()
        scale = millimetres(self.window.unit)
        low, high = column(self.window, lit.cell, bodies)
        numbers = [
            number
            for number in range(2 * len(self.window.bodies))
            if (body := self.window.bodies[number // 2]) in bodies and (number % 2 or not body.joined)
        ]
        up = np.array([0.0, 0.0, self.z])
        function, more = (
            (OCC_RAYS, ()) if self.by_occ else (PATCH_RAYS, (lifted(self.window, self.z / scale), numbers))
        )
        found = self.worker.run(
            function,
            self.path,
            state.position[live] * scale + up,
            state.direction[live],
            crossings(self.window, bodies, self.z),
            (low * scale).tolist(),
            (high * scale).tolist(),
            *more,
            timeout=SECONDS,
        )
        hits = (np.array(found["hits"]).reshape(len(live), -1, 3) - up) / scale
        end, many = np.array(found["end"], dtype=int), np.array(found["crossings"], dtype=int)
        lens = np.array(found["curved"], dtype=bool).reshape(len(live), -1)
        state.position[live] = (np.array(found["position"]).reshape(-1, 3) - up) / scale
        state.direction[live] = np.array(found["direction"]).reshape(-1, 3)
        state.surface[live] += many.astype(np.int32)
        state.fate[live] = np.choose(end, [Fate.ALIVE, Fate.WALL, Fate.WALL, Fate.TIR]).astype(np.uint8)
        for step, number in enumerate(numbers):
            face = self.window.faces[number]
            if face.array is None:
                continue
            met = many > step
            aside = ~lens[:, step] if self.by_occ else ~on_lens(self.window, face, hits[:, step])
            state.aside[live[met & aside]] = True
            state.see(live[met], face.array, self.window, hits[met, step])


def on_lens(window: Window, face: Any, place: Floats) -> NDArray[np.bool_]:
    """Whether points (n, 3) of a lens patch lie where the lens is above its land, in its optical zone."""
    _, x, y = window.locate(face.array, place[:, 0], place[:, 1])
    room = 1e-9 * min(window.lattice.pitch)
    proud = np.ones(len(place), dtype=bool)
    if face.land is not None:
        proud = (face.land - place[:, 2]) * face.land_side >= -room
    if window.land.seam > 0.0:
        corners = optical_tile(window, face.array)
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            edge = end - start
            proud &= edge[0] * (y - start[1]) - edge[1] * (x - start[0]) >= -room * float(np.hypot(*edge))
    return proud


def column(window: Window, cell: tuple[int, int], bodies: Sequence[Body]) -> tuple[Floats, Floats]:
    """Bounding column in x and y, low (2,) and high (2,), of a telescopelet, with a margin."""
    arrays = {face.array for body in bodies for face in (body.front, body.back) if face.array is not None}
    corners = np.concatenate(
        [window.lattice_of(array).tile() + window.centres(array, np.array(cell)) for array in sorted(arrays)]
    )
    room = MARGIN * min(window.lattice.pitch)
    return corners.min(axis=0) - room, corners.max(axis=0) + room


def _through_design(state: _State, window: Window, lit: Bundle, bodies: tuple[Body, ...]) -> None:
    """Trace the bodies that the file lacks as the design has them."""
    live = state.alive()
    cell = np.array(lit.cell)

    def exact(face: Any) -> ExactFace:
        centre = window.centres(0 if face.array is None else face.array, cell)
        return ExactFace(window.in_cell(face, cell), np.append(centre, 0.0))

    pieces = tuple(FacetBody(exact(body.front), exact(body.back), body) for body in bodies)
    found = trace_facets(pieces, Rays(state.position[live], state.direction[live]))
    state.position[live], state.direction[live], state.fate[live] = (
        found.position,
        found.direction,
        found.fate,
    )
    state.surface[live] += found.surface + 1
    array = bodies[-1].back.array if bodies[-1].back.array is not None else bodies[-1].front.array
    if array is not None:
        through = found.fate == Fate.ALIVE
        state.see(live[through], array, window, found.position[through])


class _State:
    """State of the rays during a trace."""

    def __init__(self, rays: Rays) -> None:
        many = len(rays)
        self.position = rays.position.copy()
        self.direction = rays.direction / np.linalg.norm(rays.direction, axis=1, keepdims=True)
        self.fate = np.full(many, Fate.ALIVE, dtype=np.uint8)
        self.surface = np.full(many, -1, dtype=np.int32)
        self.aside = np.zeros(many, dtype=bool)
        self.stray = np.zeros(many, dtype=bool)
        self.cell = np.full((many, 2), NO_CELL, dtype=np.int32)

    def alive(self) -> NDArray[np.intp]:
        """Rows of the rays that are still ALIVE."""
        return np.flatnonzero(self.fate == Fate.ALIVE)

    def see(self, rows: NDArray[np.intp], array: int, window: Window, place: Floats) -> None:
        """Record the cells of an array that rays crossed; cells of one telescopelet have one number."""
        index, _, _ = window.locate(array, place[:, 0], place[:, 1])
        known = self.cell[rows, 0] != NO_CELL
        self.stray[rows[known]] |= (self.cell[rows[known]] != index[known]).any(axis=1)
        self.stray[rows] |= ~window.lattice.contains(index)
        self.cell[rows[~known]] = index[~known]

    def closed(self) -> TraceResult:
        """The trace result; exit directions count only for rays that were transmitted."""
        through = self.fate == Fate.ALIVE
        self.fate[through & (self.direction[:, 2] <= 0.0)] = Fate.BACKWARD
        self.fate[(self.fate == Fate.ALIVE) & self.aside] = Fate.LAND
        self.fate[(self.fate == Fate.ALIVE) & self.stray] = Fate.GHOST
        many = len(self.fate)
        unknown = np.full((many, 2), NO_CELL, dtype=np.int32)
        surface = np.where(self.surface < 0, NO_CELL, self.surface).astype(np.int32)
        return TraceResult(
            self.position,
            self.direction,
            self.fate,
            np.zeros(many),
            self.cell,
            unknown,
            surface,
            np.ones(many),
        )
