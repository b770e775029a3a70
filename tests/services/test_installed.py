"""nuno from its wheel, in an environment of its own, an empty folder, without compiler and git."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib
import urllib.request
from pathlib import Path

import pytest
from distributions import ROOT, build, install
from PIL import Image

import nuno

pytestmark = pytest.mark.full
TOOLS = ("sh", "realpath", "dirname")
"""What the scripts that uv installs call; no compiler and no git is found."""


class Installed:
    """nuno in an environment, a home and a folder that are all new."""

    def __init__(self, folder: Path) -> None:
        self.wheel = build("wheel", folder / "wheel")
        self.programs = install(self.wheel, folder / "environment")
        self.folder = folder / "empty"
        self.folder.mkdir()
        tools = folder / "tools"
        tools.mkdir()
        for name in TOOLS:
            (tools / name).symlink_to(str(shutil.which(name)))
        self.environment = {"PATH": f"{self.programs}:{tools}", "HOME": str(folder / "home"), "LANG": "C.UTF-8"}
        for name in ("cc", "gcc", "clang", "git"):
            assert shutil.which(name, path=self.environment["PATH"]) is None

    def command(self, *words: str) -> list[str]:
        return [str(self.programs / "nuno"), *words]

    def run(self, *words: str, patience: float = 300.0) -> str:
        """What a command prints, which ends with exit code 0."""
        command, env = self.command(*words), self.environment
        done = subprocess.run(command, cwd=self.folder, env=env, capture_output=True, text=True, timeout=patience)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    return Installed(tmp_path_factory.mktemp("installed"))


def test_the_tour_runs(installed: Installed) -> None:
    """A run, its picture, meshes and tables, verified to the last bit; all lies in the folder that it was run in."""
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert installed.run("--version") == f"nuno {version}\n"
    assert {line.split()[0] for line in installed.run("scenes").splitlines() if line} >= {"skirt-hula", "dye/drops"}
    doctor = installed.run("doctor")
    assert "kernels" in doctor and "\nfail" not in doctor
    assert "respa" in installed.run("plan", "skirt-hula")
    installed.run("run", "hanging-sheet", "--set", "duration=0.1")
    assert installed.run("verify", "last").splitlines()[-1] == "equal to the last bit: 7 frames"
    installed.run("export", "last", "--png", "out.png", "--glb", "out.glb", "--csv", "out.csv", "--npz", "out.npz")
    with Image.open(installed.folder / "out.png") as picture:
        colours = picture.convert("RGB").getcolors(maxcolors=1 << 24)
    assert colours is not None and len(colours) > 100
    (recording,) = (installed.folder / "recordings").glob("*.mcap")
    with nuno.open(recording) as opened:
        assert len(list(opened.frames())) == 7
    installed.run("new", "skirt", "mine.yaml")
    assert "skirt" in installed.run("plan", "mine.yaml")


def test_the_studio_serves_its_page(installed: Installed) -> None:
    command = installed.command("studio", "--no-browser")
    folder, env = installed.folder, installed.environment
    with subprocess.Popen(command, cwd=folder, env=env, text=True, stdout=subprocess.PIPE) as going:
        try:
            assert going.stdout is not None
            address = going.stdout.readline().split()[-1]
            for name, path in [("", "index.html"), ("main.js", "main.js"), ("page.css", "page.css")]:
                with urllib.request.urlopen(address + name, timeout=30.0) as answer:
                    assert answer.read() == (ROOT / "services" / "nuno" / "studio" / "page" / path).read_bytes()
        finally:
            going.terminate()


def test_uvx_runs_the_wheel(installed: Installed, tmp_path: Path) -> None:
    uvx = shutil.which("uvx", path=str(Path(sys.executable).parent)) or shutil.which("uvx")
    if uvx is None:
        pytest.skip("needs uv")
    words = [uvx, "--python", sys.executable, "--from", str(installed.wheel), "nuno", "scenes"]
    environment = os.environ | {"PATH": installed.environment["PATH"]}  # with what reaches the registry from here
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout == installed.run("scenes")


SCRIPT = '''\
"""A script of a user, and a force and a solver of another package."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, NamedTuple, assert_type

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

import nuno
from nuno_integrators.explicit.fixed_step import Explicit
from nuno_integrators.explicit.updates import add_twice
from nuno_kernels import kernel
from nuno_kernels.step.acceleration import Packed, commit, evaluate
from nuno_kernels.terms import register
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, State
from nuno_schemas.plugin import Config, Force, Integrator
from nuno_schemas.system import Forces, System, Term
from nuno_testing import contract

