"""The accuracy table: its numbers against independent ones, its choices, its plot."""

from __future__ import annotations

import json

import numpy as np
import pytest
from trust.running import HEAVY, JUDGES
from trust.running import clacad as clacad_command

import clacad
from clacad.cli import main
from clacad.cli.accuracy_command import accuracy_text
from clacad.exporting.roles import Holding
from clacad.mesh import tessellate
from clacad.sheet.bundle import bundle
from clacad.sheet.window import lens_height_and_normal
from clacad.tracing.worst_cell import worst_cell
from clacad.verification.accuracy import accuracy_plot
from clacad.verification.accuracy.accuracy_plot import plot_svg
from clacad.verification.accuracy.accuracy_table import AccuracyRow, AccuracyTable, TargetOutOfReach, accuracy
from clacad.verification.accuracy.extended_precision import direction_errors
from clacad.verification.accuracy.file_floors import EXACT, FAMILIES, Floor, family_floor, probe, rounded
from clacad.verification.accuracy.measure_rungs import TracedRays, _compared, spectrum_cost, step_row


@pytest.fixture(scope="module")
def design():
    return clacad.load("designs/paper-a-covered.toml").with_cells((5, 5))


@pytest.fixture(scope="module")
def table(design):
    return accuracy(design, rays=4000, quads=(8, 16))


def row(table, rung, **wanted):
    (found,) = [
        r for r in table.rows if r.rung == rung and all(getattr(r, k) == v for k, v in wanted.items())
    ]
    return found


@pytest.mark.slow
def test_files_have_their_seconds_of_writing_and_reading(table):
    timed = [one for one in table.rows if one.write_s is not None]
    assert {(one.rung, one.quads) for one in timed} == {("mesh", 8), ("mesh", 16), ("step", None)}
    assert all(one.write_s > 0.0 and one.read_s > 0.0 for one in timed)
    assert all((one.read_s is None) == (one.write_s is None) for one in table.rows)
    svg = plot_svg(table)
    assert svg == plot_svg(table)


@pytest.mark.slow
def test_every_rung_stands_beside_its_error_and_its_seconds(table):
    assert [r.rung for r in table.rows[:4]] == ["law", "thin", "surfaces", "surfaces"]
    assert sum(r.rung == "mesh" for r in table.rows) == 2 * 2 * 2
    assert all(r.rays_per_s > 0 and r.memory > 0 for r in table.rows if r.rung != "step")
    for one in table.rows:
        assert one.seconds > 0.0
        assert one.model_rms <= one.model_max
        assert 0.0 <= one.disagree < 0.5
    surfaces = row(table, "surfaces", float="f64")
    assert surfaces.model_max < 4e-15
    assert table.reference["rays"] == 1000
    # by definition: what rung law leaves out is what the exact surfaces do differently from the law
    assert row(table, "law").model_rms == pytest.approx(surfaces.law_rms, rel=1e-12)


@pytest.mark.slow
def test_the_measured_errors_are_those_known_of_the_papers_sheet(table):
    # 2.65 mrad of law error over 1 degree; 27 and 13.6 mrad by facets of 8 and 16 quads (performance of facets
    # goes as their size, of vertex normals as its square)
    assert row(table, "surfaces", float="f64").law_rms == pytest.approx(2.65e-3, rel=0.05)
    eight, sixteen = (row(table, "mesh", quads=q, normals="facet", float="f64").model_rms for q in (8, 16))
    assert sixteen == pytest.approx(13.6e-3, rel=0.08)
    assert np.log2(eight / sixteen) == pytest.approx(1.0, abs=0.1)
    eight, sixteen = (row(table, "mesh", quads=q, normals="vertex", float="f64").model_rms for q in (8, 16))
    assert np.log2(eight / sixteen) == pytest.approx(2.0, abs=0.15)


@pytest.mark.slow
def test_step_as_the_kernel_reads_it_sends_light_where_the_surfaces_do(table):
    step = row(table, "step")
    assert step.checked >= 1000
    assert step.model_max < 1e-11


