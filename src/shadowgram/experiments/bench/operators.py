"""Cases: forward and adjoint of the imagers, and the basis both ways."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from shadowgram import codes
from shadowgram.operators.base import LinearOperator
from shadowgram.operators.transforms import basis
from shadowgram.spectral.cassi import CASSI
from shadowgram.spectral.colored import ColoredCASSI

from . import work
from .machine import Machine
from .references import BandLoops, EinsumCode, TapLoops, WaveletDCT
from .spec import OURS, PITCH, WAVELENGTHS, BenchSpec, Row, make_row, random_array, sscsi_operator
from .timing import alternate

if TYPE_CHECKING:
    from shadowgram.spectral._sscsi_operator import SSCSIOperator

LOOPS = "NumPy, band by band"
EINSUM = "NumPy einsum"
TRANSFORMS = "PyWavelets + scipy.fft"
NO_WAVELETS = "no reference: PyWavelets is not installed (pip install pywavelets)"


def sscsi_references(effective: np.ndarray) -> dict[str, EinsumCode | BandLoops]:
    """The SSCSI with its effective code (shot, band, y, x) in memory."""
    return {EINSUM: EinsumCode(effective), LOOPS: BandLoops(effective, effective.shape[1], shift=0)}


def operator_cases(spec: BenchSpec, machine: Machine) -> Iterator[Row]:
    """Forward and adjoint of SSCSI (exact, edge, gray), single-shot CASSI (first and higher order) and colored CASSI."""
    for shear, columns in (("exact", 3), ("edge", 2)):
        H = sscsi_operator(spec, spec.size, shear)
        effective = H.imager.effective_code(H.code).astype(np.float32)
        needs = work.sscsi(spec.bands, spec.size, spec.shots, columns)
        yield from _both_ways(f"SSCSI {shear}", H, sscsi_references(effective), needs, spec, machine)
        del effective
    H = gray_operator(spec)
    effective = H.imager.effective_code(H.code).astype(np.float32)
    needs = work.sscsi_gray(spec.bands, spec.size, spec.shots, columns=3)
    yield from _both_ways("SSCSI gray", H, sscsi_references(effective), needs, spec, machine)
    del effective
    yield from _both_ways("CASSI", *cassi_problem(spec), work.cassi(spec.cassi_bands, spec.size, 1), spec, machine)
    exact = cassi_exact_problem(spec)
    yield from _both_ways("CASSI exact", *exact, work.cassi(spec.cassi_bands, spec.size, 1, 3), spec, machine)
    imager = ColoredCASSI(cube_shape=(spec.bands, spec.size, spec.size), wavelengths=WAVELENGTHS, pitch=PITCH)
    code = codes.colored(shots=spec.shots, shape=imager.code_shape, seed=0)
    references = {LOOPS: BandLoops(code.astype(np.float32), spec.bands, shift=1)}
    needs = work.colored(spec.bands, spec.size, spec.shots)
    yield from _both_ways("colored CASSI", imager.operator(code), references, needs, spec, machine)


def gray_operator(spec: BenchSpec) -> SSCSIOperator:
    """SSCSI with a gray code: the kernels that also simulate finely resolved scenes."""
    imager = sscsi_operator(spec, spec.size).imager
    return imager.operator(np.random.default_rng(0).random((spec.shots, *imager.code_shape), dtype=np.float32))


def cassi_code(spec: BenchSpec) -> np.ndarray:
    """Code (1, y, x) of the single-shot CASSI."""
    return codes.random(shots=1, shape=(spec.size, spec.size), seed=0)


def cassi_problem(spec: BenchSpec) -> tuple[LinearOperator, dict[str, BandLoops]]:
    """Single-shot CASSI and its reference."""
    imager = CASSI(cube_shape=(spec.cassi_bands, spec.size, spec.size), wavelengths=WAVELENGTHS, pitch=PITCH)
    code = cassi_code(spec)
    return imager.operator(code), {LOOPS: BandLoops(code[:, None].astype(np.float32), spec.cassi_bands, shift=1)}


def cassi_exact_problem(spec: BenchSpec) -> tuple[LinearOperator, dict[str, TapLoops]]:
    """Single-shot CASSI of higher order and its reference."""
    shape = (spec.cassi_bands, spec.size, spec.size)
    imager = CASSI(cube_shape=shape, wavelengths=WAVELENGTHS, pitch=PITCH, shear="exact")
    code = cassi_code(spec)
    return imager.operator(code), {LOOPS: TapLoops(code[0].astype(np.float32), shape, (0.125, 0.75, 0.125))}


def _both_ways(
    name: str,
    H: LinearOperator,
    references: Mapping[str, EinsumCode | BandLoops | TapLoops],
    needs: work.Work,
    spec: BenchSpec,
    machine: Machine,
) -> Iterator[Row]:
    x, y = random_array(H.in_shape), random_array(H.out_shape)
    snapshots, cube = np.empty_like(y), np.empty_like(x)
    forward = {OURS: lambda: H.forward(x, out=snapshots)}
    forward |= {label: lambda r=r: r.forward(x) for label, r in references.items()}
    yield make_row(f"{name} forward", alternate(forward, spec.seconds), needs, machine)
    adjoint = {OURS: lambda: H.adjoint(y, out=cube)}
    adjoint |= {label: lambda r=r: r.adjoint(y) for label, r in references.items()}
    yield make_row(f"{name} adjoint", alternate(adjoint, spec.seconds), needs, machine)


def basis_cases(spec: BenchSpec, machine: Machine) -> Iterator[Row]:
    """Synthesis and analysis in the sparsifying basis, against PyWavelets and scipy.fft."""
    shape = (spec.bands, spec.size, spec.size)
    psi = basis("dct-sym8", shape)
    z, x = random_array(psi.in_shape), random_array(shape)
    cube, coefficients = np.empty_like(x), np.empty_like(z)
    synthesis = {OURS: lambda: psi.forward(z, out=cube)}
    analysis = {OURS: lambda: psi.adjoint(x, out=coefficients)}
    reference = wavelet_reference(spec)
    if reference is not None and psi.in_shape == shape:
        synthesis[TRANSFORMS] = lambda: reference.synthesis(z)
        analysis[TRANSFORMS] = lambda: reference.analysis(x)
    note = NO_WAVELETS if reference is None else ""
    needs = work.basis(spec.bands, spec.size)
    yield make_row("basis synthesis", alternate(synthesis, spec.seconds), needs, machine, note)
    yield make_row("basis analysis", alternate(analysis, spec.seconds), needs, machine, note)


def wavelet_reference(spec: BenchSpec) -> WaveletDCT | None:
    """The reference of the basis, if PyWavelets is installed."""
    from shadowgram.operators.transforms import default_levels

    shape = (spec.bands, spec.size, spec.size)
    try:
        return WaveletDCT(shape, default_levels(shape))
    except ImportError:
        return None
