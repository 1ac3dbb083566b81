"""One trace for all members of a group.

Dr.Jit traces a method of an emitter once for each living emitter, with the same variables for the
arguments. The members of a group have the same code, so the first trace serves all of them.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi

# `jit_var_self(JitBackend, uint32_t*, uint32_t*)`, as C++ compilers on Linux and macOS name it
SYMBOL = "_Z12jit_var_self10JitBackendPjS0_"
LIBRARIES = ("libdrjit-core.so", "libdrjit-core.dylib")


@dataclass
class Member:
    """A lamp in a group."""

    place: int  # Among the lamps of the group
    number: int  # In Dr.Jit's registry; in scalar variants the place
    constant: mi.UInt32  # The number. It is opaque: members differ in data, and not in code.


def member(place: int, emitter: mi.Emitter) -> Member:
    """The emitter as the member of a group, at this place."""
    if not dr.is_jit_v(mi.Float):
        return Member(place, place, place)
    number = dr.reinterpret_array(mi.UInt32, mi.EmitterPtr(emitter))[0]
    return Member(place, number, dr.opaque(mi.UInt32, number))


class Once:
    """A function of the member that is called, which is traced once for all members.

    The first trace keeps its result, and the others return it. The last one lets it go: nothing of
    a trace may outlive it.

    Parameters
    ----------
    members
        How many members there are.
    possible
        Tells whether the members can share a trace.
    """

    def __init__(self, members: int, possible: Callable[[], bool] = lambda: True):
        self.members = members
        self.possible = possible
        self._forget()

    def __call__(self, function: Callable, called: Member, *arguments: Any) -> Any:
        """``function(number, *arguments)`` with a variable for the number of the member."""
        number = traced_instance(called.number)
        if number is None:
            return function(called.constant, *arguments)
        key = tuple(dr.detail.collect_indices(arguments))
        if self._key != key:
            self._forget()
            # Derivatives trace a function again, with other variables.
            if dr.grad_enabled(arguments) or not self.possible():
                return function(called.constant, *arguments)
            # The arguments too: as long as they live, no other variables have their numbers.
            self._key, self._arguments = key, arguments
            self._result = function(number, *arguments)
        self._served += 1
        result = self._result
        if self._served == self.members:
            self._forget()
        return result

    def _forget(self) -> None:
        self._key = self._arguments = self._result = None
        self._served = 0


def traced_instance(number: int) -> mi.UInt32 | None:
    """Variable for the registry number of the instance whose method is being traced.

    Dr.Jit has such a variable. ``mi.EmitterPtr(self)`` gives a constant of one instance instead,
    which the trace of another one cannot use. Dr.Jit's C++ code reads the variable through
    ``jit_var_self``. Python has no function for it, so this calls the core library.

    Parameters
    ----------
    number
        Registry number of the instance that asks.

    Returns
    -------
    mi.UInt32 or None
        None if no method of this instance is being traced, or if the core library has no such
        function.
    """
    function = _jit_var_self()
    if function is None or not dr.is_jit_v(mi.Float):
        return None
    value, index = ctypes.c_uint32(), ctypes.c_uint32()
    function(int(dr.backend_v(mi.Float).value), ctypes.byref(value), ctypes.byref(index))
    if value.value != number or not index.value:
        return None
    return dr.detail.update_indices(mi.UInt32(0), [index.value])


@cache
def _jit_var_self() -> Callable | None:
    for name in LIBRARIES:
        library = Path(dr.__file__).with_name(name)
        if library.is_file():
            function = getattr(ctypes.CDLL(str(library)), SYMBOL, None)
            if function is not None:
                pointer = ctypes.POINTER(ctypes.c_uint32)
                function.argtypes, function.restype = [ctypes.c_int, pointer, pointer], None
            return function
    return None
