"""A study whose driver and workers are killed (kill −9) again and again must end as if nothing had happened.

    python benchmarks/killed_run.py [--tasks 200] [--kills 50] [--seed 0]

Two hundred small reconstructions are computed by two worker processes. At seeded random moments, some while processes start,
the driver or a worker is killed; after the driver's death it is started again. Meanwhile the journal is watched. At the end no
record that was ever seen may be gone or changed, none may be there twice, none may be missing, the figure must equal, byte by byte,
that of a run in threads which nobody disturbed, and no process may be left over.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import random
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import psutil

from shadowgram.experiments import holdings
from shadowgram.experiments.dask_run import LocalWorkers
from shadowgram.experiments.journal import FILE_NAME, open_journal, read_journal
from shadowgram.experiments.run import Threads, run
from shadowgram.experiments.source import SceneSource, generated
from shadowgram.experiments.study import Record, Result, Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DRIVE = "import sys, killed_run; killed_run.drive(sys.argv[1], int(sys.argv[2]))"
PATIENCE = 60.0  # s without anything happening after which the test has failed
END = 10.0  # s that workers get to notice the death of their driver


@dataclass(frozen=True, kw_only=True)
class Spec:
    """A small reconstruction: a sparse signal from half as many noisy measurements."""

    seed: int
    length: int = 1000
    iterations: int = 80


def reconstruct(spec: Spec, _scene: SceneSource) -> Result:
    """About a tenth of a second of iterative soft thresholding."""
    random = np.random.default_rng(spec.seed)
    H = random.normal(size=(spec.length // 2, spec.length)) / np.sqrt(spec.length)
    truth = random.normal(size=spec.length) * (random.random(spec.length) < 0.1)
    y = H @ truth + 0.01 * random.normal(size=spec.length // 2)
    step, threshold = 0.3, 0.01
    x = np.zeros(spec.length)
    for _ in range(spec.iterations):
        x += step * (H.T @ (y - H @ x))
        x = np.sign(x) * np.maximum(np.abs(x) - step * threshold, 0)
    error = float(np.linalg.norm(x - truth) / np.linalg.norm(truth))
    return Result(values={"error": error}, arrays={"x": x[:50].astype(np.float32)})


def figure(records: Sequence[Record]) -> Figure:
    """Error for every seed, and the signals."""
    from shadowgram.figures.style import new_figure

    drawn = new_figure(4, 3)
    above, below = drawn.subplots(2)
    above.plot([record.values["error"] for record in records])
    below.plot(np.array([record.arrays["x"] for record in records]).T)
    return drawn


def study(tasks: int) -> Study:
    """The study."""
    specs = [Spec(seed=seed) for seed in range(tasks)]
    return Study(
        name="killed-run", title="Small reconstructions", source="", revision=1, specs=lambda _scene, _quick: specs,
        run=reconstruct, figure=figure, claims=lambda _records: (),
    )  # fmt: skip


def drive(folder: str, tasks: int) -> None:
    """What the driver does: two worker processes, until all is computed."""
    with open_journal(Path(folder)) as journal, LocalWorkers(2) as executor:
        run(study(tasks), generated(), False, journal, executor=executor, progress=lambda _state: None)


def undisturbed(folder: Path, tasks: int) -> bytes:
    """The figure of a run in threads of this process."""
    with open_journal(folder) as journal, Threads() as executor:
        run(study(tasks), generated(), False, journal, executor=executor, progress=lambda _state: None)
        return draw(journal, tasks)


def draw(journal, tasks: int) -> bytes:
    """PNG file of all records."""
    records = holdings.gather(study(tasks), generated(), False, journal)
    return holdings.figure_png(study(tasks), records)


@dataclass(kw_only=True)
class Trial:
    """A run that is disturbed.

    Attributes
    ----------
    seen : key → checksum of every record that was ever in the journal.
    lost, changed : keys that were seen and are gone, or are something else.
    processes : everything that a driver ever started.
    """

    folder: Path
    tasks: int
    random: random.Random
    driver: psutil.Popen | None = None
    seen: dict[str, str] = field(default_factory=dict)
    lost: set[str] = field(default_factory=set)
    changed: set[str] = field(default_factory=set)
    processes: set[psutil.Process] = field(default_factory=set)
    driver_kills: int = 0
    worker_kills: int = 0
    early_kills: int = 0
    starts: int = 0
    orphans: int = 0

    def start(self) -> None:
        """Start a driver, as a program of its own."""
        path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
        self.driver = psutil.Popen(
            [sys.executable, "-c", DRIVE, str(self.folder), str(self.tasks)],
            env=os.environ | {"PYTHONPATH": path},
            stderr=subprocess.DEVNULL,
        )
        self.starts += 1

    def look(self) -> int:
        """Compare the journal with what was seen before; how many records it has."""
        if not (self.folder / FILE_NAME).exists():
            return 0
        connection = sqlite3.connect(f"{(self.folder / FILE_NAME).as_uri()}?mode=ro", uri=True, timeout=20)
        try:
            rows = dict(connection.execute("SELECT key, checksum FROM records"))
        except sqlite3.OperationalError:  # the tables are being made
            rows = {}
        finally:
            connection.close()
        self.lost |= self.seen.keys() - rows.keys()
        self.changed |= {key for key, checksum in self.seen.items() if rows.get(key, checksum) != checksum}
        self.seen |= rows
        return len(rows)

    def workers(self) -> list[psutil.Process]:
        """Worker processes of the driver, of which not all may have begun to work."""
        try:
            children = self.driver.children(recursive=True)
        except psutil.NoSuchProcess:
            return []
        self.processes |= set(children)
        return [child for child in children if "spawn_main" in " ".join(command_line(child))]

    def wait(self, ready: Callable[[], bool]) -> bool:
        """Wait until something is the case, or the driver has ended; False for the latter."""
        deadline = time.monotonic() + PATIENCE
        while not ready():
            self.workers()
            if self.driver.poll() is not None:
                return False
            if time.monotonic() > deadline:
                raise SystemExit(f"nothing has happened for {PATIENCE:.0f} s")
            time.sleep(0.02)
        return True

    def disturb(self, kills: int) -> None:
        """Kill the driver and workers, `kills` in all and in random order, now early, now after some more records."""
        victims = ["driver", "worker"] * ((kills + 1) // 2)
        self.random.shuffle(victims)
        self.start()
        for number in range(kills):
            before, moment, delay = self.look(), time.monotonic(), math.inf
            # Never so many records that none would be left for the kills that are still to come.
            share = max(1, (self.tasks - before) // (kills - number + 1))
            wanted = min(before + self.random.randint(1, share), self.tasks - 2)
            if self.random.random() < 0.25:
                delay = self.random.uniform(0.0, 3.0)
            alive = self.wait(
                lambda moment=moment, delay=delay, wanted=wanted: (
                    time.monotonic() > moment + delay or self.look() >= wanted
                )
            )
            self.early_kills += self.look() == before
            time.sleep(self.random.uniform(0.0, 0.05))
            if alive and victims[number] == "worker":
                alive = self.kill_worker()
            elif alive:
                self.kill_driver()
            if not alive:
                raise SystemExit(f"the driver ended with status {self.driver.returncode} after {number} kills")

    def kill_worker(self) -> bool:
        """Kill a worker, in whatever state it is, as soon as there is one; False if the driver has ended."""
        while self.wait(lambda: bool(self.workers())):
            try:
                self.random.choice(self.workers()).kill()
            except (IndexError, psutil.NoSuchProcess):  # it has just ended
                continue
            self.worker_kills += 1
            return True
        return False

    def kill_driver(self) -> None:
        """Kill the driver, look for what it leaves, and start it again."""
        self.workers()
        self.driver.kill()
        self.driver.wait()
        self.driver_kills += 1
        self.look()
        self.orphans += len(left_over(self.processes))
        self.start()

    def finish(self) -> int:
        """Let the last driver end by itself; its exit status."""
        deadline = time.monotonic() + PATIENCE + self.tasks
        while self.driver.poll() is None:
            self.workers()
            self.look()
            if time.monotonic() > deadline:
                raise SystemExit("the last driver does not end")
            time.sleep(0.05)
        self.look()
        self.orphans += len(left_over(self.processes))
        return self.driver.returncode

    def end(self) -> None:
        """Leave no process behind, whatever went wrong."""
        for process in (self.driver, *self.processes):
            with contextlib.suppress(psutil.NoSuchProcess):
                if process is not None:
                    process.kill()


def command_line(process: psutil.Process) -> list[str]:
    """Command line of a process; nothing if it has ended."""
    try:
        return process.cmdline()
    except (psutil.NoSuchProcess, psutil.ZombieProcess):
        return []


def left_over(processes: set[psutil.Process]) -> list[psutil.Process]:
    """Which of these processes are still there after a while."""
    deadline = time.monotonic() + END
    while True:
        left = [process for process in processes if process.is_running() and command_line(process)]
        if not left or time.monotonic() > deadline:
            return left
        time.sleep(0.05)


def torture(folder: Path, tasks: int, kills: int, seed: int) -> dict[str, object]:
    """Run undisturbed and disturbed; what was found, with the verdict as "failures".

    Parameters
    ----------
    folder : to work in.
    tasks, kills : how many.
    seed : of the moments and the victims.
    """
    (folder / "undisturbed").mkdir()
    (folder / "disturbed").mkdir()
    expected = undisturbed(folder / "undisturbed", tasks)
    trial = Trial(folder=folder / "disturbed", tasks=tasks, random=random.Random(seed))
    begun = time.monotonic()
    try:
        trial.disturb(kills)
        status = trial.finish()
    finally:
        trial.end()
    connection = sqlite3.connect(trial.folder / FILE_NAME)
    records, keys = connection.execute("SELECT count(*), count(DISTINCT spec) FROM records").fetchone()
    failed = connection.execute("SELECT count(*) FROM failures").fetchone()[0]
    connection.close()
    with read_journal(trial.folder) as journal:
        same = records == tasks and draw(journal, tasks) == expected
    checks = {
        "the last driver ended well": status == 0,
        "every kill was done": trial.driver_kills + trial.worker_kills == kills,
        "no record was lost": not trial.lost,
        "no record was changed": not trial.changed,
        "no record is there twice": records == keys,
        "no record is missing": records == tasks,
        "no task failed": failed == 0,
        "the figure is that of the undisturbed run": same,
        "no process was left over": trial.orphans == 0,
    }
    return {
        "tasks": tasks, "kills of the driver": trial.driver_kills, "kills of workers": trial.worker_kills,
        "kills before any new record": trial.early_kills, "starts of the driver": trial.starts,
        "processes started": len(trial.processes) + trial.starts, "records seen": len(trial.seen), "records": records,
        "lost": len(trial.lost), "changed": len(trial.changed), "twice": records - keys, "left over": trial.orphans,
        "figure identical": same, "seconds": round(time.monotonic() - begun, 1),
        "failures": [name for name, holds in checks.items() if not holds],
    }  # fmt: skip


def main() -> int:
    """Print what was found; 1 if anything is not as it must be."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tasks", type=int, default=200)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="killed-run-") as folder:
        found = torture(Path(folder), given.tasks, given.kills, given.seed)
    for name, value in found.items():
        print(f"{name:<30}{', '.join(value) or 'none' if isinstance(value, list) else value}")
    return 1 if found["failures"] else 0


if __name__ == "__main__":
    import killed_run  # the module that drivers and workers import, and not __main__

    sys.exit(killed_run.main())
