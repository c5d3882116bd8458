"""Figs. 4.11 and 4.12, section 4.8: a man with a pistol, over transmittance and compression ratio, and the contrast of the pistol.

The source scans the man with pencil beams of 3000 photons, multiplies that image by random codes, adds Gaussian noise of
variance 10⁴ and reconstructs with ADMM and BM3D. Measurement and reconstruction share one model there. Here the counts come
from transport through a tungsten mask with real holes (scene ``cxbi-man``), 3000 photons through a cell as in the source, and
the same noise is added; the reconstruction knows ideal cells only. It is `shadowgram.xray.reconstruct`, which chooses by the
noise alone; ADMM and BM3D with σ and λ chosen against the truth, as in the source, stand beside it, and so do scans with the
Poisson noise that air and mask bring in place of the Gaussian. Every point is a mean over strips and noises; the truth is what
the target gives through each open cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np

from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study

from . import _cxbi_maps as maps
from ._cxbi_ways import score
from ._man_panels import BLIND, GAUSSIAN, ORACLE, POISSON, SHOTS, chosen, compression, figure, mean_of, most
from ._man_regions import SCENE, contrasts, regions

PERCENT = (0.1, 0.5, 1.0, 2.5, 5.0, 10.0, 25.0, 50.0)
CURVES = (0.1, 1.0, 10.0)
"""Transmittances whose curves over the compression ratio the source shows."""
STRIP = 2048
"""Shots of a strip, half as many as pixels; every so manieth is taken."""
PHOTONS = 3000.0
"""Of the source, through one cell in a shot."""
VARIANCE = 1e4
"""Of the noise that the source adds."""
SIGMAS, STRENGTHS = (8.0, 16.0, 32.0, 64.0), (1.0,)
"""The oracle's grid: σ in counts, and λ in units of the variance of the counts."""
ORACLE_ITERATIONS = 40
OWN = 16
"""Photons followed for the response, for one of those that say what the mask scatters itself."""
GOOD = 0.8
"""SSIM from which on a reconstruction counts as good."""
FEWEST = 0.1
"""% of open cells, the fewest of the source."""
SEEN = (1.0, 2.5, 5.0)
"""% of open cells for which the source shows the pistol."""
PEAK = 10.0
"""% of open cells where the source finds the largest contrast."""
LARGE = 1e2
"""How much larger than the noise's variance the level is that makes Gaussian noise look like that of counts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One transmittance in %, number of shots, kind of noise and way of reconstructing, repeated with other strips and noises."""

    percent: float
    shots: int
    noise: str = GAUSSIAN
    way: str = BLIND
    repeats: int
    histories: int
    iterations: int = 100


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """All transmittances at the source's three compression ratios, and three of them beyond."""
    if quick:
        made = partial(Spec, repeats=1, histories=200_000, iterations=30)
        return [
            *(made(percent=percent, shots=SHOTS[0]) for percent in (1.0, 10.0, 50.0)),
            made(percent=10.0, shots=SHOTS[1]),
            made(percent=10.0, shots=SHOTS[0], noise=POISSON),
            made(percent=10.0, shots=SHOTS[0], way=ORACLE),
        ]
    largest, histories = SHOTS[-1], 8_000_000
    return [
        *(
            # More where CTR is flat and the source has its maximum.
            Spec(percent=percent, shots=largest, repeats=8 if percent >= PEAK else 3, histories=histories)
            for percent in PERCENT
        ),
        *(Spec(percent=percent, shots=largest, way=ORACLE, repeats=1, histories=histories) for percent in PERCENT),
        *(
            Spec(percent=percent, shots=shots, repeats=2, histories=histories)
            for shots in reversed(SHOTS[:-1])
            for percent in PERCENT
        ),
        *(Spec(percent=percent, shots=largest, noise=POISSON, repeats=1, histories=histories) for percent in PERCENT),
        *(
            Spec(percent=percent, shots=several * largest, repeats=1, histories=histories)
            for several in (2, 4)
            for percent in CURVES
        ),
    ]


