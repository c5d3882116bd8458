"""Our scanner beside the GATE simulations of the dissertation's author, on his data.

    python benchmarks/gate_agreement.py ../shared/data/cxbi --out docs/chapter-4

The folder holds gate/{1,10,50}/ (codes, counts of two targets and of air), gate/ground_truth_UD_square.mat, spec_120.txt and
UD1CM.stl, as published with Salazar, Liu, Arce, Opt. Express 30(9), 15211 (2022). Shots come from the linear route (the response
of every mask cell, then his codes), the air and Table 4.1 from direct runs with variance reduction, the truths from pencil beams.
Writes gate.md and gate.png.

Two things are not known. Where he put the letters: the place `LETTERS[None]` gives the best correlation with his pencil-beam truth,
and the others with his shots, some of which were taken elsewhere; counts hardly depend on it. And whether his physics list emitted
fluorescence: both are given. Everything else has the values of the scene cxbi-blocks.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from shadowgram import xray
from shadowgram.figures.style import CYCLE, MAP, new_figure, png, style
from shadowgram.xray._compile import compile_scene
from shadowgram.xray._solids import Mesh, Solid
from shadowgram.xray.montecarlo.response import Response, mask_response
from shadowgram.xray.montecarlo.run import batch_vector, run_setup
from shadowgram.xray.scene import Energies, Mask, Pattern, Scene, Source
from shadowgram.xray.simulation import prepare

TRANSMITTANCES = (1, 10, 50)
SHOT, VIEW, MARGIN = 256, 32, 8
LETTERS = {
    1: (-112.4, -65.1, 500.0),
    10: (-112.4, -65.1, 500.0),
    50: (-110.0, -62.5, 500.0),
    None: (-110.0, -62.5, 500.0),
}
"""mm, where the corner of his mesh is in his shots by transmittance, and in his truth."""
TABLE = {"UD": (1.3e3, 3.2e3, 1.27e4), "box": (1.4e3, 4.5e3, 1.9e4), "hand": (1.9e3, 8.7e3, 4e4)}
"""Table 4.1: mean counts of a shot at 1, 10 and 50 %."""


HEAD = """# The scanner beside GATE

Made by `python benchmarks/gate_agreement.py ../shared/data/cxbi --out docs/chapter-4`, from the data that the dissertation's author
published. The size of no count is fitted. Where his letters stood is not known and was found from his pictures and shots.
"Ours" leaves fluorescence out, "ours, fluorescence" has it, as nature does: its two
effects are that tungsten of mask and frame sends its K lines to the plates, and that iodine's K lines escape from them, which takes
pulses below the threshold of 10 keV. His counts of targets are nearer to those without it. The ceiling is the correlation that a
perfect model would have with counts as noisy as his. Why the air's counts differ is not settled: they depend on the shields around
the mask, of which little is known. Of his hand nothing is known; ours is a stylised one.

