"""What a scanner and its scene are: source, mask, solids and detectors, in a TOML file or made in Python.

Lengths are mm, energies keV, angles rad, times s. x is the axis along which a mask slides, y points up, and the source usually
looks along z. Where solids overlap the later one counts: first comes the world, then the mask, the solids in their order, and the
detectors.
"""

from __future__ import annotations

import os
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, ValidationError, model_validator

from ._parts import Composition as Composition
from ._parts import Count, File, Lengths, MadeOf, Part, Positive, Vector, in_words, plain
from ._solids import Box as Box
from ._solids import Cylinder as Cylinder
from ._solids import Detector as Detector
from ._solids import Ellipsoid as Ellipsoid
from ._solids import Mesh as Mesh
from ._solids import Outline as Outline
from ._solids import Solid as Solid
from ._solids import Voxels as Voxels
from ._source import Energies as Energies
from ._source import Source as Source
from ._source import Tube as Tube
from .montecarlo.arrays import HIGHEST_ENERGY, LOWEST_ENERGY
from .patterns import Pattern as PatternArray
from .patterns import random_pattern, read_pattern, read_written, written

_MOST_DETECTORS = 48  # a photon's record has a bit for each in a float64
_LARGEST_FILE = 20_000_000  # bytes
_OWN_NAMES = ("world", "mask")
_TALLIES = ("all", "deposited", "dose", "energy", "escaped")


class World(Part):
    """The box in which everything happens; what leaves it is gone.

    Attributes
    ----------
    size : full lengths, mm.
    centre : mm.
    material : what fills it, and the holes of a mask; "vacuum" for nothing.
    """

    size: Lengths
    centre: Vector = (0.0, 0.0, 0.0)
    material: MadeOf = Composition(name="air")


class Pattern(Part):
    """Which cells of a mask are holes, said in one of three ways; in Python an array (row, column) will do.

    Attributes
    ----------
    transmittance, seed : at random, each a hole with this probability.
    file : an array or a picture, see `shadowgram.xray.patterns.read_pattern`.
    rows : a text of 0 and 1 for each row, 1 = hole.
    """

    transmittance: Annotated[float, Field(gt=0, le=1)] | None = None
    seed: Annotated[int, Field(ge=0)] | None = None
    file: File | None = None
    rows: Annotated[tuple[str, ...], Field(strict=False, min_length=1)] | None = None

    @model_validator(mode="after")
    def _one_way(self) -> Pattern:
        if (self.transmittance, self.file, self.rows).count(None) != 2:
            raise ValueError("say the pattern in one way: transmittance and seed, file, or rows")
        if (self.transmittance is None) != (self.seed is None):
            raise ValueError("a random pattern has a transmittance and a seed")
        if self.rows is not None:
            read_written(self.rows)
        return self

    def cells(self, rows: int, columns: int) -> PatternArray:
        """(row, column) uint8, 1 = hole.

        Raises
        ------
        OSError
            If the file cannot be read.
        ValueError
            If it holds no pattern, or the pattern is not of this size.
        """
        if self.transmittance is not None:
            return random_pattern(rows, columns, self.transmittance, self.seed or 0)
        found = read_pattern(self.file) if self.file is not None else read_written(self.rows or ())
        if found.shape != (rows, columns):
            raise ValueError(
                f"the mask has {rows} rows and {columns} columns, but its pattern {found.shape[0]} and {found.shape[1]}"
            )
        return found


def _pattern(value: Any) -> Any:
    return {"rows": list(written(value))} if isinstance(value, list | tuple) else value


