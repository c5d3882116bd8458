"""Executors for other processes, through Dask: some on this machine, or those of a scheduler that is already running.

Dask hands the task of a worker that died to another one, and gives a task up that took several workers with it. What is finished
is in the journal, so Dask need not keep anything.
"""

from __future__ import annotations

import asyncio
import fcntl
import logging
import os
import shutil
import signal
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from multiprocessing import resource_tracker
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import threadpoolctl

from .run import Report
from .tasks import Failure, Outcome, Task, compute, now

if TYPE_CHECKING:
    from distributed import Client, Future

DEATHS = 1  # workers that may die with a task before it is a suspect
LOOK = 5.0  # s between two looks at how many workers there are
CONNECT = 10.0  # s to find a scheduler
ALONE = 60.0  # s without any worker until we give up
SCRATCH = "shadowgram-workers-"
YOUNG = 60.0  # s
MOST_WORKERS = 4  # for each processor; more only wait for one another, and for memory
STARTS = 3  # attempts to start workers, which may be killed while they start

SETTINGS: dict[str, Any] = {
    "distributed.scheduler.allowed-failures": DEATHS,
    "distributed.scheduler.worker-ttl": None,  # a kernel may keep the interpreter for minutes
}


class _Dask(ABC):
    """What both executors have in common: tasks become futures of a client."""

    def __init__(self) -> None:
        self._stack = ExitStack()
        self._client: Client | None = None
        self._futures: set[Future] = set()  # a future that nobody holds is cancelled

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._futures.clear()
        self._stack.close()

    @abstractmethod
    def _connect(self) -> Client: ...

    @abstractmethod
    def slots(self) -> int: ...

    def submit(self, task: Task, report: Report) -> None:
        """Compute a task in a worker."""
        if self._client is None:
            self._client = self._connect()
        client = self._client
        # A key of its own: Dask would remember an earlier failure.
        future = client.submit(
            compute_in_worker, task, key=f"{task.study}-{task.key[:12]}-{time.time_ns()}", pure=False
        )
        self._futures.add(future)
        future.add_done_callback(lambda done: self._hand_over(task, done, report))

    def _hand_over(self, task: Task, future: Future, report: Report) -> None:
        from distributed.scheduler import KilledWorker

        self._futures.discard(future)
        try:
            outcome = future.result()
        except KilledWorker:
            text = "every worker that took it died"
            outcome = Failure(error=text, details=text, time=now(), suspect=True)
        except CancelledError:
            outcome = ConnectionError(
                "the Dask scheduler is gone; what was finished is in the journal, run again to go on"
            )
        except Exception as error:  # noqa: BLE001 - not of the task, whose own errors are outcomes
            while error.__cause__ is not None:
                error = error.__cause__
            outcome = OSError(
                f"Dask cannot pass tasks on: {type(error).__name__}: {error}; scheduler and workers need the same packages as"
                " this process, and the module of the study"
            )
        report(task, outcome)


class LocalWorkers(_Dask):
    """Executor that computes in processes of this machine, which end with this one.

    Parameters
    ----------
    count : processes, each computing one task on one thread.

    Raises
    ------
    ValueError
        If `count` is not positive or far more than this machine's processors, or the package distributed is not installed.
    """

    def __init__(self, count: int) -> None:
        most = MOST_WORKERS * (os.cpu_count() or 1)
        if not 1 <= count <= most:
            raise ValueError(
                f"--workers takes a whole number from 1 to {most}, {MOST_WORKERS} for each processor of this machine, got {count}"
            )
        _check_installed()
        super().__init__()
        self._count = count
        self._cluster: Any = None  # Dask's own annotations take it for a coroutine
        self._seen = 0.0  # when there last was a worker

    def slots(self) -> int:
        """Tasks that it computes at once.

        Raises
        ------
        OSError
            If there has been no worker for a minute.
        """
        if self._cluster is None or self._cluster.scheduler.workers:
            self._seen = time.monotonic()
        elif time.monotonic() - self._seen > ALONE:
            raise OSError("the worker processes have died and do not start again; what was finished is in the journal")
        return self._count

    def _connect(self) -> Client:
        import dask.config
        from distributed import Client

        scratch = self._stack.enter_context(scratch_folder())
        with dask.config.set(SETTINGS), _interrupts_blocked():
            cluster = self._stack.enter_context(self._start(scratch))
        self._cluster, self._seen = cluster, time.monotonic()
        self._stack.callback(cluster.sync, _end_workers, cluster)
        return self._stack.enter_context(Client(cluster, set_as_default=False))

    def _start(self, scratch: str) -> Any:
        from distributed import LocalCluster

        for attempt in range(STARTS):
            try:
                return LocalCluster(
                    n_workers=self._count,
                    threads_per_worker=1,
                    host="127.0.0.1",
                    dashboard_address="127.0.0.1:0",  # there is always one, and None means a port that may be taken
                    memory_limit=0,  # the system knows better when memory is short
                    local_directory=scratch,
                    silence_logs=logging.CRITICAL,
                )
            except RuntimeError as error:
                if attempt == STARTS - 1:
                    raise OSError(f"the worker processes do not start: {error}") from error
        raise AssertionError


