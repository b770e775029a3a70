"""Files that are dropped on the page of `nuno studio`: taken, told of, and made scenes of."""

from __future__ import annotations

import io
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from PIL import Image
from recorded_sheet import Sheet, write
from studio_desk import FILE

from nuno.cli import main
from nuno.dye.run import build_cloth
from nuno.scene import scene_file, shipped
from nuno.studio import dropped_files as arrivals
from nuno.studio import files as offers
from nuno.studio.desk import Desk
from nuno.studio.dropped_files import look
from nuno_schemas.errors import BadInput

OWN = shipped.folder()
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
SKIRT = """\
properties: {units_in_meter: 100}
pattern:
  panels:
    front:
      vertices: [[-36, 0], [36, 0], [24, 60], [-24, 60]]
      edges: [{endpoints: [0, 1]}, {endpoints: [1, 2]}, {endpoints: [2, 3]}, {endpoints: [3, 0]}]
      translation: [0, 45, 20]
    back:
      vertices: [[-36, 0], [-24, 60], [24, 60], [36, 0]]
      edges: [{endpoints: [0, 1]}, {endpoints: [1, 2]}, {endpoints: [2, 3]}, {endpoints: [3, 0]}]
      translation: [0, 45, -20]
  stitches:
    - [{panel: front, edge: 1}, {panel: back, edge: 2}]
    - [{panel: front, edge: 3}, {panel: back, edge: 0}]
"""


@pytest.fixture(autouse=True)
def empty(desk: Desk) -> None:
    """The desk's folder."""
    Path(FILE).unlink()


def drop(desk: Desk, name: str, data: bytes) -> dict[str, Any]:
    return desk.files.take(name, io.BytesIO(data), len(data))


def rows(told: dict[str, Any]) -> dict[str, str]:
    return dict(told["rows"])


def make(desk: Desk, file: str, offer: str, **chosen: str) -> str:
    """The scene that was written, which has no mistakes."""
    scene = desk.act({"do": "make", "file": file, "offer": offer, "chosen": chosen})["scene"]
    assert desk.act({"do": "open", "scene": scene})["mistakes"] == []
    return str(scene)


def test_each_kind_of_file_is_told_in_figures(desk: Desk) -> None:
    draft = drop(desk, "mine.wif", (OWN / "dye/draft.wif").read_bytes())
    assert (draft["kind"], rows(draft)["ends"], rows(draft)["shafts"], draft["pictured"]) == ("draft", "8", "4", True)
    walk = drop(desk, "mine.bvh", (OWN / "walk.bvh").read_bytes())
    text = (OWN / "walk.bvh").read_text()
    assert rows(walk)["frames"] == text.split("Frames:")[1].split()[0]
    assert rows(walk)["joints"].startswith(f"{text.count('JOINT') + 1}, and {text.count('End Site')} ends")
    robot = drop(desk, "arm.bvh", re.sub("(S)pine|(C)hest|(N)eck|(H)ead", r"Link\1\2\3\4", text).encode())
    assert robot["mistakes"] == robot["offers"] == [] and rows(robot)["size"].endswith(" units")
    net = drop(desk, "mine.npz", (OWN / "pendulum.npz").read_bytes())
    assert rows(net) == {"masses": "9, of 0.45 kg in all", "springs": "8", "held": "1", "size": "1 x 0 x 0 m"}
    stencil = drop(desk, "mine.png", (OWN / "dye/stencil.png").read_bytes())
    with Image.open(OWN / "dye/stencil.png") as picture:
        assert rows(stencil)["size"] == "{} x {} pixels".format(*picture.size)
    pattern = drop(desk, "skirt.yaml", SKIRT.encode())
    assert (pattern["kind"], rows(pattern)["seams"], pattern["mistakes"]) == ("pattern", "2, of 1.22 m in all", [])
    assert rows(pattern)["openings"] == "144.0 cm, 96.0 cm"
    scene = drop(desk, "scene.yaml", (OWN / "net.yaml").read_bytes().replace(b"damping: 0.0", b"damping: -1"))
    assert scene["kind"] == "scene" and scene["mistakes"][0]["field"] == "damping"


