"""Arrays on the stack of a kernel: they take no time to make, and LLVM knows that none is part of another."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic


@intrinsic  # type: ignore[untyped-decorator]
def stack_array(context: Any, shape: Any) -> Any:
    """Return an array of numbers of a shape, a tuple, that lasts until the kernel ends; what is in it is not known.

    It is called by kernels and what is `expanded` into them, outside of loops, for no more than a MB together.
    """
    array = types.Array(types.float64, shape.count, "C")

    def generate(target: Any, builder: Any, _: Any, arguments: Any) -> Any:
        from numba.np.arrayobj import populate_array  # which takes long to import, and only who compiles needs

        sizes, out = cgutils.unpack_tuple(builder, arguments[0], shape.count), target.make_array(array)(target, builder)
        width = step = ir.Constant(sizes[0].type, 8)
        strides: list[Any] = []
        for size in reversed(sizes):
            strides.insert(0, step)
            step = builder.mul(step, size)
        data = builder.alloca(ir.IntType(8), size=step)
        data.align = 64
        numbers = builder.bitcast(data, ir.DoubleType().as_pointer())
        populate_array(out, data=numbers, shape=sizes, strides=strides, itemsize=width, meminfo=None)
        return out._getvalue()

    return array(shape), generate
