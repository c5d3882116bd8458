"""The studies, each a module: a figure or table of chapters 2 to 4, made again.

Every module says in its docstring what it reproduces, and defines `STUDY` (`shadowgram.experiments.study.Study`).
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from shadowgram.experiments.study import Study

# In the order of the source; the module of "fig-2-4" is `fig_2_4`.
STUDIES = (
    "fig-2-4",
    "tables-2-1",
    "fig-2-13",
    "fig-2-14",
    "fig-2-15",
    "fig-2-17",
    "fig-2-19",
    "fig-2-20",
    "table-2-4",
    "fig-2-24",
    "fig-3-1",
    "fig-3-5",
    "fig-3-7",
    "table-3-1",
    "fig-3-12",
    "fig-3-13",
    "fig-3-14",
    "codes-c1",
    "codes-better",
    "codes-light",
    "fig-4-1",
    "fig-4-4",
    "slab-backscatter",
    "fig-4-5",
    "fig-4-8",
    "fig-4-9",
    "cxbi-poisson",
    "cxbi-gate",
    "table-4-1",
    "table-4-2",
    "fig-4-10",
    "fig-4-11",
    "cxbi-laboratory",
    "methods",
    "kaist",
    "tsa-real",
)


def load(name: str) -> Study:
    """Study of this name.

    Raises
    ------
    ValueError
        If there is none.

    Examples
    --------
    >>> from shadowgram.experiments.studies import load
    >>> load("fig-2-20").source
    'Figs. 2.20 and 2.21, pages 33 and 34'
    """
    if name not in STUDIES:
        raise ValueError(f"there is no study {name!r}; there are {', '.join(STUDIES)}")
    return import_module(f"{__name__}.{name.replace('-', '_')}").STUDY
