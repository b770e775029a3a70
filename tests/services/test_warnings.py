"""What makes a run doubtful is said by the plan, before the run, in its report and to Python."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import pytest
from scenes import BALL, write_scene

import nuno
from nuno.cli import main
from nuno.recording.reader import Recording
from nuno.report.run_report import lines
from nuno.scene import shipped
from nuno.scene.files import SceneFiles
from nuno.scene.scene_file import load, read
from nuno.scene.warnings import scene_warnings
from nuno_schemas.messages import EVENT


def told(capsys: pytest.CaptureFixture[str], *command: str) -> str:
    assert main(list(command)) == 0
    said = capsys.readouterr()
    return said.out + said.err


@pytest.mark.parametrize(
    ("duration", "end"), [("0.04 s", 0.1), ("0.25 s", 0.2), (0.31, 0.3), (0.2, None), ("0.3 s", None)]
)
def test_a_duration_that_is_not_whole_frames_is_said_where_it_ends(
    duration: str | float, end: float | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = write_scene(tmp_path, duration=duration, frame_rate=10)
    said = f"the run ends at {end:g} s" if end is not None else "duration:"
    plan = told(capsys, "plan", str(scene))
    assert ((said in plan), plan.count("WARNING")) == (end is not None, int(end is not None))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = nuno.run(scene, record=tmp_path / "run.mcap")
    assert result.t == pytest.approx(end or float(str(duration).split()[0]))
    expected = [text for text in result.report["warnings"] if said in text]
    assert len(expected) == len(result.report["warnings"]) == int(end is not None)
    assert [str(one.message) for one in caught if one.category is UserWarning] == expected
    assert ("warning", *expected) in lines(result.report) or end is None


def test_intervals_of_a_recording_that_are_rounded_are_said_before_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fields = {"duration": 0.4, "frame_rate": 10, "record": {"checkpoint_every": 0.14}}
    said = told(capsys, "run", str(write_scene(tmp_path, **fields)), "--no-record", "--no-view")
    warning = "record.checkpoint_every: 0.14 s is 1.4 frames at 10 Hz: taken as 0.1 s"
    assert said.count(warning) == 2  # at the start and in the report


def ball(x: float, depth: float) -> dict[str, object]:
    """A scene in which the chain's vertex at x begins so deep [m] in a ball, and no other vertex in it."""
    collider = {"plugin": "sphere", "centre": [x, depth - 0.08, 0.0], "radius": 0.08}
    return {"bodies": [BALL[0] | {"collider": collider}], "duration": 0.1}


def warned(recording: Recording) -> list[str]:
    """Warnings that the simulation gave before its first step."""
    events = [recording.json(message.payload) for message in recording.messages([f"{EVENT.name}/simulation"])]
    return [one["text"] for one in events if (one["kind"], one["frame"]) == ("warning", 0)]


