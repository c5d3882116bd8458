"""What the commands of long work have in common: where it is computed, how much of it, and word of the compilation before it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Literal

import typer

if TYPE_CHECKING:
    from shadowgram.experiments.run import Executor

COMPILED_BY = 5.0  # s; what is in the cache of numba is loaded in a second, on a busy machine in some


def executor(workers: int | None, cluster: str | None) -> Executor:
    """Processes of this machine, the workers of a scheduler, or else threads of this process."""
    from shadowgram.experiments.dask_run import Cluster, LocalWorkers
    from shadowgram.experiments.run import Threads

    if workers is not None and cluster is not None:
        raise ValueError("give --workers for processes of this machine, or --cluster for a scheduler, not both")
    if workers is not None:
        return LocalWorkers(workers)
    return Threads() if cluster is None else Cluster(cluster)


def parse_histories(text: str) -> int:
    """A number of histories such as 1000000 or 1e6."""
    try:
        number = float(text)
        whole = int(number) if number == int(number) else 0
    except (ValueError, OverflowError):
        whole = 0
    if whole < 2:
        raise ValueError(f"--histories takes a whole number of at least 2, such as 1000000 or 1e6; got {text!r}")
    return int(text) if text.strip().isdigit() else whole


@contextmanager
def telling_of_compilation(kernel: Literal["batch", "response_batch"]) -> Iterator[None]:
    """Say that the transport is being compiled if nothing compiled is there after a while."""

    def say() -> None:
        from shadowgram.xray.montecarlo import _history_kernels, _response_kernels

        found: Any = _history_kernels.batch if kernel == "batch" else _response_kernels.response_batch
        if not found.signatures:
            typer.echo("shadowgram: compiling the transport, about half a minute, once on this machine", err=True)

    timer = threading.Timer(COMPILED_BY, say)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
