"""Cases that time the explicit step by itself, without services."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from nuno import registry
from nuno.cloth.build import Piece
from nuno.cloth.numbering import find_numbers, renumber
from nuno.simulation.ordered import Ordered
from nuno_bench.report.result import Result
from nuno_bench.speed.steps import meshes
from nuno_bench.speed.steps.meshes import DAMPING, net, net_arrays, sheet
from nuno_bench.speed.timing import inverse_roots, measure, seconds, watch_compiler
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Fabric

UNIT = "M vertex-steps/s"
"""Million vertices times steps a second."""
DT = 1e-5
TENSIONS = ("springs", "membrane")
MESH_SIDE = 101
"""Vertices a side of a mesh: 20,000 triangles."""
DISORDER = 1.18
"""Times as long as row by row that a step of vertices in no order may take: 0.85 of the speed."""
WORK = 13_000_000
"""Vertex-steps of one sample: a few tenths of a second, so that a frame's entry does not show."""


def time_steps(
    case: str,
    what: str,
    fabric: Fabric,
    repeats: int,
    *,
    integrator: str = "symplectic_euler",
    bar: float | None = None,
    aim: float | None = None,
) -> Result:
    """Rate of one integrator on one fabric. Raises RunFailed if the state does not stay finite."""
    steps = max(1, WORK // fabric.number)
    springs = fabric.springs.number / fabric.number if fabric.springs else 0.0
    note = f"{fabric.number:,} vertices, {2 * springs:.1f} springs a vertex"
    limit = 1e-6 * inverse_roots() / springs
    work, advance = 1e-6 * fabric.number * steps, stepping(what, fabric, steps, integrator)
    return measure(case, what, UNIT, advance, repeats, work, bar=bar, aim=aim, limit=limit, note=note)


def stepping(what: str, fabric: Fabric, steps: int, integrator: str = "symplectic_euler") -> Callable[[], None]:
    """Takes so many steps of one integrator each time it is called, as a run does: fabric whose vertices stand in no
    order is renumbered. Raises RunFailed where one fails.
    """
    plugin = registry.load("nuno.integrators", integrator)
    config = plugin.Config()
    system, state = meshes.system_of(fabric)
    numbers = find_numbers(fabric, [Piece("cloth", 0, fabric.number)])
    if numbers is not None:
        plugin, system = Ordered(plugin, numbers), replace(system, fabric=renumber(fabric, numbers))
    memory = plugin.prepare(config, system, state)

    def advance() -> None:
        report = plugin.advance(system, state, memory, None, steps, DT)
        if report.status != "ok":
            raise RunFailed(f"{what}: {report.status}: {report.message}")

    return advance


def grid_256(repeats: int) -> list[Result]:
    """Undamped and damped springs, two integrators; then another size, which must compile nothing."""
    timed = partial(time_steps, "grid-256", repeats=repeats)
    plain = sheet(256, 256)
    results = [
        timed("symplectic_euler", plain, bar=60.0, aim=90.0),
        timed("leapfrog", plain, integrator="leapfrog", bar=60.0, aim=90.0),
        timed("symplectic_euler, damped springs", sheet(256, 256, DAMPING), bar=60.0, aim=90.0),
    ]
    other = sheet(255, 257)
    with watch_compiler() as compiler:
        results.append(timed("symplectic_euler, 255x257", other))
    compiled = (float(compiler.number),)
    return [*results, Result("grid-256", "compiled for 255x257", "functions", compiled, bar=0.0, at_most=True)]


def net_256(repeats: int) -> list[Result]:
    """The same sheet as arrays: constants alike in each class or each spring its own, and vertices in no order."""
    timed = partial(time_steps, "net-256", repeats=repeats)
    varied = net_arrays(sheet(256, 256), varied=True)
    return [
        timed("k, rest, c per spring", net(varied), bar=22.0),
        timed("constants per class", net(net_arrays(sheet(256, 256), varied=False)), bar=30.0, aim=50.0),
        timed("vertices in random order", net(meshes.renumbered(varied))),
    ]


def membrane(repeats: int) -> list[Result]:
    """A measured fabric on a mesh of 20,000 triangles: steps of its membrane over those of springs on its edges."""
    results, (springs, of_membrane) = in_turns(
        "membrane", {f"a step of {tension}": meshes.mesh(MESH_SIDE, tension) for tension in TENSIONS}, repeats
    )
    ratios = tuple(on / off for off, on in zip(springs, of_membrane, strict=True))
    return [*results, Result("membrane", "membrane over springs", "times", ratios, bar=1.5, at_most=True)]


def numbering(repeats: int) -> list[Result]:
    """The same mesh row by row and numbered at random: how long a step then takes, over how long it took."""
    results = []
    for tension in TENSIONS:
        fabrics = {
            f"a step of {tension}, {order}": meshes.mesh(MESH_SIDE, tension, shuffled=order == "at random")
            for order in ("row by row", "at random")
        }
        found, (near, far) = in_turns("numbering", fabrics, repeats)
        ratios = tuple(other / one for one, other in zip(near, far, strict=True))
        what = f"{tension}: a step at random over one row by row"
        results += [*found, Result("numbering", what, "times", ratios, bar=DISORDER, at_most=True)]
    return results


def in_turns(case: str, fabrics: dict[str, Fabric], repeats: int) -> tuple[list[Result], list[tuple[float, ...]]]:
    """Results and times of a step [us] of some fabrics by name, in turns, so that a slow machine slows all."""
    steps = WORK // 4 // max(fabric.number for fabric in fabrics.values())
    calls = [stepping(what, fabric, steps) for what, fabric in fabrics.items()]
    for call in calls:
        call()
    spent = [[1e6 * seconds(call) / steps for call in calls] for _ in range(repeats)]
    times = list(zip(*spent, strict=True))
    results = [
        Result(case, what, "us", taken, note=f"{fabric.number:,} vertices, {len(fabric.faces):,} triangles")
        for (what, fabric), taken in zip(fabrics.items(), times, strict=True)
    ]
    return results, times


def sheet_32(repeats: int) -> list[Result]:
    """A small sheet, where starting threads would cost more than they bring."""
    timed = partial(time_steps, "sheet-32", repeats=repeats, bar=30.0, aim=45.0)
    return [timed(name, sheet(32, 32), integrator=name) for name in ("symplectic_euler", "leapfrog")]
