"""Cases that time steps of dye: diffusion alone, the whole model, the dye paper's figure 9."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from nuno import registry
from nuno.scene.files import SceneFiles
from nuno_bench.machine import cores
from nuno_bench.report.page import Result
from nuno_bench.speed.timing import bandwidth, measure
from nuno_bench.validation.dye import D0, SIZE, make_cells
from nuno_schemas.dye import Dye, DyeState, DyeSystem, Isotherm
from nuno_schemas.errors import RunFailed

UNIT = "G cell updates/s"
"""Billion cells times steps a second."""
WORK = 300_000_000
"""Cell updates of a sample: a few tenths of a second."""
BYTES = 36
"""Bytes that a cell's step moves from and to memory: its amount read and written, two weights and half of a third."""
SHARE = 0.9
"""Share of the stable step that is taken."""
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
    cells, state = plugin.build(config, SceneFiles(Path(), ()), 0, ["dye"])
    y, x = np.ogrid[:200, :200]
    drop = np.hypot(y - 99.5, x - 99.5) < 15.0
    state.phi[0] = cells.mobile_room * drop
    return DyeSystem(cells, (Dye("dye", D0, 0.01, LAWS[law]),), cores(), state.phi.copy()), state


def time_dye(
    what: str, system: DyeSystem, state: DyeState, repeats: int, bar: float | None = None, aim: float | None = None
) -> Result:
    """Rate of the explicit solver. Raises RunFailed if amounts do not stay finite."""
    plugin = registry.load("nuno.dye_solvers", "explicit")
    config, cells = plugin.Config(), system.cells.fibre.size
    memory, dt = plugin.prepare(config, system, state), SHARE * plugin.limit(config, system)
    steps = max(1, WORK // cells)

    def advance() -> None:
        report = plugin.advance(system, state, memory, steps, dt)
        if report.status != "ok":
            raise RunFailed(f"{what}: {report.message}")

    note, limit = f"{cells:,} cells; {plugin.about(system)}", 1e-9 * bandwidth() / BYTES
    return measure("dye", what, UNIT, advance, repeats, 1e-9 * cells * steps, bar=bar, aim=aim, limit=limit, note=note)


def dye(repeats: int) -> list[Result]:
    """All cases."""
    results = [
        time_dye("diffusion, 800x600x2, every face its own weight", *free_diffusion(600, 800), repeats),
        time_dye("the whole model, 800x600x2", *whole_model(600, 800), repeats, 0.8, 1.2),
    ]
    return results + [time_dye(f"figure 9, 200x200x2, {law}", *figure_9(law), repeats, 0.44, 1.1) for law in LAWS]
