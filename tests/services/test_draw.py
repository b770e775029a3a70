"""Lines drawn by hand: who may ask the page's server, what it refuses, and what becomes of a scene's text and run."""

from __future__ import annotations

import http.client
import json
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from draw_desk import FILE, SHEET, draw, keep, see, write_sheet
from live_run import PATIENCE, wait_until
from studio_desk import studio

import nuno
from nuno.cli.studio import open_desk
from nuno.recording.reader import control_events
from nuno.scene import scene_file, shipped, yaml_lines
from nuno.simulation.cloth import Piece
from nuno.studio.desk import Desk
from nuno.studio.draw import by_object, positions, read_strokes
from nuno.studio.live_view import Sight
from nuno.studio.scenes import append_items
from nuno.studio.server import MOST_BYTES, Server
from nuno_schemas.errors import BadInput

ITEM = {"plugin": "wrinkle", "object": "cloth", "lines": [{"on_faces": [{"face": 1, "at": [0.5, 0.5, 0]}]}]}
LINE = {"points": [[20, 0.2, 0.3], [100, 0.3, 0.3]], "height": 0.02}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(write_sheet(tmp_path_factory.mktemp("sheet")).parent)
        with studio() as (_, one):
            yield one


@pytest.fixture(autouse=True)
def sheet(desk: Desk) -> None:
    """To be drawn on, in the desk's folder."""
    write_sheet(Path())


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
    connection = http.client.HTTPConnection("127.0.0.1", guard.port, timeout=60)
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
        (400, {"path": "start?number=x"}),
        (404, {"path": "../desk.py"}),
        (404, {"path": "other", "body": "{}"}),
        (200, {"path": ""}),
        (200, {"path": "main.js"}),
        (200, {"path": "do", "body": '{"do": "now"}'}),
    ],
)
def test_only_the_page_that_was_opened_is_answered(server: Server, status: int, request_: dict[str, Any]) -> None:
    answer = ask(server, **request_)
    assert answer.status == status
    assert "default-src 'none'" in (answer.getheader("Content-Security-Policy") or "")
    assert answer.getheader("Access-Control-Allow-Origin") is None
    if status != 200:
        assert answer.read().startswith(str(status).encode())


def test_it_listens_on_loopback_only_and_each_has_its_own_token(server: Server) -> None:
    assert server.server_address[0] == "127.0.0.1"
    with studio() as (_, other):
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
    start = do(server, "see", scene=FILE, text=SHEET)["number"]
    answer = do(server, "draw", does="export", start=start, lines=[LINE, line])
    assert not answer["ok"] and problem in answer["problem"] and answer["field"].startswith("lines[1]")
    assert answer["remedy"]


def test_what_needs_a_start_or_a_run_is_refused_without_one(server: Server) -> None:
    for does in ("begin", "check", "keep", "export"):
        for start in (0, -1, "1", None, [1]):
            answer = do(server, "draw", does=does, start=start, lines=[LINE], scene=FILE, text=SHEET)
            assert (answer["ok"], answer["field"]) == (False, "start") and answer["remedy"]
    assert "Run" in do(server, "draw", does="apply", lines=[LINE])["remedy"]
    assert not do(server, "draw", does="dance")["ok"]


TEXTS = [
    SHEET,
    "nuno: 1\noperations:   # mine\n  - {a: 1}   # one\n  - x: a\n    text: |\n      b\n\n      c\n# after\nname: x\n",
    "nuno: 1\noperations:\n- a: [1,\n    2]   # c\n- b\nname: y",
    "nuno: 1\noperations:\nname: z\n",
    "nuno: 1\ndescription: >\n  folded\n  text\n\n\n# c\n",
    "---\nnuno: 1\nname: x\n...\n",
    "nuno: 1\r\nname: x # c\r\n",
    "nuno: 1\noperations: [{a: 1}]   # c\n",
    "{nuno: 1, name: x}\n",
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
    ["nuno: 1\noperations: 5\n", "nuno: 1\noperations: &a\n- 1\nname: *a\n", "- 1\n"],
)
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


