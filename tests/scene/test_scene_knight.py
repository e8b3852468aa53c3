"""The two chess knights: the sculpted one is a closed solid, the built-in one looks the same way."""

from __future__ import annotations

import importlib.util
import sys

import numpy as np
import pytest
from viewscenes import ROOT

from clacad.formats.mesh.readers import read_mesh
from clacad.rendering import view_through
from clacad.scene import Scene

FILE = ROOT / "designs" / "chess-knight.stl"


def corners():
    return np.concatenate(list(read_mesh(FILE).chunks()))


def test_the_shipped_knight_is_closed_stands_on_the_ground_and_is_1_high():
    found = corners()
    _, names = np.unique(found.reshape(-1, 3), axis=0, return_inverse=True)
    faces = names.reshape(-1, 3)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forward = {tuple(edge) for edge in edges}
    assert len(forward) == len(edges)  # each directed edge once ...
    assert all((b, a) in forward for a, b in forward)  # ... and once the other way round
    assert found[..., 1].min() == 0.0
    assert found[..., 1].max() == 1.0
    volume = np.einsum("ij,ij->i", found[:, 0], np.cross(found[:, 1], found[:, 2])).sum() / 6.0
    assert 0.05 < volume < 0.08  # outward


def outline(thing):
    """Silhouette of a piece seen along +z, +x to the right."""
    scene = Scene.from_dict(
        {
            "format": 1, "name": "k", "unit": "m", "sheet": {"design": "designs/paper-base.toml", "rung": "law"},
            "camera": {"position": [0, 0.5, -200], "target": [0, 0.5, 0], "frame": 1.2, "pixels": [120, 120],
                       "samples": 1, "mirror": True},
            "light": {"ambient": 1.0, "key": 0.0}, "effects": {"mode": "none"},
            "background": {"sky": [[0, 0, 0], [0, 0, 0]], "ground": [0, 0, 0]},
            "object": [{"id": "k", "at": [0, 0, 0], "size": 1.0, "colour": [1.0, 1.0, 1.0], **thing}],
        },
        folder=str(ROOT),
    )  # fmt: skip
    return view_through(scene, sheet=False).light.max(axis=-1) > 0.0


def test_both_knights_face_minus_x_and_have_nearly_one_silhouette():
    built_in = outline({"kind": "knight"})
    sculpted = outline({"kind": "mesh", "file": "designs/chess-knight.stl"})
    both, either = (built_in & sculpted).sum(), (built_in | sculpted).sum()
    assert both / either > 0.8
    for seen in (built_in, sculpted):
        muzzle = seen[45:60]  # at 0.55 … 0.68 of the height
        columns = np.nonzero(muzzle)[1]
        assert columns.min() < 40  # the nose reaches far to −x; the neck is to +x
        assert columns.max() < 90


@pytest.mark.long
def test_the_shipped_mesh_is_that_of_the_parametric_model():
    spec = importlib.util.spec_from_file_location("chess_knight", ROOT / "designs" / "chess-knight.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["chess_knight"] = module
    spec.loader.exec_module(module)
    piece = module.knight()
    assert piece.is_valid
    made, shipped = module.triangles(piece), corners()
    volumes = [
        np.einsum("ij,ij->i", c[:, 0], np.cross(c[:, 1], c[:, 2])).sum() / 6.0 for c in (made, shipped)
    ]
    assert volumes[0] == pytest.approx(volumes[1], rel=1e-3)
    assert volumes[0] == pytest.approx(piece.volume, rel=5e-3)
    slim = module.knight(module.Knight(neck=0.20, grooves=5))
    assert slim.volume < piece.volume