![Counts of a shot against ours, and maps of pencil beams](gate.png)
"""


@dataclass(frozen=True, kw_only=True)
class Effort:
    """How long to compute.

    Attributes
    ----------
    per_cell, per_pixel : histories for a cell of the response, for a pixel of a truth.
    direct : histories of a direct run.
    """

    per_cell: int
    per_pixel: int
    direct: int


QUICK = Effort(per_cell=400, per_pixel=100, direct=200_000)
FULL = Effort(per_cell=4000, per_pixel=1000, direct=8_000_000)


def load(data: Path, name: str, key: str) -> np.ndarray:
    """Counts of his shots, or one of his pictures."""
    return np.asarray(scipy.io.loadmat(data / "gate" / name)[key], float)


def strip(data: Path, transmittance: int) -> np.ndarray:
    """(row, column) of the whole mask, from the windows that it slides through."""
    windows = scipy.io.loadmat(data / "gate" / str(transmittance) / "code_it1.mat")["code_shift"][0]
    return np.concatenate([windows[0], *(window[:, -1:] for window in windows[1:])], axis=1)


def gate_scene(data: Path, target: str, transmittance: int, fluorescence: bool) -> Scene:
    """One of his scenes: his spectrum, his mask, and the target "box", "UD" (his mesh), "hand" or "air"."""
    scene = xray.shipped_scene("cxbi-hand" if target == "hand" else "cxbi-blocks")
    mask = scene.mask
    assert mask is not None
    source = {name: getattr(scene.source, name) for name in Source.model_fields if name != "spectrum"}
    plate = {name: getattr(mask, name) for name in Mask.model_fields if name != "pattern"}
    rows = tuple("".join(map(str, row)) for row in strip(data, transmittance))
    changes: dict[str, Any] = {
        "source": Source(**source, spectrum=Energies(file=str((data / "spec_120.txt").resolve()))),
        "mask": Mask(**plate, pattern=Pattern(rows=rows)),
        "fluorescence": fluorescence,
    }
    return (scene.without_targets() if target in ("air", "UD") else scene).model_copy(update=changes)


def with_letters(scene: Scene, data: Path, place: tuple[float, float, float]) -> Scene:
    """A scene with his mesh of the letters."""
    shape = Mesh(file=str((data / "UD1CM.stl").resolve()), translation=place)
    letters = Solid(name="UD", role="target", material="aluminum", shape=shape)
    return scene.model_copy(update={"solids": (*scene.solids, letters)})


def response(scene: Scene, effort: Effort) -> Response:
    """Response of the mask cells of a scene."""
    setup = prepare(compile_scene(scene, SHOT), variance_reduction=True)
    return mask_response(
        setup,
        solid=1,
        first_column=SHOT,
        columns=VIEW,
        margin=MARGIN,
        histories_per_cell=effort.per_cell,
        seed=1,
    )


def truth(scene: Scene, effort: Effort) -> np.ndarray:
    """(row, column) counts of 5000 photons in pencil beams 8.71 mm apart, as in section 4.5.7 and free of noise of that number."""
    setup = prepare(compile_scene(scene.model_copy(update={"mask": None, "shots": 1})), variance_reduction=True)
    image = np.zeros((VIEW, VIEW))
    for pixel in range(image.size):
        row, column = divmod(pixel, VIEW)
        at = np.array([(column - 15.5) * 8.71, -(row - 15.5) * 8.71, 250.0])
        beam = replace(setup, source=setup.source._replace(position=at, cosine=float(np.cos(np.radians(0.4)))))
        first = pixel * effort.per_pixel
        image[row, column] = batch_vector(beam, 2, first, first + effort.per_pixel)[0]
    return image * 5000 / effort.per_pixel


def direct(scene: Scene, effort: Effort) -> tuple[float, float]:
    """Mean counts of a shot and their standard error, over eight shots."""
    found = []
    for shot in range(32, 512, 64):
        setup = prepare(compile_scene(scene, shot), variance_reduction=True)
        run = run_setup(setup, histories=effort.direct // 8, seed=shot)
        found.append(run.tallies["all"].scaled(scene.photons_per_shot, "counts"))
    means, errors = np.array([one.mean for one in found]), np.array([one.standard_error for one in found])
    return float(means.mean()), float(np.hypot(np.sqrt((errors**2).mean() / 8), means.std(ddof=1) / np.sqrt(8)))


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Pearson's, of all values."""
    return float(np.corrcoef(a.ravel(), b.ravel())[0, 1])


def ceiling(ours: np.ndarray, noise: float) -> float:
    """The correlation that a perfect model would have with counts of this variance of noise."""
    return float(np.sqrt(ours.var() / (ours.var() + noise)))


