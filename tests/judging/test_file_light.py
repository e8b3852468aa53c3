"""Light through a file against the law: what the checks measure is what was done to the file."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from filesonly import only_files
from oracle.plain_mesh import facets, write_stl

from clacad.design import Design
from clacad.design.starter_designs import template
from clacad.exporting.roles import Role
from clacad.exporting.run import export
from clacad.formats.maps.sag import read_points
from clacad.judging.delivery import Inspection
from clacad.judging.file_light import light_checks, measure_light
from clacad.optics.rays import Fate, Rays, TraceResult
from clacad.optics.sequence import trace_sequence
from clacad.prescription.prescribe import prescribe
from clacad.sheet.bundle import bundle
from clacad.sheet.like_cell import interfaces
from clacad.sheet.representative_cells import central_cell
from clacad.storage.errors import UnreadableFile
from clacad.tracing.facets.telescopelet import height_and_slope, meet_sampled, sampled_face
from clacad.tracing.trace import trace
from clacad.verification import verify

DESIGN = Design.from_dict({
    "format": 1, "name": "pair", "unit": "mm", "law": {"eta": [-0.5, -1.0], "delta": [0.02, -0.01]},
    "pair": {"form": "biconvex", "separation": 10.0, "thickness": "auto", "index": 1.5},
    "lattice": {"pitch": 1.0, "count": [5, 5]},
})  # fmt: skip
SLAB = Design.from_dict({
    "format": 1, "name": "slab", "unit": "mm", "law": {"eta": [-0.5, -1.0]},
    "pair": {"form": "slab", "separation": 10.0, "index": 1.5}, "lattice": {"pitch": 0.5, "count": [5, 5]},
})  # fmt: skip
RAYS = 8192
SAMPLES = json.loads((Path(__file__).parents[1] / "data" / "plates.json").read_text(encoding="utf-8"))[
    "cases"
]


def through(window, slide):
    """Send rays through the exact faces with array 2 displaced."""
    seq = interfaces(window, np.asarray(slide))

    def send(lit) -> TraceResult:
        centre = window.lattice.centres(np.array([lit.cell]))[0]
        moved = trace_sequence(seq, Rays(lit.rays.position - [*centre, 0.0], lit.rays.direction))
        inside = trace(window, lit.rays).fate == Fate.ALIVE
        return replace(
            moved, fate=np.where(inside & (moved.fate == Fate.ALIVE), Fate.ALIVE, Fate.WALL).astype(np.uint8)
        )

    return send


@pytest.mark.ci_cases("-0.01-biconvex", "0.003-slab")
@pytest.mark.daily_cases("-0.01-slab")
@pytest.mark.parametrize("design", [DESIGN, SLAB], ids=["biconvex", "slab"])
@pytest.mark.parametrize("part", [-0.01, 0.0, 0.003])
def test_the_shift_that_was_made_is_the_shift_that_is_found(design, part):
    window = prescribe(design)
    distance = 10.0 * (1.5 if design is SLAB else 1.0)
    found = measure_light(design, window, through(window, [0.0, 0.0, part * distance]), RAYS, 512)
    np.testing.assert_allclose(found.shift, -part, rtol=0.03, atol=5e-5)  # rays on borders enter next door
    # the same by brute force: the shift with the least rms to the law, of the moved pair less of the pair as designed
    asked = window.law.refract(found.light.lit.rays.direction)
    both = (found.light.seen.fate == Fate.ALIVE) & (found.compared.exact.seen.fate == Fate.ALIVE)
    least = []
    for start in (part, 0.0):
        slides = np.linspace(-0.02, 0.02, 9)
        squares = []
        for slide in slides:
            seen = through(window, [0.0, 0.0, (start + slide) * distance])(found.light.lit)
            good = both & (seen.fate == Fate.ALIVE)
            off = (seen.direction - asked)[good] @ window.thin.rotation[:, :2]
            squares.append((off**2).mean(axis=0))
        a, b, _ = np.polyfit(slides, np.array(squares), 2)
        least.append(-0.5 * b / a)
    np.testing.assert_allclose(found.shift, least[0] - least[1], rtol=0.1, atol=1e-4)


def test_exact_faces_are_off_by_nothing_but_the_designs_own_aberration():
    window = prescribe(DESIGN)
    found = measure_light(DESIGN, window, lambda lit: trace(window, lit.rays), RAYS, 512)
    truth = trace(window, found.light.lit.rays)
    asked = window.law.refract(found.light.lit.rays.direction)
    alive = truth.fate == Fate.ALIVE
    cosine = np.einsum("ij,ij->i", truth.direction[alive], asked[alive])
    sine = np.linalg.norm(np.cross(truth.direction[alive], asked[alive]), axis=1)
    assert found.light.rms == pytest.approx(np.sqrt(np.mean(np.arctan2(sine, cosine) ** 2)), rel=1e-12)
    assert (found.compared.laws[0].eta_x, found.compared.laws[0].eta_y) == (
        found.compared.laws[1].eta_x,
        found.compared.laws[1].eta_y,
    )
    np.testing.assert_allclose(found.shift, 0.0, atol=1e-10)
    assert found.field[0] == alive.mean()


def test_a_wrong_offset_is_found_as_delta():
    window = prescribe(DESIGN)
    f1 = 10.0 / (1.0 + np.array([0.5, 1.0]))  # thin: s/(1 − η)
    aside = 0.01 * f1[0]
    found = measure_light(DESIGN, window, through(window, [aside, 0.0, 0.0]), RAYS, 512)
    assert found.compared.laws[0].delta_x - found.compared.laws[1].delta_x == pytest.approx(0.01, rel=0.05)
    checks = {c.id: c for c in light_checks(Inspection(DESIGN, "x", RAYS), found)}
    assert checks["file_law_delta"].state == "fail"
    assert checks["file_law_eta"].state == "pass"


def test_light_that_reaches_nothing_leaves_every_check_not_run():
    window = prescribe(DESIGN)

    def dark(lit):
        result = trace(window, lit.rays)
        return replace(result, fate=np.full(len(lit.rays), Fate.WALL, dtype=np.uint8))

    found = measure_light(DESIGN, window, dark, 1024, 64)
    checks = light_checks(Inspection(DESIGN, "x", RAYS), found)
    assert {c.id: c.state for c in checks if c.id != "file_throughput"} == {
        c.id: "not run" for c in checks if c.id != "file_throughput"
    }
    assert next(c for c in checks if c.id == "file_throughput").state == "fail"
    assert all(c.required for c in checks)


def test_what_fails_a_master_warns_of_a_preview_and_noise_excuses_a_scan():
    window = prescribe(DESIGN)
    generator = np.random.default_rng(5)

    def noisy(lit):
        result = trace(window, lit.rays)
        bent = result.direction + generator.normal(0.0, 0.02, result.direction.shape) * [1.0, 1.0, 0.0]
        return replace(result, direction=bent / np.linalg.norm(bent, axis=1, keepdims=True))

    found = measure_light(DESIGN, window, noisy, RAYS, 512)
    state = {
        role: next(c for c in light_checks(Inspection(DESIGN, "x", RAYS, role=role), found, noise=0.0288) if c.id == "file_law_rms")
        for role in (Role.MASTER, Role.PREVIEW, Role.SCAN)
    }  # fmt: skip
    assert [one.state for one in state.values()] == ["fail", "warn", "warn"]
    assert "finer facets of the same noise are worse" in state[Role.SCAN].sentence
    silent = next(
        c
        for c in light_checks(Inspection(DESIGN, "x", RAYS, role=Role.SCAN), found, noise=0.005)
        if c.id == "file_law_rms"
    )
    assert silent.state == "fail"


def test_light_through_a_neighbouring_lens_is_told_apart_from_the_error_of_the_partner():
    """A displaced array 2: light leaves d/f2 from the law, and in a strip d wide through the neighbour's lens, p/f2 farther."""
    window = prescribe(DESIGN)
    pitch, focal = window.lattice.pitch[0], window.thin.focal_length[1][0]
    shift = 0.06 * pitch
    random = np.random.default_rng(2)

    def displaced(lit):
        result = trace(window, lit.rays)
        strip = random.random(len(result.fate)) < shift / pitch
        bent = result.direction / result.direction[:, 2:] + np.outer(
            np.where(strip, shift - pitch, shift) / focal, (1, 0, 0)
        )
        return replace(result, direction=bent / np.linalg.norm(bent, axis=1, keepdims=True))

    found = measure_light(DESIGN, window, displaced, RAYS, 512)
    design_rms = measure_light(DESIGN, window, lambda lit: trace(window, lit.rays), RAYS, 512).light.rms
    assert found.strayed == pytest.approx(0.06, abs=0.02)
    assert found.partner == pytest.approx(np.hypot(design_rms, shift / focal), rel=0.02)
    stray = (pitch - shift) / focal
    assert found.light.rms == pytest.approx(np.hypot(found.partner, np.sqrt(found.strayed) * stray), rel=0.1)
    check = light_checks(
        Inspection(DESIGN, "x", RAYS),
        found,
        rms=[found.light.rms, 0.5 * found.light.rms],
        cells=[(0, 0), (1, 1)],
    )[0]
    assert check.value == found.light.rms
    assert "(in cell (0, 0), worst of 2)" in check.sentence
    assert f"over all 2 cells {1e3 * found.light.rms * np.sqrt(0.625):.4g} mrad" in check.sentence
    assert f"the rest {1e3 * found.partner:.4g} mrad rms from the law" in check.sentence


