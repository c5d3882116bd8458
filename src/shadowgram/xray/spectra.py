"""X-ray spectra: of tubes, of one energy, from files, filtered, and what they amount to.

Tube spectra are computed by SpekPy, the extra ``tubes``; the one of the CXBI simulations comes with the package.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._elements import HIGHEST_ENERGY, LOWEST_ENERGY
from .materials import Material, material

Floats = NDArray[np.float64]

_SHIPPED = "tube-120kV-1.5mmAl.csv"
_LARGEST_FILE = 10_000_000  # bytes
_DISCRETE, _INTERPOLATED = 1, 3  # modes of GATE's user spectra
_NEWTON_STEPS = 50
_NOTHING = 1e-15  # of all photons, written as 0


@dataclass(frozen=True, kw_only=True, eq=False)
class Spectrum:
    """Numbers of photons at energies.

    Attributes
    ----------
    energy : (n,) keV, rising; centres of bins, or lines.
    weight : (n,) photons at each energy, in any unit. They are counts, not counts per keV.

    Raises
    ------
    ValueError
        If the energies do not rise or lie outside 1 to 800 keV, if a weight is negative or not finite, or if all are 0.

    Examples
    --------
    >>> from shadowgram.xray.materials import material
    >>> from shadowgram.xray.spectra import shipped_tube
    >>> tube = shipped_tube()
    >>> f"mean {tube.mean_energy:.1f} keV, half-value layer {tube.half_value_layer(material('Al')):.2f} mm Al"
    'mean 52.1 keV, half-value layer 3.23 mm Al'
    >>> f"{tube.filtered(material('Cu'), 0.5).mean_energy:.1f} keV"
    '69.0 keV'
    """

    energy: Floats
    weight: Floats

    def __post_init__(self) -> None:
        energy, weight = _checked(self.energy, self.weight)
        for name, values in (("energy", energy), ("weight", weight)):
            values.flags.writeable = False
            object.__setattr__(self, name, values)

    @property
    def total(self) -> float:
        """Sum of the weights."""
        return float(self.weight.sum())

    @property
    def mean_energy(self) -> float:
        """Mean energy of the photons, keV."""
        return float(self.energy @ self.weight / self.weight.sum())

    def half_value_layer(self, absorber: Material) -> float:
        """Thickness, mm, of a material that halves the air kerma of a narrow beam.

        Parameters
        ----------
        absorber : usually aluminum.
        """
        kerma = self.weight * self.energy * material("air").mass_energy_absorption(self.energy)
        attenuation = absorber.attenuation(self.energy) / 10  # 1/mm
        thickness = 0.0
        for _ in range(_NEWTON_STEPS):
            # The logarithm of what is left is convex: from 0 the steps go up to the root and not beyond it.
            left = kerma * np.exp(-attenuation * thickness)
            step = math.log(2 * left.sum() / kerma.sum()) * left.sum() / (attenuation @ left)
            thickness += float(step)
            if abs(step) < 1e-12 * thickness:
                break
        return thickness

    def filtered(self, absorber: Material, thickness: float) -> Spectrum:
        """What is left of the spectrum behind `thickness` mm of a material: the photons that were not touched.

        Raises
        ------
        ValueError
            If the thickness is negative, or if nothing is left.
        """
        if not (math.isfinite(thickness) and thickness >= 0):
            raise ValueError(f"the thickness of a filter must be 0 or more mm, got {thickness!r}")
        left = self.weight * np.exp(-absorber.attenuation(self.energy) * thickness / 10)
        if not left.any():
            raise ValueError(f"{thickness:g} mm of {absorber.name} let nothing through")
        return Spectrum(energy=self.energy, weight=left)


def mono(energy: float) -> Spectrum:
    """Photons of one energy, keV.

    Examples
    --------
    >>> from shadowgram.xray.spectra import mono
    >>> mono(60.0).mean_energy
    60.0
    """
    return Spectrum(energy=np.array([energy]), weight=np.ones(1))


def tube(
    voltage: float,
    filters: Sequence[tuple[str, float]] = (("Al", 1.5),),
    *,
    anode_angle: float = 12.0,
    bin_width: float = 1.0,
) -> Spectrum:
    """Spectrum of an X-ray tube with a tungsten anode, computed by SpekPy.

    Parameters
    ----------
    voltage : kV, 10 to 500.
    filters : name of a material and its thickness in mm, one after the other.
    anode_angle : degrees between the anode's face and the central ray.
    bin_width : keV.

    Returns
    -------
    Spectrum
        Photons/cm² per mAs in each bin, at 1 m from the focal spot, without air in between.

    Raises
    ------
    ValueError
        If a value is out of range, a filter unknown, or SpekPy not installed (``pip install "shadowgram[tubes]"``).

    Notes
    -----
    SpekPy (Poludniowski et al., Med. Phys. 48, 3630, 2021) gives the spectrum that leaves the anode, with its model "casim"; the
    filters are ours. It takes a second, so results are kept in ``$XDG_CACHE_HOME/shadowgram`` or ``~/.cache/shadowgram``; what is
    there may be deleted at any time.

    Examples
    --------
    >>> from shadowgram.xray.spectra import tube
    >>> f"{tube(80.0, [('Al', 2.5)]).mean_energy:.1f} keV"  # doctest: +SKIP
    '43.0 keV'
    """
    from ._tubes import bare_tube  # here, since it needs Spectrum

    spectrum = bare_tube(voltage, anode_angle, bin_width)
    for name, thickness in filters:
        spectrum = spectrum.filtered(material(name), thickness)
    return spectrum


def shipped_tube() -> Spectrum:
    """Spectrum of a tube at 120 kV behind 1.5 mm of aluminum, made by `tube` and kept with the package: it needs no SpekPy.

    Returns
    -------
    Spectrum
        Bins of 1 keV; weights that add up to 1.
    """
    text = (resources.files("shadowgram.xray") / "data" / _SHIPPED).read_text(encoding="utf-8")
    return _parse(text, _SHIPPED)


def read_spectrum(path: str | Path) -> Spectrum:
    r"""Read a spectrum from a text file.

    Parameters
    ----------
    path : a file with two columns, energy in keV and a weight, split by commas, semicolons or spaces. The first line may hold
        names, and # begins a comment. Or a user spectrum of GATE: MeV, under a line with its mode and lowest energy, such as "3 0".

    Returns
    -------
    Spectrum
        Rows whose weight is 0 are left out where they lie outside the tables.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is not such a file, energies do not rise or lie outside 1 to 800 keV, or weights are negative or all 0.

    Notes
    -----
    Weights are photons at each energy. GATE interpolates between the rows of a mode 3 file (linear): there a weight is taken times
    the distance of its neighbours.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from shadowgram.xray.spectra import read_spectrum
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "mine.csv"
    >>> _ = path.write_text("keV, photons\n40, 1\n60, 3\n")
    >>> read_spectrum(path).mean_energy
    55.0
    """
    path = Path(path)
    if path.stat().st_size > _LARGEST_FILE:
        raise ValueError(f"{path} is too large for a spectrum: two columns of at most {_LARGEST_FILE // 10**6} MB")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not a text file with the two columns of a spectrum") from error
    return _parse(text, str(path))


def format_spectrum(spectrum: Spectrum, comment: str = "") -> str:
    """Text of a file that `read_spectrum` reads: keV and weights that add up to 1, with 7 digits.

    Parameters
    ----------
    comment : said in lines that begin with #.
    """
    lines = [f"# {line}" for line in comment.splitlines()]
    lines.append("energy_keV,relative_weight")
    relative = spectrum.weight / spectrum.total
    relative = np.where(relative > _NOTHING, relative, 0)
    lines += [f"{energy:.9g},{weight:.6e}" for energy, weight in zip(spectrum.energy, relative, strict=True)]
    return "\n".join(lines) + "\n"


def _parse(text: str, where: str) -> Spectrum:
    rows = _rows(text, where)
    if not rows:
        raise ValueError(f"{where} holds no spectrum: it needs two columns, energy in keV and weight")
    energy, weight = np.array(rows).T
    if len(rows) > 1 and energy[0] in (1, 2, 3) and energy[1] < energy[0]:
        energy, weight = _from_gate(energy, weight, where)
    # NaN stays in, to be complained about.
    kept = ~((weight == 0) & ((energy < LOWEST_ENERGY) | (energy > HIGHEST_ENERGY)))
    try:
        return Spectrum(energy=energy[kept], weight=weight[kept])
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error


def _rows(text: str, where: str) -> list[tuple[float, float]]:
    rows = []
    named = False
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split("#")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        try:
            energy, weight = map(float, words)
        except ValueError:
            if rows or named:
                raise ValueError(
                    f"line {number} of {where} must be an energy and a weight, got {line[:60]!r}"
                ) from None
            named = True  # the line of names
            continue
        rows.append((energy, weight))
    return rows


def _from_gate(energy: Floats, weight: Floats, where: str) -> tuple[Floats, Floats]:
    """The rows of a user spectrum of GATE after the first, which holds the mode, as keV and photons."""
    mode = int(energy[0])
    if mode not in (_DISCRETE, _INTERPOLATED):
        raise ValueError(
            f"{where} is a spectrum of GATE in mode {mode}; only modes 1 (lines) and 3 (interpolated) are read"
        )
    energy, weight = energy[1:] * 1000, weight[1:]
    if mode == _INTERPOLATED and len(energy) > 1:
        weight = weight * np.gradient(energy)
    return energy.round(9), weight  # 0.058 MeV are 58 keV


def _checked(energy: ArrayLike, weight: ArrayLike) -> tuple[Floats, Floats]:
    """Copies of the columns, if they are a spectrum."""
    energies, weights = np.array(energy, dtype=np.float64), np.array(weight, dtype=np.float64)
    if energies.ndim != 1 or energies.shape != weights.shape or not energies.size:
        raise ValueError(f"a spectrum needs as many weights as energies, got {weights.shape} and {energies.shape}")
    outside = ~((energies >= LOWEST_ENERGY) & (energies <= HIGHEST_ENERGY))
    if outside.any():
        limits = f"{LOWEST_ENERGY:g} and {HIGHEST_ENERGY:g} keV"
        raise ValueError(f"the energies of a spectrum must lie between {limits}, got {energies[outside][0]:g}")
    if np.any(np.diff(energies) <= 0):
        after = energies[1:][np.diff(energies) <= 0][0]
        raise ValueError(
            f"the energies of a spectrum must rise, but {after:g} keV comes after a higher or the same one"
        )
    wrong = ~((weights >= 0) & (weights < math.inf))
    if wrong.any():
        raise ValueError(f"the weights of a spectrum must be 0 or more, got {weights[wrong][0]:g}")
    if not weights.any():
        raise ValueError("the weights of a spectrum must not all be 0")
    return energies, weights
