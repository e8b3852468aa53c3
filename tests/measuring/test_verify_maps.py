"""`clacad verify --role scan` with height maps: sides, scales, verdicts, refusals, and what is written."""

from __future__ import annotations

import csv
import importlib
import json
from pathlib import Path

import numpy as np
import pytest
from measuring.made_parts import Made
from oracle.plain_mesh import write_stl

from clacad.cli import main
from clacad.design import Design, load
from clacad.measuring.measure import Maps, fitted_sides, maps_of
from clacad.measuring.read_map import read_map
from clacad.measuring.sides import sides_of
from clacad.mesh import tessellate
from clacad.prescription.prescribe import prescribe
from clacad.storage.errors import BadRequest, UnreadableFile
from clacad.verification import verify

DESIGN = str(Path(__file__).parents[2] / "designs" / "window-100mm.toml")
SPHERE = 2.468143364277402


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """Maps of a good front, a good back, and a front of another radius."""
    folder = tmp_path_factory.mktemp("maps")
    return {
        name: Made(radius=radius, size=150, noise=5e-6, seed=seed).write(folder / f"{name}.xyz")
        for seed, (name, radius) in enumerate(
            {"front": SPHERE, "back": SPHERE, "other": 0.9 * SPHERE, "near": 0.979 * SPHERE}.items()
        )
    }


def verified(capsys, *words: str) -> tuple[int, dict]:
    status = main(["verify", DESIGN, "--rays", "4096", "--role", "scan", "--json", *words])
    return status, json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_both_sides_are_judged_together(parts, capsys):
    status, found = verified(
        capsys, "--files", str(parts["front"]), str(parts["back"]), "--z-scale", "1 +- 1e-4"
    )
    assert (status, found["word"]) == (0, "passed as scan")
    part = found["measured"]
    assert set(part["sides"]) == {"front", "back"}
    assert part["as_designed"] == ["bodies"]
    assert {row["side"] for row in part["lenslets"]} == {"front", "back"}
    for key in ("pitch", "turn", "tilt", "z_scale", "law_rms", "u_law_rms", "formed_share", "seam_share"):
        assert key in part
    assert {"i", "j", "x", "y", "z", "radius", "conic", "astigmatism", "sq", "u_radius"} <= set(
        part["lenslets"][0]
    )


@pytest.mark.slow
def test_a_part_near_the_limit_has_no_verdict(parts, capsys):
    status, found = verified(capsys, "--files", str(parts["near"]))
    assert (status, found["word"]) == (1, "cannot say")
    assert "would be needed" in found["verdict"]


@pytest.mark.slow
def test_a_wrong_part_fails(parts, capsys):
    status, found = verified(capsys, "--files", str(parts["other"]), "--side", "other.xyz=back")
    assert (status, found["word"], found["measured"]["as_designed"]) == (1, "failed", ["front", "bodies"])


@pytest.mark.slow
def test_a_damaged_map_is_refused(tmp_path, parts, capsys):
    path = tmp_path / "cut.xyz"
    path.write_bytes(parts["front"].read_bytes()[:5000])
    assert main(["verify", DESIGN, "--rays", "4096", "--role", "scan", "--files", str(path)]) == 1
    assert "cut.xyz" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [["--z-scale", "1"], ["--tilted", "other.npy"], ["--side", "front.npy=front"]]
)
def test_scales_and_sides_are_of_maps_alone(words, parts, tmp_path, capsys):
    mesh = tmp_path / "part.step"
    mesh.write_text("solid x\nendsolid x\n")
    assert main(["verify", DESIGN, "--files", str(mesh), "--role", "scan", *words]) == 2
    assert "height maps" in capsys.readouterr().err


def test_an_unknown_unit_is_refused_with_those_that_are_known(parts):
    with pytest.raises(BadRequest, match="one of nm, um"):
        read_map(parts["front"], "parsec")


def test_sides_follow_from_names_unless_stated():
    one = maps_of(["a-back.x3p", "map.x3p"], {}, Maps(unit="um"))
    assert (one.front, one.back, one.unit) == ("map.x3p", "a-back.x3p", "um")
    assert maps_of(["front.x3p"], {"front.x3p": "back"}, Maps()).back == "front.x3p"
    for paths, sides in (
        (["front-1.x3p", "front-2.x3p"], {}),
        (["a", "b", "c"], {}),
        (["a"], {"z": "front"}),
    ):
        with pytest.raises(BadRequest, match="front"):
            maps_of(paths, sides, Maps())


def closed_part(folder: Path, quads: int) -> Path:
    """A part of 6 × 6 cells as a closed mesh, alone in its folder."""
    sheet = prescribe(load(DESIGN).with_cells((6, 6)))
    mesh = tessellate(sheet, quads=quads)
    write_stl(folder / "part.stl", np.asarray(mesh.vertices)[np.asarray(mesh.triangles)])
    return folder / "part.stl"


