"""The laws of dye: the solvers that are installed keep them, and each of them finds out who breaks it."""

from __future__ import annotations

from dataclasses import replace
from importlib.metadata import EntryPoint
from typing import Any

import numpy as np
import pytest

from nuno.plugin_contract import registry
from nuno_bench.validation import command as validate
from nuno_bench.validation import dye
from nuno_bench.validation.dye import GROUP, make_cells
from nuno_bench.validation.law import Outcome
from nuno_dye.solvers.explicit import Explicit
from nuno_schemas.dye import Dye, DyeReport, DyeState, DyeSystem
from nuno_schemas.errors import BadInput

CASES = [case for case in validate.CASES if case.group == GROUP]


def check(case: str, plugin: Any) -> Outcome:
    return validate.check(next(one for one in CASES if one.name == case), plugin)


@pytest.mark.full
def test_every_installed_solver_passes_every_case_that_it_can_pose_and_three_can_pose_each() -> None:
    part = validate.Suite("dye", tuple(CASES), tuple(sorted(registry.installed(GROUP))))
    found = [validate.check(case, registry.load(GROUP, name)) for name in part.solvers for case in part.cases]
    assert {(one.case, one.solver): one.reason for one in found if one.verdict == "failed"} == {}
    posed = validate.count_posed(part, found)
    assert set(posed) == {case.name for case in CASES} and min(posed.values()) >= 3
    least, most = min(posed.values()), max(posed.values())
    text = f"each case of dye posed by {least if least == most else f'{least} to {most}'} solvers"
    assert text in validate.summary([part], found)


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


class Constant(Changed):
    """Knows no diffusion that falls with dye, and does not say so."""

    def prepare(self, config: Any, system: DyeSystem, state: DyeState) -> Any:
        dyes = tuple(replace(one, weisz_zollinger=None) for one in system.dyes)
        self.constant = replace(system, dyes=dyes)
        return super().prepare(config, self.constant, state)

    def advance(self, system: DyeSystem, state: DyeState, memory: Any, steps: int, dt: float) -> DyeReport:
        return super().advance(self.constant, state, memory, steps, dt)


class Picky(Explicit):
    """Refuses what every solver must pose."""

    def prepare(self, config: Any, system: DyeSystem, state: DyeState) -> Any:
        raise BadInput("not today")


class Refusing(Explicit):
    """Knows none, and says so."""

    def prepare(self, config: Any, system: DyeSystem, state: DyeState) -> Any:
        if any(one.weisz_zollinger for one in system.dyes):
            raise BadInput("its D is constant")
        return super().prepare(config, system, state)


@pytest.mark.quick(case=["balance", "bounds", "resist line", "dye's stated limit"])
@pytest.mark.parametrize(
    ("kind", "case"),
    [
        (Quick, "point source, isotropic"),
        (Quick, "variance, anisotropic"),
        (Quick, "order, dye"),
        (Quick, "two layers"),
        (Quick, "bath"),
        (Quick, "uptake by difference"),
        (Leaky, "balance"),
        (Negative, "bounds"),
        (Seeping, "resist line"),
        (Drifting, "point source, anisotropic"),
        (Unlimited, "dye's stated limit"),
        (Constant, "fast diffusion, along"),
        (Constant, "fast diffusion, across"),
        (Constant, "fast diffusion, wave"),
        (Constant, "fast diffusion, cap"),
    ],
)
def test_who_breaks_a_law_is_found_out(kind: type[Changed], case: str) -> None:
    assert check(case, Changed()).verdict == "passed"
    assert check(case, kind()).verdict == "failed"


@pytest.mark.parametrize("law", dye.LAWS)
def test_an_isotherm_that_is_a_hundredth_off_is_found_out(law: str) -> None:
    isotherm, limit = dye.LAWS[law]
    assert dye.measure_rest(Explicit(), isotherm, limit).error < 1e-3
    wrong = dye.measure_rest(Explicit(), isotherm, lambda phi: 1.01 * limit(phi))
    assert wrong.error > wrong.allowed


def test_what_a_solver_cannot_pose_is_unsupported_with_its_reason() -> None:
    for name in ("along", "order", "cap"):
        found = check(f"fast diffusion, {name}", Refusing())
        assert (found.verdict, found.reason) == ("unsupported", "its D is constant")


def test_who_refuses_plain_diffusion_breaks_its_law() -> None:
    found = check("two layers", Picky())
    assert found.verdict == "failed" and "not today" in found.reason
    assert check("uptake by difference", Picky()).verdict == "unsupported", "of an isotherm"


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
