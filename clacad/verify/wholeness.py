"""Is a mesh file whole: closed, in as many pieces as designed, and as large?"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from clacad.export.closed import Measure, crowded_edges
from clacad.export.filemesh import FileMesh, Part
from clacad.export.truth import whole_extent
from clacad.feasibility import body_facts, components
from clacad.sheet import Window
from clacad.trace.facets import Floats
from clacad.verify.checks import Check, State, judge, not_run
from clacad.verify.gather import Gathered

if TYPE_CHECKING:
    from clacad.design import Design

COUNTED_FACETS = 3_000_000
"""Facets up to which edges, pieces and holes are counted one by one; beyond it closedness alone is proven."""


def closed_check(found: Measure, gathered: Gathered, mesh: FileMesh, name: str) -> Check:
    """Judge whether the surface is closed and consistently wound; where it is not, say where."""
    common: dict[str, Any] = {"where": "file", "subject": name, "limit": 0.0}
    if found.facets == 0:
        return Check("closed", "fail", "the file holds no triangles", **common)
    facts = {"facets": found.facets, "walls": gathered.walls, "degenerate": gathered.degenerate}
    if found.closed:
        sentence = f"every edge of {found.facets} facets is met once in each direction"
        if found.facets <= COUNTED_FACETS:
            crowded = sum(crowded_edges(part.corners(0, part.facet_count)) for part in mesh.parts)
            facts["crowded_edges"] = crowded
            if crowded:
                sentence += (
                    f"; {crowded} edges are shared by four facets, where steps of both signs meet in a corner"
                )
        return Check("closed", "pass", sentence, 0.0, detail=facts, **common)
    sentence = "the surface is not closed or not consistently wound"
    value = None
    if found.facets <= COUNTED_FACETS:
        value, place = _open_edges(np.concatenate(list(mesh.chunks())))
        at = ", ".join(f"{v:.6g}" for v in place)
        sentence += f": {value} edges have no partner, one at ({at}) in file units"
    return Check("closed", "fail", sentence, value, detail=facts, **common)


def _welded(corners: Floats) -> tuple[Floats, np.ndarray[Any, np.dtype[np.int64]]]:
    """Vertices that agree in all bits made one: (v, 3) and facets (t, 3)."""
    words = np.ascontiguousarray(corners.reshape(-1, 3) + 0.0).view([("", np.uint64, 3)]).ravel()
    unique, index = np.unique(words, return_inverse=True)
    return unique.view(np.float64).reshape(-1, 3), index.reshape(-1, 3).astype(np.int64)


def _open_edges(corners: Floats) -> tuple[int, Floats]:
    """Count directed edges without a partner, and give the middle of one."""
    vertices, facets = _welded(corners)
    start = facets.ravel()
    end = np.roll(facets, -1, axis=1).ravel()
    size = np.int64(len(vertices))
    forward, times = np.unique(start * size + end, return_counts=True)
    backward, answers = np.unique(end * size + start, return_counts=True)
    both = np.concatenate([forward, backward])
    sign = np.concatenate([times, -answers])
    keys, place = np.unique(both, return_inverse=True)
    balance = np.bincount(place, weights=sign)
    open_keys = keys[balance != 0]
    if not len(open_keys):
        return 0, np.zeros(3)
    a, b = divmod(int(open_keys[0]), int(size))
    # an unmatched edge shows once from each of its ends
    return int(np.abs(balance).sum() / 2), 0.5 * (vertices[a] + vertices[b])


def pieces_check(
    window: Window, found: Measure, mesh: FileMesh, name: str, stated: Mapping[str, Any]
) -> list[Check]:
    """Count connected pieces and holes of the file itself."""
    common: dict[str, Any] = {"where": "file", "subject": name, "relation": "=", "required": False}
    if found.facets > COUNTED_FACETS or found.facets == 0:
        why = f"{found.facets} facets: pieces are counted up to {COUNTED_FACETS}; one_piece says what the design gives"
        return [not_run("pieces", why, **common)]
    bodies = [body_facts(window, body) for body in window.bodies]
    expected = {sum(b.pieces for b in bodies), len(bodies) * window.lattice.cell_count}
    if "solids" in stated:
        expected = {int(stated["solids"])}
    counts = [_counted(part) for part in mesh.parts]
    pieces, holes = (sum(count[k] for count in counts) for k in (0, 1))
    wanted = " or ".join(str(n) for n in sorted(expected))
    sentence = f"{pieces} connected pieces with {holes:g} holes; {wanted} pieces are expected"
    state: State = "pass" if pieces in expected else "fail"
    return [Check("pieces", state, sentence, float(pieces), wanted, detail={"holes": holes}, **common)]


def _counted(part: Part) -> tuple[int, float]:
    """Pieces and holes of a part; one that stands at several places is counted at each (its copies may touch)."""
    vertices, facets = _welded(part.corners(0, part.facet_count))
    pieces = components(len(vertices), facets[:, [0, 0]].T.ravel(), facets[:, [1, 2]].T.ravel())
    edges = np.sort(np.concatenate([facets[:, [0, 1]], facets[:, [1, 2]], facets[:, [2, 0]]]), axis=1)
    count = len(np.unique(edges[:, 0] * np.int64(len(vertices)) + edges[:, 1]))
    euler = len(vertices) - count + len(facets)
    times = len(part.placements)
    return pieces * times, (pieces - euler / 2) * times


def scale_check(design: Design, window: Window, found: Measure, name: str) -> Check:
    """Compare the file's extent with the design's, axis by axis."""
    x0, x1, y0, y1 = whole_extent(window)
    z0, z1 = window.z_range
    want = np.array([x1 - x0, y1 - y0, z1 - z0])
    got = np.subtract(found.high, found.low)
    ratio = got / want
    if not np.isfinite(ratio).all() or found.facets == 0:
        return not_run("scale", "the file has no extent", where="file", subject=name)
    # x and y alone tell a uniform shrink; facets cut a little off the top of a lens in z
    lateral = ratio[:2]
    value = float(np.abs(lateral - 1.0).max())
    sentence = "extent over the design's: " + ", ".join(
        f"{axis} {r:.6g}" for axis, r in zip("xyz", ratio, strict=True)
    )
    return judge(
        "scale", value, design.check.scale, sentence, unit="relative", where="file", subject=name,
        detail={"ratio": ratio},
    )  # fmt: skip
