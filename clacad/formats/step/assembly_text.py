"""The assembly in the text of a STEP file: units, placements of every level, and the solids with their
placements.

Placements come from next assembly usage occurrences with their transformations, from mapped items, and from
bare relationships between representations. Lengths are converted to mm by the unit of each representation's
own context.
"""

from __future__ import annotations

import re
from array import array
from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clacad.base.arrays import Groups
from clacad.base.types import Floats
from clacad.formats.placements import UNPLACED, Placements, composed, inverse, product

NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:[Ee][-+]?\d+)?")
_PLAIN = re.compile(r"#(\d+)|(\$)")
_PREFIXED = re.compile(r"SI_UNIT\(\s*(?:\.(\w+)\.|\$)\s*,\s*\.METRE\.")
_MEASURE = re.compile(r"MEASURE(?:_WITH_UNIT)?\(\s*([-+]?\d+\.?\d*(?:[Ee][-+]?\d+)?)\s*[,)]")
_ASSIGNED = re.compile(r"GLOBAL_UNIT_ASSIGNED_CONTEXT\(\s*\(([^)]*)\)")

PREFIXES = {
    None: 1.0,
    "": 1.0,
    "EXA": 1e18,
    "PETA": 1e15,
    "TERA": 1e12,
    "GIGA": 1e9,
    "MEGA": 1e6,
    "KILO": 1e3,
    "HECTO": 1e2,
    "DECA": 1e1,
    "DECI": 1e-1,
    "CENTI": 1e-2,
    "MILLI": 1e-3,
    "MICRO": 1e-6,
    "NANO": 1e-9,
    "PICO": 1e-12,
}
MILLIMETRES = 1e3
"""Millimetres in a metre."""

SHELLS = ("CLOSED_SHELL", "OPEN_SHELL")
SOLIDS = ("MANIFOLD_SOLID_BREP", "BREP_WITH_VOIDS", "FACETED_BREP", "SHELL_BASED_SURFACE_MODEL")


@dataclass(frozen=True, eq=False)
class PlacedPart:
    """One part of a file and its placements.

    solid : False for bare shells.
    shells : numbers of its shells
    unit : mm per unit of its own coordinates.
    """

    name: str
    solid: bool
    shells: tuple[int, ...]
    unit: float
    placements: Placements


@dataclass
class Vectors:
    """Entities of a file that are triples of numbers, by their numbers: compact, many of them."""

    ids: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))

    def add(self, number: int, text: str) -> None:
        """Store an entity if it is a triple."""
        found = [float(value) for value in NUMBER.findall(text[text.rfind("(") :])]
        if len(found) == 3:
            self.ids.append(number)
            self.values.extend(found)

    def lookup(self) -> Lookup:
        """Return them as a `Lookup`."""
        ids = np.frombuffer(self.ids, dtype=np.int64) if len(self.ids) else np.empty(0, dtype=np.int64)
        values = np.frombuffer(self.values, dtype=np.float64) if len(self.values) else np.empty(0)
        values = values.reshape(-1, 3)
        if (ids[1:] > ids[:-1]).all():  # as most writers number them: no copy
            return Lookup(ids, values)
        order = np.argsort(ids, kind="stable")
        return Lookup(ids[order], values[order])


@dataclass(frozen=True, eq=False)
class Lookup:
    """Rows by number: ids (n,) sorted, values (n, …)."""

    ids: NDArray[np.int64]
    values: NDArray[Any]

    def rows(self, wanted: NDArray[np.int64]) -> NDArray[np.int64]:
        """Row of every number. Raises LookupError: One does not exist."""
        at = np.searchsorted(self.ids, wanted)
        if np.any(at >= len(self.ids)) or not np.array_equal(self.ids[at], wanted):
            raise LookupError("a number that no entity has")
        return at

    def one(self, number: int) -> Floats:
        """The value under one number. Raises LookupError: It does not exist."""
        at = bisect_left(self.ids, number)
        if at == len(self.ids) or self.ids[at] != number:
            raise LookupError("a number that no entity has")
        return np.asarray(self.values[at])


