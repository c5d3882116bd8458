"""Make the ONNX file of trained weights: ``python export.py WEIGHTS OUT``, with weights.pt from train.py."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from shadowgram.priors._ffdnet_file import Layers, to_onnx

ABOUT = "FFDNet for gray images without biases; see ffdnet_gray.md"


def main() -> None:
    """Read the command line and write the file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("weights", type=Path)
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    options.out.write_bytes(exported(torch.load(options.weights, weights_only=True)))
    check(options.out)


def exported(state: dict[str, torch.Tensor]) -> bytes:
    """Bytes of the file, from the network's weights."""
    weights = tuple(np.ascontiguousarray(tensor.numpy(), np.float32) for tensor in state.values())
    biases = tuple(np.zeros(len(weight), np.float32) for weight in weights)
    return to_onnx(Layers(weights=weights, biases=biases, residual=True), ABOUT)


def check(path: Path) -> None:
    """Let the package onnx check the file, which it did not write."""
    import onnx

    onnx.checker.check_model(onnx.load(path), full_check=True)


if __name__ == "__main__":
    main()
