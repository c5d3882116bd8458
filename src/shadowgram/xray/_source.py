"""The source of a scene: where photons come from, at which energies, and how many."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from . import spectra
from ._parts import File, Part, Positive, Vector, unit_vector
from .montecarlo.arrays import HIGHEST_ENERGY, LOWEST_ENERGY
from .spectra import Spectrum

ELECTRON_CHARGE = 1.602176634e-19
"""Coulomb (SI, exact)."""
PHOTONS_PER_ELECTRON = 0.02
"""Of a tube: the share of electrons that give a photon, by the rule of the source of the CXBI simulations (Salazar 2022, 4.5.1)."""

_ONE_OF = "energy, energies and weights, tube, file, shipped"


class Tube(Part):
    """An X-ray tube with a tungsten anode, whose spectrum `shadowgram.xray.spectra.tube` computes.

    Attributes
    ----------
    voltage : kV.
    filters : name of a material and its thickness in mm, one after the other.
    anode_angle : rad between the anode's face and the central ray.
    """

    voltage: Positive
    filters: Annotated[tuple[Annotated[tuple[str, Positive], Field(strict=False)], ...], Field(strict=False)] = (
        ("Al", 1.5),
    )
    anode_angle: Annotated[float, Field(gt=0, lt=math.pi / 2)] = math.radians(12)


class Energies(Part):
    """The energies of the photons, said in one of five ways.

    Attributes
    ----------
    energy : keV, all of one energy.
    energies, weights : keV, rising, and photons at each of them in any unit.
    tube : a tube.
    file : a spectrum that `shadowgram.xray.spectra.read_spectrum` reads.
    shipped : "tube-120kV-1.5mmAl", the tube of the CXBI simulations.
    width : keV over which the photons at an energy are spread: the width of bins, 0 for lines. By default it is 1 for tubes,
        whose bins are so wide, and 0 for the others.

    Examples
    --------
    >>> from shadowgram.xray.scene import Energies
    >>> round(Energies(shipped="tube-120kV-1.5mmAl").spectrum().mean_energy)
    52
    """

    energy: Positive | None = None
    energies: Annotated[tuple[Positive, ...], Field(strict=False)] | None = None
    weights: Annotated[tuple[Annotated[float, Field(ge=0)], ...], Field(strict=False)] | None = None
    tube: Tube | None = None
    file: File | None = None
    shipped: Literal["tube-120kV-1.5mmAl"] | None = None
    width: Annotated[float, Field(ge=0)] | None = None

    @model_validator(mode="after")
    def _one_way(self) -> Energies:
        said = [x for x in (self.energy, self.energies, self.tube, self.file, self.shipped) if x is not None]
        if len(said) != 1 or (self.energies is None) != (self.weights is None):
            raise ValueError(f"say the spectrum in one way: {_ONE_OF}")
        if self.file is None and self.tube is None:
            self.spectrum()
        return self

    @property
    def spread(self) -> float:
        """keV over which the photons at an energy are spread."""
        if self.width is not None:
            return self.width
        return 1.0 if self.tube or self.shipped else 0.0

    def spectrum(self) -> Spectrum:
        """The spectrum: computed, or read from its file.

        Raises
        ------
        OSError
            If the file cannot be read.
        ValueError
            If there is no such spectrum, or it reaches beyond the energies that can be followed.
        """
        found = self._found()
        kept = found.weight > 0
        low, high = found.energy[kept][[0, -1]]
        if low - self.spread / 2 < LOWEST_ENERGY or high + self.spread / 2 > HIGHEST_ENERGY:
            raise ValueError(
                f"photons start with {LOWEST_ENERGY:g} to {HIGHEST_ENERGY:g} keV, the spectrum has {low:g} to {high:g}"
                + (f" with bins of {self.spread:g}" if self.spread else "")
            )
        return Spectrum(energy=found.energy[kept], weight=found.weight[kept])

    def _found(self) -> Spectrum:
        if self.energy is not None:
            return spectra.mono(self.energy)
        if self.tube is not None:
            angle = round(math.degrees(self.tube.anode_angle), 9)
            return spectra.tube(self.tube.voltage, self.tube.filters, anode_angle=angle)
        if self.file is not None:
            return spectra.read_spectrum(self.file)
        if self.shipped is not None:
            return spectra.shipped_tube()
        return Spectrum(energy=self.energies, weight=self.weights)  # type: ignore[arg-type]  # it makes arrays of them


def _energies(value: Any) -> Any:
    if isinstance(value, Spectrum):
        return {"energies": value.energy, "weights": value.weight}
    return value


class Source(Part):
    """A source of photons: a cone of directions, uniform in solid angle, from a small rectangle.

    Attributes
    ----------
    position : mm, centre of the focal spot.
    direction : of the cone's axis; any length.
    half_angle : rad between the axis and the rim of the cone; 0 is a pencil, π all directions.
    focal_spot : mm, full width of the rectangle across the axis, along x and y where the axis is z.
    spectrum : see `Energies`; a `shadowgram.xray.spectra.Spectrum` will do.
    activity : photons/s into the cone.
    current : mA of a tube, in its place: 2 photons into the cone for 100 electrons.

    Examples
    --------
    >>> from shadowgram.xray.scene import Source
    >>> tube = Source(position=(0, 0, -150), half_angle=0.3054, spectrum={"shipped": "tube-120kV-1.5mmAl"}, current=5.12e-6)
    >>> f"{tube.photons_per_second:.2g} photons/s into {tube.solid_angle:.3f} sr"
    '6.4e+08 photons/s into 0.291 sr'
    """

    position: Vector
    direction: Vector = (0.0, 0.0, 1.0)
    half_angle: Annotated[float, Field(ge=0, le=math.pi)] = 0.0
    focal_spot: Annotated[tuple[Annotated[float, Field(ge=0)], Annotated[float, Field(ge=0)]], Field(strict=False)] = (
        0.0,
        0.0,
    )
    spectrum: Annotated[Energies, BeforeValidator(_energies)]
    activity: Positive | None = None
    current: Positive | None = None

    @field_validator("direction")
    @classmethod
    def _direction(cls, direction: tuple[float, float, float]) -> tuple[float, float, float]:
        return unit_vector(direction)

    @model_validator(mode="after")
    def _strength(self) -> Source:
        if (self.activity is None) == (self.current is None):
            raise ValueError("say how strong the source is: activity in photons/s, or current in mA")
        return self

    @property
    def photons_per_second(self) -> float:
        """Photons/s into the cone."""
        if self.activity is not None:
            return self.activity
        return (self.current or 0.0) * 1e-3 / ELECTRON_CHARGE * PHOTONS_PER_ELECTRON

    @property
    def solid_angle(self) -> float:
        """Of the cone, sr."""
        return 4 * math.pi * math.sin(self.half_angle / 2) ** 2
