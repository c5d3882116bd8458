"""Time other denoisers on the images of `shadowgram bench denoisers`; runs in their virtual environment, without shadowgram.

    python -m venv peers && peers/bin/pip install bm3d scikit-image torch
    peers/bin/python benchmarks/denoiser_peers.py images.npz BM3D/32 FFDNet/256 TV/512

The package bm3d is free for non-commercial use only: it is timed here, and nothing of it is used. PyTorch runs a plain network of
the shape of FFDNet with random weights, which take as long as trained ones. scikit-image stops where its iteration moves little;
the difference from shadowgram's result, which has a duality gap, is printed. One thread, warmed up.
Prints JSON: a list of {name, size, peer, ms, median_ms, error, skipped}; `ms` is null where a package is missing.
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

SECONDS = 2.0  # to spend on one function; every one is called at least once more after a first call

Problem = dict[str, np.ndarray]


def bm3d_default(problem: Problem, size: int) -> Callable[[], Any]:
    """Both stages with the default settings."""
    from bm3d import bm3d  # pyright: ignore[reportMissingImports]

    image, sigma = problem[f"image_{size}"].astype(float), float(problem["sigma"])
    return lambda: bm3d(image, sigma)


def torch_network(problem: Problem, size: int) -> Callable[[], Any]:
    """Pixel-unshuffle, a map of the noise level as fifth channel, 3×3 convolutions with ReLU, pixel-shuffle."""
    import torch
    from torch import nn

    torch.set_num_threads(1)
    torch.set_grad_enabled(False)
    torch.manual_seed(0)
    features, layers = int(problem["features"]), int(problem["layers"])
    widths = [5, *[features] * (layers - 1), 4]
    parts: list[nn.Module] = []
    for i in range(layers):
        parts += [nn.Conv2d(widths[i], widths[i + 1], 3, padding=1), nn.ReLU()]
    network = nn.Sequential(*parts[:-1]).eval()
    image = torch.from_numpy(problem[f"image_{size}"])[None, None]
    sigma = float(problem["sigma"])

    def run() -> Any:
        squares = nn.functional.pixel_unshuffle(image, 2)
        levels = torch.full((1, 1, *squares.shape[2:]), sigma)
        return nn.functional.pixel_shuffle(network(torch.cat((squares, levels), 1)), 2).numpy()

    return run


def chambolle(problem: Problem, size: int) -> Callable[[], Any]:
    """Chambolle's projection with the default tolerance."""
    from skimage.restoration import denoise_tv_chambolle  # pyright: ignore[reportMissingImports]

    image, weight = problem[f"image_{size}"], float(problem["tv_weight"])
    return lambda: denoise_tv_chambolle(image, weight=weight)


PEERS: dict[str, tuple[str, Callable[[Problem, int], Callable[[], Any]]]] = {
    "BM3D": ("bm3d", bm3d_default),
    "BM3D fast": ("bm3d", bm3d_default),
    "FFDNet": ("torch", torch_network),
    "TV": ("scikit-image", chambolle),
}


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


def case(problem: Problem, name: str, size: int, known: dict[tuple[str, int], dict[str, float]]) -> dict[str, Any]:
    """Time the package for one denoiser at one size; what it was timed at before is not timed again."""
    package, make = PEERS[name]
    try:
        peer = f"{package} {metadata.version(package)}"
    except metadata.PackageNotFoundError:
        nothing = {"ms": None, "median_ms": None, "error": None, "skipped": "it is not installed"}
        return {"name": name, "size": size, "peer": package, **nothing}
    function, error = make(problem, size), None
    if f"{name}_{size}" in problem:
        ours = problem[f"{name}_{size}"]
        error = float(np.abs(function() - ours).max() / np.abs(ours).max())
    if (package, size) not in known:
        known[package, size] = timed(function)
    return {"name": name, "size": size, "peer": peer, **known[package, size], "error": error, "skipped": ""}


def main(path: str, cases: list[str]) -> None:
    """Time the cases, written as name/size."""
    with np.load(path) as file:
        problem = dict(file)
    known: dict[tuple[str, int], dict[str, float]] = {}
    found = []
    for text in cases:
        name, size = text.split("/")
        found.append(case(problem, name, int(size), known))
    print(json.dumps(found))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
