"""MuJoCo: the sheet's springs as edges of 1D flexes, or as tendons.

Every vertex is a body on three slides, as MuJoCo's own `flexcomp` makes them; a pinned one has none.
https://mujoco.readthedocs.io, XML reference: flex/edge, tendon/spatial, option/integrator.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np

from nuno_bench.peers.problem import Sheet
from nuno_schemas.fabric import Bool, Float

QUIET = '<contact contype="0" conaffinity="0" selfcollide="none"/>'


class _MuJoCo:
    damped_joints = False
    """Whether MuJoCo takes air drag as damping of the slides; bodies of a flex may not have any."""

    def __init__(self, sheet: Sheet, dt: float, integrator: str) -> None:
        import mujoco

        self.mujoco, self.sheet, self.dt, self.remark = mujoco, sheet, dt, ""
        option = f'timestep="{dt!r}" integrator="{integrator}" solver="CG" gravity="{as_text(sheet.gravity)}"'
        parts = [f'<option {option}><flag contact="disable"/></option><size memory="2G"/>', self._bodies()]
        self.model = mujoco.MjModel.from_xml_string(f"<mujoco>{''.join(parts)}{self._elastic()}</mujoco>")
        self.data = mujoco.MjData(self.model)
        self.drag = -sheet.drag * np.repeat(sheet.mass[sheet.free], 3)

    def _bodies(self) -> str:
        drag = self.sheet.drag * self.damped_joints
        return f"<worldbody>{as_bodies(self.sheet.x, self.sheet.mass, self.sheet.pinned, drag)}</worldbody>"

    @abstractmethod
    def _elastic(self) -> str: ...

    def reset(self) -> None:
        self.mujoco.mj_resetData(self.model, self.data)

    def advance(self, seconds: float) -> Float:
        steps, data = max(1, round(seconds / self.dt)), self.data
        if self.damped_joints:
            self.mujoco.mj_step(self.model, data, steps)
        else:
            for _ in range(steps):
                np.multiply(data.qvel, self.drag, out=data.qfrc_applied)
                self.mujoco.mj_step(self.model, data)
        require_stable(data)
        unconverged = data.warning[self.mujoco.mjtWarning.mjWARN_INERTIA].number
        self.remark = f"its linear solve did not converge in {unconverged} of {steps} steps" if unconverged else ""
        x: Float = self.sheet.x.copy()
        x[self.sheet.free] += data.qpos.reshape(-1, 3)
        return x


class Edges(_MuJoCo):
    """Each spring an edge of a 1D flex of its stiffness and damping: the same equations, stepped explicitly."""

    def __init__(self, sheet: Sheet, dt: float) -> None:
        super().__init__(sheet, dt, "Euler")

    def _elastic(self) -> str:
        sheet, flexes = self.sheet, []
        constants, kind = np.unique(np.round(np.column_stack([sheet.k, sheet.c]), 12), axis=0, return_inverse=True)
        for number, (k, c) in enumerate(constants):
            used, local = np.unique(sheet.pairs[kind.reshape(-1) == number], return_inverse=True)
            bodies = " ".join(f"v{i}" for i in used)
            element = " ".join(map(str, local.reshape(-1)))
            edge = f'<edge stiffness="{float(k)!r}" damping="{float(c)!r}"/>{QUIET}'
            names = f'name="e{number}" dim="1" radius="1e-4"'
            flexes.append(f'<flex {names} body="{bodies}" element="{element}">{edge}</flex>')
        return f"<deformable>{''.join(flexes)}</deformable>"


class Tendons(_MuJoCo):
    """Each spring a tendon between two sites: the same equations, stepped by the implicit integrator."""

    damped_joints = True

    def __init__(self, sheet: Sheet, dt: float) -> None:
        super().__init__(sheet, dt, "discrete")

    def _elastic(self) -> str:
        sheet, lines = self.sheet, []
        for (i, j), k, rest, c in zip(sheet.pairs, sheet.k, sheet.rest, sheet.c, strict=True):
            own = f'springlength="{float(rest)!r}" stiffness="{float(k)!r}" damping="{float(c)!r}"'
            lines.append(f'<spatial {own}><site site="s{i}"/><site site="s{j}"/></spatial>')
        return f"<tendon>{''.join(lines)}</tendon>"


def as_bodies(x: Float, mass: Float, pinned: Bool, drag: float = 0.0) -> str:
    """Return bodies v0, v1, ... on slides at x (n, 3) [m], of mass (n,) [kg] and drag [1/s], with sites s0, s1, ..."""
    lines = []
    for i, (place, own, held) in enumerate(zip(x, mass.tolist(), pinned.tolist(), strict=True)):
        inner = f'<site name="s{i}"/>'
        if not held:
            damping = f' damping="{drag * own!r}"' if drag else ""
            inner += "".join(f'<joint type="slide" axis="{axis}"{damping}/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
            inner += f'<inertial pos="0 0 0" mass="{own!r}" diaginertia="1e-9 1e-9 1e-9"/>'
        lines.append(f'<body name="v{i}" pos="{as_text(place)}">{inner}</body>')
    return "".join(lines)


def require_stable(data: Any) -> None:
    """Raise RuntimeError for a simulation that MuJoCo has begun again."""
    import mujoco

    kinds = mujoco.mjtWarning
    if any(data.warning[kind].number for kind in (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)):
        raise RuntimeError("MuJoCo calls the simulation unstable and starts it again")


def as_text(values: Float) -> str:
    """Return numbers as an attribute has them."""
    return " ".join(repr(float(value)) for value in values)