def test_a_mesh_is_told_whether_it_is_closed_and_in_which_unit(desk: Desk) -> None:
    body = drop(desk, "body.obj", TETRAHEDRON.encode())
    assert (rows(body)["triangles"], rows(body)["closed"], rows(body)["size"][:9]) == ("4", "yes", "1 x 1 x 1")
    assert [one["name"] for one in body["offers"]] == ["wear", "dress", "cover", "stocking", "fall"]
    large = drop(desk, "large.obj", TETRAHEDRON.replace("1\nf", "1000\nf").replace("v 1 ", "v 1000 ").encode())
    assert rows(large)["unit"].startswith("taken as 1mm") and rows(large)["size"].startswith("1 x ")
    model = yaml.safe_load(Path(make(desk, "large.obj", "cover")).read_text())["bodies"][0]["collider"]
    assert model == {"plugin": "mesh", "file": "large.obj", "scale": "1 mm"}
    garment = drop(desk, "garment.obj", TETRAHEDRON.replace("1\nf", "340\nf").replace("v 1 ", "v 340 ").encode())
    assert rows(garment)["unit"].startswith("taken as 1mm")
    model = yaml.safe_load(Path(make(desk, "garment.obj", "fall")).read_text())["objects"][0]["model"]
    assert model["scale"] == "1 mm" and abs(model["centre"][1]) < 1.0
    either = drop(desk, "either.obj", TETRAHEDRON.replace("1\nf", "30\nf").replace("v 1 ", "v 30 ").encode())
    assert rows(either)["unit"].startswith("taken as metres") and "1cm (0.3 m long) or 1inch" in rows(either)["unit"]
    cloth = drop(desk, "open.obj", TETRAHEDRON.rpartition("f")[0].encode())
    assert "hole" in rows(cloth)["as a body"] and cloth["offers"][0]["name"] == "fall"
    split = drop(desk, "split.obj", TETRAHEDRON.replace("f 1 3 2", "f 1 3 2\nf 1 3 2").encode())
    assert split["offers"] == [] and split["mistakes"][0]["words"].startswith("split.obj: ")


@pytest.mark.parametrize("unit", ["1mm", "1dm"])
def test_a_mesh_that_passes_through_itself_says_so_where_it_is_in_metres(desk: Desk, unit: str) -> None:
    """Two boxes, as high as a person, cross at the height of 1 m."""
    boxes = [trimesh.creation.box(size, trimesh.transformations.translation_matrix([0.0, 0.9, 0.0]))
             for size in ((0.3, 1.8, 0.2), (0.2, 0.2, 0.3))]  # fmt: skip
    mesh = trimesh.util.concatenate(boxes)
    mesh.apply_scale({"1mm": 1000.0, "1dm": 10.0}[unit])
    seen = drop(desk, "scan.obj", trimesh.exchange.obj.export_obj(mesh).encode())
    assert rows(seen)["unit"].startswith(f"taken as {unit}") and "passes through itself" in rows(seen)["remark"]
    place = [float(word) for word in re.findall(r"\[(.*?)\]", rows(seen)["remark"])[0].split(",")]
    assert 0.1 < place[1] < 1.8 and max(map(abs, place)) < 1.8


def test_a_pattern_that_cannot_be_sewn_says_why_by_line(desk: Desk) -> None:
    told = drop(desk, "skirt.yaml", SKIRT.replace("edge: 0}]", "edge: 2}]").encode())
    assert told["offers"] == [] and told["mistakes"][0]["problem"].startswith("sewn twice")
    assert told["mistakes"][0]["line"] and "skirt.yaml" in told["mistakes"][0]["words"]


def test_a_pattern_is_put_on_a_body_as_nuno_sew_does_it(desk: Desk, capsys: pytest.CaptureFixture[str]) -> None:
    """A body with a hole and a triangle that faces the wrong way is no cloth; the scene mends it, and both say so."""
    body = drop(desk, "body.obj", TETRAHEDRON.rpartition("f")[0].replace("f 1 3 2", "f 1 2 3").encode())
    assert body["mistakes"] == [] and rows(body)["remark"].startswith("mended: 1 hole filled, the largest, of 3 edges")
    # Patterns of JSON are chosen from: a text may be many things.
    drop(desk, "skirt.json", yaml_as_json(SKIRT))
    scene = make(desk, "skirt.json", "wear", fabric="denim")
    assert scene == "skirt-worn.yaml"
    command = ["sew", "skirt.json", "--body", "body.obj", "--fabric", "denim", "--scene", "sewn.yaml", "--write"]
    assert main(command) == 0
    assert "1 hole filled" in capsys.readouterr().out and ", mend: true}" in Path(scene).read_text()
    assert Path(scene).read_text().replace("skirt-worn", "sewn") == Path("sewn.yaml").read_text()
    again = make(desk, "body.obj", "wear", pattern="skirt.json", fabric="denim", motion="nuno:walk.bvh")
    assert again == "skirt-worn-2.yaml" and Path("walk.bvh").read_bytes() == (OWN / "walk.bvh").read_bytes()
    with pytest.raises(BadInput, match="no such choice"):
        make(desk, "body.obj", "wear", pattern="../skirt.json")


