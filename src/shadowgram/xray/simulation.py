"""Simulations of a scene: counts, spectra, images and doses, with their uncertainty."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from .montecarlo.arrays import HIGHEST_ENERGY, Rules
from .montecarlo.run import Run, Setup, State, run_setup

if TYPE_CHECKING:
    from ._compile import Compiled
    from .scene import Scene

NEAR = 30.0
"""mm from a detector below which photons are left to find it by chance; the mean free path of 60 keV in water is 50 mm."""
LEAST = 0.005
"""A next-event photon arrives with a weight of about the solid angle over 4π, a few hundredths; ten times less is not
worth following.
"""
LEAST_AIR = 0.1
"""Air scatters one photon in a hundred on its way; a few of them tell as much as all."""
BIN_WIDTH = 0.5
"""keV."""


def simulate(
    scene: Scene | Compiled,
    *,
    histories: int,
    seed: int = 0,
    threads: int | None = None,
    variance_reduction: bool = False,
    shot: int = 0,
    stop_at: float | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
    progress: Callable[[State], None] = lambda _: None,
) -> Run:
    """Follow photons from the source through a scene.

    The result is a function of scene, seed and histories alone: the number of threads, an interrupt and a resumption do
    not change a digit.

    Parameters
    ----------
    scene : as `read_scene` or `shipped_scene` give it, or compiled already.
    histories : source photons in total; with `stop_at` at most.
    seed : a whole number of at least 0.
    threads : by default as many as `shadowgram.threads` or the machine say.
    variance_reduction : force collisions in target and air and send next-event photons to the detectors. Means are the
        same, errors fall faster.
        Only what happens at the detectors gains by it; leave it off for what escapes, and for doses.
    shot : which of the scene's shots, that is, where its mask is.
    stop_at : relative standard error of the counts of all detectors together at which to stop.
    checkpoint : file that keeps what was found; a run that finds its own file there goes on from it.
    progress : called after each batch.

    Returns
    -------
    Run
        ``run.tallies["NAME"].mean`` and ``.standard_error``, with NAME a detector or one of the names that `Run` lists.

    Raises
    ------
    ValueError
        If the scene, a number or the checkpoint is not what it must be.
    OSError
        If a file cannot be read or written.

    Examples
    --------
    >>> import shadowgram as sg
    >>> run = sg.xray.simulate(sg.xray.shipped_scene("slab-water"), histories=20_000, seed=1)
    >>> bool(0.06 < run.tallies["escaped/backward"].mean < 0.085)
    True
    """
    setup = prepare(compiled(scene, shot), variance_reduction=variance_reduction)
    return run_setup(
        setup,
        histories=histories,
        seed=seed,
        threads=threads,
        stop_at=stop_at,
        checkpoint=checkpoint,
        progress=progress,
    )


def compiled(scene: Scene | Compiled, shot: int = 0) -> Compiled:
    """A scene in arrays, at one of its shots."""
    from ._compile import Compiled, compile_scene

    if isinstance(scene, Compiled):
        return scene.at_shot(shot)
    return compile_scene(scene, shot)


def prepare(compiled: Compiled, *, variance_reduction: bool) -> Setup:
    """What the kernels need: the arrays of a scene, and the rules by which histories are followed."""
    highest = float(compiled.source.energy.max()) + 0.5 * compiled.source.width
    cutoff = compiled.scene.cutoff
    if not cutoff < highest < HIGHEST_ENERGY:
        raise ValueError(
            f"the highest energy of the source must lie between the cut-off, {cutoff:g} keV, and {HIGHEST_ENERGY:g} keV, "
            f"got {highest:g} keV"
        )
    rules = Rules(
        cutoff=cutoff,
        reduce=True if variance_reduction else None,
        near=NEAR,
        least=LEAST,
        least_air=LEAST_AIR,
        bin_width=BIN_WIDTH,
    )
    return Setup(
        geometry=compiled.geometry,
        physics=compiled.physics,
        source=compiled.source,
        detectors=compiled.detectors,
        rules=rules,
        detector_names=compiled.detector_names,
        solid_names=compiled.solid_names,
        masses=compiled.masses,
        # Pulses are blurred to either side, and what is above the highest bin falls into it.
        bins=int(np.ceil(1.1 * highest / BIN_WIDTH)) + 1,
    )
