"""Table 4.2: photons and dose in a pixel in one shot, over the pitch of the mask; and what made the source's dose fall with it.

The source gives 401, 1480, 5286 and 23187 photons and 30.9, 10.9, 7.1 and 4.4 nGy for pitches of 0.5, 1, 2 and 4 mm. Photons
per area do not depend on the pitch, so by (4.15) neither should the dose. Here it is computed from the geometry and the
spectrum, for the same field with masks 2 mm thick, and beside it stands what the Monte Carlo deposits in a layer of muscle
behind such masks. With ``--data`` the author's own photons for 2 mm are weighed as well; they are not shipped.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from shadowgram.experiments import data_folder
from shadowgram.experiments.source import SceneSource
from shadowgram.experiments.study import Claim, Record, Result, Study

from . import _common as common
from .cxbi_laboratory import ORIGIN

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from shadowgram.figures.sheet import Curves
    from shadowgram.xray.scene import Scene

STATED = {0.5: (30.9, 401, 0.05), 1.0: (10.9, 1480, 0.19), 2.0: (7.1, 5286, 0.75), 4.0: (4.4, 23187, 3.0)}
"""Pitch in mm → dose in nGy, photons and area in cm², as the table has them."""
SCENE = "cxbi-blocks"
FIELD = 64.0  # mm of the mask in view
TRANSMITTANCE = 0.1
LAYER, BODY = 1.0, 150.0  # mm of muscle
FORMULA, SIMULATED, PHOTONS = "formula", "simulated", "photons"
DIGEST, TABLE_DIGEST = "78da6d2e1a56bd23", "1af4860f5776e7ac"
SOFT = 10.0
"""keV, the least energy that the source's detectors count."""
NEAR = 0.1
"""Relative difference up to which numbers are taken for the same."""
BINS = np.concatenate([[0.0], np.geomspace(1, 125, 50)])  # keV


@dataclass(frozen=True, slots=True, kw_only=True)
class Spec:
    """A pitch in mm; by the formula, by the Monte Carlo behind a layer or a body, or of the author's photons."""

    what: str
    pitch: float
    thickness: float = 0.0
    histories: int = 0


def specs(_scene: SceneSource, quick: bool) -> list[Spec]:
    """All pitches; the author's photons only if the folder of the data was named."""
    histories = 200_000 if quick else 16_000_000
    simulated = [(2.0, LAYER)] if quick else [*((pitch, LAYER) for pitch in STATED), (2.0, BODY)]
    named = bool(os.environ.get(data_folder.VARIABLE))
    return [
        *(Spec(what=FORMULA, pitch=pitch) for pitch in STATED),
        *(
            Spec(what=SIMULATED, pitch=pitch, thickness=thickness, histories=histories)
            for pitch, thickness in simulated
        ),
        *([Spec(what=PHOTONS, pitch=2.0)] if named else []),
    ]


def with_pitch(pitch: float) -> Scene:
    """The scanner with a mask of another pitch and the same field, a tenth of its cells open at random."""
    from shadowgram.xray.scan import with_transmittance
    from shadowgram.xray.scene import shipped_scene

    scene = shipped_scene(SCENE)
    assert scene.mask is not None
    rows = round(FIELD / pitch)
    mask = scene.mask.model_copy(update={"pitch": pitch, "rows": rows, "columns": 2 * rows, "view": rows})
    return with_transmittance(scene.model_copy(update={"mask": mask, "shots": 1 + rows}), TRANSMITTANCE)


def before_muscle(scene: Scene, thickness: float) -> Scene:
    """The scene with a layer of muscle of 1 mm in place of its target, and more of it behind for a body."""
    from shadowgram.xray.scene import parse_scene

    layers = [("skin", 500.0, LAYER)] + ([("body", 500.0 + LAYER, thickness - LAYER)] if thickness > LAYER else [])
    solids = "".join(
        f'\n[[solids]]\nname = "{name}"\nrole = "target"\nmaterial = "skeletal muscle"\n'
        f'shape = {{ kind = "box", centre = [0, 0, {front + depth / 2}], size = [320, 320, {depth}] }}\n'
        for name, front, depth in layers
    )
    return parse_scene(scene.without_targets().toml() + solids)


def run(spec: Spec, _scene: SceneSource) -> Result:
    """Dose of a cell and of a shot."""
    if spec.what == FORMULA:
        return _formula(spec.pitch)
    return _simulated(spec) if spec.what == SIMULATED else _photons()


