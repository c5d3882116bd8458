"""Data of single elements, from xraylib: cross sections, scattering functions, absorption edges, shells and their emission.

xraylib 4.3 (Schoonjans et al., Spectrochim. Acta B 66, 776, 2011). Some of what it offers is not used, being wrong or other
than its name: ``CS_Energy``; ``SF_Compt`` below 0.005 1/Å, where its spline leaves the law ∝ x²; ``CSb_Photo_Partial``, which is
per electron; and the Kissel photoelectric tables but for ratios, as they end at 100 or 300 keV.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from .montecarlo.arrays import ELECTRON_MASS, HC

with warnings.catch_warnings():
    # SWIG's own types do not name their module, which Python 3.12 and later warn of.
    warnings.simplefilter("ignore", DeprecationWarning)
    import xraylib
    import xraylib_np

Floats = NDArray[np.float64]

LOWEST_ENERGY, HIGHEST_ENERGY = 1.0, 800.0
"""keV; the range of the cross sections."""
HEAVIEST = 98
AVOGADRO = 6.02214076e23
RADIUS_SQUARED = 2.8179403262**2 / 100
"""r_e², barn (r_e in fm, CODATA 2018)."""

_LOWEST_MOMENTUM = 0.005  # 1/Å, first entry of the tables of S(x) that has three digits
_HIGHEST_MOMENTUM = 1e9  # 1/Å
_SCAN = 2**-11  # relative step of the search for edges
_HALVINGS = 42  # of that step, to the last bit
_LEAST_JUMP = 1e-3  # of the logarithm
_OFF_EDGE = 2**-8  # relative
_NODES = 64

NAMES = (
    "hydrogen", "helium", "lithium", "beryllium", "boron", "carbon", "nitrogen", "oxygen", "fluorine", "neon",
    "sodium", "magnesium", "aluminum", "silicon", "phosphorus", "sulfur", "chlorine", "argon", "potassium",
    "calcium", "scandium", "titanium", "vanadium", "chromium", "manganese", "iron", "cobalt", "nickel", "copper",
    "zinc", "gallium", "germanium", "arsenic", "selenium", "bromine", "krypton", "rubidium", "strontium", "yttrium",
    "zirconium", "niobium", "molybdenum", "technetium", "ruthenium", "rhodium", "palladium", "silver", "cadmium",
    "indium", "tin", "antimony", "tellurium", "iodine", "xenon", "cesium", "barium", "lanthanum", "cerium",
    "praseodymium", "neodymium", "promethium", "samarium", "europium", "gadolinium", "terbium", "dysprosium",
    "holmium", "erbium", "thulium", "ytterbium", "lutetium", "hafnium", "tantalum", "tungsten", "rhenium", "osmium",
    "iridium", "platinum", "gold", "mercury", "thallium", "lead", "bismuth", "polonium", "astatine", "radon",
    "francium", "radium", "actinium", "thorium", "protactinium", "uranium", "neptunium", "plutonium", "americium",
    "curium", "berkelium", "californium",
)  # fmt: skip
"""Names of elements 1 to 98."""

K, L1, L2, L3 = range(4)
SHELLS = ("K", "L1", "L2", "L3", "M1", "M2", "M3", "M4", "M5")
# Single transitions, such as KL3 and L1N67; the groups, such as KA and LB, would count them twice.
_TRANSITIONS = tuple(
    name.removesuffix("_LINE")
    for name in vars(xraylib)
    if name.endswith("_LINE") and name.startswith(tuple(s + t for s in SHELLS for t in "LMNOP"))
)


def symbol(z: int) -> str:
    """Chemical symbol."""
    return xraylib.AtomicNumberToSymbol(z)


@cache
def symbols() -> dict[str, int]:
    """Symbol → atomic number of the elements that have data."""
    return {symbol(z): z for z in range(1, HEAVIEST + 1)}


def density(z: int) -> float:
    """g/cm³, of the element as it is at room temperature."""
    return xraylib.ElementDensity(z)


@cache
def atomic_weight(z: int) -> float:
    """g/mol."""
    return xraylib.AtomicWeight(z)


@cache
def compounds() -> dict[str, tuple[float, tuple[tuple[int, float], ...]]]:
    """NIST's name → density (g/cm³) and (Z, mass fraction) of the compounds and mixtures that xraylib knows."""
    found = {}
    for name in xraylib.GetCompoundDataNISTList():
        data = xraylib.GetCompoundDataNISTByName(name)
        found[name] = data["density"], tuple(zip(data["Elements"], data["massFractions"], strict=True))
    return found


