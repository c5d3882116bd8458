"""Scans and maps of pencil beams in native files: NetCDF-4 with a checksum, whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from shadowgram.scenes.readers.native import read_dataset, write_dataset

from .montecarlo.arrays import ORDERS
from .scan import PencilMap, Scan
from .scene import parse_scene

if TYPE_CHECKING:
    import xarray as xr

_SCAN, _PENCIL = "xray-scan", "xray-pencil-scan"
_MADE_BY = {_SCAN: ("a scan", "shadowgram xray scan"), _PENCIL: ("a scan with pencil beams", "shadowgram xray pencil")}
_BY_SHOT = ("counts", "standard_error", "background", "background_error")
_MAPS = ("counts", "standard_error", "target")


def write_scan(scan: Scan, path: str | os.PathLike[str], *, configuration: str = "") -> None:
    """Write a scan to a native file, in place of what is there.

    Parameters
    ----------
    scan : what to write.
    path : ends in ``.nc``.
    configuration : text that is kept in the file, such as the settings of the program that made it.

    Raises
    ------
    OSError
        If the file cannot be written.
    ValueError
        If `path` does not end in ``.nc``.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from shadowgram.xray.scan import Scan
    >>> from shadowgram.xray.scan_file import read_scan, write_scan
    >>> from shadowgram.xray.scene import shipped_scene
    >>> scan = Scan(counts=np.array([9.0, 7.0]), standard_error=np.array([3.0, 2.6]), codes=np.ones((2, 4, 4), np.uint8),
    ...             photons_per_shot=1e7, exposure=0.015625, route="direct", noisy=True, seed=0,
    ...             scene=shipped_scene("cxbi-blocks").toml())
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "y.nc"
    >>> write_scan(scan, path)
    >>> read_scan(path).counts
    array([9., 7.])
    """
    import xarray as xr

    variables: dict[str, Any] = {"codes": (("shot", "y", "x"), np.asarray(scan.codes, np.uint8))}
    for name in _BY_SHOT:
        values = getattr(scan, name)
        if values is not None:
            variables[name] = (("shot",), values, {"long_name": f"{name.replace('_', ' ')} of all detectors together"})
    if scan.image is not None:
        variables["image"] = (
            ("y", "x"),
            scan.image,
            {"long_name": "counts per shot from the target through each cell"},
        )
    attributes: dict[str, Any] = {
        "route": scan.route,
        "noisy": int(scan.noisy),
        "seed": scan.seed,
        "photons_per_shot": scan.photons_per_shot,
        "exposure": scan.exposure,
    }
    if scan.orders is not None:
        variables["orders"] = (("order",), np.array([scan.orders[name] for name in ORDERS], float))
        attributes["order_names"] = ", ".join(ORDERS)
    _write(xr.Dataset(variables, attrs=attributes), _SCAN, scan.scene, path, configuration)


def read_scan(path: str | os.PathLike[str]) -> Scan:
    """Read a scan that `write_scan` wrote.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is damaged or not a scan, or its contents do not fit together.
    """
    dataset = _read(path, _SCAN, ("codes", *_BY_SHOT[:2]))
    attributes = dataset.attrs
    try:
        return Scan(
            counts=dataset["counts"].values,
            standard_error=dataset["standard_error"].values,
            background=_array(dataset, "background"),
            background_error=_array(dataset, "background_error"),
            codes=dataset["codes"].values,
            image=_array(dataset, "image"),
            photons_per_shot=_number(attributes, "photons_per_shot"),
            exposure=_number(attributes, "exposure"),
            route=_text(attributes, "route"),  # type: ignore[arg-type]  # the scan checks it
            noisy=bool(_number(attributes, "noisy")),
            seed=int(_number(attributes, "seed")),
            scene=_scene(attributes),
            orders=_orders(dataset),
        )
    except ValueError as error:
        raise ValueError(f"{os.fspath(path)} is not a valid scan: {error}") from None


def write_pencil_map(found: PencilMap, path: str | os.PathLike[str], *, configuration: str = "") -> None:
    """Write a map of pencil beams to a native file, in place of what is there; parameters and errors as of `write_scan`."""
    import xarray as xr

    variables = {name: (("y", "x"), getattr(found, name)) for name in _MAPS}
    attributes: dict[str, Any] = {
        "photons": found.photons,
        "pitch": found.pitch,
        "distance": found.distance,
        "half_angle": found.half_angle,
        "noisy": int(found.noisy),
        "seed": found.seed,
    }
    _write(xr.Dataset(variables, attrs=attributes), _PENCIL, found.scene, path, configuration)


def read_pencil_map(path: str | os.PathLike[str]) -> PencilMap:
    """Read a map that `write_pencil_map` wrote; errors as of `read_scan`."""
    dataset = _read(path, _PENCIL, _MAPS)
    attributes = dataset.attrs
    try:
        return PencilMap(
            **{name: dataset[name].values for name in _MAPS},
            photons=int(_number(attributes, "photons")),
            pitch=_number(attributes, "pitch"),
            distance=_number(attributes, "distance"),
            half_angle=_number(attributes, "half_angle"),
            noisy=bool(_number(attributes, "noisy")),
            seed=int(_number(attributes, "seed")),
            scene=_scene(attributes),
        )
    except ValueError as error:
        raise ValueError(f"{os.fspath(path)} is not a valid scan with pencil beams: {error}") from None


def _write(dataset: xr.Dataset, kind: str, scene: str, path: str | os.PathLike[str], configuration: str) -> None:
    from shadowgram import __version__

    if not os.fspath(path).endswith(".nc"):
        raise ValueError(f"{_MADE_BY[kind][0]} is written to a file that ends in .nc, got {os.fspath(path)}")
    texts = {"kind": kind, "scene": scene, "configuration": configuration, "shadowgram_version": __version__}
    write_dataset(dataset.assign_attrs(texts), path)


def _read(path: str | os.PathLike[str], kind: str, needed: tuple[str, ...]) -> xr.Dataset:
    dataset = read_dataset(path)
    if dataset.attrs.get("kind") != kind or not set(needed) <= set(dataset.data_vars):
        what, command = _MADE_BY[kind]
        raise ValueError(f"{os.fspath(path)} is not {what}; make one with '{command}'")
    return dataset


def _array(dataset: xr.Dataset, name: str) -> np.ndarray | None:
    return dataset[name].values if name in dataset.data_vars else None


def _orders(dataset: xr.Dataset) -> dict[str, float] | None:
    values = _array(dataset, "orders")
    if values is None:
        return None
    names = _text(dataset.attrs, "order_names").split(", ")
    if values.shape != (len(names),) or values.dtype.kind != "f":
        raise ValueError("its orders have no number for each name")
    return dict(zip(names, values.tolist(), strict=True))


def _number(attributes: Mapping[Any, Any], name: str) -> float:
    value = attributes.get(name)
    if not isinstance(value, int | float | np.integer | np.floating) or not np.isfinite(value):
        raise ValueError(f"its {name.replace('_', ' ')} is not a number")
    return float(value) if isinstance(value, float | np.floating) else int(value)


def _text(attributes: Mapping[Any, Any], name: str) -> str:
    value = attributes.get(name)
    if not isinstance(value, str):
        raise ValueError(f"its {name.replace('_', ' ')} is not a text")
    return value


def _scene(attributes: Mapping[Any, Any]) -> str:
    text = _text(attributes, "scene")
    parse_scene(text)
    return text
