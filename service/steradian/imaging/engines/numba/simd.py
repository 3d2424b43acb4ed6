"""SIMD vectors of 16, 4, 2 and 1 lanes inside Numba functions.

LLVM does not vectorise a butterfly whose eight streams may overlap, and Numba has no ``restrict``. So the kernels of
this package load, combine and store whole vectors themselves. A vector maps to whatever registers the machine has.
The lane count is part of the memory layout (a *cell* is 16 real parts followed by 16 imaginary parts).
Where bounds are checked (:mod:`steradian.core.jit`), a vector must lie within its array as a whole.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.core.extending import intrinsic, lower_builtin, register_model
from numba.core.typing.templates import AbstractTemplate, infer_global, signature

from steradian.imaging.engines.numba.constants import CACHE_LINE_BYTES

_FAST = ("contract", "nsz", "nnan", "ninf", "arcp")


class Vector(types.Type):
    """Numba type of a SIMD vector of ``lanes`` floating-point numbers."""

    def __init__(self, dtype: types.Type, lanes: int) -> None:
        self.dtype, self.lanes = dtype, lanes
        super().__init__(name=f"Vector({dtype}, {lanes})")


@register_model(Vector)
class VectorModel(models.PrimitiveModel):
    """Numba data model of a SIMD vector: an LLVM vector."""

    def __init__(self, manager: Any, frontend: Any) -> None:
        element = manager.lookup(frontend.dtype).get_value_type()
        kind = ir.VectorType(element, frontend.lanes)
        super().__init__(manager, frontend, kind)  # type: ignore[no-untyped-call]


def _register(function: Any, instruction: str) -> None:
    @infer_global(function)  # type: ignore[no-untyped-call]
    class Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            if len(args) == 2 and all(isinstance(a, Vector) for a in args) and args[0] == args[1]:
                return signature(args[0], *args)  # type: ignore[no-untyped-call]
            return None

    @lower_builtin(function, Vector, Vector)  # type: ignore[no-untyped-call]
    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return getattr(builder, instruction)(*args, flags=_FAST)


_register(operator.add, "fadd")
_register(operator.sub, "fsub")
_register(operator.mul, "fmul")


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any, vector: Any) -> Any:
    found = context.make_array(array_type)(context, builder, array)
    if context.enable_boundscheck:
        last = builder.add(index, ir.Constant(index.type, vector.count - 1))
        before = builder.icmp_signed("<", index, ir.Constant(index.type, 0))
        # one branch for both ends: with more of them LLVM takes minutes
        outside = builder.or_(before, builder.icmp_signed(">=", last, found.nitems))
        with cgutils.if_unlikely(builder, outside):  # type: ignore[no-untyped-call]
            context.call_conv.return_user_exc(builder, IndexError, ("index is out of bounds",))
    return builder.bitcast(builder.gep(found.data, [index]), ir.PointerType(vector))


def _load(lanes: int) -> Any:
    def typer(typingctx: Any, array: Any, index: Any) -> Any:
        vector = Vector(array.dtype, lanes)

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            kind = context.get_value_type(vector)
            pointer = _pointer(context, builder, sig.args[0], args[0], args[1], kind)
            return builder.load(pointer, align=array.dtype.bitwidth // 8, typ=kind)

        return vector(array, types.intp), codegen

    return typer


def _store(typingctx: Any, array: Any, index: Any, vector: Any) -> Any:
    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = context.get_value_type(vector)
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1], kind)
        builder.store(args[2], pointer, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, vector), codegen


def _stream(typingctx: Any, array: Any, index: Any, vector: Any, past: Any) -> Any:
    """Store a vector non-temporally: bypass the caches, so that useful data stay cached.

    Where the place is not on a line's boundary, or not ``past``, it is a plain store. Others see it after
    :func:`store_fence`.
    """

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = context.get_value_type(vector)
        pointer = _pointer(context, builder, sig.args[0], args[0], args[1], kind)
        word = ir.IntType(64)
        beside = builder.and_(builder.ptrtoint(pointer, word), ir.Constant(word, CACHE_LINE_BYTES - 1))
        at_start = builder.icmp_unsigned("==", beside, ir.Constant(word, 0))
        with builder.if_else(builder.and_(at_start, args[3])) as (whole, other):
            with whole:
                stored = builder.store(args[2], pointer, align=CACHE_LINE_BYTES)
                once = builder.module.add_metadata([ir.Constant(ir.IntType(32), 1)])
                stored.set_metadata("nontemporal", once)
            with other:
                builder.store(args[2], pointer, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.void(array, types.intp, vector, types.boolean), codegen


def _settle(typingctx: Any) -> Any:
    """Execute a memory fence after non-temporal stores."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        builder.fence("seq_cst")
        return context.get_dummy_value()

    return types.void(), codegen