def parse_formula(text: str) -> tuple[tuple[int, float], ...] | None:
    """(Z, mass fraction) of a chemical formula such as "C8H10N4O2", or None if it is none."""
    try:
        data = xraylib.CompoundParser(text)
    except ValueError:
        return None
    if max(data["Elements"]) > HEAVIEST:
        return None
    return tuple(zip(data["Elements"], data["massFractions"], strict=True))


def photoelectric(elements: tuple[int, ...], energy: Floats) -> Floats:
    """(element, energy) cm²/g at keV."""
    return xraylib_np.CS_Photo(np.array(elements), np.ascontiguousarray(energy))


def compton(elements: tuple[int, ...], energy: Floats) -> Floats:
    """(element, energy) cm²/g at keV."""
    return xraylib_np.CS_Compt(np.array(elements), np.ascontiguousarray(energy))


def rayleigh(elements: tuple[int, ...], energy: Floats) -> Floats:
    """(element, energy) cm²/g at keV."""
    return xraylib_np.CS_Rayl(np.array(elements), np.ascontiguousarray(energy))


def incoherent_function(elements: tuple[int, ...], x: Floats) -> Floats:
    """(element, x) S(x) of an atom, from 0 to Z, at 1/Å; ∝ x² near 0."""
    inside = np.clip(x, _LOWEST_MOMENTUM, _HIGHEST_MOMENTUM)
    values = xraylib_np.SF_Compt(np.array(elements), np.ascontiguousarray(inside))
    return np.minimum(values, np.array(elements)[:, None]) * np.minimum(x / _LOWEST_MOMENTUM, 1.0) ** 2


def form_factor(elements: tuple[int, ...], x: Floats) -> Floats:
    """(element, x) F(x) of an atom, from Z to 0, at 1/Å."""
    return xraylib_np.FF_Rayl(np.array(elements), np.ascontiguousarray(np.minimum(x, _HIGHEST_MOMENTUM)))


@cache
def photoelectric_edges(z: int) -> Floats:
    """(edge, 2) keV: the last energy below and the first above each jump of `photoelectric`, rising.

    The tables have their edges up to 0.05 % off the binding energies, so the jumps are looked for in the tables.
    """
    steps = int(np.log(HIGHEST_ENERGY / LOWEST_ENERGY) / _SCAN)
    grid = np.geomspace(LOWEST_ENERGY, HIGHEST_ENERGY, steps)

    def logarithm(energy: Floats) -> Floats:
        return np.log(photoelectric((z,), energy)[0])

    rises = np.flatnonzero(np.diff(logarithm(grid)) > _LEAST_JUMP)
    low, high = grid[rises], grid[rises + 1]
    below, above = logarithm(low), logarithm(high)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        here = logarithm(middle)
        upper = above - here > here - below
        low, below = np.where(upper, middle, low), np.where(upper, here, below)
        high, above = np.where(upper, high, middle), np.where(upper, above, here)
    # Above some M edges the tables rise over several percent in energy; there is no jump then.
    jumps = above - below > _LEAST_JUMP
    return np.stack([low[jumps], high[jumps]], axis=1)


@dataclass(frozen=True, kw_only=True)
class Line:
    """An emission line: photon energy in keV, its probability within the shell, and the shell that is empty after it (an index)."""

    energy: float
    probability: float
    emptied: int


@dataclass(frozen=True, kw_only=True)
class Shell:
    """An electron shell: its index in `SHELLS`, the probability that a photon fills it, and the lines."""

    index: int
    fluorescence: float
    lines: tuple[Line, ...]


@cache
def shells(z: int) -> tuple[Shell, ...]:
    """Shells K to M5 of an element that emit photons."""
    found = []
    for index, name in enumerate(SHELLS):
        lines = _lines(z, name)
        if lines:
            found.append(Shell(index=index, fluorescence=_or_zero(xraylib.FluorYield, z, index), lines=lines))
    return tuple(found)


