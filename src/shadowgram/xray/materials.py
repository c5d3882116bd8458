"""Materials and how they attenuate X-rays: photoelectric absorption, Compton and Rayleigh scattering, energy absorption.

Cross sections come from xraylib; `Material.mass_energy_absorption` is derived from them. Energies are keV.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _elements
from ._elements import AVOGADRO, HEAVIEST, HIGHEST_ENERGY, LOWEST_ENERGY

Floats = NDArray[np.float64]

_TOLERANCE = 0.02  # by which mass fractions may miss 1 before they are brought to it
_BREMSSTRAHLUNG = (
    0.7e-3  # share of an electron's energy that becomes bremsstrahlung, per Z and MeV (Evans, The Atomic Nucleus, 1955)
)

# Names of ours, in small letters → a name of NIST's.
_SHORT = {
    "water": "Water, Liquid",
    "h2o": "Water, Liquid",
    "air": "Air, Dry (near sea level)",
    "bone": "Bone, Cortical (ICRP)",
    "fat": "Adipose Tissue (ICRP)",
    "adipose tissue": "Adipose Tissue (ICRP)",
    "tissue": "Tissue, Soft (ICRP)",
    "soft tissue": "Tissue, Soft (ICRP)",
    "concrete": "Concrete, Portland",
    "glass": "Glass, Plate",
    "lead glass": "Glass, Lead",
    "pyrex": "Glass, Pyrex",
    "quartz": "Silicon Dioxide",
    "sugar": "Sucrose",
    "nylon": "Nylon, type 6 and type 6/6",
    "pmma": "Polymethyl Methacralate (Lucite, Perspex)",
    "pvc": "Polyvinyl Chloride",
    "pet": "Polyethylene Terephthalate (Mylar)",
    "ptfe": "Polytetrafluoroethylene (Teflon)",
    "kapton": "Kapton Polyimide Film",
    "bgo": "Bismuth Germanium oxide",
    "nai": "Sodium Iodide",
    "csi": "Cesium Iodide",
    "cdte": "Cadmium Telluride",
    "gaas": "Gallium Arsenide",
    "sio2": "Silicon Dioxide",
    "al2o3": "Aluminum Oxide",
    "caf2": "Calcium Fluoride",
    "lif": "Lithium Fluoride",
}
# Name in small letters → formula and density, g/cm³.
_CHEMICALS = {
    "caffeine": ("C8H10N4O2", 1.23),
    "hmx": ("C4H8N8O8", 1.91),
    "rdx": ("C3H6N6O6", 1.82),
    "petn": ("C5H8N4O12", 1.77),
    "tnt": ("C7H5N3O6", 1.65),
}
# Name in small letters → mass fractions and density, g/cm³. The muscle is that of ICRU report 44, for which NIST tabulates μ_en/ρ.
_MIXTURES = {
    "red brass": ({"Cu": 0.88, "Sn": 0.10, "Zn": 0.02}, 8.44),
    "skeletal muscle": (
        {"H": 0.102, "C": 0.143, "N": 0.034, "O": 0.710, "Na": 0.001, "P": 0.002, "S": 0.003, "Cl": 0.001, "K": 0.004},
        1.05,
    ),
}
_SPELLINGS = {"aluminium": "aluminum", "sulphur": "sulfur", "caesium": "cesium"}


@dataclass(frozen=True, kw_only=True)
class Material:
    """What a thing is made of; made by `material` from a name or a formula.

    Attributes
    ----------
    name : for people.
    density : g/cm³.
    fractions : atomic number and mass fraction of each element; the fractions add up to 1.

    Raises
    ------
    ValueError
        If the density is not positive, or the fractions are not those of elements 1 to 98.

    Notes
    -----
    The methods that take an energy take a scalar or an array of keV between 1 and 800, and give as many values; they raise a
    ValueError elsewhere. Cross sections, form factors and scattering functions are those of xraylib 4.3, additive in the atoms.

    Examples
    --------
    >>> from shadowgram.xray.materials import material
    >>> water = material("water")
    >>> f"{water.mass_attenuation(60.0):.4f} cm²/g, half gone after {water.half_value_layer(60.0):.2f} cm"
    '0.2059 cm²/g, half gone after 3.37 cm'
    >>> (water.photoelectric([30, 60]) / water.mass_attenuation([30, 60])).round(3)
    array([0.388, 0.073])
    """

    name: str
    density: float
    fractions: tuple[tuple[int, float], ...]

    def __post_init__(self) -> None:
        _check_density(self.name, self.density)
        numbers = [z for z, _ in self.fractions]
        if not numbers or len(set(numbers)) < len(numbers) or not all(1 <= z <= HEAVIEST for z in numbers):
            raise ValueError(f"{self.name} must be made of different elements 1 to {HEAVIEST}, got {numbers}")
        whole = sum(fraction for _, fraction in self.fractions)
        if not (all(fraction > 0 for _, fraction in self.fractions) and abs(whole - 1) < 1e-6):
            raise ValueError(f"the mass fractions of {self.name} must be positive and add up to 1, they give {whole:g}")

    @property
    def elements(self) -> tuple[int, ...]:
        """Atomic numbers."""
        return tuple(z for z, _ in self.fractions)

    @property
    def weights(self) -> Floats:
        """(element,) mass fractions."""
        return np.array([fraction for _, fraction in self.fractions])

    @property
    def atoms(self) -> Floats:
        """(element,) atoms of each element in a gram."""
        return self.weights * AVOGADRO / np.array([_elements.atomic_weight(z) for z in self.elements])

    @property
    def electron_density(self) -> float:
        """Electrons in a cm³.

        Examples
        --------
        >>> from shadowgram.xray.materials import material
        >>> f"{material('water').electron_density:.3g}"
        '3.34e+23'
        """
        return float(self.density * self.atoms @ np.array(self.elements))

    def photoelectric(self, energy: ArrayLike) -> Floats:
        """Photoelectric absorption, cm²/g."""
        return self._per_gram(_elements.photoelectric, energy)

    def compton(self, energy: ArrayLike) -> Floats:
        """Compton (incoherent) scattering, cm²/g."""
        return self._per_gram(_elements.compton, energy)

    def rayleigh(self, energy: ArrayLike) -> Floats:
        """Rayleigh (coherent) scattering, cm²/g."""
        return self._per_gram(_elements.rayleigh, energy)

    def mass_attenuation(self, energy: ArrayLike) -> Floats:
        """Mass attenuation μ/ρ, cm²/g, coherent scattering counted: the sum of the three."""
        return self.photoelectric(energy) + self.compton(energy) + self.rayleigh(energy)

    def attenuation(self, energy: ArrayLike) -> Floats:
        """Linear attenuation μ, 1/cm."""
        return self.density * self.mass_attenuation(energy)

    def half_value_layer(self, energy: ArrayLike) -> Floats:
        """Thickness, cm, that lets half the photons of this energy through unharmed, ln 2 / μ."""
        return math.log(2) / self.attenuation(energy)

    def mass_energy_absorption(self, energy: ArrayLike) -> Floats:
        """Mass energy absorption μ_en/ρ, cm²/g: what dose and kerma come from.

        Returns
        -------
        ndarray
            Energy that electrons get from the photon and do not lose to bremsstrahlung, per photon energy, g/cm² and photon.

        Notes
        -----
        Of a photoelectric absorption, the energy without that of the fluorescence photons (shells K, L and M with vacancies passed
        on); of Compton scattering, the mean energy of the recoil electron of a bound electron. Bremsstrahlung is roughly taken as
        7×10⁻⁴ of the electron's energy per Z and MeV. Against NIST's tables (Hubbell and Seltzer, NISTIR 5632): within 2 % up to
        300 keV for Na, Al, I and W, within 1 % up to 100 keV.

        Examples
        --------
        >>> from shadowgram.xray.materials import material
        >>> material("water").mass_energy_absorption([20, 60, 100]).round(4)
        array([0.5506, 0.0319, 0.0255])
        """
        return self._per_gram(_energy_absorption, energy)

    def incoherent_function(self, x: ArrayLike) -> Floats:
        """S(x) of an average electron, 0 at x = 0 and 1 where x is large.

        Parameters
        ----------
        x : E sin(θ/2) / hc, 1/Å.
        """
        values, shape = _checked_momentum(x)
        electrons = self.atoms @ np.array(self.elements)
        return _shaped(self.atoms @ _elements.incoherent_function(self.elements, values) / electrons, shape)

    def form_factor(self, x: ArrayLike) -> Floats:
        """F(x) of an average atom, (Σ nᵢ Fᵢ² / Σ nᵢ)^½: the root mean square of Z at x = 0, and 0 where x is large.

        Parameters
        ----------
        x : E sin(θ/2) / hc, 1/Å.
        """
        values, shape = _checked_momentum(x)
        squares = self.atoms @ _elements.form_factor(self.elements, values) ** 2
        return _shaped(np.sqrt(squares / self.atoms.sum()), shape)

    def _per_gram(self, of_elements: Callable[[tuple[int, ...], Floats], Floats], energy: ArrayLike) -> Floats:
        values, shape = _checked_energy(energy)
        return _shaped(self.weights @ of_elements(self.elements, values), shape)


def material(name: str, density: float | None = None, fractions: Mapping[str, float] | None = None) -> Material:
    """Material by its name, its formula, or what it is made of.

    Parameters
    ----------
    name : an element ("tungsten", "W"), a compound or mixture of NIST's list ("Sodium Iodide", "Bone, Cortical (ICRP)", "cortical
        bone"), one of ours ("water", "caffeine", "red brass", "skeletal muscle"), or a chemical formula ("C8H10N4O2"), which needs
        its density. Capitals matter only in symbols and formulas. With `fractions`, any name.
    density : g/cm³, in place of the one that is known.
    fractions : symbol → mass fraction, which add up to 1 within 2 %; needs a density.

    Raises
    ------
    ValueError
        If there is no such material, with the names that come closest; if a density is needed or is not positive; or if the
        fractions are not those of elements.

    Examples
    --------
    >>> from shadowgram.xray.materials import material
    >>> material("tungsten").density
    19.3
    >>> material("C8H10N4O2", density=1.23).fractions == material("caffeine").fractions
    True
    >>> air = material("thin air", density=1.29e-3, fractions={"N": 0.755, "O": 0.232, "H": 0.013})
    >>> air.elements
    (7, 8, 1)
    """
    if not isinstance(name, str):
        raise TypeError(f"a material is named by a text, such as 'water', got {name!r}")
    if fractions is not None:
        if density is None:
            raise ValueError(f"say the density of {name} in g/cm³, since it is made from fractions")
        return Material(name=name, density=density, fractions=_from_symbols(name, fractions))
    if known := _known(name):
        usual, parts = known
    elif parts := _elements.parse_formula(name):
        if density is None:
            raise ValueError(f"say the density of {name} in g/cm³, which does not follow from its formula")
        usual = density
    else:
        raise ValueError(f"there is no material {name!r}; {_closest(name)}, or give a formula and its density")
    return Material(name=name, density=usual if density is None else density, fractions=_whole(parts))


def material_names() -> tuple[str, ...]:
    """All names that `material` knows, but for symbols and formulas.

    Examples
    --------
    >>> from shadowgram.xray.materials import material_names
    >>> [name for name in material_names() if "iodide" in name.lower()]
    ['Cesium Iodide', 'Lithium Iodide', 'Mercuric Iodide', 'Potassium Iodide', 'Silver Iodide', 'Sodium Iodide']
    """
    return tuple(
        sorted((*_elements.NAMES, *_CHEMICALS, *_MIXTURES, *_elements.compounds(), "water", "air"), key=str.lower)
    )


def _known(name: str) -> tuple[float, tuple[tuple[int, float], ...]] | None:
    """Density and mass fractions of a name that has them."""
    key = _key(name)
    if z := _elements.symbols().get(name.strip()):
        return _elements.density(z), ((z, 1.0),)
    if (element := _SPELLINGS.get(key, key)) in _elements.NAMES:
        z = _elements.NAMES.index(element) + 1
        return _elements.density(z), ((z, 1.0),)
    if key in _CHEMICALS:
        formula, density = _CHEMICALS[key]
        parts = _elements.parse_formula(formula)
        return None if parts is None else (density, parts)
    if key in _MIXTURES:
        fractions, density = _MIXTURES[key]
        return density, _from_symbols(name, fractions)
    compound = _compound_names().get(key)
    return None if compound is None else _elements.compounds()[compound]


def _key(name: str) -> str:
    return " ".join(name.lower().split())


@cache
def _compound_names() -> dict[str, str]:
    """Names in small letters, whole and shortened → NIST's names: "Muscle, Skeletal" is skeletal muscle, "... (Teflon)" teflon."""
    found = {}
    for name in _elements.compounds():
        plain, *inside = re.split(r"\s*[()]", name)
        words = [name, plain, *inside[0].split(", ")] if inside and "ICR" not in inside[0] else [name, plain]
        first, *rest = plain.split(", ")
        if len(rest) == 1:
            words.append(f"{rest[0]} {first}")
        for word in words:
            found.setdefault(_key(word), name)
    return found | _SHORT


