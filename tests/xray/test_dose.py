"""Doses against sums by hand, the source's own numbers, and photons that are followed."""

import numpy as np
import pytest
import scipy.io

import shadowgram as sg
from shadowgram.xray.dose import COMMERCIAL
from shadowgram.xray.scan import with_transmittance
from shadowgram.xray.scene import Box, Solid

JOULES = 1.602176634e-16


def spectrum_of(energies):
    energy, count = np.unique(energies, return_counts=True)
    return sg.xray.Spectrum(energy=energy, weight=count.astype(float))


@pytest.fixture
def blocks():
    return sg.xray.shipped_scene("cxbi-blocks")


@pytest.fixture
def source_photons(data):
    """keV of what the source counted on a pixel of 0.75 cm² in a shot, and its muscle table."""
    folder = data / "cxbi" / "dose"
    energies, table = (
        next(value for key, value in scipy.io.loadmat(folder / name).items() if not key.startswith("_"))
        for name in ("2mm.mat", "mus_skel.mat")
    )
    return 1000 * energies.ravel(), table


def test_a_line_by_hand():
    # NIST: skeletal muscle at 60 keV has 0.03258 cm²/g.
    wanted = 1000 * 60 * JOULES * 0.03258 * 1e6 / 2.0
    assert sg.xray.absorbed_dose(sg.xray.mono(60), 2.0, photons=1e6) == pytest.approx(wanted, rel=0.01)


def test_photons_and_area_scale():
    tube = sg.xray.shipped_tube()
    one = sg.xray.absorbed_dose(tube, 1.0, photons=1.0)
    assert sg.xray.absorbed_dose(tube, 0.5, photons=10.0) == pytest.approx(20 * one)
    assert sg.xray.absorbed_dose(tube, 1.0) == pytest.approx(one * tube.total)
    assert sg.xray.absorbed_dose(tube, 1.0, photons=1.0, tissue="bone, cortical (ICRP)") > 2 * one


def test_our_coefficients_are_those_of_the_source(source_photons):
    _, table = source_photons
    energy = 1000 * table[:, 0]
    kept = (energy >= 10) & (energy <= 150)
    ours = sg.xray.material("skeletal muscle").mass_energy_absorption(energy[kept])
    assert np.abs(ours / table[kept, 2] - 1).max() < 0.01


def test_the_source_s_dose_of_a_pixel(source_photons):
    """Table 4.2 has 7.1 nGy for 2 mm: its photons, its table with straight lines between the points, and 0.75 cm²."""
    energies, table = source_photons
    assert energies.size == 5826  # 5286 in print
    straight = np.interp(energies / 1000, table[:, 0], table[:, 2])
    assert 1e12 * (energies * JOULES * straight).sum() / 0.75 == pytest.approx(7.1, abs=0.05)
    ours = 1e9 * sg.xray.absorbed_dose(spectrum_of(energies), 0.75)
    assert ours == pytest.approx(6.67, abs=0.02)
    # Thirty photons below the spectrum's lower end, which cannot come through the air, make up half of it.
    hard = energies[energies >= 10]
    assert energies.size - hard.size == 30
    assert 1e9 * sg.xray.absorbed_dose(spectrum_of(hard), 0.75) == pytest.approx(3.50, abs=0.01)


def test_the_photons_of_a_cell_on_the_axis(blocks):
    found = sg.xray.scan_dose(blocks, transmittance=0.1)
    # 10⁷ photons in the cone; a hole of 2 mm, 149 mm away; 650 mm of air.
    tube = sg.xray.shipped_tube()
    air = blocks.world.material.material()
    through = tube.filtered(air, 650.0).total / tube.total
    wanted = 1e7 * (2 / 149) ** 2 / blocks.source.solid_angle * through
    axis = found.photons[15:17, 15:17].mean()
    assert axis == pytest.approx(wanted, rel=0.03)
    assert found.area.mean() == pytest.approx((650 / 149 * 0.2) ** 2, rel=1e-9)
    assert found.photons.max() < wanted
    assert found.photons[0, 0] < 0.7 * axis


def test_a_scan_adds_up(blocks):
    found = sg.xray.scan_dose(blocks, shots=128, transmittance=0.1)
    assert found.pixel.shape == (32, 32)
    assert found.shot == pytest.approx(0.1 * found.pixel.mean())
    assert found.scan == pytest.approx(128 * found.shot)
    assert found.share_of_limit == pytest.approx(found.scan / COMMERCIAL[0])
    assert sg.xray.scan_dose(blocks).transmittance == pytest.approx(blocks.mask.cells().mean())
    assert sg.xray.scan_dose(blocks).shots == 512


