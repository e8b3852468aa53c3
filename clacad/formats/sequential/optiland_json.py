"""A telescopelet as a lens of optiland, in its JSON. Reading back needs the extra `optiland`; writing needs
none.

Optiland's own biconic is z_x(x) + z_y(y), another surface than one with a single root, and its toroid is no
ellipsoid. A face of two radii is therefore written as `PolynomialGeometry`: a paraboloid of the mean
curvature and the series

    z = (cx x² + cy y²) Σ a_m (ax x² + ay y²)^m,  a = (1 + K) c²,  a_0 = 1/2, a_m = a_{m−1} (2m − 1)/(2m + 2),

of z = q (1 − √(1 − w))/w. Enough terms are written that its slope over the cell is that of the face within
`SLOPE`: not the same surface, but equal to the last digits, and the file states the error. A surface of
revolution (`StandardGeometry`), a plane and a cylinder (`BiconicGeometry`, where one of the two profiles is
flat) are exact. A face so steep that the series would need more than `MOST_TERMS` terms is rejected.
"""

from __future__ import annotations

import json
from importlib.util import find_spec
from math import atan2, comb, hypot, inf
from pathlib import Path
from typing import Any

import numpy as np

from clacad.base.types import Floats
from clacad.formats.sequential.stations import (
    Station,
    from_own_cell,
    image_height,
    left_out,
    probe,
    pupil,
    refuse_other_light,
    stations,
    through_design,
    wavelength_um,
)
from clacad.sheet.window import Window
from clacad.storage.errors import NotPossible, UnreadableFile
from clacad.storage.reading import Spending

SLOPE = 1e-13
"""Slope by which a series may differ from the face over its cell."""

MOST_TERMS = 40
"""Largest number of powers of w: a polynomial of degree 80.

It suffices where w, the bend of the root, stays below about 0.6.
"""

NEWTON = 1e-12
"""Accuracy with which optiland must intersect a face, in reaches of a cell."""


def require_optiland() -> None:
    """Raise an error that names the missing extra. Raises NotPossible."""
    if find_spec("optiland") is None:
        raise NotPossible(
            'format optiland needs the package optiland\n  install it with: pip install "clacad[optiland]"'
        )


def _light(window: Window) -> dict[str, Any]:
    """Pupil, the field along the axis, and the wavelength."""
    wavelength = {"value": wavelength_um(window), "is_primary": True, "unit": "um", "weight": 1.0}
    return {
        "aperture": {"type": "EPD", "value": pupil(window)},
        "fields": {
            "fields": [{"x": 0.0, "y": 0.0, "vx": 0.0, "vy": 0.0, "weight": 1.0}],
            "telecentric": False,
            "field_definition": {"field_type": "AngleField"},
        },
        "wavelengths": {"wavelengths": [wavelength], "polarization": "ignore"},
    }


def optiland_document(window: Window) -> dict[str, Any]:
    """Content of the file: the input of `optiland.optic.Optic.from_dict`, and an additional key for what that
    lacks.

    Raises NotPossible: No surface of optiland is close enough to a face.
    """
    faces = stations(window)
    low = min(float(one.vertex[2]) for one in faces) - pupil(window)
    plane = {"type": "Plane", "radius": inf}
    rows = [
        {
            "type": "ObjectSurface",
            "geometry": plane | {"cs": _frame(np.array([0.0, 0.0, -inf]), np.eye(3))},
            "material_post": _material(1.0),
            "comment": "object",
        },
        _surface("before the first face", plane, np.array([0.0, 0.0, low]), np.eye(3), 1.0, stop=True),
    ]
    worst = 0.0
    for one in faces:
        geometry, error = _geometry(one)
        worst = max(worst, error)
        rows.append(_surface(one.name, geometry, one.vertex, one.rotation, one.index))
    rows.append(_surface("image", plane, np.array([0.0, 0.0, image_height(window)]), np.eye(3), 1.0))
    return {
        "version": 1.0,
        "name": f"{window.name}, one telescopelet",
        **_light(window),
        "apodization": None,
        "pickups": [],
        "solves": {"solves": []},
        "surface_group": {"surfaces": rows},
        "clacad": {
            "unit": "mm",
            "frame": "sheet frame, light towards +z, the centre of lens 1's cell at x = y = 0",
            "left_out": left_out(window),
            "faces": told_of_faces(worst),
            "largest_slope_error": worst,
        },
    }