@pytest.mark.slow
def test_a_target_names_the_cheapest_setting_that_meets_it(table):
    for target in (3e-2, 1e-3, 1e-5):
        chosen = table.cheapest(target)
        assert chosen.model_rms <= target
        assert chosen.disagree <= 0.01
        for other in table.rows:
            if other.model_rms <= target and other.disagree <= 0.01:
                assert chosen.predicted_seconds(table.rays) <= other.predicted_seconds(table.rays)
    with pytest.raises(TargetOutOfReach, match="the closest is surfaces float64"):
        table.cheapest(1e-20)
    assert TargetOutOfReach.exit_status == 3


@pytest.mark.slow
def test_no_row_beats_a_row_of_the_front_in_both(table):
    front = table.pareto()
    for one in front:
        assert not any(r.seconds < one.seconds and r.model_rms < one.model_rms for r in table.rows)


@pytest.mark.slow
def test_every_export_format_has_its_floor(table):
    from clacad.exporting.formats.registry import words

    named = [name for floor in table.floors for name in floor.formats.split(", ")]
    assert set(named) == set(words())


@pytest.mark.slow
def test_the_floor_of_each_format_is_confirmed_by_a_trace(table):
    traced = [(floor, row) for floor in table.floors for row in floor.confirmed]
    assert {floor.formats for floor, _ in traced} >= {
        "stl, stl-parts",
        "glb",
        "3mf, ply",
        "ply",
        "tiff",
        "png, dose, tiff",
        "gds",
    }
    for floor, (_, forecast, found) in traced:
        assert found == pytest.approx(forecast, rel=0.35), floor.formats


@pytest.mark.long
def test_past_the_optimum_finer_facets_of_a_float32_file_are_worse():
    # the paper's lenslets of half a millimetre: a step of float32 at 50 mm is not small compared with their facets
    design = clacad.load("designs/paper-c.toml")
    window = clacad.prescribe(design)
    lit = bundle(window, 4096, design.check.field)
    seen = probe(window, lit.rays, clacad.trace(window, lit.rays))
    stl = FAMILIES[0]
    smooth = {"facet": seen.error(seen.held(64, EXACT, "facet")) * 64}
    floor = family_floor(seen, stl, smooth, confirm=False)
    assert 25 < floor.best_quads < 60
    coarse, best, fine, finer = (
        seen.error(seen.held(quads, stl.holding, "facet")) for quads in (12, round(floor.best_quads), 96, 128)
    )
    assert best < min(coarse, fine)
    assert fine < finer
    assert best == pytest.approx(floor.floor, rel=0.25)
    # doubling a grid past the optimum nearly doubles the error, as forecast
    assert finer == pytest.approx(floor.error(128), rel=0.25)


@pytest.mark.slow
def test_the_table_is_json_and_the_plot_is_the_same_for_the_same_table(table):
    again = json.loads(json.dumps(table.to_dict(), allow_nan=False))
    assert len(again["rows"]) == len(table.rows)
    assert again["rows"][0]["rays_per_s"] > 0
    first, second = plot_svg(table, 1e-3), plot_svg(table, 1e-3)
    assert first == second
    assert "<svg" in first


def test_what_was_not_measured_is_null_and_never_nan():
    dark = AccuracyRow("mesh", "no ray alive", *[float("nan")] * 5, 1.0, 0.0, float("inf"), 100, 0)
    nowhere = Floor("stl", "facet", "f32", "", float("nan"), float("nan"), float("inf"), None, float("nan"))
    table = AccuracyTable("dark", (dark,), {"rms": float("nan"), "rays": 0.0}, (nowhere,))
    text = json.dumps(table.to_dict(), allow_nan=False)
    assert json.loads(text)["rows"][0]["model_rms"] is None
    assert "NaN" not in text
    assert "Infinity" not in text
    assert table.pareto() == ()


@pytest.mark.long
def test_the_command_prints_one_json_document_without_nan(capsys):
    status = main(["accuracy", "designs/slab.toml", "--rays", "400", "--json", "-q", "--target", "0.5 mrad"])
    told = capsys.readouterr()

    def refuse(word):
        raise AssertionError(word)

    document = json.loads(told.out, parse_constant=refuse)
    assert (status, told.err) == (0, "")
    assert document["target"]["chosen"]["model_rms"] <= 5e-4
    assert document["target"]["files"][0]["error"] <= 5e-4
    needed = {
        "model_rms", "model_p95", "model_max", "law_rms", "law_max", "disagree", "seconds", "prepare_s", "rays_per_s",
        "write_s", "read_s",
        "bytes", "file_bytes", "memory", "triangles", "quads", "normals", "float",
    }  # fmt: skip
    assert all(needed <= set(row) for row in document["rows"])
    assert len({row["quads"] for row in document["rows"] if row["rung"] == "mesh"}) >= 6
    assert {row["rung"] for row in document["rows"]} == {"law", "thin", "surfaces", "mesh", "step"}


