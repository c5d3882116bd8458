"""ENVI files: raw values in one file, and a header (`.hdr`) that says how they lie there; a strict reader.

Everything that the header says is checked, and the size of the data file must be exactly what follows from it, before
any memory is taken. Format: "ENVI header files", NV5 Geospatial Software (Harris).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import prod
from pathlib import Path
from typing import Literal

import numpy as np

from .contents import Contents, Variable

MAGIC = b"ENVI"
_LONGEST = 8 * 2**20  # bytes of a header
_TYPES = {1: "u1", 2: "i2", 3: "i4", 4: "f4", 5: "f8", 12: "u2", 13: "u4", 14: "i8", 15: "u8"}
_AXES = {"bsq": ("band", "y", "x"), "bil": ("y", "band", "x"), "bip": ("y", "x", "band")}
_ENDINGS = ("", ".dat", ".img", ".raw", ".bsq", ".bil", ".bip", ".bin", ".cube")
_UNITS = {"nm": 1.0, "nanometer": 1.0, "nanometre": 1.0, "um": 1000.0, "µm": 1000.0, "μm": 1000.0, "micron": 1000.0} | {
    "micrometer": 1000.0,
    "micrometre": 1000.0,
    "angstrom": 0.1,
}
_UNSAID = ("", "unknown", "none", "index")


@dataclass(frozen=True, kw_only=True)
class _Header:
    """What a header says, checked; `shape` is in the order of the file."""

    shape: tuple[int, int, int]
    dims: tuple[str, ...]
    dtype: np.dtype
    offset: int
    bands: int
    scale: float
    ignored: float | None
    wavelengths: tuple[float, ...] | None
    notes: tuple[str, ...]


def header_beside(path: Path) -> Path | None:
    """The ENVI header that belongs to a data file: `a.hdr` or `a.dat.hdr` for `a.dat`."""
    for name in (f"{path.name}.hdr", f"{path.stem}.hdr", f"{path.name}.HDR", f"{path.stem}.HDR"):
        header = path.with_name(name)
        if header != path and header.is_file():
            with header.open("rb") as file:
                if file.read(4) == MAGIC:
                    return header
    return None


def envi_contents(header: Path, data: Path | None = None) -> Contents:
    """The cube of a header and of its data file, which is looked for beside it unless given.

    Raises
    ------
    ValueError
        If the header is damaged or says what is not read, or the data file does not have the size that follows.
    OSError
        If there is no data file.
    """
    said = _checked(_fields(header))
    size = said.offset + prod(said.shape) * said.dtype.itemsize
    data = data or _data_beside(header, size)
    actual = data.stat().st_size
    if actual != size:
        raise ValueError(
            f"its header declares {size} bytes ({' × '.join(map(str, said.shape))} {said.dtype}) but {data.name} has {actual}; "
            "one of them is truncated or damaged"
        )
    contents = Contents({}, list(said.notes))
    dtype = np.dtype(np.float32) if said.scale != 1 and said.dtype.itemsize < 4 else said.dtype
    dtype = np.dtype(np.float64) if said.scale != 1 and dtype.kind != "f" else dtype
    attrs = {} if said.scale == 1 else {"scale": said.scale}
    load = partial(_load, data, said, dtype, contents.notes)
    variables = {data.stem or "cube": Variable(said.shape, dtype, load, said.dims, attrs)}
    if said.wavelengths is not None:
        centres = np.array(said.wavelengths)
        variables["wavelength"] = Variable(centres.shape, centres.dtype, lambda: centres, attrs={"units": "nm"})
    return Contents(variables, contents.notes)


def data_files(header: Path) -> list[Path]:
    """The files beside a header that may be its data."""
    endings = (*_ENDINGS, *(ending.upper() for ending in _ENDINGS if ending))
    names = [f"{header.stem}{ending}" for ending in endings]
    return [header.with_name(name) for name in names if header.with_name(name).is_file()]


def _data_beside(header: Path, size: int) -> Path:
    found = data_files(header)
    if len(found) > 1:
        found = [one for one in found if one.stat().st_size == size]
        if len(found) != 1:
            raise ValueError(
                f"there are several files that may be its data and {len(found)} of the right size; keep one"
            )
    if not found:
        raise FileNotFoundError(f"there is no data file for {header}; it must be beside it, such as {header.stem}.dat")
    return found[0]


def _fields(path: Path) -> dict[str, str]:
    """The header's `name = value` lines; lists in braces may go over several."""
    if path.stat().st_size > _LONGEST:
        raise ValueError("it is too long for an ENVI header")
    data = path.read_bytes()
    if b"\0" in data:
        raise ValueError("its header is not a text; it is damaged")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    first, _, rest = text.partition("\n")
    if first.strip() != "ENVI":
        raise ValueError("its header does not begin with a line ENVI; it is damaged")
    fields: dict[str, str] = {}
    lines = iter(rest.splitlines())
    for line in lines:
        if not line.strip() or line.lstrip().startswith(";"):
            continue
        name, equals, value = line.partition("=")
        name = " ".join(name.lower().split())
        if not equals or not name:
            raise ValueError(f"the line {line.strip()[:60]!r} of its header is not 'name = value'; it is damaged")
        if name in fields:
            raise ValueError(f"its header says '{name[:60]}' twice")
        value = value.strip()
        if value.startswith("{"):
            parts = [value]
            while "}" not in parts[-1]:
                following = next(lines, None)
                if following is None:
                    raise ValueError(f"the list '{name[:60]}' of its header does not end; it is truncated or damaged")
                parts.append(following)
            value = "\n".join(parts).strip()
            if not value.endswith("}"):
                raise ValueError(f"there is something behind the list '{name[:60]}' of its header; it is damaged")
        fields[name] = value
    return fields


