"""Reconstruction by strips: seam, peak memory and time.

    python benchmarks/strips.py seam FOLDER                   # strips against the whole, on a cube that fits
    python benchmarks/strips.py run FOLDER --workers 2        # 4096 × 4096 × 48, ten iterations, below 6 GB

`run` makes the capture by rows, reconstructs it, and samples the resident memory of all its processes. The scene is a generated
chart, mirrored over the field, brighter from top to bottom.
"""

from __future__ import annotations

import argparse
import threading
import time
from pathlib import Path

import numpy as np
import psutil

import shadowgram as sg
from shadowgram.experiments.strips import capture_by_rows, reconstruct_strips
from shadowgram.measurement import AWGN, write_measurement
from shadowgram.scenes.readers.native_parts import read_part

TILE = 512
WAVELENGTHS = (450.0, 650.0)
KINDS = ("CASSI", "DualCASSI", "ColoredCASSI", "SSCSI")


class Scene:
    """Rows of a large cube, mirrored copies of a small one, from half to full brightness."""

    def __init__(self, bands: int, size: int) -> None:
        self.size = size
        self.tile = sg.scenes.chart(size=min(TILE, size), bands=bands, seed=0, wavelengths=WAVELENGTHS).values
        self.columns = self._mirrored(np.arange(size))

    def _mirrored(self, places: np.ndarray) -> np.ndarray:
        period = self.tile.shape[1]
        inside = places % (2 * period)
        return np.minimum(inside, 2 * period - 1 - inside)

    def rows(self, start: int, stop: int) -> np.ndarray:
        """(band, stop − start, x) float32."""
        y = np.arange(start, stop)
        brightness = (0.5 + 0.5 * y / self.size).astype(np.float32)
        return self.tile[:, self._mirrored(y)][:, :, self.columns] * brightness[:, None]


class MemoryWatch:
    """Largest resident memory of this process and all its children together, at one time, every 0.1 s."""

    def __enter__(self) -> MemoryWatch:
        self.peak, self._stop = 0, threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _watch(self) -> None:
        me = psutil.Process()
        while not self._stop.wait(0.1):
            total = 0
            for process in (me, *me.children(recursive=True)):
                try:
                    total += process.memory_info().rss
                except psutil.NoSuchProcess:
                    continue
            self.peak = max(self.peak, total)


def imager(kind: str, bands: int, size: int):
    """Imager of a square detector, with the code's pitch."""
    if kind == "SSCSI":
        # Detector-limited, with so many bands that the mask moves by one column from one to the next.
        geometry = {"detector_shape": (size, size), "detector_pitch": 10.0, "code_pitch": 10.0}
        return sg.SSCSI(**geometry, mask_position=bands / size, wavelengths=WAVELENGTHS)
    return getattr(sg, kind)(cube_shape=(bands, size, size), wavelengths=WAVELENGTHS)


def make_code(camera, shots: int) -> np.ndarray:
    """Boolean, or of four filters."""
    if isinstance(camera, sg.ColoredCASSI):
        return sg.codes.colored(shots=shots, shape=camera.code_shape, filters="four", seed=0)
    return sg.codes.boolean(shots=shots, shape=camera.code_shape, seed=0)


