"""How a command ends: with one line for an error, and at once for Ctrl-C."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import typer

from ..system.messages import innermost_cause


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Turn an exception into one line on stderr and exit code 1."""
    try:
        yield
    except Exception as error:
        print(f"mi-ellipse: {innermost_cause(error)}", file=sys.stderr)
        raise typer.Exit(1) from error


@contextmanager
def interrupt_ends_process() -> Iterator[None]:
    """
    Let Ctrl-C end the process at once.

    Python would notice it only when Mitsuba returns from rendering a pass, which can take hours;
    nothing has been written by then that would need cleaning up.
    """
    before = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
