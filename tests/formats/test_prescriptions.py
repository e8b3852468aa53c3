"""A telescopelet as lens-design programs read it: numbers by a plain reader, light by 60 digits and by optiland itself."""

from __future__ import annotations

import json
import re
import tomllib
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from oracle import trace as oracle

import clacad
from clacad.design import Design
from clacad.design.starter_designs import template
from clacad.exporting.run import export
from clacad.formats.sequential.optiland_json import write_optiland
from clacad.optics.rays import Fate, Rays
from clacad.sheet.bundle import bundle
from clacad.sheet.like_cell import in_light, interfaces
from clacad.storage.errors import FileDisagrees, NotPossible, UnreadableFile

DESIGNS = Path(__file__).parents[2] / "designs"

TILTED = {
    "biconvex": ("paper-a-covered", ["law.delta=[0.01,-0.005]", "law.euler=[30,0.4,20]"]),
    "slab": ("slab", ["law.delta=[0.01,-0.02]", "law.euler=[30,0.5,20]"]),
    "slab-biconics": ("slab", ["law.delta=[0.01,-0.02]", "law.euler=[70,-0.5,10]", 'pair.surface="biconic"']),
    "plano": ("plano", ["law.delta=[0.005,0.01]", "law.euler=[45,0.5,0]"]),
    "galilean": ("galilean", ["law.delta=[0.01,0.02]", "law.euler=[10,0.3,80]"]),
}
"""A design of each form with an offset and a tilt: biconic faces, ellipsoids, planes, concave ones."""


def tilted(name):
    """One of the five, a few cells of it."""
    design, overrides = TILTED[name]
    return clacad.load(DESIGNS / f"{design}.toml", overrides=overrides).with_cells((3, 3))


# -- a reader of its own -------------------------------------------------------------------------------


def blocks_of(text):
    """SURF blocks of a ZMX text: type, numbers by key."""
    found = []
    for block in re.split(r"^SURF \d+\s*$", text, flags=re.MULTILINE)[1:]:
        one = {"PARM": {}}
        for line in block.splitlines():
            words = line.split()
            if words and words[0] == "PARM":
                one["PARM"][int(words[1])] = float(words[2])
            elif words:
                one[words[0]] = words[1:]
        found.append(one)
    return found


