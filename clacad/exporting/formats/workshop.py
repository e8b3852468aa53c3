"""Files that a workshop feeds its machines: inserts of moulds, tool points, dose maps, the coupon of a dose.

None of them is the part. Their role is `tooling`: they are judged by the part that the process makes of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clacad.exporting.formats.format import (
    BASE,
    FaceFile,
    FileKind,
    Forecast,
    Format,
    Misfit,
    Reading,
    drawn_cost,
    map_row,
    stream_bytes,
    structured_count,
)
from clacad.exporting.roles import AT_POINTS, EXACT_FACES, NO_SURFACE, SIXTEEN_BITS

if TYPE_CHECKING:
    from clacad.base.types import Floats
    from clacad.exporting.manifest import FileRecord, Job
    from clacad.exporting.request import Request
    from clacad.exporting.tessellations import Meshes
    from clacad.formats.maps.dose import Calibration
    from clacad.formats.maps.tool_path import ToolFace
    from clacad.sheet.window import Body, Window
    from clacad.storage.worker import Worker

INSERT, TOOL, DOSE, WEDGE = "insert", "tool", "dose", "wedge"
INSERT_STEP, INSERT_STL, INSERT_MAP = "insert-step", "insert-stl", "insert-map"
TOOL_POINTS, DOSE_8, DOSE_16, DOSE_BMP, DOSE_TABLE = (
    "tool-points",
    "dose-8",
    "dose-16",
    "dose-bmp",
    "dose-table",
)
WEDGE_PICTURE, WEDGE_TABLE = "wedge-picture", "wedge-table"
"""Words of the files in manifests."""

TOOL_SECONDS, DOSE_SECONDS, INSERT_SECONDS = 2.4e-5, 4e-7, 2.5
"""Seconds per point, per pixel, and per face of an insert with its STEP file."""

MOST_POINTS, ROW = 400_000, 210
"""Points of a face where no step is requested; bytes of one."""

INSERT_FACETS = 2_000_000
"""Most facets of an insert's STL file."""

WEDGE_PIXEL = 1e-6
"""Pixel (metres) of the coupon's picture."""


# -- inserts ---------------------------------------------------------------------------------------


def _write_insert(job: Job) -> list[FileRecord]:
    """Write STEP, STL and height map of the insert of every structured face."""
    from clacad.formats.maps.sag import structured_faces
    from clacad.sheet.shrunk import insert_window

    records: list[FileRecord] = []
    for _, face, label in structured_faces(job.window):
        files = _insert_files(job, insert_window(job.window, face, label), label)
        records += [replace(one, facts={**one.facts, "face": label}) for one in files]
    return records


def _insert_files(job: Job, steel: Window, label: str) -> Iterator[FileRecord]:
    from clacad.exporting.formats.height_maps import TIFF32
    from clacad.exporting.formats.indexed_meshes import write_one
    from clacad.exporting.step_record import step_record
    from clacad.exporting.tessellations import Tessellation
    from clacad.formats.maps.sag import check_map, height_map, write_map

    body, stem = steel.bodies[0], f"{job.stem}.{label}.insert"
    own = replace(job, window=steel, stem=stem, tessellation=Tessellation(steel, _insert_quads(steel)))
    kept = (label.partition("-")[0],)
    if body.back.form is None:  # heights alone hold the forms of a correction
        yield replace(step_record(own, INSERT_STEP), bodies=kept)
        yield replace(write_one(own, f"{stem}.stl", steel), format=INSERT_STL, bodies=kept)
    map_ = height_map(steel, body, body.back, label)
    path = job.stage.path(f"{stem}.f32.tiff")
    write_map(map_, path, TIFF32, job.scale)
    check_map(map_, path, TIFF32, job.scale)
    facts = {"float": "f32", "calibration": map_.calibration(job.scale)}
    yield job.record(path, INSERT_MAP, bodies=kept, facts=facts)


def kind_named(name: str) -> str:
    """Word of the kind of an insert's file by its name; "" for other names."""
    if INSIDE_NAME not in name.lower():
        return ""
    ends = {".step": INSERT_STEP, ".stp": INSERT_STEP, ".stl": INSERT_STL, ".tiff": INSERT_MAP}
    return next((word for end, word in ends.items() if name.lower().endswith(end)), "")


BORDER = 1e-5
"""Distance from a border over half a cell within which a point belongs to either cell."""

INSIDE_NAME = ".insert."
"""Part of the name of every file of an insert."""


