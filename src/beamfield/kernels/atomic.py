"""Words of memory that several threads read and write at once, and arrays and functions by address.

Numba has neither. All words are 64-bit integers of an array; the functions work in compiled kernels only. They call
nothing, so that kernels of other files may call them in spite of Numba's disk cache.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.cgutils import get_or_insert_function
from numba.extending import intrinsic as numba_intrinsic


def intrinsic(function: Any) -> Any:
    """Let kernels call what a function describes; Numba's own type asks callers for the typing context."""
    return numba_intrinsic(function)


WORD_BYTES = 8
# LLVM's names of the instructions that tell a processor that it is waiting, with their arguments.
PAUSES: dict[str, tuple[str, list[int]]] = {
    "x86_64": ("llvm.x86.sse2.pause", []),
    "aarch64": ("llvm.aarch64.isb", [15]),
    "arm64": ("llvm.aarch64.isb", [15]),
}


def _word(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    """Return the pointer to a word of an array."""
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [index])


@intrinsic
def load(typingctx: Any, words: Any, i: Any) -> Any:
    """load(words, i) -> words[i], and all that the thread wrote that stored it there."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = _word(context, builder, signature.args[0], args[0], args[1])
        return builder.load_atomic(pointer, "seq_cst", WORD_BYTES)

    return types.int64(words, types.intp), codegen


@intrinsic
def store(typingctx: Any, words: Any, i: Any, value: Any) -> Any:
    """store(words, i, value): words[i] = value, after everything that this thread wrote before."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = _word(context, builder, signature.args[0], args[0], args[1])
        builder.store_atomic(args[2], pointer, "seq_cst", WORD_BYTES)
        return context.get_dummy_value()

    return types.void(words, types.intp, types.int64), codegen


@intrinsic
def add(typingctx: Any, words: Any, i: Any, value: Any) -> Any:
    """add(words, i, value): words[i] += value; the value before is returned."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = _word(context, builder, signature.args[0], args[0], args[1])
        return builder.atomic_rmw("add", pointer, args[2], "seq_cst")

    return types.int64(words, types.intp, types.int64), codegen


@intrinsic
def replace(typingctx: Any, words: Any, i: Any, old: Any, new: Any) -> Any:
    """replace(words, i, old, new): words[i] = new if it was old; whether it was."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = _word(context, builder, signature.args[0], args[0], args[1])
        pair = builder.cmpxchg(pointer, args[2], args[3], "seq_cst", "seq_cst")
        return builder.extract_value(pair, 1)

    return types.boolean(words, types.intp, types.int64, types.int64), codegen


@intrinsic
def pause(typingctx: Any) -> Any:
    """pause(): wait for some tens of cycles, leaving the core to its other thread; nothing on rarer processors."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        name, numbers = PAUSES.get(builder.module.triple.split("-")[0], ("", []))
        if name:
            of_type = ir.FunctionType(ir.VoidType(), [ir.IntType(32)] * len(numbers))
            instruction = get_or_insert_function(builder.module, of_type, name)
            builder.call(instruction, [ir.Constant(ir.IntType(32), number) for number in numbers])
        return context.get_dummy_value()

    return types.void(), codegen


@intrinsic
def call(typingctx: Any, address: Any, words: Any, start: Any, stop: Any) -> Any:
    """call(address, words, start, stop): call the C function void (int64 *words, int64 start, int64 stop) there.

    Both addresses are integers.
    """

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        word = ir.IntType(64)
        function = ir.FunctionType(ir.VoidType(), [word.as_pointer(), word, word])
        target = builder.inttoptr(args[0], function.as_pointer())
        builder.call(target, [builder.inttoptr(args[1], word.as_pointer()), args[2], args[3]])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64, types.int64), codegen


@intrinsic
def pointer(typingctx: Any, address: Any) -> Any:
    """pointer(address): the address as a pointer, for `numba.carray`."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.inttoptr(args[0], ir.IntType(8).as_pointer())

    return types.voidptr(types.int64), codegen
