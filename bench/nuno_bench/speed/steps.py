"""Cases that time single steps without services: of cloth, explicit and stiff, of dye, and of lines drawn on cloth."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nuno.plugin_contract import registry
from nuno.scene import scene_file, shipped
from nuno.scene.files import SceneFiles
from nuno.simulation.cloth import Piece
from nuno.simulation.costs import Costs
from nuno.simulation.renumbering import RenumberedSolver, find_numbers, renumber
from nuno.simulation.run import Simulation
from nuno.simulation.yarns import structural_edges
from nuno_bench.gallery.wrinkle import NAMES as WRINKLES
from nuno_bench.machine import cores
from nuno_bench.peers import python
from nuno_bench.peers.problem import REFERENCE, SCENE, SECONDS, judge
from nuno_bench.piles import DOWN, build_model, irregular_square, write_obj
from nuno_bench.problem import run_own
from nuno_bench.report.page import Result
from nuno_bench.speed.timing import bandwidth, inverse_roots, measure, seconds, watch_compiler
from nuno_bench.validation.dye import D0, SIZE, make_cells
from nuno_schemas.dye import Dye, DyeState, DyeSystem, Isotherm
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Fabric, State
from nuno_schemas.operation import Outcome
from nuno_schemas.system import System

# The cloth that is timed: a sheet, and the same as a net of arrays.

DAMPING = 1e-5
FABRIC = {"density": 0.3, "structural": 8.0, "shear": 2.5, "bending": 0.4}
"""Soft cloth set by hand, [N s/m], [kg/m^2] and [N/m]: 12 springs a vertex, no hinges."""
ROUGHNESS = 0.01
"""Vertices start this part of an edge off their places, so that no difference is exactly 0."""


def sheet_scene(columns: int, rows: int, damping: float = 0.0, fabric: str | None = None) -> dict[str, Any]:
    """A hanging square metre of cloth by the hand-set constants, or of a preset fabric."""
    cloth = fabric or FABRIC | {"damping": damping}
    return scene_of({"plugin": "sheet", "resolution": [columns, rows], "pin": ["top-corners"], "fabric": cloth})


def scene_of(model: dict[str, Any]) -> dict[str, Any]:
    """One object in a scene whose single frame is a tenth of a millisecond."""
    scene = {"nuno": 1, "name": "bench", "duration": 1e-4, "frame_rate": 10_000}
    solver = {"plugin": "symplectic_euler", "dt": "auto"}
    return scene | {"solver": solver, "objects": [{"name": "cloth", "model": model}]}


def sheet(columns: int, rows: int, damping: float = 0.0) -> Fabric:
    """The fabric of sheet_scene."""
    model: dict[str, Any] = sheet_scene(columns, rows, damping)["objects"][0]["model"]
    return build_model(model.pop("plugin"), model)


def net(arrays: dict[str, NDArray[Any]]) -> Fabric:
    """The fabric that the net plugin reads from these arrays."""
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "net.npz", allow_pickle=False, **arrays)
        return build_model("net", {"file": "net.npz"}, Path(folder))


def mesh(side: int, tension: str, shuffled: bool = False) -> Fabric:
    """A square metre of denim as an irregular mesh of side x side vertices, numbered row by row or at random."""
    points, faces = irregular_square(side, 1.0, 4)
    if shuffled:
        order = np.random.default_rng(3).permutation(len(points))
        points, faces = points[order], np.argsort(order).astype(np.int32)[faces]
    with tempfile.TemporaryDirectory() as folder:
        write_obj(Path(folder) / "mesh.obj", points, faces)
        return build_model("mesh", {"file": "mesh.obj", "tension": tension}, Path(folder))


def system_of(fabric: Fabric) -> tuple[System, State]:
    """The fabric under gravity on all cores, and its start, slightly rough."""
    edge = float(np.median(structural_edges(fabric)[1]))
    x = fabric.position + np.random.default_rng(1).normal(scale=ROUGHNESS * edge, size=fabric.position.shape)
    return System(fabric, DOWN, threads=cores()), State(np.ascontiguousarray(x), fabric.velocity.copy())


def net_arrays(fabric: Fabric, varied: bool) -> dict[str, NDArray[Any]]:
    """The arrays of a `net` with a fabric's vertices and springs.

    With `varied`, k, rest and c of every spring differ by up to a tenth, as measured ones would;
    otherwise all springs of a class (structural, shear, bending) stay alike.
    """
    springs = fabric.springs
    assert springs is not None
    values = {"k": springs.k, "rest": springs.rest, "c": np.full(springs.k.shape, DAMPING)}
    rng = np.random.default_rng(2)
    each = {name: np.array(springs.per_spring(array)) for name, array in values.items()}
    if varied:
        each = {name: array * rng.uniform(0.9, 1.1, array.shape) for name, array in each.items()}
    own = {"x": fabric.position, "v": fabric.velocity, "m": fabric.mass, "pinned": fabric.pinned}
    return own | {"springs": springs.pairs().astype(np.int64)} | each


def renumbered(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """The same net with its vertices numbered at random: nothing follows anything, and all is read by its index."""
    order = np.random.default_rng(3).permutation(len(arrays["x"]))
    moved = {name: arrays[name][order] for name in ("x", "v", "m", "pinned")}
    return arrays | moved | {"springs": np.argsort(order)[arrays["springs"]]}


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
CANDIDATES = {
    "auto, accuracy: preview": ("plugin: auto", "preview"),
    "symplectic_euler, dt: auto": ("plugin: symplectic_euler, dt: auto", ""),
    "leapfrog, dt: auto": ("plugin: leapfrog, dt: auto", ""),
    "dopri5, tolerance 1e-6": ("plugin: dopri5, tolerance: 1e-6, dt: auto", ""),
    "tr_bdf2, a step a frame, residual 1e-2": ("plugin: tr_bdf2, residual: 1e-2, dt: auto", ""),
    "implicit_euler, a step a frame, residual 1e-2": ("plugin: implicit_euler, residual: 1e-2, dt: auto", ""),
    "xpbd, 120 steps a frame": ("plugin: xpbd, dt: 1.3888888888888889e-4", ""),
}
BARS = {64: 0.25, 128: 1.0}
"""Wall time of a second [s], by vertices a side."""
SOLVERS = ("implicit_euler", "tr_bdf2")
SIDES = (16, 32)
STIFFNESS = (1e2, 1e4, 1e6, 1e8)
"""Structural [N/m]; shear and bending follow in the scene's own proportions."""
SHARES = {"structural": 1.0, "shear": 0.3, "bending": 0.02}
FRAMES = 30
GROWTH = 3.0
"""Largest cost at the highest stiffness over that at the lowest."""
MOST = 3
"""Repeats."""


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
    system, state = system_of(fabric)
    numbers = find_numbers(fabric, [Piece("cloth", 0, fabric.number)])
    if numbers is not None:
        plugin, system = RenumberedSolver(plugin, numbers), replace(system, fabric=renumber(fabric, numbers))
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
        timed("vertices in random order", net(renumbered(varied))),
    ]