def yaml_as_json(text: str) -> bytes:
    import json

    return json.dumps(yaml.safe_load(text)).encode()


@pytest.mark.parametrize(
    ("file", "offer", "place"),
    [
        ("dye/draft.wif", "weave", ("dye", "cloth", "weave", "file")),
        ("dye/stencil.png", "resist", ("dye", "cloth", "resist", 0, "file")),
        ("seigaiha.png", "print", ("objects", 0, "model", "texture")),
        ("pendulum.npz", "net", ("objects", 0, "model", "file")),
        ("walk.bvh", "dance", ("bodies", 0, "motion", "file")),
    ],
)
def test_what_is_made_names_the_file(desk: Desk, file: str, offer: str, place: tuple[str | int, ...]) -> None:
    name = f"mine{Path(file).suffix}"
    drop(desk, name, (OWN / file).read_bytes())
    found = yaml.safe_load(Path(make(desk, name, offer)).read_text())
    for part in place:
        found = found[part]
    assert found == name


def test_nothing_is_written_over_and_what_is_there_is_known_again(desk: Desk) -> None:
    net = (OWN / "pendulum.npz").read_bytes()
    Path("a.npz").write_text("mine")
    assert drop(desk, "a.npz", net)["file"] == drop(desk, "a.npz", net)["file"] == "a-2.npz"
    assert Path("a.npz").read_text() == "mine" and Path("a-2.npz").read_bytes() == net


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("../../up.npz", "up.npz"), ("/etc/passwd.npz", "passwd.npz"), ("C:\\a\\b.NPZ", "b.npz"),
        (".hidden.npz", "hidden.npz"), ("a/..npz", None), ("-x\n;|&$.npz", "x.npz"), ("布.npz", "布.npz"),
        ("..", None), ("a.exe", None), ("", None), ("a.npz/", None),
    ],
)  # fmt: skip
def test_a_name_leads_nowhere_else(desk: Desk, tmp_path: Path, name: str, kept: str | None) -> None:
    data = (OWN / "pendulum.npz").read_bytes()
    before = set(tmp_path.parent.iterdir())
    if kept is None:
        with pytest.raises(BadInput, match="no files of this kind"):
            drop(desk, name, data)
    else:
        assert drop(desk, name, data)["file"] == kept
    assert [path.name for path in tmp_path.iterdir()] == ([kept] if kept else [])
    assert set(tmp_path.parent.iterdir()) == before


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.obj", b"nothing"), ("a.stl", b"solid"), ("a.glb", b"glTF"), ("a.ply", b"\0" * 90), ("a.bvh", b"HIERARCHY"),
        ("a.wif", b"[WIF]"), ("a.png", b"\x89PNG\r\n\x1a\n12"), ("a.jpg", b"GIF89a"), ("a.npz", b"PK"),
        ("a.json", b"{}"), ("a.yaml", b"a: 1"), ("a.csv", b"B, 1"), ("a.mcap", b"\x89MCAP0\r\n"),
    ],
)  # fmt: skip
def test_what_is_not_what_it_says_is_refused_and_not_kept(desk: Desk, tmp_path: Path, name: str, data: bytes) -> None:
    with pytest.raises(BadInput) as refused:
        drop(desk, name, data)
    assert refused.value.problem and not [path for path in tmp_path.rglob("*") if path.is_file()]
    assert "nuno-" not in str(refused.value)


@pytest.mark.parametrize("name", ["a.json", "a.csv", "a.yaml"])
def test_a_photo_that_is_called_a_text_is_refused_as_none(desk: Desk, name: str) -> None:
    with pytest.raises(BadInput, match=r"not (a )?text") as refused:
        drop(desk, name, (OWN / "dye/stencil.png").read_bytes())
    assert "codec" not in str(refused.value) and refused.value.remedy


def test_a_pattern_in_yaml_is_found_again_and_made_a_scene_of(desk: Desk) -> None:
    drop(desk, "body.obj", TETRAHEDRON.encode())
    told = drop(desk, "skirt.yaml", SKIRT.encode())
    assert desk.act({"do": "about", "file": "skirt.yaml"})["kind"] == "pattern"
    assert make(desk, "skirt.yaml", told["offers"][0]["name"]) == "skirt-worn.yaml"


