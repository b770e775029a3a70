"""Recordings that are well formed and say what no run says: what is wrong is said, and nothing is vouched for."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from recorded_sheet import Sheet, write
from scenes import BALL, write_scene

import nuno
from nuno.bus.encodings import MOST_TEXT, BadMessage, decode_arrays, encode_arrays
from nuno.cli import main
from nuno.plugin_contract import registry
from nuno.plugin_contract.values import ContractError
from nuno.recording.reader import open_recording
from nuno.runtime.stepper import check_kept
from nuno.scene.files import SceneFiles
from nuno_contact.offset.contact_state import ContactState
from nuno_integrators.compiled import _state_arrays
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Memory
from nuno_schemas.layout import Bounds
from nuno_schemas.messages import CHECKPOINT, REPORT, STATE, STATUS
from nuno_schemas.plugin import Config
from nuno_testing import integrators
from nuno_testing.subject import Subject
from soak import damage
from soak.fuzz import forged
from soak.fuzz.forged import Held

HUGE = {"plugin": "sheet", "size": ["1 m", "1 m"], "resolution": [5000, 5000], "cells": "triangles"}
Change = Callable[[Held], object]


@pytest.fixture(scope="module")
def sheet(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A recording of no simulation, with a file in it."""
    path = tmp_path_factory.mktemp("sheet") / "a.mcap"
    write(path, Sheet(3, 2), 12, {"f": b"attached"})
    return path.read_bytes()


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """25 frames of a chain that comes to rest on a ball, with a checkpoint each five."""
    folder = tmp_path_factory.mktemp("chain")
    record = nuno.run(write_scene(folder, bodies=BALL), record=folder / "run.mcap").path
    return record.read_bytes()


@pytest.fixture
def said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """The code, the output and the errors of a command on a recording that is changed in some way."""

    def call(data: bytes, change: Change, *words: str) -> tuple[int, str, str]:
        held = Held.of(data)
        change(held)
        (tmp_path / "a.mcap").write_bytes(held.write())
        capsys.readouterr()
        code = main([words[0], str(tmp_path / "a.mcap"), *words[1:]])
        return code, *capsys.readouterr()

    return call


def _last(held: Held, topic: str) -> forged.Item:
    return [one for one in held.items if one.topic == topic][-1]


def _checkpoint(**changed: Any) -> Change:
    """Another array of the last checkpoint's, or another number beside them."""

    def change(held: Held) -> None:
        one = _last(held, CHECKPOINT.name)
        arrays, text = decode_arrays(one.payload)
        for name, value in changed.items():
            if name in text:
                text[name] = value
            elif name == "numbers":
                arrays[name] = np.array(value, np.int32)
            else:
                key = f"memory/{name}"
                arrays[key] = value(arrays[key])
        one.payload = encode_arrays(arrays, text)

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"anchor_frame": lambda a: np.full_like(a, 10**9)}, "anchor_frame is 1000000000 at row 0, outside -1 to 0"),
        ({"anchor_frame": lambda a: np.full_like(a, 5)}, "anchor_frame is 5 at row 0, outside -1 to 0"),
        ({"anchor_frame": lambda a: np.full_like(a, -2)}, "anchor_frame is -2 at row 0, outside -1 to 0"),
        ({"anchor_frame": lambda a: a.astype(np.int64)}, "anchor_frame, int64"),
        ({"anchor_frame": lambda a: a[:, :2]}, "anchor_frame, int32"),
        ({"numbers": [0, 1, 2, 3, 4, 99]}, "numbers does not name each vertex once"),
        ({"numbers": [0, 1, 2, 3, 4, 4]}, "numbers does not name each vertex once"),
        ({"numbers": [0, 1]}, "numbers is int32 (2,), not int32 (6,)"),
        ({"frame": 3}, "frame 3 is not at t = 0.5 s"),
        ({"t": 0.48}, "is not at t = 0.48 s"),
        ({"dt": 1e-12}, "20 steps of dt = 1e-12 s are no frame, which is 0.02 s"),
        ({"steps": 10**9}, "1000000000 steps of dt = 0.001 s are no frame"),
    ],
)
def test_no_kernel_sees_a_memory_that_is_out_of_range(
    whole: bytes, change: dict[str, Any], words: str, said: Any, tmp_path: Path
) -> None:
    """The checkpoint is of the last frame: what acts in it is found from it alone."""
    code, _, error = said(whole, _checkpoint(**change), "export", "--forces", str(tmp_path / "a.npz"))
    assert (code, words in error) == (2, True), error
    code = main(["run", "--resume", str(tmp_path / "a.mcap"), "--record", str(tmp_path / "b.mcap"), "--no-view",
                 "--set", "duration=0.52"])  # fmt: skip
    assert code == 2 and not (tmp_path / "b.mcap").exists()


