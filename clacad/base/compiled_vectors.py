"""Columns of vectors (n, 3) split into components and joined again, eight vectors at a time, compiled.

Compilers move numbers with a stride of three one by one; here eight vectors are three loads and six
permutations. The code runs on any processor: one without registers of eight numbers uses registers of four or
two.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from clacad.base.kernel_cache import numba
from clacad.base.types import Floats

EIGHT = 8

ir: Any = numba.core.cgutils.ir
LANES = ir.VectorType(ir.DoubleType(), EIGHT)


def _mask(picks: list[int]) -> Any:
    """Indices of the elements of two vectors that form a third."""
    return ir.Constant(ir.VectorType(ir.IntType(32), EIGHT), picks)


def _places(context: Any, builder: Any, signature: Any, arguments: Any) -> tuple[Any, list[Any]]:
    """Pointers to eight vectors of the column, and to eight elements of each of x, y, z."""
    column, row, x, y, z, k = arguments
    types = signature.args
    first = builder.mul(row, context.get_constant(numba.types.intp, 3))

    def at(kind: Any, array: Any, index: Any) -> Any:
        data = context.make_array(kind)(context, builder, array).data
        return builder.bitcast(builder.gep(data, [index]), LANES.as_pointer())

    return at(types[0], column, first), [
        at(kind, array, k) for kind, array in zip(types[2:5], (x, y, z), strict=True)
    ]


def _signature(column: Any, row: Any, x: Any, y: Any, z: Any, k: Any) -> Any:
    if column.layout != "C" or column.dtype != numba.types.float64:
        raise numba.core.errors.TypingError("vectors lie one behind the other, in double precision")
    return numba.types.void(column, numba.types.intp, x, y, z, numba.types.intp)


def _apart(typing_context: Any, column: Any, row: Any, x: Any, y: Any, z: Any, k: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source, rows = _places(context, builder, signature, arguments)
        index = ir.IntType(32)
        three = [builder.load(builder.gep(source, [index(n)]), align=8) for n in range(3)]
        for c, target in enumerate(rows):
            places = [divmod(3 * n + c, EIGHT) for n in range(EIGHT)]
            first = [e + EIGHT * v if v < 2 else 0 for v, e in places]
            second = [n if v < 2 else EIGHT + e for n, (v, e) in enumerate(places)]
            two = builder.shuffle_vector(three[0], three[1], _mask(first))
            builder.store(builder.shuffle_vector(two, three[2], _mask(second)), target, align=8)
        return context.get_dummy_value()

    return _signature(column, row, x, y, z, k), generate


def _together(typing_context: Any, column: Any, row: Any, x: Any, y: Any, z: Any, k: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        target, rows = _places(context, builder, signature, arguments)
        index = ir.IntType(32)
        three = [builder.load(source, align=8) for source in rows]
        for v in range(3):
            places = [divmod(EIGHT * v + e, 3) for e in range(EIGHT)]
            first = [n + EIGHT * c if c < 2 else 0 for n, c in places]
            second = [e if c < 2 else EIGHT + n for e, (n, c) in enumerate(places)]
            two = builder.shuffle_vector(three[0], three[1], _mask(first))
            woven = builder.shuffle_vector(two, three[2], _mask(second))
            builder.store(woven, builder.gep(target, [index(v)]), align=8)
        return context.get_dummy_value()

    return _signature(column, row, x, y, z, k), generate


Moved = Callable[[Floats, int, Floats, Floats, Floats, int], None]

eight_apart: Moved = numba.extending.intrinsic(_apart)
"""Copy eight vectors of a column (n, 3), starting at a row, to x, y, z, starting at element k."""

eight_together: Moved = numba.extending.intrinsic(_together)
"""Copy eight elements of x, y, z, starting at k, to the vectors of a column (n, 3), starting at a row."""