class Mask(Part):
    """A coded mask: a plate across z with a strip of square cells in its middle, some of them holes. It slides a pitch per shot.

    Attributes
    ----------
    material : of the plate; the holes are filled with the world's.
    position : mm, centre of the field, which stays where it is. In shot q the columns q to q + view − 1 are centred on it.
    pitch : of the cells, mm.
    depth : of the plate along z, mm.
    rows, columns : of the whole strip.
    view : columns in the field; all unless said, and then the mask does not slide.
    plate : width along x and height along y of the plate, mm.
    pattern : see `Pattern`.
    column_direction : 1 if columns are counted along x, −1 if against it.
    row_direction : −1 if rows are counted down (against y, as in a picture), 1 if up.

    Examples
    --------
    >>> from shadowgram.xray.scene import Mask
    >>> mask = Mask(material="tungsten", pitch=2, depth=2, rows=32, columns=543, view=32, plate=(1100, 70),
    ...             pattern={"transmittance": 0.1, "seed": 0})
    >>> mask.most_shots, mask.plate_centre(0), mask.plate_centre(511)
    (512, (511.0, 0.0, 0.0), (-511.0, 0.0, 0.0))
    """

    material: MadeOf
    position: Vector = (0.0, 0.0, 0.0)
    pitch: Positive
    depth: Positive
    rows: Count
    columns: Count
    view: Count | None = None
    plate: Annotated[tuple[Positive, Positive], Field(strict=False)]
    pattern: Annotated[Pattern, BeforeValidator(_pattern)]
    column_direction: Literal[1, -1] = 1
    row_direction: Literal[1, -1] = -1

    @model_validator(mode="after")
    def _fits(self) -> Mask:
        width, height = self.columns * self.pitch, self.rows * self.pitch
        if width > self.plate[0] or height > self.plate[1]:
            raise ValueError(
                f"{self.columns} × {self.rows} cells of {self.pitch:g} mm take {width:g} × {height:g} mm, more than the plate's"
                f" {self.plate[0]:g} × {self.plate[1]:g} mm"
            )
        if self.columns_in_view > self.columns:
            raise ValueError(f"{self.view} columns cannot be in view of a mask that has {self.columns}")
        if self.pattern.file is None:
            self.cells()
        return self

    @property
    def columns_in_view(self) -> int:
        """Columns in the field."""
        return self.columns if self.view is None else self.view

    @property
    def most_shots(self) -> int:
        """Shots until the strip has gone through the field."""
        return self.columns - self.columns_in_view + 1

    def cells(self) -> PatternArray:
        """(row, column) uint8 of the whole strip, 1 = hole."""
        return self.pattern.cells(self.rows, self.columns)

    def code(self, shot: int) -> PatternArray:
        """(row, column) uint8 of what is in the field in a shot."""
        return self.cells()[:, shot : shot + self.columns_in_view]

    def plate_centre(self, shot: int) -> tuple[float, float, float]:
        """Where the centre of the plate is in a shot, mm."""
        x, y, z = self.position
        ahead = self.columns / 2 - self.columns_in_view / 2 - shot
        return x + self.column_direction * self.pitch * ahead, y, z


class Scene(Part):
    """A scanner and what it looks at.

    Attributes
    ----------
    title : a line.
    world, source, mask, solids, detectors : see `World`, `Source`, `Mask`, `Solid` and `Detector`.
    shots : how many are taken, the mask sliding by a column after each.
    exposure : s, of a shot.
    cutoff : keV below which a photon is absorbed where it is.
    fluorescence : whether atoms emit their lines after a photoelectric absorption, as they do; false to compare with programs
        that leave it out.

    Raises
    ------
    ValueError
        If something in it cannot be, said in a line. Files are not looked at before `compile_scene` needs them.

    Examples
    --------
    >>> from shadowgram.xray.scene import Box, Scene, Solid, Source, World
    >>> scene = Scene(
    ...     world=World(size=(1000, 1000, 1000), material="vacuum"),
    ...     source=Source(position=(0, 0, -100), spectrum={"energy": 60}, activity=1e6),
    ...     solids=[Solid(name="slab", role="target", material="water", shape=Box(centre=(0, 0, 5), size=(100, 100, 10)))],
    ... )
    >>> scene == parse_scene(scene.toml())
    True
    """

    title: str = ""
    shots: Count = 1
    exposure: Positive = 1.0
    cutoff: Annotated[float, Field(ge=LOWEST_ENERGY, lt=HIGHEST_ENERGY)] = 1.0
    fluorescence: bool = True
    world: World
    source: Source
    mask: Mask | None = None
    solids: Annotated[tuple[Solid, ...], Field(strict=False)] = ()
    detectors: Annotated[tuple[Detector, ...], Field(strict=False, max_length=_MOST_DETECTORS)] = ()

    @model_validator(mode="after")
    def _possible(self) -> Scene:
        from ._layout import check_layout

        self._check_names()
        if self.shots > (self.mask.most_shots if self.mask else 1):
            what = (
                f"a mask of {self.mask.columns} columns, {self.mask.columns_in_view} in view,"
                if self.mask
                else "no mask"
            )
            most = f"{self.mask.most_shots} shots at most" if self.mask else "one shot only"
            raise ValueError(f"{self.shots} shots cannot be taken: with {what} there can be {most}")
        check_layout(self)
        return self

    def _check_names(self) -> None:
        seen: set[str] = set(_OWN_NAMES)
        for part in (*self.solids, *self.detectors):
            if part.name in seen:
                raise ValueError(f"the name {part.name!r} is taken; give every solid and detector one of its own")
            seen.add(part.name)
        for detector in self.detectors:
            if detector.name in _TALLIES:
                raise ValueError(f"a detector cannot be called {detector.name!r}, which is the name of another result")

    @property
    def photons_per_shot(self) -> float:
        """Photons that the source sends into its cone in a shot."""
        return self.source.photons_per_second * self.exposure

    def without_targets(self) -> Scene:
        """The same scene with nothing to look at, whose counts are the background."""
        return self.model_copy(update={"solids": tuple(solid for solid in self.solids if solid.role != "target")})

    def toml(self) -> str:
        """The whole scene, with all that was left to its default, as a TOML file; `parse_scene` gives an equal scene back.

        Names of files are absolute.
        """
        from ._toml import to_toml

        return to_toml(_compact(self.model_dump(exclude_none=True)))


