"""Helpers that make Dr.Jit trace less, or what it would leave out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

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


def table(dtype: type, columns: Any) -> Any:
    """Dr.Jit array of NumPy columns, one array a component; a list of rows in scalar variants.

    The values are copied by way of a list. Dr.Jit would use NumPy's own memory otherwise. Its
    alignment differs from array to array, and `dr.freeze` records anew for each alignment.
    """
    columns = np.asarray(columns)
    if not dr.is_jit_v(mi.Float):
        rows = columns.T.tolist()
        return rows if columns.ndim == 1 else [dtype(row) for row in rows]
    if columns.ndim == 1:
        return dtype(columns.tolist())
    return dtype(*(dr.value_t(dtype)(column.tolist()) for column in columns))


def lookup(wanted: bool) -> Any:
    """Let Dr.Jit search for each new operation among all living ones, or stop it from that.

    With a hundred lamps this search is a quarter of the time to trace them. The strategies hardly
    repeat an operation, so they do without it. Mitsuba's bitmaps repeat operations, so lamps with a
    bitmap keep it.
    """
    return dr.scoped_set_flag(dr.JitFlag.ValueNumbering, wanted)
