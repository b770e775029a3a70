"""MuJoCo: the sheet's springs as edges of 1D flexes, or as tendons.

Every vertex is a body on three slides, as MuJoCo's own `flexcomp` makes them; a pinned one has none.
https://mujoco.readthedocs.io, XML reference: flex/edge, tendon/spatial, option/integrator.
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from nuno_bench.peers.problem import Sheet
from nuno_schemas.fabric import Float

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
        sheet, lines = self.sheet, []
        drag = sheet.drag * self.damped_joints
        for i, (place, mass, pinned) in enumerate(zip(sheet.x, sheet.mass.tolist(), sheet.pinned, strict=True)):
            inner = f'<site name="s{i}"/>'
            if not pinned:
                damping = f' damping="{drag * mass!r}"' if drag else ""
                axes = ("1 0 0", "0 1 0", "0 0 1")
                inner += "".join(f'<joint type="slide" axis="{axis}"{damping}/>' for axis in axes)
                inner += f'<inertial pos="0 0 0" mass="{mass!r}" diaginertia="1e-9 1e-9 1e-9"/>'
            lines.append(f'<body name="v{i}" pos="{as_text(place)}">{inner}</body>')
        return f"<worldbody>{''.join(lines)}</worldbody>"

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
        kinds = self.mujoco.mjtWarning
        bad = [data.warning[kind] for kind in (kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC)]
        if any(warning.number for warning in bad):
            raise RuntimeError("MuJoCo calls the simulation unstable and starts it again")
        unconverged = data.warning[kinds.mjWARN_INERTIA].number
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


def as_text(values: Float) -> str:
    """Return numbers as an attribute has them."""
    return " ".join(repr(float(value)) for value in values)
