"""What an ordinary picture beside the coded shots brings: ``python benchmarks/side_information.py CUBE...`` prints a table.

Each cube is measured by an SSCSI and a CASSI with one shot and two (of a Boolean code of two), and by a panchromatic and an RGB
camera under light of equal energy, with a signal-to-noise ratio of 30 dB in each part, and reconstructed by EigenTV that knows
the noise.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import shadowgram as sg


def seen(A: sg.LinearOperator, cube: np.ndarray, seed: int) -> tuple[np.ndarray, float]:
    """Snapshots with 30 dB, and the standard deviation of their noise."""
    clean = A.forward(cube)
    return sg.noise.awgn(clean, snr_db=30, seed=seed), float(
        np.sqrt(np.mean(np.square(clean, dtype=np.float64))) / 10**1.5
    )


def rebuilt(H: sg.LinearOperator, picture: sg.LinearOperator | None, cube: np.ndarray) -> float:
    """PSNR of the reconstruction, dB."""
    shots, noise = seen(H, cube, 0)
    if picture is None:
        x = sg.solve(sg.EigenTV(noise=noise), H, shots).x
    else:
        image, image_noise = seen(picture, cube, 1)
        both = sg.operators.stack(H, picture, noise=(noise, image_noise))
        x = sg.solve(sg.EigenTV(noise=1), both, both.join([shots, image])).x
    return sg.metrics.psnr(x, cube, peak=1.0)


def main(paths: list[str]) -> None:
    """Print the table."""
    print("| scene | imager | shots | alone | + panchromatic | + RGB |\n|---|---|---|---|---|---|")
    for path in paths:
        scene = sg.scenes.read(path)
        cube, low, high = scene.values.astype(np.float32), float(scene.wavelength[0]), float(scene.wavelength[-1])
        bands, ny, nx = cube.shape
        rgb = sg.operators.SpectralResponse(
            sg.scenes.rgb_response(scene.wavelength, illuminant="equal-energy"), cube.shape
        )
        pictures = (None, sg.operators.SpectralResponse.pan(cube.shape), rgb)
        imagers = {
            "SSCSI": sg.SSCSI(
                detector_shape=(ny, nx), detector_pitch=10, code_pitch=10, mask_position=bands / nx,
                wavelengths=(low, high), shear="edge",
            ),
            "CASSI": sg.CASSI(cube_shape=cube.shape, wavelengths=(low, high)),
        }  # fmt: skip
        for name, imager in imagers.items():
            code = sg.codes.boolean(shots=2, shape=imager.code_shape, seed=0)
            for shots in (1, 2):
                H = imager.operator(code[:shots])
                found = " | ".join(f"{rebuilt(H, picture, cube):.1f}" for picture in pictures)
                print(f"| {Path(path).stem} | {name} | {shots} | {found} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