def _closest(name: str) -> str:
    """Words for the names that are most like this one."""
    names = [*_elements.NAMES, *_SPELLINGS, *_CHEMICALS, *_MIXTURES, *_compound_names()]
    near = difflib.get_close_matches(_key(name), names, n=3, cutoff=0.5)
    if by_symbol := [s for s in _elements.symbols() if s.lower() == _key(name)]:
        near = by_symbol
    return "the closest names are " + ", ".join(near) if near else "see 'shadowgram xray materials' for the names"


def _from_symbols(name: str, fractions: Mapping[str, float]) -> tuple[tuple[int, float], ...]:
    if unknown := [symbol for symbol in fractions if symbol not in _elements.symbols()]:
        raise ValueError(f"the fractions of {name} must be those of chemical symbols such as N, got {unknown[0]!r}")
    values = list(fractions.values())
    if not all(_is_positive(v) for v in values):
        raise ValueError(f"the mass fractions of {name} must be positive numbers, got {values}")
    if abs(sum(values) - 1) > _TOLERANCE:
        raise ValueError(f"the mass fractions of {name} must add up to 1, they give {sum(values):g}")
    return _whole(tuple((_elements.symbols()[symbol], float(v)) for symbol, v in fractions.items()))


def _whole(parts: tuple[tuple[int, float], ...]) -> tuple[tuple[int, float], ...]:
    """Fractions that add up to 1 to the last bit or so; NIST's are rounded."""
    whole = sum(fraction for _, fraction in parts)
    return tuple((z, fraction / whole) for z, fraction in parts)


