"""What the benchmarks of speed time, and the records that they keep and compare."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nuno.cli import main
from nuno.collision.crossings import find_crossings, mesh_of
from nuno.plugin_contract import registry
from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno_bench.machine import DISTURBED
from nuno_bench.piles import pile
from nuno_bench.report.page import Result, marks
from nuno_bench.speed import command as speed
from nuno_bench.speed import contact, studio
from nuno_bench.speed import leg as fit_speed
from nuno_bench.speed import leg as render_speed
from nuno_bench.speed import steps as dye_speed
from nuno_bench.speed.command import Record
from nuno_bench.speed.contact import Parts
from nuno_bench.speed.leg import fit
from nuno_contact.offset.contact_state import LISTED, ContactState
from nuno_schemas.dye import DyeReport, DyeState, DyeSystem
from nuno_schemas.errors import RunFailed

BEFORE = (1.0, 1.1, 1.2)
PAGE = Path(__file__).parents[2] / "docs" / "measured" / "benchmarks.md"


def timed(samples: tuple[float, ...] = BEFORE, unit: str = "s", what: str = "a step") -> Result:
    return Result("case", what, unit, samples)


def verdicts(records: list[Record], *results: Result) -> list[str]:
    return [change.verdict for change in speed.compare(records, results)]


@pytest.mark.parametrize(
    ("samples", "of_time", "of_rate"),
    [
        ((1.4, 1.5, 1.3), "slower", "faster"),
        ((0.7, 0.9, 0.8), "faster", "slower"),
        ((1.2, 1.5, 1.6), "within the spread", "within the spread"),
        ((0.5, 0.6, 1.0), "within the spread", "within the spread"),
        ((1.201, 1.205, 1.209), "within the spread", "within the spread"),
        ((9.0,), "taken once", "taken once"),
    ],
)
def test_slower_and_faster_are_beyond_both_spreads(samples: tuple[float, ...], of_time: str, of_rate: str) -> None:
    """And by more than a tenth, as everywhere in the benches."""
    for unit, expected in (("ms a frame", of_time), ("M vertex-steps/s", of_rate)):
        assert verdicts([Record.of([timed(unit=unit)], 0.0)], timed(samples, unit)) == [expected]


def test_rates_are_what_must_reach_at_least_their_bar() -> None:
    """In the documentation's tables, whose bars say which way is better; times faster than a peer are in no case."""
    rows = [line.split(" | ") for line in PAGE.read_text().splitlines() if line.count(" | ") == 9]
    found = {(row[4], row[5][:2]) for row in rows if row[0][2:] in speed.CASES and row[5]}
    assert {"M vertex-steps/s", "s", "times"} <= {unit for unit, _ in found}
    for unit, sign in found:
        assert Result("case", "what", unit).more_is_better == (sign == ">="), unit


def test_each_result_is_held_against_the_last_record_that_has_it() -> None:
    first = Record.of([timed((5.0, 5.1)), timed(what="another")], 0.0)
    second = Record.of([timed()], 0.0)
    results = timed((2.0, 2.1)), timed(what="another"), timed(what="a third"), timed(unit="ms")
    assert verdicts([first, second], *results) == ["slower", "within the spread", "no record", "no record"]
    assert verdicts([first, second], replace(results[0], samples=(), failure="it broke")) == []


def test_a_record_is_read_as_it_was_written_and_what_was_there_is_kept(tmp_path: Path) -> None:
    path, quiet = tmp_path / "docs" / "speed.jsonl", Record.of([timed(), timed((), what="failed")], 0.01)
    speed.append(path, quiet)
    before = path.read_text()
    path.write_text(before.rstrip("\n"))  # as an editor may leave it
    disturbed = Record.of([timed((3.0,))], 2 * DISTURBED)
    speed.append(path, disturbed)
    assert path.read_text().startswith(before)
    assert speed.read(path) == [quiet, disturbed] and len(quiet.results) == 1
    first, second = map(json.loads, path.read_text().splitlines())
    assert "disturbed" not in first and second["disturbed"] is True
    saved = {"case": "case", "what": "a step", "unit": "s", "median": 1.1, "least": 1.0, "greatest": 1.2}
    assert first["results"] == [saved | {"samples": list(BEFORE)}]
    for then, load in ((disturbed, 0.0), (quiet, disturbed.load)):
        said = speed.describe_changes(speed.compare([then], [timed()]), load)[-2:]
        assert ["DISTURBED" in str(text) for text in said] == [then is disturbed, then is quiet]


