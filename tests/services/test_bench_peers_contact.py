"""Engines in which cloth falls on cloth get one pile, and one judge looks at what they publish."""

from __future__ import annotations

import importlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nuno.cli import main
from nuno_bench.peers import command as peers
from nuno_bench.peers.pile import (
    CROSSED,
    MOTION,
    PAIRS,
    SIDES,
    Pile,
    PileComparison,
    PileScore,
    five_sheets,
    look,
    own_answers,
    their_answers,
)
from nuno_bench.peers.process import Engine, EnginePoint

SMALL = tuple(f"objects.{i}.model.resolution=[5, 5]" for i in range(len(SIDES)))
HERE = str(Path(__file__).parent)


@pytest.fixture(scope="module")
def pile() -> Pile:
    return five_sheets(*SMALL)


def sunk(pile: Pile, depth: float) -> np.ndarray:
    """The corner of the highest square, so much lower [m]: squares are 4 cm apart."""
    x = pile.x.copy()
    x[-1, 1] -= depth
    return x


def test_frames_are_judged_by_what_is_in_them(pile: Pile) -> None:
    """A corner that hangs 6 cm low is through the square below; the longest edge at it follows from Pythagoras."""
    pytest.importorskip("ipctk")
    seen = look(pile, np.stack([pile.x, sunk(pile, 0.06), sunk(pile, 0.03)]))
    ends = pile.edges[(pile.edges == len(pile.x) - 1).any(axis=1)]
    shortest = np.linalg.norm(pile.x[ends[:, 1]] - pile.x[ends[:, 0]], axis=1).min()
    assert (seen.frames, seen.crossed) == (3, (2,))
    assert seen.stretch == pytest.approx(np.hypot(shortest, 0.06) / shortest - 1.0)
    lowered = 0.03 * pile.mass[-1] / pile.mass.sum()
    assert seen.height == pytest.approx(pile.mass @ pile.x[:, 1] / pile.mass.sum() - lowered)


@pytest.mark.full
def test_ipctk_and_ours_answer_alike() -> None:
    pytest.importorskip("ipctk")
    pile = five_sheets()
    near, through, still = pile.x.copy(), sunk(pile, 0.06), pile.x
    near[-(SIDES[-1] ** 2) :, 1] -= 0.039
    for answers in (own_answers(pile), their_answers(pile)):
        assert answers[PAIRS](still, still) == 0
        assert answers[PAIRS](near, near) > 0  # type: ignore[operator]
        assert answers[MOTION](still, still) is True
        assert answers[MOTION](still, through) is False
        assert answers[CROSSED](still, still) is False
        assert answers[CROSSED](through, still) is True


@pytest.mark.parametrize(
    ("module", "made", "setting", "steps", "kept"),
    [
        pytest.param(
            "pile",
            "PileSolver",
            {"solver": "plugin: symplectic_euler, dt: 0.0002777777777777778"},
            60,
            1.0,
            marks=pytest.mark.full,
        ),
        pytest.param("pile_newton", "VBD", {"substeps": 10, "iterations": 4}, 10, 1.0, marks=pytest.mark.full),
        pytest.param("pile_newton", "Style3D", {"substeps": 10, "iterations": 4}, 10, 0.998, marks=pytest.mark.full),
    ],
)
def test_cloth_falls_freely_until_it_meets_anything(
    module: str, made: str, setting: dict[str, object], steps: int, kept: float
) -> None:
    """A step of both kinds of Euler goes h (v + g h), of which Style3D keeps 0.998 as velocity; frames come in order.

    Velocities are differences of positions in single precision, whose rounding by 3e-8 m adds up to 1.4e-5 m in 30.
    """
    if "newton" in module:
        pytest.importorskip("newton", reason="the peer engine newton is not installed")
    pile, h = five_sheets(), 1 / 60 / steps
    frames = getattr(importlib.import_module(f"nuno_bench.peers.{module}"), made)(pile, **setting).advance(0.05)
    assert len(frames) == 3
    v, fallen = np.zeros(3), np.zeros(3)
    for x in frames:
        for _ in range(steps):
            v = v + pile.gravity * h
            fallen, v = fallen + v * h, kept * v
        np.testing.assert_allclose(x - pile.x, np.broadcast_to(fallen, x.shape), rtol=0, atol=1.4e-5)