def run(options: argparse.Namespace) -> None:
    """Capture, reconstruct, and print what it took."""
    name = f"{options.kind}-{options.size}-{options.bands}-{options.shots}"
    shots, cube = options.folder / f"{name}-shots.nc", options.folder / f"{name}.nc"
    scene, camera = Scene(options.bands, options.size), imager(options.kind, options.bands, options.size)
    with MemoryWatch() as watch:
        if not shots.exists():
            noise = AWGN(snr_db=30, seed=0)
            write_measurement(capture_by_rows(camera, make_code(camera, options.shots), scene.rows, noise=noise), shots)
    print(f"capture: peak {watch.peak / 1e9:.2f} GB", flush=True)
    begun, heard = time.monotonic(), [0]

    def progress(state) -> None:
        if state.done > heard[-1]:
            heard.append(state.done)
            print(f"{state.done} of {state.total} strips, {time.monotonic() - begun:.0f} s", flush=True)

    with MemoryWatch() as watch:
        spec = sg.EigenTV(max_iter=options.max_iter)
        report = reconstruct_strips(
            shots, cube, spec, memory_limit=options.memory * 1e9, workers=options.workers, progress=progress
        )
    processor = psutil.Process().cpu_times()
    print(
        f"{options.kind} {options.size}² × {options.bands}, {options.shots} shots, {options.max_iter} iterations, "
        f"{report.strips} strips of {report.rows} + {2 * report.halo} rows, {options.workers} workers\n"
        f"peak {watch.peak / 1e9:.2f} GB sampled, {report.peak_memory / 1e9:.2f} GB summed over the processes' own peaks\n"
        f"{report.seconds:.0f} s, {report.seconds / report.strips:.0f} s a strip;"
        f" processor time of this process {processor.user + processor.system:.0f} s"
    )
    for row in (options.size // 8, options.size // 2, 7 * options.size // 8):
        found = read_part(cube, {"y": slice(row, row + 8)})
        estimate = next(iter(found.data_vars.values())).values
        truth = scene.rows(row, row + 8)
        print(f"rows from {row}: PSNR {sg.metrics.psnr(estimate, truth, peak=1.0):.2f} dB")


def seam(options: argparse.Namespace) -> None:
    """Strips against the whole, which is one strip and estimates its noise from all rows."""
    folder, size, bands = options.folder, options.size, options.bands
    scene, camera = Scene(bands, size), imager(options.kind, bands, size)
    taken = capture_by_rows(camera, make_code(camera, options.shots), scene.rows, noise=AWGN(snr_db=30, seed=0))
    write_measurement(taken, folder / "shots.nc")
    truth = scene.rows(0, size)
    spec = sg.EigenTV(max_iter=options.max_iter)
    reconstruct_strips(folder / "shots.nc", folder / "whole.nc", spec)
    report = reconstruct_strips(folder / "shots.nc", folder / "strips.nc", spec, rows=options.rows, halo=options.halo)
    whole, parts = (sg.scenes.read(folder / f"{name}.nc").values for name in ("whole", "strips"))
    rms = np.sqrt(np.square(parts - whole, dtype=np.float64).mean(axis=(0, 2)))
    edges = [size * i // report.strips for i in range(1, report.strips)]
    near = np.zeros(size, bool)
    for edge in edges:
        near[edge - options.halo : edge + options.halo] = True
    steps = np.sqrt(np.square(np.diff(parts - whole, axis=1), dtype=np.float64).mean(axis=(0, 2)))  # from row to row
    at_borders = np.array(edges) - 1
    print(
        f"{options.kind} {size}² × {bands}, {options.shots} shots: whole {sg.metrics.psnr(whole, truth, peak=1.0):.3f} dB,"
        f" {report.strips} strips {sg.metrics.psnr(parts, truth, peak=1.0):.3f} dB\n"
        f"RMS of the difference: {rms[near].mean():.2e} where strips overlap, {rms[~near].mean():.2e} elsewhere\n"
        f"RMS of its step from row to row: {steps[at_borders].mean():.2e} at borders,"
        f" {np.delete(steps, at_borders).mean():.2e} elsewhere"
    )
    np.save(folder / "difference.npy", parts - whole)


def main() -> None:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("seam", "run"))
    parser.add_argument("folder", type=Path, help="for captures and results, an existing folder")
    parser.add_argument("--kind", default="CASSI", choices=KINDS)
    parser.add_argument("--size", type=int, help="pixels each way; 4096, or 512 for seam")
    parser.add_argument("--bands", type=int, help="48, or 24 for seam")
    parser.add_argument("--shots", type=int, default=2)
    parser.add_argument("--max-iter", type=int, help="10, or 60 for seam")
    parser.add_argument("--memory", type=float, default=6.0, help="GB")
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--rows", type=int, default=64, help="of a strip; for seam")
    parser.add_argument("--halo", type=int, default=16, help="for seam")
    options = parser.parse_args()
    large = options.what == "run"
    options.size = options.size or (4096 if large else 512)
    options.bands = options.bands or (48 if large else 24)
    options.max_iter = options.max_iter or (10 if large else 60)
    (run if large else seam)(options)


if __name__ == "__main__":
    main()
