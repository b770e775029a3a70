"""`nuno export --colour`: cloth in its own texture or colour, or by its stretch, whatever the scene says."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from recorded_sheet import Sheet, write

from nuno.cli import main
from nuno.exports.animations import export_animation
from nuno.exports.cloth import ShownPiece
from nuno.exports.paint import CLOTHS, PLAIN, paint_stretch
from nuno.exports.pictures import Colour, Painter, _cloth_mesh
from nuno.recording.reader import open_recording
from nuno_schemas.colour import parse_hex
from nuno_schemas.errors import BadInput

SIZE = (96, 64)


def painted(path: Path, colour: Colour) -> tuple[Painter, np.ndarray | None, bool]:
    """The painter, the colours of the cloth's vertices, and whether it shows an image."""
    with open_recording(path) as recording:
        frames = list(recording.frames())
        painter = Painter(recording, frames[-1:], SIZE, colour=colour)
        mesh = painter.meshes(frames[-1])[0]
    return painter, mesh.colours, mesh.image is not None


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plain") / "run.mcap"
    write(path, Sheet(), 3)
    return path


@pytest.fixture(scope="module")
def by_stretch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same of a scene that shows stretch."""
    path = tmp_path_factory.mktemp("stretch") / "run.mcap"
    write(path, Sheet(), 3, scene={"name": "waving", "view": {"colour": "stretch"}})
    return path


@pytest.fixture(scope="module")
def textured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("textured")
    data = io.BytesIO()
    Image.new("RGB", (4, 4), "#208040").save(data, "PNG")
    write(folder / "run.mcap", Sheet(), 3, {"check.png": data.getvalue()}, texture="check.png")
    return folder / "run.mcap"


def test_cloth_without_a_colour_has_one_by_its_place_or_shows_its_stretch(plain: Path, by_stretch: Path) -> None:
    with open_recording(plain) as recording:
        last = list(recording.frames())[-1]
        piece = Painter(recording, [last], SIZE).pieces(last.t)[0]
    stretch = paint_stretch(piece.stretch(last.x))
    for path, colour in ((by_stretch, "auto"), (by_stretch, "stretch"), (plain, "stretch")):
        painter, colours, _ = painted(path, colour)  # type: ignore[arg-type]
        assert colours is not None and np.array_equal(colours, stretch)
        assert painter.legend is not None
    for path, colour, own in ((plain, "auto", CLOTHS[0]), (plain, "cloth", CLOTHS[0]), (by_stretch, "cloth", PLAIN)):
        painter, colours, _ = painted(path, colour)  # type: ignore[arg-type]
        assert colours is not None and np.array_equal(colours, np.tile(parse_hex(own), (piece.stop, 1)))
        assert painter.legend is None


def test_links_of_a_net_show_their_own_stretch() -> None:
    edges, x = np.array([[0, 1], [1, 2]], np.int32), np.array([[0.0, 0.0, 0.0], [1.01, 0.0, 0.0], [2.51, 0.0, 0.0]])
    net = ShownPiece("net", 0, 3, np.zeros((0, 3), np.int32), edges, np.ones(2), None, None, None)
    colours = _cloth_mesh(net, x).colours
    assert colours is not None
    assert np.allclose(colours.reshape(2, -1, 3), paint_stretch(np.array([0.01, 0.5]))[:, None], rtol=1e-12)


def test_cloth_with_a_texture_can_show_its_stretch(textured: Path) -> None:
    for colour in ("auto", "cloth"):
        painter, colours, image = painted(textured, colour)  # type: ignore[arg-type]
        assert image and colours is None and painter.legend is None
    painter, colours, image = painted(textured, "stretch")
    assert not image and colours is not None and painter.legend is not None


def test_the_command_passes_it_on_to_pictures_and_animations(plain: Path, tmp_path: Path) -> None:
    shown = {}
    for colour in ("auto", "cloth", "stretch"):
        png, gif = tmp_path / f"{colour}.png", tmp_path / f"{colour}.gif"
        asked = ["export", str(plain), "--png", str(png), "--gif", str(gif), "--size", "96x64", "--colour", colour]
        assert main(asked) == 0
        shown[colour] = png.read_bytes(), gif.read_bytes()
    assert shown["auto"] == shown["cloth"]
    assert shown["auto"][0] != shown["stretch"][0]
    assert shown["auto"][1] != shown["stretch"][1]


def test_another_colour_is_refused_before_anything_is_written(
    plain: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", str(plain), "--png", str(tmp_path / "a.png"), "--colour", "red"]) == 2
    assert "auto" in capsys.readouterr().err
    with pytest.raises(BadInput, match="painted"):
        export_animation(plain, tmp_path / "a.gif", SIZE, colour="red")  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())
