"""Which cases of a family run every time; the others are long and run with `-m long`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def often(names: Iterable[str], *chosen: str) -> list[Any]:
    """Parameters of a test: the chosen names as they are, the rest marked long."""
    every = list(names)
    assert set(chosen) <= set(every), set(chosen) - set(every)
    return [name if name in chosen else pytest.param(name, marks=pytest.mark.long) for name in every]
