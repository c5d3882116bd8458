"""Figs. 4.14, 4.15, D.1 and D.2, section 4.9: the laboratory scan of a water cube, and whether there is a picture in it.

The source binarises 384 images of its mask, sums the detector's images with and without the target, takes the difference and
reconstructs a field whose left half is bright, with an edge. Here the difference is reconstructed with ADMM as in the source, with
three denoisers; then its slow drift alone, which the codes have nothing to do with; and then what is left without the drift. A
permutation test compares the codes with themselves at other times, and its power says what would have been found. The same test of
the author's simulated scans, where there is a target, is the control. The data are his, and not shipped: name their folder with
``--data``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

import shadowgram as sg
from shadowgram.experiments import data_folder
from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study
from shadowgram.xray._captured_drift import basis_of, slow_terms, without
from shadowgram.xray.capture_files import read_capture
from shadowgram.xray.captured import Capture, background_gain, drift, slip
from shadowgram.xray.permutation import detection_power, permutation_test

from . import _common as common
from ._cxbi_laboratory_panels import (
    AUTO,
    PARTS,
    count_panels,
    image,
    null_panel,
    order_panel,
    power_panel,
    powers,
    size_of,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


ORIGIN = "github.com/Edgar-Noita/CXBI"
FILES = {
    "codes_bin": "a32d2042e08585d1", "y_empty": "15c1d072f6ef4adb", "y_target": "3b1dc45b10ec392c",
    "1/code_it1": "fa6117ca955813ab", "1/y_UD": "7b033cdd92b35898", "1/y_air": "ebcddc0d8220464f",
    "1/y_box": "3175566cf2d46903", "10/code_it1": "9021d427b1c40fed", "10/y_UD": "5b330cf3afe961bb",
    "10/y_air": "3a8f0633f13c2de2", "10/y_box": "3d5d38440d9aa895", "50/code_it1": "9e3fe0d60387aee0",
    "50/y_UD": "427251396cc56cce", "50/y_air": "5f899628174c3900", "50/y_box": "72bfde72f6dd3511",
}  # fmt: skip
"""Data and their digests."""
DIVISOR = 1e3
"""Of the counts, as the source has it."""
OURS = "ours"
PICTURES = (OURS, "tv", "ffdnet", "bm3d")
"""`shadowgram.xray.reconstruct`, and ADMM as in the source with a denoiser."""
SIZES = ((7, 7), (14, 14), (20, 20), (29, 16))
"""(y, x) cells of the targets that are looked for; the last is half the field, as in the source's picture."""
CONTRASTS = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """One of the questions: "counts", "picture", "test", "power" or "control"; `name` says of what."""

    what: str
    name: str = ""
    order: int = AUTO
    size: tuple[int, int] = (0, 0)
    simulations: int = 0
    iterations: int = 0


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """All questions; the data are needed when they are computed."""
    iterations, simulations = (20, 12) if quick else (60, 200)
    controls = ("50/y_UD", "50/y_air") if quick else tuple(name for name in FILES if "/y_" in name)
    orders = (AUTO, 1) if quick else (AUTO, *range(13))
    return [
        Spec(what="counts", simulations=simulations),
        *(Spec(what="picture", name=name, iterations=iterations) for name in PICTURES),
        *(Spec(what="test", order=order, simulations=simulations) for order in orders),
        *(Spec(what="power", size=size, simulations=simulations) for size in SIZES),
        *(Spec(what="control", name=name, simulations=simulations) for name in controls),
    ]


def path_of(name: str) -> str:
    """Where a file lies in the folder of the data.

    Examples
    --------
    >>> from shadowgram.experiments.studies.cxbi_laboratory import path_of
    >>> path_of("10/y_UD"), path_of("y_empty")
    ('cxbi/gate/10/y_UD.mat', 'cxbi/experiment/y_empty.mat')
    """
    return f"cxbi/{'gate' if '/' in name else 'experiment'}/{name}.mat"


@lru_cache(maxsize=2)
def scan_of(codes: str, counts: str, background: str) -> Capture:
    """A scan of the author's, by the names of its files; without background if that is empty."""
    codes_file, counts_file, background_file = (
        data_folder.find(path_of(name), FILES[name], ORIGIN) if name else None for name in (codes, counts, background)
    )
    assert codes_file is not None
    return read_capture(codes_file, counts_file, background_file)


