"""Parts in rows of an assembly are compared with the lattice as rows: the result equals that of every copy by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from brepwindows import biconvex

from clacad.formats import placements as places
from clacad.formats.placements import UNPLACED, Placements, composed
from clacad.formats.step.lens_placements import SheetPlace
from clacad.formats.step.lenses_on_cells import lens_facts
from clacad.formats.step.step_files import write_step
from clacad.formats.step.text_health import patch_points, scan_step
from clacad.storage.errors import UnreadableFile

CASES = {
    "square": {"count": (7, 5), "pitch": 0.1234567},
    "hexagonal": {"count": (6, 5), "kind": "hexagonal"},
    "displaced": {"count": (4, 6), "delta": (0.05, 0.02), "web": 0.03, "thickness": 0.14},
}


def at(x, y, z=0.0):
    found = UNPLACED.copy()
    found[:, 3] = x, y, z
    return found


def line(count, x, y):
    return np.array([at(k * x, k * y) for k in range(count)])


@pytest.fixture(scope="module", params=CASES)
def sheet(request, tmp_path_factory):
    """Window, points of the lens faces, and placements of every part, of an instanced file."""
    window = biconvex(**CASES[request.param])
    path = tmp_path_factory.mktemp("rows") / "x.step"
    write_step(window, path, mode="instanced")
    scan = scan_step(path)
    return window, patch_points(scan), [part.placements for part in scan.parts]


def written_out(parts):
    return [Placements(part.all()) for part in parts]


def placement(sheet, parts):
    """What is found, without the largest distance from a cell and where it is if that is rounding alone."""
    found = dict(lens_facts(sheet[0], sheet[1], parts)["placement"])
    if found["lattice_error"] <= 1e-12:
        found |= {"lattice_error": 0.0, "lattice_cell": [0, 0], "lattice_body": ""}
    return found


def test_rows_that_fill_the_lattice_say_what_their_copies_say_and_are_not_written_out(sheet, monkeypatch):
    window, _, parts = sheet
    n1, n2 = window.lattice.count
    rows = [part for part in parts if len(part) > 1]
    assert [(len(part.outer), len(part.inner)) for part in rows] == [(n2, n1)] * len(rows)
    wanted = placement(sheet, written_out(parts))
    monkeypatch.setattr(Placements, "all", None)
    found = placement(sheet, parts)
    assert found == wanted
    assert (found["missing"], found["doubled"], found["moved"], found["standing"]) == (0, 0, 0, 1.0)
    assert found["lattice_error"] == 0.0


def changed(part, what, pitch):
    """Placements of a part in rows with one thing wrong, still in rows."""
    outer, inner = part.outer.copy(), part.inner.copy()
    if what == "a row shifted":
        outer[2, 0, 3] += 1e-6 * pitch
    elif what == "a row raised":
        outer[1, 2, 3] += 1e-6 * pitch
    elif what == "a column shifted":
        inner[1, 1, 3] += 1e-6 * pitch
    elif what == "a column missing":
        inner = np.delete(inner, 2, axis=0)
    elif what == "a row missing":
        outer = np.delete(outer, -1, axis=0)
    elif what == "a column doubled":
        inner = np.concatenate([inner, inner[1:2]])
    elif what == "a row doubled":
        outer = np.concatenate([outer, outer[:1]])
    elif what == "a row in the place of another":
        outer[0] = outer[1]
    elif what == "a column in the place of another":
        inner[2] = inner[0]
    elif what == "all a cell aside":
        outer[:, 0, 3] += pitch
    elif what == "a row turned":
        c, s = np.cos(1e-3), np.sin(1e-3)
        outer[1, :2, :2] = [[c, -s], [s, c]]
    return Placements(outer, inner)


WRONG = (
    "a row shifted", "a row raised", "a column shifted", "a column missing", "a row missing", "a column doubled", "a row doubled",
    "a row in the place of another", "a column in the place of another", "all a cell aside", "a row turned",
)  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_with_rows_is_told_as_by_their_copies(sheet, what):
    window, _, parts = sheet
    k = next(k for k, part in enumerate(parts) if len(part) > 1)
    wrong = [*parts[:k], changed(parts[k], what, window.lattice.pitch[0]), *parts[k + 1 :]]
    stand = placement(sheet, wrong)
    assert stand == placement(sheet, written_out(wrong))
    assert stand["missing"] or stand["doubled"] or stand["moved"]
    faces, rows, columns = 2, *reversed(window.lattice.count)
    if what == "a row missing":
        assert (stand["missing"], stand["doubled"]) == (faces * columns, 0)
    if what == "a column doubled":
        assert (stand["missing"], stand["doubled"]) == (0, faces * rows)
    if what == "a row shifted":
        assert stand["moved"] == faces * columns
        assert stand["lattice_error"] == pytest.approx(1e-6 * window.lattice.pitch[0], rel=1e-6)


def test_one_placement_more_than_a_sheet_of_rows_is_a_lens_put_twice(sheet):
    window, lenses, parts = sheet
    k = next(k for k, part in enumerate(parts) if len(part) > 1)
    every = parts[k].all()
    more = [*parts[:k], Placements(np.concatenate([every, every[3:4]])), *parts[k + 1 :]]
    stand = lens_facts(window, lenses, more)["placement"]
    assert (stand["missing"], stand["doubled"]) == (0, 2)
    whole = lenses.of_part(k)
    twice = replace(
        lenses,
        place=np.concatenate([lenses.place, whole.place]),
        outward=np.concatenate([lenses.outward, whole.outward]),
        patch=np.concatenate([lenses.patch, whole.patch + lenses.patch.max() + 1]),
        part=np.concatenate([lenses.part, np.full(len(whole.part), len(parts))]),
    )
    for beside in (
        parts[k],
        Placements(every[3:4]),
    ):  # a second sheet in the place of the first; one cell of it
        stand = lens_facts(window, twice, [*parts, beside])["placement"]
        assert (stand["missing"], stand["doubled"]) == (0, 2 * len(beside))


def test_rows_are_kept_apart_whatever_stands_above_them():
    rows, cells = line(30, 0.1, 2.0), line(20, 1.0, 0.0)
    for top in ([UNPLACED], [at(5.0, 6.0, 7.0)], [at(0.0, 0.0), at(0.0, 900.0)]):
        held = {"sheet": [("row", rows)], "row": [("cell", cells)], "top": [("sheet", np.array(top))],
                "cell": [("solid", UNPLACED[None])]}  # fmt: skip
        found = composed(held, ["top", "sheet", "row", "cell", "solid"])["solid"]
        wanted = [
            t[:, 3] + r[:, 3] + c[:, 3] for t in np.array(top) for r in rows for c in cells
        ]  # exact: all are short numbers or sums of two
        np.testing.assert_allclose(found.all()[:, :, 3], wanted, rtol=1e-15)
        assert len(found.inner) == 20
        for k in (0, 19, 20, 599):
            np.testing.assert_array_equal(found.one(k), found.all()[k])
        np.testing.assert_array_equal(found.at(np.array([7, 401])), found.all()[[7, 401]])


def test_ends_are_those_of_all_copies_bit_for_bit():
    rng = np.random.default_rng(5)
    outer, inner = (np.array([at(*p) for p in rng.normal(size=(40, 3)) * 1e3]) for _ in range(2))
    rows = Placements(outer, inner)
    ((_, low, high),) = rows.ends()
    moves = rows.all()[:, :, 3]
    np.testing.assert_array_equal(low, moves.min(axis=0))
    np.testing.assert_array_equal(high, moves.max(axis=0))


def test_copies_near_a_column_are_all_found_and_few_others():
    rows = Placements(line(1000, 0.5, 2.0), line(1000, 1.0, 0.0))
    low, high = np.array([300.25, 800.0]), np.array([302.75, 804.0])
    near = rows.near(low, high)
    over = rows.at(near)[:, :2, 3]
    inside = ((over >= low) & (over <= high)).all(axis=1)
    wanted = [1000 * j + i for j in range(400, 403) for i in range(1000) if 300.25 <= i + 0.5 * j <= 302.75]
    assert near[inside].tolist() == wanted
    assert len(near) < 1e4


def test_rows_of_more_cells_than_are_written_out_are_refused_only_where_they_must_be(monkeypatch):
    monkeypatch.setattr(places, "MOST", 100)
    rows = composed(
        {"sheet": [("row", line(30, 0.0, 1.0))], "row": [("cell", line(20, 1.0, 0.0))]},
        ["sheet", "row", "cell"],
    )["cell"]
    assert len(rows) == 600
    assert len(rows.near(np.array([3.5, 3.5]), np.array([4.5, 4.5]))) == 1
    for asked in (rows.all, lambda: rows.at(np.arange(101)), lambda: rows.within(line(2, 0.1, 0.0))):
        with pytest.raises(UnreadableFile, match="more than 100 times"):
            asked()


def test_sheets_behind_one_another_take_their_own_rows(sheet):
    window, lenses, parts = sheet
    heights = [float(lenses.of_part(k).place[:, 2].mean()) for k in range(len(parts))]
    place = SheetPlace(min(heights) - 1.0, min(heights) + 1e-3, 0.25)
    for found, wanted in zip(
        place.of_parts(lenses, parts), place.of_parts(lenses, written_out(parts)), strict=True
    ):
        np.testing.assert_array_equal(found.all(), wanted.all())
    assert any(len(part) > 1 for part in place.of_parts(lenses, parts))