def _checked(fields: Mapping[str, str]) -> _Header:
    columns, lines, bands = (_whole(fields, name, low=1) for name in ("samples", "lines", "bands"))
    order = fields.get("interleave", "").lower()
    if order not in _AXES:
        raise ValueError(f"its header must have interleave = bsq, bil or bip, got {order[:40]!r}")
    notes: list[str] = []
    dtype = _dtype(fields, notes)
    if fields.get("file compression", "0") != "0":
        raise ValueError("its data are compressed; save them without compression")
    for name in ("major frame offsets", "minor frame offsets"):
        if any(_numbers(fields, name, None, int)):
            raise ValueError(f"its header says {name}, which are not read; save it without")
    length = {"band": bands, "y": lines, "x": columns}
    bad = _numbers(fields, "bbl", bands, float)
    if any(value == 0 for value in bad):
        which = [str(i) for i, value in enumerate(bad) if value == 0]
        more = ", …" if len(which) > 12 else ""
        notes.append(
            f"{len(which)} of {bands} bands are marked as bad, and kept (numbers {', '.join(which[:12])}{more})"
        )
    return _Header(
        shape=tuple(length[axis] for axis in _AXES[order]),  # pyright: ignore[reportArgumentType]
        dims=_AXES[order],
        dtype=dtype,
        offset=_whole(fields, "header offset", low=0, missing=0),
        bands=bands,
        scale=_scale(fields),
        ignored=_one_number(fields, "data ignore value"),
        wavelengths=_wavelengths(fields, bands, notes),
        notes=tuple(notes),
    )


def _dtype(fields: Mapping[str, str], notes: list[str]) -> np.dtype:
    code = _whole(fields, "data type", low=1)
    if code in (6, 9):
        raise ValueError("it holds complex numbers; save their real part or their magnitude")
    if code not in _TYPES:
        raise ValueError(f"its header must have a data type of {', '.join(map(str, _TYPES))}, got {code}")
    dtype = np.dtype(_TYPES[code])
    if "byte order" not in fields and dtype.itemsize > 1:
        notes.append("its header does not say the byte order: the lowest first (0) was taken")
    order = _whole(fields, "byte order", low=0, missing=0)
    if order not in (0, 1):
        raise ValueError(f"its header must have byte order = 0 or 1, got {order}")
    sign: Literal["<", ">"] = "<" if order == 0 else ">"
    return dtype.newbyteorder(sign)


def _whole(fields: Mapping[str, str], name: str, *, low: int, missing: int | None = None) -> int:
    if name not in fields and missing is not None:
        return missing
    text = fields.get(name, "")
    if not re.fullmatch(r"[+-]?[0-9]{1,15}", text) or int(text) < low:
        raise ValueError(f"its header must have '{name}', a whole number from {low} on, got {text[:40]!r}")
    return int(text)


def _one_number(fields: Mapping[str, str], name: str) -> float | None:
    if name not in fields:
        return None
    try:
        return float(fields[name])
    except ValueError:
        raise ValueError(f"'{name}' in its header must be a number, got {fields[name][:40]!r}") from None


