"""What `set` changes while a run goes on: gravity, damping and forces, in part or whole, by number or by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from nuno.scene import scene_file
from nuno.scene.override import apply_override
from nuno.simulation.run import Simulation
from nuno_schemas.errors import BadInput
from soak import same_bits
from soak.scenes import CASES

WIND = "forces=[{plugin: wind, velocity: [3, 0, 1]}]"


def sheet(folder: Path, **fields: Any) -> Simulation:
    """A small sheet held by its upper corners, without forces; nothing but its objects is given."""
    model = {"plugin": "sheet", "size": [0.3, 0.3], "resolution": [6, 6], "fabric": "denim", "pin": ["top-corners"]}
    scene = {"nuno": 1, "name": "flag", "duration": 1, "objects": [{"name": "cloth", "model": model}]}
    scene |= {"solver": {"plugin": "symplectic_euler", "dt": 1 / 60 / 80}}
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(scene | fields))
    return Simulation(scene_file.read(path), None, None, 1)


@pytest.mark.parametrize(
    ("items", "fields"),
    [
        ([WIND], {"forces": [{"plugin": "wind", "velocity": [3, 0, 1]}]}),
        ([WIND, "forces.wind.velocity=[0, 0, 5 m/s]"], {"forces": [{"plugin": "wind", "velocity": [0, 0, 5]}]}),
        ([WIND, "forces.0.velocity.2=-4"], {"forces": [{"plugin": "wind", "velocity": [3, 0, -4]}]}),
        (["forces=[{plugin: wind}]", "forces.0.velocity.0=7"], {"forces": [{"plugin": "wind", "velocity": [7, 0, 0]}]}),
        ([WIND, "forces=[]"], {}),
        (["gravity.1=-1.6"], {"gravity": [0, -1.6, 0]}),
    ],
)  # fmt: skip
def test_what_is_set_acts_as_if_the_scene_had_had_it(items: list[str], fields: dict[str, Any], tmp_path: Path) -> None:
    """To the last bit, also where the scene leaves the field to its default."""
    changed = sheet(tmp_path)
    still = sheet(tmp_path).advance(None, None).digest
    for item in items:
        changed.set(item)
    assert changed.loaded.value(items[-1].partition("=")[0]) is not None
    found = changed.advance(None, None).digest
    assert found == sheet(tmp_path, **fields).advance(None, None).digest
    assert (found == still) is (not fields)


@pytest.mark.parametrize(
    ("item", "field", "said"),
    [
        ("forces.0.velocity=[5, 0, 0]", "forces.0.velocity", "forces holds an empty list; give all of it"),
        ("forces.wind.velocity=[5, 0, 0]", "forces.wind.velocity", "forces holds an empty list; give all of it"),
        ("forces=[{plugin: wind, velocty: 1}]", "forces[0].velocty", "did you mean 'velocity'"),
        ("forces=[{plugin: wind, velocity: [9000, 0, 0]}]", "forces", "would make the present step unstable"),
        ("gravity.3=1", "gravity.3", "gravity holds a list of 3"),
        ("damping=1e9", "damping", "would make the present step unstable"),
    ],
)
@pytest.mark.parametrize("dt", ["auto", 1 / 60 / 80])
def test_what_is_refused_is_named_and_changes_nothing(
    item: str, field: str, said: str, dt: object, tmp_path: Path
) -> None:
    """By its own path: a step that the user gave is not at fault."""
    simulation = sheet(tmp_path, solver={"plugin": "symplectic_euler", "dt": dt})
    with pytest.raises(BadInput) as refused:
        simulation.set(item)
    assert refused.value.field == field and said in str(refused.value)
    unchanged = sheet(tmp_path, solver={"plugin": "symplectic_euler", "dt": dt})
    assert simulation.advance(None, None).digest == unchanged.advance(None, None).digest


def test_part_of_a_field_that_the_scene_leaves_out_is_set_before_a_run_as_well(tmp_path: Path) -> None:
    sheet(tmp_path)
    assert scene_file.read(tmp_path / "scene.yaml", ["gravity.1=-1.6"]).scene.gravity == (0.0, -1.6, 0.0)
    with pytest.raises(BadInput, match=r"forces\.0\.plugin: no such field"):
        scene_file.read(tmp_path / "scene.yaml", ["forces.0.plugin=wind"])


def test_two_forces_of_one_plugin_are_told_apart_by_their_numbers() -> None:
    data = {"forces": [{"plugin": "own"}, {"plugin": "own"}, {"plugin": "wind"}]}
    with pytest.raises(BadInput, match="a list of 3, counted from 0, own, own, wind"):
        apply_override(data, "forces.own.k=5")
    apply_override(data, "forces.1.k=5")
    apply_override(data, "forces.wind.k=6")
    assert data == {"forces": [{"plugin": "own"}, {"plugin": "own", "k": 5}, {"plugin": "wind", "k": 6}]}


@pytest.mark.full
def test_wind_that_is_set_is_recorded_resumed_and_verified_to_the_same_bits() -> None:
    """On threads, unrecorded, paused, resumed at a frame before, between or after the changes, and simulated again."""
    assert [change[1] for change in CASES["wind, changed"].changes] == ["set", "set"]
    ways, digests = same_bits.run(quick=True, seed=1, names=("wind, changed",))
    assert ways.samples[0] >= 8 and digests.samples == (1,), digests.note
