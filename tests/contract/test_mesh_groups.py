"""Vertices of a mesh that are held by the names of groups, as animation programs have them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from model_files import Folder
from scenes import write_scene

import nuno
from nuno_cloth.models.mesh import Mesh, MeshConfig
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric

TUBE = 6
"""vertices of each of three rings"""


def write_tube(folder: Path, groups: object) -> None:
    """tube.obj, whose first face is cut off along a seam, so that its corners are there twice; and groups.json."""
    rings = [(np.cos(a), -0.5 * k, np.sin(a)) for k in range(3) for a in 2.0 * np.pi * np.arange(TUBE) / TUBE]
    lines = [f"v {x:.17g} {y:.17g} {z:.17g}" for x, y, z in (*rings, rings[0], rings[1], rings[TUBE])]
    for k in (0, TUBE):
        for i in range(TUBE):
            a, b, c, d = (1 + k + i, 1 + k + (i + 1) % TUBE, 1 + k + TUBE + i, 1 + k + TUBE + (i + 1) % TUBE)
            first = (19, 20, 21) if (k, i) == (0, 0) else (a, b, c)
            lines += ["f {} {} {}".format(*first), f"f {b} {d} {c}"]
    (folder / "tube.obj").write_text("\n".join(lines) + "\n")
    (folder / "groups.json").write_text(json.dumps(groups))


GROUPS = {"waist": [*range(1, TUBE), 18], "hem": {str(n): 0.25 * (n % 4) for n in range(2 * TUBE, 3 * TUBE)}, "no": []}


def build(folder: Path, **fields: object) -> Fabric:
    config = MeshConfig.model_validate({"file": "tube.obj", "merge": True, "groups": "groups.json"} | fields)
    return Mesh().build(config, Folder(folder), 0)


def test_a_group_is_held_by_its_name(tmp_path: Path) -> None:
    """Also where the file is merged; of weights those from a half on count."""
    write_tube(tmp_path, GROUPS)
    assert np.flatnonzero(build(tmp_path, pin=["waist"]).pinned).tolist() == list(range(TUBE))
    held = [n for n in range(2 * TUBE, 3 * TUBE) if n % 4 >= 2]
    assert np.flatnonzero(build(tmp_path, pin=["hem", 1]).pinned).tolist() == [1, *held]


def test_what_is_held_follows_a_body(tmp_path: Path) -> None:
    """A ring that a box carries goes with it, the rest on its own way."""
    write_tube(tmp_path, GROUPS)
    model = {"plugin": "mesh", "file": "tube.obj", "merge": True, "groups": "groups.json", "pin": ["waist"]}
    motion = {"plugin": "keyframes", "times": [0.0, 0.2], "positions": [[0, 0, 0], [0.1, 0.05, 0]]}
    box = {"plugin": "box", "centre": [0, 0, 0], "size": [0.4, 0.4, 0.4]}
    scene = write_scene(
        tmp_path, duration=0.2, objects=[{"name": "tube", "model": model | {"attach": {"body": "belt"}}}],
        bodies=[{"name": "belt", "collider": box, "motion": motion}],
    )  # fmt: skip
    first, *_, last = (frame.x for frame in nuno.open(nuno.run(scene, record=tmp_path / "run.mcap").path).frames())
    assert np.abs(last[:TUBE] - first[:TUBE] - [0.1, 0.05, 0.0]).max() < 1e-6
    assert np.abs(last[TUBE:] - first[TUBE:] - [0.1, 0.05, 0.0]).max() > 1e-4


@pytest.mark.parametrize(
    ("fields", "field", "words"),
    [
        ({"pin": ["wiast"]}, "pin[0]", "waist"),
        ({"pin": [0, "no"]}, "pin[1]", "box"),
        ({"attach": {"body": "b"}}, "attach", "pin"),
    ],
)
def test_groups_that_hold_nothing_are_named(fields: dict[str, object], field: str, words: str, tmp_path: Path) -> None:
    write_tube(tmp_path, GROUPS)
    with pytest.raises(BadInput) as caught:
        build(tmp_path, **fields)
    assert caught.value.field == field and words in str(caught.value.remedy)


@pytest.mark.parametrize("groups", [{"waist": [99]}, {"waist": ["a"]}, [1, 2], {"waist": 3}])
def test_files_that_hold_no_groups_are_refused(groups: object, tmp_path: Path) -> None:
    write_tube(tmp_path, groups)
    with pytest.raises(BadInput, match=r"99|groups of vertices"):
        build(tmp_path, pin=["waist"])
