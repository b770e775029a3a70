"""Dye that is given, added or rinsed over time: whole steps, accounts, and the same bits again."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from dye_scene import CELL, D0, TAU3, arrays, write_scene
from dye_slab import CLOTH, DROP, LEFT, RED, SPREAD, WHOLE, slab
from live_run import Run
from PIL import Image

import nuno
from nuno.cli import main
from nuno.dye.run import DyeRun
from nuno.dye.supply import first_step, give
from nuno.plugin_contract import registry
from nuno.recording.reader import control_events
from nuno.report.run_report import lines
from nuno.resimulation.verification import verify
from nuno.runtime import supervisor
from nuno.runtime.service import Options
from nuno.scene import scene_file
from nuno_dye.solvers.explicit import Explicit
from nuno_schemas.dye import DyeSystem
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.messages import Event


@pytest.mark.parametrize(
    ("time", "dt", "step"),
    [(0.0, 0.3, 0), (0.9, 0.3, 3), (0.91, 0.3, 4), (1e6, 1e-3, 10**9), (math.inf, 0.3, math.inf), (0.1, 0.3, 1)],
)
def test_times_are_the_first_whole_steps_at_or_after_them(time: float, dt: float, step: float) -> None:
    assert first_step(time, dt) == step


@pytest.mark.full
def test_nothing_is_given_before_its_start_nor_after_its_stop(tmp_path: Path) -> None:
    """Of a dye that does not spread: half a frame is 50 steps."""
    still = [RED | {"D0": 0.0}]
    frame = 100 * CELL**2 / (4.0 * D0)
    drop = DROP | {"place": [2 * CELL, 0], "start": 1.5 * frame, "amount": 0.5}
    kept = WHOLE | {"region": LEFT, "start": 2.495 * frame, "stop": 2.505 * frame}
    dyeing = slab(tmp_path, 11, [drop, kept], dyes=still)
    seen = []
    for _ in range(4):
        dyeing.advance()
        seen.append(dict(dyeing.supplies.given[0]))
    assert seen[0] == {} and list(seen[1]) == ["supply[0] drop"] and list(seen[2]) == [*seen[1], "supply[1] bath"]
    assert seen[2] == seen[3]
    entries = dyeing.supplies.entries
    assert [(entry.first, entry.last) for entry in entries] == [(150, 150), (250, 251)]


@pytest.mark.parametrize("supply", [WHOLE, WHOLE | {"liquor": 8.0}, DROP | {"place": [CELL, 0]}])
def test_a_frame_counts_all_its_steps_however_supplies_cut_it(supply: dict[str, Any], tmp_path: Path) -> None:
    frame = 100 * CELL**2 / (4.0 * D0)
    report = slab(tmp_path, 9, [supply | {"start": 0.3 * frame}]).advance().report
    assert report.steps == report.totals["steps"] == 100


def test_what_is_kept_up_stops_at_its_time(tmp_path: Path) -> None:
    """A bath for half a frame gives as much in that frame as in one that it ends with, and no more."""
    frame = 100 * CELL**2 / (4.0 * D0)
    bath = WHOLE | {"region": LEFT}
    short, long = (slab(tmp_path, 9, [bath | more]) for more in ({"stop": 0.5 * frame}, {}))
    doubled = slab(tmp_path, 9, [bath], frame_rate=0.02 * 4.0 * D0 / CELL**2)
    short.advance()
    long.advance()
    doubled.advance()
    assert short.supplied == doubled.supplied < long.supplied
    short.advance()
    assert short.supplied == doubled.supplied


@pytest.mark.parametrize(("supply", "kept"), [(WHOLE, True), (DROP, False), (WHOLE | {"liquor": 2.0}, False)])
def test_steps_that_keep_supplies_up_are_prepared(
    supply: dict[str, Any], kept: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What they need is compiled before the run, where it is not counted as its time."""
    prepared, before = list[tuple[int, bool]](), Explicit.advance

    def advance(self: Explicit, system: DyeSystem, state: Any, memory: Any, steps: int, dt: float) -> Any:
        prepared.append((steps, system.supply is not None and bool(system.supply.any())))
        return before(self, system, state, memory, steps, dt)

    monkeypatch.setattr(Explicit, "advance", advance)
    slab(tmp_path, 9, [supply | {"start": "1 s"} | ({"place": [CELL, 0]} if supply is DROP else {})])
    assert prepared == ([(0, False), (0, True)] if kept else [(0, False)])


