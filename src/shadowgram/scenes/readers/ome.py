"""What the text in a TIFF file says about its pages: OME-XML, JSON, or ImageJ's list; and OME-XML for writing.

Format: OME-TIFF and the OME schema of June 2016, Open Microscopy Environment.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET
from xml.sax.saxutils import quoteattr

import numpy as np

_OME = "http://www.openmicroscopy.org/Schemas/OME/2016-06"
_NM = {"nm": 1.0, "µm": 1000.0, "μm": 1000.0, "um": 1000.0, "Å": 0.1, "pm": 0.001, "mm": 1e6}
_TYPES = {"f4": "float", "f8": "double", "u1": "uint8", "u2": "uint16", "u4": "uint32", "i1": "int8"} | {
    "i2": "int16",
    "i4": "int32",
}
_IN_NAME = re.compile(r"(?<![\d.])(\d+(?:\.\d+)?)\s*nm\b")
_NAME = re.compile(r"[A-Za-z]\w{0,60}", re.ASCII)


@dataclass(frozen=True, kw_only=True)
class Description:
    """Name, number of pages (0: not said), axes beside y and x that are longer than one, wavelengths in nm, remarks."""

    name: str = ""
    planes: int = 0
    stacks: int = 0
    wavelengths: tuple[float, ...] | None = None
    notes: tuple[str, ...] = ()


def describe(text: str) -> Description:
    """What a description says.

    Raises
    ------
    ValueError
        If it is OME-XML that is damaged, or puts the pages in an order of its own.

    Examples
    --------
    >>> from shadowgram.scenes.readers.ome import describe
    >>> describe('{"shape": [2, 8, 8], "wavelength": [450, 650]}').wavelengths
    (450.0, 650.0)
    """
    start = text.lstrip("\ufeff \t\r\n")
    if start.startswith("<") and re.search(r"<(\w+:)?OME\b", start[:2000]):
        return _from_ome(start)
    if start.startswith("{"):
        return _from_json(start)
    if start.startswith("ImageJ="):
        said = re.search(r"^images=(\d{1,9})\s*$", start, re.MULTILINE)
        return Description(planes=int(said[1]) if said else 0)
    return Description()


def _from_json(text: str) -> Description:
    try:
        said = json.loads(text)
    except (ValueError, RecursionError):
        return Description(notes=("its description begins like JSON but is not; it was left out",))
    for name in ("wavelength", "wavelengths", "wavelength_nm"):
        values = said.get(name) if isinstance(said, dict) else None
        if isinstance(values, list) and values and all(type(value) in (int, float) for value in values):
            return Description(wavelengths=tuple(map(float, values)))
    return Description()


def _from_ome(text: str) -> Description:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("its OME description defines entities, which OME does not have; it is damaged")
    try:
        root = ET.fromstring(text)  # noqa: S314 - without entities there is nothing to expand
    except (ET.ParseError, ValueError) as error:
        raise ValueError(f"its OME description is not XML ({error}); it is damaged") from None
    images = [item for item in root if _tag(item) == "Image"]
    pixels = [item for image in images for item in image if _tag(item) == "Pixels"]
    if len(images) != 1 or len(pixels) != 1:
        return Description(notes=(f"its OME description is of {len(images)} images; it was left out",))
    sizes = [_count(pixels[0].get(f"Size{axis}", "1")) for axis in "CZT"]
    _check_order(pixels[0], sizes)
    centres, notes = _wavelengths([item for item in pixels[0] if _tag(item) == "Channel"])
    if centres is not None and len(centres) != sizes[0]:
        raise ValueError(f"its OME description has {sizes[0]} channels and {len(centres)} wavelengths; it is damaged")
    name = images[0].get("Name", "")
    return Description(
        name=name if _NAME.fullmatch(name) else "",
        planes=math.prod(sizes),
        stacks=sum(size > 1 for size in sizes),
        wavelengths=centres,
        notes=notes,
    )


def _tag(item: ET.Element) -> str:
    return item.tag.rpartition("}")[2]


def _count(text: str) -> int:
    if not re.fullmatch(r"[0-9]{1,9}", text) or int(text) < 1:
        raise ValueError(f"its OME description gives {text[:40]!r} as a number of planes; it is damaged")
    return int(text)


def _check_order(pixels: ET.Element, sizes: Sequence[int]) -> None:
    """Refuse pages that do not follow each other as the planes do."""
    for item in pixels:
        firsts = [item.get(f"First{axis}", "0") for axis in "CZT"] if _tag(item) == "TiffData" else []
        if sum(size > 1 for size in sizes) <= 1 and firsts:
            plane = sum(int(first) if re.fullmatch(r"[0-9]{1,9}", first) else -1 for first in firsts)
            if item.get("IFD", str(plane)) != str(plane):
                raise ValueError(
                    "its OME description puts the pages in another order than that of the file; save it anew"
                )


def _wavelengths(channels: list[ET.Element]) -> tuple[tuple[float, ...] | None, tuple[str, ...]]:
    values: list[float] = []
    for channel in channels:
        said, unit = channel.get("EmissionWavelength"), channel.get("EmissionWavelengthUnit", "nm")
        if said is None:
            named = _IN_NAME.search(channel.get("Name", ""))
            if named is None:
                break
            said, unit = named[1], "nm"
        if unit not in _NM:
            return None, (f"its wavelengths are in {unit[:20]!r}, which is not known; they were left out",)
        try:
            values.append(float(said) * _NM[unit])
        except ValueError:
            raise ValueError(f"its OME description gives {said[:40]!r} as a wavelength; it is damaged") from None
    if values and len(values) < len(channels):
        return None, ("its OME description has wavelengths of some channels only; they were left out",)
    return tuple(values) or None, ()


def ome_type(dtype: np.dtype) -> np.dtype:
    """The type in which OME-TIFF keeps values of a type: itself, or the smallest float that holds them."""
    if dtype.str[1:] in _TYPES:
        return dtype
    return np.dtype(np.float64 if dtype.kind in "iu" else np.float32)


def ome_xml(
    shape: tuple[int, int, int], dtype: np.dtype, wavelengths: Sequence[float] | np.ndarray | None, name: str
) -> bytes:
    """ASCII OME-XML of a cube (band, y, x) whose bands are the pages."""
    bands, height, width = shape
    channels = []
    for i in range(bands):
        said = ""
        if wavelengths is not None:
            nm = float(wavelengths[i])
            said = f' Name="{nm:.6g} nm" EmissionWavelength="{nm!r}" EmissionWavelengthUnit="nm"'
        channels.append(f'<Channel ID="Channel:0:{i}" SamplesPerPixel="1"{said}/>')
    text = (
        f'<?xml version="1.0" encoding="UTF-8"?><OME xmlns="{_OME}" '
        'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" '
        f'xsi:schemaLocation="{_OME} {_OME}/ome.xsd" Creator="shadowgram">'
        f'<Image ID="Image:0" Name={quoteattr(name)}><Pixels ID="Pixels:0" DimensionOrder="XYCZT" '
        f'Type="{_TYPES[dtype.str[1:]]}" BigEndian="false" SizeX="{width}" SizeY="{height}" SizeC="{bands}" '
        f'SizeZ="1" SizeT="1">{"".join(channels)}<TiffData IFD="0" PlaneCount="{bands}"/></Pixels></Image></OME>'
    )
    return text.encode("ascii", "xmlcharrefreplace")
