"""Damage files of every format at random, and read them: nothing may crash, hang, or come back changed in silence.

    python benchmarks/fuzz_readers.py --mutations 2000

Each format's files are changed by bit flips, overwritten runs, truncations, insertions and deletions, half of them in the
first or last kilobyte, where the headers are, and by other numbers in place of those that are there, in text as in binary.
Of formats with several files (ENVI, folders of pictures and of camera frames) one of them is changed, lost, renamed or
doubled; PNG pictures get right checksums again, mostly. Worker processes read the results with `shadowgram.scenes.read` or
`read_frames`; one that dies is a crash, one that is silent for too long is a hang, and any exception but ValueError and
OSError is an error of the reader. Where the values have no zeros and many come back without a word, they were made up:
"zeros". "contained" counts the refusals where the HDF5 library crashed or ran out of its limits in the process that
`shadowgram` keeps it in. A native file must come back exactly as it was, or be refused; other formats keep no checksum of
everything, so that changed values are counted but allowed. The exit code is 1 if anything was found that must not be.
"""

from __future__ import annotations

import argparse
import faulthandler
import io
import json
import queue
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import warnings
import zlib
from pathlib import Path

import numpy as np

FORMATS = ("native", "mat5", "mat73", "npy", "npz", "netcdf", "envi", "tiff", "png", "frames")
OUTCOMES = ("refused", "same", "changed", "zeros", "crash", "hang", "error")
NUMBERS = (0, 1, 2, 3, 7, 8, 255, 256, 2**15, 2**16 - 1, 2**24, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**64 - 1)
WORDS = (
    "0",
    "-1",
    "1",
    "3",
    "6",
    "7",
    "12",
    "1e9",
    "1000000000000",
    "99999999999999999999",
    "0.5",
    "nan",
    "inf",
    "x",
    "",
)
NO_ZEROS = ("envi", "tiff", "png", "frames")
PLAIN = {ord(character): "_" for character in "/\0\ufffd"}


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
    bad = sum(result[what] for result in results.values() for what in ("zeros", "crash", "hang", "error"))
    return int(bool(bad or results.get("native", {}).get("changed", 0)))


def print_table(results: dict[str, dict]) -> None:
    """One row a format."""
    columns = (*OUTCOMES, "contained")
    print(f"{'format':8}" + "".join(f"{what:>10}" for what in columns) + f"{'slowest':>11}{'memory':>9}{'total':>9}")
    for name, result in results.items():
        counts = "".join(f"{result[what]:10d}" for what in columns)
        print(f"{name:8}{counts}{result['slowest']:9.2f} s{result['megabytes']:6d} MB{result['seconds']:7.0f} s")
    for name, result in results.items():
        for note in result["notes"]:
            print(f"{name}: {note}")


def supervise(name: str, seed: int, mutations: int, patience: float) -> dict:
    """Count what becomes of the mutations of one format; a worker that dies or hangs is replaced by another."""
    result: dict = dict.fromkeys((*OUTCOMES, "contained"), 0) | {"slowest": 0.0, "megabytes": 0, "notes": []}
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
            outcome, note, seconds, megabytes = json.loads(line)
            result[outcome] += 1
            result["contained"] += outcome == "refused" and ("crashed on it" in note or "did not finish" in note)
            result["slowest"] = max(result["slowest"], seconds)
            result["megabytes"] = max(result["megabytes"], megabytes)
            if outcome in ("error", "zeros") or (name == "native" and outcome == "changed"):
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
    faulthandler.enable()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as made, tempfile.TemporaryDirectory() as damaged:
        wholes = [(files, read_values(files[0], name)) for files in make_sets(name, Path(made))]
        for index in range(start, stop):
            files, whole = wholes[index % len(wholes)]
            rng = np.random.default_rng([seed, FORMATS.index(name), index])
            path = damage(files, Path(damaged), rng)
            began = time.monotonic()
            outcome, note = "refused", ""
            try:
                with warnings.catch_warnings(record=True) as said:
                    warnings.simplefilter("always")
                    values = read_values(path, name)
                outcome = "same" if alike(values, whole) else "changed"
                if (
                    name in NO_ZEROS
                    and zeros(values[0]) > zeros(whole[0]) + 64
                    and "were set to 0" not in str([*map(str, said)])
                ):
                    outcome, note = "zeros", f"{zeros(values[0])} of {values[0].size} values are 0"
            except (ValueError, OSError) as error:
                note = str(error)
            except Exception as error:  # noqa: BLE001  # this is what the script looks for
                outcome, note = "error", repr(error)
            seconds, peak = time.monotonic() - began, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
            print(json.dumps([outcome, note, seconds, peak]), flush=True)