def about(axis, degrees):
    """Right-handed turn about one axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    rows = {"x": [[1, 0, 0], [0, c, -s], [0, s, c]], "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]], "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]]}  # fmt: skip
    return np.array(rows[axis], dtype=float)


def faces_of(text):
    """Refracting faces: radii, conics, index beyond, place and frame, by decentre first, then x, y, z."""
    place, turn, found = np.zeros(3), np.eye(3), []
    blocks = blocks_of(text)
    for block in blocks[1:-1]:
        p = block["PARM"]
        if block["TYPE"] == ["COORDBRK"]:
            place = place + turn @ [p[1], p[2], 0.0]
            turn = turn @ about("x", p[3]) @ about("y", p[4]) @ about("z", p[5])
        elif "STOP" not in block:
            cy, ky = float(block["CURV"][0]), float(block["CONI"][0])
            cx, kx = cy, ky
            if block["TYPE"] == ["BICONICX"]:
                cx, kx = (1.0 / p[1] if p[1] else 0.0), p[2]
            index = float(block["GLAS"][3]) if "GLAS" in block else 1.0
            found.append((cx, cy, kx, ky, index, place, turn))
        place = place + turn @ [0.0, 0.0, float(block["DISZ"][0])]
    return found, (place, turn)


def millimetres(window):
    return window.unit * 1e3


@pytest.mark.daily_cases("slab-biconics", "galilean", "plano", "slab")
@pytest.mark.parametrize("name", TILTED)
def test_a_plain_reader_finds_radii_conics_indices_decentres_and_tilts_of_the_zmx(tmp_path, name):
    design = tilted(name)
    window = clacad.prescribe(design)
    export(design, tmp_path / "x", ("zmx",))
    (path,) = (tmp_path / "x").glob("*.zmx")
    found, (_, last) = faces_of(path.read_bytes().decode("ascii"))
    mm = millimetres(window)
    low = [0.0, 0.0, window.z_range[0] * mm]
    expected = [(body, face) for body in window.bodies for face in (body.front, body.back)]
    assert len(found) == len(expected)
    assert last == pytest.approx(np.eye(3), abs=1e-15)
    for (cx, cy, kx, ky, index, place, turn), (body, face) in zip(found, expected, strict=True):
        s = face.surface
        assert (cx * mm, cy * mm) == pytest.approx(
            (s.side * s.curvature_x, s.side * s.curvature_y), rel=1e-14
        )
        if s.curvature_x and hasattr(s, "kappa"):  # 1 + K = kappa / c
            assert (1 + kx) * s.curvature_x == pytest.approx(s.kappa, rel=1e-13)
            assert (1 + ky) * s.curvature_y == pytest.approx(s.kappa, rel=1e-13)
        elif s.curvature_x:
            assert (kx, ky) == (s.conic_x, s.conic_y)
        assert index == (body.index if face is body.front else 1.0)
        shift = [0.0, 0.0] if face.array is None else window.shifts[face.array]
        assert turn == pytest.approx(face.rotation, abs=4e-16)
        assert place + low == pytest.approx((np.asarray(face.vertex) + [*shift, 0.0]) * mm, abs=2e-14)


@pytest.mark.daily_cases("plano")
@pytest.mark.parametrize("name", ["biconvex", "plano"])
def test_light_through_the_numbers_of_the_zmx_is_that_of_clacad_in_sixty_digits(tmp_path, name):
    design = tilted(name)
    window = clacad.prescribe(design)
    export(design, tmp_path / "x", ("zmx",))
    (path,) = (tmp_path / "x").glob("*.zmx")
    found, _ = faces_of(path.read_bytes().decode("ascii"))
    mm, before, faces = millimetres(window), 1.0, []
    for cx, cy, kx, ky, index, place, turn in found:
        place = place + [0.0, 0.0, window.z_range[0] * mm]
        pose = {"vertex": tuple(place), "before": before, "after": index, "rotation": turn.tolist()}
        assert (1 + kx) * cx == pytest.approx((1 + ky) * cy, rel=1e-14)  # then a biconic is a quadric
        faces.append(oracle.quadric(cx, cy, (1 + kx) * cx, **pose))
        before = index
    rays, result = lit(window, 8)
    for start, direction, out in zip(rays[0] * mm, rays[1], result, strict=True):
        path_ = oracle.trace(faces, start.tolist(), direction.tolist())
        assert path_.status == "ok"
        assert np.array(path_.directions[-1], dtype=float) == pytest.approx(out, abs=1e-14)


def lit(window, count, field=0.03):
    """Starts from the middle cell's own centre, directions, and directions behind the sheet, of rays that get through."""
    launched = bundle(window, count, field)
    place = window.lattice.centres(np.array([launched.cell]))[0]
    result = clacad.trace(window, launched.rays)
    alive = result.fate == Fate.ALIVE
    start = (launched.rays.position - [*place, 0.0])[alive]
    return (start, launched.rays.direction[alive]), result.direction[alive]


# -- optiland ------------------------------------------------------------------------------------------


def rays_of_optiland(window, starts, directions):
    from optiland.rays import RealRays

    n = len(starts)
    return RealRays(
        *(starts * millimetres(window)).T.copy(), *directions.T.copy(), np.ones(n), np.full(n, 0.55)
    )


