"""The plan of a dyeing, for `nuno plan`: size, step, and cost estimated from a frame."""

from __future__ import annotations

import math

from nuno.dye.run import DyeRun, estimate_memory
from nuno.dye.supply import Entry
from nuno.formatting import duration
from nuno.scene.scene_file import Loaded
from nuno_schemas.dye import Dye


def describe_dye(loaded: Loaded) -> list[tuple[str, str]]:
    """Return rows (heading, text). Raises BadInput for a scene that would not start."""
    dyeing = DyeRun(loaded, 0)
    return [
        (
            "dye cloth" if loaded.scene.moves else "cloth",
            f"{f'on {on}, ' if (on := loaded.dyed.said.object) else ''}{_size(dyeing)}",
        ),
        ("dyes", ", ".join(map(_dye, dyeing.system.dyes))),
        *([("supply", "; ".join(map(_supply, dyeing.supplies.entries)))] if dyeing.supplies.entries else []),
        ("solver", f"{dyeing.describe_step(loaded.dyed.solver.name, dyeing.limit)}; {dyeing.about()}"),
        *_cost(dyeing, loaded),
    ]


def _dye(one: Dye) -> str:
    law = one.isotherm.kind if one.isotherm is not None and one.adsorption else "nothing is fixed"
    slower = one.weisz_zollinger
    factor = f" x min({slower.cap:g}, {slower.phi0:g} / phi)" if slower is not None else ""
    return f"{one.name} (D0 {one.D0 * 3.6e9:.4g} mm^2/h{factor}, {law})"


def _size(dyeing: DyeRun) -> str:
    _, ny, nx = dyeing.cells.fibre.shape
    size = dyeing.cells.size * 1e3
    larger = f", {dyeing.cells.coarser} times as large as given" if dyeing.cells.coarser > 1 else ""
    return f"{nx * size:.4g} mm x {ny * size:.4g} mm: {2 * ny * nx:,} cells of {size:.4g} mm{larger}, in two layers"


def _supply(entry: Entry) -> str:
    one = entry.supply
    times = f"at {duration(one.start)}"
    if one.stop is not None:
        times = f"{duration(one.start)} to {'the end' if math.isinf(one.stop) else duration(one.stop)}"
    return f"{one.kind} {times}{', exhausted' if entry.finite else ''}"


def _cost(dyeing: DyeRun, loaded: Loaded) -> list[tuple[str, str]]:
    scene, memory, rare = loaded.scene, estimate_memory(loaded)[1], loaded.scene.record.dye_every
    shown = scene.frames if rare is None else min(scene.frames, int(scene.duration / rare) + dyeing.checkpoints)
    size = (8 * (shown + 1) + 16 * dyeing.checkpoints) * dyeing.state.phi.size
    speed = f", {duration(scene.frames / scene.frame_rate * dyeing.speed)} of dyeing" if dyeing.speed != 1.0 else ""
    return dyeing.describe_cost(dyeing.time_frame(), size, memory, speed)
