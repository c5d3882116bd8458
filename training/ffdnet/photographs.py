"""Make the folder of photographs that `data.COPIED` names, out of four packages.

``python photographs.py --opencv-doc FOLDER --scipy WHEEL --out FOLDER`` takes the unpacked Debian package opencv-doc
(``dpkg-deb -x``) and a wheel of SciPy 1.9, the last with `scipy.misc.face`; PyWavelets and Matplotlib are those installed.
"""

from __future__ import annotations

import argparse
import bz2
import importlib.resources
import io
import shutil
import zipfile
from pathlib import Path

import numpy as np
from PIL import Image

import data


def main() -> None:
    """Read the command line and copy."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--opencv-doc", type=Path, required=True)
    parser.add_argument("--scipy", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    copy_from_packages(options.scipy, options.out)
    examples = options.opencv_doc / "usr" / "share" / "doc" / "opencv-doc" / "examples"
    for name in data.COPIED:
        if not (options.out / name).exists():
            found = next(
                (p for p in sorted(examples.rglob(name)) if p.parent.name in ("data", "text", "input_images")), None
            )
            if found is None:
                raise FileNotFoundError(f"{name} is not in {examples}")
            shutil.copy(found, options.out / name)


def copy_from_packages(scipy: Path, out: Path) -> None:
    """Copy those that are not OpenCV's."""
    with zipfile.ZipFile(scipy) as wheel:
        face = bz2.decompress(wheel.read("scipy/misc/face.dat"))
    Image.fromarray(np.frombuffer(face, np.uint8).reshape(768, 1024, 3)).save(out / "face.png")
    for name in ("aero", "ascent"):
        content = importlib.resources.files("pywt").joinpath("data", f"{name}.npz").read_bytes()
        Image.fromarray(np.load(io.BytesIO(content))["data"].astype(np.uint8)).save(out / f"{name}.png")
    hopper = importlib.resources.files("matplotlib").joinpath("mpl-data", "sample_data", "grace_hopper.jpg")
    (out / "grace_hopper.jpg").write_bytes(hopper.read_bytes())


if __name__ == "__main__":
    main()