def test_what_is_too_large_or_breaks_off_is_refused(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    data = (OWN / "pendulum.npz").read_bytes()
    with pytest.raises(BadInput, match="broke off"):
        desk.files.take("a.npz", io.BytesIO(data[:-1]), len(data))
    for size in (0, arrivals.MOST + 1):
        with pytest.raises(BadInput, match="empty, or too large"):
            desk.act({"do": "expect", "name": "a.npz", "bytes": size})
    usage = shutil.disk_usage(".")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=arrivals.SPARE + 10))
    with pytest.raises(BadInput, match="no room"):
        desk.act({"do": "expect", "name": "a.npz", "bytes": 11})
    assert desk.act({"do": "expect", "name": "a.npz", "bytes": 10})["name"] == "a.npz"
    assert desk.act({"do": "files"})["files"] == [] and not list(Path().iterdir())


def test_a_recording_is_told_and_lies_where_recordings_do(desk: Desk, tmp_path: Path) -> None:
    write(tmp_path / "wave.mcap", Sheet())
    data = (tmp_path / "wave.mcap").read_bytes()
    told = drop(desk, "wave.mcap", data)
    assert told["kind"] == "recording" and rows(told)["scene"] == "waving" and told["offers"] == told["mistakes"] == []
    assert Path("recordings/wave.mcap").read_bytes() == data


def test_a_sheet_of_a_laboratory_becomes_the_cloth_of_a_scene(desk: Desk) -> None:
    sheet = "instrument, KES-F\nW, 12.1, mg/cm^2\nB, 0.118, 0.076\nG, 0.8, 0.7\nLT, 0.75, 0.8\nEMT, 3.2, 6.1\n"
    told = drop(desk, "cotton.csv", sheet.encode())
    assert told["kind"] == "sheet" and "measured" in rows(told)["density"]
    fabric = yaml.safe_load(Path(make(desk, "cotton.csv", "drape")).read_text())["objects"][0]["model"]["fabric"]
    assert fabric["density"] == "0.121 kg/m^2"


def test_a_picture_is_shown_small(desk: Desk) -> None:
    Image.fromarray(np.zeros((900, 1800, 3), np.uint8)).save("large.jpg")
    kind, data = desk.files.picture({"file": ["large.jpg"]})
    assert kind == "image/png" and Image.open(io.BytesIO(data)).size == (640, 320)


WIF = """[WIF]
[WEAVING]
Shafts=2
Treadles=2
[WARP]
Threads={0}
{1}
[WEFT]
Threads={0}
{1}
[THREADING]
{2}
[TIEUP]
1=1
2=2
[TREADLING]
{2}
"""


@pytest.mark.parametrize(
    ("ends", "lengths", "cells", "coarser"),
    [(8, "", 320, 1), (8, "Units=centimeters\nSpacing=0.05", 320, 1), (90, "Units=cm\nSpacing=0.1", 1800, 3)],
    ids=["no spacing", "repeated", "large"],
)
def test_all_of_a_draft_is_woven(ends: int, lengths: str, cells: int, coarser: int) -> None:
    table = "\n".join(f"{k + 1}={k % 2 + 1}" for k in range(ends))
    Path("a.wif").write_text(WIF.format(ends, lengths, table))
    scene = scene_file.read(offers.make(Path("a.wif").resolve(), look, "weave", {}))
    cloth = scene.dyed.cloth.config
    assert cloth.cells == (cells, cells) and cloth.coarser == coarser
    build_cloth(scene)


def test_a_stencil_in_colour_or_jpg_is_taken_by_its_greys_and_written_once() -> None:
    shutil.copy(shipped.folder() / "dye" / "draft.wif", "a.wif")
    colours = np.random.default_rng(1).integers(0, 256, (40, 50, 3)).astype(np.uint8)
    for name in ("a.png", "a.jpg"):
        Image.fromarray(colours).save(name)
        with Image.open(name) as picture:
            greys = np.asarray(picture.convert("L"))
        for _ in range(2):
            scene = scene_file.read(offers.make(Path(name).resolve(), look, "resist", {}))
            build_cloth(scene)
            (resist,) = scene.dyed.cloth.config.resist
            with Image.open(resist.file) as kept:
                assert np.array_equal(np.asarray(kept), greys)
    assert len(list(Path().glob("a-grey*.png"))) == 2
