"""What the workers of a cluster do: keep the files of scenes, prove what they are, run jobs."""

from __future__ import annotations

import dataclasses
import platform
import shutil
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import distributed
import drjit as dr
from distributed.diagnostics.plugin import WorkerPlugin

from . import parcel, provenance
from .job import RenderJob, Stage
from .passes import Rendering

# Seconds after which a worker that holds still looks whether it still has to
PATIENCE = 0.5

# One job at a time: Mitsuba's variant belongs to the process, and a job uses all its threads.
_lock = threading.Lock()
_stage = Stage()


@dataclass(frozen=True)
class Identity:
    """What a worker renders with, and where."""

    code: Mapping[str, str]  # must be equal for equal pictures
    digits: Mapping[str, str]  # must be equal for pictures that are equal bit for bit
    machine: str
    host: str


@cache
def _code() -> dict[str, str]:
    return {
        **provenance.versions(),
        "python_version": ".".join(platform.python_version_tuple()[:2]),  # The next one needs it.
        "picture_digest": provenance.picture_digest(),
    }


def identity() -> Identity:
    """Return what this process renders with."""
    digits = {
        "llvm": ".".join(map(str, dr.detail.llvm_version())),
        "processor": provenance.processor(),
    }
    return Identity(_code(), digits, provenance.machine(), platform.node())


def identity_of_worker(dask_worker: distributed.Worker) -> Identity:
    """Return what a worker renders with, on its own threads; Dask gives the worker."""
    own = _settled(dask_worker)
    return dataclasses.replace(own, machine=f"{own.machine}, on {own.host}")


def _settled(worker: distributed.Worker) -> Identity:
    """Let Dr.Jit use the threads of the worker and no more, and return the identity."""
    if dr.thread_count() != worker.state.nthreads:
        dr.set_thread_count(worker.state.nthreads)
    return identity()


# ---- Files of scenes ----


class Files(WorkerPlugin):  # type: ignore[misc]
    """Files of scenes that each worker gets once, also one that joins later."""

    def __init__(self, session: str, files: Mapping[str, bytes]):
        self._session = session
        self._files = dict(files)

    def setup(self, worker: distributed.Worker) -> None:
        """Write them where :func:`run` looks for them; the memory is needed no more."""
        parcel.unpack(self._files, folder(worker, self._session))
        self._files = {}

    def teardown(self, worker: distributed.Worker) -> None:
        """Remove all files of the session, and the scene in memory unless a job has it."""
        shutil.rmtree(folder(worker, self._session), ignore_errors=True)
        if _lock.acquire(blocking=False):
            try:
                _stage.clear()
            finally:
                _lock.release()


def folder(worker: distributed.Worker, session: str) -> Path:
    """Return where a worker keeps the files of a session, on a disk of its own."""
    return Path(worker.local_directory) / f"mi_ellipse-{session}"


# ---- Jobs ----


@dataclass(frozen=True)
class Call:
    """A method of a job that a worker shall call."""

    method: Callable[..., Any]  # of RenderJob
    job: RenderJob  # whose scene is a name among the files of the session
    arguments: tuple[Any, ...]
    session: str
    code: Mapping[str, str]  # that the client renders with
    scene_digest: str


def run(call: Call) -> Any:
    """
    Call the method of a job on the worker of this thread.

    Raises
    ------
    RuntimeError
        If the worker has other versions or other code than the client.
    """
    worker = distributed.get_worker()
    with _lock:
        own = _settled(worker)
        if own.code != call.code:
            raise RuntimeError(describe_difference(worker.address, own.code, call.code))
        scene = folder(worker, call.session) / call.job.scene
        with _stage.open():
            result = call.method(dataclasses.replace(call.job, scene=scene), *call.arguments)
    if isinstance(result, Rendering):
        machine = f"{own.machine}, on {own.host}"
        return dataclasses.replace(result, scene_digest=call.scene_digest, machine=machine)
    return result


def describe_difference(address: str, own: Mapping[str, str], wanted: Mapping[str, str]) -> str:
    """Return a sentence on a worker whose code differs from the client's."""
    parts = [
        f"{name} {own.get(name, 'unknown')[:12]} instead of {wanted[name][:12]}"
        for name in wanted
        if own.get(name) != wanted[name]
    ]
    return (
        f"the worker {address} renders with {', '.join(parts)}: install the same packages on all"
        " machines"
    )


def hold_still(name: str, started: str) -> None:
    """Keep a thread of the worker from other work until the event `name` is set, or nobody asks."""
    distributed.Event(started).set()
    event, worker = distributed.Event(name), distributed.get_worker()
    key = worker.get_current_task()
    while not event.wait(timeout=PATIENCE):
        task = worker.state.tasks.get(key)
        if task is None or task.state == "cancelled":
            return
