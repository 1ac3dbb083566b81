"""How a command ends: with one line for an error, and for Ctrl-C at once or after a pass."""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import mitsuba as mi
import typer

from ..system.messages import innermost_cause

INTERRUPTED = 128 + signal.SIGINT  # Exit code, as shells have it


@contextmanager
def one_line_errors() -> Iterator[None]:
    """Turn an exception into one line on stderr and exit code 1."""
    try:
        yield
    except typer.Exit:
        raise
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


@contextmanager
def interrupt_ends_pass(say: Callable[[str], None]) -> Iterator[Callable[[], bool]]:
    """
    Give a function that tells whether Ctrl-C was pressed; a second one ends the process at once.

    A thread waits for the signal, since Python calls handlers only between passes. Dr.Jit lets
    other threads run while it renders.

    Parameters
    ----------
    say
        Called with a sentence for the user at the first Ctrl-C.
    """
    pressed = threading.Event()
    end, start = socket.socketpair()
    start.setblocking(False)

    def wait() -> None:
        while number := end.recv(1):
            if number[0] != signal.SIGINT:
                continue
            if pressed.is_set():
                os._exit(INTERRUPTED)
            pressed.set()
            say("Ends after this pass; Ctrl-C again ends at once and keeps nothing.")

    handler = signal.signal(signal.SIGINT, lambda *_: None)
    descriptor = signal.set_wakeup_fd(start.fileno())
    thread = threading.Thread(target=wait, daemon=True)
    thread.start()
    try:
        yield pressed.is_set
    finally:
        signal.set_wakeup_fd(descriptor)
        signal.signal(signal.SIGINT, handler)
        start.close()
        thread.join()
        end.close()


@contextmanager
def plain_log() -> Iterator[None]:
    """
    Let Mitsuba write what it has to say to stderr, a line each and without colours.

    Its own way is red letters and dates on stdout, where pipes and files take the results from.
    """
    # Mitsuba's stubs take `mi.logger` for an object.
    logger: Any = vars(mi)["logger"]()
    before = [logger.appender(i) for i in range(logger.appender_count())]
    logger.clear_appenders()
    logger.add_appender(_Plain())
    try:
        yield
    finally:
        logger.clear_appenders()
        for appender in before:
            logger.add_appender(appender)


class _Plain(mi.Appender):
    """Write messages as plain lines."""

    def append(self, level: mi.LogLevel, text: str) -> None:
        """Write a message without its date: "WARN  [MultijitterSampler] …"."""
        _, _, message = text.partition(f" {level.name.upper()} ")
        print(f"{level.name.upper()}: {' '.join((message or text).split())}", file=sys.stderr)

    def log_progress(
        self, progress: float, name: str, formatted: str, eta: str, ptr: object = None
    ) -> None:
        """Leave out Mitsuba's own progress bars."""
