"""A dyed object wears the picture of its cloth: in pictures, mesh files and the viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dye_scene import CELL, arrays
from garment_scene import scene as garment
from garment_scene import write
from numpy.typing import NDArray
from PIL import Image

import nuno
from nuno.cli import main
from nuno.dye.painter import DyePainter
from nuno.exports.cloth import read_pieces
from nuno.exports.dyed_pictures import Changes, read_dyed_object
from nuno.exports.pictures import Painter
from nuno.scene import scene_file
from nuno_schemas.messages import CLOTH, CONCENTRATION, STATE

NY, NX = 9, 11
VIEW = {"azimuth": 0, "elevation": 0, "target": [0, 0, 0], "distance": 1.2}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with run.mcap and run.rrd, of a garment that is dyed."""
    folder = tmp_path_factory.mktemp("garment")
    corner = {"kind": "bath", "region": {"shape": "rectangle", "low": [0, 0], "high": [5 * CELL, 4 * CELL]}}
    cloth = garment()["dye"]["cloth"] | {"supply": [corner]}
    scene = write(folder, view=VIEW, bodies=[], dye={"dyes": _dyes(), "cloth": cloth})
    data = arrays()
    data["phi"], data["resist"] = np.zeros_like(data["phi"]), np.zeros_like(data["resist"])
    np.savez(folder / "cells.npz", allow_pickle=False, **data)
    assert main(["run", str(scene), "--record", str(folder / "run.mcap"), "--save", str(folder / "run.rrd")]) == 0
    return folder


def _dyes() -> list[dict[str, Any]]:
    """Red, which nothing else in a picture is."""
    colour = {"light": "#ffffff", "mid": "#ff4040", "dark": "#c00000", "full": 0.3}
    law = {"plugin": "langmuir", "K": 2.0}
    return [{"name": "red", "D0": "1.93 mm^2/h", "adsorption": 0.5, "isotherm": law, "colour": colour}]


def drawn(run: Path, scale: int, view: str = "all") -> list[NDArray[np.uint8]]:
    """Every frame's amounts, drawn by themselves."""
    painter = DyePainter(
        scene_file.read(run / "scene.yaml", (f"dye.picture.view={view}", f"dye.picture.scale={scale}"))
    )
    with nuno.open(run / "run.mcap") as recording:
        cloth = recording.last(CLOTH.name)
        assert cloth is not None
        painter.take_cloth(cloth.payload)
        return [painter.draw(message.payload) for message in recording.messages([CONCENTRATION.name])]


def test_its_texture_is_the_picture_of_that_time(run: Path) -> None:
    pictures = drawn(run, 7, "fixed")
    with nuno.open(run / "run.mcap") as recording:
        dyed = read_dyed_object(recording, Changes(view="fixed", scale=7))
        assert dyed is not None and dyed.name == "sheet"
        for frame in (10, 0, 5, 5):
            other, sheet = dyed.dress(read_pieces(recording), frame / 50)
            assert other.name == "other" and other.image is None
            assert sheet.image is not None and np.array_equal(sheet.image, pictures[frame])
        between = dyed.texture(5.5 / 50)
        assert between is not None and np.array_equal(between, pictures[5])
    assert not np.array_equal(pictures[0], pictures[10])


def test_pictures_show_it_upright(run: Path) -> None:
    """The upper left corner was given dye, which has spread a little: the sheet is red there. A picture of the stretch
    shows no dye: of another colour it is the same.
    """
    with nuno.open(run / "run.mcap") as recording:
        frames = list(recording.frames())
        painter = Painter(recording, [frames[0]], (300, 300))
        assert painter.legend is None, "the other sheet has a colour of its own"
        picture = painter.draw(frames[1]).astype(int)
        stretched = [
            Painter(recording, [frames[0]], (300, 300), colour="stretch", changes=changes).draw(frames[1])
            for changes in (None, Changes(overrides=("dye.dyes.0.colour.dark='#0000c0'",)))
        ]
    red = (picture[..., 0] - picture[..., 1] > 60) & (picture[..., 0] - picture[..., 2] > 60)
    assert red.sum() > 500
    rows, columns = np.nonzero(red)
    assert rows.mean() < 135 and columns.mean() < 135 and min(rows.min(), columns.min()) > 60
    assert np.array_equal(*stretched)