def _formula(pitch: float) -> Result:
    import shadowgram as sg

    scene = with_pitch(pitch)
    found = sg.xray.scan_dose(scene)
    middle = found.pixel.shape[0] // 2
    inner = (slice(middle - 1, middle + 1),) * 2
    spectrum = scene.source.spectrum.spectrum()
    return Result(
        values={
            "photons": float(found.photons.mean()), "axis_photons": float(found.photons[inner].mean()),
            "area": float(found.area.mean()), "dose": float(found.pixel.mean()), "axis_dose": float(found.pixel[inner].mean()),
            "edge_dose": float(found.pixel[0, 0]),
            "soft": float(spectrum.weight[spectrum.energy < SOFT].sum() / spectrum.total),
        },
        arrays={"energy": spectrum.energy.astype(np.float32), "weight": (spectrum.weight / spectrum.total).astype(np.float32)},
    )  # fmt: skip


def _simulated(spec: Spec) -> Result:
    """Mean dose in the first millimetre by the Monte Carlo, and by the formula, over the whole layer."""
    import shadowgram as sg

    scene = before_muscle(with_pitch(spec.pitch), spec.thickness)
    shot = scene.shots // 2
    dose = sg.xray.simulate(scene, histories=spec.histories, seed=1, shot=shot).tallies["dose/skin"]
    scaled = dose.scaled(scene.photons_per_shot, "Gy")
    found = sg.xray.scan_dose(scene)
    assert scene.mask is not None
    code = scene.mask.cells()[:, shot : shot + found.pixel.shape[1]]
    # The layer is larger than the field, and what a cell gives is spread over all of it.
    by_formula = float((code * found.pixel * found.area).sum()) / 32.0**2
    return Result(values={"dose": float(scaled.mean), "error": float(scaled.standard_error), "formula": by_formula})


def _photons() -> Result:
    """The author's photons through a pixel of 2 mm."""
    from scipy.io import loadmat

    from shadowgram.xray import material
    from shadowgram.xray.dose import JOULES, TISSUE

    energy = 1000 * loadmat(data_folder.find("cxbi/dose/2mm.mat", DIGEST, ORIGIN))["data"].ravel().astype(float)
    dose = 1000 * JOULES * energy * material(TISSUE).mass_energy_absorption(energy) / STATED[2.0][2]
    table = loadmat(data_folder.find("cxbi/dose/mus_skel.mat", TABLE_DIGEST, ORIGIN))["muscle_skel"]
    straight = np.interp(energy, 1000 * table[:, 0], table[:, 2])
    soft = energy < SOFT
    # How far photons get in the air of the scene, as the source has it.
    air = with_pitch(2.0).world.material.material().attenuation(energy[soft])
    return Result(
        values={
            "count": int(energy.size), "dose": float(dose.sum()), "soft_count": int(soft.sum()),
            "soft_dose": float(dose[soft].sum()),
            "straight": float((1000 * JOULES * energy * straight).sum() / STATED[2.0][2]), "least": float(energy.min()),
            "reach": float(np.median(1 / air)), "expected": float(np.exp(-500 * air).mean()),
        },
        arrays={
            "counts": np.histogram(energy, BINS)[0].astype(np.float32),
            "share": (np.histogram(energy, BINS, weights=dose)[0] / dose.sum()).astype(np.float32),
        },
    )  # fmt: skip


def figure(records: Sequence[Record]) -> Figure:
    """Photons, dose and dose times area over the pitch; with the author's photons, their energies too."""
    from shadowgram.figures.sheet import sheet

    own = common.chosen(records, what=FORMULA)
    rows = [[_over_pitch(own), _dose(records)], [_excess(own), *_spectra(records)]]
    return sheet("A pixel in one shot, over the pitch of the mask (Table 4.2)", rows)


def _over_pitch(own: Sequence[Record]) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    x = [r.spec["pitch"] for r in own]
    return Curves(
        title="photons in a pixel", xlabel="pitch (mm)", ylabel="photons in a shot", log="y",
        curves={
            "source": Curve(x=x, y=[STATED[p][1] for p in x], reference=True),
            "on the axis": Curve(x=x, y=[r.values["axis_photons"] for r in own], colour=0),
            "mean over the field": Curve(x=x, y=[r.values["photons"] for r in own], colour=1),
        },
    )  # fmt: skip


def _dose(records: Sequence[Record]) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    own, made = common.chosen(records, what=FORMULA), _layers(records)
    x = [r.spec["pitch"] for r in own]
    curves = {
        "source": Curve(x=x, y=[STATED[p][0] for p in x], reference=True),
        "on the axis": Curve(x=x, y=[1e9 * r.values["axis_dose"] for r in own], colour=0),
        "mean over the field": Curve(x=x, y=[1e9 * r.values["dose"] for r in own], colour=1),
    }
    scale = [1e9 * common.only(own, pitch=r.spec["pitch"]).values["dose"] / r.values["formula"] for r in made]
    curves["the same by Monte Carlo, 1 mm of muscle"] = Curve(
        x=[r.spec["pitch"] for r in made], y=[s * r.values["dose"] for s, r in zip(scale, made, strict=True)],
        spread=[s * r.values["error"] for s, r in zip(scale, made, strict=True)], colour=2,
    )  # fmt: skip
    return Curves(
        title="dose of a pixel",
        xlabel="pitch (mm)",
        ylabel="nGy in a shot",
        log="y",
        curves=curves,
        bottom=0.8,
        top=100,
    )


