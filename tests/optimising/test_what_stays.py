"""A search changes faces and nothing else: plates, cells and the share of light stay. Light is traced by the test's own Newton and Snell."""

from __future__ import annotations

from math import radians

import numpy as np
import pytest
from trust.running import clacad as run

from clacad import Design, DesignError, optimise, prescribe
from clacad.advice import advise, judge
from clacad.advice.lever_trials import levers_of
from clacad.optimising import aim as light_in_cells
from clacad.optimising.face_search import FaceSearch
from clacad.optimising.search import design_text

COUNT = 6000

LAWS = {
    "straight": {},
    "offset": {"delta": [0.01, -0.02]},
    "tilted": {"euler": [30.0, 1.0, 20.0]},
    "both": {"delta": [0.01, -0.02], "euler": [30.0, 1.0, 20.0]},
}

PAIRS = {
    "biconvex": {"form": "biconvex", "separation": 8.0},
    "plano": {"form": "plano", "separation": 8.0, "thickness": [1.5, 1.5]},
    "plano inside": {"form": "plano", "curved": "inside", "separation": 8.0, "thickness": [1.5, 1.5]},
    "slab": {"form": "slab", "separation": 8.0},
}


def made(pair, law, **more):
    """A sheet of 5 × 5 cells of η (−.5, −1)."""
    return Design.from_dict({
        "format": 1, "name": "stays", "unit": "mm", "law": {"eta": [-0.5, -1.0], **LAWS[law]},
        "pair": {"material": "PMMA", **PAIRS[pair], **more}, "lattice": {"kind": "square", "pitch": 0.5, "count": [5, 5]},
    })  # fmt: skip


def landed(window, field):
    """Share (of rays over the middle cell in a cone of `field` radians) that lands in the partner cell, and rms error (mrad)."""
    rng = np.random.default_rng(20)
    half = 0.5 * window.lattice.pitch[0]
    low = window.z_range[0] - 1.0
    middle = np.array([*_field_slope(window), 1.0])
    turn = field * np.sqrt(rng.uniform(size=COUNT))
    azimuth = rng.uniform(0.0, 2.0 * np.pi, COUNT)
    ray = middle + np.column_stack([turn * np.cos(azimuth), turn * np.sin(azimuth), np.zeros(COUNT)])
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    point = np.column_stack([rng.uniform(-half, half, (COUNT, 2)), np.zeros(COUNT)])
    point += ((low - point[:, 2]) / ray[:, 2])[:, None] * ray
    asked, index, inside = window.law.refract(ray), 1.0, np.ones(COUNT, dtype=bool)
    for body in window.bodies:
        for face, after in ((body.front, body.index), (body.back, 1.0)):
            point, normal = _met(face, point, ray, 0.0 if face.array is None else window.shifts[face.array])
            if face.array is not None:
                inside &= np.abs(point[:, :2] - window.shifts[face.array]).max(axis=1) <= half
            mu, along = index / after, (ray * normal).sum(axis=1)
            ray = mu * ray + (np.sqrt(1.0 - mu * mu * (1.0 - along**2)) - mu * along)[:, None] * normal
            index = after
    inside &= np.isfinite(ray).all(axis=1)
    error = np.linalg.norm(ray - asked, axis=1)[inside]
    return float(inside.mean()), 1e3 * float(np.sqrt(np.mean(error**2)))


def _field_slope(window):
    """Slope from the middle of cell 1 to that of cell 2 of the thin pair that represents the sheet."""
    return np.asarray(window.thin.shift) / window.thin.offset[2]


def _met(face, point, ray, shift):
    """Where rays meet a face, and its unit normals along the light: Newton on the heights of its own numbers."""
    vertex = np.array(face.vertex) + [*np.broadcast_to(shift, 2), 0.0]
    if face.array is None:
        on = point + ((vertex[2] - point[:, 2]) / ray[:, 2])[:, None] * ray
        return on, np.broadcast_to([0.0, 0.0, 1.0], on.shape)
    local, way = (point - vertex) @ face.rotation, ray @ face.rotation
    local = local - (local[:, 2] / way[:, 2])[:, None] * way
    for _ in range(7):
        z, (sx, sy) = _height(face.surface, local[:, 0], local[:, 1])
        local = local - ((local[:, 2] - z) / (way[:, 2] - sx * way[:, 0] - sy * way[:, 1]))[:, None] * way
    _, (sx, sy) = _height(face.surface, local[:, 0], local[:, 1])
    normal = np.column_stack([-sx, -sy, np.ones(len(sx))])
    return local @ face.rotation.T + vertex, (
        normal / np.linalg.norm(normal, axis=1)[:, None]
    ) @ face.rotation.T


