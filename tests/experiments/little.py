"""A study of little tasks, each with the trouble that a test asks for."""

import os
import signal
import time
from dataclasses import dataclass

import numpy as np
import threadpoolctl

from shadowgram._threads import thread_count
from shadowgram.experiments.study import Claim, Result, Study
from shadowgram.figures.style import new_figure


@dataclass(frozen=True, kw_only=True)
class Spec:
    """`trouble`: what goes wrong; `log`: file that gets a line for every computation."""

    number: int
    seed: int = 0
    trouble: str = ""
    log: str = ""


def compute(spec, scene):
    if spec.log:
        with open(spec.log, "a") as file:  # noqa: PTH123 - one write, which appends whole
            file.write(f"{spec.number}\n")
    {
        "": lambda: None,
        "slow": lambda: time.sleep(1.0),
        "raise": lambda: 1 / 0,
        "exit": lambda: exit(3),
        "die": lambda: os.kill(os.getpid(), signal.SIGKILL),
        "interrupt": lambda: os.kill(os.getpid(), signal.SIGINT),
        "wait": lambda: time.sleep(0.05),
    }[spec.trouble]()
    random = np.random.default_rng([spec.seed, spec.number]).normal(size=(40, 40))
    values = {"norm": np.linalg.norm(random @ random.T), "threads": thread_count(), "blas": blas_threads()}
    return Result(values=values, arrays={"file": random[:2].astype(np.float32)})


def blas_threads():
    # OpenMP libraries, of which another test may have loaded one, keep a number of threads for every thread that calls.
    libraries = (library for library in threadpoolctl.threadpool_info() if library["user_api"] == "blas")
    return max(library["num_threads"] for library in libraries)


def figure(records):
    drawn = new_figure(3, 2)
    axes = drawn.subplots()
    axes.plot([record.spec["number"] for record in records], [record.values["norm"] for record in records])
    axes.set_title(f"{len(records)} records")
    return drawn


def claims(records):
    return [
        Claim(page=33, says="The norm is positive", found=f"{len(records)} norms", agrees=True),
        Claim(page=34, says="It is less than 1 | never", found="it is not", agrees=False, why="too many numbers"),
        Claim(page=35, says="It is beautiful", found="nothing", agrees=None),
    ]


def make_study(specs, name="little", quick=1):
    """Study of `specs`, or of the first `quick` of them."""
    return Study(
        name=name,
        title="Norms of random matrices",
        source="Fig. 1, page 33",
        revision=1,
        specs=lambda scene, cut: specs[:quick] if cut else specs,
        run=compute,
        figure=figure,
        claims=claims,
    )
