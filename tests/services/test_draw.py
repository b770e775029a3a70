"""The server of the page for drawing: who may ask, what it refuses, and what becomes of a scene's file."""

from __future__ import annotations

import http.client
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draw_desk import SHEET, scene_desk, served, write_sheet
from live_run import wait_until

import nuno
from nuno.cloth.build import Piece
from nuno.draw import keep
from nuno.draw.append import append_items
from nuno.draw.lines import by_object, positions, read_strokes
from nuno.pages.guard import MOST_BYTES
from nuno.pages.server import Server
from nuno.recording.restore import control_events
from nuno.scene import scene_file, yaml_lines
from nuno.seen.sight import Sight
from nuno_schemas.errors import BadInput

ITEM = {"plugin": "wrinkle", "object": "cloth", "lines": [{"on_faces": [{"face": 1, "at": [0.5, 0.5, 0]}]}]}
LINE = {"points": [[20, 0.2, 0.3], [100, 0.3, 0.3]], "height": 0.02}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with served(scene_desk(write_sheet(tmp_path_factory.mktemp("sheet")))) as one:
        yield one


def ask(
    server: Server, path: str = "", body: str | None = None, token: str | None = None, **headers: str | None
) -> http.client.HTTPResponse:
    """An answer to what the page itself would ask, but for what is given."""
    guard = server.guard
    host = f"127.0.0.1:{guard.port}"
    given: dict[str, str | None] = {"Host": host}
    if body is not None:
        given |= {"Origin": f"http://{host}", "Content-Type": "application/json", "Content-Length": str(len(body))}
    given |= {name.replace("_", "-"): value for name, value in headers.items()}
    connection = http.client.HTTPConnection("127.0.0.1", guard.port, timeout=10)
    connection.putrequest("GET" if body is None else "POST", f"/{guard.token if token is None else token}/{path}", True)
    for name, value in given.items():
        if value is not None:
            connection.putheader(name, value)
    connection.endheaders((body or "").encode())
    return connection.getresponse()


def do(server: Server, action: str, **more: object) -> dict[str, Any]:
    answer = ask(server, "do", json.dumps({"do": action} | more))
    assert answer.status == 200
    return dict(json.loads(answer.read()))


@pytest.mark.parametrize(
    ("status", "request_"),
    [
        (403, {"token": ""}),
        (403, {"token": "A" * 32}),
        (403, {"token": "%C3%B6"}),
        (403, {"Host": "evil.example"}),
        (403, {"Host": None}),
        (403, {"Origin": "http://evil.example"}),
        (403, {"Origin": "null"}),
        (403, {"Sec_Fetch_Site": "cross-site"}),
        (403, {"path": "do", "body": "{}", "Origin": None}),
        (403, {"path": "do", "body": "{}", "Origin": "http://localhost:1"}),
        (413, {"path": "do", "body": "", "Content_Length": str(MOST_BYTES + 1)}),
        (411, {"path": "do", "body": "", "Content_Length": None}),
        (411, {"path": "do", "body": "", "Transfer_Encoding": "chunked"}),
        (415, {"path": "do", "body": "{}", "Content_Type": "text/plain"}),
        (400, {"path": "do", "body": "[" * 100_000}),
        (400, {"path": "frame?after=x"}),
        (404, {"path": "../desk.py"}),
        (404, {"path": "other", "body": "{}"}),
        (200, {"path": ""}),
        (200, {"path": "main.js"}),
        (200, {"path": "do", "body": '{"do": "about"}'}),
    ],
)
def test_only_the_page_that_was_opened_is_answered(server: Server, status: int, request_: dict[str, Any]) -> None:
    answer = ask(server, **request_)
    assert answer.status == status
    assert "default-src 'none'" in (answer.getheader("Content-Security-Policy") or "")
    assert answer.getheader("Access-Control-Allow-Origin") is None
    if status != 200:
        assert answer.read().startswith(str(status).encode())


