"""Cases that time the explicit step by itself, without services."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno import registry
from nuno_bench.report.result import Result
from nuno_bench.speed import limits
from nuno_bench.speed.steps import meshes
from nuno_bench.speed.steps.sliced import SlicedCloth
from nuno_bench.speed.timing import seconds, watch_compiler
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Fabric

UNIT = "M vertex-steps/s"
"""Million vertices times steps a second."""
DT = 1e-5
WORK = 13_000_000
"""Vertex-steps of one sample: a few tenths of a second, so that a frame's entry does not show."""


def time_steps(fabric: Fabric, integrator: str, repeats: int, **about: Any) -> Result:
    """Rate of one integrator on one fabric. Raises RunFailed if the state does not stay finite."""
    plugin = registry.load("nuno.integrators", integrator)
    config = plugin.Config()
    system, state = meshes.system_of(fabric)
    memory = plugin.prepare(config, system, state)
    steps = max(1, WORK // fabric.number)

    def advance(count: int) -> None:
        report = plugin.advance(system, state, memory, None, count, DT)
        if report.status != "ok":
            raise RunFailed(f"{integrator}: {report.status}: {report.message}")

    with watch_compiler() as compiler:
        first = seconds(lambda: advance(1))
    advance(steps // 10 + 1)
    samples = tuple(fabric.number * steps / seconds(lambda: advance(steps)) * 1e-6 for _ in range(repeats))
    springs = fabric.springs.number if fabric.springs else 0
    size = f"{fabric.number:,} vertices, {2 * springs / fabric.number:.1f} springs a vertex"
    note = f"{size}, {compiler.number} functions compiled"
    what = about.pop("what", integrator)
    return Result(
        unit=UNIT,
        what=what,
        samples=samples,
        compile_seconds=first,
        limit=limits.vertex_steps(springs / fabric.number),
        note=note,
        **about,
    )


def sheet(columns: int, rows: int, damping: float = 0.0) -> Fabric:
    return meshes.build_model(meshes.sheet_scene(columns, rows, damping)["objects"][0]["model"], Path.cwd())


def net(arrays: dict[str, NDArray[Any]]) -> Fabric:
    """The fabric that the net plugin reads from these arrays."""
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "net.npz", allow_pickle=False, **arrays)
        return meshes.build_model({"plugin": "net", "file": "net.npz"}, Path(folder))


def grid_256(repeats: int) -> list[Result]:
    """Undamped and damped springs, two integrators; then another size, which must compile nothing."""
    plain, damped = sheet(256, 256), sheet(256, 256, meshes.DAMPING)
    bars: dict[str, Any] = {"case": "grid-256", "bar": 60.0, "aim": 90.0}
    results = [
        time_steps(plain, "symplectic_euler", repeats, **bars),
        time_steps(plain, "leapfrog", repeats, **bars),
        time_steps(damped, "symplectic_euler", repeats, what="symplectic_euler, damped springs", **bars),
    ]
    other = sheet(255, 257)
    with watch_compiler() as compiler:
        timed = time_steps(other, "symplectic_euler", repeats, case="grid-256", what="symplectic_euler, 255x257")
    compiled = Result("grid-256", "compiled for 255x257", "functions", (float(compiler.number),), bar=0.0, at_most=True)
    return [*results, timed, compiled]


def net_256(repeats: int) -> list[Result]:
    """The same sheet as arrays: constants of each spring its own, or alike in each class."""
    fabric = sheet(256, 256)
    varied, alike = (net(meshes.net_arrays(fabric, varied)) for varied in (True, False))
    return [
        time_steps(varied, "symplectic_euler", repeats, case="net-256", what="k, rest, c per spring", bar=22.0),
        time_steps(alike, "symplectic_euler", repeats, case="net-256", what="constants per class", bar=30.0, aim=50.0),
    ]


def irregular(repeats: int) -> list[Result]:
    """Triangles in no order: nothing follows anything, so every spring is read by its indices."""
    patches, shuffled = (net(meshes.irregular_arrays(256, patch)) for patch in (16, None))
    return [
        time_steps(patches, "symplectic_euler", repeats, case="irregular", what="vertices near their neighbours"),
        time_steps(shuffled, "symplectic_euler", repeats, case="irregular", what="vertices in random order"),
    ]


def sheet_32(repeats: int) -> list[Result]:
    """A small sheet, where starting threads would cost more than they bring."""
    bars: dict[str, Any] = {"case": "sheet-32", "bar": 30.0, "aim": 45.0}
    return [time_steps(sheet(32, 32), name, repeats, **bars) for name in ("symplectic_euler", "leapfrog")]


def numpy_slices(repeats: int) -> list[Result]:
    """The peer: the same undamped step by NumPy slices, on the same two meshes."""
    return [_time_numpy(side, repeats) for side in (256, 32)]


def _time_numpy(side: int, repeats: int) -> Result:
    fabric = sheet(side, side)
    system, state = meshes.system_of(fabric)
    cloth = SlicedCloth(fabric, np.asarray(system.gravity))
    x, v = np.ascontiguousarray(state.x.T), np.ascontiguousarray(state.v.T)
    steps = max(1, WORK // 10 // fabric.number)

    def advance() -> None:
        cloth.advance(x, v, steps, DT)

    advance()
    samples = tuple(fabric.number * steps / seconds(advance) * 1e-6 for _ in range(repeats))
    return Result(
        "numpy",
        f"NumPy slices, {side}x{side}",
        UNIT,
        samples,
        limit=limits.vertex_steps(6.0),
        note="the peer: one thread, undamped",
    )
