"""The file of a tolerance study, for readers of its content: the report, a drawing."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

TOLERANCES = "tolerances"
"""Kind of the document, and first part of the names of its files."""

FORMAT = 1


def read_study(folder: str | os.PathLike[str]) -> dict[str, Any] | None:
    """The study that was written to a folder as tolerances.json, or None where there is none."""
    try:
        found = json.loads((Path(folder) / f"{TOLERANCES}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    known = isinstance(found, dict) and found.get("kind") == TOLERANCES and found.get("format") == FORMAT
    return found if known else None


def study_of(folder: str | os.PathLike[str], sha256: str) -> dict[str, Any] | None:
    """The study in a folder if it is of the design with this hash, else None."""
    found = read_study(folder)
    stated = None if found is None else found.get("design")
    return found if isinstance(stated, dict) and stated.get("sha256") == sha256 else None
