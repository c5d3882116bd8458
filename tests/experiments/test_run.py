"""Runs: every task once, wherever and in whatever order it is computed; failures and interrupts leave the rest whole."""

import builtins
import dataclasses
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import shadowgram as sg
from shadowgram.experiments import dask_run, holdings
from shadowgram.experiments import run as running
from shadowgram.experiments.journal import FILE_NAME, open_journal, read_journal
from shadowgram.experiments.run import Threads, run
from shadowgram.experiments.source import generated, recorded
from shadowgram.experiments.tasks import Failure, code_commit, compute, make_tasks

# Two of these at the same time share a journal.
DRIVER = """
import sys
from pathlib import Path
import little
from shadowgram.experiments.journal import open_journal
from shadowgram.experiments.run import Threads, run
from shadowgram.experiments.source import generated
study = little.make_study([little.Spec(number=n, trouble="wait", log=sys.argv[2]) for n in range(40)])
with open_journal(Path(sys.argv[1])) as journal, Threads(2) as executor:
    summary = run(study, generated(), False, journal, executor=executor, progress=lambda state: None)
print(summary.computed, summary.reused)
"""


def compute_all(study, folder, executor, progress=lambda state: None):
    """Summary of a run of all of a study."""
    with open_journal(folder) as journal, executor:
        return run(study, generated(), False, journal, executor=executor, progress=progress)


def drawn(study, folder):
    """PNG file and records of a study."""
    with read_journal(folder) as journal:
        records = holdings.gather(study, generated(), False, journal)
    return holdings.figure_png(study, records), records


def test_same_results_from_threads_and_processes(little, tmp_path):
    study = little.make_study([little.Spec(number=n) for n in range(9)])
    executors = {"one": Threads(1), "four": Threads(4), "processes": dask_run.LocalWorkers(2)}
    found = {}
    for name, executor in executors.items():
        (tmp_path / name).mkdir()
        assert compute_all(study, tmp_path / name, executor).computed == 9
        found[name] = drawn(study, tmp_path / name)
    picture, records = found["one"]
    for other_picture, other_records in found.values():
        assert other_picture == picture
        for record, other in zip(records, other_records, strict=True):
            assert record.values == other.values
            assert (record.values["threads"], record.values["blas"]) == (1, 1)
            np.testing.assert_array_equal(record.arrays["file"], other.arrays["file"])


def test_the_figure_does_not_depend_on_the_order(little, tmp_path):
    specs = [little.Spec(number=n) for n in range(6)]
    study = little.make_study(specs)
    for name, order in (("forth", specs), ("back", specs[::-1])):
        (tmp_path / name).mkdir()
        compute_all(little.make_study(order), tmp_path / name, Threads(1))
    assert drawn(study, tmp_path / "forth")[0] == drawn(study, tmp_path / "back")[0]


class Failing(Threads):
    """Executor that computes at once, and has lost its workers when it is given another task."""

    given = 0

    def slots(self):
        return 1 + self.given

    def submit(self, task, report):
        self.given += 1
        if self.given > 2:
            raise OSError("the workers are gone")
        report(task, compute(task))


def test_results_that_came_before_the_executor_failed_are_kept(little, tmp_path):
    study = little.make_study([little.Spec(number=n) for n in range(5)])
    with pytest.raises(OSError, match="the workers are gone"):
        compute_all(study, tmp_path, Failing(1))
    assert compute_all(study, tmp_path, Threads(1)).reused == 2


def test_more_workers_than_a_machine_can_hold_are_refused():
    with pytest.raises(ValueError, match="--workers takes a whole number from 1 to"):
        dask_run.LocalWorkers(10_000)


def test_a_task_is_computed_once(little, tmp_path):
    log = str(tmp_path / "log")
    specs = [little.Spec(number=n, log=log) for n in (0, 1, 2, 1, 0)]
    study = little.make_study(specs)
    summary = compute_all(study, tmp_path, Threads(4))
    assert (summary.total, summary.computed, summary.reused) == (3, 3, 0)
    more = little.make_study([*specs, little.Spec(number=3, log=log)])
    summary = compute_all(more, tmp_path, Threads(4))
    assert (summary.total, summary.computed, summary.reused) == (4, 1, 3)
    assert sorted(Path(log).read_text().split()) == ["0", "1", "2", "3"]
    assert [record.spec["number"] for record in drawn(study, tmp_path)[1]] == [0, 1, 2, 1, 0]


def test_another_revision_is_computed_anew(little, tmp_path):
    study = little.make_study([little.Spec(number=1)])
    compute_all(study, tmp_path, Threads(1))
    newer = dataclasses.replace(study, revision=2)
    assert compute_all(newer, tmp_path, Threads(1)).computed == 1
    assert compute_all(study, tmp_path, Threads(1)).reused == 1


