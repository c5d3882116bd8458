"""Cases: a sweep of the code design, beside Algorithm 1 as it is printed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import deepcopy

import numpy as np

from shadowgram import codes
from shadowgram.codes._board import Board
from shadowgram.codes._design import default_c1
from shadowgram.experiments.studies._plain import PlainBoard
from shadowgram.spectral.sscsi import SSCSI

from .machine import Machine
from .spec import OURS, PITCH, WAVELENGTHS, BenchSpec, Row, make_row
from .timing import alternate

SIZE, SHOTS = 128, 8
REFERENCE = "Algorithm 1 as printed, numba"


def design_cases(spec: BenchSpec, machine: Machine) -> Iterator[Row]:
    """First sweep over a Boolean code of 128 × 128 elements, 8 shots, with the edge shear and with the exact one."""
    order = np.random.default_rng(0).permutation(SIZE * SIZE)
    for shear in ("edge", "exact"):
        imager = SSCSI(
            detector_shape=(SIZE, SIZE), detector_pitch=PITCH, code_pitch=PITCH, mask_position=spec.bands / SIZE,
            wavelengths=WAVELENGTHS, shear=shear,
        )  # fmt: skip
        code = codes.boolean(shots=SHOTS, shape=imager.code_shape, seed=0)
        c1 = default_c1(spec.bands, SHOTS)
        table = imager.pair_table()
        ours = Board(table, code, c1=c1, repulsion=1.0, coupling=0.0, wrap=False)
        boards: dict[str, Board | PlainBoard] = {OURS: ours}
        if shear == "edge":  # the source's model
            boards[REFERENCE] = PlainBoard(
                code, mask_position=imager.mask_position, bands=spec.bands, c1=c1, repulsion=1.0
            )
        timings = alternate({name: _sweep(board, order) for name, board in boards.items()}, spec.seconds)
        pairs = order.size * table.window * (2 * table.pairs.shape[1] - 1)
        note = f"{1e6 * timings[OURS].ms / pairs:.1f} ns for a pair of windows, of all shots"
        # No floor: what limits it are dependent look-ups and integer operations, of which there is no peak worth naming.
        yield make_row(f"design {shear}, one sweep", timings, None, machine, note)


def _sweep(board: Board | PlainBoard, order: np.ndarray) -> Callable[[], object]:
    """Sweep from the start, on a copy: the copying takes a thousandth of it."""
    return lambda: deepcopy(board).sweep(order, np.ones(1, np.uint64))
