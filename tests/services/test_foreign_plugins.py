"""Plugins of other distributions that do what no plugin may: named, and contained."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foreign_packages import Packages, packages
from scenes import write_scene

import nuno
from nuno.cli import main
from nuno.plugin_contract import registry
from nuno.runtime import supervisor
from nuno.runtime import supervisor as silence
from nuno.runtime.service import Options
from nuno.scene import scene_file
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import State
from nuno_schemas.messages import EVENT, FrameStatus

__all__ = ["packages"]

FORCE = """\
class Push:
    name = "push"
    Config = Config
    def prepare(self, config, fabric, seed):
        {prepare}
        return Term("python", push)
def push(x, v, t, out):
    {push}
"""


def force(push: str = "pass", prepare: str = "pass") -> str:
    return FORCE.format(push=push, prepare=prepare)


def test_a_name_that_two_packages_claim_is_refused_and_hinders_no_other(
    packages: Packages, capsys: pytest.CaptureFixture[str]
) -> None:
    packages.add("otherwind", force(), "wind = otherwind:Push", "push = otherwind:Push")
    with pytest.raises(BadInput, match="two installed packages offer the plugin 'wind'") as refusal:
        registry.load("nuno.forces", "wind")
    assert refusal.value.value == [f"nuno {metadata.version('nuno')}", "otherwind 1.2"]
    assert refusal.value.remedy == "uninstall one of them: pip uninstall otherwind"
    assert registry.load("nuno.forces", "push").name == "push"
    assert main(["plugins", "forces"]) == 0
    listed = capsys.readouterr().out
    assert "otherwind 1.2   claimed twice" in listed
    assert "particle_wind" in listed


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("import nowhere_at_all\n", "ModuleNotFoundError: No module named 'nowhere_at_all'"),
        ("raise SystemExit(3)\n", "SystemExit: 3"),
        ("raise BaseException('no')\n", "BaseException: no"),
        ("raise KeyboardInterrupt\n", "KeyboardInterrupt: "),
        ("import os\nos._exit(0)\n", r"SystemExit: os\._exit\(0\)"),
        ("class Other: pass\n", "AttributeError: .*has no attribute 'Push'"),
        ("class Push:\n    def __init__(self): 1 / 0\n", "ZeroDivisionError: division by zero"),
    ],
)
def test_one_that_cannot_be_imported_is_named_with_its_package_and_line(
    packages: Packages, code: str, words: str
) -> None:
    packages.add("broken", code, "push = broken:Push", "fine = broken:Push")
    with pytest.raises(BadInput, match=f"'push' of broken 1.2 cannot be imported: {words}") as refusal:
        registry.load("nuno.forces", "push")
    assert str(refusal.value.value).startswith("broken:Push, ")
    assert "broken.py:" in str(refusal.value.value) or code.startswith("class Other")
    assert registry.load("nuno.forces", "wind").name == "wind"


@pytest.mark.usefixtures("interruptible")
def test_the_users_own_interrupt_of_an_import_is_no_fault_of_the_plugin(packages: Packages) -> None:
    packages.add("slow", "import signal\nsignal.raise_signal(signal.SIGINT)\n" + force(), "push = slow:Push")
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        registry.load("nuno.forces", "push")
    assert signal.getsignal(signal.SIGINT) is before


def test_an_unknown_name_is_answered_with_where_was_looked(packages: Packages) -> None:
    packages.add("pushing", force(), "push = pushing:Push")
    with pytest.raises(BadInput, match=r"no plugin 'psh' in nuno\.forces") as refusal:
        registry.load("nuno.forces", "psh")
    assert refusal.value.limit == f"looked in nuno.forces of nuno {metadata.version('nuno')}, pushing 1.2"
    assert str(refusal.value.remedy).startswith("did you mean 'push'?")
    with pytest.raises(BadInput) as refusal:
        registry.load("nuno.forces", "leapfrog")
    assert "nuno.integrators has one" in str(refusal.value.limit)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("class Push:\n    name = 'push'\n", "the plugin 'push' of pushing 1.2 in nuno.forces has no Config"),
        (force().replace("prepare", "other"), "the plugin 'push' of pushing 1.2 in nuno.forces has no prepare"),
        (
            force().replace("Config = Config", "class Config(Config):\n        def __init__(self, **given): {}['k']"),
            "the configuration of 'push' cannot be read: KeyError: 'k'",
        ),
    ],
)
def test_one_that_lacks_what_its_kind_owes_is_named(
    packages: Packages, tmp_path: Path, capsys: pytest.CaptureFixture[str], code: str, words: str
) -> None:
    packages.add("pushing", code, "push = pushing:Push")
    scene = write_scene(tmp_path, forces=[{"plugin": "push"}], duration=0.1)
    assert main(["plan", str(scene)]) == 2
    said = capsys.readouterr().err
    assert words in said and "forces[0]" in said


OLD = """
from nuno_schemas.fabric import Memory
from nuno_schemas.system import StepLimit
class Old:
    name, order, explicit, adaptive = "old", 1, True, False
    Config = Config
    def prepare(self, config, system, state):
        return Memory()
    def limit(self, config, system, state):
        return StepLimit(1.0, 1.0, 0.0)