@pytest.mark.parametrize("supply", [[DROP], [WHOLE], [WHOLE | {"liquor": 2.0}], [WHOLE, WHOLE | {"liquor": 2.0}]])
def test_a_solver_sees_the_same_system_while_nothing_changes(
    supply: list[dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Solvers keep what follows from it: another system in every frame would be laid out in every frame."""
    seen, before = list[DyeSystem](), Explicit.advance

    def advance(self: Explicit, system: DyeSystem, *rest: Any) -> Any:
        seen.append(system)
        return before(self, system, *rest)

    dyeing = DyeRun(scene_file.read(write_scene(tmp_path, cloth=CLOTH | {"supply": supply})), 1)
    dyeing.advance()
    monkeypatch.setattr(Explicit, "advance", advance)
    for _ in range(3):
        dyeing.advance()
    assert len(seen) >= 3 and all(system is seen[0] for system in seen)


def test_giving_fills_to_a_share_takes_nothing_and_counts_what_it_gave() -> None:
    rng = np.random.default_rng(3)
    room = rng.random((2, 30, 40)) * (rng.random((2, 30, 40)) > 0.2)
    phi = room * rng.random(room.shape)
    cells = rng.random(room.shape) > 0.5
    after, given = give(phi, room, cells, 0.6)
    assert np.array_equal(after[~cells], phi[~cells]) and (after >= phi).all() and (after <= room).all()
    assert (after[cells] >= 0.6 * room[cells]).all()
    assert np.array_equal(after[phi >= 0.6 * room], phi[phi >= 0.6 * room])
    assert given == pytest.approx(math.fsum(after.ravel()) - math.fsum(phi.ravel()), rel=1e-13)
    assert give(after, room, cells, 0.6).given == 0.0
    assert np.array_equal(give(phi, room, np.ones_like(cells), 1.0).phi, room)


def rich(folder: Path, **fields: Any) -> Path:
    """All kinds at once, on cells of all kinds, of two dyes, at odd times."""
    data = arrays()
    data |= {name: np.stack([data[name], np.zeros_like(data[name])]) for name in ("phi", "fixed")}
    stroke = {"kind": "stroke", "points": [[0, 0], [6 * CELL, 8 * CELL]], "width": 3 * CELL, "maintained": True}
    supply = [
        DROP | {"start": "5 s", "amount": 0.7},
        WHOLE | {"liquor": 5.0, "start": "3 s", "stop": "16 s", "dye": 1, "region": LEFT | {"high": [5 * CELL, 1]}},
        stroke | {"amount": 0.5, "start": "6 s"},
        stroke | {"amount": 0.9, "start": "8 s", "stop": "11 s", "layers": "warp"},
    ]
    cloth = {"plugin": "cells", "file": "cells.npz", "cell_size": CELL, "tau3": {"I": 0.5, "II": 0.5, "III": 0.1}}
    blue = RED | {"name": "blue", "adsorption": 0.5, "isotherm": {"plugin": "langmuir", "K": 2.0}}
    scene = {"cloth": cloth | {"supply": supply}, "dyes": [blue, RED], "frame_rate": 1 / 3.6, "duration": "21.6 s"}
    return write_scene(folder, data=data, **scene | fields)


def test_every_supply_is_accounted_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = nuno.run(rich(tmp_path), record=tmp_path / "run.mcap")
    dye = result.report["dye"]
    stroke = "supply[2] stroke"
    both = f"{stroke} and supply[3] stroke"
    assert set(dye["given"]["blue"]) == {"at the start", "supply[0] drop", stroke, "supply[3] stroke", both}
    assert list(dye["given"]["red"]) == ["supply[1] bath"] and list(dye["baths"]) == ["supply[1] bath"]
    for name, account in dye["given"].items():
        assert dye["supplied"][name] == pytest.approx(sum(account.values()), rel=1e-14)
    assert dye["balance"] < 1e-12
    given: Float = result.recording.series()["supplied_blue"]
    assert (np.diff(given) >= 0.0).all() and given[1] == given[0] < given[2]


def test_what_would_come_after_the_end_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """At 6 s no step begins before 7.2 s."""
    scene = rich(tmp_path, duration="7.2 s")
    result = nuno.run(scene, record=tmp_path / "run.mcap")
    assert result.report["dye"]["ahead"] == {"supply[2] stroke": 6.0, "supply[3] stroke": 8.0}
    assert ("", "supply[3] stroke begins at 8 s of the dyeing, after the end") in lines(result.report)
    assert main(["plan", str(scene)]) == 0
    said = "drop at 5 s; bath 3 s to 16 s, exhausted; stroke 6 s to the end; stroke 8 s to 11 s"
    assert said in capsys.readouterr().out


LATE = [DROP | {"start": "4 s"}, WHOLE | {"start": "4 s", "region": LEFT}]


@pytest.mark.quick(supply=LATE[:1])
@pytest.mark.parametrize("supply", LATE)
def test_what_comes_later_fills_no_cell_beyond_its_room(supply: dict[str, Any], tmp_path: Path) -> None:
    """Of a dye that only spreads: the solver may leave out limits that cannot bind, as none does without dye."""
    data = arrays() | {"phi": np.zeros((2, 9, 11))}
    cloth = {"plugin": "cells", "file": "cells.npz", "cell_size": CELL, "tau3": SPREAD | {"I": 1}, "supply": [supply]}
    dyeing = DyeRun(scene_file.read(write_scene(tmp_path, data=data, cloth=cloth, dyes=[RED], solver="explicit")), 1)
    for _ in range(10):
        report = dyeing.advance().report
        assert (dyeing.state.phi[0] <= dyeing.cells.mobile_room * (1.0 + 1e-12)).all()
    assert report.mobile[0] > 1.0 and dyeing.balance(report) < 1e-13


def test_supplies_are_resumed_and_replayed_to_the_last_bit(tmp_path: Path) -> None:
    """From within the times of all of them."""
    whole = nuno.run(rich(tmp_path), record=tmp_path / "whole.mcap")
    assert verify(whole.recording).frame is None
    part = nuno.run(rich(tmp_path), "duration=10.8 s", record=tmp_path / "part.mcap")
    options = Options(record=tmp_path / "resumed.mcap", resume=part.path)
    resumed = supervisor.supervise(scene_file.read(rich(tmp_path)), options)
    assert resumed.state == "done" and resumed.summary["digest"] == whole.digest
    assert resumed.summary["dye"]["given"] == whole.report["dye"]["given"]
    assert resumed.summary["dye"]["baths"] == whole.report["dye"]["baths"]


def test_a_bath_s_share_is_part_of_the_digest(tmp_path: Path) -> None:
    dyeing = DyeRun(scene_file.read(rich(tmp_path)), 1)
    for _ in range(2):
        dyeing.advance()
    before = dyeing.digest()
    dyeing.supplies.entries[1].share *= 1.0 - 1e-15
    assert dyeing.digest() != before


def test_a_dye_is_given_by_its_name_as_by_its_place(tmp_path: Path) -> None:
    def digest(dye: object) -> str:
        cloth = {
            "plugin": "cells",
            "file": "cells.npz",
            "cell_size": CELL,
            "tau3": SPREAD,
            "supply": [DROP | {"dye": dye}],
        }
        data = arrays() | {name: np.zeros((2, 2, 9, 11)) for name in ("phi", "fixed")}
        run = DyeRun(
            scene_file.read(write_scene(tmp_path, data=data, cloth=cloth, dyes=[RED | {"name": "blue"}, RED])), 1
        )
        return run.advance().digest

    assert digest("red") == digest(1) != digest("blue") == digest(0)


@pytest.mark.parametrize(
    ("supply", "field", "words"),
    [
        (DROP | {"place": ["20 mm", 0]}, "dye.cloth.supply[0].place", "0.00055 m x 0.00045 m"),
        (DROP | {"dye": 1}, "dye.cloth.supply[0].dye", "limit:  0 blue"),
        (DROP | {"dye": "bleu"}, "dye.cloth.supply[0].dye", "did you mean 'blue'?"),
        (WHOLE | {"start": 3, "stop": 2}, "dye.cloth.supply[0].stop", "stop 2 s must be after start 3 s"),
        (DROP | {"stop": 2}, "dye.cloth.supply[0].stop", "maintained: true"),
        ({"kind": "bath", "liquor": 2}, "dye.cloth.supply[0].liquor", "maintained: true"),
        (
            DROP | {"kind": "dropp"},
            "dye.cloth.supply[0].kind: unknown kind",
            "did you mean 'drop'? known: bath, drop, rinse, stroke",
        ),
        (DROP | {"start": "-1 s"}, "dye.cloth.supply[0].start", "at least 0"),
    ],
)
def test_supplies_are_refused_by_name(supply: dict[str, Any], field: str, words: str, tmp_path: Path) -> None:
    cloth = {"plugin": "cells", "file": "cells.npz", "cell_size": CELL, "tau3": SPREAD, "supply": [supply]}
    with pytest.raises(BadInput) as refused:
        nuno.run(write_scene(tmp_path, cloth=cloth))
    assert field in str(refused.value) and words in str(refused.value)


CLOTH_ADDED = {"plugin": "cells", "file": "cells.npz", "cell_size": CELL, "tau3": {"I": 0.5, "II": 0.5, "III": 0.1}}
DROP_ADDED = {"kind": "drop", "place": [3 * CELL, 4 * CELL], "diameter": 4 * CELL}
BATH = {"kind": "bath", "maintained": True, "liquor": 5.0, "region": {"shape": "rectangle", "low": [0, 0],
        "high": [5 * CELL, 1]}}  # fmt: skip
IMAGE = {"kind": "image"}
PASTE = {"kind": "paste", "points": [[0, 5 * CELL], [1, 5 * CELL]], "width": 3 * CELL}


def start(folder: Path, cloth: dict[str, Any] | None = None, **fields: Any) -> DyeRun:
    return DyeRun(scene_file.read(write_scene(folder, cloth=CLOTH_ADDED | (cloth or {}), **fields)), 1)


def said(place: str, item: dict[str, Any]) -> str:
    return yaml.safe_dump({place: item})


@pytest.mark.parametrize(
    ("place", "item"),
    [
        ("supply", DROP_ADDED),
        ("supply", DROP_ADDED | {"start": "5.4 s"}),
        ("supply", BATH | {"start": "5.4 s"}),
        ("resist", PASTE),
    ],
)
def test_what_is_added_at_the_start_acts_as_if_the_scene_had_it(
    place: str, item: dict[str, Any], tmp_path: Path
) -> None:
    """The paste lies where no dye is."""
    data = arrays()
    data["phi"][:, 3:8] = 0.0
    own, added = start(tmp_path, {place: [item]}, data=data), start(tmp_path, data=data)
    without = start(tmp_path, data=data)
    assert added.add(said(place, item))["field"] == f"dye.cloth.{place}[0]"
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
        (said("supply", DROP_ADDED | {"diameter": "-1 mm"}), "add: dye.cloth.supply[1].diameter", "more than 0"),
        (said("supply", DROP_ADDED | {"place": [1, 1]}), "add: dye.cloth.supply[1].place", "0.00055 m x 0.00045 m"),
        (said("supply", DROP_ADDED | {"dye": 3}), "add: dye.cloth.supply[1].dye", "limit:  0 blue"),
        (said("supply", BATH | {"stop": "1 s"}), "add: dye.cloth.supply[1].stop", "its time has passed"),
        (said("supply", DROP_ADDED | {"dye": "bleu"}), "add: dye.cloth.supply[1].dye", "did you mean 'blue'"),
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
    dyeing, other = (start(tmp_path, {"supply": [DROP_ADDED]}) for _ in range(2))
    dyeing.advance(), other.advance()
    with pytest.raises(BadInput) as refused:
        dyeing.add(item)
    assert field in str(refused.value) and words in str(refused.value)
    assert dyeing.loaded.data == other.loaded.data and dyeing.loaded.files.used == other.loaded.files.used
    assert dyeing.advance().digest == other.advance().digest


def test_additions_to_a_run_are_recorded_replayed_and_resumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = write_scene(tmp_path, cloth=CLOTH_ADDED, duration="36000 s")
    run = Run(scene, tmp_path / "long.mcap")
    assert run.moved.wait(60)
    run.control("pause")
    run.wait_until_paused()
    assert main(["control", run.run, "add", said("supply", DROP_ADDED | {"amount": 0.9})]) == 0
    assert 'dye.cloth.supply[0] nothing -> {"amount": 0.9' in capsys.readouterr().out
    assert main(["control", run.run, "add", said("supply", DROP_ADDED | {"diameter": 0})]) == 2
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
        simulation.add(said("supply", DROP_ADDED))


BLUE = {"name": "blue", "D0": D0, "adsorption": 0.5, "isotherm": {"plugin": "langmuir", "K": 2.0}}
RED_RINSED = {"name": "red", "D0": D0}
FRAME = 1.8
LEFT_RINSED = {"shape": "rectangle", "low": [0, 0], "high": [5 * CELL, 1]}


def scene(folder: Path, supply: list[dict[str, Any]], **fields: Any) -> Path:
    """Two dyes on cells of all kinds, of which blue is fixed by fibre."""
    data = arrays()
    data |= {name: np.stack([data[name], 0.5 * data[name]]) for name in ("phi", "fixed")}
    cloth = {"plugin": "cells", "file": "cells.npz", "cell_size": CELL, "tau3": TAU3, "supply": supply}
    return write_scene(folder, data=data, cloth=cloth, dyes=[BLUE, RED_RINSED], **fields)


@pytest.mark.quick(solver=["explicit"])
@pytest.mark.parametrize("solver", sorted(registry.installed("nuno.dye_solvers")))
def test_a_rinse_leaves_no_mobile_dye_and_all_that_fibre_holds(solver: str, tmp_path: Path) -> None:
    """To the last bit: without mobile dye fibre takes none, so what it holds is what it held before the rinse."""
    rinse = {"kind": "rinse", "start": 3 * FRAME}
    dyeing = DyeRun(scene_file.read(scene(tmp_path, [rinse], solver={"plugin": solver, "dt": FRAME})), 1)
    for _ in range(3):
        before = dyeing.advance().report
    fixed = dyeing.state.fixed.copy()
    assert (fixed[0].sum(), min(before.mobile)) > (1.0, 1.0)
    for _ in range(3):
        report = dyeing.advance().report
        assert not dyeing.state.phi.any() and np.array_equal(dyeing.state.fixed, fixed)
        assert dyeing.balance(report) < 1e-14
    for account, mobile in zip(dyeing.supplies.given, before.mobile, strict=True):
        assert account["supply[0] rinse"] == pytest.approx(-mobile, rel=1e-14)


def test_a_rinse_takes_its_share_of_one_dye_where_it_is(tmp_path: Path) -> None:
    """Of dyes that do not spread, so that nothing else changes them. At 0 it acts once, too."""
    still = [BLUE | {"D0": 0.0}, RED_RINSED | {"D0": 0.0}]
    rinses = [
        {"kind": "rinse", "dye": "blue", "region": LEFT_RINSED, "share": 0.25},
        {"kind": "rinse", "layers": "warp", "start": FRAME, "share": 0.5},
    ]
    bare = DyeRun(scene_file.read(scene(tmp_path, [])), 1).state.phi
    dyeing = DyeRun(scene_file.read(scene(tmp_path, rinses), [f"dye.dyes={still}"]), 1)
    expected = bare.copy()
    expected[0, :, :, :5] *= 0.75
    dyeing.advance()
    assert np.array_equal(dyeing.state.phi, expected)
    expected[:, 1] *= 0.5
    for _ in range(2):
        report = dyeing.advance().report
        assert np.array_equal(dyeing.state.phi, expected)
    taken = [math.fsum(account[name] for name in account if "rinse" in name) for account in dyeing.supplies.given]
    assert taken == [pytest.approx(amounts.sum(), rel=1e-14) for amounts in expected - bare]
    assert dyeing.balance(report) < 1e-14


def test_baths_with_a_rinse_between_are_resumed_and_replayed_to_the_last_bit(tmp_path: Path) -> None:
    """Overdyeing, with the rinse half-way through the second frame; and from a checkpoint after it."""
    recipe = [
        {"kind": "bath", "dye": "blue", "maintained": True, "stop": 1.5 * FRAME, "amount": 0.5},
        {"kind": "rinse", "start": 1.5 * FRAME, "share": 0.75},
        {"kind": "bath", "dye": "red", "maintained": True, "start": 2 * FRAME, "amount": 0.5},
    ]
    path = scene(tmp_path, recipe, duration=6 * FRAME, solver={"plugin": "explicit", "dt": FRAME / 2})
    whole = nuno.run(path, record=tmp_path / "whole.mcap")
    assert verify(whole.recording).frame is None
    nuno.run(path, f"duration={4 * FRAME}", record=tmp_path / "part.mcap")
    options = Options(record=tmp_path / "resumed.mcap", resume=tmp_path / "part.mcap")
    resumed = supervisor.supervise(scene_file.read(path), options)
    assert resumed.summary["digest"] == whole.digest
    dye = whole.report["dye"]
    assert resumed.summary["dye"]["given"] == dye["given"] and dye["balance"] < 1e-13
    assert dye["given"]["blue"]["supply[1] rinse"] < 0.0 < dye["given"]["blue"]["supply[0] bath"]
    for name, account in dye["given"].items():
        assert dye["supplied"][name] == pytest.approx(math.fsum(account.values()), rel=1e-14)
