"""The laws of dye: the solvers that are installed keep them, and each of them finds out who breaks it."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from typing import Any

import numpy as np
import pytest

from nuno import registry
from nuno_bench import validate
from nuno_bench.laws import dye_amounts
from nuno_bench.laws.base import Outcome
from nuno_bench.laws.dye import GROUP, make_cells
from nuno_dye.explicit import Explicit
from nuno_schemas.dye import Dye, DyeReport, DyeState, DyeSystem

CASES = [case for case in validate.CASES if case.group == GROUP]


def check(case: str, plugin: Any) -> Outcome:
    return validate.check(next(one for one in CASES if one.name == case), plugin)


@pytest.mark.parametrize("solver", sorted(registry.installed(GROUP)))
def test_every_installed_solver_passes_every_case(solver: str) -> None:
    plugin = registry.load(GROUP, solver)
    found = [validate.check(case, plugin) for case in CASES]
    assert {one.case: one.reason for one in found if one.verdict == "failed"} == {}
    assert sum(one.verdict == "passed" for one in found) >= 15


class Changed(Explicit):
    """A third party's solver, which does something before the steps of ours."""

    name = "changed"

    def advance(self, system: DyeSystem, state: DyeState, memory: Any, steps: int, dt: float) -> DyeReport:
        if steps:
            self.change(system, state)
        return super().advance(system, state, memory, steps, dt)

    def change(self, system: DyeSystem, state: DyeState) -> None: ...


class Quick(Changed):
    """Takes steps 2 % longer than it is asked for."""

    def advance(self, system: DyeSystem, state: DyeState, memory: Any, steps: int, dt: float) -> DyeReport:
        return super().advance(system, state, memory, steps, 1.02 * dt)


class Leaky(Changed):
    """Loses a part in 1e10 a frame."""

    def change(self, system: DyeSystem, state: DyeState) -> None:
        state.phi *= 1.0 - 1e-10


class Negative(Changed):
    """Takes a little more from a cell than it holds."""

    def advance(self, system: DyeSystem, state: DyeState, memory: Any, steps: int, dt: float) -> DyeReport:
        report = super().advance(system, state, memory, steps, dt)
        state.phi[0, 0, 0, 0] = -1e-12
        return report


class Seeping(Changed):
    """Lets a little through to the far edge."""

    def change(self, system: DyeSystem, state: DyeState) -> None:
        state.phi[0, :, :, -1] += 1e-15


class Drifting(Changed):
    """Moves all dye by a cell along the weft."""

    def change(self, system: DyeSystem, state: DyeState) -> None:
        state.phi[...] = np.roll(state.phi, 1, axis=3)


class Unlimited(Changed):
    """States a limit that is 4 % too long."""

    def limit(self, config: Any, system: DyeSystem) -> float:
        return 1.04 * super().limit(config, system)


@pytest.mark.parametrize(
    ("kind", "case"),
    [
        (Quick, "point source, isotropic"),
        (Quick, "variance, anisotropic"),
        (Quick, "order, dye"),
        (Quick, "two layers"),
        (Quick, "bath"),
        (Quick, "uptake"),
        (Leaky, "balance"),
        (Negative, "bounds"),
        (Seeping, "resist line"),
        (Drifting, "point source, anisotropic"),
        (Unlimited, "dye's stated limit"),
    ],
)
def test_who_breaks_a_law_is_found_out(kind: type[Changed], case: str) -> None:
    assert check(case, Changed()).verdict == "passed"
    assert check(case, kind()).verdict == "failed"


@pytest.mark.parametrize("law", dye_amounts.LAWS)
def test_an_isotherm_that_is_a_hundredth_off_is_found_out(law: str) -> None:
    isotherm, limit = dye_amounts.LAWS[law]
    assert dye_amounts.measure_rest(Explicit(), isotherm, limit).error < 1e-3
    wrong = dye_amounts.measure_rest(Explicit(), isotherm, lambda phi: 1.01 * limit(phi))
    assert wrong.error > wrong.allowed


def test_what_a_solver_cannot_pose_is_unsupported_with_its_reason() -> None:
    assert check("fast diffusion", Explicit()).reason == "its coefficient of diffusion is constant"
    assert check("bounds, long steps", Explicit()).reason == "explicit: no such step is stable"


def test_other_packages_solvers_are_held_to_the_laws_of_dye_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    known, ours = registry.entry_points, EntryPoint("changed", f"{__name__}:Changed", GROUP)
    monkeypatch.setattr(
        registry, "entry_points", lambda group: [*known(group=group), *([ours] if group == GROUP else [])]
    )
    (part,) = validate.choose_parts([], ["changed"])
    assert part.solvers == ("changed",) and list(part.cases) == CASES
    cloth, dye = validate.choose_parts([], [])
    assert "changed" in dye.solvers and "changed" not in cloth.solvers
    assert len(cloth.cases) + len(dye.cases) == len(validate.CASES)


def test_cells_of_the_laws_have_the_coefficients_that_are_asked_for() -> None:
    """The stable step says what a cell's faces add up to: P (2 (1 + 1 / 4) + 1 / 2)."""
    system = DyeSystem(make_cells(9, 9, beside=0.25, layers=0.5), (Dye("dye", 1.0),))
    limit = Explicit().limit(Explicit.Config(), system)  # type: ignore[arg-type]
    assert limit == pytest.approx(system.cells.size**2 / (0.5 * 3.0), rel=1e-12)
