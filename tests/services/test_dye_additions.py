"""Supplies and resists that are added while dye spreads: as if the scene had them, and the same bits again."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from dye_scene import CELL, D0, arrays, write_scene
from live_run import Run
from PIL import Image

import nuno
from nuno.cli import main
from nuno.dye.run import DyeRun
from nuno.recording.restore import control_events
from nuno.replay.verification import verify
from nuno.runtime import supervisor
from nuno.runtime.service import Options
from nuno.scene import scene_file
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import Event

CLOTH = {"plugin": "cells", "file": "cells.npz", "cell_size": CELL, "tau3": {"I": 0.5, "II": 0.5, "III": 0.1}}
DROP = {"kind": "drop", "place": [3 * CELL, 4 * CELL], "diameter": 4 * CELL}
BATH = {"kind": "bath", "maintained": True, "liquor": 5.0, "region": {"shape": "rectangle", "low": [0, 0],
        "high": [5 * CELL, 1]}}  # fmt: skip
IMAGE = {"kind": "image"}
PASTE = {"kind": "paste", "points": [[0, 5 * CELL], [1, 5 * CELL]], "width": 3 * CELL}


def start(folder: Path, cloth: dict[str, Any] | None = None, **fields: Any) -> DyeRun:
    return DyeRun(scene_file.read(write_scene(folder, cloth=CLOTH | (cloth or {}), **fields)), 1)


def said(place: str, item: dict[str, Any]) -> str:
    return yaml.safe_dump({place: item})


@pytest.mark.parametrize(
    ("place", "item"),
    [("supply", DROP), ("supply", DROP | {"start": "5.4 s"}), ("supply", BATH | {"start": "5.4 s"}), ("resist", PASTE)],
)
def test_what_is_added_at_the_start_acts_as_if_the_scene_had_it(
    place: str, item: dict[str, Any], tmp_path: Path
) -> None:
    """The paste lies where no dye is."""
    data = arrays()
    data["phi"][:, 3:8] = 0.0
    own, added = start(tmp_path, {place: [item]}, data=data), start(tmp_path, data=data)
    without = start(tmp_path, data=data)
    assert added.add(said(place, item)) == f"dye.cloth.{place}[0]"
    for _ in range(6):
        digests = {own.advance().digest, added.advance().digest}
        without.advance()
        assert len(digests) == 1
    assert digests != {without.digest()} and own.supplied == added.supplied


def test_a_resist_takes_only_the_room_that_is_left(tmp_path: Path) -> None:
    dyeing = start(tmp_path, dyes=[{"name": name, "D0": D0} for name in ("red", "blue")], data=_two(arrays()))
    before, room = dyeing.cells.resist.copy(), dyeing.cells.mobile_room
    dyeing.advance()
    dyeing.add(said("resist", PASTE))
    covered = np.zeros(before.shape, np.bool_)
    covered[:, 4:6] = True  # middles of cells within a cell and a half of its line
    covered[:, 3:7] |= dyeing.cells.resist[:, 3:7] > before[:, 3:7]
    phi, left = dyeing.state.phi.max(axis=0), dyeing.cells.mobile_room
    assert np.array_equal(dyeing.cells.resist[~covered], before[~covered])
    assert (left >= phi).all() and (left <= room).all()
    # As far as it can: what room is left beyond the dye is rounding.
    assert (left - phi)[:, 4:6].max() <= 8 * np.finfo(np.float64).eps
    amounts = dyeing.state.phi.copy()
    for _ in range(5):
        report = dyeing.advance().report
    assert dyeing.balance(report) < 1e-13 and (dyeing.state.phi <= dyeing.cells.mobile_room * (1 + 1e-12)).all()
    assert not np.array_equal(dyeing.state.phi, amounts), "dye leaves, and none comes in its place"
    assert (dyeing.state.phi[:, :, 4:6] <= amounts.max(axis=0)[:, 4:6] * (1 + 1e-12)).all()


def _two(data: dict[str, Any]) -> dict[str, Any]:
    second = np.roll(data["phi"], 2, axis=2) * 0.0 + 0.3 * data["porosity"] * (1.0 - data["resist"])
    return data | {"phi": np.stack([data["phi"], second]), "fixed": np.zeros((2, *data["fixed"].shape))}


def test_a_resumed_run_prepares_its_solver_with_the_resist_that_it_goes_on_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from nuno_dye.solvers.explicit import Explicit

    whole = start(tmp_path)
    for _ in range(2):
        whole.advance()
    whole.add(said("resist", PASTE))
    whole.advance()
    point = whole.keep()
    seen, before = list[Any](), Explicit.prepare

    def prepare(self: Explicit, config: Any, system: Any, state: Any) -> Any:
        seen.append(system.cells.resist)
        return before(self, config, system, state)

    monkeypatch.setattr(Explicit, "prepare", prepare)
    resumed = start(tmp_path)
    resumed.resume(point, events([(2, said("resist", PASTE))]))
    assert np.array_equal(seen[-1], whole.cells.resist) and resumed.digest() == whole.digest()
    assert resumed.advance().digest == whole.advance().digest


def test_a_bath_added_after_a_resist_is_resumed_with_its_volume(tmp_path: Path) -> None:
    """The resist took the room that dye had left at its time, which is not the room at the start."""
    whole = start(tmp_path)
    added = [(2, said("resist", PASTE)), (3, said("supply", BATH))]
    for frame in range(4):
        for at, item in added:
            if at == frame:
                whole.add(item)
        whole.advance()
    resumed = start(tmp_path)
    resumed.resume(whole.keep(), events(added))
    assert resumed.supplies.entries[0].volume == whole.supplies.entries[0].volume
    for _ in range(3):
        assert resumed.advance().digest == whole.advance().digest
    assert resumed.supplied == whole.supplied


def events(added: list[tuple[int, str]]) -> list[Event]:
    """What a recording says of what was added at which frames."""
    return [
        Event(frame=frame, t=0.0, service="dye", kind="control", text="add", args={"item": item})
        for frame, item in added
    ]


def test_a_bath_keeps_its_volume_where_paste_comes_into_it(tmp_path: Path) -> None:
    dyeing = start(tmp_path, {"supply": [BATH]})
    dyeing.advance()
    volume = dyeing.supplies.entries[0].volume
    dyeing.add(said("resist", PASTE))
    report = dyeing.advance().report
    assert dyeing.supplies.entries[0].volume == volume and dyeing.balance(report) < 1e-13


@pytest.mark.parametrize(
    ("item", "field", "words"),
    [
        (said("supply", DROP | {"diameter": "-1 mm"}), "add: dye.cloth.supply[1].diameter", "more than 0"),
        (said("supply", DROP | {"place": [1, 1]}), "add: dye.cloth.supply[1].place", "0.00055 m x 0.00045 m"),
        (said("supply", DROP | {"dye": 3}), "add: dye.cloth.supply[1].dye", "limit:  0 blue"),
        (said("supply", BATH | {"stop": "1 s"}), "add: dye.cloth.supply[1].stop", "its time has passed"),
        (said("supply", DROP | {"dye": "bleu"}), "add: dye.cloth.supply[1].dye", "did you mean 'blue'"),
        (said("resist", PASTE | {"kind": "past"}), "add: dye.cloth.resist[0].kind", "paste"),
        (said("resist", IMAGE | {"file": "late.png"}), "add: dye.cloth.resist[0].file", "not in the run's recording"),
        (said("resist", IMAGE | {"file": "none.png"}), "add: dye.cloth.resist[0].file", "not in the run's recording"),
        (said("resists", PASTE), "add: resists", "did you mean 'resist'"),
        ("supply", "add", "one supply or one resist"),
        ("{supply: {}, resist: {}}", "add", "one supply or one resist"),
        ("supply: 3", "add: dye.cloth.supply[1]", ""),
        ("supply: {kind: [", "", "not a valid value"),
    ],
)
def test_what_is_refused_changes_nothing(item: str, field: str, words: str, tmp_path: Path) -> None:
    Image.new("L", (11, 9)).save(tmp_path / "late.png")
    dyeing, other = (start(tmp_path, {"supply": [DROP]}) for _ in range(2))
    dyeing.advance(), other.advance()
    with pytest.raises(BadInput) as refused:
        dyeing.add(item)
    assert field in str(refused.value) and words in str(refused.value)
    assert dyeing.loaded.data == other.loaded.data and dyeing.loaded.files.used == other.loaded.files.used
    assert dyeing.advance().digest == other.advance().digest


def test_additions_to_a_run_are_recorded_replayed_and_resumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = write_scene(tmp_path, cloth=CLOTH, duration="36000 s")
    run = Run(scene, tmp_path / "long.mcap")
    assert run.moved.wait(60)
    run.control("pause")
    run.wait_until_paused()
    assert main(["control", run.run, "add", said("supply", DROP | {"amount": 0.9})]) == 0
    assert 'dye.cloth.supply[0] nothing -> {"amount": 0.9' in capsys.readouterr().out
    assert main(["control", run.run, "add", said("supply", DROP | {"diameter": 0})]) == 2
    assert "dye.cloth.supply[1].diameter" in capsys.readouterr().err
    assert main(["control", run.run, "add"]) == 2
    run.control("step", frames=3)
    paused = run.wait_until_paused()
    for place, item in (("supply", BATH), ("resist", PASTE)):
        assert run.control("add", item=said(place, item))["field"].startswith(f"dye.cloth.{place}[")
    run.control("step", frames=2)
    assert run.wait_until_paused() == paused + 2
    # At the last frame: the checkpoint comes after them.
    run.control("add", item=said("resist", PASTE | {"points": [[0, 0], [1, 1]]}))
    run.control("add", item=said("supply", BATH | {"amount": 0.2}))
    assert run.stop().state == "stopped"
    with nuno.open(run.record) as recording:
        assert [event.text for event in control_events(recording)].count("add") == 5
        assert recording.counts["dye/cloth"] == 3 and verify(recording).frame is None
    loaded = scene_file.read(scene, [f"duration={(paused + 12) * 1.8} s"])
    resumed = supervisor.supervise(loaded, Options(record=tmp_path / "on.mcap", resume=run.record))
    assert resumed.state == "done" and resumed.summary["frame"] == paused + 12
    assert set(resumed.summary["dye"]["baths"]) == {"supply[1] bath", "supply[2] bath"}
    with nuno.open(tmp_path / "on.mcap") as recording:
        assert len(recording.marks()) == paused + 13 and verify(recording).frame is None


def test_cloth_that_moves_takes_nothing(tmp_path: Path) -> None:
    from scenes import write_scene as write_sheet

    from nuno.simulation.run import Simulation

    simulation = Simulation(scene_file.read(write_sheet(tmp_path)), None, None, 1)
    with pytest.raises(BadInput, match="is changed by an operation"):
        simulation.add(said("supply", DROP))
