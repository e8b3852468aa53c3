"""Files that hold one cell and its positions: read, measured and judged without writing the cells out."""

from __future__ import annotations

import json
import re
import tracemalloc
from dataclasses import replace
from hashlib import sha256

import numpy as np
import pytest
from oracle.plain_mesh import sheet_facets, write_stl
from trust.spoiling import document_of, glb, model_changed

from clacad.base.arrays import welded
from clacad.design import Design
from clacad.exporting.run import export
from clacad.exporting.tessellations import Meshes
from clacad.formats.mesh import stl as stl_format
from clacad.formats.mesh import threemf
from clacad.formats.mesh.compare_instances import standing
from clacad.formats.mesh.compare_triangles import compare_mesh
from clacad.formats.mesh.file_mesh import CHUNK, FileMesh, Part, put
from clacad.formats.mesh.glb import write_glb
from clacad.formats.mesh.ply import write_ply
from clacad.formats.mesh.readers import read_mesh
from clacad.formats.mesh.threemf import write_threemf
from clacad.judging import mesh_wholeness
from clacad.judging.cell_triangles import Gatherer
from clacad.judging.delivery import Inspection
from clacad.judging.mesh_file import judge_mesh, placement_check
from clacad.judging.mesh_light import lit_cells, rays_for
from clacad.judging.mesh_shape import clean_forecast
from clacad.judging.mesh_wholeness import connected
from clacad.prescription.prescribe import prescribe
from clacad.sheet.volume_and_extent import Integral, body_volume
from clacad.storage.errors import FileDisagrees, UnreadableFile
from clacad.storage.reading import Overheard
from clacad.verification import verify

DESIGN = Design.from_dict({
    "format": 1, "name": "repeated", "unit": "mm", "law": {"eta": [-0.25, -1.0]},
    "pair": {"form": "biconvex", "separation": 5.0, "thickness": "auto", "index": 1.5},
    "lattice": {"pitch": 0.5, "count": [4, 4]},
})  # fmt: skip
PLANO = DESIGN.replace({"pair.form": "plano"})
PITCH = 0.5
QUADS = 8
RAYS = 4096


def written(folder, suffix, design=DESIGN, quads=QUADS):
    """One cell and its places as a 3MF, GLB or (written out) PLY file."""
    path = folder / f"part.{suffix}"
    tessellation = Meshes(prescribe(design)).at(quads)
    if suffix == "3mf":
        write_threemf(tessellation.pieces(True, normals=False), path, 1.0, "repeated")
    else:
        {"glb": write_glb, "ply": write_ply}[suffix](
            tessellation.pieces(True, normals=True), path, 1.0, "repeated"
        )
    return path


def judged(path, design=DESIGN, stated=None, mesh=None):
    mesh = read_mesh(path) if mesh is None else mesh
    factor = (mesh.unit or 1e-3) / design.unit_m
    asked = Inspection(design, "part", RAYS, stated=stated or {})
    checks, evidence = judge_mesh(asked, prescribe(design), mesh, factor)
    return {check.id: check for check in checks}, evidence


def faults(checks):
    """Failures of what a file must be; that so few facets make no master is another matter."""
    return {c.id for c in checks.values() if c.state == "fail" and not c.id.startswith("file_law")} - {
        "file_confocality", "file_throughput",
    }  # fmt: skip


def written_out(mesh):
    """The same file as if every cell had been written, by plain numpy."""
    parts = []
    for part in mesh.parts:
        for place in part.placements:
            normals = part.normals
            if normals is not None:
                normals = normals @ np.linalg.inv(place[:3]).T
                normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
            parts.append(
                Part(part.name, part.vertices @ place[:3] + place[3], part.triangles, normals=normals)
            )
    return FileMesh(mesh.format, tuple(parts), mesh.unit, mesh.name)


# -- the same verdict as of all cells written out ------------------------------------------------


