"""What scans found, for people and as JSON."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from shadowgram.xray.scan import PencilMap, Scan
    from shadowgram.xray.scene import Scene


def scan_values(found: Scan, out: Path, journal: Path | None, seconds: float) -> dict[str, object]:
    """A scan, as JSON can hold it."""
    return {
        "file": out,
        "route": found.route,
        "noisy": found.noisy,
        "shots": len(found.counts),
        "photons_per_shot": found.photons_per_shot,
        "exposure": found.exposure,
        "open": float(found.codes.mean()),
        "counts": found.counts.tolist(),
        "standard_error": found.standard_error.tolist(),
        "background": None if found.background is None else found.background.tolist(),
        "background_error": None if found.background_error is None else found.background_error.tolist(),
        "orders": None if found.orders is None else dict(found.orders),
        "journal": journal,
        "seconds": seconds,
    }


def scan_lines(found: Scan, out: Path, scene: Scene) -> list[str]:
    """What a scan counted, on average over its shots."""
    kind = "counts" if found.noisy else "mean counts"
    lines = [
        *([scene.title] if scene.title else []),
        f"{len(found.counts)} shots of {found.photons_per_shot:.4g} photons ({found.exposure:.4g} s), {found.route} {kind}",
        f"{100 * found.codes.mean():.3g} % of the cells are holes",
        _row("a shot", found.counts, found.standard_error),
    ]
    if found.background is not None and found.background_error is not None:
        lines.append(_row("without target", found.background, found.background_error))
        lines.append(_row("difference", found.signal, found.signal_error))
    orders = {} if found.orders is None else {name: value for name, value in found.orders.items() if value > 0}
    lines += ["mean by what the photon did before"] if orders else []
    lines += [f"  {name:<16}{value:>10.1f}" for name, value in orders.items()]
    return [*lines, f"→ {out}"]


def _row(name: str, values: np.ndarray, errors: np.ndarray) -> str:
    mean_error = math.sqrt(float((errors**2).mean()))
    return (
        f"{name:<18}{values.mean():>10.1f}, {values.min():.1f} to {values.max():.1f}; standard error {mean_error:.3g}"
    )


def pencil_values(found: PencilMap, out: Path, journal: Path, seconds: float) -> dict[str, object]:
    """A map of pencil beams, as JSON can hold it."""
    return {
        "file": out,
        "noisy": found.noisy,
        "shape": list(found.counts.shape),
        "photons": found.photons,
        "counts": found.counts.tolist(),
        "standard_error": found.standard_error.tolist(),
        "target": found.target.tolist(),
        "journal": journal,
        "seconds": seconds,
    }


def pencil_lines(found: PencilMap, out: Path) -> list[str]:
    """What pencil beams counted, on average over the pixels."""
    rows, columns = found.counts.shape
    return [
        f"{rows} × {columns} pixels (y × x) of {found.pitch:g} mm, {found.photons} photons each",
        _row("a pixel", found.counts, found.standard_error),
        f"{'from the target':<18}{found.target.mean():>10.1f}, {found.target.min():.1f} to {found.target.max():.1f}",
        f"→ {out}",
    ]
