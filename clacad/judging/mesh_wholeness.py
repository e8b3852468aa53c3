"""Wholeness of a mesh file: closed, with the designed pieces and size; or an open measured surface."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.arrays import components, distinct, welded
from clacad.base.text import count_text
from clacad.base.types import Floats
from clacad.checks.check import Check, State
from clacad.checks.file_kinds import CLOSED, PIECES, SCALE
from clacad.formats.mesh.file_mesh import CHUNK, FileMesh, Part
from clacad.formats.mesh.measure import Measure, crowded_edges, edge_times, vertex_hashes
from clacad.judging.cell_triangles import CellFacets
from clacad.sheet.face_order import plates_of
from clacad.sheet.feasibility import body_facts, body_range
from clacad.sheet.volume_and_extent import whole_extent
from clacad.sheet.window import Window

if TYPE_CHECKING:
    from clacad.design import Design


COUNTED_FACETS = 1_000_000
"""Facets up to which vertices are welded and edges and holes counted (0.4 GB per million); larger files are
streamed."""

COUNTED_PIECES = 30_000_000
"""Facets in a file up to which connected pieces are counted: 0.2 s and 20 MB per million."""

FULL = 0.6
"""Largest used share of a hash table."""


def holding(mesh: FileMesh, shells: int | None) -> dict[str, Any]:
    """Contents of a mesh file for a workshop: `words`, and the numbers in them.

    shells : Closed surfaces with every instance counted; None where they were not counted.
    """
    objects, places = len(mesh.parts), sum(len(part.places) for part in mesh.parts)
    if places > objects:
        words = f"{places:,} instances of {count_text(objects, 'object', 'd')}"
    else:
        words = f"{count_text(objects, 'object', 'd')}"
    if shells is not None and shells != places:
        words += f", {count_text(shells, 'closed shell', ',')}"
    words += f", {mesh.facet_count:,} facets"
    if mesh.stored_count != mesh.facet_count:
        words += f" ({mesh.stored_count:,} in the file)"
    return {
        "words": words,
        "objects": objects,
        "placements": places,
        "shells": shells,
        "facets": mesh.facet_count,
        "facets_stored": mesh.stored_count,
    }


@dataclass(frozen=True, slots=True)
class PartCount:
    """Counts of a part at all of its places (its copies may touch), and at one of them.

    pieces : Connected pieces, at all places.
    holes : Half the sum of the missing Euler numbers, at all places.
    crowded : Edges shared by a number of facets other than two, at one place.
    """

    pieces: int
    holes: float
    crowded: int

    @classmethod
    def of(cls, part: Part) -> PartCount:
        """Count a part that fits in memory."""
        vertices, facets = part.welded()
        pieces = len(distinct(components(len(vertices), facets[:, [0, 1, 0, 2]].reshape(-1, 2))))
        edges, times = edge_times(facets), len(part.places)
        euler = len(vertices) - len(edges) + len(facets)
        return cls(pieces * times, (pieces - euler / 2) * times, crowded_edges(edges))


def part_counts(mesh: FileMesh) -> list[PartCount] | None:
    """Counts of every part; None for a file with more than `COUNTED_FACETS` facets."""
    return [PartCount.of(part) for part in mesh.parts] if mesh.stored_count <= COUNTED_FACETS else None


def closed_check(
    found: Measure,
    gathered: CellFacets,
    mesh: FileMesh,
    name: str,
    holds: Mapping[str, Any],
    counts: Sequence[PartCount] | None,
    window: Window,
) -> Check:
    """Judge whether the surface is closed and consistently wound, and locate a fault.

    holds : from `holding`, goes into the check's detail
    counts : from `part_counts`
    """
    common: dict[str, Any] = {"where": "file", "subject": name, "limit": 0.0}
    if found.facets == 0:
        return CLOSED.check("fail", "the file holds no triangles", **common)
    facts: dict[str, Any] = {"facets": found.facets, "walls": gathered.walls}
    facts |= {"degenerate": gathered.degenerate, "holds": dict(holds)}
    if found.closed:
        sentence = f"every edge of {found.facets} facets is met once in each direction"
        if counts is not None:
            crowded = sum(count.crowded for count in counts)
            facts["crowded_edges"] = crowded
            if crowded:
                where = "where steps of both signs meet in a corner"
                if len(plates_of(window.bodies)) < len(window.bodies):
                    where = "on joints, which two bodies share, or where steps meet"
                sentence += f"; {crowded} edges are shared by four facets, {where}"
        return CLOSED.check("pass", sentence, 0.0, detail=facts, **common)
    sentence = "the surface is not closed or not consistently wound"
    value = None
    if found.facets > COUNTED_FACETS >= mesh.stored_count:
        worst = max(map(rims, mesh.parts), key=lambda one: one.count)
        value = worst.count
        sentence += f": {value} edges of one instance have no partner, one at ({worst.at}) in its own frame"
    elif found.facets <= COUNTED_FACETS:
        worst = rims(mesh)
        value = worst.count
        sentence += f": {value} edges have no partner, one at ({worst.at}) in file units"
    return CLOSED.check("fail", sentence, value, detail=facts, **common)


def pieces_check(
    window: Window,
    found: Measure,
    mesh: FileMesh,
    name: str,
    stated: Mapping[str, Any],
    counts: Sequence[PartCount] | None,
    counted: PieceCount | None = None,
    wrong: Sequence[str] = (),
) -> list[Check]:
    """Judge the number of connected pieces and holes of a file; `counted` while measuring facets.

    wrong : from `misnamed`
    """
    common: dict[str, Any] = {"where": "file", "subject": name, "relation": "=", "required": False}
    if found.facets == 0:
        return [PIECES.not_run("the file holds no triangles", **common)]
    if mesh.stored_count > COUNTED_PIECES and wrong:
        return [PIECES.check("fail", "; ".join(wrong), **common)]
    if mesh.stored_count > COUNTED_PIECES:
        why = (
            f"not counted and not required: {mesh.stored_count} facets in the file, and pieces are counted up"
            f" to {COUNTED_PIECES}; one_piece says what the design gives"
        )
        return [PIECES.not_run(why, **common)]
    bodies = [body_facts(window, body) for body in window.bodies]
    expected = {sum(b.pieces for b in bodies), len(bodies) * window.lattice.cell_count}
    fused = len(plates_of(window.bodies)) < len(window.bodies) and len(mesh.parts) < len(bodies)
    if fused:  # facets of a joint have the same corners
        facts = iter(bodies)
        expected = {sum(min(next(facts).pieces for _ in plate) for plate in plates_of(window.bodies))}
    if "solids" in stated:
        expected = {int(stated["solids"])}
    wanted = " or ".join(str(n) for n in sorted(expected))
    holes: float | None = None
    if counts is not None:
        pieces, holes = sum(count.pieces for count in counts), sum(count.holes for count in counts)
        sentence = (
            f"{count_text(pieces, 'connected piece')} with {count_text(holes, 'hole')}; {wanted} expected"
        )
        if fused:
            sentence, holes = f"{count_text(pieces, 'connected piece')}; {wanted} expected", None
    else:
        pieces = counted.pieces if counted else sum(connected(p) * len(p.places) for p in mesh.parts)
        sentence = f"{count_text(pieces, 'connected piece')}; {wanted} expected"
    state: State = "pass" if pieces in expected and not wrong else "fail"
    sentence = "; ".join([sentence, *wrong])
    return [PIECES.check(state, sentence, float(pieces), wanted, detail={"holes": holes}, **common)]


def misnamed(window: Window, named: Iterable[tuple[str, str]], what: str) -> list[str]:
    """Sentences on things of a file with the name of a body of another medium.

    named : name in the file, and name of the body of the design that lies there
    what : word for one of them
    """
    index, wrong = {body.name: body.index for body in window.bodies}, []
    for name, body in named:
        said = max((one for one in index if name.startswith(one)), key=len, default=body)
        if index[said] != index[body]:
            wrong.append(f"the {what} named {name} lies where the design has {body}")
    return wrong


def named_objects(window: Window, mesh: FileMesh, factor: float) -> Iterator[tuple[str, str]]:
    """Name of each object that begins with that of a body, and name of the body with the nearest heights."""
    bodies = {body.name: np.array(body_range(window, body)) for body in window.bodies}
    for part in mesh.parts:
        if len({body.index for body in window.bodies}) > 1 and part.name.startswith(tuple(bodies)):
            points = part.corners(0, part.facet_count) if part.vertices is None else part.vertices[:]
            place = part.placed_at(np.zeros(1, dtype=np.int64))[0, :, 2]
            z = points @ place[:3] + place[3]
            own = factor * np.array([z.min(), z.max()])
            yield part.name, min(bodies, key=lambda name: float(np.abs(bodies[name] - own).max()))


def connected(part: Part) -> int:
    """Connected pieces of a part at one of its places, in one pass."""
    count = PieceCount(part.facet_count)
    for start in range(0, part.facet_count, CHUNK):
        count.add(part.corners(start, start + CHUNK))
    return count.pieces


class PieceCount:
    """Connected pieces of a stream of triangles; corners are one vertex where their hashes agree.

    The hash table is sized for a closed surface of `facets` facets, which has half as many vertices; it
    grows for more.
    """

    def __init__(self, facets: int) -> None:
        expected = facets // 2 + 3 * min(facets, CHUNK)
        size = 1 << max(16, int(expected / FULL).bit_length())
        self._table, self._number = np.zeros(size, dtype=np.uint64), np.zeros(size, dtype=np.int32)
        self._parent = np.zeros(expected, dtype=np.int32)
        self._vertices = self._joins = 0

    @property
    def pieces(self) -> int:
        """Number of pieces among the facets added."""
        return self._vertices - self._joins

    def add(self, corners: Floats) -> None:
        """Add facets (k, 3, 3)."""
        from clacad.formats.mesh.compiled_measure import join, rehash

        keys = vertex_hashes(corners)
        most = self._vertices + keys.size
        while most > FULL * len(self._table):
            size = 2 * len(self._table)
            larger = np.zeros(size, dtype=np.uint64), np.zeros(size, dtype=np.int32)
            rehash(self._table, self._number, *larger)
            self._table, self._number = larger
        if most > len(self._parent):
            more = np.zeros(max(len(self._parent), keys.size), dtype=np.int32)
            self._parent = np.concatenate([self._parent, more])
        self._vertices, joins = join(keys, self._table, self._number, self._parent, self._vertices)
        self._joins += joins


def counted_on_the_way(mesh: FileMesh) -> PieceCount | None:
    """Counter of a file's pieces for use while its facets are measured; None where that is not needed."""
    one = len(mesh.parts) == 1 and not mesh.parts[0].repeated
    return (
        PieceCount(mesh.stored_count)
        if one and COUNTED_FACETS < mesh.stored_count <= COUNTED_PIECES
        else None
    )


