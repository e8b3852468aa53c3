"""Heights over a cell that determine thickness, land and the window's extent.

Exact heights are sampled: borders at 65 points, the cell on a grid, corners always included.

Thickness "auto": the smallest that covers every cell, joins neighbours and covers the land.

Given faces without height somewhere over their cell, or that intersect there, are refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from clacad.base.types import Floats, Pair2
from clacad.design.sections import LATTICE, PAIR
from clacad.prescription.bodies import given_conics
from clacad.prescription.radii import NoSuchLens
from clacad.sheet.representative_cells import level_point, outermost_cells
from clacad.sheet.window import (
    Body,
    Face,
    Window,
    column,
    face_height,
    in_optical_tile,
    lens_height,
    optical_tile,
)

BORDER_SAMPLES = 65
GRID = 33


def _border_points(tile: Floats, number: int) -> Floats:
    """Points along border `number` of an optical zone (m, 2), cell frame, (65, 2), lengths."""
    start, end = tile[number], tile[(number + 1) % len(tile)]
    t = np.linspace(0.0, 1.0, BORDER_SAMPLES)[:, None]
    return np.asarray((1.0 - t) * start + t * end)


def zone_points(window: Window, array: int = 0) -> Floats:
    """Points (n, 2), lengths, of an array's optical zone: border samples, then a grid inside."""
    tile = optical_tile(window, array)
    borders = [_border_points(tile, k) for k in range(len(tile))]
    # a fan of scaled outlines: a grid that fits any convex cell
    fan = [np.concatenate(borders)[::2] * scale for scale in np.linspace(0.0, 1.0, GRID)[:-1]]
    return np.concatenate([*borders, *fan])