"""


def test_a_solver_of_an_earlier_version_is_told_what_it_lacks(
    packages: Packages, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before the first frame."""
    packages.add("older", OLD, "old = older:Old", group="nuno.integrators")
    scene = write_scene(tmp_path, solver={"plugin": "old", "dt": "1 ms"}, duration=0.1)
    for command in (["plan", str(scene)], ["run", str(scene), "--no-view", "--no-record"]):
        assert main(command) == 2
        said = capsys.readouterr().err
        assert "the plugin 'old' of older 1.2 in nuno.integrators has no making_lists" in said
        assert "docs/reference/protocols.md" in said and "Traceback" not in said


def test_one_whose_class_is_abstract_is_told_what_to_write(packages: Packages) -> None:
    """It has been imported well, and reinstalling it would write no method."""
    abstract = (
        "from abc import ABC, abstractmethod\nclass Base(ABC):\n    @abstractmethod\n    def prepare(self): ...\n"
    )
    packages.add("half", abstract + "class Push(Base):\n    name = 'push'\n    Config = Config\n", "push = half:Push")
    with pytest.raises(BadInput, match=r"the plugin 'push' of half 1\.2 in nuno\.forces has no prepare") as refusal:
        registry.load("nuno.forces", "push")
    assert str(refusal.value.remedy).startswith("write it")


