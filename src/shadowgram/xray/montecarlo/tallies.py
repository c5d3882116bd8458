"""What a run counts, with the standard error of every number.

A run is cut into batches of histories. Each batch gives one vector of sums; their spread gives the standard errors,
whatever weights and splits happen inside a history, and adding them in order gives the same digits for any number of
threads or workers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .arrays import ORDERS, Detectors, Floats, Tally

COSINE_BINS = 80
"""Bins of the cosine of what escapes, over [−1, 1]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """A number, or an array of numbers, that a run has estimated.

    Attributes
    ----------
    mean : per source photon, or what `unit` says.
    standard_error : of the mean, by the spread of the batches; same shape.
    unit : what one source photon gives.
    axes : names of the axes, for arrays.
    edges : for every axis the edges of its bins, or None where it is counted.
    """

    mean: Floats
    standard_error: Floats
    unit: str
    axes: tuple[str, ...] = ()
    edges: tuple[Floats | None, ...] = ()

    @property
    def relative_error(self) -> Floats:
        """Standard error over mean; infinite where nothing was counted."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.mean != 0, self.standard_error / np.abs(self.mean), np.inf)

    def scaled(self, factor: float, unit: str) -> Estimate:
        """The same in another unit, for instance per shot: times the photons of a shot."""
        return Estimate(
            mean=self.mean * factor,
            standard_error=self.standard_error * abs(factor),
            unit=unit,
            axes=self.axes,
            edges=self.edges,
        )


def empty_tally(solids: int, detectors: Detectors, bins: int) -> Tally:
    """Sums of nothing, for one batch."""
    count = detectors.solid.size
    return Tally(
        counts=np.zeros((count, len(ORDERS))),
        spectrum=np.zeros((count, bins)),
        image=np.zeros(int(np.prod(detectors.pixels, axis=1).sum()) if count else 0),
        deposited=np.zeros(solids),
        escaped=np.zeros(COSINE_BINS),
        escaped_spectrum=np.zeros((2, bins)),
        balance=np.zeros(2),
    )


def as_vector(tally: Tally) -> Floats:
    """All sums of a batch in one row; totals come first, since the errors of their parts do not just add up."""
    together = tally.counts.sum(axis=0)
    totals = [[together.sum()], together, tally.counts.sum(axis=1), tally.escaped_spectrum.sum(axis=1)]
    return np.concatenate([*totals, *(part.ravel() for part in tally)])


@dataclass(kw_only=True, eq=False)
class Sums:
    """Batches added up in order.

    Attributes
    ----------
    total, squares : sums over batches of the batch vectors, and of their squares.
    batches, histories : how many.
    """

    total: Floats
    squares: Floats
    batches: int = 0
    histories: int = 0

    @classmethod
    def of_size(cls, size: int) -> Sums:
        """Nothing yet."""
        return cls(total=np.zeros(size), squares=np.zeros(size))

    def add(self, vector: Floats, histories: int) -> None:
        """One more batch."""
        total, squares = self.total + vector, self.squares + vector * vector
        batches, count = self.batches + 1, self.histories + histories
        # Nothing is called here, so an interrupt leaves all of it done or none.
        self.total, self.squares, self.batches, self.histories = total, squares, batches, count

    def mean(self) -> Floats:
        """Per history."""
        return self.total / self.histories

    def standard_error(self) -> Floats:
        """Of `mean`, from batches of (nearly) equal size; infinite for a single batch."""
        if self.batches < 2:
            return np.full(self.total.shape, np.inf)
        n = self.batches
        spread = np.maximum(self.squares - self.total**2 / n, 0.0) * n / (n - 1)
        return np.sqrt(spread) / self.histories


def named_estimates(
    sums: Sums,
    shape: Tally,
    detectors: Detectors,
    names: tuple[str, ...],
    solids: tuple[str, ...],
    masses: Floats,
    bin_width: float,
) -> dict[str, Estimate]:
    """Give every part of the sums its name and unit.

    Parameters
    ----------
    shape : an empty tally of the run.
    names, solids : of the detectors, of the solids.
    masses : (solid) g; NaN where unknown.
    """
    mean, error = sums.mean(), sums.standard_error()
    found: dict[str, Estimate] = {}

    def take(name: str, start: int, dims: tuple[int, ...], unit: str, axes=(), edges=()) -> None:
        stop = start + int(np.prod(dims, dtype=int))
        found[name] = Estimate(
            mean=mean[start:stop].reshape(dims),
            standard_error=error[start:stop].reshape(dims),
            unit=unit,
            axes=axes,
            edges=edges,
        )

    bins = shape.spectrum.shape[1]
    energy = (np.arange(bins + 1) * bin_width,)
    counts, orders = "counts per source photon", len(ORDERS)
    take("all", 0, (), counts)
    take("all/orders", 1, (orders,), counts, ("order",), (None,))
    at = 1 + orders
    for i, name in enumerate(names):
        take(name, at + i, (), counts)
    at += len(names)
    take("escaped/backward", at, (), "photons per source photon")
    take("escaped/forward", at + 1, (), "photons per source photon")
    at += 2
    for i, name in enumerate(names):
        take(f"{name}/orders", at + i * orders, (orders,), counts, ("order",), (None,))
    at += shape.counts.size
    for i, name in enumerate(names):
        take(f"{name}/spectrum", at + i * bins, (bins,), counts, ("energy",), energy)
    at += shape.spectrum.size
    for i, name in enumerate(names):
        rows, columns = (int(n) for n in detectors.pixels[i])
        take(f"{name}/image", at + int(detectors.start[i]), (rows, columns), counts, ("y", "x"), (None, None))
    at += shape.image.size
    for i, name in enumerate(solids):
        take(f"deposited/{name}", at + i, (), "keV per source photon")
        if np.isfinite(masses[i]):
            # 1 keV/g is 1.602e-13 Gy.
            found[f"dose/{name}"] = found[f"deposited/{name}"].scaled(
                1.602176634e-13 / masses[i], "Gy per source photon"
            )
    at += shape.deposited.size
    cosines = (np.linspace(-1.0, 1.0, COSINE_BINS + 1),)
    take("escaped/cosine", at, (COSINE_BINS,), "photons per source photon", ("cosine",), cosines)
    at += COSINE_BINS
    take("escaped/backward/spectrum", at, (bins,), "photons per source photon", ("energy",), energy)
    take("escaped/forward/spectrum", at + bins, (bins,), "photons per source photon", ("energy",), energy)
    at += 2 * bins
    take("energy/started", at, (), "keV per source photon")
    take("energy/escaped", at + 1, (), "keV per source photon")
    return found