def make_sets(name: str, folder: Path) -> list[list[Path]]:
    """What is read, undamaged: each a file or a folder, and after it the files that may be damaged."""
    makers = {"envi": make_envi, "tiff": make_tiff, "png": make_png, "frames": make_frames}
    if name in makers:
        return makers[name](folder)
    return [[folder / base, folder / base] for base in make_files(name, folder)]


def read_values(path: Path, name: str) -> tuple[np.ndarray, ...]:
    """All that comes out of a file: values, wavelengths and attributes, or what `read_frames` gives."""
    from shadowgram import scenes

    if name == "frames":
        found = scenes.read_frames(path)
        return found.snapshots, found.saturated, found.exposures
    cube = scenes.read(path)
    return cube.values, cube.wavelength.values, np.array(repr(sorted(cube.attrs.items())))


def alike(values: tuple[np.ndarray, ...], whole: tuple[np.ndarray, ...]) -> bool:
    """Whether what was read is what was written, with its types."""
    return all(a.dtype == b.dtype and np.array_equal(a, b) for a, b in zip(values, whole, strict=True))


def zeros(values: np.ndarray) -> int:
    """How many values are zero."""
    return int(values.size - np.count_nonzero(values))


def damage(files: list[Path], folder: Path, rng: np.random.Generator) -> Path:
    """A copy of the files in `folder` of which one is damaged, lost or doubled; returns what is to be read."""
    shutil.rmtree(folder)
    read, parts = files[0], files[1:]
    inside = read.is_dir()
    root = folder / "damaged" if inside else folder
    root.mkdir(parents=True)
    for part in parts:
        (root / part.name).write_bytes(part.read_bytes())
    chosen = root / parts[rng.integers(len(parts))].name
    kind = rng.integers(20) if len(parts) > 1 else 99
    if kind == 0:
        chosen.unlink()
    elif kind == 1:
        chosen.rename(
            chosen.with_stem(mutate(chosen.stem.encode(), rng).decode("ascii", "replace").translate(PLAIN)[:40])
        )
    elif kind == 2:
        shutil.copy(chosen, chosen.with_stem(f"{chosen.stem}{rng.integers(20)}"))
    else:
        content = mutate(chosen.read_bytes(), rng)
        # The checksums of PNG would keep every change from what lies behind them.
        chosen.write_bytes(with_checksums(content) if chosen.suffix == ".png" and rng.random() < 0.7 else content)
    return root if inside else root / read.name


def with_checksums(data: bytes) -> bytes:
    """A PNG file with right checksums, as far as its chunks can be told."""
    fixed, at = bytearray(data), 8
    while at + 12 <= len(data):
        end = at + 8 + int.from_bytes(data[at : at + 4], "big")
        if end + 4 > len(data):
            break
        fixed[end : end + 4] = zlib.crc32(data[at + 4 : end]).to_bytes(4, "big")
        at = end + 4
    return bytes(fixed)


