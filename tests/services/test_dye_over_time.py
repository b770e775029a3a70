"""Dye that is given over time: whole steps, accounts, and the same bits again."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dye_scene import CELL, D0, arrays, write_scene
from dye_slab import CLOTH, DROP, LEFT, RED, SPREAD, WHOLE, slab

import nuno
from nuno.cli import main
from nuno.dye.run import DyeRun
from nuno.dye.supply import first_step, give
from nuno.replay.verification import verify
from nuno.report.show import lines
from nuno.runtime import supervisor
from nuno.runtime.service import Options
from nuno.scene import scene_file
from nuno_dye.solvers.explicit import Explicit
from nuno_schemas.dye import DyeSystem
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float


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
