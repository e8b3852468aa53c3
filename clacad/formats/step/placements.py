"""Where the parts of an assembly stand: placements composed level by level, arrays of them at a time.

A placement is the upper three rows of a homogeneous matrix, (3, 4): x ↦ A x + b, lengths in mm.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import TypeVar

import numpy as np

from clacad.base.types import Floats, Ints
from clacad.storage.errors import UnreadableFile

Node = TypeVar("Node", bound=Hashable)

MOST = 8_000_000
"""Instances of one part that are placed; a file that claims more is refused."""

UNPLACED = np.eye(3, 4)


def product(outer: Floats, inner: Floats) -> Floats:
    """Apply placements (…, 3, 4) `inner` first, then `outer`; their leading shapes are broadcast."""
    if unturned(outer) and unturned(inner):  # moves alone: the same numbers, of a million cells in no time
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
    """Rows of placements (k, 3, 4) grouped by how they turn, to twelve places."""
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


def composed(held: Mapping[Node, Sequence[tuple[Node, Floats]]], nodes: Iterable[Node]) -> dict[Node, Floats]:
    """Placements of every node of an assembly in the frame of its roots.

    Parameters
    ----------
    held : mapping
        What a node holds: (child, its placements (e, 3, 4) in the node's frame).
    nodes : iterable
        All nodes; those that nobody holds are roots and stand unplaced.

    Returns
    -------
    dict of (k, 3, 4) arrays
        k: how often the node stands in the whole.

    Raises
    ------
    UnreadableFile
        A part holds itself, or a part stands more than `MOST` times.
    """
    everyone = list(dict.fromkeys(nodes))
    waiting = dict.fromkeys(everyone, 0)
    for node in everyone:
        for child, _ in held.get(node, ()):
            waiting[child] += 1
    ready = [node for node in everyone if waiting[node] == 0]
    placed: dict[Node, list[Floats]] = {node: [UNPLACED[None]] for node in ready}
    found: dict[Node, Floats] = {}
    while ready:
        node = ready.pop()
        found[node] = here = np.concatenate(placed.pop(node))
        for child, own in held.get(node, ()):
            _few(len(here) * len(own) + sum(len(part) for part in placed.get(child, ())))
            placed.setdefault(child, []).append(product(here[:, None], own[None]).reshape(-1, 3, 4))
            waiting[child] -= 1
            if waiting[child] == 0:
                ready.append(child)
    if len(found) < len(everyone):
        raise UnreadableFile("a part of its assembly holds itself")
    return found


def _few(count: int) -> None:
    if count > MOST:
        raise UnreadableFile(f"a part of its assembly stands more than {MOST} times")