@pytest.mark.daily_cases("plano-glb")
@pytest.mark.parametrize("suffix", ["3mf", "glb"])
@pytest.mark.parametrize("design", [DESIGN, PLANO], ids=["biconvex", "plano"])
def test_a_repeated_cell_gets_the_verdict_of_all_cells_written_out(tmp_path, suffix, design):
    mesh = read_mesh(written(tmp_path, suffix, design))
    assert all(part.repeated for part in mesh.parts)
    once, _ = judged(None, design, mesh=mesh)
    out, _ = judged(None, design, mesh=written_out(mesh))
    assert set(once) - {"placement"} == set(out)
    assert once["placement"].state == "pass"
    assert not faults(once)
    for name, check in out.items():
        other = once[name]
        assert (check.state, check.unit, check.required) == (other.state, other.unit, other.required), name
        # rays at dyadic places of a cell meet the very edges of its facets, where rounding decides between two
        share = 2e-3 if name.startswith(("file_law", "faithful", "file_conf", "file_thr")) else 1e-6
        if isinstance(check.value, float):
            room = share * max(abs(check.value), abs(check.limit) if isinstance(check.limit, float) else 0.0)
            assert other.value == pytest.approx(check.value, abs=room), name
        else:
            assert other.value == check.value
        if isinstance(check.limit, float):
            assert other.limit == pytest.approx(check.limit, rel=share), name
    about, whole = once["closed"].detail, out["closed"].detail
    assert {k: about[k] for k in ("facets", "walls", "degenerate")} == {
        k: whole[k] for k in ("facets", "walls", "degenerate")
    }


# -- every place is compared with the lattice ----------------------------------------------------

COMPONENT = re.compile(r'<component objectid="(\d+)" transform="1 0 0 0 1 0 0 0 1 (\S+) (\S+) (\S+)"/>\n')


def places_of(data, change):
    """The list of (object, x, y, z) of a 3MF file's components changed; a fourth text may replace a whole transform."""

    def model(text):
        found = [(m[1], *(float(m[k]) for k in (2, 3, 4))) for m in COMPONENT.finditer(text)]
        lines = {}
        for number, *place in change(found):
            turn = place.pop() if isinstance(place[-1], str) else "1 0 0 0 1 0 0 0 1"
            lines.setdefault(number, []).append(
                f'<component objectid="{number}" transform="{turn} {place[0]!r} {place[1]!r} {place[2]!r}"/>\n'
            )
        for number in dict.fromkeys(one[0] for one in found):
            block = re.compile(rf'(?:<component objectid="{number}" [^\n]*\n)+')
            text = block.sub(lambda _, number=number: "".join(lines.get(number, [])), text)
        return text

    return model_changed(data, model)


def nodes_of(data, change):
    """The same of a GLB file's nodes."""
    document, binary = document_of(data)
    for body in [n for n in document["nodes"] if "children" in n][1:]:
        leaves = [document["nodes"][k] for k in body["children"]]
        found = change([(str(leaves[0]["mesh"]), *n["translation"]) for n in leaves])
        body["children"] = []
        for number, x, y, z, *turn in found:
            body["children"].append(len(document["nodes"]))
            more = {"rotation": [0.0, 0.0, 0.5**0.5, 0.5**0.5]} if turn else {}
            document["nodes"].append({"mesh": int(number), "translation": [x, y, z], **more})
    return glb(document, binary)


def of_first(change):
    """Change the places of the first object only: (places of a kind) → places."""

    def all_of(found):
        first = min(found)[0]
        mine = [one for one in found if one[0] == first]
        return change(mine) + [one for one in found if one[0] != first] if first in ("0", "1") else found

    return all_of


def _moved(axis, way):
    def change(places):
        one = list(places[6])  # cell (2, 1), row by row
        one[1 + axis] += way
        return [*places[:6], tuple(one), *places[7:]]

    return change


QUARTER = "0 1 0 -1 0 0 0 0 1"
PLACES = {
    "moved along x": _moved(0, 1e-4 * PITCH),
    "moved along y": _moved(1, -1e-4 * PITCH),
    "moved along z": _moved(2, 1e-4 * PITCH),
    "moved by a pitch": _moved(0, PITCH),
    "missing": lambda places: places[:6] + places[7:],
    "doubled": lambda places: [*places, places[6]],
    "beside the sheet": lambda places: [*places, (places[6][0], places[6][1] + 40 * PITCH, *places[6][2:])],
    "turned by a quarter": lambda places: [*places[:6], (*places[6], QUARTER), *places[7:]],
}