def angles(a, b):
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", TILTED)
def test_optiland_sends_a_thousand_rays_where_clacad_does(tmp_path, name):
    pytest.importorskip("optiland", reason="the extra optiland is not installed")
    from optiland.fileio import load_optiland_file

    design = tilted(name)
    window = clacad.prescribe(design)
    export(design, tmp_path / "x", ("optiland",))
    (path,) = (tmp_path / "x").glob("*.optiland.json")
    lens = load_optiland_file(str(path))
    (starts, directions), wanted = lit(window, 2048, 0.01)
    assert len(wanted) >= 1000
    rays = rays_of_optiland(window, starts[:1000], directions[:1000])
    lens.surfaces.trace(rays)
    assert angles(np.column_stack([rays.L, rays.M, rays.N]), wanted[:1000]).max() < 1e-9


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", ["achromat", "achromat-plastic", "achromat-doublets", "three-plates-10deg"])
def test_optiland_sends_three_lines_where_clacad_does(tmp_path, kind):
    """A file has one index a medium: its faces get those of each line, in the order of the light.

    It holds one telescopelet. Oblique rays that first meet a neighbouring cell pass the neighbour's
    telescopelet in the sheet, and the continued face of this one in the file.
    """
    pytest.importorskip("optiland", reason="the extra optiland is not installed")
    from optiland.fileio import load_optiland_file
    from optiland.materials import IdealMaterial

    design = Design.from_dict(tomllib.loads(template("day", kind))).with_cells((3, 3))
    window = clacad.prescribe(design)
    path = tmp_path / "day.optiland.json"
    write_optiland(window, path)
    launched = bundle(window, 1024, design.check.field)
    place = [*window.lattice.centres(np.array([launched.cell]))[0], 0.0]
    for wave in (486.1e-9, 587.6e-9, 656.3e-9):
        lens = load_optiland_file(str(path))
        faces = [s for s in lens.surfaces if s.material_pre.n(0.5461) != s.material_post.n(0.5461)]
        for surface, at in zip(faces, interfaces(in_light(window, wave)), strict=True):
            surface.material_post = IdealMaterial(at.index_after)
        result = clacad.trace(window, Rays(launched.rays.position, launched.rays.direction, wave))
        rays = rays_of_optiland(window, launched.rays.position - place, launched.rays.direction)
        lens.surfaces.trace(rays)
        apart = angles(np.column_stack([rays.L, rays.M, rays.N]), result.direction)
        alive, own = result.fate == Fate.ALIVE, (result.cell == launched.cell).all(axis=1)
        assert (alive & own).sum() >= 0.95 * alive.sum()
        assert apart[alive & own].max() < 1e-9
        if (alive & ~own).any():
            assert kind == "three-plates-10deg"  # the deep front face is met beyond the cell's border
            assert apart[alive & ~own].min() > 1e-5


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
def test_optilands_own_reader_finds_the_faces_of_revolution_of_a_zmx_where_they_stand(tmp_path):
    pytest.importorskip("optiland", reason="the extra optiland is not installed")
    from optiland.fileio import load_zemax_file
    from optiland.materials import IdealMaterial

    design = tilted("galilean")
    window = clacad.prescribe(design)
    export(design, tmp_path / "x", ("zmx",))
    (path,) = (tmp_path / "x").glob("*.zmx")
    lens = load_zemax_file(str(path))
    faces = [face for body in window.bodies for face in (body.front, body.back)]
    indices = [v for body in window.bodies for v in (body.index, 1.0)]
    mm = millimetres(window)
    for surface, face, index in zip(lens.surfaces[2:-1], faces, indices, strict=True):
        place, turn = surface.geometry.cs.get_effective_transform()
        shift = window.shifts[face.array]
        low = [0.0, 0.0, window.z_range[0] * mm]
        assert place + low == pytest.approx((np.asarray(face.vertex) + [*shift, 0.0]) * mm, abs=1e-13)
        assert turn == pytest.approx(face.rotation, abs=1e-14)
        assert float(surface.geometry.radius) == pytest.approx(
            mm / (face.side * face.surface.curvature_x), rel=1e-14
        )
        surface.material_post = IdealMaterial(index)  # its model glass is dispersive: n_d and V of a fit
    (starts, directions), wanted = lit(window, 256, 0.01)
    rays = rays_of_optiland(window, starts - [0.0, 0.0, window.z_range[0]], directions)
    lens.surfaces.trace(rays)
    assert angles(np.column_stack([rays.L, rays.M, rays.N]), wanted).max() < 1e-9


# -- messages and refusals -----------------------------------------------------------------------------