def test_the_dose_does_not_depend_on_the_pitch(blocks):
    """The fluence is the source's; holes as deep as wide weaken it alike."""
    doses = []
    for pitch in (0.5, 1.0, 2.0, 4.0):
        cells = round(64 / pitch)
        mask = blocks.mask.model_copy(
            update={"pitch": pitch, "depth": pitch, "rows": cells, "columns": cells, "view": None}
        )
        scene = blocks.model_copy(update={"mask": mask, "shots": 1})
        doses.append(sg.xray.scan_dose(scene, transmittance=0.1).pixel.mean())
    assert np.ptp(doses) < 0.01 * max(doses)


def test_photons_that_are_followed_give_the_same(blocks):
    """A sheet of muscle of 2 mm in the whole field, half of the mask open."""
    scene = with_transmittance(blocks, 0.5)
    sheet = Solid(
        name="skin", role="target", material="skeletal muscle", shape=Box(centre=(0, 0, 501), size=(277.4, 277.4, 2))
    )
    shields = tuple(solid for solid in scene.solids if solid.role == "shield")
    scene = scene.model_copy(update={"solids": (*shields, sheet)})
    run = sg.xray.simulate(scene, histories=150_000, seed=3, shot=256)
    followed = run.tallies["dose/skin"].scaled(scene.photons_per_shot, "Gy")
    ours = sg.xray.scan_dose(scene).shot
    assert followed.relative_error < 0.08
    # 2 % for what the sheet takes from itself and gives back.
    assert abs(followed.mean - ours) < 3 * followed.standard_error + 0.02 * ours


BAD = [
    ({"area": 0.0}, "area"),
    ({"area": float("nan")}, "area"),
    ({"area": 1.0, "photons": -1}, "photons"),
    ({"area": 1.0, "tissue": "unobtainium"}, "unobtainium"),
]


@pytest.mark.parametrize(("options", "message"), BAD)
def test_bad_numbers_are_one_clear_line(options, message):
    with pytest.raises(ValueError, match=message):
        sg.xray.absorbed_dose(sg.xray.mono(60), **options)


def test_scenes_without_a_dose_are_refused(blocks):
    for changed, message in (
        ({"mask": None, "shots": 1}, "mask"),
        ({"solids": ()}, 'role = "target"'),
        ({"source": blocks.source.model_copy(update={"direction": (1.0, 0.0, 0.0)})}, "direction"),
        ({"source": blocks.source.model_copy(update={"half_angle": 0.0})}, "pencil"),
    ):
        with pytest.raises(ValueError, match=message):
            sg.xray.scan_dose(blocks.model_copy(update=changed))
    for transmittance in (0.0, 1.5, float("nan")):
        with pytest.raises(ValueError, match="transmittance"):
            sg.xray.scan_dose(blocks, transmittance=transmittance)
    with pytest.raises(ValueError, match="shots"):
        sg.xray.scan_dose(blocks, shots=0)


def test_contrast_and_its_error():
    rng = np.random.default_rng(0)
    gun = np.zeros((22, 22), bool)
    gun[8:12, 5:15] = True
    mean = np.where(gun, 60.0, 100.0)
    found = [sg.metrics.contrast(rng.poisson(mean), gun, ~gun) for _ in range(400)]
    assert np.mean(found) == pytest.approx(0.4, abs=0.003)
    assert np.std(found) == pytest.approx(sg.metrics.contrast_error(mean, gun, ~gun), rel=0.15)
    assert sg.metrics.contrast(np.where(gun, 150.0, 100.0), gun, ~gun) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("image", "target", "background", "message"),
    [
        (np.ones((4, 4)), np.ones((4, 4), bool), np.ones((4, 4), bool), "share"),
        (np.ones((4, 4)), np.zeros((4, 4), bool), np.ones((4, 4), bool), "at least a pixel"),
        (np.ones((4, 4)), np.eye(4), np.eye(4) < 1, "True and False"),
        (np.ones((4, 5)), np.eye(4) > 0, np.eye(4) < 1, "masks of its shape"),
        (np.eye(4), np.eye(4) > 0, np.eye(4) < 1, "positive"),
        (np.full((4, 4), np.nan), np.eye(4) > 0, np.eye(4) < 1, "finite"),
    ],
)
def test_bad_regions_are_one_clear_line(image, target, background, message):
    with pytest.raises(ValueError, match=message):
        sg.metrics.contrast(image, target, background)


def test_negative_counts_have_no_poisson_error():
    image = np.array([[-1.0, 5.0]])
    with pytest.raises(ValueError, match="negative"):
        sg.metrics.contrast_error(image, image < 0, image > 0)