@pytest.mark.ci_cases(
    "3mf-moved along z",
    "3mf-missing",
    "3mf-turned by a quarter",
    "glb-moved by a pitch",
    "glb-beside the sheet",
)
@pytest.mark.daily_cases("3mf-beside the sheet")
@pytest.mark.parametrize("what", PLACES)
@pytest.mark.parametrize("suffix", ["3mf", "glb"])
def test_one_instance_in_a_wrong_place_fails_placement(tmp_path, suffix, what):
    path = written(tmp_path, suffix)
    change = {"3mf": places_of, "glb": nodes_of}[suffix]
    honest = change(path.read_bytes(), lambda found: found)
    path.write_bytes(honest)
    assert judged(path)[0]["placement"].state == "pass"
    path.write_bytes(change(honest, of_first(PLACES[what])))
    check = judged(path)[0]["placement"]
    assert check.state == "fail"
    if what in ("moved along x", "moved along y", "moved along z"):
        assert check.value == pytest.approx(1e-4 * PITCH, rel=1e-6)
        assert "(2, 1)" in check.sentence
    if what in ("missing", "doubled"):
        assert check.detail["cells_" + what] == [(2, 1)]
        assert "(2, 1)" in check.sentence
    if what == "beside the sheet":
        assert check.detail["outside"] == 1
    if what == "moved by a pitch":
        assert check.detail["cells_missing"] == [(2, 1)]
        assert check.detail["cells_doubled"] == [(3, 1)]


@pytest.mark.parametrize("what", ["moved along x", "missing", "doubled"])
def test_an_export_does_not_agree_with_a_file_whose_instance_stands_wrong(tmp_path, what):
    path = written(tmp_path, "3mf")
    window = prescribe(DESIGN)
    promise = Meshes(window).at(QUADS).promise(True, False)
    compare_mesh(read_mesh(path), window, promise, "part.3mf")
    path.write_bytes(places_of(path.read_bytes(), of_first(PLACES[what])))
    mesh = read_mesh(path)
    with pytest.raises(FileDisagrees, match=r"\(2, 1\)"):
        compare_mesh(mesh, window, replace(promise, facets=mesh.facet_count), "part.3mf")


@pytest.mark.slow
def test_a_hexagonal_sheet_of_repeated_cells_stands_on_its_lattice(tmp_path):
    design = DESIGN.replace({"lattice.kind": "hexagonal", "lattice.count": [5, 4]})
    path = written(tmp_path, "3mf", design)
    checks, _ = judged(path, design)
    assert checks["placement"].state == "pass"
    assert not faults(checks)
    path.write_bytes(places_of(path.read_bytes(), of_first(PLACES["missing"])))
    assert judged(path, design)[0]["placement"].detail["missing"] == 1


# -- rows of cells -------------------------------------------------------------------------------

ROW = re.compile(
    r'<object id="(\d+)" type="model" name="\S+ row">\n<components>\n((?:<component [^\n]*\n)+)</components>'
)


@pytest.fixture
def in_rows(tmp_path, monkeypatch):
    """A 3MF file of 4 × 4 cells that holds rows, and rows of cells."""
    monkeypatch.setattr(threemf, "FLAT_LIMIT", 0)
    return written(tmp_path, "3mf")


@pytest.mark.slow
def test_rows_of_cells_are_not_written_out_and_get_the_verdict_of_cells(in_rows, tmp_path, monkeypatch):
    mesh = read_mesh(in_rows)
    assert all((len(part.places.outer), len(part.places.inner)) == (4, 4) for part in mesh.parts)
    every = replace(mesh, parts=tuple(replace(part, places=put(part.placements)) for part in mesh.parts))
    assert not any(part.places.in_rows for part in every.parts)
    (wanted, _), box = judged(None, mesh=every), every.box()
    monkeypatch.setattr(Part, "placements", property(lambda _: pytest.fail("written out")))
    found, _ = judged(None, mesh=read_mesh(in_rows))
    for name, check in wanted.items():
        other = found[name]
        if name != "placement":
            assert (other.state, other.value, other.limit, other.sentence) == (
                check.state,
                check.value,
                check.limit,
                check.sentence,
            ), name
    place, other = found["placement"], wanted["placement"]
    assert (place.state, place.limit) == (other.state, other.limit) == ("pass", other.limit)
    assert place.sentence.split(";")[0] == other.sentence.split(";")[0]
    assert max(place.value, other.value) <= 1e-14
    np.testing.assert_array_equal(read_mesh(in_rows).box(), box)


def _lines(change):
    """Change the lines of the components of an object that holds cells (first of them), or rows of cells."""
    return lambda text, pattern: pattern.sub(
        lambda m: m[0].replace(m[2], "".join(change(m[2].splitlines(True)))), text, count=1
    )


