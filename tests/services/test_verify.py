"""What differs in a recording is named: the first frame, the quantity, the index, and both values."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scenes import BALL, write_scene

import nuno
from nuno.bus.encodings import decode_arrays, encode_arrays, encode_points
from nuno.cli import main
from nuno.recording.recorded import Recorded
from nuno.recording.writer import RecordingWriter
from nuno.resimulation.verification import Verification, verify
from nuno_schemas.messages import Header

Change = Callable[[Recorded], bytes]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """25 frames of a chain on a ball, with a checkpoint each five."""
    folder = tmp_path_factory.mktemp("verify")
    return nuno.run(write_scene(folder, bodies=BALL), record=folder / "run.mcap").path


def altered(
    whole: Path, target: Path, change: Change = lambda m: m.payload, scene: str = "{}", versions: str = "{}"
) -> Path:
    """A copy with other payloads, and other fields of the scene and of the versions."""
    with nuno.open(whole) as recording:
        metadata = {name: dict(fields) for name, fields in recording.metadata.items()}
        metadata["scene"]["json"] = json.dumps(recording.scene | json.loads(scene))
        metadata["versions"] |= json.loads(versions)
        files = {n: recording.attachment(n) for n in recording.attachments}
        writer = RecordingWriter(target, metadata, files)
        for m in recording.messages():
            writer.write(m.topic, Header(run="r", service="s", seq=m.seq, frame=0, t=m.t), change(m))
        writer.finish({})
    return target


def found_in(path: Path) -> Verification:
    with nuno.open(path) as recording:
        return verify(recording)


def test_a_recording_is_equal_and_says_so(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert found_in(whole) == Verification(26, published=26, kept=5)
    assert main(["verify", str(whole)]) == 0
    said = capsys.readouterr()
    assert said.out == "equal to the last bit: 26 frames\n"
    assert "compared: 26 digests, 26 as published, 5 checkpoints\n" in said.err


@pytest.mark.parametrize("lost", [1, 8, 37, 2000])
def test_a_cut_recording_is_not_vouched_for(
    lost: int, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`nuno verify copy.mcap && rm original` would lose what the copy lacks."""
    (cut := tmp_path / "cut.mcap").write_bytes(whole.read_bytes()[:-lost])
    assert main(["verify", str(cut)]) == 1
    assert "equal to the last bit" not in capsys.readouterr().out
    with pytest.warns(UserWarning, match="INCOMPLETE"):
        found = nuno.verify(cut)
    assert found.frame is None and found.incomplete


def test_frames_between_nanoseconds_are_those_of_their_times(tmp_path: Path) -> None:
    """At 7,001 Hz no frame but the first is at a whole nanosecond."""
    solver = {"plugin": "symplectic_euler", "dt": "auto"}
    scene = write_scene(tmp_path, bodies=BALL, frame_rate=7001, duration=0.002, solver=solver, record={})
    found = found_in(nuno.run(scene, record=tmp_path / "run.mcap").path)
    assert (found.frame, found.compared, found.published) == (None, 15, 15)


def test_another_digest_is_found_though_all_that_is_kept_is_equal(whole: Path, tmp_path: Path) -> None:
    def swap(m: Recorded) -> bytes:
        status = json.loads(m.payload) if m.topic == "sim/status" else {}
        return m.payload.replace(status["digest"].encode(), b"0" * 32) if status.get("frame") == 7 else m.payload

    found = found_in(altered(whole, tmp_path / "a.mcap", swap))
    assert (found.frame, found.compared, found.part, found.difference) == (7, 7, "cloth", None)


