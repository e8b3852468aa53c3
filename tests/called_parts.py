"""Parts of kernels made callable: Python itself calls none."""

from __future__ import annotations

from functools import cache


@cache
def called(part):
    """A function that calls one part, compiled."""
    import numba

    @numba.njit(error_model="numpy")
    def entry(*given):
        return part(*given)

    return entry
