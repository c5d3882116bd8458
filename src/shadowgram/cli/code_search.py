"""Designs of a code from several starts, which lose nothing when they are interrupted."""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import output

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

    from shadowgram.codes import Design

    from .code_imager import Camera

UNFINISHED = "unfinished design"  # kind of the side file
GRACE = 3.0  # s for running sweeps to end, after an interrupt
MOST_EXCHANGES = 10  # sweeps of exchanges
AXES = {3: ("shot", "row", "column"), 4: ("shot", "band", "row", "column")}


class _Stopped(Exception):  # noqa: N818 - not an error
    """Ends the work of a thread after an interrupt."""


class Search:
    """Designs from several starts, and the side file in which all of them are kept after every sweep.

    Parameters
    ----------
    camera : imager that the code is for.
    options : of `shadowgram.codes.design`, without seed.
    seed : of the first start.
    starts : number of starts.
    exchange : refine the best by exchanges.
    out : where the code will be written; the side file stands next to it.
    resume : go on with what the side file has.

    Attributes
    ----------
    exchanges : sweeps of exchanges so far.

    Raises
    ------
    ValueError
        If there is a side file and `resume` was not asked for, or if it was and there is none of these parameters.
    """

    def __init__(
        self,
        camera: Camera,
        options: Mapping[str, Any],
        *,
        seed: int,
        starts: int,
        exchange: bool,
        out: Path,
        resume: bool,
    ) -> None:
        from shadowgram.measurement import imager_to_json

        self._camera, self._options, self._seed, self._starts, self._exchange = camera, options, seed, starts, exchange
        self._file = out.with_name(f"{out.stem}.design.nc")
        given = {**options, "seed": seed, "starts": starts, "exchange": exchange}
        self._parameters = json.loads(json.dumps({**given, "imager": json.loads(imager_to_json(camera))}))
        self._designs: dict[int, Design] = {}  # those that run, and the best of those that are done
        self._costs: dict[int, float] = {}  # of those that are done
        self.exchanges = self._sweeps = 0
        self._lock, self._stop, self._closed = threading.Lock(), threading.Event(), False
        if resume:
            self._read()
        elif self._file.exists():
            raise ValueError(
                f"{self._file} holds a design that was interrupted: go on with it, --resume, or delete it to begin afresh"
                if _is_unfinished(self._file)
                else f"{self._file}, where the unfinished design would be kept, is another file; choose another name"
            )

    @property
    def costs(self) -> list[float]:
        """Cost of each start when it was done, before exchanges."""
        return [self._costs[start] for start in sorted(self._costs)]

    def run(self, update: output.Update) -> Design:
        """Design from every start, and give the best.

        Raises
        ------
        output.Interrupted
            After Ctrl-C, when a sweep has been kept.
        """
        from shadowgram._threads import thread_count

        def job(start: int) -> Callable[[], None]:
            return lambda: self._design(start, update)

        todo = [job(start) for start in range(self._starts) if start not in self._costs]
        try:
            _side_by_side(todo, min(len(todo), thread_count()), self._stop)
            if self._exchange:
                _side_by_side([lambda: self._refine(update)], 1, self._stop)
        except KeyboardInterrupt:
            with self._lock:  # nothing is being written now, nor will be
                self._closed = True
            if not self._file.exists():
                raise
            raise output.Interrupted(
                f"interrupted; the design so far is in {self._file}, and the same command with --resume goes on"
            ) from None
        return self._designs[self._best]

    def mask(self, found: Design) -> np.ndarray:
        """Code of the whole mask, over which a tile repeats."""
        ny, nx = self._camera.code_shape[-2:]
        return found.mask((ny, nx))

    def remove_file(self) -> None:
        """Remove the side file; the code has been written."""
        self._file.unlink(missing_ok=True)

    @property
    def _best(self) -> int:
        return min(self._costs, key=lambda start: (self._costs[start], start))

    def _design(self, start: int, update: output.Update) -> None:
        from shadowgram.codes._design import design

        found = design(
            self._camera,
            **self._options,
            seed=self._seed + start,
            resume=self._designs.get(start),
            callback=lambda so_far: self._keep(start, so_far, update),
        )
        with self._lock:
            self._costs[start] = found.costs[-1]
            for done in set(self._costs) - {self._best}:
                self._designs.pop(done, None)

    def _refine(self, update: output.Update) -> None:
        from shadowgram.codes._design import exchange

        best = self._best
        while self.exchanges < MOST_EXCHANGES and not (self.exchanges and self._designs[best].converged):
            found = exchange(self._camera, self._designs[best], max_sweeps=1)  # pyright: ignore[reportArgumentType] - not colored
            self.exchanges += 1
            self._keep(best, found, update)

    def _keep(self, start: int, found: Design, update: output.Update) -> None:
        """Write the side file, tell the progress, and end if the user said so."""
        from shadowgram.scenes.readers.native import write_dataset

        with self._lock:
            if self._closed:
                raise _Stopped
            self._designs[start] = found
            self._sweeps += 1
            write_dataset(self._dataset(), self._file)
            cost, moved = found.costs[-1], found.moves[-1] / found.code[0].size
            of = f"start {start + 1}/{self._starts}, " if self._starts > 1 else ""
            change = 100 * (cost / found.costs[0] - 1) if found.costs[0] else 0.0
            update(
                self._sweeps, f"{of}sweep {found.sweeps}, cost {cost:.5g} ({change:+.2f} %), {100 * moved:.2g} % moved"
            )
        if self._stop.is_set():
            raise _Stopped

    def _dataset(self) -> xr.Dataset:
        """All that is needed to go on, and under `code` the best so far for who will not."""
        import xarray as xr

        from shadowgram import __version__

        leading = min(self._designs.values(), key=lambda one: one.costs[-1])
        axes = ("shot", "y", "x") if leading.code.ndim == 3 else ("shot", "band", "y", "x")
        variables: dict[str, Any] = {"code": (axes, self.mask(leading))}
        for start, one in self._designs.items():
            variables[f"code_{start}"] = (AXES[one.code.ndim], one.code)
            variables[f"costs_{start}"] = (f"cost_{start}", list(one.costs), {"converged": int(one.converged)})
            variables[f"moves_{start}"] = (f"sweep_{start}", list(one.moves))
        if self._costs:
            variables["done"] = ("done_start", list(self._costs))
            variables["done_cost"] = ("done_start", list(self._costs.values()))
        weights = leading.weights
        attributes = {
            "kind": UNFINISHED,
            "parameters": json.dumps(self._parameters),
            "weights": [float(weights.c1), float(weights.repulsion), float(weights.coupling)],
            "exchanges": self.exchanges,
            "sweeps": self._sweeps,
            "shadowgram_version": __version__,
        }
        return xr.Dataset(variables, attrs=attributes)

    def _read(self) -> None:
        from shadowgram.codes._design import Design, Weights
        from shadowgram.scenes.readers.native import read_dataset

        if not self._file.exists():
            raise ValueError(f"there is no unfinished design {self._file} to go on with; leave out --resume")
        if not _is_unfinished(self._file):
            raise ValueError(f"{self._file} is not an unfinished design; leave out --resume and choose another name")
        dataset = read_dataset(self._file)
        self._check_parameters(json.loads(dataset.attrs["parameters"]))
        c1, repulsion, coupling = (float(weight) for weight in dataset.attrs["weights"])
        for name in dataset.data_vars:
            if str(name).startswith("costs_"):
                start = int(str(name).removeprefix("costs_"))
                costs = dataset[name]
                self._designs[start] = Design(
                    code=dataset[f"code_{start}"].values,
                    costs=tuple(costs.values.tolist()),
                    moves=tuple(dataset[f"moves_{start}"].values.tolist()),
                    converged=bool(costs.attrs["converged"]),
                    weights=Weights(c1=c1, repulsion=repulsion, coupling=coupling),
                    seed=self._seed + start,
                    tile=self._options["tile"],
                )
        if "done" in dataset.data_vars:
            done = zip(dataset["done"].values.tolist(), dataset["done_cost"].values.tolist(), strict=True)
            self._costs.update(done)
        self.exchanges, self._sweeps = int(dataset.attrs["exchanges"]), int(dataset.attrs["sweeps"])

    def _check_parameters(self, before: Mapping[str, object]) -> None:
        for name, value in self._parameters.items():
            if before.get(name) == value:
                continue
            if name == "imager":
                raise ValueError(
                    f"{self._file} was begun for another imager: give the same options as then, or delete it"
                )
            was, now = (_option(name, given) for given in (before.get(name), value))
            raise ValueError(f"{self._file} was begun {was}, not {now}: give the same options as then, or delete it")


