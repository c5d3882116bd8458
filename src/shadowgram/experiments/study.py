"""What a study is: specifications, a function that turns one into a record, a figure and claims that need the records alone.

A study is a module of `shadowgram.experiments.studies` whose docstring says what it reproduces and what agrees. It defines `STUDY`,
and `studies.STUDIES` lists them all.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from .source import SceneSource

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# A number, a text, a truth value, or lists and mappings of them: what JSON holds.
Value = Any


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """What one task found.

    Attributes
    ----------
    values : name → number, text or list, as JSON can hold them.
    arrays : name → array, for pictures and curves; kept small (float32, thinned out), since all records share one journal.
    """

    values: Mapping[str, Value]
    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """A result as it stands in the journal, with the specification it belongs to and how long it took."""

    spec: Mapping[str, Value]
    values: Mapping[str, Value]
    arrays: Mapping[str, np.ndarray]
    seconds: float


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A statement of the source, or a question of ours that it does not ask, and what was found.

    Attributes
    ----------
    page : of the dissertation; None for a question of ours.
    says : the statement, or the question.
    found : what the records show, with numbers.
    agrees : whether it does; None where the records cannot tell, and for a question.
    why : reason, where it does not agree or only in part.
    """

    page: int | None
    says: str
    found: str
    agrees: bool | None
    why: str = ""


@dataclass(frozen=True, kw_only=True)
class Study:
    """A figure or table, and how it is made.

    Attributes
    ----------
    name : on the command line, such as "fig-2-15".
    title : a line.
    source : figures, tables and pages of the source.
    revision : raised by one whenever the same specification would give another result; old records are then not used.
    specs : (scene, quick) → list of frozen dataclasses, each the whole specification of one task.
    run : (specification, scene) → result; seeded, and the same for any number of threads.
    figure : records → figure, from the records alone.
    claims : records → claims, from the records alone.
    data : where the measured data come from that its tasks need (`shadowgram.experiments.data_folder`); empty if they need none.
    """

    name: str
    title: str
    source: str
    revision: int
    specs: Callable[[SceneSource, bool], Sequence[Any]]
    run: Callable[[Any, SceneSource], Result]
    figure: Callable[[Sequence[Record]], Figure]
    claims: Callable[[Sequence[Record]], Sequence[Claim]]
    data: str = ""

    @property
    def chapter(self) -> int | None:
        """Chapter of the first figure, table or section that `source` names; None if it names none by a number such as 2.15.

        Examples
        --------
        >>> from shadowgram.experiments.studies import load
        >>> load("fig-2-20").source, load("fig-2-20").chapter
        ('Figs. 2.20 and 2.21, pages 33 and 34', 2)
        """
        found = re.search(r"(\d+)\.\d", self.source)
        return int(found[1]) if found else None


def spec_fields(spec: object) -> dict[str, Value]:
    """Specification as JSON would give it back: tuples become lists.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> from shadowgram.experiments.study import spec_fields
    >>> @dataclass(frozen=True)
    ... class Spec:
    ...     shots: int
    ...     shape: tuple[int, int]
    >>> spec_fields(Spec(3, (4, 5)))
    {'shots': 3, 'shape': [4, 5]}
    """
    return json.loads(json.dumps(dataclasses.asdict(spec)))  # type: ignore[call-overload]  # a dataclass, as the study says


def task_key(study: Study, spec: object, scene: SceneSource) -> str:
    """Digest of all that decides a result: study, revision, scene and specification."""
    whole = {"study": study.name, "revision": study.revision, "scene": scene.digest, "spec": spec_fields(spec)}
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()