# -- maps ------------------------------------------------------------------------------------------------


def grid(window, count, height):
    half = 0.5 * np.asarray(window.lattice.pitch)
    step = 2.0 * half / count
    x, y = (-half[k] + step[k] * (np.arange(count) + 0.5) for k in (0, 1))
    gx, gy = (g.ravel() for g in np.meshgrid(x, y))
    return np.column_stack([gx, gy, height(gx, gy)]), step


def test_a_bicubic_surface_goes_through_its_samples_and_is_smooth():
    window = prescribe(SLAB)
    face = window.bodies[0].front
    generator = np.random.default_rng(1)
    samples, step = grid(window, 10, lambda x, y: face.vertex[2] + 0.01 * generator.normal(size=x.shape))
    made = sampled_face(window, face, np.zeros(3), samples, step)
    z, dx, dy = height_and_slope(made, samples[:, 0], samples[:, 1])
    np.testing.assert_allclose(z, samples[:, 2], atol=1e-14)
    at = generator.uniform(-0.2, 0.2, (200, 2))
    h = 1e-6
    ahead, behind = (height_and_slope(made, at[:, 0] + s, at[:, 1])[0] for s in (h, -h))
    np.testing.assert_allclose(height_and_slope(made, *at.T)[1], (ahead - behind) / (2 * h), atol=1e-7)
    above, below = (height_and_slope(made, at[:, 0], at[:, 1] + s)[0] for s in (h, -h))
    np.testing.assert_allclose(height_and_slope(made, *at.T)[2], (above - below) / (2 * h), atol=1e-7)
    assert np.isfinite(dx).all()
    assert np.isfinite(dy).all()


