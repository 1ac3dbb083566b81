"""Where a command renders: in this process, in several, or on a cluster."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING

from rich.console import Console

from ..rendering.executor import JobExecutor, LocalExecutor
from .process import interrupt_ends_process

if TYPE_CHECKING:
    from ..rendering.cluster import ClusterExecutor


def place(
    scheduler: str | None, workers: int | None, console: Console
) -> AbstractContextManager[JobExecutor]:
    """
    Give the executor that the options ask for.

    Raises
    ------
    ImportError
        If a cluster is asked for and Dask is not installed.
    ValueError
        If both options are given.
    """
    if scheduler is not None and workers is not None:
        raise ValueError("--scheduler and --workers exclude each other: choose one of them")
    if scheduler is None and workers is None:
        return LocalExecutor()
    return _cluster(scheduler, workers, console)


def interruptible(executor: JobExecutor) -> AbstractContextManager[None]:
    """
    Let Ctrl-C end the process at once where the process itself renders.

    Elsewhere it stays an exception, so that the workers are told.
    """
    return interrupt_ends_process() if isinstance(executor, LocalExecutor) else nullcontext()


def _cluster(scheduler: str | None, workers: int | None, console: Console) -> ClusterExecutor:
    # Not with the other imports: it is slow, and Dask need not be there.
    from ..rendering import cluster

    if scheduler is not None:
        return cluster.connect(scheduler, console.print)
    assert workers is not None
    return cluster.start(workers, console.print)
