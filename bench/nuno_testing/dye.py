"""The contract of plugins of dye: solvers and isotherms."""

from __future__ import annotations

import itertools
from dataclasses import replace
from math import fsum

import numpy as np

from nuno.runtime.stepper import check_kept
from nuno_schemas.dye import Cells, Dye, DyeState, DyeSystem, Isotherm, Tortuosity
from nuno_schemas.fabric import Float
from nuno_testing.subject import Subject, made_twice

D0, LANGMUIR = 1e-9, Isotherm("langmuir", 2.0)


def cloth(side: int) -> Cells:
    """Return random cells, some of which have little or no capacity left by paste or binding."""
    rng, shape = np.random.default_rng(11), (2, side, side + 1)
    up = rng.random(shape[1:]) > 0.5
    porosity, resist = rng.uniform(0.2, 0.8, shape), rng.random(shape) * (rng.random(shape) > 0.7)
    return Cells(
        rng.random(shape) > 0.3, np.stack([~up, up]), porosity, rng.random(shape), resist, 1e-4,
        Tortuosity(0.5, 0.3, 0.6, 1.0, 0.8, 0.4),
    )  # fmt: skip


def make_system(side: int = 14, threads: int = 1, law: Isotherm | None = LANGMUIR) -> DyeSystem:
    """Return a cloth with one dye."""
    return DyeSystem(cloth(side), (Dye("blue", D0, 0.06 if law else 0.0, law),), threads)


def start(system: DyeSystem) -> DyeState:
    """Return a state with random full cells."""
    room = system.cells.mobile_room[None]
    return DyeState(room * (np.random.default_rng(2).random(room.shape) > 0.6), 0.0 * room)


def spread(subject: Subject, system: DyeSystem, seconds: float, *frames: int) -> DyeState:
    """Return the amounts after frames of these numbers of steps, and check the reported totals."""
    state, total = start(system), start(system).phi.sum()
    memory = subject.plugin.prepare(subject.config, system, state)
    for steps in frames:
        report = subject.plugin.advance(system, state, memory, steps, seconds / sum(frames))
        assert report.status == "ok"
        check_kept(memory, memory.arrays)
        for totals, amounts in ((report.mobile, state.phi), (report.fixed, state.fixed)):
            assert abs(totals[0] - fsum(amounts.reshape(-1))) <= 1e-13 * total
    return state


def stable_step(subject: Subject, system: DyeSystem) -> float:
    """Return a stable step [s]: the solver's limit, or at most the time scale of diffusion between neighbours."""
    state = DyeState(*np.zeros((2, 1, *system.cells.fibre.shape)))
    subject.plugin.prepare(subject.config, system, state)
    return float(min(subject.plugin.limit(subject.config, system), system.cells.size**2 / D0))


def dye_is_kept_within_its_bounds(subject: Subject) -> None:
    """The total is conserved, every cell stays between 0 and its capacity, and some dye is fixed."""
    system = make_system()
    steps, t = 40, 40.0 * stable_step(subject, system)
    end, total = spread(subject, system, t, steps), fsum(start(system).phi.reshape(-1))
    kept = fsum(end.phi.reshape(-1)) + fsum(end.fixed.reshape(-1))
    assert abs(kept - total) <= 1e-13 * np.sqrt(steps) * total
    assert end.phi.min() >= 0.0 and end.fixed.min() >= 0.0 and end.fixed.max() > 0.0
    assert (end.phi[0] <= system.cells.mobile_room).all() and (end.fixed[0] <= system.cells.fixed_room).all()


def frames_and_threads_change_no_bit(subject: Subject) -> None:
    """A run gives the same bits when repeated, cut into frames, and on two threads if the cloth is large enough."""
    system = make_system(160)
    t = 12.0 * stable_step(subject, system)
    whole = made_twice(lambda: spread(subject, system, t, 12), system.cells)
    for other in (spread(subject, system, t, 4, 4, 4), spread(subject, replace(system, threads=2), t, 12)):
        assert (other.phi.tobytes(), other.fixed.tobytes()) == (whole.phi.tobytes(), whole.fixed.tobytes())


def shorter_steps_come_to_one_end(subject: Subject) -> None:
    """For pure diffusion, the change by halving the step falls at least as for a method of first order."""
    system = make_system(law=None)
    t = 8.0 * stable_step(subject, system)
    ends = [spread(subject, system, t, steps).phi for steps in (32, 64, 128)]
    coarse, fine = (np.abs(a - b).max() for a, b in itertools.pairwise(ends))
    assert fine < 0.6 * coarse


SOLVERS = (dye_is_kept_within_its_bounds, frames_and_threads_change_no_bit, shorter_steps_come_to_one_end)


def largest_fixed(law: Isotherm, phi: Float, room: Float) -> Float:
    """Return A_d by the formula of each kind in the schema."""
    if law.function is not None:
        return law.function(phi, room)
    formulas = {
        "partition": law.first * phi,
        "freundlich": law.first * phi**law.second,
        "langmuir": room * law.first * phi / (1.0 + law.first * phi),
    }
    return formulas[law.kind]


def more_dye_beside_it_never_fixes_less(subject: Subject) -> None:
    """The largest fixed amount is 0 without mobile dye and never falls with more of it; arrays are not changed."""
    law = subject.plugin.prepare(subject.config)
    phi, room = np.tile(np.linspace(0.0, 1.0, 101), (2, 3, 1)), np.full((2, 3, 101), 0.6)
    fixed = made_twice(lambda: largest_fixed(law, phi, room), phi, room)
    assert fixed.shape == phi.shape
    assert (fixed[..., 0] == 0.0).all() and (np.diff(fixed, axis=-1) >= 0.0).all() and fixed.max() > 0.0


ISOTHERMS = (more_dye_beside_it_never_fixes_less,)
