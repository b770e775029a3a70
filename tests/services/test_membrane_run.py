"""A mesh of a measured fabric in a run: recorded, resumed, reported, and met by what works on springs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenes import write_scene

import nuno
from nuno.exports.cloth import read_pieces
from nuno.runtime import supervisor
from nuno.runtime.service import Options
from nuno.scene import scene_file
from nuno.simulation import cloth as build
from nuno_bench.problem import lengths_at_rest
from nuno_bench.stability import shortest, stiffen
from nuno_schemas.errors import BadInput

LINE = {"points": [[0.05, 0.0, 0.05], [0.15, 0.0, 0.15]], "height": 0.01}


def cloth(folder: Path, **fields: Any) -> dict[str, Any]:
    """A level piece of 0.2 m, held along one side, whose vertices lie in no rows."""
    ticks = np.linspace(0.0, 0.2, 6)
    x, z = (each.reshape(-1) for each in np.meshgrid(ticks, ticks))
    inside = (x > 0) & (x < 0.2) & (z > 0) & (z < 0.2)
    rng = np.random.default_rng(1)
    x, z = (each + np.where(inside, rng.uniform(-0.01, 0.01, each.shape), 0.0) for each in (x, z))
    row, column = (each.reshape(-1) for each in np.mgrid[:5, :5])
    a = 6 * row + column + 1
    faces = np.concatenate([np.column_stack([a, a + 6, a + 7]), np.column_stack([a, a + 7, a + 1])])
    lines = [f"v {p!r} 0 {q!r}" for p, q in zip(x.tolist(), z.tolist(), strict=True)]
    (folder / "piece.obj").write_text("\n".join(lines + [f"f {i} {j} {k}" for i, j, k in faces.tolist()]) + "\n")
    pin = [{"low": [-1, -1, -0.01], "high": [1, 1, 0.01]}]
    model = {"plugin": "mesh", "file": "piece.obj", "warp": [0, 0, 1], "pin": pin, "fabric": "interlock"}
    return {"name": "piece", "model": model | fields}


@pytest.mark.full
@pytest.mark.quick(solver=["xpbd"])
@pytest.mark.parametrize("solver", ["leapfrog", "implicit_euler", "xpbd"])
def test_it_hangs_by_its_side_and_a_resumed_run_ends_in_the_same_bits(tmp_path: Path, solver: str) -> None:
    scene = write_scene(tmp_path, objects=[cloth(tmp_path)], solver=solver, duration=0.4, damping=2.0,
                        cloth_contact={"plugin": "offset"}, record={"checkpoint_every": 0.2})  # fmt: skip
    whole = nuno.run(scene, record=tmp_path / "whole.mcap")
    assert whole.report["size"]["triangles of a membrane"] == 50 and whole.report["size"]["springs"] == 0
    assert 0.0 < whole.report["stretch"] < 0.1
    part = nuno.run(scene, "duration=0.2", record=tmp_path / "part.mcap")
    options = Options(record=tmp_path / "on.mcap", resume=part.path)
    assert supervisor.supervise(scene_file.read(scene), options).summary["digest"] == whole.digest


@pytest.mark.quick(solver=["symplectic_euler"], plugin=["mesh"])
@pytest.mark.parametrize("solver", ["symplectic_euler", "respa", "implicit_euler", "xpbd"])
@pytest.mark.parametrize("plugin", ["mesh", "sheet"])
def test_what_friction_remembers_is_part_of_the_state(tmp_path: Path, solver: str, plugin: str) -> None:
    """A resumed run ends in the same bits, and other ones than without friction."""
    piece = cloth(tmp_path)
    if plugin == "sheet":
        piece["model"] = {
            "plugin": "sheet",
            "size": [0.2, 0.2],
            "resolution": [6, 6],
            "plane": "xz",
            "pin": ["top-row"],
        }
    digests = []
    for fabric in ({"preset": "interlock", "hysteresis_warp": 2e-4, "hysteresis_weft": 1e-4}, "interlock"):
        piece["model"]["fabric"] = fabric
        scene = write_scene(tmp_path, objects=[piece], solver=solver, duration=0.2, record={"checkpoint_every": 0.1})
        whole = nuno.run(scene, record=tmp_path / "whole.mcap")
        part = nuno.run(scene, "duration=0.1", record=tmp_path / "part.mcap")
        options = Options(record=tmp_path / "on.mcap", resume=part.path)
        digests.append(whole.digest)
        assert supervisor.supervise(scene_file.read(scene), options).summary["digest"] == whole.digest
        for name in ("whole", "part", "on"):
            (tmp_path / f"{name}.mcap").unlink()
    assert digests[0] != digests[1]


def test_what_is_shown_of_it_are_the_sides_of_its_triangles(tmp_path: Path) -> None:
    scene = write_scene(tmp_path, objects=[cloth(tmp_path)], duration=0.02)
    with nuno.open(nuno.run(scene, record=tmp_path / "run.mcap").path) as recording:
        fabric, first = recording.fabric()[0], next(recording.frames())
    ends = first.x[fabric["edges"]]
    assert len(ends) == 85
    assert np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) == pytest.approx(fabric["edge_rest"], rel=1e-4)


def test_it_comes_to_rest_in_balance(tmp_path: Path) -> None:
    scene = write_scene(tmp_path, objects=[cloth(tmp_path)], solver="implicit_euler", duration=20.0, damping=5.0,
                        until="balance")  # fmt: skip
    assert nuno.run(scene).report["rested"]


def test_lines_ask_for_a_width_or_springs(tmp_path: Path) -> None:
    operations = [{"plugin": "wrinkle", "at": 0.0, "lines": [LINE]}]
    refused = write_scene(tmp_path, objects=[cloth(tmp_path)], duration=0.05, operations=operations)
    with pytest.raises(BadInput, match="keep their triangles") as caught:
        nuno.run(refused)
    assert "operations[0].lines[0].width" in str(caught.value)
    raised = [{"plugin": "wrinkle", "lines": [LINE | {"width": 0.2}]}]
    wide = write_scene(tmp_path, objects=[cloth(tmp_path)], duration=0.05, operations=raised)
    assert nuno.run(wide).report["changes"]
    drawn = write_scene(tmp_path, objects=[cloth(tmp_path, tension="springs")], duration=0.05, operations=operations)
    assert nuno.run(drawn).report["changes"]


def test_benches_stiffen_it_and_measure_its_strain(tmp_path: Path) -> None:
    """As springs: damping by the root keeps its share of the critical."""
    fabric = build.build_fabric(scene_file.read(write_scene(tmp_path, objects=[cloth(tmp_path)])))[0]
    soft, stiff = fabric.membrane, stiffen(fabric, 9.0).membrane
    assert soft is not None and stiff is not None
    np.testing.assert_array_equal(stiff.moduli, 9.0 * soft.moduli)
    np.testing.assert_array_equal(stiff.damping, 3.0 * soft.damping)
    pairs, rest = lengths_at_rest(fabric)
    length = np.linalg.norm(np.diff(fabric.position[pairs], axis=1)[:, 0], axis=1)
    assert rest == pytest.approx(length, rel=1e-12) and len(rest) == 85
    # A side has a length in each of its triangles, to the last bits.
    assert shortest(fabric) == pytest.approx(rest.min(), rel=1e-12)


def test_a_knit_beside_it_is_shown_by_its_yarns_and_their_tension(tmp_path: Path) -> None:
    """Sides of triangles are no yarns; the mesh is shown by its stretch."""
    knit = {
        "plugin": "knit",
        "wales": 3,
        "courses": 4,
        "spacing": [0.02, 0.02],
        "yarns": ["elastane"],
        "pin": ["top-row"],
    }
    objects = [{"name": "knit", "model": knit}, cloth(tmp_path)]
    scene = write_scene(tmp_path, objects=objects, duration=0.02, solver="leapfrog")
    with nuno.open(nuno.run(scene, record=tmp_path / "run.mcap").path) as recording:
        arrays, pieces = recording.fabric()[0], read_pieces(recording)
    alone = write_scene(tmp_path, objects=objects[:1], duration=0.02, solver="leapfrog")
    with nuno.open(nuno.run(alone, record=tmp_path / "alone.mcap").path) as recording:
        expected = recording.fabric()[0]
    links = len(expected["edges"])
    assert len(arrays["edges"]) == links + 85
    for name in ("edge_yarn", "edge_k", "edge_mu", "edge_beside"):
        assert len(arrays[name]) == links + 85
        np.testing.assert_array_equal(arrays[name][:links], expected[name])
    assert pieces[0].tensions is not None and pieces[1].tensions is None
