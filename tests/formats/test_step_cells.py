"""STEP of non-uniform sheets: cells written in arrays are those that are described one by one, as OCC reads them."""

from __future__ import annotations

import numpy as np
import pytest

import clacad
from clacad.formats.step import step_files
from clacad.formats.step.read_back import read_step
from clacad.formats.step.shell_text import TextWriter
from clacad.solid.lens_faces import quadric_lens
from clacad.solid.rational_conics import LensArray, posed

SLAB = {"form": "slab", "separation": 10.0, "material": "PMMA"}
EYE = {"point": [-40.0, 10.0, -400.0]}
SHEETS = {
    "round": ({}, {"count": [6, 6], "outline": {"circle": 3.0}, "aperture": {"point": [0.0, 0.0, -400.0]}}),
    "hexagonal": ({}, {"kind": "hexagonal", "count": [6, 6], "aperture": EYE}),
    "tilted and varying": (
        {"euler": [4.0, 2.0, 0.0], "varying": {"gradient": [[0.004, 0.0], [0.0, 0.004]]}}, {"count": [6, 6]},
    ),
    "turned": ({}, {"count": [6, 6], "rotation_2": "0.2 deg"}),
}  # fmt: skip


def sheet(name):
    law, lattice = SHEETS[name]
    pair = SLAB | ({"surface": "biconic", "conic": [-0.7, -0.7]} if name == "round" else {})
    made = {"format": 1, "name": "s", "unit": "mm", "law": {"eta": [-1.0, -1.0], **law}, "pair": pair}
    return clacad.prescribe(clacad.Design.from_dict(made | {"lattice": {"pitch": 0.5, **lattice}}))


@pytest.mark.ci_cases("hexagonal", "tilted and varying")
@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "round" else pytest.mark.slow) for name in SHEETS]
)
def test_cells_in_arrays_are_the_solid_of_cells_one_by_one(tmp_path, monkeypatch, name):
    window = sheet(name)
    arrays = step_files.write_step(window, tmp_path / "arrays.step")
    monkeypatch.setattr(step_files, "SheetWriter", TextWriter)
    single = step_files.write_step(window, tmp_path / "single.step")
    for key in ("solids", "faces", "saddles", "wedges"):
        assert arrays[key] == single[key], key
    assert arrays["bodies"][0]["faces"] == single["bodies"][0]["faces"]
    found, expected = (
        read_step(tmp_path / f"{one}.step", window, kernel=True) for one in ("arrays", "single")
    )
    assert found["valid"]
    assert found["open_edges"] == found["dangling"] == 0
    assert (found["kernel_solids"], found["kernel_faces"]) == (
        expected["kernel_solids"],
        expected["kernel_faces"],
    )
    assert found["volume"] == pytest.approx(expected["volume"], rel=1e-9)
    assert found["area"] == pytest.approx(expected["area"], rel=1e-9)
    assert found["lens_error"] < 1e-12
    assert found["patch_error"] < 1e-12


def test_patches_and_arcs_in_arrays_lie_on_their_quadrics_with_one_parameter():
    rng = np.random.default_rng(7)
    tile = 0.25 * np.array([(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)])
    turn = np.linalg.qr(np.eye(3) + 0.1 * rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.diag(turn))
    curvatures, apex = rng.uniform(0.2, 0.5, (5, 3)), rng.uniform(-0.05, 0.05, (5, 3))
    lenses = LensArray(0, 1, None, turn, curvatures, apex)
    made = lenses.geometry(tile, np.roll(tile, -1, axis=0))
    t = np.linspace(0.0, 1.0, 7)
    for n in range(5):
        quadric = posed(tuple(curvatures[n]), 1, turn, apex[n])
        lens = quadric_lens(quadric, made.arcs[n].reshape(-1, 3))
        patch = lens.patch
        assert np.abs(patch.poles - made.patch[n]).max() < 1e-13
        assert np.abs(patch.weights - made.patch_weights[n]).max() < 1e-13
        for k in range(4):
            arc = lens.arc(tile[k], tile[(k + 1) % 4])
            assert np.abs(arc.at(t) - _at(made.arcs[n, k], made.weights[n, k], t)).max() < 1e-13
            assert np.abs(quadric.value(arc.at(t))).max() < 1e-14
            u, v = _at(made.curves[n, k], made.curve_weights[n, k], t).T
            assert np.abs(patch.at(u, v) - arc.at(t)).max() < 1e-12


def _at(poles, weights, t):
    basis = np.column_stack([(1 - t) ** 2, 2 * t * (1 - t), t**2]) * weights
    return (basis @ poles) / basis.sum(axis=1)[:, None]
