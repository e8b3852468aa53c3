"""How kernels are compiled: cached on disk, without exceptions for division, without the interpreter's lock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


def exact(function: Function) -> Function:
    """Compile so that every operation is rounded as written."""
    return cast(Function, njit(cache=True, error_model="numpy", nogil=True)(function))


def fused(function: Function) -> Function:
    """Compile with multiply-adds fused: for plain arithmetic only, never around an exact product."""
    options = {"cache": True, "error_model": "numpy", "nogil": True, "fastmath": {"contract"}}
    return cast(Function, njit(**options)(function))
