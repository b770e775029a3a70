"""Recordings as the page of `nuno studio` replays them: the bytes that it gets are what was recorded."""

from __future__ import annotations

import io
from pathlib import Path

import dye_scene
import numpy as np
import pytest
from live_run import PATIENCE, wait_until
from PIL import Image
from recorded_sheet import Sheet, items, metadata, write
from replays import FOLDER, both, frames, unpack, waving
from studio_desk import FILE, ask, write_sheet

import nuno
from nuno.exports.cloth import INSET, body_vertices, read_bodies
from nuno.recording.reader import END, open_recording
from nuno.recording.writer import RecordingWriter, part_of
from nuno.studio.desk import Desk
from nuno.studio.screen import MOST_FILMS
from nuno.studio.server import Refused
from nuno_schemas.errors import BadInput
from nuno_schemas.messages import FABRIC


@pytest.fixture(autouse=True)
def folder(desk: Desk) -> None:
    """In the desk's."""
    FOLDER.mkdir()


def test_frames_are_the_bytes_that_were_recorded(desk: Desk) -> None:
    write(path := FOLDER / "wave.mcap", Sheet())
    found = ask(desk, "replay", recording=path.name)
    head, arrays = frames(desk, found["film"], 3, 5)
    with open_recording(path) as recording:
        recorded = list(recording.frames())
        bodies = read_bodies(recording, INSET)
        assert found["times"] == [frame.t for frame in recorded]
        assert found["numbers"] == [frame.number for frame in recorded] and found["says"] == []
        for i, frame in enumerate(recorded[3:8]):
            x = (arrays[f"x{i}"].reshape(-1, 3).astype(np.float64)) + head["origin"]
            assert np.array_equal(x, frame.x)  # the origins are the same: not a bit is lost
            body = arrays[f"body{i}"].reshape(-1, 3) + head["origin"]
            assert np.allclose(body, body_vertices(recording, bodies, frame.t), atol=1e-6)
    assert [one["frame"] for one in head["frames"]] == [3, 4, 5, 6, 7]
    told, shape = unpack(desk.screen.shape({"film": [found["film"]], "shape": ["0"]}))
    assert np.array_equal(shape["faces"].reshape(-1, 3), Sheet().faces) and told["pieces"][0]["name"] == "cloth"
    for wrong in (
        {"first": "20"},
        {"first": "-1"},
        {"count": "0"},
        {"count": "65"},
        {"first": "--5"},
        {"film": "1-2:wave.mcap"},
    ):
        query = {"film": found["film"], "first": "0", "count": "1"} | wrong
        with pytest.raises(Refused):
            desk.screen.frames({name: [value] for name, value in query.items()})


