"""Time scico's steps with total variation on the cube of `shadowgram bench iteration`; runs in its environment, without shadowgram.

    python -m venv peers && peers/bin/pip install scico
    peers/bin/python benchmarks/gap_tv_peers.py problem.npz

Three of them, on the same cube, code and snapshots, in float32, each a unit that others would call one step of total variation:

- prox: `functional.IsotropicTVNorm.prox` of the cube, once, along y and x. It approximates the proximal map by one pass of Haar
  transforms and thresholds.
- APGM: one `AcceleratedPGM.step()` of ½‖Hx − y‖² + weight · TV: a gradient of the data term, that prox, and the momentum.
- ADMM: one `ADMM.step()` of the same problem split at the finite differences, with at most 25 conjugate gradients to a tolerance of
  1e-4 for the data, as in scico's own examples.

H is an einsum with the effective code in memory, jitted. One thread, warmed up; `error` is the largest difference of scico's
snapshots from ours, relative to the largest. Prints JSON: a list of {peer, ms, median_ms, error, skipped}.
"""

from __future__ import annotations

import os

# Before any of the packages starts its threads.
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

import json
import statistics
import sys
import time
from collections.abc import Callable
from importlib import metadata
from typing import Any

import numpy as np

SECONDS = 4.0  # to spend on one function
STEPS = ("prox", "APGM", "ADMM")

Problem = dict[str, np.ndarray]


def scico_steps(problem: Problem) -> tuple[dict[str, Callable[[], Any]], float]:
    """Give the steps by name, and the error of the operator."""
    import jax.numpy as jnp  # pyright: ignore[reportMissingImports]
    from scico import functional, linop, loss, optimize  # pyright: ignore[reportMissingImports]
    from scico.optimize.admm import LinearSubproblemSolver  # pyright: ignore[reportMissingImports]

    code, cube, snapshots = (jnp.asarray(problem[name]) for name in ("code", "cube", "snapshots"))
    weight = float(problem["weight"])
    H = linop.LinearOperator(
        cube.shape, snapshots.shape, eval_fn=lambda x: jnp.einsum("qkyx,kyx->qyx", code, x),
        adj_fn=lambda y: jnp.einsum("qkyx,qyx->kyx", code, y), input_dtype=np.float32, output_dtype=np.float32, jit=True,
    )  # fmt: skip
    data = loss.SquaredL2Loss(y=snapshots, A=H)
    norm = functional.IsotropicTVNorm(axes=(1, 2), input_shape=cube.shape, input_dtype=np.float32)
    quiet = {"display": False}
    apgm = optimize.AcceleratedPGM(
        f=data, g=weight * norm, L0=float(problem["lipschitz"]), x0=H.adj(snapshots), itstat_options=quiet
    )
    gradient = linop.FiniteDifference(input_shape=cube.shape, axes=(1, 2), append=0, input_dtype=np.float32)
    admm = optimize.ADMM(
        f=data, g_list=[weight * functional.L21Norm()], C_list=[gradient], rho_list=[float(problem["rho"])],
        x0=H.adj(snapshots), itstat_options=quiet,
        subproblem_solver=LinearSubproblemSolver(cg_kwargs={"tol": 1e-4, "maxiter": 25}),
    )  # fmt: skip

    def step(solver: Any) -> None:
        solver.step()
        solver.x.block_until_ready()

    error = float(jnp.abs(H(cube) - snapshots).max() / jnp.abs(snapshots).max())
    steps = {
        "prox": lambda: norm.prox(cube, weight).block_until_ready(),
        "APGM": lambda: step(apgm),
        "ADMM": lambda: step(admm),
    }
    return steps, error


def timed(function: Callable[[], Any]) -> dict[str, float]:
    """Give the minimum and the median time of a function, ms."""
    taken: list[float] = []
    function()
    begun = time.perf_counter()
    while not taken or time.perf_counter() - begun < SECONDS:
        start = time.perf_counter()
        function()
        taken.append(1e3 * (time.perf_counter() - start))
    return {"ms": min(taken), "median_ms": statistics.median(taken)}


def main(path: str) -> None:
    """Time the steps."""
    try:
        version = metadata.version("scico")
    except metadata.PackageNotFoundError:
        nothing = {"ms": None, "median_ms": None, "error": None, "skipped": "it is not installed"}
        print(json.dumps([{"peer": f"scico {step}", **nothing} for step in STEPS]))
        return
    with np.load(path) as file:
        steps, error = scico_steps(dict(file))
    found = [{"peer": f"scico {version} {step}", **timed(steps[step]), "error": error, "skipped": ""} for step in STEPS]
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1])
