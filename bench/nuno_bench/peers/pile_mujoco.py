"""MuJoCo, on the processor: the pile by its contact that keeps cloth from passing through cloth, the flag `ipc`.

https://mujoco.readthedocs.io, XML reference: option/flag/ipc, deformable/flex, flex/elasticity. It resolves contact
without friction, and commits no position before continuous collision detection has found the way to it free.
"""

from __future__ import annotations

import math

import numpy as np

from nuno_bench.peers import pile as problem
from nuno_bench.peers.mujoco import as_bodies, as_text, require_stable
from nuno_bench.peers.pile import Pile
from nuno_bench.peers.problem import RATE
from nuno_schemas.fabric import Float

POISSON = 1.0 / 3.0
"""Of cloth whose two Lame constants in the plane are SHEAR."""
IN_PLANE = 8.0 / 3.0 * problem.SHEAR
"""Young's modulus times the thickness of such cloth [N/m]."""
PLATE = math.sqrt(12.0 * problem.BEND * (1.0 - POISSON**2) / IN_PLANE)
"""Thickness [m] of a plate that is as stiff in its plane, and in bending."""


class IPC:
    """Triangles of cloth by the integrator `discrete`; each square is a flex of dimension 2."""

    def __init__(self, pile: Pile, dt: float) -> None:
        import mujoco

        self.mujoco, self.pile, self.dt, self.remark = mujoco, pile, dt, "contact without friction"
        r, centre = problem.RADIUS, as_text(np.array(problem.CENTRE))
        bodies = as_bodies(pile.x, pile.mass, np.zeros(len(pile.x), np.bool_))
        option = f'timestep="{dt!r}" integrator="discrete" solver="CG" gravity="{as_text(pile.gravity)}"'
        self.model = mujoco.MjModel.from_xml_string(
            f'<mujoco><option {option}><flag ipc="enable"/></option><size memory="2G"/>'
            f'<worldbody><geom type="sphere" size="{r!r}" pos="{centre}"/>{bodies}</worldbody>'
            f"<deformable>{self._squares()}</deformable></mujoco>"
        )
        self.data = mujoco.MjData(self.model)

    def _squares(self) -> str:
        flexes, first = [], 0
        elastic = f'young="{IN_PLANE / PLATE!r}" poisson="{POISSON!r}" thickness="{PLATE!r}" elastic2d="both"'
        for number, side in enumerate(problem.SIDES):
            end = first + side * side
            faces = self.pile.faces[(self.pile.faces[:, 0] >= first) & (self.pile.faces[:, 0] < end)] - first
            bodies, element = (
                " ".join(map(str, names)) for names in ([f"v{i}" for i in range(first, end)], faces.ravel())
            )
            flexes.append(
                f'<flex name="s{number}" dim="2" radius="{problem.THICKNESS / 2!r}" body="{bodies}" '
                f'element="{element}"><elasticity {elastic}/><contact selfcollide="auto"/></flex>'
            )
            first = end
        return "".join(flexes)

    def reset(self) -> None:
        self.mujoco.mj_resetData(self.model, self.data)

    def advance(self, seconds: float) -> Float:
        frames = []
        for _ in range(max(1, round(seconds * RATE))):
            self.mujoco.mj_step(self.model, self.data, max(1, round(1 / RATE / self.dt)))
            require_stable(self.data)
            frames.append(self.pile.x + self.data.qpos.reshape(-1, 3))
        return np.array(frames)
