"""Where jobs run: the interface of every place, and the place that is this process."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager, nullcontext
from typing import Any, ParamSpec, TypeVar

from . import provenance
from .job import Stage

P = ParamSpec("P")
T = TypeVar("T")


class JobExecutor(Executor, ABC):
    """Run jobs somewhere: ``submit(RenderJob.run, job)``, ``map(RenderJob.run, jobs)``."""

    @abstractmethod
    def alone(self) -> AbstractContextManager[Executor]:
        """
        Give an executor for jobs whose times are compared.

        It runs one job at a time, on one machine, and nothing else of this package runs there
        meanwhile. Its `map` starts a job only when its result is asked for.
        """

    @abstractmethod
    def machine(self) -> str:
        """Return the machine on which :meth:`alone` runs jobs, for the metadata of pictures."""

    def places(self) -> str:
        """Return where jobs run, for a sentence to the user; empty: in this process."""
        return ""


class OneByOne(Executor, ABC):
    """Run one job at a time: `submit` returns when it is done, and `map` waits to be asked."""

    @abstractmethod
    def _call(self, fn: Callable[..., T], *args: Any, **kwargs: Any) -> T:
        """Call `fn` where this executor runs its jobs."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Call `fn` now, and return a future that is done; an interrupt comes through at once."""
        future: Future[T] = Future()
        try:
            result = self._call(fn, *args, **kwargs)
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


class LocalExecutor(OneByOne, JobExecutor):
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
        return super().submit(fn, *args, **kwargs)

    def _call(self, fn: Callable[..., T], *args: Any, **kwargs: Any) -> T:
        with self._stage.open():
            return fn(*args, **kwargs)

    def alone(self) -> AbstractContextManager[Executor]:
        """Give this executor, whose jobs are always alone."""
        return nullcontext(self)

    def machine(self) -> str:
        """Return this machine, see :func:`mi_ellipse.rendering.provenance.machine`."""
        return provenance.machine()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more jobs, and free the scene; nothing is ever left to wait for or to cancel."""
        self._is_shut_down = True
        self._stage.clear()
