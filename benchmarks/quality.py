"""Reconstruction quality on real datacubes: every imager, GPSR with τ searched against the truth, and EigenTV and EigenPnP as
they come. "searched" is EigenTV with the noise that gives the best PSNR.

    python benchmarks/quality.py FOLDER
    python benchmarks/quality.py FOLDER --snr 30

FOLDER holds `uis_lego/lego.mat` (256 × 256 × 24, taken as 451 to 642 nm) and `cave_toy/cave_toy_left_512x256x31_u16.npz`
(of which 420 to 650 nm; 256 rows from --cave-row on). The same model measures and reconstructs, without noise ("inverse crime"),
as in Salazar (2022), section 2.4; `shadowgram demo` shows what a model error costs. PSNR in dB, peak 1.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import shadowgram as sg
from shadowgram.operators import LinearOperator
from shadowgram.solvers.tau_search import search_tau

TAUS = (1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6)
NOISES = (0.25, 0.5, 0.7, 1.0, 1.4, 2.0)  # times the estimate of the noise
LEGO = (
    ("SSCSI", 1),
    ("SSCSI", 2),
    ("SSCSI", 3),
    ("colored, ideal", 3),
    ("dual disperser", 3),
    ("colored, 4 filters", 3),
    ("CASSI", 3),
    ("SSCSI", 4),
    ("SSCSI", 6),
)
CAVE = (("SSCSI", 1), ("SSCSI", 2), ("SSCSI", 4), ("SSCSI", 6))


def operator(kind: str, shots: int, shear: str) -> LinearOperator:
    """Forward model of one imager for 24 bands of 256 × 256, complementary code, seed 0; for one shot a random one."""
    shape, wavelengths = (24, 256, 256), (450.0, 650.0)
    if kind.startswith("colored"):
        imager = sg.ColoredCASSI(cube_shape=shape, wavelengths=wavelengths)
        filters = "ideal" if kind.endswith("ideal") else "four"
        return imager.operator(sg.codes.colored(shots=shots, shape=shape, filters=filters, seed=0))
    if kind == "SSCSI":
        geometry = {"detector_shape": shape[1:], "detector_pitch": 10.0, "code_pitch": 10.0, "mask_position": 0.09375}
        imager = sg.SSCSI(**geometry, wavelengths=wavelengths, shear=shear)
    elif kind == "CASSI":
        imager = sg.CASSI(cube_shape=shape, wavelengths=wavelengths)
    else:
        imager = sg.DualCASSI(cube_shape=shape, wavelengths=wavelengths)
    make = sg.codes.random if shots == 1 else sg.codes.boolean
    return imager.operator(make(shots=shots, shape=imager.code_shape, seed=0))


def searched(H: LinearOperator, y: np.ndarray, truth: np.ndarray) -> float:
    """PSNR of EigenTV with the best noise."""
    from shadowgram.solvers._noise_level import noise_level

    level = noise_level(H, y)
    specs = [sg.EigenTV(noise=factor * level) for factor in NOISES]
    return max(sg.metrics.psnr(sg.solve(spec, H, y).x, truth, peak=1.0) for spec in specs)


def main() -> None:
    """Print one line for each scene, imager and number of shots."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--shear", default="edge", choices=("exact", "centre", "edge"))
    parser.add_argument("--cave-row", type=int, default=64, help="first of the 256 rows of the CAVE scene")
    parser.add_argument("--snr", type=float, help="noise, dB; by default none")
    options = parser.parse_args()
    lego = sg.scenes.read(
        options.folder / "uis_lego" / "lego.mat", variable="hyperimg", axes="y,x,band", wavelengths=(451, 642)
    )
    cave = sg.scenes.read(
        options.folder / "cave_toy" / "cave_toy_left_512x256x31_u16.npz", variable="cube", axes="y,x,band"
    )
    cave = cave[(cave.wavelength >= 420) & (cave.wavelength <= 650), options.cave_row : options.cave_row + 256]
    print(f"{'scene':5} {'imager':19} shots  GPSR dB  at tau  EigenTV dB  searched  iterations  seconds  EigenPnP dB")
    for name, cube, cases in (("lego", lego, LEGO), ("cave", cave, CAVE)):
        truth = np.ascontiguousarray(cube.values, np.float32)
        for kind, shots in cases:
            H = operator(kind, shots, options.shear)
            y = H.forward(truth)
            if options.snr is not None:
                y = sg.noise.awgn(y, snr_db=options.snr, seed=0)
            _, table = search_tau(
                sg.GPSR(max_iter=600, tol=1e-6), H, y, lambda x, t=truth: sg.metrics.psnr(x, t, peak=1.0), TAUS
            )
            best = max(table, key=lambda trial: trial.score)
            found, denoised = sg.solve(sg.EigenTV(), H, y), sg.solve(sg.EigenPnP(), H, y)
            blind, plugged = (sg.metrics.psnr(one.x, truth, peak=1.0) for one in (found, denoised))
            print(
                f"{name:5} {kind:19} {shots:5} {best.score:8.2f} {best.tau:7.0e} {blind:11.2f} {searched(H, y, truth):9.2f}"
                f" {found.iterations:11d} {found.seconds:8.2f} {plugged:12.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