def test_a_series_has_the_sag_of_the_face_and_says_within_what_slope():
    from mpmath import mp, mpf

    from clacad.formats.sequential.optiland_json import series, terms_needed
    from clacad.formats.sequential.stations import stations

    mp.dps = 40
    for name in ("biconvex", "slab"):
        for one in stations(clacad.prescribe(tilted(name))):
            terms, error = terms_needed(one)
            assert error <= 1e-13
            table = series(one, terms)
            (cx, cy), (kx, ky) = one.curvature, one.conic
            for u, v in ((1.0, 1.0), (-0.3, 0.8), (0.9, 0.1)):
                x, y = mpf(u * one.reach[0]), mpf(v * one.reach[1])
                root = mp.sqrt(1 - (1 + mpf(kx)) * mpf(cx) ** 2 * x**2 - (1 + mpf(ky)) * mpf(cy) ** 2 * y**2)
                sag = (cx * x**2 + cy * y**2) / (1 + root)
                found = sum(c * x**i * y**j for i, row in enumerate(table) for j, c in enumerate(row) if c)
                assert abs(found - sag) < 1e-13 * float(max(one.reach)) + 1e-15 * abs(float(sag))


def test_a_zmx_whose_radius_was_changed_or_that_is_cut_short_is_refused(tmp_path):
    from clacad.formats.sequential.zmx import check_zmx, write_zmx

    window = clacad.prescribe(tilted("slab"))
    path = tmp_path / "x.zmx"
    write_zmx(window, path)
    check_zmx(window, path)
    text = path.read_bytes()
    at = re.search(rb"PARM 1 (-?[1-9][0-9.]+)", text)
    path.write_bytes(text[: at.start(1)] + repr(float(at.group(1)) * 1.0001).encode() + text[at.end(1) :])
    with pytest.raises(FileDisagrees, match="light through it leaves up to"):
        check_zmx(window, path)
    path.write_bytes(text[:500])
    with pytest.raises(UnreadableFile):
        check_zmx(window, path)


def test_what_a_prescription_cannot_hold_stands_in_the_file_and_in_the_manifest(tmp_path):
    design = clacad.load(DESIGNS / "baffled.toml").with_cells((2, 2))
    manifest = export(design, tmp_path / "x", ("zmx",))
    (entry,) = manifest.files
    text = (tmp_path / "x" / entry["name"]).read_bytes().decode("ascii")
    said = " ".join(entry["left_out"])
    assert "neighbours" in said
    assert "baffle" in said
    assert all(f"NOTE 0 Not in this file: {sentence}." in text for sentence in entry["left_out"])


def test_without_optiland_the_format_names_its_extra_before_any_work(tmp_path, monkeypatch):
    module = import_module("clacad.formats.sequential.optiland_json")
    monkeypatch.setattr(module, "find_spec", lambda name: None)
    with pytest.raises(NotPossible, match=r"pip install .clacad\[optiland\]"):
        export(tilted("slab"), tmp_path / "x", ("zmx", "optiland"))
    assert not (tmp_path / "x").exists()


def test_a_face_that_optiland_cannot_hold_is_refused_before_anything_is_written(tmp_path, monkeypatch):
    module = import_module("clacad.formats.sequential.optiland_json")
    monkeypatch.setattr(module, "find_spec", lambda name: object())
    steep = ["law.eta=[-0.5,-0.6]", "pair.separation=2.2", "lattice.pitch=0.5"]
    design = clacad.load(DESIGNS / "slab.toml", overrides=steep).with_cells((1, 1))
    with pytest.raises(NotPossible, match="too steep at its corners"):
        export(design, tmp_path / "x", ("zmx", "optiland"))
    assert not (tmp_path / "x").exists()
    assert [entry["format"] for entry in export(design, tmp_path / "x", ("zmx",)).files] == ["zmx"]


def test_a_cylinder_is_held_by_optilands_biconic_and_a_sphere_by_its_conic():
    from clacad.formats.sequential.optiland_json import optiland_document

    flat = clacad.load(DESIGNS / "slab.toml", overrides=["law.eta=[-0.5,1.0]", "law.delta=[0,0]"])
    for design, kind in (
        (flat, "BiconicGeometry"),
        (clacad.load(DESIGNS / "galilean.toml"), "StandardGeometry"),
    ):
        document = optiland_document(clacad.prescribe(design.with_cells((1, 1))))
        kinds = {row["geometry"]["type"] for row in document["surface_group"]["surfaces"][2:-1]}
        assert kinds == {kind}
        assert document["clacad"]["largest_slope_error"] == 0.0
        assert json.loads(json.dumps(document)) == document
