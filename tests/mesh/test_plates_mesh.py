"""Plates listed face by face as meshes: closed bodies, joints shared facet by facet, light, files judged."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from clacad import to_trimesh, trace_sequence
from clacad.design import Design
from clacad.effects.trace import trace
from clacad.exporting.formats.format import RoughSheet
from clacad.exporting.tessellations import Meshes
from clacad.formats.mesh.file_mesh import FileMesh
from clacad.formats.mesh.glb import write_glb
from clacad.formats.mesh.readers import read_mesh
from clacad.formats.mesh.stl import write_stl
from clacad.formats.mesh.threemf import write_threemf
from clacad.judging.delivery import Inspection
from clacad.judging.mesh_file import judge_mesh
from clacad.mesh import check_closed, tessellate
from clacad.mesh.body_mesh import facet_tags
from clacad.mesh.cell_template import BACK, BACK_LAND, FRONT, FRONT_LAND
from clacad.optics.rays import Fate, Rays
from clacad.optics.sequence import Interface
from clacad.optics.surface import Biconic
from clacad.prescription.prescribe import prescribe
from clacad.sheet.face_order import media_of

PITCH, N = 0.5, 4
PMMA_PS = [  # radius (> 0: centre of curvature towards +z), conic, z, array, medium behind
    (2.29629077, -0.373266996, 0.0, 1, "PMMA"),
    (-5.11080418, 0.0, 1.0, 1, "PS"),
    (5.11080418, 0.0, 14.8294173, 2, "PMMA"),
    (-2.29629077, -0.373266996, 15.8294173, 2, "air"),
]
LAYER = [
    (2.3006771, -0.449236722, 0.0, 1, "Fused silica"),
    ("inf", 0.0, 1.65260254, None, "N-SF6"),
    ("inf", 0.0, 15.6758003, None, "Fused silica"),
    (-2.3006771, -0.449236722, 17.3284028, 2, "air"),
]
MENISCI = [
    (0.733276291, -1.06203256, 0.0, 1, "PMMA"),
    (-0.425388892, -3.04632891, 1.49190384, 1, "air"),
    (0.425388892, -3.04632891, 2.10953316, 2, "PMMA"),
    (-0.733276291, -1.06203256, 3.601437, 2, "air"),
]
LISTS = {"curved": PMMA_PS, "layer": LAYER, "columns": MENISCI, "seamed": PMMA_PS}
JOINED = ("curved", "layer", "seamed")
SEAM, BORDER = 0.03, 0.5  # of "seamed"


def design(name):
    faces = []
    for radius, conic, z, array, behind in LISTS[name]:
        face = {"radius": [radius, radius], "behind": behind}
        face |= {"z": z} if z else {}
        face |= {"array": array, "conic": [conic, conic]} if array else {}
        faces.append(face)
    return Design.from_dict({
        "format": 1, "name": name, "unit": "mm", "law": {"eta": [-1, -1]},
        "pair": {"form": "plates", "wavelength": "546.1 nm", "face": faces},
        "lattice": {"pitch": PITCH, "count": [N, N], **({"seam": SEAM} if name == "seamed" else {})},
        "check": {"field": "1.0 deg"}, **({"body": {"border": BORDER}} if name == "seamed" else {}),
    })  # fmt: skip


WINDOWS = {name: prescribe(design(name)) for name in LISTS}


def sag(face, x, y):
    """Height of a listed face over a point of its cell, from the equation of the conic."""
    radius, conic, z, array, _ = face
    if array is None:
        return z + 0.0 * x
    c, r2 = 1.0 / radius, x * x + y * y
    return z + c * r2 / (1.0 + np.sqrt(1.0 - (1.0 + conic) * c * c * r2))


def volumes(name):
    """Volumes of the bodies by Gauss quadrature of their listed faces over a cell."""
    node, weight = np.polynomial.legendre.leggauss(24)
    seam, border = (SEAM, BORDER) if name == "seamed" else (0.0, 0.0)
    half = 0.5 * (PITCH - seam)
    x, y = np.meshgrid(half * node, half * node)
    area = half**2 * np.outer(weight, weight)
    faces, flat = LISTS[name], (N * PITCH + 2.0 * border) ** 2 - N * N * (2.0 * half) ** 2
    under = []
    for number, face in enumerate(faces):
        ends = sag(face, 0.0, 0.0), sag(face, half, half)
        land = min(ends) - PITCH / 50.0 if number else max(ends) + PITCH / 50.0
        under.append(float((sag(face, x, y) * area).sum()) * N * N + land * flat)
    return [under[k + 1] - under[k] for k in range(len(faces) - 1) if faces[k][4] != "air"]


def beam(count, spread=0.1, slope=0.004):
    """Rays over the middle of one cell, in a small field."""
    rng = np.random.default_rng(7)
    xy, tilt = rng.uniform(-spread, spread, (count, 2)), rng.uniform(-slope, slope, (count, 2))
    direction = np.column_stack([tilt, np.ones(count)])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return Rays(np.column_stack([xy + 0.5 * PITCH, np.full(count, -1.0)]), direction)


def through_list(name, rays):
    """Directions after the listed faces of one telescopelet, by Snell's law at explicit surfaces."""
    window = WINDOWS[name]
    media, place = media_of(window.bodies), [0.5 * PITCH, 0.5 * PITCH]
    known = iter(media[1:])
    sequence, before = [], 1.0
    for radius, conic, z, array, behind in LISTS[name]:
        index = 1.0 if behind == "air" else next(n for n in known if n not in (before, 1.0))
        curvature = 0.0 if array is None else 1.0 / radius
        surface = Biconic(curvature, curvature, conic, conic, 1)
        sequence.append(Interface(surface, np.array([*place, z]), before, index))
        before = index
    return trace_sequence(sequence, rays)