def test_it_listens_on_loopback_only_and_each_has_its_own_token(server: Server, tmp_path: Path) -> None:
    assert server.server_address[0] == "127.0.0.1"
    with served(scene_desk(write_sheet(tmp_path))) as other:
        assert len(other.guard.token) >= 32 and other.guard.token != server.guard.token
        assert ask(other, token=server.guard.token).status == 403


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        (LINE | {"height": 0.0}, "height"),
        (LINE | {"height": "1"}, "no line"),
        (LINE | {"points": [[20, 0.2, 0.3]]}, "no line"),
        (LINE | {"points": [[20, 0.2, 0.3], [99999, 0.3, 0.3]]}, "off the cloth"),
        (LINE | {"points": [[20, 0.2, 0.3], [21, 0.9, 0.3]]}, "off the cloth"),
        (LINE | {"points": [[20, 0.2, 0.3], ["21", 0.1, 0.3]]}, "no line"),
        (5, "no line"),
    ],
)
def test_a_line_that_cannot_be_is_refused_by_its_number(server: Server, line: object, problem: str) -> None:
    answer = do(server, "export", shape=0, lines=[LINE, line])
    assert not answer["ok"] and problem in answer["problem"] and answer["field"].startswith("lines[1]")
    assert answer["remedy"]


def test_lines_about_other_triangles_are_refused(server: Server) -> None:
    answer = do(server, "export", shape=1, lines=[LINE])
    assert (answer["ok"], answer["field"]) == (False, "shape")


def test_what_needs_a_run_is_refused_without_one(server: Server) -> None:
    for action in ("apply", "pause", "step"):
        assert "Simulate" in do(server, action, lines=[LINE])["remedy"]
    assert not do(server, "dance")["ok"]


TEXTS = [
    SHEET,
    "nuno: 1\noperations:   # mine\n  - {a: 1}   # one\n  - x: a\n    text: |\n      b\n\n      c\n# after\nname: x\n",
    "nuno: 1\noperations:\n- a: [1,\n    2]   # c\n- b\nname: y",
    "nuno: 1\noperations:\nname: z\n",
    "nuno: 1\ndescription: >\n  folded\n  text\n\n\n# c\n",
    "---\nnuno: 1\nname: x\n...\n",
    "nuno: 1\r\nname: x # c\r\n",
]


@pytest.mark.parametrize("text", TEXTS)
def test_lines_are_added_and_all_else_stays_as_it_was_written(text: str) -> None:
    after = append_items(text, "operations", [ITEM, ITEM], "scene.yaml")
    before = yaml_lines.parse(text, "")[0]
    assert yaml_lines.parse(after, "")[0] == before | {"operations": [*(before.get("operations") or []), ITEM, ITEM]}
    # What was there is there still, character by character: only something was put in.
    rest = iter(after)
    assert all(letter in rest for letter in text)
    assert [row for row in text.splitlines() if "#" in row and row.split("#")[1] not in after] == []
    again = append_items(after, "operations", [ITEM], "scene.yaml")
    assert len(yaml_lines.parse(again, "")[0]["operations"]) == len(before.get("operations") or []) + 3


@pytest.mark.parametrize(
    "text",
    [
        "nuno: 1\noperations: 5\n", "nuno: 1\noperations: &a\n- 1\nname: *a\n", "- 1\n",
        "nuno: 1\noperations: [{a: 1}]\n", "{nuno: 1, name: x}\n",
    ],
)  # fmt: skip
def test_a_text_that_would_say_something_else_is_refused(text: str) -> None:
    with pytest.raises(BadInput) as refused:
        append_items(text, "operations", [ITEM], "scene.yaml")
    assert refused.value.remedy


def test_lines_are_given_by_their_objects_own_triangles() -> None:
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
    two = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    sight = Sight(
        np.concatenate([square, square + 5.0]), np.concatenate([two, two + 4]), (Piece("a", 0, 4), Piece("b", 4, 8))
    )
    lines = [
        {"points": [[0, 0.2, 0.3], [1, 0.3, 0.3]], "height": 0.01},
        {"points": [[3, 0.2, 0.3], [2, 0, 0]], "height": -0.01},
    ]
    found = by_object(read_strokes(lines, sight), sight)
    assert [[row["face"] for row in line["on_faces"]] for name in "ab" for line in found[name]] == [[0, 1], [1, 0]]
    assert found["b"][0]["on_faces"][0]["at"] == pytest.approx([0.5, 0.2, 0.3]) and found["b"][0]["height"] == -0.01
    ring = by_object(read_strokes([lines[0] | {"closed": True}], sight), sight)["a"][0]
    assert ring["closed"] is True and "closed" not in found["a"][0]
    exact = by_object(read_strokes(lines, sight), sight, exact=False)
    assert exact["b"][0]["points"] == [[5.2, 5.5, 5.0], [5.0, 5.0, 5.0]]
    with pytest.raises(BadInput, match="two pieces"):
        read_strokes([{"points": [[0, 0.2, 0.3], [3, 0.3, 0.3]], "height": 0.01}], sight)


