"""Pictures of a run of dye: what is drawn is what was recorded, as the scene or the command line says."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dye_scene import write_scene
from numpy.typing import NDArray
from PIL import Image
from scenes import write_scene as write_cloth

import nuno
from nuno.cli import main
from nuno.exports.dyed_pictures import _bar, _time, caption, choose_amounts, dyed_pictures, find_amounts
from nuno.plugin_contract import registry
from nuno.scene.files import SceneFiles
from nuno_dye.picture import YarnsPicture
from nuno_schemas.dyeing import DyeColour
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import CONCENTRATION
from nuno_schemas.pictures import Layers, Window
from nuno_schemas.plugin import Config

NY, NX = 9, 11


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dyed")
    return nuno.run(write_scene(folder), record=folder / "run.mcap").path


def read(path: Path) -> NDArray[np.uint8]:
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def export(recording: Path, *arguments: str) -> NDArray[np.uint8]:
    target = recording.with_name("out.png")
    assert main(["export", str(recording), "--png", str(target), *arguments]) == 0
    return read(target)


def drawn(recording: Path, frame: int, seen: str, scale: int = 16, colour: DyeColour | None = None) -> Any:
    """The recorded amounts of a frame, drawn by the plugin itself."""
    with nuno.open(recording) as opened:
        cloth, _ = opened.arrays(opened.last("dye/cloth"))
        found = [opened.arrays(message)[0] for message in opened.messages(["dye/concentration"])][frame]
    amounts = {"all": found["phi"] + found["fixed"], "fixed": found["fixed"], "mobile": found["phi"]}[seen]
    plugin, window = YarnsPicture(), Window(0, NY, 0, NX)
    layers = Layers(cloth["fibre"], cloth["up"])
    prepared = plugin.prepare(plugin.Config(), SceneFiles(Path()), layers, [colour or DyeColour()], window, scale)
    return plugin.draw(prepared, amounts)


@pytest.mark.parametrize("view", ["all", "fixed", "mobile"])
@pytest.mark.parametrize("frame", [0, 4, 10])
def test_a_picture_is_of_the_recorded_amounts(recording: Path, frame: int, view: str) -> None:
    found = export(recording, "--frame", str(frame), "--view", view)
    assert np.array_equal(found[: 16 * NY], drawn(recording, frame, view))


def test_the_last_frame_and_the_scene_s_own_view_are_what_is_not_asked_for(recording: Path) -> None:
    assert np.array_equal(export(recording)[: 16 * NY], drawn(recording, 10, "all"))
    assert np.array_equal(export(recording, "--scale", "3"), drawn(recording, 10, "all", 3)), "no room for a text"


def test_a_crop_is_cut_from_the_picture(recording: Path) -> None:
    whole = drawn(recording, 10, "all", 20)
    found = export(recording, "--scale", "20", "--crop", "0.1mm", "0.05mm", "0.4mm", "0.3mm")
    assert np.array_equal(found, whole[20:120, 40:160])


@pytest.mark.parametrize("dye", ["0", "blue"])
def test_colours_can_be_others_afterwards(recording: Path, dye: str) -> None:
    colour = f"dye.dyes.{dye}.colour"
    found = export(recording, "--set", f"{colour}.full=0.1", "--set", f"{colour}.dark='#400000'")
    assert np.array_equal(found[: 16 * NY], drawn(recording, 10, "all", colour=DyeColour(full=0.1, dark="#400000")))


def test_a_run_ends_with_the_scene_s_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scene(tmp_path, picture={"view": "fixed", "scale": 4})
    assert main(["run", str(scene), "--record", str(tmp_path / "run.mcap")]) == 0
    assert str(tmp_path / "run.png") in capsys.readouterr().out
    assert np.array_equal(read(tmp_path / "run.png"), drawn(tmp_path / "run.mcap", 10, "fixed", 4))


def test_an_animation_has_a_picture_of_every_frame_between_its_ends(recording: Path, tmp_path: Path) -> None:
    for arguments, number in ((), 11), (("--start", "3.6", "--end", "9"), 4), (("--end", "0"), 1):
        target = tmp_path / "out.gif"
        assert main(["export", str(recording), "--gif", str(target), *arguments]) == 0
        with Image.open(target) as image:
            assert image.n_frames == number  # type: ignore[attr-defined]
            assert image.size[0] == 16 * NX
            shown = image.info["duration"] * number / 1000.0
        # All of it is watched for five seconds, but no picture longer than one.
        assert shown == pytest.approx(min(5.0, number), rel=0.2)
    assert main(["export", str(recording), "--gif", str(target), "--fps", "50"]) == 0
    with Image.open(target) as image:
        assert image.info["duration"] == 20


def test_the_end_of_an_animation_may_be_the_time_of_a_frame() -> None:
    """Times are recorded in nanoseconds, of which 3e7 times 1e-9 is more than 0.03."""
    frames: Any = SimpleNamespace(
        path="", marks=lambda: {k * 10_000_000: (k, "") for k in range(2000)}, counts={CONCENTRATION.name: 2000}
    )
    for k in range(0, 2000, 3):
        assert choose_amounts(frames, k / 100, k / 100) == [k / 100]


def test_an_mp4_has_even_sides(recording: Path, tmp_path: Path) -> None:
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="needs nuno[video]")
    assert main(["export", str(recording), "--mp4", str(tmp_path / "out.mp4"), "--scale", "5"]) == 0
    frames = imageio_ffmpeg.read_frames(str(tmp_path / "out.mp4"))
    assert next(frames)["size"] == (56, 46)
    assert len(list(frames)) == 11


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--obj", "out.obj"], ["--obj", "without a shape", "--png"]),
        (["--glb", "out.glb"], ["--glb", "without a shape"]),
        (["--png", "out.png", "--size", "60x40"], ["--size", "recording is of dye", "--scale N"]),
        (["--png", "out.png", "--colour", "stretch"], ["--colour", "recording is of dye", "--view"]),
        (["--png", "out.png", "--scale", "0"], ["scale", "cannot have this scale", "11 x 9 cells"]),
        (["--png", "out.png", "--scale", "100000"], ["scale", "cannot have this scale", "67108864"]),
        (["--png", "out.png", "--frame", "11"], ["--frame", "no such frame", "frames 0 to 10"]),
        (["--gif", "out.gif", "--start", "20"], ["nothing to show between", "0 to 18 s"]),
        (["--png", "out.png", "--crop", "1cm", "0", "2cm", "1"], ["crop", "holds no cell", "0.00055 m x 0.00045 m"]),
        (["--png", "out.png", "--crop", "2mm", "0", "1mm", "1"], ["--crop", "nothing between the corners"]),
        (["--png", "out.png", "--crop", "2mg", "0", "1mm", "1"], ["--crop", "--crop 2mm 2mm 4mm 3mm"]),
        (["--png", "out.png", "--set", "dye.solver.dt=1"], ["--set", "no matter of pictures"]),
        (["--png", "out.png", "--set", "dye.picture.grund='#ffffff'"], ["dye.picture.grund", "did you mean 'ground'"]),
        (["--png", "out.jpg"], ["the name must end in .png"]),
        (["--gif", "out.gif", "--fps", "0"], ["--fps", "1 to 240"]),
        (["--rrd", "out.mcap"], ["--rrd", "must end in .rrd"]),
    ],
)
def test_what_makes_no_sense_is_refused_before_any_file_is_written(
    arguments: list[str], words: list[str], recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(["export", str(recording), "--npz", "out.npz", "--csv", "out.csv", *arguments]) == 2
    said = capsys.readouterr().err
    assert all(word in said for word in words), said
    assert list(tmp_path.iterdir()) == []


def test_moving_cloth_has_no_view_of_dye(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = nuno.run(write_cloth(tmp_path), "duration=0.05", record=tmp_path / "run.mcap").path
    for flag in (["--view", "fixed"], ["--scale", "0"], ["--crop", "0", "0", "1", "1"]):
        assert main(["export", str(path), "--png", str(tmp_path / "out.png"), *flag]) == 2
        assert f"{flag[0]}: for pictures of dyed cloth" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("picture", "field", "words"),
    [
        ({"scale": 2.5}, "dye.picture.scale", "auto"),
        ({"view": "fixd"}, "dye.picture.view", "did you mean 'fixed'"),
        ({"texture": {"relif": 1}}, "dye.picture.texture.relif", "did you mean 'relief'"),
        ({"crop": {"low": [0, 0], "high": ["1 mm", 0]}}, "dye.picture.crop.high", "nothing between the corners"),
        ({"crop": {"low": ["1 cm", 0], "high": ["2 cm", 1]}}, "dye.picture.crop", "holds no cell"),
        ({"scale": 256, "crop": {"low": ["1 cm", 0], "high": ["2 cm", 1]}}, "dye.picture.crop", "holds no cell"),
        ({"plugin": "yarn"}, "dye.picture.plugin", "did you mean 'yarns'"),
    ],
)
def test_a_picture_that_cannot_be_drawn_is_refused_before_the_run(
    picture: dict[str, Any], field: str, words: str, tmp_path: Path
) -> None:
    scene = write_scene(tmp_path, picture=picture)
    with pytest.raises(BadInput) as refused:
        nuno.run(scene, record=tmp_path / "run.mcap")
    assert "scene.yaml:" in str(refused.value) and f"{field}: " in str(refused.value)
    assert words in str(refused.value)


def test_a_flat_cloth_is_refused_by_another_renderer_before_it_is_looked_for(
    recording: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("nuno_render.paths_of_light.Paths.require", lambda self: pytest.fail("asked for Mitsuba"))
    assert main(["export", str(recording), "--png", str(recording.with_name("no.png")), "--renderer", "paths"]) == 2
    assert "--renderer" in capsys.readouterr().err and not recording.with_name("no.png").exists()


def test_the_bar_of_a_caption_is_as_long_as_it_says() -> None:
    for pixel in np.geomspace(1e-7, 1e-2, 23):
        length, label = _bar(float(pixel), 800)
        number, unit = label.split()
        assert length * pixel == pytest.approx(
            float(number) * {"um": 1e-6, "mm": 1e-3, "m": 1.0}[unit], abs=0.51 * pixel
        )
        assert 800 * 0.2 * 0.39 < length <= 800 * 0.2
    narrow = np.zeros((20, 40, 3), np.uint8)
    assert caption(narrow, "a name and a time", 1e-5) is narrow


@pytest.mark.full
def test_the_recording_of_a_photograph_needs_no_file_beside_it(tmp_path: Path) -> None:
    """The scene's photograph, and the masks that it names, travel in the recording."""
    rng, warp = np.random.default_rng(2), np.indices((24, 32)).sum(axis=0) // 4 % 2 == 0
    for name, values in (
        ("cloth.png", rng.integers(80, 250, (24, 32, 3), np.uint8)),
        ("warp.png", warp.astype(np.uint8) * 255),
        ("weft.png", (~warp).astype(np.uint8) * 255),
    ):
        Image.fromarray(values).save(tmp_path / name)
    cloth = {
        "plugin": "photograph",
        "file": "cloth.png",
        "masks": {"warp": "warp.png", "weft": "weft.png"},
        "pixels": 2,
        "tau3": {"I": 0.1, "II": 0.1},
        "supply": [{"kind": "drop", "place": ["0.4 mm", "0.3 mm"], "diameter": "0.2 mm"}],
    }
    scene = write_scene(tmp_path, cloth=cloth, picture={"plugin": "photograph", "scale": 2})
    path = nuno.run(scene, record=tmp_path / "run.mcap").path
    before = export(path, "--frame", "0")
    photograph = read(tmp_path / "cloth.png")
    for file in tmp_path.glob("*.png"):
        file.unlink()
    assert np.array_equal(export(path, "--frame", "0"), before)
    dyed = (before != photograph).any(axis=2)
    assert dyed.any() and not dyed[:, :6].any() and not dyed[:, 28:].any()
    assert main(["verify", str(path)]) == 0
    assert main(["export", str(path), "--rrd", str(tmp_path / "run.rrd")]) == 0


