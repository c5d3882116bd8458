"""Datacubes on the command line: reading, comparing in numbers, and as pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from .arguments import parse_wavelengths

if TYPE_CHECKING:
    from collections.abc import Mapping

    import xarray as xr

    from shadowgram.experiments.quality import Quality


def read_cube(
    path: Path, *, variable: str | None = None, axes: str | None = None, wavelengths: str | None = None
) -> xr.DataArray:
    """Datacube with rising wavelengths from any file that can be read, with the options as they were typed."""
    from shadowgram.scenes import read

    pair = None if wavelengths is None else parse_wavelengths(wavelengths)
    cube = read(path, variable=variable, axes=axes, wavelengths=pair)
    if "wavelength" not in cube.coords:
        raise ValueError(f"{path} does not say the wavelengths of its bands: say --wavelengths first:last in nm")
    return cube[::-1] if cube.sizes["band"] > 1 and cube.wavelength[0] > cube.wavelength[-1] else cube


def quality_lines(quality: Quality) -> list[str]:
    """Quality of a reconstruction, for people."""
    return [
        f"PSNR  {quality.psnr:.2f} dB   (peak {quality.peak:g})",
        f"RMS   {quality.rms:.5g}",
        f"SSIM  {quality.ssim:.4f}   (peak {quality.peak:g})",
        f"SAM   {quality.sam:.4f} rad",
    ]


def side_by_side(cubes: Mapping[str, xr.DataArray], caption: str) -> bytes:
    """PNG of cubes in true colour at the exposure of the first, with a zoom; the caption stands below the last."""
    from shadowgram.figures import images, style
    from shadowgram.scenes import to_rgb
    from shadowgram.scenes.colour import auto_exposure

    exposure = auto_exposure(next(iter(cubes.values())))
    pictures = {name: to_rgb(cube, exposure) for name, cube in cubes.items()}
    first = next(iter(pictures.values()))
    zoom = images.busiest(first, max(1, min(first.shape[:2]) // 5))
    with style.style():
        return style.png(images.gallery(pictures, captions={list(pictures)[-1]: caption}, zoom=zoom))
