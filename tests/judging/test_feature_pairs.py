"""Every combination of a non-uniform sheet with a feature, as a file: a master that passes, a spoilt cell that does not.

The features and sheets are those of `clacad explain combinations`. One combination in six is also traced, ray by ray,
through the faces of single cells by the textbook tracer in 60 digits.
"""

from dataclasses import replace

import numpy as np
import pytest
from oracle import trace as oracle
from sheet.test_cells_of_own_eta import FORMS, GIVEN_EVEN, across, leaning, slightly, spread, turned
from sheet.test_cells_of_own_eta import PRESENT as PRESENT_WITH_ETA
from sheet.test_cells_of_own_eta import design as tabled
from sheet.test_varying_sheets import ITS_OWN, PRESENT, SHEET, design

import clacad
from clacad.design.combinations import FEATURES, REASONS, SHEETS
from clacad.formats.step.step_files import write_step
from clacad.optics.rays import Fate
from clacad.optics.surface import Biconic, Quadric
from clacad.sheet.cell_places import VertexChange
from clacad.sheet.face_order import refractions
from clacad.sheet.vignetting import aperture_slopes

ETAS = "eta in law.varying.table"
"""A sheet of `law.varying` whose table has η."""
OF_A_TABLE = (*ITS_OWN["law.varying"], "offset")
"""Features that a table of cells states itself."""
PAIRS = [
    (sheet, feature.name)
    for sheet in (*SHEETS, ETAS)
    for feature in FEATURES
    if (sheet if sheet in SHEETS else "law.varying", feature.name) not in REASONS
    and feature.name not in ITS_OWN.get(sheet, OF_A_TABLE)
]
FILES = [
    pytest.param(*pair, marks=pytest.mark.long if k % 32 else pytest.mark.slow)
    for k, pair in enumerate(PAIRS)
]
SMALL = {"lattice__count": [4, 3], "check__field": "0.1 deg", "check__process": "none"}
SPOILT = 0.02
"""Displacement of one lens, as part of the pitch."""


def made(sheet, feature, folder):
    """The design of a combination; a table of cells lies in the folder."""
    if sheet == ETAS:
        return tabled(folder, spread(-0.95, -1.1), **{**SMALL, **{**PRESENT, **PRESENT_WITH_ETA}[feature]})
    return design(**{**SMALL, **SHEET[sheet], **PRESENT[feature]})


def failing(report):
    """Identities of the checks of written files that fail."""
    return {check.id for check in report.checks if check.state == "fail" and check.subject.endswith(".step")}


AXES = across(spread(-0.95, -1.1), spread(-1.15, -1.0))
"""η along both axes of a cell."""
UNLIKE = across(spread(-0.75, -0.85), spread(-1.35, -1.25))
"""As `AXES`, of cells that are turned."""
OF_TWO_AXES = {
    "slab": {}, "ellipsoids": {"pair__surface": None}, "biconvex": FORMS["biconvex"],
    "plano, hexagonal": {**FORMS["plano"], "lattice__kind": "hexagonal"}, "tilt": {"law__euler": [20, 3, 0]},
    "aimed": {"lattice__aperture": {"point": [3, 2, -300]}}, "seam": {"lattice__seam": 0.05}, "law of two": {"law__eta": [-1.0, -1.1]},
    "even terms": GIVEN_EVEN,
    "field lens": {"pair__field_lens": True, "pair__surface": None, "lattice__count": [2, 2]},
    "field lens, plano": {"pair__field_lens": True, "pair__surface": None, **FORMS["plano"], "lattice__count": [2, 2]},
    "field lens, biconvex": {"pair__field_lens": True, **FORMS["biconvex"], "lattice__count": [2, 2]},
    "field lens, turned": {"pair__field_lens": True, "pair__surface": None, "turn": slightly, "lattice__count": [2, 2]},
    "turned": {"turn": turned, "lattice__count": [3, 2]},
    "turned plano": {**FORMS["plano"], "pair__surface": None, "turn": turned, "lattice__count": [3, 2]},
    "turned biconvex": {**FORMS["biconvex"], "turn": slightly, "lattice__count": [3, 2]},
    "turned ellipsoids": {"turn": turned, "pair__surface": None, "lattice__kind": "hexagonal", "lattice__count": [2, 2]},
    "leaning": {"turn": leaning, "lattice__count": [2, 2]},
    "leaning biconvex": {**FORMS["biconvex"], "turn": leaning, "lattice__count": [2, 2]},
    "leaning behind planes": {**FORMS["plano"], "pair__surface": None, "turn": leaning, "lattice__count": [2, 2]},
    "field lens, leaning": {"pair__field_lens": True, "pair__field": {"gap": 0.8}, "pair__surface": None, "turn": leaning, "lattice__count": [2, 2]},
    "field lens, tilted biconvex": {"pair__field_lens": True, **FORMS["biconvex"], "law__euler": [20, 3, 10], "law__eta": [-1.0, -1.1], "lattice__count": [2, 2]},
}  # fmt: skip


