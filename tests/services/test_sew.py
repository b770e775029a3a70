"""`nuno sew`: what looks wrong with a pattern, whether it can be sewn, and a body that wears it."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from sewing_patterns import back, column, front, panel, pattern, stitch, tube

from nuno.cli import main
from nuno.cli.sew import _remind
from nuno.scene import scene_file
from nuno.scene.files import SceneFiles
from nuno_schemas.bodies import UNITS as UNITS_OF_FILES
from nuno_schemas.bodies import unit_of
from nuno_schemas.errors import BadInput

GROWTH = 0.9
"""Of a column's girth, from its top down [1/m]."""
LID = panel((0, 0), (30, 0), (30, 0.5), (0, 0.5))


def check(folder: Path, capsys: pytest.CaptureFixture[str], data: Any, *flags: str) -> tuple[int, dict[str, Any]]:
    (folder / "pattern.json").write_text(json.dumps(data))
    capsys.readouterr()
    code = main(["sew", str(folder / "pattern.json"), "--check", "--json", *flags])
    return code, json.loads(capsys.readouterr().out)


def kinds(found: dict[str, Any]) -> dict[str, str]:
    return {remark["kind"]: remark["where"] for remark in found["remarks"]}


def test_a_sound_pattern_has_its_measures_and_nothing_to_be_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, found = check(tmp_path, capsys, tube())
    assert (code, found["remarks"], found["seams"]) == (0, [], 2) and found["length"] == pytest.approx(0.4)
    assert [one["edges"] for one in found["openings"]] == [["front[0]", "back[3]"], ["front[2]", "back[1]"]]
    assert [one["length"] for one in found["openings"]] == pytest.approx([0.6, 0.6])
    assert [(one["name"], one["sewn"]) for one in found["panels"]] == [("front", 2), ("back", 2)]
    assert [one["area"] for one in found["panels"]] == pytest.approx([0.06, 0.06])


def unplaced(one: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in one.items() if name != "translation"}


