"""Random damage to files and folders of the formats that captures come in; the full number: benchmarks/fuzz_readers.py."""

import importlib.util
import json
import sys
from collections import Counter
from pathlib import Path

import pytest

FUZZ = Path(__file__).parents[2] / "benchmarks/fuzz_readers.py"


@pytest.mark.skipif(not FUZZ.exists(), reason="the benchmarks are not part of this copy")
@pytest.mark.parametrize("name", ["envi", "tiff", "png", "frames"])
def test_random_damage(name, capfd, monkeypatch):
    pytest.importorskip("tifffile")
    spec = importlib.util.spec_from_file_location("fuzz_readers", FUZZ)
    fuzz = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "fuzz_readers", fuzz)
    spec.loader.exec_module(fuzz)
    fuzz.work(name, 1, 0, 300)  # in this process: these readers call no foreign libraries that could end it
    results = [json.loads(line) for line in capfd.readouterr().out.splitlines()]
    counts = Counter(outcome for outcome, *_ in results)
    assert set(counts) <= {"refused", "same", "changed"}, [one for one in results if one[0] in ("error", "zeros")]
    assert counts.total() == 300
    assert counts["refused"] > 100