def laboratory() -> Capture:
    """The scan of the water cube."""
    return scan_of("codes_bin", "y_target", "y_empty")


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Answer one question."""
    answers = {"counts": _counts, "picture": _picture, "test": _test, "power": _power, "control": _control}
    return answers[spec.what](spec)


def _counts(_spec: Spec) -> Result:
    """The counts, their drifts, and what both runs share."""
    scan = laboratory()
    assert scan.background is not None
    difference = scan.counts - scan.background
    fitted = {
        "target": drift(scan.codes, scan.counts),
        "empty": drift(scan.codes, scan.background),
        "difference": drift(scan.codes, difference),
    }
    gain = background_gain(scan.codes, scan.counts, scan.background)
    moved = {axis: slip(scan.codes, scan.counts, scan.background, axis=axis) for axis in ("x", "y")}
    values = {
        "open": float(scan.codes.mean()), "net": float(difference.mean()), "mean": float(scan.counts.mean()),
        "orders": {name: one.order for name, one in fitted.items()},
        "noise": {name: one.residual for name, one in fitted.items()},
        "gain": gain.value, "gain_error": gain.standard_error,
        "slip_p": {axis: found.p_value for axis, found in moved.items()}, "area": _by_area(scan, fitted["target"].order),
    }  # fmt: skip
    arrays = {"target": scan.counts, "empty": scan.background, "difference": difference}
    slow = {f"drift_{name}": one.values + arrays[name].mean() for name, one in fitted.items()}
    values |= {"in_step": _best_share(scan, backwards=False), "backwards": _best_share(scan, backwards=True)}
    return Result(
        values=values,
        arrays={name: (a / DIVISOR).astype(np.float32) for name, a in (arrays | slow).items()}
        | {"codes": scan.codes[:4]},
    )


def _best_share(scan: Capture, *, backwards: bool) -> float:
    """Largest share of the variance that codes explain at any lag, perhaps in the opposite order."""
    codes = scan.codes[::-1] if backwards else scan.codes
    found = permutation_test(codes, scan.counts, scan.background, lags=range(1, len(codes)))
    return float(max(found.statistic, found.null.max()))


def _by_area(scan: Capture, order: int) -> tuple[float, float]:
    """By how much of the net counts they follow the open area, and the standard error; 1 for a flat picture behind the codes."""
    assert scan.background is not None
    basis = basis_of(slow_terms(len(scan.counts), order))
    area = scan.codes.mean(axis=(1, 2))
    x, y = without(area, basis), without(scan.counts, basis)
    scale = float(area.mean()) / float((scan.counts - scan.background).mean()) / float(x @ x)
    rest = y - x * float(x @ y) / float(x @ x)
    error = np.sqrt(float(rest @ rest) / (len(y) - basis.shape[1] - 1) * float(x @ x))
    return float(x @ y) * scale, float(error * scale)


def _picture(spec: Spec) -> Result:
    """Difference, drift and rest, reconstructed alike."""
    scan = laboratory()
    assert scan.background is not None
    difference = scan.counts - scan.background
    found = drift(scan.codes, difference)
    parts = (difference, difference.mean() + found.values, difference - found.values)
    if spec.name == OURS:
        images = [_ours(scan, part, spec.iterations) for part in parts]
    else:
        images = [_as_the_source(scan, part, found.residual, spec) for part in parts]
    named = dict(zip(PARTS, images, strict=True))
    values = {
        "contrast": {name: float(x.std() / x.mean()) for name, x in named.items()},
        "like_drift": _correlation(named["difference"], named["drift"]),
        "like_rest": _correlation(named["difference"], named["rest"]),
    }
    return Result(values=values, arrays={name: x.astype(np.float32) for name, x in named.items()})


def _as_the_source(scan: Capture, net: np.ndarray, noise: float, spec: Spec) -> np.ndarray:
    """ADMM with a denoiser, of a difference that is divided as in the source."""
    rows, columns = scan.codes.shape[1:]
    imager = sg.CXBI(shape=(rows, columns)).operator(scan.codes)
    level = float(net.mean()) / DIVISOR / (rows * columns * float(scan.codes.mean()))
    solver = sg.ADMM(
        denoiser=spec.name, sigma=(level, 0.3 * level), strength=(noise / DIVISOR) ** 2, max_iter=spec.iterations, tol=1e-4,
    )  # fmt: skip
    return sg.solve(solver, imager, net / DIVISOR).x


def _ours(scan: Capture, net: np.ndarray, iterations: int) -> np.ndarray:
    """The package's own reconstruction, of counts that are the run without target and something more."""
    assert scan.background is not None
    found = sg.xray.reconstruct(scan.codes, scan.background + net, scan.background, iterations=iterations)
    return found.x / DIVISOR


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a.ravel().astype(float), b.ravel().astype(float))[0, 1])


