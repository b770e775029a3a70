"""What a dyed garment is refused for before it starts, what it starts, and what its plan says."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from garment_scene import write

import nuno
from nuno.cli import main
from nuno_schemas.errors import BadInput

PROGRAM = """
import json, os, sys
from nuno.cli import main
code = main(["run", "scene.yaml", "--no-view", "--record", "one.mcap"])
print(json.dumps([code, sorted(sys.modules)]))
sys.stdout.flush()
os._exit(0)
"""

MESH = "v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n"
TILED = "v 0 0 0\nv 1 0 0\nv 0 0 1\nvt 0 0\nvt 3 0\nvt 0 3\nf 1/1 2/2 3/3\n"


@pytest.mark.parametrize(
    ("fields", "field", "words"),
    [
        ({"dye": {"object": "sheat"}}, "dye.object", "did you mean 'sheet'"),
        ({"dye": {"object": "sheet"}, "objects": []}, "dye.object", "known: none"),
        ({"dye": {"object": "cape"}, "mesh": MESH}, "objects[0].model", "'cape'"),
        ({"dye": {"object": "cape"}, "mesh": MESH}, "objects[0].model", "give the mesh texture coordinates"),
        ({"dye": {"object": "cape"}, "mesh": TILED}, "objects[0].model", "0 to 3"),
        ({"dye": {"on": "sheet"}}, "dye.on", "the object that is dyed is `object`: write object: sheet"),
        ({"dye": {True: "sheet"}}, "dye.true", "write object: sheet"),
        ({"dye": {"object": None}}, "objects", "name the object that is dyed as dye.object"),
        ({"dye": {"solver": {"plugin": "explicit", "dt": "100 s"}}}, "dye.solver.dt", "a dye.speed of at least 5000"),
        ({"dye": {"dyes": []}}, "dye.dyes", "too short"),
        ({"dye": {"picture": {"crop": {"low": [0, 0], "high": [1, 1]}}}}, "dye.picture.crop", "shows all of the cloth"),
    ],
)
def test_garments_are_refused_by_name(fields: dict[str, Any], field: str, words: str, tmp_path: Path) -> None:
    mesh = fields.get("mesh")
    if mesh is not None:
        (tmp_path / "cape.obj").write_text(mesh)
        fields = {"dye": fields["dye"], "objects": [{"name": "cape", "model": {"plugin": "mesh", "file": "cape.obj"}}]}
    with pytest.raises(BadInput) as refused:
        nuno.run(write(tmp_path, **fields), record=tmp_path / "run.mcap")
    assert f"{field}: " in str(refused.value) and words in str(refused.value)
    assert list(tmp_path.glob("*.mcap*")) == []


@pytest.mark.full
def test_a_garment_without_bodies_starts_no_collision_service(tmp_path: Path) -> None:
    write(tmp_path, bodies=[])
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=tmp_path, env=os.environ, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    code, modules = json.loads(done.stdout.splitlines()[-1])
    assert code == 0 and "nuno.dye.service" in modules and "nuno.simulation.service" in modules
    assert [name for name in modules if "nuno.collision.service" in name or "nuno_contact" in name] == []


def test_a_plan_names_both(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", str(write(tmp_path))]) == 0
    said = capsys.readouterr().out
    assert "services  simulation, dye, collision, recorder" in said
    assert (
        "on sheet, 0.55 mm x 0.45 mm: 198 cells" in said
        and "72 vertices" in said
        and "wrinkles: the scene has none" in said
    )
    assert "720 s of dyeing" in said
