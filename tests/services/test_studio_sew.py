"""An edge of a garment's pattern that gets another length in `nuno studio`, and the garment sewn again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import trimesh
import yaml
from browser import Page
from sewing_patterns import column, read_pattern, tube
from studio_desk import NEEDS_BROWSER, ask, look

import nuno
from nuno.scene import scene_file
from nuno.scene.files import SceneFiles
from nuno.studio.desk import Desk
from nuno.studio.server import Server
from nuno_schemas.errors import BadInput

PATIENCE = 300.0
"""The first run on a machine compiles kernels [s]."""
SCENE: dict[str, Any] = {
    "nuno": 1, "name": "tube-worn", "duration": 0.1, "frame_rate": 60, "seed": 7,
    "solver": {"plugin": "respa", "dt": "auto"},
    "objects": [
        {"name": "tube", "model": {"plugin": "pattern", "file": "tube.json", "edge": 0.04, "over": {"body": "column"}}},
        {"name": "sheet", "model": {"plugin": "sheet", "size": [0.1, 0.1], "centre": [1, 1, 0], "fabric": "silk"}},
    ],
    "bodies": [{"name": "column", "collider": {"plugin": "mesh", "file": "column.obj"}, "friction": 0.4}],
    "cloth_contact": {"plugin": "offset", "thickness": "2 mm", "bodies": ["column"]},
}  # fmt: skip
EDGE = "document.querySelector('[aria-label=\"%s\"]').dispatchEvent(new Event('click'))"


@pytest.fixture
def recording(desk: Desk) -> str:
    """The name of a recording of a tube on a column, in the desk's folder."""
    x, faces = column((0.08, 0.06), (0.0, 1.6), around=48)
    x[:, [0, 2]] *= (1.0 + 0.5 * (1.4 - x[:, 1]))[:, None]
    trimesh.Trimesh(x, faces, process=False).export("column.obj")
    Path("tube.json").write_text(json.dumps(tube(), indent=1))
    Path("tube-worn.yaml").write_text(yaml.safe_dump(SCENE))
    path = Path("recordings/one.mcap")
    path.parent.mkdir()
    nuno.run("tube-worn.yaml", record=path)
    return path.name


def test_the_page_is_told_of_edges_and_lengths_that_cannot_be_are_refused_before_a_file_is_written(
    desk: Desk, recording: str
) -> None:
    told = ask(desk, "edges", recording=recording)
    assert told["panels"] == [0, 0] and list(told["edges"]) == [0] and "no edge of sheet" in told["why"]
    assert told["edges"][0]["front[1]"] == (pytest.approx(0.2), "back[2]")
    assert told["edges"][0]["front[0]"] == (pytest.approx(0.3), None)
    files = sorted(Path().rglob("*"))
    for edge in ({"panel": 0, "edge": 1, "length": 20.0}, {"panel": 2, "edge": 1, "length": 0.3},
                 {"panel": 0, "edge": 9, "length": 0.3}, {"panel": 0, "edge": 1, "length": None}):  # fmt: skip
        with pytest.raises(BadInput):
            ask(desk, "sew", recording=recording, **edge)
    assert sorted(Path().rglob("*")) == files


@pytest.mark.full
@NEEDS_BROWSER
def test_an_edge_is_picked_and_sewn_again_with_another_length(
    page: Page, served: tuple[Desk, Server], recording: str
) -> None:
    look(page, served[1], f"#fit={recording}", "nuno.run")
    page.wait("Boolean(nuno.run.fit?.values)", PATIENCE)
    before = {path.name: path.read_bytes() for path in Path().iterdir() if path.is_file()}
    # Of a garment without panels it is said why; a second box is taken away again.
    page.value(
        f"import('{served[1].guard.address}pattern.js').then(({{ patternOf }}) => "
        f"document.body.append(Object.assign(patternOf({{ frame: {{}} }}, '{recording}'), {{ id: 'none' }})))"
    )
    page.wait("document.getElementById('none').textContent.includes('No edge of sheet can be changed')")
    assert page.value("document.querySelector('#none .sewing').hidden")
    page.value("document.getElementById('none').remove()")
    page.value(EDGE % "front, edge 1")
    page.wait("document.getElementById('edge-length').value === '20.00'")
    assert page.value("document.querySelector('.sewing span').textContent") == "sewn to back, edge 2, 20.00 cm"
    assert page.value("document.getElementById('sew-again').disabled")
    for typed in ("2000", "23.5"):
        page.value("document.getElementById('edge-length').select()")
        page.type(typed)
        page.tap("#sew-again")
        if typed == "2000":
            page.wait("document.querySelector('.sewing + div .mistake') !== null")
            assert "limit:" in page.value("document.querySelector('.sewing + div').textContent")
    page.wait("nuno.dock.now.scene === 'tube-worn-2.yaml'")
    page.wait("nuno.run?.name.startsWith('tube-worn-2-') && Boolean(nuno.run.fit?.values)", 2 * PATIENCE)
    page.value(EDGE % "front, edge 1")
    page.wait("document.getElementById('edge-length')?.value === '23.50'")
    assert "cut 23.5 cm" in page.value("document.querySelector('.panels + p').textContent")
    # All else of the scene is as it was, and nothing was written over.
    assert {name: Path(name).read_bytes() for name in before} == before
    data = scene_file.read(Path("tube-worn-2.yaml")).data
    with nuno.open("last") as last:
        assert last.scene == data and set(last.attachments) == {"tube-2.json", "column.obj"}
    data["objects"][0]["model"]["file"], data["name"] = "tube.json", "tube-worn"
    assert data == scene_file.read(Path("tube-worn.yaml")).data
    altered = read_pattern(SceneFiles(Path()), "tube-2.json")
    assert [altered.edge(side).length for seam in altered.seams for side in seam.sides] == pytest.approx([0.235] * 4)
