"""Time other packages on the problems of `shadowgram bench`; runs in their virtual environment, without shadowgram.

    python benchmarks/peers.py problem.npz "CASSI forward" "CASSI adjoint"

Each class below is one package on one imager or transform, written as someone who knows the package would: set up once,
float32, one thread (the process keeps to one processor), warmed up. What it computes is compared with shadowgram's result
before it is timed. Prints JSON: a list of {case, peer, ms, median_ms, error}, with "skipped" instead where a package is missing.
"""

from __future__ import annotations

import os

# Before any of the packages starts its threads.
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", JAX_PLATFORMS="cpu")

import json
import statistics
import sys
import time
import warnings
from collections.abc import Callable
from importlib import metadata

import numpy as np

SECONDS = 2.0  # to spend on one function; every one is called at least once


class TorchCASSI:
    """g[y, x + k] = Σ_k t[y, x] f[k, y, x]: one in-place multiply-add a band; the adjoint as one product with a strided view."""

    package = "torch"

    def __init__(self, problem: dict[str, np.ndarray]) -> None:
        import torch

        torch.set_num_threads(1)
        torch.set_grad_enabled(False)
        self.torch = torch
        self.x, self.y, self.t = (torch.from_numpy(problem[f"cassi_{name}"]) for name in ("cube", "snapshot", "code"))
        self.snapshot, self.cube = torch.empty_like(self.y), torch.empty_like(self.x)
        nx = self.y.shape[1]
        self.sheared = self.y.as_strided(tuple(self.x.shape), (1, nx, 1))

    def forward(self) -> np.ndarray:
        """Give the snapshot."""
        nx = self.x.shape[2]
        self.snapshot.zero_()
        for k in range(len(self.x)):
            self.snapshot[:, k : k + nx].addcmul_(self.t, self.x[k])
        return self.snapshot.numpy()

    def adjoint(self) -> np.ndarray:
        """Give the cube."""
        return self.torch.mul(self.sheared, self.t, out=self.cube).numpy()


class PylopsCASSI:
    """The same as a pylops operator; pylops is given flat arrays, as its solvers give them."""

    package = "pylops"

    def __init__(self, problem: dict[str, np.ndarray]) -> None:
        import pylops

        code = problem["cassi_code"]
        bands, _, nx = dims = problem["cassi_cube"].shape
        plane = np.empty_like(code)

        class CASSI(pylops.LinearOperator):
            def __init__(self) -> None:
                super().__init__(dtype=code.dtype, dims=dims, dimsd=problem["cassi_snapshot"].shape)

            def _matvec(self, x: np.ndarray) -> np.ndarray:
                y = np.zeros(self.dimsd, code.dtype)
                for k, band in enumerate(x.reshape(self.dims)):
                    np.multiply(code, band, out=plane)
                    y[:, k : k + nx] += plane
                return y.ravel()

            def _rmatvec(self, y: np.ndarray) -> np.ndarray:
                y, x = y.reshape(self.dimsd), np.empty(self.dims, code.dtype)
                for k in range(bands):
                    np.multiply(code, y[:, k : k + nx], out=x[k])
                return x.ravel()

        self.operator = CASSI()
        self.x, self.y = problem["cassi_cube"].ravel(), problem["cassi_snapshot"].ravel()

    def forward(self) -> np.ndarray:
        """Give the snapshot."""
        return self.operator.matvec(self.x)

    def adjoint(self) -> np.ndarray:
        """Give the cube."""
        return self.operator.rmatvec(self.y)


class DeepinvCASSI:
    """The package's own class.

    It averages over the bands where the model sums, and images of even size come out a pixel off: the result is not compared.
    """

    package = "deepinv"
    slow = True
    comparable = False

    def __init__(self, problem: dict[str, np.ndarray]) -> None:
        import torch
        from deepinv.physics import CompressiveSpectralImaging

        torch.set_num_threads(1)
        torch.set_grad_enabled(False)
        self.x = torch.from_numpy(problem["cassi_cube"])[None]
        self.y = torch.from_numpy(problem["cassi_snapshot"])[None, None]
        mask = torch.from_numpy(problem["cassi_code"]).expand_as(self.x).clone()
        self.physics = CompressiveSpectralImaging(tuple(self.x.shape[1:]), mask=mask, mode="sd", shear_dir="w")

    def forward(self) -> np.ndarray:
        """Give the snapshot."""
        return self.physics.A(self.x)[0, 0].numpy()

    def adjoint(self) -> np.ndarray:
        """Give the cube."""
        return self.physics.A_adjoint(self.y)[0].numpy()


