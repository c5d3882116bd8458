"""Absorbed dose: of given photons, and of the scan of a scene; per cell, per shot and in all.

The dose is that of photons as they arrive, in a tissue thin enough not to weaken them: energy fluence times the mass
energy-absorption coefficient. It is the dose at the skin, without what the body scatters back there, and the most that any part of
the body gets from the beam directly.

Source: Salazar (2022), eq. (4.15) and section 4.7, for skeletal muscle (ICRU report 44).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ._mask_rays import share_of_source, through_cells
from .materials import Material, material

if TYPE_CHECKING:
    from .scene import Mask, Scene
    from .spectra import Spectrum

Floats = NDArray[np.float64]

JOULES = 1.602176634e-16
"""In a keV."""
COMMERCIAL = (0.07e-6, 0.1e-6)
"""Sv of one inspection with commercial scanners (Salazar 2022, section 4.7). A gray of X-rays to the whole body is a sievert."""
TISSUE = "skeletal muscle"


def absorbed_dose(spectrum: Spectrum, area: float, *, photons: float | None = None, tissue: str = TISSUE) -> float:
    """Dose of photons that arrive evenly on an area.

    Parameters
    ----------
    spectrum : of the photons as they arrive.
    area : cm², across their direction.
    photons : how many; by default the spectrum's weights are numbers of photons.
    tissue : a name that `shadowgram.xray.material` knows.

    Returns
    -------
    float
        Gy.

    Raises
    ------
    ValueError
        If the area is not positive, the number of photons is negative, or the tissue is not known.

    Notes
    -----
    Source: Salazar (2022), eq. (4.15), Σ_E E N_E (μ_en/ρ)(E) / area.

    Examples
    --------
    >>> from shadowgram.xray import absorbed_dose, mono
    >>> f"{1e9 * absorbed_dose(mono(60), 0.75, photons=5286):.2f} nGy"
    '2.21 nGy'
    """
    if not (math.isfinite(area) and area > 0):
        raise ValueError(f"the area must be positive, in cm², got {area!r}")
    if photons is not None and not (math.isfinite(photons) and photons >= 0):
        raise ValueError(f"the number of photons must be 0 or more, got {photons!r}")
    scale = 1.0 if photons is None else photons / spectrum.total
    return scale * float(_dose_of_fluence(spectrum.energy, material(tissue)) @ spectrum.weight) / area


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanDose:
    """Dose at the front of the target.

    Attributes
    ----------
    photons : (y, x) that arrive through an open cell of the mask in one shot.
    area : (y, x) cm² that a cell lights there, parallel to the mask.
    pixel : (y, x) Gy in one shot, where the cell is open.
    transmittance : share of the cells that are open.
    shots : of the scan.
    tissue : in which the dose is.
    """

    photons: Floats
    area: Floats
    pixel: Floats
    transmittance: float
    shots: int
    tissue: str

    @property
    def shot(self) -> float:
        """Gy of one shot, the mean over the field."""
        return self.transmittance * float(np.average(self.pixel, weights=self.area))

    @property
    def scan(self) -> float:
        """Gy of all shots, the mean over the field."""
        return self.shots * self.shot

    @property
    def share_of_limit(self) -> float:
        """The dose of the scan over the lower of the `COMMERCIAL` ones, as if the whole body got what the field gets."""
        return self.scan / COMMERCIAL[0]


def scan_dose(
    scene: Scene, *, shots: int | None = None, transmittance: float | None = None, tissue: str = TISSUE
) -> ScanDose:
    """Dose of a scan at the front of the target, from the geometry alone.

    Parameters
    ----------
    scene : with a mask and a target, its source looking along z.
    shots : by default those of the scene.
    transmittance : share of open cells, above 0 and at most 1; by default that of the scene's mask.
    tissue : in which the dose is; the target's own materials do not count.

    Raises
    ------
    OSError
        If a file of the scene cannot be read.
    ValueError
        If the scene has no mask or target, its source looks elsewhere, or a number cannot be.

    Notes
    -----
    The photons of a cell are those within its solid angle at the plate's front, less what air takes and what the walls of the hole
    cut off; closed cells are taken as opaque, and neighbours as open with the probability `transmittance`.

    Examples
    --------
    >>> import shadowgram as sg
    >>> found = sg.xray.scan_dose(sg.xray.shipped_scene("cxbi-blocks"), shots=512, transmittance=0.1)
    >>> f"{1e9 * found.pixel.mean():.2f} nGy a pixel, {1e6 * found.scan:.3f} µGy a scan"
    '3.29 nGy a pixel, 0.169 µGy a scan'
    """
    from ._scan_blocks import check_whole

    mask = scene.mask
    if mask is None:
        raise ValueError("the dose of a scan is that through a coded mask, and this scene has none: add [mask]")
    shots = scene.shots if shots is None else check_whole("shots", shots, 1)
    share = float(mask.cells().mean()) if transmittance is None else float(transmittance)
    if not 0 < share <= 1:
        raise ValueError(f"transmittance is the share of open cells, above 0 and at most 1, got {share:g}")
    front = _front(scene)
    spectrum = scene.source.spectrum.spectrum()
    start = np.array(scene.source.position)
    cells = through_cells(mask, start)[:, 0]
    distance = abs(front - start[2])
    magnified = (distance / np.abs(cells[2])) ** 2 * mask.pitch**2 / 100
    cosine = np.abs(cells[2]) / np.linalg.norm(cells, axis=0)
    air = scene.world.material.material().attenuation(spectrum.energy) / 10
    arriving = np.exp(-air * (distance / cosine)[..., None]) * spectrum.weight / spectrum.total
    photons = scene.photons_per_shot * share_of_source(scene, mask, cells) * _through_hole(mask, cells, share)
    energy = arriving @ _dose_of_fluence(spectrum.energy, material(tissue))
    return ScanDose(
        photons=photons * arriving.sum(axis=-1),
        area=magnified,
        pixel=photons * energy / (magnified * cosine),
        transmittance=share,
        shots=shots,
        tissue=tissue,
    )


def _dose_of_fluence(energy: Floats, tissue: Material) -> Floats:
    """Gy of one photon per cm² at each energy, keV: from keV cm²/g."""
    return 1000 * JOULES * energy * tissue.mass_energy_absorption(energy)


def _front(scene: Scene) -> float:
    """z of the front of the target, mm."""
    from ._layout import placed_solids

    forward = scene.source.direction[2]
    if abs(forward) < 1 - 1e-6:
        raise ValueError(
            "the dose of a scan is at a front across z, but the source of this scene looks elsewhere; give it direction (0, 0, 1)"
        )
    if scene.source.half_angle == 0:
        raise ValueError("the dose of a scan is that of a cone of light, and the source of this scene is a pencil")
    placed = placed_solids(scene, files=True)
    targets = [placed[solid.name] for solid in scene.solids if solid.role == "target"]
    if not targets:
        raise ValueError('there is nobody to get a dose: give a solid of this scene role = "target"')
    return float(min(one.low[2] for one in targets) if forward > 0 else max(one.high[2] for one in targets))


def _through_hole(mask: Mask, cells: Floats, share: float) -> Floats:
    """(y, x) share of a cell's photons that leave the plate: those that stay in the hole, or go on in open neighbours."""
    across, along = (np.minimum(1, mask.depth * np.abs(cells[axis] / cells[2]) / mask.pitch) for axis in (0, 1))
    side = (across * (1 - along) + along * (1 - across)) * share
    return (1 - across) * (1 - along) + side + across * along * share**2
