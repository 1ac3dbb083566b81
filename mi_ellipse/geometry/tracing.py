"""Helpers that make Dr.Jit trace less, or what it would leave out."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi

# Smallest normal single-precision number: a floor for denominators whose numerators vanish too.
TINY = 1.1754944e-38


def cross(a, b):
    """Cross product: `drjit.cross`, which takes three times as long to trace."""
    return type(a)(
        dr.fma(a.y, b.z, -(a.z * b.y)),
        dr.fma(a.z, b.x, -(a.x * b.z)),
        dr.fma(a.x, b.y, -(a.y * b.x)),
    )


def branch(argument, condition, on_true: Callable, on_false: Callable) -> Any:
    """Call one of two functions at a branch of the kernel, which skips the other one.

    `dr.if_stmt` removes a branch whose condition it can evaluate, and takes the size of the branch
    from the condition. So the condition is compared with the argument as well: ``argument.x < 2``
    is always true, but Dr.Jit cannot see that, and the branch stays.

    Parameters
    ----------
    argument
        Argument of both functions: random numbers or a unit vector.
    condition
        Mask, or True for a branch that only looks at the mask of the call around it.
    on_true, on_false
        Functions of the argument that return the same types. Derivatives trace them again: they
        must not keep a variable from one trace to the next.
    """
    return dr.if_stmt((argument,), condition & (argument.x < 2), on_true, on_false)


def take(dtype: type, source: Any, index: Any) -> Any:
    """Element of arrays at an index: a gather, or an item of a list in scalar variants."""
    return dr.gather(dtype, source, index) if dr.is_jit_v(mi.Float) else source[index]


def instance_number(own: int) -> mi.UInt32 | None:
    """Variable for the registry number of the instance whose method is being traced.

    Dr.Jit traces a method of an emitter for each living emitter. It keeps a variable that is the
    same in all these traces and stands for the instance that is called. ``mi.EmitterPtr(self)``
    gives a constant of one instance instead, which the trace of another one cannot use.

    Dr.Jit's C++ code reads the variable through ``jit_var_self(JitBackend, uint32_t*, uint32_t*)``.
    Python has no function for it. So this calls the function of the core library, under the name
    that C++ compilers on Linux and macOS give to it.

    Parameters
    ----------
    own
        Registry number of the instance that asks.

    Returns
    -------
    mi.UInt32 or None
        None if no call of this instance is being traced, or if the core library has no such
        function.
    """
    function = _jit_var_self()
    if function is None or not dr.is_jit_v(mi.Float):
        return None
    value, index = ctypes.c_uint32(), ctypes.c_uint32()
    function(int(dr.backend_v(mi.Float).value), ctypes.byref(value), ctypes.byref(index))
    if value.value != own or not index.value:
        return None
    return dr.detail.update_indices(mi.UInt32(0), [index.value])


def registry_number(emitter: mi.Emitter) -> int:
    """Number of an emitter in Dr.Jit's registry."""
    return dr.reinterpret_array(mi.UInt32, mi.EmitterPtr(emitter))[0]


@cache
def _jit_var_self() -> Callable | None:
    for name in ("libdrjit-core.so", "libdrjit-core.dylib"):
        library = Path(dr.__file__).with_name(name)
        if library.is_file():
            function = getattr(ctypes.CDLL(str(library)), "_Z12jit_var_self10JitBackendPjS0_", None)
            if function is not None:
                pointer = ctypes.POINTER(ctypes.c_uint32)
                function.argtypes, function.restype = [ctypes.c_int, pointer, pointer], None
            return function
    return None