def insert_file(of: FaceFile) -> FaceFile:
    """The file of the steel that moulds a face of a sheet; the steel is named after the face."""
    from clacad.sheet.shrunk import insert_window

    steel = insert_window(of.window, of.face, of.label)
    return FaceFile(steel, steel.bodies[0], steel.bodies[0].back, of.label, of.path)


def is_insert(word: str) -> bool:
    """Whether files of a kind are inserts of a mould."""
    return word in (INSERT_STEP, INSERT_STL, INSERT_MAP)


def surface_misfit(of: FaceFile, points: Floats) -> Floats:
    """Distances (m,) along z of points from the face of a file's window, lengths; NaN off its cells.

    NaN too on borders with a step, where a point belongs to either side: of tilted or differing lenses, and
    of lenses with land.
    """
    import numpy as np

    from clacad.sheet.window import face_height

    index, u, v = of.window.locate(of.face.array or 0, points[:, 0], points[:, 1])
    off = points[:, 2] - face_height(of.window, of.face, u, v, index)
    held, lattice = of.window.lattice.contains(index), of.window.lattice_of(of.face.array or 0)
    half, past = np.array(lattice.half_widths)[:, None], lattice.past_borders(u, v)
    borders = [0.0] if not (of.face.untilted and of.window.uniform) else []
    for inset in borders + ([0.5 * of.window.land.seam] if of.face.land is not None else []):
        held &= (np.abs(past + inset) > BORDER * half).all(axis=0)
    return np.where(held, off, np.nan)


def _insert_misfit(points: Callable[[FaceFile], Floats]) -> Callable[[FaceFile], Misfit]:
    """Comparison of an insert, by its points, with the face of its window."""

    def compare(of: FaceFile) -> Misfit:
        import numpy as np

        off = surface_misfit(of, points(of))
        worst = float(np.nanmax(np.abs(off), initial=0.0)) if np.isfinite(off).any() else np.inf
        room = 1e-5 * min(of.window.lattice.pitch) * of.scale
        return worst * of.scale, room, f"{np.isfinite(off).sum():,} points of {of.label}"

    return compare


def _insert_quads(steel: Window) -> int:
    """Finest grid whose facets stay below `INSERT_FACETS`."""
    from clacad.exporting.limits import QUADS

    cells = max(1, steel.lattice.cell_count)
    return next((quads for quads in QUADS if 2 * quads * quads * cells <= INSERT_FACETS), QUADS[-1])


def _require_insert(window: Window, _asked: Request, _worker: Worker) -> None:
    """Require faces whose cells lie on themselves when turned."""
    from clacad.formats.maps.sag import structured_faces
    from clacad.sheet.shrunk import insert_window

    for _, face, label in structured_faces(window):
        insert_window(window, face, label)


