"""Other engines get the very sheet or pile that ours get, one judge looks at them, and none ends the comparison."""

from __future__ import annotations

import contextlib
import html
import importlib
import io
import json
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from nuno.cli import main
from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno_bench.peers import command as peers
from nuno_bench.peers import page as peer_page
from nuno_bench.peers.command import choose
from nuno_bench.peers.pile import (
    BEND,
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
from nuno_bench.peers.problem import Sheet, SheetScore, judge
from nuno_bench.peers.process import SHEET_KINDS, Engine, EnginePoint, measure
from nuno_bench.peers.python import NumPy, stiff_sheet
from nuno_schemas.fabric import Float, State

SMALL = ("objects.0.model.resolution=[9, 8]",)
HERE = str(Path(__file__).parent)


@pytest.fixture
def sheet() -> Sheet:
    return stiff_sheet(*SMALL)


@pytest.fixture
def fakes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", HERE)


def fake(made: str, *settings: dict[str, float], package: str = "") -> Engine:
    named = {str(setting): setting for setting in settings}
    return Engine(f"fake-{made.lower()}", package, "fake_engines", made, named, f"{made} <is> given.")


def against(sheet: Sheet, exact: Float) -> Callable[[Float], SheetScore]:
    return partial(judge, sheet, exact=exact)


def test_arrays_given_to_engines_have_the_accelerations_of_our_kernels(sheet: Sheet) -> None:
    simulation = Simulation(scene_file.read(shipped.find("stiff-sheet"), SMALL), None, None, 1)
    draw, n = np.random.default_rng(11), sheet.mass.size
    x = np.ascontiguousarray(sheet.x.T) + draw.normal(0.0, 0.01, (3, n))
    v = draw.normal(0.0, 1.0, (3, n)) * sheet.free
    state, other = State(np.ascontiguousarray(x.T), np.ascontiguousarray(v.T)), np.empty((3, n))
    forces = simulation.loaded.integrator.plugin.forces
    own = forces(simulation.system, state, simulation.memory, None).acceleration.T
    NumPy(sheet, 1e-3).accelerate(x, v, other)
    np.testing.assert_allclose(other, own, rtol=0, atol=1e-12 * np.abs(own).max())


def test_score_of_an_end_is_its_shift_and_its_stretch(sheet: Sheet) -> None:
    """Stretched by 1 % everywhere; twice that is twice the mean strain; the peak is the strain."""
    exact = 1.01 * sheet.x
    found = judge(sheet, 1.02 * sheet.x + [0.0, 3e-3, 4e-3], exact)
    middle = sheet.mass @ sheet.x / sheet.mass.sum()
    assert found.centre == pytest.approx(float(np.linalg.norm(0.01 * middle + [0.0, 3e-3, 4e-3])))
    assert found.strain == pytest.approx(2.0)
    assert found.peak == pytest.approx(0.02)


@pytest.mark.full
@pytest.mark.parametrize(("module", "made", "off"), [("mujoco", "Edges", 1e-9), ("newton", "SemiImplicit", 1e-4)])
def test_engines_that_step_as_numpy_does_end_where_it_does(sheet: Sheet, module: str, made: str, off: float) -> None:
    """Both are symplectic Euler: the same springs, dampers, masses, drag and pins give the same positions."""
    pytest.importorskip(module, reason=f"the peer engine {module} is not installed")
    engine = getattr(__import__(f"nuno_bench.peers.{module}", fromlist=[made]), made)(sheet, dt=1 / 3000)
    x, exact = engine.advance(0.2), NumPy(sheet, 1 / 3000).advance(0.2)
    moved = np.abs(exact - sheet.x).max()
    assert moved > 0.05
    np.testing.assert_allclose(x, exact, rtol=0, atol=off * moved)


def test_engine_in_a_process_of_its_own_gives_its_score(sheet: Sheet, fakes: None) -> None:
    point = measure(fake("Still", {"shift": 2e-3}), "{'shift': 0.002}", sheet, against(sheet, sheet.x), 3, 60.0)
    assert point.failure == ""
    assert len(point.seconds) == 3
    assert min(point.seconds) >= 0.01
    assert point.start is not None and point.start > 0.0
    assert point.score is not None and point.score.centre == pytest.approx(2e-3)
    assert point.remark == "it did nothing"


@pytest.mark.quick(made=["Crash"])
@pytest.mark.parametrize(
    ("made", "setting", "limit", "reason"),
    [
        ("Crash", {"after": 0.0}, 60.0, "signal SIGSEGV"),
        ("Hang", {"after": 0.0}, 1.0, "not done after 1 s"),
        ("Refuse", {"shift": 0.0}, 60.0, "RuntimeError: unstable at step 7"),
        ("Diverge", {"shift": 0.0}, 60.0, "no longer finite"),
        ("NoSuchEngine", {}, 60.0, "AttributeError"),
    ],
)
def test_engine_that_breaks_is_a_mark_with_its_reason(
    sheet: Sheet, fakes: None, made: str, setting: dict[str, float], limit: float, reason: str
) -> None:
    point = measure(fake(made, setting), str(setting), sheet, against(sheet, sheet.x), 1, limit)
    assert point.score is None
    assert reason in point.failure


def test_engine_that_breaks_while_it_repeats_keeps_what_it_has(sheet: Sheet, fakes: None) -> None:
    point = measure(fake("Crash", {"after": 3.0}), "{'after': 3.0}", sheet, against(sheet, 1.001 * sheet.x), 5, 60.0)
    assert len(point.seconds) == 2
    assert point.score is not None
    assert point.failure == ""
    assert "signal SIGSEGV" in point.remark


@pytest.mark.full
def test_engine_whose_starter_was_killed_ends_by_itself(fakes: None) -> None:
    code = "from multiprocessing import Pipe; from nuno_bench.peers.process import work; "
    code += "work(Pipe()[1], 'fake_engines', 'Hang', {'after': 0.0}, None, 1, 0.0)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=60.0).returncode == -signal.SIGALRM


def test_fastest_that_is_accurate_is_best_of_its_kind() -> None:
    good, off, loose = SheetScore(1e-3, 1.1, 0.1), SheetScore(7e-3, 1.0, 0.1), SheetScore(1e-3, 1.3, 0.1)
    points = [
        EnginePoint("nuno-a", "coarse", 0.1, (0.1,), off),
        EnginePoint("nuno-a", "fine", 0.1, (0.5, 0.4, 0.6), good),
        EnginePoint("other", "coarse", 0.1, (0.2,), loose),
        EnginePoint("other", "fine", 0.1, (5.0,), good),
        EnginePoint("never", "", None, (), None, "not done after 9 s"),
    ]
    kinds = [Engine(name, "", "", "", {}, "") for name in ("nuno-a", "other", "never")]
    found = peer_page.SheetComparison(kinds, points, (), 1.0)
    assert [row[-1] for row in found.settings().rows] == ["not accurate", "best of its kind"] * 2 + ["failed"]
    assert found.notes().rows == [["never", "", "not done after 9 s"]]
    assert "10 times faster" in " ".join(found.verdicts())
    assert "Accurate and done at no setting shown: never." in found.verdicts()


class Stretched:
    """The converged run, quickly."""

    def __init__(self, sheet: Sheet) -> None:
        self.end = 1.001 * sheet.x

    def advance(self, seconds: float) -> Float:
        return self.end


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[int, str, Path]:
    """The command on engines that are quick; one is not installed, one crashes: its code, output and folder."""
    small, folder, out = stiff_sheet(*SMALL), tmp_path_factory.mktemp("peers"), io.StringIO()
    kinds = (
        fake("Still", {"shift": 0.0}, {"shift": 1.0}),
        fake("Crash", {"after": 0.0}),
        fake("Hang", {"after": 0.0}, package="no_such_engine"),
    )
    docs = folder / "page.md"
    docs.write_text("before\n<!-- measured: peers -->\n<!-- end: peers -->\nafter\n")
    argv = ["bench", "peers", "--repeats", "2", "--out", str(folder), "--docs", str(docs)]
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out):
        patch.setenv("PYTHONPATH", HERE)
        patch.setitem(peers.SCENES, "sheet", replace(peers.SCENES["sheet"], kinds=kinds))
        patch.setattr(peers, "stiff_sheet", lambda: small)
        patch.setattr(peers, "Nuno", lambda sheet, solver: Stretched(sheet))
        code = main(argv)
    return code, out.getvalue(), folder


