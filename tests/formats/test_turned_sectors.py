"""Sheets aimed from their axis: cells a turn apart are the same piece, and a STEP file holds one sector, turned."""

import re

import numpy as np
import pytest

import clacad
from clacad.formats.step.part21 import chosen_mode
from clacad.formats.step.read_back import read_step
from clacad.formats.step.step_files import write_step
from clacad.sheet.need_window import CellsDiffer
from clacad.sheet.representative_cells import sector, sectors_of, turned_alike

AXIS = {"lattice.aperture": {"point": [0, 0, -400]}, "lattice.count": [8, 8]}
ROUND = {"lattice.outline": {"circle": 6}, "lattice.count": [12, 12]}


def window(**keys):
    changed = AXIS | {name.replace("__", "."): value for name, value in keys.items()}
    return clacad.prescribe(clacad.load("window-100mm").replace(changed))


def turned(points, copies):
    """By 360 degrees / copies, by complex numbers."""
    z = (points[..., 0] + 1j * points[..., 1]) * (1j if copies == 4 else -1)
    return np.stack([z.real, z.imag], axis=-1)


@pytest.mark.parametrize(
    ("keys", "alike", "sectors"),
    [
        ({}, 4, 4),
        ({"pair__form": "plano"}, 4, 4),
        ({"pair__form": "biconvex"}, 4, 4),
        ({"lattice__outline": {"circle": 3}}, 4, 4),
        ({"lattice__count": [7, 7]}, 4, 1),  # a cell lies on the axis: arrays of two pitches have no common cut
        ({"lattice__count": [8, 6]}, 2, 2),
        ({"lattice__count": [7, 6]}, 2, 2),
        ({"lattice__count": [6, 7]}, 2, 1),
        ({"lattice__kind": "hexagonal"}, 2, 1),  # rows of cells are no straight cut through the outline
        ({"lattice__kind": "hexagonal", "pair__form": "plano"}, 2, 2),
        ({"law__eta": [-1.0, -0.5]}, 2, 2),
        ({"body__outline": {"circle": 16}}, 4, 1),  # a plate is not cut: its holes may break the symmetry
        ({"body__border": 2.0}, 4, 4),
        ({"lattice__outline": {"rectangle": [3, 2]}}, 2, 2),
        ({"law__delta": [0.01, 0.0]}, 1, 1),
        ({"lattice__aperture": {"point": [1, 0, -400]}}, 1, 1),
    ],
)  # fmt: skip
def test_what_turns_leave_a_sheet_as_it_is(keys, alike, sectors):
    sheet = window(**keys)
    assert (turned_alike(sheet), sectors_of(sheet)) == (alike, sectors)


@pytest.mark.parametrize("form", ["slab", "plano", "biconvex"])
@pytest.mark.parametrize(("count", "copies"), [([7, 7], 4), ([8, 8], 4), ([8, 6], 2)])
def test_lenses_of_turned_cells_lie_where_the_turn_takes_them_bit_by_bit(form, count, copies):
    sheet = window(pair__form=form, lattice__count=count)
    cells = sheet.lattice.cells()
    centres = sheet.lattice.centres(cells)
    there = sheet.lattice.locate(*turned(centres, copies).T)[0]
    for face in (face for face in sheet.faces if face.array == 1):
        apex = sheet.vertices(face, cells)
        assert np.array_equal(sheet.vertices(face, there)[:, :2] + 0.0, turned(apex[:, :2], copies) + 0.0)
        assert np.array_equal(sheet.vertices(face, there)[:, 2], apex[:, 2])
        assert not apex[(centres == 0.0).all(axis=1), :2].any()  # the lens on the axis lies on it


def test_the_sector_and_its_turned_copies_are_every_cell_once():
    for copies, keys in ((4, {"lattice__outline": {"circle": 3}}), (2, {"lattice__count": [8, 6]})):
        sheet = window(**keys)
        centres = sheet.lattice.centres(sector(sheet).lattice.cells())
        found = [centres]
        for _ in range(copies - 1):
            found.append(turned(found[-1], copies))
        index = sheet.lattice.locate(*np.concatenate(found).T)[0]
        assert sorted(map(tuple, index.tolist())) == sorted(map(tuple, sheet.lattice.cells().tolist()))


