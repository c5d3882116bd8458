"""The field's comparison: 28 bands of 256×256 pixels, one snapshot of 256×310, no noise; a question of ours, on chapter 2.

Papers on CASSI compare on ten scenes of KAIST (Choi et al., ACM Trans. Graph. 36 (2017)) and a mask of TSA-Net (Meng et al., ECCV
2020): a single disperser, 2 pixels from one band to the next, snapshots by the model that reconstructs. The scenes are not shipped.
Name their folder with ``--data``: every datacube of 28 bands and 256×256 pixels in it, or in its folder `kaist`, is a scene, and
`mask.mat` (or .npy, .tif …), 256×256, is the mask. Without a folder the generated scene and a random mask stand in.

Metrics: PSNR of the whole cube, peak 1; PSNR as published tables have it, the mean over the bands of PSNR after rounding to 256
levels; SSIM with peak 1, mean over the bands, over the places whose whole window (11×11, σ = 1.5) lies in the image; SAM in rad.
"""

from __future__ import annotations

import hashlib
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes, scenes
from shadowgram.experiments.data_folder import VARIABLE
from shadowgram.experiments.quality import assess
from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study
from shadowgram.spectral.cassi import CASSI

from . import _common as common
from . import _methods as methods
from ._methods import METHODS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Picture