def test_light_meets_a_bicubic_surface_where_it_is():
    window = prescribe(SLAB)
    face = window.bodies[0].front
    samples, step = grid(window, 16, lambda x, y: face.vertex[2] + 0.3 * (x**2 - 0.5 * x * y + y**2))
    made = sampled_face(window, face, np.array([1.0, 2.0, 0.0]), samples, step)
    generator = np.random.default_rng(2)
    start = np.column_stack(
        [generator.uniform(-0.1, 0.1, (100, 2)) + [1.0, 2.0], np.full(100, face.vertex[2] - 1.0)]
    )
    ray = np.column_stack([generator.uniform(-0.05, 0.05, (100, 2)), np.ones(100)])
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    distance, normal, land = meet_sampled(made, start, ray)
    hit = start + distance[:, None] * ray - [1.0, 2.0, 0.0]
    x, y = hit[:, 0], hit[:, 1]
    # the middle of the cell is far from where the grid goes on as the design does
    np.testing.assert_allclose(hit[:, 2], face.vertex[2] + 0.3 * (x**2 - 0.5 * x * y + y**2), atol=2e-5)
    np.testing.assert_allclose(normal[:, 0], -0.3 * (2 * x - 0.5 * y), atol=2e-3)
    assert not land.any()
    beyond = start + [0.5, 0.0, 0.0]
    assert np.isnan(meet_sampled(made, beyond, np.broadcast_to([0.0, 0.0, 1.0], beyond.shape))[0]).all()


FORMATS = ("tiff", "png", "xyz", "sag")


@pytest.fixture(scope="module")
def maps(tmp_path_factory):
    """Maps of a slab, and of one whose lens 1 has radii 3 % off."""
    made = {}
    for name, change in (("right", {}), ("wrong", {"law.eta": [-0.515, -1.03]})):
        folder = tmp_path_factory.mktemp(name)
        export(SLAB.replace(change), folder, formats=FORMATS)
        made[name] = folder
    return made


@pytest.mark.daily_cases("*back.xyz", "*front.cell.dat", "*front.u16.png")
@pytest.mark.parametrize(
    "pattern", ["*front.f32.tiff", "*back.u16.tiff", "*front.u16.png", "*back.xyz", "*front.cell.dat"]
)
def test_light_through_a_map_is_that_of_the_exact_faces(maps, pattern, monkeypatch):
    only_files(monkeypatch)
    (path,) = maps["right"].glob(pattern)
    report = verify(SLAB, path, rays=RAYS)
    checks = {c.id: c for c in report.checks if c.subject == path.name}
    exact = next(c.value for c in report.checks if c.id == "law_rms")
    assert checks["file_law_rms"].value == pytest.approx(exact, rel=0.02)
    assert report.word == "passed as optical master"
    assert {c.state for c in checks.values()} <= {"pass", "not run"}


