"""What a scene consists of, in lines."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from shadowgram.xray._compile import Compiled
    from shadowgram.xray._parts import Composition
    from shadowgram.xray.scene import Detector, Mask, Scene, Solid, Source

_WIDTH = 11  # characters of the first column


def lines(scene: Scene, arrays: Compiled) -> list[str]:
    """Source, mask, solids and detectors, one after the other.

    Parameters
    ----------
    scene, arrays : the same.
    """
    entries: list[tuple[str, str]] = [
        ("world", f"{_sizes(scene.world.size)} of {_made_of([scene.world.material])}"),
        ("source", _source_place(scene.source)),
        ("", _energies(scene.source)),
        ("", _strength(scene)),
        *([] if scene.mask is None else [("mask", text) for text in _mask(scene.mask, scene.shots)]),
    ]
    if scene.cutoff > 1 or not scene.fluorescence:
        fluorescence = "" if scene.fluorescence else "; without fluorescence"
        entries.append(("physics", f"photons below {scene.cutoff:g} keV are absorbed where they are{fluorescence}"))
    shown = [scene.title] if scene.title else []
    last = ""
    for title, text in entries:
        shown.append(f"{'' if title == last else title:<{_WIDTH}}{text}")
        last = title or last
    return [*shown, *_solids(scene, arrays), *_detectors(scene.detectors)]


def _sizes(sizes: Iterable[float]) -> str:
    return " × ".join(f"{size:.4g}" for size in sizes) + " mm"


def _place(place: Iterable[float]) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in place) + ")"


def _made_of(materials: Sequence[Composition]) -> str:
    known = list(dict.fromkeys(one.material() for one in materials))
    if len(known) > 1:
        return ", ".join(one.name for one in known)
    density = known[0].density
    return known[0].name if density < 1e-20 else f"{known[0].name}, {density:.4g} g/cm³"


def _source_place(source: Source) -> str:
    beam = (
        f"half angle {math.degrees(source.half_angle):.4g}° ({source.solid_angle:.4g} sr)" if source.half_angle else ""
    )
    spot = f"focal spot {_sizes(source.focal_spot)}" if any(source.focal_spot) else ""
    parts = [f"at {_place(source.position)} mm towards {_place(source.direction)}", beam or "a pencil", spot]
    return ", ".join(part for part in parts if part)


def _energies(source: Source) -> str:
    spectrum = source.spectrum.spectrum()
    if len(spectrum.energy) == 1:
        return f"{spectrum.energy[0]:g} keV"
    return f"{spectrum.energy[0]:g} to {spectrum.energy[-1]:g} keV, mean {spectrum.mean_energy:.4g} keV"


def _strength(scene: Scene) -> str:
    shots = "one shot" if scene.shots == 1 else f"each of {scene.shots} shots"
    return (
        f"{scene.source.photons_per_second:.4g} photons/s, {scene.photons_per_shot:.4g} in {shots} of"
        f" {scene.exposure:g} s"
    )


def _mask(mask: Mask, shots: int) -> list[str]:
    cells = mask.cells()
    width, height = mask.plate
    found = [
        f"{mask.rows} × {mask.columns} cells (y × x) of {mask.pitch:g} mm, {100 * cells.mean():.3g} % of them holes",
        f"in {_sizes((width, height, mask.depth))} of {_made_of([mask.material])}, centred at {_place(mask.position)} mm",
    ]
    if shots > 1:
        found.append(f"{mask.columns_in_view} columns in view, sliding by one a shot")
    return found


def _solids(scene: Scene, arrays: Compiled) -> list[str]:
    if not scene.solids:
        return []
    boxes = dict(zip(arrays.solid_names, arrays.geometry.box, strict=True))
    masses = dict(zip(arrays.solid_names, arrays.masses, strict=True))
    titles = ("solid", "role", "shape", "material", "box around it", "at (mm)", "mass")
    rows = [_solid_row(solid, boxes[solid.name], float(masses[solid.name])) for solid in scene.solids]
    return ["", *_columns([titles, *rows])]


def _solid_row(solid: Solid, box: np.ndarray, mass: float) -> tuple[str, ...]:
    lower, upper = box[:3], box[3:]
    return (
        solid.name,
        solid.role,
        solid.shape.kind,
        _made_of(solid.materials),
        _sizes(upper - lower),
        _place((lower + upper) / 2),
        f"{mass:.4g} g" if math.isfinite(mass) else "cut into",
    )


def _detectors(detectors: Sequence[Detector]) -> list[str]:
    if not detectors:
        return ["", "no detector: only what escapes is counted, and doses"]
    rows = [("detector", "material", "size", "at (mm)", "threshold", "resolution", "pixels (y × x)")]
    rows += [
        (
            one.name,
            _made_of([one.material]),
            _sizes(one.size),
            _place(one.centre),
            f"{one.threshold:g} keV",
            f"{100 * one.resolution:.3g} % at 662 keV" if one.resolution else "exact",
            f"{one.pixels[0]} × {one.pixels[1]}",
        )
        for one in detectors
    ]
    return ["", *_columns(rows)]


def _columns(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(map(len, column)) + 2 for column in zip(*rows, strict=True)]
    return ["".join(f"{word:<{width}}" for word, width in zip(row, widths, strict=True)).rstrip() for row in rows]