def of_two_axes(form, folder):
    """The design of a form with an η along each lens axis of a cell."""
    eta = UNLIKE if "turn" in OF_TWO_AXES[form] and "leaning" not in form else AXES
    return tabled(folder, eta, **{**SMALL, **OF_TWO_AXES[form]})


def one_lens_turned(window, array):
    """The lens of an array in one cell is turned by a fiftieth of a radian more about z."""
    cell = window.lattice.cells()[-1]
    c, s = np.cos(SPOILT), np.sin(SPOILT)

    def turned_more(face):
        if face.array != array or face.change.rotation is None:
            return face
        own = face.change.rotation.copy()
        row = cell[0] + cell[1] // 2 if window.lattice.hexagonal else cell[0]
        own[row, cell[1]] = [[c, -s, 0], [s, c, 0], [0, 0, 1]] @ own[row, cell[1]]
        return replace(face, change=replace(face.change, rotation=own))

    return replace(
        window,
        bodies=tuple(replace(b, front=turned_more(b.front), back=turned_more(b.back)) for b in window.bodies),
    )


def one_lens_bent(window, array):
    """The lens of an array in one cell is curved by a fiftieth more along y."""
    cell = window.lattice.cells()[-1]

    def bent(face):
        if face.array != array:
            return face
        aspect = face.change.aspect.copy()
        aspect[cell[0] + cell[1] // 2 if window.lattice.hexagonal else cell[0], cell[1]] *= 1.0 + SPOILT
        return replace(face, change=replace(face.change, aspect=aspect))

    return replace(
        window, bodies=tuple(replace(b, front=bent(b.front), back=bent(b.back)) for b in window.bodies)
    )


@pytest.mark.parametrize(
    "form",
    [
        pytest.param(
            form, marks=pytest.mark.slow if form in ("ellipsoids", "turned ellipsoids") else pytest.mark.long
        )
        for form in OF_TWO_AXES
    ],
)
def test_the_file_of_cells_of_two_eta_is_a_master_and_one_lens_bent_along_one_axis_is_found(form, tmp_path):
    wanted = of_two_axes(form, tmp_path)
    manifest = clacad.export(wanted, tmp_path / "right", formats=("step",))
    (entry,) = [one for one in manifest.files if one["format"] == "step"]
    assert entry["role"] == "optical-master"
    assert not failing(clacad.verify(wanted, files=tmp_path / "right", rays=2048))
    window = clacad.prescribe(wanted)
    for array in (2,) if window.field_array else (0, 1):
        for spoilt in (one_lens_bent, one_lens_moved, one_lens_turned)[: 2 + ("turn" in OF_TWO_AXES[form])]:
            write_step(spoilt(window, array), tmp_path / "spoilt.step")
            assert failing(clacad.verify(wanted, files=tmp_path / "spoilt.step", rays=2048))


@pytest.mark.parametrize("form", OF_TWO_AXES)
def test_rays_of_cells_of_two_eta_are_those_of_the_textbook_through_the_faces_of_their_cells(form, tmp_path):
    as_of_the_textbook(clacad.prescribe(of_two_axes(form, tmp_path)))


def one_lens_moved(window, array):
    """The lens of an array lies a fiftieth of the pitch from its place in one cell."""
    cell = window.lattice.cells()[-1]

    def moved(face):
        if face.array != array:
            return face
        change = face.change or VertexChange()
        table = np.zeros((*window.lattice.count, 2)) if change.table is None else change.table.copy()
        row = cell[0] + cell[1] // 2 if window.lattice.hexagonal else cell[0]
        table[row, cell[1]] += (SPOILT * min(window.lattice.pitch), 0.0)
        return replace(face, change=replace(change, table=table))

    return replace(
        window, bodies=tuple(replace(b, front=moved(b.front), back=moved(b.back)) for b in window.bodies)
    )


@pytest.mark.ci_cases(
    "lattice.aperture-hexagonal cells",
    "pair.focus-biconvex",
    "eta in law.varying.table-plate with an outline of its own",
)
@pytest.mark.parametrize(("sheet", "feature"), FILES)
def test_the_file_of_a_combination_is_a_master_and_one_lens_out_of_place_is_found(sheet, feature, tmp_path):
    wanted = made(sheet, feature, tmp_path)
    manifest = clacad.export(wanted, tmp_path / "right", formats=("step",))
    (entry,) = [one for one in manifest.files if one["format"] == "step"]
    assert entry["role"] == "optical-master"
    right = failing(clacad.verify(wanted, files=tmp_path / "right", rays=2048))
    assert not right
    window = clacad.prescribe(wanted)
    for array in range(1, len(window.placements)):
        write_step(one_lens_moved(window, array), tmp_path / "spoilt.step")
        assert failing(clacad.verify(wanted, files=tmp_path / "spoilt.step", rays=2048))


def oracle_faces(window, cell):
    """Faces of one telescopelet for the textbook tracer, in the order of the light, sheet frame."""
    found = []
    for _, face, before, after in refractions(window.bodies):
        own = window.in_cell(face, cell)
        centre = np.zeros(2) if face.array is None else window.centres(face.array, cell)
        s = own.surface
        place = {
            "vertex": (own.vertex[0] + centre[0], own.vertex[1] + centre[1], own.vertex[2]),
            "before": before, "after": after,
        }  # fmt: skip
        if not own.untilted:
            place["rotation"] = own.rotation
        if isinstance(s, Quadric):
            found.append(oracle.quadric(s.curvature_x, s.curvature_y, s.kappa, s.side, **place))
        else:
            numbers = (s.curvature_x, s.curvature_y, s.conic_x, s.conic_y)
            if isinstance(s, Biconic):
                found.append(oracle.biconic(*numbers, s.side, **place))
            else:
                found.append(oracle.polynomial(*numbers, s.a4, s.a6, s.a8, s.side, **place))
    return found


FIELD_SHEETS = {
    "aimed": SHEET["lattice.aperture"], "another pitch": SHEET["lattice.pitch_2"], "turned": SHEET["lattice.rotation_2"],
    "sharp": SHEET["pair.focus"],
    "aimed from the side": {"law__varying": None, "lattice__aperture": {"point": [12, 4, -300]}, "law__delta": [0.01, 0.0]},
    "two pitches, turned": {**SHEET["lattice.rotation_2"], "lattice__kind": "rectangular", "lattice__pitch": [0.5, 0.5], "lattice__pitch_2": [0.4975, 0.499]},
}  # fmt: skip
FIELD_PAIRS = {
    "two plates": {}, "unequal": {"law__eta": [-0.6, -0.6]}, "plano": {"pair__form": "plano"},
    "biconvex": {"pair__form": "biconvex"}, "hexagonal": {"lattice__kind": "hexagonal"},
    "cylinders": {"law__eta": [-1.0, -0.8]},
}  # fmt: skip


@pytest.mark.parametrize(
    ("sheet", "pair"),
    [(s, p) for s in FIELD_SHEETS for p in FIELD_PAIRS if (s, p) != ("two pitches, turned", "hexagonal")],
)
def test_field_faces_lie_where_the_light_of_each_cell_passes_on_its_way_to_its_partner(sheet, pair):
    """The chief ray of the textbook meets every field vertex, and the cell of array 2 in its middle."""
    window = clacad.prescribe(
        design(**{**SMALL, **FIELD_SHEETS[sheet], **PRESENT["field lens"], **FIELD_PAIRS[pair]})
    )
    faces = [face for _, face, _, _ in refractions(window.bodies)]
    for cell in window.lattice.cells()[[0, 5, -1]]:
        slope = aperture_slopes(window, cell[None])[0]
        first = window.centres(0, cell)
        path = oracle.trace(oracle_faces(window, cell), [*(first - slope), -1.0], (*slope, 1.0))
        assert path.status == "ok"
        points = np.array([[float(v) for v in point] for point in path.hits])
        for face, point in zip(faces, points, strict=True):
            if face.array == 2:
                vertex = window.vertices(face, cell)[:2] + window.centres(2, cell)
                off = np.abs(point[:2] - vertex)
                bent = np.array([face.surface.curvature_x, face.surface.curvature_y]) != 0.0
                assert off[bent].max(initial=0.0) < 2e-3 * min(window.lattice.pitch)
        x, y, z = (float(v) for v in path.directions[-2])  # to the height of the vertex of lens 2
        far = points[-1][:2] + (window.vertices(faces[-1], cell)[2] - points[-1][2]) / z * np.array([x, y])
        if faces[-1].array == 1 and window.form != "biconvex":  # whose front has bent the ray before
            assert np.abs(far - window.centres(1, cell)).max() < 2e-3 * min(window.lattice.pitch)


TRACED = sorted(
    {*PAIRS[::6], ("pair.focus", "field lens"), (ETAS, "field lens"), (ETAS, "eta_x and eta_y that differ")}
)


@pytest.mark.parametrize(("sheet", "feature"), TRACED)
def test_rays_of_a_combination_are_those_of_the_textbook_through_the_faces_of_their_cells(
    sheet, feature, tmp_path
):
    as_of_the_textbook(clacad.prescribe(made(sheet, feature, tmp_path)))


def as_of_the_textbook(window):
    """Rays of two cells, through all that the window has, are those of the textbook tracer."""
    cells = window.lattice.cells()[[0, -1]]
    slope = np.divide(window.thin.shift, window.thin.offset[2])
    at = np.column_stack([window.centres(0, cells), np.full(len(cells), -1.0)])
    start = at + [*(0.02 - slope), 0.0]
    seen = clacad.trace(window, clacad.Rays(start, (slope[0], slope[1], 1.0)), rung="surfaces")
    assert (seen.fate == Fate.ALIVE).all()
    for k, cell in enumerate(cells):
        path = oracle.trace(oracle_faces(window, cell), start[k], (slope[0], slope[1], 1.0))
        assert path.status == "ok"
        exact = np.array([float(v) for v in path.directions[-1]])
        assert np.abs(seen.direction[k] - exact).max() < 1e-12