def test_saving_again_takes_the_place_of_what_was_saved(tmp_path: Path) -> None:
    path = write_sheet(tmp_path)
    desk = scene_desk(path)
    save: dict[str, Any] = {"do": "save", "lines": [LINE]}
    desk.act(save)
    desk.act(save | {"lines": [LINE | {"height": 0.03}]})
    (operation,) = yaml_lines.parse(path.read_text(), "")[0]["operations"]
    assert [line["height"] for line in operation["lines"]] == [0.03]
    changed = path.read_text() + "# mine"
    path.write_text(changed)
    with pytest.raises(BadInput, match="changed after"):
        desk.act(save)
    assert path.read_text() == changed
    # A page that is opened on what is there now adds behind it, by places that its triangles do not matter for.
    again = scene_desk(path)
    again.act(save)
    first, second = yaml_lines.parse(path.read_text(), "")[0]["operations"]
    assert first == operation and path.read_text().endswith("# mine")
    assert np.allclose(
        second["lines"][0]["points"], positions(read_strokes([LINE], again.board.now)[0], again.board.now)
    )
    assert not list(tmp_path.glob(".*"))


def test_a_shipped_scene_stays_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = write_sheet(tmp_path)
    monkeypatch.setattr(keep.shipped, "scenes", lambda: {"sheet": path})
    for name in ("sheet-drawn.yaml", "sheet-drawn-2.yaml"):
        answer = scene_desk(path).act({"do": "save", "lines": [LINE]})
        assert Path(answer["file"]) == tmp_path / name and answer["text"].endswith(f"nuno run {name}")
        assert scene_file.read(tmp_path / name).scene.operations
    assert path.read_text() == SHEET


def test_cloth_that_lines_cannot_be_raised_on_is_refused_before_anything_is_drawn(tmp_path: Path) -> None:
    path = tmp_path / "quads.yaml"
    path.write_text(SHEET.replace("cells: triangles, ", ""))
    with pytest.raises(BadInput, match="edges of its triangles") as refused:
        scene_desk(path)
    assert refused.value.field == "objects[0].model" and "cells: triangles" in refused.value.remedy


def test_lines_that_could_not_be_raised_are_not_saved(tmp_path: Path) -> None:
    path = tmp_path / "two.yaml"
    quads = "  - {name: plain, model: {plugin: sheet, resolution: [5, 5], fabric: denim}}\n# the end"
    path.write_text(two := SHEET.replace("# the end", quads))
    desk = scene_desk(path)
    line = LINE | {"points": [[288, 0.2, 0.3], [290, 0.3, 0.3]]}
    with pytest.raises(BadInput, match="edge of its triangles"):
        desk.act({"do": "save", "lines": [line]})
    assert path.read_text() == two


@pytest.mark.full
def test_a_run_that_the_page_starts_waits_for_lines_and_takes_none_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    desk = scene_desk(write_sheet(tmp_path))
    start = desk.board.now
    desk.act({"do": "save", "lines": [LINE]})
    try:
        desk.act({"do": "start"})
        wait_until(lambda: desk.board.now.state == "paused", 120.0)
        assert desk.board.now.frame == 0 and np.array_equal(desk.board.now.faces, start.faces)
        assert desk.act({"do": "apply", "shape": desk.board.now.shape, "lines": [LINE]})["applied"] == [0]
        added = len(desk.board.now.x) - len(start.x)
        desk.act({"do": "step"})
        wait_until(lambda: desk.board.now.frame == 1)
        assert len(desk.board.now.x) - len(start.x) == added > 0
        desk.act({"do": "back"})
        assert desk.board.now.state == "start" and np.array_equal(desk.board.now.x, start.x)
    finally:
        desk.close()
    (recording,) = (tmp_path / "recordings").glob("*.mcap")
    with nuno.open(recording) as one:
        assert [event.text for event in control_events(one)] == ["add", "step", "stop"]


def test_lines_on_other_triangles_than_the_files_are_not_saved(tmp_path: Path) -> None:
    path = write_sheet(tmp_path)
    desk = scene_desk(path)
    path.write_text(changed := SHEET.replace("[13, 13]", "[14, 14]"))
    with pytest.raises(BadInput, match="other triangles"):
        desk.act({"do": "save", "lines": [LINE]})
    assert path.read_text() == changed