@pytest.mark.slow
@pytest.mark.parametrize("side", ["front", "back"])
def test_one_side_of_a_closed_part_has_the_lenslets_of_its_map(tmp_path, side):
    """Heights of the map by the sphere of the design; the mesh has chords in their place."""
    path = closed_part(tmp_path, 24)
    exact = Made(noise=0.0, size=220, spikes=0, dirt=0, lost=0.0)
    mesh, made = (
        read_map(path, "mm", side),
        read_map(exact.write(tmp_path / f"{side}.xyz")),
    )
    window = prescribe(load(DESIGN))
    rows = []
    for one in (mesh, made):
        found, _, _ = fitted_sides(load(DESIGN), window, Maps(z_scale=1.0).of(side, one))
        rows.append(found[side].lenslets)
    assert 1.0 / rows[0].values[:, 3] == pytest.approx(SPHERE, rel=1e-4)
    assert rows[1].values[:, 3].mean() == pytest.approx(rows[0].values[:, 3].mean(), rel=1e-4)
    assert rows[1].values[:, 4].mean() == pytest.approx(rows[0].values[:, 4].mean(), abs=0.01)
    assert rows[1].pitch == pytest.approx(rows[0].pitch, rel=1e-6)
    with pytest.raises(UnreadableFile, match="state its side: --side part.stl=front"):
        read_map(path, "mm")


INSIDE = [
    {"radius": "inf", "behind": "PMMA"},
    {"radius": -2.4, "z": 1.5, "array": 1, "behind": "air"},
    {"radius": 2.4, "z": 11.2, "array": 2, "behind": "PMMA"},
    {"radius": "inf", "z": 12.7, "behind": "air"},
]
"""Plates whose lenslets face each other, inside the closed mesh."""


def scanned(folder: Path, design: Design, spoil=lambda corners: corners):
    """The report on the closed mesh of a design as a scan."""
    mesh = tessellate(prescribe(design), quads=16)
    write_stl(folder / "part.stl", spoil(np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]))
    return verify(design, folder / "part.stl", rays=4096, role="scan")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["slab", *(pytest.param(n, marks=pytest.mark.slow) for n in ("inside", "galilean"))]
)
def test_the_mesh_of_a_scan_is_judged_by_its_lenslets_alone(tmp_path, name, monkeypatch):
    """Radii are those that the prescription states; no light goes through the facets."""
    told = {"format": 1, "name": "inside", "unit": "mm", "law": {"eta": [-1, -1]},
            "pair": {"form": "plates", "wavelength": "546.1 nm", "face": INSIDE},
            "lattice": {"pitch": 0.5, "count": 4}, "check": {"law_rms": "30 mrad", "law_bias": "30 mrad"}}  # fmt: skip
    design = Design.from_dict(told) if name == "inside" else load(name, ["lattice.count=[4,4]"])
    home, read = importlib.import_module("clacad.formats.mesh.readers"), []
    monkeypatch.setattr(
        home, "read_mesh", lambda *words, take=home.read_mesh: read.append(words) or take(*words)
    )
    report = scanned(tmp_path, design)
    assert (report.word, len(read)) == ("passed as scan", 1)
    curved = [face for face in prescribe(design).faces if face.array is not None]
    for side, face in (("front", curved[0]), ("back", curved[-1])):
        one = report.measured.sides[side]
        assert abs(report.measured.radii()[side][0]) == pytest.approx(
            1.0 / abs(face.surface.curvature_x), rel=2e-3
        )
        assert sorted(map(tuple, one.lit.cells.of(one.lenslets.index))) == [
            (i, j) for i in range(4) for j in range(4)
        ]
    kinds = {check.id for check in report.checks if check.where in ("file", "mesh")}
    assert "scan_light" in kinds
    assert not [one for one in kinds if one.startswith(("file_", "faithful_")) or one == "convergence"]