def told_of_faces(worst: float) -> str:
    """Text on the accuracy of the faces; `worst`: largest slope error of any series, radians."""
    if not worst:
        return "every face is held exactly"
    return (
        f"faces of two radii to the last digit: they are polynomials within {worst:.1g} rad of the faces'"
        " slope over the cell, for optiland has no such surface"
    )


def _surface(
    name: str, geometry: dict[str, Any], place: Floats, turn: Floats, index: float, stop: bool = False
) -> dict[str, Any]:
    return {
        "type": "Surface",
        "thickness": 0.0,
        "geometry": geometry | {"cs": _frame(place, turn)},
        "material_post": _material(index),
        "is_stop": stop,
        "aperture": None,
        "comment": name,
        "interaction_model": {
            "type": "RefractiveReflectiveModel",
            "is_reflective": False,
            "coating": None,
            "bsdf": None,
        },
    }


def _material(index: float) -> dict[str, Any]:
    model = {"class": "HomogeneousPropagation"}
    return {"type": "IdealMaterial", "propagation_model": model, "index": float(index), "absorp": 0.0}


def _frame(place: Floats, turn: Floats) -> dict[str, Any]:
    """Pose in the form of optiland: R = Rz Ry Rx of three angles, radians."""
    tilt = hypot(turn[0, 0], turn[1, 0])
    angles = {
        "rx": atan2(turn[2, 1], turn[2, 2]),
        "ry": atan2(-turn[2, 0], tilt),
        "rz": atan2(turn[1, 0], turn[0, 0]),
    }
    x, y, z = (float(v) + 0.0 for v in place)
    return {"x": x, "y": y, "z": z, **{k: v + 0.0 for k, v in angles.items()}, "reference_cs": None}


def _geometry(one: Station) -> tuple[dict[str, Any], float]:
    """Geometry of a face, and the deviation of its slope from the face's (radians)."""
    (cx, cy), (kx, ky) = one.curvature, one.conic
    if one.flat:
        return {"type": "Plane", "radius": inf}, 0.0
    if one.rotational and not one.polynomial:
        return {"type": "StandardGeometry", "radius": 1.0 / cx, "conic": kx}, 0.0
    solving = {"tol": NEWTON * min(one.reach), "max_iter": 100}
    if (cx == 0.0 or cy == 0.0) and not one.polynomial:
        radii = {"radius_x": 1.0 / cx if cx else inf, "radius_y": 1.0 / cy if cy else inf}
        return {"type": "BiconicGeometry", **radii, "conic_x": kx, "conic_y": ky, **solving}, 0.0
    terms, error = terms_needed(one)
    mean = 0.5 * (cx + cy)
    table = series(one, terms)
    table[2][0] -= 0.5 * mean
    table[0][2] -= 0.5 * mean
    base = {"radius": 1.0 / mean if mean else inf, "conic": -1.0}
    return {"type": "PolynomialGeometry", **base, "coefficients": table, **solving}, error


