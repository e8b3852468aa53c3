"""Syntax trees of the package's modules, each parsed once a process."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path


@cache
def syntax(path: Path) -> ast.Module:
    """Syntax tree of a module of the package; callers change nothing in it."""
    return ast.parse(path.read_text(encoding="utf-8"))
