"""Numbers, vectors and placements in the language of POV-Ray."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clacad.base.types import Floats
from clacad.storage.errors import ExportError

GAP = 2e-4
"""Gap between a lens and each border of its cell, as part of a pitch."""


class NotForPov(ExportError):
    """A sheet that a POV-Ray scene cannot represent; exit status 3."""

    exit_status = 3


def number(value: Any) -> str:
    """A number with all of its digits."""
    return repr(float(value) + 0.0)


def vector(values: Floats) -> str:
    """A vector."""
    return "<" + ", ".join(number(v) for v in values) + ">"


def colour(values: Sequence[float]) -> str:
    """A colour of linear light."""
    return f"rgb <{', '.join(number(v) for v in values)}>"


def matrix(rotation: Floats, origin: Floats) -> str:
    """Placement by its nine elements and a move; POV-Ray multiplies rows from the left."""
    return "matrix <" + ", ".join(number(v) for v in [*rotation.T.ravel(), *origin]) + ">"
