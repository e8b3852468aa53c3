"""A plain closed mesh of a sheet without steps: one height grid over all cells, front and back, and four sides.

Written only for tests: heights come from the faces, everything else from counting.
"""

from __future__ import annotations

import struct

import numpy as np

from clacad.sheet.window import column


def facets(window, body, quads):
    """Triangles (t, 3, 3) of one body, wound counter-clockwise seen from outside."""
    lattice = window.lattice
    n1, n2 = lattice.count
    array = body.front.array if body.front.array is not None else body.back.array
    shift = np.asarray(window.shifts[array])
    p, q = lattice.pitch
    x0, y0 = lattice.centres(np.array([0, 0])) - 0.5 * np.array([p, q])
    i, j = np.meshgrid(np.arange(n1 * quads + 1), np.arange(n2 * quads + 1), indexing="ij")
    cell_i, cell_j = np.minimum(i // quads, n1 - 1), np.minimum(j // quads, n2 - 1)
    local_x = (i - cell_i * quads) * (p / quads) - 0.5 * p
    local_y = (j - cell_j * quads) * (q / quads) - 0.5 * q
    front, back = (z.reshape(i.shape) for z in column(window, body, local_x.ravel(), local_y.ravel()))
    x, y = x0 + shift[0] + i * (p / quads), y0 + shift[1] + j * (q / quads)
    top, bottom = np.stack([x, y, back], axis=-1), np.stack([x, y, front], axis=-1)
    found = [_sheet(top), _sheet(bottom)[:, ::-1]]
    rims = [(slice(None), 0), (-1, slice(None)), (slice(None, None, -1), -1), (0, slice(None, None, -1))]
    found += [_wall(bottom[rim], top[rim]) for rim in rims]
    return np.concatenate(found)


def _sheet(grid):
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    return np.concatenate([np.stack([a, b, c], axis=-2), np.stack([a, c, d], axis=-2)]).reshape(-1, 3, 3)


def _wall(low, high):
    a, b, c, d = low[:-1], low[1:], high[1:], high[:-1]
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def sheet_facets(window, quads):
    """Triangles of all bodies."""
    return np.concatenate([facets(window, body, quads) for body in window.bodies])


def write_stl(path, triangles):
    """Binary STL of triangles (t, 3, 3) in the file's own unit."""
    record = np.zeros(
        len(triangles), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("extra", "<u2")]
    )
    record["corners"] = triangles
    with open(path, "wb") as stream:
        stream.write(b"plain".ljust(80) + struct.pack("<I", len(triangles)) + record.tobytes())