@pytest.mark.slow
@pytest.mark.parametrize(
    "keys",
    [
        {"lattice__outline": {"circle": 6}, "lattice__count": [12, 12]},
        {"pair__form": "plano"},
        {"pair__form": "biconvex", "lattice__count": [6, 4]},
        {"lattice__kind": "hexagonal", "pair__form": "plano", "lattice__count": [4, 4]},
    ],
    ids=["round slab", "plano", "biconvex halves", "hexagonal halves"],
)
def test_turned_sectors_have_the_volume_and_the_lenses_of_the_whole(keys, tmp_path):
    sheet = window(**keys)
    found = {}
    for mode in ("fused", "instanced"):
        written = write_step(sheet, tmp_path / f"{mode}.step", mode=mode)
        found[mode] = read_step(tmp_path / f"{mode}.step", sheet) | {"bytes": written["bytes"]}
    whole, parts = found["fused"], found["instanced"]
    copies = sectors_of(sheet)
    assert parts["valid"]
    assert parts["kernel_solids"] == copies * len(sheet.bodies)
    assert parts["volume"] == pytest.approx(whole["volume"], rel=1e-9)
    assert np.allclose(parts["box"], whole["box"], rtol=0.0, atol=1e-6)
    assert parts["placement"]["instances"] == copies * len(sheet.bodies)
    assert parts["placement"]["lattice_error"] < 1e-12
    assert parts["placement"]["standing"] == 1.0
    assert max(parts["patch_error"], parts["lens_error"]) < 1e-11
    assert parts["bytes"] < 1.25 * whole["bytes"] / copies


@pytest.fixture(scope="module")
def in_sectors(tmp_path_factory):
    """A round sheet of twelve by twelve cells and its file of four sectors."""
    path = tmp_path_factory.mktemp("sectors") / "good.step"
    sheet = window(**{name.replace(".", "__"): value for name, value in ROUND.items()})
    write_step(sheet, path, mode="instanced")
    return sheet, path.read_text()


def second_turn(text):
    """The placement of the second sector: its x axis, and its origin."""
    return re.findall(r"(#\d+=DIRECTION\('',\()0\.,1\.,0\.\)\);\n#\d+=AXIS2_PLACEMENT_3D\('',(#\d+)", text)[
        -1
    ]


def a_turn_exchanged(text):
    """The second sector lies where the third does."""
    begins, _ = second_turn(text)
    return text.replace(f"{begins}0.,1.,0.", f"{begins}-1.,0.,0.")


def a_turn_spoilt(text):
    """The second sector is turned by a tenth of a milliradian too far."""
    begins, _ = second_turn(text)
    return text.replace(f"{begins}0.,1.,0.", f"{begins}-1.E-4,1.,0.")


def a_place_moved(text):
    """The second sector lies 1 µm aside."""
    _, at = second_turn(text)
    return text.replace(f"\n{at}=CARTESIAN_POINT('',(0.,", f"\n{at}=CARTESIAN_POINT('',(0.001,")


def a_place_missing(text):
    """The last sector is not placed: its use, its shape, and the relation of the two."""
    [use] = re.findall(r"\n(#\d+)=NEXT_ASSEMBLY_USAGE_OCCURRENCE\('sheet sector 4'", text)
    [shape] = re.findall(rf"\n(#\d+)=PRODUCT_DEFINITION_SHAPE\('','',{use}\);", text)
    [(last, relation)] = re.findall(
        rf"\n(#\d+)=CONTEXT_DEPENDENT_SHAPE_REPRESENTATION\((#\d+),{shape}\);", text
    )
    for number in (use, shape, last, relation):
        text = re.sub(rf"\n{number}=.*", "", text)
    return text


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (a_turn_exchanged, "more than once"),
        (a_turn_spoilt, "off the lattice"),
        (a_place_moved, "off the lattice"),
        (a_place_missing, "is missing"),
        (lambda text: text, ""),
    ],
    ids=["exchanged", "spoilt", "moved", "missing", "good"],
)
def test_verify_finds_a_sector_that_lies_elsewhere(spoil, words, in_sectors, tmp_path):
    from clacad.judging.step_file import _placement, room_for

    sheet, good = in_sectors
    text = spoil(good)
    assert (text != good) is bool(words)
    path = tmp_path / "spoilt.step"
    path.write_text(text)
    found = read_step(path, sheet, kernel=False)
    room = room_for(clacad.load("window-100mm"), sheet, {"pcurves": True})
    check = _placement(found, room, {"subject": path.name})
    assert check.state == ("fail" if words else "pass")
    assert words in check.sentence


def test_an_assembly_is_chosen_for_many_cells_and_refused_where_nothing_repeats():
    small, odd = window(), window(lattice__count=[7, 7])
    assert chosen_mode(small, "auto") == chosen_mode(odd, "auto") == "fused"
    assert chosen_mode(window(lattice__count=[60, 60]), "auto") == "instanced"
    with pytest.raises(CellsDiffer, match="CL139"):
        chosen_mode(odd, "instanced")
