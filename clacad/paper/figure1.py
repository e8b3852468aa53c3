"""The paper's Figure 1: what is found in its section and in its solids.

A picture of the sheet itself: its bodies as tinted solids over the scene, for the paper's Fig. 1(b).

The glass is drawn, not traced: each body is a lit, half-transparent surface, so that the shape of the lenses
is visible. `clacad.rendering.view` renders the view *through* a sheet.

The paper's Fig. 1 as numbers: the drawn section traced as ideal lenses, the drawn solids as they are.

Fig. 1(a) is compared with the rays of ideal lenses (the drawn thick lenses follow them to their aberration).
Fig. 1(b) is measured on the corners of the drawn triangles: each lens is fitted by quadrics, as a part would
be measured. Corners are rounded to about a millionth of a cell, so a fitted axis is good to 0.005 degrees.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from clacad.base.types import Bytes, Floats
from clacad.mesh import BodyMesh, Mesh, check_closed, tessellate
from clacad.mesh.body_mesh import facet_tags
from clacad.mesh.cell_template import BACK, FRONT
from clacad.optics.rays import Fate, Rays
from clacad.paper.figure1_section import parallel_bundle
from clacad.paper.paper_figures import AtlasFinding
from clacad.prescription.prescribe import prescribe
from clacad.rendering.camera import aim, offsets, rays
from clacad.rendering.compiled.scene_hits import look_all
from clacad.rendering.picture_files import encode
from clacad.rendering.scene_arrays import MESH, Primitive, Tables, set_stage, stage_of, tables
from clacad.scene import Scene
from clacad.sheet.window import Window
from clacad.tracing.facets.hierarchy import mesh_tree
from clacad.tracing.trace import trace

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
