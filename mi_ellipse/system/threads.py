"""Threads that Dr.Jit renders with, for a while."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import drjit as dr


@contextmanager
def use_threads(count: int) -> Iterator[None]:
    """Let Dr.Jit use so many threads during the block."""
    before = dr.thread_count()
    if count == before:
        yield
        return
    dr.set_thread_count(count)
    try:
        yield
    finally:
        dr.set_thread_count(before)
