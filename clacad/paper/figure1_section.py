"""The paper's Fig. 1(a): one telescopelet in cross-section, to scale, with traced rays, as SVG.

The drawing follows the traced design: lens outlines are the design's own faces cut by y = 0. Rays are traced
through them surface by surface, and the law's direction is compared with that of ideal lenses.
"""

from __future__ import annotations

from html import escape

import numpy as np

from clacad.base.text import mrad_text
from clacad.base.types import Floats
from clacad.design import Design
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import trace_sequence
from clacad.prescription.prescribe import prescribe
from clacad.sheet.like_cell import interfaces
from clacad.sheet.window import Face, Window
from clacad.tracing.trace import trace

RAYS = 7
ASIDE = -0.07
"""Slope of the incident bundle against the line through both lens centres."""
WIDTH = 900.0
"""Width of the drawing, user units."""
SHARE = 0.92
"""Part of the half cell that is drawn."""


def section_svg(design: Design) -> str:
    """Draw a design's telescopelet and a bundle of parallel rays through it.

    design : Its optical axis must lie in the x, z plane: euler = (-90, θ, 90) turns it by θ towards +x.
    Raises ValueError: The axis leaves the drawn plane.
    """
    window = prescribe(design).with_cells((1, 1))
    rotation = window.thin.rotation
    if abs(rotation[1, 2]) > 1e-12 or abs(rotation[1, 0]) > 1e-12:
        raise ValueError("the optical axis of this design leaves the plane of the drawing (x, z)")
    paths, directions = _rays(window)
    (f1, _), (f2, _) = window.thin.focal_length
    lens1, lens2 = np.zeros(3), np.array(window.thin.offset)
    axis, across = rotation[:, 2], rotation[:, 0]
    focus = lens1 + f1 * axis + f1 * _slope(window) * across
    half = 0.5 * window.lattice.pitch[0]
    outlines = [_outline(window, body_index, half * SHARE) for body_index in range(len(window.bodies))]
    every = np.concatenate([*paths, *outlines])
    canvas = _Canvas(every[:, [2, 0]].min(axis=0), every[:, [2, 0]].max(axis=0))
    parts = [canvas.shape(outline, "lens") for outline in outlines]
    parts += [canvas.line(path, "ray") for path in paths]
    parts.append(canvas.line(np.array([-0.3 * f1 * axis, (f1 + f2) * axis]), "axis"))
    parts.append(canvas.line(np.array([lens2 - f2 * axis, lens2 + 0.4 * f1 * axis]), "axis"))
    plane = lens1 + f1 * axis
    parts.append(canvas.line(np.array([plane - 1.2 * half * across, plane + 1.2 * half * across]), "plane"))
    parts.append(canvas.dot(focus))
    parts += _labels(canvas, window, focus, plane, half)
    parts += canvas.caption(_caption(design, window, directions))
    return canvas.svg(parts)


def _slope(window: Window) -> float:
    """Slope of the bundle against the lens axis at which it finds lens 2."""
    offset = np.array(window.thin.offset)
    return float(offset @ window.thin.rotation[:, 0]) / window.thin.separation + ASIDE


def parallel_bundle(window: Window) -> tuple[Floats, Floats]:
    """Starts and directions (7, 3) of parallel rays that fill the middle of lens 1, lengths of the window."""
    rotation, half = window.thin.rotation, 0.5 * window.lattice.pitch[0]
    direction = rotation[:, 2] + _slope(window) * rotation[:, 0]
    direction = direction / np.linalg.norm(direction)
    at = np.linspace(-0.6, 0.6, RAYS)[:, None] * half * rotation[:, 0]
    reach = 0.9 * window.thin.focal_length[0][0]
    return at - reach * direction, np.tile(direction, (RAYS, 1))


def _rays(window: Window) -> tuple[list[Floats], Floats]:
    start, direction = parallel_bundle(window)
    result = trace_sequence(interfaces(window), Rays(start, direction), record=True)
    assert result.hits is not None
    reach = 0.9 * window.thin.focal_length[0][0]
    end = result.position + reach * result.direction
    paths = [np.vstack([start[k], result.hits[:, k], end[k]]) for k in range(RAYS)]
    return paths, result.direction


def _outline(window: Window, number: int, half: float) -> Floats:
    """Closed outline (k, 3) of a lens in the plane y = 0."""
    body = window.bodies[number]
    x = np.linspace(-half, half, 121)
    front, back = (_face_points(window, face, x) for face in (body.front, body.back))
    gap = (back - front)[:, 2] if body.front.untilted else (back - front) @ window.thin.rotation[:, 2]
    solid = gap >= 0.0
    return np.concatenate([front[solid], back[solid][::-1]])


def _face_points(window: Window, face: Face, x: Floats) -> Floats:
    """Points of a face over lens coordinates x, y = 0."""
    shift = (0.0, 0.0) if face.array is None else window.shifts[face.array]
    z = face.surface.sag(x, np.zeros_like(x))
    local = np.column_stack([x, np.zeros_like(x), z])
    return np.asarray(local @ face.rotation.T + np.array(face.vertex) + np.array([*shift, 0.0]))


def _caption(design: Design, window: Window, directions: Floats) -> list[str]:
    start, direction = parallel_bundle(window)
    thin = trace(window, Rays(start, direction), rung="thin", path="size")
    asked = window.law.refract(direction)
    alive = thin.fate == Fate.ALIVE
    off = np.linalg.norm(np.cross(thin.direction, asked), axis=1)[alive].max(initial=0.0)
    spread = np.linalg.norm(np.cross(directions, asked), axis=1).max()
    return [
        f"{window.name} with {design.law_spec.words()}, to scale.",
        f"Ideal lenses obey the law to {off:.0e} rad, the drawn thick ones to {mrad_text(spread, 2)}"
        " over this bundle.",
    ]


