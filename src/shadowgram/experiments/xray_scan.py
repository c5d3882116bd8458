"""Scans as runs of a journal: on threads, processes or a cluster, interrupted and gone on with, always the same digits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

import shadowgram
from shadowgram.xray._scan_blocks import Block, Found, Plan, follow

from .journal import Journal
from .run import Executor, Progress, Summary, run
from .source import SceneSource
from .study import Claim, Record, Result, Study
from .tasks import make_tasks

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAME = "xray-scan"
REVISION = 1
"""Raised by one whenever the same block would give other numbers."""

Whole = TypeVar("Whole")


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome(Generic[Whole]):
    """How the run of a plan ended.

    Attributes
    ----------
    result : the whole; None if something is missing.
    summary : what was computed, reused, failed and dropped.
    """

    result: Whole | None
    summary: Summary


def run_plan(
    plan: Plan[Whole], journal: Journal, *, executor: Executor, progress: Callable[[Progress], None]
) -> Outcome[Whole]:
    """Compute the blocks of a plan that the journal does not have, and put all together.

    An interrupt (Ctrl-C) leaves what is finished in the journal, and the next run goes on from there.

    Parameters
    ----------
    plan : as `shadowgram.xray.scan.direct_plan` or `pencil_plan` give it.
    journal : open for writing.
    executor : entered: `shadowgram.experiments.run.Threads`, or those of `shadowgram.experiments.dask_run`.
    progress : called after every block, and at least once a second.

    Raises
    ------
    OSError
        If the journal cannot be written, or the executor has lost its workers.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from shadowgram.experiments.journal import open_journal
    >>> from shadowgram.experiments.run import Threads
    >>> from shadowgram.experiments.xray_scan import run_plan
    >>> from shadowgram.xray.scan import direct_plan
    >>> from shadowgram.xray.scene import shipped_scene
    >>> plan = direct_plan(shipped_scene("cxbi-blocks"), shots=2, histories=4000)
    >>> with open_journal(pathlib.Path(tempfile.mkdtemp())) as journal, Threads() as executor:
    ...     outcome = run_plan(plan, journal, executor=executor, progress=lambda state: None)
    >>> outcome.result.counts.shape
    (2,)
    """
    study, source = _study(plan.blocks), _source()
    summary = run(study, source, False, journal, executor=executor, progress=progress)
    keys = [task.key for task in make_tasks(study, source, False)]
    records = journal.records(keys)
    if len(records) < len(set(keys)):
        return Outcome(result=None, summary=summary)
    return Outcome(result=plan.assemble([_found(records[key]) for key in keys]), summary=summary)


def compute_block(block: Block, source: SceneSource) -> Result:  # noqa: ARG001 - the signature of a study's run
    """Compute a block in whatever process it came to."""
    found = follow(block)
    return Result(
        values={
            "counts": found.counts.tolist(),
            "standard_error": found.standard_error.tolist(),
            "orders": found.orders.tolist(),
        }
    )


def _found(record: Record) -> Found:
    values = record.values
    return Found(**{name: np.array(values[name], float) for name in ("counts", "standard_error", "orders")})


def _study(blocks: Sequence[Block]) -> Study:
    return Study(
        name=NAME,
        title="Counts of a scan",
        source="",
        revision=REVISION,
        specs=lambda _scene, _quick: blocks,
        run=compute_block,
        figure=_no_figure,
        claims=_no_claims,
    )


def _source() -> SceneSource:
    """A name for the journal. What is computed stands in the blocks; another version of the program computes anew."""
    return SceneSource(name=NAME, digest=f"{NAME} {shadowgram.__version__}", wavelengths=(0.0, 0.0))


def _no_figure(records: Sequence[Record]) -> Figure:
    raise ValueError(f"{len(records)} records of a scan have no figure of their own; see shadowgram.figures.xray_scan")


def _no_claims(records: Sequence[Record]) -> Sequence[Claim]:  # noqa: ARG001 - the signature of a study's claims
    return []
