"""The benchmarks: the references compute the same, and every figure is there; no absolute time is asserted."""

import sys

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import shadowgram as sg
from shadowgram.cli.benchmark import bench
from shadowgram.experiments.bench import machine, memory, operators, peers, run, scaling, solvers, table, timing, work
from shadowgram.experiments.bench.references import BandLoops, EinsumCode, GPSRSteps, WaveletDCT
from shadowgram.experiments.bench.spec import OURS, BenchSpec, make_row, random_array, sscsi_operator
from shadowgram.experiments.bench.timing import Timing

TINY = BenchSpec(size=32, bands=4, shots=3, cassi_bands=5, sizes=(16, 32), seconds=0.01)
MACHINE = machine.Machine(cpu="a machine", bandwidth=10.0, peak=100.0, packed=True)


def agree(reference, H):
    x, y = random_array(H.in_shape), random_array(H.out_shape)
    np.testing.assert_allclose(reference.forward(x), H.forward(x), rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(reference.adjoint(y), H.adjoint(y), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("shear", ["exact", "edge"])
def test_references_of_the_sscsi_compute_the_same(shear):
    H = sscsi_operator(TINY, TINY.size, shear)
    effective = H.imager.effective_code(H.code).astype(np.float32)
    for reference in operators.sscsi_references(effective).values():
        agree(reference, H)


def test_references_of_the_gray_sscsi_compute_the_same():
    H = operators.gray_operator(TINY)
    effective = H.imager.effective_code(H.code).astype(np.float32)
    for reference in operators.sscsi_references(effective).values():
        agree(reference, H)


def test_references_of_the_cassis_compute_the_same():
    H, references = operators.cassi_problem(TINY)
    for reference in references.values():
        agree(reference, H)
    H, references = operators.cassi_exact_problem(TINY)
    for reference in references.values():
        agree(reference, H)
    imager = sg.ColoredCASSI(cube_shape=(4, 6, 8), wavelengths=(450, 650))
    code = sg.codes.colored(shots=3, shape=imager.code_shape, seed=0)
    agree(BandLoops(code.astype(np.float32), 4, shift=1), imager.operator(code))


def test_reference_of_the_basis_is_the_same_up_to_the_order_and_sign_of_coefficients():
    pytest.importorskip("pywt")
    shape = (4, 32, 32)
    x = random_array(shape)
    reference, psi = WaveletDCT(shape, 2), sg.operators.basis("dct-sym8", shape, levels=2)
    z = reference.analysis(x)
    assert z.dtype == np.float32
    np.testing.assert_allclose(reference.synthesis(z), x, atol=1e-5)
    np.testing.assert_allclose(np.sort(abs(z), axis=None), np.sort(abs(psi.adjoint(x)), axis=None), atol=1e-5)


def test_reference_iteration_descends():
    pytest.importorskip("pywt")
    H, y, _truth = solvers.problem(TINY, TINY.size)
    effective = H.imager.effective_code(H.code).astype(np.float32)
    basis = operators.wavelet_reference(TINY)
    steps = GPSRSteps(EinsumCode(effective), basis, y, tau=1e-3)
    values = [0.5 * float(np.vdot(y, y))]
    for _ in range(30):
        steps.step()
        z = steps.u - steps.v
        miss = H.forward(basis.synthesis(z)) - y
        values.append(0.5 * float(np.vdot(miss, miss)) + 1e-3 * float(abs(z).sum()))
    assert (np.diff(values) <= 1e-5 * values[0]).all()
    assert values[-1] < 0.01 * values[0]
    np.testing.assert_allclose(steps.gradient, basis.analysis(H.adjoint(miss)), atol=1e-3)


def test_bytes_are_those_of_the_arrays():
    H = sscsi_operator(TINY, TINY.size)
    arrays = random_array(H.in_shape).nbytes + random_array(H.out_shape).nbytes + H._masks.nbytes
    assert work.sscsi(TINY.bands, TINY.size, TINY.shots, columns=3).bytes == arrays
    C = operators.cassi_problem(TINY)[0]
    arrays = random_array(C.in_shape).nbytes + random_array(C.out_shape).nbytes + C.code.nbytes
    assert work.cassi(TINY.cassi_bands, TINY.size, 1).bytes == arrays


def test_the_floor_is_the_stronger_of_the_two_limits():
    assert MACHINE.floor_ms(work.Work(bytes=1e7, flops=1e7)) == (1.0, "bandwidth")
    assert MACHINE.floor_ms(work.Work(bytes=1e7, flops=1e9)) == (10.0, "arithmetic")


def test_row_takes_the_fastest_reference():
    timings = {OURS: Timing(2.0, 3.0), "slow": Timing(10.0, 10.0), "fast": Timing(6.0, 20.0)}
    row = make_row("case", timings, work.Work(bytes=1e7, flops=0), MACHINE)
    assert (row.reference, row.ratio, row.share) == ("fast", 3.0, 0.5)
    assert make_row("case", {OURS: Timing(2.0, 3.0)}, None, MACHINE).ratio is None


def test_functions_are_timed_in_turn():
    calls = []
    found = timing.alternate({"a": lambda: calls.append("a"), "b": lambda: calls.append("b")}, seconds=0.0)
    assert set(found) == {"a", "b"}
    assert all(0 <= t.ms <= t.median_ms for t in found.values())
    assert calls[:4] == ["a", "a", "b", "b"]  # each twice beforehand
    assert calls.count("a") > 2 < calls.count("b")


def test_machine_is_measured():
    found = machine.measure(0.01, floats=4096)
    assert found.cpu
    assert found.bandwidth > 0
    assert found.peak > 0


def test_cost_per_voxel_and_threads():
    by_case = {one.case: one for one in scaling.scaling(TINY)}
    assert set(by_case["GPSR iteration"].ns_per_voxel) == {16, 32}
    assert scaling.Scaling(case="", ns_per_voxel={1: 1.0, 2: 3.0}).deviation == 0.5
    for one in scaling.two_threads(TINY):
        assert one.one_ms > 0 < one.two_ms


def test_peak_memory_counts_more_than_the_result():
    found = {one.case: one for one in memory.peak_memory(BenchSpec(size=64, bands=8, shots=3, sizes=(64,)))}
    assert set(found) == {"GPSR", "EigenTV"}
    for one in found.values():
        assert 2 < one.traced_cubes < 100


def test_run_and_table():
    steps = []
    results = run.run(TINY, ("operators", "basis", "iteration", "reconstruction", "codes"), None, steps.append)
    assert steps == ["machine", "operators", "basis", "iteration", "reconstruction", "codes"]
    cases = [record["case"] for record in results.cases]
    assert len(cases) == len(set(cases)) == 23
    assert set(peers.CASES) <= set(cases)
    text = "\n".join(table.lines(results))
    assert all(case in text for case in cases)
    assert MACHINE.cpu not in text
    assert results.machine.cpu in text


def test_unknown_group_and_impossible_size_are_said():
    with pytest.raises(ValueError, match="there is no benchmark 'speed'; there are operators, "):
        run.run(TINY, ["speed"], None, lambda _: None)
    with pytest.raises(ValueError, match="more than the 24 bands of the benchmark, got 24"):
        BenchSpec(size=24)


@pytest.mark.skipif(not peers.SCRIPT.is_file(), reason="the peers need a checkout of the repository")
def test_peers_run_in_their_own_python_and_say_what_is_missing():
    H, _ = operators.cassi_problem(TINY)
    timings = timing.alternate({OURS: lambda: H.forward(random_array(H.in_shape))}, 0.0)
    rows = {"CASSI forward": make_row("CASSI forward", timings, None, MACHINE)}
    peers.check(sys.executable)
    found = list(peers.compare(TINY, rows, sys.executable))
    assert {one.peer.split()[0] for one in found} == {"torch", "pylops", "scico", "deepinv"}
    for one in found:
        assert one.case == "CASSI forward"
        assert (one.ms is None and "Error" in one.skipped) or one.ms > 0
    with pytest.raises(ValueError, match=r"packages of .*peers\.txt, got /no/python"):
        peers.check("/no/python")


def test_command_writes_a_table_and_json(tmp_path):
    app = typer.Typer()
    app.command()(bench)
    for name, start in (("bench.md", "- 20"), ("bench.json", "{")):
        out = tmp_path / name
        done = CliRunner().invoke(app, ["basis", "--quick", "--size", "32", "--out", str(out)], catch_exceptions=False)
        assert done.exit_code == 0
        assert out.read_text().startswith(start)
        assert "basis synthesis" in done.output
    done = CliRunner().invoke(app, ["basis", "--out", str(tmp_path / "bench.txt")])
    assert isinstance(done.exception, ValueError)
