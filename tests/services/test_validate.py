"""The suite of laws: sound solvers pass all, a wrong one is found out, and what is said follows from the figures."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nuno.cli import main
from nuno.plugin_contract import registry
from nuno_bench import piles
from nuno_bench.sweep.executor import Executor
from nuno_bench.validation import command as suite
from nuno_bench.validation import command as validate
from nuno_bench.validation import contacts, oscillator, statics
from nuno_bench.validation.law import Case, Measurement, Outcome, Unsupported
from nuno_integrators.explicit.runge_kutta import RK4, Tableau
from nuno_schemas.errors import BadInput
from nuno_schemas.fabric import Float
from nuno_schemas.system import System

GROUP = "nuno.integrators"
SOUND = ["leapfrog", "rk4", "symplectic_euler"]
CLOTH = [case.name for case in validate.CASES if case.group == GROUP]


def weighted(last: float) -> Tableau:
    """RK4's tableau, whose last stage has the weight `last` / 6 instead of 1 / 6."""
    return Tableau(RK4.tableau.a, (*RK4.tableau.b[:3], last / 6))


class Wrong(RK4):
    """RK4 with a slip in one weight, which its matrix does not have, as a third party might ship it."""

    name = "rk4_wrong"
    tableau = weighted(1.02)

    def amplification(self, omega: float | Float, damping: float | Float, dt: float | Float) -> Float:
        return RK4.tableau.amplification(omega, damping, dt)


class Right(Wrong):
    """The same without the slip."""

    name = "rk4_right"
    tableau = weighted(1.0)