@lru_cache(maxsize=1)
def photons_per_shot() -> float:
    """Photons of the source in a shot, so that `PHOTONS` of them go through a cell."""
    import shadowgram as sg

    scene = sg.xray.shipped_scene(SCENE)
    return scene.photons_per_shot * PHOTONS / float(sg.xray.scan_dose(scene).photons.mean())


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Scan, reconstruct and assess, with several strips and noises."""
    photons = photons_per_shot()
    rows = []
    image = truth = np.zeros(())
    shots = used = 0
    for seed in range(spec.repeats):
        scan = maps.expected(
            SCENE, percent=spec.percent, seed=seed, shots=STRIP, step=STRIP // spec.shots, histories=spec.histories,
            photons=photons,
        )  # fmt: skip
        rng = np.random.default_rng((seed, spec.shots, round(1000 * spec.percent)))
        x, truth = _reconstructed(spec, scan, rng), scan.image
        psnr, ssim = score(x, truth)
        rows.append([psnr, ssim, *contrasts(x)])
        image = x if seed == 0 else image
        shots, used = shots + spec.shots, used + len(scan.codes)
    names = ("psnr", "ssim", "contrast", "elsewhere")
    values: dict[str, object] = dict(zip(names, np.transpose(rows).tolist(), strict=True))
    values |= {"lit": used / shots, "true_contrast": contrasts(truth)[0], "scan_gray": _dose(spec)}
    values["centre"] = [float(c.mean()) for c in np.nonzero(regions().pistol)]
    values |= _levels(spec, photons)
    return Result(values=values, arrays={"image": image.astype(np.float32), "truth": truth.astype(np.float32)})


def _dose(spec: Spec) -> float:
    """Gy of the scan, the mean over the field."""
    import shadowgram as sg

    scene = sg.xray.shipped_scene(SCENE)
    found = sg.xray.scan_dose(scene, shots=spec.shots, transmittance=spec.percent / 100)
    return found.scan * photons_per_shot() / scene.photons_per_shot


def _levels(spec: Spec, photons: float) -> dict[str, float]:
    """Mean counts in a shot of the target, of the air through the holes, and of the mask itself."""
    scan = maps.expected(
        SCENE, percent=spec.percent, seed=0, shots=STRIP, step=STRIP // spec.shots, histories=spec.histories, photons=photons
    )  # fmt: skip
    levels = {"signal": float((scan.counts - scan.air).mean()), "air": float(scan.air.mean())}
    if spec.noise == POISSON:
        levels["mask"] = photons * maps.own_scatter(SCENE, spec.percent, spec.histories // OWN)
    return levels


def _reconstructed(spec: Spec, scan: maps.Shots, rng: np.random.Generator) -> np.ndarray:
    import shadowgram as sg

    if spec.noise == POISSON:
        own = photons_per_shot() * maps.own_scatter(SCENE, spec.percent, spec.histories // OWN)
        counts, air = (rng.poisson(mean.clip(min=0) + own) for mean in (scan.counts, scan.air))
        return sg.xray.reconstruct(scan.codes, counts, air, iterations=spec.iterations).x
    y = scan.counts - scan.air + rng.normal(0, np.sqrt(VARIANCE), len(scan.counts))
    if spec.way == ORACLE:
        return _oracle(scan, y)
    # Counts at a level where their own noise is the Gaussian one: reconstruct takes the variance from the mean.
    scale, level = LARGE, LARGE * VARIANCE
    found = sg.xray.reconstruct(
        scan.codes, scale * (y + level), np.full(len(y), scale * level), iterations=spec.iterations
    )
    return found.x / scale


def _oracle(scan: maps.Shots, y: np.ndarray) -> np.ndarray:
    """ADMM with BM3D, at the setting of the grid that comes closest to the truth."""
    import shadowgram as sg

    operator = sg.CXBI(shape=scan.codes.shape[1:]).operator(scan.codes)
    images = [
        sg.solve(
            sg.ADMM(
                denoiser="bm3d", sigma=sigma, strength=strength * VARIANCE, max_iter=ORACLE_ITERATIONS, tol=0
            ),
            operator, y,
        ).x.astype(float)
        for sigma in SIGMAS for strength in STRENGTHS
    ]  # fmt: skip
    return max(images, key=lambda x: score(x, scan.image)[0])


def claims(records: Sequence[Record]) -> list[Claim]:
    """What section 4.8 says of quality, contrast and the pistol, and what it does not ask."""
    own = chosen(records, shots=most(records))
    return [
        _few_holes(records), _enough(records), _seen(own), _peak(own),
        _other_ways(records), _own_noise(records), _dose_of(own),
    ]  # fmt: skip


def _list(own: Sequence[Record], name: str, digits: int) -> str:
    """Means and standard errors over the transmittance."""
    parts = []
    for record in own:
        mean, error = mean_of(record, name)
        more = f" ± {error:.{digits}f}" if error else ""
        parts.append(f"{record.spec['percent']:g} %: {mean:.{digits}f}{more}")
    return ", ".join(parts)


def _few_holes(records: Sequence[Record]) -> Claim:
    least = min(r.spec["percent"] for r in chosen(records))
    own = chosen(records, percent=least)
    means = [mean_of(r, "ssim")[0] for r in own]
    found = ", ".join(
        f"{compression(r):g} %: {mean_of(r, 'psnr')[0]:.1f} dB, {mean:.2f}" for r, mean in zip(own, means, strict=True)
    )
    return Claim(
        page=84, says="even at 0.1 % transmittance the algorithm performs well when the compression ratio is sufficient",
        found=f"at {least:g} %, by shots over pixels: {found} (good: an SSIM of {GOOD:g}); {100 * own[-1].values['lit']:.0f} % of"
        " the shots see a hole, and the others are left out",
        agrees=max(means) >= GOOD if least <= FEWEST else None,
        why="" if max(means) >= GOOD or least > FEWEST else "the noise that the source adds, of 100 counts, is larger than the"
        f" {own[-1].values['signal']:.0f} of the man in a shot",
    )  # fmt: skip


def _enough(records: Sequence[Record]) -> Claim:
    parts, rising, falling = [], 0, 0
    for shots in sorted({r.spec["shots"] for r in chosen(records)} & set(SHOTS)):
        own = chosen(records, shots=shots)
        for name, digits in (("psnr", 1), ("ssim", 2)):
            *before, last = [mean_of(r, name) for r in own]
            best = max(before, default=last)
            error = float(np.hypot(best[1], last[1]))
            rising += last[0] - best[0] > error
            falling += best[0] - last[0] > error
            parts.append(f"{name.upper()} at {compression(own[0]):g} % shots: {_list(own, name, digits)}")
    agrees = rising == 0 if len(parts) == 2 * len(SHOTS) else None
    return Claim(
        page=84, says="after a certain point, more transmittance does not necessarily give a better SSIM and PSNR",
        found=f"{'; '.join(parts)}; of these {len(parts)}, {falling} are better at less than the largest transmittance and"
        f" {rising} best"
        " there, by more than the standard error",
        agrees=agrees, why="some of them rise to the largest transmittance" if agrees is False else "",
    )  # fmt: skip


def _seen(own: Sequence[Record]) -> Claim:
    parts, won = [], {}
    for record in own:
        both = list(zip(record.values["contrast"], record.values["elsewhere"], strict=True))
        number = sum(pistol > elsewhere for pistol, elsewhere in both)
        won[record.spec["percent"]] = number == len(both)
        parts.append(
            f"{record.spec['percent']:g} %: {mean_of(record, 'contrast')[0]:.2f} against"
            f" {mean_of(record, 'elsewhere')[0]:.2f} ({number} of {len(both)})"
        )
    truth = contrasts(own[0].arrays["truth"])
    agrees = all(won[percent] for percent in SEEN) if set(SEEN) <= set(won) else None
    return Claim(
        page=85, says="at 1, 2.5 and 5 % transmittance and a compression ratio of 12.5 % the firearm is easily identified",
        found="CTR of the pistol against the largest of its outline elsewhere on the man, and in how many scans it is larger: "
        + ", ".join(parts)
        + f"; {truth[0]:.2f} against {truth[1]:.2f} in the truth",
        agrees=agrees,
        why="single images are too uncertain at few holes: blurred limbs and errors make as large a contrast where there is no"
        " pistol, although it is there for the eye" if agrees is False else "",
    )  # fmt: skip


def _peak(own: Sequence[Record]) -> Claim:
    found = {r.spec["percent"]: mean_of(r, "contrast") for r in own}
    best = max(found, key=lambda percent: found[percent][0])
    truth = own[0].values["true_contrast"]
    said, agrees = "", None
    if len(found) == len(PERCENT):
        (top, top_error), (ten, ten_error) = found[best], found[PEAK]
        apart, error = top - ten, float(np.hypot(top_error, ten_error))
        said = f"; that at {best:g} % is {apart:.2f} ± {error:.2f} above that at {PEAK:g} %"
        agrees = best == PEAK or (None if apart <= 2 * error else False)
    return Claim(
        page=86, says="CTR reaches its maximum at a transmittance of 10 %",
        found=f"{_list(own, 'contrast', 2)}; largest at {best:g} %{said}; {truth:.2f} in the truth", agrees=agrees,
        why="" if agrees or not said else "CTR rises with the transmittance as noise falls, up to about what the truth has, and"
        " is flat from there on; nothing in (4.16) prefers a transmittance",
    )  # fmt: skip


def _other_ways(records: Sequence[Record]) -> Claim:
    own = chosen(records, way=ORACLE)
    blind = [chosen(records, percent=r.spec["percent"], shots=r.spec["shots"])[0] for r in own]
    return Claim(
        page=None, says="what does the published method give, ADMM with BM3D, its parameters chosen against the truth?",
        found=f"CTR {_list(own, 'contrast', 2)}; PSNR {_list(own, 'psnr', 1)}; blind: PSNR {_list(blind, 'psnr', 1)}",
        agrees=None,
    )  # fmt: skip


def _own_noise(records: Sequence[Record]) -> Claim:
    own = chosen(records, noise=POISSON)
    levels = ", ".join(
        f"{r.spec['percent']:g} %: {r.values['signal']:.0f} of the man, {r.values['air']:.0f} of the air and"
        f" {r.values['mask']:.0f} of the mask"
        for r in own
    )
    return Claim(
        page=None, says="how does σ² = 10⁴ compare with the noise that a scanner has by itself?",
        found=f"mean counts in a shot, which are the variance: {levels}; PSNR with that noise, the air modelled:"
        f" {_list(own, 'psnr', 1)}; CTR {_list(own, 'contrast', 2)}",
        agrees=None,
    )  # fmt: skip


def _dose_of(own: Sequence[Record]) -> Claim:
    from shadowgram.xray.dose import COMMERCIAL

    found = ", ".join(f"{r.spec['percent']:g} %: {1e6 * r.values['scan_gray']:.2g}" for r in own)
    return Claim(
        page=None, says="what dose do these scans give, beside the 0.07 to 0.1 µSv of commercial scanners?",
        found=f"µGy, the mean over the field, {compression(own[0]):g} % shots: {found}; {1e6 * COMMERCIAL[0]:g} µSv would be"
        f" reached at {own[-1].spec['percent'] * COMMERCIAL[0] / own[-1].values['scan_gray']:.0f} % open cells",
        agrees=None,
    )  # fmt: skip


STUDY = Study(
    name="fig-4-11",
    title="A man with a pistol: quality and contrast over the transmittance",
    source="Figs. 4.11 and 4.12, pages 83 to 86",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
