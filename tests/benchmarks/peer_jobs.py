"""Jobs of other tracers: the same rays through the same faces, each as its own user would trace them.

A maker gives a call to be timed and one that gives the directions (n, 3) of what it did last; those of whole
traces, the last points (n, 3) too. They raise ImportError where the peer is not installed.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable

import numpy as np

from clacad.optics.rays import Rays
from clacad.sheet.window import Window

Job = Callable[[], object]
FACES = 4
SPARE = 8
"""Copies of the rays made beforehand, for peers that work in place."""


def beam(window, count: int, spread: float, inset: float) -> Rays:
    """Rays about the middle of the field; inset 1: anywhere, less: that part of each cell about its middle."""
    rng = np.random.default_rng(0)
    cells = window.lattice.cells()
    cell = window.lattice.centres(cells[rng.integers(0, len(cells), count)])
    aim = np.column_stack(
        [cell + inset * window.lattice.pitch[0] * rng.uniform(-0.5, 0.5, (count, 2)), np.zeros(count)]
    )
    direction = np.column_stack([rng.uniform(-spread, spread, (count, 2)), np.ones(count)])
    direction[:, :2] += np.divide(window.thin.shift, window.thin.offset[2])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return Rays(aim - 0.02 * direction, direction)


def sphere_of(face) -> float:
    """Radius, positive where the centre lies on the +z side."""
    return face.surface.side / face.surface.curvature_x


def batoid_faces(window: Window) -> list[tuple]:
    """Sphere, place, medium before and behind of each face."""
    os.environ["OMP_NUM_THREADS"] = "1"
    import batoid

    air, glass = batoid.ConstMedium(1.0), batoid.ConstMedium(window.bodies[0].index)
    return [
        (batoid.Sphere(sphere_of(face)), batoid.CoordSys(origin=face.vertex), one, two)
        for body in window.bodies
        for face, one, two in ((body.front, air, glass), (body.back, glass, air))
    ]


def unit(v: np.ndarray) -> np.ndarray:
    """Directions (n, 3) of length 1: batoid's are divided by the index."""
    return v / np.linalg.norm(v, axis=1)[:, None]


def batoid_job(window: Window, rays: Rays) -> tuple[Job, Callable[[], np.ndarray]]:
    """Rays through batoid's spheres alone; it works in place, so that each call gets a copy made beforehand."""
    faces = batoid_faces(window)
    import batoid

    p, d = rays.position.T.copy(), rays.direction.T.copy()
    made = [batoid.RayVector(*p, *d, 0.0, 5e-7) for _ in range(SPARE)]
    last = []

    def run() -> None:
        beam = made.pop()
        for surface, place, one, two in faces:
            surface.refract(beam, one, two, place)
        last[:] = [beam]

    return run, lambda: unit(last[0].v)


def batoid_whole(
    window: Window, rays: Rays
) -> tuple[Job, Callable[[], np.ndarray], Callable[[], np.ndarray]]:
    """From arrays to arrays, as a user of batoid traces a lens: rays made, a compound optic, points in its frame."""
    faces = batoid_faces(window)
    import batoid

    lens = batoid.CompoundOptic(
        tuple(
            batoid.RefractiveInterface(surface, name=str(k), coordSys=place, inMedium=one, outMedium=two)
            for k, (surface, place, one, two) in enumerate(faces)
        )
    )
    p, d = rays.position.T.copy(), rays.direction.T.copy()
    last = []

    def run() -> None:
        beam = lens.trace(batoid.RayVector(*p, *d, 0.0, 5e-7))
        beam.toCoordSys(batoid.CoordSys())
        last[:] = [beam.r, beam.v]

    return run, lambda: unit(last[1]), lambda: last[0]


def optiland_lens(window: Window):
    """Both lenses as an optiland prescription: object at infinity, four faces, an image plane behind."""
    from optiland.materials import IdealMaterial
    from optiland.optic import Optic

    warnings.simplefilter("ignore")
    lens, glass = Optic(), IdealMaterial(n=window.bodies[0].index)
    heights = [face.vertex[2] for face in window.faces]
    lens.add_surface(index=0, thickness=np.inf)
    for k, face in enumerate(window.faces):
        gap = heights[k + 1] - heights[k] if k + 1 < FACES else 0.01
        lens.add_surface(
            index=k + 1, radius=sphere_of(face), thickness=gap, material=glass if k % 2 == 0 else "air", is_stop=k == 0
        )  # fmt: skip
    lens.add_surface(index=FACES + 1)
    lens.add_wavelength(value=0.5, is_primary=True)
    return lens