@pytest.mark.parametrize(
    ("trouble", "error"),
    [("raise", r"ZeroDivisionError: division by zero \(little.py, line \d+\)"), ("exit", "SystemExit: 3 .*")],
)
def test_a_task_that_raises_does_not_stop_the_others(little, tmp_path, trouble, error):
    good = [little.Spec(number=n) for n in range(6)]
    study = little.make_study([*good[:2], little.Spec(number=9, trouble=trouble), *good[2:]])
    summary = compute_all(study, tmp_path, Threads(2))
    assert summary.computed == 6
    ((label, said),) = summary.failed
    assert label == f"number=9 trouble={trouble}"
    assert re.fullmatch(error, said)
    with read_journal(tmp_path) as journal, pytest.raises(ValueError, match=r"has 6 of the 7 records .*1 failed: "):
        holdings.gather(study, generated(), False, journal)


def test_a_task_that_failed_is_tried_again(little, tmp_path, monkeypatch):
    study = little.make_study([little.Spec(number=n, trouble="raise" if n == 1 else "") for n in range(3)])
    assert len(compute_all(study, tmp_path, Threads(2)).failed) == 1
    mended = dataclasses.replace(
        study, run=lambda spec, scene: little.compute(dataclasses.replace(spec, trouble=""), scene)
    )
    summary = compute_all(mended, tmp_path, Threads(2))
    assert (summary.computed, summary.reused, summary.failed) == (1, 2, ())
    with read_journal(tmp_path) as journal:
        assert journal.failures(task.key for task in make_tasks(study, generated(), False)) == {}


def test_a_task_that_kills_every_worker_is_given_up_alone(little, tmp_path):
    troubles = {3: "die", 5: "raise"}
    study = little.make_study([little.Spec(number=n, trouble=troubles.get(n, "")) for n in range(10)])
    summary = compute_all(study, tmp_path, dask_run.LocalWorkers(2))
    assert summary.computed == 8
    failed = dict(summary.failed)
    assert failed["number=3 trouble=die"] == "every worker that took it died"
    assert failed["number=5 trouble=raise"].startswith("ZeroDivisionError")
    assert len(failed) == 2


