"""What contact's share of a step goes into: each of its parts called alone, on cloth as it lies in a run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from nuno.simulation.run import Simulation
from nuno_bench.speed.timing import seconds
from nuno_contact.offset.brake import SWEEPS, brake, farthest_way
from nuno_contact.offset.hold import is_thorough, pass_by
from nuno_contact.offset.lists import choose_near, make_list
from nuno_contact.offset.meeting import Meeting
from nuno_contact.offset.places import CHOICES, LISTS_MADE, STEPS
from nuno_contact.offset.touching import drag_anchors, find_touching
from nuno_kernels.step.acceleration import evaluate
from nuno_kernels.step.packing import own_copy, silence
from nuno_kernels.step.rows import sum_rows

CALLS = 3
"""Of each part at a moment: the fastest counts, less what it takes Python to call anything with such a term."""


class Parts:
    """Times of the parts [s], at moments of a run with an explicit solver, and how often its steps need each."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.moments: list[dict[str, float]] = []
        self.begun = self._counted()

    def look(self) -> None:
        """Time the parts as the cloth lies now; the run goes on as if it had not been looked at."""
        packed, state, dt = self._packed, self.simulation.state, self.simulation.dt
        m, threads = own_copy(self._meeting), packed.threads
        x, v = m.last.copy(), np.zeros_like(m.last)
        v[:, : len(state.v)] = state.v.T
        there = sum_rows(x, dt, v)
        calls: dict[str, Callable[[], Any]] = {
            "planes between pairs": lambda: pass_by(m, there, farthest_way(v, dt), threads),
            "what touches": lambda: find_touching(m, threads),
            "anchors of friction": lambda: drag_anchors(m, v, threads),
            "brakes": lambda: brake(m, v.copy(), dt, SWEEPS[1 if len(m.local) else 0], threads),
            "what is near": lambda: choose_near(m, threads),
            "lists": lambda: make_list(m, threads),
        }
        own, a = packed._replace(forces=tuple(m if isinstance(f, Meeting) else f for f in packed.forces)), v.copy()
        alone, cloth, rates = silence(own, "cloth_contact"), x[:, : len(state.v)].copy(), v[:, : len(state.v)].copy()
        forces = fastest(lambda: evaluate(cloth, rates, 0.0, a, own, None))
        forces -= fastest(lambda: evaluate(cloth, rates, 0.0, a, alone, None))
        call = fastest(lambda: is_thorough(m))
        times = {name: fastest(part) - call for name, part in calls.items()}
        self.moments.append({name: max(0.0, time) for name, time in ({"forces of pairs": forces} | times).items()})

    def each(self) -> dict[str, float]:
        """What each part takes of a step [s], over the moments."""
        lists, choices, steps = (end - begin for end, begin in zip(self._counted(), self.begun, strict=True))
        often = {"lists": lists / steps, "what is near": choices / steps}
        return {
            name: often.get(name, 1.0) * float(np.mean([moment[name] for moment in self.moments]))
            for name in self.moments[0]
        }

    def _counted(self) -> tuple[int, int, int]:
        """Lists made so far, choices of what is near of them, and steps."""
        m = self._meeting
        return int(m.number[LISTS_MADE]), int(m.number[CHOICES]), int(m.so_far[STEPS])

    @property
    def _packed(self) -> Any:
        work: Any = self.simulation.memory.work
        return work.packed

    @property
    def _meeting(self) -> Meeting:
        (meeting,) = (term for term in self._packed.forces if isinstance(term, Meeting))
        return meeting


def fastest(call: Callable[[], Any]) -> float:
    """Wall time of the fastest of some calls [s], after one that may compile."""
    call()
    return min(seconds(call) for _ in range(CALLS))