def _height(surface, x, y):
    """Height and slopes of a conic with terms of fourth order, by its textbook formula; convex faces rise towards their side's air."""
    cx, cy = surface.curvature_x, surface.curvature_y
    if hasattr(surface, "kappa"):
        squares, a = (cx * surface.kappa, cy * surface.kappa), (0.0, 0.0, 0.0)
    else:
        squares = ((1.0 + surface.conic_x) * cx**2, (1.0 + surface.conic_y) * cy**2)
        a = getattr(surface, "a4", (0.0, 0.0, 0.0))

    def height(x, y):
        root = np.sqrt(1.0 - squares[0] * x * x - squares[1] * y * y)
        sag = (cx * x * x + cy * y * y) / (1.0 + root)
        return surface.side * (sag + a[0] * x**4 + a[1] * x * x * y * y + a[2] * y**4)

    h = 1e-5
    slopes = (
        (height(x + h, y) - height(x - h, y)) / (2 * h),
        (height(x, y + h) - height(x, y - h)) / (2 * h),
    )
    return height(x, y), slopes


def assert_only_faces_changed(start, found):
    """Vertices, plane faces, pitch and cells to 1e-12 of the separation, the part's height but for the lenses' own relief."""
    one, two = prescribe(start), prescribe(found.design)
    size = 1e-12 * one.thin.separation
    np.testing.assert_allclose(
        [f.vertex for f in two.faces], [f.vertex for f in one.faces], rtol=0.0, atol=size
    )
    np.testing.assert_allclose(two.shifts, one.shifts, rtol=0.0, atol=size)
    assert two.outline == one.outline
    assert two.lattice == one.lattice
    assert two.thin.separation == one.thin.separation
    height = [w.z_range[1] - w.z_range[0] for w in (one, two)]
    # the top of a face of radius R whose axis leans by θ lies R θ²/2 over its vertex, its conic constant changes that by R θ⁴
    lean = np.arccos(min(1.0, one.thin.rotation[2, 2]))
    relief = sum(
        np.abs(_radii(new) - _radii(old)).max() * lean**2 / 2.0 + _radii(old).max() * lean**4
        for old, new in zip(one.faces, two.faces, strict=True) if old.array is not None
    )  # fmt: skip
    assert height[1] == pytest.approx(height[0], abs=size + relief)
    for part in (0.5, 1.0, 2.0):
        (share, error), (now, left) = (landed(w, part * radians(1.0)) for w in (one, two))
        assert now >= share - 0.02
        assert left <= error


def _radii(face):
    return 1.0 / np.array([face.surface.curvature_x, face.surface.curvature_y])


@pytest.mark.ci_cases(
    "biconvex-tilted-conic", "plano-offset-conic", "plano inside-both-a4", "slab-straight-a4"
)
@pytest.mark.slow
@pytest.mark.parametrize(
    ("pair", "law", "word"),
    [(p, w, ("conic", "a4")[(i + j) % 2]) for i, p in enumerate(PAIRS) for j, w in enumerate(LAWS)],
)
def test_a_search_changes_faces_and_neither_plates_nor_cells_nor_share(pair, law, word):
    """Each form of pair with each law, each of both with either word."""
    start = made(pair, law)
    assert_only_faces_changed(start, optimise(start, ("radii", word)))


@pytest.mark.slow
@pytest.mark.parametrize(("pair", "more"), [("slab", {}), ("biconvex", {}), ("plano", {"thickness": "auto"})])
def test_with_a_field_lens_the_same_stays(pair, more):
    start = made(pair, "straight", field_lens=True, **more)
    found = optimise(start, ("radii", "conic", "field"))
    one, two = prescribe(start), prescribe(found.design)
    np.testing.assert_allclose(
        [f.vertex for f in two.faces], [f.vertex for f in one.faces], rtol=0.0, atol=8e-12
    )
    assert all(
        after.throughput >= before.throughput - 0.02
        for before, after in zip(found.before, found.after, strict=True)
    )


