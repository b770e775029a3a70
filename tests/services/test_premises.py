"""Every service of a run starts from the same scene and files, wherever it has read them."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import pytest
from scenes import BALL, write_scene

from nuno.bus.messages import Bus
from nuno.bus.sessions import hub_at, spoke
from nuno.runtime import runs, supervisor
from nuno.runtime.consistency import compare, premises_of
from nuno.runtime.service import Options, run_service
from nuno.runtime.supervisor import Deployment, Outcome
from nuno.scene import scene_file, shipped
from nuno.scene.scene_file import Loaded
from nuno.simulation.solver_selection.cloth import decide
from nuno_schemas.errors import BadInput, RunFailed
from nuno_schemas.messages import FrameStatus

SERVICES = ("simulation", "collision", "recorder")


def supervise(
    loaded: Loaded, others: dict[str, Loaded], record: Path, late: str = ""
) -> tuple[Outcome | None, list[str], str]:
    """A run whose services have each read a scene of their own: how it ended, what was said, what was refused. One may
    be `late`: it comes when the run has said that it waits for it, and not for the recorder.
    """
    run, said, missed = runs.new_id("apart"), list[str](), threading.Event()

    def hear(status: FrameStatus | str) -> None:
        if isinstance(status, str):
            said.append(status)
            if late and late in status and "recorder" not in status:
                missed.set()

    def serve(name: str, endpoint: str) -> None:
        if name == late:
            missed.wait(60.0)
        with spoke(endpoint) as session:
            options = Options(record=record, must_see=("collision", "recorder"))
            try:
                run_service(name, others.get(name, loaded), session, run, options)
            except RunFailed as error:
                said.append(str(error))

    outcome, refused = None, ""
    with hub_at(None) as (_, endpoint):
        threads = [threading.Thread(target=serve, args=(name, endpoint), daemon=True) for name in SERVICES]
        for thread in threads:
            thread.start()
        try:
            deployment = Deployment(connect=endpoint, run=run)
            outcome = supervisor.supervise(loaded, Options(record=record), deployment, hear)
        except BadInput as error:
            refused = str(error)
        for thread in threads:
            thread.join(30.0)
            assert not thread.is_alive()
    return outcome, said, refused


@pytest.mark.parametrize("service", SERVICES)
def test_a_service_with_another_scene_is_refused_before_the_first_frame(service: str, tmp_path: Path) -> None:
    scene = write_scene(tmp_path, bodies=BALL)
    other = scene_file.read(scene, ["bodies.0.collider.radius=0.2"])
    record = tmp_path / "run.mcap"
    _, _, refused = supervise(scene_file.read(scene), {service: other}, record)
    assert f"bodies[0].collider.radius: the {service} service has read another scene" in refused
    assert "value:  0.2" in refused and "as the run has it" in refused and "--set" in refused
    assert not list(tmp_path.glob("run*"))


def test_a_service_that_dies_when_it_is_asked_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def leave(bus: Bus, services: set[str], loaded: Loaded, resumes: bool, real_time: bool) -> list[str]:
        bus.ask_json("finish/collision", {})
        raise RunFailed("no answer", peer="collision")

    monkeypatch.setattr("nuno.runtime.supervisor.check_premises", leave)
    loaded = scene_file.read(write_scene(tmp_path, bodies=BALL))
    outcome, _, _ = supervise(loaded, {}, tmp_path / "run.mcap")
    assert outcome is not None and outcome.state == "failed"
    assert outcome.error == "the collision service died: its process ended or the connection broke"


@pytest.mark.parametrize(("after", "every"), [(0.2, 1e6), (1e6, 0.2)])
def test_services_that_are_still_to_be_started_are_named(
    after: float, every: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whenever there are fewer of them, and every few seconds."""
    monkeypatch.setattr("nuno.runtime.supervisor.PREPARING_AFTER", after)
    monkeypatch.setattr("nuno.runtime.supervisor.PREPARING_EVERY", every)
    loaded = scene_file.read(write_scene(tmp_path, bodies=BALL, duration="0.1 s"))
    outcome, said, _ = supervise(loaded, {}, tmp_path / "run.mcap", "collision")
    assert outcome is not None and outcome.state == "done"
    assert [text for text in said if text.endswith(": collision")]