@contextmanager
def scratch_folder() -> Iterator[str]:
    """A temporary folder that is removed in the end, if need be by the next process that asks for one."""
    for old in Path(tempfile.gettempdir()).glob(f"{SCRATCH}*/lock"):
        with suppress(OSError):
            _remove_if_left(old)
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix=SCRATCH, ignore_cleanup_errors=True))
        lock = stack.enter_context((Path(folder) / "lock").open("w"))
        fcntl.flock(lock, fcntl.LOCK_EX)  # until this process closes it, or dies
        yield folder


def _remove_if_left(lock: Path) -> None:
    """Remove the folder of a process that is gone. One made a moment ago may not be locked yet."""
    if time.time() - lock.stat().st_mtime > YOUNG and lock.stat().st_uid == os.getuid():
        with lock.open() as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(lock.parent)


def compute_in_worker(task: Task) -> Outcome:
    """Compute a task in a process of Dask's."""
    _limit_blas()
    return compute(task)


@cache
def _limit_blas() -> None:
    import scipy.linalg  # noqa: F401 - the limit holds only for libraries that are loaded

    threadpoolctl.threadpool_limits(1)  # for as long as the process lives: its threads could not take turns


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Let threads and processes that are started here never see Ctrl-C: the driver decides what is still finished.

    They inherit the blocked signal, and so do workers that are started later in place of dead ones.
    """
    resource_tracker.ensure_running()  # which would unblock it
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


async def _end_workers(cluster: Any) -> None:
    """End worker processes without waiting for what they compute: it has been given up."""
    nannies = list(cluster.workers.values())
    await asyncio.gather(*(nanny.close(timeout=0.2) for nanny in nannies), return_exceptions=True)


class Cluster(_Dask):
    """Executor that computes on the workers of a running Dask scheduler.

    They need the same shadowgram, the modules of the studies, and recorded scenes under the same path. Whoever can reach a
    scheduler can run programs on its workers: keep it inside a network you trust.

    Parameters
    ----------
    address : of the scheduler, such as "tcp://10.0.0.1:8786".

    Raises
    ------
    ValueError
        If the package distributed is not installed.
    """

    def __init__(self, address: str) -> None:
        _check_installed()
        super().__init__()
        self._address = address
        self._threads, self._looked = 0, -LOOK

    def __enter__(self) -> Self:
        # At once: that there is no scheduler should be known before anything else happens.
        self._client = self._connect()
        return self

    def slots(self) -> int:
        """Threads of the workers that there are at the moment."""
        if self._client is not None and time.monotonic() - self._looked > LOOK:
            self._looked = time.monotonic()
            with suppress(OSError):
                threads: Any = self._client.nthreads()
                self._threads = sum(threads.values())
        return self._threads

    def _connect(self) -> Client:
        from distributed import Client
        from distributed.utils import silence_logging_cmgr

        self._stack.enter_context(silence_logging_cmgr(logging.CRITICAL))
        try:
            client = Client(self._address, timeout=CONNECT, set_as_default=False)
        except (OSError, ValueError) as error:
            raise OSError(f"no Dask scheduler answers at {self._address}; 'dask scheduler' starts one") from error
        return self._stack.enter_context(client)


def _check_installed() -> None:
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        raise ValueError(
            "worker processes need the package distributed: install shadowgram[cluster], or run without --workers and --cluster"
        ) from error