def membrane(repeats: int) -> list[Result]:
    """A measured fabric on a mesh of 20,000 triangles: steps of its membrane over those of springs on its edges."""
    results, (springs, of_membrane) = in_turns(
        "membrane", {f"a step of {tension}": mesh(MESH_SIDE, tension) for tension in TENSIONS}, repeats
    )
    ratios = tuple(on / off for off, on in zip(springs, of_membrane, strict=True))
    return [*results, Result("membrane", "membrane over springs", "times", ratios, bar=1.5, at_most=True)]


def numbering(repeats: int) -> list[Result]:
    """The same mesh row by row and numbered at random: how long a step then takes, over how long it took."""
    results = []
    for tension in TENSIONS:
        fabrics = {
            f"a step of {tension}, {order}": mesh(MESH_SIDE, tension, shuffled=order == "at random")
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


def stiff_sheet(repeats: int) -> list[Result]:
    """A second of the sheet by each solver; the bar is held against the fastest that is accurate enough."""
    results, names = list[Result](), list(CANDIDATES)
    for side, bar in BARS.items():
        size = f"objects.0.model.resolution=[{side}, {side}]"
        sheet, converged = python.stiff_sheet(size), python.Nuno(None, REFERENCE, "", [size])
        taken, good, found = seconds(partial(converged.advance, SECONDS)), list[Result](), list[Result]()
        for name in names:
            engine = python.Nuno(None, *CANDIDATES[name], [size])
            engine.advance(1 / 60)
            times = []
            for _ in range(min(repeats, MOST)):
                engine.reset()
                times.append(seconds(partial(engine.advance, SECONDS)))
            score = judge(sheet, engine.simulation.state.x, converged.simulation.state.x)
            note = (
                f"centre of mass off by {1e3 * score.centre:.2g} mm, mean strain {score.strain:.2f} of the reference's"
            )
            note += "" if score.accurate else ": not accurate enough"
            found.append(Result("stiff", f"{side}x{side}, {name}", "s", tuple(times), note=note))
            good += [found[-1]] * score.accurate
        best = min(good, key=lambda one: one.median, default=None)
        results += [replace(one, bar=bar, at_most=True) if one is best else one for one in found]
        results.append(Result("stiff", f"{side}x{side}, the reference: {REFERENCE}", "s", (taken,)))
        # The larger sheet takes eight times as long: only by those that may be the fastest.
        names = sorted(names, key=lambda name: found[names.index(name)].median)[:2]
    return results


def stiffness(repeats: int) -> list[Result]:
    """Cost of a frame over stiffness, a frame as the step, and the growth from the softest sheet to the stiffest."""
    results = []
    for solver, side in ((solver, side) for solver in SOLVERS for side in SIDES):
        what, costs = f"{solver}, {side}x{side}", []
        for k in STIFFNESS:
            constants = [f"objects.0.model.fabric.{name}={share * k!r}" for name, share in SHARES.items()]
            constants.append(f"objects.0.model.resolution=[{side}, {side}]")
            chosen = (f"solver={{plugin: {solver}, dt: auto}}", f"duration={FRAMES / 60!r}", *constants)
            runs = [run_own(scene_file.read(shipped.find(SCENE), chosen)) for _ in range(min(repeats, MOST))]
            newton, linear = (runs[0].totals[name] for name in ("newton_steps", "linear_iterations"))
            note = f"{newton / FRAMES:.3g} Newton steps a frame, {linear / max(newton, 1):.3g} linear iterations each"
            each = tuple(1e3 * one.seconds / FRAMES for one in runs)
            costs.append(Result("stiffness", f"{what}, k = {k:.0e} N/m", "ms a frame", each, note=note))
        growth = tuple(high / low for low, high in zip(costs[0].samples, costs[-1].samples, strict=True))
        over = f"{what}, {STIFFNESS[-1]:.0e} N/m over {STIFFNESS[0]:.0e} N/m"
        results += [*costs, Result("stiffness", over, "times", growth, bar=GROWTH, at_most=True)]
    return results


# Lines drawn on cloth of 20,000 triangles while it moves: no longer than a frame is shown, and nothing compiled. The
# wrinkle paper's own scenes, at sizes of ours: the paper prints none.

HUNG = "hung-cloth-wrinkle"
A_FRAME = 1000.0 / 60.0
"""A frame at 60 Hz [ms]."""
SMALL, LONG = "[[0.45, 0.55], [0.55, 0.6]]", "[[0.2, 0.3], [0.8, 0.35]]"
DRAWN = {
    "a line over a tenth of it": (SMALL, "false"),
    "a line over most of it": (LONG, "false"),
    "one that is kept": (SMALL, "true"),
}
"""Place of each line on the cloth, and whether it is kept."""
FOLLOWED = 30
"""Frames of a sample of the paper's scenes, once their lines are drawn."""


def wrinkle(repeats: int) -> list[Result]:
    """The speed of the paper's scenes, and what takes their time; the mesh work of a line [ms], and functions compiled
    from its first frame on, without and with `keep`.
    """
    results = [result for name in WRINKLES for result in _follow_lines(name, repeats)]
    for name, (texture, keep) in DRAWN.items():
        line = f"{{height: 1 cm, texture: {texture}}}"
        drawn = f"operations=[{{plugin: wrinkle, at: 50 ms, lines: [{line}], keep: {keep}}}]"
        # Split triangles are finer than the scene's cloth is thick.
        thin = "cloth_contact.thickness=0.5 mm"
        overrides = ("objects[0].model.resolution=[101, 101]", drawn, thin, "until=duration")
        simulation = Simulation(scene_file.read(shipped.find(HUNG), overrides), None, None, cores())
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
            Result("wrinkle", f"{name}: mesh work", "ms", times, bar=A_FRAME, at_most=True, note=size),
            Result("wrinkle", f"{name}: compiled during the run", "functions", number, bar=0.0, at_most=True),
        ]
    return results