REMARKS: dict[str, tuple[Any, dict[str, str]]] = {
    "gathers": (tube(back=back(height=24.0)), {"unequal seam": "back[0], front[3]"}),
    "a turned seam": (
        pattern({"front": front(), "back": back()}, stitch("front[1]", "back[2]"), stitch("front[3]", "back[2]")),
        {"sewn twice": "back[2]"},
    ),
    "a panel upside down": (
        tube(back=back() | {"rotation": [180, 0, 0], "translation": [-15, 120, -15]}),
        {"turned seam": "front[3], back[0]"},
    ),
    "a bag": (
        pattern({"front": front(), "back": back()}, *(stitch(f"front[{k}]", f"back[{3 - k}]") for k in range(4))),
        {"closed bag": "front, back"},
    ),
    "a loose panel": (tube(pocket=front(10.0, 10.0)), {"loose panel": "pocket"}),
    "two pieces": (
        pattern(
            {"front": front(), "back": back(), "cuff": front(), "other": back()}, stitch("front[1]", "back[2]"),
            stitch("cuff[1]", "other[2]"),
        ),
        {"several pieces": "pattern"},
    ),
    "no place": (tube(front=unplaced(front()), back=unplaced(back())), {"no place": "front, back"}),
    "a short edge": (
        tube(front=panel((0, 0), (30, 0), (30, 20), (0.1, 20), (0, 20), translation=[-15, 100, 15])),
        {"short edge": "front[3]", "unequal seam": "back[0], front[3]"},
    ),
    "translations in metres": (
        tube(front=front() | {"translation": [0, 1.0, 0.15]}, back=back() | {"translation": [0, 1.0, -0.15]}),
        {"places": "pattern"},
    ),
    "millimetres for centimetres": (
        tube() | {"properties": {"units_in_meter": 1.0}}, {"size": "pattern"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REMARKS)
def test_what_looks_wrong_is_told(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, expected = REMARKS[name]
    code, found = check(tmp_path, capsys, data)
    told = kinds(found)
    assert told.items() >= expected.items(), told
    assert code == (2 if any(remark["wrong"] for remark in found["remarks"]) else 0)
    assert (code == 2) == (name == "a turned seam")


def test_all_errors_are_told_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = tube(front=panel((0, 0), (30, 20), (30, 0), (0, 20)))
    data["pattern"]["panels"]["back"]["edges"].pop()
    data["pattern"]["stitches"].append(stitch("sleeve[0]", "back[1]"))
    code, found = check(tmp_path, capsys, data)
    assert code == 2 and all(remark["wrong"] and remark["line"] for remark in found["remarks"])
    assert list(kinds(found)) == ["crossing edges", "open outline", "no such panel"]


def test_the_ratio_that_is_told_of_can_be_chosen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = tube(back=back(height=24.0))
    assert "unequal seam" not in kinds(check(tmp_path, capsys, data, "--gather", "1.25")[1])
    (remark, *_) = check(tmp_path, capsys, data, "--gather", "1.15")[1]["remarks"]
    assert remark["text"] == "24.00 cm are gathered onto 20.00 cm, 1.20 to 1"


def test_a_person_reads_a_table_of_each_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = [tmp_path / name for name in ("sound.json", "none.json", "torn.yaml")]
    paths[0].write_text(json.dumps(tube()))
    paths[2].write_text(json.dumps(tube(front=panel((0, 0), (30, 20), (30, 0), (0, 20)))))
    assert main(["sew", "--check", *map(str, paths)]) == 2
    said = capsys.readouterr()
    assert "can be sewn, 0 remarks" in said.out and "cannot be sewn: 1 error, 0 remarks" in said.out
    assert "no such file" in said.err
    row = next(line for line in said.out.splitlines() if line.startswith("front"))
    assert row.split() == ["front", "4", "2", "30.0", "20.0", "600"]


def test_the_page_shows_what_is_said_of_its_skirt(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "how-to" / "sewing.md").read_text()
    skirt, said = (page.partition(f"```{kind}\n")[2].partition("```")[0] for kind in ("yaml", "text"))
    monkeypatch.chdir(tmp_path)
    Path("skirt.yaml").write_text(skirt)
    assert main(["sew", "--check", "skirt.yaml"]) == 0
    assert capsys.readouterr().out.strip() == said.strip()


def test_a_ratio_below_one_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sew", "--check", "--gather", "0.9", "x.json"]) == 2
    assert "--gather" in capsys.readouterr().err


def wear(folder: Path, monkeypatch: pytest.MonkeyPatch, *flags: str) -> int:
    """A tube of 60 cm, put on a column of 44 at the top that grows to 64 at its foot."""
    (folder / "tube.json").write_text(json.dumps(tube()))
    x, faces = column((0.08, 0.06), (0.9, 1.4))
    x[:, [0, 2]] *= (1.0 + GROWTH * (1.4 - x[:, 1]))[:, None]
    trimesh.Trimesh(x, faces, process=False).export(folder / "column.obj")
    monkeypatch.chdir(folder)
    return main(["sew", "tube.json", *flags])


REFUSED: dict[str, tuple[tuple[str, ...], str]] = {
    "neither": ((), "a pattern is put on a body, or checked"),
    "both": (("--check", "--body", "column.obj"), "a pattern is put on a body, or checked"),
    "three fabrics": (("--body", "column.obj", *("--fabric", "denim") * 3), "fabrics and patterns do not go together"),
    "no body": (("--body", "colum.obj"), "body: no such file"),
    "no motion": (("--body", "column.obj", "--motion", "walk.bvh"), "motion: no such file"),
    "motion alone": (("--check", "--motion", "walk.bvh"), "a motion moves a body"),
    "written": (("--body", "column.obj", "--scene", "mine.yaml"), "the scene is there already, and has been changed"),
    "fabric": (("--body", "column.obj", "--fabric", "demin"), "'denim'"),
    "edge": (("--body", "column.obj", "--edge", "2 km"), "edge"),
    "edge of a check": (("--check", "--edge", "1 cm"), "error: --edge: "),
    "fabric of a check": (("--check", "--fabric", "denm"), "error: --fabric: "),
    "scene of a check": (("--check", "--scene", "foo.yaml"), "error: --scene: "),
    "a check is not written": (("--check", "--write"), "error: --write: "),
    "gather on a body": (("--body", "column.obj", "--gather", "1.01"), "error: --gather: "),
    "no JSON of a run": (("--body", "column.obj", "--write", "--json"), "error: --json: "),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_put_on_is_refused_before_anything_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], case: str
) -> None:
    (tmp_path / "mine.yaml").write_text("mine")
    flags, problem = REFUSED[case]
    assert wear(tmp_path, monkeypatch, *flags) == 2
    assert problem in capsys.readouterr().err
    assert (tmp_path / "mine.yaml").read_text() == "mine" and not (tmp_path / "recordings").exists()


def test_a_file_that_is_no_pattern_is_refused_before_a_scene_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "coat.dxf").write_text("0\nSECTION\n2\nHEADER\n")
    trimesh.Trimesh(*column((0.08, 0.06), (0.9, 1.4)), process=False).export(tmp_path / "column.obj")
    monkeypatch.chdir(tmp_path)
    assert main(["sew", "coat.dxf", "--body", "column.obj"]) == 2
    assert "coat.dxf:1" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["coat.dxf", "column.obj"]


OTHER_FLAGS = {
    "another fabric and motion": ("polyester", "--body", "column.obj", "--motion", "walk.bvh"),
    "the mannequin": ("denim", "--body", "mannequin"),
}


@pytest.mark.quick(case=["another fabric and motion"])
@pytest.mark.parametrize("case", OTHER_FLAGS)
def test_a_scene_that_no_one_has_changed_is_written_for_other_flags(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also for a body that moves, by a file that is then refused, and for the mannequin that comes with nuno; unless a
    flag is wrong.
    """
    (tmp_path / "walk.bvh").write_text("")
    for fabric, *flags in (("denim", "--body", "column.obj"), OTHER_FLAGS[case]):
        code = 2 if "--motion" in flags else 0
        assert wear(tmp_path, monkeypatch, "--edge", "6 cm", "--fabric", fabric, "--write", *flags) == code
        assert wear(tmp_path, monkeypatch, "--fabric", "demin", "--write", "--body", "column.obj") == 2
        text = (tmp_path / "tube-worn.yaml").read_text()
        assert fabric in text and ("plugin: skin" in text) is ("--motion" in flags)
        assert ("shape: person" in text) is ("mannequin" in flags) is ("column.obj" not in text)
    assert not (tmp_path / "recordings").exists()


@pytest.mark.quick(file=["2nd tube.yaml"])
@pytest.mark.parametrize("file", ["tube-1.5.yaml", "2nd tube.yaml"])
def test_a_scene_has_a_name_whatever_its_file_is_called(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, file: str
) -> None:
    assert wear(tmp_path, monkeypatch, "--body", "column.obj", "--edge", "6 cm", "--write", "--scene", file) == 0
    assert scene_file.read(tmp_path / file).scene.objects[0].name == "tube"


def test_what_looks_wrong_is_told_before_it_is_put_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """In a line, by kinds; nothing of a pattern that looks right."""
    for name, stitches in (("whole", tube()["pattern"]["stitches"]), ("loose", [])):
        data = tube()
        data["pattern"]["stitches"] = stitches
        (tmp_path / f"{name}.json").write_text(json.dumps(data))
        _remind(tmp_path / f"{name}.json")
        said = capsys.readouterr().out
        assert ("loose panel" in said and "--check" in said) if name == "loose" else not said
    (tmp_path / "large.json").write_text(json.dumps(REMARKS["millimetres for centimetres"][0]))
    with pytest.raises(BadInput, match="where a garment has") as refused:
        _remind(tmp_path / "large.json")
    assert refused.value.line is not None and "1000 for mm" in str(refused.value.remedy)


UNITS = [(1.0, ""), (1e-2, "1cm"), (1e-3, "1mm"), (0.0254, "1inch"), (0.3048, "1ft"), (0.1, "1dm"), (10.0, "10m"),
         (100.0, "100m")]  # fmt: skip


@pytest.mark.quick(named=["", "1inch"])
@pytest.mark.parametrize(("unit", "named"), UNITS)
def test_the_unit_of_a_scan_is_told_by_its_size_and_written_into_the_scene(
    unit: float, named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    x, faces = column((0.08, 0.06), (0.0, 1.7))
    trimesh.Trimesh(x / unit, faces, process=False).export(tmp_path / "scan.obj")
    assert wear(tmp_path, monkeypatch, "--body", "scan.obj", "--edge", "6 cm", "--write") == 0
    assert (f"taken as {named}" if named else "scene") in capsys.readouterr().out
    scene = yaml.safe_load((tmp_path / "tube-worn.yaml").read_text())
    assert scene["bodies"][0]["collider"].get("scale", "") == named


def test_a_body_that_fits_no_one_in_any_unit_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    x, faces = column((0.08, 0.06), (0.0, 1.7))
    trimesh.Trimesh(1.7 * x, faces, process=False).export(tmp_path / "scan.obj")
    assert wear(tmp_path, monkeypatch, "--body", "scan.obj", "--write") == 2
    said = capsys.readouterr().err
    assert "fits no one" in said and "1.2 m high" in said and not (tmp_path / "tube-worn.yaml").exists()


@pytest.mark.parametrize("write", [(), ("--write",)], ids=["run", "written"])
def test_a_body_with_its_origin_at_the_pelvis_is_refused_with_the_shift_that_helps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], write: tuple[str, ...]
) -> None:
    x, faces = column((0.08, 0.06), (-1.12, 0.54))
    trimesh.Trimesh(x, faces, process=False).export(tmp_path / "scan.obj")
    assert wear(tmp_path, monkeypatch, "--body", "scan.obj", "--edge", "6 cm", *write) == 2
    said = capsys.readouterr().err
    assert "-1.12 to 0.54" in said and "does not stand where the garment's panels are placed" in said
    move = said.partition("--set ")[2].partition(", or")[0]
    collider = scene_file.read(tmp_path / "tube-worn.yaml", [move]).colliders[0]
    assert collider.plugin.build(collider.config, None, SceneFiles(tmp_path)).vertices[:, 1].min() == pytest.approx(0.0)


@pytest.mark.parametrize("height", [1.05, 1.2, 1.66, 2.0])
@pytest.mark.parametrize("name", UNITS_OF_FILES)
def test_a_person_is_one_in_every_unit_with_and_without_a_pattern(name: str, height: float) -> None:
    size = height / UNITS_OF_FILES[name]
    assert {unit_of(size, worn) for worn in (0.0, 0.66 * height, 1.1 * height)} == {name}


def test_a_doll_in_metres_is_known_by_its_pattern() -> None:
    assert unit_of(0.166, 0.14) == "1m" and unit_of(0.166, 1.4) == "10m" and unit_of(2.8, 1.4) == ""


def test_a_file_that_is_missing_is_answered_with_the_one_of_nearly_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert wear(tmp_path, monkeypatch, "--body", "colum.obj") == 2
    assert "did you mean 'column.obj'?" in capsys.readouterr().err
    assert main(["sew", "tube.jsn", "--body", "column.obj"]) == 2
    assert "did you mean 'tube.json'?" in capsys.readouterr().err
    assert main(["plan", "tube.yml"]) == 2
    assert "did you mean" not in capsys.readouterr().err


@pytest.mark.parametrize("edge", ["3", "0.5 mm", "2 km", "two"])
def test_an_edge_that_is_none_is_refused_before_a_scene_is_written(
    edge: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert wear(tmp_path, monkeypatch, "--body", "column.obj", "--edge", edge) == 2
    said = capsys.readouterr().err
    assert "--edge" in said and edge in said and "2 cm" in said
    assert not list(tmp_path.glob("*.yaml"))


def test_the_scene_reads_the_files_that_were_named_whatever_else_has_their_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file of the name beside the scene, two patterns of one name, and a pattern in a folder below; the command that
    is printed finds each.
    """
    here = tmp_path / "here"
    named = "../one/tube.json", "../two/tube.json", "below/tube.json", "../one/other.json", "../two/column.obj"
    for name in (*named, "tube.json", "column.obj"):
        (here / name).parent.mkdir(parents=True, exist_ok=True)
        (here / name).write_text(json.dumps(tube()))
    x, faces = column((0.08, 0.06), (0.9, 1.4))
    trimesh.Trimesh(x, faces, process=False).export(here / named[-1])
    monkeypatch.chdir(here)
    assert main(["sew", *named[:4], "--body", named[4], "--edge", "6 cm", "--write", "--scene", "worn.yaml"]) == 0
    command = shlex.split(capsys.readouterr().out.partition("nuno run ")[2].partition(")")[0])
    loaded = scene_file.read(Path(command[0]), roots=[Path(root) for root in command[2::2]])
    written = yaml.safe_load(Path("worn.yaml").read_text())
    files = [one["model"]["file"] for one in written["objects"]] + [written["bodies"][0]["collider"]["file"]]
    assert [loaded.files.resolve(file) for file in files] == [(here / name).resolve() for name in named]
    assert files[2:4] == ["below/tube.json", "other.json"]


@pytest.mark.quick(written=['edge: "6 cm"', "nuno: 1"])
@pytest.mark.parametrize(
    ("written", "changed"),
    [
        ('fabric: "interlock"', 'fabric: "silk"'), ('edge: "6 cm"', 'edge: "5 cm"'), ('"column.obj"', '"other.obj"'),
        ('name: "tube-worn"', 'name: "mine"'), ("duration: 6 s", "duration: 7 s"), ("nuno: 1", "nuno: 1\n# mine"),
    ],
)  # fmt: skip
def test_a_scene_with_any_change_is_not_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], written: str, changed: str
) -> None:
    """Also with one that `nuno sew` could have written; one without a change is, and the command says so."""
    flags = "--body", "column.obj", "--edge", "6 cm", "--write"
    for more, said in ((), False), (("--fabric", "denim"), True), ((), True):
        assert wear(tmp_path, monkeypatch, *flags, *more) == 0
        assert ("replaced   tube-worn.yaml" in capsys.readouterr().out) == said
    scene = tmp_path / "tube-worn.yaml"
    own = scene.read_text().replace(written, changed)
    assert own != scene.read_text()
    scene.write_text(own)
    assert wear(tmp_path, monkeypatch, *flags) == 2
    assert scene.read_text() == own and "has been changed" in capsys.readouterr().err


