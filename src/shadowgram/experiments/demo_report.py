"""What the demo leaves behind: the report, a picture for a README, the cubes and the figures as JSON."""

from __future__ import annotations

import dataclasses
import json
import platform
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np

from shadowgram import __version__, scenes
from shadowgram._threads import thread_count
from shadowgram.figures import images, lines, overview, report, style
from shadowgram.figures.images import Point
from shadowgram.measurement import write_measurement
from shadowgram.scenes.colour import auto_exposure
from shadowgram.scenes.readers.atomic import replace_file

from .demo import FIRST, Case, Demo, Estimate, solvers

NOTES = {
    "SSCSI": "One mask between detector and spectral plane: each band sees the code one column further, a little out of step"
    " with the detector, hence the grey edges in what reaches it.",
    "CASSI": "The coded scene is dispersed over a wider detector, one pixel a band: all bands carry the same code.",
    "Colored CASSI, ideal": "Every element of the mask is a filter that may pass any set of bands (its colour tells which)."
    " Beyond what can be manufactured today.",
    "Colored CASSI, 4 filters": "Every element is a low-pass, high-pass, band-pass or band-stop filter.",
}


def write(demo: Demo, out: Path, command: str, step: Callable[[str], None]) -> list[Path]:
    """Write everything to the folder `out`, which exists.

    Parameters
    ----------
    demo : what was found.
    out : folder.
    command : that makes the same again, to be printed in the report.
    step : called with a few words before each part.

    Returns
    -------
    list of Path
        The files, the report first.
    """
    view = _View(demo)
    files = {"report.html": report.render(_report(view, command)).encode()}
    step("overview")
    with style.style():
        files["overview.png"] = style.png(_overview(view), dpi=150)
    results = {
        "program": "shadowgram",
        "version": __version__,
        "spec": dataclasses.asdict(demo.spec),
        "records": demo.records(),
    }
    files["results.json"] = (json.dumps(results, indent=2) + "\n").encode()
    for name, data in files.items():
        replace_file(out / name, [data])
    step("cubes")
    return [out / name for name in files] + _write_cubes(demo, out, json.dumps(results["spec"]))


def _write_cubes(demo: Demo, out: Path, configuration: str) -> list[Path]:
    paths = [out / "scene.nc"]
    scenes.write(demo.scene.assign_attrs(configuration=configuration), paths[0])
    for case in demo.cases:
        stem = case.name.lower().replace(",", "").replace(" ", "-")
        best = case.estimates[0]
        cube = scenes.as_datacube(best.x, demo.scene.wavelength.values, "chart")
        paths += [out / f"{stem}-shots.nc", out / f"{stem}.nc"]
        write_measurement(case.measurement, paths[-2], configuration=configuration)
        scenes.write(cube.assign_attrs(configuration=configuration, solver=best.solver), paths[-1])
    return paths


