"""Turn weights of an FFDNet from other programs into the ONNX file that `FFDNet` runs."""

from __future__ import annotations

import io
import itertools
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import _ffdnet_file as file
from ._torch_file import LARGEST, tensors
from .ffdnet import denoise, start_session

_EPSILON = 1e-5  # of batch normalisation, torch's default
_MATLAB_ORDER = [0, 2, 1, 3]  # MATLAB counts the pixels of a 2×2 square down its columns
_PROBE_SIGMA = 25 / 255
_LEAST_GAIN = 4.0  # the mean squared error must fall by this much


@dataclass(frozen=True, kw_only=True)
class Imported:
    """Weights as a file, and what was found out about them.

    Attributes
    ----------
    content : bytes of the ONNX file.
    layers, features : of the network.
    residual : whether its last layer gives the noise instead of the image.
    map_first : whether it takes the noise map before the pixels.
    gain : by how many dB it raised the PSNR of a test image.
    """

    content: bytes
    layers: int
    features: int
    residual: bool
    map_first: bool
    gain: float


def import_weights(path: Path) -> Imported:
    """Read weights of an FFDNet for gray images and make the ONNX file.

    A file of weights does not say whether the network gives the image or the noise, nor if the noise map comes before or after the
    pixels: programs differ. All four are tried on a test image with noise, and the one that removes it is taken.

    Parameters
    ----------
    path : ``.pth`` or ``.pt`` of PyTorch, a dictionary of tensors with or without batch normalisation, or ``.mat`` of MatConvNet
        (``net.layers``, at most version 7).

    Returns
    -------
    Imported

    Raises
    ------
    ValueError
        If the ending is unknown, the file is cut short, holds anything but the weights of a gray FFDNet, or the network
        does not remove noise.
    OSError
        If the file cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from shadowgram.priors.weights_import import import_weights
    >>> import_weights(Path("ffdnet.h5"))
    Traceback (most recent call last):
    ValueError: ffdnet.h5: weights are read from .pth, .pt and .mat files
    """
    kind = path.suffix.lower()
    if kind not in (".pth", ".pt", ".mat"):
        raise ValueError(f"{path}: weights are read from .pth, .pt and .mat files")
    if path.stat().st_size > LARGEST:
        raise ValueError(
            f"{path}: weights of an FFDNet have less than {LARGEST >> 20} MB, got {path.stat().st_size >> 20}"
        )
    content = path.read_bytes()
    try:
        weights, biases = _from_matlab(content) if kind == ".mat" else _from_torch(tensors(content))
        return _as_found(weights, biases, path.name)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _from_torch(given: dict[str, np.ndarray]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Weights and biases of the convolutions; batch normalisation after one is folded into it."""
    weights: list[np.ndarray] = []
    biases: list[np.ndarray] = []
    for _, names in itertools.groupby(given, key=lambda name: name.rpartition(".")[0]):
        group = {name.rpartition(".")[2]: given[name].astype(np.float64) for name in names}
        if group.get("weight", np.empty(0)).ndim == 4:
            weights.append(group["weight"])
            biases.append(group.get("bias", np.zeros(len(group["weight"]))))
        elif weights and {"weight", "bias", "running_mean", "running_var"} <= group.keys():
            factor = group["weight"] / np.sqrt(group["running_var"] + _EPSILON)
            if factor.shape != biases[-1].shape:
                raise ValueError("batch normalisation does not fit the convolution before it")
            weights[-1] = weights[-1] * factor[:, None, None, None]
            biases[-1] = (biases[-1] - group["running_mean"]) * factor + group["bias"]
        else:
            raise ValueError(f"it has a layer that an FFDNet does not have, with {', '.join(sorted(group))}")
    return weights, biases


def _from_matlab(content: bytes) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Weights and biases of the layers of type conv; the pixels of a square are brought from columns to rows."""
    from scipy.io import loadmat

    if b"MATLAB 7.3" in content[:128]:
        raise ValueError("it is of MATLAB version 7.3; save it again in MATLAB with the option '-v7'")
    try:
        layers = loadmat(io.BytesIO(content), simplify_cells=True)["net"]["layers"]
        convolutions = [layer["weights"] for layer in layers if layer["type"] == "conv"]
        weights = [np.asarray(w, np.float64).transpose(3, 2, 0, 1) for w, _ in convolutions]
        biases = [np.asarray(b, np.float64).reshape(-1) for _, b in convolutions]
    except Exception as error:  # a broken file may raise anything
        raise ValueError("it is not a whole MATLAB file with net.layers of MatConvNet") from error
    if weights and weights[0].shape[1] == file.CHANNELS_IN and len(weights[-1]) == file.CHANNELS_OUT:
        weights[0] = weights[0][:, [*_MATLAB_ORDER, 4]]
        weights[-1] = weights[-1][_MATLAB_ORDER]
        biases[-1] = biases[-1][_MATLAB_ORDER]
    return weights, biases


def _as_found(weights: list[np.ndarray], biases: list[np.ndarray], name: str) -> Imported:
    """Try the noise map last and first, and the image and the noise as what the network gives."""
    if not weights:
        raise ValueError("it has no convolutions")
    if (taken := weights[0].shape[1]) in (13, 15):
        raise ValueError(f"it is a network for colour images, of {taken} channels; one for gray images has 5")
    found: list[Imported] = []
    for map_first, residual in itertools.product((False, True), repeat=2):
        first = weights[0][:, [1, 2, 3, 4, 0]] if map_first and taken == file.CHANNELS_IN else weights[0]
        layers = file.Layers(
            weights=tuple(w.astype(np.float32) for w in (first, *weights[1:])),
            biases=tuple(b.astype(np.float32) for b in biases),
            residual=residual,
        )
        content = file.to_onnx(layers, f"imported from {re.sub(r'[^ -~]', '?', name)}")
        sizes = {"layers": len(weights), "features": len(weights[0])}
        found.append(Imported(content=content, **sizes, residual=residual, map_first=map_first, gain=_gain(content)))
    best = max(found, key=lambda one: one.gain)
    if best.gain < 10 * np.log10(_LEAST_GAIN):
        raise ValueError(
            f"this network does not remove noise: it changed the PSNR of a test image by {best.gain:.1f} dB"
        )
    return best


def _gain(content: bytes) -> float:
    """dB by which the PSNR of a test image with noise rises."""
    rng = np.random.default_rng(0)
    clean = np.kron(rng.uniform(0.1, 0.9, (8, 8)), np.ones((12, 12)))
    noisy = clean + _PROBE_SIGMA * rng.standard_normal(clean.shape)
    noisy = noisy.astype(np.float32)
    denoised = denoise(start_session(content, "the network"), noisy, np.full(noisy.shape, _PROBE_SIGMA, np.float32))
    return float(10 * np.log10(np.mean((noisy - clean) ** 2) / np.mean((denoised - clean) ** 2)))