def operations(text: str) -> list[dict[str, Any]]:
    return list(yaml_lines.parse(text, FILE)[0]["operations"])


def test_lines_behind_others_are_added_by_places_that_triangles_do_not_matter_for(desk: Desk) -> None:
    start = see(desk)
    once = keep(desk, start, [LINE])
    (operation,) = operations(once)
    twice = keep(desk, see(desk, once), [LINE | {"height": 0.03}], once + "# mine")
    first, second = operations(twice)
    assert first == operation and twice.endswith("# mine") and second["lines"][0]["height"] == 0.03
    sight = desk._starts.kept[start].sight
    assert np.allclose(second["lines"][0]["points"], positions(read_strokes([LINE], sight)[0], sight), atol=1e-6)


def test_a_file_and_a_shipped_scene_stay_as_they_are_until_they_are_saved(desk: Desk, tmp_path: Path) -> None:
    text = shipped.find("hung-cloth-wrinkle").read_text()
    start = see(desk, text, "hung-cloth-wrinkle")
    after = keep(desk, start, [LINE], text, "hung-cloth-wrinkle")
    saved = desk.act({"do": "save", "scene": "hung-cloth-wrinkle", "text": after, "before": text, "name": "drawn.yaml"})
    assert saved["name"] == "drawn.yaml" and scene_file.read(tmp_path / "drawn.yaml").scene.operations
    assert shipped.find("hung-cloth-wrinkle").read_text() == text
    keep(desk, see(desk), [LINE])
    assert Path(FILE).read_text() == SHEET


def test_cloth_that_lines_cannot_be_raised_on_is_refused_before_anything_is_drawn(desk: Desk) -> None:
    found = draw(desk, "begin", start=see(desk))
    assert not found["needs_width"] and found["edge"] == pytest.approx((2.0 + np.sqrt(2.0)) / 36.0)
    quads = SHEET.replace("cells: triangles, ", "")
    assert draw(desk, "begin", start=see(desk, quads))["needs_width"]
    bare = quads.replace("fabric: denim", "fabric: {density: 0.2, structural: 20}")
    with pytest.raises(BadInput, match="edge of its triangles") as refused:
        draw(desk, "begin", start=see(desk, bare))
    assert refused.value.field == "objects[0].model" and refused.value.remedy
    Path(FILE).write_text(bare)
    with pytest.raises(BadInput, match="edge of its triangles"):
        open_desk(Namespace(scene=FILE, overrides=[], root=[], config=None))


def test_lines_that_could_not_be_raised_do_not_go_into_the_text(desk: Desk) -> None:
    quads = "  - {name: plain, model: {plugin: sheet, resolution: [5, 5], fabric: denim}}\n# the end"
    two = SHEET.replace("# the end", quads)
    line = LINE | {"points": [[288, 0.2, 0.3], [290, 0.3, 0.3]]}
    with pytest.raises(BadInput, match="no spring along an edge"):
        keep(desk, see(desk, two), [line], two)


def test_lines_with_a_width_are_numbered_by_object_behind_those_of_the_text(desk: Desk) -> None:
    wide = LINE | {"width": 0.5}
    quads = SHEET.replace("cells: triangles, ", "")
    start = see(desk, quads)
    draw(desk, "check", start=start, lines=[wide])
    settings = {"passes": 3, "keep": True}
    first = draw(desk, "keep", start=start, lines=[wide, wide], text=quads, scene=FILE, settings=settings)
    assert first["numbers"] == [("cloth", 1), ("cloth", 2)]
    (operation,) = operations(first["text"])
    assert operation["keep"] is True and "smoothing" not in operation and operation["lines"][0]["width"] == 0.5
    again = see(desk, first["text"])
    second = draw(desk, "keep", start=again, lines=[wide], text=first["text"], scene=FILE)
    assert second["numbers"] == [("cloth", 3)]
    for lines, field in (([wide, LINE], "lines[1].width"), ([wide | {"width": 0.2}], "lines[0]")):
        with pytest.raises(BadInput) as refused:
            draw(desk, "check", start=start, lines=lines)
        assert refused.value.field == field and refused.value.remedy
    with pytest.raises(BadInput, match="no run goes on"):
        draw(desk, "take_back", object="cloth", number=1)


