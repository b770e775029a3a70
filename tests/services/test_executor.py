"""Sweeps over processes and over a Dask cluster: the same bits as in one process, whatever is lost."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

import psutil
import pytest
import sweep_tasks
from line_net import write_net

from nuno.cli import main
from nuno_bench import stability
from nuno_bench.sweep.executor import Cluster, Executor, LostTask, Processes
from nuno_bench.sweep.storage import SweepFile, pack, unpacked
from nuno_bench.validation import command as validate
from nuno_schemas.errors import BadInput, RunFailed

distributed = pytest.importorskip("distributed", reason="needs nuno[sweep]")


TESTS = str(Path(__file__).parent)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two workers, processes of one thread each, that start again when they are killed."""
    options = {"n_workers": 2, "threads_per_worker": 1, "processes": True, "dashboard_address": ":0"}
    with distributed.LocalCluster(host="127.0.0.1", protocol="tcp", **options) as made:
        yield made


@pytest.fixture(scope="module", params=["processes", pytest.param("dask", marks=pytest.mark.full)])
def executor(request: pytest.FixtureRequest) -> Iterator[Executor]:
    made: Any
    if request.param == "processes":
        made = Processes(2)
    else:
        made = Cluster(request.getfixturevalue("cluster").scheduler_address)
    yield made
    made.close()


def test_every_task_comes_back_and_refusals_are_results(executor: Executor) -> None:
    found = dict(executor.run(sweep_tasks.square, [3, -1, 4]))
    assert (found[3], found[4]) == (9, 16)
    assert isinstance(found[-1], BadInput)
    assert (found[-1].problem, found[-1].field, found[-1].value) == ("negative", "number", -1)


def test_tasks_are_taken_only_when_they_can_be_started(executor: Executor) -> None:
    taken: list[int] = []

    def numbers() -> Iterator[int]:
        for number in range(9):
            taken.append(number)
            yield number

    running = executor.run(sweep_tasks.square, numbers())
    next(running)
    assert len(taken) <= 4
    assert dict(running).keys() | {0, 1} >= set(range(9))


def test_what_a_task_raises_ends_the_sweep(executor: Executor) -> None:
    with pytest.raises((RuntimeError, ZeroDivisionError), match="division by zero"):
        list(executor.run(sweep_tasks.divide, [0]))
    assert dict(executor.run(sweep_tasks.divide, [2])) == {2: 0.5}


@pytest.mark.full
def test_a_task_whose_process_is_lost_is_run_again(executor: Executor, tmp_path: Path) -> None:
    tasks = [(str(tmp_path / "once"), number) for number in range(5)]
    assert dict(executor.run(sweep_tasks.die_at_first, tasks)) == {task: task[1] for task in tasks}


@pytest.mark.full
def test_a_task_that_always_loses_its_process_is_named_and_the_others_are_done(tmp_path: Path) -> None:
    executor = Processes(2)
    tasks = [(str(tmp_path / "always"), number) for number in range(4)]
    found = dict(executor.run(sweep_tasks.die_at_first, tasks))
    executor.close()
    lost = found.pop(tasks[2])
    assert isinstance(lost, LostTask) and "lost twice" in lost.reason
    assert sorted(map(str, found.values())) == ["0", "1", "3"]
    assert len((tmp_path / "always").read_text()) == 2


def test_no_process_is_left_behind() -> None:
    before = {child.pid for child in psutil.Process().children(recursive=True)}
    executor = Processes(2)
    running = executor.run(sweep_tasks.square, [1, 2, 3, 4])
    next(running)
    running.close()
    executor.close()
    kinds = [child.cmdline() for child in psutil.Process().children() if child.pid not in before]
    assert not [kind for kind in kinds if "spawn_main" in " ".join(kind)]


@pytest.mark.full
def test_processes_end_with_the_one_that_started_them(tmp_path: Path) -> None:
    """Though it is killed, and can tell them nothing."""
    marks = [tmp_path / "one", tmp_path / "two"]
    code = "import sys, sweep_tasks; from nuno_bench.sweep.executor import Processes; "
    code += "list(Processes(2).run(sweep_tasks.tell_process, sys.argv[1:]))"
    parent = subprocess.Popen([sys.executable, "-c", code, *map(str, marks)], env=os.environ | {"PYTHONPATH": TESTS})
    deadline = time.monotonic() + 60.0
    while not all(mark.exists() for mark in marks) and time.monotonic() < deadline:
        time.sleep(0.1)
    processes = [psutil.Process(int(mark.read_text())) for mark in marks]
    parent.kill()
    parent.wait()
    assert psutil.wait_procs(processes, 20.0)[1] == []


def scene_with_a_file(folder: Path) -> Path:
    """A user's scene whose net lies in a file of a folder beside it."""
    folder.mkdir()
    (folder / "nets").mkdir()
    path = write_net(folder)
    (folder / "line.npz").rename(folder / "nets" / "line.npz")
    path.write_text(path.read_text().replace("line.npz", "nets/line.npz"))
    return path


def test_a_scene_travels_with_its_files(tmp_path: Path) -> None:
    path = scene_with_a_file(tmp_path / "user")
    packed = pack(path, ["damping=0.25"])
    assert [name for name, _ in packed.files] == ["nets/line.npz"]
    here = packed.digest
    path.parent.rename(tmp_path / "gone")
    with unpacked(packed, ["duration=0.1"]) as loaded:
        assert (loaded.scene.damping, loaded.scene.duration, loaded.file) == (0.25, 0.1, str(path))
        assert loaded.files.resolve("nets/line.npz").read_bytes() == packed.files[0][1]
        place = loaded.files.folder
    assert not place.exists()
    assert pack(tmp_path / "gone" / "line.yaml", ["damping=0.25"]).digest == here
    assert pack(tmp_path / "gone" / "line.yaml", ["damping=0.5"]).digest != here