def terms_needed(one: Station) -> tuple[int, float]:
    """Fewest powers of w that represent a face within `SLOPE` over its cell, and the remaining slope error.

    Raises NotPossible.
    """
    (cx, cy), (x, y) = np.abs(one.curvature), one.reach
    ax, ay = (abs((1.0 + k) * c * c) for k, c in zip(one.conic, one.curvature))
    w, q = ax * x * x + ay * y * y, cx * x * x + cy * y * y
    if w < 1.0:
        factor, tail = 0.5, []
        for m in range(20 * MOST_TERMS):
            grown = m * q * w ** (m - 1) if m else 0.0
            tail.append(
                factor * hypot(*(2.0 * (c * w**m + a * grown) * r for c, a, r in ((cx, ax, x), (cy, ay, y))))
            )
            factor *= (2 * m + 1) / (2 * m + 4)
        left = np.cumsum(tail[::-1])[::-1]
        enough = np.flatnonzero(left[1:] <= SLOPE)
        if len(enough) and enough[0] + 1 <= MOST_TERMS:
            return int(enough[0]) + 1, float(left[enough[0] + 1])
    raise NotPossible(
        f"optiland: {one.name} is too steep at its corners (w = {w:.2g}; below about 0.6 can be held): none"
        " of optiland's surfaces is a face of two radii, and the series that replaces it does not converge"
        " soon enough; use format zmx"
    )


def series(one: Station, terms: int) -> list[list[float]]:
    """Coefficients of x^i y^j of a face, row i, column j; `terms` powers of w."""
    cx, cy = one.curvature
    ax, ay = ((1.0 + k) * c * c for k, c in zip(one.conic, one.curvature))
    wide = max([2 * terms, *(2 * (len(own) - 1) for own in one.terms if any(own))]) + 1
    table = np.zeros((wide, wide))
    factor = 0.5
    for m in range(terms):
        for k in range(m + 1):
            share = factor * comb(m, k) * ax**k * ay ** (m - k)
            table[2 * k + 2, 2 * (m - k)] += share * cx
            table[2 * k, 2 * (m - k) + 2] += share * cy
        factor *= (2 * m + 1) / (2 * m + 4)
    for own in one.terms:
        for j, term in enumerate(own):
            if term:
                table[2 * (len(own) - 1 - j), 2 * j] += term
    return [[float(v) + 0.0 for v in row] for row in table]


def write_optiland(window: Window, path: Path) -> dict[str, Any]:
    """Write the file, with infinities as optiland itself writes and reads them. Returns its content.

    Raises NotPossible.
    """
    document = optiland_document(window)
    text = json.dumps(document, sort_keys=True, indent=1, ensure_ascii=False) + "\n"
    path.write_text(text, encoding="utf-8", newline="\n")
    return document


# -- reading back --------------------------------------------------------------------------------------


def optiland_directions(
    path: str, start: list[list[float]], direction: list[list[float]]
) -> list[list[float]]:
    """Directions (n, 3) that optiland computes for rays (mm) through a file; NaN as null. Run it in a
    separate process.

    Raises NotPossible, UnreadableFile, OverBudget.
    """
    require_optiland()
    import warnings

    Spending("prescription", path)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        from optiland.fileio import load_optiland_file
        from optiland.rays import RealRays

        try:
            lens = load_optiland_file(path)
        except (ValueError, KeyError, TypeError) as error:
            raise UnreadableFile(f"{Path(path).name}: optiland does not read it ({error})") from error
        columns = [np.array(column) for column in (*zip(*start), *zip(*direction))]
        one = np.ones(len(start))
        rays = RealRays(*columns, one, one * lens.primary_wavelength)
        lens.surfaces.trace(rays)
    found = np.column_stack([np.asarray(v, dtype=np.float64) for v in (rays.L, rays.M, rays.N)])
    return [[float(v) for v in row] for row in found]


def check_optiland(window: Window, name: str, found: Floats) -> None:
    """Compare the directions (n, 3) that optiland computed for the rays of `rays_for` with the design's own.

    Raises FileDisagrees.
    """
    start, direction = rays_for(window)
    wanted, inside = through_design(window, start, direction)
    refuse_other_light(name, wanted, found, inside)


def rays_for(window: Window) -> tuple[Floats, Floats]:
    """Starts (mm) and directions, (n, 3) each, of the rays that are sent through a file."""
    return from_own_cell(window, probe(window))
