"""Recordings in the page of `nuno studio`, in a browser: replayed, plotted, gone on with, and compared."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dye_scene
import garment_scene
import numpy as np
import pytest
import yaml
from browser import Page
from numpy.typing import NDArray
from PIL import Image
from recorded_sheet import Sheet, write
from studio_desk import NEEDS_BROWSER, SHEET, look, studio, write_sheet

import nuno
from nuno.exports.dyed_pictures import read_dyed_object
from nuno.recording.reader import open_recording
from nuno.studio.server import Server

pytestmark = [pytest.mark.full, NEEDS_BROWSER]
PATIENCE = 300.0
"""The first run on a machine compiles kernels [s]."""
FOLDER = Path("recordings")
RUN = "nuno.run"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With runs of a sheet: one, a longer one in denser air, one of another rate, one of another mesh; half a file."""
    folder = tmp_path_factory.mktemp("studio")
    scene = write_sheet(folder)
    (folder / FOLDER).mkdir()
    changes: dict[str, dict[str, Any]] = {
        "a": {}, "b": {"damping": 0.9, "duration": "0.5 s"}, "rate": {"frame_rate": "40 Hz"},
        "fine": {"objects.0.model.resolution": [13, 13]},
    }  # fmt: skip
    for name, change in changes.items():
        nuno.run(scene, change, record=folder / FOLDER / f"{name}.mcap")
    write(long := folder / "long.mcap", Sheet(60, 50), frames=240, checkpoint_every=1000, scene=yaml.safe_load(SHEET))
    data = long.read_bytes()
    (folder / FOLDER / "cut.mcap.part").write_bytes(data[: len(data) // 2])
    return folder


@pytest.fixture
def server(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    monkeypatch.chdir(folder)
    with studio() as (_, one):
        yield one


def look_at(page: Page, server: Server, name: str) -> None:
    look(page, server, f"#run={name}", f"{RUN}?.screen?.frame && document.querySelector('.plot .cursor')")


def frames(name: str) -> list[NDArray[np.float64]]:
    with open_recording(FOLDER / name) as recording:
        return [frame.x for frame in recording.frames()]


def shown(page: Page, screen: str = f"{RUN}.screen") -> NDArray[np.float64]:
    """(n, 3) [m] where the page has the cloth."""
    x = np.array(page.value(f"[...{screen}.stage.cloth.x]")).reshape(-1, 3)
    return np.asarray(x + np.array(page.value(f"{screen}.frame.origin")))


def at(page: Page, index: int) -> None:
    """Wait until a frame is shown."""
    page.wait(f"{RUN}.player.index === {index} && ({RUN}.screen ?? {RUN}.screens[0]).index === {index}")


def plot(page: Page, title: str) -> list[str]:
    """What stands beside the lines of a plot at the time that is shown."""
    found: list[str] = page.value(
        f"[...document.querySelectorAll('.plot')].filter((p) => p.querySelector('b').textContent === {title!r})"
        ".flatMap((p) => [...p.querySelectorAll('output')].map((o) => o.textContent))"
    )
    return found


def read(page: Page, address: str) -> bytes:
    """What the page gets from an address."""
    got = f"fetch({address!r}).then((a) => a.arrayBuffer()).then((b) => [...new Uint8Array(b)])"
    return bytes(page.value(got))


def focus(page: Page, name: str) -> None:
    page.value(f"document.getElementById({name!r}).focus()")


def test_a_recording_is_replayed_by_keyboard(page: Page, server: Server) -> None:
    look_at(page, server, "a.mcap")
    x = frames("a.mcap")
    at(page, 0)
    assert np.array_equal(shown(page), x[0])
    focus(page, "time-line")
    for key, index in (("ArrowRight", 1), ("ArrowRight", 2), ("End", 20), ("ArrowLeft", 19), (",", 18), (".", 19)):
        page.press(key)
        at(page, index)
        assert np.array_equal(shown(page), x[index])
    page.press("Home")
    at(page, 0)
    page.press(" ")
    page.wait(f"{RUN}.player.playing")
    at(page, 20)
    page.wait(f"!{RUN}.player.playing && document.getElementById('play').textContent === 'Play'")
    assert page.value("document.getElementById('time-line').getAttribute('aria-valuetext')") == "0.400 of 0.400 s"


def test_it_plays_as_fast_as_is_asked_for(page: Page, server: Server) -> None:
    look_at(page, server, "a.mcap")
    page.value("window.requestAnimationFrame = () => {}")  # the clock's ticks are this test's
    page.click("play")
    for speed, seconds, index in (("0.25", 0.8, 10), ("1", 0.1, 15), ("0.05", 0.4, 16), ("4", 0.5, 20)):
        page.value(f"document.getElementById('speed').value = '{speed}'")
        page.value(f"{RUN}.player.tick({RUN}.player.then + {1000.0 * seconds + 1e-3})")
        assert page.value(f"{RUN}.player.index") == page.value(f"{RUN}.screen.index") == index
    assert page.value("document.getElementById('play').textContent") == "Play"


def test_plots_have_the_report_s_series_and_lead_to_their_times(page: Page, server: Server) -> None:
    look_at(page, server, "a.mcap")
    with open_recording(FOLDER / "a.mcap") as recording:
        series = recording.series()
    page.value(f"{RUN}.player.go(12)")
    at(page, 12)
    assert [float(text) for text in plot(page, "Largest stretch")] == [
        pytest.approx(100.0 * series["stretch"][12], rel=1e-3)
    ]
    kinetic = page.value(f"{RUN}.drawn[0].lines.find((line) => line.name === 'kinetic').values")
    assert kinetic == series["energy_kinetic"].tolist()
    x, y = page.value(
        "(() => { const p = nuno.run.drawn[0], r = p.svg.getBoundingClientRect(); p.svg.scrollIntoView(); "
        "const s = p.svg.getBoundingClientRect(); return [s.left + p.x(0.2), s.top + 40]; })()"
    )
    page.drag([(x, y), (x + 1, y)])
    at(page, 10)
    assert page.value("document.querySelector('.plot .cursor').getAttribute('d')") != ""


def test_stretch_and_cloth_that_is_cut_short_are_shown(page: Page, server: Server) -> None:
    look_at(page, server, "a.mcap")
    focus(page, "film")
    page.press("s")
    page.wait("!document.getElementById('stretch-scale').hidden")
    look_at(page, server, "cut.mcap.part")
    last = page.value(f"{RUN}.film.times.length") - 1
    assert 0 < last < 239 and "INCOMPLETE" in page.value("document.getElementById('film-said').textContent")
    focus(page, "time-line")
    page.press("End")
    at(page, last)
    assert np.allclose(shown(page), Sheet(60, 50).x(last / 50.0), atol=1e-6)


def test_two_runs_are_chosen_and_compared_to_the_numbers_of_numpy(page: Page, server: Server) -> None:
    look(page, server, "#runs", "document.querySelectorAll('tbody input').length > 1")
    for name in ("a.mcap", "b.mcap"):
        page.value(f"document.querySelector('tbody input[value=\"{name}\"]').focus()")
        page.press(" ")
    focus(page, "compare")
    page.press("Enter")
    page.wait(f"{RUN}?.done === true")
    names = page.value(f"{RUN}.names")
    assert sorted(names) == ["a.mcap", "b.mcap"]
    one, two = frames(names[0]), frames(names[1])
    apart = [np.linalg.norm(x - y, axis=1) for x, y in zip(one, two, strict=False)]
    assert page.value(f"{RUN}.far.largest") == [float(d.max()) for d in apart]
    assert page.value(f"{RUN}.far.rms") == [float(np.sqrt((d**2).mean())) for d in apart]
    focus(page, "time-line")
    page.press("End")
    at(page, 20)
    for i, x in enumerate((one, two)):
        assert np.array_equal(shown(page, f"{RUN}.screens[{i}]"), x[20])
        far = np.array(page.value(f"[...{RUN}.screens[{i}].frame.far]"))
        assert np.array_equal(far, apart[20].astype(np.float32))
    said = page.value("document.getElementById('far-said').textContent").replace(",", "").split()
    assert float(said[1]) == pytest.approx(1e3 * apart[20].max(), rel=1e-3)
    assert float(said[4]) == pytest.approx(1e3 * np.sqrt((apart[20] ** 2).mean()), rel=1e-3)
    most = float(page.value("document.getElementById('far-scale').lastChild.textContent").split()[0])
    assert most == pytest.approx(1e3 * max(d.max() for d in apart), rel=1e-3)
    assert "both have frames until 0.4 s" in page.value("document.getElementById('film-said').textContent")
    # One camera: what turns one turns the other.
    x, y, w, h = page.value(
        "(({x, y, width, height}) => [x, y, width, height])(document.getElementById('film-0').getBoundingClientRect())"
    )
    page.drag([(x + w / 2, y + h / 2), (x + w / 2 + 60, y + h / 2)])
    assert page.value(f"{RUN}.screens[0].stage.camera === {RUN}.screens[1].stage.camera")
    page.wait(f"!{RUN}.screens[1].stage.asked")


def test_another_rate_is_interpolated_and_another_mesh_is_not_compared_by_vertices(page: Page, server: Server) -> None:
    look(page, server, "#compare=a.mcap,rate.mcap", f"{RUN}?.done")
    assert "positions are interpolated linearly" in page.value("document.getElementById('film-said').textContent")
    page.value(f"{RUN}.player.go(1)")
    at(page, 1)
    page.wait("document.getElementById('far-said').textContent.endsWith('interpolated')")
    page.value(f"{RUN}.player.go(4)")  # 0.1 s, of which both have a frame
    at(page, 4)
    page.wait("!document.getElementById('far-said').textContent.includes('interpolated')")
    assert page.value(f"{RUN}.apart.lines[0].t") == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4])
    look(page, server, "#compare=a.mcap,fine.mcap", f"{RUN}?.done")
    assert "cannot be compared vertex by vertex" in page.value("document.getElementById('far-said').textContent")
    titles = page.value("[...document.querySelectorAll('.plot:not([hidden]) b')].map((b) => b.textContent)")
    assert "Distance of the same vertices" not in titles and "Energy" in titles


def test_a_run_is_gone_on_with_or_it_is_said_why_not(page: Page, server: Server) -> None:
    look_at(page, server, "cut.mcap.part")
    page.click("go-on")
    page.wait("!document.getElementById('toast').hidden")
    said = page.value("document.getElementById('toast').textContent")
    assert said.startswith("The recording holds no checkpoint") and "--set record.checkpoint_every=0.1s" in said
    look_at(page, server, "a.mcap")
    focus(page, "go-on")
    page.press("Enter")
    page.wait("document.getElementById('asked').open")
    assert page.value("document.getElementById('asked-input').value") == "0.8 s"
    page.value("document.getElementById('asked-input').select()")
    page.type("0.6 s")
    page.press("Enter")
    page.wait("nuno.dock.now.state === 'over'", PATIENCE)
    assert page.value("nuno.dock.now.frame") == 30
    now = page.value("nuno.dock.now.recording")
    assert np.array_equal(frames(now)[:21], frames("a.mcap"))
    page.wait("document.querySelector('#run-said img')?.complete", PATIENCE)


def test_a_picture_is_of_the_frame_and_from_the_camera_of_the_page(page: Page, server: Server) -> None:
    """The cloth, in red, covers the same pixels."""
    nuno.run("sheet.yaml", {"objects.0.colour": "#c01818"}, record=FOLDER / "red.mcap")
    look_at(page, server, "red.mcap")
    page.value(f"{RUN}.player.go(17)")
    at(page, 17)
    page.click("from-side")
    page.value(f"Object.assign({RUN}.screen.stage.camera, {{ azimuth: 0.7, elevation: 0.35 }})")
    page.value(f"{RUN}.screen.stage.camera.zoom(1.4)")
    page.value(f"{RUN}.screen.stage.camera.changed()")
    page.wait(f"!{RUN}.screen.stage.asked")
    box = "(({x, y, width, height}) => [x, y, width, height])(document.getElementById('film').getBoundingClientRect())"
    x, y, w, h = map(round, page.value(box))
    seen = page.picture()[y : y + h, x : x + w].astype(int)
    page.value(f"document.getElementById('export-size').value = '{w}x{h}'")
    page.click("export-png")
    page.wait("Boolean(document.querySelector('#exported a'))", PATIENCE)
    data = read(page, page.value("document.querySelector('#exported a').href"))
    drawn = np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)
    assert drawn.shape == seen.shape
    red = [(one[..., 0] - one[..., 1] > 40)[50:] for one in (seen, drawn)]  # below the buttons
    assert red[0].sum() > 2000 and (red[0] & red[1]).sum() > 0.95 * (red[0] | red[1]).sum()
    page.value("document.getElementById('export-size').value = '9x9'")
    page.click("export-png")
    page.wait("document.querySelector('#exported pre')?.textContent.includes('16 to 8192')", PATIENCE)


