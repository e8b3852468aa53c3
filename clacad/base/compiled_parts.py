"""Parts of kernels: functions that only compiled code calls, made into machine code once, within the kernel they serve.

A compiler of functions optimises each one with all it calls and makes machine code of the whole: a walk of six levels is
made six times, and only the outermost is ever run. A part stops at its own intermediate code, which its callers take in;
what Python calls (`clacad.base.compiled.entry`) is optimised and made once, as a whole. That takes half of the time.
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
    """A code generator that keeps no constants for a function Python cannot call."""

    def __init__(self, generator: Any) -> None:
        self._generator = generator

    def __getattr__(self, name: str) -> Any:
        return getattr(self._generator, name)

    def set_env(self, name: str, environment: object) -> None:
        """Do nothing: there is no machine code that would look for it."""


class PartLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Intermediate code of a part and of all that it calls; never optimised, never machine code."""

    @property
    def codegen(self) -> Any:
        """The generator, without a place for constants of this function."""
        return _WithoutEnvironments(self._codegen)

    def _optimize_functions(self, module: Any) -> None:
        """Take a module as it is."""
        module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        """Leave that to the kernel."""

    def _finalize_final_module(self) -> None:
        """Make no machine code."""
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Give what Python runs if it calls the part after all: a refusal."""
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
    """The usual passes, the last of which stops at intermediate code."""

    def define_pipelines(self) -> list[Any]:
        """Give the passes."""
        usual = DefaultPassBuilder.define_nopython_pipeline(self.state)
        usual.passes = [
            (_LoweredAsPart if each is NativeLowering else each, why) for each, why in usual.passes
        ]
        usual.finalize()
        return [usual]


_REFUSAL = ctypes.cast(ctypes.pythonapi.PyVectorcall_Call, ctypes.c_void_p).value or 0
"""A C function of the kind Python calls here; it says with a TypeError that what it was given cannot be called."""
