"""Plugins that a script or a notebook registers: found by name in its process, and in no other."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import CHAIN, write_chain

import nuno
from nuno.plugin_contract import registry
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.fabric import Fabric, Float
from nuno_schemas.plugin import Config
from nuno_schemas.system import Term

PULLED = CHAIN | {"forces": [{"plugin": "pull"}]}


@pytest.fixture(autouse=True)
def _unregistered() -> Iterator[None]:
    yield
    registry.REGISTERED.clear()


def pull_of(newtons: float) -> type:
    """A class of the same name each time, as a notebook's cell makes it."""

    class Pull:
        name = "pull"
        Config = Config

        def prepare(self, config: Config, fabric: Fabric, seed: int) -> Term:
            def pull(x: Float, v: Float, t: float, out: Float) -> None:
                out[:, 0] += newtons

            return Term("pull", pull)

    return Pull


@pytest.fixture
def roots(tmp_path: Path) -> list[Path]:
    write_chain(tmp_path)
    return [tmp_path]


def ended(roots: list[Path]) -> Float:
    return nuno.run(PULLED, roots=roots, duration=0.02).x


def test_a_scene_finds_the_class_that_was_registered_last(roots: list[Path]) -> None:
    """By the equation of motion: the velocity's change is the force over the mass, of all free masses alike."""
    found = []
    for newtons in (0.5, 1.0):
        nuno.register("nuno.forces", pull_of(newtons))
        assert registry.installed("nuno.forces")["pull"].load() is not None
        found.append(ended(roots)[-1, 0] - 0.5)
    assert found[1] == pytest.approx(2.0 * found[0], rel=0.05)


def test_what_a_registered_class_does_amiss_names_its_module(roots: list[Path]) -> None:
    nuno.register("nuno.forces", pull_of(np.nan))
    with pytest.raises(RunFailed, match=f"the plugin 'pull' of {__name__} in nuno.forces: at 0 s its force is nan"):
        ended(roots)


class Wind:
    name = "wind"


class Nameless:
    pass


class Pull:
    name = "pull"


REFUSED: dict[str, tuple[str, Any, str]] = {
    "an unknown kind": ("nuno.force", Pull, "no such kind of plugin"),
    "an object": ("nuno.forces", Pull(), "a plugin is a class with a name"),
    "no name": ("nuno.forces", Nameless, "a plugin is a class with a name"),
    "a name that is installed": ("nuno.forces", Wind, "there is a plugin 'wind' in nuno.forces already"),
    "a name of another class": ("nuno.forces", Pull, "there is a plugin 'pull' in nuno.forces already"),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_what_cannot_be_registered_is_refused_and_changes_nothing(fault: str) -> None:
    nuno.register("nuno.forces", pull_of(1.0))
    before = dict(registry.REGISTERED)
    group, plugin, problem = REFUSED[fault]
    with pytest.raises(BadInput, match=problem) as refusal:
        nuno.register(group, plugin)
    assert refusal.value.remedy
    assert before == registry.REGISTERED


ELSEWHERE: dict[str, Callable[[list[Path]], object]] = {
    "processes": lambda roots: nuno.run(PULLED, roots=roots, processes=True),
    "a sweep's": lambda roots: nuno.sweep(PULLED, {"duration": [0.02, 0.04]}, roots=roots, jobs=2),
}


@pytest.mark.parametrize("where", ELSEWHERE)
def test_other_processes_are_refused_before_they_start(where: str, roots: list[Path]) -> None:
    nuno.register("nuno.forces", pull_of(1.0))
    with pytest.raises(BadInput, match=r"the plugin 'pull' in nuno\.forces is registered in this process") as refusal:
        ELSEWHERE[where](roots)
    assert "entry point" in str(refusal.value.remedy)


def test_kernels_of_source_in_no_file_are_compiled() -> None:
    source = "from nuno_kernels import kernel\n@kernel\ndef double(x):\n    return 2.0 * x\nprint(double(1.5))"
    ran = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, timeout=120)
    assert ran.stdout == "3.0\n"


CELL = """
from typing import NamedTuple
from nuno_kernels.formula import formula
@formula
class Flat(NamedTuple):
    height: float
    def distance(self, x, y, z):
        return {}
"""


def test_a_cell_that_runs_again_with_other_code_is_compiled_anew() -> None:
    """The classes have one name, and are known to compiled code as two."""
    found = []
    for code in ("y - self.height", "y - 2.0 * self.height"):
        cell: dict[str, Any] = {"__name__": __name__}
        exec(CELL.format(code), cell)
        found.append(float(cell["Flat"](1.0).distance(0.0, 5.0, 0.0)))
    assert found == [4.0, 3.0]
