"""Meshes that are written as they are made: shared vertices, files read row by row, against numpy and trimesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

import clacad
from clacad.exporting.tessellations import Tessellation
from clacad.formats.mesh import file_mesh
from clacad.formats.mesh.file_mesh import FileRows
from clacad.formats.mesh.glb import write_glb
from clacad.formats.mesh.measure import Welder
from clacad.formats.mesh.ply import write_ply
from clacad.formats.mesh.readers import read_mesh
from clacad.formats.mesh.threemf import write_threemf
from clacad.sheet.window import Window

DESIGNS = Path(__file__).parents[2] / "designs"


def aimed(**changes: object) -> Window:
    """A round sheet whose cells all differ, ringed by land."""
    keys = {
        "lattice.count": [9, 9], "lattice.aperture": {"point": [0, 0, -400]}, "pair.surface": "biconic",
        "pair.conic": [-0.7, -0.7], "check.process": "none", "lattice.outline": {"circle": 3.5},
    }  # fmt: skip
    return clacad.prescribe(clacad.load(str(DESIGNS / "window-100mm.toml")).replace(keys | changes))


def numbered(rows: np.ndarray) -> tuple[list[int], list[tuple[float, ...]]]:
    """Numbers of rows in the order they come, by a plain dictionary, and the distinct rows."""
    seen: dict[tuple[float, ...], int] = {}
    return [seen.setdefault(tuple(row), len(seen)) for row in (rows + 0.0).tolist()], list(seen)


@pytest.mark.parametrize("columns", [3, 6])
def test_rows_are_numbered_as_by_a_dictionary_across_blocks_and_generations(columns: int) -> None:
    rng = np.random.default_rng(3)
    named = rng.integers(0, 3, (5, columns)).astype(np.float64)
    blocks = [rng.integers(-2, 3, (700, columns)) * np.where(rng.random((700, 1)) < 0.5, 1.0, -0.0 + 1.0)
              for _ in range(3)]  # fmt: skip
    blocks[1][:50] = -0.0
    weld, found = Welder(named), []
    for number, block in enumerate(blocks):
        if number == 2:
            weld.begin()  # rows of the second block are still known
        found.append(weld.numbers(block)[0])
    wanted, distinct = numbered(np.concatenate(blocks))
    assert np.concatenate(found).tolist() == wanted
    assert weld.count == len(distinct)


def test_rows_of_generations_before_the_last_are_new_unless_they_were_named() -> None:
    rows = np.arange(12.0).reshape(4, 3)
    weld = Welder(rows[:1])
    assert weld.numbers(rows)[0].tolist() == [0, 1, 2, 3]
    weld.begin()
    assert weld.numbers(rows[2:3])[0].tolist() == [2]  # met again: kept for one more generation
    weld.begin()
    numbers, fresh = weld.numbers(rows)
    assert (numbers.tolist(), fresh.tolist()) == ([0, 4, 2, 5], [1, 3])


def test_vertices_of_a_sheet_whose_cells_differ_are_shared_as_by_a_dictionary() -> None:
    """Vertices with normals in the order of the facets; without, each edge has its two facets."""
    made = Tessellation(aimed(), 3)
    (body,) = made.mesh.bodies
    (piece,) = made.pieces(False, normals=True)
    from clacad.mesh.tessellation import shaded_rows

    rows = np.concatenate([np.concatenate(both, axis=2).reshape(-1, 6) for both in shaded_rows(body)])
    numbers, distinct = numbered(rows)
    vertices, normals, triangles = piece.whole
    assert normals is not None
    assert triangles.ravel().tolist() == numbers
    assert np.array_equal(np.concatenate([vertices, normals], axis=1), np.array(distinct))
    plain = made.pieces(False, normals=False)[0].whole
    assert len(plain.vertices) == len(body.vertices)  # by keys of cells, points and levels
    edges = np.sort(np.concatenate([plain.triangles[:, [a, (a + 1) % 3]] for a in range(3)]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


@pytest.mark.parametrize("suffix", [".glb", ".ply", ".3mf"])
def test_files_read_row_by_row_are_those_held_in_memory_and_those_of_trimesh(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, made = tmp_path / f"sheet{suffix}", Tessellation(aimed(), 3)
    write = {".glb": write_glb, ".ply": write_ply, ".3mf": write_threemf}[suffix]
    write(made.pieces(False, normals=suffix != ".3mf"), path, 1.0, "sheet")
    held = np.concatenate(list(read_mesh(path).chunks()))
    monkeypatch.setattr(file_mesh, "HELD", 0)
    monkeypatch.setattr(file_mesh, "CHUNK", 50)
    found = read_mesh(path)
    assert np.array_equal(np.concatenate(list(found.chunks(64))), held)
    if suffix != ".3mf":
        assert isinstance(found.parts[0].triangles, FileRows)
        some = np.random.default_rng(1).integers(0, found.facet_count, 40)

        picked = found.parts[0].picked(some)
        place = found.parts[0].placements[0]
        np.testing.assert_array_equal(picked @ place[:3] + place[3], held[some])
        other = trimesh.load(path, force="mesh", process=False)
        np.testing.assert_allclose(other.triangles, held, rtol=1e-6, atol=1e-7)
    low, high = found.parts[0].own_box()
    place = found.parts[0].placements[0]
    np.testing.assert_allclose(np.stack([low, high]) @ place[:3] + place[3],
                               [held.min(axis=(0, 1)), held.max(axis=(0, 1))], rtol=1e-12)  # fmt: skip


@pytest.mark.slow
def test_a_ply_file_of_another_form_is_read_as_before(tmp_path: Path) -> None:
    """Single precision and a quad go to the general reader."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype="<f4")
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    head += "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    path = tmp_path / "quad.ply"
    path.write_bytes(head.encode() + vertices.tobytes() + bytes([4]) + np.arange(4, dtype="<i4").tobytes())
    assert read_mesh(path).facet_count == 2


def test_a_file_cut_after_it_was_opened_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(file_mesh, "HELD", 0)
    path = tmp_path / "cut.glb"
    write_glb(Tessellation(aimed(), 2).pieces(False, normals=True), path, 1.0, "cut")
    found = read_mesh(path)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(clacad.storage.errors.UnreadableFile, match=r"cut\.glb: it ends before row"):
        list(found.chunks())
