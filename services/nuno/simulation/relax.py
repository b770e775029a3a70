"""Coming to rest: damping that finds its own strength, and what is said of cloth that does not.

`damping: auto` is 3 / t with t the time since the last start, the damping under which x'' + (3 / t) x' + grad E = 0
goes down in energy as Nesterov's method does (W. Su, S. Boyd, E. Candes, A differential equation for modeling
Nesterov's accelerated gradient method, JMLR 17(153), 2016): strong at first, then ever weaker, so that no frequency of
the cloth has to be known. Where the speed falls the cloth has gone past the bottom: it stops and starts again, their
"speed restarting", which converges linearly. Not chosen: a constant damping, which
is right for one frequency; 10 /s took twice the steps on a stocking of 150 x 150 points without friction.
"""

from __future__ import annotations

import math

import numpy as np

from nuno.cloth.build import Piece
from nuno_schemas.fabric import Float, State

BALANCED = 1e-3
"""Cloth is in balance where no vertex is farther from rest than this share of the springs' mean tension."""


class Relaxation:
    """Damping over the frames of one run; `memory` (2,) goes into checkpoints: frames since the last start, and the
    kinetic energy after the last one [J].
    """

    def __init__(self, frame_rate: float, inertia: Float) -> None:
        """`inertia` (n,) masses of the vertices, 0 for those that are held [kg]."""
        self.frame_rate, self.inertia = frame_rate, inertia[:, None]
        self.memory = np.zeros(2)

    @property
    def damping(self) -> float:
        """Of the next frame [1/s]."""
        return 3.0 * self.frame_rate / (1.0 + float(self.memory[0]))

    def after(self, state: State) -> None:
        """Note a finished frame; cloth that has become slower stops."""
        # Exactly: in NumPy's order, which differs between machines, the last bits would decide when to start again.
        try:
            energy = math.fsum((self.inertia * state.v * state.v).ravel().tolist())
        except OverflowError:  # of cloth that flies apart
            energy = math.inf
        self.memory[0] += 1.0
        if energy < self.memory[1]:
            state.v[...] = 0.0
            energy = self.memory[0] = 0.0
        self.memory[1] = energy


def unsettled(share: Float, state: State, pieces: list[Piece], free: int) -> str:
    """What is said of cloth that its duration was too short for; share (n,) is how far each vertex is from rest."""
    vertex, beyond = int(np.argmax(share)), int((share > BALANCED).sum())
    piece = next(piece.name for piece in pieces if vertex < piece.stop)
    place = ", ".join(f"{value:.4g}" for value in state.x[vertex])
    speed = float(np.linalg.norm(state.v, axis=1).max(initial=0.0))
    return (
        f"the cloth has not come to rest: {beyond:,} of {free:,} free vertices are farther from it than {BALANCED:g} "
        f"of the mean tension, the farthest, vertex {vertex} of {piece} at [{place}] m, by {share[vertex]:.3g}; the "
        f"fastest moves at {speed:.3g} m/s; lengthen the scene, for example --set duration=100s, or look for parts "
        "that nothing holds"
    )
