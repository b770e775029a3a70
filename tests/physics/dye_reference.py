"""Cells of random widths and resists, and a step of dye written as a plain loop over them."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from nuno_dye.laws.diffusivity import Faces, face_values
from nuno_dye.laws.isotherms import (
    FREUNDLICH,
    LANGMUIR,
    PARTITION,
    Freundlich,
    FreundlichConfig,
    Known,
    Langmuir,
    LangmuirConfig,
    Partition,
    PartitionConfig,
)
from nuno_dye.solvers.bands import make_bands, read_bands
from nuno_dye.solvers.diffusion import diffuse
from nuno_dye.solvers.explicit import ExplicitConfig
from nuno_schemas.dye import Cells, Dye, DyeSystem, Isotherm, Tortuosity
from nuno_schemas.fabric import Float

PLAIN = Tortuosity(layers=0.3, beside=0.2, rim=0.1, gap=0.9, yarn=0.8, weave=0.47)


ISOTHERMS = {
    "nothing": None,
    "partition": Known(PARTITION, 0.7, 0.0),
    "freundlich": Known(FREUNDLICH, 0.4, 0.35),
    "langmuir": Known(LANGMUIR, 2.0, 0.0),
}
Place = tuple[int, int, int]
LAWS = {
    "partition": Partition().prepare(PartitionConfig(k=0.7)),
    "freundlich": Freundlich().prepare(FreundlichConfig(k=0.4, b=0.35)),
    "langmuir": Langmuir().prepare(LangmuirConfig(K=2.0)),
}
D0, CONFIG = 2e-10, ExplicitConfig()


def random_cells(ny: int, nx: int, seed: int = 3) -> Cells:
    rng = np.random.default_rng(seed)
    shape = (2, ny, nx)
    porosity = rng.uniform(0.2, 0.8, shape) * (rng.random(shape) > 0.1)
    return Cells(
        rng.random(shape) > 0.3,
        rng.random(shape) > 0.5,
        porosity,
        rng.uniform(0.5, 1, shape),
        np.zeros(shape),
        1e-4,
        PLAIN,
    )


def step_plainly(phi: Float, cells: Cells, scale: float) -> Float:
    """One step, cell by cell and face by face, from the text of the method."""
    t, out = cells.tortuosity, phi.copy()
    layers, ny, nx = phi.shape
    for layer, j, i in itertools.product(range(layers), range(ny), range(nx)):
        here = (layer, j, i)
        for there in ((layer, j, i + 1), (layer, j, i - 1), (layer, j + 1, i), (layer, j - 1, i), (1 - layer, j, i)):
            if not (0 <= there[1] < ny and 0 <= there[2] < nx):
                continue
            p, q = cells.porosity[here], cells.porosity[there]
            harmonic = 0.0 if p == 0.0 or q == 0.0 else 2.0 / (1.0 / p + 1.0 / q)
            tau = 0.5 * (cells.twist[here] + cells.twist[there])
            if there[0] != layer:
                tau *= t.layers
            elif cells.fibre[here] and cells.fibre[there]:
                yarn = (there[2] != i) if layer == 0 else (there[1] != j)
                tau *= t.yarn if yarn else t.beside
                tau *= t.weave if cells.up[here] != cells.up[there] else 1.0
            elif not cells.fibre[here] and not cells.fibre[there]:
                tau *= t.gap
            else:
                tau *= t.rim
            out[here] += scale * harmonic * tau * (phi[there] - phi[here])
    return out


def spread(phi: Float, faces: Faces, scale: float, steps: int, bands: int = 1) -> Float:
    packed = make_bands(phi, faces, scale, bands)
    diffuse(steps, packed, None, None, np.zeros(1, np.int64))
    return read_bands(packed, packed.phi, np.empty_like(phi))


def resisted(ny: int, nx: int) -> Cells:
    """Random cells, some of which paste or binding leaves little room or none."""
    rng = np.random.default_rng(13)
    return replace(random_cells(ny, nx), resist=rng.random((2, ny, nx)) * (rng.random((2, ny, nx)) > 0.4))


def limit(isotherm: str, phi: float, room: float) -> float:
    _, k, b = ISOTHERMS[isotherm] or (0, 0.0, 0.0)
    return {
        "nothing": 0.0,
        "partition": k * phi,
        "freundlich": k * phi**b,
        "langmuir": room * k * phi / (1.0 + k * phi),
    }[isotherm]


def plain_step(
    phi: Float, fixed: Float, cells: Cells, scale: float, rate: float, isotherm: str, back: float = 1.0
) -> tuple[Float, Float]:
    """One step, cell by cell and face by face, from the text of the method; phi - back A drives adsorption."""
    phi, fixed = phi.copy(), fixed.copy()
    for at in np.ndindex(*phi.shape):
        room = (1.0 - cells.porosity[at]) * cells.v_max if cells.fibre[at] else 0.0
        most = min(room, limit(isotherm, phi[at], room)) - fixed[at]
        taken = max(0.0, min(rate * max(0.0, phi[at] - back * fixed[at]), most, phi[at]))
        phi[at] -= taken
        fixed[at] += taken
    flows = face_flows(phi, cells, scale)
    came, went = np.zeros_like(phi), np.zeros_like(phi)
    for (donor, receiver), flow in flows.items():
        came[receiver] += flow
        went[donor] += flow
    room = cells.v_max * cells.porosity * (1.0 - cells.resist) - phi
    into = np.minimum(1.0, np.divide(room, came, out=np.ones_like(phi), where=came > 0.0))
    out_of = np.minimum(1.0, np.divide(phi, went, out=np.ones_like(phi), where=went > 0.0))
    for (donor, receiver), flow in flows.items():
        moved = flow * max(0.0, min(into[receiver], out_of[donor]))
        phi[donor] -= moved
        phi[receiver] += moved
    return phi, fixed


def face_flows(phi: Float, cells: Cells, scale: float) -> dict[tuple[Place, Place], float]:
    """Positive flow of every face, by donor and receiver, from single steps of pairs of cells."""
    faces, flows = face_values(cells), {}
    layers, ny, nx = phi.shape
    for layer, j, i in itertools.product(range(layers), range(ny), range(nx)):
        here: Place = (layer, j, i)
        near: list[tuple[Place, float]] = []
        if i + 1 < nx:
            near.append(((layer, j, i + 1), faces.along[here]))
        if j + 1 < ny:
            near.append(((layer, j + 1, i), faces.down[here]))
        if layer == 0:
            near.append(((1, j, i), faces.across[j, i]))
        for there, value in near:
            flow = scale * value * (phi[there] - phi[here])
            flows[(there, here) if flow > 0.0 else (here, there)] = abs(flow)
    return flows


def start(cells: Cells) -> tuple[Float, Float]:
    """Some cells full, some partly, most empty."""
    rng = np.random.default_rng(17)
    return cells.mobile_room * rng.choice([0.0, 0.0, 0.5, 1.0], cells.fibre.shape), np.zeros(cells.fibre.shape)


def dyed(cells: Cells, law: Isotherm | None, threads: int = 1, adsorption: float = 0.06) -> DyeSystem:
    return DyeSystem(cells, (Dye("blue", D0, adsorption, law),), threads)


def kept(cells: Cells, share: float = 1.0, seed: int = 2) -> Float:
    """(1, 2, ny, nx) a disc of floors, with some cells in it left out."""
    rng, (_, ny, nx) = np.random.default_rng(seed), cells.fibre.shape
    y, x = np.indices((ny, nx))
    disc = (2 * y - ny) ** 2 + (2 * x - nx) ** 2 < 0.25 * min(ny, nx) ** 2
    return share * (cells.mobile_room * disc * (rng.random(cells.fibre.shape) > 0.2))[None]