FLOAT32 = "raise type('TypingError', (Exception,), {})('array(float32, 2d, C)')"
"""As numba says it of buffers of another kind than `stages`."""
FAULTS = {
    "prepare": (force(prepare="raise KeyError('k')"), "failed in prepare: KeyError: 'k' ("),
    "float32": (force(prepare=FLOAT32), "a method's own buffers, too, as `stages` are"),
    "exit": (force(prepare="raise SystemExit(0)"), "failed in prepare: SystemExit: 0"),
    "infinity": (force("out[2] += np.inf"), "at 0.5 s its force is inf at row 2"),
    "shape": (force("out += np.zeros((7, 3))"), "failed in its force: ValueError: operands could not be broadcast"),
    "returned": (force("return -x"), "its force returns ndarray, which nothing uses: add the force to `out`"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_force_that_fails_is_named(packages: Packages, fault: str) -> None:
    code, words = FAULTS[fault]
    packages.add("pushing", code, "push = pushing:Push")

    def push() -> None:
        term = registry.load("nuno.forces", "push").prepare(None, None, 0)
        term.data(np.zeros((4, 3)), np.zeros((4, 3)), 0.5, np.zeros((4, 3)))

    with pytest.raises(RunFailed, match=r"the plugin 'push' of pushing 1\.2 in nuno\.forces") as failure:
        push()
    assert words in str(failure.value)


def test_a_force_is_not_to_blame_for_what_came_before_it(packages: Packages) -> None:
    packages.add("pushing", force("return out"), "push = pushing:Push")
    push = registry.load("nuno.forces", "push").prepare(None, None, 0).data
    lost = np.full((4, 3), np.nan)
    push(lost, np.zeros((4, 3)), 0.0, np.zeros((4, 3)))
    push(np.zeros((4, 3)), np.zeros((4, 3)), 0.0, lost)


LATE = {
    "nan": (force("out[3, 1] = np.nan if t > 0.03 else 0.0"), "s its force is nan at row 3"),
    "raise": (force("if t > 0.03: raise ValueError('no')"), "failed in its force: ValueError: no"),
    "interrupt": (force("if t > 0.03: raise KeyboardInterrupt"), "failed in its force: KeyboardInterrupt"),
    "generator": (force("if t > 0.03: raise GeneratorExit"), "failed in its force: GeneratorExit"),
}


@pytest.mark.parametrize("fault", LATE)
def test_a_run_ends_at_the_frame_that_fails_and_keeps_its_recording(
    packages: Packages, tmp_path: Path, fault: str
) -> None:
    code, words = LATE[fault]
    packages.add("pushing", code, "push = pushing:Push")
    record = tmp_path / "run.mcap"
    scene = write_scene(tmp_path, forces=[{"plugin": "push"}], duration=0.1)
    with pytest.raises(RunFailed) as failure:
        nuno.run(scene, record=record)
    assert "the plugin 'push' of pushing 1.2 in nuno.forces" in str(failure.value)
    assert words in str(failure.value)
    with nuno.open(record) as recording:
        assert not recording.complete
        assert max(frame.t for frame in recording.frames()) == pytest.approx(0.02)
        events = [recording.json(m.payload) for m in recording.messages([f"{EVENT.name}/simulation"])]
    (error,) = (event for event in events if event["kind"] == "error")
    assert fault == "nan" or "pushing.py" in error["args"]["trace"]


@pytest.mark.parametrize("place", ["push", "prepare"])
def test_one_that_leaves_the_folder_leaves_the_recording_where_it_was_asked_for(
    packages: Packages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    packages.add("pushing", "import os\n" + force(**{place: "os.chdir('/')"}), "push = pushing:Push")
    scene = write_scene(tmp_path, forces=[{"plugin": "push"}], duration=0.1)
    monkeypatch.chdir(tmp_path)
    assert main(["run", str(scene), "--no-view", "--record", "run.mcap"]) == 0
    assert Path.cwd() == tmp_path
    with nuno.open(tmp_path / "run.mcap") as recording:
        assert recording.complete


ENDS = {
    "python": ("import os\n", "os._exit(0)", "pushing 1.2 in nuno.forces failed in its force: SystemExit: os._exit(0)"),
    "thread": ("import os, threading\n", "threading.Thread(target=os._exit, args=(0,)).start()", ""),
    "compiled": ("import ctypes\n", "ctypes.CDLL(None).exit(0)", "failed: compiled code has ended the process"),
}


@pytest.mark.quick(way=["compiled"])
@pytest.mark.parametrize("way", ENDS)
def test_one_that_ends_the_process_does_not_end_it_as_done(packages: Packages, tmp_path: Path, way: str) -> None:
    """Exit code 0 says that there is a recording, whoever asks for it."""
    head, end, words = ENDS[way]
    packages.add("pushing", head + force(f"if t > 0.03: {end}"), "push = pushing:Push")
    scene = write_scene(tmp_path, forces=[{"plugin": "push"}], duration=0.1)
    command = [sys.executable, "-m", "nuno", "run", str(scene), "--no-view", "--record", "run.mcap"]
    path = os.environ | {"PYTHONPATH": str(packages.folder / "pushing")}
    ended = subprocess.run(command, cwd=tmp_path, env=path, capture_output=True, text=True, timeout=120)
    assert ended.returncode == (0 if way == "thread" else 1)
    assert words in ended.stderr
    if way == "compiled":
        assert not (tmp_path / "run.mcap").exists()
    else:
        with nuno.open(tmp_path / "run.mcap") as recording:
            assert recording.complete == (way == "thread") and len(list(recording.frames())) > 1


def test_how_numpy_treats_errors_stays_as_it_was(packages: Packages) -> None:
    packages.add("pushing", force(prepare="np.seterr(all='raise')"), "push = pushing:Push")
    before = np.geterr()
    registry.load("nuno.forces", "push").prepare(None, None, 0)
    assert np.geterr() == before


STEPS = {
    "nan": ("state.x[4, 2] = np.nan", "leaves a state whose x is nan at row 4"),
    "shape": ("state.x = state.x[:-1]", r"leaves a state whose x is float64 \(5, 3\), not float64 \(6, 3\)"),
    "dtype": ("state.v = state.v.astype(np.float32)", r"leaves a state whose v is float32 \(6, 3\)"),
}


@pytest.mark.parametrize("fault", STEPS)
def test_what_a_solver_leaves_is_looked_at(packages: Packages, fault: str) -> None:
    change, words = STEPS[fault]
    code = f"class Step:\n    name = 'step'\n    Config = Config\n    def advance(self, state):\n        {change}\n"
    packages.add("stepping", code, "step = stepping:Step", group="nuno.integrators")
    state = State(np.zeros((6, 3)), np.zeros((6, 3)))
    with pytest.raises(RunFailed, match=f"the plugin 'step' of stepping 1.2.*{words}"):
        registry.load("nuno.integrators", "step").advance(state)


def test_a_motion_that_is_not_finite_is_named(packages: Packages) -> None:
    code = (
        "class Fly:\n    name = 'fly'\n    Config = Config\n    def prepare(self, config, files):\n"
        "        at = np.array([[1.0, 0, 0, 0]]), np.array([[0.0, np.inf, 0]])\n"
        "        return Mover(('a',), np.array([-1], np.int32), np.zeros((1, 3)), lambda t: at)\n"
    )
    packages.add("flying", code, "fly = flying:Fly", group="nuno.motions")
    mover: Any = registry.load("nuno.motions", "fly").prepare(None, None)
    with pytest.raises(RunFailed, match="at 2 s its translation is inf at row 0"):
        mover.pose(2.0)


def test_a_step_that_does_not_end_is_told_with_its_frame(
    packages: Packages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The force waits until the supervisor has said that nothing comes; then the run goes on to its end."""
    waits = "if t > 0.03: GATE.wait(60)\nimport threading\nGATE = threading.Event()"
    packages.add("pushing", force(waits), "push = pushing:Push")
    monkeypatch.setattr(silence, "QUIET_SECONDS", 0.2)
    said: list[str] = []

    def hear(status: FrameStatus | str) -> None:
        if isinstance(status, str):
            said.append(status)
            if "no frame for" in status:
                sys.modules["pushing"].GATE.set()  # type: ignore[attr-defined]

    scene = scene_file.read(write_scene(tmp_path, forces=[{"plugin": "push"}], duration=0.1))
    outcome = supervisor.supervise(scene, Options(), progress=hear)
    assert outcome.state == "done"
    told = [text for text in said if "no frame for 0.2 s: the simulation service is still in frame" in text]
    assert told and "Ctrl-C" in told[0]
