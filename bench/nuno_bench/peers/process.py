"""Engines and their settings, each run in a process of its own: a crash there is a finding, not the end."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

import numpy as np

from nuno_bench import options
from nuno_bench.peers.problem import RATE, SECONDS, Peer
from nuno_schemas.errors import RunFailed
from nuno_schemas.fabric import Float

# Which engines `nuno bench peers` steps each scene with, at which settings, and how each is given it.

Setting = Mapping[str, float | str]

EXACT = "The sheet's own springs, dampers, masses, drag and pins"
KERNELS = f"{EXACT}; kernels alone."
PILE = "Springs and hinges of the cloth, damped by 0.05 of critical; solver and cloth contact as a scene has them."
SAME_PILE = "The same triangles, masses, thickness and friction; single precision; no damping but the solver's own. "
SKIRT = (
    "Springs and hinges of the cloth, damped by 0.05 of critical; capsules push by penalty; solver and cloth contact "
    "as a scene has them."
)
SAME_SKIRT = (
    "The same vertices, masses, waist and drag; capsules are kinematic bodies, posed in every step; contact by springs "
    "of 1,000 N/m; single precision. "
)
OWN_SKIRT = f"{SAME_SKIRT}The skirt's own springs, dampers and hinges. "


@dataclass(frozen=True)
class Engine:
    """An engine with one of its solvers.

    name      as it is shown, and as --only takes it
    package   what is imported, "" for what always is there
    module    of the class `made`, which is made as `made(posed, **setting)`
    settings  by what they are shown as, from coarse to fine
    posed     what the engine is given, and where that is not the same material
    """

    name: str
    package: str
    module: str
    made: str
    settings: Mapping[str, Setting]
    posed: str

    @property
    def missing(self) -> bool:
        return bool(self.package and options.missing_package(self.package))


def _nuno(place: str, posed: str, solver: str, given: str, *steps: str) -> Engine:
    """Our `solver`, what it is given beside `dt`, and what that may be: auto, or a number of steps a frame."""
    module, _, made = place.rpartition(".")
    before = "dt " if made == "Nuno" else ""
    settings: dict[str, Setting] = {}
    for step in steps:
        name, dt = ("dt auto", "auto") if step == "auto" else (f"{before}{step} a frame", repr(1 / RATE / int(step)))
        settings[f"{given}{name}"] = {"solver": f"plugin: {solver}, {given}dt: {dt}"}
    return Engine(f"nuno-{solver}", "", f"nuno_bench.peers.{module}", made, settings, posed)


def _at(rate: int, **more: int) -> dict[str, Setting]:
    """So many steps a second."""
    dt = f"{1e3 / rate:.3g} ms" if rate <= 1000 else f"{1e6 / rate:.3g} us"
    return {", ".join([dt, *(f"{name} {value}" for name, value in more.items())]): {"dt": 1 / rate, **more}}


def _in(steps: int, iterations: int, said: str = "", **more: bool) -> dict[str, Setting]:
    name = ", ".join(filter(None, [f"{steps} steps a frame, {iterations} iterations", said]))
    return {name: {"substeps": steps, "iterations": iterations, **more}}


def _engine(module: str, made: str, settings: Mapping[str, Setting], posed: str) -> Engine:
    package = module.rpartition("_")[2]
    return Engine(f"{package}-{made.lower()}", package, f"nuno_bench.peers.{module}", made, settings, posed)


SHEET_KINDS = (
    Engine("nuno-auto", "", "nuno_bench.peers.python", "Nuno",
           {f"accuracy {one}": {"solver": "plugin: auto", "accuracy": one} for one in ("preview", "normal")},
           f"{EXACT}; solver and step as nuno takes them by itself for an accuracy."),
    _nuno("python.Nuno", KERNELS, "symplectic_euler", "", "auto", "240"),
    _nuno("python.Nuno", KERNELS, "leapfrog", "", "auto", "240"),
    _nuno("python.Nuno", KERNELS, "dopri5", "tolerance: 1e-6, ", "auto"),
    _nuno("python.Nuno", KERNELS, "tr_bdf2", "residual: 1e-2, ", "1", "2", "4"),
    _nuno("python.Nuno", KERNELS, "implicit_euler", "residual: 1e-2, ", "1", "4"),
    Engine("numpy", "", "nuno_bench.peers.python", "NumPy", _at(7500) | _at(15000),
           f"{EXACT}; symplectic Euler written with slices of whole arrays, no compiler."),
    Engine("scipy", "scipy", "nuno_bench.peers.python", "SciPy",
           {f"{method}, tolerance {rtol:.0e}": {"method": method, "rtol": rtol}
          for method, rtol in (("RK45", 1e-3), ("RK45", 1e-5), ("DOP853", 1e-4))},
           f"{EXACT}; forces by the same NumPy slices. Its implicit methods are left out: each of their "
           "matrices has 24,576 columns."),
    _engine("mujoco", "Edges", _at(7500) | _at(10000),
            f"{EXACT}: springs of equal constants are a 1D flex, whose edges have that stiffness and damping; drag is "
            "an applied force. MuJoCo integrates such edges explicitly only, so integrator=Euler."),
    _engine("mujoco", "Tendons", _at(300) | _at(600) | _at(1200),
            f"{EXACT}: each spring is a tendon between two sites, drag is joint damping. integrator=discrete, the one "
            "that MuJoCo documents as implicit in stiffness, with its CG solver."),
    _engine("newton", "SemiImplicit", _at(7500) | _at(10000),
            f"{EXACT}; single precision; drag is an applied force."),
    _engine("newton", "XPBD", _at(600, iterations=10) | _at(20000, iterations=1),
            f"{EXACT}; single precision. Newton's XPBD adds up the corrections of all springs of a vertex without "
            "relaxation, which diverges unless the step is so small that compliance holds it back."),
    _engine("newton", "VBD", _at(600, iterations=10) | _at(2400, iterations=4) | _at(2400, iterations=10)
            | _at(4800, iterations=4),
            f"{EXACT}; single precision; vertices are coloured so that no spring joins two of a colour."),
)  # fmt: skip
PILE_KINDS = (
    _nuno("pile.PileSolver", PILE, "symplectic_euler", "", "auto"),
    _nuno("pile.PileSolver", PILE, "implicit_euler", "residual: 1e-1, ", "1"),
    _engine("pile_newton", "VBD",
            _in(10, 4, "as cloth_twist") | _in(10, 10, "as cloth_hanging") | _in(20, 10, "as poker_cards"),
            f"{SAME_PILE}Neo-Hookean triangles of the cloth's Lame constants, folds on their edges; self-contact "
            "within the thickness, its stiffness and buffers as in the example cloth_twist. A frame is a graph of "
            "kernels."),
    _engine("pile_newton", "Style3D",
            _in(10, 4, "as cloth_style3d") | _in(10, 4, "its own 6 mm thickness", own_reach=True) | _in(20, 10),
            f"{SAME_PILE}Baraff and Witkin's triangles of the cloth's tension and shear, not narrowing; quadratic "
            "bending of their folds. It takes 0.2% of all velocities away in every step. Its thickness is 6 mm "
            "unless a part of the solver is changed, as it is here but for a row."),
    _engine("pile_mujoco", "IPC", _at(120) | _at(60),
            "The same triangles, masses and thickness; no friction, which its contact has not; a plate as stiff in its "
            "plane and in bending. integrator=discrete with the flag ipc, which commits no position before the way to "
            "it is found free, and its CG solver."),
    Engine("ipctk", "ipctk", "", "", {},
           "ipc-toolkit has no solver. It judges every engine's frames, and answers questions about ours: see there."),
)  # fmt: skip
SKIRT_KINDS = (
    _nuno("skirt.SkirtSolver", SKIRT, "respa", "", "auto"),
    _nuno("skirt.SkirtSolver", SKIRT, "symplectic_euler", "", "auto"),
    _nuno("skirt.SkirtSolver", SKIRT, "implicit_euler", "residual: 1e-1, ", "1"),
    _engine("skirt_newton", "XPBD", _in(10, 4) | _in(100, 1),
            f"{OWN_SKIRT}It adds up the corrections of all springs of a vertex without relaxation, which diverges "
            "unless the step is so small that compliance holds it back. Cloth meets cloth as balls at its vertices, "
            "of the thickness: edges and triangles may pass."),
    _engine("skirt_newton", "VBD", _in(10, 4, "as cloth_twist"),
            f"{OWN_SKIRT}Self-contact within the thickness, by triangles without a stiffness; its buffers are as in "
            "the example cloth_twist. Edges that meet are the mesh's and those of hinges."),
    _engine("skirt_newton", "Style3D", _in(10, 4, "as cloth_style3d") | _in(20, 10),
            f"{SAME_SKIRT}Baraff and Witkin's triangles of the fabric's warp, weft and shear instead of springs, "
            "each flat as long as its springs are; no dampers, but 0.2% of all velocities are taken away in every "
            "step; quadratic bending of their edges, of the hinges' stiffness, which a cell whose triangles have the "
            "other diagonal has on that one. Self-contact within the thickness."),
)  # fmt: skip


S = TypeVar("S")
ENOUGH = 1 / 3
"""Of a setting's limit, after which its seconds are not repeated."""


