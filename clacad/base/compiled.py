"""Decorators that compile kernels: cached on disk, no exception on division, global interpreter lock
released.

Fused multiply-add (``fastmath={"contract"}``) is forbidden here. Where the compiler fuses depends on which
functions are compiled into which, and that differs between the run that compiles and the runs that load its
kernels. The last bits of directions would differ, too. Fusing gains nothing measurable and breaks the exact
products of `clacad.base.pairs`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from clacad.base.compiled_parts import PartCompiler
from clacad.base.kernel_cache import keep, numba

Function = TypeVar("Function", bound=Callable[..., Any])

_PLAIN: dict[str, Any] = {"error_model": "numpy", "nogil": True}
_PART: dict[str, Any] = {
    **_PLAIN,
    "pipeline_class": PartCompiler,
    "no_cfunc_wrapper": True,
    "no_cpython_wrapper": True,
}


def exact(function: Function) -> Function:
    """Compile a part of kernels with every operation rounded as written; the part may not allocate arrays.

    A part that allocates no arrays needs no reference counting of its arguments. Reference counting is an
    atomic instruction for every array of every call: ten times as slow as a walk's arithmetic, and threads
    wait for one another. Only compiled code calls a part; see `PartCompiler`.
    """
    return cast(Function, numba.njit(_nrt=False, **_PART)(function))


def inlined(function: Function) -> Function:
    """Compile like `exact` and inline: passing a dozen arrays costs more than the function's own work."""
    return cast(Function, numba.njit(_nrt=False, forceinline=True, **_PART)(function))


def making(function: Function) -> Function:
    """Compile like `exact` a part that allocates arrays."""
    return cast(Function, numba.njit(_nrt=True, **_PART)(function))


def entry(function: Function) -> Function:
    """Compile a kernel that Python calls, with all its parts, and cache it on disk;
    it may not allocate arrays.
    """
    return cast(Function, keep(numba.njit(_nrt=False, **_PLAIN)(function)))


def owning(function: Function) -> Function:
    """Compile like `entry` a kernel that allocates arrays, including temporaries of array expressions."""
    return cast(Function, keep(numba.njit(_nrt=True, **_PLAIN)(function)))


def _multiply_add(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """Return the machine's fused multiply-add: a b + c, rounded once."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return numba.types.float64(numba.types.float64, numba.types.float64, numba.types.float64), generate


multiply_add: Callable[[float, float, float], float] = numba.extending.intrinsic(_multiply_add)
"""a b + c with one rounding: multiply_add(a, b, −(a b)) is exactly the rounding error of the product."""


@exact
def least(a: float, b: float) -> float:
    """Return the lesser of two numbers, a where b is NaN: one machine instruction."""
    return b if b < a else a