@pytest.mark.parametrize(("made", "noise", "word"), [
    ("right", 0.0, "passed as optical master"), ("right", 2e-5, "passed as scan"), ("wrong", 2e-5, "failed"),
])  # fmt: skip
def test_a_plain_cloud_of_points_is_judged_by_light(maps, tmp_path, monkeypatch, made, noise, word):
    """Lines x y z, as a profilometer writes them, with heights off by up to 20 nm; declared a scan where they are."""
    only_files(monkeypatch)
    (path,) = maps[made].glob("*back.xyz")
    points = np.loadtxt(path)[:, :3]
    points[:, 2] += np.random.default_rng(0).uniform(-noise, noise, len(points))
    np.savetxt(tmp_path / "cloud.xyz", points, fmt="%.9f", header="x y z")
    report = verify(SLAB, tmp_path / "cloud.xyz", rays=RAYS, role="scan" if noise else None)
    assert report.word == word
    states = {c.id: c.state for c in report.checks if c.subject == "cloud.xyz"}
    assert states["file_law_eta"] == ("pass" if made == "right" else "warn")


def test_lines_of_points_that_are_neither_three_nor_six_numbers_are_named(tmp_path):
    for number, text in enumerate(("0 0 1\n0 1\n", "0 0 1\n0 0 1 0 0 1\n", "1 2 3 4\n", "a b c\n")):
        (tmp_path / f"{number}.xyz").write_text(text)
        with pytest.raises(UnreadableFile, match="neither x y z nor x y z and a normal"):
            list(read_points(tmp_path / f"{number}.xyz"))


@pytest.mark.parametrize("pattern", ["*back.f32.tiff", "*back.u16.png", "*back.xyz"])
def test_light_through_the_map_of_another_lens_tells_by_how_much(maps, pattern, monkeypatch):
    only_files(monkeypatch)
    (path,) = maps["wrong"].glob(pattern)
    target = path.parent / "alone" / path.name
    target.parent.mkdir(exist_ok=True)
    target.write_bytes(path.read_bytes())
    report = verify(SLAB, target, rays=RAYS)
    states = {c.id: c for c in report.checks if c.subject == path.name}
    assert report.exit_status == 1
    if "tiff" in pattern:  # 16-bit maps hold no scale of their own; points and float maps hold heights
        assert states["file_law_eta"].value > 0.005


@pytest.mark.slow
def test_a_bare_scan_of_the_middle_cell_is_lit_there(tmp_path, monkeypatch):
    only_files(monkeypatch)
    window = prescribe(DESIGN)
    soup = np.concatenate([facets(window, body, 16) for body in window.bodies])
    path = Path(tmp_path / "part.stl")
    write_stl(path, soup)
    report = verify(DESIGN, path, rays=RAYS, role="preview")
    lit = next(c for c in report.checks if c.id == "file_law_rms")
    assert tuple(lit.detail["cells"][0]) == central_cell(window)
    assert bundle(window, 16, 0.01).cell == central_cell(window)


@pytest.mark.slow
@pytest.mark.parametrize("cells", [8, pytest.param(200, marks=pytest.mark.long)])
def test_a_step_of_silica_on_flint_keeps_to_the_law_in_white_light(tmp_path, cells, monkeypatch):
    """Another program leaves .0253 mrad by the same faces; a wrong medium in one body would leave .1 and more."""
    only_files(monkeypatch)
    design = Design.from_dict(tomllib.loads(template("day", "achromat"))).with_cells((cells, cells))
    (entry,) = export(design, tmp_path / "out", ("step",)).files
    assert (len(entry["bodies"]), entry["role"]) == (3, "optical-master")
    report = verify(design, tmp_path / "out", rays=RAYS)
    checks = {check.id: check for check in report.checks if check.where == "file"}
    white, lines = checks["file_law_white"], checks["file_law_white"].detail["lines"]
    assert (white.state, white.limit, white.required) == ("pass", pytest.approx(0.028e-3), True)
    assert 1e3 * white.value == pytest.approx(0.0253, rel=0.02)
    wanted = next(case for case in SAMPLES if "Silica|N-SF6" in case["name"])["results"][0]["law_rms_mrad"]
    assert [1e3 * value for value in lines.values()] == pytest.approx(list(wanted.values()), rel=0.04)
    assert [checks[name].state for name in ("solids", "shape", "volume")] == ["pass"] * 3
    assert float(checks["faithful_rms"].value) < 1e-12