def test_a_commit_is_told_only_in_a_repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "ROOT", tmp_path)
    outside = Record.of([timed()], 0.0)
    assert outside.commit == "" and "commit" not in json.loads(outside.line())
    git = "git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b"
    (tmp_path / "kept").write_text("1")
    for arguments in (["init", "-q"], ["add", "."], ["commit", "-qm", "one"]):
        speed.subprocess.run([*git, *arguments], check=True)
    clean = speed.commit()
    assert re.fullmatch("[0-9a-f]{7,}", clean)
    (tmp_path / "kept").write_text("2")
    assert speed.commit() == f"{clean}+changes"


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[Result]:
    """What every case gives, with nothing timed."""
    results = [timed()]
    monkeypatch.setattr(speed, "run_case", lambda name, repeats: list(results))
    return results


def test_runs_are_saved_and_held_against_the_last(
    tmp_path: Path, measured: list[Result], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / ".git").mkdir()
    monkeypatch.setattr(speed, "ROOT", tmp_path)
    kept = tmp_path / "docs" / "measured" / "speed.jsonl"
    bench = ["bench", "speed", "sheet-32", "--save"]
    assert main(bench) == 0 and main([*bench, "--against"]) == 0
    assert "1 within the spread" in capsys.readouterr().out
    measured[0] = timed((2.0, 2.1, 2.2))
    assert main([*bench, "--against"]) == 1
    said = capsys.readouterr().out
    assert re.search(r"1\.1 \(1 - 1\.2\) +2\.1 \(2 - 2\.2\) +1\.91  slower", said)
    assert f"then: {speed.read(kept)[1].date}, no commit, numpy" in said
    # The slow one was saved, too, and is the last now.
    assert main(["bench", "speed", "sheet-32", "--against"]) == 0
    assert len(speed.read(kept)) == 3


def test_other_machines_are_left_alone(
    tmp_path: Path, measured: list[Result], capsys: pytest.CaptureFixture[str]
) -> None:
    path, own = tmp_path / "speed.jsonl", Record.of(measured, 0.0)
    for other in (replace(own, processor="Abacus"), replace(own, cores=own.cores + 1)):
        speed.append(path, replace(other, results=(timed((0.1, 0.1)),)))
    assert main(["bench", "speed", "--against", str(path)]) == 2
    said = capsys.readouterr().err
    assert "no record of this machine" in said and f"Abacus, {own.cores} cores; {own.processor}" in said
    speed.append(path, own)
    assert main(["bench", "speed", "sheet-32", "--against", str(path)]) == 0