def _layers(records: Sequence[Record]) -> list[Record]:
    return common.chosen(records, what=SIMULATED, thickness=LAYER)


def excess(own: Sequence[Record]) -> list[float]:
    """nGy cm² of the source's dose times area beyond what its photons give with our spectrum, for each pitch."""
    found = []
    for record in own:
        dose, photons, area = STATED[record.spec["pitch"]]
        found.append(dose * area - photons * _per_photon(record))
    return found


def _per_photon(record: Record) -> float:
    """nGy cm² of a photon of our spectrum."""
    return 1e9 * record.values["dose"] * record.values["area"] / record.values["photons"]


def _excess(own: Sequence[Record]) -> Curves:
    from shadowgram.figures.sheet import Curve, Curves

    x = [r.spec["pitch"] for r in own]
    return Curves(
        title="dose times area, what the photons impart", xlabel="pitch (mm)", ylabel="nGy cm²", log="y",
        curves={
            "source": Curve(x=x, y=[STATED[p][0] * STATED[p][2] for p in x], reference=True),
            "its photons with our spectrum": Curve(x=x, y=[STATED[r.spec["pitch"]][1] * _per_photon(r) for r in own]),
            "difference": Curve(x=x, y=np.maximum(excess(own), 1e-3), colour=3, dash=1),
        },
        bottom=0.1, top=100,
    )  # fmt: skip


def _spectra(records: Sequence[Record]) -> list[Curves]:
    from shadowgram.figures.sheet import Curve, Curves

    found = common.chosen(records, what=PHOTONS)
    if not found:
        return []
    record, middle = found[0], np.sqrt(np.maximum(BINS[1:-1] * BINS[2:], 1e-3))
    kept = slice(1, None)
    total, share = record.arrays["counts"].sum(), record.arrays["share"]
    return [
        Curves(
            title="the author's photons, 2 mm", xlabel="energy (keV)", ylabel="% in a bin", log="x", bottom=0,
            curves={
                "of the photons": Curve(x=middle, y=100 * record.arrays["counts"][kept] / total, colour=0, dash=4),
                "of the dose": Curve(x=middle, y=100 * share[kept], colour=1, dash=5),
            },
            marks={SOFT: "10 keV"},
        )
    ]  # fmt: skip


def claims(records: Sequence[Record]) -> list[Claim]:
    """The three columns, what the dose of the source is made of, and the Monte Carlo beside the formula."""
    own = common.chosen(records, what=FORMULA)
    return [
        _count(own), _areas(own), _doses(own), _reading(own),
        *(_his_photons(r, own[0]) for r in common.chosen(records, what=PHOTONS)), _checked(records),
    ]  # fmt: skip


def _count(own: Sequence[Record]) -> Claim:
    parts, apart = [], []
    for record in own:
        pitch, v = record.spec["pitch"], record.values
        stated = STATED[pitch][1]
        apart.append(v["axis_photons"] / stated - 1)
        parts.append(
            f"{pitch:g} mm: {v['axis_photons']:.0f} on the axis and {v['photons']:.0f} in the mean over the field, beside {stated}"
            f" ({100 * apart[-1]:+.0f} % on the axis)"
        )
    agrees = all(abs(one) <= NEAR for one in apart)
    return Claim(
        page=83, says="401, 1480, 5286 and 23187 photons arrive at a pixel for pitches of 0.5, 1, 2 and 4 mm",
        found="; ".join(parts), agrees=agrees,
        why="" if agrees else "a pixel's photons go with the square of the pitch, 4 times as many at twice the pitch; the"
        " source's go by 3.7, 3.6 and 4.4. The author's file for 2 mm has 5826 photons, so that 5286 has two digits exchanged:"
        " with it the steps are 3.7, 3.9 and 4.0. Towards the edge the walls of narrow holes 2 mm deep cut most of the light off",
    )  # fmt: skip


