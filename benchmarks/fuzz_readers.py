"""Damage files of every format at random, and read them: nothing may crash, hang, or come back changed in silence.

    python benchmarks/fuzz_readers.py --mutations 2000

Each format's files are changed by bit flips, overwritten runs, truncations, insertions and deletions, half of them in the
first or last kilobyte, where the headers are. Worker processes read the results with `shadowgram.scenes.read`; one that
dies is a crash, one that is silent for too long is a hang, and any exception but ValueError and OSError is an error of the
reader. "contained" counts the refusals where the HDF5 library crashed or ran out of its limits in the process that
`shadowgram` keeps it in. A native file must come back exactly as it was, or be refused; other formats keep no checksum of
everything, so that changed values are counted but allowed. The exit code is 1 if anything was found that must not be.
"""

from __future__ import annotations

import argparse
import faulthandler
import io
import json
import queue
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from pathlib import Path

import numpy as np

FORMATS = ("native", "mat5", "mat73", "npy", "npz", "netcdf")
OUTCOMES = ("refused", "same", "changed", "crash", "hang", "error")


def main() -> int:
    """Run the workers and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mutations", type=int, default=2000, help="how many for each format")
    parser.add_argument("--formats", nargs="+", choices=FORMATS, default=FORMATS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--patience", type=float, default=90.0, help="seconds after which a silent worker hangs")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the table")
    parser.add_argument("--worker", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker is not None:
        work(options.formats[0], options.seed, options.worker, options.mutations)
        return 0
    results = {one: supervise(one, options.seed, options.mutations, options.patience) for one in options.formats}
    if options.json:
        print(json.dumps(results))
    else:
        print_table(results)
    bad = sum(result[what] for result in results.values() for what in ("crash", "hang", "error"))
    return int(bool(bad or results.get("native", {}).get("changed", 0)))


def print_table(results: dict[str, dict]) -> None:
    """One row a format."""
    columns = (*OUTCOMES, "contained")
    print(f"{'format':8}" + "".join(f"{what:>10}" for what in columns) + f"{'slowest':>11}{'total':>9}")
    for name, result in results.items():
        counts = "".join(f"{result[what]:10d}" for what in columns)
        print(f"{name:8}{counts}{result['slowest']:9.2f} s{result['seconds']:7.0f} s")
    for name, result in results.items():
        for note in result["notes"]:
            print(f"{name}: {note}")


def supervise(name: str, seed: int, mutations: int, patience: float) -> dict:
    """Count what becomes of the mutations of one format; a worker that dies or hangs is replaced by another."""
    result: dict = dict.fromkeys((*OUTCOMES, "contained"), 0) | {"slowest": 0.0, "notes": []}
    began, index = time.monotonic(), 0
    while index < mutations:
        arguments = ["--formats", name, "--seed", str(seed), "--worker", str(index), "--mutations", str(mutations)]
        worker = subprocess.Popen(
            [sys.executable, __file__, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        lines: queue.Queue[str] = queue.Queue()
        threading.Thread(target=lambda w=worker, q=lines: [*map(q.put, w.stdout), q.put("")], daemon=True).start()
        fate = "crash"
        while index < mutations:
            try:
                line = lines.get(timeout=patience)
            except queue.Empty:
                fate = "hang"
                break
            if not line:
                break
            outcome, note, seconds = json.loads(line)
            result[outcome] += 1
            result["contained"] += outcome == "refused" and ("crashed on it" in note or "did not finish" in note)
            result["slowest"] = max(result["slowest"], seconds)
            if outcome == "error" or (name == "native" and outcome == "changed"):
                result["notes"].append(f"mutation {index}: {note}")
            index += 1
        worker.kill()
        _, said = worker.communicate()
        if index < mutations:
            result[fate] += 1
            result["notes"].append(f"mutation {index}: {fate} {said[-500:]}")
            index += 1
    return result | {"seconds": time.monotonic() - began}


def work(name: str, seed: int, start: int, stop: int) -> None:
    """Read mutations start, start + 1, ... and print one line of JSON for each."""
    from shadowgram import scenes

    faulthandler.enable()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as folder:
        bases = [Path(folder) / base for base in make_files(name, Path(folder))]
        wholes = [(base, base.read_bytes(), scenes.read(base)) for base in bases]
        for index in range(start, stop):
            base, content, whole = wholes[index % len(wholes)]
            rng = np.random.default_rng([seed, FORMATS.index(name), index])
            damaged = base.with_stem("damaged")
            damaged.write_bytes(mutate(content, rng))
            began = time.monotonic()
            outcome, note = "refused", ""
            try:
                cube = scenes.read(damaged)
                kept = cube.identical(whole.rename(cube.name)) and cube.dtype == whole.dtype
                outcome = "same" if kept else "changed"
            except (ValueError, OSError) as error:
                note = str(error)
            except Exception as error:  # noqa: BLE001  # this is what the script looks for
                outcome, note = "error", repr(error)
            print(json.dumps([outcome, note, time.monotonic() - began]), flush=True)


def mutate(content: bytes, rng: np.random.Generator) -> bytes:
    """A damaged copy, never equal to the original."""
    data = bytearray(content)
    while bytes(data) == content:
        kind = rng.integers(6)
        place = rng.integers(len(data)) if rng.random() < 0.5 else rng.integers(-1024, 1024) % len(data)
        run = int(rng.integers(1, 65))
        if kind == 0:
            for at in (place, *(rng.integers(len(data), size=rng.integers(8)) if rng.random() < 0.5 else ())):
                data[at] ^= 1 << rng.integers(8)
        elif kind == 1:
            data[place : place + run] = rng.bytes(len(data[place : place + run]))
        elif kind == 2:
            data[place : place + run] = rng.choice([b"\0", b"\xff"]) * len(data[place : place + run])
        elif kind == 3:
            del data[place:]
        elif kind == 4:
            data[place:place] = rng.bytes(run)
        else:
            del data[place : place + run]
    return bytes(data)


def make_files(name: str, folder: Path) -> list[str]:
    """Undamaged files of one format, small so that headers are hit often; returns their names."""
    from shadowgram import scenes

    values = np.random.default_rng(1).integers(0, 256, (5, 12, 16)).astype(np.uint8)
    cube = scenes.as_datacube(values / np.float32(255), np.linspace(451, 642, 5), name="scene")
    cube.attrs["note"] = "a text that must not change"
    if name == "native":
        scenes.write(cube, folder / "a.nc")
        return ["a.nc"]
    if name == "mat5":
        return make_mat5(values, folder)
    if name == "mat73":
        return make_mat73(values, folder)
    if name == "npy":
        np.save(folder / "a.npy", values)
        return ["a.npy"]
    if name == "npz":
        scenes.write(cube, folder / "a.npz")
        np.savez_compressed(folder / "b.npz", cube=values, wavelength_nm=np.linspace(451, 642, 5))
        return ["a.npz", "b.npz"]
    cube.to_netcdf(folder / "a.nc", engine="h5netcdf", encoding={"scene": {"zlib": True}})
    return ["a.nc"]


def make_mat5(values: np.ndarray, folder: Path) -> list[str]:
    """Plain and compressed, numbers and texts."""
    from scipy.io import savemat

    contents = {"hyperimg": values.transpose(1, 2, 0), "lambda": np.linspace(451.0, 642.0, 5), "note": "a text"}
    savemat(folder / "a.mat", contents)
    savemat(folder / "b.mat", contents, do_compression=True)
    return ["a.mat", "b.mat"]


def make_mat73(values: np.ndarray, folder: Path) -> list[str]:
    """As MATLAB writes them: a header of 512 bytes, reversed axes, old-style groups; plain and compressed."""
    import h5py

    for name, options in (("a.mat", {}), ("b.mat", {"chunks": (5, 8, 12), "compression": "gzip", "shuffle": True})):
        buffer = io.BytesIO()
        with h5py.File(buffer, "w", userblock_size=512) as file:
            image = file.create_dataset("hyperimg", data=values.transpose(1, 2, 0).T, **options)
            image.attrs["MATLAB_class"] = np.bytes_("uint8")
            centres = file.create_dataset("lambda", data=np.linspace(451.0, 642.0, 5)[:, None])
            centres.attrs["MATLAB_class"] = np.bytes_("double")
        header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
        (folder / name).write_bytes(header.ljust(512, b"\0") + buffer.getvalue()[512:])
    return ["a.mat", "b.mat"]


if __name__ == "__main__":
    sys.exit(main())
