"""The network that is trained: FFDNet for gray images without biases, and how its weights move."""

from __future__ import annotations

import itertools

import torch
from torch import nn

_NEWTON_SCHULZ = (3.4445, -4.7750, 2.0315)


class Network(nn.Module):
    """Noise estimate from a noisy image and a noise map, both (image, 1, y, x) with even sides.

    The image is cut into its four pixels of every 2×2 square, with a fifth channel for the noise map; 3×3 convolutions and
    ReLU follow; four channels of noise are put together again. No layer has a bias, so that the estimate scales with its input.
    Sources: Zhang, Zuo & Zhang, IEEE Trans. Image Process. 27 (2018) 4608 (FFDNet); Mohan et al., ICLR 2020 (no biases).
    """

    def __init__(self, width: int = 64, depth: int = 15) -> None:
        super().__init__()
        sizes = [5] + [width] * (depth - 1) + [4]
        self.layers = nn.ModuleList(nn.Conv2d(a, b, 3, padding=1, bias=False) for a, b in itertools.pairwise(sizes))
        for layer in self.layers:
            nn.init.kaiming_normal_(layer.weight)
        with torch.no_grad():
            for layer in self.layers[1:-1]:
                # Starting near the identity makes a deep plain network as easy to train as one with shortcuts.
                layer.weight.mul_(0.5)
                layer.weight[:, :, 1, 1] += torch.eye(width)
            self.layers[-1].weight.mul_(0.1)

    def forward(self, image: torch.Tensor, sigma: torch.Tensor) -> torch.Tensor:
        """Noise in the image, in its units."""
        x = torch.cat([nn.functional.pixel_unshuffle(image, 2), sigma[:, :, ::2, ::2]], 1)
        x = x.contiguous(memory_format=torch.channels_last)
        for layer in self.layers[:-1]:
            x = torch.relu_(layer(x))
        with torch.autocast("cpu", enabled=False):
            x = self.layers[-1](x.float())
        return nn.functional.pixel_shuffle(x, 2)


class Muon(torch.optim.Optimizer):
    """Gradient steps of weights whose matrix (out, in·3·3) is orthogonalised, with Nesterov momentum.

    Source: Jordan et al., "Muon: an optimizer for hidden layers in neural networks" (2024).
    """

    def __init__(self, weights: list[torch.Tensor], lr: float = 0.01, momentum: float = 0.95) -> None:
        super().__init__(weights, {"lr": lr, "momentum": momentum})

    @torch.no_grad()
    def step(self) -> None:
        """Move every weight."""
        for group in self.param_groups:
            for weight in group["params"]:
                state = self.state[weight]
                mean = state.setdefault("mean", torch.zeros_like(weight))
                mean.lerp_(weight.grad, 1 - group["momentum"])
                direction = weight.grad.lerp(mean, group["momentum"])
                weight.add_(_orthogonalised(direction.flatten(1)).view_as(weight), alpha=-group["lr"])


def _orthogonalised(matrix: torch.Tensor) -> torch.Tensor:
    """About the nearest matrix with orthonormal rows, by five steps of a Newton-Schulz iteration."""
    a, b, c = _NEWTON_SCHULZ
    x = matrix / (matrix.norm() + 1e-12)
    for _ in range(5):
        gram = x @ x.T
        x = a * x + (b * gram + c * gram @ gram) @ x
    return x
