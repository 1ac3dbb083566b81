"""Where a command renders: in this process, in several, or on a cluster."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console

from ..rendering.executor import JobExecutor, LocalExecutor
from .process import interrupt_ends_process

if TYPE_CHECKING:
    from ..rendering.cluster import ClusterExecutor


@contextmanager
def place(scheduler: str | None, workers: int | None, console: Console) -> Iterator[JobExecutor]:
    """
    Give the executor that the options ask for.

    Ctrl-C ends this process at once where it renders. Elsewhere it is an exception, so that the
    workers are told.

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
        with interrupt_ends_process(), LocalExecutor() as local:
            yield local
    else:
        with _cluster(scheduler, workers, console) as cluster:
            yield cluster


def _cluster(scheduler: str | None, workers: int | None, console: Console) -> ClusterExecutor:
    # Not with the other imports: it is slow, and Dask need not be there.
    from ..rendering import cluster

    if scheduler is not None:
        return cluster.connect(scheduler, console.print)
    assert workers is not None
    return cluster.start(workers, console.print)
