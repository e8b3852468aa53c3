"""Judge a part that came back: a scan, a slicer's repair, a piece; in the design's frame, noise stated apart.

What such a mesh may be, a file to be made may not: open, in pieces, cut anywhere, facets across the borders of
cells. What counts is the same: where its faces lie, and where they send light.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.export.closed import measure
from clacad.export.truth import whole_extent
from clacad.verify.checks import Check, judge, not_run
from clacad.verify.deviation import FEWER, POINTS, deviation
from clacad.verify.deviationmap import DeviationMap, Mapper
from clacad.trace.facets import Floats
from clacad.verify.gather import Gathered, Gatherer, Progress, chosen_cells, telescopelet
from clacad.verify.meshfile import judge_mesh
from clacad.verify.meshlight import MeshEvidence, light_checks
from clacad.verify.meshshape import own_sag_error
from clacad.verify.registration import Placed

if TYPE_CHECKING:
    from clacad.design import Design

ON_FACES = 1e-5
"""Pitches that the corners of a meshed STEP part may lie off: what registration leaves."""

OUTLIER = 3.0
"""A cell is damaged if its rms deviation exceeds this many times the usual one and the limit besides."""


class Cutter(Gatherer):
    """A gatherer that cuts facets at the borders of the chosen cells: a scan's run across them."""

    def _keep(self, body: int, side: int, array: int, corners: Floats, middle: Floats) -> None:
        centres = self.window.lattice.centres(np.array(self.result.cells, dtype=np.int64))
        tile = self.window.lattice.tile()
        shift = np.asarray(self.window.shifts[array])
        low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
        for cell, centre in enumerate(centres + shift):
            near = (high > centre + tile.min(axis=0)).all(axis=1) & (low < centre + tile.max(axis=0)).all(
                axis=1
            )
            if near.any():
                cut = cut_to(corners[near], tile + centre)
                if len(cut):
                    self.result.facets.setdefault((body, side, cell), []).append(cut)

    def _hold(self, *_: Any) -> None:
        """Every cell is held against the design by the deviation map."""


def cut_to(corners: Floats, polygon: Floats) -> Floats:
    """Parts of facets (k, 3, 3) over a convex counter-clockwise polygon (m, 2), as facets of the same sense."""
    inside = np.ones(len(corners), dtype=bool)
    for start, end in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        edge = end - start
        side = edge[0] * (corners[..., 1] - start[1]) - edge[1] * (corners[..., 0] - start[0])
        inside &= (side >= 0.0).all(axis=1)
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
    return np.asarray(pieces[np.abs(area) > 1e-12 * size * size])  # slivers have no slope to speak of


def _clipped(points: Floats, polygon: Floats) -> Floats:
    """A plane polygon in space (m, 3) cut by vertical planes over the edges (Sutherland and Hodgman)."""
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


def judge_placed(
    design: Design, placed: Placed, name: str, rays: int, progress: Progress
) -> tuple[list[Check], MeshEvidence]:
    """Judge a part that came without a manifest: to rounding where it lies as written, else as what came back."""
    if not placed.exact:
        found, evidence = judge_returned(design, placed, name, rays, progress)
    else:
        found, evidence = judge_mesh(
            design, placed.window, placed.mesh, placed.factor, name, {}, rays, progress, placed.present
        )
    return [*placed.checks, *found], evidence


def judge_returned(
    design: Design, placed: Placed, name: str, rays: int, progress: Progress
) -> tuple[list[Check], MeshEvidence]:
    """Measure a returned part in one pass and judge it.

    Parameters
    ----------
    design : Design
    placed : Placed
        The part, registered.
    name : str
        File name, the subject of the checks.
    rays : int
    progress : callable
        (stage, done 0 … 1).
    """
    window = placed.window
    present = None if len(placed.present) == len(window.bodies) else placed.present
    cutter = Cutter(window, chosen_cells(window))
    mapper = Mapper(window, design.unit, placed.present, placed.mesh.facet_count, placed.pose.residual)
    found = measure(_looked_at(placed, (cutter, mapper), progress), origin=np.zeros(3))
    gathered, mapped = cutter.result, mapper.result()
    checks = [_closed(found.closed, found.facets, name), _scale(design, placed, name)]
    checks.append(_shape(design, gathered, mapped, placed, name))
    off = [
        deviation(window, telescopelet(window, gathered, k, present), FEWER if k else POINTS)
        for k in range(len(gathered.cells))
    ]
    dark = [str(c) for c, d in zip(gathered.cells, off, strict=True) if not d.complete]
    if dark and len(dark) < len(off):  # holes in some cells: light is judged where there is a face
        kept = [k for k, d in enumerate(off) if d.complete]
        gathered, off = _only(gathered, kept), [off[k] for k in kept]
    light, evidence = light_checks(design, window, gathered, off, found, name, rays, progress, present)
    if dark:
        light = [_with_holes(check, dark, len(cutter.result.cells)) for check in light]
    facts = {**evidence.facts, "deviation": mapped, "pose": placed.pose}
    return checks + light, replace(evidence, facts=facts)