def _side_by_side(jobs: Sequence[Callable[[], None]], count: int, stop: threading.Event) -> None:
    """Run jobs in threads, the first ones first; what one raises is raised here. Ctrl-C gives running sweeps a few seconds."""
    waiting, errors = deque(jobs), []

    def work() -> None:
        while not stop.is_set():
            try:
                job = waiting.popleft()
            except IndexError:
                return
            try:
                job()
            except BaseException as error:  # noqa: BLE001 - raised again by the thread that waits
                errors.append(error)
                stop.set()

    # Threads of their own do not keep the process from ending.
    threads = [threading.Thread(target=work, daemon=True) for _ in range(count)]
    for thread in threads:
        thread.start()
    try:
        for thread in threads:
            while thread.is_alive():
                thread.join(0.2)
    except KeyboardInterrupt:
        stop.set()
        until = time.monotonic() + GRACE
        for thread in threads:
            thread.join(max(0.0, until - time.monotonic()))
        raise
    if errors:
        raise errors[0]


def _is_unfinished(path: Path) -> bool:
    from shadowgram.scenes.readers.native import read_dataset

    return read_dataset(path).attrs.get("kind") == UNFINISHED


def _option(name: str, value: object) -> str:
    """An option as it is typed."""
    if value is None or value is False:
        return f"without --{name}"
    if isinstance(value, list):
        value = "x".join(map(str, value))
    return f"with --{name}" if value is True else f"with --{name} {value}"
