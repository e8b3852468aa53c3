"""Judge a measured part in the design's frame: a scan, a slicer's repair, a piece; noise is reported
separately.

Unlike a file to be made, such a mesh may be open, in pieces, cut anywhere, with facets across the borders of
cells.
The criteria are those of other files: the position of its faces, and the direction of light through them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.base.polygons import within
from clacad.base.types import Floats, Progress
from clacad.checks.check import Check, LimitSource, other
from clacad.checks.file_kinds import CLOSED, FAITHFUL_RMS, FILE_LAW_RMS, PIECES, SCALE, SHAPE, VOLUME
from clacad.exporting.formats.step import WORD as STEP
from clacad.exporting.roles import Role
from clacad.formats.mesh.measure import Measure, measure
from clacad.judging.cell_triangles import CellFacets, Gatherer, SideFacets
from clacad.judging.damage import SHOWN, find_dents, find_features
from clacad.judging.delivery import Inspection
from clacad.judging.deviation_map import OUTLIER, DeviationMap, Mapper, deviation_map
from clacad.judging.face_deviation import deviations
from clacad.judging.mesh_file import judge_mesh
from clacad.judging.mesh_light import MeshEvidence, checks_of_light, lit_cells
from clacad.judging.mesh_shape import clean_forecast, own_sag_error
from clacad.judging.mesh_wholeness import is_open_surface, rims
from clacad.sheet.volume_and_extent import whole_extent

if TYPE_CHECKING:
    from clacad.design import Design
    from clacad.judging.registration import Placed


SUSPECT = {SHAPE, VOLUME, PIECES, CLOSED, FAITHFUL_RMS, FILE_LAW_RMS}
"""Checks that fail where a part is damaged; a failure starts the search for damage."""

FEATURES = 4
"""Holes and steps that a sentence names; `detail` holds all of them."""

ON_FACES = 1e-5
"""Distance in pitches of the corners of a meshed STEP part from its faces, caused by registration."""


class Cutter(Gatherer):
    """A gatherer that cuts facets at the borders of the chosen cells, since facets of a scan cross them."""

    def _keep(self, body: int, side: int, array: int, some: SideFacets) -> None:
        corners = some.corners[some.rows]
        centres = self.window.centres(array, np.array(self.result.cells, dtype=np.int64))
        tile = self.window.lattice_of(array).tile()
        low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
        for cell, centre in enumerate(centres):
            near = (high > centre + tile.min(axis=0)).all(axis=1) & (low < centre + tile.max(axis=0)).all(
                axis=1
            )
            if near.any():
                cut = cut_to(corners[near], tile + centre)
                if len(cut):
                    self.result.facets.setdefault((body, side, cell), []).append(cut)

    def _hold(self, *_: Any) -> None:
        """Do nothing: the deviation map compares every cell with the design."""


def cut_to(corners: Floats, polygon: Floats) -> Floats:
    """Parts of facets (k, 3, 3) over a convex counter-clockwise polygon (m, 2), oriented as the facets."""
    inside = within(polygon, corners[..., 0], corners[..., 1]).all(axis=1)
    found = [corners[inside]]
    for facet in corners[~inside]:
        piece = _clipped(facet, polygon)
        if len(piece) >= 3:
            found.append(
                np.stack([np.stack([piece[0], piece[k], piece[k + 1]]) for k in range(1, len(piece) - 1)])
            )
    pieces = np.concatenate(found)
    (ax, ay), (bx, by) = ((pieces[:, k, :2] - pieces[:, 0, :2]).T for k in (1, 2))
    area = ax * by - ay * bx
    size = np.ptp(polygon, axis=0).max()
    return np.asarray(pieces[np.abs(area) > 1e-12 * size * size])  # slivers have no reliable slope


def _clipped(points: Floats, polygon: Floats) -> Floats:
    """A plane polygon in space (m, 3) clipped by vertical planes over the edges (Sutherland and Hodgman)."""
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if len(points) == 0:
            break
        edge = end - start
        side = edge[0] * (points[:, 1] - start[1]) - edge[1] * (points[:, 0] - start[0])
        kept = []
        for k in range(len(points)):
            here, there, a, b = points[k - 1], points[k], side[k - 1], side[k]
            if (a < 0.0) != (b < 0.0):
                kept.append(here + (there - here) * (a / (a - b)))
            if b >= 0.0:
                kept.append(there)
        points = np.array(kept) if kept else np.empty((0, 3))
    return points


def judge_placed(asked: Inspection, placed: Placed) -> tuple[list[Check], MeshEvidence]:
    """Judge a part without a manifest: to rounding where it lies as written, else as a measured part.

    The resulting role, that of a scan where the surface is open, is in the evidence's facts ("role").
    """
    if not placed.exact:
        found, evidence = judge_returned(asked, placed)
    else:
        as_written = replace(asked, stated={})
        found, evidence = judge_mesh(as_written, placed.window, placed.mesh, placed.factor, placed.present)
        evidence = replace(evidence, facts={**evidence.facts, "role": asked.role, "part": placed})
        failed = {check.kind for check in found if check.state == "fail"}
        if CLOSED in failed and _measured(placed, asked.role):
            found, evidence = judge_returned(asked, placed)
        elif failed & SUSPECT:
            found, evidence = _with_damage(asked.design, placed, found, evidence)
    return [*placed.checks, *found], evidence


def _measured(placed: Placed, role: Role) -> bool:
    """Whether an open mesh that lies as written is a measured surface."""
    return role is Role.SCAN or is_open_surface(rims(placed.mesh), placed.pose.turn)


def _with_damage(
    design: Design, placed: Placed, checks: list[Check], evidence: MeshEvidence
) -> tuple[list[Check], MeshEvidence]:
    """Add the damage of a part that was judged to rounding."""
    chunks, count = (chunk * placed.factor for chunk in placed.mesh.chunks()), placed.mesh.facet_count
    found = deviation_map(placed.window, design.unit, chunks, placed.present, count)
    gathered = evidence.gathered
    limit = design.check.shape * own_sag_error(gathered) if gathered is not None else 0.0
    mapped, told, detail = _damage(placed, found, limit)
    facts = {**evidence.facts, "deviation": mapped}
    if not told:
        return checks, replace(evidence, facts=facts)
    named = [
        (
            _with_failure(
                replace(c, sentence=f"{c.sentence}; {told}", detail={**c.detail, **detail}), mapped, limit
            )
            if c.kind is SHAPE
            else c
        )
        for c in checks
    ]
    return named, replace(evidence, facts=facts)


def _with_failure(check: Check, mapped: DeviationMap, limit: float) -> Check:
    """The check of shape, failed by dents or by holes and steps in cells, with their value and limit.

    A check that fails by its own value keeps it.

    limit : length. Allowed deviation of a sound face of the file.
    """
    lost = {tuple(cell) for feature in check.detail["features"] for cell in feature["cells"]}
    if check.state == "fail" or not (lost or check.detail["dents"]):
        return check
    if check.detail["dents"]:
        value, most = mapped.worst_cell(limit)
        source = other(f"{OUTLIER:g} × the median cell, and what facets of this size give")
        return replace(check, state="fail", value=value, limit=most, limit_source=source)
    source = other("no cell may lose its face")
    return replace(check, state="fail", value=float(len(lost)), limit=0.0, unit="cells", limit_source=source)


def _damage(placed: Placed, mapped: DeviationMap, limit: float) -> tuple[DeviationMap, str, dict[str, Any]]:
    """Map with its dents, text of the damage ("" for none), and its numbers."""
    window = placed.window
    bad = mapped.damaged(limit)
    worst = sorted(bad, key=lambda one: -_peak(mapped, one))[:SHOWN]
    dents = (
        find_dents(window, placed.mesh, placed.factor, placed.present, worst, placed.pose.residual)
        if worst
        else []
    )
    features = find_features(window, placed.mesh, placed.factor, placed.present, placed.pose.residual)
    mapped = replace(mapped, dents=tuple(dents))
    cells = sorted({cell for _, cell in bad})
    told = [f.words(mapped.unit, window.unit) for f in features[:FEATURES]]
    if len(features) > FEATURES:
        told.append(f"{len(features) - FEATURES} more holes and steps")
    if dents:
        told.append(
            f"{len(cells)} cell{'s are' if len(cells) > 1 else ' is'} off by "
            f"{'themselves' if len(cells) > 1 else 'itself'}; worst: {dents[0].words(window.unit)}"
        )
    detail = {
        "damaged": [list(cell) for cell in cells[:SHOWN]],
        "dents": [dent.to_dict(window.unit) for dent in dents],
        "features": [feature.to_dict(window.unit) for feature in features],
    }
    return mapped, "; ".join(told), detail


def _peak(mapped: DeviationMap, one: tuple[int, tuple[int, int]]) -> float:
    face = next(f for f in mapped.faces if f.number == one[0])
    return float(face.peaks[one[1][0] - mapped.first[0], one[1][1] - mapped.first[1]])


def judge_returned(asked: Inspection, placed: Placed) -> tuple[list[Check], MeshEvidence]:
    """Measure a registered part in one pass and judge it.

    `asked` : An open surface is judged as a scan regardless of its stated role.
    placed : The part, registered.
    """
    design, window = asked.design, placed.window
    present = None if len(placed.present) == len(window.bodies) else placed.present
    cutter = Cutter(window, lit_cells(window, design.check.field))
    mapper = Mapper(window, design.unit, placed.present, placed.mesh.facet_count, placed.pose.residual)
    found = measure(_looked_at(placed, (cutter, mapper), asked.progress), origin=np.zeros(3))
    gathered = cutter.result
    closed, role = _closed(placed, found, asked)
    shape, mapped = _shape(asked, gathered, mapper.result(), placed)
    off = deviations(window, gathered, present)
    dark = [str(c) for c, d in zip(gathered.cells, off, strict=True) if not d.complete]
    if dark and len(dark) < len(off):  # holes in some cells: light is judged where there are faces
        kept = [k for k, d in enumerate(off) if d.complete]
        gathered, off = _only(gathered, kept), [off[k] for k in kept]
    clean = np.inf if role is Role.SCAN else clean_forecast(window, gathered, 0, present)
    light, evidence = checks_of_light(
        replace(asked, role=role),
        window,
        gathered,
        off,
        found,
        present,
        clean if np.isfinite(clean) else np.inf,
    )
    if dark:
        light = [_with_holes(check, dark, len(cutter.result.cells)) for check in light]
    facts = {**evidence.facts, "deviation": mapped, "part": placed, "role": role}
    facts["noise"] = float(np.nanmax(evidence.forecast)) if np.isfinite(evidence.forecast).any() else 0.0
    return [closed, _scale(asked, placed), shape, *light], replace(evidence, facts=facts)


def _looked_at(placed: Placed, watchers: tuple[Gatherer, Mapper], progress: Progress) -> Iterator[Floats]:
    total, done = max(1, placed.mesh.facet_count), 0
    for chunk in placed.mesh.chunks():
        corners = chunk * placed.factor
        for watcher in watchers:
            watcher.look(corners)
        done += len(corners)
        progress("reading triangles", done / total)
        yield corners


def _only(gathered: CellFacets, kept: list[int]) -> CellFacets:
    """Copy with some of the chosen cells only."""
    facets = {
        (body, side, kept.index(cell)): parts
        for (body, side, cell), parts in gathered.facets.items()
        if cell in kept
    }
    return replace(gathered, cells=tuple(gathered.cells[k] for k in kept), facets=facets)


def _with_holes(check: Check, dark: list[str], total: int) -> Check:
    if check.kind is not FAITHFUL_RMS:
        return check
    return replace(
        check,
        sentence=f"{check.sentence}; {len(dark)} of {total} cells have holes and were left out:"
        f" {', '.join(dark[:4])}",
    )


def _closed(placed: Placed, found: Measure, asked: Inspection) -> tuple[Check, Role]:
    """Judge whether the surface is closed, which a scan need not be; with the resulting role."""
    role, common = asked.role, {"limit": 0.0, **asked.common}
    if found.facets == 0:
        return CLOSED.check("fail", "the file holds no triangles", **common), role
    rim = None if found.closed else rims(placed.mesh if placed.file is None else placed.file)
    if rim is None or rim.count == 0:  # the file is closed: moving it separated equal corners
        sentence = f"every edge of {found.facets} facets is met once in each direction"
        return CLOSED.check("pass", sentence, 0.0, **common), role
    if role is Role.SCAN or is_open_surface(rim, placed.pose.turn):
        sentence = (
            "the surface is open or not one mesh: it can be measured, as a scan is, but not made from "
            f"({rim.count} edges have no partner)"
        )
        return CLOSED.check("warn", sentence, float(rim.count), required=False, **common), Role.SCAN
    sentence = (
        f"the surface is not closed or not consistently wound: {rim.count} edges of {found.facets} facets"
        f" have no partner, one at ({rim.at}) in file units; a scan would be open all along its rim"
    )
    return CLOSED.check("fail", sentence, float(rim.count), **common), role


def _scale(asked: Inspection, placed: Placed) -> Check:
    scale = placed.pose.scale
    sentence = f"the part is {scale:.6g} times as large as the design, as its faces fit best"
    if scale != 1.0:
        sentence += "; everything below is judged at the design's size"
    limit, detail = asked.design.check.scale, {"scale": scale}
    return SCALE.judge(abs(scale - 1.0), limit, sentence, detail=detail, **asked.common)


def _shape(
    asked: Inspection, gathered: CellFacets, mapped: DeviationMap, placed: Placed
) -> tuple[Check, DeviationMap]:
    """Judge systematic deviation of the faces without noise; holes, steps, and locally deviating cells."""
    design = asked.design
    common: dict[str, Any] = {"unit": design.unit, **asked.common}
    systematic = [face.systematic for face in mapped.faces]
    if not systematic or not np.isfinite(systematic).all():
        return SHAPE.not_run("too few corners lie where the design has its faces", **common), mapped
    worst = mapped.faces[int(np.argmax(systematic))]
    step = rounding_step(placed) * placed.pose.factor
    limit, source = _shape_limit(design, gathered, placed, step)
    noise = max(face.noise for face in mapped.faces)
    mapped, damage, more = _damage(placed, mapped, limit)
    sentence = (
        f"averaged over its cells {worst.name} lies up to {worst.systematic:.3g} {design.unit} off the exact"
        f" face (rms {worst.rms:.3g}); single corners scatter by {noise:.3g}"
    )
    if step:
        sentence += f"; its numbers were rounded to {step:.3g}"
    if damage:
        sentence += f"; {damage}"
    common |= {
        "limit_source": source,
        "detail": {
            "systematic": systematic,
            "noise": noise,
            "rms": [face.rms for face in mapped.faces],
            **more,
        },
    }
    check = SHAPE.judge(worst.systematic, limit, sentence, **common)
    return _with_failure(check, mapped, limit), mapped


def _shape_limit(
    design: Design, gathered: CellFacets, placed: Placed, step: float
) -> tuple[float, LimitSource]:
    """Allowed deviation of faces (length): unavoidable error of facets, and rounding to `step` (length)."""
    pitch = max(placed.window.lattice.pitch)
    if placed.mesh.format == STEP:  # corners of its facets lie on its faces, to float32
        reach = max(abs(v) for v in (*whole_extent(placed.window), *placed.window.z_range))
        return ON_FACES * pitch + 2.0**-22 * reach, other("corners on exact faces")
    limit = design.check.shape * own_sag_error(gathered) + 1e-6 * pitch + 0.6 * step
    return limit, other("what facets of this size and bend give")


def rounding_step(placed: Placed) -> float:
    """Largest power of ten that divides a file's heights, in its unit; 0 where only float32 rounding is
    found.

    Rounding moves one place of every cell alike, so it does not average out as noise does.
    """
    part = placed.mesh.parts[0]
    upright = int(np.argmax(np.abs(placed.pose.axes[2])))  # the file's axis across the sheet
    corners = part.corners(0, part.facet_count)[:: max(1, part.facet_count // 4096), :, upright].ravel()
    corners = corners[
        np.abs(corners) > 0.5 * np.abs(corners).max()
    ]  # significant digits: the largest are coarsest
    found = 0.0
    for exponent in range(-7, 2):
        count = corners / 10.0**exponent
        room = 0.01 + np.abs(count) * 2.0**-23
        if (room > 0.2).any():
            continue  # finer than float32 resolves
        if np.mean(np.abs(count - np.round(count)) <= room) < 0.99:
            break
        found = float(10.0**exponent)
    return found
