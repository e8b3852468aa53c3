"""Targets, the assignment of cells to them, and the commands `image` and `shape`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.optimize import linear_sum_assignment

import clacad
from clacad.cli.entry_point import main
from clacad.design.asked_cells import lattice_of
from clacad.imaging.shape import assigned, rendered, shaped, table_text
from clacad.imaging.target import NoTarget, _along_hilbert, of_picture, of_points


def square_ways(cells, places, order):
    return float(np.sum((cells - places[order]) ** 2))


def test_few_cells_go_the_shortest_ways_of_all():
    rng = np.random.default_rng(0)
    cells, places = rng.uniform(size=(60, 2)), rng.uniform(size=(60, 2))
    rows, best = linear_sum_assignment(((cells[:, None] - places[None]) ** 2).sum(axis=2))
    assert square_ways(cells, places, assigned(cells, places)) == pytest.approx(
        square_ways(cells[rows], places, best)
    )


@pytest.mark.slow
def test_many_cells_go_ways_hardly_longer_each_to_a_place_of_its_own_and_the_same_every_time():
    rng = np.random.default_rng(1)
    cells, places = rng.uniform(size=(1200, 2)), rng.uniform(size=(1200, 2)) ** 2
    found = assigned(cells, places)
    assert np.array_equal(np.sort(found), np.arange(1200))
    assert np.array_equal(found, assigned(cells, places))
    _, best = linear_sum_assignment(((cells[:, None] - places[None]) ** 2).sum(axis=2))
    assert square_ways(cells, places, found) <= 1.15 * square_ways(cells, places, best)


@pytest.mark.parametrize("size", [(8, 8), (5, 7), (1, 6)])
def test_the_order_of_pixels_passes_each_once(size):
    order = _along_hilbert(*size)
    assert len(np.unique(order, axis=0)) == len(order) == size[0] * size[1]
    if size == (8, 8):
        assert np.abs(np.diff(order, axis=0)).sum(axis=1).max() == 1


def test_each_pixel_gets_cells_by_its_light_to_less_than_one():
    light = np.array([[0.0, 1.0, 2.0], [3.0, 0.0, 4.0]])
    target = of_picture(light, 3.0)
    places = target.places(1000)
    column, row = np.floor(places[:, 0] + 1.5).astype(int), np.floor(1.0 - places[:, 1]).astype(int)
    counts = np.zeros((2, 3))
    np.add.at(counts, (row, column), 1)
    assert np.abs(counts - 1000 * light / light.sum()).max() < 1.0


def test_colour_counts_by_what_is_seen_of_it_and_black_is_refused():
    light = np.zeros((1, 3, 3))
    light[0, 0, 0] = light[0, 1, 1] = light[0, 2, 2] = 1.0
    by_place = of_picture(light, 3.0)
    assert dict(zip(by_place.points[:, 0].tolist(), by_place.weights.tolist())) == pytest.approx(
        {-1.0: 0.2126, 0.0: 0.7152, 1.0: 0.0722}
    )
    for dark in (np.zeros((4, 4)), np.zeros((1, 1, 3))):
        with pytest.raises(NoTarget, match="black"):
            of_picture(dark, 1.0)


@pytest.mark.parametrize("points", [False, True])
def test_light_of_a_target_between_edges_is_that_of_many_drawn_places(points, tmp_path):
    target = of_picture(np.array([[0.0, 1.0, 2.0], [3.0, 0.0, 4.0]]), 3.0)
    if points:
        (tmp_path / "p.csv").write_text("x,y,weight\n0.2,0.1,3\n-1,0.3,1\n0.2,-0.7,2\n")
        target = of_points(tmp_path / "p.csv")
    edges, blur = (np.linspace(-2, 1.7, 9), np.linspace(-1.2, 1.4, 8)), (0.7, 0.3)
    rng = np.random.default_rng(2)
    which = rng.choice(len(target.points), 400_000, p=target.weights)
    shares = [width * rng.uniform(-0.5, 0.5, (400_000, 2)) for width in (target.grain, blur)]
    drawn, _, _ = np.histogram2d(*(target.points[which] + sum(shares)).T, edges)
    assert np.abs(target.light(edges, blur) - drawn / 400_000).max() < 2e-3
    wide = (np.array([-9.0, 9.0]), np.array([-9.0, 9.0]))
    assert target.light(wide, blur) == pytest.approx(1.0, rel=1e-12)


def test_points_are_read_with_or_without_weights_and_refused_at_their_place(tmp_path):
    path = tmp_path / "p.csv"
    path.write_text("x,y,weight\r\n1,2,3\r\n-1,0,1\r\n5,5,0\r\n")
    assert of_points(path).weights.tolist() == [0.75, 0.25]
    path.write_text("x,y\n1,2\n3,4\n")
    assert np.array_equal(of_points(path).places(4), [[1, 2], [1, 2], [3, 4], [3, 4]])
    with pytest.raises(NoTarget, match="need as many cells"):
        of_points(path).places(1)
    path.write_text("x,y\n1,nan\n")
    with pytest.raises(clacad.DesignError, match="p.csv:2:3"):
        of_points(path)
    path.write_text("x,y,weight\n1,2,0\n")
    with pytest.raises(NoTarget, match="no point has a weight"):
        of_points(path)


@pytest.mark.slow
def test_light_of_each_cell_of_the_written_table_arrives_where_it_was_sent(tmp_path):
    design = clacad.Design.from_dict({
        "format": 1, "name": "s", "unit": "mm", "law": {"eta": [-1.0, -0.5]},
        "pair": {"form": "slab", "separation": 10.0, "material": "PMMA", "surface": "biconic"},
        "lattice": {"pitch": 0.5, "count": [20, 20]},
    })  # fmt: skip
    picture = np.zeros((20, 20))
    picture[2:6, 3:9], picture[12:18, 10:16] = 1.0, 0.4
    found = shaped(design, lattice_of(design), of_picture(picture, 9.0), 150.0)
    (tmp_path / "t.csv").write_text(table_text(found))
    text = design.canonical_toml().replace("[law]\n", '[law]\nvarying = {table = "t.csv"}\n')
    (tmp_path / "d.toml").write_text(text)
    window = clacad.prescribe(clacad.load(tmp_path / "d.toml"))
    seen = rendered(window, found, 150.0, 20_000)
    assert seen.within > 0.8
    assert seen.difference < 0.3
    assert seen.by_lenses < 0.25
    # one cell by hand: the thin pair of the cell sends its chief ray to its place
    i, j = found.cells[37]
    t = window.law_at((int(i), int(j))).refract([0.0, 0.0, 1.0])
    at = window.lattice.centres(found.cells[37]) + 150.0 * t[:2] / t[2]
    assert np.abs(at - found.places[37]).max() < 1e-12


@pytest.mark.slow
def test_a_hundred_cells_square_send_four_fifths_of_the_light_within_one_blur_of_its_target(tmp_path):
    side = np.linspace(-1, 1, 128)
    x, y = np.meshgrid(side, side)
    light = np.where(np.hypot(x, y) < 0.8, 1.0 + x, 0.02) * (np.hypot(x - 0.3, y + 0.2) > 0.25)
    Image.fromarray((np.repeat(light[..., None], 3, axis=2) * 110).astype(np.uint8)).save(tmp_path / "p.png")
    out = tmp_path / "d.toml"
    assert main(["shape", str(tmp_path / "p.png"), "--distance", "500", "-o", str(out), "-q"]) == 0
    rows = np.loadtxt(tmp_path / "d.cells.csv", delimiter=",", skiprows=1)
    assert rows.shape == (10_000, 4)
    window = clacad.prescribe(clacad.load(out))
    rng = np.random.default_rng(4)
    which = rng.integers(0, 10_000, 100_000)
    centre = (rows[which, :2] - 49.5) * 0.5
    start = np.column_stack([centre + rng.uniform(-0.25, 0.25, (100_000, 2)), np.full(100_000, -1.0)])
    seen = clacad.trace(window, clacad.Rays(start, (0.0, 0.0, 1.0)))
    through = seen.fate == clacad.Fate.ALIVE
    level = window.faces[1].vertex[2] + 500.0
    hit = seen.position + ((level - seen.position[:, 2]) / seen.direction[:, 2])[:, None] * seen.direction
    place = centre + 500.0 * rows[which, 2:]  # eta = -1
    blur = 0.5 + 550e-6 * 500.0 / 0.5
    near = through & (np.abs(hit[:, :2] - place) <= blur).all(axis=1)
    assert near.mean() >= 0.8
    # and the places are the picture's: as many of its pixels' light as cells were sent into them
    counts, _, _ = np.histogram2d(-place[:, 1], place[:, 0], np.linspace(-25, 25, 17))
    wanted = (light * 110).astype(np.uint8) / 255.0
    wanted = (
        np.where(wanted <= 0.04045, wanted / 12.92, ((wanted + 0.055) / 1.055) ** 2.4)
        .reshape(16, 8, 16, 8)
        .sum(axis=(1, 3))
    )
    assert np.abs(counts[:16] / counts.sum() - wanted / wanted.sum()).max() < 2e-3


TINY = 'format = 1\nname = "t"\nunit = "mm"\n[law]\neta = [-1.0, -1.0]\n[law.varying]\nf_image = 100\n[pair]\nform = "slab"\nseparation = 10\nmaterial = "PMMA"\n[lattice]\npitch = 0.5\ncount = [8, 8]\n'


@pytest.mark.slow
def test_the_command_image_tells_and_draws_what_its_twin_finds(tmp_path, capsys):
    (tmp_path / "t.toml").write_text(TINY)
    words = ["image", str(tmp_path / "t.toml"), "--object", "0,0,-inf", "--rays", "512"]
    assert main([*words, "--dry-run", "--json"]) == 0
    alone = json.loads(capsys.readouterr().out)["forecast"]
    assert main([*words, "--dry-run", "--json", "-o", str(tmp_path / "drawn.png")]) == 0
    drawn = json.loads(capsys.readouterr().out)["forecast"]
    assert 0.0 <= alone["building"] < alone["seconds"] < drawn["seconds"]
    assert not (tmp_path / "drawn.png").exists()
    assert main([*words, "--json", "-o", str(tmp_path / "f.svg")]) == 0
    told = json.loads(capsys.readouterr().out)
    twin = clacad.image(clacad.prescribe(clacad.load(tmp_path / "t.toml")), (0, 0, -np.inf), rays=512)
    assert [one["found"] for one in told["rungs"]] == [one.found.point.tolist() for one in twin.rungs]
    # kappa = -0.01: within a cell delta would change by up to 0.0025 along each axis, evenly
    assert told["sampling"]["slope"] == pytest.approx(0.01 * 0.5 / np.sqrt(6), rel=0.03)
    assert max(told["sampling"]["spot"]) < 1e-12
    drawn = (tmp_path / "f.svg").read_bytes()
    assert main([*words, "-q", "--overwrite", "-o", str(tmp_path / "f.svg")]) == 0
    assert (tmp_path / "f.svg").read_bytes() == drawn
    assert main([*words, "-o", str(tmp_path / "f.svg")]) == 4
    assert main([*words, "--dry-run", "-o", str(tmp_path / "g.png")]) == 0
    assert not (tmp_path / "g.png").exists()
    for wrong in ("0,0,300", "0,0", "0,x,-3", "0,0,nan", "0,0,inf"):
        assert main(["image", str(tmp_path / "t.toml"), "--object", wrong]) == 2
    assert main([*words, "--rung", "mesh"]) == 2
    assert main([*words, "-o", str(tmp_path / "f.pdf")]) == 2


@pytest.mark.slow
def test_the_command_shape_writes_a_design_that_verifies_its_table_and_nothing_where_it_cannot(
    tmp_path, capsys
):
    picture = np.zeros((6, 6, 3), np.uint8)
    picture[1:4, 2:5] = 200
    Image.fromarray(picture).save(tmp_path / "p.png")
    Image.fromarray(picture * 0).save(tmp_path / "black.png")
    Image.fromarray(picture[2:3, 3:4]).save(tmp_path / "one.png")
    (tmp_path / "bad.png").write_bytes(b"no picture")
    out = tmp_path / "d.toml"
    words = [
        "shape",
        str(tmp_path / "p.png"),
        "--distance",
        "20 cm",
        "-o",
        str(out),
        "--cells",
        "8x8",
        "--rays",
        "512",
    ]
    assert main([*words, "--dry-run"]) == 0
    assert capsys.readouterr().out
    assert not out.exists()
    assert main([*words, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["within_one_blur"] > 0.8
    names = {"d.toml", "d.cells.csv", "d.png"}
    first = {name: (tmp_path / name).read_bytes() for name in names}
    assert main([*words, "-q", "--overwrite"]) == 0
    assert {name: (tmp_path / name).read_bytes() for name in names} == first
    assert main([*words, "-q"]) == 4
    assert clacad.load(out).law_spec.varying.table.file == "d.cells.csv"
    for name in ("black.png", "bad.png", "none.png"):
        assert main(["shape", str(tmp_path / name), "--distance", "200", "-o", str(tmp_path / "x.toml")]) == 2
    assert (
        main(
            [
                "shape",
                str(tmp_path / "one.png"),
                "--distance",
                "200",
                "-o",
                str(tmp_path / "y.toml"),
                "--cells",
                "4",
                "--rays",
                "64",
            ]
        )
        == 0
    )
    (tmp_path / "many.csv").write_text("x,y\n" + "".join(f"{k},0\n" for k in range(17)))
    assert (
        main(
            [
                "shape",
                str(tmp_path / "many.csv"),
                "--distance",
                "200",
                "-o",
                str(tmp_path / "x.toml"),
                "--cells",
                "4",
            ]
        )
        == 2
    )
    assert (
        main(
            [
                "shape",
                str(tmp_path / "p.png"),
                "--distance",
                "1",
                "--width",
                "50",
                "-o",
                str(tmp_path / "x.toml"),
                "--cells",
                "8",
            ]
        )
        == 2
    )
    before = (tmp_path / "p.png").read_bytes()
    same = ["shape", str(tmp_path / "p.png"), "--distance", "200", "--cells", "4", "--overwrite", "-o"]
    for name in ("p.toml", "x.json", "x"):
        assert main([*same, str(tmp_path / name)]) == 2
    assert (tmp_path / "p.png").read_bytes() == before
    (tmp_path / "tilted.toml").write_text(
        TINY.replace("[law.varying]\nf_image = 100\n", "euler = [0, 5, 0]\n")
    )
    capsys.readouterr()
    assert main([*same, str(tmp_path / "x.toml"), "--design", str(tmp_path / "tilted.toml")]) == 2
    told = capsys.readouterr().err
    assert f"{tmp_path / 'tilted.toml'}:6:9: error CL125: law.euler" in told
    aimed = TINY.replace("[law.varying]\nf_image = 100\n", "") + "aperture = {point = [0, 0, -400]}\n"
    (tmp_path / "aimed.toml").write_text(aimed)
    assert main([*same, str(tmp_path / "x.toml"), "--design", str(tmp_path / "aimed.toml")]) == 2
    assert "error CL125: lattice.aperture" in capsys.readouterr().err
    assert not (tmp_path / "x.toml").exists()
    assert not (tmp_path / "x.cells.csv").exists()


@pytest.mark.slow
def test_a_shaped_design_whose_table_was_exchanged_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The design names the table with its hash: a new table with an old design is no sheet."""
    for name, points in (("one", "x,y\n0,0\n2,1\n"), ("two", "x,y\n1,0\n0,3\n")):
        (tmp_path / f"{name}.csv").write_text(points)
        words = [
            "shape",
            str(tmp_path / f"{name}.csv"),
            "--distance",
            "300",
            "--cells",
            "4x4",
            "--rays",
            "64",
            "-o",
        ]
        assert main([*words, str(tmp_path / f"{name}.toml")]) == 0
    (tmp_path / "one.cells.csv").write_bytes((tmp_path / "two.cells.csv").read_bytes())
    capsys.readouterr()
    assert main(["check", str(tmp_path / "one.toml")]) == 2
    assert "is not the table whose sha256 the design states" in capsys.readouterr().err
    assert main(["check", str(tmp_path / "two.toml")]) in (0, 1)
