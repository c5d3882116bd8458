"""What all parts of a scene share: how they are checked, vectors, file names, what a thing is made of, and faults in words."""

from __future__ import annotations

import dataclasses
import math
import os
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, ValidationInfo, model_validator

from . import _elements
from .materials import Material, material

_MOST_FAULTS = 3


class Part(BaseModel):
    """A part of a scene: its keys are known, its numbers finite, and it does not change; NumPy's numbers and arrays will do."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _plain(cls, values: Any) -> Any:
        return {name: plain(value) for name, value in values.items()} if isinstance(values, dict) else values


def plain(value: Any) -> Any:
    """The same in Python's own numbers, texts and lists."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    return value


def _file(name: Any, info: ValidationInfo) -> Any:
    """A file name, from the folder of the scene if it is in one."""
    folder = (info.context or {}).get("folder", "")
    return os.path.abspath(Path(folder, name).expanduser()) if isinstance(name, str) and name else name  # noqa: PTH100 - a link keeps its name


Positive = Annotated[float, Field(gt=0)]
Count = Annotated[int, Field(ge=1)]
# TOML has arrays where a scene has tuples.
Vector = Annotated[tuple[float, float, float], Field(strict=False)]
Lengths = Annotated[tuple[Positive, Positive, Positive], Field(strict=False)]
File = Annotated[str, BeforeValidator(_file), Field(min_length=1)]


class Composition(Part):
    """What a thing is made of. Where one is wanted, a name alone will do, and so will a `Material`.

    Attributes
    ----------
    name : of a material that is known, such as "water"; or, with a formula or fractions, any.
    formula : such as "C8H10N4O2"; needs a density.
    fractions : symbol → mass fraction; needs a density.
    density : g/cm³, in place of the one that is known.

    Examples
    --------
    >>> from shadowgram.xray._parts import Composition
    >>> Composition(formula="C8H10N4O2", density=1.23).material().density
    1.23
    """

    name: Annotated[str, Field(min_length=1)] | None = None
    formula: Annotated[str, Field(min_length=1)] | None = None
    fractions: dict[str, Positive] | None = None
    density: Positive | None = None

    @model_validator(mode="after")
    def _known(self) -> Composition:
        self.material()
        return self

    def material(self) -> Material:
        """The material itself."""
        if self.formula and self.fractions:
            raise ValueError("say a formula or fractions, not both")
        if self.fractions:
            return material(self.name or "mixture", self.density, self.fractions)
        if self.formula:
            return dataclasses.replace(material(self.formula, self.density), name=self.name or self.formula)
        if not self.name:
            raise ValueError("say a name, a formula or fractions")
        return VACUUM if self.name == VACUUM.name else material(self.name, self.density)


VACUUM = Material(name="vacuum", density=1e-25, fractions=((1, 1.0),))
"""Nearly nothing: the density of hydrogen between the galaxies, in which a photon meets an atom every 10²⁶ mm."""


def _composition(value: Any) -> Any:
    if isinstance(value, str):
        return {"name": value}
    if isinstance(value, Material):
        symbols = {z: symbol for symbol, z in _elements.symbols().items()}
        fractions = {symbols[z]: fraction for z, fraction in value.fractions}
        return {"name": value.name, "density": value.density, "fractions": fractions}
    return value


MadeOf = Annotated[Composition, BeforeValidator(_composition)]


def unit_vector(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    """The direction of a vector; the same again for one that is a direction already.

    Raises
    ------
    ValueError
        If it has no length.
    """
    length = math.hypot(*vector)
    if length == 0:
        raise ValueError("a direction must have a length, got (0, 0, 0)")
    if abs(length - 1) < 1e-12:
        return vector
    x, y, z = (component / length for component in vector)
    return x, y, z


def in_words(error: ValidationError, values: object = None) -> str:
    """What is wrong with a scene, in a line.

    Parameters
    ----------
    values : that were checked, for the names of solids and detectors.
    """
    faults = error.errors(include_url=False)
    lines = list(dict.fromkeys(_fault(dict(fault), values) for fault in faults))
    more = f"; and {len(lines) - _MOST_FAULTS} more" if len(lines) > _MOST_FAULTS else ""
    return "; ".join(lines[:_MOST_FAULTS]) + more


def _fault(fault: dict[str, Any], values: object) -> str:
    where = _place(fault["loc"], values)
    at = f"{where}: " if where else ""
    message, context = fault["msg"], fault.get("ctx", {})
    match fault["type"]:
        case "extra_forbidden":
            return f"unknown key {where}"
        case "missing":
            return f"{where} is missing"
        case "value_error":
            return at + message.removeprefix("Value error, ")
        case "union_tag_invalid":
            return f"{at}kind must be one of {context['expected_tags']}, got {context['tag']!r}"
        case "union_tag_not_found":
            return f"{at}say its kind, such as kind = 'box'"
        case _:
            got = repr(fault["input"])
            shown = got if len(got) < 60 else got[:56] + " ..."
            return f"{where} should {message.removeprefix('Input should ')}, got {shown}"


def _place(location: tuple[int | str, ...], values: object) -> str:
    """Where pydantic found a fault, as in "solids[0] (palm) shape.size[1]"."""
    words, here = "", values
    for i, step in enumerate(location):
        if i and location[i - 1] == "shape" and isinstance(here, dict) and step == here.get("kind"):
            continue  # which member of the union it is
        try:
            here = here[step]  # type: ignore[index]  # lists and tables, down to the fault
        except (TypeError, KeyError, IndexError):
            here = None
        if isinstance(step, int):
            words += f"[{step}]"
            if isinstance(here, dict) and isinstance(here.get("name"), str):
                words += f" ({here['name']})"
        else:
            words += f" {step}" if words.endswith(")") else f".{step}" if words else step
    return words
