"""Sweeps: a scene for each combination of values, in one table, over processes and a Dask cluster."""

from __future__ import annotations

import base64
import csv
import io
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
import sweep_tasks
from line_net import write_net
from PIL import Image
from scenes import CHAIN, write_chain, write_scene

import nuno
from nuno.cli import main
from nuno_bench import stability
from nuno_bench.sweep import grid
from nuno_bench.sweep.executor import Cluster, Executor, Processes, SweepFile, pack, unpacked
from nuno_bench.sweep.grid import values_of
from nuno_bench.validation import command as validate
from nuno_schemas.errors import BadInput, RunFailed

OVER = {"solver.plugin": ["symplectic_euler", "rk4"], "solver.dt": [1e-3, "2 ms", 1.0]}


@pytest.fixture
def roots(tmp_path: Path) -> list[Path]:
    write_chain(tmp_path)
    return [tmp_path]


def test_each_combination_is_the_run_of_its_values(roots: list[Path]) -> None:
    """In order, the first field's values changing last; what is refused has a row that says why, and no picture."""
    found = nuno.sweep(CHAIN, OVER, roots=roots, jobs=1, side="front")
    pairs = [(one, step) for one in OVER["solver.plugin"] for step in OVER["solver.dt"]]
    assert [(row["solver.plugin"], row["solver.dt"]) for row in found.rows] == pairs
    for (solver, step), row in zip(pairs, found.rows, strict=True):
        if step == 1.0:
            assert row["state"] == "refused" and "solver.dt: " in row["why"] and "picture" not in row
            continue
        result = nuno.run(CHAIN, {"solver.plugin": solver, "solver.dt": step}, roots=roots)
        assert (row["state"], row["digest"], row["dt"]) == ("done", result.digest, result.report["dt"])
        with result.recording as recording:
            assert row["energy_kinetic"] == recording.series()["energy_kinetic"][-1]
        with Image.open(io.BytesIO(base64.b64decode(row["picture"]))) as image:
            assert image.size == grid.SIZE
    table = found.to_dataframe()
    assert list(table["state"]) == ["done", "done", "refused"] * 2 and "picture" not in table
    assert found._repr_html_().count("<img") == 4 and found._repr_html_().count("<tr>") == 7


def test_values_may_need_each_other_come_twice_or_be_of_numpy(roots: list[Path]) -> None:
    """A field that only one solver has; and each combination has a row, also of the same values."""
    over: dict[str, Any] = {"solver.plugin": ["xpbd"], "solver.iterations": np.array([3, 3]), "seed": iter([1])}
    found = nuno.sweep(CHAIN, over, roots=roots, jobs=1, side="")
    assert [row["solver.iterations"] for row in found.rows] == [3, 3]
    assert found.rows[0]["digest"] == found.rows[1]["digest"]


