"""What the page of `nuno studio` asks for: scenes checked and saved, runs, recordings."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from live_run import PATIENCE, wait_until
from studio_desk import FILE, SHEET, ask

import nuno
from nuno.python_api.plan import describe
from nuno.recording.writer import part_of
from nuno.scene import scene_file, shipped
from nuno.studio.desk import Desk
from nuno.studio.server import page_files
from nuno_schemas.errors import BadInput


def about(desk: Desk, does: str, /, text: str = SHEET, **more: object) -> dict[str, Any]:
    return ask(desk, does, scene=FILE, text=text, **more)


def run_to_end(desk: Desk, text: str = SHEET) -> dict[str, Any]:
    about(desk, "run", text)
    wait_until(lambda: ask(desk, "now")["state"] in ("over", "failed", "refused", "stopped"), PATIENCE)
    return ask(desk, "now")


def test_the_page_takes_nothing_from_elsewhere_and_is_small() -> None:
    files = page_files()
    text = "".join(body.decode() for _, body in files.values())
    assert set(re.findall(r"https?://[^\s\"'`]+", text)) == {"http://www.w3.org/2000/svg"}
    # What a browser loads at first: styles, and scripts with all that they import beforehand.
    loaded, waiting = set[str](), ["index.html"]
    while waiting:
        name = waiting.pop()
        loaded.add(name)
        named = re.findall(r'(?:href|src|from) ?=? ?"(?:\./)?([\w-]+\.(?:css|js))"', files[name][1].decode())
        waiting += [one for one in named if one not in loaded]
    assert {"main.js", "scene.js", "page.css", "weave.css"} <= loaded
    assert sum(len(files[name][1]) for name in loaded) < 250_000


def test_scenes_of_the_folder_and_those_with_nuno_are_listed(desk: Desk) -> None:
    Path("notes.yaml").write_text("a: 1\n")
    Path("broken.yaml").write_text("nuno: 1\nname: [\n")
    found = {one["name"]: one for one in ask(desk, "scenes")["scenes"]}
    assert found[FILE] == {
        "name": FILE, "own": True, "scene": "sheet", "description": "A small sheet falls.", "picture": None,
        "drawn": False
    }  # fmt: skip
    assert "broken.yaml:3: not valid YAML" in found["broken.yaml"]["description"]
    assert found.keys() - {FILE, "broken.yaml"} == shipped.scenes().keys()
    for name in ("../sheet.yaml", "notes.yaml", "/etc/passwd", 5):
        with pytest.raises(BadInput, match="no such scene"):
            ask(desk, "open", scene=name)


@pytest.mark.parametrize("odd", [[], {}, [[]], 3, None, True, "x" * 5000], ids=lambda odd: str(odd)[:9])
def test_a_request_of_another_kind_is_refused_in_words(desk: Desk, odd: object) -> None:
    Path("a.npz").write_bytes((shipped.folder() / "pendulum.npz").read_bytes())
    for request in (
        {"do": "open", "scene": odd}, {"do": "check", "scene": odd, "text": SHEET},
        {"do": "run", "scene": odd, "text": ""}, {"do": "make", "file": "a.npz", "offer": odd},
        {"do": "about", "file": odd}, {"do": "replay", "recording": odd}, {"do": "plots", "film": odd},
        {"do": "worn", "start": odd}, {"do": odd},
    ):  # fmt: skip
        with pytest.raises(BadInput):
            desk.act(request)


def test_mistakes_that_stand_side_by_side_are_told_together(desk: Desk) -> None:
    text = SHEET.replace("damping: 0.5", "damping: -1").replace("fabric: silk", "fabric: sillk")
    found = about(desk, "check", text.replace("dt: auto", "dt: never"))
    assert {(one["field"], one["line"]) for one in found["mistakes"]} == {
        ("damping", 8), ("objects[0].model.fabric", 12), ("solver.dt", 7)
    }  # fmt: skip
    assert about(desk, "check")["mistakes"] == []


def test_a_plan_has_the_rows_of_the_command_line(desk: Desk) -> None:
    rows = [row for row in about(desk, "plan")["rows"] if row[0] != "time"]  # which is measured
    assert rows == [row for row in describe(scene_file.read(Path(FILE))) if row[0] != "time"] and len(rows) > 5
    with pytest.raises(BadInput) as refused:
        about(desk, "plan", SHEET.replace("silk", "sillk"))
    assert refused.value.line == 12


def test_a_scene_is_saved_in_the_folder_and_nowhere_else(desk: Desk) -> None:
    text = SHEET.replace("0.5", "0.7")
    for name in ("../up.yaml", "/tmp/up.yaml", "sheet.txt", ".yaml", "a b.yaml", "", None):
        with pytest.raises(BadInput, match="not the name"):
            about(desk, "save", text, before=SHEET, name=name)
    Path("other.yaml").write_text("nuno: 1\n")
    with pytest.raises(BadInput, match="is there already"):
        about(desk, "save", text, before=SHEET, name="other.yaml")
    with pytest.raises(BadInput, match="changed since"):
        about(desk, "save", text, before="nuno: 1\n", name=FILE)
    assert Path(FILE).read_text() == SHEET and Path("other.yaml").read_text() == "nuno: 1\n"
    about(desk, "save", text, before=SHEET, name=FILE)
    about(desk, "save", text, before=SHEET, name="new.yaml")
    assert Path(FILE).read_text() == text
    own = "my skirt (1).yaml"
    Path(own).write_text(SHEET)
    ask(desk, "save", scene=own, text=text, before=SHEET, name=own)
    assert Path(own).read_text() == text


def test_a_copy_has_its_own_name_unless_the_text_has_another(desk: Desk) -> None:
    for name, file, scene in (
        ("new", "new.yaml", "new"), ("new-2.yml", "new-2.yml", "new-2"), ("2.b.yaml", "2.b.yaml", "scene-2-b"),
        (f"{'x' * 90}.yaml", f"{'x' * 90}.yaml", "x" * 64),
    ):  # fmt: skip
        about(desk, "save", SHEET, before=SHEET, name=name)
        assert Path(file).read_text() == SHEET.replace("name: sheet", f"name: {scene}")
        assert scene_file.read(Path(file)).scene.name == scene
    mine = SHEET.replace("name: sheet", "name: mine")
    about(desk, "save", mine, before=SHEET, name="theirs")
    assert Path("theirs.yaml").read_text() == mine
    about(desk, "save", SHEET, before="nam: [", name="mended")
    assert Path("mended.yaml").read_text() == SHEET


@pytest.mark.full
def test_a_run_has_the_same_bits_as_from_the_command_line_and_is_of_the_text(desk: Desk) -> None:
    text = SHEET.replace("0.5     # air", "0.9")
    now = run_to_end(desk, text)
    assert (now["state"], now["frame"], now["frames"]) == ("over", 20, 20)
    with nuno.open(Path("recordings") / now["recording"]) as recording:
        digests = [frame.digest for frame in recording.frames()]
        rows = recording.report()
    alone = nuno.run(FILE, damping=0.9)
    assert len(digests) == 21 and digests[-1] == alone.digest != nuno.run(FILE).digest
    found = ask(desk, "recording", recording=now["recording"])
    assert dict(found["rows"])["digest"] == alone.digest and rows["digest"] == alone.digest
    assert Path(FILE).read_text() == SHEET


def test_a_run_is_stepped_paused_and_stopped(desk: Desk) -> None:
    text = SHEET.replace("0.4 s", "400 s")
    about(desk, "run", text, paused=True)
    wait_until(lambda: ask(desk, "now")["state"] == "paused", PATIENCE)
    with pytest.raises(BadInput, match="goes on already"):
        about(desk, "run", text)
    first = ask(desk, "now")["frame"]
    ask(desk, "control", action="step")
    wait_until(lambda: ask(desk, "now")["frame"] == first + 1 and ask(desk, "now")["state"] == "paused")
    ask(desk, "control", action="resume")
    wait_until(lambda: ask(desk, "now")["frame"] > first + 20 and ask(desk, "now")["factor"])
    name = ask(desk, "now")["recording"]
    with pytest.raises(BadInput, match="its run goes on"):
        ask(desk, "delete", recording=f"{name}.part")
    assert [one["state"] for one in ask(desk, "recordings")["recordings"]] == ["not finished"]
    assert ask(desk, "control", action="stop")["state"] in ("ending", "over")  # its recording is whole only then
    wait_until(lambda: ask(desk, "now")["state"] == "over")
    (only,) = ask(desk, "recordings")["recordings"]
    assert (only["name"], only["scene"], only["state"]) == (name, "sheet", "stopped")
    with pytest.raises(BadInput, match="no run goes on"):
        ask(desk, "control", action="pause")


def test_what_ends_a_run_before_it_begins_is_told(desk: Desk) -> None:
    now = run_to_end(desk, SHEET.replace("dt: auto", "dt: 20 ms"))
    assert now["state"] == "refused" and "stab" in now["said"] and not list(Path("recordings").glob("*.mcap*"))


def test_what_lies_beside_stays_while_another_recording_of_its_run_is_there(desk: Desk) -> None:
    folder = Path("recordings")
    folder.mkdir()
    for name in ("a.mcap", "a.mcap.part", "a.png"):
        (folder / name).write_bytes(b"")
    ask(desk, "delete", recording="a.mcap.part")
    assert sorted(path.name for path in folder.iterdir()) == ["a.mcap", "a.png"]
    ask(desk, "delete", recording="a.mcap")
    assert not list(folder.iterdir())


@pytest.mark.full
def test_a_recording_is_verified_and_deleted_with_what_lies_beside(desk: Desk) -> None:
    name = run_to_end(desk)["recording"]
    path, other = Path("recordings") / name, Path("recordings/other.mcap")
    other.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    part_of(Path("recordings/cut.mcap")).write_bytes(b"")
    assert {one["name"]: one["state"] for one in ask(desk, "recordings")["recordings"]} == {
        name: "done", "other.mcap": "unknown", "cut.mcap.part": "not finished"
    }  # fmt: skip
    assert ask(desk, "recording", recording="other.mcap")["lacks"].startswith("INCOMPLETE")
    ask(desk, "verify", recording=name)
    wait_until(lambda: not ask(desk, "verdict", recording=name)["verifying"], PATIENCE)
    verdict = ask(desk, "verdict", recording=name)
    assert verdict["equal"] and verdict["words"].endswith("equal to the last bit: 21 frames")
    wait_until(lambda: not ask(desk, "picture", recording=name)["drawing"], PATIENCE)
    assert {one["name"]: one["picture"] for one in ask(desk, "scenes")["scenes"]}[FILE] == name
    for wrong in ("../sheet.yaml", FILE, f"../recordings/{name}", "", None):
        with pytest.raises(BadInput, match="no such recording"):
            ask(desk, "delete", recording=wrong)
    ask(desk, "delete", recording=name)
    assert sorted(path.name for path in Path("recordings").iterdir()) == ["cut.mcap.part", "other.mcap"]
