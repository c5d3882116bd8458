"""Time shadowgram's single-disperser CASSI in PyTorch beside deepinv's own, on the same cubes in the same run.

    pip install "shadowgram[torch]"
    python benchmarks/torch_peers.py [BANDS ROWS COLUMNS BATCH]

Both are physics of deepinv, float32, on one thread. deepinv's `CompressiveSpectralImaging` averages the bands where shadowgram adds
them, and takes one mask a physics: one shot. Version 0.5.0 moves the picture by a pixel, and fails its own adjointness test, unless
ROWS and COLUMNS + BANDS - 1 are odd, as they are by default. It shears by a convolution with a kernel of the size of the picture,
which takes minutes at 256 × 256. Then a plain PyTorch loop over the bands, which is what one would write by hand; and learning, the
gradient of a loss by the code. Results are compared before anything is timed.
Prints JSON: a list of {what, name, ms, ratio}; `ms` is the median processor time, and `ratio` that over shadowgram's.
"""

from __future__ import annotations

import os

# Before any of the packages starts its threads. Processor time is then what a function costs, whatever else the machine does.
os.environ.update(OMP_NUM_THREADS="1", MKL_NUM_THREADS="1", SHADOWGRAM_THREADS="1")

import json
import statistics
import sys
import time
from collections.abc import Callable

import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from deepinv.physics import CompressiveSpectralImaging  # pyright: ignore[reportMissingImports]

import shadowgram as sg

ROUNDS = 15
SECONDS = 5.0  # after which a function is not timed again
Run = Callable[[], torch.Tensor]


def loop_forward(code: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """Sum of shifted bands, by hand."""
    bands, ny, nx = x.shape[1:]
    y = x.new_zeros(len(x), len(code), ny, nx + bands - 1)
    for k in range(bands):
        y[..., k : k + nx] += code * x[:, k, None]
    return y


def loop_adjoint(code: torch.Tensor, y: torch.Tensor, bands: int) -> torch.Tensor:
    """Transpose of `loop_forward`."""
    nx = code.shape[2]
    return torch.stack([(code * y[..., k : k + nx]).sum(1) for k in range(bands)], 1)


def median_ms(runs: dict[str, Run]) -> dict[str, float]:
    """Each in turn, so that what else the machine does falls on all alike."""
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    for run in runs.values():
        run()
    for _ in range(ROUNDS):
        for name, run in runs.items():
            if sum(seconds[name]) > SECONDS:
                continue
            begun = time.process_time()
            run()
            seconds[name].append(time.process_time() - begun)
    return {name: 1000 * statistics.median(all_of_it) for name, all_of_it in seconds.items()}


def code_gradient(forward: Callable[[torch.Tensor], torch.Tensor], code: torch.Tensor) -> Run:
    """Gradient of a squared loss by the code."""

    def run() -> torch.Tensor:
        given = code.clone().requires_grad_()
        return torch.autograd.grad((forward(given) ** 2).sum(), given)[0]

    return run


def agree(what: str, found: torch.Tensor, wanted: torch.Tensor) -> None:
    """Raise if two results differ by more than rounding."""
    gap = float((found - wanted).abs().max() / wanted.abs().max())
    if gap > 1e-5:
        raise SystemExit(f"{what} differ by {gap:.2g} of the largest value: the times would compare different things")
    print(f"{what} agree to {gap:.1g}", file=sys.stderr)


def main(bands: int, rows: int, columns: int, batch: int) -> None:
    """Compare and time."""
    torch.set_num_threads(1)
    imager = sg.CASSI(cube_shape=(bands, rows, columns), wavelengths=(450, 650))
    code = sg.codes.random(shots=1, shape=imager.code_shape, seed=0)
    ours, camera = sg.operators.as_deepinv(imager.operator(code)), sg.spectral.torch_imager(imager)
    mask = torch.from_numpy(code).float()
    theirs = CompressiveSpectralImaging(
        (bands, rows, columns), mask=mask.expand(1, bands, -1, -1).contiguous(), mode="sd", shear_dir="w"
    )
    rng = np.random.default_rng(0)
    x = torch.from_numpy(rng.random((batch, bands, rows, columns), np.float32))
    y = torch.from_numpy(rng.random((batch, 1, rows, columns + bands - 1), np.float32))

    agree("forward of shadowgram and deepinv", theirs.A(x) * bands, ours.A(x))
    agree("adjoint of shadowgram and deepinv", theirs.A_adjoint(y) * bands, ours.A_adjoint(y))
    agree("forward of shadowgram and a loop", loop_forward(mask, x), ours.A(x))
    agree("adjoint of shadowgram and a loop", loop_adjoint(mask, y, bands), ours.A_adjoint(y))
    by_ours, by_loop = (code_gradient(lambda c: camera(c, x), mask), code_gradient(lambda c: loop_forward(c, x), mask))
    agree("gradients by the code", by_loop(), by_ours())

    cases: dict[str, dict[str, Run]] = {
        "forward": {
            "shadowgram": lambda: ours.A(x),
            "deepinv": lambda: theirs.A(x),
            "loop": lambda: loop_forward(mask, x),
        },
        "adjoint": {
            "shadowgram": lambda: ours.A_adjoint(y),
            "deepinv": lambda: theirs.A_adjoint(y),
            "loop": lambda: loop_adjoint(mask, y, bands),
        },
        "gradient by the code": {"shadowgram": by_ours, "loop": by_loop},
    }
    found = []
    for what, runs in cases.items():
        times = median_ms(runs)
        found += [
            {"what": what, "name": name, "ms": round(ms, 2), "ratio": round(ms / times["shadowgram"], 1)}
            for name, ms in times.items()
        ]
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main(*(int(a) for a in sys.argv[1:])) if len(sys.argv) == 5 else main(24, 127, 128, 1)