def _splat(lanes: int) -> Any:
    def typer(typingctx: Any, value: Any) -> Any:
        vector = Vector(value, lanes)

        def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
            kind = context.get_value_type(vector)
            single = builder.insert_element(ir.Constant(kind, ir.Undefined), args[0], ir.Constant(ir.IntType(32), 0))
            mask = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
            return builder.shuffle_vector(single, ir.Constant(kind, ir.Undefined), mask)

        return vector(value), codegen

    return typer


load16: Any = intrinsic(_load(16))
load4: Any = intrinsic(_load(4))
load2: Any = intrinsic(_load(2))
load1: Any = intrinsic(_load(1))
store: Any = intrinsic(_store)
stream_store: Any = intrinsic(_stream)
store_fence: Any = intrinsic(_settle)
broadcast16: Any = intrinsic(_splat(16))
splat4: Any = intrinsic(_splat(4))
splat2: Any = intrinsic(_splat(2))
splat1: Any = intrinsic(_splat(1))


def _row(builder: Any, rows: Any, context: Any, rows_type: Any, i: int, at: Any) -> Any:
    place = _pointer(context, builder, rows_type, rows, ir.Constant(at.type, i), ir.VectorType(at.type, 1))
    start = builder.extract_element(builder.load(place, align=8), ir.Constant(ir.IntType(32), 0))
    return builder.add(start, at)


def _shuffled(builder: Any, rows: list[Any]) -> list[Any]:
    """Transpose 16 vectors of 16 by four rounds of interleaving."""
    word = ir.VectorType(ir.IntType(32), 16)
    low = ir.Constant(word, [x for i in range(8) for x in (i, 16 + i)])
    high = ir.Constant(word, [x for i in range(8, 16) for x in (i, 16 + i)])
    for _ in range(4):
        pairs = [(rows[i], rows[i + 8]) for i in range(8)]
        rows = [builder.shuffle_vector(a, b, mask) for a, b in pairs for mask in (low, high)]
    return rows


def _collect(typingctx: Any, source: Any, rows: Any, at: Any, target: Any, offset: Any) -> Any:
    """Load 16 numbers from each of 16 rows ``source[rows[i] + at:]`` into lanes i of ``target[offset + 32 n:]``."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = ir.VectorType(context.get_value_type(source.dtype), 16)
        align = source.dtype.bitwidth // 8
        values = []
        for i in range(16):
            place = _row(builder, args[1], context, sig.args[1], i, args[2])
            pointer = _pointer(context, builder, sig.args[0], args[0], place, kind)
            values.append(builder.load(pointer, align=align, typ=kind))
        for i, value in enumerate(_shuffled(builder, values)):
            place = builder.add(args[4], ir.Constant(args[4].type, 32 * i))
            builder.store(value, _pointer(context, builder, sig.args[3], args[3], place, kind), align=align)
        return context.get_dummy_value()

    return types.void(source, rows, types.intp, target, types.intp), codegen


def _distribute(typingctx: Any, source: Any, offset: Any, target: Any, rows: Any, at: Any) -> Any:
    """Store lane i of 16 cells ``source[offset + 32 n:]`` to row ``target[rows[i] + at:]``."""

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = ir.VectorType(context.get_value_type(source.dtype), 16)
        align = source.dtype.bitwidth // 8
        values = []
        for i in range(16):
            place = builder.add(args[1], ir.Constant(args[1].type, 32 * i))
            pointer = _pointer(context, builder, sig.args[0], args[0], place, kind)
            values.append(builder.load(pointer, align=align, typ=kind))
        for i, value in enumerate(_shuffled(builder, values)):
            place = _row(builder, args[3], context, sig.args[3], i, args[4])
            builder.store(value, _pointer(context, builder, sig.args[2], args[2], place, kind), align=align)
        return context.get_dummy_value()

    return types.void(source, types.intp, target, rows, types.intp), codegen


transpose_gather: Any = intrinsic(_collect)
transpose_scatter: Any = intrinsic(_distribute)
