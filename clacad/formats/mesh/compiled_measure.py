"""Triangles in one pass, compiled: sums over a stream (`clacad.formats.mesh.measure`), its connected pieces,
and lines of text.

Facets in the form of a binary STL file: see `clacad.formats.mesh.stl`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clacad.base.compiled import entry, exact, inlined, mixed, two_sum
from clacad.base.hashing import GOLDEN, MIX, STIR
from clacad.base.types import Bytes, Cells, Floats, Ints, Singles, Words

FIRST, SECOND = np.uint64(GOLDEN), np.uint64(0xC2B2AE3D27D4EB4F)
"""Seeds of the two hashes."""

MINUS_ZERO, ZERO = np.uint64(1 << 63), np.uint64(0)

VOLUME, AREA = 0, 2
"""Indices of six times the volume and twice the area in the totals, each in two parts."""


@inlined
def point_hash(words: Words, facet: int, corner: int, seed: np.uint64) -> np.uint64:
    """Hash of a corner from the bits of its coordinates; −0 is 0."""
    x, y, z = words[facet, corner, 0], words[facet, corner, 1], words[facet, corner, 2]
    x = ZERO if x == MINUS_ZERO else x
    y = ZERO if y == MINUS_ZERO else y
    z = ZERO if z == MINUS_ZERO else z
    value = mixed(x ^ seed)
    value = mixed(value + y * MIX)
    return mixed(value + z * STIR)


@inlined
def edge_hash(start: np.uint64, end: np.uint64, seed: np.uint64) -> np.uint64:
    """Hash of a directed edge: the undirected one's, negative if traversed backwards; 0 for no length."""
    if start == end:
        return ZERO
    low, high = (start, end) if start < end else (end, start)
    value = mixed(low * STIR + mixed(high + seed))
    return value if start < end else ZERO - value


@entry
def add_facets(
    corners: Floats, words: Words, origin: Floats, sums: Words, totals: Floats, box: Floats
) -> None:
    """Add facets (k, 3, 3) to the sums over a stream.

    words : (k, 3, 3). The bits of `corners`.
    origin : (3,). Point the cones of the volume start from.
    sums : (2,). Of the hashes of directed edges.
    totals : (4,). See VOLUME and AREA; each is a rounded sum and its rounding error.
    box : (2, 3). Lowest and highest corner.
    """
    for f in range(len(corners)):
        for k in range(2):
            seed = FIRST if k == 0 else SECOND
            a = point_hash(words, f, 0, seed)
            b = point_hash(words, f, 1, seed)
            c = point_hash(words, f, 2, seed)
            sums[k] += edge_hash(a, b, seed) + edge_hash(b, c, seed) + edge_hash(c, a, seed)
        for axis in range(3):
            for corner in range(3):
                place = corners[f, corner, axis]
                box[0, axis] = min(place, box[0, axis])
                box[1, axis] = max(place, box[1, axis])
        ax, ay, az = corners[f, 0, 0] - origin[0], corners[f, 0, 1] - origin[1], corners[f, 0, 2] - origin[2]
        bx, by, bz = corners[f, 1, 0] - origin[0], corners[f, 1, 1] - origin[1], corners[f, 1, 2] - origin[2]
        cx, cy, cz = corners[f, 2, 0] - origin[0], corners[f, 2, 1] - origin[1], corners[f, 2, 2] - origin[2]
        ux, uy, uz = bx - ax, by - ay, bz - az
        vx, vy, vz = cx - ax, cy - ay, cz - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        high, low = two_sum(totals[VOLUME], ax * nx + ay * ny + az * nz)
        totals[VOLUME], totals[VOLUME + 1] = high, totals[VOLUME + 1] + low
        high, low = two_sum(totals[AREA], np.sqrt(nx * nx + ny * ny + nz * nz))
        totals[AREA], totals[AREA + 1] = high, totals[AREA + 1] + low


@entry
def hash_corners(words: Words, hashes: Words) -> None:
    """Hash every corner of facets (k, 3, 3), given by the bits of its coordinates, into (k, 3)."""
    for f in range(len(words)):
        for c in range(3):
            hashes[f, c] = point_hash(words, f, c, FIRST)


@entry
def join(keys: Words, table: Words, number: Cells, parent: Cells, count: int) -> tuple[int, int]:
    """Join the three corners of each facet (k, 3), given by their hashes; returns the vertex count and the
    join count.

    table, number : (2^b,) hash table of the known vertices, open addressing; 0 is an empty slot
    parent : union-find forest over the vertices, with room for new ones
    """
    mask = np.uint64(len(table) - 1)
    joins = 0
    for f in range(len(keys)):
        root = -1
        for c in range(3):
            key = keys[f, c]
            if key == np.uint64(0):
                key = np.uint64(1)
            slot = key & mask
            while table[slot] != np.uint64(0) and table[slot] != key:
                slot = (slot + np.uint64(1)) & mask
            if table[slot] == np.uint64(0):
                table[slot] = key
                number[slot] = count
                parent[count] = count
                count += 1
            node = number[slot]
            while parent[node] != node:
                parent[node] = parent[parent[node]]
                node = parent[node]
            if root < 0:
                root = node
            elif node != root:
                if node < root:
                    root, node = node, root
                parent[node] = root
                joins += 1
    return count, joins


@entry
def rehash(table: Words, number: Cells, larger: Words, renumbered: Cells) -> None:
    """Move a hash table into a larger one."""
    mask = np.uint64(len(larger) - 1)
    for k in range(len(table)):
        key = table[k]
        if key != np.uint64(0):
            slot = key & mask
            while larger[slot] != np.uint64(0):
                slot = (slot + np.uint64(1)) & mask
            larger[slot] = key
            renumbered[slot] = number[k]


