"""Phase space: the photons that enter the detectors of a scene, each with place, direction, energy and history.

What a detector does with them can then be computed again and again without following photons through the scene, here or by
another program: files are .npz, .h5 and .mcpl.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from shadowgram._threads import thread_count
from shadowgram.scenes.readers.atomic import replace_file

from .montecarlo.arrays import ORDERS, Floats
from .montecarlo.run import Setup, batch_edges, batch_phase_space

if TYPE_CHECKING:
    from shadowgram.scenes.readers.contents import Variable

    from ._compile import Compiled
    from .scene import Scene

Numbers = NDArray[np.uint8]

SUFFIXES = (".npz", ".h5", ".mcpl")
UNITS = {"position": "mm", "direction": "1", "energy": "keV", "weight": "photons", "order": "1", "detector": "1"}
"""The arrays of a phase space, and their units."""
_FORMAT = "shadowgram phase space 1"
_MANY_ORDERS = 16  # by which a detector's number is multiplied in the flags of an MCPL file
_ROUNDING = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class PhaseSpace:
    """Photons where they enter a detector.

    Attributes
    ----------
    position : (photon, 3) mm, on the surface of the detector.
    direction : (photon, 3) of length 1.
    energy : (photon) keV.
    weight : (photon) of how many photons it stands for; 1 without variance reduction.
    order : (photon) index into `orders`: what it had done before.
    detector : (photon) index into `detectors`.
    orders, detectors : names.
    histories : source photons from which these came; sums of weights over it are per source photon.

    Raises
    ------
    ValueError
        If the arrays do not fit together, or a photon cannot be.
    """

    position: Floats
    direction: Floats
    energy: Floats
    weight: Floats
    order: Numbers
    detector: Numbers
    orders: tuple[str, ...]
    detectors: tuple[str, ...]
    histories: int

    def __post_init__(self) -> None:
        photons = len(self)
        for name in UNITS:
            shape = (photons, 3) if name in ("position", "direction") else (photons,)
            array = getattr(self, name)
            if array.shape != shape or array.dtype.kind not in "fiu":
                raise ValueError(
                    f"{name} must be {shape} numbers for {photons} photons, got {array.dtype} {array.shape}"
                )
        for name, names in (("order", self.orders), ("detector", self.detectors)):
            numbers = getattr(self, name)
            if photons and (numbers.min() < 0 or numbers.max() >= len(names)):
                raise ValueError(f"{name} must be from 0 to {len(names) - 1}, got {numbers.min()} to {numbers.max()}")
        _check_photons(self)

    def __len__(self) -> int:
        """How many photons."""
        return len(self.energy)

    def of(self, detector: str) -> PhaseSpace:
        """Those that enter one detector.

        Raises
        ------
        ValueError
            If there is none of this name.
        """
        if detector not in self.detectors:
            raise ValueError(f"there is no detector {detector!r}; there are {', '.join(self.detectors)}")
        chosen = self.detector == self.detectors.index(detector)
        arrays = {name: getattr(self, name)[chosen] for name in UNITS}
        return PhaseSpace(**arrays, orders=self.orders, detectors=self.detectors, histories=self.histories)


def _check_photons(space: PhaseSpace) -> None:
    if isinstance(space.histories, bool) or not isinstance(space.histories, int | np.integer) or space.histories < 1:
        raise ValueError(f"histories must be a whole number of at least 1, got {space.histories!r}")
    for name in ("position", "direction", "energy", "weight"):
        if not np.isfinite(getattr(space, name)).all():
            raise ValueError(f"{name} must be finite numbers, and some are not")
    for name in ("energy", "weight"):
        if np.any(getattr(space, name) <= 0):
            raise ValueError(f"{name} must be positive, got {getattr(space, name).min():g}")
    if np.any(np.abs((space.direction**2).sum(axis=1) - 1) > _ROUNDING):
        raise ValueError("every direction must have the length 1, and some have not")


def phase_space(
    scene: Scene | Compiled,
    *,
    histories: int,
    seed: int = 0,
    threads: int | None = None,
    variance_reduction: bool = False,
    shot: int = 0,
    progress: Callable[[int], None] = lambda _: None,
) -> PhaseSpace:
    """Follow photons through a scene and keep those that enter a detector.

    They are the same histories as those of `shadowgram.xray.simulate`, and the result is a function of scene, seed and histories
    alone. A photon that leaves a detector and comes back is there twice.

    Parameters
    ----------
    scene : as `read_scene` or `shipped_scene` give it, or compiled already.
    histories : source photons.
    seed : a whole number of at least 0.
    threads : by default as many as `shadowgram.threads` or the machine say.
    variance_reduction : many photons of small weights in place of few of weight 1.
    shot : which of the scene's shots.
    progress : called with the histories that are done.

    Raises
    ------
    ValueError
        If the scene has no detector, or a number is not what it must be.
    OSError
        If a file of the scene cannot be read.

    Examples
    --------
    >>> from shadowgram.xray.phase_space import phase_space
    >>> from shadowgram.xray.scene import shipped_scene
    >>> space = phase_space(shipped_scene("cxbi-blocks"), histories=20_000, seed=1, variance_reduction=True)
    >>> space.detectors, len(space) > 1000, 20 < space.energy.mean() < 80
    (('plate +x', 'plate -x'), True, np.True_)
    """
    from .simulation import compiled, prepare

    for name, value, least in (("histories", histories, 1), ("seed", seed, 0), ("threads", threads, 1)):
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least):
            raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")
    setup = prepare(compiled(scene, shot), variance_reduction=variance_reduction)
    if not setup.detector_names:
        raise ValueError("the scene has no detector that photons could enter; add one, however thin")
    rows = _rows(setup, int(seed), int(histories), threads or thread_count(), progress)
    return PhaseSpace(
        position=rows[:, :3].copy(),
        direction=rows[:, 3:6].copy(),
        energy=rows[:, 6].copy(),
        weight=rows[:, 7].copy(),
        order=rows[:, 8].astype(np.uint8),
        detector=rows[:, 9].astype(np.uint8),
        orders=ORDERS,
        detectors=setup.detector_names,
        histories=int(histories),
    )


def _rows(setup: Setup, seed: int, histories: int, threads: int, progress: Callable[[int], None]) -> Floats:
    """(photon, 10) as `Desk.phase` has them, in the order of the histories."""

    def follow(first: int, last: int) -> Floats:
        # A copy, since the part that is filled would keep the whole of it alive.
        return batch_phase_space(setup, seed, first, last).copy()

    edges = batch_edges(histories)
    with ThreadPoolExecutor(threads, thread_name_prefix="shadowgram-xray") as pool:
        waiting: list[Future[Floats]] = []
        try:
            waiting += [pool.submit(follow, *pair) for pair in pairwise(edges)]
            found = []
            for one, done in zip(waiting, edges[1:], strict=True):
                found.append(one.result())
                progress(done)
        finally:
            for one in waiting:
                one.cancel()
    return np.concatenate(found)


def write_phase_space(path: str | os.PathLike[str], space: PhaseSpace) -> None:
    """Write a phase space to a file, all or nothing.

    Parameters
    ----------
    path : .npz, for NumPy; .h5, with units as attributes; or .mcpl, for other programs, in cm and MeV, with 16 · detector + order
        as the flags of a photon, and no times.

    Raises
    ------
    ValueError
        If the file's name ends otherwise.
    OSError
        If it cannot be written.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from shadowgram.xray.phase_space import phase_space, read_phase_space, write_phase_space
    >>> from shadowgram.xray.scene import shipped_scene
    >>> space = phase_space(shipped_scene("cxbi-ud"), histories=1000, seed=1, variance_reduction=True)
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "photons.npz"
    >>> write_phase_space(path, space)
    >>> bool((read_phase_space(path).energy == space.energy).all())
    True
    """
    writers = {".npz": _npz, ".h5": _h5, ".mcpl": _mcpl}
    suffix = Path(path).suffix.lower()
    if suffix not in writers:
        raise ValueError(f"a phase space is written to {', '.join(SUFFIXES)} files, not to {path}")
    replace_file(path, writers[suffix](space))


def _npz(space: PhaseSpace) -> list[memoryview]:
    from shadowgram.scenes.readers.numpy_files import npz_bytes

    names = {"orders": np.array(space.orders), "detectors": np.array(space.detectors)}
    numbers = {"histories": np.array(space.histories, np.int64)}
    return [npz_bytes({name: getattr(space, name) for name in UNITS} | names | numbers)]


def _h5(space: PhaseSpace) -> list[memoryview]:
    import h5py

    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver="v110") as file:
        file.attrs["format"] = _FORMAT
        file.attrs["orders"], file.attrs["detectors"] = json.dumps(space.orders), json.dumps(space.detectors)
        file.attrs["histories"] = space.histories
        for name, unit in UNITS.items():
            file.create_dataset(name, data=getattr(space, name)).attrs["units"] = unit
    return [buffer.getbuffer()]


def _mcpl(space: PhaseSpace):
    from shadowgram import __version__

    from ._mcpl import mcpl_chunks

    listed = (", ".join(f"{i} {name}" for i, name in enumerate(names)) for names in (space.orders, space.detectors))
    orders, detectors = listed
    return mcpl_chunks(
        position=space.position,
        direction=space.direction,
        energy=space.energy,
        weight=space.weight,
        flags=_MANY_ORDERS * space.detector.astype(np.uint32) + space.order,
        program=f"shadowgram {__version__}",
        comments=[
            "Photons where they enter a detector. Times are not known and 0.",
            f"userflags = {_MANY_ORDERS} * detector + order; orders: {orders}; detectors: {detectors}",
        ],
        histories=space.histories,
    )


def read_phase_space(path: str | os.PathLike[str]) -> PhaseSpace:
    """Read what `write_phase_space` wrote to a .npz or .h5 file.

    Raises
    ------
    ValueError
        If the file is of another kind, damaged, or holds no phase space.
    OSError
        If it cannot be read.
    """
    from .patterns import check_file

    path = Path(path)
    check_file(path)
    readers = {".npz": _from_npz, ".h5": _from_h5}
    suffix = path.suffix.lower()
    if suffix not in readers:
        raise ValueError(f"a phase space is read from .npz and .h5 files, not from {path}")
    try:
        return readers[suffix](path)
    except ValueError as error:
        raise ValueError(f"cannot read the phase space {path}: {error}") from error


def _from_npz(path: Path) -> PhaseSpace:
    from shadowgram.scenes.readers.numpy_files import npz_variables

    variables = npz_variables(path)
    texts = {}
    for name in ("orders", "detectors"):
        array = _loaded(variables, name)
        if array.ndim != 1 or array.dtype.kind != "U":
            raise ValueError(f"'{name}' in it must be a list of names")
        texts[name] = tuple(array.tolist())
    histories = _loaded(variables, "histories")
    if histories.shape or histories.dtype.kind not in "iu":
        raise ValueError("'histories' in it must be a whole number")
    return _made(variables, texts, int(histories))


def _from_h5(path: Path) -> PhaseSpace:
    from shadowgram.scenes.readers.hdf5_isolated import isolated

    with isolated(path) as listing:
        if listing.attrs.get("format") != _FORMAT:
            raise ValueError(f"it does not say that it is a {_FORMAT!r}")
        texts = {name: _names(name, listing.attrs.get(name)) for name in ("orders", "detectors")}
        histories = listing.attrs.get("histories")
        if not isinstance(histories, int):
            raise ValueError("its attribute 'histories' must be a whole number")
        return _made(listing.variables, texts, histories)


def _names(what: str, text: object) -> tuple[str, ...]:
    try:
        names = json.loads(text) if isinstance(text, str) else None
    except (ValueError, RecursionError):
        names = None
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError(f"its attribute '{what}' must be a list of names in JSON")
    return tuple(names)


def _loaded(variables: Mapping[str, Variable], name: str) -> np.ndarray:
    if name not in variables:
        raise ValueError(f"it holds no '{name}'; is it a phase space?")
    return variables[name].load()


def _made(variables: Mapping[str, Variable], texts: Mapping[str, tuple[str, ...]], histories: int) -> PhaseSpace:
    arrays = {name: _loaded(variables, name) for name in UNITS}
    for name in ("order", "detector"):
        if arrays[name].dtype != np.uint8:
            raise ValueError(f"'{name}' in it must be uint8, got {arrays[name].dtype}")
    return PhaseSpace(**arrays, orders=texts["orders"], detectors=texts["detectors"], histories=histories)
