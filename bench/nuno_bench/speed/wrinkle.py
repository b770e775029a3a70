"""Lines drawn on cloth of 20,000 triangles while it moves: no longer than a frame is shown, and nothing compiled."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from nuno.scene import scene_file, shipped
from nuno.simulation.run import Simulation
from nuno_bench.machine import cores
from nuno_bench.report.page import Result
from nuno_bench.speed.timing import seconds, watch_compiler
from nuno_schemas.fabric import Fabric, State
from nuno_schemas.operation import Outcome

SCENE = "hung-cloth-wrinkle"
BAR = 1000.0 / 60.0
"""A frame at 60 Hz [ms]."""
SMALL, LONG = "[[0.45, 0.55], [0.55, 0.6]]", "[[0.2, 0.3], [0.8, 0.35]]"
LINES = {
    "a line over a tenth of it": (SMALL, "false"),
    "a line over most of it": (LONG, "false"),
    "one that is kept": (SMALL, "true"),
}
"""Where each lies on the cloth, and whether it is kept."""


def wrinkle(repeats: int) -> list[Result]:
    """The mesh work of a line [ms], and functions compiled from its first frame on, without and with `keep`."""
    results = []
    for name, (texture, keep) in LINES.items():
        line = f"{{height: 1 cm, texture: {texture}}}"
        drawn = f"operations=[{{plugin: wrinkle, at: 50 ms, lines: [{line}], keep: {keep}}}]"
        # Split triangles are finer than the scene's cloth is thick.
        thin = "cloth_contact.thickness=0.5 mm"
        overrides = ("objects[0].model.resolution=[101, 101]", drawn, thin, "until=duration")
        simulation = Simulation(scene_file.read(shipped.find(SCENE), overrides), None, None, cores())
        simulation.measure(None)
        simulation.rehearse()
        with watch_compiler() as compiled:
            while simulation.applied == 0:
                chosen, fabric, state = simulation.loaded.operations[0], simulation.fabric, simulation.state
                before = state.copy()
                simulation.advance(None, None)
        draw = partial(_draw, chosen, fabric, before)
        size = f"{len(fabric.faces):,} triangles, {draw().facts['vertices']:.0f} of them split"
        times, number = tuple(1e3 * seconds(draw) for _ in range(repeats)), (float(compiled.number),)
        results += [
            Result("wrinkle", f"{name}: mesh work", "ms", times, bar=BAR, at_most=True, note=size),
            Result("wrinkle", f"{name}: compiled during the run", "functions", number, bar=0.0, at_most=True),
        ]
    return results


def _draw(chosen: Any, fabric: Fabric, state: State) -> Outcome:
    """The line on a copy of the cloth as it is before it."""
    made: Outcome = chosen.plugin.apply(chosen.config, fabric, replace(state), None)
    return made
