"""What a simulation found, for people and for files: a table, JSON, NetCDF."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr

    from shadowgram.xray.montecarlo.run import Run
    from shadowgram.xray.montecarlo.tallies import Estimate
    from shadowgram.xray.scene import Scene


def with_error(mean: float, error: float) -> str:
    """A number and its standard error, to two digits of the error.

    Examples
    --------
    >>> from shadowgram.cli.xray_results import with_error
    >>> with_error(0.0066345, 0.0000249), with_error(361289, 1846), with_error(1.2345e-15, 2e-17)
    ('0.006634 ± 0.000025', '361300 ± 1800', '(1.234 ± 0.020)e-15')
    >>> with_error(60.0, 0.0), with_error(2.5e-4, math.inf)
    ('60', '0.00025')
    """
    if error == 0 or not math.isfinite(error):
        return f"{mean:.6g}"
    exponent = math.floor(math.log10(max(abs(mean), error)))
    last = math.floor(math.log10(error)) - 1
    if -4 < exponent < 6:
        digits = max(0, -last)
        return f"{round(mean, -last):.{digits}f} ± {round(error, -last):.{digits}f}"
    digits = max(0, exponent - last)
    return f"({mean / 10**exponent:.{digits}f} ± {error / 10**exponent:.{digits}f})e{exponent:+03d}"


def table(run: Run, scene: Scene) -> list[str]:
    """Lines with the counts of the detectors by order, what escaped, and the doses of the targets."""
    photons = scene.photons_per_shot
    sections = list(_sections(run, scene))
    names = max(len(name) for _, rows in sections for name, _ in rows)
    lines = [f"{'':<{names}}{'per source photon':>28}{f'per shot of {photons:.4g} photons':>36}"]
    for title, rows in sections:
        lines.append(title)
        for name, estimate in rows:
            each, shot = (_written(one) for one in (estimate, estimate.scaled(photons, estimate.unit)))
            lines.append(f"{name:<{names}}{each:>28}{shot:>36}")
    return lines


def _written(estimate: Estimate) -> str:
    return with_error(float(estimate.mean), float(estimate.standard_error))


def _sections(run: Run, scene: Scene) -> Iterator[tuple[str, list[tuple[str, Estimate]]]]:
    """Titles, and under each names and numbers."""
    tallies = run.tallies
    detectors = [one.name for one in scene.detectors]
    if detectors:
        shown = detectors if len(detectors) == 1 else ["all", *detectors]
        rows = [row for name in shown for row in _counts(name, tallies)]
        yield "counts of pulses above threshold, by the history of the photon", rows
    sides = [(f"  {side}s", tallies[f"escaped/{side}"]) for side in ("backward", "forward")]
    yield "photons that leave the world", sides
    targets = [solid.name for solid in scene.solids if solid.role == "target"]
    doses = [(f"  {name}", tallies[f"dose/{name}"]) for name in targets if f"dose/{name}" in tallies]
    if doses:
        yield "dose, Gy", doses
    others = [(f"  {name}", tallies[f"deposited/{name}"]) for name in targets if f"dose/{name}" not in tallies]
    if others:
        yield "energy left in solids of which something is cut off, keV", others


def _counts(name: str, tallies: Mapping[str, Estimate]) -> Iterator[tuple[str, Estimate]]:
    """The counts of a detector, and under them those orders that occurred."""
    import dataclasses

    from shadowgram.xray.montecarlo.arrays import ORDERS

    yield f"  {name}", tallies[name]
    orders = tallies[f"{name}/orders"]
    for i, order in enumerate(ORDERS):
        if orders.mean[i] > 0:
            one = dataclasses.replace(
                orders, mean=orders.mean[i], standard_error=orders.standard_error[i], axes=(), edges=()
            )
            yield f"    {order}", one


def values(run: Run, scene: Scene) -> dict[str, object]:
    """All of it, as JSON can hold it."""
    return {
        "title": scene.title,
        "histories": run.histories,
        "seconds": run.seconds,
        "finished": run.finished,
        "photons_per_shot": scene.photons_per_shot,
        "tallies": {name: _plain(estimate) for name, estimate in run.tallies.items()},
    }


def _plain(estimate: Estimate) -> dict[str, object]:
    found: dict[str, object] = {
        "mean": estimate.mean.tolist(),
        "standard_error": estimate.standard_error.tolist(),
        "unit": estimate.unit,
    }
    if not estimate.axes:
        return found
    edges = [None if edge is None else edge.tolist() for edge in estimate.edges]
    names = {"order": _orders()} if "order" in estimate.axes else {}
    return found | {"axes": list(estimate.axes), "edges": edges} | names


def _orders() -> list[str]:
    from shadowgram.xray.montecarlo.arrays import ORDERS

    return list(ORDERS)


def dataset(run: Run, scene: Scene, settings: str) -> xr.Dataset:
    """All of it as a dataset: a variable for every tally and one for its standard error, which end in ``_error``.

    Parameters
    ----------
    settings : how it was made, as JSON.
    """
    import numpy as np
    import xarray as xr

    variables: dict[str, tuple] = {}
    coordinates: dict[str, tuple] = {}
    for name, estimate in run.tallies.items():
        short = _short(name, variables)
        images = estimate.axes == ("y", "x")
        dims = tuple(f"{axis}_{short}" for axis in "yx") if images else estimate.axes
        attrs = {"long_name": name, "units": estimate.unit}
        variables[short] = (dims, np.asarray(estimate.mean), attrs)
        error = {"long_name": f"standard error of {name}", "units": estimate.unit}
        variables[f"{short}_error"] = (dims, np.asarray(estimate.standard_error), error)
        for axis, edges in zip(dims, estimate.edges, strict=True):
            if edges is not None:
                unit = {"units": "keV"} if axis == "energy" else {"units": "1"}
                coordinates[axis] = (axis, (edges[:-1] + edges[1:]) / 2, unit)
    attrs = {"orders": ", ".join(_orders()), "histories": run.histories, "photons_per_shot": scene.photons_per_shot}
    return xr.Dataset(variables, coordinates, attrs | {"title": scene.title, "settings": settings})


def _short(name: str, taken: Mapping[str, object]) -> str:
    """A name of a tally as NetCDF takes it, different from those that are taken."""
    base = "_".join(name.replace("/", "_").split())
    short, number = base, 2
    while short in taken or f"{short}_error" in taken or short.removesuffix("_error") in taken:
        short, number = f"{base}_{number}", number + 1
    return short
