"""Tables of cells as others write them: what is taken, and where what is not taken is refused."""

from __future__ import annotations

import io
import os
import zipfile
from hashlib import sha256

import numpy as np
import pytest

from clacad.config.mistakes import DesignError, DesignTooLarge
from clacad.design import cell_table_rows
from clacad.design.cell_table import TableSpec, digest, read_table, table_path
from clacad.sheet.lattice import Circle, Lattice

HEADER = "i,j,delta_x,delta_y\n"
SMALL = Lattice("square", (1.0, 1.0), (2, 3))


def rows(lattice, delta=lambda i, j: (0.01 * i, -0.02 * j)):
    return HEADER + "".join(
        "{},{},{!r},{!r}\n".format(i, j, *delta(i, j)) for i, j in lattice.cells().tolist()
    )


def table_of(tmp_path, data, lattice=SMALL, name="cells.csv", stated=None, eta=-1.0):
    raw = data if isinstance(data, bytes) else data.encode()
    (tmp_path / name).write_bytes(raw)
    spec = TableSpec(name, stated or sha256(raw).hexdigest())
    return read_table(str(tmp_path / "d.toml"), spec, lattice, eta if isinstance(eta, tuple) else (eta, eta))


def read(tmp_path, data, lattice=SMALL, name="cells.csv", stated=None):
    found = table_of(tmp_path, data, lattice, name, stated)
    assert found.etas is None
    return found.deltas


def refused(tmp_path, data, lattice=SMALL, name="cells.csv", eta=-1.0):
    with pytest.raises(DesignError) as caught:
        table_of(tmp_path, data, lattice, name, eta=eta)
    (mistake,) = caught.value.mistakes
    assert mistake.code == "CL124"
    assert str(mistake)
    return mistake


def npz(**arrays):
    made = io.BytesIO()
    np.savez(made, **arrays)
    return made.getvalue()


@pytest.mark.parametrize("change", [str, lambda t: t.replace("\n", "\r\n"), lambda t: "\ufeff" + t, str.strip, lambda t: t + "\n\n", lambda t: t.replace(",", " , ")])  # fmt: skip
def test_rows_are_taken_in_any_order_with_any_line_end_and_byte_order_mark(tmp_path, change):
    head, *body = rows(SMALL).splitlines(keepends=True)
    made = read(tmp_path, change(head + "".join(reversed(body))))
    exact = [[[0.01 * i, -0.02 * j] for j in range(3)] for i in range(2)]
    assert np.array_equal(made, exact)