def test_the_colours_of_a_draft_s_yarns_are_recorded(tmp_path: Path) -> None:
    """Two red ends and two white picks, plainly woven: each shows where it is above."""
    wif = "[WIF]\n[WEAVING]\nShafts=2\n[WARP]\nThreads=2\nColor=1\n[WEFT]\nThreads=2\n[COLOR TABLE]\n1=255,0,0\n"
    (tmp_path / "draft.wif").write_text(wif + "[THREADING]\n1=1\n2=2\n[LIFTPLAN]\n1=1\n2=2\n")
    cloth = {"plugin": "woven", "weave": {"plugin": "wif", "file": "draft.wif"}, "tau3": {"I": 1, "II": 1, "III": 1}}
    scene = write_scene(tmp_path, cloth=cloth, picture={"texture": None})
    path = nuno.run(scene, record=tmp_path / "run.mcap").path
    seen = export(path, "--scale", "1")
    assert seen.shape == (20, 20, 3)
    assert [seen[y, x].tolist() for y in (5, 15) for x in (5, 15)] == [
        [255, 0, 0], [255, 255, 255], [255, 255, 255], [255, 0, 0],
    ]  # fmt: skip


def test_a_caption_tells_the_time_of_the_dyeing(tmp_path: Path) -> None:
    scene = write_scene(tmp_path, speed="1 min/s", solver="explicit", picture={"scale": 40})
    path = nuno.run(scene, record=tmp_path / "run.mcap").path
    with nuno.open(path) as recording, dyed_pictures(recording) as pictures:
        pictures.draw(find_amounts(recording, None))
        assert pictures.painter.time == pytest.approx(18 * 60.0)
    assert [_time(t) for t in (0.0, 59.0, 1080.0, 5400.0, 172_800.0)] == ["0 s", "59 s", "18 min", "1.5 h", "2 d"]


