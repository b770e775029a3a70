"""Lines drawn on cloth of 20,000 triangles while it moves: no longer than a frame is shown, and nothing compiled."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from nuno.scene import scene_file
from nuno.simulation.run import Simulation
from nuno_bench.machine import cores
from nuno_bench.report.result import Result
from nuno_bench.speed.timing import seconds, watch_compiler
from nuno_schemas.fabric import State
from nuno_schemas.operation import Outcome

CASE, SCENE = "wrinkle", "hung-cloth-wrinkle"
BAR = 1000.0 / 60.0
"""A frame at 60 Hz [ms]."""
SMALL_LINE = {"height": "1 cm", "texture": [[0.45, 0.55], [0.55, 0.6]]}
LONG_LINE = {"height": "1 cm", "texture": [[0.2, 0.3], [0.8, 0.35]]}


def scene_of(line: dict[str, Any], **fields: Any) -> scene_file.Loaded:
    """The hung cloth with 20,000 triangles, and one line that comes in the third frame."""
    operation = {"plugin": "wrinkle", "at": "50 ms", "lines": [line], **fields}
    data = f"operations={[operation]}".replace("'", '"').replace("True", "true")
    return scene_file.read(scene_file.find(SCENE), ("objects[0].model.resolution=[101, 101]", data, "until=duration"))


def wrinkle(repeats: int) -> list[Result]:
    """The mesh work of a line [ms], and functions compiled from its first frame on, without and with `keep`."""
    results = []
    for name, line, fields in (
        ("a line over a tenth of it", SMALL_LINE, {}),
        ("a line over most of it", LONG_LINE, {}),
        ("one that is kept", SMALL_LINE, {"keep": True}),
    ):
        simulation = Simulation(scene_of(line, **fields), None, None, cores())
        with watch_compiler() as prepared:
            simulation.measure(None)
            simulation.rehearse(None)
        with watch_compiler() as compiled:
            while simulation.applied == 0:
                chosen, fabric, state = simulation.loaded.operations[0], simulation.fabric, simulation.state
                own = State(state.x.copy(), state.v.copy(), state.t)
                simulation.advance(None, None)

        def draw(chosen: Any = chosen, fabric: Any = fabric, own: State = own) -> Outcome:
            made: Outcome = chosen.plugin.apply(chosen.config, fabric, replace(own), None)
            return made

        facts = draw().facts
        samples = tuple(1e3 * seconds(draw) for _ in range(repeats))
        size = f"{len(fabric.faces):,} triangles, {facts['vertices']:.0f} of them split"
        results += [
            Result(CASE, f"{name}: mesh work", "ms", samples, BAR, None, True, note=size),
            Result(CASE, f"{name}: compiled during the run", "functions", (float(compiled.number),), 0.0, None, True,
                   note=f"{prepared.number} before it"),
        ]  # fmt: skip
    return results