def test_layers_are_objects_in_their_order_each_of_its_fabric(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And a scene of several is written again for other flags, as one of one is."""
    for edge in ("5 cm", "6 cm"):
        flags = "tube.json", "--body", "column.obj", "--fabric", "denim", "--fabric", "polyester", "--edge", edge
        assert wear(tmp_path, monkeypatch, *flags, "--write") == 0
    scene = yaml.safe_load((tmp_path / "tube-tube-worn.yaml").read_text())
    told = [(one["name"], one["model"]["file"], one["model"]["fabric"]) for one in scene["objects"]]
    assert told == [("tube", "tube.json", "denim"), ("tube-2", "tube.json", "polyester")]
    assert len({one["colour"] for one in scene["objects"]}) == 2


@pytest.mark.full
def test_a_body_wears_a_pattern_and_no_edge_goes_through_anything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the collision service's own look at every frame; and again, on one thread, to the same bits."""
    assert wear(tmp_path, monkeypatch, "--body", "column.obj") == 0
    said = capsys.readouterr().out
    assert "cloth passes through cloth or wearer in 0 of" in said
    assert main(["run", "tube-worn.yaml", "--threads", "1", "--no-view"]) == 0
    digests = [line for line in (said + capsys.readouterr().out).splitlines() if line.startswith("digest")]
    assert len(digests) == 2 and digests[0] == digests[1]
    recording = next((tmp_path / "recordings").glob("*.mcap"))
    # It stays where the column is as wide, and is measured there.
    assert main(["fit", str(recording), "--json"]) == 0
    (fit,) = json.loads(capsys.readouterr().out)
    high, low = fit["openings"][0]["high"], fit["openings"][1]["low"]
    assert 0.0 < low < high < 0.5 and fit["pressed"]["area"] > 0.0
    middle = 0.5 * (low + high)
    assert main(["fit", str(recording), "--json", "--at", f"middle={middle} m"]) == 0
    (fit,) = json.loads(capsys.readouterr().out)
    turn = 2.0 * np.pi * np.arange(65) / 64
    around = np.diff(np.stack([0.08 * np.sin(turn), 0.06 * np.cos(turn)], axis=1), axis=0)
    tape = np.linalg.norm(around, axis=1).sum() * (1.0 + GROWTH * (0.5 - middle))
    assert fit["girths"][0]["body"] == pytest.approx(tape, rel=1e-6)
    assert fit["girths"][0]["cut"] == pytest.approx(0.6, abs=2e-3)
    assert fit["ease"]["middle"] == pytest.approx(0.6 - tape, abs=2e-3)


def test_fit_asks_for_a_body_and_a_garment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bare.yaml").write_text(
        "nuno: 1\nname: bare\nduration: 0.02 s\nframe_rate: 50 Hz\nsolver: {plugin: symplectic_euler, dt: auto}\n"
        "objects: [{name: cloth, model: {plugin: sheet, size: [0.1 m, 0.1 m], resolution: [3, 3], fabric: denim}}]\n"
    )
    file = str(tmp_path / "bare.mcap")
    assert main(["run", str(tmp_path / "bare.yaml"), "--no-view", "--record", file]) == 0
    for flags, problem in (
        ((), "the recording has no body to fit"),
        (("--at", "bust=1 kg"), "--at"),
        (("--at", "1 m"), "a height has a name"),
        (("--frame", "7"), "no such frame"),
    ):
        capsys.readouterr()
        assert main(["fit", file, *flags]) == 2
        assert problem in capsys.readouterr().err