def test_cloth_that_changes_has_its_triangles_of_each_time(desk: Desk) -> None:
    before, after = Sheet(6, 5), Sheet(8, 5)
    writer = RecordingWriter(FOLDER / "finer.mcap", metadata(), {})
    late = [message for message in items(after, 20) if message[1].t >= 0.2]
    (fabric,) = [message for message in items(after, 1) if message[0] == FABRIC.name]
    changed = fabric[0], fabric[1].model_copy(update={"t": 0.2, "seq": 1}), fabric[2]
    for topic, header, payload in [*(one for one in items(before, 10) if one[1].t < 0.2), changed, *late]:
        if "event" not in topic and "report" not in topic:
            writer.write(topic, header, payload)
    writer.finish({END: {"state": "done", "complete": "true", "missing": "{}"}})
    found = ask(desk, "replay", recording="finer.mcap")
    assert found["shapes"] == 2
    head, arrays = frames(desk, found["film"], 8, 4)
    assert [one["shape"] for one in head["frames"]] == [0, 0, 1, 1]
    assert [arrays[f"x{i}"].size // 3 for i in range(4)] == [before.number, before.number, after.number, after.number]
    for number, sheet in enumerate((before, after)):
        _, shape = unpack(desk.screen.shape({"film": [found["film"]], "shape": [str(number)]}))
        assert np.array_equal(shape["faces"].reshape(-1, 3), sheet.faces)
    # Beside a run that keeps its cloth: vertices are compared as long as they are the same ones.
    waving(FOLDER / "same.mcap")
    _, apart = both(desk, "finer.mcap", "same.mcap")
    assert apart["largest"][:10] == [0.0] * 10 and apart["largest"][10:] == [None] * 10


def test_what_is_cut_or_damaged_is_shown_as_far_as_it_goes(desk: Desk) -> None:
    write(path := FOLDER / "long.mcap", Sheet(60, 50), frames=240)
    data = path.read_bytes()
    part_of(FOLDER / "cut.mcap").write_bytes(data[: len(data) * 2 // 3])
    with open_recording(path) as recording:
        chunk = recording.layout.chunks[-2]
        end = chunk.message_start_time
    spoilt = bytearray(data)
    spoilt[chunk.chunk_start_offset + 2000] ^= 1
    (FOLDER / "spoilt.mcap").write_bytes(bytes(spoilt))
    cut = ask(desk, "replay", recording="cut.mcap.part")
    assert 0 < len(cut["times"]) < 240 and cut["says"][0].startswith("INCOMPLETE: cut short at")
    found = ask(desk, "replay", recording="spoilt.mcap")
    times = found["times"]  # of the frame at `end` the state may stand in the chunk before
    assert times == [i / 50.0 for i in range(len(times))] and round(times[-1] * 1e9) in (end, end - 20_000_000)
    assert "INCOMPLETE: damaged at byte" in found["says"][0]
    for one in (cut, found):
        last = len(one["times"]) - 1
        head, arrays = frames(desk, one["film"], last, 1)
        x = arrays["x0"].reshape(-1, 3) + np.array(head["origin"])
        assert np.allclose(x, Sheet(60, 50).x(one["times"][last]), atol=1e-6)
        assert ask(desk, "plots", film=one["film"])["t"][:2] == [0.0, 0.02]


def test_plots_are_the_series_in_units_that_people_read(desk: Desk) -> None:
    write(path := FOLDER / "wave.mcap", Sheet())
    found = ask(desk, "plots", film=ask(desk, "replay", recording=path.name)["film"])
    plots = {one["name"]: one for one in found["plots"]}
    with open_recording(path) as recording:
        series = recording.series()
    assert found["t"] == series["t"].tolist()
    energy = plots["energy"]["lines"]
    assert energy["kinetic"] == series["energy_kinetic"].tolist()
    assert energy["total"] == (series["energy_kinetic"] + series["energy_springs"]).tolist()
    assert plots["stretch"]["unit"] == "%" and plots["stretch"]["lines"][""] == (100.0 * series["stretch"]).tolist()
    assert plots["penetration"]["lines"]["largest"] == (1e3 * series["depth"]).tolist()
    speed = plots["speed"]["lines"][""]
    assert speed[0] is None and np.allclose(speed[1:], 0.02 / 0.001)


def test_those_that_were_wanted_last_stay_open(desk: Desk) -> None:
    for i in range(MOST_FILMS + 2):
        waving(FOLDER / f"{i}.mcap", frames=3)
    films = [ask(desk, "replay", recording=f"{i}.mcap")["film"] for i in range(MOST_FILMS)]
    first = desk.screen._film(films[0])
    ask(desk, "replay", recording=f"{MOST_FILMS}.mcap")
    assert list(desk.screen._films)[:-1] == [*films[2:], films[0]]
    desk.screen.forget("0.mcap")
    with pytest.raises(BadInput, match="closed meanwhile"):
        first.stills(first.times)
    # Opening the second of two closes another one than the first.
    pair, _ = both(desk, "2.mcap", f"{MOST_FILMS + 1}.mcap")
    assert set(pair) <= set(desk.screen._films)


def test_a_recording_without_a_scene_is_not_gone_on_with(desk: Desk) -> None:
    write(FOLDER / "none.mcap", Sheet(), scene={"name": "waving"})
    for name in ("resumable", "resume"):
        with pytest.raises(BadInput) as refused:
            ask(desk, name, recording="none.mcap", duration="1 s")
        assert "the scene in recordings/none.mcap" in str(refused.value)


@pytest.mark.full
def test_a_run_goes_on_from_its_last_checkpoint_to_the_bits_of_a_longer_one(desk: Desk) -> None:
    scene = write_sheet(Path())
    nuno.run(scene, record=FOLDER / "short.mcap")
    assert ask(desk, "resumable", recording="short.mcap") == {"at": 0.4, "end": 0.4}
    with pytest.raises(BadInput, match="has come to the end of its scene"):
        ask(desk, "resume", recording="short.mcap", duration="0.4 s")
    ask(desk, "resume", recording="short.mcap", duration="0.6 s")
    wait_until(lambda: ask(desk, "now")["state"] in ("over", "failed", "refused", "stopped"), PATIENCE)
    now = ask(desk, "now")
    assert (now["state"], now["frame"]) == ("over", 30), now["said"]
    with nuno.open(FOLDER / now["recording"]) as recording:
        digests = [frame.digest for frame in recording.frames()]
    assert digests[-1] == nuno.run(FILE, duration="0.6 s").digest and len(digests) == 31


def test_dyed_cloth_is_shown_as_its_pictures_are_exported(desk: Desk) -> None:
    nuno.run(dye_scene.write_scene(Path()), record=FOLDER / "dye.mcap")
    found = ask(desk, "replay", recording="dye.mcap")
    assert found["dyed"] and not found["moves"]
    kind, png = desk.screen.dyed({"film": [found["film"]], "frame": [str(len(found["times"]) - 1)]})
    nuno.export(FOLDER / "dye.mcap", png="last.png")
    with Image.open(io.BytesIO(png)) as here, Image.open("last.png") as exported:
        assert kind == "image/png" and np.array_equal(np.asarray(here), np.asarray(exported))
    with pytest.raises(Refused):
        desk.screen.dyed({"film": [found["film"]], "frame": [str(len(found["times"]))]})
    waving(FOLDER / "a.mcap")
    other = ask(desk, "replay", recording="a.mcap")["film"]
    with pytest.raises(BadInput, match="no positions in it to compare"):
        ask(desk, "compare", first=found["film"], second=other)