@pytest.mark.slow
def test_the_scan_of_a_part_with_another_radius_fails_by_its_light(tmp_path):
    """Sag of the front 6 % less, as a sphere of a radius 6 % larger has it; and a dent of 4 µm in one cell."""

    def flatter(corners, part=0.06):
        low, off = corners[..., 2] < 1.0, (corners[..., :2] % 0.5) - 0.25
        moved = corners[..., 2] - part * (off**2).sum(axis=-1) / (2.0 * SPHERE)
        return np.dstack([corners[..., :2], np.where(low, moved, corners[..., 2])])

    def dented(corners):
        near = (corners[..., 2] < 1.0) & (np.hypot(*(corners[..., :2] - 0.3).T).T < 0.1)
        return corners + near[..., None] * [0.0, 0.0, 0.004]

    design = load(DESIGN, ["lattice.count=[4,4]"])
    report = scanned(tmp_path, design, flatter)
    states = {check.id: check.state for check in report.checks if check.subject == "part.stl"}
    assert (report.word, states["scan_light"]) == ("failed", "fail")
    assert report.measured.radii()["front"][0] == pytest.approx(SPHERE / 0.94, rel=2e-3)
    assert scanned(tmp_path, design, lambda one: flatter(one, 0.002)).word == "passed as scan"
    report = scanned(tmp_path, design, dented)
    assert [check.state for check in report.checks if check.id == "shape"] == ["fail"]
    assert report.word == "failed"


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "side"), [(1.0, "front"), (2.0, "back")])
def test_a_map_without_a_name_is_of_the_side_with_its_curvature_and_is_read_once(
    tmp_path, monkeypatch, factor, side
):
    """Slopes become t/eta: at eta = -2 lens 2 has twice the focal length of lens 1."""
    design = load(DESIGN).replace("law.eta", [-2.0, -2.0])
    front, back = (1.0 / one.lenslet[3] for one in sides_of(prescribe(design), 1.0).values())
    assert back == pytest.approx(2.0 * front, rel=1e-3)
    made = Made(radius=factor * front, noise=5e-6, size=150).write(tmp_path / "first.xyz")
    home, read = importlib.import_module("clacad.measuring.measure"), []
    monkeypatch.setattr(home, "read_map", lambda *words: read.append(words) or read_map(*words))
    maps = maps_of([made], {}, Maps(z_scale="1 +- 1e-3"))
    assert not maps.named
    assert set(maps.measured(design, lambda *_: None).sides) == {side}
    assert len(read) == 1


@pytest.mark.slow
def test_numbers_table_and_deviation_maps_are_written_next_to_the_report(parts, tmp_path, capsys):
    words = [
        "verify",
        DESIGN,
        "--files",
        str(parts["front"]),
        "--role",
        "scan",
        "--z-scale",
        "1 +- 1e-4",
    ]
    assert main([*words, "-o", str(tmp_path / "out"), "-q"]) == 0
    numbers = json.loads((tmp_path / "out" / "measured.json").read_text())
    rows = list(csv.DictReader((tmp_path / "out" / "lenslets.csv").open()))
    assert len(rows) == len(numbers["lenslets"]) > 0
    assert float(rows[0]["radius"]) == pytest.approx(numbers["lenslets"][0]["radius"])
    deviation = read_map(tmp_path / "out" / "deviation-front.npy")
    assert np.percentile(np.abs(deviation.points[2]), 90) < 30e-9
    assert 'id="measured"' in (tmp_path / "out" / "report.html").read_text()
    assert main([*words, "-o", str(tmp_path / "out"), "-q"]) == 0  # its own files are replaced
    assert load("window-100mm").sha256 == numbers["design"]["sha256"]


@pytest.mark.slow
def test_the_design_alone_has_the_table_of_a_measured_part(capsys):
    assert main(["check", DESIGN, "--json", "--set", "lattice.count=[8,8]"]) in (0, 1)
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["iso_14880"]}
    assert len(rows) == 20
    for side in ("front", "back"):
        assert float(rows[f"{side}: radius of curvature"]["design"]) == pytest.approx(SPHERE, rel=1e-5)
        assert float(rows[f"{side}: pitch x"]["design"]) == 0.5
        # a sphere is as deep as its radius less the height over the corner of a cell
        deep = SPHERE - (SPHERE**2 - 0.125) ** 0.5
        assert float(rows[f"{side}: surface modulation depth"]["design"]) == pytest.approx(deep, rel=1e-4)
        # a plano lens of glass of index n has f = R / (n - 1)
        f = SPHERE / (1.493629 - 1.0)
        assert float(rows[f"{side}: focal length, as derived"]["design"]) == pytest.approx(f, rel=1e-4)
    assert main(["check", DESIGN, "--all", "--set", "lattice.count=[8,8]"]) in (0, 1)
    assert "in the terms of ISO 14880" in capsys.readouterr().out


@pytest.mark.slow
def test_the_mesh_of_a_coupon_of_one_side_names_what_it_needs(tmp_path, capsys):
    mesh = tessellate(prescribe(load(DESIGN).with_cells((4, 4))), quads=16)
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]
    up = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    write_stl(tmp_path / "coupon.stl", corners[(up < 0.0) & (corners[..., 2].max(axis=1) < 1.0)])
    words = ["verify", DESIGN, "--rays", "1024", "--role", "scan", "--files", str(tmp_path / "coupon.stl")]
    assert main(words) == 2
    assert "--unit mm" in capsys.readouterr().err
    status, found = verified(capsys, *words[6:], "--unit", "mm", "--z-scale", "1")
    assert (status, found["word"]) == (0, "passed as scan")
    assert found["measured"]["sides"]["front"]["radius"] == pytest.approx(SPHERE, rel=2e-4)
