"""`shadowgram xray reconstruct`."""

from __future__ import annotations

import time
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import output
from .arguments import parse_size

if TYPE_CHECKING:
    import numpy as np

    from shadowgram.xray.captured import Capture
    from shadowgram.xray.permutation import PermutationTest
    from shadowgram.xray.reconstruction import Reconstruction

KIND = "xray-image"


class DenoiserName(StrEnum):
    """Priors of the image."""

    ffdnet = "ffdnet"
    bm3d = "bm3d"
    tv = "tv"


@dataclass(frozen=True, kw_only=True, eq=False)
class _Found:
    """What came of the counts of a scan."""

    scan: Capture
    result: Reconstruction
    model: np.ndarray
    test: PermutationTest | None
    problem: str
    seconds: float

    @property
    def verdict(self) -> str:
        """A sentence on whether to trust the image."""
        return f"no permutation test: {self.problem}" if self.test is None else self.test.verdict


def reconstruct(
    context: typer.Context,
    codes: Annotated[
        Path,
        typer.Argument(
            metavar="CODES",
            help="Codes, .mat, .npz or .npy; or a scan with its counts, .nc as 'xray scan' writes it, or .npz.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Image to write, .nc.", show_default=False)],
    counts: Annotated[
        Path | None, typer.Argument(metavar="[COUNTS]", help="Counts, a number a shot: .mat, .npz or .npy.")
    ] = None,
    background: Annotated[Path | None, typer.Option(help="Counts of a run without target.", show_default=False)] = None,
    shape: Annotated[
        str | None,
        typer.Option(help="Rows x columns of a code, where CODES has them as rows of one matrix.", show_default=False),
    ] = None,
    block: Annotated[
        float | None,
        typer.Option(
            help="Detector pixels a cell, such as 7, where CODES has images of the codes; 2.5 is possible.",
            show_default=False,
        ),
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Use every so manieth shot.")] = 1,
    denoiser: Annotated[
        DenoiserName | None,
        typer.Option(help="Prior of the image.", show_default="ffdnet, and its mean with bm3d in the end"),
    ] = None,
    png: Annotated[
        Path | None, typer.Option("--png", help="Show image, counts and verdict in this PNG.", show_default=False)
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Reconstruct the image behind the counts of a coded backscatter scan, and say whether to trust it.

    Example: shadowgram xray reconstruct y.nc -o image.nc --png image.png

    Example: shadowgram xray reconstruct codes_bin.mat y_target.mat --background y_empty.mat -o image.nc

    No parameter is to be chosen. The permutation test compares the codes with the same codes, shifted in time: if they explain
    the counts no better, the image shows noise or drift.

    The JSON has file, shape, shots, open (share of the cells), counts, background and image (mean counts a shot; the background
    as it is modelled), noise (mean standard deviation of a shot, as modelled), dispersion (its square over that of photons),
    chi_square (of the counts about the model), converged, test (p_value, least_p, explained, lags, drift_order, noise,
    significant; null if it cannot be made), verdict and seconds.
    """
    output.check_result(out, (".nc",), inputs=[codes, counts, background])
    if png is not None:
        output.check_output(png, (".png",), inputs=[codes, counts, background])
    from shadowgram.xray.capture_files import read_capture

    size = None if shape is None else parse_size("--shape", shape)
    scan = read_capture(codes, counts, background, shape=size, block=block).every(every)
    found = _reconstruct(scan, denoiser)
    text = output.configuration(context)
    _write(found, out, text)
    output.write_configuration(out, text)
    if png is not None:
        _plot(found, png, codes.name)
    output.report(_values(found, out), _lines(found, out), as_json)


def _reconstruct(scan: Capture, denoiser: DenoiserName | None) -> _Found:
    import numpy as np

    from shadowgram.xray.permutation import permutation_test
    from shadowgram.xray.reconstruction import reconstruct as reconstruct_image

    begun = time.monotonic()
    prior = ("ffdnet", "bm3d") if denoiser is None else denoiser.value
    with output.progress("reconstructing") as update:
        result = reconstruct_image(
            scan.codes,
            scan.counts,
            scan.background,
            denoiser=prior,
            callback=lambda iteration, _values: update(iteration, ""),
        )
        test, problem = None, ""
        try:
            test = permutation_test(scan.codes, scan.counts, scan.background)
        except ValueError as error:
            problem = str(error)
    light = np.tensordot(scan.codes, result.x, axes=2)
    return _Found(
        scan=scan,
        result=result,
        model=result.background + light,
        test=test,
        problem=problem,
        seconds=time.monotonic() - begun,
    )


def _write(found: _Found, out: Path, text: str) -> None:
    import xarray as xr

    from shadowgram import __version__
    from shadowgram.scenes.readers.native import write_dataset

    names = {
        "counts": (found.scan.counts, "counts with the target"),
        "model": (found.model, "what image and background make of them"),
        "background": (found.result.background, "modelled counts without the image"),
        "deviation": (found.result.deviation, "modelled standard deviation of the counts"),
    }
    variables = {name: (("shot",), values, {"long_name": said}) for name, (values, said) in names.items()}
    image = (("y", "x"), found.result.x, {"long_name": "counts per shot through each open cell"})
    attributes: dict[str, object] = {
        "kind": KIND, "verdict": found.verdict, "pedestal": found.result.pedestal, "chi_square": found.result.chi2,
        "configuration": text, "shadowgram_version": __version__,
    }  # fmt: skip
    if found.test is not None:
        attributes |= {"p_value": found.test.p_value, "explained": found.test.statistic}
    write_dataset(xr.Dataset({"image": image, **variables}, attrs=attributes), out)


def _plot(found: _Found, png: Path, name: str) -> None:
    from shadowgram.figures import style
    from shadowgram.figures.xray_reconstruct import Shown, reconstruction

    shown = Shown(
        title=f"{name}: {len(found.scan.counts)} shots",
        image=found.result.x,
        counts=found.scan.counts,
        model=found.model,
        background=found.result.background,
        verdict=found.verdict,
        trusted=None if found.test is None else found.test.significant,
    )
    output.write_bytes(png, style.png(reconstruction(shown)))


def _values(found: _Found, out: Path) -> dict[str, object]:
    test = found.test
    tested = None if test is None else {
        "p_value": test.p_value, "least_p": test.least_p, "explained": test.statistic, "lags": len(test.lags),
        "drift_order": test.drift_order, "noise": test.noise, "significant": test.significant,
    }  # fmt: skip
    result = found.result
    return {
        "file": out,
        "shape": list(result.x.shape),
        "shots": len(found.scan.counts),
        "open": float(found.scan.codes.mean()),
        "counts": float(found.scan.counts.mean()),
        "background": float(result.background.mean()),
        "image": float((found.model - result.background).mean()),
        "noise": float(result.deviation.mean()),
        "dispersion": result.dispersion,
        "chi_square": result.chi2,
        "converged": result.converged,
        "test": tested,
        "verdict": found.verdict,
        "seconds": found.seconds,
    }


def _lines(found: _Found, out: Path) -> list[str]:
    result, counts = found.result, found.scan.counts
    rows, columns = result.x.shape
    image = (found.model - result.background).mean()
    settled = "" if result.converged else "; the image has not settled"
    return [
        f"{rows} × {columns} pixels (y × x) from {len(counts)} shots, {100 * found.scan.codes.mean():.1f} % open",
        f"counts      {counts.mean():.6g} a shot: background {result.background.mean():.6g} (modelled), image {image:.6g}",
        f"noise       {result.deviation.mean():.4g} a shot, {result.dispersion:.3g} times the variance of photons",
        f"fit         χ² = {result.chi2:.3g} a shot{settled}",
        found.verdict,
        f"→ {out}, {output.duration(found.seconds)}",
    ]