def optiland_job(window: Window, rays: Rays) -> tuple[Job, Callable[[], np.ndarray]]:
    """Rays through optiland's spheres alone, numpy backend, surface by surface."""
    surfaces = optiland_lens(window).surface_group.surfaces[1 : FACES + 1]
    from optiland.rays import RealRays

    p, d, one = (
        rays.position.T - [[0.0], [0.0], [window.faces[0].vertex[2]]],
        rays.direction.T,
        np.ones(len(rays)),
    )
    last = []

    def run() -> None:
        beam = RealRays(*(c.copy() for c in p), *(c.copy() for c in d), one, 0.5 * one)
        for surface in surfaces:
            surface.trace(beam)
        last[:] = [beam]

    return run, lambda: np.stack([last[0].L, last[0].M, last[0].N], axis=1)


def optiland_whole(
    window: Window, rays: Rays
) -> tuple[Job, Callable[[], np.ndarray], Callable[[], np.ndarray]]:
    """From arrays to arrays, as a user of optiland traces given rays: the whole lens, recording as it does."""
    lens = optiland_lens(window)
    from optiland.rays import RealRays

    down = window.faces[0].vertex[2]
    p, d, one = rays.position.T - [[0.0], [0.0], [down]], rays.direction.T, np.ones(len(rays))
    last = []

    def run() -> None:
        beam = lens.surface_group.trace(
            RealRays(*(c.copy() for c in p), *(c.copy() for c in d), one, 0.5 * one)
        )
        face = lens.surface_group.surfaces[FACES]
        last[:] = [
            np.stack([beam.L, beam.M, beam.N], axis=1), np.stack([face.x, face.y, face.z + down], axis=1)
        ]  # fmt: skip

    return run, lambda: last[0], lambda: last[1]


def centre_of(face) -> list[float]:
    """Centre of a face's sphere."""
    x, y, z = face.vertex
    return [x, y, z + sphere_of(face)]


def mitsuba_whole(
    window: Window, rays: Rays
) -> tuple[Job, Callable[[], np.ndarray], Callable[[], np.ndarray]]:
    """Each face's sphere a scene of mitsuba, which gives hit points and normals (float32, LLVM); Snell in its arrays."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    dr.set_thread_count(1)
    size, faces = abs(sphere_of(window.faces[0])), []  # lengths near 1, for float32
    for body in window.bodies:
        for face, eta in ((body.front, 1.0 / body.index), (body.back, body.index)):
            sphere = {
                "type": "sphere",
                "center": [c / size for c in centre_of(face)],
                "radius": abs(sphere_of(face)) / size,
            }
            faces.append((mi.load_dict({"type": "scene", "face": sphere}), eta))
    p, d = rays.position.T / size, rays.direction.T
    last: list[np.ndarray] = []

    def run() -> None:
        point, going = mi.Point3f(*p.astype(np.float32)), mi.Vector3f(*d.astype(np.float32))
        for scene, eta in faces:
            met = scene.ray_intersect(mi.Ray3f(point, going))
            point, normal = met.p, mi.Vector3f(met.n)
            along = dr.dot(normal, going)
            normal = dr.select(along > 0.0, normal, -normal)
            along = dr.abs(along)
            going = eta * going + (dr.sqrt(1.0 - eta * eta * (1.0 - along * along)) - eta * along) * normal
        dr.eval(point, going)
        last[:] = [np.array(going).T, np.array(point).T * size]

    return run, lambda: unit(last[0]), lambda: last[1]


def raysect_whole(
    window: Window, rays: Rays
) -> tuple[Job, Callable[[], np.ndarray], Callable[[], np.ndarray]]:
    """Each face's sphere a world of raysect, ray by ray: it has no arrays of rays."""
    from raysect.core import Point3D, Ray, Vector3D, World, translate
    from raysect.primitive import Sphere

    faces = []
    for body in window.bodies:
        for face, eta in ((body.front, 1.0 / body.index), (body.back, body.index)):
            world = World()
            Sphere(abs(sphere_of(face)), world, translate(*centre_of(face)))
            faces.append((world, eta))
    last: list[np.ndarray] = []

    def bent(going: Vector3D, normal: Vector3D, eta: float) -> Vector3D:
        along = normal.dot(going)
        if along < 0.0:
            along, normal = -along, -normal
        turn = (1.0 - eta * eta * (1.0 - along * along)) ** 0.5 - eta * along
        return Vector3D(*(eta * g + turn * n for g, n in zip(going, normal, strict=True)))

    def one(point: Point3D, going: Vector3D) -> tuple[Point3D, Vector3D]:
        for world, eta in faces:
            met = world.hit(Ray(point, going))
            point = met.hit_point.transform(met.primitive_to_world)
            going = bent(going, met.normal.transform(met.primitive_to_world), eta)
        return point, going

    def run() -> None:
        made = [
            one(Point3D(*p), Vector3D(*d))
            for p, d in zip(rays.position.tolist(), rays.direction.tolist(), strict=True)
        ]
        last[:] = [np.array([[*v] for _, v in made]), np.array([[*p] for p, _ in made])]

    return run, lambda: unit(last[0]), lambda: last[1]