def _labels(canvas: _Canvas, window: Window, focus: Floats, plane: Floats, half: float) -> list[str]:
    """SVG of the measures and names: focus and plane (3,), half width of the section, lengths."""
    rotation = window.thin.rotation
    axis, across = rotation[:, 2], rotation[:, 0]
    (f1, _), (f2, _) = window.thin.focal_length
    lens2 = np.array(window.thin.offset)
    foot = lens2 - (lens2 @ across) * across
    below = -1.35 * half * across
    found = [
        canvas.text(focus + 0.12 * half * across, "F", "start"),
        canvas.arrow(below, plane + below, "f₁"),
        canvas.arrow(plane + below, foot + below, "f₂"),
        *_offset(canvas, foot, lens2, axis, f2),
        canvas.text(plane + 1.3 * half * across, "common focal plane", "end"),
        canvas.line(np.array([[0.0, 0.0, -0.9 * f1], [0.0, 0.0, 0.0]]), "normal"),
        canvas.text(np.array([0.10 * half, 0.0, -0.9 * f1]), "sheet normal", "start"),
    ]
    if rotation[0, 2] != 0.0:
        angle = np.degrees(np.arctan2(rotation[0, 2], rotation[2, 2]))
        found.append(
            canvas.text(foot - 0.35 * half * across, f"axis of lens 1, tilted by θ = {angle:.3g}°", "start")
        )
    return found


def _offset(canvas: _Canvas, foot: Floats, lens2: Floats, axis: Floats, f2: float) -> list[str]:
    """The offset d of lens 2 as an arrow from one axis to the other, clear of both lenses and of the rays."""
    d = lens2 - foot
    if np.linalg.norm(d) < 1e-9 * f2:
        return []
    back = -0.62 * f2 * axis
    return [
        canvas.arrow(foot + back, lens2 + back, ""),
        canvas.text(foot + back + 0.6 * d - 0.06 * f2 * axis, "d", "end"),
    ]


class _Canvas:
    """Transformation from sheet (z to the right, x up) to drawing coordinates, and pieces of an SVG text."""

    def __init__(self, low: Floats, high: Floats) -> None:
        margin = 0.08 * float((high - low)[0])
        self.low, self.high = low - margin, high + margin
        self.scale = WIDTH / float((self.high - self.low)[0])
        self.height = float((self.high - self.low)[1]) * self.scale

    def _at(self, point: Floats) -> str:
        x, y = (point[2] - self.low[0]) * self.scale, (self.high[1] - point[0]) * self.scale
        return f"{x:.2f},{y:.2f}"

    def line(self, points: Floats, kind: str) -> str:
        return f'<polyline class="{kind}" points="{" ".join(self._at(p) for p in points)}"/>'

    def shape(self, points: Floats, kind: str) -> str:
        return f'<polygon class="{kind}" points="{" ".join(self._at(p) for p in points)}"/>'

    def dot(self, point: Floats) -> str:
        x, y = self._at(point).split(",")
        return f'<circle class="dot" cx="{x}" cy="{y}" r="4"/>'

    def text(self, point: Floats, words: str, anchor: str) -> str:
        x, y = self._at(point).split(",")
        return f'<text x="{x}" y="{y}" text-anchor="{anchor}">{escape(words)}</text>'

    def arrow(self, start: Floats, end: Floats, words: str) -> str:
        x, y = self._at(0.5 * (start + end)).split(",")
        label = (
            f'<text x="{x}" y="{float(y) - 7:.2f}" text-anchor="middle">{escape(words)}</text>'
            if words
            else ""
        )
        return self.line(np.array([start, end]), "measure") + label

    def caption(self, lines: list[str]) -> list[str]:
        return [
            f'<text class="caption" x="12" y="{self.height + 14 + 18 * k:.2f}">{escape(words)}</text>'
            for k, words in enumerate(lines)
        ]

    def svg(self, parts: list[str]) -> str:
        """The whole drawing of the given parts."""
        style = (
            "text{font:15px"
            " system-ui,sans-serif;fill:#333;paint-order:stroke;stroke:#fff;"
            "stroke-width:4px;stroke-linejoin:round}"
            ".caption{font-size:13px}polyline{fill:none}"
            ".lens{fill:#bcd9ee;fill-opacity:.75;stroke:#3b6f9c}.ray{stroke:#c4483a;stroke-width:1.4}"
            ".axis{stroke:#555;stroke-dasharray:9 3 2 3}.plane{stroke:#2b7a4b;stroke-dasharray:5 4}"
            ".normal{stroke:#999}.measure{stroke:#333;marker-start:url(#a);marker-end:url(#a)}"
            ".dot{fill:#c4483a}"
        )
        marker = (
            '<defs><marker id="a" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
            'orient="auto-start-reverse"><path d="M0,1 L9,5 L0,9 z" fill="#333"/></marker></defs>'
        )
        body = "\n".join(part for part in parts if part)
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH:.0f}" height="{self.height + 44:.0f}"'
            f' viewBox="0 0 {WIDTH:.0f} {self.height + 44:.0f}" role="img" aria-label="cross-section of a'
            f' lenslet pair with rays">\n<style>{style}</style>{marker}\n<rect width="100%" height="100%"'
            f' fill="#fff"/>\n{body}\n</svg>\n'
        )
