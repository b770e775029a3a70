"""`nuno bench contact`: scenes follow from their seeds, what passes through is seen and ends the command with 1."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nuno.cli import main
from nuno.collision.crossings import find_crossings, mesh_of
from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_bench import contact, piles
from nuno_bench.contact import PileOutcome, run_pile
from nuno_bench.piles import BODIES, SOLVERS, Oracle, irregular_square, random_pile
from nuno_bench.sweep.executor import Executor, SweepFile

SHORT = 0.1
"""Duration of a scene [s]."""


@pytest.mark.full
@pytest.mark.parametrize("seed", range(1, 31))
def test_no_cloth_passes_through_cloth_in_random_scenes(seed: int) -> None:
    """By ipctk, and by our own check; a solver may give up, with a message."""
    found = run_pile((seed, 0.5))
    assert (found.crossed, found.own) == ([], [])
    assert found.status in ("ok", "diverged", "unconverged")
    assert found.status == "ok" or found.message
    assert found.frames > 0 and found.vertex_steps >= found.vertices * found.frames


def test_scenes_follow_from_their_seeds_and_are_of_all_kinds(tmp_path: Path) -> None:
    """The same text again; of a shorter duration the same start; each can be read."""
    solvers, bodies = set(), set()
    for seed in range(60):
        paths = [random_pile(seed, duration, tmp_path) for duration in (0.5, 0.5, 0.1)]
        texts = [json.loads(path.read_text()) for path in paths]
        path = random_pile(seed, 0.5, tmp_path)
        again = json.loads(path.read_text())
        assert texts[-1] == again | {"duration": 0.1}
        found = contact.made_of(seed, again)
        solvers.add(found.solver)
        bodies.add(found.body)
        assert 2 <= len(scene_file.read(path).models) <= 3
    assert (solvers, bodies) == (set(SOLVERS), set(BODIES))


@pytest.fixture
def crossing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenes whose contact is left out, so that cloth passes through."""

    def without(seed: int, duration: float, folder: Path) -> Path:
        path = random_pile(seed, duration, folder)
        path.write_text(json.dumps(json.loads(path.read_text()) | {"cloth_contact": "none"}))
        return path

    def counted(simulation: Simulation) -> Any:
        frame = Simulation.step(simulation)
        counts = {**frame.report.counts, "cloth_contacts": 0}
        return replace(frame, report=replace(frame.report, counts=counts))

    class Counted(Simulation):
        step = counted

    monkeypatch.setattr(contact, "random_pile", without)
    monkeypatch.setattr(contact, "Simulation", Counted)