def test_a_run_goes_on_with_its_own_topics_alone(
    whole: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    held = Held.of(whole)
    held.items[-1].topic = "/tf"
    (tmp_path / "a.mcap").write_bytes(held.write())
    words = ["run", "--resume", str(tmp_path / "a.mcap"), "--record", str(tmp_path / "b.mcap"), "--no-view"]
    assert main([*words, "--set", "duration=0.6"]) == 2
    assert "a topic that none records" in capsys.readouterr().err


def test_integers_need_bounds_to_come_out_of_a_file() -> None:
    """Of every solver and contact: what a third party's memory does not say is not taken from a file."""
    memory = Memory({"place": np.zeros(3, np.int32), "rate": np.zeros(3)})
    check_kept(memory, {"rate": np.ones(3)})
    with pytest.raises(ContractError, match="memory/place holds integers"):
        check_kept(memory, {"place": np.zeros(3, np.int32)})


@pytest.mark.parametrize(
    ("name", "value"),
    [("clock", np.nan), ("clock", 1e300), ("clock", -9.0), ("spread", -1e-9), ("spread", np.inf), ("unrest", -1.0),
     ("motion", np.inf), ("anchor", np.nan), ("last", np.nan), ("so_far", -1)],
)  # fmt: skip
def test_clocks_and_plans_of_cloth_contact_are_in_their_ranges(name: str, value: float) -> None:
    """As every solver holds them; a plan that has not been made yet has a reference of NaN."""
    registry.load("nuno.cloth_contacts", "offset")
    kept = {"anchor": np.zeros((5, 4)), "anchored": np.zeros(5, bool), "reference": np.full((6, 3), np.nan)}
    kept |= {name: np.zeros((rows, 3)) for name, rows in {"motion": 6, "spread": 2, "unrest": 2, "last": 3}.items()}
    kept |= {"clock": np.zeros(7), "so_far": np.zeros(5, np.int64), "push": np.zeros((2, 3, 3))}
    own = {name: kept[name] for name in ("anchor", "anchored", "last", "push", "clock", "so_far")}
    term = ContactState(*[None] * len(ContactState._fields))._replace(plan=SimpleNamespace(**kept), **own)
    packed = SimpleNamespace(forces=(term,), bodies=())
    arrays, bounds = _state_arrays(cast(Any, SimpleNamespace(packed=packed, state_arrays=dict, bounds=dict)))
    memory = Memory(arrays, None, bounds)
    check_kept(memory, arrays)
    wrong = arrays[name].copy()
    wrong.flat[-1] = value
    with pytest.raises(ContractError, match=f"memory/{name} is "):
        check_kept(memory, {name: wrong})


def test_the_checks_of_plugins_ask_for_bounds_of_integers() -> None:
    """What a third party's solver keeps goes through the same check as what comes out of a file."""
    memory = Memory({"place": np.zeros(3, np.int32)})
    solver = SimpleNamespace(
        prepare=lambda config, system, state: memory,
        advance=lambda system, state, memory, poses, steps, dt: SimpleNamespace(status="ok"),
    )
    subject, system = (
        Subject("nuno.integrators", "own", solver, Config(), SceneFiles(Path())),
        integrators.oscillator(),
    )
    with pytest.raises(ContractError, match="memory/place holds integers that its solver gives no bounds for"):
        integrators.run(subject, system, 0.1, 1)
    memory.bounds["place"] = Bounds(0, 2)
    integrators.run(subject, system, 0.1, 1)


def test_a_truth_is_true_or_false() -> None:
    payload = encode_arrays({"a": np.array([True, False])}).replace(b"\x01\x00", b"\x07\x00")
    with pytest.raises(BadMessage, match="neither true nor false"):
        decode_arrays(payload)


def _without(held: Held, topic: str, *which: int) -> None:
    """Take away messages of a topic, or all of them."""
    found = [one for one in held.items if one.topic == topic]
    gone = [found[i] for i in which] if which else found
    held.items = [one for one in held.items if all(one is not other for other in gone)]


def _renamed(held: Held) -> None:
    for one in held.items:
        one.topic = "sim/other" if one.topic == STATE.name else one.topic


def _doubled(held: Held) -> None:
    one = _last(held, STATE.name)
    held.items.insert(held.items.index(one), one)


def _renumbered(held: Held) -> None:
    """Two states left out, and all that would tell of it made to fit but for the frames themselves."""
    _without(held, STATE.name, 7, 8)
    for i, one in enumerate(one for one in held.items if one.topic == STATE.name):
        one.seq = i
    held.metadata["end"]["counts"] = json.dumps(json.loads(held.metadata["end"]["counts"]) | {STATE.name: 24})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda held: _without(held, STATE.name), "missing: 26 of sim/state"),
        (_renamed, "missing: 26 of sim/state"),
        (lambda held: _without(held, STATE.name, 7, 8), "missing: 2 of sim/state"),
        (_renumbered, "missing: 2 of sim/state"),
        (_doubled, "more than once: 1 of sim/state"),
        (lambda held: held.items.append(_last(held, REPORT.name)), "more than once: 1 of run/report"),
        (lambda held: _without(held, STATUS.name, 3), "missing: 1 of sim/status"),
        (lambda held: _without(held, CHECKPOINT.name, 1), "missing: 1 of sim/checkpoint"),
        (lambda held: _without(held, REPORT.name), "missing: 1 of run/report"),
    ],
)
def test_what_is_missing_is_vouched_for_by_nobody(whole: bytes, change: Change, words: str, said: Any) -> None:
    code, out, error = said(whole, change, "verify")
    assert (code, out, words in error) == (1, "", True), error
    code, out, _ = said(whole, change, "info")
    assert code == 0 and f"INCOMPLETE: {words}" in out and "complete\n" not in out
    facts = json.loads(said(whole, change, "info", "--json")[1])
    assert not facts["complete"] and (facts["missing"] or facts["doubled"])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"t": 0.48}, "t of the checkpoint"),
        ({"dt": 0.002}, "dt of the checkpoint"),
        ({"steps": 21}, "steps of the checkpoint"),
        ({"frame": 24}, "frame of the checkpoint"),
    ],
)
def test_a_falsified_number_of_a_checkpoint_is_a_difference(
    whole: bytes, change: dict[str, Any], words: str, said: Any
) -> None:
    code, _, error = said(whole, _checkpoint(**change), "verify")
    assert code == 1 and words in error


