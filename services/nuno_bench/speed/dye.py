"""Cases that time steps of dye: diffusion alone beside its peers, the whole model, the dye paper's figure 9."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from nuno import registry
from nuno.scene.files import SceneFiles
from nuno_bench.machine import cores
from nuno_bench.report.result import Result
from nuno_bench.speed import limits
from nuno_bench.speed.dye_peers import SlicedDiffusion, devito_diffusion
from nuno_bench.speed.timing import seconds, watch_compiler
from nuno_bench.validation.laws.dye import D0, SIZE, make_cells
from nuno_schemas.dye import Dye, DyeState, DyeSystem, Isotherm
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Float

UNIT = "G cell updates/s"
"""Billion cells times steps a second."""
WORK = 300_000_000
"""Cell updates of a sample: a few tenths of a second."""
SLOW = 10
"""A peer takes so many times fewer steps in a sample."""
BYTES = 36
"""Of a cell's step from memory: its amount read and written, two weights and half of a third."""
SHARE = 0.9
"""Of the stable step."""
LAWS = {
    "partition": Isotherm("partition", 0.5),
    "freundlich": Isotherm("freundlich", 0.5, 0.4),
    "langmuir": Isotherm("langmuir", 2.0),
}


def free_diffusion(ny: int, nx: int) -> tuple[DyeSystem, DyeState]:
    """Cells whose weights are all different, and amounts that no limit can bind."""
    rng = np.random.default_rng(2)
    cells = make_cells(ny, nx, layers=0.5, beside=0.3, porosity=rng.uniform(0.3, 0.6, (2, ny, nx)))
    phi = rng.uniform(0.0, 0.3, (1, 2, ny, nx))
    return DyeSystem(cells, (Dye("dye", D0),), cores()), DyeState(phi, np.zeros_like(phi))


def whole_model(ny: int, nx: int) -> tuple[DyeSystem, DyeState]:
    """The same with adsorption, cells that limits bind and resist over a tenth of them."""
    system, _ = free_diffusion(ny, nx)
    rng = np.random.default_rng(3)
    resist = rng.random((2, ny, nx)) * (rng.random((2, ny, nx)) < 0.1)
    cells = replace(system.cells, resist=resist)
    phi = (cells.mobile_room * (rng.random((2, ny, nx)) < 0.5))[None]
    dye = Dye("dye", D0, 0.01, LAWS["langmuir"])
    return replace(system, cells=cells, dyes=(dye,)), DyeState(phi, np.zeros_like(phi))


def figure_9(law: str) -> tuple[DyeSystem, DyeState]:
    """The dye paper's cloth of figure 9: plain weave, yarns of 8 cells and gaps of 2, a drop that is kept up."""
    plugin = registry.load("nuno.dye_cloths", "woven")
    yarn = {"width": 8, "gap": 2, "porosity": 0.5}
    config = plugin.Config.model_validate(
        {"cells": [200, 200], "cell_size": SIZE, "tau2": 0.47, "weft": yarn, "warp": yarn,
         "tau3": {"I": 1.0, "II": 1.0, "III": 1.0, "IV": 1.0, "V": 1.0}}
    )  # fmt: skip
    cells, state = plugin.build(config, SceneFiles(Path(), ()), 0, 1)
    y, x = np.ogrid[:200, :200]
    drop = np.hypot(y - 99.5, x - 99.5) < 15.0
    state.phi[0] = cells.mobile_room * drop
    return DyeSystem(cells, (Dye("dye", D0, 0.01, LAWS[law]),), cores(), state.phi.copy()), state


def time_dye(system: DyeSystem, state: DyeState, repeats: int, what: str, **about: Any) -> Result:
    """Rate of the explicit solver. Raises RunFailed if amounts do not stay finite."""
    plugin = registry.load("nuno.dye_solvers", "explicit")
    config = plugin.Config()
    memory = plugin.prepare(config, system, state)
    dt, cells = SHARE * plugin.limit(config, system), system.cells.fibre.size
    steps = max(1, WORK // cells)

    def advance(count: int) -> None:
        report = plugin.advance(system, state, memory, count, dt)
        if report.status != "ok":
            raise RunFailed(f"{what}: {report.message}")

    with watch_compiler() as compiler:
        first = seconds(lambda: advance(1))
    advance(steps // 10 + 1)
    samples = tuple(cells * steps / seconds(lambda: advance(steps)) * 1e-9 for _ in range(repeats))
    note = f"{cells:,} cells, {compiler.number} functions compiled; {plugin.about(system)}"
    limit = limits.bandwidth() / BYTES * 1e-9
    return Result("dye", what, UNIT, samples, compile_seconds=first, limit=limit, note=note, **about)


def time_peer(advance: Callable[[Float, int], None], phi: Float, repeats: int, what: str, note: str) -> Result:
    """Rate of a peer's steps of phi (2, ny, nx)."""
    steps = max(1, WORK // SLOW // phi.size)
    first = seconds(lambda: advance(phi, 1))
    samples = tuple(phi.size * steps / seconds(lambda: advance(phi, steps)) * 1e-9 for _ in range(repeats))
    return Result("dye", what, UNIT, samples, compile_seconds=first, limit=limits.bandwidth() / BYTES * 1e-9, note=note)


def dye(repeats: int) -> list[Result]:
    """All cases, ours beside the peers in one run."""
    system, state = free_diffusion(600, 800)
    start, scale = state.phi[0].copy(), _scale(system)
    results = [time_dye(system, state, repeats, "diffusion, 800x600x2, every face its own weight")]
    peers: dict[str, Callable[[Float, int], None]] = {"NumPy": SlicedDiffusion(system.cells, scale).advance}
    compiled = devito_diffusion(system.cells, scale, cores())
    if compiled is not None:
        peers["Devito"] = compiled
    for name, advance in peers.items():
        found = time_peer(advance, start.copy(), repeats, f"the same by {name}", "in the same run")
        ratio = tuple(results[0].median / sample for sample in found.samples)
        results += [found, Result("dye", f"ours over {name}", "times", ratio)]
    if compiled is None:
        results[0] = replace(results[0], note=f"{results[0].note}; Devito is not installed")
    results.append(time_dye(*whole_model(600, 800), repeats, "the whole model, 800x600x2", bar=0.4, aim=1.0))
    for law in LAWS:
        results.append(time_dye(*figure_9(law), repeats, f"figure 9, 200x200x2, {law}", bar=0.44, aim=1.1))
    return results


def _scale(system: DyeSystem) -> float:
    """D0 dt / size^2 of the steps that are timed."""
    plugin = registry.load("nuno.dye_solvers", "explicit")
    return float(D0 * SHARE * plugin.limit(plugin.Config(), system) / SIZE**2)
