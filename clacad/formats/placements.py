"""Placements of repeated parts: those of an assembly, level by level, and those of a mesh on the lattice.

A placement is the upper three rows of a homogeneous matrix, (3, 4): x ↦ A x + b. Rows of a sheet and the
cells of a row are kept separate, as in the file. A sheet of a million cells is two thousand placements, and
is written out only where each of its cells is needed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from clacad.base.types import Floats, Ints
from clacad.sheet.lattice import Lattice
from clacad.storage.errors import FileDisagrees, UnreadableFile

Node = TypeVar("Node", bound=Hashable)

MOST = 8_000_000
"""Instances of one part that are written out; a file with more, unless it is a sheet of rows, is rejected."""

UNPLACED = np.eye(3, 4)
ALONE = UNPLACED[None]

NEGLIGIBLE = 1e-12
"""Relative to the lengths that are added: more than their rounding error."""


@dataclass(frozen=True, eq=False)
class Placements:
    """Placements of one part: each of the inner placements within each of the outer ones, as cells of a row
    in rows.

    Number k of them is `inner[k % n]`, then `outer[k // n]`. Placements without this order are all outer
    ones.

    outer : (m, 3, 4)
    inner : (n, 3, 4)
    """

    outer: Floats
    inner: Floats = field(default_factory=lambda: ALONE)

    def __len__(self) -> int:
        return len(self.outer) * len(self.inner)

    @cached_property
    def unturned(self) -> bool:
        """Whether all of them only move, exactly."""
        return unturned(self.outer) and unturned(self.inner)

    @property
    def in_rows(self) -> bool:
        """Whether they are rows and cells in them, all unrotated."""
        return len(self.inner) > 1 and len(self.outer) > 1 and self.unturned

    def at(self, numbers: Ints) -> Floats:
        """Selected placements, (k, 3, 4). Raises UnreadableFile: More than `MOST` of them."""
        if self.inner is ALONE:
            return self.outer[numbers]
        _few(len(numbers))
        row, column = np.divmod(numbers, len(self.inner))
        return product(self.outer[row], self.inner[column])

    def one(self, number: int) -> Floats:
        """One placement, (3, 4)."""
        row, column = divmod(number, len(self.inner))
        return self.outer[row] if self.inner is ALONE else product(self.outer[row], self.inner[column])

    def all(self) -> Floats:
        """All placements, (m n, 3, 4). Raises UnreadableFile: More than `MOST` of them."""
        if self.inner is ALONE:
            return self.outer
        _few(len(self))
        return product(self.outer[:, None], self.inner[None]).reshape(-1, 3, 4)

    def within(self, own: Floats) -> Placements:
        """Placements of an object whose placements in this part are `own` (e, 3, 4).

        Raises UnreadableFile: More than `MOST` must be written out.
        """
        if len(self) == 1:
            return Placements(product(self.outer, own))
        if len(own) == 1:
            return self if np.array_equal(own[0], UNPLACED) else Placements(product(self.all(), own))
        return Placements(self.all(), own)

    def ends(self) -> Iterator[tuple[Floats, Floats, Floats]]:
        """Every rotation among them, as a placement without a move, with the least and greatest moves (3,) of
        its placements.
        """
        if self.unturned and len(self):  # rounding is monotonic: sums of extremes are the extremes
            across, along = self.outer[..., 3], self.inner[..., 3]
            yield UNPLACED, across.min(axis=0) + along.min(axis=0), across.max(axis=0) + along.max(axis=0)
            return
        for turn, moves in turns(self.all()):
            yield turn, moves.min(axis=0), moves.max(axis=0)

    def near(self, low: Floats, high: Floats) -> Ints:
        """Numbers, ascending, of all placements with moves between low and high (2,) in x and y, or more."""
        if not self.unturned or not len(self):
            return np.arange(len(self))
        across, along = self.outer[:, :2, 3], self.inner[:, :2, 3]
        sizes = [
            np.abs(lengths[np.isfinite(lengths)]).max(initial=0.0) for lengths in (across, along, low, high)
        ]
        room = NEGLIGIBLE * sum(sizes)
        rows = _between(across, low - along.max(axis=0) - room, high - along.min(axis=0) + room)
        columns = _between(along, low - across.max(axis=0) - room, high - across.min(axis=0) + room)
        _few(len(rows) * len(columns))
        return np.asarray((rows[:, None] * len(self.inner) + columns).ravel())


def _between(values: Floats, low: Floats, high: Floats) -> Ints:
    """Rows of values (k, 2) between low and high (2,)."""
    return np.flatnonzero(((values >= low) & (values <= high)).all(axis=1))


def fill(lattice: Lattice, first: Ints, steps: Ints) -> bool:
    """Whether rows of cells fill a lattice, each cell once; also False where an outline cuts it or rows run
    up and down.

    first : (m, 2). A cell of each row.
    steps : (n, 2). Steps from that cell to the cells of the row.
    """
    if lattice.outline is not None or (len(steps), len(first)) != lattice.count or steps[:, 1].any():
        return False
    columns, rows = np.sort(steps[:, 0]), np.sort(first[:, 1])
    if (np.diff(columns) != 1).any() or (np.diff(rows) != 1).any():
        return False
    return all(bool(lattice.contains(first + [columns[end], 0]).all()) for end in (0, -1))


def turns(placements: Floats) -> Iterator[tuple[Floats, Floats]]:
    """Every rotation among placements (k, 3, 4), as a placement without a move, with its moves (m, 3)."""
    for rows in by_turn(placements):
        turn = np.concatenate([placements[rows[0], :, :3], np.zeros((3, 1))], axis=1)
        yield turn, placements[rows, :, 3]


def product(outer: Floats, inner: Floats) -> Floats:
    """Apply placements (…, 3, 4) `inner` first, then `outer`; their leading shapes are broadcast."""
    if unturned(outer) and unturned(inner):  # moves alone: the same numbers, and fast for a million cells
        shape = np.broadcast_shapes(outer.shape, inner.shape)
        found = np.empty(shape)
        found[..., :3] = UNPLACED[:, :3]
        np.add(inner[..., 3], outer[..., 3], out=found[..., 3])
        return found
    linear = outer[..., :, :3] @ inner[..., :, :3]
    move = (outer[..., :, :3] @ inner[..., :, 3:]) + outer[..., :, 3:]
    return np.concatenate([linear, move], axis=-1)


def unturned(placements: Floats) -> bool:
    """Whether placements (…, 3, 4) only move, exactly."""
    return bool((placements[..., :3] == UNPLACED[:, :3]).all())


def by_turn(placements: Floats) -> list[Ints]:
    """Rows of placements (k, 3, 4) grouped by rotation, to twelve decimals."""
    linear = placements[:, :, :3].reshape(-1, 9)
    if not len(linear) or (linear == linear[0]).all():
        return [np.arange(len(linear))] if len(linear) else []
    which = np.unique(linear.round(12), axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(which, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(which[order])) + 1)


def inverse(placement: Floats) -> Floats:
    """Inverse of placements (…, 3, 4)."""
    linear = np.linalg.inv(placement[..., :, :3])
    return np.concatenate([linear, -linear @ placement[..., :, 3:]], axis=-1)


def applied(placement: Floats, points: Floats) -> Floats:
    """Points (…, n, 3) after placements (…, 3, 4)."""
    if unturned(placement):
        return np.asarray(points + placement[..., None, :, 3])
    turned = points @ np.swapaxes(placement[..., :, :3], -1, -2)
    return np.asarray(turned + placement[..., None, :, 3])


def composed(
    held: Mapping[Node, Sequence[tuple[Node, Floats]]], nodes: Iterable[Node]
) -> dict[Node, Placements]:
    """Placements of every node of an assembly in the frame of its roots.

    held : Content of a node: (child, its placements (e, 3, 4) in the node's frame).
    nodes : All nodes; those that no node contains are roots and have no placement.
    Returns: One placement for each occurrence of the node in the whole.
    Raises UnreadableFile: A part contains itself, or occurs more than `MOST` times without the order of cells
        in rows.
    """
    everyone = list(dict.fromkeys(nodes))
    waiting = Counter(child for node in everyone for child, _ in held.get(node, ()))
    ready = [node for node in everyone if waiting[node] == 0]
    placed: dict[Node, list[Placements]] = {node: [Placements(ALONE)] for node in ready}
    found: dict[Node, Placements] = {}
    while ready:
        node = ready.pop()
        found[node] = here = joined(placed.pop(node))
        for child, own in held.get(node, ()):
            placed.setdefault(child, []).append(here.within(own))
            waiting[child] -= 1
            if waiting[child] == 0:
                ready.append(child)
    if len(found) < len(everyone):
        raise UnreadableFile("a part of its assembly holds itself")
    return found


def joined(several: Sequence[Placements]) -> Placements:
    """Placements one after another. Raises UnreadableFile: More than `MOST` must be written out."""
    if len(several) == 1:
        return several[0]
    _few(sum(len(one) for one in several))
    return Placements(np.concatenate([one.all() for one in several]))


def _few(count: int) -> None:
    if count > MOST:
        raise UnreadableFile(f"a part of its assembly lies more than {MOST} times")


FLAT_LIMIT = 50_000
"""Positions up to which components of 3MF are written in one level, which every tested reader understands."""


class Block(NamedTuple):
    """Some triangles of a piece, with the vertices that they are the first to use.

    vertices : (v, 3) array, design units
        About the piece's own origin (the centre of its cell, z of the sheet).
    normals : (v, 3) array or None. Exact unit normals at the vertices, for formats that keep them.
    triangles : (t, 3) int array. Numbers among the vertices of this block and of those before.
    """

    vertices: Floats
    normals: Floats | None
    triangles: Ints

    def sound(self, name: str, scale: float, centre: Floats | None = None) -> tuple[Floats, Floats]:
        """Positions (v, 3), scaled, about `centre` (design units) if given, and normals: finite, without −0.

        Raises FileDisagrees: There are no normals, or a number is not finite; `name` is that of the piece.
        """
        if self.normals is None:
            raise FileDisagrees(f"{name}: this format needs vertex normals")
        position = (self.vertices if centre is None else self.vertices + centre) * scale + 0.0
        normal = self.normals + 0.0
        if not (np.isfinite(position).all() and np.isfinite(normal).all()):
            raise FileDisagrees(f"{name}: a vertex or normal is not a finite number")
        return position, normal


@dataclass(frozen=True, eq=False)
class Piece:
    """A closed mesh and its positions, made block by block.

    name : Body it belongs to.
    blocks : Makes the triangles, in order, on each call.
    facets : Number of triangles, about.
    places : None: the piece occurs once, at its coordinates.
    index : Refractive index, for formats that draw glass.
    """

    name: str
    blocks: Callable[[], Iterator[Block]]
    facets: int
    places: Places | None = None
    index: float = 1.5

    @classmethod
    def of(
        cls,
        name: str,
        vertices: Floats,
        triangles: Ints,
        normals: Floats | None = None,
        places: Places | None = None,
        index: float = 1.5,
    ) -> Piece:
        """Piece of vertices (v, 3), triangles (t, 3) and normals (v, 3); see `Block`."""
        block = Block(vertices, normals, triangles)
        return cls(name, lambda: iter([block]), len(triangles), places, index)

    @property
    def count(self) -> int:
        """Number of instances of the piece."""
        return 1 if self.places is None else self.places.count

    @cached_property
    def whole(self) -> Block:
        """All of it as one block."""
        blocks = list(self.blocks())
        if len(blocks) == 1:
            return blocks[0]
        vertices, normals, triangles = zip(*blocks, strict=True)
        smooth = None if normals[0] is None else np.concatenate(normals)
        return Block(np.concatenate(vertices), smooth, np.concatenate(triangles))


@dataclass(frozen=True, eq=False)
class Places:
    """Positions of the cells of an array, row by row.

    shift : (x, y), lengths. Displacement of the array against the lattice.
    """

    lattice: Lattice
    shift: tuple[float, float]

    @property
    def count(self) -> int:
        """Number of cells."""
        return self.lattice.cell_count

    def centres(self) -> NDArray[np.float64]:
        """Centres of all cells, row by row, (m, 3), lengths; z is 0."""
        flat = self.lattice.centres(self.lattice.cells()) + np.asarray(self.shift)
        return np.column_stack([flat, np.zeros(len(flat))])

    def rows(self) -> tuple[list[Floats], list[tuple[int, tuple[float, float]]]]:
        """Group cells into kinds of rows, so that equal rows are written once.

        Returns
        -------
        kinds : list of (k,) arrays
            x of the cells of a row, from its first cell.
        `standing` : list of (kind, (x, y))
            For every row: its kind, and the position of its first cell.
        """
        kinds: dict[tuple[int, ...], int] = {}
        offsets: list[Floats] = []
        standing = []
        for j in range(self.lattice.count[1]):
            row = self.lattice.row(j)
            if not len(row):
                continue
            pattern = tuple((row[:, 0] - row[0, 0]).tolist())
            if pattern not in kinds:
                kinds[pattern] = len(kinds)
                offsets.append(np.array(pattern, dtype=np.float64) * self.lattice.pitch[0])
            x, y = self.lattice.centres(row[0]) + np.asarray(self.shift)
            standing.append((kinds[pattern], (float(x), float(y))))
        return offsets, standing