@pytest.mark.full
@pytest.mark.parametrize("made", ["VBD", "Style3D"])
def test_newton_has_the_masses_and_the_bending_of_the_cloth(made: str) -> None:
    """Bent to a cylinder across rows a fold of angle curvature x width stores rigidity curvature^2 / 2 per area."""
    pytest.importorskip("newton", reason="the peer engine newton is not installed")
    module = importlib.import_module("nuno_bench.peers.pile_newton")
    pile = five_sheets()
    model = getattr(module, made)(pile, 10, 4).model
    np.testing.assert_allclose(model.particle_mass.numpy(), pile.mass, rtol=1e-6)
    quads, k = model.edge_indices.numpy(), model.edge_bending_properties.numpy()[:, 0].astype(float)
    ends, x = pile.x[quads], pile.x
    inner = (quads[:, :2] >= 0).all(axis=1)
    along = ends[:, 3] - ends[:, 2]
    length, area = np.linalg.norm(along, axis=1), np.zeros(len(quads))
    for corner in (0, 1):
        area += 0.5 * np.linalg.norm(np.cross(along, ends[:, corner] - ends[:, 2]), axis=1)
    stiffness = k * length if made == "VBD" else k * 3.0 * length**2 / area
    across = inner & (np.abs(along[:, 0]) < 1e-9)  # folds of a cylinder whose axis is along z
    width = area[across] / length[across]
    assert stiffness[across] * width / length[across] == pytest.approx(module.BEND, rel=1e-5)
    assert not k[~inner].any() and len(x) == sum(side * side for side in SIDES)


def seen(*crossed: int) -> PileScore:
    return PileScore(60, crossed, 0.05, 0.6)


def test_another_engine_is_held_against_our_fastest_with_no_more_crossings() -> None:
    points = [
        EnginePoint("nuno-a", "loose", 1.0, (1.0,), seen(3, 4)),
        EnginePoint("nuno-a", "tight", 1.0, (4.0,), seen()),
        EnginePoint("newton-b", "clean", 1.0, (6.0, 2.0, 8.0), seen()),
        EnginePoint("newton-b", "quick", 1.0, (2.0,), seen()),
        EnginePoint("newton-c", "crosses", 1.0, (3.0,), seen(5, 6, 7)),
        EnginePoint[PileScore]("newton-c", "breaks", failure="not done after 9 s"),
    ]
    found = PileComparison([Engine(n, "", "", "", {}, "") for n in ("nuno-a", "newton-b", "newton-c")], points, (), ())
    rows = [row[-2:] for row in found.settings().rows]
    assert rows == [["", ""], ["", ""], ["1.5", "bar met"], ["0.5", "missed"], ["3", "bar met"], ["", "failed"]]
    assert found.verdicts() == [
        "nuno-a (tight): 4 s, cloth through cloth in 0 of 60 frames.",
        "newton-b (quick): 2 s, 0.5 times as long as ours, cloth through cloth in 0 of 60 frames.",
        "newton-c (crosses): 3 s, 3 times as long as ours, cloth through cloth in 3 of 60 frames.",
    ]


@pytest.mark.full
def test_page_tells_crossings_and_who_is_left_out(
    pile: Pile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("ipctk")
    settings = {"rests": {"depth": 0.0}, "sinks": {"depth": 0.06}}
    kinds = (
        Engine("fake-sinks", "", "fake_engines", "Sinks", settings, "A pile."),
        Engine("fake-none", "no_such_engine", "fake_engines", "Sinks", settings, "A pile."),
    )
    docs = tmp_path / "page.md"
    docs.write_text("before\n<!-- measured: peers contact -->\n<!-- end: peers contact -->\nafter\n")
    monkeypatch.setenv("PYTHONPATH", HERE)
    monkeypatch.setitem(peers.SCENES, "contact", replace(peers.SCENES["contact"], kinds=kinds))
    monkeypatch.setattr(peers, "five_sheets", lambda: pile)
    argv = ["bench", "peers", "contact", "--repeats", "2", "--out", str(tmp_path), "--docs", str(docs)]
    assert main(argv) == 0
    data = json.loads((tmp_path / "peers-contact.json").read_text())
    assert [point["score"]["crossed"] for point in data["points"]] == [[], [2]]
    told = "left out, fake-none: no_such_engine is not installed (pip install 'no_such_engine')"
    assert data["left_out"] == [told] and told in docs.read_text() and told in capsys.readouterr().out
    assert "| fake-sinks | sinks | 1 |" in docs.read_text()