@pytest.mark.ci_cases("offset", "tilted")
@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_faces_that_were_given_are_searched_from_where_they_are(law):
    first = optimise(made("plano", law), ("radii",)).design
    assert_only_faces_changed(first, optimise(first, ("radii", "a4")))


def test_given_faces_of_a_tilted_pair_are_mounted_where_derived_faces_are():
    """The air gap of the same plates does not depend on the faces: radii 30 times as long move nothing."""
    start = made("plano", "both")
    lens = prescribe(start).recipe["R"]
    flat = {"radius": ["inf", "inf"]}
    faces = [{"radius": [30.0 * r for r in lens[0]]}, flat, flat, {"radius": [30.0 * r for r in lens[1]]}]
    given = start.replace(
        {"pair.prescription": "given", "pair.face": faces, "pair.vertex": prescribe(start).recipe["d"]}
    )
    np.testing.assert_allclose(
        [f.vertex for f in prescribe(given).faces], [f.vertex for f in prescribe(start).faces], atol=8e-12
    )


def test_the_best_scale_of_the_radii_of_a_tilted_pair_leaves_the_plates_where_they_are():
    """Radii scaled for the least error once drew the plates 142 mm apart, from 7.5 mm."""
    exact, best = prescribe(made("plano", "tilted")), prescribe(made("plano", "tilted", confocal="best"))
    np.testing.assert_allclose([f.vertex for f in best.faces], [f.vertex for f in exact.faces], atol=8e-12)
    assert 1.0 < best.recipe["scale"] < 1.01


@pytest.fixture(scope="module")
def better():
    start = made("plano", "both")
    return start, optimise(start, ("radii", "conic"))


def test_the_text_says_where_lens_2_was_held(better):
    start, found = better
    assert f"vertex = {prescribe(start).recipe['d']}" in design_text(found)


@pytest.mark.long
def test_advice_for_a_design_that_was_searched_for_changes_nothing_that_the_search_held(better):
    """Where limits fail that a larger separation would meet: it is advised for the start, and not for the faces found."""
    keys = []
    for design in (better[0], better[1].design):
        strict = design.replace({"check.law_rms": "0.08 mrad"})
        assert "law_rms" in {check.id for check, _ in advise(strict).hints}
        keys.append([key for _, hints in advise(strict).hints for hint in hints for key in hint.changes])
    assert "pair.separation" in keys[0]
    assert not [key for key in keys[1] if key.startswith(("pair.", "lattice.pitch", "lattice.aperture"))]


def test_nothing_that_a_search_held_is_tried_to_mend_what_it_found(better):
    start, found = better
    checks = judge(start.replace({"check.law_rms": "0.08 mrad"})).failing
    before, after = ({lever.key for lever in levers_of(design, checks)} for design in (start, found.design))
    assert {"pair.separation", "lattice.pitch", "lattice.aperture"} <= before
    assert not after & {"pair.separation", "pair.thickness", "lattice.pitch", "lattice.aperture"}


def test_a_search_whose_only_gains_cost_light_writes_nothing_and_says_so(tmp_path, monkeypatch):
    """A wall of the share that every change passes."""
    monkeypatch.setattr(
        light_in_cells.LightInCells,
        "slack",
        lambda self, window: {"share of light": 1.0 if first in (None, window) else -1.0},
    )
    start = made("plano", "straight")
    first = None
    real = FaceSearch._trial

    def trial(self, vector):
        nonlocal first
        window = real(self, vector)
        first = window if np.array_equal(vector, self.unknowns.vector) else first
        return window

    monkeypatch.setattr(FaceSearch, "_trial", trial)
    with pytest.raises(
        DesignError,
        match="better than the start, .* beyond the wall of the share of light; nothing is written",
    ):
        optimise(start, ("radii",))


@pytest.mark.slow
def test_a_search_from_its_own_result_writes_no_second_file(tmp_path, better):
    (tmp_path / "one.toml").write_text(design_text(better[1]))
    ended = run("optimise", "one.toml", "-o", "two.toml", "--free", "radii", cwd=tmp_path)
    assert ended.status == 2
    assert "better than the start" in ended.err
    assert [p.name for p in tmp_path.iterdir()] == ["one.toml"]
