"""Knits in recordings: what kind of yarn each link is, how long the yarns are, and pictures by kind."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import nuno
from nuno.exports.cloth import read_pieces
from nuno.exports.paint import PLAIN, SIDES, YARNS, paint_stretch, paint_yarns
from nuno.exports.pictures import Painter
from nuno.recording.reader import open_recording
from nuno.scene import scene_file, shipped
from nuno.simulation.cloth import build
from nuno.simulation.cloth.yarns import edge_yarns
from nuno_schemas.colour import parse_hex
from nuno_schemas.fabric import Fabric

SCENE = "knit/stitch-10x10"


def fabric() -> Fabric:
    return build.build_fabric(scene_file.read(shipped.find(SCENE)))[0]


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
    fabric, pieces = build.build_fabric(scene_file.read(path))
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
