"""Measured maps of sheets whose lenslets are tilted, differ from cell to cell, or have faces between them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from measuring.made_parts import Made
from measuring.test_measure import mapped

from clacad.design import Design, load
from clacad.exporting.fixtures.engraving import engravings
from clacad.light.measure import measure as measure_light
from clacad.measuring.measure import Maps, fitted_sides, measure
from clacad.measuring.read_map import MeasuredMap
from clacad.prescription.prescribe import prescribe
from clacad.sheet.bundle import RequestedLaw, bundle
from clacad.sheet.like_cell import like_cell
from clacad.storage.errors import BadRequest, NotPossible
from clacad.tracing.trace import trace

SEEN = {"front": (1, -1), "back": (-1, -1)}
"""Signs of a map's x and y along the sheet's, as docs/how-to/measured.md states them."""


@dataclass
class Turned(Made):
    """A part of quadrics c x² + d y² + k z² = 2 z about axes that are turned, in the axes of the sheet."""

    curvature: tuple[float, float] = (0.4, 0.4)
    kappa: float = 0.4
    axes: np.ndarray = field(default_factory=lambda: np.eye(3))
    side: str = "front"
    columns: tuple[int, int] | None = None  # cells (i from, to) that have a lenslet; the others are flat

    def surface(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        _, seam = super().surface(x, y)
        steps = self.steps()
        who = np.rint(np.linalg.solve(steps, np.stack([x, y]).reshape(2, -1)))
        u, v = np.stack([x, y]).reshape(2, -1) - steps @ who
        u = u - np.array([self.cells.get((i, j), (0.0, 0.0, 0.0))[0] for i, j in who.T.astype(int)])
        v = v - np.array([self.cells.get((i, j), (0.0, 0.0, 0.0))[1] for i, j in who.T.astype(int)])
        sx, sy = SEEN[self.side]
        c, d = self.curvature
        z = np.zeros_like(u)
        for _ in range(30):  # Newton along the sheet's normal
            p = self.axes.T @ np.stack([sx * u, sy * v, z])
            off = c * p[0] ** 2 + d * p[1] ** 2 + self.kappa * p[2] ** 2 - 2.0 * p[2]
            slope = 2.0 * np.stack([c * p[0], d * p[1], self.kappa * p[2] - 1.0])
            z = z - off / np.einsum("ik,i->k", slope, self.axes[2])
        height = -z if self.side == "front" else z
        if self.columns is not None:
            height = np.where((who[0] < self.columns[0]) | (who[0] > self.columns[1]), -0.01, height)
        return height.reshape(x.shape), seam.reshape(x.shape)


def like(design: Design, side: str, first: tuple[int, int] = (0, 0), **other) -> Turned:
    """The part as designed, its cell `first` in the middle of the map."""
    window = prescribe(design)
    face = window.faces[0 if side == "front" else -1]
    surface, sign = face.surface, 1.0 if side == "front" else -1.0
    conic = getattr(surface, "conic_x", None)
    kappa = surface.kappa if conic is None else (1.0 + conic) * surface.curvature_x
    made = Turned(
        pitch=window.lattice_of(face.array).pitch, side=side, axes=np.asarray(face.rotation),
        curvature=(sign * surface.curvature_x, sign * surface.curvature_y), kappa=sign * kappa, **other,
    )  # fmt: skip
    (sx, sy), count = SEEN[side], window.lattice.count
    for i, j in made.cells:
        cell = np.clip([first[0] + sx * i, first[1] + sy * j], 0, np.array(count) - 1)
        x, y, _ = window.vertices(face, cell)
        made.cells[i, j] = (float(sx * x), float(sy * y), 1.0)
    return made


def exact(design: Design, cells) -> float:
    """Rms error of light through the exact surfaces of these cells."""
    window, squares = prescribe(design), []
    for cell in cells:
        one = like_cell(window, np.array(cell))
        lit = bundle(one, 1024, design.check.field, design.check.field_centre)
        send = lambda rays, sheet=one: trace(sheet, rays.rays, path="size")  # noqa: E731
        squares.append(measure_light(send, lit, RequestedLaw.of(one)).rms ** 2)
    return float(np.sqrt(np.mean(squares)))


AIMED = load("window-100mm", [
    "lattice.count=[21,21]", "lattice.aperture={point=[0,0,-400]}", 'pair.surface="biconic"',
    "pair.conic=[-0.7,-0.7]", 'pair.offset="traced"',
])  # fmt: skip
FIELD_LENS = load("plano", ["lattice.count=[5,5]", "pair.field_lens=true"])
OTHERS = {
    "tilted front": (load("tilted", ["lattice.count=[5,5]"]), "front", (2, 2)),
    "tilted back": (load("tilted", ["lattice.count=[5,5]"]), "back", (2, 2)),
    "four faces": (load("tilted-biconvex", ["lattice.count=[5,5]"]), "front", (2, 2)),
    "field lens": (FIELD_LENS, "back", (2, 2)),
    "aimed back": (AIMED, "back", (15, 12)),
}


@pytest.mark.ci_cases("tilted front", "four faces", "field lens")
@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [one if one == "aimed back" else pytest.param(one, marks=pytest.mark.slow) for one in OTHERS],
)
def test_light_through_a_perfect_part_is_that_through_the_exact_faces(name):
    design, side, cell = OTHERS[name]
    made = like(design, side, cell, noise=1e-6, spikes=0, dirt=0, lost=0.0, rim=0.0)
    found = measure(design, **{side: (mapped(made), cell)}, z_scale=1.0)
    true = exact(design, found.light.cells)
    assert found.light.rms == pytest.approx(true, rel=6e-3)
    assert found.radii()[side][0] == pytest.approx(found.sides[side].radius, rel=1e-4)
    assert np.abs(found.sides[side].deviation[np.isfinite(found.sides[side].deviation)]).max() < 30e-6
    assert len(found.sides[side].lenslets.index) >= 9


def stepped(made: Turned, columns: tuple[int, int]) -> Turned:
    """The part with lenslets in these columns alone; beyond them it is flat."""
    made.columns = columns
    return made


class Plate(Turned):
    """Cells of a plate with land around them, its sides, a hole in the land; and a damaged cell, as flat as land."""

    first, count, land, hole, damaged = (0, 0), (0, 0), 1.0, None, None

    def surface(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        z, seam = super().surface(x, y)
        signs = np.array(SEEN[self.side]).reshape(2, *[1] * x.ndim)
        cell = np.rint(np.stack([x / self.pitch[0], y / self.pitch[1]])) * signs
        first, count = (np.array(one).reshape(signs.shape) for one in (self.first, self.count))
        sheet = signs * np.stack([x, y]) + 0.5 * (first - 0.5 * (count - 1.0))
        flat = (np.abs(sheet) > 0.25 * count).any(axis=0)
        if self.damaged:
            flat |= (cell + first == np.array(self.damaged).reshape(signs.shape)).all(axis=0)
        gone = (np.abs(sheet) > 0.25 * count + self.land).any(axis=0)
        if self.hole:
            gone |= np.hypot(sheet[0] - self.hole[0], sheet[1] - self.hole[1]) < self.hole[2]
        return np.where(flat, -0.01, z), np.where(gone, -1.0, seam)


def shown(design: Design, side: str, first: tuple[int, int], size: int = 340, **what):
    """Cell at the middle of a map of a plate, and how it was known for i and for j."""
    made = like(design, side, first, size=size, pixel=0.008, noise=5e-6, spikes=0, dirt=0)
    made.__class__ = Plate
    vars(made).update(first=first, count=prescribe(design).lattice.count, **what)
    found, _, _ = fitted_sides(design, prescribe(design), Maps(**{side: mapped(made)}, z_scale=1.0))
    cells = found[side].lit.cells
    return cells.first, cells.known


HOLED = load("window-100mm", [
    "lattice.count=[15,9]", "body.border=1.0", "body.holes=[{diameter=0.8,at=[[4.3,1.0]]}]",
])  # fmt: skip
NARROW = load("window-100mm", ["lattice.count=[15,9]", "body.border=0.2"])


ON_PLATES = {
    "hole in the land": (HOLED, (13, 2), {"hole": (4.3, 1.0, 0.4)}, ((13, 2), ("edge", "mark"))),
    "corner, and a damaged cell": (HOLED, (13, 7), {"damaged": (12, 6)}, ((13, 7), ("edge", "edge"))),
    "side of the plate": (NARROW, (13, 2), {"land": 0.2, "size": 300}, ((13, 4), ("mark", "assumed"))),
    "a damaged cell alone": (HOLED, (8, 5), {"damaged": (9, 4)}, ((7, 4), ("assumed", "assumed"))),
}


@pytest.mark.ci_cases("front-corner, and a damaged cell", "front-side of the plate", "back-hole in the land")
@pytest.mark.daily_cases("front-hole in the land")
@pytest.mark.parametrize("name", ON_PLATES)
@pytest.mark.parametrize("side", ["front", "back"])
def test_corners_holes_and_sides_of_the_plate_tell_the_cells(side, name):
    design, first, what, expected = ON_PLATES[name]
    assert shown(design, side, first, **what) == expected


def engraved(points: np.ndarray, loops) -> np.ndarray:
    """Which points (n, 2) lie in letters, by the parity of borders to their right."""
    inside = np.zeros(len(points), dtype=bool)
    for loop in loops:
        for (ax, ay), (bx, by) in zip(loop, np.roll(loop, -1, axis=0), strict=True):
            if ay != by:
                level = (points[:, 1] >= min(ay, by)) & (points[:, 1] < max(ay, by))
                inside ^= level & (points[:, 0] < ax + (points[:, 1] - ay) * (bx - ax) / (by - ay))
    return inside


@pytest.mark.slow
@pytest.mark.parametrize("first", [(13, 1), (22, 1)])
def test_engraved_letters_tell_the_cells(first):
    """A map over the lower border: its row is known by the edge, its column by the letters alone."""
    design = load("window-100mm", ["lattice.count=[41,9]", "body.border=1.2"])
    window = prescribe(design)
    [marks] = engravings(window, window.name).values()
    made = like(design, "front", first, size=460, pixel=0.008, noise=5e-6, spikes=0, dirt=2)
    made.__class__ = Plate
    vars(made).update(first=first, count=window.lattice.count, land=1.2)
    z = made.heights()
    at = (np.arange(made.size) - made.size / 2.0) * made.pixel
    x, y = np.meshgrid(at, -at)
    sheet = np.stack([x.ravel(), y.ravel()], axis=1) + 0.5 * (np.array(first) - [20.0, 4.0])
    top = window.faces[0].vertex[2] - window.bodies[0].front.land
    flat = (np.abs(sheet) > [10.25, 2.25]).any(axis=1).reshape(z.shape) & np.isfinite(z)
    z[flat] += 0.01 + top
    plain = z.copy()
    line = np.concatenate(marks.loops)
    near = flat & ((sheet >= line.min(axis=0)) & (sheet <= line.max(axis=0))).all(axis=1).reshape(z.shape)
    z[near] -= marks.depth * engraved(sheet[near.ravel()], marks.loops)
    for heights, known in ((z, ("mark", "edge")), (plain, ("assumed", "edge"))):
        row, column = np.nonzero(np.isfinite(heights))
        places = np.stack([column, row]) - made.size / 2.0
        points = np.vstack([1e-3 * made.pixel * places, 1e-3 * heights[row, column]])
        map_ = MeasuredMap("map", points, (8e-6, 8e-6), heights.shape)
        found, _, _ = fitted_sides(design, window, Maps(front=map_, z_scale=1.0))
        assert found["front"].lit.cells.known == known
        if known[0] == "mark":
            assert found["front"].lit.cells.first == first


EDGES = load("window-100mm", ["lattice.count=[7,7]"])


@pytest.mark.slow
@pytest.mark.parametrize(("side", "first"), [("front", 5), ("back", 1)])
def test_an_edge_of_the_array_in_the_map_tells_its_cells(side, first):
    made = stepped(like(EDGES, side, size=340, pixel=0.008, noise=5e-6, spikes=0, dirt=0), (-9, 1))
    found = measure(EDGES, **{side: mapped(made)}, z_scale=(1.0, 1e-4))
    cells = found.sides[side].lit.cells
    assert (cells.first[0], cells.known) == (first, ("edge", "assumed"))
    rows = found.to_dict()["lenslets"]
    assert len(rows) == 20
    assert max(row["cell"][0] for row in rows) == (6 if side == "front" else 3)
    assert min(row["cell"][0] for row in rows) == (3 if side == "front" else 0)
    assert found.verdict == "pass"


@pytest.mark.slow
def test_of_a_sheet_whose_cells_differ_an_edge_or_the_stated_cell_decides():
    made = like(AIMED, "back", (15, 12), noise=5e-6)
    open_ = measure(AIMED, back=mapped(made), z_scale=(1.0, 1e-4))
    assert open_.verdict == "cannot say"
    assert "--cell" in open_.summary
    assert measure(AIMED, back=(mapped(made), (15, 12)), z_scale=(1.0, 1e-4)).verdict == "pass"
    rim = stepped(like(AIMED, "back", (19, 10), noise=5e-6, size=340, spikes=0, dirt=0), (-1, 9))
    found = measure(AIMED, back=mapped(rim), z_scale=(1.0, 1e-4))
    assert found.sides["back"].lit.cells.first == (19, 10)
    assert found.verdict == "pass"
    with pytest.raises(BadRequest, match="no such cell"):
        measure(AIMED, back=(mapped(made), (40, 0)))


@pytest.mark.slow
@pytest.mark.parametrize("step", [(0.003, -0.001), pytest.param((0.02, -0.01), marks=pytest.mark.slow)])
def test_pieces_bonded_with_a_displacement_are_named(step):
    made = Made(size=250, spread_middle=1e-4)
    for (i, j), (x, y, radius) in made.cells.items():
        made.cells[i, j] = (x + step[0] * (i >= 1), y + step[1] * (i >= 1), radius)
    found = measure(load("window-100mm"), mapped(made), z_scale=(1.0, 1e-4))
    [pitch] = [check for check in found.checks if check.id == "scan_pitch"]
    assert "two pieces are bonded: from i = 1 on" in pitch.sentence
    shown = pitch.sentence.split("displaced by ")[1].replace("µm", "").split(",")
    assert [float(one) for one in shown] == pytest.approx([1e3 * one for one in step], abs=0.3)
    assert pitch.state == ("fail" if step[0] > 0.0025 else "pass")


@pytest.mark.slow
def test_a_good_array_is_not_called_bonded():
    for seed in range(3):
        made = Made(size=250, spread_middle=2e-4, seed=seed)
        found = measure(load("window-100mm"), mapped(made), z_scale=(1.0, 1e-4))
        assert "bonded" not in " ".join(check.sentence for check in found.checks)


@pytest.mark.slow
def test_a_wrong_insert_swapped_sides_and_a_rotated_array_are_named():
    sheet = load("hexagonal", ["lattice.count=[9,9]"])
    front, back = (1.0 / prescribe(sheet).faces[k].surface.curvature_x for k in (0, 1))
    part = dict(pitch=(0.5, 0.5), hexagonal=True, noise=5e-6, conic=0.0)
    told = lambda radius, turn=0.0: " ".join(  # noqa: E731
        check.sentence
        for check in measure(
            sheet, mapped(Made(radius=radius, turn=turn, **part)), z_scale=(1.0, 1e-4)
        ).checks
    )
    assert "radius of the back" in told(back * 1.001)
    assert "another insert" in told(0.96 * front)
    assert "rotated by 8.59 deg" in told(front, 0.15)
    good = told(front)
    assert "insert" not in good
    assert "exchanged" not in good
    assert "rotated" not in good


def test_lenslets_with_power_along_one_axis_are_refused():
    with pytest.raises(NotPossible, match="cylinders|no two arrays"):
        measure(load("window-100mm", ["law.eta=[-1,1]", "lattice.count=[5,5]"]), mapped(Made()))
