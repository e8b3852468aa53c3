"""How kernels are compiled: cached on disk, without exceptions for division, without the interpreter's lock.

No compiler may fuse a multiply with an add here (``fastmath={"contract"}``). Where it does hangs on what was compiled
into what, which differs between the run that compiles and those that load its kernels: the last bits of directions
would, too. It gains nothing measurable, and would break the exact products of `clacad.base.pairs`.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit, types
from numba.extending import intrinsic

SOURCES = (
    "tracing/**/*.py", "**/*compiled*.py", "**/compiled/*.py",
    "optics/*.py", "optics/surface/*.py", "rendering/scene_arrays.py",
)  # fmt: skip
"""Files that kernels are made of: their own, and those whose constants are compiled in."""


def _forget_stale() -> None:
    """Drop cached kernels older than any kernel source: a cached caller keeps the callees it was built with."""
    package = Path(__file__).parent.parent
    newest = max(path.stat().st_mtime for pattern in SOURCES for path in package.glob(pattern))
    for cached in package.glob("**/__pycache__/*.nbi"):
        with suppress(OSError):  # read-only, or another process was first
            if cached.stat().st_mtime < newest:
                cached.unlink()


_forget_stale()

Function = TypeVar("Function", bound=Callable[..., Any])

_PLAIN: dict[str, Any] = {"cache": True, "error_model": "numpy", "nogil": True}


def exact(function: Function) -> Function:
    """Compile so that every operation is rounded as written; the function may make no array.

    Without arrays of its own a function need not count who holds those it is given. That counting, an
    atomic instruction for every array of every call, takes ten times as long as a walk's arithmetic, and
    threads wait for one another's.
    """
    return cast(Function, njit(_nrt=False, **_PLAIN)(function))


def inlined(function: Function) -> Function:
    """Compile like `exact`, into its callers: handing over a dozen arrays costs more than what it does."""
    return cast(Function, njit(_nrt=False, forceinline=True, **_PLAIN)(function))


def owning(function: Function) -> Function:
    """Compile like `exact` a function that makes arrays of its own, in expressions too."""
    return cast(Function, njit(_nrt=True, **_PLAIN)(function))


def _multiply_add(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    """Give the machine's multiply-add: a b + c, rounded once."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), generate


multiply_add: Callable[[float, float, float], float] = intrinsic(_multiply_add)
"""a b + c with one rounding, so that multiply_add(a, b, −(a b)) is exactly what the product lost."""


@exact
def least(a: float, b: float) -> float:
    """Give the lesser of two numbers, a where b is NaN: one machine instruction."""
    return b if b < a else a
