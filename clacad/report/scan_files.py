"""A scan as files: table, picture, page on which a slider moves the plates.

The page shows a section with rays, the numbers and the orders of a position.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from clacad.base.drawn_figure import drawn, inline_svg, no_formula
from clacad.base.text import plain
from clacad.optics.rays import Fate, Rays
from clacad.prescription.prescribe import prescribe
from clacad.sheet.face_order import plates_of
from clacad.sheet.moved_plates import moved_plates
from clacad.sheet.window import Face, Window, face_height
from clacad.steering.scan import Scan, Steered
from clacad.tracing.trace import trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from clacad.design import Design

SIZE = (9.6, 6.4)
STYLE = {
    "font.size": 9.0,
    "svg.hashsalt": "clacad",
    "svg.fonttype": "path",
    "axes.grid": True,
    "grid.color": "#e3e8ec",
}
RAYS, PARAXIAL, WAVES = "#1b6ca8", "#8b98a5", "#c2571a"


def csv_text(found: Steered) -> str:
    """Table of a scan as CSV: travel in the design unit, slopes, radians, 1/m; empty where not known."""
    columns = found.to_columns()
    rows = zip(*columns.values(), strict=True)
    return "".join(",".join(map(_cell, row)) + "\n" for row in (columns, *rows))


def _cell(value: Any) -> str:
    """Shortest text that reads back exactly."""
    if isinstance(value, float):
        return repr(value) if np.isfinite(value) else ""
    return str(value)


def picture(found: Steered, format: Literal["png", "svg"] = "png") -> bytes:
    """Slope, spread, share and efficiency along a scan, as the bytes of a picture."""
    return drawn(format, SIZE, lambda figure: draw(figure, found), STYLE)


def draw(figure: Figure, found: Steered) -> None:
    """Draw a scan on a given figure."""
    columns = {name: np.array(values, dtype=float) for name, values in found.to_columns().items()}
    travel, slope = columns["travel"], columns["slope"]
    (steered, bent), (spread, light) = figure.subplots(2, 2, sharex=True)
    closed = columns[f"closed_form_{'xy'[found.along]}"]
    dots: dict[str, Any] = {"marker": "o", "ms": 3, "color": RAYS, "lw": 1.2}
    dashed: dict[str, Any] = {"ls": "--", "color": PARAXIAL, "lw": 1.0}
    if found.axis == "z":
        steered.plot(travel, columns["power"], label="traced", **dots)
        steered.set_ylabel("convergence (1/m)")
    else:
        steered.plot(travel, 1e3 * slope, label="traced", **dots)
        steered.plot(travel, 1e3 * closed, label="paraxial", **dashed)
        steered.set_ylabel("exit slope (1e-3)")
    bent.plot(travel, 1e3 * (slope - closed), **dots)
    bent.set_ylabel("traced minus paraxial (1e-3)")
    spread.plot(travel, 1e3 * columns["spread"], label="rays", **dots)
    spread.axhline(500.0 * found.order_step[found.along], label="half an order", **dashed)
    spread.set_ylabel("rms spread (mrad)")
    spread.set_ylim(bottom=0.0)
    light.plot(travel, columns["share"], label="share, rays", **dots)
    light.plot(travel, columns["exit_beam_over_pitch"], label="exit beam / pitch", **dashed)
    waves = columns["efficiency_on_order"]
    if np.isfinite(waves).any():
        light.plot(travel, waves, label="efficiency, on order", **dots | {"marker": "s", "color": WAVES})
    light.set_ylim(0.0, 1.1)
    for axes in (steered, spread, light):
        axes.legend(fontsize=8)
    for axes in (spread, light):
        axes.set_xlabel(f"travel along {found.axis} ({found.unit})")
    figure.suptitle(no_formula(f"{found.name}: {moves_text(found)}"), fontsize=10)


def moves_text(found: Steered) -> str:
    """Plates that move, with their part of the travel."""
    plates = ", ".join(f"plate {number} by {part:g}" for number, part in found.moves.items())
    reach = max(abs(one.travel) for one in found.positions)
    return f"{plates} x ±{reach:g} {found.unit} along {found.axis}"


PATHS = 9
"""Rays drawn through the middle cell."""

POINTS = 33
"""Points of a drawn face across a cell."""

AROUND = 2
"""Cells drawn on either side of the middle one."""


def page(design: Design, found: Steered) -> str:
    """The page as one HTML text that needs no network; every text of the design is escaped in it."""
    from markupsafe import Markup

    from clacad.report.self_contained import HERE, environment, policy_hash

    window = prescribe(design)
    script = (HERE / "scan.js").read_text(encoding="utf-8")
    scan = found.to_dict() | {"sections": _sections(window, found)}
    return (
        environment()
        .get_template("scan_page.html.j2")
        .render(
            name=found.name,
            moves=moves_text(found),
            found=found,
            figure=Markup(inline_svg(picture(found, "svg").decode())),
            scan=json.dumps(plain(scan), sort_keys=True, allow_nan=False),
            digest=policy_hash(script),
            script=Markup(script),
            middle=len(found.positions) // 2,
        )
    )


def _sections(window: Window, found: Steered) -> list[dict[str, Any]]:
    """Faces and rays of each position in the plane of travel; lengths, [across, z] each."""
    scan, few = Scan(1.0, found.axis, found.moves), window.with_cells((9, 9))
    return [
        _section(moved_plates(few, scan.displacements(few, one.travel)), found.along)
        for one in found.positions
    ]


def _section(window: Window, along: int) -> dict[str, Any]:
    """Faces and rays of a sheet in the plane of one axis through the middle cell."""
    pitch = window.lattice.pitch[along]
    faces = [
        [_face(window, face, along) for body in plate for face in (body.front, body.back)]
        for plate in plates_of(window.bodies)
    ]
    start = np.zeros((PATHS, 3))
    start[:, along] = (np.arange(PATHS) + 0.5) / PATHS * pitch - 0.5 * pitch
    low, high = window.z_range
    room = 0.3 * (high - low)
    start[:, 2] = low - room
    seen = trace(window, Rays(start, (0.0, 0.0, 1.0)), record=True, path="numpy")
    assert seen.hits is not None  # recorded
    out = seen.position + seen.direction / seen.direction[:, 2:] * (high + room - seen.position[:, 2:])
    points = np.concatenate([start[None], seen.hits, out[None]])[:, :, [along, 2]]
    return {
        "plates": faces,
        "rays": points.transpose(1, 0, 2).round(6).tolist(),
        "wanted": (seen.fate == Fate.ALIVE).tolist(),
    }


def _face(window: Window, face: Face, along: int) -> list[list[float]]:
    """Heights of a face over the cells around the middle one."""
    pitch, array = window.lattice.pitch[along], face.array or 0
    across = np.linspace(-0.5, 0.5, POINTS) * pitch * (1.0 - 1e-9)
    zero = np.zeros_like(across)
    height = face_height(window, face, *((across, zero) if along == 0 else (zero, across)))
    shift = window.shifts[array][along]
    found = [np.column_stack([across + shift + cell * pitch, height]) for cell in range(-AROUND, AROUND + 1)]
    return [[round(float(x), 6), round(float(z), 6)] for x, z in np.concatenate(found)]
