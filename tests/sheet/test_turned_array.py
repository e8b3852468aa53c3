"""A second array turned against the first: positions of its cells, its law, the reach of its fields, its files."""

import cmath
from dataclasses import replace

import numpy as np
import pytest
from mpmath import mp, mpf

import clacad
from clacad.optics.law.focusing import Superlens
from clacad.optics.rays import Fate
from clacad.sheet.cell_places import CellPlacement, centre_pairs
from clacad.sheet.feasibility.as_rows import zone_of
from clacad.sheet.lattice import Lattice
from clacad.sheet.pattern import MOST_TURN, cosine_and_sine, held_when_turned
from clacad.sheet.vignetting import partner_share

BASE = {
    "format": 1, "name": "turned", "unit": "mm", "law": {"eta": [-1.0, -0.5], "delta": [0.01, -0.02], "euler": [20, 0, 0]},
    "pair": {"form": "slab", "separation": 10, "index": 1.5, "offset": "paraxial"},
    "lattice": {"pitch": 0.5, "pitch_2": 0.4975, "count": [31, 30], "rotation_2": "3 deg"}, "check": {"process": "none"},
}  # fmt: skip


def design(**changes):
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    return clacad.Design.from_dict(BASE).replace(keys)


@pytest.mark.parametrize("angle", [1e-12, 0.3, -0.7853981633974483])
def test_cosine_and_sine_in_pairs_are_those_of_forty_digits(angle):
    with mp.workdps(50):
        for (high, low), exact in zip(cosine_and_sine(angle), (mp.cos(mpf(angle)), mp.sin(mpf(angle)))):
            assert abs(mpf(high) + mpf(low) - exact) < mpf(2) ** -104


@pytest.mark.parametrize("kind", ["square", "rectangular", "hexagonal"])
def test_a_cell_ten_thousand_pitches_out_is_found_to_the_last_bits_of_a_cell(kind):
    lattice = CellPlacement(pitch=(0.3, 0.4), turn=0.3).lattice(Lattice(kind, (0.29, 0.39), (20_001, 20_001)))
    rng = np.random.default_rng(1)
    cells = rng.integers(0, 10_000, (200, 2))
    (x, x_low), (y, y_low) = centre_pairs(lattice, cells)
    local = rng.uniform(-0.1, 0.1, (200, 2))
    with mp.workdps(50):
        c, s = mp.cos(mpf(0.3)), mp.sin(mpf(0.3))
        for k in range(0, 200, 40):
            u, v = (
                mpf(float(one[0][k])) + mpf(float(one[1][k])) for one in centre_pairs(lattice.straight, cells)
            )
            assert abs(mpf(float(x[k])) + mpf(float(x_low[k])) - (c * u - s * v)) < 1e-26
    index, at_x, at_y = lattice.locate(x, y, x_low + local[:, 0], y_low + local[:, 1])
    assert (index == cells).all()
    assert np.abs(np.column_stack([at_x, at_y]) - local).max() < 1e-16


def test_every_cell_obeys_the_law_of_where_its_partner_was_turned_to():
    """By complex numbers: d(C) = d + (g e^iα − 1) C, seen along the lens axes and over f1."""
    window = clacad.prescribe(design())
    f1 = np.array(window.thin.focal_length[0])
    cells = window.lattice.cells()
    centre = window.lattice.centres(cells) @ (1.0, 1j)
    aside = (0.4975 / 0.5 * cmath.exp(1j * np.radians(3.0)) - 1.0) * centre
    along = aside * cmath.exp(-1j * np.radians(20.0))
    expected = np.array([0.01, -0.02]) + np.column_stack([along.real, along.imag]) / f1
    laws = [window.law_at(cell) for cell in cells]
    assert np.abs([[law.delta_x, law.delta_y] for law in laws] - expected).max() < 1e-15
    start = np.column_stack([window.lattice.centres(cells) + [0.02, -0.01], np.full(len(cells), -1.0)])
    seen = clacad.trace(window, clacad.Rays(start, (0.0, 0.0, 1.0)), rung="thin")
    for row in np.flatnonzero(seen.fate == Fate.ALIVE):
        assert np.abs(seen.direction[row] - window.law_at(seen.cell[row]).refract([0, 0, 1.0])).max() < 1e-14
    assert (seen.fate == Fate.ALIVE).sum() > 200


def test_the_share_that_meets_the_partner_is_that_of_rays_over_the_cell():
    window = clacad.prescribe(design(law__euler=[0, 0, 0], law__delta=[0, 0], lattice__rotation_2="2 deg"))
    rng = np.random.default_rng(5)
    for cell in ((15, 15), (19, 11), (22, 18)):
        index = np.array(cell)
        at = window.centres(0, index) + rng.uniform(-0.25, 0.25, (40_000, 2))
        start = np.column_stack([at, np.full(len(at), -1.0)])
        seen = clacad.trace(window, clacad.Rays(start, (0.0, 0.0, 1.0)), rung="thin")
        alive = (seen.fate == Fate.ALIVE).mean()
        assert partner_share(window, index[None], [[0.0, 0.0, 1.0]])[0] == pytest.approx(alive, abs=0.012)


