"""Knits in recordings: kinds of yarn, their lengths, pictures in every style."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import nuno
from nuno.cli import main
from nuno.exports.cloth import PLAIN, SIDES, YARNS, paint_stretch, paint_yarns, read_frame, read_pieces, read_pressure
from nuno.exports.pictures import Painter
from nuno.exports.yarns import export_yarn_picture, find_camera, read_worn, styled
from nuno.recording.reader import Recording, open_recording
from nuno.scene import scene_file, shipped
from nuno.simulation import cloth
from nuno.simulation.yarns import edge_yarns
from nuno_schemas.colour import parse_hex
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Fabric

SCENE = "knit/stitch-10x10"


def fabric() -> Fabric:
    return cloth.build_fabric(scene_file.read(shipped.find(SCENE)))[0]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("knit") / "run.mcap"
    nuno.run(SCENE, "duration=0.3", record=path)
    return path


def test_every_edge_knows_its_yarn() -> None:
    """The soft one is the first, the stiff one the second."""
    net = fabric()
    assert net.springs is not None
    kinds = edge_yarns(net)
    assert kinds is not None
    assert np.array_equal(kinds, (net.springs.k == 10.0).astype(np.int8))


def test_pictures_show_kinds_of_yarn_or_stretch(recorded: Path) -> None:
    with open_recording(recorded) as recording:
        last = list(recording.frames())[-1]
        piece = read_pieces(recording)[0]
        assert piece.yarns is not None
        by_kind = Painter(recording, [last], (96, 64), colour="cloth")
        colours = by_kind.meshes(last)[0].colours
        assert colours is not None and by_kind.legend is None
        assert np.array_equal(colours, np.repeat(paint_yarns(piece.yarns), 2 * SIDES, axis=0))
        assert len(np.unique(colours, axis=0)) == 2
        by_stretch = Painter(recording, [last], (96, 64))
        shown = by_stretch.meshes(last)[0].colours
        assert shown is not None and by_stretch.legend is not None
        assert np.array_equal(shown, np.repeat(paint_stretch(piece.link_stretch(last.x)), 2 * SIDES, axis=0))


def test_kinds_beyond_the_colours_begin_again_and_none_is_plain() -> None:
    found = paint_yarns(np.array([0, len(YARNS), -1], np.int8))
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[2], parse_hex(PLAIN).reshape(3))


def test_a_report_has_the_yarns_lengths(recorded: Path) -> None:
    """9 courses of 5 wales: 4 links a wale less one, of 1 m; 5 heads and 4 sinkers are borrowed of their neighbours."""
    with open_recording(recorded) as recording:
        yarns = recording.report()["yarns"]
    assert yarns["nylon"] == {"length": 5 * 19.0 + 9.0, "longest": 19.0}
    assert yarns["support"] == {"length": 4 * 19.0, "longest": 19.0}


def test_yarns_keep_their_links_beside_other_cloth(tmp_path: Path) -> None:
    """A sheet between two knits: springs are numbered anew, names that they share stay one kind."""
    knit = "{plugin: knit, wales: 3, courses: 4, form: %s, yarns: %s}"
    objects = [
        ("low", knit % ("tube", "[nylon, support]")),
        ("sheet", "{plugin: sheet, resolution: [5, 4]}"),
        ("high", knit % ("panel", "[support, elastane]")),
    ]
    lines = ["nuno: 1", "name: three", "duration: 1 s", "objects:"]
    path = tmp_path / "three.yaml"
    path.write_text("\n".join([*lines, *(f"  - {{name: {name}, model: {model}}}" for name, model in objects)]))
    fabric, pieces = cloth.build_fabric(scene_file.read(path))
    assert fabric.yarns is not None and fabric.springs is not None
    assert fabric.yarns.names == ("nylon", "support", "elastane")
    neighbours, yarn = fabric.yarns.neighbours()
    pairs = fabric.springs.pairs()
    for first, second in neighbours.tolist():
        assert len({*pairs[first].tolist()} & {*pairs[second].tolist()}) == 1
    names = np.array(fabric.yarns.names)[fabric.yarns.kind[yarn]]
    high = pairs[neighbours[:, 0]].min(axis=1) >= pieces[2].start
    assert set(names[high]) == {"support", "elastane"} and set(names[~high]) == {"nylon", "support"}
    assert pairs[neighbours[~high]].max() < pieces[1].start


STYLED = """
nuno: 1
name: hose
duration: 10 ms
frame_rate: 100 Hz
solver: {plugin: symplectic_euler, dt: auto}
gravity: [0, 0, 0]
objects:
  - name: hose
    colour: "#2030a0"
    model: {plugin: knit, form: tube, wales: 20, courses: 12, spacing: [22 mm, 25 mm], stretch: [1.2, 1.0],
            yarns: [{name: nylon, k: 1 N/m}, {name: support, k: 10 N/m}], mass: 1 g,
            centre: [0, 0.5, 0]}