@pytest.mark.daily_cases("1,1000000000000000000")
@pytest.mark.parametrize("count", ["1000000000,1000000000", "1,1000000000000000000"])
def test_a_sheet_of_1e18_lenslets_is_refused_before_anything_is_loaded_that_could_trace_it(count):
    ended = clacad_command("accuracy", "designs/slab.toml", "--set", f"lattice.count=[{count}]")
    assert (ended.status, ended.out) == (3, "")
    assert "1.00e+18 lenslets" in ended.err
    assert not ended.packages & HEAVY
    assert ended.parts <= JUDGES


def test_fifty_digits_see_an_error_of_an_ulp_that_doubles_cannot(design):
    window = clacad.prescribe(design)
    lit = bundle(window, 64, design.check.field)
    found = clacad.trace(window, lit.rays)
    alive = np.flatnonzero(found.fate == clacad.Fate.ALIVE)
    arguments = (window, lit.rays.position[alive], lit.rays.direction[alive])
    where = found.cell[alive], found.order[alive]
    assert direction_errors(*arguments, found.direction[alive], *where).max() < 1e-15
    turned = found.direction[alive] + [1e-12, 0.0, 0.0]
    errors = direction_errors(*arguments, turned, *where)
    np.testing.assert_allclose(errors, 1e-12 * np.sqrt(1 - found.direction[alive][:, 0] ** 2), rtol=1e-3)


@pytest.mark.daily_cases("slab", "hexagonal", "plano", "galilean")
@pytest.mark.parametrize("name", ["slab", "tilted", "hexagonal", "plano", "galilean"])
def test_every_form_is_held_to_fifty_digits_and_to_its_step_file(name):
    design = clacad.load(f"designs/{name}.toml")
    window = clacad.prescribe(design)
    ladder = TracedRays.raised(window, bundle(window, 400, design.check.field).rays)
    alive = np.flatnonzero(ladder.truth.fate == clacad.Fate.ALIVE)
    errors = direction_errors(
        window, ladder.rays.position[alive], ladder.rays.direction[alive], ladder.truth.direction[alive],
        ladder.truth.cell[alive], ladder.truth.order[alive],
    )  # fmt: skip
    assert errors.max() < 4e-15
    if name == "tilted":  # a displaced slab: the hard one for a file
        step, note = step_row(
            ladder, lambda count: TracedRays.raised(window, bundle(window, count, design.check.field).rays)
        )
        assert note == ""
        assert step.checked >= 1000  # though the ladder has 400 rays
        assert step.model_max < 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("lost", [0.0, 0.6, 0.93])
def test_rays_go_to_the_step_file_until_a_thousand_came_through_and_none_goes_twice(design, lost):
    window = clacad.prescribe(design)

    def ladder(count):
        return TracedRays.raised(window, bundle(window, count, design.check.field).rays)

    seen = []

    def cast(position, direction, indices):
        first = len(seen)
        seen.extend(map(tuple, np.hstack([position, direction]).tolist()))
        rng = np.random.default_rng(first)
        return [None if rng.random() < lost else ray for ray in direction], 0.5, 0.1

    spot = _compared(ladder(300), ladder, cast, window.with_cells((5, 5)))
    through = np.isfinite(spot.found[:, 0])
    assert 1000 <= through.sum() <= 1500
    assert len(set(seen)) == len(seen) == len(spot.found) == len(spot.truth) == len(spot.asked)
    assert through.mean() == pytest.approx(1.0 - lost, abs=0.05)
    assert (spot.reading, spot.seconds) == (0.5, pytest.approx(0.1 * (1 if lost == 0.0 else 2), abs=0.11))
    # a blind file: some are sent again, and it ends
    seen.clear()
    none = _compared(
        ladder(300), ladder, lambda p, d, i: ([None] * len(p), 0.5, 0.1), window.with_cells((5, 5))
    )
    assert len(none.found) <= 20_000
    assert not np.isfinite(none.found).any()