def facets_of_side(body, kind):
    """Facets of one side of a body as a set of cycles of corners."""
    corners = np.concatenate(list(body.rows()))
    kinds = np.concatenate([tags for tags, _ in facet_tags(body)])
    found = set()
    for facet in corners[kinds == kind].tolist():
        first = facet.index(min(facet))
        found.add(tuple(map(tuple, facet[first:] + facet[:first])))
    return found


# -- meshes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LISTS)
def test_every_body_is_closed_alone_and_has_the_volume_of_its_listed_faces(name):
    coarse, fine = (tessellate(WINDOWS[name], quads=quads) for quads in (8, 16))
    for rough, body, exact in zip(coarse.bodies, fine.bodies, volumes(name), strict=True):
        health, solid = check_closed(np.concatenate(list(body.rows()))), to_trimesh(body)
        assert health.closed
        assert health.pieces == 1
        assert solid.is_watertight
        assert solid.is_winding_consistent
        extrapolated = (4.0 * solid.volume - to_trimesh(rough).volume) / 3.0  # chords cut off ~ 1/quads²
        assert extrapolated == pytest.approx(exact, rel=2e-6, abs=1e-5)


@pytest.mark.daily_cases("5-layer", "5-seamed", "8-curved", "8-layer")
@pytest.mark.parametrize("name", JOINED)
@pytest.mark.parametrize("quads", [5, 8])
def test_both_bodies_of_a_joint_have_the_same_facets_mirrored(name, quads):
    bodies = tessellate(WINDOWS[name], quads=quads).bodies
    for before, body in zip(bodies, bodies[1:]):
        for kind, other in ((BACK, FRONT), (BACK_LAND, FRONT_LAND)):
            back = facets_of_side(before, kind)
            mirrored = set()
            for a, b, c in facets_of_side(body, other):
                mirrored.add((a, c, b))
            assert len(back) > (N * N if kind == BACK or name == "seamed" else -1)
            assert back == mirrored


def test_the_forecast_of_facets_counts_both_sides_of_a_joint():
    for name, window in WINDOWS.items():
        asked, built = RoughSheet.of_design(design(name)), RoughSheet.of_window(window)
        assert (asked.lenses, asked.bodies) == (built.lenses, built.bodies)
        optical = sum(
            int(np.isin(kind, (FRONT, BACK)).sum())
            for body in tessellate(window, quads=32).bodies
            for kind, _ in facet_tags(body)
        )
        assert optical == pytest.approx(built.facets(32) * N * N, rel=0.15)


# -- light ----------------------------------------------------------------------------------------


@pytest.mark.ci_cases("curved", "seamed")
@pytest.mark.slow
@pytest.mark.parametrize("name", LISTS)
def test_light_through_a_fine_mesh_approaches_that_through_the_listed_faces(name):
    rays = beam(400)
    exact = through_list(name, rays)
    errors = []
    for quads in (16, 64):
        found = trace(WINDOWS[name], rays, rung="mesh", mesh=quads)
        both = (found.fate == Fate.ALIVE) & (exact.fate == Fate.ALIVE)
        assert both.mean() > 0.9
        errors.append(np.linalg.norm(found.direction - exact.direction, axis=1)[both].std())
    assert errors[1] < 0.4 * errors[0]
    smooth = trace(WINDOWS[name], rays, rung="mesh", mesh=128, normals="vertex")
    both = (smooth.fate == Fate.ALIVE) & (exact.fate == Fate.ALIVE)
    assert np.abs(smooth.direction - exact.direction)[both].max() < 5e-4


