"""Surface equation and pose table: what a tool-path programmer needs to cut the faces without CAD."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Iterator
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.base.units import POWER
from clacad.formats.maps.sag import structured_faces
from clacad.optics.law.orientation import rotation_degrees
from clacad.optics.surface import EvenPolynomial
from clacad.sheet.window import Face, Window, lens_height
from clacad.storage.atomic import canonical_json
from clacad.storage.errors import FileDisagrees, UnreadableFile

EQUATION = {
    "quadric": (
        "cx x^2 + cy y^2 + kappa z^2 - 2 side z = 0, the half nearer the apex, in the lens frame (apex at the"
        " origin)"
    ),
    "biconic": (
        "z = side q / (1 + sqrt(1 - (1+Kx) cx^2 x^2 - (1+Ky) cy^2 y^2)), q = cx x^2 + cy y^2, in the lens"
        " frame"
    ),
}
POLYNOMIAL = {
    "even polynomial": (
        "z = side (q / (1 + sqrt(1 - (1+Kx) cx^2 x^2 - (1+Ky) cy^2 y^2)) + a x^4 + b x^2 y^2 + c y^4), "
        "a4 = [a, b, c], q = cx x^2 + cy y^2, in the lens frame"
    )
}
HIGHER = (
    "; in the bracket also + a6 . (x^6, x^4 y^2, x^2 y^4, y^6) + a8 . (x^8, x^6 y^2, x^4 y^4, x^2 y^6, y^8)"
)
STRETCHED = ", a term x^m y^n by its power n (m + n - 1)/(m + n)"
COLUMNS = ("face", "i", "j", "apex_x_mm", "apex_y_mm", "apex_z_mm", "phi_deg", "theta_deg", "psi_deg")


def columns(window: Window) -> tuple[str, ...]:
    """Head of the pose table; for lenses of several sizes with size and apex radius of each, negative where
    concave; for cells with an η along each axis the radius along x, and the aspect.
    """
    sizes = ("size", "apex_radius_mm", "aspect")[: 3 if window.many_aspects else 2]
    return (*COLUMNS, *sizes) if window.many_sizes else COLUMNS


def surface_table(window: Window, scale: float) -> dict[str, Any]:
    """Everything about the faces in millimetres: equation, coefficients, pose in the cell, lattice.

    scale : Millimetres per design unit.
    """
    lattice = window.lattice
    return {
        "format": 1,
        "unit": "mm",
        "name": window.name,
        "form": window.form,
        "frame": "sheet frame, right-handed; light travels towards +z; lens to sheet: P = R p + apex",
        "equations": EQUATION | _of_polynomials(window),
        "euler": "R = Rz(psi) Rx(theta) Rz(phi) about the fixed sheet axes",
        "lattice": {
            "kind": lattice.kind,
            "pitch_mm": [p * scale for p in lattice.pitch],
            "count": list(lattice.count),
            "a1_mm": [v * scale for v in lattice.a1],
            "a2_mm": [v * scale for v in lattice.a2],
            "first_centre_mm": [v * scale for v in lattice.first_centre],
            "seam_mm": window.land.seam * scale,
        },
        "bodies": [
            {"name": body.name, "index": body.index, "material": getattr(body.material, "name", None)}
            for body in window.bodies
        ],
        "faces": [
            _face(window, body.name, face, label, scale) | _of_its_own(window, face, scale)
            for body in window.bodies
            for face, label in ((body.front, f"{body.name}-front"), (body.back, f"{body.name}-back"))
        ],
    }


def _of_its_own(window: Window, face: Face, scale: float) -> dict[str, Any]:
    """Additional entries of a face on a non-uniform sheet: pitch of its array, and home of its apexes."""
    found: dict[str, Any] = {}
    place = None if face.array is None else window.placements[face.array]
    if place is not None and place.pitch is not None:
        found["cells_pitch_mm"] = [p * scale for p in place.lattice(window.lattice).pitch]
    if place is not None and place.turn:
        found["cells_turned_deg"] = degrees(place.turn)
    if face.change is not None:
        found |= {
            "apex_in_cell_mm": [None, None, face.vertex[2] * scale if face.change.level else None],
            "apex": "cell by cell in the pose table",
        }
    if face.change is not None and face.change.size is not None:
        found |= {
            "apex_radius_x_mm": None,
            "apex_radius_y_mm": None,
            "size": (
                "cell by cell in the pose table: the face of a cell is the one of these coefficients, all"
                " lengths times its size"
            ),
        }
    if face.own_axes:
        found |= {"rotation": None, "axes": "cell by cell in the pose table"}
    if face.change is not None and face.change.aspect is not None:
        found["aspect"] = (
            "cell by cell in the pose table: first the curvature along y is multiplied by it, and kappa by"
            " its square root"
        ) + STRETCHED * isinstance(face.surface, EvenPolynomial)
    return found


def _of_polynomials(window: Window) -> dict[str, str]:
    """The equation of even polynomials, to the highest order present."""
    surfaces = [face.surface for face in window.faces if isinstance(face.surface, EvenPolynomial)]
    if not any(any(surface.a6) or any(surface.a8) for surface in surfaces):
        return POLYNOMIAL if surfaces else {}
    return {name: equation + HIGHER for name, equation in POLYNOMIAL.items()}


def _face(window: Window, body: str, face: Face, label: str, scale: float) -> dict[str, Any]:
    """One face as the surface table lists it; `scale`: millimetres per design unit."""
    surface: Any = face.surface
    plain: dict[str, Any] = {
        "face": label,
        "body": body,
        "side": face.side,
        "curvature_x_per_mm": surface.curvature_x / scale,
        "curvature_y_per_mm": surface.curvature_y / scale,
        "array": face.array,
        "cells_shift_mm": None if face.array is None else [v * scale for v in window.shifts[face.array]],
        "apex_in_cell_mm": [v * scale for v in face.vertex],
        "rotation": face.rotation.tolist(),
        "land_z_mm": None if face.land is None else face.land * scale,
    }
    if hasattr(surface, "kappa"):
        plain |= {"equation": "quadric", "kappa_per_mm": surface.kappa / scale}
    else:
        plain |= {"equation": "biconic", "conic_x": surface.conic_x, "conic_y": surface.conic_y}
    if hasattr(surface, "a4"):
        plain |= {"equation": "even polynomial", "a4_per_mm3": [term / scale**3 for term in surface.a4]}
        for order in ("a6", "a8"):
            if any(getattr(surface, order)):
                power = POWER[order]
                plain[f"{order}_per_mm{power}"] = [term / scale**power for term in getattr(surface, order)]
    for axis in ("x", "y"):
        c = getattr(surface, f"curvature_{axis}") / scale
        plain[f"apex_radius_{axis}_mm"] = 1.0 / c if c else None
        if plain["equation"] == "quadric":
            plain[f"conic_{axis}"] = plain["kappa_per_mm"] / c - 1.0 if c else None
    return plain


def write_table_json(window: Window, path: Path, scale: float) -> None:
    """Write the surface table as JSON."""
    path.write_text(canonical_json(surface_table(window, scale)), encoding="utf-8", newline="\n")


def write_table_csv(window: Window, path: Path, scale: float) -> int:
    """Write apex and Euler angles of each lenslet face of each cell; return the number of lines."""
    count = 0
    with path.open("w", encoding="ascii", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns(window))
        for line in pose_lines(
            window, scale, (window.lattice.row(j) for j in range(window.lattice.count[1]))
        ):
            writer.writerow(line)
            count += 1
    return count


def pose_lines(window: Window, scale: float, rows: Iterable[Ints]) -> Iterator[list[str | int]]:
    """Lines of the pose table for some rows of cells, face after face."""
    rows = list(rows)
    for _, face, label in structured_faces(window):
        assert face.array is not None
        for row in rows:
            angles = _angles(window, face, row)
            apexes = window.vertices(face, row)
            if face.change is None:
                apexes = np.asarray(face.vertex)
            places = (window.centres(face.array, row) + apexes[..., :2]) * scale + 0.0
            heights = np.broadcast_to(apexes[..., 2] * scale, len(row)).tolist()
            sizes = _sizes(window, face, row, scale)
            own = zip(row.tolist(), places.tolist(), heights, angles, sizes, strict=True)
            for (i, j), (x, y), z, turns, size in own:
                yield [label, i, j, repr(x), repr(y), repr(z), *turns, *size]


def _angles(window: Window, face: Face, row: Ints) -> list[list[str]]:
    """φ, θ, ψ in degrees of the lens of each cell of a row (n, 2)."""
    turns = window.lenses(face, row).rotation
    each = [face.rotation] if turns is None else turns
    found = [[repr(v) for v in euler_degrees(one)] for one in each]
    return found * len(row) if turns is None else found


def _sizes(window: Window, face: Face, row: Ints, scale: float) -> list[tuple[str, ...]]:
    """Size, apex radius (mm) and aspect of the lens of each cell of a row (n, 2), as `columns` has them."""
    if not window.many_sizes:
        return [()] * len(row)
    places = window.lenses(face, row)
    size, aspect = (np.ones(len(row)) if one is None else one for one in (places.size, places.aspect))
    told = [size, scale * size / face.surface.curvature_x, aspect][: 3 if window.many_aspects else 2]
    return [tuple(map(repr, line)) for line in np.stack(told, axis=-1).tolist()]


def euler_degrees(r: Floats) -> tuple[float, float, float]:
    """φ, θ, ψ in degrees of R = Rz(ψ) Rx(θ) Rz(φ); an untilted lens has θ = 0 and ψ = 0."""
    theta = float(np.arctan2(np.hypot(r[0, 2], r[1, 2]), r[2, 2]))
    if np.hypot(r[0, 2], r[1, 2]) < 1e-12:
        return float(np.degrees(np.arctan2(r[1, 0], r[0, 0]))), 0.0, 0.0
    psi = np.arctan2(r[0, 2], -r[1, 2])
    phi = np.arctan2(r[2, 0], r[2, 1])
    return float(np.degrees(phi)), float(np.degrees(theta)), float(np.degrees(psi))


def check_table(window: Window, json_path: Path, csv_path: Path, scale: float, count: int) -> None:
    """Reconstruct heights from the two files alone and compare them with the design.

    The equation is solved here from the written coefficients, by bisection, not with the package's surfaces.

    Raises FileDisagrees, UnreadableFile.
    """
    try:
        table = json.loads(json_path.read_text(encoding="utf-8"))
        faces = {entry["face"]: entry for entry in table["faces"]}
        with csv_path.open(encoding="ascii", newline="") as stream:
            rows = list(csv.DictReader(stream))
    except (ValueError, KeyError, TypeError) as error:
        raise UnreadableFile(f"{json_path.name}: damaged ({error})") from error
    if len(rows) != count:
        raise FileDisagrees(f"{csv_path.name}: {len(rows)} lenslets were read back, {count} were written")
    chance = np.random.default_rng(0)
    for body, face, label in structured_faces(window):
        entry = faces[label]
        mine = [row for row in rows if row["face"] == label]
        for row in (mine[k] for k in chance.integers(0, len(mine), 50)):
            _check_pose(window, face, entry, row, scale, json_path.name, body.name)


def _check_pose(
    window: Window, face: Face, entry: dict[str, Any], row: dict[str, str], scale: float, name: str, body: str
) -> None:
    """Reject a row whose lens, at the pose it states, differs from the design's lens there."""
    assert face.array is not None
    apex = np.array([float(row[f"apex_{axis}_mm"]) for axis in "xyz"])
    index = np.array([int(row["i"]), int(row["j"])])
    centre = window.centres(face.array, index)
    reach = 0.3 * min(window.lattice.pitch)
    x, y = np.array([0.0, reach, -reach, 0.4 * reach]), np.array([0.0, reach, 0.5 * reach, -reach])
    z = lens_height(window.in_cell(face, index), x, y)
    points = np.column_stack([x + centre[0], y + centre[1], z])[np.isfinite(z)] * scale
    turn = rotation_degrees(float(row["phi_deg"]), float(row["theta_deg"]), float(row["psi_deg"]))
    local = (points - apex) @ turn / float(row.get("size") or 1.0)
    for key, power in (("curvature_y_per_mm", 1.0), ("kappa_per_mm", 0.5)):
        if key in entry and row.get("aspect"):
            entry = entry | {key: entry[key] * float(row["aspect"]) ** power}
    left = _equation(entry, local)
    if not len(points) or np.abs(left).max() > 1e-13 * max(float(np.abs(points).max()), reach * scale):
        raise FileDisagrees(
            f"{name}: the written equation and pose do not give the {body} face of cell {tuple(index)}"
        )


def _equation(entry: dict[str, Any], p: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Height error of lens-frame points against the written equation, to first order."""
    cx, cy, side = entry["curvature_x_per_mm"], entry["curvature_y_per_mm"], entry["side"]
    x, y, z = p.T
    q = cx * x * x + cy * y * y
    if entry["equation"] == "quadric":
        return np.asarray(0.5 * (q + entry["kappa_per_mm"] * z * z - 2 * side * z))
    root = 1 - (1 + entry["conic_x"]) * (cx * x) ** 2 - (1 + entry["conic_y"]) * (cy * y) ** 2
    height = q / (1 + np.sqrt(root))
    for order, power in POWER.items():
        terms = entry.get(f"{order}_per_mm{power}", ())
        for j, term in enumerate(terms):
            height = height + term * x ** (2 * (len(terms) - 1 - j)) * y ** (2 * j)
    return np.asarray(side * height - z)