def test_the_same_scene_is_the_same_however_it_was_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a file, by what was set, in other units, with its solver chosen already, which not every service needs."""
    monkeypatch.setattr("nuno.runtime.supervisor.PREPARING_AFTER", 1e6)  # nothing is to be said of it
    monkeypatch.setattr("nuno.runtime.supervisor.PREPARING_EVERY", 1e6)
    solver = {"plugin": "xpbd", "residual": 1e-5, "iterations": 2}
    scene = write_scene(tmp_path, bodies=BALL, solver=solver, accuracy="preview", duration="0.2 s")
    loaded = scene_file.read(scene)
    decided = decide(loaded)
    differ = premises_of(decided, False).items() ^ premises_of(loaded, False).items()
    assert any(field.startswith("solver") for field, _ in differ)
    again = scene_file.read(scene, decided.overrides)
    radius = loaded.data["bodies"][0]["collider"]["radius"]
    units = scene_file.read(scene, [f"bodies.0.collider.radius={1000 * radius} mm", "bodies.0.motion=null"])
    outcome, said, refused = supervise(
        decided, {"collision": units, "recorder": again, "simulation": again}, tmp_path / "run.mcap"
    )
    assert refused == "" and [text for text in said if "its bus at" not in text] == []
    assert outcome is not None and outcome.state == "done"


def test_a_file_of_the_same_name_must_hold_the_same(tmp_path: Path) -> None:
    folders = [tmp_path / "here", tmp_path / "there"]
    found = []
    for folder, text in zip(folders, ("one", "two"), strict=True):
        folder.mkdir()
        (folder / "walk.bvh").write_text(text)
        motion = {"plugin": "bvh", "file": "walk.bvh"}
        body = {"name": "dancer", "collider": {"plugin": "skeleton"}, "motion": motion}
        found.append(premises_of(scene_file.read(write_scene(folder, bodies=[body])), False))
    here, there = found
    assert compare("collision", here, here) == []
    with pytest.raises(BadInput, match="the collision service has read another file of that name") as caught:
        compare("collision", there, here)
    assert caught.value.value == "walk.bvh"
    del there["file walk.bvh"]
    assert compare("collision", there, here) == [], "not every service needs it"


def test_other_versions_are_said(tmp_path: Path) -> None:
    own = premises_of(scene_file.read(write_scene(tmp_path)), False)
    theirs = own | {"version numpy": "1.0"}
    (note,) = compare("simulation", theirs, own)
    assert note.startswith(f"the simulation service has numpy 1.0, the run {own['version numpy']}")


def test_a_file_that_changes_before_the_run_begins_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever has read it has the old one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "walk.bvh").write_text("one")
    body = {"name": "dancer", "collider": {"plugin": "skeleton"}, "motion": {"plugin": "bvh", "file": "walk.bvh"}}
    loaded = scene_file.read(write_scene(tmp_path, bodies=[body]))
    premises_of(loaded, False)
    (tmp_path / "walk.bvh").write_text("other")
    with pytest.raises(BadInput, match="it has changed since it was read"):
        premises_of(loaded, False)
    (tmp_path / "walk.bvh").unlink()
    with pytest.raises(BadInput, match="cannot be read"):
        premises_of(loaded, False)


def test_services_that_step_go_on_from_a_recording_where_the_run_does(tmp_path: Path) -> None:
    own = premises_of(scene_file.read(write_scene(tmp_path)), True)
    anew = own | {"resumes": False}
    assert compare("viewer", anew, own) == []
    for service in ("simulation", "collision"):
        with pytest.raises(BadInput, match=f"the {service} service starts anew, the run does not"):
            compare(service, anew, own)


def test_the_service_that_sets_the_pace_waits_for_the_clock_where_the_run_does(tmp_path: Path) -> None:
    loaded = scene_file.read(write_scene(tmp_path))
    own, hurried = premises_of(loaded, False, real_time=True), premises_of(loaded, False)
    assert compare("recorder", hurried, own) == compare("simulation", own, hurried) == []
    with pytest.raises(BadInput, match="the simulation service does not wait for the clock") as caught:
        compare("simulation", hurried, own)
    assert caught.value.field == "--real-time"


def test_long_values_are_cut_short(tmp_path: Path) -> None:
    own = premises_of(scene_file.read(write_scene(tmp_path)), False)
    other = own | {"objects[0].name": "x" * 10_000}
    with pytest.raises(BadInput) as caught:
        compare("simulation", other, own)
    assert len(str(caught.value)) < 600


@pytest.mark.full
def test_every_scene_that_comes_along_is_the_same_for_all() -> None:
    """Whatever its plugins were given crosses the bus, and is read alike twice."""
    scenes = shipped.scenes()
    assert len(scenes) > 50
    for path in scenes.values():
        here, there = (json.dumps(premises_of(scene_file.read(path), False)) for _ in range(2))
        assert compare("simulation", json.loads(there), json.loads(here)) == []


def test_premises_cross_the_bus_unchanged(tmp_path: Path) -> None:
    own = premises_of(scene_file.read(write_scene(tmp_path, bodies=BALL)), False)
    assert json.loads(json.dumps(own)) == own


def test_values_are_named_by_their_fields(tmp_path: Path) -> None:
    scene = scene_file.read(write_scene(tmp_path, bodies=BALL))
    own, dumped = premises_of(scene, False), scene.scene.model_dump(mode="json")
    named = {"gravity[1]": dumped["gravity"][1], "bodies[0].name": dumped["bodies"][0]["name"], "dye": None}
    assert {field: own[field] for field in named} == named
    assert not own.keys() & {"", "gravity", "bodies", "bodies[0]"}


def test_a_part_that_only_one_has_is_named(tmp_path: Path) -> None:
    own = premises_of(scene_file.read(write_scene(tmp_path)), False)
    for theirs, ours, said in ((own | {"d[1]": 2}, own, "value:  2"), (own, own | {"d[1]": 2}, "value:  'nothing'")):
        with pytest.raises(BadInput, match=r"d\[1\]: the dye service has read another scene") as caught:
            compare("dye", theirs, ours)
        assert said in str(caught.value)
