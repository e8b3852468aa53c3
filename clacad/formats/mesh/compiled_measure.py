"""Triangles in one pass, compiled: sums over a stream (`clacad.formats.mesh.measure`), its connected pieces,
and lines of text.

Facets in the form of a binary STL file: see `clacad.formats.mesh.stl`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clacad.base.compiled import entry, exact, inlined, mixed, two_sum
from clacad.base.hashing import GOLDEN, MIX, STIR
from clacad.base.types import Bools, Bytes, Cells, Floats, Ints, Singles, Words
from clacad.formats.step.compiled_text import one_number

DIGIT = 48
"""Code of the digit 0."""

FIRST, SECOND = np.uint64(GOLDEN), np.uint64(0xC2B2AE3D27D4EB4F)
"""Seeds of the two hashes."""

MINUS_ZERO, ZERO = np.uint64(1 << 63), np.uint64(0)

VOLUME, AREA = 0, 2
"""Indices of six times the volume and twice the area in the totals, each in two parts."""


@inlined
def point_hash(words: Words, row: int, seed: np.uint64) -> np.uint64:
    """Hash of a point from the bits of its coordinates; −0 is 0."""
    x, y, z = words[row, 0], words[row, 1], words[row, 2]
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
    points: Floats,
    words: Words,
    facets: Ints,
    hashes: Words,
    origin: Floats,
    sums: Words,
    totals: Floats,
    box: Floats,
) -> None:
    """Add facets (k, 3), given by rows of points (n, 3), to the sums over a stream.

    words : (n, 3). The bits of `points`.
    hashes : (n, 2). Written here.
    origin : (3,). Point the cones of the volume start from.
    sums : (2,). Of the hashes of directed edges.
    totals : (4,). See VOLUME and AREA; each is a rounded sum and its rounding error.
    box : (2, 3). Lowest and highest corner.
    """
    for row in range(len(points)):
        hashes[row, 0] = point_hash(words, row, FIRST)
        hashes[row, 1] = point_hash(words, row, SECOND)
    for f in range(len(facets)):
        one, two, three = facets[f, 0], facets[f, 1], facets[f, 2]
        for k in range(2):
            seed = FIRST if k == 0 else SECOND
            a, b, c = hashes[one, k], hashes[two, k], hashes[three, k]
            sums[k] += edge_hash(a, b, seed) + edge_hash(b, c, seed) + edge_hash(c, a, seed)
        for axis in range(3):
            for corner in range(3):
                place = points[facets[f, corner], axis]
                box[0, axis] = min(place, box[0, axis])
                box[1, axis] = max(place, box[1, axis])
        ax, ay, az = points[one, 0] - origin[0], points[one, 1] - origin[1], points[one, 2] - origin[2]
        bx, by, bz = points[two, 0] - origin[0], points[two, 1] - origin[1], points[two, 2] - origin[2]
        cx, cy, cz = points[three, 0] - origin[0], points[three, 1] - origin[1], points[three, 2] - origin[2]
        ux, uy, uz = bx - ax, by - ay, bz - az
        vx, vy, vz = cx - ax, cy - ay, cz - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        high, low = two_sum(totals[VOLUME], ax * nx + ay * ny + az * nz)
        totals[VOLUME], totals[VOLUME + 1] = high, totals[VOLUME + 1] + low
        high, low = two_sum(totals[AREA], np.sqrt(nx * nx + ny * ny + nz * nz))
        totals[AREA], totals[AREA + 1] = high, totals[AREA + 1] + low


@entry
def hash_points(words: Words, hashes: Words) -> None:
    """Hash points (n, 3), given by the bits of their coordinates, into (n,)."""
    for row in range(len(words)):
        hashes[row] = point_hash(words, row, FIRST)


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


@exact
def _facet_normal(corners: Singles, f: int) -> tuple[np.float32, np.float32, np.float32]:
    """Normal of a facet of rounded corners, of length 1, or 0 for one without area."""
    ax, ay, az = np.float64(corners[f, 0, 0]), np.float64(corners[f, 0, 1]), np.float64(corners[f, 0, 2])
    ux, uy, uz = corners[f, 1, 0] - ax, corners[f, 1, 1] - ay, corners[f, 1, 2] - az
    vx, vy, vz = corners[f, 2, 0] - ax, corners[f, 2, 1] - ay, corners[f, 2, 2] - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if not length > 0.0:
        length = 1.0
    zero = np.float32(0.0)
    return np.float32(nx / length) + zero, np.float32(ny / length) + zero, np.float32(nz / length) + zero


@entry
def facet_numbers(corners: Floats, scale: float, normals: Singles, rounded: Singles) -> bool:
    """Write normals (k, 3) and corners (k, 3, 3) of facets as float32; return whether all of them are finite.

    scale : File units per unit of the corners.

    Corners are rounded first, without −0.
    """
    finite = True
    zero = np.float32(0.0)
    for f in range(len(corners)):
        for corner in range(3):
            for axis in range(3):
                value = np.float32(corners[f, corner, axis] * scale) + zero
                rounded[f, corner, axis] = value
                finite = finite and np.isfinite(value)
        normals[f, 0], normals[f, 1], normals[f, 2] = _facet_normal(rounded, f)
    return finite


@entry
def as_written(normals: Singles, corners: Singles, bits: Cells, attributes: Cells) -> bool:
    """Whether facets are finite and as `facet_numbers` writes them, to the last bit.

    bits : (k, 12). Normals and corners as integers.
    attributes : (k,). Must be 0.
    """
    minus = np.int32(-(2**31))
    for f in range(len(corners)):
        sound = attributes[f] == 0
        for n in range(12):
            sound = sound and bits[f, n] != minus
        for corner in range(3):
            for axis in range(3):
                sound = sound and np.isfinite(corners[f, corner, axis])
        if not sound:
            return False
        x, y, z = _facet_normal(corners, f)
        if normals[f, 0] != x or normals[f, 1] != y or normals[f, 2] != z:
            return False
    return True


@inlined
def _copied(source: Bytes, first: int, last: int, out: Bytes, at: int) -> int:
    """Write source[first:last] into `out` from `at` on; the place behind it."""
    for k in range(first, last):
        out[at] = source[k]
        at += 1
    return at


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
            at = _copied(between, ends[part], ends[part + 1], out, at)
            if part < 3:
                word = words[row, part]
                at = _copied(letters, starts[word], starts[word + 1], out, at)
    return at


@entry
def join_whole(numbers: Ints, between: Bytes, ends: Ints, out: Bytes) -> int:
    """Write lines of three whole numbers from 0 on, as `join_words` writes words; their length."""
    at = 0
    for row in range(len(numbers)):
        for part in range(4):
            at = _copied(between, ends[part], ends[part + 1], out, at)
            if part < 3:
                value, size = numbers[row, part], 1
                while value >= 10:
                    value //= 10
                    size += 1
                value = numbers[row, part]
                for k in range(at + size - 1, at - 1, -1):
                    out[k] = DIGIT + value % 10
                    value //= 10
                at += size
    return at


@exact
def _whole(text: Bytes, at: int, found: Floats, line: int, part: int) -> int:
    """Read a whole number of up to 15 digits; index behind it, −1 where there is none."""
    value, first = 0, at
    while at < len(text) and DIGIT <= text[at] <= DIGIT + 9:
        value = 10 * value + (int(text[at]) - DIGIT)
        at += 1
    found[line, part] = value
    return at if first < at <= first + 15 else -1


@entry
def read_lines(text: Bytes, between: Bytes, ends: Ints, whole: bool, found: Floats) -> tuple[int, int]:
    """Read lines as `join_words` writes them, each three numbers; count of lines, and index behind the last.

    whole : Whether the numbers are whole, of up to 15 digits.
    found : (n, 3). Receives the numbers.

    Reading ends before a line of another form, and before a number that needs more than one rounding.
    """
    line = behind = 0
    while line < len(found):
        at = behind
        while at < len(text) and (text[at] == 32 or text[at] == 13 or 9 <= text[at] <= 10):
            at += 1
        for part in range(4):
            size = ends[part + 1] - ends[part]
            if at + size > len(text):
                return line, behind
            for k in range(size):
                if text[at + k] != between[ends[part] + k]:
                    return line, behind
            at += size
            if part == 3:
                break
            first = at
            at = (
                _whole(text, at, found, line, part)
                if whole
                else one_number(text, at, len(text), found[line], part)
            )
            if at <= first:
                return line, behind
        behind = at
        line += 1
    return line, behind


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
def _word(place: Words, smooth: Words, row: int, column: int) -> np.uint64:
    """Bits of one number of a vertex: those of its place, then those of its normal; −0 is 0."""
    word = place[row, column] if column < place.shape[1] else smooth[row, column - place.shape[1]]
    return ZERO if word == MINUS_ZERO else word


@exact
def _hash(place: Words, smooth: Words, row: int, columns: int) -> np.uint64:
    value = FIRST
    for column in range(columns):
        value = mixed(value ^ _word(place, smooth, row, column)) * MIX
    return value


@exact
def _place(table: VertexTable, place: Words, smooth: Words, row: int, key: np.uint64) -> int:
    """Index of a vertex in a table, or the free one where it belongs."""
    mask = np.uint64(len(table.number) - 1)
    index = key & mask
    while table.number[index] != FREE:
        same = True
        for column in range(table.words.shape[1]):
            same = same and table.words[index, column] == _word(place, smooth, row, column)
        if same:
            break
        index = (index + np.uint64(1)) & mask
    return int(index)


@exact
def _put(table: VertexTable, index: int, place: Words, smooth: Words, row: int, number: int) -> None:
    table.number[index] = number
    for column in range(table.words.shape[1]):
        table.words[index, column] = _word(place, smooth, row, column)


@entry
def name_vertices(words: Words, table: VertexTable) -> None:
    """Put vertices (n, c) that have not come yet into a table."""
    for row in range(len(words)):
        key = _hash(words, words, row, words.shape[1])
        _put(table, _place(table, words, words, row, key), words, words, row, PENDING)


@entry
def move_vertices(table: VertexTable, larger: VertexTable) -> None:
    """Put the vertices of a table into a larger one."""
    words = table.words
    for old in range(len(table.number)):
        if table.number[old] != FREE:
            place = _place(larger, words, words, old, _hash(words, words, old, words.shape[1]))
            _put(larger, place, words, words, old, table.number[old])


class CellCorners(NamedTuple):
    """Where corners lie within the cells of a block.

    start : (cells + 1,). First corner of each cell.
    points : (n,). Point of the footprint of each corner; −1: unknown.
    inner : (p,). Whether a point lies inside the cell, where no other cell has a vertex.
    last, before : (p,), (n,). Written by the kernel; `last` begins with −1.
    """

    start: Ints
    points: Ints
    inner: Bools
    last: Ints
    before: Ints


@inlined
def _same(words: Words, one: int, other: int) -> bool:
    """Whether two rows are equal; −0 is 0."""
    for column in range(words.shape[1]):
        a, b = words[one, column], words[other, column]
        if a != b and a | b != MINUS_ZERO:
            return False
    return True


@exact
def _in_cell(cells: CellCorners, place: Words, smooth: Words, row: int, low: int) -> int:
    """First row of the cell, which begins at row `low`, with the vertex of this one; −1 where it is new."""
    seen = cells.last[cells.points[row]]
    while seen >= low and not (_same(place, seen, row) and _same(smooth, seen, row)):
        seen = cells.before[seen]
    return int(seen) if seen >= low else -1


@exact
def _known(
    tables: tuple[VertexTable, ...], place: Words, smooth: Words, row: int, number: int
) -> tuple[int, bool]:
    """Number of a vertex by the tables recent, older, always, and whether it has come to the first of them.

    number : The one that it gets where it is new.
    """
    recent, older, always = tables
    key = _hash(place, smooth, row, recent.words.shape[1])
    here = _place(recent, place, smooth, row, key)
    if recent.number[here] != FREE:
        return recent.number[here], False
    found = older.number[_place(older, place, smooth, row, key)]
    if found < 0:
        there = _place(always, place, smooth, row, key)
        found = always.number[there]
        if found == PENDING:
            always.number[there] = number
    if found < 0:
        found = number
    _put(recent, here, place, smooth, row, found)
    return found, True


@entry
def number_vertices(
    place: Words,
    smooth: Words,
    cells: CellCorners,
    tables: tuple[VertexTable, ...],
    counts: tuple[int, int, int, int],
    numbers: Ints,
    fresh: Ints,
) -> tuple[int, int, int]:
    """Number vertices (n, 3), with normals (n, 3) or (n, 0), by their cells and by the tables recent, older
    and always; new ones come to `recent`, and older ones that are met again.

    counts : First row, vertices numbered before, new ones among them of these rows, used places of `recent`.
    numbers, fresh : (n,). Receive the number of each vertex, and the rows of the new ones.

    Returns the row behind the last that was numbered: `recent` may be half full; then counts of new vertices
    and of used places.
    """
    begin, count, found, used = counts
    room = len(tables[0].number) // 2
    cell = 0
    for row in range(begin, len(place)):
        if used >= room:
            return row, found, used
        while row >= cells.start[cell + 1]:
            cell += 1
        point = cells.points[row] if len(cells.points) else -1
        if point >= 0:
            seen = _in_cell(cells, place, smooth, row, cells.start[cell])
            if seen >= 0:
                numbers[row] = numbers[seen]
                continue
            cells.before[row], cells.last[point] = cells.last[point], row
        if point >= 0 and cells.inner[point]:
            number = count + found
        else:
            number, more = _known(tables, place, smooth, row, count + found)
            used += more
        if number == count + found:
            fresh[found] = row
            found += 1
        numbers[row] = number
    return len(place), found, used
