"""Tube spectra from SpekPy, kept on the disk once they are computed."""

from __future__ import annotations

import hashlib
import json
import math
import os
from contextlib import suppress
from pathlib import Path

import numpy as np

from shadowgram.scenes.readers.atomic import replace_file

from .spectra import Spectrum

_MODEL = "casim"
_FORMAT = 1  # of the files in the cache
_VOLTAGES = (10.0, 500.0)  # kV, what the model covers
_ANGLES = (1.0, 90.0)  # degrees
_WIDTHS = (0.1, 5.0)  # keV


def bare_tube(voltage: float, anode_angle: float, bin_width: float) -> Spectrum:
    """Spectrum of a tube with a tungsten anode and no filter, photons/cm² per mAs at 1 m.

    Raises
    ------
    ValueError
        If a value is out of range, or SpekPy is not installed.
    """
    _check("the voltage", voltage, _VOLTAGES, "kV")
    _check("the anode angle", anode_angle, _ANGLES, "degrees")
    _check("the width of the energy bins", bin_width, _WIDTHS, "keV")
    try:
        from spekpy import __version__ as version
    except ModuleNotFoundError as error:
        raise ValueError('tube spectra need the package spekpy: pip install "shadowgram[tubes]"') from error
    key = {
        "voltage": float(voltage), "anode_angle": float(anode_angle), "bin_width": float(bin_width),
        "model": _MODEL, "spekpy": version, "format": _FORMAT,
    }  # fmt: skip
    file = _file(key)
    spectrum = None if file is None else _recall(file, key)
    if spectrum is None:
        spectrum = _compute(voltage, anode_angle, bin_width)
        if file is not None:
            _keep(file, key, spectrum)
    return spectrum


def _check(what: str, value: float, limits: tuple[float, float], unit: str) -> None:
    low, high = limits
    if not (isinstance(value, (int, float, np.number)) and math.isfinite(value) and low <= value <= high):
        raise ValueError(f"{what} must be between {low:g} and {high:g} {unit}, got {value!r}")


def _compute(voltage: float, anode_angle: float, bin_width: float) -> Spectrum:
    from spekpy import Spek

    energy, weight = Spek(kvp=voltage, th=anode_angle, dk=bin_width, physics=_MODEL).get_spectrum(diff=False)
    return Spectrum(energy=np.asarray(energy), weight=np.asarray(weight))


def _file(key: dict[str, object]) -> Path | None:
    """Where the cache keeps what this key stands for; None where there is no home."""
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:
        return None
    name = hashlib.sha256(json.dumps(key, sort_keys=True).encode()).hexdigest()[:32]
    return folder / "shadowgram" / f"tube-{name}.json"


def _recall(file: Path, key: dict[str, object]) -> Spectrum | None:
    """What the cache holds, or None if it holds nothing that can be used."""
    try:
        kept = json.loads(file.read_text(encoding="utf-8"))
        if kept["key"] == key:
            return Spectrum(energy=np.array(kept["energy"]), weight=np.array(kept["weight"]))
    except (OSError, ValueError, TypeError, KeyError):
        pass
    return None


def _keep(file: Path, key: dict[str, object], spectrum: Spectrum) -> None:
    text = json.dumps({"key": key, "energy": spectrum.energy.tolist(), "weight": spectrum.weight.tolist()})
    # A cache that cannot be written costs a second the next time, and nothing else.
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        replace_file(file, [text.encode()])
