"""What bodies feel is published and recorded where a scene wants it, and changes nothing of the run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from rrd import curves, write
from scenes import BALL, write_scene
from viewer_run import RATE, messages

import nuno
from nuno.bus.encodings import decode_arrays
from nuno.cli import main
from nuno.recording.reader import open_recording
from nuno_schemas.messages import CONTACT, TOUCHES, BodyContact, Contact

SHEET = [
    {
        "name": "cloth",
        "model": {
            "plugin": "sheet",
            "size": [0.2, 0.2],
            "resolution": [9, 9],
            "plane": "xz",
            "centre": [0.3, -0.09, 0.0],
        },
    }
]


def test_each_frame_says_what_bodies_feel(tmp_path: Path) -> None:
    """Force, torque and pressure of each body, in the recording and its series; the touches add up to the force; and
    the bits are those of a run without.
    """
    scene = write_scene(tmp_path, bodies=BALL, objects=SHEET, solver="symplectic_euler")
    plain = nuno.run(scene, duration="0.5 s", progress=False)
    felt = nuno.run(scene, {"record.contact_forces": True}, duration="0.5 s", record=tmp_path / "felt.mcap")
    assert felt.digest == plain.digest
    with open_recording(tmp_path / "felt.mcap") as recording:
        frames = len(list(recording.frames()))
        contacts = [Contact.model_validate_json(one.payload) for one in recording.messages([CONTACT.name])]
        touches = [decode_arrays(one.payload) for one in recording.messages([TOUCHES.name])]
        series = recording.series()
    assert [one.frame for one in contacts] == list(range(frames)) and len(touches) == frames
    assert any(body.vertices for one in contacts for body in one.bodies)
    for one, (arrays, text) in zip(contacts, touches, strict=True):
        assert text["bodies"] == [body.body for body in one.bodies]
        for number, body in enumerate(one.bodies):
            own = arrays["body"] == number
            assert own.sum() == body.vertices
            total = arrays["force"][own].sum(axis=0)
            assert np.abs(total + np.array(body.attached) - body.force).max() <= 1e-5 * max(1.0, *map(abs, body.force))
    name = contacts[0].bodies[0].body
    assert series[f"force_{name}_y"].tolist() == [one.bodies[0].force[1] for one in contacts]
    assert series[f"pressure_{name}"].max() > 0.0


def test_a_table_has_their_units(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`force_ball_y [N]`, `pressure_ball [Pa]`."""
    scene, file = write_scene(tmp_path, bodies=BALL, objects=SHEET, solver="symplectic_euler"), tmp_path / "run.mcap"
    nuno.run(scene, {"record.contact_forces": True}, duration="0.1 s", record=file)
    assert main(["export", str(file), "--csv", str(tmp_path / "run.csv")]) == 0
    head = (tmp_path / "run.csv").read_text().splitlines()[0]
    assert "force_ball_y [N]" in head and "pressure_ball [Pa]" in head


def test_forces_on_bodies_are_curves(tmp_path: Path) -> None:
    """Their sizes, one curve a body, where a run tells them."""
    still = {"torque": (0.0, 0.0, 0.0), "attached": (0.0, 0.0, 0.0), "vertices": 1, "area": 1.0, "pressure": 0.0}
    fed = list(messages(2))
    for frame in range(2):
        felt = [BodyContact(body=name, force=(3.0 * frame, 4.0 * frame, 0.0), mean_pressure=0.0, **still)
                for name in ("bar", "floor")]  # fmt: skip
        contact = Contact(frame=frame, t=frame / RATE, bodies=felt)
        fed.append((CONTACT.name, frame, frame / RATE, contact.model_dump_json().encode()))
    found = curves(write(tmp_path / "run.rrd", fed), "/plots/contact")
    assert found == {"bar": {0: 0.0, 1: 5.0}, "floor": {0: 0.0, 1: 5.0}}
