"""Coded apertures as their makers take them: GDSII for mask shops, SVG for film plotters and lasers, frames for a DMD.

Elements are merged into rectangles: runs along x, and equal runs of successive rows in one. Their corners are whole
nanometres, so that neighbours share edges exactly; rectangles do not overlap. Row 0 of a code is at the top and x runs to
the right, as in a picture.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Literal

import numpy as np

from ._rectangles import rectangles
from .patterns import check_code

if TYPE_CHECKING:
    import gdstk

Polarity = Literal["open", "chrome"]

LAYER = 1  # of everything that is to be written
_TIME = datetime(2000, 1, 1)  # the same code gives the same file, whenever and wherever it is made
_LARGEST = 2**31 - 1  # nm; GDSII coordinates have 32 bits, and gdstk does not say when they overflow
_END = b"\x00\x04\x04\x00"  # the record ENDLIB
_LEAST_GAP = 40.0  # µm; the bars of the crosses, a twentieth of the gap, are then 2 µm wide


def write_gds(
    code: np.ndarray,
    path: str | os.PathLike[str],
    *,
    pitch: float,
    polarity: Polarity = "open",
    bias: float = 0.0,
    gap: float = 1000.0,
    columns: int | None = None,
    marks: bool = True,
    title: str | None = None,
) -> None:
    """Write the shots of a binary code side by side on one photomask, as a GDSII file, in place of what is there, all or nothing.

    Cell ``MASK`` holds cells ``SHOT_1``, ``SHOT_2``..., the first at the left, or at the upper left of several rows, and is
    centred on the origin; the origin of a shot's cell is its lower left corner. Everything is on layer 1. The user unit is
    1 µm, the database unit 1 nm.

    Parameters
    ----------
    code : (shot, y, x) or (y, x) of 0 and 1, 1 = open.
    path : the file.
    pitch : side of an element, µm; a whole number of nm.
    polarity : what the polygons are. ``"open"``: clear areas, all the rest is chrome (to a mask shop: dark field, drawn is
        clear). ``"chrome"``: closed elements, all the rest is clear, also around the shots (clear field, drawn is dark).
    bias : µm by which every edge of the open areas moves inwards, less than half of `pitch`. Open elements that only meet at
        a corner come apart, and closed ones that do so join.
    gap : µm between shots. The marks scale with it.
    columns : number of shots in a row; by default all are in one.
    marks : draw a cross off each corner of the whole, the number of each shot below it, and the title at the lower left, as
        the polygons of the code are: clear on chrome or chrome on clear.
    title : printable ASCII; by default the size of the code, as in ``6 x 256 x 256, 10 um``.

    Raises
    ------
    ValueError
        If the code is not binary, a length is out of range or not a whole number of nm, the mask is larger than GDSII can
        say, or the package gdstk is missing (``pip install 'shadowgram[layout]'``).
    OSError
        If the file cannot be written; what was there before stays.

    Notes
    -----
    For chrome around the shots of a ``"chrome"`` mask pad the code with closed elements, as with ``numpy.pad``. Which side of the
    plate carries the pattern is for the order to say; ``code[..., ::-1]`` is its mirror image.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import shadowgram as sg
    >>> from shadowgram.codes.layout import write_gds
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "mask.gds"
    >>> write_gds(sg.codes.boolean(shots=3, shape=(64, 64), seed=0), path, pitch=10.0, bias=0.5)
    >>> import gdstk
    >>> [cell.name for cell in gdstk.read_gds(path).cells]
    ['MASK', 'SHOT_1', 'SHOT_2', 'SHOT_3']
    """
    from shadowgram.scenes.readers.atomic import replace_file

    code, side = check_binary(code), _nanometres("pitch", pitch)
    columns = len(code) if columns is None else columns
    if not (isinstance(columns, int | np.integer) and columns >= 1):
        raise ValueError(f"columns must be a whole number of at least 1, got {columns!r}")
    if marks and not gap >= _LEAST_GAP:
        raise ValueError(
            f"marks need a gap of at least {_LEAST_GAP:g} µm, got {gap}; make it wider, or leave the marks out"
        )
    spacing = _nanometres("gap", gap)
    if title is None:
        title = f"{' x '.join(map(str, code.shape))}, {_decimal(side)} um"
    if not (title.isascii() and title.isprintable()):
        raise ValueError(f"the title must be of printable ASCII characters, got {title!r}")
    shots = [_drawn(shot, side, bias, polarity) for shot in code]
    height, width = (n * side for n in code.shape[1:])
    plate = _Plate(shots=len(code), columns=min(columns, len(code)), height=height, width=width, gap=spacing)
    replace_file(path, [_gds_file(shots, plate, title if marks else None)])


def write_svg(
    code: np.ndarray,
    path: str | os.PathLike[str],
    *,
    pitch: float,
    shot: int = 0,
    polarity: Polarity = "open",
    bias: float = 0.0,
) -> None:
    """Write one shot of a binary code as an SVG file in its true size, in place of what is there, all or nothing.

    The units of the coordinates are µm. The file looks like the mask against the light. All rectangles are one path,
    which viewers draw without smoothing, so that no seams appear between them.

    Parameters
    ----------
    code : (shot, y, x) or (y, x) of 0 and 1, 1 = open.
    path : the file.
    pitch : side of an element, µm; a whole number of nm.
    shot : number of the shot, from 0.
    polarity : what the path is. ``"open"``: the open areas, white on a black rectangle of the size of the code; ``"chrome"``: the
        closed areas, black on nothing, as a film plotter wants it.
    bias : µm by which every edge of the open areas moves inwards, less than half of `pitch`.

    Raises
    ------
    ValueError
        If the code is not binary, there is no such shot, or a length is out of range or not a whole number of nm.
    OSError
        If the file cannot be written; what was there before stays.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import shadowgram as sg
    >>> from shadowgram.codes.layout import write_svg
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "mask.svg"
    >>> write_svg(sg.codes.random(shots=2, shape=(64, 96), seed=0), path, pitch=10.0, shot=1)
    >>> path.read_text().splitlines()[0]
    '<svg xmlns="http://www.w3.org/2000/svg" width="0.96mm" height="0.64mm" viewBox="0 0 960 640">'
    """
    from shadowgram.scenes.readers.atomic import replace_file

    code, side = check_binary(code), _nanometres("pitch", pitch)
    if not (isinstance(shot, int | np.integer) and 0 <= shot < len(code)):
        raise ValueError(f"shot must be a number from 0 to {len(code) - 1}, got {shot!r}")
    path_data = _path(_drawn(code[shot], side, bias, polarity))
    rows, columns = code.shape[1:]
    width, height = columns * side, rows * side
    ground = f'<rect id="chrome" width="{_decimal(width)}" height="{_decimal(height)}" fill="#000"/>\n'
    text = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_decimal(width, 6)}mm" height="{_decimal(height, 6)}mm" '
        f'viewBox="0 0 {_decimal(width)} {_decimal(height)}">\n'
        f"<title>Shot {shot + 1} of {len(code)}, {rows} × {columns} elements of {_decimal(side)} µm</title>\n"
        f"{ground if polarity == 'open' else ''}"
        f'<path id="{polarity}" shape-rendering="crispEdges" fill="{"#fff" if polarity == "open" else "#000"}" '
        f'd="{path_data}"/>\n'
        "</svg>\n"
    )
    replace_file(path, [text.encode()])


def dmd_frames(
    code: np.ndarray, *, frame: tuple[int, int] = (1080, 1920), mirrors: int = 1, offset: tuple[int, int] = (0, 0)
) -> np.ndarray:
    """Patterns for a digital micromirror device: each element of a binary code as a square of mirrors, amid mirrors that are off.

    Parameters
    ----------
    code : (shot, y, x) or (y, x) of 0 and 1, 1 = open.
    frame : (y, x) mirrors of the device, which lie in rows and columns.
    mirrors : along a side of an element.
    offset : (y, x) mirrors by which the code is moved from the centre, down and to the right. Where it cannot be centred
        exactly, it lies half a mirror further up or left.

    Returns
    -------
    (shot, y, x) bool array of the size of `frame`, True = on.

    Raises
    ------
    ValueError
        If the code is not binary, or does not fit.

    Examples
    --------
    >>> import shadowgram as sg
    >>> from shadowgram.codes.layout import dmd_frames
    >>> frames = dmd_frames(sg.codes.boolean(shots=2, shape=(256, 256), seed=0), mirrors=4)
    >>> frames.shape, int(frames[0].sum())
    ((2, 1080, 1920), 524288)
    """
    code = check_binary(code)
    if not (isinstance(mirrors, int | np.integer) and mirrors >= 1):
        raise ValueError(f"mirrors must be a whole number of at least 1, got {mirrors!r}")
    height, width = _pair("frame", frame)
    down, right = _pair("offset", offset)
    rows, columns = (int(n) * int(mirrors) for n in code.shape[1:])
    top, left = (height - rows) // 2 + down, (width - columns) // 2 + right
    if not (0 <= top <= height - rows and 0 <= left <= width - columns):
        moved = f" that are moved by {down} down and {right} right" if down or right else ""
        raise ValueError(
            f"the code takes {rows} × {columns} mirrors{moved}, which do not fit on {height} × {width}; "
            "use fewer mirrors an element, a smaller offset or a smaller code"
        )
    frames = np.zeros((len(code), height, width), dtype=bool)
    frames[:, top : top + rows, left : left + columns] = code.repeat(mirrors, axis=1).repeat(mirrors, axis=2)
    return frames


def corner_contacts(code: np.ndarray) -> int:
    """Count the corners where two open elements meet that share no edge, in all shots; a process may join or part them.

    Parameters
    ----------
    code : (shot, y, x) or (y, x) of 0 and 1, 1 = open.

    Raises
    ------
    ValueError
        If the code is not binary.

    Examples
    --------
    >>> from shadowgram.codes.layout import corner_contacts
    >>> corner_contacts([[1, 0, 0], [0, 1, 0], [1, 1, 1]])
    1
    """
    code = check_binary(code)
    falling = code[:, :-1, :-1] & code[:, 1:, 1:] & ~(code[:, :-1, 1:] | code[:, 1:, :-1])
    rising = code[:, :-1, 1:] & code[:, 1:, :-1] & ~(code[:, :-1, :-1] | code[:, 1:, 1:])
    return int(falling.sum() + rising.sum())


def check_binary(code: np.ndarray) -> np.ndarray:
    """Return a code that can be made of open and closed elements, with a leading shot axis, or say what is wrong with it.

    Parameters
    ----------
    code : (shot, y, x) or (y, x) of 0 and 1, 1 = open.

    Returns
    -------
    (shot, y, x) bool array.

    Raises
    ------
    ValueError
        If the code has other axes or other values.

    Examples
    --------
    >>> from shadowgram.codes.layout import check_binary
    >>> check_binary([[0, 1], [1, 0]]).shape
    (1, 2, 2)
    """
    code = np.asarray(code)
    if code.ndim not in (2, 3) or not code.size:
        hint = "; a colored code is made of filters, not of open and closed elements" if code.ndim == 4 else ""
        raise ValueError(f"the code must have the shape (shot, y, x) or (y, x), got {code.shape}{hint}")
    code = check_code(code, code.shape[-2:])
    if code.dtype != np.uint8:
        gray = code[(code > 0) & (code < 1)][0]
        raise ValueError(
            f"the code must be binary, every element 0 (closed) or 1 (open), got a transmittance of {gray:g}; "
            "make it binary first, as with code > 0.5"
        )
    return code.astype(bool)


def _pair(name: str, pair: tuple[int, int]) -> tuple[int, int]:
    if not (len(pair) == 2 and all(isinstance(n, int | np.integer) for n in pair)):
        raise ValueError(f"{name} must be two whole numbers, (y, x) mirrors, got {pair!r}")
    return int(pair[0]), int(pair[1])


def _nanometres(name: str, length: float) -> int:
    """A positive length in µm as a whole number of nm."""
    if not 0 < length <= _LARGEST / 1000:
        raise ValueError(f"{name} must be a positive length in µm, below {_LARGEST / 1e9:.3g} m, got {length}")
    nm = round(length * 1000)
    if nm < 1 or abs(length * 1000 - nm) > 1e-6:
        raise ValueError(f"{name} must be a whole number of nm, got {length} µm; {max(nm, 1) / 1000:g} is the nearest")
    return nm


def _drawn(shot: np.ndarray, side: int, bias: float, polarity: str) -> np.ndarray:
    """Rectangles of a shot, after a check of what the caller said."""
    if polarity not in ("open", "chrome"):
        raise ValueError(f'polarity must be "open" or "chrome", got {polarity!r}')
    edge = _nanometres("bias", bias) if bias else 0
    if 2 * edge >= side:
        raise ValueError(f"bias must be less than half of the pitch, {side / 2000:g} µm, got {bias}")
    return rectangles(shot, side, edge, closed=polarity == "chrome")


@dataclass(frozen=True, kw_only=True)
class _Plate:
    """Where the shots of a photomask lie, in nm, x to the right and y up from the centre of all."""

    shots: int
    columns: int
    height: int
    width: int
    gap: int

    @property
    def rows(self) -> int:
        return -(-self.shots // self.columns)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of all shots with the gaps between them."""
        height = self.rows * (self.height + self.gap) - self.gap
        return height, self.columns * (self.width + self.gap) - self.gap

    @property
    def corner(self) -> tuple[int, int]:
        """The lower left corner (x, y)."""
        height, width = self.size
        return -(width // 2), -(height // 2)

    def place(self, shot: int) -> tuple[int, int]:
        """The lower left corner (x, y) of a shot."""
        row, column = divmod(shot, self.columns)
        x, y = self.corner
        return x + column * (self.width + self.gap), y + (self.rows - 1 - row) * (self.height + self.gap)


def _gds_file(shots: list[np.ndarray], plate: _Plate, title: str | None) -> bytes:
    """The bytes of the file."""
    gdstk = _gdstk()
    library = gdstk.Library("shadowgram", unit=1e-6, precision=1e-9)
    mask = library.new_cell("MASK")
    for number, drawn in enumerate(shots):
        cell = library.new_cell(f"SHOT_{number + 1}")
        for top, bottom, left, right in drawn.tolist():
            lower, upper = _microns(left, plate.height - bottom), _microns(right, plate.height - top)
            cell.add(gdstk.rectangle(lower, upper, LAYER))
        mask.add(gdstk.Reference(cell, _microns(*plate.place(number))))
    if title is not None:
        mask.add(*_marks(plate, title))
    _check_extent(mask, plate)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "mask.gds"
        library.write_gds(file, timestamp=_TIME)
        data = file.read_bytes()
    if not data.endswith(_END):  # gdstk does not say when the disk is full
        raise OSError(f"there is no room for temporary files in {tempfile.gettempdir()}; nothing was written")
    return data


def _gdstk() -> ModuleType:
    try:
        import gdstk
    except ImportError as error:
        raise ValueError("GDSII files need the package gdstk: pip install 'shadowgram[layout]'") from error
    return gdstk


def _marks(plate: _Plate, title: str) -> list[gdstk.Polygon]:
    """Crosses off the corners of the whole, the number of each shot, and the title."""
    gdstk = _gdstk()
    (height, width), (left, bottom), gap = plate.size, plate.corner, plate.gap
    # The font is drawn on 16 steps a height: whole nanometres again.
    letter = gap // 4 // 16 * 16
    arm, bar = gap // 4, gap // 40
    marks = [
        gdstk.cross(_microns(x, y), 2 * arm / 1000, 2 * bar / 1000, LAYER)
        for x in (left - gap // 2, left + width + gap // 2)
        for y in (bottom - gap // 2, bottom + height + gap // 2)
    ]
    for shot in range(plate.shots):
        x, y = plate.place(shot)
        number = str(shot + 1)
        start = x + (plate.width - len(number) * letter * 9 // 16) // 2  # a letter takes 9/16 of its height
        marks += gdstk.text(number, letter / 1000, _microns(start, y - gap // 2), layer=LAYER)
    return marks + gdstk.text(title, letter / 1000, _microns(left, bottom - gap - letter), layer=LAYER)


def _microns(x: int, y: int) -> tuple[float, float]:
    return x / 1000, y / 1000


def _check_extent(mask: gdstk.Cell, plate: _Plate) -> None:
    """Raise if a coordinate would not fit."""
    box = mask.bounding_box() or ((0.0, 0.0), (0.0, 0.0))
    largest = max(plate.width, plate.height, *(abs(1000 * value) for corner in box for value in corner))
    if largest > _LARGEST:
        raise ValueError(
            f"a GDSII file of 1 nm ends at {_LARGEST / 1e9:.3f} m from its centre, the mask at {largest / 1e9:.3f} m; "
            "use a smaller pitch or gap"
        )


def _path(drawn: np.ndarray) -> str:
    """Path data of rectangles in nm, in µm."""
    return "".join(
        f"M{_decimal(left)} {_decimal(top)}h{_decimal(right - left)}v{_decimal(bottom - top)}h{_decimal(left - right)}z"
        for top, bottom, left, right in drawn.tolist()
    )


def _decimal(nm: int, places: int = 3) -> str:
    """A length in nm as a plain number of units of 10^places nm, exact."""
    sign, whole, rest = "-" * (nm < 0), *divmod(abs(nm), 10**places)
    return f"{sign}{whole}.{rest:0{places}d}".rstrip("0").rstrip(".")
