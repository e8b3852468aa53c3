"""Rows of a block's scratch array: each holds one quantity of every ray."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from clacad.base.kernel_cache import numba
from clacad.base.types import Floats

X, Y, Z, DX, DY, DZ, ROOT, PATH, GOOD, CI, CJ, CI0, CJ0, LEFT_X, LEFT_Y, GX, GY, GZ = range(18)
SHARE, OVER, DEPTH, STEEP, HALF, AX, AY, SCRATCH = range(18, 26)
"""Transmitted light is SHARE/OVER; DEPTH sums attenuation times length, STEEP is attenuation/N; HALF numbers
half bins.
(AX, AY): offset of the lens of a ray's cell from the face's vertex, on non-uniform sheets.
"""

RANGE = ROOT
"""Distances, where facets replace a smooth face."""

XL, YL = GX, GY
"""Rounding errors of positions, on the way to another cell."""

BLOCK = 256
"""Rays in a block: the rows that one face works on take 24 KB, which the first-level cache holds."""


def _row(context: Any, builder: Any, scratch: Any, value: Any, number: Any) -> Any:
    """Row of a scratch array (any, BLOCK) as an address at a fixed offset from its start."""
    whole = context.make_array(scratch)(context, builder, value)
    row = context.make_array(scratch.copy(ndim=1))(context, builder)
    width, size = (context.get_constant(numba.types.intp, n) for n in (BLOCK, scratch.dtype.bitwidth // 8))
    start = builder.gep(whole.data, [builder.mul(number, width)])
    numba.np.arrayobj.populate_array(row, start, (width,), (size,), size, None)
    return row._getvalue()


def _lane(typing_context: Any, scratch: Any, number: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _row(context, builder, scratch, *arguments)

    return scratch.copy(ndim=1)(scratch, numba.types.intp), generate


def _lanes(typing_context: Any, scratch: Any, numbers: Any) -> Any:
    count = len(numbers)
    asked = numba.types.UniTuple(numba.types.intp, count)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        rows = [
            _row(context, builder, scratch, arguments[0], number)
            for number in numba.core.cgutils.unpack_tuple(builder, arguments[1], count)
        ]
        return context.make_tuple(builder, signature.return_type, rows)

    return numba.types.UniTuple(scratch.copy(ndim=1), count)(scratch, asked), generate


lane: Callable[[Floats, int], Floats] = numba.extending.intrinsic(_lane)
"""Row `number` of the scratch array, at an address known when the kernel is compiled.

Loops over rows that cannot overlap need no overlap test, which takes longer than a short loop.
"""

lanes: Callable[[Floats, tuple[int, ...]], tuple[Floats, ...]] = numba.extending.intrinsic(_lanes)
"""Several rows at once."""