def _aside(line, by):
    return re.sub(r"(\S+) (\S+) (\S+)\"/>", lambda m: f'{float(m[1]) + by!r} {m[2]} {m[3]}"/>', line)


WHOLE = re.compile(
    r'<object id="(\d+)" type="model" name="[^" ]+">\n<components>\n((?:<component [^\n]*\n)+)</components>'
)
IN_ROWS = {
    "a row shifted": (WHOLE, lambda lines: [*lines[:2], _aside(lines[2], 1e-4 * PITCH), lines[3]]),
    "a column shifted": (ROW, lambda lines: [lines[0], _aside(lines[1], 1e-4 * PITCH), *lines[2:]]),
    "a row missing": (WHOLE, lambda lines: lines[:-1]),
    "a column missing": (ROW, lambda lines: [lines[0], *lines[2:]]),
    "a row doubled": (WHOLE, lambda lines: [*lines, lines[1]]),
    "a column doubled": (ROW, lambda lines: [*lines, lines[1]]),
    "a row in the place of another": (WHOLE, lambda lines: [lines[0], lines[2], *lines[2:]]),
    "a row beside the sheet": (WHOLE, lambda lines: [*lines[:3], _aside(lines[3], 4 * PITCH)]),
}


@pytest.mark.parametrize("what", IN_ROWS)
def test_a_row_or_column_in_a_wrong_place_fails_as_its_cells_do(in_rows, what):
    pattern, change = IN_ROWS[what]
    whole = in_rows.read_bytes()
    in_rows.write_bytes(model_changed(whole, lambda text: _lines(change)(text, pattern)))
    assert in_rows.read_bytes() != whole
    mesh = read_mesh(in_rows)
    every = replace(mesh, parts=tuple(replace(part, places=put(part.placements)) for part in mesh.parts))
    window = prescribe(DESIGN)
    check, other = (
        placement_check(DESIGN, standing(one, window, 1e-3 / DESIGN.unit_m), "part") for one in (mesh, every)
    )
    assert check.state == other.state == "fail"
    assert (check.sentence, check.value, check.detail) == (other.sentence, other.value, other.detail)
    if "missing" in what:
        assert check.detail["missing"] == 4
    if "doubled" in what:
        assert check.detail["doubled"] == 4
    if "shifted" in what:
        assert check.value == pytest.approx(1e-4 * PITCH, rel=1e-3)


# -- 40,000 cells --------------------------------------------------------------------------------

LARGE = DESIGN.replace({"lattice.count": [200, 200]})


class Counter:
    """Count of facets whose corners were requested, by any caller."""

    def __init__(self, monkeypatch):
        self.facets = 0
        corners, picked = Part.corners, Part.picked

        def counted(part, start, stop):
            found = corners(part, start, stop)
            self.facets += len(found)
            return found

        def chosen(part, facets):
            self.facets += len(facets)
            return picked(part, facets)

        monkeypatch.setattr(Part, "corners", counted)
        monkeypatch.setattr(Part, "picked", chosen)


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    return written(tmp_path_factory.mktemp("large"), "3mf", LARGE, 64)


@pytest.mark.slow
def test_a_sheet_of_40_000_cells_is_read_and_judged_without_expanding_it(large, monkeypatch):
    counter = Counter(monkeypatch)
    tracemalloc.start()
    mesh = read_mesh(large)
    checks, evidence = judged(None, LARGE, mesh=mesh)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert mesh.facet_count == 40_000 * mesh.stored_count > 1_000_000_000
    assert counter.facets < 20 * mesh.stored_count
    assert peak < 400e6
    assert not faults(checks)
    assert checks["placement"].state == checks["pieces"].state == "pass"
    assert checks["placement"].detail["instances"] == 80_000
    holds = evidence.facts["holds"]
    assert (holds["objects"], holds["placements"], holds["shells"]) == (2, 80_000, 80_000)
    assert holds["facets_stored"] == mesh.stored_count
    assert holds["words"].startswith("80,000 instances of 2 objects")
    # the two columns of a cell, each 40,000 times
    window = prescribe(LARGE)
    exact = sum(body_volume(window, body).value for body in window.bodies)
    assert checks["volume"].detail["volume"] == pytest.approx(exact, rel=5e-4)