@pytest.mark.parametrize("frame", [10**30, 10**9, -1, 4])
def test_a_frame_that_the_scene_has_not_is_refused_at_once(whole: bytes, frame: int, said: Any) -> None:
    def change(held: Held) -> None:
        one = [one for one in held.items if one.topic == STATUS.name][5]
        one.payload = json.dumps(json.loads(one.payload) | {"frame": frame}).encode()

    code, _, error = said(whole, change, "verify")
    assert code == 2 and "sim/status 5 at 0.1 s" in error and str(frame) in error


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("objects.0.model", HUGE, "25,000,000 vertices"),
        ("solver.dt", "5 us", "a frame of 20 steps, of which the scene has 4,000"),
        ("record", "text", "field: record|record: the scene in the recording is damaged"),
    ],
)
def test_a_scene_that_is_not_the_recorded_one_is_refused_before_it_is_built(
    whole: bytes, path: str, value: Any, words: str, said: Any
) -> None:
    def change(held: Held) -> None:
        data = json.loads(held.metadata["scene"]["json"])
        forged._set(data, path.split("."), value)
        held.metadata["scene"]["json"] = json.dumps(data)

    code, _, error = said(whole, change, "verify")
    assert code == 2 and any(word in error for word in words.split("|")), error


@pytest.mark.parametrize("version", ["0", "2", "", "text"])
@pytest.mark.parametrize("command", ["info", "verify", "replay", "export"])
def test_a_recording_of_another_version_is_refused(sheet: bytes, version: str, command: str, said: Any) -> None:
    def change(held: Held) -> None:
        held.metadata["run"]["schema_version"] = version
        held.metadata["versions"] = {"nuno": "9.9"}

    code, _, error = said(sheet, change, command)
    assert code == 2 and "schema_version: a recording of another version" in error
    assert "this nuno reads version 1" in error and "read it with nuno 9.9" in error


