"""The explicit step of diffusion by others, on the same cells: NumPy slices, and Devito where it is installed.

Devito is no extra of ours: it holds NumPy back, and puts packages named `test`, `scripts` and `examples` beside itself.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np

from nuno_schemas.dye import Cells
from nuno_schemas.fabric import Float


def weigh_faces(cells: Cells, scale: float) -> tuple[Float, Float, Float]:
    """`scale` P T of every face to the next column and row (2, ny, nx), 0 in the last, and between layers (ny, nx).

    For cloth that is all fibre, each layer either up or down, which has but three of the seven tortuosities.
    """
    assert cells.fibre.all() and all(layer.min() == layer.max() for layer in cells.up)
    p, tau, t = cells.porosity, cells.twist, cells.tortuosity
    along, down = np.zeros((2, *p.shape))
    yarns = np.array([[t.yarn, t.beside], [t.beside, t.yarn]])[:, :, None, None]
    along[:, :, :-1] = scale * _mean(p[:, :, 1:], p[:, :, :-1]) * 0.5 * (tau[:, :, 1:] + tau[:, :, :-1]) * yarns[0]
    down[:, :-1] = scale * _mean(p[:, 1:], p[:, :-1]) * 0.5 * (tau[:, 1:] + tau[:, :-1]) * yarns[1]
    across: Float = scale * _mean(p[0], p[1]) * 0.5 * (tau[0] + tau[1]) * t.layers
    return along, down, across


def _mean(a: Float, b: Float) -> Float:
    """Harmonic; 0 where both are."""
    total = a + b
    found: Float = np.divide(2.0 * a * b, total, out=np.zeros_like(total), where=total > 0.0)
    return found


class SlicedDiffusion:
    """phi += sum of weight times difference over a cell's five faces, by array slices."""

    def __init__(self, cells: Cells, scale: float) -> None:
        self.along, self.down, self.across = weigh_faces(cells, scale)
        self.flow, self.change = np.empty_like(self.along), np.empty_like(self.along)

    def advance(self, phi: Float, steps: int) -> None:
        """`steps` steps of phi (2, ny, nx), in place."""
        flow, change = self.flow, self.change
        for _ in range(steps):
            np.subtract(phi[:, :, 1:], phi[:, :, :-1], out=flow[:, :, :-1])
            flow *= self.along
            change[...] = flow
            change[:, :, 1:] -= flow[:, :, :-1]
            np.subtract(phi[:, 1:], phi[:, :-1], out=flow[:, :-1])
            flow *= self.down
            change += flow
            change[:, 1:] -= flow[:, :-1]
            through = self.across * (phi[1] - phi[0])
            change[0] += through
            change[1] -= through
            phi += change


def devito_diffusion(cells: Cells, scale: float, threads: int) -> Callable[[Float, int], None] | None:
    """The same compiled by Devito, for phi (2, ny, nx) in place and a number of steps; None where it is missing."""
    if importlib.util.find_spec("devito") is None:
        return None
    import devito

    devito.configuration["log-level"] = "ERROR"
    devito.configuration["language"] = "openmp" if threads > 1 else "C"
    along, down, across = weigh_faces(cells, scale)
    grid = devito.Grid(shape=across.shape, dtype=np.float64)
    y, x = grid.dimensions
    layers = [devito.TimeFunction(name=f"phi{k}", grid=grid, space_order=2) for k in (0, 1)]

    def field(name: str, values: Float) -> Any:
        made = devito.Function(name=name, grid=grid, space_order=2)
        made.data[...] = values
        return made

    through = field("across", across)
    equations = []
    for k, u in enumerate(layers):
        a, d = field(f"along{k}", along[k]), field(f"down{k}", down[k])
        change = a * (u.subs(x, x + x.spacing) - u) + d * (u.subs(y, y + y.spacing) - u)
        change += a.subs(x, x - x.spacing) * (u.subs(x, x - x.spacing) - u)
        change += d.subs(y, y - y.spacing) * (u.subs(y, y - y.spacing) - u)
        equations.append(devito.Eq(u.forward, u + change + through * (layers[1 - k] - u)))
    operator = devito.Operator(equations)

    def advance(phi: Float, steps: int) -> None:
        for k, u in enumerate(layers):
            u.data[0] = phi[k]
        options = {"nthreads": threads} if threads > 1 else {}
        operator.apply(time_m=0, time_M=steps - 1, **options)
        for k, u in enumerate(layers):
            phi[k] = u.data[steps % 2]

    return advance
