"""Parts of kernels: functions that only compiled code calls, turned into machine code once, within their
kernel.

The usual compiler optimises each function together with all its callees and makes machine code of the whole.
A walk of six call levels is compiled six times, and only the outermost version ever runs. A part stops at
intermediate code, which its callers link in. Only a function that Python calls (`clacad.base.compiled.entry`)
is optimised and compiled to machine code, once, as a whole. This halves the compilation time.
"""

from __future__ import annotations

import ctypes
from typing import Any

from clacad.base.kernel_cache import numba

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