def _forecast_insert(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    from clacad.exporting.formats.step import step_bytes
    from clacad.formats.maps.sag import samples_per_cell
    from clacad.formats.step.part21 import chosen_mode

    window, quads = meshes.window, _insert_quads(meshes.window)
    cells, faces = window.lattice.cell_count, structured_count(window)
    pixels = samples_per_cell(window) ** 2 * cells
    step = step_bytes(window, chosen_mode(window, "auto"))
    size = step + faces * (stream_bytes(2 * quads * quads * cells) + 4 * pixels)
    return map_row(INSERT, size, BASE + INSERT_SECONDS * faces + 1.2e-6 * step, 500_000_000)


def _step_points(of: FaceFile) -> Floats:
    """Corners of triangles on the faces of a STEP file, which lie on the faces themselves."""
    from clacad.base.units import millimetres
    from clacad.exporting.formats.registry import longest_wait, reading_worker
    from clacad.storage.atomic import scratch_folder

    fine = STEP_FINE * min(of.window.lattice.pitch) * millimetres(of.window.unit)
    fine *= max(1.0, of.window.lattice.cell_count / FINE_CELLS)  # facets in all stay as many
    with scratch_folder() as folder, reading_worker(of.path) as worker:
        target = folder / "insert.stl"
        worker.run(
            "clacad.formats.step.read_back:facets",
            str(of.path),
            str(target),
            fine,
            timeout=longest_wait(of.path),
        )
        return _corners(target, of)


def _stl_points(of: FaceFile) -> Floats:
    return _corners(of.path, of)


def _corners(path: Path, of: FaceFile) -> Floats:
    """Corners (m, 3) of the facets of `_facets`, each once."""
    import numpy as np

    return np.unique(_facets(path, of).reshape(-1, 3), axis=0)


def _facets(path: Path, of: FaceFile) -> Floats:
    """Facets (t, 3, 3) that are no walls, without those of the block's bottom and top."""
    import numpy as np

    from clacad.formats.mesh.readers import read_mesh
    from clacad.sheet.window import WALL

    found = [np.empty((0, 3, 3))]
    reach = INSIDE * max(abs(z) for z in of.window.z_range)
    for chunk in read_mesh(path).chunks():
        corners = np.asarray(chunk, dtype=np.float64) / of.scale
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        level = np.abs(normal[:, 2]) > WALL * np.linalg.norm(normal, axis=1)
        found.append(corners[level & (np.abs(corners[..., 2]) < reach).all(axis=1)])
    return np.concatenate(found)


def _insert_heights(of: FaceFile) -> Floats:
    """Points of the pixels of an insert's map."""
    import numpy as np

    from clacad.exporting.formats.height_maps import TIFF32

    map_ = of.map()
    pixels = np.asarray(map_.read(of.path, TIFF32), dtype=np.float64)
    heights, hole = map_.heights_of(pixels, TIFF32, of.scale)
    rows, columns = np.nonzero(~hole)
    x, y = map_.places(columns, rows)
    return np.stack([x, y, heights[rows, columns] + map_.reference], axis=1)


STEP_FINE, FINE_CELLS, INSIDE = 1e-4, 2000, 0.6
"""Distance of the facets through which a STEP file is sampled, in pitches, up to that number of cells;
height over the block's that is searched for the cavity."""

# -- tool points -----------------------------------------------------------------------------------


def _tools(window: Window, asked: Request) -> Iterator[tuple[Body, str, ToolFace]]:
    """Faces, or the inserts that mould them, with the tool that cuts them. Raises NotPossible."""
    from clacad.formats.maps.sag import structured_faces
    from clacad.formats.maps.tool_path import tool_face

    for body, face, label in structured_faces(window):
        cut = FaceFile(window, body, face, label, Path())
        if asked.compensation is not None and asked.compensation.cut_as_insert:
            cut = insert_file(cut)
        tool = tool_face(cut.window, cut.face, label, asked.nose or 0.0, asked.tool_step, MOST_POINTS)
        yield body, label, tool


def _write_tool(job: Job) -> list[FileRecord]:
    from clacad.formats.maps.tool_path import tool_misfit, write_tool
    from clacad.storage.errors import FileDisagrees

    records = []
    for body, label, tool in _tools(job.window, job.request):
        path = job.stage.path(f"{job.stem}.{label}.tool.csv")
        job.progress(f"write {path.name}", 0.0)
        facts = write_tool(tool, path, job.scale, job.request.tool_order, label)
        off, count, _ = tool_misfit(tool, path, job.scale)
        if count != facts["points"] or not off <= TOOL_ROOM * min(job.window.lattice.pitch) * job.scale:
            raise FileDisagrees(f"{path.name}: its points are not those of {label}")
        records.append(job.record(path, TOOL_POINTS, bodies=[body.name], facts={"face": label, **facts}))
    return records


TOOL_ROOM = 1e-9
"""Distance of a written point from the face over the pitch: rounding of sheet coordinates."""


def _require_tool(window: Window, asked: Request, _worker: Worker) -> None:
    """Require a nose that reaches the faces."""
    for _ in _tools(window, asked):
        pass


def _forecast_tool(meshes: Meshes, _quads: int, asked: Request) -> Forecast:
    window = meshes.window
    points = 0
    for _, _, tool in _tools(window, asked):
        points += int(window.lattice.cell_area * window.lattice.cell_count / tool.step**2)
    return map_row(TOOL, ROW * points, BASE + TOOL_SECONDS * points)


def _tool_of(of: FaceFile) -> ToolFace:
    """Tool of a file's face; the radius is that of the file's first row."""
    from clacad.formats.maps.tool_path import ToolFace

    return ToolFace(of.window, of.face, 0.0, min(of.window.lattice.pitch))


def _tool_surface(of: FaceFile) -> Floats:
    """Surface points of a tool file, in the axes of the sheet."""
    import numpy as np

    from clacad.formats.maps.tool_path import read_tool

    way, vertex = _tool_of(of).way, of.face.vertex[2]
    points = np.concatenate([table[:, :3] for table in read_tool(of.path)]) / of.scale
    return np.asarray(points * np.array([1.0, way, way]) + np.array([0.0, 0.0, vertex]))


def _tool_misfit(of: FaceFile) -> Misfit:
    from clacad.formats.maps.tool_path import tool_misfit

    worst, count, reached = tool_misfit(_tool_of(of), of.path, of.scale)
    words = f"{count:,} tool points of {of.label}, of which the nose does not reach {count - reached:,}"
    return worst, TOOL_ROOM * min(of.window.lattice.pitch) * of.scale, words


# -- dose ------------------------------------------------------------------------------------------


def _calibration(asked: Request, deepest: float) -> Calibration:
    from clacad.formats.maps.dose import Calibration, read_calibration

    if asked.calibration is None:
        return Calibration.straight(deepest)
    return read_calibration(Path(asked.calibration))


def _write_dose(job: Job) -> list[FileRecord]:
    """Write the levels of every structured face as PNG and BMP of 8 bits and PNG of 16 bits."""
    from clacad.formats.maps.dose import DoseMap
    from clacad.formats.maps.sag import height_maps
    from clacad.storage.atomic import canonical_json

    records: list[FileRecord] = []
    table: dict[str, Any] = {}
    for map_ in height_maps(job.window):
        label = map_.label
        depth = (map_.high - map_.low) * job.window.unit
        dose = DoseMap(map_, _calibration(job.request, depth))
        for kind, ending in DOSE_ENDINGS.items():
            path = job.stage.path(f"{job.stem}.{label}.{ending}")
            job.progress(f"write {path.name}", 0.0)
            facts = {"face": label, "calibration": dose.calibration.name, **dose.write(path)}
            records.append(job.record(path, kind, unit="level", bodies=[map_.body.name], facts=facts))
        table[label] = dose.to_dict(job.scale)
    path = job.stage.path(f"{job.stem}.dose.json")
    path.write_text(canonical_json({"format": 1, "faces": table}), encoding="utf-8", newline="\n")
    return [*records, job.record(path, DOSE_TABLE)]


def _require_dose(window: Window, asked: Request, _worker: Worker) -> None:
    """Require a calibration that can be read and covers the depths of all faces."""
    from clacad.formats.maps.sag import height_maps
    from clacad.storage.errors import BadRequest

    if asked.calibration is None:
        return
    for map_ in height_maps(window):
        depth = (map_.high - map_.low) * window.unit
        found = _calibration(asked, depth)
        deepest = float(found.depths[-1])
        if not (found.depths[0] <= 0.0 and depth <= deepest):
            raise BadRequest(
                f"dose: {map_.label} is {1e6 * depth:.6g} um deep; {found.name} covers"
                f" {1e6 * found.depths[0]:.6g} to {1e6 * deepest:.6g} um"
            )


def _forecast_dose(meshes: Meshes, _quads: int, _asked: Request) -> Forecast:
    from clacad.formats.maps.sag import samples_per_cell

    window, faces = meshes.window, structured_count(meshes.window)
    pixels = samples_per_cell(window) ** 2 * window.lattice.cell_count * faces
    return map_row(DOSE, int(1.6 * pixels) + 4000 * faces, BASE + DOSE_SECONDS * pixels)


def _dose_misfit(of: FaceFile) -> Misfit:
    """Compare a dose map with its face, by the table next to it."""
    from clacad.formats.maps.dose import dose_of

    worst, room, count = dose_of(of.map(), of.path).misfit(of.path)
    return worst, room, f"{count:,} levels of {of.label}"


def _dose_surface(of: FaceFile) -> Floats:
    """Points at the calibrated depths of a dose map."""
    import numpy as np

    from clacad.formats.maps.dose import dose_of

    map_ = of.map()
    height = map_.high - dose_of(map_, of.path).depths(of.path) / of.window.unit
    gx, gy = np.meshgrid(*map_.places(np.arange(map_.width), np.arange(map_.height)))
    return np.stack([gx.ravel(), gy.ravel(), (map_.reference - of.face.side * height).ravel()], axis=1)


def _dose_table(window: Window, path: Any) -> Misfit:
    """The table next to dose maps is what they are judged by; it must hold every face."""
    from clacad.formats.maps.dose import read_table
    from clacad.formats.maps.sag import structured_faces
    from clacad.storage.errors import UnreadableFile

    table = read_table(path)
    lacking = [label for _, _, label in structured_faces(window) if label not in table]
    if lacking:
        raise UnreadableFile(f"{path.name}: no calibration of {lacking[0]}")
    return 0.0, 0.0, f"calibrations of {len(table)} faces"


# -- coupon ----------------------------------------------------------------------------------------


def _write_wedge(job: Job) -> list[FileRecord]:
    """Write the coupon as a picture of levels and as its definition; it is the same for every design."""
    import numpy as np

    from clacad.formats.maps.dose import Coupon, read_levels
    from clacad.formats.maps.raster import write_png
    from clacad.storage.atomic import canonical_json
    from clacad.storage.errors import FileDisagrees

    coupon = Coupon()
    picture = coupon.picture(WEDGE_PIXEL).astype(np.uint16)
    path, told = job.stage.path(f"{job.stem}.wedge.png"), job.stage.path(f"{job.stem}.wedge.json")
    write_png([picture], path, picture.shape[1], picture.shape[0], 1.0 / WEDGE_PIXEL, 8)
    if not (read_levels(path) == picture).all():
        raise FileDisagrees(f"{path.name}: its levels are not those of the coupon")
    text = canonical_json(coupon.to_dict(WEDGE_PIXEL))
    told.write_text(text, encoding="utf-8", newline="\n")
    return [
        job.record(path, WEDGE_PICTURE, unit="level", bodies=()),
        job.record(told, WEDGE_TABLE, bodies=()),
    ]


DOSE_ENDINGS = {DOSE_8: "dose8.png", DOSE_BMP: "dose8.bmp", DOSE_16: "dose16.png"}

FORMATS = (
    Format(
        INSERT,
        "part",
        "insert of a mould for each face: STEP, STL and height map, over the shrinkage of the process",
        _write_insert,
        _forecast_insert,
        lambda sheet, _quads, _asked: INSERT_SECONDS * sheet.lenses + 5e-6 * 1500 * sheet.cells,
        _require_insert,
        tooling=True,
        commands=True,
        turned_arrays=True,
        kernel=True,
        stored=(EXACT_FACES,),
    ),
    Format(
        TOOL,
        "map",
        "points for a ball-nosed tool: surface, normal, centre of the nose, whether it reaches; CSV",
        _write_tool,
        _forecast_tool,
        drawn_cost(TOOL_SECONDS),
        _require_tool,
        tooling=True,
        commands=True,
        smaller="--tool-step, or --cells 50x50",
        stored=(AT_POINTS,),
    ),
    Format(
        DOSE,
        "map",
        "level of a writer for the depth of each face, by a calibration: PNG and BMP of 8 bits, PNG of 16",
        _write_dose,
        _forecast_dose,
        drawn_cost(DOSE_SECONDS),
        _require_dose,
        tooling=True,
        commands=True,
        stored=(SIXTEEN_BITS,),
    ),
    Format(
        WEDGE,
        "part",
        "coupon that calibrates a dose: 17 fields of one level each, PNG and JSON",
        _write_wedge,
        lambda _meshes, _quads, _asked: map_row(WEDGE, 3900, BASE),
        lambda _sheet, _quads, _asked: BASE,
        optical=False,
        stored=(NO_SURFACE,),
    ),
)


def _kind(word: str, *ends: str) -> FileKind:
    return FileKind(word, "map", ends, readings=__name__)


FILES = (
    _kind(INSERT_STEP),
    _kind(INSERT_STL),
    _kind(INSERT_MAP),
    _kind(TOOL_POINTS, ".tool.csv"),
    *(_kind(word, f".{ending}") for word, ending in DOSE_ENDINGS.items()),
    _kind(DOSE_TABLE, ".dose.json"),
    FileKind(WEDGE_PICTURE, "other"),
    FileKind(WEDGE_TABLE, "other"),
)

READINGS = {
    INSERT_STEP: Reading(_insert_misfit(_step_points), points=_step_points),
    INSERT_STL: Reading(
        _insert_misfit(_stl_points), points=_stl_points, facets=lambda of: _facets(of.path, of), room=1e-5
    ),
    INSERT_MAP: Reading(_insert_misfit(_insert_heights), points=_insert_heights),
    TOOL_POINTS: Reading(_tool_misfit, points=_tool_surface),
    **{word: Reading(_dose_misfit, points=_dose_surface) for word in DOSE_ENDINGS},
    DOSE_TABLE: Reading(sheet=_dose_table, unit=""),
}
"""Kind of file → its comparison with the design."""
