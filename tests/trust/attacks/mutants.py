"""Mutants of a good file, each made from its number alone: bytes changed anywhere, or the part itself changed."""

from __future__ import annotations

import random
import re
from collections.abc import Callable

import numpy as np
from fuzz.bytes_of import mutated, repacked
from fuzz.grow import recipe
from trust.bench.readers import triangles as read_triangles
from trust.spoiling import Change, Floats, Ints, changed

WHOLE = 1 << 20
"""Bytes of a mutant at most: nothing is cut from a good file."""


def ascii_stl(corners: Floats) -> bytes:
    """Triangles (t, 3, 3) as an ASCII STL file."""
    facets = [
        "facet normal 0 0 1\n outer loop\n"
        + "".join(f"  vertex {x!r} {y!r} {z!r}\n" for x, y, z in facet)
        + " endloop\nendfacet\n"
        for facet in corners.tolist()
    ]
    return ("solid tiny\n" + "".join(facets) + "endsolid tiny\n").encode()


def bytes_mutant(kind: str, good: bytes, number: int) -> bytes:
    """A few random steps on the bytes; of a 3MF file in half of the cases on the text inside it."""
    chance = random.Random(number)
    steps = recipe(chance)
    inside = repacked(good, steps) if kind == "3mf" and number % 2 else None
    return inside or mutated(good, steps, good, WHOLE)


def part_mutant(kind: str, good: bytes, number: int) -> bytes:
    """The part itself changed by so much that light, or a check of wholeness, must detect it."""
    chance = np.random.default_rng(number)
    change = CHANGES[int(chance.integers(len(CHANGES)))](chance)
    if kind == "ascii.stl":
        corners = corners_of("ascii.stl", good)
        vertices, facets = change(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))
        return ascii_stl(vertices[facets])
    return changed(f"x.{kind}", good, change)


def _shifted(chance: np.random.Generator) -> Change:
    """One vertex, with all others in its place, lies a tenth of a millimetre higher or lower."""

    def change(vertices: Floats, facets: Ints) -> tuple[Floats, Ints]:
        at = vertices[chance.integers(len(vertices))].copy()
        moved = vertices.copy()
        moved[(vertices == at).all(axis=1)] += [0.0, 0.0, chance.choice([-0.1, 0.1])]
        return moved, facets

    return change


def _torn(chance: np.random.Generator) -> Change:
    def change(vertices: Floats, facets: Ints) -> tuple[Floats, Ints]:
        one = int(chance.integers(len(facets)))
        torn = facets.copy()
        match int(chance.integers(3)):
            case 0:
                torn = np.delete(facets, one, axis=0)
            case 1:
                torn[one] = facets[one, ::-1]
            case _:
                torn = np.concatenate([facets, facets[one : one + 1]])
        return vertices, torn

    return change


def _stretched(chance: np.random.Generator) -> Change:
    """Drawn out along one axis by a hundredth to a fifth."""
    factor = np.ones(3)
    factor[chance.integers(3)] += chance.uniform(0.01, 0.2)
    return lambda vertices, facets: (vertices * factor, facets)


def _waved(chance: np.random.Generator) -> Change:
    """Heights with a wave of 30 µm across a cell."""

    def change(vertices: Floats, facets: Ints) -> tuple[Floats, Ints]:
        waved = vertices.copy()
        waved[:, 2] += 0.03 * np.sin(2.0 * np.pi * vertices[:, 0] / 0.5 + chance.uniform(0.0, 6.0))
        return waved, facets

    return change


CHANGES: tuple[Callable[[np.random.Generator], Change], ...] = (_shifted, _torn, _stretched, _waved)


# -- is a mutant the same part? ------------------------------------------------------------------------


def corners_of(kind: str, data: bytes) -> Floats:
    """Corners (t, 3, 3) of a file, by nothing of the package's own, millimetres."""
    if kind == "ascii.stl":
        return np.array(re.findall(rb"vertex\s+(\S+)\s+(\S+)\s+(\S+)", data), dtype=float).reshape(-1, 3, 3)
    if kind == "obj":
        vertices = np.array(re.findall(rb"^\s*v\s+(\S+)\s+(\S+)\s+(\S+)", data, re.M), dtype=float)
        faces = re.findall(rb"^\s*f\s+(\d+)\S*\s+(\d+)\S*\s+(\d+)\S*\s*$", data, re.M)
        return vertices[np.array(faces, dtype=np.int64) - 1]
    return read_triangles(f"x.{kind}", data)


def same_part(kind: str, good: bytes, mutant: bytes, room: float) -> bool:
    """Whether a mutant holds the very triangles of the good file, in any order, each corner within `room` mm."""
    moved = _moved(corners_of(kind, good), corners_of(kind, mutant), room)
    return moved is not None and not len(moved)


def only_beside_lenses(
    kind: str, good: bytes, mutant: bytes, room: float, blocks: tuple[Floats, Floats]
) -> bool:
    """Whether only corners lie elsewhere that were on the outline of a face's lenses or outside it.

    blocks : lowest and highest x, y (2, 2), mm, of the lenses of the lower and the upper face
    """
    moved = _moved(corners_of(kind, good), corners_of(kind, mutant), room)
    if moved is None:
        return False
    middle = 0.5 * np.ptp(corners_of(kind, good)[..., 2])
    low, high = np.stack(blocks)[(moved[:, 2] > middle).astype(int)].swapaxes(0, 1)
    inside = (moved[:, :2] > low + EDGE).all(axis=1) & (moved[:, :2] < high - EDGE).all(axis=1)
    return not inside.any()


EDGE = 1e-3
"""Millimetres next to the outline of the lenses that belong to it."""


def _moved(want: Floats, got: Floats, room: float) -> Floats | None:
    """Where corners (k, 3) were that lie more than `room` elsewhere; None where the triangles are others."""
    if want.shape != got.shape:
        return None
    far = np.abs(want - got).max(axis=2) > room
    if far.mean() > 0.5:  # in another order, perhaps
        want, got = (c[np.lexsort(np.round(c.mean(axis=1) / room / 64.0).T)] for c in (want, got))
        far = np.abs(want - got).max(axis=2) > room
    return np.asarray(want[far])