@pytest.mark.parametrize(("x", "what"), [(0.3, "6 vertices"), (0.0, "1 held vertices")])
def test_depths_are_those_before_the_first_step(
    x: float, what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = write_scene(tmp_path, **ball(x, 0.031))
    warning = f"1 of {what} start in a body, up to 31 mm deep"
    assert warning in told(capsys, "plan", str(scene))
    with pytest.warns(UserWarning, match=warning):
        result = nuno.run(scene, record=tmp_path / "run.mcap")
    with result.recording as recording:
        said = warned(recording)
    assert said == result.report["warnings"]
    assert sum(warning in text for text in said) == 1
    through = [text for text in said if "the edge that is held" in text]
    assert (len(said), len(through)) == ((1, 0) if x else (2, 1))


def test_cloth_that_hardly_touches_is_not_said_to_start_inside(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = write_scene(tmp_path, **ball(0.3, 0.0049))
    assert "WARNING" not in told(capsys, "plan", str(scene))
    assert nuno.run(scene, record=tmp_path / "run.mcap").report["warnings"] == []


@pytest.mark.full
def test_a_body_through_a_waistband_is_said(shared_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Hips of a captured walk are higher than those that the shipped skirt is cut for."""
    small = (
        *("--set", "objects.0.model.columns=80", "--set", "objects.0.model.rows=24", "--set", "duration=0.1"),
        *("--set", "cloth_contact=none"),
    )
    said = told(capsys, "plan", "skirt-walk", *small)
    assert "WARNING" not in said
    walk = f"bodies.walker.motion.file={shared_data / 'cmu_12_01_walk.bvh'}"
    said = told(capsys, "plan", "skirt-walk", *small, "--set", walk)
    assert "a body is through the edge that is held" in said


HANGING = {
    "nuno": 1,
    "name": "bare",
    "duration": 0.1,
    "frame_rate": 10,
    "solver": {"plugin": "symplectic_euler", "dt": 1e-9},
    "objects": [{"name": "cloth", "model": {"plugin": "sheet", "size": [0.2, 0.2], "resolution": [3, 3]}}],
}


def hanging(scene: dict[str, Any] | None = None, **model: Any) -> list[str]:
    """What is warned of a hanging sheet with other fields of its model, and of its scene."""
    cloth = HANGING["objects"][0]  # type: ignore[index]
    objects = [cloth | {"model": cloth["model"] | model}]
    return scene_warnings(load(HANGING | {"objects": objects} | (scene or {}), {}, "bare", SceneFiles(Path())))


@pytest.mark.parametrize(
    ("field", "value", "said", "meant"),
    [
        (
            "fabric",
            {"preset": "denim", "density": 150},
            "fabric.density: a bare 150",
            "150 g/m^2, which is 0.15 kg/m^2?",
        ),
        ("fabric", {"preset": "denim", "bend_weft": 5}, "fabric.bend_weft: a bare 5", "5 uN*m, which is 5e-06 N*m"),
        ("fabric", {"density": 0.1, "structural": [60, 6e6]}, "fabric.structural[1]: a bare 6e+06", "plausible"),
        ("fabric", {"density": 0.1, "structural": 6e6}, "fabric.structural: a bare 6e+06", "plausible"),
        ("size", [50, 0.5], "size[0]: a bare 50", "50 cm, which is 0.5 m; or 50 mm, which is 0.05 m?"),
        ("size", [100, 0.5], "size[0]: a bare 100", "100 cm, which is 1 m; or 100 mm, which is 0.1 m?"),
        ("size", ["100", "0.5"], "size[0]: a bare 100", "100 cm, which is 1 m; or 100 mm, which is 0.1 m?"),
        ("rotate", {"angle": -90}, "rotate.angle: a bare -90", "-90 deg, which is -1.571 rad?"),
        ("velocity", [0, 0, 1e308], "velocity[2]: a bare 1e+308", "up to 100 m/s is plausible"),
    ],
)
def test_bare_numbers_that_no_cloth_has_are_said_with_what_was_meant(
    field: str, value: Any, said: str, meant: str
) -> None:
    (warning,) = hanging(**{field: value})
    assert f"objects[0].model.{said}" in warning and meant in warning
    if "bare 150" in said:
        assert "0.003 to 5 kg/m^2 is plausible (nine in ten of 618 measured fabrics have 0.031 to 0.488)" in warning


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("fabric", {"preset": "denim", "density": "150 g/m^2", "bend_weft": "5 uN*m"}),
        ("fabric", {"preset": "denim", "density": "150 kg/m^2"}),  # what is written with its unit is meant
        ("fabric", {"preset": "denim", "bend_weft": 0}),
        ("fabric", {"density": 0.031, "structural": 60, "hinge": 1.1e-4}),
        ("size", ["100 cm", 1.0]),
        ("rotate", {"angle": 6.28}),
    ],
)
def test_plausible_numbers_and_those_with_units_pass_without_a_word(field: str, value: Any) -> None:
    assert hanging(**{field: value}) == []


def test_bare_numbers_are_looked_at_in_all_of_a_scene() -> None:
    bodies = [{"name": "ball", "collider": {"plugin": "sphere", "centre": [0, 0, 0], "radius": 30}}]
    forces = [{"plugin": "wind", "velocity": ["120 km/h", 0, 0], "density": 1225}]
    found = hanging({"gravity": [0, -981, 0], "view": {"azimuth": 45}, "bodies": bodies, "forces": forces})
    fields = ["gravity[1]", "view.azimuth", "bodies[0].collider.radius", "forces[0].density"]
    assert sorted(text.partition(":")[0] for text in found) == sorted(fields)
    keyframes = {"plugin": "keyframes", "times": [0, 1], "rotations": [[0, 0, 0], [0, 90, 0]]}
    assert (
        hanging({"bodies": [bodies[0] | {"collider": {"plugin": "sphere", "radius": 0.1}, "motion": keyframes}]}) == []
    )


@pytest.mark.parametrize(
    ("form", "rotations", "key"),
    [
        ("euler", [[0, 0, 0], [0, "180 deg", 0], [0, "360 deg", 0]], None),
        ("euler", [[0, 0, 0], [0, "90 deg", 0], [0, "-110 deg", 0]], 2),
        ("axis_angle", [[0, 1, 0, 0], [0, 1, 0, "270 deg"], [0, 1, 0, 0]], 1),
        ("quaternion", [[1, 0, 0, 0], [-1, 0, 0, 0], [0, 1, 0, 0]], None),
    ],
)
def test_keys_that_are_turned_the_other_way_are_said(form: str, rotations: list[list[Any]], key: int | None) -> None:
    motion = {"plugin": "keyframes", "times": [0, 1, 2], "form": form, "rotations": rotations}
    found = hanging({"bodies": [{"name": "box", "collider": {"plugin": "sphere", "radius": 0.1}, "motion": motion}]})
    assert [text.partition(":")[0] for text in found] == ([f"bodies[0].motion.rotations[{key}]"] if key else [])


@pytest.mark.parametrize(("fields", "jumps"), [
    ({"positions": [[0, 0, 0], [1, 0, 0], [0, 0, 0]]}, False), ({"positions": [[0, 0, 0], [1, 0, 0], [1, 0, 0]]}, True),
    ({"rotations": [[0, 0, 0], [0, "180 deg", 0], [0, "360 deg", 0]]}, False),
    ({"rotations": [[0, 0, 0], [0, "90 deg", 0], [0, "180 deg", 0]]}, True),
])  # fmt: skip
def test_a_loop_that_ends_elsewhere_than_it_begins_is_doubted(fields: dict[str, Any], jumps: bool) -> None:
    for end in ("hold", "loop"):
        motion = {"plugin": "keyframes", "times": [0, 1, 2], "end": end, **fields}
        found = hanging({"bodies": [{"name": "b", "collider": {"plugin": "sphere", "radius": 0.1}, "motion": motion}]})
        assert [text.partition(":")[0] for text in found] == ["bodies[0].motion.end"] * (jumps and end == "loop")


@pytest.mark.parametrize("name", shipped.scenes())
def test_shipped_scenes_are_beyond_doubt(name: str) -> None:
    assert scene_warnings(read(shipped.find(name))) == []


def test_implausible_numbers_are_said_by_plan_run_and_python(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, warning = write_scene(tmp_path, gravity=[0, -981, 0], duration=0.1), "gravity[1]: a bare -981 is -981 m/s^2"
    assert warning in told(capsys, "plan", str(scene))
    assert told(capsys, "run", str(scene), "--no-record", "--no-view").count(warning) == 2
    with pytest.warns(UserWarning, match="was it -981 cm/s"):
        result = nuno.run(scene, record=tmp_path / "run.mcap")
    assert [text.startswith(warning) for text in result.report["warnings"]] == [True]


def test_a_number_that_cannot_be_built_is_asked_about_in_the_error(capsys: pytest.CaptureFixture[str]) -> None:
    """And the error is of a field that the skirt has."""
    assert main(["plan", "skirt-hula", "--set", "objects.skirt.model.length=60"]) == 2
    first, *_, remedy = capsys.readouterr().err.strip().splitlines()
    assert "objects[0].model.rows" in first
    assert remedy.strip().startswith("remedy: objects[0].model.length: a bare 60 is 60 m") and "60 cm" in remedy


SMALL = ("--set", "objects.0.model.columns=80", "--set", "objects.0.model.rows=24")


def planned(capsys: pytest.CaptureFixture[str], *flags: str) -> str:
    assert main(["plan", "skirt-walk", *SMALL, *flags]) == 0
    return capsys.readouterr().out


def test_cloth_that_starts_in_a_body_is_told_beside_where_its_frame_is(capsys: pytest.CaptureFixture[str]) -> None:
    fits = planned(capsys)
    found = re.search(r"^attached +to walker/Hips, which starts at \[(.*)\] m$", fits, re.MULTILINE)
    assert found is not None and "WARNING" not in fits
    x, y, z = (float(value) for value in found[1].split(", "))
    low = planned(capsys, "--set", f"objects.0.model.centre=[{x}, {y}, {z}]")
    assert re.search(r"^WARNING +[1-9][0-9]* of 1,920 vertices start in a body, up to [0-9.]+ mm", low, re.MULTILINE)


@pytest.mark.parametrize(("warp", "fabric", "doubted"), [
    (None, "denim", True), ([0.0, 0.0, 1.0], "denim", False), ([0.05, -2.0, 0.0], "denim", True),
    ([1, 1, 0], "denim", False), (None, {"density": 0.2, "structural": 10.0}, False),
])  # fmt: skip
def test_a_warp_that_is_normal_to_cloth_is_doubted(
    warp: list[float] | None, fabric: Any, doubted: bool, tmp_path: Path
) -> None:
    (tmp_path / "top.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 0 1\nv 0 0 1\nf 1 3 2\nf 1 4 3\n")
    model = {"plugin": "mesh", "file": "top.obj", "fabric": fabric} | ({} if warp is None else {"warp": warp})
    objects = [{"name": "top", "model": model, "colour": "#ffffff"}]
    found = scene_warnings(load(HANGING | {"objects": objects}, {}, "top", SceneFiles(tmp_path)))
    assert [text.startswith("objects[0].model.warp") for text in found] == [True] * doubted


@pytest.mark.parametrize(("size", "scale", "said"), [
    (340.0, 1.0, "1mm (0.34 m long)"), (340.0, 1e-3, ""), (19.0, 1.0, ""), (30.0, 1.0, "1cm (0.3 m long) or 1inch"),
    (400.0, 0.1, "1mm (0.4 m long)"),
])  # fmt: skip
def test_a_mesh_that_is_vast_in_metres_is_doubted(
    size: float, scale: float, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "top.obj").write_text(f"v 0 0 0\nv {size} 0 0\nv {size} {size} 0\nv 0 {size} 0\nf 1 2 3\nf 1 3 4\n")
    model = {"plugin": "mesh", "file": "top.obj", "scale": scale, "fabric": "denim"}
    scene = write_scene(tmp_path, objects=[{"name": "top", "model": model}], solver={"plugin": "implicit_euler"})
    assert main(["plan", str(scene)]) == 0
    assert ("top is " in capsys.readouterr().out) == bool(said)
    result = nuno.run(scene, duration=0.05, record=tmp_path / "run.mcap")
    doubts = [text for text in result.report["warnings"] if text.startswith("top is ")]
    assert len(doubts) == bool(said) and all(said in text for text in doubts)


def test_a_resumed_runs_report_says_how_its_recording_began(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, path = write_scene(tmp_path, **ball(0.0, 0.031)), tmp_path / "run.mcap"
    assert "start in a body" in told(capsys, "run", str(scene), "--record", str(path), "--no-view")
    on = ("run", "--resume", str(path), "--set", "duration=0.2", "--record", str(tmp_path / "on.mcap"), "--no-view")
    assert "start in a body" in told(capsys, *on)
    with nuno.open(path) as first, nuno.open(tmp_path / "on.mcap") as second:
        assert warned(second) == warned(first), "the event of the start stands once in the recording"


@pytest.mark.parametrize(
    ("material", "fields", "named"),
    [
        (
            "newmtl a\nmap_Kd print.png\nnewmtl b\n  map_kd C:\\prints\\my print.png\r\n",
            {},
            ["print.png", "my print.png"],
        ),
        ("newmtl a\nmap_Kd print.png\nnewmtl b\nmap_Kd print.png", {}, ["print.png"]),
        ("map_Kd print.png", {"colour": "teal"}, []),
        ("map_Kd print.png", {"texture": "print.png"}, []),
        ("Kd 0.8 0.8 0.8\n# map_Kd print.png\nmap_Ks print.png", {}, []),
        (None, {}, []),
    ],
)
def test_images_of_materials_are_named(
    tmp_path: Path, material: str | None, fields: dict[str, str], named: list[str]
) -> None:
    """Those of an OBJ file's material files next to it, each once, unless the cloth has a texture or a colour."""
    (tmp_path / "dress.obj").write_text("mtllib ./dress.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n")
    if material is not None:
        (tmp_path / "dress.mtl").write_text(material)
    model = {"plugin": "mesh", "file": "dress.obj", "texture": fields.get("texture")}
    objects = [{"name": "dress", "model": model, "colour": fields.get("colour")}]
    found = scene_warnings(load(HANGING | {"objects": objects}, {}, "dress", SceneFiles(tmp_path)))
    assert [text.partition("name the image ")[2].partition(", and")[0] for text in found] == named
    assert all(text.startswith("objects[0].model: ") for text in found)