@pytest.mark.slow
def test_single_precision_is_a_tenth_of_a_microradian_not_a_milliradian(table):
    single = row(table, "surfaces", float="f32")
    assert 1e-9 < single.model_rms < 3e-7
    assert single.disagree < 1e-3


def test_rounded_vertices_are_float32_numbers_of_the_files_unit(design):
    window = clacad.prescribe(design)
    mesh = tessellate(window, quads=6)
    cell = (4, 4)
    held = rounded(mesh, cell, Holding("sheet")).bodies[0].tiled[0].maker.tile
    centre = window.lattice.centres(np.array(cell))
    x = (held.plan.xy + centre) * 1e3
    assert np.abs(x - x.astype(np.float32)).max() < 1e-13
    z = held.lens * held.step * 1e3
    assert np.abs(z - z.astype(np.float32)).max() < 1e-4 * np.spacing(np.float32(z.max()))
    assert np.abs(held.plan.xy - mesh.bodies[0].tiled[0].maker.tile.plan.xy).max() > 0.0


def test_held_exactly_the_corners_lie_on_the_surfaces(design):
    window = clacad.prescribe(design)
    mesh = tessellate(window, quads=6)
    for body, held in zip(window.bodies, rounded(mesh, (0, 0), EXACT).bodies, strict=True):
        tile = held.tiled[0].maker.tile
        for side, face in enumerate((body.front, body.back)):
            z, _ = lens_height_and_normal(face, *tile.plan.xy.T)
            assert np.abs(tile.lens[:, side] * tile.step - z).max() <= tile.step


@pytest.mark.slow
@pytest.mark.parametrize(("normals", "order"), [("facet", 1.0), ("vertex", 2.0)])
def test_facets_are_of_first_order_and_vertex_normals_of_second(normals, order):
    # a slab: one pair of facets a ray, so that no correlation of two bodies bends the line
    design = clacad.load("designs/slab.toml").with_cells((5, 5))
    window = clacad.prescribe(design)
    lit = bundle(window, 4000, design.check.field)
    seen = probe(window, lit.rays, clacad.trace(window, lit.rays))
    grids = np.array([6, 9, 13, 20, 30, 45])  # not powers of two: Sobol points share no grid with them
    errors = [seen.error(seen.held(int(quads), EXACT, normals)) for quads in grids]
    slope = np.polyfit(np.log(grids), np.log(errors), 1)[0]
    assert -slope == pytest.approx(order, abs=0.1)


@pytest.mark.slow
def test_a_field_lens_has_its_rows_of_error_and_seconds_and_its_step_faces_are_exact():
    design = clacad.load("designs/window-100mm.toml").with_cells((5, 5)).replace("pair.field_lens", True)
    found = accuracy(design, rays=1000, quads=(8, 16))
    surfaces, plain = row(found, "surfaces", float="f64"), row(found, "law")
    assert surfaces.model_max < 1e-14  # rad, through four faces, against the oracle's digits
    assert plain.model_rms == pytest.approx(surfaces.law_rms, rel=1e-12)
    assert row(found, "thin").model_rms == pytest.approx(
        plain.model_rms, rel=0.05
    )  # what thick lenses add is small
    coarse, fine = (
        next(
            r.model_rms
            for r in found.rows
            if r.rung == "mesh" and r.setting.startswith(f"{quads} quads, facet")
        )
        for quads in (8, 16)
    )
    assert coarse / fine == pytest.approx(2.0, rel=0.15)
    assert row(found, "step").model_rms < 1e-9
    assert all(one.seconds > 0.0 for one in found.rows)


# -- the plot and the conclusion ------------------------------------------------------------------------------------


def row_of(rung, error, seconds, **more):
    return AccuracyRow(rung, "", error, error, error, 0.0, 0.0, 0.0, seconds, 0.0, 1000, 1000, **more)