def mutate_number(data: bytearray, rng: np.random.Generator) -> None:
    """Put another number in place of one: of digits where there are some, or of 2, 4 or 8 bytes."""
    texts = list(re.finditer(rb"[0-9.]+", bytes(data))) if data[:1].isascii() else []
    if texts and rng.random() < 0.5:
        found = texts[rng.integers(len(texts))]
        data[found.start() : found.end()] = str(rng.choice(WORDS)).encode()
    else:
        width = int(rng.choice([2, 4, 8]))
        at = 2 * int(rng.integers(max(1, len(data) // 2)))
        number = int(NUMBERS[rng.integers(len(NUMBERS))]) % 256**width
        data[at : at + width] = number.to_bytes(width, "little" if rng.random() < 0.7 else "big")


def mutate(content: bytes, rng: np.random.Generator) -> bytes:
    """A damaged copy, never equal to the original."""
    data = bytearray(content)
    while bytes(data) == content:
        kind = rng.integers(8)
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
        elif kind >= 6:
            mutate_number(data, rng)
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


def image(seed: int, shape: tuple[int, ...] = (5, 12, 16), high: int = 256) -> np.ndarray:
    """Whole numbers without zeros, smooth so that they can be compressed."""
    rng = np.random.default_rng(seed)
    ramp = np.add.outer(np.arange(shape[-2]), 2 * np.arange(shape[-1])) % 100 + 1
    return (ramp + rng.integers(0, 20, shape)) * (high // 128)


def make_envi(folder: Path) -> list[list[Path]]:
    """Of our own, and as spectrometers write them: BIL, big-endian, an offset, a scale; given by either file."""
    from shadowgram import scenes

    cube = scenes.as_datacube(image(1) / np.float32(256), np.linspace(451, 642, 5), name="scene")
    scenes.write(cube, folder / "a.hdr")
    (folder / "b.hdr").write_text(
        "ENVI\nsamples = 16\nlines = 12\nbands = 5\nheader offset = 24\ndata type = 12\ninterleave = bil\n"
        "byte order = 1\nreflectance scale factor = 10000\ndata ignore value = 65535\nwavelength units = Micrometers\n"
        "wavelength = {0.451, 0.5, 0.55,\n 0.6, 0.642}\nbbl = {1, 1, 1, 1, 1}\n"
    )
    (folder / "b.img").write_bytes(bytes(range(24)) + image(2).transpose(1, 0, 2).astype(">u2").tobytes())
    files = {ending: folder / ending for ending in ("a.hdr", "a.dat", "b.hdr", "b.img")}
    return [
        [files["a.hdr"], files["a.hdr"], files["a.dat"]],
        [files["a.dat"], files["a.hdr"], files["a.dat"]],
        [files["b.hdr"], files["b.hdr"], files["b.img"]],
        [files["b.img"], files["b.hdr"], files["b.img"]],
    ]


def make_tiff(folder: Path) -> list[list[Path]]:
    """OME-TIFF of our own; BigTIFF in tiles; strips with Deflate, LZW and PackBits; samples of one page."""
    import tifffile
    from PIL import Image

    from shadowgram import scenes

    cube = scenes.as_datacube(image(1) / np.float32(256), np.linspace(451, 642, 5), name="scene")
    scenes.write(cube, folder / "a.ome.tif")
    grey = {"photometric": "minisblack"}
    deep = image(2, high=65536).astype(np.uint16)
    tifffile.imwrite(folder / "b.tif", deep, bigtiff=True, tile=(16, 16), byteorder=">", metadata=None, **grey)
    how = {"compression": "zlib", "predictor": True, "rowsperstrip": 5}
    tifffile.imwrite(folder / "c.tif", deep, **how, **grey, metadata={"wavelength": [451, 500, 550, 600, 642]})
    tifffile.imwrite(folder / "d.tif", deep.transpose(1, 2, 0), planarconfig="contig", metadata=None, **grey)
    pages = [Image.fromarray(page.astype(np.uint8)) for page in image(3)]
    for name, compression in (("e.tif", "tiff_lzw"), ("f.tif", "packbits")):
        pages[0].save(folder / name, save_all=True, append_images=pages[1:], compression=compression)
    return [[folder / name, folder / name] for name in ("a.ome.tif", "b.tif", "c.tif", "d.tif", "e.tif", "f.tif")]


def make_png(folder: Path) -> list[list[Path]]:
    """A folder of our own, and one of 8 bits with every kind of row filter and without wavelengths."""
    from PIL import Image

    from shadowgram import scenes

    scenes.write(scenes.as_datacube(image(1) / np.float32(256), np.linspace(451, 642, 5)), folder / "a")
    (folder / "b_ms").mkdir()
    for i, page in enumerate(image(2, (5, 40, 60)), 1):
        Image.fromarray(page.astype(np.uint8)).save(folder / "b_ms" / f"b_ms_{i:02d}.png")
    return [[folder / name, *sorted((folder / name).iterdir())] for name in ("a", "b_ms")]


def make_frames(folder: Path) -> list[list[Path]]:
    """Folders of camera frames, described in TOML and in JSON, of PNG, TIFF and NumPy files."""
    import tifffile

    from shadowgram.scenes.readers.png import png_bytes

    toml, plain = folder / "toml", folder / "json"
    toml.mkdir()
    plain.mkdir()
    frames = (image(1, (5, 12, 16), 16384) + 500).astype(np.uint16)
    for i, frame in enumerate(frames[:4]):
        (toml / f"shot{i}.png").write_bytes(png_bytes(frame))
        tifffile.imwrite(plain / f"shot{i}.tif", frame, photometric="minisblack", metadata=None)
    for path in (toml, plain):
        np.save(path / "dark.npy", np.full(frames[0].shape, 100, np.uint16))
    (toml / "capture.toml").write_text(
        'exposure = 0.02\nsaturation = 60000\ndark = ["dark.npy"]\n[[shots]]\nframes = ["shot0.png", "shot1.png"]\n'
        '[[shots]]\nframes = ["shot2.png"]\n[[shots]]\nframes = ["shot3.png"]\n'
    )
    shots = [{"frames": [f"shot{i}.tif", f"shot{i + 1}.tif"], "exposure": [0.1, 0.2]} for i in (0, 2)]
    dark = [{"frame": "dark.npy", "exposure": 0.1}, {"frame": "dark.npy", "exposure": 0.2}]
    (plain / "capture.json").write_text(json.dumps({"saturation": 60000, "dark": dark, "shots": shots}))
    return [[path, *sorted(path.iterdir())] for path in (toml, plain)]


if __name__ == "__main__":
    sys.exit(main())
