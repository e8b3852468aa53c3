"""How kernels are compiled: cached on disk, without exceptions for division, without the interpreter's lock.

No compiler may fuse a multiply with an add here (``fastmath={"contract"}``). Where it does hangs on what was compiled
into what, which differs between the run that compiles and those that load its kernels: the last bits of directions
would, too. It gains nothing measurable, and would break the exact products of `clacad.base.pairs`.
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
    """Compile a part of kernels, every operation rounded as written; the function may make no array.

    Without arrays of its own a function need not count who holds those it is given. That counting, an
    atomic instruction for every array of every call, takes ten times as long as a walk's arithmetic, and
    threads wait for one another's. A part is called by compiled code only; see `PartCompiler`.
    """
    return cast(Function, numba.njit(_nrt=False, **_PART)(function))


def inlined(function: Function) -> Function:
    """Compile like `exact`, into its callers: handing over a dozen arrays costs more than what it does."""
    return cast(Function, numba.njit(_nrt=False, forceinline=True, **_PART)(function))


def making(function: Function) -> Function:
    """Compile like `exact` a part that makes arrays."""
    return cast(Function, numba.njit(_nrt=True, **_PART)(function))


def entry(function: Function) -> Function:
    """Compile a kernel that Python calls: with all its parts, kept on disk; it may make no array."""
    return cast(Function, keep(numba.njit(_nrt=False, **_PLAIN)(function)))


def owning(function: Function) -> Function:
    """Compile like `entry` a kernel that makes arrays of its own, in expressions too."""
    return cast(Function, keep(numba.njit(_nrt=True, **_PLAIN)(function)))


def _multiply_add(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """Give the machine's multiply-add: a b + c, rounded once."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return numba.types.float64(numba.types.float64, numba.types.float64, numba.types.float64), generate


multiply_add: Callable[[float, float, float], float] = numba.extending.intrinsic(_multiply_add)
"""a b + c with one rounding, so that multiply_add(a, b, −(a b)) is exactly what the product lost."""


@exact
def least(a: float, b: float) -> float:
    """Give the lesser of two numbers, a where b is NaN: one machine instruction."""
    return b if b < a else a
