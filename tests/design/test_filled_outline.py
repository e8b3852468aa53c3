"""A count of cells that is left to the outline fills it, and is nothing but the count that could have been written."""

from __future__ import annotations

import numpy as np
import pytest

from clacad.design import Design, DesignError
from clacad.design.body import filling_count
from clacad.sheet.lattice import Circle, Lattice, Rectangle


def keys(**lattice: object) -> dict[str, object]:
    return {
        "format": 1, "name": "x", "unit": "mm", "law": {"eta": [-1, -1]},
        "pair": {"form": "slab", "separation": 10, "material": "PMMA"}, "lattice": {"pitch": 0.5, **lattice},
    }  # fmt: skip


@pytest.mark.parametrize("kind", ["square", "rectangular", "hexagonal"])
def test_no_more_columns_or_rows_of_the_same_lattice_would_hold_another_cell(kind):
    chance = np.random.default_rng(7)
    for _ in range(60):
        pitch = (
            tuple(chance.uniform(0.3, 1.0, 2)) if kind == "rectangular" else (chance.uniform(0.3, 1.0),) * 2
        )
        width, height = chance.uniform(2.0, 12.0, 2)
        outline = Circle(width) if chance.random() < 0.5 else Rectangle(width, height)
        size = (width, width) if isinstance(outline, Circle) else (width, height)
        n1, n2 = filling_count(kind, pitch, size)
        full = Lattice(kind, pitch, (n1, n2), outline).cell_count
        for more in ((n1 + 2, n2), (n1, n2 + 2)):  # two: the same rows and columns stay where they are
            if kind == "hexagonal" and more[1] != n2 and n2 % 2:
                continue  # an odd number of rows moves all by a part of the pitch
            assert Lattice(kind, pitch, more, outline).cell_count == full


def test_a_size_of_whole_cells_holds_that_many_whatever_rounding_does():
    assert filling_count("square", (0.1, 0.1), (0.3, 0.7)) == (3, 7)


def test_the_design_is_the_one_whose_count_is_written_and_its_text_says_the_count():
    left = Design.from_dict(keys(outline={"circle": 9}))
    written = Design.from_dict(keys(outline={"circle": 9}, count=[18, 18]))
    assert left == written
    assert left.sha256 == written.sha256
    assert "count = [18, 18]" in left.canonical_toml()
    assert left.replace({"lattice.pitch": 1.0}).lattice.count == (9, 9)


def test_without_an_outline_the_count_is_missing_and_both_ways_out_are_named():
    with pytest.raises(DesignError, match=r"CL103: missing key lattice.count\n.*leave it to lattice.outline"):
        Design.from_dict(keys())


def test_an_outline_of_more_cells_than_can_be_counted_is_refused():
    with pytest.raises(DesignError, match=r"CL117: .*cells wide"):
        Design.from_dict(
            keys(outline={"circle": 1e9})
            | {"unit": "1e6 m", "lattice": {"pitch": 1e-12, "outline": {"circle": 1e9}}}
        )