def test_a_run_that_fails_has_its_row_and_leaves_nothing(
    roots: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    changes = {"allow_unstable": True, "solver.dt": "20 ms"}
    found = nuno.sweep(CHAIN, {"duration": [0.1, 20]}, changes, roots=roots, jobs=1, side="")
    assert [row["state"] for row in found.rows] == ["done", "failed"] and "diverged" in found.rows[1]["why"]
    assert not list((tmp_path / "temporary").iterdir())


@pytest.mark.full
def test_processes_find_the_same(roots: list[Path]) -> None:
    digests = [
        [row["digest"] for row in nuno.sweep(CHAIN, {"seed": [1, 2]}, roots=roots, jobs=jobs, side="").rows]
        for jobs in (1, 2)
    ]
    assert digests[0] == digests[1]


def test_an_interrupted_sweep_goes_on_where_it_was(roots: list[Path], tmp_path: Path) -> None:
    """What is done is not run again; another sweep's is not taken."""
    over, out, heard = {"duration": [0.04, 0.06, 0.08]}, tmp_path / "out", list[str]()

    def stop(text: str) -> None:
        heard.append(text)
        if len(heard) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        nuno.sweep(CHAIN, over, roots=roots, jobs=1, out=out, progress=stop)
    found = nuno.sweep(CHAIN, over, roots=roots, jobs=1, out=out, resume=True, progress=heard.append)
    assert [text.partition(":")[0] for text in heard] == ["1 of 3", "2 of 3", "3 of 3"]
    assert [row["simulated_seconds"] for row in found.rows] == pytest.approx([0.04, 0.06, 0.08])
    with (out / "sweep.csv").open(newline="") as stream:
        assert [float(row["duration"]) for row in csv.DictReader(stream)] == [0.04, 0.06, 0.08]
    with pytest.raises(BadInput, match="another sweep"):
        nuno.sweep(CHAIN, {"seed": [1], **over}, roots=roots, jobs=1, out=out, resume=True)
    with pytest.raises(BadInput, match="another sweep"):
        nuno.sweep(CHAIN, over, "seed=3", roots=roots, jobs=1, out=out, resume=True)


def test_the_command_writes_a_page_and_a_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    sheet = ["sweep", "hanging-sheet", "--set", "duration=0.04", "--jobs", "1", "--over"]
    assert main([*sheet, "objects.0.model.fabric=denim, jacket"]) == 0
    said = capsys.readouterr()
    assert "jacket" in said.out and said.err.startswith("objects.0.model.fabric: denim, jacket\n")
    (folder,) = (tmp_path / "recordings" / "sweep").iterdir()
    rows = json.loads((folder / "sweep.json").read_text())["rows"]
    assert [row["objects.0.model.fabric"] for row in rows] == ["denim", "jacket"]
    assert (folder / "sweep.html").read_text().count("<img") == 2
    assert main([*sheet, "solver.dt=9 s", "--side", "none"]) == 1
    assert "refused, solver.dt" in capsys.readouterr().err


def test_values_are_those_of_yaml() -> None:
    assert values_of("a.b=1 ms, 2,[0, 1, 0],{plugin: rk4}, x") == (
        "a.b", ["1 ms", 2, [0, 1, 0], {"plugin": "rk4"}, "x"]
    )  # fmt: skip


REFUSED: dict[str, tuple[Callable[[list[Path]], Any], str]] = {
    "a field": (lambda to: nuno.sweep(CHAIN, {"solver.dtt": [1, 2]}, roots=to, jobs=1), "over: solver.dtt: no such"),
    "a value": (lambda to: nuno.sweep(CHAIN, {"duration": [1, "soon"]}, roots=to, jobs=1), "over: duration: "),
    "no values": (lambda to: nuno.sweep(CHAIN, {"duration": []}, roots=to, jobs=1), "over: nothing to sweep over"),
    "a side": (lambda to: nuno.sweep(CHAIN, {"seed": [1]}, roots=to, side="fromt", jobs=1), "did you mean 'front'"),
    "a text": (lambda to: nuno.sweep(CHAIN, {"seed": "12"}, roots=to, jobs=1), "over a list of values"),
    "no list": (lambda to: nuno.sweep(CHAIN, {"damping": 0.3}, roots=to, jobs=1), "over a list of values"),
    "nowhere to go on": (lambda to: nuno.sweep(CHAIN, {"seed": [1]}, roots=to, jobs=1, resume=True), "name the folder"),
    "no processes": (lambda to: nuno.sweep(CHAIN, {"seed": [1]}, roots=to, jobs=0), "at least one"),
    "a field that is set": (
        lambda to: nuno.sweep(CHAIN, {"seed": [1]}, "seed=7", roots=to, jobs=1),
        'limit:  "seed=7"',
    ),
    "a part that is set": (
        lambda to: nuno.sweep(CHAIN, {"solver": [{"plugin": "rk4"}]}, {"solver.dt": 5e-4}, roots=to, jobs=1),
        "over: the sweep gives this field its values",
    ),
    "a flat cloth's side": (lambda _: nuno.sweep("dye/drops", {"seed": [1]}, side="left", jobs=1), "lies flat"),
}


@pytest.fixture
def unrun(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """Points that were run nevertheless."""
    ran: list[object] = []
    monkeypatch.setattr(grid, "measure", ran.append)
    return ran


@pytest.mark.parametrize("fault", REFUSED)
def test_what_cannot_be_swept_is_refused_before_anything_runs(
    fault: str, roots: list[Path], unrun: list[object]
) -> None:
    call, words = REFUSED[fault]
    with pytest.raises(BadInput) as caught:
        call(roots)
    assert words in str(caught.value) and "--" not in str(caught.value)
    assert not unrun


def test_the_command_names_its_flag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(write_scene(tmp_path))
    for over, words in (("solver.dtt=1", "--over: solver.dtt: no such field"), ("x", "--over: a sweep goes over")):
        assert main(["sweep", path, "--over", over]) == 2
        assert words in capsys.readouterr().err
    assert main(["sweep", path]) == 2
    assert "--over: nothing to sweep over" in capsys.readouterr().err


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Points that are done at once."""
    monkeypatch.setattr(grid, "measure", lambda point: {"state": "done", "digest": " ".join(point.overrides)})


def interrupt(text: str) -> None:
    raise KeyboardInterrupt


@pytest.mark.usefixtures("quick")
def test_two_sweeps_at_once_do_not_share_a_folder(roots: list[Path], tmp_path: Path) -> None:
    """The second is refused, also with `resume`, and leaves the rows of the first as they are."""
    out, refused = tmp_path / "out", list[str]()

    def other(text: str) -> None:
        before = (out / grid.KEPT).read_bytes()
        for resume in (False, True):
            with pytest.raises(BadInput, match="another sweep is writing there") as caught:
                nuno.sweep(CHAIN, {"seed": [3]}, roots=roots, jobs=1, out=out, resume=resume)
            refused.append(str(caught.value))
        assert (out / grid.KEPT).read_bytes() == before

    found = nuno.sweep(CHAIN, {"seed": [1, 2]}, roots=roots, jobs=1, out=out, progress=other)
    assert len(refused) == 4 and all(str(out) in text and "another out" in text for text in refused)
    with (out / "sweep.csv").open(newline="") as stream:
        assert [row["digest"] for row in csv.DictReader(stream)] == [row["digest"] for row in found.rows]
    nuno.sweep(CHAIN, {"seed": [3]}, roots=roots, jobs=1, out=out)


@pytest.mark.usefixtures("quick")
def test_an_interrupted_sweep_is_not_lost_to_another(roots: list[Path], tmp_path: Path) -> None:
    """Its rows stay until they are resumed or removed; the message says which of both would work."""
    over, out, heard = {"seed": [1, 2]}, tmp_path / "out", list[str]()
    with pytest.raises(KeyboardInterrupt):
        nuno.sweep(CHAIN, over, roots=roots, jobs=1, out=out, progress=interrupt)
    kept = (out / grid.KEPT).read_bytes()
    with pytest.raises(BadInput, match=r"(?s)would be lost.*continue it with resume, give another out, or remove"):
        nuno.sweep(CHAIN, over, roots=roots, jobs=1, out=out)
    for changed, what in (({"seed": [3]}, "over"), ({**over, "damping": [0.1]}, "over")):
        with pytest.raises(BadInput, match=rf"(?s)would be lost.*has another {what}\n.*: give another out, or remove"):
            nuno.sweep(CHAIN, changed, roots=roots, jobs=1, out=out)
    with pytest.raises(BadInput, match=r"(?s)would be lost.*it has another scene\n"):
        nuno.sweep(CHAIN, over, "damping=0.3", roots=roots, jobs=1, out=out)
    assert (out / grid.KEPT).read_bytes() == kept
    nuno.sweep(CHAIN, over, roots=roots, jobs=1, out=out, resume=True, progress=heard.append)
    assert [text[:6] for text in heard] == ["2 of 2"]
    nuno.sweep(CHAIN, over, roots=roots, jobs=1, out=out, resume=True, progress=heard.append)
    assert len(heard) == 1, "a finished one has nothing left"
    nuno.sweep(CHAIN, {"seed": [3]}, roots=roots, jobs=1, out=out, progress=heard.append)
    assert heard[1] == f"the finished sweep in {out / grid.KEPT} is replaced" and heard[2][:6] == "1 of 1"
    (out / grid.KEPT).write_bytes(kept[: kept.index(b"\n") + 1])
    nuno.sweep(CHAIN, over, roots=roots, jobs=1, out=out)  # what has finished nothing has nothing to lose


@pytest.mark.usefixtures("quick")
def test_all_tables_have_the_same_columns(roots: list[Path], tmp_path: Path) -> None:
    """Also the one for a reason, where all is well."""
    nuno.sweep(CHAIN, {"seed": [1, 2]}, roots=roots, jobs=1, out=tmp_path)
    with (tmp_path / "sweep.csv").open(newline="") as stream:
        assert [list(row) for row in csv.DictReader(stream)] == [["seed", "state", "why", "digest"]] * 2


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
    assert isinstance(lost, RunFailed) and "lost twice" in str(lost)
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


def test_the_command_takes_mappings_and_lists_as_values(tmp_path: Path) -> None:
    scene, out = str(write_scene(tmp_path)), str(tmp_path / "swept")
    over = ["gravity=[0, -1.6, 0]", "solver={plugin: rk4, dt: 1 ms}, {plugin: leapfrog, dt: 1 ms}"]
    flags = [text for one in over for text in ("--over", one)]
    assert main(["sweep", scene, *flags, "--set", "duration=0.04", "--side", "none", "--out", out]) == 0
    with (tmp_path / "swept" / "sweep.csv").open(newline="") as stream:
        assert [row["state"] for row in csv.DictReader(stream)] == ["done"] * 2


@pytest.mark.full
def test_values_may_be_files_of_the_scene_or_of_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = scene_with_a_file(tmp_path / "user")
    net = (path.parent / "nets" / "line.npz").read_bytes()
    (path.parent / "other.npz").write_bytes(net)
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "third.npz").write_bytes(net)
    monkeypatch.chdir(tmp_path)
    command = ["sweep", "user/line.yaml", "--set", "duration=0.1", "--side", "none", "--out", "swept"]
    assert main([*command, "--over", "objects.0.model.file=nets/line.npz,other.npz,here/third.npz"]) == 0
    with (tmp_path / "swept" / "sweep.csv").open(newline="") as stream:
        found = list(csv.DictReader(stream))
    assert [row["state"] for row in found] == ["done"] * 3 and len({row["digest"] for row in found}) == 1


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
