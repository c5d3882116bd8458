"""The run of a study: what is not yet in the journal is computed, and every result goes into it as soon as it is there.

`run` decides what is computed and keeps the journal; where it is computed is up to an executor: `Threads` of this process, or the
processes of `dask_run`.
"""

from __future__ import annotations

import math
import queue
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from typing import Protocol, Self

import threadpoolctl

from shadowgram._threads import thread_count

from .journal import Journal
from .source import SceneSource
from .study import Study
from .tasks import Failure, Outcome, Task, compute, make_tasks

TICK = 1.0  # s between two looks at the clock
GRACE = 3.0  # s that running tasks get after an interrupt

# What an executor reports of a task: its outcome, or why nothing more will come.
Report = Callable[[Task, Outcome | OSError], None]


class Executor(Protocol):
    """Computes tasks; a context manager, whose end stops what it started."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *exception: object) -> None: ...

    def slots(self) -> int:
        """Tasks that it computes at once."""
        ...

    def submit(self, task: Task, report: Report) -> None:
        """Compute a task, and report the outcome from any thread."""
        ...


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Where a run stands.

    Attributes
    ----------
    done, total : tasks.
    label : of a task that is being computed; empty if there is none.
    seconds_left : estimate from the tasks that are done; None if none is.
    """

    done: int
    total: int
    label: str
    seconds_left: float | None


@dataclass(frozen=True, kw_only=True)
class Summary:
    """How a run ended.

    Attributes
    ----------
    total : different tasks of the study.
    computed, reused : tasks whose result came now, or was in the journal.
    failed : label and error of each task that failed.
    interrupted : the user stopped it.
    finished, dropped : after the interrupt: tasks that came to their end, and tasks that were given up.
    seconds : of the run.
    """

    total: int
    computed: int
    reused: int
    failed: tuple[tuple[str, str], ...]
    interrupted: bool
    finished: int
    dropped: int
    seconds: float


class Threads:
    """Executor that computes in threads of this process.

    Parameters
    ----------
    count : tasks at once, each on one thread; by default as many as `shadowgram.threads` or the environment say.
    """

    def __init__(self, count: int | None = None) -> None:
        self._count = thread_count() if count is None else count
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        import scipy.linalg  # noqa: F401 - the limit holds only for libraries that are loaded

        self._stack.enter_context(threadpoolctl.threadpool_limits(1))
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def slots(self) -> int:
        """Tasks that it computes at once."""
        return self._count

    def submit(self, task: Task, report: Report) -> None:
        """Compute a task in a thread of its own, which does not keep the process from ending."""
        threading.Thread(target=lambda: report(task, compute(task)), name=f"task {task.label}", daemon=True).start()


def run(
    study: Study,
    scene: SceneSource,
    quick: bool,
    journal: Journal,
    *,
    executor: Executor,
    progress: Callable[[Progress], None],
) -> Summary:
    """Compute what a study needs and the journal does not have.

    An interrupt (Ctrl-C) starts nothing new, gives the tasks that are running three seconds, and returns; a second one is
    raised. Whatever happens, results that were there are in the journal, and the next run goes on from them. Tasks that
    failed are tried again in the next run.

    Parameters
    ----------
    study, scene, quick : what to compute.
    journal : open for writing. Another run may write to it at the same time.
    executor : entered.
    progress : called after every task, and at least once a second.

    Raises
    ------
    OSError
        If the journal cannot be written, or the executor has lost its workers.

    Examples
    --------
    >>> import tempfile
    >>> from dataclasses import dataclass
    >>> from pathlib import Path
    >>> from shadowgram.experiments.journal import open_journal
    >>> from shadowgram.experiments.run import Threads, run
    >>> from shadowgram.experiments.source import generated
    >>> from shadowgram.experiments.study import Result, Study
    >>> @dataclass(frozen=True)
    ... class Spec:
    ...     x: int
    >>> study = Study(
    ...     name="squares", title="", source="", revision=1, specs=lambda scene, quick: [Spec(x) for x in range(5)],
    ...     run=lambda spec, scene: Result(values={"square": spec.x**2}), figure=lambda records: None, claims=lambda records: [],
    ... )
    >>> with open_journal(Path(tempfile.mkdtemp())) as journal, Threads() as executor:
    ...     summary = run(study, generated(), False, journal, executor=executor, progress=lambda state: None)
    >>> summary.computed, summary.reused, summary.failed
    (5, 0, ())
    """
    tasks = list({task.key: task for task in make_tasks(study, scene, quick)}.values())
    work = _Run(tasks, journal, executor, progress)
    with _interrupts(work.interrupt):
        return work.go()


