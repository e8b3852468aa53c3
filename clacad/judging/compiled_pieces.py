"""Connected pieces of a stream of triangles, compiled; imported only when a large mesh is counted."""

from __future__ import annotations

import numpy as np

from clacad.base.compiled import entry
from clacad.base.types import Cells, Words


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