def test_the_command_line_changes_how_it_is_drawn(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def export(*arguments: str) -> NDArray[np.uint8]:
        target = run / "out.png"
        assert main(["export", str(run / "run.mcap"), "--png", str(target), "--size", "200x200", *arguments]) == 0
        with Image.open(target) as image:
            return np.asarray(image)

    usual = export()
    assert not np.array_equal(export("--view", "fixed"), usual)
    assert not np.array_equal(export("--set", "dye.dyes.0.colour.dark='#0000c0'"), usual)
    assert not np.array_equal(export("--frame", "0"), usual)
    assert main(["export", str(run / "run.mcap"), "--png", str(run / "a.png"), "--crop", "0", "0", "1", "1"]) == 2
    assert "--crop: " in capsys.readouterr().err
    assert main(["export", str(run / "run.mcap"), "--gif", str(run / "a.gif"), "--size", "64x48"]) == 0


def test_a_gltf_file_holds_that_frame_s_texture(run: Path) -> None:
    import trimesh

    with nuno.open(run / "run.mcap") as recording:
        dyed = read_dyed_object(recording)
        assert dyed is not None
        for frame in (0, 10):
            target = run / "out.glb"
            assert main(["export", str(run / "run.mcap"), "--glb", str(target), "--frame", str(frame)]) == 0
            mesh = trimesh.load(target).geometry["sheet"]  # type: ignore[union-attr]
            found = np.asarray(mesh.visual.material.baseColorTexture.convert("RGB"))
            assert np.array_equal(found, dyed.texture(frame / 50))
    folder = run / "frames"
    assert main(["export", str(run / "run.mcap"), "--glb", str(folder)]) == 0
    assert len(list(folder.glob("*.glb"))) == 11


def test_the_viewer_s_file_has_its_textures_and_curves(run: Path) -> None:
    from rrd import curves, read

    from nuno.viewer.dyed import TEXTURE_PIXELS

    found = read(run / "run.rrd", "/world/cloth/sheet", "Mesh3D:albedo_texture_buffer")
    assert sorted(found) == list(range(11))
    formats = read(run / "run.rrd", "/world/cloth/sheet", "Mesh3D:albedo_texture_format")
    scale = formats[0][0]["width"] // NX
    assert scale * scale * NX * NY <= TEXTURE_PIXELS
    for frame, picture in enumerate(drawn(run, scale)):
        assert np.array_equal(np.asarray(found[frame][0], np.uint8).reshape(picture.shape), picture)
    assert read(run / "run.rrd", "/world/cloth/other", "Mesh3D:albedo_texture_buffer") == {}
    assert {
        len(values) for plot in ("dye/red", "energy") for values in curves(run / "run.rrd", f"/plots/{plot}").values()
    } == {11}
    about = str(read(run / "run.rrd", "/about", "TextDocument:text", static=True)[0])
    assert "a second here is 1 h of dyeing" in about
    again = run / "again.rrd"
    assert main(["export", str(run / "run.mcap"), "--rrd", str(again)]) == 0
    assert read(again, "/world/cloth/sheet", "Mesh3D:albedo_texture_buffer") == found


def test_a_texture_that_comes_before_its_object_is_worn(run: Path, tmp_path: Path) -> None:
    """zenoh keeps no order between topics."""
    from rrd import read

    from nuno.viewer.dyed import viewer_painter
    from nuno.viewer.file import RerunFile
    from nuno.viewer.stream import Subject

    file = RerunFile(
        tmp_path / "a.rrd", Subject(run="run"), painter=viewer_painter(scene_file.read(run / "scene.yaml"))
    )
    with nuno.open(run / "run.mcap") as recording:
        for topic in (CLOTH.name, CONCENTRATION.name, "sim/fabric", STATE.name):
            message = recording.last(topic)
            assert message is not None
            file.feed(topic, 0, 0.0, message.payload)
    file.finish()
    assert list(read(tmp_path / "a.rrd", "/world/cloth/sheet", "Mesh3D:albedo_texture_buffer")) == [0]
