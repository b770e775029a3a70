"""The cloth that the studio's page is told of: a scene's start, and a run that is followed while somebody looks."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_run import PATIENCE, wait_until
from studio_desk import FILE, SHEET

import nuno
from nuno.cli.active_runs import NEEDS
from nuno.exports.cloth import read_pieces
from nuno.runtime import runs
from nuno.runtime.supervisor import control
from nuno.scene import scene_file, shipped
from nuno.studio import cloth
from nuno.studio.desk import Desk
from nuno.studio.live_view import see_objects
from nuno.studio.server import Refused, page_files
from nuno_schemas.colour import CONTROL
from nuno_schemas.errors import BadInput

LONG = SHEET.replace("0.4 s", "400 s")


def read(message: tuple[str, bytes]) -> dict[str, Any]:
    """What the page makes of a frame."""
    body = message[1]
    size = int.from_bytes(body[:4], "little")
    frame, at = dict(json.loads(body[4 : 4 + size])), 4 + size
    for name, kind, count in frame["arrays"]:
        frame[name] = np.frombuffer(body, np.dtype(kind).newbyteorder("<"), count, at)
        at += 4 * count
    assert at == len(body)
    return frame


def see(desk: Desk, text: str, scene: str = FILE) -> dict[str, Any]:
    return desk.act({"do": "see", "scene": scene, "text": text})


def start(desk: Desk, number: int) -> dict[str, Any]:
    return read(desk._starts.tell({"number": [str(number)]}))


def test_a_start_is_that_of_the_text_and_nothing_is_run_for_it(desk: Desk) -> None:
    first = see(desk, SHEET)
    Path("other.yaml").write_text(text := SHEET.replace("[9, 9]", "[5, 7]"))
    other = see(desk, text)
    sight = see_objects(scene_file.read(Path("other.yaml")))[0]
    frame = start(desk, other["number"])
    assert np.array_equal(frame["x"].reshape(-1, 3), (sight.x - frame["origin"]).astype(np.float32))
    assert np.array_equal(frame["faces"].reshape(-1, 3), sight.faces) and frame["state"] == "start"
    assert np.array_equal(frame["edges"].reshape(-1, 2), sight.edges) and np.array_equal(frame["rest"], sight.rest)
    assert len(start(desk, first["number"])["x"]) == 3 * 81
    assert not Path("recordings").exists() and desk.act({"do": "now"}) == {"state": "none"}
    for _ in range(cloth.MOST):
        see(desk, SHEET)
    with pytest.raises(Refused, match="no longer"):
        start(desk, first["number"])


def test_cloth_has_the_colours_of_its_recording_and_its_pictures(desk: Desk) -> None:
    sheet = "{plugin: sheet, size: [40 cm, 40 cm], resolution: [5, 5], fabric: silk}"
    net = "{plugin: net, file: pendulum.npz}"
    shutil.copy(shipped.folder() / "pendulum.npz", ".")
    more = "".join(f"  - {{name: {name}, model: {model}{colour}}}\n" for name, model, colour in (
        ("plain", sheet, ""), ("red", sheet, ", colour: '#c03020'"), ("net", net, ""), ("last", sheet, "")
    ))  # fmt: skip
    Path(FILE).write_text(text := SHEET.replace("# the end\n", more))
    told = start(desk, see(desk, text)["number"])["pieces"]
    nuno.run(FILE, duration="40 ms", record=Path("all.mcap"))
    with nuno.open(Path("all.mcap")) as recording:
        kept = read_pieces(recording)
    assert [one["colour"] for one in told] == [one.colour for one in kept]
    assert len({one["colour"] for one in told}) == 5


def test_what_is_not_shown_is_said_and_a_scene_without_cloth_is_refused(desk: Desk) -> None:
    assert see(desk, SHEET)["words"] == ""
    assert "dye" in see(desk, shipped.find("skirt-dyed").read_text(), "skirt-dyed")["words"]
    with pytest.raises(BadInput, match="no cloth here"):
        see(desk, shipped.find("dye/drops").read_text(), "dye/drops")
    with pytest.raises(BadInput, match="fabric"):
        see(desk, SHEET.replace("silk", "sillk"))


def test_a_run_is_followed_only_while_somebody_looks_and_shows_what_is_recorded(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cloth, "LEAVE", 0.2)
    desk.act({"do": "run", "scene": FILE, "text": LONG})
    own = desk._own
    assert own is not None
    wait_until(lambda: own.frame > 5, PATIENCE)
    assert own.live is not None and own.live.follower is None
    asked = {"run": [own.name]}
    first = read(desk._live(asked))
    assert {"faces", "bodyFaces", "edges"} <= first.keys() and first["run"] == own.name
    again = {name: [str(first[key])] for name, key in [("after", "number"), ("shape", "shape"), ("place", "place")]}
    later = read(desk._live(asked | again))
    assert "faces" not in later and later["frame"] > first["frame"] and own.live.follower is not None
    frame = desk.act({"do": "control", "action": "pause"})["frame"]
    wait_until(lambda: read(desk._live(asked))["frame"] == frame)
    shown = read(desk._live(asked))
    wait_until(lambda: own.live is not None and own.live.follower is None)
    with pytest.raises(Refused):
        desk._live({"run": ["another"]})
    check_set(desk, own.name)
    desk.act({"do": "control", "action": "stop"})
    wait_until(lambda: desk.act({"do": "now"})["state"] == "over", PATIENCE)
    with nuno.open("last") as recording:
        x = list(recording.frames())[frame].x
    assert np.array_equal(shown["x"].reshape(-1, 3), (x - shown["origin"]).astype(np.float32))


def check_set(desk: Desk, run: str) -> None:
    """A field is changed as from the command line, and refused in its words."""
    answer = desk.act({"do": "control", "action": "set", "item": "damping=0.75"})
    assert answer["changed"] | {"frame": 0} == {"field": "damping", "old": 0.5, "new": 0.75, "frame": 0}
    for item in ("duration=3 s", "damping=-1", "solver.dt=1 s", "dampin=1", ""):
        with pytest.raises(BadInput) as refused:
            desk.act({"do": "control", "action": "set", "item": item})
        told = control(run, runs.running()[run], {"action": "set", "item": item})
        assert not told["ok"] and str(refused.value) in told["error"], item
    assert NEEDS["set"][1] == "set damping=0.5"  # the page's example


def test_the_page_has_the_colours_of_pictures() -> None:
    text = page_files()["scale.js"][1].decode()
    assert tuple(re.findall(r'"(#[0-9a-f]{6})"', text)) == CONTROL