@pytest.mark.parametrize("quantity", ["x", "v"])
def test_one_bit_of_a_checkpoint_is_named(
    whole: Path, tmp_path: Path, quantity: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = []

    def flip(m: Recorded) -> bytes:
        if m.topic != "sim/checkpoint":
            return m.payload
        arrays, text = decode_arrays(m.payload)
        if text["frame"] != 10:
            return m.payload
        values = arrays[quantity].copy()
        before.append(float(values[4, 1]))
        values[4, 1] = np.nextafter(values[4, 1], np.inf)
        return encode_arrays(arrays | {quantity: values}, text)

    path = altered(whole, tmp_path / "a.mcap", flip)
    found = found_in(path)
    value = found.difference
    assert value is not None and (found.frame, found.compared, value.frame, value.kept) == (10, 10, 10, "checkpoint")
    assert (value.quantity, value.index) == ({"x": "position", "v": "velocity"}[quantity], "vertex 4, axis y")
    assert (value.here, value.recorded) == (before[0], np.nextafter(before[0], np.inf))
    assert (value.number, value.of, value.farthest) == (1, 18, value.recorded - value.here)
    assert main(["verify", str(path)]) == 1
    said = capsys.readouterr().err
    for text in ("frame 10 (t = 0.2 s)", value.quantity, value.index, repr(value.here), repr(value.recorded)):
        assert text in said
    assert "promised" not in said  # made here, by this version


@pytest.mark.parametrize("kept", [True, False])
def test_what_the_solver_remembers_is_compared_though_no_digest_holds_it(
    whole: Path, tmp_path: Path, kept: bool
) -> None:
    """Where the chain took hold of the ball: a run that goes on from there would end in other bits."""

    def tamper(m: Recorded) -> bytes:
        arrays, text = decode_arrays(m.payload) if m.topic == "sim/checkpoint" else ({}, {})
        if text.get("frame") != 10:
            return m.payload
        anchor = arrays.pop("memory/anchor").copy()
        anchor[0, 2, 4] += 0.5
        return encode_arrays(arrays | ({"memory/anchor": anchor} if kept else {}), text)

    found = found_in(altered(whole, tmp_path / "a.mcap", tamper))
    value = found.difference
    assert value is not None and (found.frame, found.compared, value.kept) == (10, 10, "checkpoint")
    if kept:
        assert (value.quantity, value.index) == ("the solver's memory, anchor", "entry (0, 2, 4)")
        assert (value.number, value.of, value.recorded - value.here) == (1, 18, 0.5)
    else:
        assert value.quantity == "number of values (the solver's memory, anchor)"
        assert (value.here, value.recorded) == (18.0, 0.0)


def test_what_was_published_is_compared_too(whole: Path, tmp_path: Path) -> None:
    with nuno.open(whole) as recording:
        x = list(recording.frames())[3].x
    x[5, 2] += 0.001

    def move(m: Recorded) -> bytes:
        return encode_points(x, m.t) if m.topic == "sim/state" and m.t == 0.06 else m.payload

    found = found_in(altered(whole, tmp_path / "a.mcap", move))
    value = found.difference
    assert value is not None and (found.frame, value.quantity, value.kept) == (3, "position", "published")
    assert value.index == "vertex 5, axis z" and value.recorded - value.here == pytest.approx(0.001, rel=1e-5)


def test_what_float32_does_not_show_is_named_where_float64_is_kept(whole: Path, tmp_path: Path) -> None:
    """Gravity that is off by one part in 10^14 changes the digest at once; frame 5 has the first checkpoint."""
    path = altered(whole, tmp_path / "a.mcap", scene=json.dumps({"gravity": [0, -9.81 * (1 + 1e-14), 0]}))
    found = found_in(path)
    value = found.difference
    assert value is not None and (found.frame, value.frame, value.kept) == (1, 5, "checkpoint")
    assert 0.0 < value.farthest < 1e-12


def test_other_versions_are_named_beside_a_difference_only(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    versions = json.dumps({"numba": "0.1", "processor": "an abacus"})
    equal = altered(whole, tmp_path / "equal.mcap", versions=versions)
    assert main(["verify", str(equal)]) == 0
    other = altered(whole, tmp_path / "other.mcap", scene=json.dumps({"damping": 0.5}), versions=versions)
    capsys.readouterr()
    assert main(["verify", str(other)]) == 1
    said = capsys.readouterr().err
    assert "numba 0.1, here" in said and "processor an abacus, here" in said and "numpy" not in said


def _flipped(whole: Path, target: Path, place: int) -> str:
    """A copy with one flipped bit."""
    data = bytearray(whole.read_bytes())
    data[place] ^= 1
    target.write_bytes(data)
    return str(target)


def test_one_flipped_bit_is_told_with_its_place_and_nothing_is_taken_for_whole(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the last chunk, behind all frames; in that of the frames; and in the scene, beside all messages."""
    with nuno.open(whole) as recording:
        places = [chunk.chunk_start_offset for chunk in recording.layout.chunks]
        status = next(id for id, channel in recording.layout.channels.items() if channel.topic == "sim/status")
        first = next(c for c in recording.layout.chunks if status in c.message_index_offsets)
    resume = ["run", "--record", str(tmp_path / "on.mcap"), "--no-view", "--resume"]

    behind = _flipped(whole, tmp_path / "a.mcap", places[-1] + 80)
    assert main(["verify", behind]) == 1
    assert f"not whole, damaged at byte {places[-1]:,} of" in capsys.readouterr().err
    assert main([*resume, behind, "--set", "duration=0.52s"]) == 0
    assert f"going on at 0.5 s of {behind} (INCOMPLETE: damaged at byte {places[-1]:,}" in capsys.readouterr().out
    with nuno.open(tmp_path / "on.mcap") as recording:
        assert recording.complete and verify(recording).compared == 27

    among = _flipped(whole, tmp_path / "b.mcap", first.chunk_start_offset + 100)
    assert main(["verify", among]) == 1
    assert "no frame is left to compare" in capsys.readouterr().err
    assert main([*resume, among]) == 2
    assert "no checkpoint before that" in (said := capsys.readouterr().err) and "duration" not in said

    beside = _flipped(whole, tmp_path / "c.mcap", whole.read_bytes().index(b'"frame_rate"') + 1)
    assert main([*resume, beside]) == 2
    assert "its scene may be another" in capsys.readouterr().err


def test_a_replay_that_is_refused_is_not_announced(whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(whole), "--no-view", "--start", "9"]) == 2
    assert "nothing to replay there" in (said := capsys.readouterr().err) and "replaying" not in said