def _lines(z: int, shell: str) -> tuple[Line, ...]:
    found = []
    for transition in _TRANSITIONS:
        if transition.startswith(shell):
            macro = getattr(xraylib, f"{transition}_LINE")
            energy, rate = _or_zero(xraylib.LineEnergy, z, macro), _or_zero(xraylib.RadRate, z, macro)
            if energy > 0 and rate > 0:
                to = transition.removeprefix(shell)
                found.append((energy, rate, SHELLS.index(to) if to in SHELLS else -1))
    whole = sum(rate for _, rate, _ in found)
    return tuple(Line(energy=energy, probability=rate / whole, emptied=to) for energy, rate, to in found)


def _or_zero(function: Callable[..., float], *arguments: int) -> float:
    """Value of an xraylib function, 0 where it has none."""
    try:
        return function(*arguments)
    except ValueError:
        return 0.0


def shell_shares(z: int, energy: Floats) -> Floats:
    """(4, energy): shares of the photoelectric absorptions that empty K, L1, L2 and L3, at keV."""
    parts = xraylib_np.CS_Photo_Partial(np.array([z]), np.arange(31), _kissel_energy(z, energy))[0]
    return parts[:4] / parts.sum(axis=0)


def _kissel_energy(z: int, energy: Floats) -> Floats:
    """Energies at which the tables by shells say what holds at these: not above their end, and off their edges.

    The edges of the two sets of tables differ by up to 0.05 %, and just above its edges this one is not smooth.
    """
    off = np.minimum(energy, _last_kissel(z))
    edges = photoelectric_edges(z)
    for i, (below, above) in enumerate(edges):
        following = edges[i + 1, 0] if i + 1 < len(edges) else HIGHEST_ENERGY
        upper = min(above * (1 + _OFF_EDGE), following * (1 - _OFF_EDGE / 4))
        off = np.where((energy >= above) & (energy < upper), upper, off)
        lower = below * (1 - _OFF_EDGE / 4)
        off = np.where((energy <= below) & (energy > lower), lower, off)
    return np.ascontiguousarray(off)


@cache
def _last_kissel(z: int) -> float:
    """Highest whole keV of the photoelectric tables by shells; above it the shares hardly change."""
    energies = np.arange(LOWEST_ENERGY, HIGHEST_ENERGY)
    return float(energies[np.flatnonzero(xraylib_np.CS_Photo_Total(np.array([z]), energies)[0])[-1]])


def fluorescence(z: int, energy: Floats) -> Floats:
    """Mean energy, keV, that the photons after a photoelectric absorption carry away, vacancies that move on counted."""
    inside = _kissel_energy(z, energy)
    emitting = shells(z)
    if not emitting:
        return np.zeros_like(energy)
    numbers = np.array([shell.index for shell in emitting])
    mean = np.array([sum(line.energy * line.probability for line in shell.lines) for shell in emitting])
    emitted = xraylib_np.CS_FluorShell_Kissel_Cascade(np.array([z]), numbers, inside)[0]
    return mean @ emitted / xraylib_np.CS_Photo_Total(np.array([z]), inside)[0]


def compton_transfer(z: int, energy: Floats) -> Floats:
    """Mean share of a photon's energy that Compton scattering gives to the electron."""
    grid, shares = _transfer_table(z)
    return np.interp(np.log(energy), grid, shares)


@cache
def _transfer_table(z: int) -> tuple[Floats, Floats]:
    energy = np.geomspace(LOWEST_ENERGY, HIGHEST_ENERGY, 500)
    cosine, weight = np.polynomial.legendre.leggauss(_NODES)
    ratio = 1 / (1 + energy[:, None] / ELECTRON_MASS * (1 - cosine))
    x = energy[:, None] / HC * np.sqrt((1 - cosine) / 2)
    bound = incoherent_function((z,), x.ravel())[0].reshape(x.shape)
    law = bound * ratio**2 * (ratio + 1 / ratio - 1 + cosine**2)
    return np.log(energy), ((1 - ratio) * law) @ weight / (law @ weight)