class Units:
    """Collector of a file's units of length, representation by representation."""

    def __init__(self) -> None:
        self.context_of: dict[int, int] = {}
        self._si: dict[int, float] = {}
        self._converted: dict[int, int] = {}
        self._measures: dict[int, tuple[float, int]] = {}
        self._contexts: dict[int, list[int]] = {}

    def collect(self, number: int, statement: str, references: list[int]) -> bool:
        """Process one entity, as `Assembly.collect` does; return whether it belongs to a unit."""
        if "LENGTH_UNIT" in statement:
            if (si := _PREFIXED.search(statement)) is not None:
                self._si[number] = PREFIXES[si.group(1)]
            elif "CONVERSION_BASED_UNIT" in statement:
                at = statement.index("CONVERSION_BASED_UNIT")
                self._converted[number] = int(
                    statement[statement.index("#", at) + 1 :].split(")")[0].split(",")[0]
                )
        elif (assigned := _ASSIGNED.search(statement)) is not None:
            self._contexts[number] = [int(a) for a in re.findall(r"#(\d+)", assigned.group(1))]
        elif "MEASURE_WITH_UNIT" in statement and (size := _MEASURE.search(statement)) is not None:
            self._measures[number] = (float(size.group(1)), references[-1])
        else:
            return False
        return True

    def of(self, representation: int) -> float:
        """Millimetres per unit of length of a representation; 1 where none is given."""
        for unit in self._contexts.get(self.context_of.get(representation, 0), ()):
            if (metres := self._metres(unit)) is not None:
                return metres * MILLIMETRES
        return 1.0

    def every(self) -> set[float]:
        """Millimetres per unit, of all representations that state it."""
        return {self.of(r) for r, c in self.context_of.items() if c in self._contexts}

    def _metres(self, unit: int, depth: int = 0) -> float | None:
        if unit in self._si:
            return self._si[unit]
        size = self._measures.get(self._converted.get(unit, 0))
        if size is None or depth > 8:
            return None
        base = self._metres(size[1], depth + 1)
        return None if base is None else size[0] * base