def facets_of(mesh) -> list[np.ndarray]:
    """Corners (m, 3, 3) of the optical facets of each face, in the order of the light."""
    faces = []
    for body in mesh.bodies:
        corners = body.vertices[body.triangles]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        upright = normal[:, 2] / np.linalg.norm(normal, axis=1)
        faces += [corners[upright < -0.05], corners[upright > 0.05]]
    return faces


def through_planes(faces, name: Callable, index: float, rays: Rays) -> np.ndarray:
    """Refract rays in float64 at the planes of the triangles that `name` finds for each face."""
    p, d = rays.position.copy(), rays.direction.copy()
    for k, corners in enumerate(faces):
        which = name(k, p, d)
        a = corners[which]
        normal = np.cross(a[:, 1] - a[:, 0], a[:, 2] - a[:, 0])
        normal /= np.linalg.norm(normal, axis=1)[:, None] * np.sign(normal[:, 2:])
        along = np.einsum("ij,ij->i", normal, d)
        p = p + (np.einsum("ij,ij->i", normal, a[:, 0] - p) / along)[:, None] * d
        mu = 1.0 / index if k % 2 == 0 else index
        d = mu * d + (np.sqrt(1.0 - mu * mu * (1.0 - along * along)) - mu * along)[:, None] * normal
    return d


def embreex_job(window: Window, faces, rays: Rays) -> tuple[Job, Callable[[], np.ndarray]]:
    """Embree (float32) finds the triangle; hit and refraction are numpy's, float64."""
    from embreex import rtcore_scene
    from embreex.mesh_construction import TriangleMesh

    scenes = []
    for corners in faces:
        scene = rtcore_scene.EmbreeScene()
        TriangleMesh(scene, corners.astype(np.float32))
        scenes.append(scene)
    last = []

    def name(k: int, p: np.ndarray, d: np.ndarray) -> np.ndarray:
        return scenes[k].run(p.astype(np.float32), d.astype(np.float32))

    def run() -> None:
        last[:] = [through_planes(faces, name, window.bodies[0].index, rays)]

    return run, lambda: last[0]


def trimesh_job(window: Window, faces, rays: Rays) -> tuple[Job, Callable[[], np.ndarray]]:
    """Trimesh's own ray interface over embree."""
    import embreex  # noqa: F401  # else trimesh takes its slow search
    import trimesh

    tracers = []
    for corners in faces:
        part = trimesh.Trimesh(
            corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), process=False
        )
        tracers.append(trimesh.ray.ray_pyembree.RayMeshIntersector(part))
    last = []

    def name(k: int, p: np.ndarray, d: np.ndarray) -> np.ndarray:
        return tracers[k].intersects_first(p, d)

    def run() -> None:
        last[:] = [through_planes(faces, name, window.bodies[0].index, rays)]

    return run, lambda: last[0]