def _compact(value: Any) -> Any:
    """Materials that are only a name as this name, and nothing that is empty."""
    if isinstance(value, dict):
        kept = {name: _compact(one) for name, one in value.items() if one not in ((), {}, "")}
        for key in kept.keys() & {"material"}:
            kept[key] = _name_alone(kept[key])
        if "materials" in kept:
            kept["materials"] = [_name_alone(one) for one in kept["materials"]]
        return kept
    return [_compact(one) for one in value] if isinstance(value, list | tuple) else value


def _name_alone(composition: Any) -> Any:
    return composition["name"] if isinstance(composition, dict) and composition.keys() == {"name"} else composition


def read_scene(path: str | os.PathLike[str]) -> Scene:
    """Read a scene from a TOML file; names of files in it are relative to its folder.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is not TOML or describes no possible scene; the message has the file and, in a line, what is wrong.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from shadowgram.xray.scene import read_scene, shipped_scene
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "mine.toml"
    >>> _ = path.write_text(shipped_scene("cxbi-ud").toml(), encoding="utf-8")
    >>> read_scene(path) == shipped_scene("cxbi-ud")
    True
    """
    from .patterns import check_file

    path = Path(path)
    check_file(path)
    if path.stat().st_size > _LARGEST_FILE:
        raise ValueError(f"{path} is too large for a scene")
    try:
        return parse_scene(path.read_bytes().decode(), path.parent)
    except ValueError as error:  # a UnicodeDecodeError is one
        raise ValueError(f"{path}: {error}") from None


def parse_scene(text: str, folder: str | os.PathLike[str] = "") -> Scene:
    """Scene from the text of a TOML file.

    Parameters
    ----------
    folder : to which names of files in it are relative; the current one unless said.

    Raises
    ------
    ValueError
        If it is not TOML or describes no possible scene; the message says in a line what is wrong.
    """
    import tomllib

    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"it is not TOML: {error}") from None
    try:
        return Scene.model_validate(plain(values), context={"folder": os.fspath(folder)})
    except ValidationError as error:
        raise ValueError(in_words(error, values)) from None


def shipped_scenes() -> tuple[str, ...]:
    """Names of the scenes that come with the package.

    Examples
    --------
    >>> from shadowgram.xray.scene import shipped_scenes
    >>> shipped_scenes()
    ('cxbi-blocks', 'cxbi-hand', 'cxbi-man', 'cxbi-ud', 'slab-water')
    """
    folder = resources.files("shadowgram.xray") / "data" / "scenes"
    return tuple(sorted(file.name.removesuffix(".toml") for file in folder.iterdir() if file.name.endswith(".toml")))


def shipped_scene(name: str) -> Scene:
    """A scene that comes with the package.

    Raises
    ------
    ValueError
        If there is none of this name.

    Examples
    --------
    >>> from shadowgram.xray.scene import shipped_scene
    >>> scene = shipped_scene("cxbi-blocks")
    >>> scene.shots, [solid.name for solid in scene.solids if solid.role == "target"]
    (512, ['caffeine 1', 'caffeine 2', 'HMX 1', 'HMX 2'])
    """
    if name not in shipped_scenes():
        raise ValueError(f"there is no scene {name!r} in the package; it has {', '.join(shipped_scenes())}")
    file = resources.files("shadowgram.xray") / "data" / "scenes" / f"{name}.toml"
    return parse_scene(file.read_text(encoding="utf-8"))