def _looked_at(placed: Placed, watchers: tuple[Gatherer, Mapper], progress: Progress) -> Iterator[Floats]:
    total, done = max(1, placed.mesh.facet_count), 0
    for chunk in placed.mesh.chunks():
        corners = chunk * placed.factor
        for watcher in watchers:
            watcher.look(corners)
        done += len(corners)
        progress("reading triangles", done / total)
        yield corners


def _only(gathered: Gathered, kept: list[int]) -> Gathered:
    """The same with some of the chosen cells only."""
    facets = {
        (body, side, kept.index(cell)): parts
        for (body, side, cell), parts in gathered.facets.items()
        if cell in kept
    }
    return replace(gathered, cells=tuple(gathered.cells[k] for k in kept), facets=facets)


def _with_holes(check: Check, dark: list[str], total: int) -> Check:
    if check.id != "faithful_rms":
        return check
    return replace(
        check,
        sentence=f"{check.sentence}; {len(dark)} of {total} cells have holes and were left out: {', '.join(dark[:4])}",
    )


def _closed(closed: bool, facets: int, name: str) -> Check:
    common: dict[str, Any] = {"where": "file", "subject": name, "required": False}
    if facets == 0:
        return Check("closed", "fail", "the file holds no triangles", **common)
    if closed:
        return Check(
            "closed",
            "pass",
            f"every edge of {facets} facets is met once in each direction",
            0.0,
            0.0,
            **common,
        )
    return Check(
        "closed", "warn", "the surface is open or not one mesh: it can be measured, as a scan is, but not made from",
        **common,
    )  # fmt: skip


def _scale(design: Design, placed: Placed, name: str) -> Check:
    scale = placed.pose.scale
    sentence = f"the part is {scale:.6g} times as large as the design, as its faces fit best"
    if scale != 1.0:
        sentence += "; everything below is judged at the design's size"
    return judge(
        "scale", abs(scale - 1.0), design.check.scale, sentence, unit="relative", where="file", subject=name,
        detail={"scale": scale},
    )  # fmt: skip


def _shape(design: Design, gathered: Gathered, mapped: DeviationMap, placed: Placed, name: str) -> Check:
    """Systematic deviation of the faces, noise apart; and cells that are off by themselves."""
    common: dict[str, Any] = {"where": "file", "subject": name, "unit": design.unit}
    systematic = [face.systematic for face in mapped.faces]
    if not systematic or not np.isfinite(systematic).all():
        return not_run("shape", "too few corners lie where the design has its faces", **common)
    worst = mapped.faces[int(np.argmax(systematic))]
    rounding = 1e-6 * max(placed.window.lattice.pitch)
    step = rounding_step(placed) * placed.pose.factor
    limit = design.check.shape * own_sag_error(gathered) + rounding + 0.6 * step
    source = "what facets of this size and bend give"
    if placed.mesh.format == "step":  # corners of its facets lie on its faces, to float32
        reach = max(abs(v) for v in (*whole_extent(placed.window), *placed.window.z_range))
        limit, source = (
            ON_FACES * max(placed.window.lattice.pitch) + 2.0**-22 * reach,
            "corners on exact faces",
        )
    noise = max(face.noise for face in mapped.faces)
    damaged = _damaged(mapped, limit)
    detail = {
        "systematic": systematic, "noise": noise, "rms": [face.rms for face in mapped.faces],
        "damaged": [list(cell) for cell in damaged[:64]],
    }  # fmt: skip
    sentence = (
        f"averaged over its cells {worst.name} lies up to {worst.systematic:.3g} {design.unit} off the exact face "
        f"(rms {worst.rms:.3g}); single corners scatter by {noise:.3g}"
    )
    if step:
        sentence += f"; its numbers were rounded to {step:.3g}"
    if damaged:
        sentence += f"; {len(damaged)} cells are off by themselves, such as {damaged[0]}"
        return Check("shape", "fail", sentence, worst.systematic, limit, detail=detail,
                     source=source, **common)  # fmt: skip
    return judge(
        "shape",
        worst.systematic,
        limit,
        sentence,
        detail=detail,
        source=source,
        **common,
    )


def rounding_step(placed: Placed) -> float:
    """Largest power of ten that a file's heights are multiples of, in its unit; 0 where float32 is all there is.

    Rounding moves the same places of all cells alike, so it does not average out as noise does.
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
            continue  # finer than float32 tells
        if np.mean(np.abs(count - np.round(count)) <= room) < 0.99:
            break
        found = float(10.0**exponent)
    return found


def _damaged(mapped: DeviationMap, limit: float) -> list[tuple[int, int]]:
    """Cells (numbered from the corner of the part) whose rms deviation stands out from their like."""
    found: set[tuple[int, int]] = set()
    for face in mapped.faces:
        known = np.isfinite(face.cells)
        if known.sum() < 4:
            continue
        usual = float(np.median(face.cells[known]))
        with np.errstate(invalid="ignore"):
            bad = face.cells > OUTLIER * usual + limit
        found |= {(int(i), int(j)) for i, j in np.argwhere(bad)}
    return sorted(found)