@pytest.mark.parametrize("name", forged.NAMES)
def test_names_that_no_key_file_or_terminal_can_have(sheet: bytes, name: str, said: Any) -> None:
    def topic(held: Held) -> None:
        for one in held.items:
            one.topic = name if one.topic == "collision/report" else one.topic

    def file(held: Held) -> None:
        held.attachments.append((name, b"data"))

    def scene(held: Held) -> None:
        held.metadata["scene"]["json"] = json.dumps({"name": name})

    for change in (topic, file, scene):
        code, out, error = said(sheet, change, "info")
        assert code == 0 and "\x1b" not in out
        code, out, error = said(sheet, change, "replay", "--fast", "--no-view")
        assert code in (0, 2) and "\x1b" not in error
        assert code == 0 or (change is topic and "a topic that no key can name" in error)
        code, _, error = said(sheet, change, "verify")  # whose scene is none
        assert code == 2 and "\x1b" not in error


@pytest.mark.parametrize("value", ["text", None, [], 10**400, -1])
def test_fields_of_other_types_are_said_and_hide_nothing_else(whole: bytes, value: Any, said: Any) -> None:
    """Of the report what else the file holds is shown; of a status it is named, and no table is made of it."""

    def report(held: Held) -> None:
        one = _last(held, REPORT.name)
        one.payload = json.dumps(json.loads(one.payload) | {"energy": value, "size": value, "frames": value}).encode()

    def status(held: Held) -> None:
        one = _last(held, STATUS.name)
        one.payload = json.dumps(json.loads(one.payload) | {"energy": value, "t": value}).encode()

    code, out, _ = said(whole, report, "info")
    assert code == 0 and "sim/state              26 messages" in out and "report                 damaged: " in out
    code, _, error = said(whole, status, "info")
    assert code == 2 and "sim/status 25 at 0.5 s: not a nuno.Status message" in error


def test_a_time_beyond_every_format_ends_what_is_read(sheet: bytes, said: Any, tmp_path: Path) -> None:
    def change(held: Held) -> None:
        _last(held, STATE.name).log_time = 2**64 - 1

    code, _, error = said(sheet, change, "export", "--foxglove", str(tmp_path / "out.mcap"))
    assert code == 2 and "too late for any format" in error


def test_damaged_recordings_are_read_or_refused_in_words(
    sheet: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A few by what reads quickly and simulates nothing; `make soak ARGS=damage` takes 500 through every command."""
    path, accepted = tmp_path / "a.mcap", 0
    for number in range(40):
        random = Random(number)
        how, data = forged.damage(sheet, random)
        if how == "inflate":
            continue
        path.write_bytes(data)
        for words in (["info", str(path)], ["export", str(path), "--csv", str(tmp_path / "a.csv")]):
            code = main(words)
            said = "".join(capsys.readouterr())
            assert code in (0, 2) and "Traceback" not in said and "\x1b" not in said, (number, how, said)
            accepted += code == 0
    assert accepted > 20


@pytest.mark.full
def test_every_command_reads_or_refuses_damaged_recordings() -> None:
    """No time is held to: others may compute beside it."""
    wrong = [row.note for row in damage.run(True, 7) if row.unit == "" and row.samples != (0,)]
    assert wrong == []


def test_a_list_of_messages_that_no_recorder_counted(sheet: bytes, tmp_path: Path) -> None:
    held = Held.of(sheet)
    held.metadata["end"]["counts"] = '{"sim/state": -1}'
    (tmp_path / "a.mcap").write_bytes(held.write())
    with open_recording(tmp_path / "a.mcap") as recording, pytest.raises(BadInput, match="counts"):
        recording.numbers("counts")


def test_texts_and_fields_have_limits(sheet: bytes, said: Any) -> None:
    """Nothing is parsed that would take a hundred times the memory of its file."""

    def report(held: Held) -> None:
        _last(held, REPORT.name).payload = b"[" + b"[]," * (MOST_TEXT // 3 + 1) + b"[]]"

    code, _, error = said(sheet, report, "info")
    assert code == 2 and "a text of 16,777,22" in error
    with pytest.raises(BadMessage, match="more than 10,000 fields"):
        decode_arrays(b"\x12\x00" * 10_001)
