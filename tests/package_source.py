"""Syntax trees of the package's modules, each parsed and walked once a process."""

from __future__ import annotations

import ast
import gc
from functools import cache
from pathlib import Path


@cache
def syntax(path: Path) -> ast.Module:
    """Syntax tree of a module of the package; callers change nothing in it.

    The collector of garbage never looks at the million nodes of the trees.
    """
    gc.disable()
    try:
        return ast.parse(path.read_text(encoding="utf-8"))
    finally:
        gc.freeze()
        gc.enable()


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """All nodes of a module."""
    return tuple(ast.walk(syntax(path)))


@cache
def texts(path: Path) -> tuple[ast.Constant, ...]:
    """Nodes of a module that are text, docstrings included."""
    return tuple(n for n in nodes(path) if isinstance(n, ast.Constant) and isinstance(n.value, str))


@cache
def messages(path: Path) -> tuple[ast.Constant, ...]:
    """Nodes of a module that are text and no docstring."""
    docstrings = {id(node.value) for node in nodes(path) if isinstance(node, ast.Expr)}
    return tuple(node for node in texts(path) if id(node) not in docstrings)


@cache
def literals(path: Path) -> frozenset[str]:
    """Texts of a module."""
    return frozenset(node.value for node in texts(path))