def _check_density(name: str, density: float) -> None:
    if not _is_positive(density):
        raise ValueError(f"the density of {name} must be a positive number of g/cm³, got {density!r}")


def _is_positive(value: object) -> bool:
    return isinstance(value, (int, float, np.number)) and bool(0 < value < math.inf)


def _energy_absorption(elements: tuple[int, ...], energy: Floats) -> Floats:
    """(element, energy) cm²/g."""
    photoelectric, compton = _elements.photoelectric(elements, energy), _elements.compton(elements, energy)
    result = np.empty_like(photoelectric)
    for i, z in enumerate(elements):
        loss = _BREMSSTRAHLUNG * z * energy / 1000
        kept = 1 - _elements.fluorescence(z, energy) / energy
        recoil = _elements.compton_transfer(z, energy)
        result[i] = photoelectric[i] * kept * (1 - loss * kept) + compton[i] * recoil * (1 - loss * recoil)
    return result


def _checked_energy(energy: ArrayLike) -> tuple[Floats, tuple[int, ...]]:
    values, shape = _numbers(energy, "energies in keV")
    if not np.all((values >= LOWEST_ENERGY) & (values <= HIGHEST_ENERGY)):  # so written, it refuses NaN
        outside = values[~((values >= LOWEST_ENERGY) & (values <= HIGHEST_ENERGY))][0]
        raise ValueError(
            f"energies must lie between {LOWEST_ENERGY:g} and {HIGHEST_ENERGY:g} keV, where there are tables; got {outside:g}"
        )
    return values, shape


def _checked_momentum(x: ArrayLike) -> tuple[Floats, tuple[int, ...]]:
    values, shape = _numbers(x, "momentum transfers x in 1/Å")
    if not np.all(values >= 0):
        raise ValueError(f"momentum transfers x must be 0 or more, in 1/Å; got {values[~(values >= 0)][0]:g}")
    return values, shape


def _numbers(values: ArrayLike, what: str) -> tuple[Floats, tuple[int, ...]]:
    array = np.asarray(values)
    if array.dtype.kind not in "iuf":
        raise TypeError(f"{what} must be real numbers, got {array.dtype}")
    return array.astype(np.float64).ravel(), array.shape


def _shaped(values: Floats, shape: tuple[int, ...]) -> Floats:
    """As many values as there were arguments; a scalar for a scalar."""
    return values.reshape(shape)[()]