@dataclass(frozen=True)
class EnginePoint(Generic[S]):
    """Run of an engine at one setting, with a score of type S.

    start     from a fresh process to the first step: imports, the model, compiling [s]
    seconds   wall times of what is simulated, one per repeat [s]
    failure   why there is no score
    remark    what the engine says of the run
    """

    kind: str
    setting: str
    start: float | None = None
    seconds: tuple[float, ...] = ()
    score: S | None = None
    failure: str = ""
    remark: str = ""

    @property
    def median(self) -> float:
        return float(np.median(self.seconds)) if self.seconds else float("nan")


def measure(
    kind: Engine, name: str, posed: object, judge: Callable[[Float], S], repeats: int, limit: float,
    simulated: float = SECONDS,
) -> EnginePoint[S]:  # fmt: skip
    """Run an engine's setting of this name in a process of its own, which is ended after `limit` [s].

    `posed` is what the engine is made with, and `judge` scores what it advances to in `simulated` [s], or raises
    RunFailed where that is no cloth any more.
    """
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    asked = (kind.module, kind.made, kind.settings[name], posed, repeats, limit, simulated)
    child = context.Process(target=work, args=(theirs, *asked), daemon=True)
    child.start()
    theirs.close()
    messages, failure, deadline = list[dict[str, Any]](), f"not done after {limit:g} s", time.monotonic() + limit
    try:
        while ours.poll(max(0.0, deadline - time.monotonic())):
            messages.append(ours.recv())
    except EOFError:
        child.join()
        code = child.exitcode or 0
        what = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        failure = f"its process ended with {what}" if code else ""
    finally:
        child.kill()
        child.join()
    failure = next((line["failure"] for line in messages if "failure" in line), failure)
    start = next((line["start"] for line in messages if "start" in line), None)
    done = [line for line in messages if "seconds" in line]
    if not done:
        return EnginePoint(kind.name, name, start, failure=failure)
    # What broke while it repeated itself has been measured all the same.
    remark = f"a repeat: {failure}" if failure else done[0]["remark"]
    point = EnginePoint[S](kind.name, name, start, tuple(line["seconds"] for line in done), remark=remark)
    if not np.isfinite(x := done[0]["x"]).all():
        return EnginePoint(**vars(point) | {"failure": "positions are no longer finite"})
    try:
        return EnginePoint(**vars(point) | {"score": judge(x)})
    except RunFailed as error:
        return EnginePoint(**vars(point) | {"failure": str(error)})


def work(
    tell: Connection, module: str, made: str, setting: Setting, posed: object, repeats: int, limit: float,
    simulated: float = SECONDS,
) -> None:  # fmt: skip
    """The process: make the engine, one short run that compiles, then the repeats; what is found is sent as it comes.

    Engines write lines of their own, which go nowhere.
    """
    began, nowhere = time.perf_counter(), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    signal.alarm(int(limit) + 1)  # ends the process if its parent, which should, was killed
    try:
        peer: Peer = getattr(importlib.import_module(module), made)(posed, **setting)
        peer.advance(1 / 60)
        tell.send({"start": time.perf_counter() - began})
        spent = 0.0
        for _ in range(repeats):
            peer.reset()
            at = time.perf_counter()
            x = peer.advance(simulated)
            spent += (seconds := time.perf_counter() - at)
            tell.send({"seconds": seconds, "remark": peer.remark, "x": x})
            if spent > ENOUGH * limit:
                break
    except Exception as error:  # whatever an engine raises is a finding about it
        tell.send({"failure": f"{type(error).__name__}: {error}"[:300]})
