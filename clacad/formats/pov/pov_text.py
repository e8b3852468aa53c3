"""Numbers, vectors and placements as POV-Ray reads them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from clacad.base.types import Floats
from clacad.storage.errors import ExportError

GAP = 2e-4
"""Part of a pitch by which a lens keeps off each border of its cell."""


class NotForPov(ExportError):
    """A sheet that this form of scene cannot hold; exit status 3."""

    exit_status = 3


def number(value: Any) -> str:
    """A number in as many digits as it has."""
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
