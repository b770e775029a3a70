"""Coming to rest: detection of rest, adaptive damping, and the message for cloth that does not settle.

`damping: auto` is 3 / t with t the time since the last start, the damping under which x'' + (3 / t) x' + grad E = 0
goes down in energy as Nesterov's method does (W. Su, S. Boyd, E. Candes, A differential equation for modeling
Nesterov's accelerated gradient method, JMLR 17(153), 2016): strong at first, then ever weaker, so that no frequency of
the cloth has to be known. Where the speed falls the cloth has passed the minimum: it stops and starts again, their
"speed restarting", which converges linearly. Rejected: a constant damping, which
is right for one frequency; 10 /s took twice the steps on a stocking of 150 x 150 points without friction.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.simulation.cloth import Piece
from nuno_schemas.fabric import Float, State
from nuno_schemas.scene import Fading, Scene
from nuno_schemas.system import System

REST_SPEED, REST_TIME, TREMBLES = 2e-4, 0.3, 0.125
"""Cloth rests when no vertex drifts faster than this share of the cloth's size a second, unless the
scene gives a speed, for this time [s]: a pendulum of 1 m keeps swings of less than 1 mm. Vibration with a period below
the last time [s] is averaged out: contact of taut cloth oscillates by a tenth of a millimetre
between two of its forces, and moves nothing."""
BALANCED = 1e-3
"""Cloth is balanced where no vertex has a larger unbalanced force than this share of the springs' mean tension."""
EXACT = 1e-6
"""Residual of a solver's steps beyond which cloth that does not settle may need more exact ones."""


class Stillness:
    """Detects rest by the positions of vertices.

    Rejected: velocities. Between forces that alternate, taut cloth stays in place while its velocity is that in the
    middle of a step, half a step of force (leapfrog, respa). `memory` is stored in checkpoints: the mean positions
    (n, 3) [m], and the frames (1,) since they were at place (n, 3) [m].
    """

    def __init__(self, frame_rate: float, vertices: int, speed: float) -> None:
        """`speed` [m/s] is the least that counts as motion."""
        self.needed, self.room = REST_TIME * frame_rate, speed * REST_TIME
        self.share = min(1.0, 1.0 / TREMBLES / frame_rate)
        self.frames, self.mean, self.place = np.zeros(1, np.int64), *np.full((2, vertices, 3), np.nan)
        self.memory: dict[str, NDArray[Any]] = {
            "rest_frames": self.frames, "rest_mean": self.mean, "rest_place": self.place,
        }  # fmt: skip

    def after(self, x: Float) -> None:
        """Record a finished frame with positions x (n, 3) [m]."""
        if self.room > 0.0 and not np.isnan(self.mean).any():
            self.mean += self.share * (x - self.mean)
            self.frames[0] += 1
            if not (np.abs(self.mean - self.place) <= self.room).all():
                self.frames[0], self.place[...] = 0, self.mean
        else:
            self.begin(x)

    def begin(self, x: Float) -> None:
        """Restart the count of frames at rest, at positions x (n, 3) [m]."""
        self.frames[0], self.mean[...], self.place[...] = 0, x, x

    @property
    def rests(self) -> bool:
        """Whether the cloth rests."""
        return bool(self.frames[0] >= self.needed)


class Relaxation:
    """Adaptive damping over the frames of one run; `memory` (2,) is stored in checkpoints: frames since the last
    restart, and the kinetic energy after the last frame [J].
    """

    def __init__(self, frame_rate: float, inertia: Float) -> None:
        """`inertia` (n,) is the mass of each vertex, 0 for a pinned one [kg]."""
        self.frame_rate, self.inertia = frame_rate, inertia[:, None]
        self.memory = np.zeros(2)

    @property
    def damping(self) -> float:
        """Damping of the next frame [1/s]."""
        return 3.0 * self.frame_rate / (1.0 + float(self.memory[0]))

    def after(self, state: State) -> None:
        """Record a finished frame; stop cloth that has become slower."""
        # The sum is exact: NumPy's order differs between machines, and the last bits would decide the restart.
        try:
            energy = math.fsum((self.inertia * state.v * state.v).ravel().tolist())
        except OverflowError:  # diverging cloth
            energy = math.inf
        self.memory[0] += 1.0
        if energy < self.memory[1]:
            state.v[...] = 0.0
            energy = self.memory[0] = 0.0
        self.memory[1] = energy


def damped(system: System, scene: Scene, frame: int, relaxation: Relaxation | None) -> System:
    """Return the system with the scene's damping from `frame` to the next."""
    if relaxation is not None:
        return replace(system, damping=relaxation.damping)
    if isinstance(scene.damping, Fading):
        return replace(system, damping=scene.damping.mean(frame / scene.frame_rate, (frame + 1) / scene.frame_rate))
    return system


def unsettled(share: Float, state: State, pieces: list[Piece], free: int, loose: bool) -> str:
    """Return the message for cloth that did not settle in its duration; share (n,) is each vertex's unbalance, and
    `loose` says whether the solver solves its steps to a residual above EXACT.
    """
    vertex, beyond = int(np.argmax(share)), int((share > BALANCED).sum())
    piece = next(piece.name for piece in pieces if vertex < piece.stop)
    place = ", ".join(f"{value:.4g}" for value in state.x[vertex])
    speed = float(np.linalg.norm(state.v, axis=1).max(initial=0.0))
    return (
        f"the cloth has not come to rest: {beyond:,} of {free:,} free vertices are farther from it than {BALANCED:g} "
        f"of the mean tension, the farthest, vertex {vertex} of {piece} at [{place}] m, by {share[vertex]:.3g}; the "
        f"fastest moves at {speed:.3g} m/s; lengthen the scene, for example --set duration=100s, or look for parts "
        "that nothing holds" + (f"; or solve steps more exactly, --set solver.residual={EXACT:g}" if loose else "")
    )