def scale_check(design: Design, window: Window, found: Measure, name: str) -> Check:
    """Compare the file's extent with the design's, axis by axis."""
    x0, x1, y0, y1 = whole_extent(window)
    z0, z1 = window.z_range
    want = np.array([x1 - x0, y1 - y0, z1 - z0])
    got = np.subtract(found.high, found.low)
    ratio = got / want
    if not np.isfinite(ratio).all() or found.facets == 0:
        return SCALE.not_run("the file has no extent", where="file", subject=name)
    # x and y alone show a uniform shrink; facets cut a little off the top of a lens in z
    lateral = ratio[:2]
    value = float(np.abs(lateral - 1.0).max())
    sentence = "extent over the design's: " + ", ".join(
        f"{axis} {r:.6g}" for axis, r in zip("xyz", ratio, strict=True)
    )
    return SCALE.judge(value, design.check.scale, sentence, subject=name, detail={"ratio": ratio})


SECTORS = 36
"""Number of sectors around the part's middle."""

AROUND = 0.8
"""Least share of sectors in which an open surface has its boundary at the rim."""

AT_RIM = 0.8
"""Distance from the middle, over that to the rim, beyond which a boundary edge lies at the rim."""


@dataclass(frozen=True, eq=False)
class Rims:
    """Edges of a mesh without a second facet.

    count : Directed edges without a partner.
    place : (3,) lengths, file unit. Middle of one of them; NaN where there are none.
    middles : (count, 3). Middles of all of them.
    closed_pieces : Connected pieces without such an edge: closed shells.
    corners : (v, 3). All vertices.
    """

    count: int
    place: Floats
    middles: Floats
    closed_pieces: int
    corners: Floats

    @property
    def at(self) -> str:
        """Text of the place."""
        return ", ".join(f"{v:.6g}" for v in np.nan_to_num(self.place))


