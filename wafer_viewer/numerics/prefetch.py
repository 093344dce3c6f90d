"""Software prefetch of rows that the hardware prefetcher does not predict."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from wafer_viewer.numerics.array_types import Greys
from wafer_viewer.numerics.jit import inlined_part

_LINE_BYTES = 64
_TO_READ, _KEEP, _DATA = 0, 3, 1


@inlined_part
def prefetch(row: Greys) -> None:
    """Prefetch a row into the caches, without waiting and without side effects."""
    for x in range(0, row.size, _LINE_BYTES // row.itemsize):
        _prefetch(row, x)


def _typed(_: Any, row: Any, index: Any) -> Any:
    return types.void(row, index), _emit


def _emit(context: Any, builder: Any, signature: Any, args: Any) -> Any:
    data = context.make_array(signature.args[0])(context, builder, args[0]).data
    number = ir.IntType(32)
    kind = ir.FunctionType(ir.VoidType(), [data.type, number, number, number])
    instruction = builder.module.declare_intrinsic("llvm.prefetch", [data.type], kind)
    builder.call(instruction, [builder.gep(data, [args[1]]), *(number(n) for n in (_TO_READ, _KEEP, _DATA))])
    return context.get_dummy_value()


_prefetch: Any = intrinsic(_typed)
