"""Where jobs run: here, in this process, behind the interface that other places would have too."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from typing import Any, ParamSpec, TypeVar

from .job import Stage

P = ParamSpec("P")
T = TypeVar("T")


class LocalExecutor(Executor):
    """
    Run jobs in this process, one at a time, so that their times can be compared.

    ``executor.submit(RenderJob.run, job)`` and ``executor.map(RenderJob.run, jobs)`` work as with
    any other ``concurrent.futures.Executor``, with two differences: `submit` returns when the job
    is done, and `map` starts a job only when its result is asked for. So what is made of a picture
    is safe before the next one begins. Jobs in a row with the same scene load it once;
    `shutdown`, or the end of a ``with`` block, frees it.
    """

    def __init__(self) -> None:
        self._stage = Stage()
        self._is_shut_down = False

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Call `fn` now, and return a future that is done; an interrupt comes through at once."""
        if self._is_shut_down:
            raise RuntimeError("cannot submit a job to an executor that was shut down")
        future: Future[T] = Future()
        try:
            with self._stage.open():
                result = fn(*args, **kwargs)
        except Exception as error:
            future.set_exception(error)
        else:
            future.set_result(result)
        return future

    def map(
        self,
        fn: Callable[..., T],
        *iterables: Iterable[Any],
        timeout: float | None = None,
        chunksize: int = 1,
        **options: Any,
    ) -> Iterator[T]:
        """Yield the results in order, each made when it is asked for; the options do nothing."""
        return (self.submit(fn, *arguments).result() for arguments in zip(*iterables, strict=False))

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more jobs, and free the scene; nothing is ever left to wait for or to cancel."""
        self._is_shut_down = True
        self._stage.clear()