def test_the_dye_of_a_garment_is_on_it_over_time(page: Page, server: Server) -> None:
    """What is printed is the texture of its pictures, and another at the end than at the start."""
    (folder := Path("garment")).mkdir()
    nuno.run(garment_scene.write(folder), record=FOLDER / "garment.mcap")
    look_at(page, server, "garment.mcap")
    page.wait(f"{RUN}.screen.stage.worn?.corners.length === {3 * 50}", PATIENCE)  # of two sheets only the dyed one's
    film, times = page.value(f"[{RUN}.film.film, {RUN}.film.times]")
    with open_recording(FOLDER / "garment.mcap") as recording:
        dyed = read_dyed_object(recording)
        assert dyed is not None
        textures = [dyed.texture(t) for t in (times[0], times[-1])]
    for index, texture in zip((0, len(times) - 1), textures, strict=True):
        found = read(page, f"dyed?film={film}&frame={index}")
        assert np.array_equal(np.asarray(Image.open(io.BytesIO(found)).convert("RGB")), texture)
    assert not np.array_equal(*textures)
    focus(page, "time-line")
    page.press("End")
    page.wait(f"{RUN}.screen.dressed === {len(times) - 1} && !{RUN}.screen.dressing")


def test_dyed_cloth_is_shown_by_its_pictures(page: Page, server: Server) -> None:
    nuno.run(dye_scene.write_scene(Path()), record=FOLDER / "dye.mcap")
    look(page, server, "#run=dye.mcap", "document.getElementById('dyed')?.naturalWidth > 0")
    before = page.value("document.getElementById('dyed').src")
    focus(page, "time-line")
    page.press("End")
    page.wait("document.getElementById('dyed').complete && document.getElementById('dyed').src.endsWith('frame=10')")
    assert page.value("document.getElementById('dyed').naturalWidth") > 0 and before.endswith("frame=0")
