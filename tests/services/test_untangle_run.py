"""Cloth that is untangled before the first frame: in a scene, its report and its later frames."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import ipctk
import numpy as np
import pytest
from scenes import write_scene
from sewing_patterns import back, front, pattern, stitch

import nuno
from nuno.report.show import lines
from nuno.scene import scene_file, shipped
from nuno.simulation.cloth import build
from nuno.simulation.run import Simulation
from nuno_geometry.normals import edge_numbers
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric, Float

JACKET = {"plugin": "sheet", "resolution": [12, 12], "size": [0.12, 0.12], "plane": "xz", "fabric": "jacket"}
LEANS = JACKET | {"rotate": {"axis": [1, 0.3, 0], "angle": "25 deg"}, "centre": [0, 0.01, 0], "pin": ["top-row"]}
CONTACT = {"plugin": "offset", "thickness": "2 mm"}
UNTANGLE: list[dict[str, Any]] = [{"plugin": "untangle"}]


def two_sheets(folder: Path, **fields: Any) -> Path:
    """A sheet that leans through a level one."""
    objects = [{"name": "level", "model": JACKET}, {"name": "leaning", "model": LEANS}]
    given: dict[str, Any] = {"objects": objects, "solver": {"plugin": "symplectic_euler", "dt": "auto"}}
    return write_scene(folder, **given | {"cloth_contact": CONTACT, "duration": 0.1} | fields)


def crosses(fabric: Fabric, x: Float) -> bool:
    mesh = ipctk.CollisionMesh(fabric.position, edge_numbers(fabric.faces)[1], fabric.faces)
    return bool(ipctk.has_intersections(mesh, x))


def start(path: Path, *overrides: str) -> Fabric:
    """The cloth where a scene starts."""
    return build.build_fabric(scene_file.read(path, overrides))[0]


def test_a_tangled_start_is_refused_and_names_what_untangles_it(tmp_path: Path) -> None:
    with pytest.raises(BadInput) as caught:
        Simulation(scene_file.read(two_sheets(tmp_path)), None, None, 1)
    assert "operations: [{plugin: untangle}]" in (caught.value.remedy or "")
    assert "edges through triangles" in caught.value.problem


def test_an_untangled_start_stays_so_and_is_the_same_over_threads(tmp_path: Path) -> None:
    """In every frame; pins where they were, to the bit."""
    path = two_sheets(tmp_path, operations=UNTANGLE)
    before, digests = start(path, "operations=[]"), []
    assert crosses(before, before.position)
    for threads in (1, 2):
        simulation = Simulation(scene_file.read(path), None, None, threads)
        fabric = simulation.fabric
        assert fabric.position[fabric.pinned].tobytes() == before.position[before.pinned].tobytes()
        for _ in range(5):
            assert not crosses(fabric, simulation.state.x)
            assert simulation.advance(None, None).report.status == "ok"
        digests.append(simulation.digest())
    assert digests[0] == digests[1]


def test_the_report_tells_what_was_moved(tmp_path: Path) -> None:
    path = two_sheets(tmp_path, operations=UNTANGLE)
    whole = nuno.run(path, record=tmp_path / "whole.mcap")
    told = whole.report["arranged"]
    assert [(one["operation"], one["object"]) for one in told] == [("untangle", "")]
    assert told[0]["facts"]["crossings"] > 20 and 0.0 < told[0]["facts"]["mean"] < told[0]["facts"]["largest"] < 0.02
    assert whole.report["cloth_contact"]["crossed"] == 0
    rows = dict(lines(whole.report))
    assert "edges went through triangles at the start" in rows["untangle"]


def test_a_run_goes_on_from_a_checkpoint_in_the_same_bits(tmp_path: Path) -> None:
    """What is not kept in it is untangled again."""
    loaded = scene_file.read(two_sheets(tmp_path, operations=UNTANGLE))
    whole = Simulation(loaded, None, None, 1)
    whole.advance(None, None)
    point, resumed = whole.keep(), Simulation(loaded, None, None, 1)
    resumed.resume(point)
    for _ in range(2):
        assert whole.advance(None, None).digest == resumed.advance(None, None).digest


def test_one_object_is_moved_alone_and_those_that_may_meet_are_left(tmp_path: Path) -> None:
    path = two_sheets(tmp_path)
    before = start(path)
    alone = start(path, "operations=[{plugin: untangle, object: leaning}]")
    assert alone.position[:144].tobytes() == before.position[:144].tobytes()
    assert not crosses(alone, alone.position)
    free = start(path, "operations=[{plugin: untangle}]", "cloth_contact.allow=[[level, leaning]]")
    assert free.position.tobytes() == before.position.tobytes()


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"operations": [{"plugin": "untangle", "at": 0.05}]}, "operations[0].at: this operation is for the start"),
        ({"operations": [{"plugin": "untangle", "object": "shirt"}]}, "no object has this name"),
        ({"operations": [{"plugin": "untangle", "gap": -1}]}, "operations[0].gap"),
        ({"operations": [{"plugin": "untangle", "iterations": 1}]}, "still passes through cloth after 1 iterations"),
    ],
)
def test_what_cannot_be_is_said(tmp_path: Path, fields: dict[str, Any], said: str) -> None:
    with pytest.raises(BadInput) as caught:
        start(two_sheets(tmp_path, **fields))
    assert said in str(caught.value)


def test_what_stays_tangled_of_a_sewn_garment_is_named_by_its_panels(tmp_path: Path) -> None:
    """Two tubes that go through each other, of panels with names of their own."""
    objects = []
    for name, aside in (("inner", 0.0), ("outer", 7.0)):
        parts = {f"{name}-{part['translation'][2]:+d}": part for part in (front(), back())}
        for part in parts.values():
            part["translation"][0] += aside
        one, two = parts
        sewn = pattern(parts, stitch(f"{one}[1]", f"{two}[2]"), stitch(f"{one}[3]", f"{two}[0]"))
        (tmp_path / f"{name}.json").write_text(json.dumps(sewn))
        model = {"plugin": "pattern", "file": f"{name}.json", "edge": "3 cm", "fabric": "denim"}
        objects.append({"name": name, "model": model})
    with pytest.raises(BadInput) as caught:
        start(write_scene(tmp_path, objects=objects, operations=[{"plugin": "untangle", "iterations": 1}]))
    said, first = str(caught.value.value), ("inner", "outer")
    assert "cut panels" in (caught.value.remedy or "")
    assert any(re.match(rf"{i}-[+-]15 of {i} through {j}-[+-]15 of {j}, at ", said) for i, j in (first, first[::-1]))


def test_cloth_that_moves_is_not_untangled(tmp_path: Path) -> None:
    """That is for the start."""
    path = two_sheets(tmp_path, operations=UNTANGLE)
    simulation = Simulation(scene_file.read(path), None, None, 1)
    with pytest.raises(BadInput, match="for the start"):
        simulation.add("untangle: {object: level}")
    assert np.isfinite(simulation.state.x).all()


@pytest.mark.full
def test_a_garment_that_starts_in_itself_is_untangled() -> None:
    """A shirt with wide sleeves, whose underarms pass through each other on a mannequin with low arms.

    By 72 edges: with few it begins in itself or not by a machine's last digits.
    """
    low = ["bodies.mannequin.collider.arms=40 deg", "cloth_contact=none", "objects.shirt.model.around=100",
           "objects.shirt.model.cuff=15cm"]  # fmt: skip
    path = shipped.find("shirt-on-mannequin")
    before = start(path, *low)
    after = build.build_start(scene_file.read(path, [*low, "operations=[{plugin: untangle}]"]))
    assert crosses(before, before.position)
    assert not crosses(before, after.fabrics[0].position)
    assert after.facts[0]["facts"]["largest"] < 0.03
