"""The drawing of a frame in the documentation, against a frame."""

from __future__ import annotations

import re
import threading
from collections import defaultdict
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from scenes import BALL, write_scene

import nuno
from nuno.bus.messages import Message
from nuno.collision.service import Collision
from nuno.runtime.stepper import Stepped
from nuno.simulation.run import Simulation

PAGE = Path(__file__).resolve().parents[2] / "docs" / "explanation" / "services.md"
NAME = re.compile(r"[A-Za-z_]+\.[a-z_]+|set_[a-z_]+")


def drawn() -> list[tuple[int, str]]:
    """Names of the drawing, each with its indentation; a line's further names have that of the first."""
    block = PAGE.read_text().split("## A frame\n")[1].split("```")[1].splitlines()[1:]
    lines = [(len(line) - len(line.lstrip()), re.split(r"\s{2,}", line.strip())[0]) for line in block if line.strip()]
    return [(depth, name) for depth, names in lines for name in NAME.findall(names)]


def test_a_frame_passes_what_is_drawn_each_within_what_it_is_drawn_in(tmp_path: Path) -> None:
    within: dict[str, set[str]] = defaultdict(set)

    def note(frame: FrameType, event: str, argument: Any) -> None:
        if event == "call" and threading.current_thread().name == "simulation":
            name, caller = frame.f_code.co_qualname, frame.f_back
            while caller is not None:
                within[name].add(caller.f_code.co_qualname)
                caller = caller.f_back

    scene = write_scene(tmp_path, duration=0.1, bodies=BALL)
    nuno.run(scene, threads=1)  # compiles, which takes far longer while calls are noted
    threading.setprofile(note)
    try:
        assert nuno.run(scene, record=tmp_path / "run.mcap", threads=1).state == "done"
    finally:
        threading.setprofile(None)
    around: list[tuple[int, str]] = []
    names = drawn()
    assert len(names) > 12
    for depth, name in names:
        around = [(other, outer) for other, outer in around if other < depth]
        assert name in within and {outer for _, outer in around} <= within[name], name
        around.append((depth, name))


def test_no_step_is_taken_before_all_services_have_the_first_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What they compile for it is no time of the run's."""
    stepped, early = threading.Event(), list[bool]()
    step, measure = Simulation.step, Collision.measure

    def note_step(simulation: Simulation) -> Stepped:
        stepped.set()
        return step(simulation)

    def measure_late(collision: Collision, message: Message) -> None:
        if not early:
            early.append(stepped.wait(0.3))
        measure(collision, message)

    monkeypatch.setattr(Simulation, "step", note_step)
    monkeypatch.setattr(Collision, "measure", measure_late)
    assert nuno.run(write_scene(tmp_path, duration=0.1, bodies=BALL)).state == "done"
    assert stepped.is_set() and early == [False]