def _follow_lines(name: str, repeats: int) -> list[Result]:
    """The speed of a scene after its lines are drawn, over real time, and the share of each part of its steps."""
    simulation, seconds = Simulation.with_bodies(scene_file.read(shipped.find(name)), cores()), list[float]()
    while simulation.applied < len(simulation.loaded.operations):
        simulation.step()
    simulation.step()
    lists, simulation.costs = simulation.costs.lists, Costs()
    simulation.costs.begin(lists)
    for _ in range(repeats):
        seconds.append(sum(simulation.step().report.seconds["steps"] for _ in range(FOLLOWED)))
    shares, shown = simulation.divide(sum(seconds)), FOLLOWED / simulation.loaded.scene.frame_rate
    size = f"{simulation.fabric.number:,} vertices, {simulation.steps} steps a frame"
    speed = Result("wrinkle", f"{name}, {size}", "s/s", tuple(shown / each for each in seconds), bar=1.0)
    parts = sorted(shares.items(), key=lambda part: -part[1])
    return [
        speed,
        *(Result("wrinkle", f"{name}: {part}", "%", (100.0 * share / sum(seconds),)) for part, share in parts),
    ]


def _draw(chosen: Any, fabric: Fabric, state: State) -> Outcome:
    """The line on a copy of the cloth as it is before it."""
    made: Outcome = chosen.plugin.apply(chosen.config, fabric, replace(state), None)
    return made