@pytest.mark.full
@pytest.mark.usefixtures("crossing")
def test_what_passes_through_is_seen_named_kept_and_ends_the_command_with_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Seed 2 without cloth contact: by both checks, in the same frames."""
    assert main(["bench", "contact", "2", "--duration", "0.1", "--jobs", "1", "--out", str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert "crossed: seed 2, leapfrog, box" in said and "by our own check" in said
    (one,) = json.loads((tmp_path / "contact.json").read_text())["scenes"]
    assert one["verdict"] == "crossed" and one["crossed"] == one["own"] != []
    assert scene_file.read(tmp_path / "contact" / "2" / "pile-2.yaml").scene.name == "pile-2"
    with (tmp_path / "contact.csv").open() as stream:
        assert [row["verdict"] for row in csv.DictReader(stream)] == ["crossed"]


def test_what_is_finished_is_not_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[int]()

    def ran(task: tuple[int, float]) -> PileOutcome:
        asked.append(task[0])
        return PileOutcome(task[0], "rk4", "box", ("denim",), ("quads",), crossed=[4] * (task[0] == 2))

    monkeypatch.setattr(contact, "run_pile", ran)
    flags = ["--jobs", "1", "--out", str(tmp_path)]
    assert main(["bench", "contact", "1", "2", *flags]) == 1
    assert main(["bench", "contact", "--count", "3", "--resume", *flags]) == 1
    assert asked == [1, 2, 3]
    assert [one["seed"] for one in json.loads((tmp_path / "contact.json").read_text())["scenes"]] == [1, 2, 3]
    assert main(["bench", "contact", "3", "--resume", "--duration", "0.2", *flags]) == 2, "another sweep's"


def test_both_checks_see_an_edge_through_a_triangle() -> None:
    x, faces = irregular_square(6, 0.1, 1)
    turned = x[:, [1, 0, 2]] + [0.0, 0.003, 0.001]
    both, all_faces = np.concatenate([x, turned]), np.concatenate([faces, faces + len(x)])
    raised = x + np.array([0.0, 0.001, 0.0])
    apart = np.concatenate([x, raised])
    oracle = Oracle(both, all_faces)
    for places, expected in ((both, True), (apart, False)):
        assert oracle.crossed(places) is expected
        assert (len(find_crossings(places, mesh_of(all_faces)).edges) > 0) is expected


@pytest.mark.parametrize(
    ("found", "verdict", "bad"),
    [
        (PileOutcome(1), "clean", False),
        (PileOutcome(1, crossed=[3], own=[3]), "crossed", True),
        (PileOutcome(1, crossed=[3]), "disagrees", True),
        (PileOutcome(1, status="diverged", message="vertex 3"), "failed", False),
        (PileOutcome(1, crossed=[3], own=[3], status="diverged"), "crossed", True),
        (PileOutcome(1, status="refused", message="no"), "refused", True),
        (PileOutcome(1, status="crashed", message="no"), "crashed", True),
    ],
)
def test_verdicts_follow_from_what_was_seen(found: PileOutcome, verdict: str, bad: bool) -> None:
    assert (found.verdict, contact.is_bad(found)) == (verdict, bad)
    assert bool(contact.describe(found)) == (verdict != "clean")
    assert contact.keep([PileOutcome(1)], 0.1, Path("nowhere")) is None


@pytest.mark.usefixtures("crossing")
def test_what_raises_is_a_finding_about_its_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: Simulation) -> None:
        raise ZeroDivisionError("by hand")

    monkeypatch.setattr(Simulation, "step", broken)
    kept = SweepFile(tmp_path / "kept.jsonl", {}, False, print)
    (found,) = contact.run_all([2], SHORT, kept, Executor(), lambda text: None)
    assert (found.verdict, found.message, found.frames) == ("crashed", "ZeroDivisionError: by hand", 0)


def test_scenes_that_are_counted_are_all_in_the_tables() -> None:
    found = [
        PileOutcome(1, "rk4", "box", ("denim",), ("quads",), vertices=10, frames=5, vertex_steps=1000, cut=1),
        PileOutcome(
            2, "xpbd", "box", ("denim", "springs"), ("quads",), frames=5, crossed=[4], own=[4], vertex_steps=1000
        ),
    ]
    by_solver, by_body, _, by_fabric = contact.count_tables(found)
    assert [row[:4] for row in by_solver.rows] == [
        ["rk4", "1", "5", "0"],
        ["xpbd", "1", "5", "1"],
        ["all", "2", "10", "1"],
    ]
    assert [row[1] for row in by_body.rows] == ["2", "2"]
    assert [row[0] for row in by_fabric.rows] == ["denim", "springs", "all"]
    assert by_solver.rows[0][5] == "0.1 %"
    assert "cloth passes through cloth in 1 by ipctk and in 1 by our own check; 1 scenes went wrong" in contact.summary(
        found
    )


def test_irregular_squares_are_whole_and_face_up() -> None:
    x, faces = irregular_square(9, 0.2, 3)
    normal = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
    assert (normal[:, 1] > 0.0).all()
    assert 0.5 * normal[:, 1].sum() == pytest.approx(0.04)
    lengths = np.linalg.norm(np.diff(x[mesh_of(faces).edges], axis=1)[:, 0], axis=1)
    assert lengths.min() > 0.3 * 0.025
    assert piles.sheet(irregular=True).mass.sum() == pytest.approx(piles.sheet().mass.sum())


@pytest.mark.parametrize("arguments", [["--count", "0"], ["-1"], ["--duration", "0"], ["--docs", "/nowhere.md"]])
def test_bad_arguments_are_refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(contact, "run_all", lambda *given: pytest.fail("nothing is to run"))
        assert main(["bench", "contact", *arguments]) == 2
    assert "error: " in capsys.readouterr().err
