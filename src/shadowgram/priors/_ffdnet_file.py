"""The network as an ONNX file: from layers to bytes.

The file says of itself, as metadata properties, what the runner must know: that it is an FFDNet, and the `range` of the images it
was trained on: "any" for a network without biases, whose result scales with its input, or "0..1".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import _onnx as onnx

MARK, RANGE = "shadowgram.network", "shadowgram.range"  # metadata properties
FFDNET, ANY, UNIT = "ffdnet", "any", "0..1"
CHANNELS_IN, CHANNELS_OUT = 5, 4  # four pixels of every 2×2 square, in rows, and the noise map; four pixels


@dataclass(frozen=True, kw_only=True)
class Layers:
    """Convolutions of an FFDNet for gray images, with a ReLU after each but the last.

    Attributes
    ----------
    weights : of each layer (out, in, 3, 3), float32.
    biases : of each layer (out,), float32.
    residual : whether the last layer gives the noise instead of the image.
    """

    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]
    residual: bool

    def __post_init__(self) -> None:
        sizes = [CHANNELS_IN, *(len(w) for w in self.weights)]
        for number, (weight, bias, size) in enumerate(zip(self.weights, self.biases, sizes, strict=False), 1):
            if weight.shape[1:] != (size, 3, 3) or bias.shape != weight.shape[:1]:
                raise ValueError(
                    f"layer {number} of a gray FFDNet takes {size} channels through 3×3 weights, got the shape {weight.shape}"
                )
        if len(self.weights) < 2 or sizes[-1] != CHANNELS_OUT:
            raise ValueError(f"the last layer of a gray FFDNet gives {CHANNELS_OUT} channels, got {sizes[-1]}")
        if not all(np.isfinite(values).all() for values in (*self.weights, *self.biases)):
            raise ValueError("the weights hold NaN or infinite values")

    @property
    def range(self) -> str:
        """Range of the images: any, if there is no bias that would fix it."""
        return UNIT if any(np.any(bias) for bias in self.biases) else ANY


def to_onnx(layers: Layers, about: str) -> bytes:
    """Give the file: `image` (1, 1, 2h, 2w) and `sigma` (1, 1, h, w), of even rows and columns only, to `denoised`."""
    weights: dict[str, np.ndarray] = {}
    nodes = [
        onnx.node("SpaceToDepth", ["image"], "squares", blocksize=2),
        onnx.node("Concat", ["squares", "sigma"], "x0", axis=1),
    ]
    last = len(layers.weights)
    for number, (weight, bias) in enumerate(zip(layers.weights, layers.biases, strict=True), 1):
        weights[f"w{number}"] = weight
        names = [f"x{number - 1}", f"w{number}"]
        if np.any(bias):
            weights[f"b{number}"] = bias
            names.append(f"b{number}")
        result = f"c{number}" if number < last else "parts"
        nodes.append(onnx.node("Conv", names, result, kernel_shape=[3, 3], pads=[1, 1, 1, 1]))
        if number < last:
            nodes.append(onnx.node("Relu", [result], f"x{number}"))
    if layers.residual:
        nodes += [
            onnx.node("DepthToSpace", ["parts"], "noise", blocksize=2),
            onnx.node("Sub", ["image", "noise"], "denoised"),
        ]
    else:
        nodes.append(onnx.node("DepthToSpace", ["parts"], "denoised", blocksize=2))
    full, half = (1, 1, "height", "width"), (1, 1, "half_height", "half_width")
    graph = onnx.graph("FFDNet", nodes, weights, {"image": full, "sigma": half}, {"denoised": full})
    return onnx.model(graph, {MARK: FFDNET, RANGE: layers.range, "about": about})