@pytest.mark.full
def test_absent_engine_is_named_with_its_install_command_and_no_error(run: tuple[int, str, Path]) -> None:
    code, out, folder = run
    told = "left out, fake-hang: no_such_engine is not installed (pip install 'no_such_engine')"
    assert code == 0
    assert told in out
    assert json.loads((folder / "peers.json").read_text())["left_out"] == [told]
    assert told in html.unescape((folder / "peers.html").read_text())


@pytest.mark.full
def test_page_and_table_hold_what_the_json_holds(run: tuple[int, str, Path]) -> None:
    _, out, folder = run
    data = json.loads((folder / "peers.json").read_text())
    shown, docs = html.unescape((folder / "peers.html").read_text()), (folder / "page.md").read_text()
    assert [point["kind"] for point in data["points"]] == ["fake-still", "fake-still", "fake-crash"]
    for point in data["points"]:
        cells = [point["kind"], point["setting"], point["failure"], point["remark"]]
        if point["score"]:
            cells.append(peer_page.number(1e3 * point["score"]["centre"]))
            cells.append(peer_page.number(point["median"]))
        for text in (shown, out, docs):
            assert all(cell in text for cell in cells)
    assert all(text in shown and text in docs for text in data["posed"].values())
    assert data["about"]["command"] in docs
    assert "<svg" in shown and "http" not in shown.replace("http://www.w3.org", "")
    assert docs.startswith("before\n") and docs.endswith("after\n")


