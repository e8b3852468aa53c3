"""Origin of given faces (`[pair.search]`): the record that a search writes into its resulting design."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

from clacad.config.compound_kinds import InlineTable, ListOf, Several
from clacad.config.quantities import Quantity
from clacad.config.value_kinds import Flag, Text, Whole
from clacad.design.given_faces import FaceSpec, face_table

_NUMBER: Final = Quantity("ratio", "a number", least=0.0)
_COUNT: Final = Whole("a whole number from 1")
_SHA: Final = Text("a SHA-256", 64, pattern="[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class SearchRecord:
    """Start, settings and result of a search; nothing is built from it.

    Parameters
    ----------
    start_sha256 : str
        SHA-256 of the initial design.
    faces_sha256 : str
        SHA-256 of the resulting faces (`faces_digest`).
    free : tuple of str
    field_deg : float
        Half angle of the cone of rays.
    weights : tuple of (part of the field, weight)
    tolerances : bool
        Whether the search optimised parts with fabrication errors instead of the perfect part.
    unknowns, rays : int
    history : tuple of (evaluations, rms error in mrad)
        One entry for each improvement of the best by a tenth, and the first and the last.
    """

    start_sha256: str
    faces_sha256: str
    free: tuple[str, ...]
    field_deg: float
    weights: tuple[tuple[float, float], ...]
    tolerances: bool
    unknowns: int
    rays: int
    history: tuple[tuple[float, float], ...]

    def to_dict(self) -> dict[str, Any]:
        """The table of a design file; `SEARCH` reads it back."""
        made = {key: getattr(self, key) for key, _ in _KEYS}
        made |= {key: [list(pair) for pair in made[key]] for key in ("weights", "history")}
        return made | {"free": list(self.free)}


_KEYS: Final = (
    ("start_sha256", _SHA),
    ("faces_sha256", _SHA),
    ("free", ListOf(Text("a word", 20), "texts")),
    ("field_deg", _NUMBER),
    ("weights", ListOf(Several(_NUMBER, ("part of the field", "weight")), "pairs")),
    ("tolerances", Flag()),
    ("unknowns", _COUNT),
    ("rays", _COUNT),
    ("history", ListOf(Several(_NUMBER, ("evaluations", "mrad")), "pairs")),
)

SEARCH: Final = InlineTable(_KEYS, required=tuple(key for key, _ in _KEYS))
"""Kind of the value of `pair.search`."""


def search_read(table: Iterable[tuple[str, Any]]) -> SearchRecord:
    """Record from the value read by `SEARCH`."""
    return SearchRecord(**dict(table))


def faces_digest(faces: Iterable[FaceSpec]) -> str:
    """SHA-256 of faces; it reveals changes after the search."""
    return hashlib.sha256(repr([face_table(face) for face in faces]).encode()).hexdigest()
