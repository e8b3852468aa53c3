"""The paper's Figure 1: what is found in its section and in its solids.

A picture of the sheet itself: its bodies as tinted solids over the scene, for the paper's Fig. 1(b).

The glass is drawn, not traced: each body is a lit, half-transparent surface, so that the shape of the lenses
is visible. `clacad.rendering.view` renders the view *through* a sheet.

The paper's Fig. 1 as numbers: the drawn section traced as ideal lenses, the drawn solids as they are.

Fig. 1(a) is compared with the rays of ideal lenses (the drawn thick lenses follow them to their aberration).
Fig. 1(b) is measured on the corners of the drawn triangles: each lens is fitted by quadrics, as a part would
be measured. Corners are rounded to about a millionth of a cell, so a fitted axis is good to 0.005 degrees.

The paper's Fig. 1(a): one telescopelet in cross-section, to scale, with traced rays, as SVG.

The drawing follows the traced design: lens outlines are the design's own faces cut by y = 0. Rays are traced
through them surface by surface, and the law's direction is compared with that of ideal lenses.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from html import escape

import numpy as np

from clacad.base.text import mrad_text
from clacad.base.types import Bytes, Floats
from clacad.design import Design
from clacad.mesh import BodyMesh, Mesh, check_closed, tessellate
from clacad.mesh.body_mesh import facet_tags
from clacad.mesh.cell_template import BACK, FRONT
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import trace_sequence
from clacad.paper.paper_figures import AtlasFinding
from clacad.prescription.prescribe import prescribe
from clacad.rendering.camera import aim, offsets, rays
from clacad.rendering.compiled.scene_hits import look_all
from clacad.rendering.picture_files import encode
from clacad.rendering.scene_arrays import MESH, Primitive, Tables, set_stage, stage_of, tables
from clacad.scene import Scene
from clacad.sheet.like_cell import interfaces
from clacad.sheet.window import Face, Window
from clacad.tracing.facets.hierarchy import mesh_tree
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


CLEAR = 0.45
"""Share of the background that shows through one lit surface."""

QUADS = 8
"""Facets along a cell's side."""


def solid_picture(scene: Scene) -> Bytes:
    """Picture of a scene, its sheet drawn as solids of the colour `sheet.tint`, encoded bytes (h, w, 3)."""
    window = prescribe(scene.design())
    tint = scene.sheet.tint
    scale = scene.unit_m / window.unit
    mesh = sheet_triangles(window)
    corners = np.concatenate([body.vertices[body.triangles] for body in mesh.bodies]) / scale
    background = tables(set_stage(scene))
    glass = tables(
        stage_of(
            [[Primitive(MESH, np.eye(3), np.zeros(3), (0, 0, 0, 0), (tint, tint), tree=mesh_tree(corners))]],
            replace(scene.light, ambient=0.25, key=0.9),
            scene.background,
        )
    )
    view = aim(scene.camera)
    count = scene.camera.samples
    light = np.zeros((view.height * view.width, 3))
    for first in range(0, len(light), 4096):
        pixels = np.arange(first, min(first + 4096, len(light)))
        position, direction = rays(view, pixels, offsets(pixels, 1, count, count))
        light[pixels] = (
            _seen(background, glass, position, direction).reshape(len(pixels), count, 3).mean(axis=1)
        )
    return encode(light.reshape(view.height, view.width, 3), scene.camera.exposure, scene.camera.encoding)


def sheet_triangles(window: Window) -> Mesh:
    """The triangles of a sheet as they are drawn."""
    return tessellate(window, quads=QUADS)


def _seen(background: Tables, glass: Tables, position: Floats, direction: Floats) -> Floats:
    """Background seen through at most four surfaces of glass."""
    n = len(position)
    start, ray = np.array(position, dtype=np.float64), np.ascontiguousarray(direction)
    behind, found = np.empty((n, 3)), np.empty((n, 3))
    met, left, distance = np.empty(n, dtype=np.bool_), np.full(n, np.inf), np.empty(n)
    look_all(background, start, ray, left.copy(), behind, met, left)
    light, through = np.zeros((n, 3)), np.ones(n)
    for _ in range(4):
        look_all(glass, start, ray, left, found, met, distance)
        light += np.where(met, through * (1.0 - CLEAR), 0.0)[:, None] * np.where(met[:, None], found, 0.0)
        through = np.where(met, through * CLEAR, through)
        step = np.where(met, distance * (1.0 + 1e-9) + 1e-9, 0.0)
        start, left = start + step[:, None] * ray, left - step
    return light + through[:, None] * behind


