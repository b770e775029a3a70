"""How fast what the contributors' page shows is, beside what it replaces: python tests/services/speed_of_shown.py

The magnet beside a kernel over blocks written by hand, and a stage of heun3 beside one of rk4, in process time.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from foreign_packages import shown

from nuno_integrators.explicit.fixed_step import SymplecticEuler
from nuno_integrators.explicit.runge_kutta import RK4
from nuno_kernels import kernel
from nuno_kernels.step.blocks import BLOCK
from nuno_kernels.terms import register
from nuno_schemas.fabric import Fabric, Float, State
from nuno_schemas.system import System, Term

VERTICES, WORK, ROUNDS, DT = (256, 4096, 65536), 10_000_000, 15, 1e-4


class ByHand(NamedTuple):
    """The magnet's term."""

    stiffness: float


@kernel
def add_by_hand(pull: ByHand, block: int, origin: int, x: Float, v: Float, force: Float) -> None:
    """Add newtons to the forces (3, w) of a block of vertices."""
    for c in range(min(BLOCK, x.shape[1] - origin)):
        for row in range(3):
            force[row, c] += -pull.stiffness * x[row, origin + c]


register(ByHand, "by_hand", block=add_by_hand)


def module(name: str, folder: str) -> Any:
    """A module that the page shows, from a file in the folder."""
    (Path(folder) / f"{name}.py").write_text(shown(name))
    return import_module(name)


def stepping(plugin: Any, term: Any, n: int) -> Callable[[], float]:
    """Return a function that takes steps of n free vertices, and returns the microseconds of one."""
    x = np.random.default_rng(1).standard_normal((n, 3))
    fabric = Fabric("dust", x, np.zeros_like(x), np.ones(n), np.zeros(n, bool), np.zeros((0, 3), np.int32))
    system, state = System(fabric, np.zeros(3), 0.0, (Term("pull", (term,)),)), State(x.copy(), np.zeros_like(x))
    memory, steps = plugin.prepare(plugin.Config(), system, state), max(10, WORK // n)

    def go() -> float:
        begin = time.process_time()
        assert plugin.advance(system, state, memory, None, steps, DT).status == "ok"
        return 1e6 * (time.process_time() - begin) / steps

    go()
    return go


def main() -> None:
    """Print the medians of rounds in which both take turns."""
    with TemporaryDirectory() as folder:
        sys.path.insert(0, folder)
        pull, heun3 = module("magnets", folder).Pull, module("heun3", folder).Heun3()
        for n in VERTICES:
            euler, kutta = SymplecticEuler(), RK4()
            goes = [stepping(euler, ByHand(0.02), n), stepping(euler, pull(0.02), n)]
            goes += [stepping(kutta, pull(0.02), n), stepping(heun3, pull(0.02), n)]
            hand, vertex, four, three = np.median([[go() for go in goes] for _ in range(ROUNDS)], axis=0)
            print(f"{n} vertices: magnet {vertex:.3g} us a step, {vertex / hand:.2f} of the kernel by hand; "
                  f"heun3 {three / 3:.3g} us a stage, {three / 3 / (four / 4):.2f} of rk4's")  # fmt: skip


if __name__ == "__main__":
    main()