class _Run:
    """One run: tasks go from `pending` to `running` to the journal."""

    def __init__(
        self, tasks: list[Task], journal: Journal, executor: Executor, progress: Callable[[Progress], None]
    ) -> None:
        self.journal, self.executor, self.progress = journal, executor, progress
        self.begun = time.monotonic()
        self.total = len(tasks)
        self.pending: deque[Task] = deque()
        self.suspects: deque[Task] = deque()  # their worker died, for which something else may be to blame
        self.alone: Task | None = None  # the suspect that runs without company
        self.running: dict[str, Task] = {}
        self.news: queue.SimpleQueue[tuple[Task, Outcome | OSError] | None] = queue.SimpleQueue()
        self.known_seconds: list[float] = []  # of tasks computed before
        self.seconds: list[float] = []  # of tasks computed now
        self.failed: list[tuple[str, str]] = []
        self.reused = self.finished = 0
        self.heard = self.begun  # when a task last came to its end
        self.interrupted, self.deadline = False, math.inf
        for task in tasks:
            self._queue(task)

    def interrupt(self) -> None:
        """Ask for the end, from a signal handler."""
        self.interrupted = True
        self.news.put(None)

    def go(self) -> Summary:
        try:
            while self.pending or self.running or self.suspects:
                self._launch()
                self._tell()
                if not self.running or time.monotonic() >= self.deadline:
                    break
                with suppress(queue.Empty):
                    self._hear(self.news.get(timeout=max(0.0, min(TICK, self.deadline - time.monotonic()))))
        finally:
            with suppress(queue.Empty):
                while True:  # what came at the last moment, whatever ended the loop
                    self._hear(self.news.get_nowait())
        self._tell()
        return self._summary()

    def _hear(self, news: tuple[Task, Outcome | OSError] | None) -> None:
        if news is None:
            self.deadline = time.monotonic() + GRACE
        else:
            self._take(*news)

    def _queue(self, task: Task) -> None:
        seconds = self.journal.seconds(task.key)
        if seconds is None:
            self.pending.append(task)
        else:
            self.known_seconds.append(seconds)
            self.reused += 1

    def _launch(self) -> None:
        """Keep the executor busy, with no task in advance: nothing would be gained, and an interrupt delayed."""
        while self.pending and not self.interrupted and len(self.running) < max(1, self.executor.slots()):
            task = self.pending.popleft()
            if self.journal.seconds(task.key) is not None:  # another run was faster
                self.reused += 1
            else:
                self._submit(task)
        if self.suspects and not self.interrupted and not self.running:
            self.alone = self.suspects.popleft()
            self._submit(self.alone)

    def _submit(self, task: Task) -> None:
        self.running[task.key] = task
        self.executor.submit(task, lambda task, outcome: self.news.put((task, outcome)))

    def _take(self, task: Task, outcome: Outcome | OSError) -> None:
        if isinstance(outcome, OSError):
            raise outcome
        self.running.pop(task.key, None)
        self.heard = time.monotonic()
        self.finished += self.interrupted
        accused = isinstance(outcome, Failure) and outcome.suspect and task is not self.alone
        if accused:
            self.suspects.append(task)
        if accused:
            return
        if isinstance(outcome, Failure):
            self.failed.append((task.label, outcome.error))
            self.journal.add_failure(task.key, task.study, task.spec_json, outcome.details, outcome.time)
        elif self.journal.add(outcome):
            self.seconds.append(outcome.seconds)
        else:
            self.reused += 1

    def _tell(self) -> None:
        done = len(self.seconds) + self.reused + len(self.failed)
        label = next(iter(self.running.values())).label if self.running else ""
        if self.running and not self.executor.slots():
            label = "waiting for a worker"
        self.progress(Progress(done=done, total=self.total, label=label, seconds_left=self._seconds_left()))

    def _seconds_left(self) -> float | None:
        seconds = self.seconds or self.known_seconds
        if not seconds:
            return None
        rounds = (len(self.pending) + len(self.running) + len(self.suspects)) / max(1, self.executor.slots())
        left = max(rounds, 1.0 * bool(self.running)) * sum(seconds) / len(seconds)
        return max(0.0, left - (time.monotonic() - self.heard))

    def _summary(self) -> Summary:
        return Summary(
            total=self.total,
            computed=len(self.seconds),
            reused=self.reused,
            failed=tuple(self.failed),
            interrupted=self.interrupted and bool(self.pending or self.running or self.suspects),
            finished=self.finished,
            dropped=len(self.running),
            seconds=time.monotonic() - self.begun,
        )


@contextmanager
def _interrupts(handle: Callable[[], None]) -> Iterator[None]:
    """Call `handle` for the first Ctrl-C inside the block, so that it cannot strike between a result and the journal."""
    old = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or old is signal.SIG_IGN or old is None:
        yield
        return

    def first(number: int, frame: object) -> None:  # noqa: ARG001 - the signature of a signal handler
        signal.signal(signal.SIGINT, old)
        handle()

    signal.signal(signal.SIGINT, first)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, old)