class ScicoCASSI:
    """A scico operator: one jitted JAX function each way, with JAX arrays going in and coming out."""

    package = "scico"

    def __init__(self, problem: dict[str, np.ndarray]) -> None:
        import jax.numpy as jnp
        from scico.linop import LinearOperator

        code = jnp.asarray(problem["cassi_code"])
        bands, _, nx = problem["cassi_cube"].shape

        def shear_and_sum(x):
            y = jnp.zeros(problem["cassi_snapshot"].shape, code.dtype)
            for k in range(bands):
                y = y.at[:, k : k + nx].add(code * x[k])
            return y

        def mask_and_unshear(y):
            return jnp.stack([code * y[:, k : k + nx] for k in range(bands)])

        self.operator = LinearOperator(
            problem["cassi_cube"].shape, problem["cassi_snapshot"].shape, eval_fn=shear_and_sum, adj_fn=mask_and_unshear,
            input_dtype=np.float32, output_dtype=np.float32, jit=True,
        )  # fmt: skip
        self.x, self.y = jnp.asarray(problem["cassi_cube"]), jnp.asarray(problem["cassi_snapshot"])

    def forward(self) -> np.ndarray:
        """Give the snapshot."""
        return np.asarray(self.operator(self.x).block_until_ready())

    def adjoint(self) -> np.ndarray:
        """Give the cube."""
        return np.asarray(self.operator.adj(self.y).block_until_ready())


class TorchSSCSI:
    """The SSCSI with its effective code (shot, band, y, x) in memory, shot by shot and band by band."""

    package = "torch"

    def __init__(self, problem: dict[str, np.ndarray]) -> None:
        import torch

        torch.set_num_threads(1)
        torch.set_grad_enabled(False)
        self.torch = torch
        self.t, self.x, self.y = (torch.from_numpy(problem[f"sscsi_{name}"]) for name in ("code", "cube", "snapshots"))
        self.snapshots, self.cube = torch.empty_like(self.y), torch.empty_like(self.x)

    def forward(self) -> np.ndarray:
        """Give the snapshot."""
        self.snapshots.zero_()
        for k in range(len(self.x)):
            self.snapshots.addcmul_(self.t[:, k], self.x[k])
        return self.snapshots.numpy()

    def adjoint(self) -> np.ndarray:
        """Give the cube."""
        self.torch.mul(self.t[0], self.y[0], out=self.cube)
        for q in range(1, len(self.y)):
            self.cube.addcmul_(self.t[q], self.y[q])
        return self.cube.numpy()


class PylopsBasis:
    """pylops' own DCT and 2-D wavelet operators, composed; analysis is their forward."""

    package = "pylops"

    def __init__(self, problem: dict[str, np.ndarray]) -> None:
        import pylops.signalprocessing as transforms

        x = problem["sscsi_cube"]
        along = transforms.DCT(x.shape, axes=0, dtype=x.dtype)
        level = int(problem["levels"])
        self.operator = transforms.DWT2D(x.shape, axes=(1, 2), wavelet="sym8", level=level, dtype=x.dtype) @ along
        self.x = x.ravel()
        self.z = self.analysis()

    def synthesis(self) -> np.ndarray:
        """Give the cube."""
        return self.operator.rmatvec(self.z)

    def analysis(self) -> np.ndarray:
        """Give the coefficients."""
        return self.operator.matvec(self.x)


# case → (the classes that have it, their method, the array of the problem that it must give)
CASES = {
    "CASSI forward": ((TorchCASSI, PylopsCASSI, ScicoCASSI, DeepinvCASSI), "forward", "cassi_snapshot"),
    "CASSI adjoint": ((TorchCASSI, PylopsCASSI, ScicoCASSI, DeepinvCASSI), "adjoint", "cassi_back"),
    "SSCSI exact forward": ((TorchSSCSI,), "forward", "sscsi_snapshots"),
    "SSCSI exact adjoint": ((TorchSSCSI,), "adjoint", "sscsi_back"),
    "basis synthesis": ((PylopsBasis,), "synthesis", "sscsi_cube"),
    "basis analysis": ((PylopsBasis,), "analysis", ""),
}


def main(path: str, cases: list[str]) -> int:
    """Time every package that has one of the cases."""
    with np.load(path) as file:
        problem = dict(file)
    results = []
    for case in cases:
        peers, method, expected = CASES[case]
        for peer in peers:
            try:
                ready = peer(problem)
            except Exception as error:  # noqa: BLE001 - whatever keeps a peer from starting is told, not raised
                results.append(
                    {"case": case, "peer": peer.package, "skipped": f"{type(error).__name__}: {error}"[:200]}
                )
                continue
            function = getattr(ready, method)
            value = function()
            compared = expected and getattr(ready, "comparable", True)
            times = measure(function, slow=getattr(ready, "slow", False))
            results.append({
                "case": case,
                "peer": f"{peer.package} {metadata.version(peer.package)}",
                "ms": 1e3 * min(times),
                "median_ms": 1e3 * statistics.median(times),
                "error": relative_error(value, problem[expected]) if compared else None,
            })  # fmt: skip
    json.dump(results, sys.stdout)
    return 0


def measure(function: Callable[[], object], *, slow: bool) -> list[float]:
    """Seconds of repeated calls, after the one that was checked; a slow function is called once."""
    times: list[float] = []
    begun = time.perf_counter()
    while not times or (not slow and time.perf_counter() - begun < SECONDS):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return times


def relative_error(value: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference, relative to the largest value."""
    return float(np.abs(value.ravel() - expected.ravel()).max() / np.abs(expected).max())


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    raise SystemExit(main(sys.argv[1], sys.argv[2:]))
