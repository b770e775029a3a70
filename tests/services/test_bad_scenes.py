"""Scenes that cannot run: exit code 2, file, line, field and remedy, and no false recording."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from refusals import Refused, of_file, sheet, write_net
from scenes import BALL

SKIRT = {"plugin": "skirt", "waist_radius": 0.1, "hem_radius": 0.2, "length": 0.3}


STEPS: dict[str, tuple[dict[str, Any], str]] = {
    "does not divide a frame": (
        {"solver": {"plugin": "rk4", "dt": "3 ms", "strict": True}},
        "0.002857143 s (7 steps) or 0.003333333 s (6 steps)",
    ),
    "longer than a frame": (
        {"solver": {"plugin": "rk4", "dt": "30 ms"}, "allow_unstable": True}, "a frame is shorter than a step",
    ),
    "above the limit, as is what is nearest": ({"solver": {"plugin": "rk4", "dt": "30 ms"}}, "dt: auto"),
    "above the limit": (
        {"solver": {"plugin": "rk4", "dt": "20 ms"}, "objects": sheet()}, "above the stability limit",
    ),
    "so small that no frame ends": ({"solver": {"plugin": "rk4", "dt": 1e-300}}, "10,000,000 steps a frame"),
    "unstable whatever it is": ({"solver": {"plugin": "euler"}}, "use symplectic_euler, leapfrog or rk4"),
}  # fmt: skip


@pytest.mark.parametrize("fault", STEPS)
def test_steps_that_cannot_be_taken(fault: str, refused: Refused, tmp_path: Path) -> None:
    change, words = STEPS[fault]
    said = refused.run(**change)
    assert words in said
    assert f"{tmp_path / 'scene.yaml'}:" in said
    assert "solver." in said


def test_numbers_beyond_float64_are_refused(refused: Refused, tmp_path: Path) -> None:
    for change in ({"k": np.full(2, 1e300)}, {"m": np.full(3, 1e-300)}, {"x": np.diag([0, 1e300, 1e308])}):
        write_net(tmp_path / "bad.npz", **change)
        said = refused.run(objects=of_file("bad.npz"), solver={"plugin": "rk4"})
        assert "too large or too small" in said
        assert "Warning" not in said


PARTS: dict[str, tuple[dict[str, Any], str, str]] = {
    "attached to no body": (
        {"objects": [{"name": "skirt", "model": SKIRT | {"attach": {"body": "bal", "frame": "world"}}}],
         "bodies": BALL},
        "objects[0].model.attach: cloth is attached to a frame that no body has", "did you mean 'ball/world'?",
    ),
    "taken by no body": (
        {"objects": sheet(), "bodies": BALL, "operations": [{"plugin": "attach", "at": 0.1, "body": "bal"}]},
        "operations[0].body: there is no such body", "did you mean 'ball'?",
    ),
    "let go of by no body": (
        {"objects": sheet(), "operations": [{"plugin": "release", "at": 0.1, "body": "ball"}]},
        "operations[0].body: there is no such body", "give the scene the body",
    ),
    "felt by no body": (
        {"record": {"contact_forces": True}}, "record.contact_forces: there are no bodies", "give the scene some",
    ),
    "attached to no frame": (
        {"objects": [*sheet(), {"name": "s", "model": SKIRT | {"attach": {"body": "ball", "frame": "hips"}}}],
         "bodies": BALL},
        "objects[1].model.attach: cloth is attached", "known: ball/world",
    ),
    "attached where there are no bodies": (
        {"objects": [{"name": "skirt", "model": SKIRT | {"attach": {"body": "ball", "frame": "world"}}}]},
        "objects[0].model.attach", "known: none",
    ),
    "no such joint": (
        {"bodies": [{"name": "b", "collider": {"plugin": "sphere", "radius": 1, "joint": "hip"},
                     "motion": {"plugin": "hula"}}]},
        "bodies[0].collider.joint: no such joint", "did you mean 'hips'?",
    ),
    "missing motion": (
        {"bodies": [{"name": "b", "collider": {"plugin": "skeleton"}, "motion": {"plugin": "bvh", "file": "no.bvh"}}]},
        "bodies[0].motion.file: no such file", "--root DIR",
    ),
    "pin -1": ({"objects": sheet(pin=[-1])}, "objects[0].model.pin[0]: no such vertex", "0 to 15"),
    "wind on a net": ({"forces": [{"plugin": "wind"}]}, "forces[0]: wind blows on triangles", "use particle_wind"),
}  # fmt: skip


@pytest.mark.parametrize("fault", PARTS)
def test_parts_that_do_not_fit_together(fault: str, refused: Refused, tmp_path: Path) -> None:
    change, words, advice = PARTS[fault]
    said = refused.run(**change)
    assert words in said
    assert advice in said
    assert f"{tmp_path / 'scene.yaml'}:" in said.replace("scene.yaml: ", "")  # with its line


def test_a_refusal_leaves_no_service_behind(refused: Refused, tmp_path: Path) -> None:
    """A service that refuses ends the others, also those that wait for it."""
    began = time.monotonic()
    refused.run(bodies=[{"name": "b", "collider": {"plugin": "skeleton"}, "motion": {"plugin": "bvh", "file": "no"}}])
    names = {thread.name for thread in threading.enumerate()}
    assert not {"simulation", "collision", "recorder"} & names
    # Waiting for the collision service would take 30 s.
    assert time.monotonic() - began < 25


def test_processes_refuse_alike_and_once(refused: Refused, tmp_path: Path) -> None:
    said = refused.run("--processes", objects=of_file("no.npz"))
    assert said.count("objects[0].model.file: no such file") == 1


def test_a_scene_larger_than_memory_is_refused_before_it_is_built(refused: Refused) -> None:
    before = psutil.Process().memory_info().rss
    said = refused.run(objects=sheet(resolution=[16384, 16384]))
    assert "268,435,456 vertices, about 100.0 GiB" in said
    assert "GiB are free" in said
    assert "lower the resolution" in said
    assert "scene.yaml:5: objects" in said
    # Positions alone would be 6 GiB.
    assert psutil.Process().memory_info().rss - before < 500 * 2**20


def test_the_same_estimate_without_that_machine(refused: Refused, monkeypatch: pytest.MonkeyPatch) -> None:
    class Memory:
        available = 100_000

    monkeypatch.setattr(psutil, "virtual_memory", Memory)
    assert "400 vertices" in refused.run(objects=sheet(resolution=[20, 20]))
    write_net(refused.folder / "net.npz", 300, pinned=np.zeros(300, bool))
    monkeypatch.setattr(Memory, "available", 10_000)
    assert "300 vertices" in refused.run(objects=of_file("net.npz"))
