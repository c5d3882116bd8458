"""FFDNet: a convolutional network that removes noise of a given level, run by onnxruntime."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from shadowgram._threads import thread_count

from . import _ffdnet_file as file
from .denoiser import checked_image, checked_sigma

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

SHIPPED = Path(__file__).parent / "weights" / "ffdnet_gray.onnx"

_NAME = "ffdnet"
_WORTH_THREADS = 96 * 96  # pixels; smaller images are slower on several threads
_TRAINED_SIGMA = 75 / 255  # the largest, of images in 0..1


@dataclass(frozen=True, kw_only=True)
class FFDNet:
    """Remove white Gaussian noise with a network that was trained for it.

    The weights that ship with the package work on images in any unit: the network has no biases and sees the image less its mean,
    so that the result for a · image + b and a · sigma is a · result + b. Weights of others, made into a file by
    ``shadowgram denoiser import``, mostly have biases; images are then scaled to the range 0..1 that they were trained on.

    Parameters
    ----------
    path : ONNX file with other weights; by default the weights in the package.

    Notes
    -----
    Every 2×2 square of pixels becomes four channels, beside a fifth with the noise level; 3×3 convolutions with ReLU work on those
    at half the resolution. An odd side is made even by reflection.
    Sources: Zhang, Zuo & Zhang, IEEE Trans. Image Process. 27 (2018) 4608; without biases: Mohan et al., ICLR 2020.

    Examples
    --------
    >>> import numpy as np, shadowgram as sg
    >>> clean = np.kron([[0.2, 0.8], [0.6, 0.1]], np.ones((16, 16)))
    >>> noisy = clean + 0.1 * np.random.default_rng(0).standard_normal(clean.shape)
    >>> denoised = sg.priors.FFDNet()(noisy, 0.1)
    >>> bool(np.abs(denoised - clean).mean() < 0.4 * np.abs(noisy - clean).mean())
    True
    """

    path: str | Path | None = None

    def __call__(self, image: ArrayLike, sigma: ArrayLike, /) -> np.ndarray:
        """Denoise an image.

        Parameters
        ----------
        image : (y, x) of at least 8×8 pixels, real numbers.
        sigma : standard deviation of the noise in the image's units: one number, or a map (y, x). Where it is 0, the image stays.

        Returns
        -------
        (y, x), float32

        Raises
        ------
        TypeError
            If image or sigma are not real numbers.
        ValueError
            If a shape does not fit, a value is not finite or sigma is negative; if the file holds no network for gray images.
        OSError
            If the file cannot be read.
        """
        noisy = checked_image(_NAME, image)
        levels = np.broadcast_to(checked_sigma(_NAME, sigma, noisy.shape), noisy.shape)
        if not levels.any() or noisy.min() == noisy.max():
            return noisy.copy()
        threads = thread_count() if noisy.size >= _WORTH_THREADS else 1
        return denoise(_open(SHIPPED if self.path is None else Path(self.path).resolve(), threads), noisy, levels)


def denoise(session: InferenceSession, noisy: np.ndarray, levels: np.ndarray) -> np.ndarray:
    """Denoise an image (y, x) of which not all values are the same, with a map of noise levels that are not all 0."""
    trained = session.get_modelmeta().custom_metadata_map.get(file.RANGE)
    offset, scale = (_centred if trained == file.ANY else _into_unit_range)(noisy, levels)
    # In float64, so that a large offset does not cost digits of the image.
    scaled = ((noisy - np.float64(offset)) / scale).astype(np.float32)
    result = _run(session, scaled, (levels / np.float64(scale)).astype(np.float32))
    largest = np.finfo(np.float32).max
    denoised = np.clip(result * np.float64(scale) + offset, -largest, largest).astype(np.float32)
    return np.where(levels > 0, denoised, noisy)


def _centred(noisy: np.ndarray, levels: np.ndarray) -> tuple[float, float]:
    """Mean of the image, and a power of two near its size: a scale that changes no digit, but avoids overflow."""
    mean = float(noisy.mean(dtype=np.float64))
    size = max(float(noisy.max()) - mean, mean - float(noisy.min()), float(levels.max()))
    return mean, float(2.0 ** np.ceil(np.log2(size)))


def _into_unit_range(noisy: np.ndarray, levels: np.ndarray) -> tuple[float, float]:
    """Offset and scale that bring the image into 0..1, except for outliers, and the noise to levels that were trained."""
    low, high = np.percentile(noisy.astype(np.float64), (1, 99))
    scale = max(float(high - low), float(levels.max()) / _TRAINED_SIGMA)
    return float(low + high - scale) / 2, scale


def _run(session: InferenceSession, image: np.ndarray, levels: np.ndarray) -> np.ndarray:
    height, width = image.shape
    extra = (0, height % 2), (0, width % 2)
    if height % 2 or width % 2:
        image, levels = np.pad(image, extra, "reflect"), np.pad(levels, extra, "reflect")
    feeds = {"image": image[None, None], "sigma": np.ascontiguousarray(levels[None, None, ::2, ::2])}
    return np.asarray(session.run(["denoised"], feeds)[0])[0, 0, :height, :width]


def _open(path: Path, threads: int) -> InferenceSession:
    """Session on a file, the same one until the file changes."""
    status = path.stat()
    return _session(path, status.st_mtime_ns, status.st_size, threads)


@lru_cache(maxsize=8)
def _session(path: Path, modified: int, size: int, threads: int) -> InferenceSession:  # noqa: ARG001 - part of the key
    return start_session(path.read_bytes(), str(path), threads)


def start_session(content: bytes, name: str, threads: int = 1) -> InferenceSession:
    """Start a network from the bytes of its file.

    Raises
    ------
    ValueError
        If they are not an ONNX file that ``shadowgram denoiser import`` wrote.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 4
    # Threads that wait in a loop would take time from everything else.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    wrong = f"{name} is not a network for gray images; make one with 'shadowgram denoiser import'"
    try:
        session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's exceptions share no other base
        raise ValueError(wrong) from error
    if session.get_modelmeta().custom_metadata_map.get(file.MARK) != file.FFDNET:
        raise ValueError(wrong)
    return session