def targets_table(data: Path, effort: Effort, curves: dict[Any, Any]) -> list[str]:
    """Target minus air, per shot."""
    lines = [
        "| target | transmittance | his mean | ours | ratio | ours, fluorescence | ratio | correlation per shot | ceiling |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for target in ("box", "UD"):
        for percent in TRANSMITTANCES:
            his = load(data, f"{percent}/y_{target}.mat", "y").ravel()
            air = load(data, f"{percent}/y_air.mat", "air").ravel()
            ours = []
            for fluorescence in (False, True):
                scene = gate_scene(data, target, percent, fluorescence)
                if target == "UD":
                    scene = with_letters(scene, data, LETTERS[percent])
                ours.append(response(scene, effort).shots(strip(data, percent))[0] * scene.photons_per_shot)
            shown = his - air
            curves[target, percent] = shown, ours[0]
            spread = float(np.sqrt((his.mean() + air.mean()) / his.size))
            lines.append(
                f"| {target} | {percent} % | {shown.mean():.0f} ± {spread:.0f} | {ours[0].mean():.0f} | "
                f"{ours[0].mean() / shown.mean():.3f} | {ours[1].mean():.0f} | {ours[1].mean() / shown.mean():.3f} | "
                f"{correlation(ours[0], shown):.3f} | {ceiling(ours[0], his.mean() + air.mean()):.3f} |"
            )
    return lines


def truth_table(data: Path, effort: Effort, pictures: dict[str, Any]) -> list[str]:
    """Pencil-beam maps."""
    lines = ["| target | correlation of the maps | ceiling | his mean count | ours |", "|---|---|---|---|---|"]
    for target, key in (("box", "square"), ("UD", "UD")):
        scene = gate_scene(data, target, 10, False)
        if target == "UD":
            scene = with_letters(scene, data, LETTERS[None])
        his, ours = load(data, "ground_truth_UD_square.mat", key), truth(scene, effort)
        pictures[target] = his, ours
        lines.append(
            f"| {target} | {correlation(his, ours):.4f} | {ceiling(ours, ours.mean()):.4f} | {his.mean():.1f} | {ours.mean():.1f} |"
        )
    return lines


def air_table(data: Path, effort: Effort) -> list[str]:
    """Air alone, and Table 4.1: counts with a target."""
    lines = [
        "| target | transmittance | his | ours | ratio | ours, fluorescence | ratio |",
        "|---|---|---|---|---|---|---|",
    ]
    for target in ("air", "UD", "box", "hand"):
        for place, percent in enumerate(TRANSMITTANCES):
            printed = TABLE[target][place] if target in TABLE else load(data, f"{percent}/y_air.mat", "air").mean()
            cells = []
            for fluorescence in (False, True):
                scene = gate_scene(data, target, percent, fluorescence)
                if target == "UD":
                    scene = with_letters(scene, data, LETTERS[percent])
                mean, error = direct(scene, effort)
                cells.append(f"{mean:.0f} ± {error:.0f} | {mean / printed:.2f}")
            lines.append(f"| {target} | {percent} % | {printed:.0f} | {' | '.join(cells)} |")
    return lines


def draw(path: Path, curves: dict[Any, Any], pictures: dict[str, Any]) -> None:
    """His counts against ours, and both maps of both targets."""
    with style():
        figure = new_figure(9.0, 5.6)
        axes = figure.subplots(2, 4, width_ratios=(1.25, 1, 1, 0.06))
        for row, (target, name) in enumerate((("box", "blocks"), ("UD", "letters"))):
            for percent, colour in zip(TRANSMITTANCES, CYCLE, strict=False):
                his, ours = curves[target, percent]
                axes[row, 0].plot(ours, his, ".", color=colour, markersize=2.5, label=f"{percent} %")
            ends = [50, max(ours.max(), his.max())]
            axes[row, 0].plot(ends, ends, color="0.4", linewidth=0.8)
            axes[row, 0].set(xscale="log", yscale="log", title=f"{name}, counts of a shot less air")
            axes[row, 0].set(xlabel="shadowgram, mean", ylabel="GATE, one run", xlim=ends, ylim=(20, 1.3 * his.max()))
            axes[row, 0].legend(title="transmittance", markerscale=3)
            his, ours = pictures[target]
            top = float(np.percentile(his, 99.5))
            for column, (image, title) in enumerate(((his, "GATE"), (ours, "shadowgram, no noise")), 1):
                shown = axes[row, column].imshow(
                    image, cmap=MAP, vmin=0, vmax=top, extent=(-139.4, 139.4, -139.4, 139.4)
                )
                axes[row, column].set(title=title, xlabel="x, mm", ylabel="y, mm" if column == 1 else "")
            figure.colorbar(shown, cax=axes[row, 3], label="counts of 5000 photons")
        path.write_bytes(png(figure, dpi=130))


def main() -> None:
    """Write gate.md and gate.png."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, default=Path())
    parser.add_argument("--quick", action="store_true", help="a few histories: numbers within some per cent")
    options = parser.parse_args()
    effort = QUICK if options.quick else FULL
    curves: dict[Any, Any] = {}
    pictures: dict[str, Any] = {}
    text = [HEAD, "## Counts of a shot, target minus air", "", *targets_table(options.data, effort, curves), ""]
    text += ["## Pencil-beam maps", "", *truth_table(options.data, effort, pictures), ""]
    text += ["## Air alone, and Table 4.1", "", *air_table(options.data, effort), ""]
    print("\n".join(text))
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "gate.md").write_text("\n".join(text))
    draw(options.out / "gate.png", curves, pictures)


if __name__ == "__main__":
    main()