def test_two_drivers_at_once(little, tmp_path):
    log = tmp_path / "log"
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
    command = [sys.executable, "-c", DRIVER, tmp_path, log]
    drivers = [subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    counts = []
    for driver in drivers:
        said, _ = driver.communicate(timeout=60)
        assert driver.returncode == 0
        counts.append([int(count) for count in said.split()])
    assert all(computed + reused == 40 for computed, reused in counts)
    assert sum(computed for computed, _ in counts) == 40  # results that were kept
    assert {int(line) for line in log.read_text().split()} == set(range(40))


def test_what_another_driver_has_finished_meanwhile_is_not_computed(little, tmp_path):
    log = tmp_path / "log"
    study = little.make_study([little.Spec(number=n, log=str(log)) for n in range(4)])

    def first_helped(spec, scene):
        if spec.number == 0:  # another driver finishes the third task
            with open_journal(tmp_path) as journal:
                journal.add(compute(make_tasks(study, scene, False)[2]))
        return little.compute(spec, scene)

    summary = compute_all(dataclasses.replace(study, run=first_helped), tmp_path, Threads(1))
    assert (summary.computed, summary.reused) == (3, 1)
    assert log.read_text().split() == ["2", "0", "1", "3"]


def test_an_interrupt_keeps_what_is_finished_and_the_next_run_goes_on(little, tmp_path):
    specs = [little.Spec(number=n, trouble="interrupt" if n == 4 else "wait") for n in range(10)]
    study = little.make_study(specs)
    summary = compute_all(study, tmp_path, Threads(2))
    assert summary.interrupted
    assert summary.dropped == 0
    assert 5 <= summary.computed <= 6  # the one that interrupts, and the one beside it
    assert summary.finished >= 1
    again = compute_all(study, tmp_path, Threads(2))
    assert not again.interrupted
    assert (again.computed, again.reused) == (10 - summary.computed, summary.computed)


def test_an_interrupt_does_not_wait_for_long_tasks(little, tmp_path, monkeypatch):
    monkeypatch.setattr(running, "GRACE", 0.2)
    specs = [little.Spec(number=0, trouble="slow"), little.Spec(number=1, trouble="interrupt"), little.Spec(number=2)]
    summary = compute_all(little.make_study(specs), tmp_path, Threads(2))
    assert summary.interrupted
    assert (summary.computed, summary.dropped) == (1, 1)
    assert summary.seconds < 0.9


def test_a_full_disk_ends_the_run_and_loses_nothing(little, tmp_path):
    study = little.make_study([little.Spec(number=n) for n in range(40)])
    with open_journal(tmp_path) as journal, Threads(2) as executor:
        pages = journal._db.execute("PRAGMA page_count").fetchone()[0]
        journal._db.execute(f"PRAGMA max_page_count = {pages + 6}")
        with pytest.raises(OSError, match=f"{FILE_NAME}: the disk is full; what is in it is safe"):
            run(study, generated(), False, journal, executor=executor, progress=lambda state: None)
    summary = compute_all(study, tmp_path, Threads(2))
    assert summary.reused > 0
    assert summary.computed + summary.reused == 40


def test_progress_counts_and_estimates(little, tmp_path):
    study = little.make_study([little.Spec(number=n, trouble="wait") for n in range(12)])
    states = []
    compute_all(study, tmp_path, Threads(2), states.append)
    done = [state.done for state in states]
    assert done == sorted(done)
    assert (done[0], done[-1]) == (0, 12)
    assert states[0].seconds_left is None
    assert states[0].label == "number=0"
    assert states[-1] == running.Progress(done=12, total=12, label="", seconds_left=0.0)
    middle = next(state for state in states if state.done == 6)
    assert 0.05 < middle.seconds_left < 1.5  # six tasks of 0.05 s or a little more, two at a time
    states = []
    more = little.make_study([little.Spec(number=n, trouble="wait") for n in range(14)])
    compute_all(more, tmp_path, Threads(2), states.append)
    assert states[0].seconds_left is not None  # from the records that are there


def test_labels_name_what_differs(little):
    specs = [little.Spec(number=n, trouble=trouble) for n in (1, 2) for trouble in ("", "slow")]
    tasks = make_tasks(little.make_study(specs), generated(), False)
    assert [task.label for task in tasks][1:3] == ["number=1 trouble=slow", "number=2 trouble="]


def test_a_worker_with_another_version_is_told(little):
    (task,) = make_tasks(little.make_study([little.Spec(number=1)]), generated(), False)
    outcome = compute(dataclasses.replace(task, version="0.0.1"))
    assert isinstance(outcome, Failure)
    assert f"has shadowgram {sg.__version__}, not 0.0.1; install the same" in outcome.error


def test_a_scene_that_changes_during_the_run_is_told(little, tmp_path):
    path = tmp_path / "scene.nc"
    sg.scenes.write(sg.scenes.chart(size=16, bands=3, seed=0), path)
    scene = recorded(path)
    (task,) = make_tasks(little.make_study([little.Spec(number=1)]), scene, False)
    assert compute(task).scene == scene
    other = dataclasses.replace(scene, digest="0")
    outcome = compute(dataclasses.replace(task, scene=other))
    assert "scene.nc has changed since the run began" in outcome.error


@pytest.mark.parametrize("values", [{"x": np.zeros(2)}, {"x": {1, 2}}])
def test_values_must_be_what_json_holds(little, values):
    study = dataclasses.replace(
        little.make_study([little.Spec(number=1)]), run=lambda spec, scene: little.Result(values=values)
    )
    (task,) = make_tasks(study, generated(), False)
    assert "arrays belong in its 'arrays'" in compute(task).error


def test_a_record_says_which_code_made_it(little):
    (task,) = make_tasks(little.make_study([little.Spec(number=1)]), generated(), False)
    entry = compute(task)
    assert entry.version == sg.__version__
    assert entry.commit == code_commit()
    if (Path(sg.__file__).parents[2] / ".git").exists():
        assert len(entry.commit.removesuffix("-dirty")) == 40
    else:
        assert entry.commit == ""


def test_workers_need_the_package_distributed(monkeypatch):
    imported = builtins.__import__

    def without(name, *arguments, **more):
        if name == "distributed":
            raise ModuleNotFoundError(name)
        return imported(name, *arguments, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    for make in (lambda: dask_run.LocalWorkers(2), lambda: dask_run.Cluster("tcp://127.0.0.1:8786")):
        with pytest.raises(ValueError, match=r"need the package distributed: install shadowgram\[cluster\]"):
            make()


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://"])
def test_no_scheduler_answers(monkeypatch, address):
    monkeypatch.setattr(dask_run, "CONNECT", 0.5)
    with pytest.raises(OSError, match=f"no Dask scheduler answers at {address}"), dask_run.Cluster(address):
        pass


def test_scratch_folders_of_dead_processes_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(dask_run.tempfile, "tempdir", str(tmp_path))
    left, young = tmp_path / f"{dask_run.SCRATCH}left", tmp_path / f"{dask_run.SCRATCH}young"
    for folder in (left, young):
        folder.mkdir()
        (folder / "lock").touch()
    os.utime(left / "lock", (0, 0))
    with dask_run.scratch_folder() as used:
        os.utime(Path(used) / "lock", (0, 0))
        assert not left.exists()
        with dask_run.scratch_folder() as other:
            assert Path(used).exists()
            assert other != used
    assert list(tmp_path.iterdir()) == [young]


def test_a_cluster_that_is_running(little, tmp_path):
    from distributed import LocalCluster

    study = little.make_study([little.Spec(number=n) for n in range(5)])
    # A worker in a process of its own, as on a real cluster: in this one it would share locks with the tests.
    with LocalCluster(n_workers=1, threads_per_worker=2, processes=True, dashboard_address=None) as cluster:
        executor = dask_run.Cluster(cluster.scheduler_address)
        with executor:
            assert executor.slots() == 2
        summary = compute_all(study, tmp_path, dask_run.Cluster(cluster.scheduler_address))
    assert summary.computed == 5
