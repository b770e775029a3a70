"""Plugins that never come back, and those that write into what they were lent: stopped and named, and recorded."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dye_scene import write_scene as write_dye_scene
from foreign_packages import HEAD, Packages, packages
from scenes import BALL, write_scene

import nuno
from nuno.plugin_contract import registry
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Fabric, State

__all__ = ["packages"]

SPIN = """
import sys
def spin():
    print("spinning", file=sys.stderr, flush=True)
    while True:
        pass
"""
SOLVER = """
from nuno_integrators.explicit.fixed_step import SymplecticEuler
class Own(SymplecticEuler):
    name = "own"
    def advance(self, system, state, memory, poses, steps, dt):
        if state.t > 0.05:
            spin()
        return super().advance(system, state, memory, poses, steps, dt)
"""
PLUGIN = """
class Own:
    name = "own"
    Config = Config
    def {method}(self, *given):
        {body}
"""
MOVER = "return Mover(('a',), np.array([-1], np.int32), np.zeros((1, 3)), pose)\n"
POSE = "def pose(t):\n    if t > 0.05:\n        spin()\n    return np.array([[1.0, 0, 0, 0]]), np.zeros((1, 3))\n"
PUSH = "def push(x, v, t, out):\n    if t > 0.05:\n        spin()\n"
COUNT = "    def count(self, *given):\n        return 4\n"
OWN = {"plugin": "own"}
ENDLESS: dict[str, tuple[str, str, dict[str, Any], str]] = {
    "force": ("nuno.forces", PLUGIN.format(method="prepare", body="return Term('own', push)") + PUSH,
              {"forces": [OWN]}, "failed in its force"),
    "prepared force": ("nuno.forces", PLUGIN.format(method="prepare", body="spin()"), {"forces": [OWN]},
                       "failed in prepare"),
    "solver": ("nuno.integrators", SOLVER, {"solver": OWN | {"dt": "1 ms"}}, "failed in advance"),
    "model": ("nuno.models", PLUGIN.format(method="build", body="spin()") + COUNT,
              {"objects": [{"name": "a", "model": OWN}]}, "failed in build"),
    "collider": ("nuno.colliders", PLUGIN.format(method="build", body="spin()"),
                 {"bodies": [{"name": "b", "collider": OWN}]}, "failed in build"),
    "motion": ("nuno.motions", PLUGIN.format(method="prepare", body=MOVER) + POSE,
               {"bodies": [BALL[0] | {"motion": OWN}]}, "failed in its pose"),
    "isotherm": ("nuno.isotherms", PLUGIN.format(method="prepare", body="spin()"), {}, "failed in prepare"),
}  # fmt: skip
"""Group, code, fields of the scene, and what is said of it."""
FRAMES = ("force", "solver", "motion")
"""Those that begin to spin within a run of some frames."""
RUN = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from nuno import cli, process
process.end_when_terminated()
process.leave(cli.main(sys.argv[1:]))
"""
SECONDS = 100.0
"""Longest that a process is waited for on a busy machine: the services' own patience is 30 s for each."""


@pytest.mark.quick(kind=["force"], processes=[False])
@pytest.mark.parametrize("processes", [False, True])
@pytest.mark.parametrize("kind", ENDLESS)
def test_a_loop_without_end_is_stopped_and_named(
    packages: Packages, tmp_path: Path, kind: str, processes: bool
) -> None:
    group, code, fields, words = ENDLESS[kind]
    packages.add("endless", SPIN + code, "own = endless:Own", group=group, head=HEAD)
    if kind == "isotherm":
        dye = {"name": "dye", "D0": "1.93 mm^2/h", "adsorption": 0.5, "isotherm": OWN}
        scene = write_dye_scene(tmp_path, dyes=[dye], solver={"plugin": "explicit"})
    else:
        scene = write_scene(tmp_path, **fields)
    command = [sys.executable, "-c", RUN, "run", str(scene), "--no-view", "--record", str(tmp_path / "run.mcap")]
    command += ["--processes"] if processes else []
    path = os.environ | {"PYTHONPATH": str(packages.folder / "endless")}
    with subprocess.Popen(command, env=path, stderr=subprocess.PIPE, text=True) as child:
        try:
            assert child.stderr is not None
            assert any("spinning" in line for line in child.stderr)
            child.send_signal(signal.SIGTERM)
            _, said = child.communicate(timeout=SECONDS)
        finally:
            child.kill()
    assert child.returncode == 1
    assert f"the plugin 'own' of endless 1.2 in {group} {words}: Overdue" in said
    if kind in FRAMES:
        with nuno.open(tmp_path / "run.mcap") as recording:
            assert 0.0 < max(frame.t for frame in recording.frames()) <= 0.06


KEPT = """
kept = []
class Own:
    name = "own"
    Config = Config
    def prepare(self, config, fabric, seed):
        {prepared}
        return Term("own", push)
def push(x, v, t, out):
    {push}
"""


LATER: dict[str, tuple[str, str, str]] = {
    "positions": ("pass", "if kept: kept[0][2] += 0.1\n    kept.append(x)", "failed in its force: ValueError"),
    "forces": ("pass", "kept.append(out)\n    kept[0][2] += 1.0", ""),
    "fabric": ("kept.append(fabric.position)", "kept[0][2] += 0.1", "failed in its force: ValueError"),
}
"""What is kept at first, what is done at each call, and what is said of it: nothing of what does no harm."""


@pytest.mark.parametrize("what", LATER)
def test_a_force_cannot_change_later_what_it_was_lent(packages: Packages, tmp_path: Path, what: str) -> None:
    """It ends the run, or goes into what is nobody's any more: then all is as if it had never been written."""
    prepared, push, words = LATER[what]
    fields = {"solver": {"plugin": "symplectic_euler"}, "duration": 0.1}
    packages.add("keeping", KEPT.format(prepared=prepared, push=push), "own = keeping:Own")
    if words:
        with pytest.raises(RunFailed) as failure:
            nuno.run(write_scene(tmp_path, forces=[OWN], **fields), record=tmp_path / "run.mcap")
        assert f"the plugin 'own' of keeping 1.2 in nuno.forces {words}" in str(failure.value)
        assert (tmp_path / "run.mcap").exists()
        return
    once = KEPT.format(prepared="pass", push="out[2] += 1.0 if not kept else 0.0\n    kept.append(0)")
    packages.add("plain", once, "other = plain:Own")
    digests = [nuno.run(write_scene(tmp_path, forces=[{"plugin": n}], **fields)).digest for n in ("own", "other")]
    assert digests[0] == digests[1]


def test_what_a_model_keeps_of_its_fabric_is_its_own(packages: Packages) -> None:
    """So is what a solver keeps of a state that it only looks at."""
    code = "kept = []\nclass Own:\n    def {}(self, given):\n        kept.append({})\n        return given\n"
    packages.add("models", code.format("build", "given.position"), "own = models:Own", group="nuno.models")
    packages.add("looks", code.format("forces", "given.x"), "own = looks:Own", group="nuno.integrators")
    x = np.zeros((4, 3))
    fabric = Fabric("own", x, x.copy(), np.ones(4), np.zeros(4, bool), np.zeros((0, 3), np.int32))
    built = registry.load("nuno.models", "own").build(fabric)
    state = State(x.copy(), x.copy())
    registry.load("nuno.integrators", "own").forces(state)
    assert not sys.modules["models"].kept[0].flags.writeable
    assert built.position.flags.writeable and not np.shares_memory(built.position, x)
    sys.modules["looks"].kept[0] += 1.0
    assert not state.x.any()
