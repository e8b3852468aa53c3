"""Height maps, point clouds, grid sag, tables and masks agree with the design's surfaces."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import mpmath
import numpy as np
import pytest

import clacad
from clacad.formats.maps import mask, pose_table, sag
from clacad.formats.maps.raster import read_png, read_tiff
from clacad.sheet.window import Window
from clacad.storage.errors import FileDisagrees, UnreadableFile

DESIGNS = Path(__file__).parents[2] / "designs"
CASES = [
    "slab.toml",
    "tilted-seam.toml",
    "hexagonal.toml",
    "paper-a-covered.toml",
    "plano.toml",
    "tilted-biconvex.toml",
]


def window(name: str, cells: tuple[int, int] = (3, 2)) -> Window:
    built = clacad.prescribe(clacad.load(DESIGNS / name))
    if built.lattice.outline is not None:
        return built
    return clacad.prescribe(clacad.load(DESIGNS / name, overrides=[f"lattice.count=[{cells[0]},{cells[1]}]"]))


def scale(w: Window) -> float:
    return w.unit / 1e-3


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("kind", ["tiff32", "tiff16", "png16"])
def test_a_height_map_reads_back_as_the_design(tmp_path: Path, name: str, kind: str) -> None:
    w = window(name)
    for body, face, label in sag.structured_faces(w):
        map_ = sag.height_map(w, body, face, label, 8)
        path = tmp_path / f"{label}.{kind}"
        sag.write_map(map_, path, kind, scale(w))
        sag.check_map(map_, path, kind, scale(w))


def test_pillow_sees_the_same_pixels(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    w = window("slab.toml")
    body, face, label = sag.structured_faces(w)[0]
    map_ = sag.height_map(w, body, face, label, 8)
    for kind, suffix, reader in (
        ("tiff32", "tiff", read_tiff),
        ("tiff16", "tiff", read_tiff),
        ("png16", "png", read_png),
    ):
        path = tmp_path / f"{kind}.{suffix}"
        sag.write_map(map_, path, kind, scale(w))
        with image.open(path) as picture:
            np.testing.assert_array_equal(np.asarray(picture), reader(path))


def test_the_top_row_is_the_greatest_y_and_a_front_face_grows_towards_the_viewer(tmp_path: Path) -> None:
    """A tilted lens, whose heights have no symmetry, against a 30-digit solution of its quadric."""
    w = window("tilted.toml")
    body, face, label = sag.structured_faces(w)[0]
    map_ = sag.height_map(w, body, face, label, 8)
    path = tmp_path / "x.tiff"
    sag.write_map(map_, path, "tiff32", scale(w))
    pixels = read_tiff(path)
    x, y = map_.origin[0] + 0.5 * map_.pixel, map_.origin[1] + (map_.height - 0.5) * map_.pixel
    centre = w.lattice.centres(np.array([0, w.lattice.count[1] - 1])) + np.array(w.shifts[0])
    with mpmath.workdps(30):
        local = [mpmath.mpf(x) - centre[0] - face.vertex[0], mpmath.mpf(y) - centre[1] - face.vertex[1]]
        r = [[mpmath.mpf(float(v)) for v in row] for row in face.rotation]
        s = face.surface

        def miss(z: mpmath.mpf) -> mpmath.mpf:
            p = [*local, z - face.vertex[2]]
            a, b, c = (sum(r[k][m] * p[k] for k in range(3)) for m in range(3))
            return s.curvature_x * a * a + s.curvature_y * b * b + s.kappa * c * c - 2 * s.side * c

        z = mpmath.findroot(miss, face.vertex[2])
        height = -(z - map_.reference) * scale(w)
    assert float(pixels[0, 0]) == pytest.approx(float(height), rel=1e-6)


@pytest.mark.parametrize("name", CASES)
def test_points_and_grid_sag_lie_on_the_surfaces(tmp_path: Path, name: str) -> None:
    w = window(name)
    for body, face, label in sag.structured_faces(w):
        path = tmp_path / f"{label}.xyz"
        count = sag.write_points(w, body, face, 6, path, scale(w))
        assert count > 0
        sag.check_points(w, face, path, scale(w), count)
        grid = tmp_path / f"{label}.dat"
        sag.write_grid_sag(w, face, 16, grid, scale(w))
        sag.check_grid_sag(face, grid, scale(w))


def test_normals_are_the_slopes_of_neighbouring_points(tmp_path: Path) -> None:
    w = window("slab.toml")
    body, face, _ = sag.structured_faces(w)[1]
    path = tmp_path / "p.xyz"
    sag.write_points(w, body, face, 32, path, scale(w))
    points = np.loadtxt(path)[: 32 * 32].reshape(32, 32, 6)
    inner = points[1:-1, 1:-1]
    along = points[1:-1, 2:, :3] - points[1:-1, :-2, :3]
    across = points[2:, 1:-1, :3] - points[:-2, 1:-1, :3]
    normal = np.cross(along, across)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    np.testing.assert_allclose(inner[..., 3:], normal, atol=2e-4)


@pytest.mark.parametrize("name", CASES)
def test_the_surface_table_alone_gives_the_faces(tmp_path: Path, name: str) -> None:
    w = window(name)
    count = pose_table.write_table_csv(w, tmp_path / "t.csv", scale(w))
    pose_table.write_table_json(w, tmp_path / "t.json", scale(w))
    pose_table.check_table(w, tmp_path / "t.json", tmp_path / "t.csv", scale(w), count)


@pytest.mark.parametrize(("key", "change"), [("curvature_x_per_mm", 1e-6), ("kappa_per_mm", 1e-3)])
def test_a_changed_coefficient_is_noticed(tmp_path: Path, key: str, change: float) -> None:
    w = window("tilted.toml")
    count = pose_table.write_table_csv(w, tmp_path / "t.csv", scale(w))
    written = pose_table.surface_table(w, scale(w))
    written["faces"][0][key] *= 1 + change
    (tmp_path / "t.json").write_text(json.dumps(written))
    with pytest.raises(FileDisagrees):
        pose_table.check_table(w, tmp_path / "t.json", tmp_path / "t.csv", scale(w), count)


def test_swapped_lenslets_are_noticed(tmp_path: Path) -> None:
    w = window("tilted.toml", (2, 1))
    count = pose_table.write_table_csv(w, tmp_path / "t.csv", scale(w))
    pose_table.write_table_json(w, tmp_path / "t.json", scale(w))
    with (tmp_path / "t.csv").open(newline="") as stream:
        rows = list(csv.reader(stream))
    rows[1][3], rows[2][3] = rows[2][3], rows[1][3]
    with (tmp_path / "t.csv").open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)
    with pytest.raises(FileDisagrees):
        pose_table.check_table(w, tmp_path / "t.json", tmp_path / "t.csv", scale(w), count)


@pytest.mark.parametrize("name", CASES)
def test_masks_show_every_lens_in_its_place(tmp_path: Path, name: str) -> None:
    w = window(name)
    for body, face, label in sag.structured_faces(w):
        svg, dxf = tmp_path / f"{label}.svg", tmp_path / f"{label}.dxf"
        mask.write_svg(w, body, face, label, svg, scale(w))
        mask.write_dxf(w, body, face, label, dxf, scale(w))
        mask.check_mask(w, face, svg, dxf, scale(w))


def test_a_rim_of_a_lens_without_web_is_where_front_meets_back() -> None:
    """Lens 2 of the paper's base does not cover its cell: its rim is the ellipse where the sag is T/2."""
    w = window("paper-base.toml")
    body = w.bodies[1]
    outline = mask.aperture(w, body, body.front)
    half = 0.5 * w.lattice.pitch[0]
    on_rim = np.abs(outline).max(axis=1) < half * (1 - 1e-9)
    assert on_rim.any()
    assert not on_rim.all()
    s = body.front.surface
    thickness = body.back.vertex[2] - body.front.vertex[2]
    x, y = outline[on_rim].T - np.array(body.front.vertex[:2])[:, None]
    z = 0.5 * thickness
    left = s.curvature_x * x * x + s.curvature_y * y * y + s.kappa * z * z - 2 * z
    np.testing.assert_allclose(left, 0.0, atol=1e-12 * thickness)