def made_table(mesh_seconds):
    """Exact faces that cost 1.3 × the law, 12 meshes of 1/m or 1/m², a STEP file and the floor of STL."""
    rows = [row_of("law", 3e-4, 1.0), row_of("thin", 3e-4, 1.2), row_of("surfaces", 1e-16, 1.3)]
    for m in (4, 8, 16, 32, 64, 128):
        rows.append(row_of("mesh", 0.08 / m, mesh_seconds, quads=m, normals="facet"))
        rows.append(row_of("mesh", 5e-4 / m**2, 1.2 * mesh_seconds, quads=m, normals="vertex"))
    rows.append(row_of("step", 5e-14, 1e4, file_bytes=175_000))
    floor = Floor("stl, stl-parts", "facet", "f32", "", 0.08, 2e-8, 2000.0, 1e-3, 3.5e-4, 1e9)
    return AccuracyTable(
        "made", tuple(rows), {"rms": 1e-16, "max": 2e-16, "digits": 50.0, "rays": 1000.0}, (floor,), rays=1000
    )


def test_the_conclusion_says_what_the_rows_say():
    table = made_table(1.5)
    said = table.conclusion
    assert said == table.to_dict()["conclusion"]
    assert "Exact faces cost 1.3 × the law and are within 1e-13 mrad" in said
    assert "No mesh is worth tracing" in said
    assert "128 quads a cell side with vertex normals, takes 1.4 × the time" in said
    assert (
        "Of files, STEP is within 5e-11 mrad in 175 kB; STL comes no closer than 0.35 mrad at any size."
        in said
    )
    assert said in accuracy_text(table)


def test_a_mesh_that_is_faster_than_exact_faces_is_said_to_be_worth_its_error():
    assert "A mesh is worth tracing for speed alone: 128 quads" in made_table(1.05).conclusion


@pytest.mark.slow
def test_no_label_of_the_plot_lies_on_another_or_on_a_curve_and_legends_lie_beside_the_panels():
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.text import Annotation

    figure = Figure(figsize=accuracy_plot.SIZE)
    canvas = FigureCanvasAgg(figure)
    table = made_table(1.5)
    accuracy_plot.draw(figure, table, 1e-6)
    canvas.draw()
    drawer = canvas.get_renderer()
    left, right = figure.axes
    labels = [one for one in left.get_children() if isinstance(one, Annotation)]
    boxes = [one.get_window_extent(drawer) for one in labels]
    assert {"law", "surfaces", "step"} <= {one.get_text() for one in labels}
    assert not [(a, b) for k, a in enumerate(boxes) for b in boxes[:k] if a.overlaps(b)]
    for line in left.lines:
        at = line.get_transform().transform(line.get_xydata())
        along = np.concatenate([np.linspace(p, q, 500) for p, q in zip(at, at[1:] if len(at) > 1 else at)])
        assert not any(box.contains(x, y) for box in boxes for x, y in along)
    for axes in (left, right):
        assert not axes.get_legend().get_window_extent(drawer).overlaps(axes.bbox)
        assert "(mrad)" in axes.get_ylabel()
    caption = next(one for one in figure.texts if "Exact faces" in one.get_text())
    box = caption.get_window_extent(drawer)
    assert caption.get_text().replace("\n", " ") == table.conclusion
    assert not any(box.overlaps(axes.get_legend().get_window_extent(drawer)) for axes in (left, right))
    assert box.x0 > 0.0
    assert box.x1 < figure.bbox.x1


def test_one_line_against_the_spectrum_has_its_cost_and_the_numbers_of_check():
    """Closed form next to the trace; the mean over the lines is that of another program (.293 mrad at 1 degree)."""
    sheet = clacad.load("window-100mm").with_cells((20, 20))
    window = clacad.prescribe(sheet)
    cell, lit = worst_cell(window, sheet.check.field), bundle(window, 16384, sheet.check.field)
    cost = spectrum_cost(sheet, cell, lit)
    assert cost.lines == 4
    assert 1e3 * cost.law_white == pytest.approx(0.293, rel=0.01)
    assert cost.closed_change == pytest.approx(cost.change, rel=0.03)
    assert min(cost.one_line_s, cost.traced_s, cost.closed_s) > 0.0
    assert cost.sentence().startswith("one line against the spectrum: 4 lines take ")
    assert f"{cost.traced_s / cost.one_line_s:.2g} × one line" in cost.sentence()
    assert spectrum_cost(sheet.replace("light.spectrum", "photopic"), cell, lit).lines == 5
    bare = clacad.load("paper-base")
    assert spectrum_cost(bare, worst_cell(clacad.prescribe(bare), 0.0), lit) is None