class Assembly:
    """Collector of the entities of the assembly structure in a scan; composes them afterwards."""

    def __init__(self) -> None:
        self.directions = Vectors()
        self._axes: array[int] = array("q")  # number, location, axis, reference direction; 0 where not given
        self.units = Units()
        self._operators: dict[int, tuple[list[int], float]] = {}
        self._moves: dict[int, tuple[int, int]] = {}
        self._maps: dict[int, tuple[int, int]] = {}
        self._mapped: dict[int, tuple[int, int]] = {}
        self._items: dict[int, list[int]] = {}
        self._relations: dict[int, tuple[int, int, int]] = {}
        self._dependents: list[tuple[int, int]] = []
        self._shape_of: dict[int, int] = {}
        self._represented: list[tuple[int, int]] = []
        self._uses: dict[int, tuple[int, int]] = {}
        self._solids: dict[int, tuple[str, str, list[int]]] = {}
        self._turned_shells: dict[int, int] = {}
        self._merged: Groups[int] = Groups()

    # -- collecting -----------------------------------------------------------------------------

    def collect(self, number: int, kind: str, statement: str, references: list[int], title: str) -> None:
        """Process one entity; `kind` is the first of its type names, `statement` its text without strings."""
        statement = "".join(statement.split())  # lines may break anywhere between words
        if kind == "AXIS2_PLACEMENT_3D":
            given = [int(a) if a else 0 for a, _ in _PLAIN.findall(statement)] + [0, 0]
            self._axes.extend([number, *given[:3]])
        elif kind == "DIRECTION":
            self.directions.add(number, statement)
        elif kind in SOLIDS:
            self._solids[number] = (kind, title, references)
        elif kind == "ORIENTED_CLOSED_SHELL":
            self._turned_shells[number] = references[0]
        elif kind == "NEXT_ASSEMBLY_USAGE_OCCURRENCE":
            self._uses[number] = (references[0], references[1])
        elif kind == "PRODUCT_DEFINITION_SHAPE":
            self._shape_of[number] = references[0]
        elif kind == "SHAPE_DEFINITION_REPRESENTATION":
            self._represented.append((references[0], references[1]))
        elif kind == "CONTEXT_DEPENDENT_SHAPE_REPRESENTATION":
            self._dependents.append((references[0], references[1]))
        elif kind == "ITEM_DEFINED_TRANSFORMATION":
            self._moves[number] = (references[0], references[1])
        elif kind == "MAPPED_ITEM":
            self._mapped[number] = (references[0], references[1])
        elif kind == "REPRESENTATION_MAP":
            self._maps[number] = (references[0], references[1])
        elif (
            kind == "CARTESIAN_TRANSFORMATION_OPERATOR_3D"
            or "CARTESIAN_TRANSFORMATION_OPERATOR_3D(" in statement
        ):
            self._operator(number, statement)
        elif kind.endswith("SHAPE_REPRESENTATION") or kind == "REPRESENTATION":
            self._items[number], self.units.context_of[number] = references[:-1], references[-1]
        elif not self.units.collect(number, statement, references):
            self._relation(number, statement, references)

    def _relation(self, number: int, statement: str, references: list[int]) -> None:
        """Process a relationship of two representations, with its transformation or 0 for none."""
        if "REPRESENTATION_RELATIONSHIP" not in statement or len(references) < 2:
            return
        moved = re.search(r"WITH_TRANSFORMATION\(\s*(?:'[^']*'\s*,[^#]*)?#(\d+)\s*\)", statement)
        plain = [r for r in references if moved is None or r != int(moved.group(1))]
        self._relations[number] = (plain[0], plain[1], 0 if moved is None else int(moved.group(1)))

    def _operator(self, number: int, statement: str) -> None:
        """Axes 1 and 2, origin, scale and axis 3, as one list of texts or spread over a complex entity."""
        lists = re.findall(r"CARTESIAN_TRANSFORMATION_OPERATOR(?:_3D)?\(([^()]*)\)", statement)
        given = [word.strip() for text in lists for word in text.split(",")][-5:]
        first, second, at, scale, third = (["$"] * (5 - len(given))) + given
        numbers = [int(word[1:]) if word.startswith("#") else 0 for word in (first, second, at, third)]
        self._operators[number] = (numbers, 1.0 if scale == "$" else float(scale))

    # -- placements -----------------------------------------------------------------------------

    @property
    def frames(self) -> NDArray[np.int64]:
        """Number, location, axis and reference direction of every placement, (n, 4); 0 where not given."""
        return np.array(self._axes, dtype=np.int64).reshape(-1, 4)

    def standing(self, points: Lookup) -> list[PlacedPart]:
        """Every solid and bare shell of the file, with all its placements."""
        frames = _Frames(points, self.directions.lookup(), self._axes, self._operators)
        self._merge()
        held: dict[int, list[tuple[int, Floats]]] = {}
        for (parent, child), moves in self._edges(frames).items():
            held.setdefault(parent, []).append((child, np.array(moves)))
        nodes = {self._of(n) for n in (*self._items, *(-d for d in self._definitions()))}
        placed = composed(held, nodes)
        found = []
        for representation, items in self._items.items():
            for item in items:
                if item in self._solids:
                    kind, name, shells = self._solids[item]
                    numbers = tuple(self._turned_shells.get(shell, shell) for shell in shells)
                    found.append(
                        PlacedPart(
                            name,
                            kind != "SHELL_BASED_SURFACE_MODEL",
                            numbers,
                            self.units.of(representation),
                            placed[self._of(representation)],
                        )
                    )
        return found

    def _definitions(self) -> set[int]:
        own = {d for d in self._shape_of.values() if d not in self._uses}
        return own | {d for use in self._uses.values() for d in use}

    def _of(self, node: int) -> int:
        """The node that represents all representations of one part."""
        return self._merged.of(node)

    def _merge(self) -> None:
        """Merge the representations of a product definition, and those related without a transformation."""
        for shape, representation in self._represented:
            definition = self._shape_of.get(shape, 0)
            if definition and definition not in self._uses:
                self._merged.join(representation, -definition)
        used = {relation for relation, _ in self._dependents}
        for number, (first, second, move) in self._relations.items():
            if not move and number not in used and {first, second} <= self._items.keys():
                self._merged.join(first, second)

    def _edges(self, frames: _Frames) -> dict[tuple[int, int], list[Floats]]:
        found: dict[tuple[int, int], list[Floats]] = {}
        for parent, child, move in (*self._mappings(frames), *self._bare(frames)):
            found.setdefault((parent, child), []).append(move)
        mapped = set(found)
        moved = {self._shape_of.get(shape, 0): relation for relation, shape in self._dependents}
        for use, (above, below) in self._uses.items():
            parent, child = self._of(-above), self._of(-below)
            relation = self._relations.get(moved.get(use, 0))
            if relation is not None:
                found.setdefault((parent, child), []).append(self._move(frames, relation, child))
            elif (parent, child) not in mapped:
                found.setdefault((parent, child), []).append(UNPLACED)
        return found

    def _mappings(self, frames: _Frames) -> Iterator[tuple[int, int, Floats]]:
        for representation, items in self._items.items():
            for item in items:
                if item in self._mapped:
                    source, target = self._mapped[item]
                    origin, inner = self._maps[source]
                    there = frames.of(target, self.units.of(representation))
                    back = inverse(frames.of(origin, self.units.of(inner)))
                    yield self._of(representation), self._of(inner), product(there, back)

    def _bare(self, frames: _Frames) -> Iterator[tuple[int, int, Floats]]:
        """Edges from a relationship of representations alone."""
        used = {relation for relation, _ in self._dependents}
        for number, relation in self._relations.items():
            first, second, move = relation
            if move and number not in used and {first, second} <= self._items.keys():
                yield self._of(second), self._of(first), self._move(frames, relation, self._of(first))

    def _move(self, frames: _Frames, relation: tuple[int, int, int], child: int) -> Floats:
        """Placement of the child that a relationship states, in either order of the two."""
        first, second, move = relation
        if not move:
            return UNPLACED
        if move in self._operators:
            there = frames.of(move, self.units.of(second))
        else:
            before, after = self._moves[move]
            there = product(
                frames.of(after, self.units.of(second)), inverse(frames.of(before, self.units.of(first)))
            )
        return there if self._of(first) == child else inverse(there)