@pytest.mark.slow
def test_an_export_reads_40_000_cells_back_without_expanding_them(large, monkeypatch):
    window = prescribe(LARGE)
    promise = Meshes(window).at(64).promise(True, False)
    volumes = [body_volume(window, body) for body in window.bodies]
    exact = Integral(sum(v.value for v in volumes), sum(v.error for v in volumes))
    counter = Counter(monkeypatch)
    verdict = compare_mesh(read_mesh(large), window, promise, "part.3mf", exact)
    assert verdict.checks == ("closed", "volume", "shape")
    assert counter.facets < 20 * promise.facets // 40_000


@pytest.mark.slow
def test_what_walks_all_facets_is_refused_and_the_box_is_not(large, monkeypatch):
    mesh = read_mesh(large)
    with pytest.raises(UnreadableFile, match="facets"):
        next(mesh.chunks())
    counter = Counter(monkeypatch)
    low, high = mesh.box()
    assert low[:2] == pytest.approx([-50.0, -50.0])
    assert high[:2] == pytest.approx([50.0, 50.0])
    assert counter.facets < 3 * mesh.stored_count


# -- stored normals ------------------------------------------------------------------------------


def normals_of(path, change):
    """The file with its stored normals (v, 3) changed."""
    data = path.read_bytes()
    if path.suffix == ".ply":
        head, mark, body = data.partition(b"end_header\n")
        count = int(re.search(rb"element vertex (\d+)", head)[1])
        table = np.frombuffer(body, "<f8", 6 * count).reshape(-1, 6).copy()
        table[:, 3:] = change(table[:, 3:].copy())
        path.write_bytes(head + mark + table.tobytes() + body[table.nbytes :])
        return path
    document, binary = document_of(data)
    buffer = bytearray(binary)
    for mesh in document["meshes"]:
        accessor = document["accessors"][mesh["primitives"][0]["attributes"]["NORMAL"]]
        start = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
        values = np.frombuffer(binary, "<f4", 3 * accessor["count"], start).reshape(-1, 3)
        changed = change(values.astype(np.float64)).astype("<f4").tobytes()
        buffer[start : start + len(changed)] = changed
    path.write_bytes(glb(document, bytes(buffer)))
    return path


def _first_is_nan(normals):
    normals[0] = np.nan
    return normals


def _leaning(normals):
    """All turned by 3 degrees about y."""
    c, s = np.cos(np.deg2rad(3.0)), np.sin(np.deg2rad(3.0))
    return normals @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


NORMALS = {
    "x and y negated": lambda n: n * [-1.0, -1.0, 1.0], "turned over": lambda n: -n, "zero": lambda n: 0.0 * n,
    "half as long": lambda n: 0.5 * n, "turned by 3 degrees": _leaning,
}  # fmt: skip


@pytest.mark.ci_cases("x and y negated-glb", "turned over-ply", "zero-glb", "turned by 3 degrees-ply")
@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["glb", "ply"])
@pytest.mark.parametrize("what", NORMALS)
def test_wrong_stored_normals_fail(tmp_path, suffix, what):
    path = written(tmp_path, suffix, quads=16)
    assert judged(path)[0]["file_normals"].state == "pass"
    checks, _ = judged(normals_of(path, NORMALS[what]))
    assert faults(checks) == {"file_normals"}


@pytest.mark.slow
def test_a_stored_normal_that_is_no_number_fails(tmp_path):
    checks, _ = judged(normals_of(written(tmp_path, "glb"), _first_is_nan))
    assert faults(checks) == {"file_normals"}
    with pytest.raises(UnreadableFile):
        read_mesh(normals_of(written(tmp_path, "ply"), _first_is_nan))


@pytest.mark.slow
def test_stored_normals_are_judged_by_their_angle_to_the_sphere(tmp_path):
    """All turned by an angle: that angle is found, on lenses whose normals are known in closed form."""
    path = normals_of(written(tmp_path, "glb", quads=32), _leaning)
    check = judged(path)[0]["file_normals"]
    # a turn about y moves a normal (n_x, n_y, n_z) by 2 asin(sin(a/2) sqrt(1 - n_y^2)): nearly a on shallow lenses
    assert check.value == pytest.approx(np.deg2rad(3.0), rel=0.01)


@pytest.mark.slow
def test_a_file_without_normals_is_not_asked_for_them(tmp_path):
    assert "file_normals" not in judged(written(tmp_path, "3mf"))[0]


# -- noise ---------------------------------------------------------------------------------------


