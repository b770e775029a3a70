"""Laws of cloth that meets cloth: sound solvers keep them, and a contact that breaks one is found out."""

from __future__ import annotations

from typing import Any

import pytest

from nuno.plugin_contract import registry
from nuno_bench import piles
from nuno_bench.validation import command as suite
from nuno_bench.validation import contacts
from nuno_bench.validation.law import Outcome
from nuno_schemas.system import System

pytestmark = pytest.mark.full

CASES = {case.name: case for case in contacts.laws}
SOLVERS = ("symplectic_euler", "leapfrog", "rk4", "dopri5", "xpbd", "implicit_euler")


def outcome(case: str, solver: str = "symplectic_euler") -> Outcome:
    return suite.check(CASES[case], registry.load("nuno.integrators", solver))


@pytest.mark.parametrize("solver", SOLVERS)
def test_solvers_keep_every_law_of_cloth_contact(solver: str) -> None:
    """On grids and on irregular triangles; bits without contact are not asked of an adaptive method."""
    found = [outcome(case, solver) for case in CASES]
    unposed = {"cloth apart", "mesh apart"} if solver == "dopri5" else set()
    assert {one.case: one.reason for one in found if one.verdict != "passed" and one.case not in unposed} == {}
    assert {one.case for one in found if one.verdict == "unsupported"} == unposed
    assert len(found) == 16


@pytest.mark.parametrize("case", ["cloth slides", "mesh slide rate"])
def test_a_friction_that_is_two_percent_off_is_found_out(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    make = piles.pile

    def rougher(*pieces: Any, friction: float, **settings: Any) -> System:
        return make(*pieces, friction=1.02 * friction, **settings)

    monkeypatch.setattr(piles, "pile", rougher)
    assert outcome(case).verdict == "failed"


@pytest.mark.parametrize("case", ["cloth momentum", "cloth heap", "mesh pile"])
def test_cloth_that_does_not_meet_breaks_the_laws(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    make = piles.pile
    monkeypatch.setattr(piles, "pile", lambda *pieces, **settings: make(*pieces, **settings | {"contact": False}))
    assert outcome(case).verdict == "failed"