def section_findings(scene: Scene) -> Iterator[AtlasFinding]:
    """Parallel bundle through one telescopelet of ideal lenses: eqs. (1) to (6) of the paper."""
    window = prescribe(scene.design()).with_cells((1, 1))
    start, direction = parallel_bundle(window)
    result = trace(window, Rays(start, direction), rung="thin", record=True, path="size")
    assert result.hits is not None
    axis, across = window.thin.rotation[:, 2], window.thin.rotation[:, 0]
    ((f1, _), (f2, _)), s = window.thin.focal_length, window.thin.separation
    first, second = result.hits
    share = (f1 - first @ axis) / ((second - first) @ axis)  # where each ray crosses the focal plane
    crossing = (first + share[:, None] * (second - first)) @ across
    incident = float(direction[0] @ across / (direction[0] @ axis))
    yield AtlasFinding(
        "section: rays of the bundle that pass both lenses",
        float(np.count_nonzero(result.fate == Fate.ALIVE)),
        len(start),
        0.0,
    )
    yield AtlasFinding(
        "section: spread of the rays in the common focal plane, over s",
        float(np.ptp(crossing)) / s,
        0.0,
        1e-12,
    )
    yield AtlasFinding(
        "section: point F over f1 against tan(alpha1 - theta)", float(crossing.mean()) / f1, incident, 1e-12
    )
    out = np.linalg.norm(np.cross(result.direction, result.direction[0]), axis=1).max()
    yield AtlasFinding("section: spread of the outgoing directions, rad", float(out), 0.0, 1e-12)
    slope = (result.direction @ across) / (result.direction @ axis)
    eta, delta = -f2 / f1, float(np.array(window.thin.offset) @ across) / f1
    off = np.abs(incident - delta - eta * slope).max()
    yield AtlasFinding(
        "section: tan(a1 - theta) - delta - eta tan(a2 - theta), largest", float(off), 0.0, 1e-12
    )


def solid_findings(scene: Scene) -> Iterator[AtlasFinding]:
    """Properties of both arrays' triangles: closed, one piece, separate, alike, placed and turned as set."""
    design = scene.design()
    window = prescribe(design)
    mesh = sheet_triangles(window)
    arrays = [measured_lenses(window, k, body) for k, body in enumerate(mesh.bodies)]
    for k, (body, lenses) in enumerate(zip(mesh.bodies, arrays, strict=True)):
        health = check_closed((body.vertices, body.triangles))
        name = f"array {k + 1}"
        yield AtlasFinding(f"{name}: watertight (1)", float(health.closed), 1.0, 0.0)
        yield AtlasFinding(f"{name}: pieces", float(health.pieces or 0), 1.0, 0.0)
        yield AtlasFinding(
            f"{name}: lenses", float(len(lenses.centre)), float(np.prod(window.lattice.count)), 0.0
        )
        unlike = float(np.abs(lenses.radii / lenses.radii[0] - 1.0).max())
        yield AtlasFinding(f"{name}: largest difference of its lenses' radii, relative", unlike, 0.0, 1e-6)
        for label, found, asked, slack in zip(
            ("phi", "theta", "psi"), lenses.euler(), design.law_spec.euler, (0.5, 0.01, 0.5), strict=True
        ):
            worst = math.degrees(found[np.argmax(np.abs(found - asked))])
            yield AtlasFinding(
                f"{name}: {label} of the lens farthest off, degrees", worst, math.degrees(asked), slack
            )
        f_x, f_y = window.thin.focal_length[k]
        ratio = float(lenses.radii[0, 0] / lenses.radii[0, 1])
        yield AtlasFinding(f"{name}: radius in x over radius in y", ratio, f_x / f_y, 0.05 * f_x / f_y)
    s = window.thin.separation  # as specified: centre to centre
    apart = (arrays[1].centre - arrays[0].centre) @ window.thin.rotation / s
    for axis, asked in enumerate((0.0, 0.0, 1.0)):
        worst = float(apart[np.argmax(np.abs(apart[:, axis] - asked)), axis])
        yield AtlasFinding(
            f"lens 2 from lens 1 along lens {'xyz'[axis]}, over s, farthest off", worst, asked, 1e-4
        )
    gap = float(mesh.bodies[1].vertices[:, 2].min() - mesh.bodies[0].vertices[:, 2].max())
    yield AtlasFinding("a plane lies between the arrays (1)", float(gap > 0.0), 1.0, 0.0)