@entry
def facet_numbers(corners: Floats, scale: float, numbers: Singles) -> bool:
    """Write normal and corners of facets (k, 3, 3) into (k, 4, 3) float32; return whether all of them are
    finite.

    scale : File units per unit of the corners.

    Corners are rounded first, without −0; the normal is that of the rounded triangle, of length 1, or 0 for
    one without area.
    """
    finite = True
    zero = np.float32(0.0)
    for f in range(len(corners)):
        for corner in range(3):
            for axis in range(3):
                value = np.float32(corners[f, corner, axis] * scale) + zero
                numbers[f, 1 + corner, axis] = value
                finite = finite and np.isfinite(value)
        ax, ay, az = np.float64(numbers[f, 1, 0]), np.float64(numbers[f, 1, 1]), np.float64(numbers[f, 1, 2])
        ux, uy, uz = numbers[f, 2, 0] - ax, numbers[f, 2, 1] - ay, numbers[f, 2, 2] - az
        vx, vy, vz = numbers[f, 3, 0] - ax, numbers[f, 3, 1] - ay, numbers[f, 3, 2] - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if not length > 0.0:
            length = 1.0
        numbers[f, 0, 0] = np.float32(nx / length) + zero
        numbers[f, 0, 1] = np.float32(ny / length) + zero
        numbers[f, 0, 2] = np.float32(nz / length) + zero
    return finite


@entry
def join_words(words: Ints, letters: Bytes, starts: Ints, between: Bytes, ends: Ints, out: Bytes) -> int:
    """Write lines of three words each into `out`; their length.

    words : (n, 3). Numbers of words.
    letters : bytes. All words, one after another; word k is letters[starts[k] : starts[k + 1]].
    between : bytes
        Text before, between and after the words of a line; part k is between[ends[k] : ends[k + 1]].
    """
    at = 0
    for row in range(len(words)):
        for part in range(4):
            for k in range(ends[part], ends[part + 1]):
                out[at] = between[k]
                at += 1
            if part < 3:
                word = words[row, part]
                for k in range(starts[word], starts[word + 1]):
                    out[at] = letters[k]
                    at += 1
    return at


# -- shared vertices ---------------------------------------------------------------------------
FREE, PENDING = -1, -2
"""Numbers of a place of a table without a vertex, and of a vertex that was named and has not come yet."""


class VertexTable(NamedTuple):
    """Hash table of vertices, open addressing.

    words : (2^b, c). Bits of the numbers of each vertex.
    number : (2^b,). Numbers of the vertices; `FREE` where there is none.
    """

    words: Words
    number: Ints


@inlined
def _word(words: Words, row: int, column: int) -> np.uint64:
    """Bits of one number; −0 is 0."""
    word = words[row, column]
    return ZERO if word == MINUS_ZERO else word


@exact
def _hash(words: Words, row: int) -> np.uint64:
    value = FIRST
    for column in range(words.shape[1]):
        value = mixed(value ^ _word(words, row, column)) * MIX
    return value


@exact
def _place(table: VertexTable, words: Words, row: int, key: np.uint64) -> int:
    """Place of a vertex in a table, or the free place where it belongs."""
    mask = np.uint64(len(table.number) - 1)
    place = key & mask
    while table.number[place] != FREE:
        same = True
        for column in range(words.shape[1]):
            same = same and table.words[place, column] == _word(words, row, column)
        if same:
            break
        place = (place + np.uint64(1)) & mask
    return int(place)


@exact
def _put(table: VertexTable, place: int, words: Words, row: int, number: int) -> None:
    table.number[place] = number
    for column in range(words.shape[1]):
        table.words[place, column] = _word(words, row, column)


@entry
def name_vertices(words: Words, table: VertexTable) -> None:
    """Put vertices (n, c) that have not come yet into a table."""
    for row in range(len(words)):
        _put(table, _place(table, words, row, _hash(words, row)), words, row, PENDING)


@entry
def move_vertices(table: VertexTable, larger: VertexTable) -> None:
    """Put the vertices of a table into a larger one."""
    for old in range(len(table.number)):
        if table.number[old] != FREE:
            place = _place(larger, table.words, old, _hash(table.words, old))
            _put(larger, place, table.words, old, table.number[old])


@entry
def number_vertices(
    words: Words,
    recent: VertexTable,
    older: VertexTable,
    always: VertexTable,
    counts: tuple[int, int],
    numbers: Ints,
    fresh: Ints,
) -> tuple[int, int]:
    """Number vertices (n, c) by the tables; new ones come to `recent`, and older ones that are met again.

    counts : vertices numbered before, and used places of `recent`
    numbers, fresh : (n,). Receive the number of each vertex, and the rows of the new ones.

    Returns the used places of `recent` and the number of new vertices.
    """
    count, used = counts
    found = 0
    for row in range(len(words)):
        key = _hash(words, row)
        here = _place(recent, words, row, key)
        if recent.number[here] != FREE:
            numbers[row] = recent.number[here]
            continue
        there = _place(older, words, row, key)
        number = older.number[there]
        if number < 0:
            there = _place(always, words, row, key)
            number = always.number[there]
        if number < 0:
            if number == PENDING:
                always.number[there] = count + found
            number = count + found
            fresh[found] = row
            found += 1
        _put(recent, here, words, row, number)
        used += 1
        numbers[row] = number
    return used, found