# Cases that time steps of dye: diffusion alone, the whole model, the dye paper's figure 9.

DYE_UNIT = "G cell updates/s"
"""Billion cells times steps a second."""
DYE_WORK = 300_000_000
"""Cell updates of a sample: a few tenths of a second."""
DYE_BYTES = 36
"""Bytes that a cell's step moves from and to memory: its amount read and written, two weights and half of a third."""
DYE_SHARE = 0.9
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
    memory, dt = plugin.prepare(config, system, state), DYE_SHARE * plugin.limit(config, system)
    steps = max(1, DYE_WORK // cells)

    def advance() -> None:
        report = plugin.advance(system, state, memory, steps, dt)
        if report.status != "ok":
            raise RunFailed(f"{what}: {report.message}")

    note, limit = f"{cells:,} cells; {plugin.about(system)}", 1e-9 * bandwidth() / DYE_BYTES
    return measure(
        "dye", what, DYE_UNIT, advance, repeats, 1e-9 * cells * steps, bar=bar, aim=aim, limit=limit, note=note
    )


def dye(repeats: int) -> list[Result]:
    """All cases."""
    results = [
        time_dye("diffusion, 800x600x2, every face its own weight", *free_diffusion(600, 800), repeats),
        time_dye("the whole model, 800x600x2", *whole_model(600, 800), repeats, 0.8, 1.2),
    ]
    return results + [time_dye(f"figure 9, 200x200x2, {law}", *figure_9(law), repeats, 0.44, 1.1) for law in LAWS]