def stl(folder, design, quads, noise=0.0):
    """An STL with noise (mm) on the heights of its vertices, the same wherever facets share one."""
    corners = sheet_facets(prescribe(design), quads)
    vertices, index = welded(np.round(corners, 9))
    vertices = vertices.copy()
    vertices[:, 2] += np.random.default_rng(1).normal(0.0, noise, len(vertices)) if noise else 0.0
    path = folder / "part.stl"
    write_stl(path, vertices[index])
    return path


WINDOW = Design.from_dict({
    "format": 1, "name": "window", "unit": "mm", "law": {"eta": [-1.0, -1.0]},
    "pair": {"form": "slab", "separation": 10.0, "index": 1.49},
    "lattice": {"pitch": 0.5, "count": [6, 6]},
})  # fmt: skip


@pytest.mark.daily_cases("8")
@pytest.mark.parametrize("quads", [8, 16, 32])
def test_noise_of_a_tenth_of_a_micrometre_fails_where_the_honest_file_passes(tmp_path, quads):
    honest, _ = judged(stl(tmp_path, WINDOW, quads), WINDOW)
    assert not faults(honest)
    noisy, _ = judged(stl(tmp_path, WINDOW, quads, 1e-4), WINDOW)
    assert "shape" in faults(noisy)


@pytest.mark.slow
@pytest.mark.parametrize("stated", [
    {"sag_error_max": 1.0, "slope_error_rms": 1.0, "unit": "mm"}, {"sag_error_max": 1.0, "unit": "mm"},
], ids=["both", "sag"])  # fmt: skip
def test_errors_that_a_manifest_states_too_large_widen_no_limit(tmp_path, stated):
    assert not faults(judged(stl(tmp_path, WINDOW, 16), WINDOW, stated)[0])
    assert "shape" in faults(judged(stl(tmp_path, WINDOW, 16, 1e-4), WINDOW, stated)[0])
    # one bump of half a micrometre in the middle of a lens: slopes over the cell hardly show it
    corners = sheet_facets(prescribe(WINDOW), 16)
    top = corners[..., 2].max()
    bump = (np.abs(corners[..., :2] - 0.25).max(axis=-1) < 1e-9) & (corners[..., 2] > top - 0.1)
    assert bump.any()
    corners[bump, 2] += 5e-4
    write_stl(tmp_path / "part.stl", corners)
    assert "shape" in faults(judged(tmp_path / "part.stl", WINDOW, stated)[0])


def test_the_forecast_of_the_clean_cut_does_not_know_the_noise(tmp_path):
    window = prescribe(WINDOW)
    forecasts = []
    for noise in (0.0, 1e-3):
        gatherer = Gatherer(window, lit_cells(window, 0.0))
        for chunk in read_mesh(stl(tmp_path, WINDOW, 16, noise)).chunks():
            gatherer.look(chunk)
        forecasts.append(clean_forecast(window, gatherer.result, 0))
    assert forecasts[1] == pytest.approx(forecasts[0], rel=1e-3)
    assert forecasts[0] > 0.0


# -- pieces --------------------------------------------------------------------------------------