@pytest.fixture
def foreign(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both are installed."""
    known = registry.entry_points
    ours = [EntryPoint(f"rk4_{n.lower()}", f"{__name__}:{n}", GROUP) for n in ("Wrong", "Right")]
    monkeypatch.setattr(
        registry, "entry_points", lambda group: [*known(group=group), *(ours if group == GROUP else [])]
    )


def outcomes(cases: list[str], solvers: list[str]) -> dict[tuple[str, str], Outcome]:
    parts = validate.choose_parts(cases or CLOTH, solvers)
    found = validate.check_all(parts, Executor(), lambda text: None)
    return {(o.case, o.solver): o for o in found}


@pytest.mark.full
def test_three_sound_solvers_pass_every_case() -> None:
    found = outcomes([], SOUND)
    assert {key: o.reason for key, o in found.items() if o.verdict != "passed"} == {}
    assert len(found) == len(SOUND) * len(CLOTH)
    (part,) = validate.choose_parts(CLOTH, SOUND)
    assert set(validate.count_posed(part, list(found.values())).values()) == {3}


QUICK = ("one step", "oscillator energy", "momentum", "rotation", "chain frequency 1")


@pytest.mark.quick(case=QUICK)
@pytest.mark.parametrize("case", [*QUICK, "angular momentum", "projectile", "order, net"])
def test_every_installed_solver_passes(case: str) -> None:
    found = outcomes([case], [])
    assert {key: o.reason for key, o in found.items() if o.verdict == "failed"} == {}
    assert {s for _, s in found} == set(registry.installed(GROUP))


def test_the_order_of_what_soon_is_at_rounding_is_fitted_above_it() -> None:
    (outcome,) = outcomes(["order, oscillator"], ["dop853"]).values()
    assert outcome.verdict == "passed"
    assert outcome.found is not None
    assert abs(outcome.found.measured - 8.0) < 0.15


class OrderEight:
    order = 8


def test_rounding_hides_no_wrong_order() -> None:
    counts = np.array([10.0, 14.0, 20.0, 28.0])

    def found(errors: Float) -> Measurement:
        return oscillator.order_found(OrderEight(), counts, 1.0, errors, 1.0)

    rounded = np.maximum(4.9e-4 / counts**8, 2e-15)
    assert rounded[-1] == 2e-15
    assert found(rounded).error < 1e-9
    assert found(4.9e-4 / counts**7).error == pytest.approx(1.0)
    assert math.isnan(found(np.full(4, math.nan)).error), "which fails"
    with pytest.raises(Unsupported, match="only 0 of 4 errors are above rounding"):
        found(np.zeros(4))


@pytest.mark.usefixtures("foreign")
def test_a_wrong_weight_is_found_out_and_the_right_one_passes() -> None:
    cases = ["one step", "oscillator energy", "order, oscillator", "order, net", "projectile", "rotation"]
    found = outcomes(cases, ["rk4_wrong", "rk4_right"])
    assert all(o.verdict == "passed" for (_, solver), o in found.items() if solver == "rk4_right")
    wrong = {case: o for (case, solver), o in found.items() if solver == "rk4_wrong"}
    assert {case for case, o in wrong.items() if o.verdict == "failed"} == set(cases) - {"rotation"}
    order = wrong["order, net"].found
    assert order is not None
    assert abs(order.measured) < 0.1, "it converges to something else"


@pytest.mark.usefixtures("foreign")
def test_a_failure_is_named_and_ends_the_command_with_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, data = tmp_path / "laws.html", tmp_path / "laws.json"
    command = ["validate", "one step", "rotation", "--solvers", "rk4,rk4_wrong", "--html", str(page)]
    command += ["--jobs", "1"]
    assert main([*command, "--json", str(data)]) == 1
    said = capsys.readouterr().out
    assert "failed: one step, rk4_wrong: measured" in said
    assert "3 passed, 1 failed, 0 unsupported" in said
    written = json.loads(data.read_text())
    assert written["counts"] == {"passed": 3, "failed": 1, "slip": 0, "unsupported": 0}
    assert [(o["case"], o["solver"]) for o in written["outcomes"] if o["verdict"] == "failed"] == [
        ("one step", "rk4_wrong")
    ]
    assert 'class="bad">failed' in page.read_text()
    assert main(["validate", "rotation", "--solvers", "rk4", "--jobs", "1"]) == 0


def test_slips_are_told_and_are_no_failure(capsys: pytest.CaptureFixture[str]) -> None:
    flags = ["--solvers", "rk4,rk4_printed", "--jobs", "1"]
    assert main(["validate", "projectile", *flags]) == 0
    said = capsys.readouterr().out
    assert "slip: rk4_printed, kept with the paper's slips: gravity counted twice" in said
    assert "1 passed, 0 failed, 0 unsupported, 1 slips of rk4_printed" in said


def test_what_a_solver_cannot_pose_is_unsupported_with_its_reason() -> None:
    found = outcomes(["critical step", "chain frequency 1"], ["implicit_euler", "dopri5", "euler"])
    assert found["critical step", "implicit_euler"].reason == "implicit: every step is stable"
    assert found["critical step", "dopri5"].verdict == "unsupported"
    assert "without damping" in found["chain frequency 1", "euler"].reason


def case_of(measure: Callable[[Any], Measurement]) -> Case:
    return Case("made up", "law", "source", measure)


def raising(error: Exception) -> Callable[[Any], Measurement]:
    def measure(plugin: Any) -> Measurement:
        raise error

    return measure


def test_verdicts_follow_from_the_error() -> None:
    rk4 = registry.load(GROUP, "rk4")

    def verdict(measure: Callable[[Any], Measurement]) -> str:
        return validate.check(case_of(measure), rk4).verdict

    assert verdict(lambda plugin: Measurement(1.0, 1.0, 0.1, 0.1)) == "passed"
    assert verdict(lambda plugin: Measurement(1.0, 1.0, 0.1001, 0.1)) == "failed"
    assert verdict(lambda plugin: Measurement(math.nan, 1.0, math.nan, 0.1)) == "failed"
    assert verdict(raising(ZeroDivisionError())) == "failed"
    assert verdict(raising(Unsupported("no"))) == "unsupported"


def test_the_table_fits_a_screen_of_120_columns_however_many_solvers_there_are() -> None:
    names = [*registry.installed(GROUP), *(f"someones_solver_{i}" for i in range(12))]
    part = validate.Suite("cloth", validate.CASES, tuple(names))
    found = [Outcome(c.name, n, "passed", "", Measurement(1.0, 1.0, 1e-9, 1.0)) for c in part.cases for n in names]
    text = validate.case_tables(part, found)
    assert max(map(len, text.splitlines())) <= 120
    assert text.count("1e-9") == len(found)


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (("--jobs", "0"), "at least one"),
        (("--jobs", "1", "--dask", "tcp://127.0.0.1:1"), "either --jobs or --dask"),
    ],
)
def test_bad_input_is_refused_before_anything_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], flags: tuple[str, ...], said: str
) -> None:
    assert main(["validate", "one step", "--json", str(tmp_path / "out"), *flags]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_unknown_names_are_answered_with_the_nearest() -> None:
    with pytest.raises(BadInput, match="no such case") as wrong:
        validate.choose_cases(["projectil3"])
    assert "projectile" in str(wrong.value)
    with pytest.raises(BadInput, match="no such solver"):
        validate.choose_parts([], ["rk5"])
    with pytest.raises(BadInput, match="the cases are of dye, the solvers are not"):
        validate.choose_parts(["two layers"], ["rk4"])


def elastica(gamma: float, steps: int = 400) -> float:
    """Drop / length of the heavy cantilever by shooting on theta'(0)."""

    def end(curvature: float) -> tuple[float, float]:
        h, y = 1.0 / steps, np.array([0.0, curvature, 0.0])

        def slope(s: float, y: Float) -> Float:
            return np.array([y[1], -gamma * (1.0 - s) * math.cos(y[0]), math.sin(y[0])])

        for i in range(steps):
            s = i * h
            k1 = slope(s, y)
            k2 = slope(s + 0.5 * h, y + 0.5 * h * k1)
            k3 = slope(s + 0.5 * h, y + 0.5 * h * k2)
            k4 = slope(s + h, y + h * k3)
            y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return float(y[1]), float(y[2])

    # theta'(1) grows with theta'(0) while theta stays below a right angle.
    low, high = 0.0, gamma
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if end(middle)[0] < 0.0 else (low, middle)
    return end(0.5 * (low + high))[1]


@pytest.mark.parametrize("gamma", statics.DROP)
def test_drops_of_the_cantilever_are_the_elasticas(gamma: int) -> None:
    assert elastica(gamma) == pytest.approx(statics.DROP[gamma], abs=2e-5)


CASES = {case.name: case for case in contacts.laws}
SOLVERS = ("symplectic_euler", "leapfrog", "rk4", "dopri5", "xpbd", "implicit_euler")


def outcome(case: str, solver: str = "symplectic_euler") -> Outcome:
    return suite.check(CASES[case], registry.load("nuno.integrators", solver))


@pytest.mark.parametrize("case", ["mesh slide rate", "mesh pile", "mesh momentum"])
def test_symplectic_euler_keeps_the_laws_of_cloth_contact(case: str) -> None:
    assert outcome(case).verdict == "passed"


@pytest.mark.full
@pytest.mark.parametrize("solver", SOLVERS)
def test_solvers_keep_every_law_of_cloth_contact(solver: str) -> None:
    """On grids and on irregular triangles; bits without contact are not asked of an adaptive method."""
    found = [outcome(case, solver) for case in CASES]
    unposed = {"cloth apart", "mesh apart"} if solver == "dopri5" else set()
    assert {one.case: one.reason for one in found if one.verdict != "passed" and one.case not in unposed} == {}
    assert {one.case for one in found if one.verdict == "unsupported"} == unposed
    assert len(found) == 20


@pytest.mark.full
@pytest.mark.parametrize("case", ["cloth slides", "mesh slide rate"])
def test_a_friction_that_is_two_percent_off_is_found_out(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    make = piles.pile

    def rougher(*pieces: Any, friction: float, **settings: Any) -> System:
        return make(*pieces, friction=1.02 * friction, **settings)

    monkeypatch.setattr(piles, "pile", rougher)
    assert outcome(case).verdict == "failed"


@pytest.mark.full
@pytest.mark.parametrize("case", ["cloth momentum", "cloth heap", "mesh pile"])
def test_cloth_that_does_not_meet_breaks_the_laws(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    make = piles.pile
    monkeypatch.setattr(piles, "pile", lambda *pieces, **settings: make(*pieces, **settings | {"contact": False}))
    assert outcome(case).verdict == "failed"
