"""Rows of a block's scratch array: one quantity of every ray each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from clacad.base.kernel_cache import numba
from clacad.base.types import Floats

X, Y, Z, DX, DY, DZ, ROOT, PATH, GOOD, CI, CJ, CI0, CJ0, LEFT_X, LEFT_Y, GX, GY, GZ = range(18)
SHARE, OVER, DEPTH, STEEP, HALF, AX, AY, SCRATCH = range(18, 26)
"""Light let through is SHARE/OVER; DEPTH sums attenuation times length, STEEP is attenuation/N; HALF numbers half bins.
(AX, AY): how far the lens of a ray's cell stands from where the face's do, where cells differ."""

RANGE = ROOT
"""Distances, where facets take the place of a smooth face."""

XL, YL = GX, GY
"""What rounding takes from positions, on the way to another cell."""

BLOCK = 256
"""Rays in a block: the rows that one face works on take 24 KB, which the first-level cache holds."""


def _lane(typing_context: Any, scratch: Any, number: Any) -> Any:
    """Give a row of a scratch array (any, BLOCK) as a place so many numbers from its start."""
    one = scratch.copy(ndim=1)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        whole, made = context.make_array(scratch)(context, builder, arguments[0]), context.make_array(one)
        row = made(context, builder)
        width, size = (
            context.get_constant(numba.types.intp, n) for n in (BLOCK, scratch.dtype.bitwidth // 8)
        )
        start = builder.gep(whole.data, [builder.mul(arguments[1], width)])
        numba.np.arrayobj.populate_array(row, start, (width,), (size,), size, None)
        return row._getvalue()

    return one(scratch, numba.types.intp), generate


lane: Callable[[Floats, int], Floats] = numba.extending.intrinsic(_lane)
"""Row `number` of the scratch array, whose place is known when the kernel is compiled: of rows that plainly lie apart no loop
has to ask first whether they overlap, which takes longer than a short loop does."""