class StripesConfig(Config):
    """Of a plugin from elsewhere."""

    level: int = 7


class Stripes:
    """Draws how many dyes there are, and how much of them; as a package of somebody else's would."""

    name = "stripes"
    Config = StripesConfig

    def prepare(self, config: Any, files: Any, layers: Layers, dyes: Any, window: Window, scale: int) -> Any:
        return config.level, len(dyes), scale * (window.bottom - window.top), scale * (window.right - window.left)

    def draw(self, prepared: Any, amounts: NDArray[np.float32]) -> NDArray[np.uint8]:
        level, dyes, height, width = prepared
        picture = np.full((height, width, 3), level, np.uint8)
        picture[..., 1], picture[..., 2] = dyes, round(float(amounts.sum()))
        return picture


def test_a_plugin_from_elsewhere_draws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    claims, group = registry.claims, "nuno.dye_pictures"
    point = EntryPoint("stripes", f"{__name__}:Stripes", group)
    monkeypatch.setattr(
        registry, "claims", lambda asked: claims(asked) | ({"stripes": [point]} if asked == group else {})
    )
    scene = write_scene(tmp_path, picture={"plugin": "stripes", "level": 9, "scale": 2})
    path = nuno.run(scene, record=tmp_path / "run.mcap").path
    with nuno.open(path) as recording:
        last = recording.last("dye/concentration")
        amounts, _ = recording.arrays(last)
        assert recording.metadata["plugins"][f"{group}/stripes"] == __name__
    total = round(float((amounts["phi"] + amounts["fixed"]).sum()))
    picture = export(path)
    assert picture.shape == (2 * NY, 2 * NX, 3) and (picture == [9, 1, total]).all()