def test_cells_of_a_hexagonal_sheet_are_named_as_its_lattice_names_them(tmp_path):
    lattice = Lattice("hexagonal", (1.0, 1.0), (3, 4))
    made = read(tmp_path, rows(lattice), lattice)
    for i, j in lattice.cells().tolist():
        assert made[i + j // 2, j].tolist() == [0.01 * i, -0.02 * j]


def test_cells_that_an_outline_leaves_out_may_be_missing_or_there(tmp_path):
    whole = Lattice("square", (1.0, 1.0), (6, 6))
    round_one = Lattice("square", (1.0, 1.0), (6, 6), Circle(6.0))
    kept = read(tmp_path, rows(round_one), round_one)
    assert np.count_nonzero(kept.any(axis=-1)) <= round_one.cell_count < 36
    assert np.array_equal(read(tmp_path, rows(whole), round_one)[1, 2], kept[1, 2])


@pytest.mark.parametrize(
    ("change", "row", "column", "word"),
    [
        (lambda t: t.replace("i,j,", "j,i,", 1), 1, 1, "header"),
        (lambda t: t.replace(",delta_y", "", 1), 1, 12, "header"),
        (lambda t: t.replace("1,2,0.01,-0.04", "1,2,nan,-0.04"), 7, 5, "delta_x is out of range"),
        (lambda t: t.replace("1,2,0.01,-0.04", "1,2,0.01,inf"), 7, 10, "delta_y is out of range"),
        (lambda t: t.replace("1,2,0.01,-0.04", "1,2,0.01,x"), 7, 10, "delta_y is no number"),
        (lambda t: t.replace("1,2,0.01,-0.04", "1,2,0.01"), 7, 9, "3 values in a row"),
        (lambda t: t.replace("1,2,0.01,-0.04", "1,2,0.01,0,0"), 7, 12, "5 values in a row"),
        (lambda t: t.replace("1,2,0.01,-0.04", "1,7,0.01,0"), 7, 3, "j lies outside"),
        (lambda t: t.replace("1,2,0.01,-0.04", "-1,2,0.01,0"), 7, 1, "i lies outside"),
        (lambda t: t.replace("1,2,0.01,-0.04", "0.5,2,0.01,0"), 7, 1, "i is no whole number"),
        (lambda t: t.replace("1,2,0.01,-0.04", "1e300,2,0.01,0"), 7, 1, "i is no whole number"),
        (lambda t: t.replace("1,2,0.01,-0.04", "0,2,0.01,0"), 7, 1, "cell (0, 2) occurs twice in the table"),
        (lambda t: t + "1,2,0.01,-0.04\n", 8, 1, "cell (1, 2) occurs twice in the table"),
        (lambda t: t.replace("1,2,0.01,-0.04\n", ""), None, None, "cell (1, 2) is missing"),
        (lambda t: t.replace("1,2,0.01,-0.04\n", "\n1,2,0.01,-0.04\n"), 7, None, "empty row"),
        (lambda t: t + "0" * 2000, 8, None, "1000 characters"),
        (lambda t: t.encode() + b"\xff\xfe,1\n", 8, None, "not UTF-8"),
        (lambda t: "", 1, 1, "header"),
        (lambda t: HEADER, None, None, "cell (0, 0) is missing"),
        (lambda t: t + "#\n", 8, 1, "i is no number"),
    ],
)
def test_a_flaw_is_refused_at_its_row_and_column(tmp_path, change, row, column, word):
    mistake = refused(tmp_path, change(rows(SMALL)))
    assert (mistake.line, mistake.column) == (row, column)
    assert word in mistake.message
    assert mistake.path.endswith("cells.csv")


def test_a_flaw_in_a_later_block_is_named_by_its_own_row(tmp_path, monkeypatch):
    monkeypatch.setattr(cell_table_rows, "BLOCK", 2)
    assert np.array_equal(read(tmp_path, rows(SMALL))[1, 2], [0.01, -0.04])
    text = rows(SMALL).replace("1,2,0.01,-0.04", "0,0,0.01,0")
    assert refused(tmp_path, text).line == 7


def test_an_array_is_taken_as_it_is_and_refused_where_it_is_another(tmp_path):
    delta = np.arange(12.0).reshape(2, 3, 2)
    for kind in (np.float64, np.float32, np.int16):
        assert np.array_equal(read(tmp_path, npz(delta=delta.astype(kind)), name="t.npz"), delta)
    whole = npz(delta=delta)
    for data, word in (
        (npz(other=delta), "no array"),
        (npz(delta=delta, theta=90.0 + delta[..., 0]), "theta[0, 0] = 90.0 is out of range"),
        (npz(delta=delta, tilt=delta[..., 0]), "tilt.npy is none of the arrays that are read"),
        (npz(delta=delta, phi=1e5 + delta[..., 0]), "phi[0, 0] = 100000.0 is out of range"),
        (
            npz(delta=delta, eta=-1 - delta[..., 0], eta_x=-1 - delta[..., 0]),
            "eta_x.npy is none of the arrays",
        ),
        (npz(delta=delta, eta_y=delta[..., 0]), "eta_y[0, 0] = 0.0 is out of range"),
        (npz(delta=delta[:, :2]), "(2, 2, 2)"),
        (npz(delta=np.full((2, 3, 2), None)), "pickled objects are not read"),
        (npz(delta=np.where(delta == 7, np.nan, delta)), "delta[1, 0, 1]"),
        (npz(delta=np.full((2, 3, 2), "x")), "<U1"),
        (npz(delta=np.asfortranarray(delta)), "Fortran"),
        (b"not a zip", "not an .npz archive"),
        (whole[:-30], "not an .npz archive"),
        (whole[:60] + b"\xff" * 40 + whole[100:], "delta"),
        (whole + b"\0" * (2 << 20), "more than such arrays have"),
    ):
        assert word in refused(tmp_path, data, name="t.npz").message


def test_a_bomb_is_not_blown_up(tmp_path):
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        head = io.BytesIO()
        np.lib.format.write_array_header_1_0(
            head, {"descr": "<f8", "fortran_order": False, "shape": (2, 3, 2)}
        )
        archive.writestr("delta.npy", head.getvalue() + bytes(50 << 20))
    assert "not as long as its header says" in refused(tmp_path, made.getvalue(), name="t.npz").message


def test_a_table_lies_in_the_folder_of_its_design(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "out.csv").write_text(rows(SMALL))
    os.symlink(tmp_path / "out.csv", tmp_path / "in" / "link.csv")
    design = str(tmp_path / "in" / "d.toml")
    for name in ("../out.csv", str(tmp_path / "out.csv"), "link.csv", "none.csv", ".", "C:x.csv"):
        with pytest.raises(DesignError, match="CL124"):
            table_path(design, name)
    os.mkfifo(tmp_path / "in" / "pipe.csv")
    with pytest.raises(DesignError, match="it is a pipe"):
        table_path(design, "pipe.csv")


def test_a_table_that_has_changed_is_refused(tmp_path):
    with pytest.raises(DesignError, match="is not the table whose sha256"):
        read(tmp_path, rows(SMALL), stated="0" * 64)


def test_too_many_cells_rows_or_bytes_are_refused_by_the_limit(tmp_path, monkeypatch):
    with pytest.raises(DesignTooLarge, match="10,000,000"):
        read(tmp_path, rows(SMALL), Lattice("square", (1.0, 1.0), (3163, 3163)))
    path = tmp_path / "large.csv"
    with path.open("wb") as stream:
        stream.truncate(1_000_000_001)
    with pytest.raises(DesignTooLarge, match="1,000,000,001 bytes"):
        digest(str(path))
    few = cell_table_rows.BUDGETS["cell-table"].__class__("", 10**9, 5, "cells", None)
    monkeypatch.setattr(cell_table_rows, "BUDGETS", {"cell-table": few})
    with pytest.raises(DesignTooLarge, match="more than 5 rows"):
        read(tmp_path, rows(SMALL))


def with_etas(eta=lambda i, j: -1.0 - 0.1 * i - 0.01 * j):
    head, *body = rows(SMALL).splitlines()
    lines = [f"{line},{eta(*map(int, line.split(',')[:2]))!r}" for line in body]
    return "\n".join([head + ",eta", *lines]) + "\n"


def test_a_column_or_an_array_of_eta_is_taken_beside_delta(tmp_path):
    etas = np.array([[-1.0 - 0.1 * i - 0.01 * j for j in range(3)] for i in range(2)])
    for change in (str, lambda t: t.replace("\n", "\r\n"), lambda t: "\ufeff" + t):
        made = table_of(tmp_path, change(with_etas()))
        assert np.array_equal(made.etas, etas)
        assert np.array_equal(made.deltas, read(tmp_path, rows(SMALL)))
    made = table_of(tmp_path, npz(delta=np.zeros((2, 3, 2)), eta=etas), name="t.npz")
    assert np.array_equal(made.etas, etas)


@pytest.mark.parametrize("kind", ["csv", "npz"])
@pytest.mark.parametrize("names", [("eta_x",), ("eta_y",), ("eta_x", "eta_y")])
def test_a_column_or_an_array_for_each_axis_is_taken_and_the_other_has_that_of_the_law(tmp_path, kind, names):
    own = {"eta_x": lambda i, j: -1.0 - 0.1 * i, "eta_y": lambda i, j: 0.3 + 0.01 * j}
    cells = SMALL.cells().tolist()
    if kind == "csv":
        lines = [",".join(map(repr, [i, j, 0, 0, *(own[name](i, j) for name in names)])) for i, j in cells]
        made = table_of(
            tmp_path, "\n".join([f"i,j,delta_x,delta_y,{','.join(names)}", *lines]), eta=(-2.0, 0.5)
        )
    else:
        arrays = {name: np.array([[own[name](i, j) for j in range(3)] for i in range(2)]) for name in names}
        made = table_of(tmp_path, npz(delta=np.zeros((2, 3, 2)), **arrays), name="t.npz", eta=(-2.0, 0.5))
    assert made.etas.shape == (2, 3, 2)
    for i, j in cells:
        told = (
            own["eta_x"](i, j) if "eta_x" in names else -2.0,
            own["eta_y"](i, j) if "eta_y" in names else 0.5,
        )
        assert tuple(made.etas[i, j]) == told


def test_one_eta_of_both_axes_lies_where_both_lenses_keep_their_signs(tmp_path):
    mistake = refused(tmp_path, with_etas(lambda i, j: -1.0), eta=(-1.0, 0.5))
    assert mistake.message == "eta is out of range"
    assert mistake.allowed.startswith("eta_x and eta_y")
    assert (
        table_of(tmp_path, with_etas(lambda i, j: -2.0), eta=(-1.0, -0.5)).etas.tolist() == [[-2.0] * 3] * 2
    )


def test_cells_that_an_outline_leaves_out_have_the_eta_of_the_law(tmp_path):
    round_one = Lattice("square", (1.0, 1.0), (6, 6), Circle(6.0))
    text = HEADER.replace("\n", ",eta\n") + "".join(
        f"{i},{j},0,0,-2\n" for i, j in round_one.cells().tolist()
    )
    etas = table_of(tmp_path, text, round_one, eta=-0.5).etas
    assert (etas == -2.0).sum() == round_one.cell_count
    assert (etas == -0.5).sum() == 36 - round_one.cell_count
    array = npz(delta=np.zeros((6, 6, 2)), eta=np.where(etas == -2.0, -2.0, np.nan))
    assert np.array_equal(table_of(tmp_path, array, round_one, "t.npz", eta=-0.5).etas, etas)


@pytest.mark.parametrize(
    ("eta", "law", "allowed"),
    [
        ("nan", -1.0, "between -1e+06 and 0"), ("0", -1.0, "between -1e+06 and 0"), ("0.5", -1.0, "between -1e+06 and 0"),
        ("-1e-7", -1.0, "|eta| >= 1e-06"), ("-inf", -1.0, "-1e+06"), ("1", 0.5, "between 0 and 1"), ("-0.5", 0.5, "between 0 and 1"),
        ("2", 0.5, "between 0 and 1"), ("1", 2.0, "between 1 and 1e+06"), ("0.5", 2.0, "between 1 and 1e+06"),
    ],
)  # fmt: skip
def test_an_eta_of_no_lens_or_of_lenses_bent_the_other_way_is_refused_at_its_place(
    tmp_path, eta, law, allowed
):
    good = with_etas(lambda i, j: law)
    text = good.replace(f"1,2,0.01,-0.04,{law!r}", f"1,2,0.01,-0.04,{eta}")
    mistake = refused(tmp_path, text, eta=law)
    assert (mistake.line, mistake.column) == (7, 16)
    assert mistake.message == "eta is out of range"
    assert allowed in mistake.allowed
    assert f"law.eta = {law:g}" in mistake.allowed
    etas = np.full((2, 3), law)
    etas[1, 2] = float(eta)
    array = refused(tmp_path, npz(delta=np.zeros((2, 3, 2)), eta=etas), name="t.npz", eta=law)
    assert "eta[1, 2]" in array.message


def test_a_table_with_another_kind_of_eta_is_refused_saying_what_is_taken(tmp_path):
    mistake = refused(tmp_path, "i,j,delta_x,delta_y,theta\n0,0,0,0,-90\n")
    assert "from -89.999 to 89.999" in mistake.allowed
    assert mistake.column == 9
    assert refused(tmp_path, "i,j,delta_x,delta_y,tilt\n0,0,0,0,-1\n").column == 21
    assert refused(tmp_path, "i,j,delta_x,delta_y,psi,phi\n0,0,0,0,-1,2\n").column == 21
    assert refused(tmp_path, "i,j,delta_x,delta_y,eta,eta_x\n0,0,0,0,-1,-1\n").column == 25
    assert refused(tmp_path, "i,j,delta_x,delta_y,eta_y,eta_x\n0,0,0,0,-1,-1\n").column == 21
    assert refused(tmp_path, "i,j,delta_x,eta,delta_y\n0,0,0,-1,0\n").column == 13
    delta = np.zeros((2, 3, 2))
    for wrong in (np.full((2, 3, 2), -1.0), np.full((2, 2), -1.0), np.full((2, 3), "x")):
        assert "array 'eta' is" in refused(tmp_path, npz(delta=delta, eta=wrong), name="t.npz").message