def border_overlap(window: Window, body: Body) -> float:
    """Least common height of two neighbouring columns over all borders (length), −inf if a lens is missing.

    A negative value is the gap between the columns.
    """
    least, array = np.inf, body.arrays[0]
    lattice = window.lattice_of(array)
    tile, steps = optical_tile(window, array), lattice.steps
    for number in range(len(steps) // 2):
        here = _border_points(tile, number)
        there = here - np.asarray(lattice.offset(*steps[number]))
        low = [_lens_column(body, p) for p in (here, there)]
        overlap = np.fmin(low[0][1], low[1][1]) - np.fmax(low[0][0], low[1][0])
        least = min(least, -np.inf if np.isnan(overlap).any() else float(overlap.min()))
    return least


def least_thickness(window: Window, body: Body) -> float:
    """Least lens thickness along z over the optical zone (length), −inf where a lens is missing."""
    front, back = _lens_column(body, zone_points(window, body.arrays[0]))
    thickness = back - front
    return -np.inf if np.isnan(thickness).any() else float(thickness.min())


def proud_of_land(window: Window, body: Body) -> float:
    """Least height of both lens faces over their land within the optical zone (length); inf without land."""
    if body.front.land is None or body.back.land is None:
        return np.inf
    front, back = _lens_column(body, zone_points(window, body.arrays[0]))
    proud = np.fmin(body.front.land - front, back - body.back.land)
    return -np.inf if np.isnan(proud).any() else float(proud.min())


def _lens_column(body: Body, points: Floats) -> tuple[Floats, Floats]:
    x, y = points[:, 0], points[:, 1]
    return lens_height(body.front, x, y), lens_height(body.back, x, y)


def face_range(window: Window, face: Face) -> tuple[float, float]:
    """Lowest and highest lens point of a structured face over its optical zone (lengths), NaN-free.

    The range of samples and of the point whose normal is the sheet's normal, where it lies in the zone.

    Raises NoSuchLens: The lens has no point over the zone.
    """
    points = zone_points(window, face.array or 0)
    heights = [
        z
        for one in faces_that_differ(window, face)
        for z in (lens_height(one, points[:, 0], points[:, 1]), _level_point(window, one))
    ]
    z = np.concatenate(heights)
    z = z[np.isfinite(z)]
    if not len(z):
        raise NoSuchLens(
            f"the surface of lens {1 + (face.array or 0)} ends before it reaches its cell: no point of the"
            " cell is lens",
            key=LATTICE.aperture,
            hint="a smaller displacement of the cells, a smaller tilt, or a smaller pitch",
        )
    return float(z.min()), float(z.max())


def _level_point(window: Window, face: Face) -> Floats:
    """Height of the extreme point of the lens if it lies in the zone, else empty, (0 or 1,)."""
    if face.untilted:
        return np.array([face.vertex[2]])
    found = level_point(window, face)
    if found is None or not in_optical_tile(window, np.array([found[0]]), np.array([found[1]]))[0]:
        return np.empty(0)
    return np.array([found[2]])


def faces_that_differ(window: Window, face: Face) -> list[Face]:
    """The face as it is in the cells with extreme lenses; the face itself where all cells are alike."""
    if face.change is None:
        return [face]
    cells = outermost_cells(window, face)
    return [window.in_cell(face, cell) for cell in cells]


def _bodies_that_differ(window: Window, body: Body) -> list[Body]:
    """The body as it is in the cells where one of its lenses is extreme."""
    faces = [face for face in (body.front, body.back) if face.change is not None]
    if not faces:
        return [body]
    cells = np.concatenate([outermost_cells(window, face) for face in faces])
    return [
        replace(body, front=window.in_cell(body.front, cell), back=window.in_cell(body.back, cell))
        for cell in np.unique(cells, axis=0)
    ]


def window_range(window: Window) -> tuple[float, float]:
    """Lowest and highest point of any body (lengths), from exact heights at samples."""
    every = [
        _points_range(window, one) for body in window.bodies for one in _bodies_that_differ(window, body)
    ]
    return min(low for low, _ in every), max(high for _, high in every)


def _points_range(window: Window, body: Body) -> tuple[float, float]:
    """Lowest and highest point (lengths) of a uniform body."""
    heights: list[float] = []
    for array in dict.fromkeys(face.array for face in (body.front, body.back)):
        points = zone_points(window, array or 0)
        # where there is a seam, rounding may put a border sample outside the zone: add samples 1e-12 inside
        points = np.concatenate([points, points * (1.0 - 1e-12)])
        if body.columnar:
            faces = [body.front, body.back]
            parts = list(column(window, body, points[:, 0], points[:, 1]))
        else:
            faces = [face for face in (body.front, body.back) if face.array == array]
            parts = [face_height(window, face, points[:, 0], points[:, 1]) for face in faces]
        for face, z in zip(faces, parts, strict=True):
            finite = z[np.isfinite(z)]
            heights += [float(finite.min()), float(finite.max())] if len(finite) else []
            heights += [] if face.land is None else [face.land]
            if face.array is not None:
                level = _level_point(window, face)
                # the extreme point of a lens below its land is not part of the surface
                if face.land is not None and len(level):
                    sunk = level[0] > face.land if face.land_side > 0 else level[0] < face.land
                    level = level[:0] if sunk else level
                heights += [float(v) for v in level]
    return min(heights), max(heights)


def auto_thickness(build: Callable[[Pair2], Window], guess: Pair2, neck: float, limit: float) -> Pair2:
    """Solve for the thicknesses of a biconvex pair together with its radii.

    build : Thicknesses → window (radii solved for them).
    guess : (T1, T2), lengths
    neck : Least common height of neighbouring columns (length).
    limit : Thickness at which the search stops (length).
    Raises NoSuchLens: No thickness below `limit` joins the lenslets.

    Notes
    -----
    Moving the two faces apart by dT increases every thickness by dT cos θ to first order, so that the fixed
    point T ← T + (needed − present) contracts fast; the radii depend only weakly on T.
    """
    thickness = list(guess)
    for _ in range(80):
        window = build((thickness[0], thickness[1]))
        missing = [_missing(window, k, neck) for k in (0, 1)]
        if max(abs(m) for m in missing) <= 2e-14 * limit:
            break
        thickness = [t + m for t, m in zip(thickness, missing, strict=True)]
        for number, t in enumerate(thickness, start=1):
            if not 0.0 < t < limit:
                raise NoSuchLens(
                    f"no centre thickness below {limit:.6g} covers the cell of lens {number} and joins it to"
                    f" its neighbours (tried {t:.6g})",
                    hint="a larger separation, a smaller pitch, less tilt, or a seam with a web",
                )
    return thickness[0], thickness[1]


def _missing(window: Window, number: int, neck: float) -> float:
    """Additional thickness that the lens needs (negative: it may be thinner), length."""
    body = window.bodies[-number]  # first or last: a field lens has its own thickness
    spare = np.inf
    for one in _bodies_that_differ(window, body):
        spare = min(spare, least_thickness(window, one) - neck)
        if window.land.seam == 0.0:
            spare = min(spare, border_overlap(window, one) - neck)
        proud = proud_of_land(window, one)  # both faces rise by half of the increase of T
        spare = min(spare, 2.0 * proud)
    if spare == -float("inf"):
        return window.lattice.circumradius  # a lens ends inside its cell: a thicker lens reaches farther
    return -spare / float(window.thin.rotation[2, 2])


def refuse_no_faces(window: Window) -> None:
    """Refuse given faces that have no height somewhere over their cell, or that cross there.

    Raises NoSuchLens: A face has no real height somewhere over its cell, or front and back of a body without
        land intersect.
    """
    number = -1
    for body in window.bodies:
        for face in (body.front, body.back):
            if face is body.front and body.joined:
                continue
            number += 1
            if face.array is not None:
                for one in faces_that_differ(window, face) if window.many_sizes else [face]:
                    _refuse_no_height(window, one, number)
        for thin in _bodies_that_differ(window, body) if window.many_sizes else [body]:
            _refuse_crossing(window, thin, number)


def _refuse_no_height(window: Window, face: Face, number: int) -> None:
    points = zone_points(window)
    missing = np.isnan(lens_height(face, points[:, 0], points[:, 1]))
    if not missing.any():
        return
    apart = points[missing] - np.asarray(face.vertex[:2])
    at = points[missing][int(np.argmin((apart**2).sum(axis=1)))]
    raise NoSuchLens(
        f"face {number + 1} has no real height over ({at[0]:.4g}, {at[1]:.4g}) of its cell",
        key=f"{PAIR.face}.{number}.conic",
        hint=_conic_that_fits(face, points),
    )


def _conic_that_fits(face: Face, points: Floats) -> str:
    """Conic constants of an upright face that reach every point (n, 2), lengths, of its zone."""
    surface = face.surface
    conics = given_conics(surface)
    x, y = (points - np.asarray(face.vertex[:2])).T
    square = [
        (1.0 + k) * c * c for k, c in zip(conics, (surface.curvature_x, surface.curvature_y), strict=True)
    ]
    worst = float((square[0] * x * x + square[1] * y * y).max())
    if worst <= 1.0:
        return "less tilt, longer radii or a smaller pitch"
    fits = [(1.0 + k) / worst - 1.0 for k in conics]
    return f"conic below [{fits[0]:.4g}, {fits[1]:.4g}], longer radii, or a smaller pitch"


def _refuse_crossing(window: Window, body: Body, back: int) -> None:
    """Refuse a body without land whose front and back intersect over the cell."""
    faces = (body.front, body.back)
    if all(face.land is not None for face in faces if face.array is not None):
        return
    if body.columnar or None in (body.front.array, body.back.array):
        left = least_thickness(window, body)
    else:
        left = face_range(window, body.back)[0] - face_range(window, body.front)[1]
    if left <= 0.0:
        raise NoSuchLens(
            f"faces {back} and {back + 1} cross over their cell: {left:.4g} is left between them where they"
            " are nearest",
            key={"slab": PAIR.separation, "plates": f"{PAIR.face}.{back}.after"}.get(
                window.form, PAIR.thickness
            ),
            hint=f"more than {-left:.4g} more thickness, or longer radii",
        )