def rows(path: Path, executor: Executor) -> list[tuple[Any, ...]]:
    settings = [s for s in stability.settings_of(path, [])[0] if s.value in (0.1, 1.0)]
    kept = SweepFile(path.parent / "rows.jsonl", {}, False, print)
    points, omissions = stability.measure_all(settings, ["leapfrog", "rk4"], kept, 600.0, executor, print)
    assert [text for text in omissions if "resolution" not in text] == []
    return [(p.axis, p.value, p.solver, p.dt, p.outcome, repr(p.error), repr(p.gained)) for p in points]


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Any, ...]]:
    """The rows of one process."""
    return rows(scene_with_a_file(tmp_path_factory.mktemp("alone") / "user"), Executor())


@pytest.mark.full
def test_maps_are_the_same_bits_though_a_worker_is_lost_in_mid_sweep(
    executor: Executor, alone: list[tuple[Any, ...]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mark = tmp_path / "killed"
    monkeypatch.setattr(stability, "measure_setting", sweep_tasks.Dying(str(mark)))
    assert rows(scene_with_a_file(tmp_path / "user"), executor) == alone
    assert len(alone) >= 20
    assert mark.exists()


@pytest.mark.full
def test_laws_are_the_same_bits(executor: Executor) -> None:
    parts = validate.choose_parts(["one step", "momentum"], ["rk4", "leapfrog"])

    def outcomes(where: Executor) -> list[Any]:
        found = validate.check_all(parts, where, lambda text: None)
        return [replace(one, seconds=0.0) for one in found]

    assert outcomes(executor) == outcomes(Executor())


@contextmanager
def worker_of(scheduler: Any, *path: str) -> Iterator[None]:
    """A worker by hand, of one thread; `path` comes before what is installed."""
    flags = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1"]
    command = [sys.executable, "-m", "distributed.cli.dask_worker", scheduler.scheduler_address, *flags]
    environment, quiet = os.environ | {"PYTHONPATH": os.pathsep.join(path)}, subprocess.DEVNULL
    worker = subprocess.Popen(command, env=environment, stdout=quiet, stderr=quiet)
    try:
        yield
    finally:
        worker.kill()
        worker.wait()


@pytest.fixture
def scheduler() -> Iterator[Any]:
    """A scheduler without workers."""
    with distributed.LocalCluster(n_workers=0, host="127.0.0.1", protocol="tcp", dashboard_address=":0") as made:
        yield made


@pytest.mark.full
def test_a_worker_with_another_version_is_refused_by_name(scheduler: Any, tmp_path: Path) -> None:
    old = tmp_path / "nuno-0.0.1.dist-info"
    old.mkdir()
    (old / "METADATA").write_text("Metadata-Version: 2.1\nName: nuno\nVersion: 0.0.1\n")
    with worker_of(scheduler, str(tmp_path)), pytest.raises(BadInput, match="other versions") as caught:
        Cluster(scheduler.scheduler_address)
    assert f"nuno: {metadata.version('nuno')} here, 0.0.1 there" in str(caught.value.value)


@pytest.mark.full
def test_a_cluster_whose_workers_are_all_gone_ends_the_sweep(scheduler: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nuno_bench.sweep.executor.WORKER_SECONDS", 0.5)
    with pytest.raises(BadInput, match="has no worker"):
        Cluster(scheduler.scheduler_address)
    monkeypatch.setattr("nuno_bench.sweep.executor.WORKER_SECONDS", 60.0)
    with worker_of(scheduler, TESTS):
        cluster = Cluster(scheduler.scheduler_address)
        running = cluster.run(sweep_tasks.square, [2, 3])
        assert next(running) == (2, 4)
    monkeypatch.setattr("nuno_bench.sweep.executor.PATIENCE", 0.5)
    with pytest.raises(RunFailed, match="no worker"):
        list(running)
    cluster.close()


@pytest.mark.full
def test_a_scheduler_that_ends_in_mid_sweep_is_said(tmp_path: Path) -> None:
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as made:
        cluster = Cluster(made.scheduler_address)
        running = cluster.run(sweep_tasks.square, iter(range(9)))
        next(running)
    with pytest.raises(RunFailed, match="connection to the Dask scheduler"):
        list(running)
    cluster.close()


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:PORT", "nonsense", "ftp://a:1"])
def test_what_is_no_scheduler_is_refused_within_seconds(
    address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nuno_bench.sweep.executor.CONNECT_SECONDS", 1.0)
    with socket.socket() as silent:
        # A port that is taken by somebody who never answers: the worst of addresses.
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        address = address.replace("PORT", str(silent.getsockname()[1]))
        command = ["validate", "one step", "--solvers", "rk4", "--json", str(tmp_path / "out"), "--dask", address]
        began = time.monotonic()
        assert main(command) == 2
        assert time.monotonic() - began < 30.0, "a client of Dask itself would wait for ever"
    said = capsys.readouterr().err
    assert "no Dask scheduler can be reached" in said and address in said and "dask scheduler" in said
    assert "Traceback" not in said
    assert not (tmp_path / "out").exists()


@pytest.mark.full
def test_without_dask_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(BadInput, match="not installed") as caught:
        Cluster("tcp://127.0.0.1:1")
    assert "nuno[sweep]" in str(caught.value)
