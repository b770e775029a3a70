"""Files of a recording from buttons: each is what `nuno export` makes, and what cannot be is told in its words."""

from __future__ import annotations

import io
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from browser import Page
from live_run import PATIENCE, wait_until
from PIL import Image
from studio_desk import NEEDS_BROWSER, studio, write_sheet

import nuno
from nuno.studio.desk import KINDS, Desk
from nuno.studio.server import Refused
from nuno_schemas.errors import BadInput


@pytest.fixture
def recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    write_sheet(tmp_path)
    Path("recordings").mkdir()
    nuno.run("sheet.yaml", duration=0.1, record=Path("recordings/one.mcap"))
    return "one.mcap"


@pytest.fixture
def desk(recording: str) -> Iterator[Desk]:
    one = Desk()
    yield one
    one.close()


def export(desk: Desk, recording: str, kind: str, **more: object) -> dict[str, Any]:
    """What is told once it is made."""
    asked = {"do": "export", "recording": recording, "kind": kind}
    desk.act(asked | more)
    wait_until(lambda: not desk.act(asked)["making"], PATIENCE)
    return desk.act(asked)


def test_the_scene_of_a_recording_is_a_scene_again_and_runs_to_the_same_bits(recording: str) -> None:
    (path,) = nuno.export(Path("recordings") / recording, scene=Path("again.yaml"))
    with nuno.open(Path("recordings") / recording) as one:
        assert yaml.safe_load(path.read_text()) == one.scene
    assert nuno.run(path).digest == nuno.run("sheet.yaml", duration=0.1).digest


@pytest.mark.full
def test_a_table_and_the_scene_are_those_of_nuno_export(desk: Desk, recording: str) -> None:
    for kind in ("csv", "scene"):
        told = export(desk, recording, kind)
        content, data = desk.exports.file({"recording": [recording], "kind": [kind]})
        alone = Path(f"alone{KINDS[kind][0]}")
        nuno.export(Path("recordings") / recording, **{kind: alone})
        assert data == alone.read_bytes() and told["bytes"] == len(data) and content == KINDS[kind][1]
        assert told["name"] == f"one{KINDS[kind][0]}"


@pytest.mark.full
def test_pictures_animations_and_meshes_are_of_their_kinds_and_tell_how_far(desk: Desk, recording: str) -> None:
    heads = {"png": b"\x89PNG", "glb": b"glTF", "mp4": b"ftyp"}
    for kind, head in heads.items():
        told = export(desk, recording, kind)
        assert told["problem"] == ""
        data = desk.exports.file({"recording": [recording], "kind": [kind]})[1]
        assert head in data[:8]
        assert told["share"] == (1.0 if kind == "mp4" else None)
        if kind == "png":
            assert Image.open(io.BytesIO(data)).size[0] > 100


def test_of_a_recording_that_grows_one_file_of_a_kind_is_made_at_once(desk: Desk, recording: str) -> None:
    asked = {"do": "export", "recording": recording, "kind": "glb"}
    desk.act(asked)
    _, child = desk.exports._made[recording, "glb"]
    os.utime(Path("recordings") / recording)
    assert child.code is None and desk.act(asked)["making"]
    assert desk.exports._made[recording, "glb"][1] is child
    desk.act({"do": "delete", "recording": recording})
    assert child.code is not None and not desk.exports._made


def test_what_cannot_be_made_is_told_in_words(desk: Desk, recording: str) -> None:
    half = Path("recordings/half.mcap")
    half.write_bytes((Path("recordings") / recording).read_bytes()[:3000])
    told = export(desk, half.name, "csv")
    assert told["problem"] and not told["problem"].startswith("error:") and told["bytes"] is None
    with pytest.raises(Refused):
        desk.exports.file({"recording": [half.name], "kind": ["csv"]})
    for wrong in ("../sheet.yaml", "none.mcap", ""):
        with pytest.raises(BadInput, match="no such recording"):
            desk.act({"do": "export", "recording": wrong, "kind": "csv"})
    with pytest.raises(BadInput, match="no such file can be made"):
        desk.act({"do": "export", "recording": recording, "kind": "exe"})


@pytest.mark.full
@NEEDS_BROWSER
def test_a_button_saves_a_file(tmp_path_factory: pytest.TempPathFactory, recording: str) -> None:
    down = tmp_path_factory.mktemp("down")
    with Page(tmp_path_factory.mktemp("browser")) as page, studio() as (_, server):
        page.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(down))
        page.open(f"{server.guard.address}#run={recording}")
        page.wait("document.getElementById('export-csv') !== null")
        page.value("document.getElementById('export-csv').focus()")
        page.press("Enter")
        wait_until(lambda: any(path.stat().st_size for path in down.glob("one.csv")), PATIENCE)  # first it is empty
        assert (down / "one.csv").read_text().startswith("frame,")
        page.wait("document.querySelector('#exported a')?.textContent === 'one.csv'")
        page.tap("#export-scene")
        wait_until(lambda: any(path.stat().st_size for path in down.glob("one.yaml")), PATIENCE)  # first it is empty
        assert yaml.safe_load((down / "one.yaml").read_text())["name"] == "sheet"
        assert page.said == []