@pytest.mark.parametrize("angle", [0.5, 4.0])
def test_light_along_the_normal_stays_with_its_partner_over_the_zone_that_is_told(angle):
    made = design(law__eta=[-1.0, -1.0], law__delta=[0, 0], law__euler=[0, 0, 0], lattice__rotation_2=f"{angle} deg",
                  lattice__count=[401, 1])  # fmt: skip
    window = clacad.prescribe(made)
    x = np.linspace(-99.0, 99.0, 40_001)
    start = np.column_stack([x, np.zeros_like(x), np.full_like(x, -1.0)])
    middle = np.abs(x - 0.5 * np.rint(x / 0.5)) < 0.005  # rays through the middle of a lens alone
    seen = clacad.trace(window, clacad.Rays(start[middle], (0.0, 0.0, 1.0)), rung="thin")
    alive = np.abs(x[middle][seen.fate == Fate.ALIVE]).max()
    g = 0.995 * cmath.exp(1j * np.radians(angle))
    off = (g - 1.0) / g  # along the axes of the turned cells, in pitches of array 2
    assert alive == pytest.approx(0.25 / max(abs(off.real), abs(off.imag)), abs=0.5)
    zone = zone_of(window)
    assert zone.width[0] == pytest.approx(0.5 / abs(g - 1.0), rel=1e-12)
    assert zone.moire[0] == pytest.approx(
        1.0 / abs(1 / 0.5 - 1 / (0.4975 * cmath.exp(1j * np.radians(angle)))), rel=1e-12
    )
    assert Superlens((0.5, 0.5), (5.0, 5.0), 0.0).moire_period == np.inf


def test_a_turn_by_nothing_is_the_sheet_there_was():
    plain = clacad.Design.from_dict({**BASE, "lattice": {"pitch": 0.5, "count": [3, 3]}})
    none = plain.replace({"lattice.rotation_2": "0 deg"})
    assert none.sha256 == plain.sha256
    assert "rotation_2" not in plain.canonical_toml()
    assert clacad.prescribe(none).uniform
    again = clacad.Design.from_dict(design().to_dict())
    assert again.lattice.rotation_2 == design().lattice.rotation_2 == np.radians(3.0)
    assert again.sha256 == design().sha256


@pytest.mark.parametrize(("value", "code"), [("46 deg", "CL106"), (3, "CL10"), ("-1 rad", "CL106")])
def test_a_turn_that_is_none_is_refused(value, code):
    with pytest.raises(clacad.DesignError, match=code):
        design(lattice__rotation_2=value)


def test_a_lens_without_power_has_nothing_to_stand_aside_of():
    plain = {
        **BASE,
        "law": {"eta": [1.0, -1.0]},
        "lattice": {"pitch": 0.5, "count": [3, 3], "rotation_2": "3 deg"},
    }
    with pytest.raises(clacad.DesignError, match="CL111.*rotation_2"):
        clacad.prescribe(clacad.Design.from_dict(plain))


def test_cells_in_a_rectangle_lie_in_it_when_they_are_turned():
    window = clacad.prescribe(
        design(lattice__outline={"rectangle": [9, 5]}, law__euler=[0, 0, 0], lattice__rotation_2="25 deg")
    )
    for array in (0, 1):
        corners = window.centres(array, window.lattice.cells())[:, None] + window.lattice_of(array).tile()
        assert (np.abs(corners).max(axis=(0, 1)) <= [4.5, 2.5]).all()
    share = held_when_turned((9.0, 5.0), 0.4)
    box = np.array([[4.5, 2.5], [4.5, -2.5]]) * share
    turned = box @ np.array([[np.cos(0.4), np.sin(0.4)], [-np.sin(0.4), np.cos(0.4)]])
    assert np.max(np.abs(turned) / [4.5, 2.5]) == pytest.approx(1.0, rel=1e-12)
    assert MOST_TURN == np.pi / 4


def straightened(window):
    """Array 2 was not turned in the workshop."""
    first, second = window.placements
    return replace(window, placements=(first, replace(second, turn=0.0)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_the_files_of_a_turned_array_pass_and_one_that_was_not_turned_is_found_out(kind, tmp_path):
    from clacad.formats.step.step_files import write_step

    made = design(law__eta=[-1, -1], law__delta=[0, 0], law__euler=[0, 0, 0], lattice__kind=kind, lattice__count=[4, 3],
                  lattice__rotation_2="5 deg", pair__surface="biconic", check__field="0.3 deg")  # fmt: skip
    clacad.export(made, tmp_path / "out", formats=("step", "tiff", "xyz", "table", "mask"))
    report = clacad.verify(made, files=tmp_path / "out", rays=2048)
    assert report.word.startswith("passed"), [c.sentence for c in report.checks if c.state == "fail"]
    write_step(straightened(clacad.prescribe(made)), tmp_path / "straight.step")
    found = clacad.verify(made, files=tmp_path / "straight.step", rays=2048)
    assert any(check.state == "fail" and check.subject.endswith(".step") for check in found.checks)
