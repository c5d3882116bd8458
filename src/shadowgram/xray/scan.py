"""Scans: the counts of a sequence of shots through a coded mask, in two ways, and the scan with pencil beams that is their truth.

*Direct*: in every shot photons are followed through the mask with its real holes. *Linear*: what every cell of the mask gives is
tallied once, and the shots of any code are computed from it, which takes as long for a thousand shots as for one. Both give a
`Scan`, and `shadowgram.xray.scan_file` writes it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._scan_blocks import BACKGROUND_FIRST, Found, Plan, blocks_of, check_whole, together
from ._scan_codes import Coded, coded
from ._scan_codes import with_transmittance as with_transmittance
from ._scan_pencil import PencilMap as PencilMap
from ._scan_pencil import pencil_plan as pencil_plan
from ._scan_pencil import pencil_scan as pencil_scan
from .montecarlo.arrays import ORDERS

if TYPE_CHECKING:
    from .scene import Scene

Floats = NDArray[np.float64]
Route = Literal["direct", "linear"]
ROUTES: tuple[Route, ...] = ("direct", "linear")


@dataclass(frozen=True, kw_only=True, eq=False)
class Scan:
    """Counts of all detectors together, shot by shot.

    Attributes
    ----------
    counts : (shot,) with the target.
    standard_error : (shot,) by which they scatter about what an endless run would give; in counts with noise that is the noise.
    background, background_error : the same without the target; None if it was not taken.
    codes : (shot, y, x) uint8 in view of the source, 1 = hole; y counts the rows and x the columns of the mask.
    photons_per_shot : source photons that the counts are for.
    exposure : s in which the scene's source emits as many.
    route : "direct" or "linear".
    noisy : whether the counts have the noise of a real scan; otherwise they are means.
    seed : of all that is random.
    scene : TOML of the scene with the target.
    orders : mean counts per shot by what the photon did before, see `shadowgram.xray.montecarlo.arrays.ORDERS`; None of
        a linear scan.
    image : (y, x) counts per shot that the target gives through each cell, the truth that a reconstruction looks for; None of a
        direct scan.

    Raises
    ------
    ValueError
        If lengths do not fit together, or a number cannot be.
    """

    counts: Floats
    standard_error: Floats
    background: Floats | None = None
    background_error: Floats | None = None
    codes: NDArray[np.uint8]
    photons_per_shot: float
    exposure: float
    route: Route
    noisy: bool
    seed: int
    scene: str
    orders: Mapping[str, float] | None = None
    image: Floats | None = None

    def __post_init__(self) -> None:
        codes = np.asarray(self.codes)
        if codes.ndim != 3 or not codes.size or codes.dtype.kind not in "bu" or codes.max() > 1:
            raise ValueError("the codes of a scan are 0 and 1, (shot, y, x)")
        for name in ("counts", "standard_error", "background", "background_error"):
            _check_numbers(name, getattr(self, name), codes.shape[:1])
        if (self.background is None) != (self.background_error is None):
            raise ValueError("a background has a standard error, and there is none without it")
        _check_numbers("image", self.image, codes.shape[1:])
        if self.route not in ROUTES:
            raise ValueError(f"the route of a scan is {' or '.join(ROUTES)}, got {self.route!r}")
        if not (0 < self.photons_per_shot < np.inf and 0 < self.exposure < np.inf):
            raise ValueError("photons per shot and exposure must be positive")

    @property
    def signal(self) -> Floats:
        """(shot,) counts less the background: what the target gives.

        Raises
        ------
        ValueError
            If the background was not taken.
        """
        if self.background is None:
            raise ValueError("this scan has no background; make it with background=True (--background)")
        return self.counts - self.background

    @property
    def signal_error(self) -> Floats:
        """(shot,) standard error of `signal`."""
        if self.background_error is None:
            return self.standard_error
        return np.hypot(self.standard_error, self.background_error)


def _check_numbers(name: str, values: Floats | None, shape: tuple[int, ...]) -> None:
    if values is None:
        return
    if values.shape != shape or values.dtype.kind != "f" or not np.isfinite(values).all():
        what = " × ".join(map(str, shape))
        raise ValueError(f"{name.replace('_', ' ')} of this scan must be {what} finite numbers, got {values.shape}")


def direct_scan(
    scene: Scene,
    codes: ArrayLike | None = None,
    *,
    shots: int | None = None,
    histories: int | None = None,
    seed: int = 0,
    variance_reduction: bool = False,
    background: bool = False,
    threads: int | None = None,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Scan:
    """Follow the photons of every shot through the mask.

    Without variance reduction the counts of n photons *are* what a detector counts, noise and all.
    `shadowgram.experiments.xray_scan` does it with a journal and on other processes; the digits are the same.

    Parameters
    ----------
    scene : with a mask and detectors.
    codes : in the mask: a strip (row, column) that slides by a column a shot, or separate codes (shot, row, column); by default
        the scene's own strip.
    shots : by default as many as the scene, or the codes, have.
    histories : source photons of all shots together; by default as many as the scene's source emits. The counts are those of
        histories / shots photons, and are not scaled to another number.
    seed : shot q has histories q · n … (q + 1) · n − 1 of this seed; the background has others.
    variance_reduction : give means with smaller errors, in place of counts with noise.
    background : take the shots without the target as well.
    threads, progress : of this process; progress is told how many of how many parts are done.

    Raises
    ------
    OSError
        If a file of the scene cannot be read.
    ValueError
        If the scene has no mask or no detector, the codes do not fit, or a number cannot be.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.xray.scan import direct_scan
    >>> scan = direct_scan(sg.xray.shipped_scene("cxbi-blocks"), shots=2, histories=40_000)
    >>> scan.codes.shape, scan.photons_per_shot
    ((2, 32, 32), 20000.0)
    """
    plan = direct_plan(
        scene,
        codes,
        shots=shots,
        histories=histories,
        seed=seed,
        variance_reduction=variance_reduction,
        background=background,
    )
    return plan.run(threads=threads, progress=progress)


def direct_plan(
    scene: Scene,
    codes: ArrayLike | None = None,
    *,
    shots: int | None = None,
    histories: int | None = None,
    seed: int = 0,
    variance_reduction: bool = False,
    background: bool = False,
) -> Plan[Scan]:
    """The parts of `direct_scan`, to be computed anywhere; parameters and errors as there.

    Examples
    --------
    >>> from shadowgram.xray.scan import direct_plan
    >>> from shadowgram.xray.scene import shipped_scene
    >>> plan = direct_plan(shipped_scene("cxbi-blocks"), background=True)
    >>> len(plan.blocks), plan.histories
    (1024, 10240000000)
    """
    whole = coded(scene, codes, shots)
    each = _histories_per_shot(scene, histories, len(whole.steps))
    seed = check_whole("seed", seed, 0)
    parts = [(whole.scene, 0)]
    if background:
        parts.append((whole.scene.without_targets(), BACKGROUND_FIRST))
    listed = [
        blocks_of(
            part, whole.steps, histories=each, first_history=first, seed=seed, variance_reduction=variance_reduction
        )
        for part, first in parts
    ]

    def assemble(found: Sequence[Found]) -> Scan:
        return _direct(whole, each, seed, not variance_reduction, found, len(listed[0]))

    return Plan(blocks=tuple(block for blocks in listed for block in blocks), assemble=assemble)


def _histories_per_shot(scene: Scene, histories: int | None, shots: int) -> int:
    if histories is None:
        return max(2, round(scene.photons_per_shot))
    if check_whole("histories", histories, 2) < 2 * shots:
        raise ValueError(f"{shots} shots need at least {2 * shots} histories together, got {histories}")
    return int(histories) // shots


def _direct(whole: Coded, each: int, seed: int, noisy: bool, found: Sequence[Found], blocks: int) -> Scan:
    target = together(found[:blocks])
    rest = together(found[blocks:]) if found[blocks:] else None
    return Scan(
        counts=target.counts,
        standard_error=target.standard_error,
        background=None if rest is None else rest.counts,
        background_error=None if rest is None else rest.standard_error,
        codes=whole.codes,
        photons_per_shot=float(each),
        exposure=each / whole.scene.source.photons_per_second,
        route="direct",
        noisy=noisy,
        seed=seed,
        scene=whole.scene.toml(),
        orders=dict(zip(ORDERS, target.orders.mean(axis=0).tolist(), strict=True)),
    )


def linear_scan(
    scene: Scene,
    codes: ArrayLike | None = None,
    *,
    shots: int | None = None,
    histories: int | None = None,
    seed: int = 0,
    noise: bool = True,
    background: bool = False,
    threads: int | None = None,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Scan:
    """Compute the counts of all shots from what each cell of the mask gives.

    What the mask scatters itself, and the light around its plate, is not in the response. A smooth fit to direct runs of 16 of the
    shots stands for it, in which single shots of the source's scanner are off by about 1 %. It cancels in the signal, counts less
    background.

    Parameters
    ----------
    scene, codes, shots, seed, background : as of `direct_scan`.
    histories : source photons to be followed, with variance reduction, for the response of the mask, which is its precision; by
        default 20 000 for each cell in view, and 24 million at most.
    noise : draw Poisson counts of the photons that the scene's source emits in a shot; otherwise give their means.
    threads, progress : as of `direct_scan`.

    Raises
    ------
    OSError
        If a file of the scene cannot be read.
    ValueError
        If the scene has no mask or no detector, the codes do not fit, a number cannot be, or light crosses more than one
        wall between cells.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.xray.scan import linear_scan
    >>> scan = linear_scan(sg.xray.shipped_scene("cxbi-blocks"), shots=3, histories=50_000)
    >>> scan.counts.shape, scan.image.shape, scan.photons_per_shot
    ((3,), (32, 32), 10000000.0)
    """
    from ._scan_linear import means

    whole = coded(scene, codes, shots)
    seed = check_whole("seed", seed, 0)
    photons = scene.photons_per_shot
    parts = [whole.scene, whole.scene.without_targets()] if background else [whole.scene]
    found = []
    for number, part in enumerate(parts):
        said = _share(progress, number, len(parts))
        mean = means(whole.of(part), histories, seed, threads, said)
        counts, error = mean.counts * photons, mean.standard_error * photons
        if noise:
            counts = counts.clip(min=0.0)
            error = np.hypot(error, np.sqrt(counts))
            counts = np.random.default_rng((seed, number)).poisson(counts).astype(float)
        found.append((counts, error, mean.image * photons))
    return Scan(
        counts=found[0][0],
        standard_error=found[0][1],
        background=found[1][0] if background else None,
        background_error=found[1][1] if background else None,
        codes=whole.codes,
        photons_per_shot=photons,
        exposure=scene.exposure,
        route="linear",
        noisy=noise,
        seed=seed,
        scene=whole.scene.toml(),
        image=found[0][2],
    )


def _share(progress: Callable[[int, int], None], number: int, count: int) -> Callable[[int, int], None]:
    """Progress of one of several parts of equal length."""
    return lambda done, total: progress(number * total + done, count * total)