def rims(mesh: FileMesh | Part) -> Rims:
    """Find the boundary of a mesh, or of a part at none of its places; count pieces without a boundary."""
    whole = mesh.corners(0, mesh.facet_count) if isinstance(mesh, Part) else np.concatenate([*mesh.chunks()])
    corners, facets = welded(whole)
    start, end = facets.ravel(), np.roll(facets, -1, axis=1).ravel()
    size = np.int64(len(corners))
    same = start == end  # a facet without area has no such edge
    low, high = np.minimum(start, end)[~same], np.maximum(start, end)[~same]
    keys, back = np.unique(low * size + high, return_inverse=True)
    balance = np.bincount(back, np.where((start < end)[~same], 1.0, -1.0))
    open_keys = keys[balance != 0.0]
    piece = components(len(corners), np.stack([low, high], axis=1))
    closed = np.setdiff1d(piece[start], piece[open_keys // size])
    middles = 0.5 * (corners[open_keys // size] + corners[open_keys % size])
    count = int(np.abs(balance).sum())
    place = middles[0] if len(middles) else np.full(3, np.nan)
    return Rims(count, place, middles, len(closed), corners)


def is_open_surface(found: Rims, turn: Floats | None = None) -> bool:
    """Whether a mesh is a surface without a volume, such as a scan, rather than an incomplete solid.

    turn : (3, 3) or None. File → sheet frame: the rim lies around the third axis.

    Notes
    -----
    Facets connected by edges are a piece (union-find over vertices). A piece whose every edge is used once in
    each direction is a closed shell. It has a volume, however small, so the file is meant as a solid; any
    open edge next to it is a fault. Where no piece is closed, the boundary decides. A measured surface ends
    at the rim of the part: seen along the sheet's normal, boundary edges lie at the rim all around it (in
    four fifths of 36 sectors, in the outer fifth of the way). A solid without a facet, a patch or a whole
    side wall has its boundary around the gap only. A soup whose facets share no corner is open at every edge
    and also counts as a surface.
    """
    if found.count == 0 or found.closed_pieces:
        return False
    axes = np.eye(3) if turn is None else turn
    flat, edges = found.corners @ axes[:2].T, found.middles @ axes[:2].T
    low, high = flat.min(axis=0), flat.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * np.where(high > low, high - low, 1.0)
    reach = _farthest((flat - middle) / half)
    rim = _farthest((edges - middle) / half)
    known = reach > 0.0
    return bool((rim[known] >= AT_RIM * reach[known]).mean() >= AROUND)


def _farthest(points: NDArray[np.float64]) -> Floats:
    """Largest distance from the origin of points (n, 2) in each sector, (SECTORS,)."""
    sector = ((np.arctan2(points[:, 1], points[:, 0]) / (2.0 * np.pi) + 0.5) * SECTORS).astype(np.int64)
    found = np.zeros(SECTORS)
    np.maximum.at(found, np.clip(sector, 0, SECTORS - 1), np.hypot(points[:, 0], points[:, 1]))
    return found