class _View:
    """The demo, seen through one exposure, one zoom and one pair of pixels."""

    def __init__(self, demo: Demo) -> None:
        self.demo = demo
        self.wavelengths = demo.scene.wavelength.values
        self.exposure = auto_exposure(demo.scene)
        self.truth = self.rgb(demo.scene.values)
        self.zoom = images.busiest(self.truth, demo.spec.size // 5)
        self.points = pick_points(demo.scene.values)

    def rgb(self, values: np.ndarray) -> np.ndarray:
        return scenes.to_rgb(values, self.exposure, wavelengths=self.wavelengths)

    def spectra(self, values: np.ndarray) -> dict[str, np.ndarray]:
        return {point.label: values[:, point.y, point.x] for point in self.points}

    def code(self, case: Case) -> np.ndarray:
        """First shot of a code, (y, x), or (y, x, 3): the colours that a white light has behind a colored one."""
        first = case.measurement.code[0]
        if first.ndim == 2:
            return first
        return scenes.to_rgb(first, 1.0, wavelengths=self.wavelengths, illuminant="equal-energy")


def pick_points(cube: np.ndarray) -> tuple[Point, Point]:
    """Two pixels in even places whose spectra are worth a look: T1 the most colourful, T2 the one nearest to a single line.

    Parameters
    ----------
    cube : (band, y, x).

    Examples
    --------
    >>> import numpy as np
    >>> from shadowgram.experiments.demo_report import pick_points
    >>> cube = np.ones((5, 40, 40)); cube[:2, :, 20:] = 0.2; cube[1:, 20:, :20] = 0
    >>> pick_points(cube)
    (Point(label='T1', y=1, x=21), Point(label='T2', y=21, x=1))
    """
    side = max(2, min(cube.shape[1:]) // 40)
    bands, ny, nx = cube.shape[0], cube.shape[1] // side, cube.shape[2] // side
    blocks = cube[:, : ny * side, : nx * side].reshape(bands, ny, side, nx, side)
    mean = blocks.mean(axis=(2, 4)).reshape(bands, -1)
    spread = blocks.std(axis=(2, 4)).mean(axis=0).ravel()
    bright = np.maximum(mean.mean(axis=0), 1e-12)
    # Uneven or dark places tell more about the pixels beside them.
    unfit = (spread > 0.05 * bright) | (mean.max(axis=0) < 0.3 * mean.max())
    peak = np.where(unfit, 0, mean.max(axis=0) / bright)
    line = np.argmax(peak)
    colourful = (mean / bright).std(axis=0)
    broad = np.argmax(np.where(unfit | (peak > 0.5 * peak[line]), 0, colourful))
    middles = [(int(place // nx * side + side // 2), int(place % nx * side + side // 2)) for place in (broad, line)]
    return Point("T1", *middles[0]), Point("T2", *middles[1])


def _overview(view: _View):
    case = view.demo.cases[0]
    best, shots = case.estimates[0], view.demo.spec.shots
    return overview.overview(
        scene=view.truth,
        code=case.measurement.code[0],
        snapshot=case.measurement.snapshots[0],
        reconstruction=view.rgb(best.x),
        titles=(
            f"Scene, {view.demo.spec.bands} bands",
            f"Coded aperture 1 of {shots}",
            f"Snapshot 1 of {shots}",
            f"Reconstruction, {best.quality.psnr:.1f} dB",
        ),
        zoom=view.zoom,
        points=view.points,
        wavelengths=view.wavelengths,
        truth=view.spectra(view.demo.scene.values),
        estimate=view.spectra(best.x),
    )


def _report(view: _View, command: str) -> report.Report:
    demo, spec = view.demo, view.demo.spec
    best = max(demo.cases, key=lambda case: case.estimates[0].quality.psnr)
    first = best.estimates[0]
    share = spec.shots / spec.bands
    return report.Report(
        title="Four coded-aperture cameras, one scene",
        lead=_lead(demo),
        facts=(
            (f"{spec.bands} × {spec.size} × {spec.size}", "voxels to find, bands × y × x"),
            (f"{spec.shots}", f"snapshots each: {100 * share:.3g} % as many numbers"),
            (f"{spec.snr_db:g} dB", "signal-to-noise ratio of the snapshots"),
            (f"{first.quality.psnr:.1f} dB", f"PSNR of the best, {best.name}"),
            (f"{first.seconds:.1f} s", f"to reconstruct it with {first.solver}, {_threads()}"),
        ),
        truth=view.truth,
        views=[_camera_view(view, case) for case in demo.cases],
        zoom=view.zoom,
        points=view.points,
        spectra=(_spectra(view, dark=False), _spectra(view, dark=True)),
        quality=_quality_table(demo),
        quality_note=QUALITY_NOTE,
        model_error=_model_table(demo),
        model_error_note=_model_error_note(demo),
        settings=_settings(demo),
        command=command,
    )


QUALITY_NOTE = (
    "PSNR and SSIM for a peak of 1; RMS is the mean over the pixels of the root-mean-square error over the bands; SAM the mean"
    " spectral angle. Bold: best of its column. The model that made the snapshots also reconstructs them, for all cameras alike:"
    " this “inverse crime” compares codes and solvers; what it hides is told below. Times are wall-clock, without compilation."
)


def _lead(demo: Demo) -> str:
    spec = demo.spec
    low, high = demo.cases[0].measurement.imager.wavelengths
    return (
        f"A generated scene of {spec.bands} spectral bands, {low:g} to {high:g} nm, is photographed {spec.shots} times by each"
        " of four simulated spectral cameras, every time through another coded aperture. From these"
        f" {spec.shots} grey snapshots the datacube is reconstructed: {spec.bands} images from {spec.shots}. The reconstruction"
        " knows the snapshots, the codes and the optics; the original only serves to judge it."
    )


def _model_error_note(demo: Demo) -> str:
    spec = demo.spec
    return (
        f"The same {demo.cases[0].name}, with the same code and noise. In the last three rows the snapshots come from a scene of"
        f" {spec.bands * spec.sub_bands} bands, each falling where its own wavelength falls, as light does; the reconstruction"
        f" has {spec.bands} bands and must represent the code within each by one pattern: its mean over the band (exact), or"
        " what is seen at the centre or at the lower edge of the band, as in the literature. Bold: best of these three; they"
        " are the figures to expect of a well calibrated camera. The CASSI figures above have no such check: their model moves"
        " light by whole pixels."
    )


def _camera_view(view: _View, case: Case) -> report.CameraView:
    best = case.estimates[0]
    error = np.sqrt(np.mean(np.square(best.x - view.demo.scene.values), axis=0))
    return report.CameraView(
        name=case.name,
        note=NOTES[case.name],
        score=f"{best.quality.psnr:.1f} dB · SSIM {best.quality.ssim:.3f}",
        code=view.code(case),
        snapshot=case.measurement.snapshots[0],
        reconstruction=view.rgb(best.x),
        error=error,
    )


def _spectra(view: _View, *, dark: bool):
    truth = view.demo.scene.values
    found = {case.name: case.estimates[0].x for case in view.demo.cases}
    quality = {name: 10 * np.log10(1 / np.mean(np.square(x - truth), axis=(1, 2))) for name, x in found.items()}
    with style.style(dark=dark):
        return lines.spectra(
            view.wavelengths, view.spectra(truth), {name: view.spectra(x) for name, x in found.items()}, quality
        )


FIGURES = ("PSNR (dB)", "RMS", "SSIM", "SAM (rad)")


def _figures(estimate: Estimate) -> tuple[str, ...]:
    q = estimate.quality
    return f"{q.psnr:.2f}", f"{q.rms:.4f}", f"{q.ssim:.4f}", f"{q.sam:.4f}"


def _quality_table(demo: Demo) -> report.Table:
    pairs = [(case.name, estimate) for case in demo.cases for estimate in case.estimates]
    rows = [
        (
            name,
            e.solver,
            *_figures(e),
            f"{e.seconds:.2f}",
            f"{e.iterations}" if e.converged else f"{e.iterations}, not converged",
        )
        for name, e in pairs
    ]
    columns = ("camera", "solver", *FIGURES, "time (s)", "iterations")
    return report.Table(columns=columns, rows=rows, texts=2, best=_best([e for _, e in pairs], offset=2))


def _model_table(demo: Demo) -> report.Table:
    names = {"exact": "exact", "centre": "centre of the band", "edge": "lower edge of the band"}
    same = demo.cases[0].estimates[0]
    rows = [("same model, exact", "inverse crime", *_figures(same))]
    rows += [(names[shear], "fine bands", *_figures(e)) for shear, e in demo.model_errors.items()]
    best = frozenset((row + 1, column) for row, column in _best(list(demo.model_errors.values()), offset=2))
    return report.Table(
        columns=("model of the code in a band", "measured with", *FIGURES), rows=rows, texts=2, best=best
    )


def _best(estimates: Sequence[Estimate], offset: int) -> frozenset[tuple[int, int]]:
    """Cells of the best PSNR, RMS, SSIM and SAM."""
    signs = {"psnr": 1, "rms": -1, "ssim": 1, "sam": -1}
    return frozenset(
        (max(range(len(estimates)), key=lambda row: sign * getattr(estimates[row].quality, name)), offset + column)
        for column, (name, sign) in enumerate(signs.items())
    )


def _settings(demo: Demo) -> list[tuple[str, str]]:
    spec = demo.spec
    s = demo.cases[0].measurement.imager
    used = [f"{label}: {_parameters(solver)}" for label, solver in solvers(FIRST).items()]
    software = ", ".join(f"{name} {version(name)}" for name in ("numpy", "numba", "scipy"))
    return [
        ("Scene", f"shadowgram.scenes.chart(size={spec.size}, bands={spec.bands}, seed={spec.seed})"),
        ("SSCSI", _parameters(s)),
        ("CASSI, colored", _parameters(demo.cases[1].measurement.imager)),
        ("Codes", f"{spec.shots} shots; SSCSI and CASSI share one complementary code; seed {spec.seed}"),
        ("Noise", f"white Gaussian, {spec.snr_db:g} dB, seed {spec.seed}"),
        *[("Solver", text) for text in used],
        ("Software", f"shadowgram {__version__}, Python {platform.python_version()}, {software}"),
        ("Whole demo", f"{demo.seconds:.1f} s, {_threads()}; compiling, which only a first run needs, included"),
    ]


def _parameters(value: object) -> str:
    fields = dataclasses.asdict(value)  # type: ignore[call-overload]  # every caller gives a dataclass
    return ", ".join(f"{name} = {field}" for name, field in fields.items() if field is not None)


def _threads() -> str:
    count = thread_count()
    return "1 thread" if count == 1 else f"{count} threads"