bodies:
  - name: leg
    collider: {plugin: mesh, shape: leg, resolution: 24}
contact: {plugin: sliding}
view: {size: [96, 128]%s}
"""
FAST = ("view.yarns.samples=4",)


def record(folder: Path, view: str = "") -> Path:
    scene = folder / "hose.yaml"
    scene.write_text(STYLED % view)
    nuno.run(scene, record=folder / "run.mcap")
    return folder / "run.mcap"


@pytest.fixture(scope="module")
def styled_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("hose"))


def draw(recording: Path, folder: Path, style: str | None, *overrides: str, **more: Any) -> np.ndarray:
    path = export_yarn_picture(recording, folder / "out.png", style, overrides=overrides or FAST, **more)
    return np.asarray(Image.open(path)).astype(int)


def blue(picture: np.ndarray) -> float:
    """Share of pixels that are blue, which neither skin nor floor is."""
    return float((picture[..., 2] - picture[..., 0] > 12).mean())


def test_yarns_take_their_objects_colour_unless_another_is_given(styled_recording: Path, tmp_path: Path) -> None:
    thick = (*FAST, "view.yarns.radius=3mm")
    own, other = (
        draw(styled_recording, tmp_path, "yarns", *thick, *more) for more in ((), ("view.yarns.colour=#a02030",))
    )
    assert own.shape == (128, 96, 3)
    assert blue(own) > 0.03 > 10 * blue(other)


def test_thicker_yarns_cover_more(styled_recording: Path, tmp_path: Path) -> None:
    shares = [blue(draw(styled_recording, tmp_path, "yarns", *FAST, f"view.yarns.radius={r}mm")) for r in (1, 2, 4)]
    assert shares[0] < shares[1] < shares[2]


def test_lines_and_density_are_drawn_and_other_styles_refused(styled_recording: Path, tmp_path: Path) -> None:
    lines, density = (draw(styled_recording, tmp_path, style) for style in ("lines", "density"))
    assert not np.array_equal(lines, density)
    # The colour bar and the surface are those of the map, from violet to yellow.
    assert ((density[..., 0] > 200) & (density[..., 2] < 90)).any()
    with pytest.raises(BadInput, match="no plugin 'linse'") as refused:
        draw(styled_recording, tmp_path, "linse")
    assert refused.value.field == "--style"


def test_a_scene_says_how_its_yarns_are_drawn(tmp_path: Path) -> None:
    path = record(tmp_path, ", yarns: {plugin: lines, width: 3, samples: 4}")
    with open_recording(path) as recording, styled(recording, None, ()) as (_, chosen):
        assert chosen.name == "lines" and chosen.config.width == 3.0
        with styled(recording, "lines", ("view.yarns.width=2",)) as (_, changed):
            assert changed.config.width == 2.0 and changed.config.samples == 4
        with styled(recording, "yarns", ()) as (_, other):
            assert other.name == "yarns"
    wide = draw(path, tmp_path, None, "view.size=[48,64]")
    assert wide.shape == (64, 48, 3)


def test_curves_lie_off_the_leg_and_points_are_the_frames(styled_recording: Path) -> None:
    def worn(recording: Recording, style: str) -> Any:
        with styled(recording, style, ()) as (loaded, chosen):
            return read_worn(recording, loaded, read_frame(recording), chosen)

    with open_recording(styled_recording) as recording:
        yarns, lines = worn(recording, "yarns"), worn(recording, "lines")
        assert lines.yarns is None and len(yarns.yarns.points) > len(yarns.points)
        x = read_frame(recording).x
        assert np.array_equal(yarns.points[:, 2], x[:, 1]) and np.array_equal(yarns.points[:, 1], -x[:, 2])
        assert np.abs(np.linalg.norm(yarns.yarns.points[:, :2], axis=1) - 1.2 * 0.14).max() < 0.01
        with styled(recording, "yarns", ("view.distance=0.7", "view.target=[0,0.5,0]")) as (loaded, _):
            camera = find_camera(loaded.scene.view, yarns, None)
            assert np.linalg.norm(camera.eye - [0, 0, 0.5]) == pytest.approx(0.7)
            assert camera.size == (96, 128)


def test_a_map_shows_the_pressure_of_the_frame(styled_recording: Path, tmp_path: Path) -> None:
    with open_recording(styled_recording) as recording, styled(recording, "map", ()) as (loaded, chosen):
        frame = read_frame(recording)
        values = read_worn(recording, loaded, frame, chosen).values
        expected = read_pressure(recording)
        assert values is not None and expected is not None and values.label == "pressure [Pa]"
        assert np.array_equal(values.values, expected(frame.x)) and values.values.mean() > 1.0
    shown = draw(styled_recording, tmp_path, "map", "view.yarns.radius=60mm")
    assert len(np.unique(shown.reshape(-1, 3), axis=0)) > 100


def test_an_eye_inside_the_leg_is_refused(styled_recording: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="inside a body"):
        draw(styled_recording, tmp_path, "yarns", "view.target=[0,0.4,0]", "view.distance=0.01")


def test_what_is_no_picture_of_yarns_is_refused(styled_recording: Path, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no matter of pictures") as refused:
        draw(styled_recording, tmp_path, "yarns", "seed=3")
    assert refused.value.field == "--set"
    with pytest.raises(BadInput, match="no such field"):
        draw(styled_recording, tmp_path, "lines", "view.yarns.radius=1mm")
    sheet = {"nuno": 1, "name": "sheet", "duration": 0.01, "frame_rate": 100.0, "gravity": [0, 0, 0]}
    sheet["objects"] = [{"name": "sheet", "model": {"plugin": "sheet", "resolution": [4, 4]}}]
    nuno.run(sheet, "solver.plugin=symplectic_euler", record=tmp_path / "sheet.mcap")
    with pytest.raises(BadInput, match="no yarns"):
        draw(tmp_path / "sheet.mcap", tmp_path, "yarns")


def test_the_command_draws_and_refuses(
    styled_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, export = tmp_path / "a.png", ["export", str(styled_recording)]
    assert main([*export, "--png", str(out), "--style", "lines", "--size", "40x32", "--set", FAST[0]]) == 0
    assert Image.open(out).size == (40, 32)
    assert main([*export, "--gif", str(tmp_path / "a.gif"), "--style", "lines"]) == 2
    assert "--style" in capsys.readouterr().err


def test_a_picture_that_is_refused_leaves_no_other_file(styled_recording: Path, tmp_path: Path) -> None:
    """That the eye is inside the leg is found only as the picture is drawn."""
    inside = ["--set", "view.target=[0,0.4,0]", "--set", "view.distance=0.01"]
    files = ["--npz", str(tmp_path / "b.npz"), "--csv", str(tmp_path / "b.csv"), "--png", str(tmp_path / "b.png")]
    assert main(["export", str(styled_recording), *files, "--style", "yarns", *inside]) == 2
    assert list(tmp_path.iterdir()) == []