def _scale(fields: Mapping[str, str]) -> float:
    scale = _one_number(fields, "reflectance scale factor")
    if scale is None:
        return 1.0
    if not 1e-30 < scale < 1e30:
        raise ValueError(f"'reflectance scale factor' in its header must be positive and finite, got {scale:g}")
    return scale


def _numbers(fields: Mapping[str, str], name: str, count: int | None, kind: Callable[[str], float]) -> list[float]:
    """The numbers of a list in braces, as many as there are bands; none where it is absent or empty."""
    parts = [part.strip() for part in fields.get(name, "").strip("{} \n\t").split(",")]
    if parts == [""]:
        return []
    try:
        numbers = [kind(part) for part in parts]
    except ValueError:
        raise ValueError(f"'{name}' in its header must be numbers, got {fields[name][:60]!r}") from None
    if count is not None and len(numbers) != count:
        raise ValueError(f"its header has {count} bands but {len(numbers)} numbers in '{name}'; it is damaged")
    return numbers


def _wavelengths(fields: Mapping[str, str], bands: int, notes: list[str]) -> tuple[float, ...] | None:
    """Centres of the bands in nm; None where they are not said, or in units that are no lengths."""
    values = np.array(_numbers(fields, "wavelength", bands, float))
    if not values.size:
        return None
    if not np.isfinite(values).all() or (values <= 0).any():
        raise ValueError("the wavelengths in its header must be positive numbers; it is damaged")
    said = fields.get("wavelength units", "").strip()
    unit = said.lower()
    factor = _UNITS.get(unit, _UNITS.get(unit.removesuffix("s")))
    if factor is None and unit not in _UNSAID:
        notes.append(f"its wavelengths are in {said[:40]!r}, which is not nm or µm; they were left out")
        return None
    if factor is None:
        factor, name = (1.0, "nm") if values.min() >= 100 else (1000.0, "µm")
        notes.append(
            f"its header does not say the unit of the wavelengths: {name} was taken for {values[0]:g} to {values[-1]:g}"
        )
    # Decimal micrometres must not become 450.00000000000006 nm.
    return tuple(float(f"{value:.13g}") for value in values * factor) if factor != 1 else tuple(map(float, values))


def _load(data: Path, said: _Header, dtype: np.dtype, notes: list[str]) -> np.ndarray:
    count = prod(said.shape)
    with data.open("rb") as file:
        file.seek(said.offset)
        values = np.fromfile(file, said.dtype, count)
    if len(values) != count:
        raise ValueError(f"{data.name} became shorter while it was read")
    missing = None
    if said.ignored is not None:
        missing = _is_ignored(values, said.ignored)
    values = values.astype(dtype.newbyteorder("="), copy=False)
    if said.scale != 1:
        values /= dtype.type(said.scale)
    if missing is not None and missing.any():
        values[missing] = 0
        notes.append(
            f"{np.count_nonzero(missing)} of {count} values are marked as missing (data ignore value {said.ignored:g}); "
            "they were set to 0"
        )
    return values.reshape(said.shape)


def _is_ignored(values: np.ndarray, ignored: float) -> np.ndarray:
    if np.isnan(ignored):
        return np.isnan(values)
    with np.errstate(over="ignore"):  # what is written in decimals must meet what was rounded to the type
        return values == (values.dtype.type(ignored) if values.dtype.kind == "f" else np.float64(ignored))


def envi_parts(values: np.ndarray, wavelengths: np.ndarray | None, name: str) -> tuple[np.ndarray, bytes]:
    """What goes into a data file, and its header: a cube (band, y, x) in the order BSQ, the lowest byte first."""
    kept = values.dtype.str[1:] in _TYPES.values()
    stored = np.ascontiguousarray(values, (values.dtype if kept else np.dtype(np.float32)).newbyteorder("<"))
    code = next(code for code, text in _TYPES.items() if text == stored.dtype.str[1:])
    bands, lines, columns = values.shape
    text = [
        "ENVI",
        f"description = {{ {re.sub(r'[{}=]|[^ -~]', '_', name)} }}",
        f"samples = {columns}",
        f"lines = {lines}",
        f"bands = {bands}",
        "header offset = 0",
        "file type = ENVI Standard",
        f"data type = {code}",
        "interleave = bsq",
        "byte order = 0",
    ]
    if wavelengths is not None:
        listed = ",\n ".join(repr(float(nm)) for nm in wavelengths)
        text += ["wavelength units = Nanometers", f"wavelength = {{\n {listed}\n}}"]
    return stored, ("\n".join(text) + "\n").encode("ascii")