Array = NDArray[np.float64]


def look() -> None:
    result = nuno.run("hanging-sheet", {"solver.plugin": "rk4"}, duration=1)
    assert_type(result, nuno.Result)
    assert_type((result.x, result.v, result.t, result.digest), tuple[Array, Array, float, str])
    assert_type(result.phi, Array | None)
    assert_type(result.recording, nuno.Recording)
    for frame in result.recording.frames(start=0.5):
        assert_type((frame.number, frame.t, frame.x), tuple[int, float, Array])
    for moment in nuno.states(result.recording, [3], forces=True):
        assert_type(moment.forces.parts["springs"] + moment.x, Array)
        assert_type(moment.fabric, Fabric)
    for each in nuno.states(result.recording):
        assert_type(each, nuno.FrameState)
        assert_type((each.fabric, each.forces), tuple[Fabric | None, Forces | None])
    assert_type(nuno.export(result, png="out.png"), list[Path])
    assert_type([(row[0], row[1]) for row in nuno.plan("skirt-hula")], list[tuple[str, str]])
    assert_type(nuno.verify(result).compared, int)
    scene = nuno.Scene("skirt-hula").copy(duration=0.5)
    assert_type(scene, nuno.Scene)
    assert_type(nuno.resume(nuno.run(scene)), nuno.Result)
    with nuno.open("last") as recording, nuno.watch("last", "sim/state") as heard:
        assert_type(recording.complete, bool)
        assert_type([message.topic for message in heard], list[str])
    with nuno.drive("last", "hand") as driving:
        driving.send([0.0, 1.0, 0.0])
    try:
        nuno.run("no-such-scene")
    except BadInput as error:
        assert_type((error.problem, error.field), tuple[str, str | None])


class Pull(NamedTuple):
    centre: Annotated[Array, 3]
    stiffness: float


@kernel
def energy_of(pull: Pull, x: Array) -> float:
    return float(0.5 * pull.stiffness * ((x - pull.centre.reshape(3, 1)) ** 2).sum())


register(Pull, name="pull", energy=energy_of)


class PullConfig(Config):
    stiffness: float = 1.0


class PullForce:
    name: ClassVar[str] = "pull"
    Config: ClassVar[type[BaseModel]] = PullConfig

    def prepare(self, config: PullConfig, fabric: Fabric, seed: int) -> Term:
        assert_type(fabric.position, Array)
        return Term("pull", Pull(np.zeros(3), config.stiffness))


@kernel
def advance(x: Array, v: Array, stages: Array, steps: int, dt: float, p: Packed) -> None:
    for step in range(steps):
        evaluate(x, v, step / steps, stages[0], p)
        add_twice(v, v, dt, stages[0], x, x, dt, v, p.threads)
        commit(x, v, (step + 1) / steps, p.bodies, p.bodies_on, p.threads)


class Mine(Explicit):
    name: ClassVar[str] = "mine"
    order: ClassVar[int] = 1
    loop: ClassVar[Any] = advance


force: Force = PullForce()
solver: Integrator = Mine()
test_forces = contract("nuno.forces", pull={"stiffness": 2.0})
'''
WRONG = {
    "nuno.run(3)": "arg-type",
    "nuno.open('last').frame": "attr-defined",
    "nuno.verify('last').compared + 'frames'": "operator",
    "wrong: Force = Mine()": "assignment",
    "contract('nuno.forces', pull=2.0)": "arg-type",
}
"""Mistakes, and what mypy calls them: none would be found where a type was Any."""


def test_a_type_checker_of_another_project_knows_the_installed_packages(installed: Installed, tmp_path: Path) -> None:
    pytest.importorskip("mypy", reason="needs mypy, of nuno[dev]")
    right, wrong = tmp_path / "mine.py", tmp_path / "wrong.py"
    right.write_text(SCRIPT)
    wrong.write_text(SCRIPT + "\n".join(WRONG) + "\n")
    python = str(installed.programs / "python")
    command = [sys.executable, "-m", "mypy", "--strict", "--python-executable", python, "--cache-dir", ".cache"]
    found = [
        subprocess.run([*command, str(path)], cwd=tmp_path, env=installed.environment, capture_output=True, text=True)
        for path in (right, wrong)
    ]
    assert found[0].returncode == 0, found[0].stdout
    first = SCRIPT.count("\n") + 1
    told = {int(line.split(":")[1]) - first: line for line in found[1].stdout.splitlines() if ": error:" in line}
    assert {row: line.split("[")[-1].rstrip("]") for row, line in told.items()} == dict(enumerate(WRONG.values()))