def damaged(path: Path, at: float, value: int) -> None:
    data = bytearray(path.read_bytes())
    data[int(at * (len(data) - 1))] ^= value
    path.write_bytes(data)


@pytest.mark.parametrize("kind", ["tiff32", "tiff16", "png16"])
def test_cut_maps_are_refused(tmp_path: Path, kind: str) -> None:
    w = window("slab.toml")
    body, face, label = sag.structured_faces(w)[0]
    map_ = sag.height_map(w, body, face, label, 8)
    path = tmp_path / "m"
    sag.write_map(map_, path, kind, scale(w))
    data = path.read_bytes()
    for cut in (0, 3, 20, 100, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:cut])
        with pytest.raises(UnreadableFile):
            sag.check_map(map_, path, kind, scale(w))
    if kind == "png16":
        path.write_bytes(data)
        damaged(path, 0.5, 1)
        with pytest.raises(UnreadableFile):
            sag.check_map(map_, path, kind, scale(w))


def write_all(folder: Path) -> None:
    w = window("tilted-seam.toml")
    for body, face, label in sag.structured_faces(w):
        map_ = sag.height_map(w, body, face, label, 8)
        for kind in ("tiff32", "tiff16", "png16"):
            sag.write_map(map_, folder / f"{label}.{kind}", kind, scale(w))
        sag.write_points(w, body, face, 4, folder / f"{label}.xyz", scale(w))
        sag.write_grid_sag(w, face, 8, folder / f"{label}.dat", scale(w))
        mask.write_svg(w, body, face, label, folder / f"{label}.svg", scale(w))
        mask.write_dxf(w, body, face, label, folder / f"{label}.dxf", scale(w))
    pose_table.write_table_csv(w, folder / "t.csv", scale(w))
    pose_table.write_table_json(w, folder / "t.json", scale(w))


@pytest.mark.slow
def test_the_same_bytes_in_another_process_with_another_hash_seed_and_locale(tmp_path: Path) -> None:
    ours, theirs = tmp_path / "a", tmp_path / "b"
    ours.mkdir()
    theirs.mkdir()
    write_all(ours)
    path = os.pathsep.join(
        [str(Path(__file__).parents[1]), str(Path(__file__).parent), *filter(None, sys.path)]
    )
    env = os.environ | {
        "PYTHONHASHSEED": "3",
        "TZ": "Asia/Tokyo",
        "LC_ALL": "de_DE.UTF-8",
        "PYTHONPATH": path,
    }
    code = "import sys, pathlib, test_export_maps; test_export_maps.write_all(pathlib.Path(sys.argv[1]))"
    subprocess.run([sys.executable, "-c", code, str(theirs)], check=True, env=env, cwd=tmp_path)
    assert {p.name: p.read_bytes() for p in ours.iterdir()} == {
        p.name: p.read_bytes() for p in theirs.iterdir()
    }
