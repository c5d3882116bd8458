"""Results of the benchmarks for people: text in columns, which is also valid Markdown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from .run import Results

Record = dict[str, Any]


def lines(results: Results) -> list[str]:
    """Everything that was measured."""
    return list(_lines(results))


def _lines(results: Results) -> Iterator[str]:
    machine, spec = results.machine, results.spec
    versions = ", ".join(f"{name} {version}" for name, version in results.versions.items())
    yield f"- {results.date} · {machine.cpu} · one thread · {versions}"
    yield (
        f"- limits measured in this run: {machine.bandwidth:.1f} GB/s, {machine.peak:.1f} GFLOP/s (float32 multiply-adds)"
        + ("" if machine.packed else "; the compiler did not use whole vectors, so the arithmetic limit is too low")
    )
    yield (
        f"- datacube {spec.size}×{spec.size}×{spec.bands}, {spec.shots} shots, float32;"
        f" CASSI {spec.size}×{spec.size}×{spec.cassi_bands}, 1 shot"
    )
    if results.cases:
        head = ("case", "ms", "median", "reference", "its ms", "ratio", "floor ms", "share", "limit")
        yield from _table(head, [_case(record) for record in results.cases])
        yield from (f"- {r['case']}: {r['note']}" for r in results.cases if r["note"])
    if results.peers:
        head = ("case", "peer", "its ms", "median", "our ms", "ratio", "difference")
        yield from _table(head, [_peer(record) for record in results.peers if not record["skipped"]])
        yield from sorted({f"- {r['peer']} left out: {r['skipped']}" for r in results.peers if r["skipped"]})
    if results.scaling:
        sizes = list(results.scaling[0]["ns_per_voxel"])  # type: ignore[call-overload]
        head = ("ns per voxel", *(f"{n}²" for n in sizes), "within")
        yield from _table(head, [_scaling(record) for record in results.scaling])
    if results.threads:
        rows = [_row(r["case"], r["one_ms"], r["two_ms"], _times(r["speedup"])) for r in results.threads]
        yield from _table(("case", "1 thread ms", "2 threads ms", "speed-up"), rows)
    if results.memory:
        rows = [_row(r["case"], r["cube_mb"], r["traced_cubes"], r["resident_cubes"]) for r in results.memory]
        yield from _table(("peak memory", "cube MB", "allocated, cubes", "resident, cubes"), rows)


def _case(r: Record) -> list[str]:
    return _row(
        r["case"], r["ms"], r["median_ms"], r["reference"], r["reference_ms"], _times(r["ratio"]), r["floor_ms"],
        "" if r["share"] is None else f"{r['share']:.0%}", r["limit"],
    )  # fmt: skip


def _peer(r: Record) -> list[str]:
    error = "" if r["error"] is None else f"{r['error']:.0e}" if r["error"] else "0"
    return _row(r["case"], r["peer"], r["ms"], r["median_ms"], r["ours_ms"], _times(r["ratio"]), error)


def _scaling(r: Record) -> list[str]:
    return _row(r["case"], *r["ns_per_voxel"].values(), f"±{r['deviation']:.0%}")


def _times(ratio: object) -> str:
    return "" if not isinstance(ratio, float) else f"{ratio:.1f}×" if ratio < 99.5 else f"{ratio:.0f}×"


def _row(*values: object) -> list[str]:
    return ["" if v is None else _number(v) if isinstance(v, float) else str(v) for v in values]


def _number(value: float) -> str:
    """Three digits, without an exponent."""
    return f"{value:.0f}" if value >= 99.95 else f"{value:#.3g}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Columns as wide as their longest entry, between empty lines."""
    widths = [max(len(row[i]) for row in (head, *rows)) for i in range(len(head))]
    yield ""
    for row in (head, ["-" * width for width in widths], *rows):
        yield "| " + " | ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)) + " |"
    yield ""
