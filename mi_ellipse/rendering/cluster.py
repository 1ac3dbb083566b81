"""Run jobs on a Dask cluster: on many machines, or on several processes of this one."""

from __future__ import annotations

import dataclasses
import logging
import os
import re
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError, Executor, Future
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

try:
    import distributed
except ImportError as error:
    raise ImportError(
        f"a cluster needs the package {error.name}: pip install 'mi_ellipse[cluster]'"
    ) from None

from . import parcel, worker
from .executor import JobExecutor, OneByOne
from .job import RenderJob, stamps_of
from .parcel import Parcel
from .scene import under_variant
from .worker import Call, Identity

P = ParamSpec("P")
T = TypeVar("T")

# Seconds to wait for a scheduler's answer, and for the first worker
PATIENCE = 30.0

# Jobs that are on their way for each worker. One is being rendered, one waits, and one more may be
# done and wait for a slower one before it: results are handed on in order.
AHEAD = 3

# Seconds between two looks at which workers there are
REFRESH = 1.0

# The name of a packed file in a message, with the folder before it
PACKED = re.compile(r"[^\s\"']*?([0-9a-f]{64}\.\w+)")

# Scene file, parameters and variant
Key = tuple[Path, Mapping[str, str], str]


class ClusterExecutor(JobExecutor):
    """
    Run jobs on the workers of a Dask cluster.

    Each worker gets the files of a scene once, and needs no disk in common with this machine. It
    uses as many threads as Dask gives it, for one job at a time. A worker that dies loses the job
    that it works on, which another one starts again. What the workers return does not depend on
    which of them made it, nor on when.

    Parameters
    ----------
    client
        Of the cluster; this executor closes it.
    say
        Called with sentences for the user.
    resources
        What else to close in the end.

    Raises
    ------
    ConnectionError
        If no worker joins within half a minute.
    RuntimeError
        If a worker has other versions or other code than this process.
    """

    def __init__(
        self,
        client: distributed.Client,
        say: Callable[[str], None] = lambda sentence: None,
        resources: ExitStack | None = None,
    ):
        self.client = client
        self._say = say
        self.session = uuid.uuid4().hex[:12]
        self._closing = resources or ExitStack()
        self._closing.callback(client.close)
        self._executor = client.get_executor(pure=False)
        self._here = worker.identity()
        self._parcels: dict[Key, Parcel] = {}
        self._stamps: dict[Key, dict[Path, tuple[int, int]]] = {}
        self._sent: set[str] = set()
        self._plugins: list[str] = []
        self._timing: tuple[str, str] | None = None  # address and machine
        self._count = (0, -REFRESH)  # workers, and when they were counted
        self._is_shut_down = False
        try:
            self._wait_for_workers()
            self._greet()
        except BaseException:
            self._closing.close()
            raise

    # ---- Jobs ----

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Send a job to the next worker that is free; its files go before it, once."""
        if self._is_shut_down:
            raise RuntimeError("cannot submit a job to an executor that was shut down")
        try:
            call = self.call(fn, args)
        except Exception as error:  # of the scene
            future: Future[T] = Future()
            future.set_exception(error)
            return future
        if call is None:
            return self._explained(self._executor.submit(fn, *args, **kwargs))
        return self._explained(self._executor.submit(worker.run, call))

    def map(
        self,
        fn: Callable[..., T],
        *iterables: Iterable[Any],
        timeout: float | None = None,
        chunksize: int = 1,
        **options: Any,
    ) -> Iterator[T]:
        """
        Yield the results in order, whichever is done first; the options do nothing.

        Some jobs for each worker are on their way, and no more results than those are kept here.
        """
        waiting: deque[Future[T]] = deque()
        try:
            for arguments in zip(*iterables, strict=False):
                waiting.append(self.submit(fn, *arguments))
                while len(waiting) >= AHEAD * self.workers():
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()

    def workers(self) -> int:
        """Return how many workers there are, at least 1; it may be a second old."""
        count, when = self._count
        if time.monotonic() - when > REFRESH:
            count = max(1, len(self.client.nthreads()))
            self._count = count, time.monotonic()
        return count

    def call(self, fn: Callable[..., Any], arguments: tuple[Any, ...]) -> Call | None:
        """Return what a worker shall call for a method of a job; None for any other function."""
        owner = getattr(fn, "__self__", None)
        if isinstance(owner, RenderJob):
            fn, arguments = getattr(RenderJob, fn.__name__), (owner, *arguments)
        if not arguments or not isinstance(arguments[0], RenderJob):
            return None
        job, *rest = arguments
        packed = self._delivered(job)
        there = dataclasses.replace(job, scene=Path(packed.scene), parameters=packed.parameters)
        code, digest = self._here.code, packed.scene_digest
        return Call(fn, there, tuple(rest), self.session, code, digest)

    def _delivered(self, job: RenderJob) -> Parcel:
        """Return the scene of a job, whose files are sent; again, when one of them has changed."""
        key = (job.scene.resolve(), job.parameters, job.variant)
        if key in self._parcels and self._stamps[key] == stamps_of(self._stamps[key]):
            return self._parcels[key]
        with under_variant(job.variant):
            packed = parcel.pack(job.scene, job.parameters)
        self._send(packed.files)
        self._stamps[key] = stamps_of(packed.origins.values())
        self._parcels[key] = dataclasses.replace(packed, files={})  # to free the memory
        return self._parcels[key]

    def _send(self, files: Mapping[str, bytes]) -> None:
        """Give all workers the files that they do not have; the scheduler keeps them for others."""
        missing = {name: data for name, data in files.items() if name not in self._sent}
        if missing:
            name = f"mi_ellipse-{self.session}-{len(self._plugins)}"
            self.client.register_plugin(worker.Files(self.session, missing), name=name)
            self._plugins.append(name)
            self._sent |= missing.keys()

    def _explained(self, inner: Future[T]) -> Future[T]:
        """Return a future whose errors say what happened in the words of this machine."""
        outer: Future[T] = Future()

        def done(_: Future[T]) -> None:
            if outer.cancelled():
                return
            if inner.cancelled():
                outer.set_exception(ConnectionError("the scheduler of the cluster is gone"))
            elif (error := inner.exception()) is not None:
                outer.set_exception(self.explain(error))
            else:
                outer.set_result(inner.result())

        outer.add_done_callback(lambda _: inner.cancel() if outer.cancelled() else None)
        inner.add_done_callback(done)
        return outer

    def explain(self, error: BaseException) -> BaseException:
        """Return the error of a job with the names that its files have on this machine."""
        if isinstance(error, distributed.KilledWorker):
            return RuntimeError(
                f"a job has ended {error.allowed_failures + 1} workers, the last one at"
                f" {error.last_worker.address}: their logs may say why"
            )
        origins = {
            name: file for one in self._parcels.values() for name, file in one.origins.items()
        }
        error.args = tuple(
            PACKED.sub(lambda found: str(origins.get(found[1], found[0])), one)
            if isinstance(one, str)
            else one
            for one in error.args
        )
        return error

    # ---- Jobs that are timed ----

    @contextmanager
    def alone(self) -> Iterator[Executor]:
        """
        Give an executor for jobs whose times are compared: one worker, one job at a time.

        The other workers of its machine do nothing meanwhile, whoever uses the cluster.
        """
        lock = distributed.Lock("mi_ellipse-alone", self.client.scheduler, self.client.loop)
        if not lock.acquire(timeout=REFRESH):
            self._say("Waiting: another command times jobs on this cluster, or has just ended")
            lock.acquire()
        try:
            with _Alone(self) as executor:
                executor.place()
                yield executor
        finally:
            lock.release()

    def machine(self) -> str:
        """Return the machine that times jobs; it stays the same as long as one is like it."""
        return self.timing_worker()[1]

    def timing_worker(self) -> tuple[str, str]:
        """
        Return the address and the machine of the worker that times jobs.

        Raises
        ------
        ConnectionError
            If it is gone, and no other one joins on the same machine within half a minute.
        """
        if self._timing is not None and self._timing[0] in self.client.nthreads():
            return self._timing
        end = time.monotonic() + PATIENCE
        while True:
            late = time.monotonic() > end  # Asking a worker that has just ended can take long.
            present = self._identities()
            found = sorted((one.host, address, one.machine) for address, one in present.items())
            if self._timing is not None:
                found = [entry for entry in found if entry[2] == self._timing[1]]
            if found:
                _, address, machine = found[0]
                self._timing = address, machine
                return self._timing
            if late:
                raise ConnectionError(
                    "the worker that timed jobs is gone, and no other is like it"
                    f" ({self._timing[1] if self._timing else 'no workers'}): run the command"
                    " again, and another machine times all pictures"
                )
            time.sleep(REFRESH)

    @contextmanager
    def held_still(self, address: str) -> Iterator[None]:
        """Keep the other workers of a worker's machine, and its other threads, from any work."""
        name = f"mi_ellipse-{uuid.uuid4().hex}"
        end = distributed.Event(name, client=self.client)
        held = []
        try:
            for neighbour, threads in self._neighbours(address).items():
                for k in range(threads):
                    started = f"{name}-{neighbour}-{k}"
                    future = self.client.submit(
                        worker.hold_still, name, started, workers=[neighbour], pure=False
                    )
                    event = distributed.Event(started, client=self.client)
                    held.append((neighbour, event, future))
            for neighbour, event, _ in held:
                while not event.wait(timeout=REFRESH) and neighbour in self.client.nthreads():
                    pass
            yield
        finally:
            end.set()
            self.client.cancel([future for *_, future in held])

    def _neighbours(self, address: str) -> dict[str, int]:
        """Return the workers of a worker's machine, and their threads that could do other work."""
        present, threads = self._identities(), dict(self.client.nthreads())
        if address not in present:  # It has just died.
            return {}
        threads[address] = threads.get(address, 1) - 1
        host = present[address].host
        return {other: threads.get(other, 0) for other, one in present.items() if one.host == host}

    # ---- Beginning and end ----

    def places(self) -> str:
        """Return how many workers there are, with how many threads, and where."""
        present = self._identities()
        hosts = sorted({one.host for one in present.values()})
        threads = sum(self.client.nthreads().values())
        shown = ", ".join(hosts[:4]) + (", …" if len(hosts) > 4 else "")
        return f"{len(present)} worker(s) with {threads} thread(s) on {shown}"

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more jobs, remove what the workers keep, and leave the cluster."""
        if self._is_shut_down:
            return
        self._is_shut_down = True
        with suppress(OSError, CancelledError):  # The scheduler may be gone.
            self._executor.shutdown(wait=wait and not cancel_futures)
            for name in self._plugins:
                self.client.unregister_worker_plugin(name)
        self._closing.close()

    def __exit__(self, *error: object) -> None:
        """Leave the cluster; after an error, or Ctrl-C, without waiting for jobs."""
        self.shutdown(wait=error[0] is None)

    def _wait_for_workers(self) -> None:
        try:
            self.client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            address = self.client.scheduler.address
            raise ConnectionError(
                f"no worker has joined the scheduler at {address}: start some with"
                f" `dask worker {address}`"
            ) from None

    def _greet(self) -> None:
        """Check the workers that are there, and say what they are."""
        present = self._identities()
        for address, one in present.items():
            if one.code != self._here.code:
                raise RuntimeError(worker.describe_difference(address, one.code, self._here.code))
        self._say(f"Cluster: {self.places()}")
        others = [one for one in present.values() if one.digits != self._here.digits]
        if others:
            self._say(
                f"{len(others)} of the workers have another processor or LLVM than this machine:"
                " their pictures agree with its own to rounding, not bit for bit"
            )

    def _identities(self) -> dict[str, Identity]:
        """Return what each worker renders with, by its address."""
        answers = self.client.run(worker.identity_of_worker, on_error="return")
        for address, answer in answers.items():
            if isinstance(answer, ImportError):
                raise RuntimeError(
                    f"the worker {address} cannot load this package ({answer}): install"
                    " mi_ellipse[cluster] there"
                )
        # A worker that has died meanwhile answers with an error of its connection.
        return {
            address: answer for address, answer in answers.items() if isinstance(answer, Identity)
        }


class _Alone(OneByOne):
    """Run jobs on the worker that times them; a job whose worker dies begins again."""

    def __init__(self, owner: ClusterExecutor):
        self._owner = owner
        self._address = ""
        self._held = ExitStack()

    def place(self) -> str:
        """Return the address of the worker, when the others of its machine hold still."""
        address, _ = self._owner.timing_worker()
        if address != self._address:
            self._held.close()  # The new one may have been among those that held still.
            self._held.enter_context(self._owner.held_still(address))
            self._address = address
        return address

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Let the other workers work again; nothing is ever left to wait for or to cancel."""
        self._held.close()

    def _call(self, fn: Callable[..., T], *args: Any, **kwargs: Any) -> T:
        try:
            result: T = self._result(fn, args)
        except Exception as error:
            explained = self._owner.explain(error)
        else:
            return result
        raise explained

    def _result(self, fn: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
        client = self._owner.client
        while True:
            call = self._owner.call(fn, arguments)
            work = (worker.run, call) if call is not None else (fn, *arguments)
            address = self.place()
            future = client.submit(*work, workers=[address], pure=False)
            while address in client.nthreads():
                try:
                    return future.result(timeout=REFRESH)
                except TimeoutError:
                    if future.done():  # The error is that of the job.
                        raise
            future.cancel()


def connect(scheduler: str, say: Callable[[str], None] = lambda sentence: None) -> ClusterExecutor:
    """
    Use the cluster of a Dask scheduler.

    Parameters
    ----------
    scheduler
        Its address, such as ``tcp://HOST:8786``.
    say
        See :class:`ClusterExecutor`, which lists further errors.

    Raises
    ------
    ConnectionError
        If no scheduler answers.
    """
    try:
        client = distributed.Client(scheduler, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConnectionError(f"no Dask scheduler answers at {scheduler}: {error}") from None
    return ClusterExecutor(client, say)


def start(workers: int, say: Callable[[str], None] = lambda sentence: None) -> ClusterExecutor:
    """
    Start a cluster of single-threaded processes on this machine, which ends with the executor.

    Raises
    ------
    ValueError
        If `workers` is not positive.
    """
    if workers < 1:
        raise ValueError(f"workers={workers}: a cluster needs at least 1 worker")
    with ExitStack() as closing:
        if workers > (cores := os.cpu_count() or 1):
            say(f"{workers} workers share {cores} cores: more of them than cores are no faster")
        cluster = distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            memory_limit=None,  # Only the machine's own
            silence_logs=logging.CRITICAL + 1,
        )
        closing.callback(cluster.close)
        client = distributed.Client(cluster, set_as_default=False)
        return ClusterExecutor(client, say, closing.pop_all())
