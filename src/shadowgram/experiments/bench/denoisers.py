"""Cases: the denoisers, beside the package `bm3d`, PyTorch and scikit-image on the same images."""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from shadowgram import priors

from .machine import Machine
from .peers import HOUR
from .spec import OURS, BenchSpec, Row, make_row
from .timing import alternate
from .work import Work

SCRIPT = Path(__file__).parents[4] / "benchmarks" / "denoiser_peers.py"
SIZES = (32, 256, 512)
SIGMA = 0.1
TV_WEIGHT = 0.75  # of sigma; with a weight of its own choice TV is solved for several
LAYERS, FEATURES = 15, 64  # of the network that ships, and of the one that PyTorch runs
DENOISERS: dict[str, tuple[priors.Denoiser, tuple[int, ...]]] = {
    "BM3D": (priors.BM3D(), SIZES),
    "BM3D fast": (priors.BM3D(profile="fast"), SIZES),
    "FFDNet": (priors.FFDNet(), SIZES[:2]),
    "TV": (priors.TVDenoiser(weight=TV_WEIGHT), SIZES),
}


def case_name(name: str, size: int) -> str:
    """What the rows of a denoiser are called."""
    return f"{name} {size}×{size}"


def denoiser_cases(spec: BenchSpec, machine: Machine) -> Iterator[Row]:
    """Every denoiser at every size. Total variation has no floor: how many iterations an image needs is not known before."""
    for name, (denoise, sizes) in DENOISERS.items():
        for size in sizes:
            timings = alternate({OURS: partial(denoise, noisy_image(size), SIGMA)}, spec.seconds)
            yield make_row(case_name(name, size), timings, work(name, size), machine)


def noisy_image(size: int) -> np.ndarray:
    """Squares on a slope, with noise, float32."""
    y, x = np.mgrid[:size, :size]
    clean = 0.2 + 0.3 * x / size + 0.4 * ((y // 11 + x // 13) % 3 == 0)
    return (clean + SIGMA * np.random.default_rng(0).standard_normal(clean.shape)).astype(np.float32)


def work(name: str, size: int) -> Work | None:
    """What a denoiser cannot do without; the image is read and written once.

    BM3D matches blocks in two stages: of every row of reference blocks and every displacement, with the rows of squared differences
    that blocks share added up once, that is 6 + 3·step operations a column; transforms and groups come to much less. FFDNet
    multiplies and adds 9 numbers a filter and pixel at half the resolution.
    """
    image = 8 * size**2
    if name == "FFDNet":
        filters = 5 * FEATURES + (LAYERS - 2) * FEATURES**2 + 4 * FEATURES
        return Work(image, 2 * 9 * filters * size**2 / 4)
    if name == "TV":
        return None
    flops = 0.0
    for step, reach in ((6, 12), (5, 12)) if name == "BM3D fast" else ((3, 19), (3, 19)):
        used = min(step, 2) if size <= 64 else step
        flops += size**2 / used * (2 * reach + 1) ** 2 * (6 + 3 * used)
    return Work(image, flops)


def compare(rows: Mapping[str, Row], python: str) -> Iterator[dict[str, object]]:
    """Records, as `peers.Peer` gives them, of other packages on those cases that are among our `rows`.

    Raises
    ------
    ValueError
        If the script fails; with its last words.
    """
    cases = {case_name(name, size): (name, size) for name, (_, sizes) in DENOISERS.items() for size in sizes}
    wanted = [case for case in cases if case in rows]
    if not wanted:
        return
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "images.npz"
        np.savez(path, allow_pickle=False, **_problem([cases[case] for case in wanted]))
        command = [python, str(SCRIPT), str(path), *("/".join(map(str, cases[case])) for case in wanted)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=HOUR, check=False)
    if done.returncode:
        raise ValueError(f"the peers failed: {' '.join(done.stderr.strip().splitlines()[-1:])}")
    for found in json.loads(done.stdout):
        case = case_name(found.pop("name"), found.pop("size"))
        ours = rows[case].ms
        ratio = None if found["ms"] is None else found["ms"] / ours
        yield {"case": case, **found, "ours_ms": ours, "ratio": ratio}


def _problem(wanted: list[tuple[str, int]]) -> dict[str, np.ndarray]:
    """Noisy images, our results of total variation, and the settings."""
    images = {f"image_{size}": noisy_image(size) for _, size in wanted}
    results = {
        f"TV_{size}": DENOISERS["TV"][0](images[f"image_{size}"], SIGMA) for name, size in wanted if name == "TV"
    }
    settings = {"sigma": SIGMA, "tv_weight": TV_WEIGHT * SIGMA, "layers": LAYERS, "features": FEATURES}
    return images | results | {name: np.array(value) for name, value in settings.items()}
