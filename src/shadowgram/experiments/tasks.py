"""A task of a study: one specification and one scene, computed anywhere, on one thread, with the same result everywhere."""

from __future__ import annotations

import datetime as dt
import json
import platform
import shutil
import subprocess
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import shadowgram
from shadowgram._threads import threads

from .journal import Entry, pack_arrays
from .source import SceneSource, recorded
from .study import Result, Study, spec_fields, task_key

LABEL = 60  # characters of a label


@dataclass(frozen=True, kw_only=True)
class Task:
    """All that a process needs to compute a record; it travels to other processes.

    Attributes
    ----------
    key : as `study.task_key` gives it.
    label : in which fields of its specification it differs from the other tasks of its study, for people.
    study, revision, run : of the study. `run` travels as the name of a function of a module.
    spec, scene : what to compute.
    version : of the shadowgram that made the task.
    """

    key: str
    label: str
    study: str
    revision: int
    run: Callable[[Any, SceneSource], Result]
    spec: Any
    scene: SceneSource
    version: str

    @property
    def spec_json(self) -> str:
        """The specification as it stands in the journal."""
        return json.dumps(spec_fields(self.spec))


@dataclass(frozen=True, kw_only=True)
class Failure:
    """That a task failed.

    Attributes
    ----------
    error : the exception, in a line.
    details : the traceback, or the line again where there is none.
    time : UTC, ISO 8601.
    suspect : processes died while they had the task, perhaps for another reason.
    """

    error: str
    details: str
    time: str
    suspect: bool = False


Outcome = Entry | Failure


def make_tasks(study: Study, scene: SceneSource, quick: bool) -> list[Task]:
    """Tasks of a study in the order of its specifications; one that is listed twice is here twice.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from shadowgram.experiments.source import generated
    >>> from shadowgram.experiments.study import Result, Study
    >>> from shadowgram.experiments.tasks import make_tasks
    >>> @dataclass(frozen=True)
    ... class Spec:
    ...     shots: int
    >>> study = Study(
    ...     name="an-example", title="", source="", revision=1, specs=lambda scene, quick: [Spec(1), Spec(2)],
    ...     run=lambda spec, scene: Result(values={}), figure=lambda records: None, claims=lambda records: [],
    ... )
    >>> [task.label for task in make_tasks(study, generated(), quick=False)]
    ['shots=1', 'shots=2']
    """
    specs = study.specs(scene, quick)
    labels = _labels([spec_fields(spec) for spec in specs])
    return [
        Task(
            key=task_key(study, spec, scene),
            label=label,
            study=study.name,
            revision=study.revision,
            run=study.run,
            spec=spec,
            scene=scene,
            version=shadowgram.__version__,
        )
        for spec, label in zip(specs, labels, strict=True)
    ]


def compute(task: Task) -> Outcome:
    """Compute a task on one thread. Whatever goes wrong in it is an outcome too."""
    started, begun = now(), time.perf_counter()
    try:
        _check_version(task.version)
        _check_scene(task.scene)
        with threads(1):
            result = task.run(task.spec, task.scene)
        seconds = time.perf_counter() - begun
        values, arrays = json.dumps(result.values, default=_plain_number), pack_arrays(result.arrays)
    except (Exception, SystemExit) as error:  # noqa: BLE001 - one bad task must not end the others
        return Failure(error=one_line(error), details=traceback.format_exc(), time=now())
    return Entry(
        key=task.key,
        study=task.study,
        revision=task.revision,
        scene=task.scene,
        spec=task.spec_json,
        result=values,
        arrays=arrays,
        version=shadowgram.__version__,
        commit=code_commit(),
        host=platform.node(),
        started=started,
        seconds=seconds,
    )


def now() -> str:
    """The time, UTC, ISO 8601."""
    return dt.datetime.now(dt.UTC).isoformat(timespec="milliseconds")


def one_line(error: BaseException) -> str:
    """An exception in a line, with the place in the code that raised it.

    Examples
    --------
    >>> from shadowgram.experiments.tasks import one_line
    >>> one_line(KeyError("psnr"))
    "KeyError: 'psnr'"
    """
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return " ".join(f"{type(error).__name__}: {error}".split()) + place


@lru_cache(maxsize=1)
def code_commit() -> str:
    """Git commit of this code, with "-dirty" behind it if files were changed since; nothing if it runs from no checkout."""
    folder, git = Path(shadowgram.__file__).parents[2], shutil.which("git")
    if git is None or not (folder / ".git").exists():
        return ""
    # The options: 40 digits, no names of tags, and no lock that another git could run into.
    command = [git, "--no-optional-locks", "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()


def _labels(fields: list[dict[str, Any]]) -> list[str]:
    """For each specification the fields that are not the same in all."""
    texts = [{name: _short(value) for name, value in one.items()} for one in fields]
    names = dict.fromkeys(name for one in texts for name in one)
    varying = [name for name in names if len({one.get(name) for one in texts}) > 1]
    return [" ".join(f"{name}={one[name]}" for name in varying if name in one)[:LABEL] for one in texts]


def _short(value: Any) -> str:
    return value if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else json.dumps(value)


def _plain_number(value: object) -> object:
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(
        f"values of a result are numbers, texts and lists, got {type(value).__name__}; arrays belong in its 'arrays'"
    )


def _check_version(version: str) -> None:
    if version != shadowgram.__version__:
        raise ValueError(
            f"the worker on {platform.node()} has shadowgram {shadowgram.__version__}, not {version}; install the same"
        )


@lru_cache(maxsize=4)
def _check_scene(scene: SceneSource) -> None:
    """Raise an error if the file is no longer what it was when the run began; once for each scene and process."""
    if scene.path is not None and recorded(scene.path).digest != scene.digest:
        raise ValueError(f"{scene.path} has changed since the run began; run again with the new scene")