def tetrahedra(count):
    """A number of tetrahedra, none of which touches another, (4 count, 3, 3)."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32)
    facets = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    places = 2.0 * np.argwhere(np.ones((count // 100 + 1, 10, 10)))[:count].astype(np.float32)
    return (corners[facets][None] + places[:, None, None]).reshape(-1, 3, 3)


def test_pieces_of_a_stream_are_counted_to_the_last_one():
    soup = tetrahedra(40_000)
    assert connected(Part("", soup=soup)) == 40_000
    order = np.random.default_rng(0).permutation(len(soup))
    assert connected(Part("", soup=soup[order])) == 40_000
    bridge = np.stack([soup[0, 0], soup[-1, 0], soup[4, 0]])[None]  # one triangle from the first to the last
    assert connected(Part("", soup=np.concatenate([soup, bridge]))) == 39_998


@pytest.mark.slow
def test_a_large_stl_is_read_once_for_its_hash_its_sums_its_facets_and_its_pieces(tmp_path, monkeypatch):
    path, read = stl(tmp_path, DESIGN, QUADS), []
    small, _ = judged(path)
    monkeypatch.setattr(mesh_wholeness, "COUNTED_FACETS", 0)

    def told(path, start, stop, heard=None, real=stl_format.read_facets):
        read.append((start, stop))
        return real(path, start, stop, heard)

    monkeypatch.setattr(stl_format, "read_facets", told)
    heard = Overheard(path)
    large, _ = judged(path, mesh=read_mesh(path, heard))
    count = (path.stat().st_size - 84) // 50
    assert [start for start, _ in read] == list(range(0, count, CHUNK))
    assert heard.heard == path.stat().st_size
    assert heard.hexdigest() == sha256(path.read_bytes()).hexdigest()
    assert large["pieces"].value == small["pieces"].value
    assert large["volume"].value == small["volume"].value


def test_a_corner_that_is_no_number_is_told_as_it_is_read(tmp_path):
    path = stl(tmp_path, DESIGN, QUADS)
    content = bytearray(path.read_bytes())
    count = (len(content) - 84) // 50
    for number in (np.nan, np.inf, -np.inf):
        place = 84 + 50 * (count - 3) + 12 + 4 * 5
        content[place : place + 4] = np.float32(number).tobytes()
        path.write_bytes(content)
        with pytest.raises(UnreadableFile, match="not a number"):
            list(read_mesh(path).chunks())
    content[84 + 50 * 3 + 12 : 84 + 50 * 3 + 16] = np.float32(np.inf).tobytes()  # and one of each sign
    path.write_bytes(content)
    with pytest.raises(UnreadableFile, match="not a number"):
        list(read_mesh(path).chunks())


@pytest.mark.slow
def test_pieces_of_a_large_file_are_counted_or_the_sentence_says_that_they_are_not(tmp_path, monkeypatch):
    path = stl(tmp_path, DESIGN, QUADS)
    small = judged(path)[0]["pieces"]
    monkeypatch.setattr(mesh_wholeness, "COUNTED_FACETS", 0)
    large = judged(path)[0]["pieces"]
    assert (large.state, large.value) == (small.state, small.value) == ("pass", 2.0)
    monkeypatch.setattr(mesh_wholeness, "COUNTED_PIECES", 0)
    none = judged(path)[0]["pieces"]
    assert none.state == "not run"
    assert not none.required
    assert none.sentence.startswith("not counted and not required")


@pytest.mark.slow
def test_rays_too_few_for_a_fit_are_an_answer_of_their_own_with_the_number_that_will_do(tmp_path):
    design = Design.from_dict({
        "format": 1, "name": "few", "unit": "mm", "law": {"eta": [-0.25, -1.0]},
        "pair": {"form": "slab", "separation": 10.0, "material": "PMMA"}, "lattice": {"pitch": 0.5, "count": [3, 3]},
    })  # fmt: skip
    export(design, tmp_path / "few", formats=["3mf"], quads=64)
    few = verify(design, tmp_path / "few", rays=1000)
    (told,) = few.verdicts
    missing = [check for check in few.checks if check.state == "not run" and check.required]
    assert {check.id for check in missing} == {"faithful_eta", "faithful_delta"}
    assert (few.word, told.word, few.exit_status) == ("not judged", "not judged", 1)
    needed = missing[0].detail["rays_needed"]
    assert f"--rays {needed} would do" in few.verdict()
    enough = verify(design, tmp_path / "few", rays=needed)
    assert not [check for check in enough.checks if check.state == "not run" and check.required]
    assert enough.word != "not judged"


def test_rays_for_a_number_that_passes_are_enough_and_not_many_more():
    for passed, share in [(1024, 0.86), (1024, 0.011), (64, 1.0), (1, 1e-6)]:
        assert passed / share <= rays_for(passed, share) < 1.25 * passed / share


# -- hostile files -------------------------------------------------------------------------------


def test_a_node_that_stands_under_two_others_is_no_tree(tmp_path):
    path = written(tmp_path, "glb")
    document, binary = document_of(path.read_bytes())
    bodies = [n for n in document["nodes"] if "children" in n][1:]
    bodies[1]["children"].append(bodies[0]["children"][0])
    path.write_bytes(glb(json.loads(json.dumps(document)), binary))
    with pytest.raises(UnreadableFile, match="twice"):
        read_mesh(path)


@pytest.mark.slow
def test_a_cell_open_by_itself_fails_at_40_000_places(tmp_path):
    path = written(tmp_path, "3mf", LARGE, QUADS)
    path.write_bytes(
        model_changed(path.read_bytes(), lambda text: re.sub(r"<triangle [^>]*/>\n", "", text, count=1))
    )
    check = judged(path, LARGE)[0]["closed"]
    assert check.state == "fail"
    assert check.value == 3.0