@pytest.mark.parametrize(("only", "meant"), [("mujocco", "mujoco"), ("newton-vbd,numpi", "numpy")])
def test_unknown_engine_is_refused_with_the_nearest_name(
    only: str, meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", "peers", "--only", only]) == 2
    told = capsys.readouterr().err
    assert "no such peer" in told and f"did you mean {meant!r}?" in told


@pytest.mark.parametrize(("option", "value"), [("--repeats", "0"), ("--limit", "0"), ("--limit", "nan")])
def test_no_repeats_and_no_time_are_refused(option: str, value: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "peers", option, value]) == 2
    assert option in capsys.readouterr().err


def test_names_choose_engines_or_one_way_of_theirs() -> None:
    assert [kind.name for kind in choose(SHEET_KINDS, "mujoco,newton-vbd")] == [
        "mujoco-edges",
        "mujoco-tendons",
        "newton-vbd",
    ]
    assert choose(SHEET_KINDS, "") == list(SHEET_KINDS)


def test_every_setting_has_a_label_of_its_own() -> None:
    for kind in SHEET_KINDS:
        assert len(kind.settings) >= 1 and all(kind.settings), kind.name
    sizes = {kind.name: len(kind.settings) for kind in SHEET_KINDS}
    assert (sizes["newton-vbd"], sizes["scipy"], sizes["nuno-tr_bdf2"]) == (4, 3, 3)


CONTACT_SMALL = tuple(f"objects.{i}.model.resolution=[5, 5]" for i in range(len(SIDES)))


@pytest.fixture(scope="module")
def pile() -> Pile:
    return five_sheets(*CONTACT_SMALL)


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
        pytest.param("pile_mujoco", "IPC", {"dt": 1 / 600}, 10, 1.0, marks=pytest.mark.full),
    ],
)
def test_cloth_falls_freely_until_it_meets_anything(
    module: str, made: str, setting: dict[str, object], steps: int, kept: float
) -> None:
    """A step of both kinds of Euler goes h (v + g h), of which Style3D keeps 0.998 as velocity; frames come in order.

    Velocities are differences of positions in single precision, whose rounding by 3e-8 m adds up to 1.4e-5 m in 30.
    """
    if "_" in module:
        pytest.importorskip(module.rpartition("_")[2], reason="this peer engine is not installed")
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
    assert stiffness[across] * width / length[across] == pytest.approx(BEND, rel=1e-5)
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