# nm; as the authors of TSA-Net give them. Only colours depend on them.
WAVELENGTHS = (
    453.5, 457.5, 462.0, 466.0, 471.5, 476.5, 481.5, 487.0, 492.5, 498.0, 504.0, 510.0, 516.0, 522.5,
    529.5, 536.5, 544.0, 551.5, 558.5, 567.5, 575.5, 584.5, 594.5, 604.0, 614.5, 625.0, 636.5, 648.0,
)  # fmt: skip
BAND_SHIFT = 2
SIZE = 256
CUBES = (".mat", ".nc", ".npz", ".npy", ".hdr", ".tif", ".tiff")
MASK = "mask"
SHOWN = ("gpsr", "gap-tv", "eigen-tv", "eigen-pnp")


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One method on one scene; of a recorded scene, and of the mask, the digest of the file."""

    method: str
    scene: str
    digest: str
    mask: str
    size: int
    bands: int


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """All methods on all scenes of the folder."""
    found = {} if quick else _scenes()
    mask = _mask_file() if found else None
    named = {path.name: _digest(path) for path in found.values()} or {"": ""}
    bands, size = (8, 48) if quick else (len(WAVELENGTHS), SIZE)
    return [
        Spec(
            method=method, scene=name, digest=digest, mask="" if mask is None else _digest(mask), size=size, bands=bands
        )
        for name, digest in named.items()
        for method in METHODS
        if method != "eigen-tv-searched"
    ]


def _folder() -> Path | None:
    named = os.environ.get(VARIABLE)
    if not named:
        return None
    inner = Path(named) / "kaist"
    return inner if inner.is_dir() else Path(named)


def _scenes() -> Mapping[str, Path]:
    """Files of the folder that may be scenes, by name."""
    folder = _folder()
    files = [] if folder is None else sorted(folder.iterdir())
    return {path.name: path for path in files if path.suffix.lower() in CUBES and path.stem.lower() != MASK}


def _mask_file() -> Path | None:
    folder = _folder()
    files = [] if folder is None else sorted(folder.glob(f"{MASK}.*"))
    return files[0] if files else None


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def read_scene(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Values (band, y, x) float32 of a scene of the comparison, and the centres of its bands, (band,) nm.

    They are those of the comparison, unless a NetCDF file says others.

    Raises
    ------
    ValueError
        If it is no cube of 28 bands and 256×256 pixels in [0, 1].
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what is guessed, the comparison fixes
        cube = scenes.read(path, wavelengths=None if path.suffix.lower() == ".nc" else WAVELENGTHS)
    values = cube.values.astype(np.float32)
    wanted = (len(WAVELENGTHS), SIZE, SIZE)
    if values.shape != wanted:
        raise ValueError(
            f"{path} holds a cube of (band, y, x) = {values.shape}, and the comparison is of {wanted}; crop it"
        )
    if values.min() < 0 or values.max() > 1:
        raise ValueError(
            f"{path} has values from {values.min():.4g} to {values.max():.4g}, and the comparison's lie in [0, 1]; scale it"
        )
    return values, cube.wavelength.values


def _truth(spec: Spec, scene: SceneSource) -> tuple[np.ndarray, np.ndarray]:
    if spec.scene:
        return read_scene(_scenes()[spec.scene])
    edges = np.linspace(*scene.wavelengths, spec.bands + 1)
    return common.fine_cube(scene, spec.bands, (spec.size, spec.size)), (edges[1:] + edges[:-1]) / 2


def _mask(spec: Spec) -> np.ndarray:
    """Mask (1, y, x): of the folder, or a random one, half open."""
    path = _mask_file()
    if not spec.mask or path is None:
        return codes.random(shots=1, shape=(spec.size, spec.size), seed=0)
    mask = scenes.read_array(path)
    if mask.shape != (spec.size, spec.size):
        raise ValueError(f"{path} holds a mask of {mask.shape}, and the scenes have {spec.size}×{spec.size} pixels")
    return mask[None]


def published_psnr(x: np.ndarray, truth: np.ndarray) -> float:
    """PSNR in dB as the field's published code has it: of each band, peak 255, both rounded to 256 levels; the mean of the bands.

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.experiments.studies.kaist import published_psnr
    >>> truth = np.zeros((2, 4, 4))
    >>> round(published_psnr(truth + 0.1, truth), 2)  # 0.1 becomes 26 of 256
    19.83
    """
    a, b = np.round(256 * x.astype(np.float64)), np.round(256 * truth.astype(np.float64))
    error = np.maximum(np.square(a - b).mean(axis=(1, 2)), 1e-12)
    return float(np.mean(10 * np.log10(255**2 / error)))


def run(spec: Spec, scene: SceneSource) -> Result:
    """Measure without noise, reconstruct and assess."""
    truth, centres = _truth(spec, scene)
    bands, ny, nx = truth.shape
    imager = CASSI(cube_shape=(bands, ny, nx), band_centres=tuple(map(float, centres)), band_shift=BAND_SHIFT)
    H = imager.operator(_mask(spec))
    found = methods.best(spec.method, H, H.forward(truth), truth)
    x = found.solution.x
    quality = assess(x, truth, peak=1.0)
    values = {
        "psnr": quality.psnr, "published": published_psnr(x, truth), "ssim": quality.ssim, "sam": quality.sam,
        "seconds": round(found.seconds, 3), "snapshot": list(H.out_shape[1:]), "solver": repr(found.spec),
    }  # fmt: skip
    exposure = common.exposure_of(truth, centres)
    pictures = {"picture": common.colours(x, centres, exposure)} if spec.method in SHOWN else {}
    if spec.method == SHOWN[0]:
        pictures["truth"] = common.colours(truth, centres, exposure)
    return Result(values=values, arrays=pictures)


def _names(records: Sequence[Record]) -> list[str]:
    return list(dict.fromkeys(r.spec["scene"] for r in records))


def _title(scene: str) -> str:
    return Path(scene).stem if scene else "generated scene"


def figure(records: Sequence[Record]) -> Figure:
    """True colours of every scene and its reconstructions."""
    from shadowgram.figures.sheet import sheet

    rows = [_row(common.chosen(records, scene=name), name) for name in _names(records)]
    return sheet("One snapshot of 28 bands, 2 px a band: the field's comparison", rows)


def _row(records: Sequence[Record], scene: str) -> list[Picture]:
    from shadowgram.figures.sheet import Picture

    first = common.only(records, method=SHOWN[0])
    row = [Picture(title=_title(scene), picture=first.arrays["truth"], caption="truth")]
    for name in SHOWN:
        record = common.only(records, method=name)
        caption = f"{record.values['psnr']:.2f} dB, SSIM {record.values['ssim']:.3f}"
        row.append(Picture(title=METHODS[name].text, picture=record.arrays["picture"], caption=caption))
    return row


def claims(records: Sequence[Record]) -> list[Claim]:
    """The field's table: PSNR and SSIM of every scene, and their means."""
    return [_table(records, "published", "PSNR in dB as published tables have it", 2), *_tables(records)]


def _tables(records: Sequence[Record]) -> list[Claim]:
    return [
        _table(records, "psnr", "PSNR in dB of the whole cube, peak 1", 2),
        _table(records, "ssim", "SSIM, mean over the bands", 3),
        _table(records, "sam", "spectral angle in rad", 3),
        _table(records, "seconds", "seconds on one thread", 1),
    ]


def _table(records: Sequence[Record], what: str, title: str, digits: int) -> Claim:
    names = _names(records)
    rows = []
    for method in dict.fromkeys(r.spec["method"] for r in records):
        found = [float(common.only(records, method=method, scene=name).values[what]) for name in names]
        cells = " / ".join(f"{value:.{digits}f}" for value in found)
        rows.append(
            f"{METHODS[method].text} {cells}" + (f", mean {np.mean(found):.{digits}f}" if len(found) > 1 else "")
        )
    return Claim(
        page=None,
        says=f"{title}: which method is best on {', '.join(map(_title, names))}?",
        found="; ".join(rows),
        agrees=None,
    )


STUDY = Study(
    name="kaist",
    title="The field's comparison: 28 bands from one CASSI snapshot",
    source="a question of ours, on section 2.2",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
