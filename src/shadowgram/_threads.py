"""How many threads the kernels use, and the one pool they run on.

Kernels are serial numba functions that release the GIL and work on a range of rows or bands, `kernel(start, stop, *args)`;
numba's own threading layer is not used, because its default one aborts the process when two Python threads enter it.
Each output element is computed by one thread in one fixed order, so results do not depend on the number of threads.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from itertools import pairwise

_requested: ContextVar[int | None] = ContextVar("shadowgram_threads", default=None)


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Use `count` threads inside the `with` block; results do not depend on it.

    Without it, all processors that the process may use are taken, or as many as the environment
    variable ``SHADOWGRAM_THREADS`` says.

    Raises
    ------
    ValueError
        If `count` is not a positive whole number.

    Examples
    --------
    >>> import shadowgram as sg
    >>> with sg.threads(1):
    ...     pass
    """
    if not isinstance(count, int) or count < 1:
        raise ValueError(f"threads takes a whole number of at least 1, got {count!r}")
    token = _requested.set(count)
    try:
        yield
    finally:
        _requested.reset(token)


def thread_count() -> int:
    """Threads that a kernel started here would use."""
    requested = _requested.get()
    if requested is not None:
        return requested
    said = os.environ.get("SHADOWGRAM_THREADS")
    if said is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not said.isdigit() or int(said) < 1:
        raise ValueError(f"SHADOWGRAM_THREADS must be a whole number of at least 1, got {said!r}")
    return int(said)


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(workers, thread_name_prefix="shadowgram")


if hasattr(os, "register_at_fork"):
    # The threads of a pool do not survive a fork: the child must make its own.
    os.register_at_fork(after_in_child=_pool.cache_clear)


def run_chunks(kernel: Callable[..., None], items: int, grain: int, *args: object) -> None:
    """Call ``kernel(start, stop, *args)`` over contiguous chunks of ``range(items)``, at least `grain` items each.

    The caller's thread works on the first chunk. The kernel must not start chunks of its own.
    """
    chunks = max(1, min(thread_count(), items // max(grain, 1)))
    if chunks == 1:
        kernel(0, items, *args)
        return
    edges = [items * i // chunks for i in range(chunks + 1)]
    pool = _pool(chunks - 1)
    waiting = [pool.submit(kernel, a, b, *args) for a, b in pairwise(edges[1:])]
    try:
        kernel(edges[0], edges[1], *args)
    finally:
        # An interrupt must not return while another thread still writes to the caller's arrays.
        for one in waiting:
            one.result()