@pytest.mark.slow
@pytest.mark.parametrize("name", JOINED)
def test_light_through_a_written_file_is_that_through_the_mesh_in_memory(name, tmp_path):
    window, rays = WINDOWS[name], beam(300)
    mesh = tessellate(window, quads=8)
    write_stl(mesh.bodies, tmp_path / "part.stl", 1.0, name)
    own = trace(window, rays, rung="mesh", mesh=mesh)
    filed = trace(window, rays, rung="mesh", mesh=tmp_path / "part.stl")
    both = (own.fate == Fate.ALIVE) & (filed.fate == Fate.ALIVE)
    assert (own.fate == filed.fate).mean() > 0.99
    assert both.mean() > 0.5
    apart = np.linalg.norm(own.direction - filed.direction, axis=1)[both]
    assert np.quantile(apart, 0.98) < 1e-5
    assert own.optical_path[both] == pytest.approx(filed.optical_path[both], abs=1e-4)


# -- files ----------------------------------------------------------------------------------------


def written(name, folder, suffix, quads=16):
    path, tessellation = folder / f"part.{suffix}", Meshes(WINDOWS[name]).at(quads)
    if suffix == "stl":
        write_stl(tessellation.mesh.bodies, path, 1.0, name)
    elif suffix == "glb":
        write_glb(tessellation.pieces(name != "seamed", normals=True), path, 1.0, name)
    else:
        repeated = suffix != "fused.3mf" and name != "seamed"  # a border is in no cell
        write_threemf(tessellation.pieces(repeated, normals=False), path, 1.0, name)
    return read_mesh(path)


def faults(name, mesh):
    asked = Inspection(design(name), "part", 2048)
    factor = (mesh.unit or 1e-3) / design(name).unit_m
    checks, _ = judge_mesh(asked, WINDOWS[name], mesh, factor)
    return {check.id for check in checks if check.state != "pass" and not check.id.startswith("file_law")}


FORMATS = ("stl", "3mf", "glb")
SLOW = {("seamed", "3mf"), ("seamed", "glb")}


@pytest.mark.ci_cases("curved-3mf", "layer-stl", "seamed-glb")
@pytest.mark.slow
@pytest.mark.parametrize(("name", "suffix"), [
    pytest.param(*case, marks=[pytest.mark.slow] if case in SLOW else []) for case in product(JOINED, FORMATS)
])  # fmt: skip
def test_a_right_file_passes(name, suffix, tmp_path):
    assert faults(name, written(name, tmp_path, suffix)) <= {"file_confocality", "file_throughput"}


@pytest.mark.daily_cases("layer")
@pytest.mark.parametrize("name", JOINED)
def test_a_joint_of_one_body_that_is_5_um_off_is_found(name, tmp_path):
    mesh = written(name, tmp_path, "fused.3mf", quads=8)
    body, height = mesh.parts[1], LISTS[name][1][2]
    vertices = np.array(body.vertices)
    vertices[np.abs(vertices[:, 2] - height) < 0.1, 2] += 0.005
    moved = replace(body, vertices=vertices)
    spoilt = FileMesh(mesh.format, (mesh.parts[0], moved, mesh.parts[2]), mesh.unit, mesh.name)
    assert "shape" in faults(name, spoilt)


@pytest.mark.daily_cases("layer")
@pytest.mark.parametrize("name", JOINED)
def test_a_missing_body_between_two_joints_is_found(name, tmp_path):
    mesh = written(name, tmp_path, "fused.3mf", quads=8)
    spoilt = FileMesh(mesh.format, (mesh.parts[0], mesh.parts[2]), mesh.unit, mesh.name)
    assert {"volume", "shape"} <= faults(name, spoilt)


@pytest.mark.ci_cases("curved-glb", "layer-fused.3mf")
@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["3mf", "fused.3mf", "glb"])
@pytest.mark.parametrize("name", [name for name in JOINED if name != "seamed"])
def test_objects_that_exchange_their_names_are_found_where_their_media_differ(name, suffix, tmp_path):
    mesh = written(name, tmp_path, suffix, quads=8)
    assert "pieces" not in faults(name, mesh)
    one, two, *rest = mesh.parts
    spoilt = FileMesh(
        mesh.format, (replace(one, name=two.name), replace(two, name=one.name), *rest), mesh.unit, mesh.name
    )
    assert "pieces" in faults(name, spoilt)