@pytest.mark.parametrize("option", ["--save", "--against"])
def test_bad_records_are_refused(
    option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With exit code 2, before anything is measured."""
    monkeypatch.setattr(speed, "run_case", lambda name, repeats: pytest.fail("measured"))
    monkeypatch.setattr(speed, "ROOT", tmp_path)
    path, good = tmp_path / "speed.jsonl", Record.of([timed()], 0.0).line()
    for file, said in (((), "in no repository"), (("sheet-32",), "this is a case"), ((str(tmp_path),), "be read")):
        assert main(["bench", "speed", option, *file]) == 2
        assert said in capsys.readouterr().err
    for line in ("", "no JSON", "{}", good.replace("1.1", '"fast"')):
        path.write_text(f"{good}\n{line}\n{good}\n")
        assert main(["bench", "speed", option, str(path)]) == 2
        assert f"{path}:2: " in capsys.readouterr().err


@pytest.mark.full
def test_scenes_take_equal_steps_with_and_without() -> None:
    found = contact.on_over_off("hanging-sheet", ("objects.0.model.resolution=[8, 8]",), 0.1)
    assert found.on > 0.0 and found.off > 0.0
    assert found.note.startswith("6 frames of ")
    assert "64 vertices, 0 contacts at the end, 0 of " in found.note


@pytest.mark.full
def test_parts_of_contact_are_timed_beside_a_run_that_they_do_not_touch() -> None:
    """Cloth ends in the same bits whether it was looked at; what a step seldom needs counts as seldom."""
    ends = []
    for looked in (False, True):
        loaded = scene_file.read(shipped.find("contact/ribbon"), ("duration=0.1",))
        simulation = Simulation(loaded, None, None, 1)
        simulation.present()
        parts = Parts(simulation)
        while not simulation.finished:
            simulation.step()
            if looked:
                parts.look()
        ends.append(simulation.state.x.tobytes())
    assert ends[0] == ends[1]
    lists, choices, steps = (end - begin for end, begin in zip(parts._counted(), parts.begun, strict=True))
    taken = simulation.frame * simulation.steps
    assert 0 < lists < choices < steps < taken
    mean = np.mean([moment["lists"] for moment in parts.moments])
    assert parts.each()["lists"] == pytest.approx(lists / taken * mean)


@pytest.mark.full
def test_a_query_finds_what_lies_on_each_other_and_that_nothing_crosses(monkeypatch: pytest.MonkeyPatch) -> None:
    """As many pairs a vertex on a larger mesh, about; exponents are fitted to the times of each repeat."""
    monkeypatch.setattr(contact, "SIDES", (12, 24))
    shares = []
    for side in contact.SIDES:
        system = pile(*contact.layers(side))
        (meeting,) = system.terms[-1].data  # type: ignore[misc]
        assert isinstance(meeting, ContactState)
        contact.listing(meeting)()
        both = meeting.surface.piece[meeting.pairs.vertices[: meeting.counts[LISTED]]][:, [0, 3]]
        shares.append(float((both[:, 0] != both[:, 1]).sum()) / system.fabric.number)
    assert shares[0] > 4.0
    assert shares[1] == pytest.approx(shares[0], rel=0.3)
    times = iter(np.array([1.0, 2.0, 4.0, 8.0] * 2) * 1e-3)
    monkeypatch.setattr(contact, "seconds", lambda ask: next(times))
    found = {one.what: one for one in contact.queries(2)}
    triangles = [4 * (side - 1) ** 2 for side in contact.SIDES]
    slope = np.log(4.0) / np.log(triangles[1] / triangles[0])
    assert found["a list of pairs: exponent over the triangles"].samples == pytest.approx((slope, slope))
    assert found["a list of pairs, 484 triangles"].samples == pytest.approx((1.0, 1.0))


@pytest.mark.full
def test_layers_that_cross_are_not_timed() -> None:
    fabric = pile(*contact.layers(8)).fabric
    mesh = mesh_of(fabric.faces)
    contact.look(fabric, mesh)
    fabric.position[64:, 1] -= 1e-3 + contact.GAP * np.linspace(0.0, 2.0, 64)
    assert len(find_crossings(fabric.position, mesh).edges)
    with pytest.raises(RunFailed, match="pass through"):
        contact.look(fabric, mesh)


STEPS = 25


def explicit(system: DyeSystem, state: DyeState, steps: int) -> DyeReport:
    """The report of so many steps by our solver."""
    plugin = registry.load("nuno.dye_solvers", "explicit")
    config = plugin.Config()
    dt = dye_speed.DYE_SHARE * plugin.limit(config, system)
    report: DyeReport = plugin.advance(system, state, plugin.prepare(config, system, state), steps, dt)
    return report


def test_the_whole_model_fixes_dye_and_is_limited() -> None:
    system, state = dye_speed.whole_model(40, 44)
    start = state.phi.sum()
    report = explicit(system, state, STEPS)
    assert report.fixed[0] > 0.0 and report.mobile[0] + report.fixed[0] == pytest.approx(start, rel=1e-13)
    room = system.cells.mobile_room
    assert (state.phi[0] <= room).all() and (state.phi[0] > 0.999 * room)[system.cells.resist > 0.0].any()


@pytest.mark.parametrize("law", dye_speed.LAWS)
def test_figure_9_is_a_drop_that_is_kept_up_in_woven_yarns(law: str) -> None:
    system, state = dye_speed.figure_9(law)
    assert system.supply is not None and system.cells.fibre.shape == (2, 200, 200)
    assert system.cells.fibre.mean() == pytest.approx(0.8, abs=0.01)
    full = system.supply[0] > 0.0
    assert full[0].sum() == pytest.approx(np.pi * 15.0**2, rel=0.02)
    start = state.phi.sum()
    report = explicit(system, state, STEPS)
    assert np.array_equal(state.phi[0][full], system.supply[0][full])
    assert report.supplied[0] > 0.0 and report.fixed[0] > 0.0
    assert report.mobile[0] + report.fixed[0] == pytest.approx(start + report.supplied[0], rel=1e-12)


SHORT = """\
nuno: 1
name: short
duration: 2 s
frame_rate: 50 Hz
solver: {plugin: symplectic_euler, dt: auto}
objects:
  - {name: cloth, model: {plugin: sheet, size: [40 cm, 40 cm], resolution: [9, 9], fabric: silk, pin: [top-corners]}}
"""


@pytest.mark.full
def test_a_client_is_given_frames_and_a_missing_browser_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "short.yaml"
    path.write_text(SHORT)
    monkeypatch.setattr(studio.shipped, "find", lambda name: path)
    monkeypatch.setattr(studio.shipped, "scenes", lambda: {studio.SCENE: path})
    monkeypatch.setattr(studio, "find_browser", lambda: None)
    found = {result.what: result for result in studio.studio(1)}
    (rate,) = found["frames to a client that draws none"].samples
    assert 0.0 < rate <= 1.1 / studio.SCREEN
    assert "no Chromium" in found["pictures in Chromium"].failure
    assert found["page without the 3-D viewer"].verdict == "bar met"


SMALL = ("objects.stocking.model.wales=10", "objects.stocking.model.courses=19", "bodies.leg.collider.resolution=16")


@pytest.mark.full
def test_a_fit_ends_at_rest_and_one_that_does_not_is_no_figure() -> None:
    taken, steps = fit("stocking-150", *SMALL)
    assert steps > 10 and taken > 0.0
    assert fit("stocking-150", *SMALL, frames=1)[1] == 10
    with pytest.raises(RuntimeError, match="did not come to rest"):
        fit("stocking-150", *SMALL, "duration=0.2")


def test_every_stocking_is_fitted_on_both_legs_against_its_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[object, ...]] = []

    def quick(name: str, *overrides: str, frames: int | None = None) -> tuple[float, int]:
        asked.append((name, *overrides, frames))
        return 3.0, 30

    monkeypatch.setattr(fit_speed, "fit", quick)
    results = fit_speed.fits(7)
    assert [(one.bar, one.median, len(one.samples)) for one in results] == [(bar, 3.0, 3) for bar in (15, 15, 90, 90)]
    assert len(asked) == 4 * 4 and len(set(asked)) == 4 * 2


def test_chosen_cases_have_a_section_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    page.write_text("".join(f"{mark}\n" for name in ("speed", "speed fit") for mark in marks(name)))
    monkeypatch.setattr(speed, "run_case", lambda name, repeats: [Result(name, "seconds", "s", (1.0,))])
    assert main(["bench", "speed", "fit", "--docs", str(page)]) == 0
    text = page.read_text()
    assert "| fit |" in text.split("speed fit -->")[1] and "| fit |" not in text.split("<!-- end: speed -->")[0]


def test_the_stocking_lies_on_the_leg_with_all_its_links() -> None:
    worn, links = render_speed.stocking(12)
    assert links == 12 * 11 + 12 * 12 == len(worn.links)
    body = worn.bodies[0]
    near = registry.load("nuno.colliders", "mesh").search(body.vertices, body.faces)(worn.points)
    # Quads of the leg's rings are two triangles, and places on them lie beside both a little.
    assert np.abs(near.distance).max() < 1e-3
    assert np.ptp(worn.points[:, 2]) > 0.4
    assert worn.yarns is not None and (worn.yarns.radius == render_speed.RADIUS).all()


@pytest.mark.full
def test_seconds_and_rays_are_of_the_same_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    small = render_speed.stocking(12)
    monkeypatch.setattr(render_speed, "stocking", lambda: small)
    monkeypatch.setattr(render_speed, "SIDE", 32)
    taken, rays = render_speed.render(2)
    assert taken.bar == render_speed.SLOWEST and taken.at_most and len(taken.samples) == 2
    assert np.allclose(np.array(taken.samples) * rays.samples, render_speed.SAMPLES * 32 * 32 * 1e-6)