@pytest.mark.full
def test_lines_of_a_run_are_taken_back_by_their_numbers(desk: Desk) -> None:
    wide = LINE | {"width": 0.5}
    text = keep(desk, see(desk), [wide])
    desk.act({"do": "run", "scene": FILE, "text": text, "paused": True})
    wait_until(lambda: desk.act({"do": "now"})["state"] == "paused", PATIENCE)
    own = desk._own
    assert own is not None and own.live is not None
    desk.act({"do": "control", "action": "step"})
    desk._live({"run": [own.name]})
    board = own.live.board
    wait_until(lambda: len(board.now.x) > 0 and desk.act({"do": "now"})["state"] == "paused")
    found = draw(desk, "apply", run=own.name, shape=board.now.shape, lines=[wide, wide])
    assert (found["applied"], found["numbers"]) == ([0, 1], [("cloth", 2), ("cloth", 3)])
    for number in (1, 3):
        draw(desk, "take_back", object="cloth", number=number)
    for number in (1, 4, "x"):
        with pytest.raises(BadInput):
            draw(desk, "take_back", object="cloth", number=number)
    desk.act({"do": "control", "action": "stop"})
    wait_until(lambda: desk.act({"do": "now"})["state"] == "over", PATIENCE)
    with nuno.open("last") as one:
        assert [event.text for event in control_events(one)].count("add") == 3


def test_lines_on_other_triangles_than_the_texts_do_not_go_into_it(desk: Desk) -> None:
    with pytest.raises(BadInput, match="other triangles"):
        keep(desk, see(desk), [LINE], SHEET.replace("[13, 13]", "[14, 14]"))


def test_a_scene_is_opened_with_its_changes_in_the_text(desk: Desk, tmp_path: Path) -> None:
    elsewhere = tmp_path / "other"
    elsewhere.mkdir()
    path = write_sheet(elsewhere)
    Path(FILE).unlink()
    opened, place = open_desk(Namespace(scene=str(path), overrides=["damping=0.7"], root=[], config=None))
    assert place == f"#draw={FILE}"
    found = opened.act({"do": "open", "scene": FILE})
    assert found["text"] == SHEET and found["changed"] == SHEET.replace("damping: 2", "damping: 0.7") and found["own"]
    opened.act({"do": "save", "scene": FILE, "text": found["changed"], "before": SHEET, "name": FILE})
    assert path.read_text() == found["changed"] and not Path(FILE).exists()


@pytest.mark.full
def test_a_run_has_lines_from_its_first_frame_and_takes_more_by_its_present_triangles(desk: Desk) -> None:
    start = see(desk)
    plain = desk._starts.kept[start].sight
    text = keep(desk, start, [LINE])
    desk.act({"do": "run", "scene": FILE, "text": text, "paused": True})
    wait_until(lambda: desk.act({"do": "now"})["state"] == "paused", PATIENCE)
    own = desk._own
    assert own is not None and own.live is not None
    desk.act({"do": "control", "action": "step"})
    asked = {"run": [own.name]}
    desk._live(asked)
    sight = own.live.board
    wait_until(lambda: len(sight.now.x) > len(plain.x) and desk.act({"do": "now"})["state"] == "paused")
    with pytest.raises(BadInput) as refused:
        draw(desk, "apply", run=own.name, shape=sight.now.shape + 1, lines=[LINE])
    assert refused.value.field == "shape"
    before = sight.now
    line = LINE | {"points": [[150, 0.2, 0.3], [200, 0.3, 0.3]]}
    assert draw(desk, "apply", run=own.name, shape=before.shape, lines=[line])["applied"] == [0]
    assert len(sight.now.x) > len(before.x) and sight.now.shape > before.shape
    desk.act({"do": "control", "action": "stop"})
    wait_until(lambda: desk.act({"do": "now"})["state"] == "over", PATIENCE)
    with nuno.open("last") as one:
        assert [event.text for event in control_events(one)][-2:] == ["add", "stop"]
        assert len(list(one.frames())[1].x) == len(before.x)
