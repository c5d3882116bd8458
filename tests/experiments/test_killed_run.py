"""Driver and workers are killed at random moments: nothing is lost, doubled or left over (benchmarks/killed_run.py, in small)."""

from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.mark.skipif(not BENCHMARKS.exists(), reason="the benchmarks are not part of this copy")
def test_a_run_that_is_killed_again_and_again(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    import killed_run

    found = killed_run.torture(tmp_path, tasks=20, kills=4, seed=1)
    assert found["failures"] == []
    assert (found["kills of the driver"], found["kills of workers"]) == (2, 2)
