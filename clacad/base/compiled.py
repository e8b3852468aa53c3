"""Decorators that compile kernels: cached on disk, no exception on division, global interpreter lock
released.

Fused multiply-add (``fastmath={"contract"}``) is forbidden here. Where the compiler fuses depends on which
functions are compiled into which, and that differs between the run that compiles and the runs that load its
kernels. The last bits of directions would differ, too. Fusing gains nothing measurable and breaks the exact
products of `clacad.base.pairs`.

Parts of kernels: functions that only compiled code calls, turned into machine code once, within their kernel.

The usual compiler optimises each function together with all its callees and makes machine code of the whole.
A walk of six call levels is compiled six times, and only the outermost version ever runs. A part stops at
intermediate code, which its callers link in. Only a function that Python calls (`clacad.base.compiled.entry`)
is optimised and compiled to machine code, once, as a whole. This halves the compilation time.

Error-free sums and products of single numbers are counterparts of `clacad.base.pairs`, and the hash of a word
is that of `clacad.base.hashing`.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np

from clacad.base.hashing import HIGH, LOW, MIDDLE, MIX, STIR
from clacad.base.kernel_cache import keep, numba

JITCodeLibrary: Any = numba.core.codegen.JITCodeLibrary
CompilerBase: Any = numba.core.compiler.CompilerBase
DefaultPassBuilder: Any = numba.core.compiler.DefaultPassBuilder
NativeLowering: Any = numba.core.typed_passes.NativeLowering


class _WithoutEnvironments:
    """A code generator that stores no constants for a function that Python cannot call."""

    def __init__(self, generator: Any) -> None:
        self._generator = generator

    def __getattr__(self, name: str) -> Any:
        return getattr(self._generator, name)

    def set_env(self, name: str, environment: object) -> None:
        """Do nothing: no machine code reads the constant."""


class PartLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Intermediate code of a part and of all its callees; never optimised, never machine code."""

    @property
    def codegen(self) -> Any:
        """The generator, without storage for constants of this function."""
        return _WithoutEnvironments(self._codegen)

    def _optimize_functions(self, module: Any) -> None:
        """Accept a module without optimising it."""
        module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        """Do nothing: the kernel optimises."""

    def _finalize_final_module(self) -> None:
        """Make no machine code."""
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return the address that Python runs if it calls the part: a function that refuses."""
        self._ensure_finalized()
        return _REFUSAL


@numba.core.compiler_machinery.register_pass(mutates_CFG=True, analysis_only=False)
class _LoweredAsPart(NativeLowering):  # type: ignore[misc]
    """Lowering into a `PartLibrary`."""

    _name = "lowered_as_part"

    def run_pass(self, state: Any) -> bool:
        """Lower one function."""
        state.library = PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        return bool(super().run_pass(state))


class PartCompiler(CompilerBase):  # type: ignore[misc]
    """The usual compiler passes; the last one stops at intermediate code."""

    def define_pipelines(self) -> list[Any]:
        """Return the list with one pass manager."""
        usual = DefaultPassBuilder.define_nopython_pipeline(self.state)
        usual.passes = [
            (_LoweredAsPart if each is NativeLowering else each, why) for each, why in usual.passes
        ]
        usual.finalize()
        return [usual]


_REFUSAL = ctypes.cast(ctypes.pythonapi.PyVectorcall_Call, ctypes.c_void_p).value or 0
"""Address of a C function with Python's call signature; it raises TypeError: the object is not callable."""


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
    """Compile a kernel that Python calls, with its parts, and cache it on disk; it allocates no arrays."""
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


_SPLITTER = 134217729.0  # 2**27 + 1 halves a 53-bit significand


@exact
def two_sum(a: float, b: float) -> tuple[float, float]:
    """Rounded sum and its exact rounding error."""
    s = a + b
    v = s - a
    return s, (a - (s - v)) + (b - v)


@exact
def two_product(a: float, b: float) -> tuple[float, float]:
    """Rounded product and its exact rounding error."""
    p = a * b
    t = _SPLITTER * a
    ah = t - (t - a)
    al = a - ah
    t = _SPLITTER * b
    bh = t - (t - b)
    bl = b - bh
    return p, ((ah * bh - p) + ah * bl + al * bh) + al * bl


@exact
def less_product(x: float, a: float, b: float) -> float:
    """Value of x − a b with the product unrounded."""
    product = a * b
    total, rest = two_sum(x, -product)
    return total + (rest - multiply_add(a, b, -product))


@exact
def pair_product(ah: float, al: float, bh: float, bl: float) -> tuple[float, float]:
    """Product of two pairs."""
    p, e = two_product(ah, bh)
    return two_sum(p, e + (ah * bl + al * bh))


@exact
def pair_sum(ah: float, al: float, bh: float, bl: float) -> tuple[float, float]:
    """Sum of two pairs."""
    s, e = two_sum(ah, bh)
    return two_sum(s, e + (al + bl))


@exact
def less_multiple(x: float, k: float, step: float) -> float:
    """Return x − k·step without rounding the product."""
    high, low = two_product(k, step)
    return (x - high) - low


@inlined
def mixed(word: np.uint64) -> np.uint64:
    """Hash a word; see `clacad.base.hashing.mixed`."""
    word = (word ^ (word >> LOW)) * MIX
    word = (word ^ (word >> MIDDLE)) * STIR
    return word ^ (word >> HIGH)