class _Frames:
    """Axis placements and transformation operators as placements, mm."""

    def __init__(
        self,
        points: Lookup,
        directions: Lookup,
        axes: array[int],
        operators: dict[int, tuple[list[int], float]],
    ) -> None:
        rows = np.array(axes, dtype=np.int64).reshape(-1, 4)
        order = np.argsort(rows[:, 0], kind="stable")
        self._axes = Lookup(rows[order, 0], rows[order, 1:])
        self._turns: dict[tuple[int, int], Floats] = {}
        self._points, self._directions, self._operators = points, directions, operators

    def of(self, number: int, unit: float) -> Floats:
        """One placement, with its lengths in `unit` mm."""
        if number in self._operators:
            (first, _, at, third), scale = self._operators[number]
            frame = self._frame(at, third, first, unit)
            frame[:, :3] *= scale
            return frame
        at, axis, reference = self._axes.one(number).tolist()
        return self._frame(at, axis, reference, unit)

    def _frame(self, at: int, axis: int, reference: int, unit: float) -> Floats:
        return np.column_stack([self._turn(axis, reference), self._points.one(at) * unit])

    def _turn(self, axis: int, reference: int) -> Floats:
        """Axes x, y, z in columns (3, 3), of directions that many placements share."""
        if (axis, reference) not in self._turns:
            z = self._directions.one(axis) if axis else np.array([0.0, 0.0, 1.0])
            z = z / np.linalg.norm(z)
            x = self._directions.one(reference) if reference else np.eye(3)[int(abs(z[0]) > 0.999999)]
            x = x - (x @ z) * z
            x = x / np.linalg.norm(x)
            self._turns[axis, reference] = np.column_stack([x, np.cross(z, x), z])
        return self._turns[axis, reference]
