"""Number of pieces of a body and number of holes through it, from the joints between neighbouring cells.

Every cell is one disc. Two neighbours that share height along a stretch of their border are glued there. A
node is filled where all borders that end in it are glued up to it (overlapping intervals on one line leave no
loop around it). Then discs − glued stretches + filled nodes = pieces − holes (Euler).

Columns that touch along a line count as joined. A mesh keeps them apart. Where front and back air are in
contact along such a line, the mesh's genus counts a hole of zero width that is not counted here.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from clacad.base.arrays import components
from clacad.base.types import Bools
from clacad.sheet.pattern import Step, node_cells

if TYPE_CHECKING:
    from clacad.sheet.lattice import Lattice


class BorderJoint(NamedTuple):
    """Joint between the two cells at a class of borders.

    step : (di, dj). Step from the left to the right cell: `lattice.steps[k]` of border class k.
    stretches : Number of separate stretches along which the cells share height.
    reaches : (start, end)
        Whether a stretch reaches the corner where the border starts (ends), seen from the left cell.
    """

    step: Step
    stretches: int
    reaches: tuple[bool, bool]


def count_pieces_and_holes(lattice: Lattice, joints: Sequence[BorderJoint]) -> tuple[int, int]:
    """Count the connected pieces of a body and the holes through it.

    joints : One for every class of borders, in the order of `lattice.steps`.
    """
    glued = sum(joint.stretches * count_together(lattice, [(0, 0), joint.step]) for joint in joints)
    pieces = _count_pieces(lattice, [joint.step for joint in joints if joint.stretches])
    return pieces, pieces - (lattice.cell_count - glued + _filled_nodes(lattice, joints))


def count_together(lattice: Lattice, cells: Sequence[Step]) -> int:
    """Count the cells all of whose relatives (index steps, the cell itself being (0, 0)) are kept."""
    if lattice.outline is None and not lattice.hexagonal:
        spans = np.ptp(np.array(cells), axis=0)
        return int(np.prod(np.maximum(np.array(lattice.count) - spans, 0)))
    return int(_together(_kept(lattice), cells).sum())


def _filled_nodes(lattice: Lattice, joints: Sequence[BorderJoint]) -> int:
    """Number of inner nodes at which all borders that end there are glued up to them."""
    sides = len(lattice.steps)
    half = sides // 2
    found = 0
    for cells in node_cells(lattice):
        # the border between a cell and the next one is the cell's side that ends at its corner at the node
        ends = [(corner - 1) % sides for _, corner in cells]
        if all(joints[k % half].reaches[1 if k < half else 0] for k in ends):
            found += count_together(lattice, [step for step, _ in cells])
    return found


def _kept(lattice: Lattice) -> Bools:
    """Kept cells as a (rows i, columns j) mask with one empty line on every side."""
    n1, n2 = lattice.count
    first = -(n2 // 2) if lattice.hexagonal else 0
    i, j = np.meshgrid(np.arange(first, n1), np.arange(n2), indexing="ij")
    return np.pad(lattice.contains(np.stack([i, j], axis=-1)), 1)


def _together(kept: Bools, cells: Sequence[Step]) -> Bools:
    """Mask like `kept` of the cells all of whose relatives (index steps) are kept."""
    everywhere = np.ones_like(kept)
    for di, dj in cells:
        everywhere &= np.roll(kept, (-di, -dj), axis=(0, 1))
    return everywhere


def _count_pieces(lattice: Lattice, steps: Sequence[Step]) -> int:
    """Number of connected pieces of the kept cells when neighbours along `steps` are joined."""
    if not steps:
        return lattice.cell_count
    if lattice.outline is None and not lattice.hexagonal:
        n1, n2 = lattice.count
        return (1 if (1, 0) in steps else n1) * (1 if (0, 1) in steps else n2)
    if lattice.outline is None and (1, 0) in steps and len(steps) > 1:
        return 1  # whole rows, joined to one another
    kept = _kept(lattice)
    number = np.cumsum(kept.ravel()).reshape(kept.shape) - 1
    pairs = []
    for step in steps:
        both = _together(kept, [(0, 0), step])
        other = np.roll(number, (-step[0], -step[1]), axis=(0, 1))
        pairs.append(np.stack([number[both], other[both]], axis=1))
    return len(np.unique(components(int(kept.sum()), np.concatenate(pairs))))