def _areas(own: Sequence[Record]) -> Claim:
    pairs = [(r.spec["pitch"], r.values["area"], STATED[r.spec["pitch"]][2]) for r in own]
    agrees = all(abs(area / stated - 1) <= NEAR for _, area, stated in pairs)
    return Claim(
        page=83, says="such a pixel has 0.05, 0.19, 0.75 and 3 cm² on the body",
        found=", ".join(f"{pitch:g} mm: {area:.3f} cm²" for pitch, area, _ in pairs), agrees=agrees,
        why="" if agrees else "the distances of the scene give other areas",
    )  # fmt: skip


def _doses(own: Sequence[Record]) -> Claim:
    parts, apart = [], []
    for record in own:
        pitch, v = record.spec["pitch"], record.values
        apart.append(1e9 * v["axis_dose"] / STATED[pitch][0] - 1)
        parts.append(
            f"{pitch:g} mm: {1e9 * v['axis_dose']:.2f} on the axis, {1e9 * v['dose']:.2f} in the mean, {1e9 * v['edge_dose']:.2f}"
            f" in a corner, beside {STATED[pitch][0]:g}"
        )
    agrees = all(abs(one) <= NEAR for one in apart)
    return Claim(
        page=83, says="one shot gives a pixel 30.9, 10.9, 7.1 and 4.4 nGy for pitches of 0.5, 1, 2 and 4 mm",
        found=f"nGy: {'; '.join(parts)}", agrees=agrees,
        why="" if agrees else "the photons on each cm² are the same for all pitches, and so is their dose on the axis; the"
        f" source's own photons per area differ by {_per_area()} only, while its dose falls sevenfold",
    )  # fmt: skip


def _per_area() -> str:
    """How far the source's photons per area are apart."""
    found = [photons / area for _, photons, area in STATED.values()]
    return f"a factor of {max(found) / min(found):.2f}"


def _reading(own: Sequence[Record]) -> Claim:
    shares = [photons * _per_photon(r) for r in own for photons in (STATED[r.spec["pitch"]][1],)]
    parts = [
        f"{r.spec['pitch']:g} mm: {e + s:.2f}, of which its photons with our spectrum give {s:.2f} and {e:.2f} are left"
        for r, e, s in zip(own, excess(own), shares, strict=True)
    ]
    return Claim(
        page=None, says="what makes the source's dose fall with the pitch?",
        found=f"its dose times area, nGy cm²: {'; '.join(parts)}. What is left is between"
        f" {min(excess(own)):.1f} and {max(excess(own)):.1f} while the photons grow {STATED[4.0][1] / STATED[0.5][1]:.0f}-fold,"
        " as if it did not come through the hole: a few very soft photons at any pitch, divided by the area. This is a reading of"
        " the numbers; only the photons for 2 mm are known",
        agrees=None,
    )  # fmt: skip


def _his_photons(record: Record, ours: Record) -> Claim:
    v = record.values
    return Claim(
        page=None, says="what are the author's own photons for 2 mm?",
        found=f"{v['count']} photons give {1e9 * v['dose']:.2f} nGy ({1e9 * v['straight']:.2f} with his table joined by straight"
        f" lines); {v['soft_count']} of them have {v['least']:.1f} to {SOFT:g} keV and give"
        f" {100 * v['soft_dose'] / v['dose']:.0f} % of it,"
        f" so that {1e9 * (v['dose'] - v['soft_dose']):.2f} nGy are left without them. Half of these get no further than"
        f" {v['reach']:.0f} mm in air, and {100 * v['expected']:.0f} % of such would cross the 50 cm to the body. The tube's"
        f" spectrum has {v['count'] * ours.values['soft']:.2g} in {v['count']} photons: so these were born close by"
        " and are not light of the source",
        agrees=None,
    )  # fmt: skip


def _checked(records: Sequence[Record]) -> Claim:
    parts = []
    for record in _layers(records):
        v = record.values
        parts.append(f"{record.spec['pitch']:g} mm: {v['dose'] / v['formula']:.3f} ± {v['error'] / v['formula']:.3f}")
    found = f"Monte Carlo over formula, which takes closed cells as opaque, in 1 mm of muscle, all of the field: {', '.join(parts)}"
    for record in common.chosen(records, what=SIMULATED, thickness=BODY):
        v = record.values
        found += (
            f"; with {BODY / 10:g} cm of muscle in all, whose scatter comes back into the first millimetre:"
            f" {v['dose'] / v['formula']:.2f} ± {v['error'] / v['formula']:.2f}"
        )
    return Claim(
        page=None, says="is the dose of (4.15) what photons deposit behind the mask?", found=found, agrees=None
    )


STUDY = Study(
    name="table-4-2",
    title="Photons and dose of a pixel over the pitch",
    source="Table 4.2 and eq. (4.15), pages 82 and 83",
    revision=1,
    specs=specs,
    run=run,
    figure=figure,
    claims=claims,
)
