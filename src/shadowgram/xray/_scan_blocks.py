"""What a scan is made of: short runs in blocks, each a function of its description alone, so that they can be computed anywhere."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from shadowgram._threads import thread_count

from .montecarlo.arrays import ORDERS, Floats
from .montecarlo.run import Setup, batch_edges, batch_vector
from .montecarlo.tallies import Sums
from .patterns import read_written
from .simulation import prepare

if TYPE_CHECKING:
    from ._compile import Compiled
    from .scene import Scene

BACKGROUND_FIRST = 2**52
"""Number of the first history of a background, which must not repeat those of the scan."""
OFFSET_FIRST = 2**53
"""The same of the runs that say what a mask scatters itself."""
_BLOCK = 1_000_000
"""Histories of a block, if its runs are shorter: half a second."""
_LARGEST_SEED = 2**63 - 1

Result = TypeVar("Result")


@dataclass(frozen=True, kw_only=True)
class Step:
    """In what a run differs from the scene of its block.

    Attributes
    ----------
    shot : where the mask is.
    code : a text of 0 and 1 for each row of the mask, in place of its own pattern; empty to keep that.
    position : of the source, mm; None to keep the scene's.
    """

    shot: int = 0
    code: tuple[str, ...] = ()
    position: tuple[float, float, float] | None = None


@dataclass(frozen=True, kw_only=True)
class Block:
    """Some runs, one after the other, of so many histories each.

    Attributes
    ----------
    first : number of the first run in its plan.
    steps : the runs.
    histories : of each.
    first_history : number of the first history of the first run.
    seed : of all.
    variance_reduction : whether there is; otherwise the counts are those of a real detector, with their noise.
    files : as `files_digest` gives it.
    scene : TOML.
    """

    first: int
    steps: tuple[Step, ...]
    histories: int
    first_history: int
    seed: int
    variance_reduction: bool
    files: str
    scene: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Found:
    """What a block found.

    Attributes
    ----------
    counts, standard_error : (run,) of all detectors together, for the histories of a run.
    orders : (run, order) the same by `shadowgram.xray.montecarlo.arrays.ORDERS`.
    """

    counts: Floats
    standard_error: Floats
    orders: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan(Generic[Result]):
    """Blocks, and what to make of their results.

    Attributes
    ----------
    blocks : in order.
    assemble : results of the blocks, in order → the whole.
    """

    blocks: tuple[Block, ...]
    assemble: Callable[[Sequence[Found]], Result]

    @property
    def histories(self) -> int:
        """Source photons of all runs."""
        return sum(block.histories * len(block.steps) for block in self.blocks)

    def run(
        self, *, threads: int | None = None, progress: Callable[[int, int], None] = lambda _done, _total: None
    ) -> Result:
        """Compute all blocks on threads of this process; the result does not depend on how many."""
        pool = ThreadPoolExecutor(check_whole("threads", threads or thread_count(), 1))
        try:
            found = []
            for one in pool.map(follow, self.blocks):
                found.append(one)
                progress(len(found), len(self.blocks))
        finally:
            pool.shutdown(cancel_futures=True)
        return self.assemble(found)


def check_whole(name: str, value: object, least: int) -> int:
    """A whole number of at least `least`, or a ValueError."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not least <= value <= _LARGEST_SEED:
        raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")
    return int(value)


def blocks_of(
    scene: Scene,
    steps: Sequence[Step],
    *,
    histories: int,
    first_history: int,
    seed: int,
    variance_reduction: bool,
    together: int | None = None,
) -> tuple[Block, ...]:
    """Runs put into blocks.

    Parameters
    ----------
    scene : of all.
    steps : the runs.
    histories, first_history, seed, variance_reduction : see `Block`; run q has histories first_history + q · histories on.
    together : runs of a block; by default so many that it takes about half a second.
    """
    size = together or max(1, min(len(steps), _BLOCK // histories))
    text, files = scene.toml(), files_digest(scene)
    return tuple(
        Block(
            first=first,
            steps=tuple(steps[first : first + size]),
            histories=histories,
            first_history=first_history + first * histories,
            seed=seed,
            variance_reduction=variance_reduction,
            files=files,
            scene=text,
        )
        for first in range(0, len(steps), size)
    )


def follow(block: Block) -> Found:
    """Compute a block, on this thread.

    Raises
    ------
    OSError
        If a file of the scene cannot be read.
    ValueError
        If such a file is not the one that the block was made for.

    Examples
    --------
    >>> from shadowgram.xray._scan_blocks import Step, blocks_of, follow
    >>> from shadowgram.xray.scene import shipped_scene
    >>> (block,) = blocks_of(shipped_scene("cxbi-blocks"), [Step(shot=0), Step(shot=9)], histories=500, first_history=0, seed=0,
    ...                      variance_reduction=False)
    >>> follow(block).orders.shape
    (2, 9)
    """
    compiled = _compiled(block.scene, block.files)
    kept = 1 + len(ORDERS)  # the vectors begin with the counts of all detectors, in total and by order
    rows = []
    for number, step in enumerate(block.steps):
        setup = _setup(compiled, step, block.variance_reduction)
        first = block.first_history + number * block.histories
        sums = Sums.of_size(kept)
        for start, stop in pairwise(batch_edges(block.histories)):
            sums.add(batch_vector(setup, block.seed, first + start, first + stop)[:kept], stop - start)
        error = sums.standard_error()[0] * block.histories
        rows.append(np.concatenate([sums.total[:1], [error], sums.total[1:]]))
    table = np.array(rows)
    return Found(counts=table[:, 0], standard_error=table[:, 1], orders=table[:, 2:])


def together(found: Sequence[Found]) -> Found:
    """Results of blocks, one after the other."""
    return Found(
        counts=np.concatenate([one.counts for one in found]),
        standard_error=np.concatenate([one.standard_error for one in found]),
        orders=np.concatenate([one.orders for one in found]),
    )


@lru_cache(maxsize=4)
def _compiled(text: str, files: str) -> Compiled:
    """A scene at shot 0; compiled once a process."""
    from ._compile import compile_scene
    from .scene import parse_scene

    scene = parse_scene(text)
    if files_digest(scene) != files:
        raise ValueError("the files of the scene are not those that the scan began with; run it again from the start")
    return compile_scene(scene)


def _setup(compiled: Compiled, step: Step, variance_reduction: bool) -> Setup:
    moved = compiled.at_shot(step.shot)
    if step.code:
        masks = moved.geometry.masks
        pattern: NDArray[np.uint8] = read_written(step.code).ravel()
        geometry = moved.geometry._replace(masks=masks._replace(open=pattern))
        moved = dataclasses.replace(moved, geometry=geometry)
    setup = prepare(moved, variance_reduction=variance_reduction)
    if step.position is None:
        return setup
    return dataclasses.replace(setup, source=setup.source._replace(position=np.array(step.position)))


def files_digest(scene: Scene) -> str:
    """Digest of the contents of all files that a scene names; empty if it names none.

    Raises
    ------
    OSError
        If one cannot be read.
    """
    names = sorted(set(_files(scene.model_dump(exclude_none=True))))
    if not names:
        return ""
    hashed = hashlib.sha256()
    for name in names:
        with Path(name).open("rb") as file:
            hashed.update(hashlib.file_digest(file, "sha256").digest())
    return hashed.hexdigest()


def _files(value: object) -> Iterator[str]:
    if isinstance(value, Mapping):
        if isinstance(value.get("file"), str):
            yield value["file"]
        for one in value.values():
            yield from _files(one)
    elif isinstance(value, list | tuple):
        for one in value:
            yield from _files(one)