def _test(spec: Spec) -> Result:
    """The permutation test with one order of the drift."""
    scan = laboratory()
    return _tested(scan, None if spec.order == AUTO else spec.order)


def _tested(scan: Capture, order: int | None) -> Result:
    found = permutation_test(scan.codes, scan.counts, scan.background, drift_order=order)
    values = {
        "p": found.p_value, "least": found.least_p, "statistic": found.statistic, "order": found.drift_order,
        "noise": found.noise, "moves_in": found.moves_in, "lags": len(found.lags),
    }  # fmt: skip
    return Result(values=values, arrays={"null": found.null.astype(np.float32)})


def _power(spec: Spec) -> Result:
    scan = laboratory()
    found = detection_power(
        scan.codes, scan.counts, scan.background, contrasts=CONTRASTS, side=spec.size,
        simulations=spec.simulations,
    )  # fmt: skip
    # JSON has no infinity.
    smallest = found.smallest if np.isfinite(found.smallest) else None
    return Result(values={"contrasts": list(CONTRASTS), "power": found.power.tolist(), "smallest": smallest})


def _control(spec: Spec) -> Result:
    """The same test of a simulated scan; of a run without target there is nothing to subtract."""
    folder, target = spec.name.split("/")
    air = "" if target == "y_air" else f"{folder}/y_air"
    return _tested(scan_of(f"{folder}/code_it1", spec.name, air), None)


def figure(records: Sequence[Record]) -> Figure:
    """Counts, pictures of the difference, the drift and the rest, and the test with its power."""
    from shadowgram.figures.sheet import sheet

    counts = common.only(records, what="counts")
    pictures = [common.only(records, what="picture", name=name) for name in PICTURES]
    rows = [
        count_panels(counts),
        *([image(record, part) for part in PARTS] for record in pictures),
        [null_panel(records), order_panel(records), power_panel(records)],
    ]
    return sheet("The laboratory scan of a water cube (Figs. 4.15 and D.2): the picture is that of the drift", rows)


def claims(records: Sequence[Record]) -> list[Claim]:
    """What section 4.9 says, and what its data allow to say."""
    return [
        _binarised(records), _reconstructed(records), _area(records), _subtracted(records), _drift_only(records),
        _by_order(records), _found(records), _controls(records), _moving(records),
    ]  # fmt: skip


def _binarised(records: Sequence[Record]) -> Claim:
    share = common.only(records, what="counts").values["open"]
    return Claim(
        page=87, says="block means above their mean are open cells, of a mask with 50 % transmittance",
        found=f"{100 * share:.1f} % of the cells of the 384 codes are open", agrees=abs(share - 0.5) < 0.02,
    )  # fmt: skip


def _reconstructed(records: Sequence[Record]) -> Claim:
    test = common.only(records, what="test", order=AUTO).values
    smallest = _smallest(records)
    return Claim(
        page=89, says="the scene with the water target is reconstructed from the counts",
        found=f"beside a drift of order {test['order']}, codes in their place explain the counts no better than codes of another"
        f" time do: p = {test['p']:.2f} of {test['lags']} lags",
        agrees=test["p"] <= 0.05,
        why=f"not for lack of power: at 5 %, the test finds with a probability of 80 % a target of {smallest}",
    )  # fmt: skip


def _smallest(records: Sequence[Record]) -> str:
    parts = []
    for r in powers(records):
        least = r.values["smallest"]
        share = "no share that was tried" if least is None else f"{100 * least:.0f} %"
        parts.append(f"{size_of(r)} cells that gives {share} of the net counts")
    return ", or of ".join(parts)


def _area(records: Sequence[Record]) -> Claim:
    values = common.only(records, what="counts").values
    share, error = values["area"]
    few = share + 2 * error < 0.5
    rest = ". So most of what the target adds did not come through the open cells of these codes" if few else ""
    return Claim(
        page=None, says="do the counts grow with the open area of the code, as those of any target would, even a flat one?",
        found=f"beside the drift they do by {share:.2f} ± {error:.2f} of the net counts of {values['net'] / 1e6:.1f} million; 1 is"
        f" expected of a flat picture{rest}",
        agrees=None,
    )  # fmt: skip


