"""Shortcuts for tests of files: checks of `verify` on the design alone, tested elsewhere, are computed once."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import pytest

from clacad.checks.file_kinds import CONVERGENCE
from clacad.design import Design

_SEEN: dict[Any, Any] = {}


def only_files(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave refinement out of `verify`, and trace each design once, regardless of the files."""
    run = importlib.import_module("clacad.verification.run")
    nothing = (None, CONVERGENCE.not_run("left out", required=False))
    convergence = importlib.import_module("clacad.verification.light.facet_convergence")
    monkeypatch.setattr(convergence, "judge_convergence", lambda *_: nothing)
    for name in ("judge_window", "meridians"):
        monkeypatch.setattr(run, name, _once(name, getattr(run, name)))


def _once(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    def call(first: Any, *arguments: Any) -> Any:
        about = first.sha256 if isinstance(first, Design) else (repr(first.thin), repr(first.lattice))
        key = name, about, *(given for given in arguments if isinstance(given, int))
        if key not in _SEEN:
            _SEEN[key] = function(first, *arguments)
        return _SEEN[key]

    return call
