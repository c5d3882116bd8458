"""Measure networks on what they were not trained on: ``python measure.py [OTHER.onnx …]``; the shipped one is always measured.

Gives the mean PSNR at three noise levels, beside BM3D if the package bm3d is installed, and the time at 32×32 beside torch.
"""

from __future__ import annotations

import argparse
import importlib.util
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

import data
import shadowgram as sg
from network import Network
from shadowgram.priors import FFDNet

LEVELS = (15, 25, 50)
SCENES = 24  # generated ones of 32×32

Denoise = Callable[[np.ndarray, float], np.ndarray]


def main() -> None:
    """Read the command line, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("others", type=Path, nargs="*")
    options = parser.parse_args()
    methods: dict[str, Denoise] = {"noisy": lambda image, _: image}
    if importlib.util.find_spec("bm3d"):
        import bm3d

        methods["BM3D (wheel)"] = bm3d.bm3d
    methods["shipped"] = FFDNet()
    methods |= {path.stem: FFDNet(path=path) for path in options.others}
    with sg.threads(1):
        for name, images in image_sets().items():
            print(f"\n{name}")
            for method, denoise in methods.items():
                values = (f"{mean_psnr(denoise, images, level / 255):6.2f}" for level in LEVELS)
                print(f"{method:24s}", *values, flush=True)
        print_speed()


def image_sets() -> dict[str, list[np.ndarray]]:
    """Photographs that were held out, whole and made smaller, and scenes as X-ray backscatter scanners see them."""
    rng = np.random.default_rng(99)
    return {
        "held-out photographs, 256×256": data.held_out(),
        "held-out photographs, whole": data.held_out_whole(),
        "four blocks, 32×32": [four_blocks(rng) for _ in range(SCENES)],
        "blocks, letters and discs, 32×32": [data.simple_scene(rng, 32) / 255 for _ in range(SCENES)],
    }


def four_blocks(rng: np.random.Generator) -> np.ndarray:
    """Four bright squares on a dark ground, (32, 32) in 0..1."""
    scene = np.full((32, 32), 0.08)
    for corner_y in (3, 18):
        for corner_x in (3, 18):
            y, x = corner_y + rng.integers(0, 3), corner_x + rng.integers(0, 3)
            side = rng.integers(7, 11)
            scene[y : y + side, x : x + side] = rng.uniform(0.4, 1)
    return scene


def mean_psnr(denoise: Denoise, images: list[np.ndarray], sigma: float) -> float:
    """Mean over the images, each with its own noise, that is the same for every method; peak 1."""
    rng = np.random.default_rng(7)
    values = []
    for clean in images:
        noisy = clean + sigma * rng.standard_normal(clean.shape, np.float32)
        error = np.mean((np.asarray(denoise(noisy, sigma)) - clean) ** 2)
        values.append(-10 * np.log10(error))
    return float(np.mean(values))


def print_speed() -> None:
    """Milliseconds for an image of 32×32 on one thread, onnxruntime and torch by turns, the best of each."""
    torch.set_num_threads(1)
    image = np.random.default_rng(0).standard_normal((32, 32)).astype(np.float32)
    tensor, sigma = torch.from_numpy(image)[None, None], torch.full((1, 1, 32, 32), 0.1)
    network, denoise = Network().eval(), FFDNet()

    def by_torch() -> None:
        with torch.inference_mode():
            network(tensor, sigma)

    best = {"onnxruntime": np.inf, "torch": np.inf}
    for _ in range(200):
        for name, work in (("onnxruntime", lambda: denoise(image, 0.1)), ("torch", by_torch)):
            start = time.perf_counter()
            work()
            best[name] = min(best[name], time.perf_counter() - start)
    print("\none image of 32×32, one thread:", ", ".join(f"{name} {1e3 * s:.2f} ms" for name, s in best.items()))


if __name__ == "__main__":
    main()
