"""Memory prefetch.

A mesh query reads many scattered cache lines, each address taken from the one before. Where the next query points are
known, their lines can be loaded meanwhile.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic, overload

# Arguments of llvm.prefetch: read access, high temporal locality, data cache.
_READ, _KEEP, _DATA = 0, 3, 1


@intrinsic
def _fetch(typing_context: Any, array: Any, row: Any) -> tuple:
    """Prefetch a row of an array of any rank, without a bounds check."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pool = context.make_array(signature.args[0])(context, builder, arguments[0])
        stride = cgutils.unpack_tuple(builder, pool.strides)[0]
        byte = ir.IntType(8).as_pointer()
        place = builder.gep(builder.bitcast(pool.data, byte), [builder.mul(stride, arguments[1])])
        number = ir.IntType(32)
        function = builder.module.declare_intrinsic(
            "llvm.prefetch", [byte], ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        )
        builder.call(function, [place, number(_READ), number(_KEEP), number(_DATA)])
        return context.get_dummy_value()

    return types.void(array, types.intp), generate


def fetch(array: Any, row: int) -> None:
    """Prefetch the first cache line of a row of `array`; the row need not exist. Does nothing when not compiled."""


@overload(fetch, inline="always", strict=False)
def _compiled_fetch(array: Any, row: Any) -> Any:
    return lambda array, row: _fetch(array, row)