@dataclass(frozen=True, eq=False)
class MeasuredLenses:
    """The lenses of an array as measured on its triangles, in order of their cells.

    centre : (n, 3) lengths. Midway between the vertices of both faces.
    frame : (n, 3, 3)
        Columns: principal directions x, y of the front face and its axis z, which points to +z.
    radii : (n, 2) lengths. Radii of curvature of the front face at its vertex, along x and y.
    """

    centre: Floats
    frame: Floats
    radii: Floats

    def euler(self) -> tuple[Floats, Floats, Floats]:
        """Angles φ (modulo π), θ, ψ (n,) of Rz(ψ) Rx(θ) Rz(φ), radians, read off the last row and column."""
        x, y, z = self.frame[:, 2, 0], self.frame[:, 2, 1], self.frame[:, 2, 2]
        theta = np.arctan2(np.hypot(x, y), z)
        psi = np.arctan2(self.frame[:, 0, 2], -self.frame[:, 1, 2])
        return np.arctan2(x, y) % math.pi, theta, psi


def measured_lenses(window: Window, array: int, body: BodyMesh) -> MeasuredLenses:
    """Fit both faces of every lens of an array of ellipsoid lenses to the corners of its triangles."""
    fronts, backs = (_face_corners(body, kind) for kind in (FRONT, BACK))
    f_x, f_y = window.thin.focal_length[array]
    vertex, frame, radii = quadrics(fronts, flatter_x=f_x > f_y)
    other, _, _ = quadrics(backs, flatter_x=f_x > f_y)
    return MeasuredLenses(0.5 * (vertex + other), frame, radii)


def _face_corners(body: BodyMesh, kind: int) -> Floats:
    """One corner (n, k, 3) of each triangle of a face, lens by lens in order of their cells."""
    corners, cells = [], []
    for triangles, (kinds, cell) in zip(body.rows(), facet_tags(body), strict=True):
        chosen = kinds == kind
        corners.append(triangles[chosen, 0])
        cells.append(cell[chosen])
    cell = np.concatenate(cells)
    order = np.lexsort((cell[:, 0], cell[:, 1]))
    number = len(np.unique(cell, axis=0))
    return np.concatenate(corners)[order].reshape(number, -1, 3)


def quadrics(points: Floats, flatter_x: bool) -> tuple[Floats, Floats, Floats]:
    """Vertex (n, 3), frame (n, 3, 3) and radii (n, 2) of the ellipsoids through points (n, k, 3), k ≥ 9.

    points : (n, k, 3) lengths. Points on n caps about the z axis of each ellipsoid.
    flatter_x : Whether x names the meridian with the larger radius.

    Returns
    -------
    vertex : (n, 3) lengths
        End of the axis in the middle of the cap.
    frame : (n, 3, 3)
        Columns x, y, z as in `MeasuredLenses`.
    radii : (n, 2) lengths
        At the vertex, along x and y.
    """
    middle = points.mean(axis=1)
    size = float(np.abs(points - middle[:, None]).max())
    x, y, z = np.moveaxis((points - middle[:, None]) / size, 2, 0)
    columns = np.stack([x * x, y * y, z * z, x * y, x * z, y * z, x, y, z, np.ones_like(x)], axis=2)
    a = np.linalg.svd(columns, full_matrices=False)[2][:, -1]
    form = np.empty((len(a), 3, 3))
    for k, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
        form[:, i, j] = form[:, j, i] = a[:, k] * (1.0 if i == j else 0.5)
    value, vector = np.linalg.eigh(form)
    frame, value = _named(vector, value, flatter_x)
    centre = -0.5 * np.linalg.solve(form, a[:, 6:9, None])[..., 0]
    level = a[:, 9] + 0.5 * np.einsum("ni,ni->n", a[:, 6:9], centre)
    half = np.sqrt(-level[:, None] / value)  # semi-axes
    side = np.sign(
        np.einsum("ni,ni->n", frame[:, :, 2], -centre)
    )  # the face is nearer the points than its far side
    vertex = centre + (side * half[:, 2])[:, None] * frame[:, :, 2]
    radii = half[:, :2] ** 2 / half[:, 2:]
    return middle + size * vertex, frame, size * radii


def _named(vector: Floats, value: Floats, flatter_x: bool) -> tuple[Floats, Floats]:
    """Eigenvectors as a right-handed frame: z nearest the sheet normal, x the flatter or steeper meridian."""
    rows = np.arange(len(vector))
    axis = np.argmax(np.abs(vector[:, 2]), axis=1)
    others = np.array([(1, 2), (0, 2), (0, 1)])[axis]
    size = np.abs(value[rows[:, None], others])
    first = np.argmin(size, axis=1) if flatter_x else np.argmax(size, axis=1)
    x = vector[rows, :, others[rows, first]]
    z = vector[rows, :, axis] * np.sign(vector[rows, 2, axis])[:, None]
    frame = np.stack([x, np.cross(z, x), z], axis=2)
    order = np.stack([others[rows, first], others[rows, 1 - first], axis], axis=1)
    return frame, np.take_along_axis(value, order, axis=1)
