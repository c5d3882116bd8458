"""Solids of a scene: shapes, where they are, what they are made of and what they are there for.

A shape is turned first and moved then. `rotation` is three angles, rad: about the x axis, then the y axis, then the z axis of
the world, each anticlockwise for someone to whom the axis points.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from ._parts import Composition, Count, File, Lengths, MadeOf, Part, Positive, Vector, unit_vector

Point = Annotated[tuple[float, float], Field(strict=False)]
Loop = Annotated[tuple[Point, ...], Field(strict=False, min_length=3)]
ORIGIN = (0.0, 0.0, 0.0)


class Box(Part):
    """A cuboid.

    Attributes
    ----------
    centre, size : mm; its full lengths.
    rotation : rad, about its centre.
    """

    kind: Literal["box"] = "box"
    centre: Vector = ORIGIN
    size: Lengths
    rotation: Vector = ORIGIN


class Ellipsoid(Part):
    """An ellipsoid.

    Attributes
    ----------
    centre, semi_axes : mm.
    rotation : rad, about its centre.
    """

    kind: Literal["ellipsoid"] = "ellipsoid"
    centre: Vector = ORIGIN
    semi_axes: Lengths
    rotation: Vector = ORIGIN


class Cylinder(Part):
    """A round cylinder, said by the centres of its two ends, or by its centre, length and axis.

    Attributes
    ----------
    radius : mm.
    start, end : mm, centres of the ends.
    centre, length, axis : in their place, mm; the axis is a direction, z unless said.
    rotation : rad, about its centre.
    """

    kind: Literal["cylinder"] = "cylinder"
    radius: Positive
    start: Vector | None = None
    end: Vector | None = None
    centre: Vector | None = None
    length: Positive | None = None
    axis: Vector | None = None
    rotation: Vector = ORIGIN

    @field_validator("axis")
    @classmethod
    def _direction(cls, axis: tuple[float, float, float] | None) -> tuple[float, float, float] | None:
        return None if axis is None else unit_vector(axis)

    @model_validator(mode="after")
    def _one_way(self) -> Cylinder:
        ends = self.start is not None and self.end is not None
        middle = self.length is not None
        if ends == middle or (ends and (self.centre or self.axis)) or (middle and (self.start or self.end)):
            raise ValueError("say start and end of the cylinder, or its centre, length and axis")
        if ends and self.start == self.end:
            raise ValueError(f"the cylinder has no length: it starts and ends at {self.start} mm")
        return self


class Outline(Part):
    """A plate cut along an outline, or block letters; the outline lies in x and y, the thickness along z.

    Attributes
    ----------
    centre : mm; where the point (0, 0) of the outline, at half the thickness, lies. Letters are centred there.
    points : (x, y) of the corners, mm, one after the other.
    holes : outlines of holes, each like `points`.
    text, height : in their place letters, and how high they are, mm.
    thickness : mm.
    rotation : rad, about `centre`.
    """

    kind: Literal["outline"] = "outline"
    centre: Vector = ORIGIN
    points: Loop | None = None
    holes: Annotated[tuple[Loop, ...], Field(strict=False)] = ()
    text: Annotated[str, Field(min_length=1)] | None = None
    height: Positive | None = None
    thickness: Positive
    rotation: Vector = ORIGIN

    @model_validator(mode="after")
    def _one_way(self) -> Outline:
        letters = self.text is not None and self.height is not None
        if letters == (self.points is not None) or (self.text is None) != (self.height is None):
            raise ValueError("say the points of the outline, or a text and its height")
        if self.holes and self.points is None:
            raise ValueError("holes belong to an outline with points")
        return self


class Mesh(Part):
    """A body bounded by triangles, from a file; it must be closed.

    Attributes
    ----------
    file : STL, OBJ or PLY.
    scale : mm per unit of the file, which is done first.
    rotation : rad, about the origin of the file.
    translation : mm, which is done last.
    """

    kind: Literal["mesh"] = "mesh"
    file: File
    scale: Positive = 1.0
    rotation: Vector = ORIGIN
    translation: Vector = ORIGIN


class Voxels(Part):
    """A block of cells, each of one material, from a file.

    Attributes
    ----------
    file : array (x, y, z) of whole numbers, each the number of a material: .npy, or the only one of three axes in .npz, .mat
        or .nc.
    materials : material 0, material 1 and so on.
    pitch : mm along x, y, z.
    corner : mm, where the outer corner of cell (0, 0, 0) lies.
    rotation : rad, about `corner`.
    """

    kind: Literal["voxels"] = "voxels"
    file: File
    materials: Annotated[tuple[MadeOf, ...], Field(strict=False, min_length=1, max_length=2**15)]
    pitch: Lengths
    corner: Vector = ORIGIN
    rotation: Vector = ORIGIN


Shape = Annotated[Box | Ellipsoid | Cylinder | Outline | Mesh | Voxels, Field(discriminator="kind")]
Role = Literal["environment", "target", "shield"]


class Solid(Part):
    """A solid. Where solids overlap the later one counts.

    Attributes
    ----------
    name : of its own.
    role : "target", what is looked at; "shield", what is there to stop photons; or "environment".
    material : what it is made of; voxels say it themselves.
    shape : one of `Box`, `Ellipsoid`, `Cylinder`, `Outline`, `Mesh` and `Voxels`; in TOML a table with its `kind`.

    Examples
    --------
    >>> from shadowgram.xray.scene import Box, Solid
    >>> Solid(name="block", role="target", material="caffeine", shape=Box(centre=(70, 70, 505), size=(70, 70, 10))).shape.kind
    'box'
    """

    name: Annotated[str, Field(pattern=r"^[^/\s]([^/]*[^/\s])?$", max_length=80)]
    role: Role = "environment"
    material: MadeOf | None = None
    shape: Shape

    @model_validator(mode="after")
    def _made_of_something(self) -> Solid:
        if isinstance(self.shape, Voxels) != (self.material is None):
            missing = self.material is None
            raise ValueError("the key 'material' is missing" if missing else "voxels say their materials themselves")
        return self

    @property
    def materials(self) -> tuple[Composition, ...]:
        """All that it is made of."""
        if isinstance(self.shape, Voxels):
            return self.shape.materials
        return () if self.material is None else (self.material,)


class Detector(Part):
    """A detector: a box whose faces lie along the axes.

    Attributes
    ----------
    name : of its own, after which its tallies are called.
    centre, size : mm.
    material : what it is made of.
    threshold : keV, the least energy of a pulse that is counted.
    resolution : full width at half maximum over the energy, at 662 keV, such as 0.07; it goes with 1/√E. 0 for none.
    efficiency : probability that a pulse is read out.
    pixels : rows along y and columns along x of its image; pulses lie where their first interaction was.
    """

    name: Annotated[str, Field(pattern=r"^[^/\s]([^/]*[^/\s])?$", max_length=80)]
    centre: Vector
    size: Lengths
    material: MadeOf
    threshold: Annotated[float, Field(ge=0)] = 10.0
    resolution: Annotated[float, Field(ge=0, lt=1)] = 0.0
    efficiency: Annotated[float, Field(gt=0, le=1)] = 1.0
    pixels: Annotated[tuple[Count, Count], Field(strict=False)] = (1, 1)
