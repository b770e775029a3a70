"""Plugins of other distributions: what they do that none may is named and contained, their results are checked."""

from __future__ import annotations

import logging
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
from scenes import BALL, write_scene

import nuno
from nuno.cli import main
from nuno.plugin_contract import registry
from nuno.runtime import supervisor
from nuno.runtime import supervisor as silence
from nuno.runtime.service import Options
from nuno.scene import scene_file
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Fabric, State
from nuno_schemas.messages import EVENT, FrameStatus
from nuno_schemas.plugin import Mover

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
class Old:
    name, order, explicit, adaptive = "old", 1, True, False
    Config = Config
    def prepare(self, config, system, state):
        return Memory()
"""


def test_a_solver_is_told_what_it_lacks(packages: Packages, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Before the first frame."""
    packages.add("older", OLD, "old = older:Old", group="nuno.integrators")
    scene = write_scene(tmp_path, solver={"plugin": "old", "dt": "1 ms"}, duration=0.1)
    for command in (["plan", str(scene)], ["run", str(scene), "--no-view", "--no-record"]):
        assert main(command) == 2
        said = capsys.readouterr().err
        assert "the plugin 'old' of older 1.2 in nuno.integrators has no limit" in said
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
    "moving": (force("x[2] -= 0.01"), "failed in its force: ValueError: output array is read-only"),
    "slowing": (force("v *= 0.9"), "failed in its force: ValueError: output array is read-only"),
    "returned": (force("return -x"), "its force returns ndarray, which nothing uses: add the force to `out`"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_force_that_fails_is_named(packages: Packages, fault: str) -> None:
    code, words = FAULTS[fault]
    packages.add("pushing", code, "push = pushing:Push")

    def push() -> None:
        term = registry.load("nuno.forces", "push").prepare(None, None, 0)
        term.data(np.ones((4, 3)), np.ones((4, 3)), 0.5, np.zeros((4, 3)))

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


GIVEN = """\
from dataclasses import replace
from nuno_kernels import kernel
from nuno_kernels.forces.vertex import vertex_force
from nuno_kernels.formula import formula
from nuno_kernels.terms import register
from typing import Annotated, NamedTuple
from nuno_schemas.bodies import *
from nuno_schemas.dye import *
from nuno_schemas.fabric import *
from nuno_schemas.operation import *
from nuno_schemas.plugin import *
from nuno_schemas.fabric import Yarns
class Typed(NamedTuple):
    at: Annotated[Float, "m", 3]
    k: float = 1.0
    of: Annotated[Int, "n"] | None = None
    also: Annotated[Float, "m"] = np.zeros(2)
register(Typed, name="typed", counts=lambda term: {{}})
class Unknown(NamedTuple):
    k: float
class Idle(NamedTuple):
    k: float
register(Idle, name="idle")
@formula
class Law(NamedTuple):
    k: float
    def limit(self, phi, room):
        return self.k * phi
@formula
class Lost(NamedTuple):
    k: float
    def distance(self, x, y, z):
        return x / (x * x + y * y + z * z)
@formula
class Shifted(NamedTuple):
    k: float
    def limit(self, phi, room):
        return phi + self.k
@formula
class Endless(NamedTuple):
    k: float
    def limit(self, phi, room):
        return phi / 0.0 if phi == 0.0 else phi
@formula
class Uncompiled(NamedTuple):
    k: float
    def limit(self, phi, room):
        return self.b * phi
@formula
class Steep(NamedTuple):
    k: float
    def distance(self, x, y, z):
        return x - self.k
    def gradient(self, x, y, z):
        return 2.0, 0.0, 0.0
@formula
class Flat(NamedTuple):
    k: float
    def distance(self, x, y, z):
        return x - self.k
    def gradient(self, x, y, z):
        return x, y
@vertex_force("two")
class Two(NamedTuple):
    k: float
    def force(self, x):
        return self.k * x[0], self.k * x[1]
@vertex_force("scaled")
class Scaled(NamedTuple):
    k: float
    def force(self, x):
        return self.k * x
@vertex_force("heavy")
class Heavy(NamedTuple):
    k: float
    def force(self, v, t):
        return self.k * v[0], self.k * v[1], 0
    def energy(self, x):
        return x
@vertex_force("right")
class Right(NamedTuple):
    k: float
    def force(self, v, t):
        return np.cross(np.ones(3), np.array(v))
    def energy(self, x):
        return 0
@kernel
def lost(term, block, origin, x, v, force):
    force[0, 0] += term.lost
@kernel
def lost_energy(term, x):
    return term.lost
class Lostly(NamedTuple):
    k: float
register(Lostly, "lostly", block=lost)
class Measured(NamedTuple):
    k: float
register(Measured, "measured", energy=lost_energy)
def cloth():
    x = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0, 0.1], [0.1, 0, 0.1]])
    pairs = np.array([[0, 1], [0, 2], [1, 3], [2, 3], [1, 2]], np.int32)
    springs = Springs.from_pairs(pairs, np.full(5, 10.0), np.full(5, 0.1), np.zeros(5))
    one = np.ones(1, np.int32)
    hinges = Hinges(np.array([[1, 2, 0, 3]], np.int32), one, one, np.ones(1), np.zeros(1))
    faces = np.array([[0, 1, 2], [1, 3, 2]], np.int32)
    pinned = np.array([True, False, False, False])
    return Fabric("own", x, np.zeros_like(x), np.full(4, 0.01), pinned, faces, springs, hinges)
def ball():
    at = np.zeros((1, 3))
    return BodyShape(("world",), np.zeros(1, np.int8), np.zeros(1, np.int32), at, at, np.full(1, 0.1))
def tetrahedron():
    x = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    kind = np.full(1, MESH, np.int8)
    return replace(ball(), kind=kind, radius=np.zeros(1), vertices=x, faces=faces, owner=np.zeros(4, np.int32))
def mover():
    at = np.array([[1.0, 0, 0, 0]]), np.zeros((1, 3))
    return Mover(("a",), np.array([-1], np.int32), np.zeros((1, 3)), lambda t: at)
def yarns():
    return Yarns(np.array([0, 2], np.int32), np.array([0, 2], np.int32), np.full(1, 0.25), np.zeros(1, np.int8))
def cells():
    half, yes = np.full((2, 3, 4), 0.5), np.ones((2, 3, 4), bool)
    return Cells(yes, yes, half, half, 0 * half, 1e-4, Tortuosity(1, 1, 1, 1, 1, 1))
def amounts():
    return DyeState(np.zeros((1, 2, 3, 4)), np.zeros((1, 2, 3, 4)))
class Own:
    name = "own"
    Config = Config
    def {method}(self, *given):
        return {result}
"""

FABRIC = ("nuno.models", "build")
SPRINGS = "replace(cloth(), springs=replace(cloth().springs, {}))"
HINGES = "replace(cloth(), hinges=replace(cloth().hinges, {}))"
BODY, DRAWN = ("nuno.colliders", "build"), "replace(tetrahedron(), {})"
ISOTHERM = ("nuno.isotherms", "prepare")
MOTION, OWN, CLOTH = ("nuno.motions", "prepare"), ("nuno.forces", "prepare"), ("nuno.dye_cloths", "build")
FORM = "replace(tetrahedron(), kind=np.full(1, FIELD, np.int8), fields=({},))"
TYPED = "Term('own', (Typed({}),))"
WRONG: list[tuple[tuple[str, str], str, str]] = [
    (FABRIC, "None", "it is NoneType, not Fabric"),
    (FABRIC, SPRINGS.format("first=np.array([[0, 1], [0, 2], [1, 4], [2, 3], [1, 2]], np.int32)"),
     "springs.first is 4 at row 2, outside 0 to 3"),
    (FABRIC, SPRINGS.format("first=cloth().springs.first - 1"), "springs.first is -1 at row 0, outside 0 to 3"),
    (FABRIC, SPRINGS.format("count=np.array([1, 1, 1, 3, 1], np.int32)"), "springs of run 3 go on to vertex 4"),
    (FABRIC, SPRINGS.format("first=np.zeros((5, 2), np.int32)"), "springs.first names a vertex twice at row 0"),
    (FABRIC, SPRINGS.format("first=cloth().springs.first.astype(int)"),
     "springs.first is int64 (5, 2), not int32 (n, 2)"),
    (FABRIC, SPRINGS.format("k=np.array([1.0, 1, -1, 1, 1])"), "springs.k is -1.0 at row 2, less than 0"),
    (FABRIC, SPRINGS.format("k=np.full(5, np.nan)"), "springs.k is nan at row 0"),
    (FABRIC, SPRINGS.format("k=np.ones(3)"), "springs.k is float64 (3,), not float64 (5,)"),
    (FABRIC, SPRINGS.format("c=np.ones(10)[::2]"), "springs.c is not C-contiguous: give numpy.ascontiguousarray of it"),
    (FABRIC, SPRINGS.format("lock=np.ones(5)"), "springs.lock and springs.k_lock are not both given"),
    (FABRIC, SPRINGS.format("lock=np.ones(5), k_lock=np.ones(5)"),
     "springs.k_lock is 1.0 at spring 0, less than its k"),
    (FABRIC, HINGES.format("first=np.array([[1, 2, 0, -1]], np.int32)"), "hinges.first is -1 at row 0, outside 0 to 3"),
    (FABRIC, HINGES.format("k=np.full(1, -1.0)"), "hinges.k is -1.0 at row 0, less than 0"),
    (FABRIC, "replace(cloth(), faces=cloth().faces + 1)", "faces is 4 at row 1, outside 0 to 3"),
    (FABRIC, "replace(cloth(), cells=np.array([[0, 1, 3, 7]], np.int32))", "cells is 7 at row 0, outside 0 to 3"),
    (FABRIC, "replace(cloth(), mass=np.zeros(4))", "mass is 0.0 at row 0, not above 0"),
    (FABRIC, "replace(cloth(), position=np.zeros((3, 4)).T)", "position is not C-contiguous"),
    (FABRIC, "replace(cloth(), velocity=np.full((4, 3), np.inf))", "velocity is inf at row 0"),
    (FABRIC, "replace(cloth(), pinned=np.zeros(4))", "pinned is float64 (4,), not bool (4,)"),
    (FABRIC, "replace(cloth(), uv=np.zeros((4, 2)))", "uv is float64 (4, 2), not float32 (4, 2)"),
    (FABRIC, "replace(cloth(), bindings=(Binding(np.array([9], np.int32), 'b', 'f'),))",
     "bindings[0].vertices is 9 at row 0, outside 0 to 3"),
    (FABRIC, "replace(cloth(), bindings=(Binding(np.array([1], np.int32), 'b', 'f'),))", "some that are not pinned"),
    (FABRIC, "replace(cloth(), yarns=replace(yarns(), links=np.array([0, 5], np.int32)))",
     "yarns.links is 5 at row 1, outside 0 to 4"),
    (FABRIC, "replace(cloth(), yarns=replace(yarns(), mu=np.full(1, 0.5)))", "yarns.mu is 0.5 at row 0, outside 0"),
    (BODY, "replace(ball(), radius=np.full(1, np.nan))", "radius is nan at row 0"),
    (BODY, "replace(ball(), radius=np.zeros(1))", "radius is not above 0 at row 0"),
    (BODY, "replace(ball(), frame=np.ones(1, np.int32))", "frame is 1 at row 0, outside 0 to 0"),
    (BODY, "replace(ball(), frames=('world', 'hips'))", "frames are 2, of a motion of 1"),
    (BODY, "replace(ball(), kind=np.full(1, 9, np.int8))", "kind is 9 at row 0, outside 0 to 5"),
    (BODY, "replace(ball(), kind=np.full(1, SKIN, np.int8))", "skins are 0, of 1 primitives that have one"),
    (BODY, "replace(ball(), pose=print)", "pose is one of a body without a motion"),
    (BODY, "replace(ball(), kind=np.full(1, PLANE, np.int8))", "b is no unit normal at row 0"),
    (BODY, "replace(ball(), kind=np.full(1, FIELD, np.int8))", "fields are 0, of 1 primitives that have one"),
    (BODY, FORM.format("print"), "fields[0] is builtin_function_or_method, not a named tuple with a compiled distance"),
    (BODY, FORM.format("Law(1.0)"), "fields[0] is Law, not a named tuple with a compiled distance"),
    (BODY, FORM.format("Lost(1.0)"), "fields[0].distance is nan at (0, 0, 0)"),
    (BODY, FORM.format("Steep(1.0)"), "fields[0].gradient has length 2 at [0.0, 0.0, 0.0], not 1"),
    (BODY, FORM.format("Flat(1.0)"), "fields[0].gradient returns (0.0, 0.0), not 3 numbers"),
    (BODY, DRAWN.format("faces=tetrahedron().faces + 1"), "faces is 4 at row 1, outside 0 to 3"),
    (BODY, DRAWN.format("owner=np.ones(4, np.int32)"), "owner is 1 at row 0, outside 0 to 0"),
    (MOTION, "replace(mover(), parents=np.zeros(1, np.int32))", "parents is 0 at row 0, which does not come before it"),
    (OWN, "Term('python', add, omega_squared=np.nan) if (add := print) else 0", "omega_squared is nan"),
    (OWN, "Term('python', add, damping_rate=-1.0) if (add := print) else 0", "damping_rate is -1.0, less than 0"),
    (OWN, "Term('python', 3)", "data is int, neither a tuple of named tuples nor a function f(x, v, t, out)"),
    (OWN, "Term('wind', (np.zeros(3),))", "data is tuple, neither a tuple of named tuples"),
    (OWN, TYPED.format("np.zeros(3)"), "data[0].at is float64 (3,), not float64 (n, 3)"),
    (OWN, TYPED.format("np.zeros((2, 3), int)"), "data[0].at is int64 (2, 3), not float64 (n, 3)"),
    (OWN, TYPED.format("np.array([[0, 0, 0], [0, np.nan, 0]])"), "data[0].at is nan at row 1"),
    (OWN, TYPED.format("np.zeros((2, 3)), np.inf"), "data[0].k is inf"),
    (OWN, TYPED.format("np.zeros((2, 3)), 1.0, np.zeros(3, np.int32)"), "data[0].of is int32 (3,), not int32 (4,)"),
    (OWN, TYPED.format("np.zeros((2, 3)), (1.0, 2.0)"), "data[0].k is tuple, no number"),
    (OWN, "Term('own', (Unknown(1.0),))", "data[0] is of type Unknown, which has no kernels"),
    (OWN, "Term('own', (Idle(1.0),))", "data[0] is of type Idle, which has no kernels, and so does nothing"),
    (OWN, "Term('own', (Two(1.0),))", "data[0].force returns (0.0, 0.0), not 3 numbers"),
    (OWN, "Term('own', (Scaled(1.0),))", "data[0].force cannot be compiled: No implementation of "),
    (OWN, "Term('own', (Heavy(1.0),))", "data[0].energy returns (0.0, 0.0, 0.0), not a number"),
    (OWN, "Term('own', (Lostly(1.0),))", "data[0] block cannot be compiled: Unknown attribute 'lost' of type Lostly"),
    (OWN, "Term('own', (Measured(1.0),))", "data[0] energy cannot be compiled: Unknown attribute 'lost' of type"),
    (CLOTH, "(replace(cells(), porosity=2 * np.ones((2, 3, 4))), amounts())",
     "cells.porosity is 2.0 at row 0, outside 0 to 1"),
    (CLOTH, "(cells(), DyeState(np.zeros((2, 3, 4)), np.zeros((2, 3, 4))))",
     "phi is float64 (2, 3, 4), not float64 (1, 2, 3, 4)"),
    (("nuno.integrators", "limit"), "StepLimit(np.nan, 1.0, 0.0)", "dt is nan"),
    (("nuno.integrators", "advance"), "StepReport('fine', 1)",
     "status is 'fine', not ok, diverged, unconverged or left"),
    (("nuno.renderers", "render"), "np.zeros((4, 5, 3))", "it is float64 (4, 5, 3), not uint8 (n, n, 3)"),
    (ISOTHERM, "Isotherm('partition', -1.0)", "first is -1.0, less than 0"),
    (ISOTHERM, "Isotherm('own', law=print)", "law is builtin_function_or_method, not a named tuple with a compiled"),
    (ISOTHERM, "Isotherm('own', law=Typed(1.0, 2.0))", "law is Typed, not a named tuple with a compiled limit"),
    (ISOTHERM, "Isotherm('own', law=Law('1'))", "law.k is str, not float"),
    (ISOTHERM, "Isotherm('own', law=Law(np.inf))", "law.k is inf"),
    (ISOTHERM, "Isotherm('own', law=Law(-1.0))", "law.limit falls beyond (0, 0.1)"),
    (ISOTHERM, "Isotherm('own', law=Shifted(0.1))", "law.limit is 0.1 at (0, 0.1), not 0"),
    (ISOTHERM, "Isotherm('own', law=Endless(0.1))", "law.limit is nan at (0, 0.1)"),
    (ISOTHERM, "Isotherm('own', law=Uncompiled(0.1))", "law.limit cannot be compiled: Unknown attribute 'b' of type"),
]  # fmt: skip
GOOD = [
    (FABRIC, "cloth()"),
    (FABRIC, "replace(cloth(), yarns=yarns(), bindings=(Binding(np.zeros(1, np.int32), 'b', 'f'),))"),
    (BODY, "ball()"),
    (BODY, "tetrahedron()"),
    (MOTION, "mover()"),
    (OWN, "Term('python', print)"),
    (OWN, TYPED.format("np.zeros((2, 3)), 2, np.zeros(4, np.int32)")),
    (OWN, "Term('own', (Right(1.0),))"),
    (CLOTH, "(cells(), amounts())"),
    (("nuno.integrators", "limit"), "StepLimit(np.inf, 1.0, 0.0)"),
    (ISOTHERM, "Isotherm('partition', 1.0)"),
    (ISOTHERM, "Isotherm('own', law=Law(0.5))"),
]


def give(packages: Packages, place: tuple[str, str], result: str) -> Any:
    """What a foreign plugin's method gives."""
    group, method = place
    packages.add("given", GIVEN.format(method=method, result=result), "own = given:Own", group=group)
    x = np.zeros((4, 3))
    fabric = Fabric("own", x, x, np.ones(4), np.zeros(4, bool), np.zeros((0, 3), np.int32))
    arguments = {
        "nuno.dye_cloths": (None, None, 0, ["dye"]),
        "nuno.colliders": (None, None, None),
        "nuno.forces": (None, fabric, 0),
    }.get(group, (None, None, 0))
    return getattr(registry.load(group, "own"), method)(*arguments)


@pytest.mark.parametrize(("place", "result", "words"), WRONG)
def test_what_is_amiss_is_named_with_plugin_and_field(
    packages: Packages, place: tuple[str, str], result: str, words: str
) -> None:
    with pytest.raises(RunFailed) as failure:
        give(packages, place, result)
    said = str(failure.value)
    assert said.startswith(f"the plugin 'own' of given 1.2 in {place[0]}: {place[1]} gives ")
    assert words in said


@pytest.mark.parametrize(("place", "result"), GOOD)
def test_what_is_right_is_taken(packages: Packages, place: tuple[str, str], result: str) -> None:
    assert give(packages, place, result) is not None


def test_a_turn_that_is_no_rotation_is_named(packages: Packages) -> None:
    wrong = "replace(mover(), pose=lambda t: (np.array([[1.0, t, 0, 0]]), np.zeros((1, 3))))"
    found: Mover = give(packages, MOTION, wrong)
    found.pose(0.0)
    with pytest.raises(
        RunFailed, match=r"the plugin 'own' of given 1\.2.*at 1 s: rotation has length 1.41421 at row 0"
    ):
        found.pose(1.0)


def test_an_operation_that_loses_the_order_of_vertices_is_named(packages: Packages) -> None:
    made = "Outcome({}, changed=Changed(given[1], given[2], np.array([0, 2, 1, 3], np.int32)))"
    code = GIVEN.format(method="apply", result=made)
    packages.add("given", code, "own = given:Own", group="nuno.operations")
    plugin = registry.load("nuno.operations", "own")
    import given  # type: ignore[import-not-found]

    fabric: Fabric = given.cloth()
    with pytest.raises(RunFailed, match=r"changed\.source does not keep the order of the old vertices"):
        plugin.apply(None, fabric, State(fabric.position, fabric.velocity), None)


@pytest.mark.parametrize(
    ("place", "result", "words"),
    [
        (FABRIC, "replace(cloth(), position=1000.0 * cloth().position)", "position comes to 141 m, 0.001 to 100 m"),
        (FABRIC, "replace(cloth(), mass=np.full(4, 1e4))", "mass comes to 4e+04 kg"),
        (BODY, "replace(ball(), radius=np.full(1, 100.0))", "radius comes to 200 m"),
        (CLOTH, "(replace(cells(), size=0.5), amounts())", "cells.size"),
    ],
)
def test_a_size_in_another_unit_is_doubted(
    packages: Packages, caplog: pytest.LogCaptureFixture, place: tuple[str, str], result: str, words: str
) -> None:
    with caplog.at_level(logging.WARNING, "nuno.plugins"):
        give(packages, place, result)
    (said,) = (record.getMessage() for record in caplog.records)
    assert "the plugin 'own' of given 1.2" in said and words in said


def test_a_run_is_refused_before_compiled_code_reads_beyond_an_array(
    packages: Packages, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = SPRINGS.format("first=cloth().springs.first + np.int32(10**8)")
    code = GIVEN.format(method="build", result=wrong) + "    def count(self, *given):\n        return 4\n"
    packages.add("given", code, "own = given:Own", group="nuno.models")
    scene = write_scene(tmp_path, objects=[{"name": "net", "model": {"plugin": "own"}}], duration=0.1)
    assert main(["run", str(scene), "--no-view", "--record", str(tmp_path / "run.mcap")]) == 1
    assert "springs.first is 100000000 at row 0, outside 0 to 3" in capsys.readouterr().err


def test_the_projects_own_plugins_hand_over_what_they_owe(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of them looked at as foreign ones are, to the same bits."""
    scene = write_scene(tmp_path, bodies=BALL, forces=[{"plugin": "particle_wind", "strength": 1e-3}], duration=0.1)
    digest = nuno.run(scene).digest
    monkeypatch.setattr(registry, "is_own", lambda point: False)
    assert nuno.run(scene).digest == digest