def _subtracted(records: Sequence[Record]) -> Claim:
    values = common.only(records, what="counts").values
    noise, orders = values["noise"], values["orders"]
    return Claim(
        page=None, says="the counts without target are subtracted shot by shot (p. 87); what does that take away?",
        found=f"the mean, and part of the drift (orders {orders['target']} with, {orders['empty']} without target,"
        f" {orders['difference']} of the difference). Beside the drifts the runs share nothing: the gain from one to"
        f" the other is {values['gain']:.2f} ± {values['gain_error']:.2f}. So the noise of a shot grows from"
        f" {noise['target'] / 1e6:.2f} to"
        f" {noise['difference'] / 1e6:.2f} million counts, {100 * noise['difference'] / values['net']:.1f} % of the net counts",
        agrees=None,
    )  # fmt: skip


def _drift_only(records: Sequence[Record]) -> Claim:
    parts = []
    for name in PICTURES:
        values = common.only(records, what="picture", name=name).values
        contrast = values["contrast"]
        parts.append(
            f"{name}: correlation {values['like_drift']:.2f}; deviation over mean {contrast['difference']:.2f} of the picture,"
            f" {contrast['drift']:.2f} of the drift's and {contrast['rest']:.3f} without the drift"
        )
    return Claim(
        page=None, says="what does the drift look like through the codes, and what is left of the picture without it?",
        found="; ".join(parts), agrees=None,
    )  # fmt: skip


def _by_order(records: Sequence[Record]) -> Claim:
    tests = [r for r in records if r.spec["what"] == "test" and r.spec["order"] != AUTO]
    listed = ", ".join(f"{r.values['p']:.2f} ({r.spec['order']})" for r in tests)
    return Claim(
        page=None, says="does the verdict depend on the order of the drift?",
        found=f"p by order: {listed}", agrees=None,
    )  # fmt: skip


def _found(records: Sequence[Record]) -> Claim:
    parts = []
    for r in powers(records):
        pairs = ", ".join(
            f"{100 * c:g} %: {100 * p:.0f} %" for c, p in zip(r.values["contrasts"], r.values["power"], strict=True)
        )
        parts.append(f"{size_of(r)} cells: {pairs}")
    return Claim(
        page=None, says="how often would the test find a bright rectangle, by its share of the net counts?",
        found="; ".join(parts), agrees=None,
    )  # fmt: skip


def _controls(records: Sequence[Record]) -> Claim:
    parts = []
    for r in (r for r in records if r.spec["what"] == "control"):
        percent, target = r.spec["name"].split("/")
        parts.append(
            f"{target.removeprefix('y_')} at {percent} %: p = {r.values['p']:.2g},"
            f" {100 * r.values['statistic']:.0f} % of the variance"
        )
    least = common.only(records, what="control", name="50/y_UD").values["least"]
    return Claim(
        page=None, says="does the same test find the targets of the simulated scans, and nothing in those without?",
        found=f"{'; '.join(parts)} (the least possible p is {least:.2g}). The runs without target are coded too, weakly:"
        " air scatters behind the open cells, and not the same behind each",
        agrees=None,
    )  # fmt: skip


def _moving(records: Sequence[Record]) -> Claim:
    test = common.only(records, what="test", order=AUTO).values
    values = common.only(records, what="counts").values
    slips = values["slip_p"]
    listed = ", ".join(f"{axis}: p = {p:.2f}" for axis, p in slips.items())
    better = "no slip of up to 2 cells fits" if min(slips.values()) > 0.05 else "a slip fits"
    return Claim(
        page=None, says="the codes and the counts are from two runs of the stage (p. 87); are they out of step?",
        found=f"the mask moves on, to another code within {test['moves_in']} shots; {better} the counts better than none"
        f" ({listed}). With the codes at any of the 384 lags at most {100 * values['in_step']:.1f} % of the variance is"
        f" explained, and in the opposite order {100 * values['backwards']:.1f} %, as by chance among so many",
        agrees=None,
    )  # fmt: skip


STUDY = Study(
    name="cxbi-laboratory",
    title="The laboratory scan: what is in it, and what is not",
    source="Figs. 4.13 to 4.15, D.1 and D.2, section 4.9, pages 86 to 89",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
    data=ORIGIN,
)
